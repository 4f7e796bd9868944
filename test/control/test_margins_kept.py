# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Automatic designs keep the margins required of every design, on the model and with one more sample of delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.control.controller import DESIGNS, ControllerParameters
from hysteresis_ros.control.kalman import INNOVATION, KalmanFilter, KalmanParameters
from hysteresis_ros.control.linearisation import linear_loop, margins
from hysteresis_ros.control.margins import REQUIRED, margins_of, plant_state_space
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.models.linear import LinearDynamics

T = 0.005


def lag(time_constant: float = 0.015, sample_time: float = T, delay: float = 0.0) -> ControllerParameters:
    """Return parameters whose model is a lag of unit gain, in micrometres."""
    a = float(np.exp(-sample_time / time_constant))
    values = {"A": (a,), "B": (1.0 - a,), "C": (1.0,), "output_scale": 1e-6}
    values |= {"sample_time": sample_time, "delay": delay}
    return ControllerParameters.from_mapping({f"model.dynamics.{name}": value for name, value in values.items()})


def later(parameters, samples: float, sample_time: float = T):
    """Return the loop of the same gains with more delay in the plant; the observer's model is unchanged."""
    dynamics = parameters.model.dynamics
    late = replace(dynamics, delay=dynamics.delay + samples * sample_time, sample_time=sample_time)
    controller, _ = linear_loop(parameters, sample_time)
    return margins_of(controller, plant_state_space(late), sample_time)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "delay"), [*((name, 0.0) for name in DESIGNS), ("pid", 1.4 * T), ("offset_free", 1.4 * T)]
)
def test_a_design_of_a_lag_keeps_them_with_and_without_a_modelled_delay(name, delay):
    found = design_gains(lag(delay=delay), name, T)
    assert found.margins.meets, found.margins.misses()
    one_more = later(found.parameters, 1.0)
    assert one_more.stable and one_more.delay_margin_samples > 0.99 and one_more.sensitivity_peak < 3.03
    assert found.margins.bandwidth > 5.0


@pytest.mark.slow
def test_a_resonance_is_not_damped_by_a_loop_that_a_sample_of_delay_would_excite(parameters):
    """Kim's axis has 76 degrees of lag per sample at its resonance; the published filter tolerates 0.58 samples."""
    time = 1.0 / 3000.0
    published = margins(parameters(), time)
    assert not published.meets and not later(parameters(), 1.0, time).stable
    found = design_gains(parameters(), "offset_free", time)
    assert found.margins.meets
    one_more = later(found.parameters, 1.0, time)
    assert one_more.stable and one_more.delay_margin_samples > 0.99 and one_more.sensitivity_peak < 3.03


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pid", "offset_free"])
def test_a_fast_sample_rate_makes_no_fast_loop_of_a_slow_lag(name):
    """A lag of 12 Hz at 20 kHz: the effect of sensor noise on the command ends the search, not the sample rate."""
    time, slow = 5e-5, lag(1.0 / (2.0 * np.pi * 12.0), 5e-5)
    found = design_gains(slow, name, time, aimed=replace(REQUIRED, command_noise_gain=20.0))
    assert 10.0 < found.margins.command_noise_gain < 20.1
    assert 50.0 < found.margins.bandwidth < 1500.0, "a tenth of the sample rate would be 2 kHz"
    louder = design_gains(slow, name, time, aimed=replace(REQUIRED, command_noise_gain=2.0))
    assert louder.margins.bandwidth < 0.5 * found.margins.bandwidth


@pytest.mark.slow
def test_an_observer_that_knows_the_delay_foresees_through_it():
    """Without noise its innovation is zero for any input; an observer without the delay has an innovation."""
    dynamics = lag(delay=2.3 * T).model.dynamics
    inputs = np.random.default_rng(2).normal(size=200)
    surprises = {}
    for known in (True, False):
        believed = dynamics if known else replace(dynamics, delay=0.0)
        observer = KalmanFilter(KalmanParameters(form="current"), T, believed)
        plant, seen, before = LinearDynamics(replace(dynamics, input_scale=1.0, output_scale=1.0), T), [], 0.0
        for u in inputs:
            observer.step(before, plant.output())
            seen.append(observer.x[INNOVATION])
            plant.step(u)
            before = u
        surprises[known] = np.max(np.abs(seen))
    assert surprises[True] < 1e-12 and surprises[False] > 0.1
