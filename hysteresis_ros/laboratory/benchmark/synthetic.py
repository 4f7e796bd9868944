# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Synthetic recordings of stages of other classes than the package's models; the true displacement is known.

The plants are those of :mod:`hysteresis_ros.laboratory.foreign`, drawn at random. The recording for the fit contains
the converter's quantisation and the sensor's noise. The test has another input, and the prediction is compared with the
displacement without noise.
"""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.laboratory.benchmark.manifest import Task
from hysteresis_ros.laboratory.comparison.rows import Bench, drawn, recorded
from hysteresis_ros.models.limits import Limits

#: Length of the test [s].
DURATION = 4.0
#: Length of the first part of the test, which determines the state and is not judged [s].
LEAD = 0.5


def test_voltage(seed: int, bench: Bench) -> np.ndarray:
    """Return the voltage of the test [V]: loops between random points, then steps, within 5 … 95 % of the range."""
    random = np.random.default_rng((seed, 4))
    rate, span = bench.sample_rate, bench.voltage
    samples = round(0.75 * DURATION * rate)
    times, levels = [0.0], [0.0]
    while times[-1] < samples / rate:
        times.append(times[-1] + random.uniform(0.02, 0.25))
        levels.append(span * random.uniform(0.05, 0.95))
    loops = np.interp(np.arange(samples) / rate, times, levels)
    steps = np.repeat(span * random.uniform(0.05, 0.95, 5), round((DURATION * rate - samples) / 5))
    return np.concatenate([loops, steps])


def synthetic_task(seed: int, noise: float = 5e-9) -> Task:
    """Return the recordings of a plant.

    Units: ``noise`` [m], the standard deviation of the sensor noise. The seed determines the class of hysteresis.
    """
    bench = Bench(noise=noise)
    plant = drawn(seed, bench)
    recording = recorded(plant, bench, seed)
    step = 1.0 / bench.sample_rate
    voltage = Limits(bench.node(seed).limits, step).simulate(test_voltage(seed, bench))
    # a measurement responds to earlier voltages only
    moved = np.concatenate([[0.0], plant.between(voltage)[:-1, -1]])
    source = f"synthetic plant {seed} ({plant.actuator.hysteresis})"
    train = IdentificationData(recording.time, recording["voltage"], recording["measured"], source=source)
    test = IdentificationData(np.arange(len(voltage)) * step, voltage, moved, source=source)
    about = f"stage of class {plant.actuator.hysteresis}, {bench.sample_rate:g} Hz, noise {1e9 * noise:g} nm"
    truth = {"seed": seed, "noise": noise, "sample_rate": bench.sample_rate, **asdict(plant.actuator)}
    return Task(f"synthetic_{seed}", train, test, round(LEAD * bench.sample_rate), "kept", about, truth)
