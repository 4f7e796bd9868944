# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The voltages of the stages, sample by sample: each begins and ends at the safe voltage, and goes there smoothly."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.commissioning.plan import Plan
from hysteresis_ros.references.recipes import SMALL, recipe
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters
from hysteresis_ros.references.ways import REST, hold, there_and_back, way

#: Seconds of a small step, and of the holds around it; of the step whose creep is measured, and part of its hold that
#: the way back is watched.
STEP_WAY, STEP_HOLD = 0.05, 0.75
CREEP_WAY, BACK_PART = 0.1, 0.25
#: Periods of the multisine, and their length [s]; the first one settles.
PERIODS, PERIOD = 5, 2.0
#: Decaying cycles: those over the whole range, all others, and how many of these lower the amplitude to 1/e.
WHOLE, DECAYING, DECAY = 2, 14, 3.5
#: Where the step whose creep is measured ends, as a part of the range.
CREEP_PART = 0.8


def listening(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return the voltage [V] under which the sensor is listened to: the safe one."""
    return hold(safe, plan.noise_duration, rate)


def step_size(plan: Plan, safe: float) -> float:
    """Return the small step [V]: towards the farther end of the range."""
    size = plan.step * plan.span
    return size if plan.maximum - safe >= safe - plan.minimum else -size


def small_step(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return a small step and the way back [V]."""
    level, wait = safe + step_size(plan, safe), hold(safe, STEP_HOLD, rate)
    up, back = way(safe, level, STEP_WAY, rate), way(level, safe, STEP_WAY, rate)
    return np.concatenate([wait, up, hold(level, STEP_HOLD, rate), back, wait])


def small_multisine(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return a small multisine around the middle of the range, with the ways there and back [V]."""
    part = plan.small / SMALL
    asked = recipe("multisine", plan.minimum, plan.maximum, rate, 1.0 / PERIOD, part, PERIODS * PERIOD)
    sines = Waveform(WaveformParameters.from_mapping(asked.waveform), 1.0 / rate)
    voltages = sines.simulate(np.zeros(round(asked.duration * rate)))
    return there_and_back(np.clip(voltages, plan.minimum, plan.maximum), safe, rate)


def decaying_cycles(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return cycles over the whole range whose amplitude then decays, with the ways there and back [V]."""
    cycle = max(round(rate / plan.cycle_frequency), 8)
    index = np.arange((WHOLE + DECAYING) * cycle + 1)
    fall = np.exp(-np.maximum(index - WHOLE * cycle, 0) / (DECAY * cycle))
    middle = 0.5 * (plan.minimum + plan.maximum)
    return there_and_back(middle - 0.5 * plan.span * fall * np.cos(2.0 * np.pi * index / cycle), safe, rate)


def creeping_level(plan: Plan, safe: float) -> float:
    """Return where the step whose creep is measured ends [V]."""
    far = plan.maximum if plan.maximum - safe >= safe - plan.minimum else plan.minimum
    return safe + CREEP_PART * (far - safe)


def creeping_step(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return a large step that is held, and the way back, which is watched for a while [V]."""
    level = creeping_level(plan, safe)
    up, back = way(safe, level, CREEP_WAY, rate), way(level, safe, CREEP_WAY, rate)
    held, rest = hold(level, plan.creep_duration, rate), hold(safe, BACK_PART * plan.creep_duration, rate)
    return np.concatenate([hold(safe, REST, rate), up, held, back, rest])
