# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A delay with the dynamics, in fractions of a sample: shifted responses, the delay of a ramp, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.uncertainty import slowed
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters

T = 0.005
MODELS = {
    "no matrices": LinearParameters(sample_time=T),
    "lag": LinearParameters(A=(0.8,), B=(0.2,), C=(1.0,), sample_time=T),
    "mode with feedthrough": LinearParameters(
        A=(0.6, 0.7, -0.7, 0.6), B=(0.2, 0.5), C=(1.0, 0.3), D=(0.4,), sample_time=T
    ),
}


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(MODELS)),
    st.integers(0, 5),
    st.sampled_from([0.0, 0.25, 0.5, 0.9]),
    st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=30),
)
def test_answers_come_later_by_whole_samples_and_are_shared_between_two_by_parts(name, whole, part, inputs):
    model, inputs = MODELS[name], np.array(inputs)
    prompt = LinearDynamics(model, T).simulate(inputs)
    late = LinearDynamics(replace(model, delay=(whole + part) * T), T).simulate(inputs)
    shifted = np.concatenate([np.zeros(whole + 1), prompt])
    expected = (1.0 - part) * shifted[1:] + part * shifted[:-1]
    np.testing.assert_allclose(late, expected[: len(inputs)], atol=1e-12)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("delay", [0.3 * T, T, 2.7 * T])
def test_a_ramp_comes_later_by_the_delay_and_a_constant_stays(name, delay):
    model = MODELS[name]
    late = replace(model, delay=delay)
    ramp = np.arange(400) * T
    behind = LinearDynamics(model, T).simulate(ramp)[-1] - LinearDynamics(late, T).simulate(ramp)[-1]
    assert behind == pytest.approx(delay, rel=1e-9)
    block = LinearDynamics(late, T)
    block.settle(3.0)
    assert block.output() == pytest.approx(3.0)
    np.testing.assert_allclose(block.simulate(np.full(20, 3.0)), 3.0, rtol=1e-12)
    assert late.state_space.dc_gain == pytest.approx(model.state_space.dc_gain)


def test_a_slow_lag_answers_like_the_continuous_one():
    lag, delay, part = 20.0 * T, 1.37 * T, 1.0 - np.exp(-1.0 / 20.0)
    model = LinearParameters(A=(1.0 - part,), B=(part,), C=(1.0,), sample_time=T, delay=delay)
    t = T * np.arange(1, 100)
    expected = np.where(t > delay, 1.0 - np.exp(-(t - delay) / lag), 0.0)
    found = LinearDynamics(model, T).simulate(np.ones(99))
    assert np.max(np.abs(found - expected)) < 5e-4
    without = LinearDynamics(replace(model, delay=T), T).simulate(np.ones(99))
    assert np.max(np.abs(without - expected)) > 1e-2, "a third of a sample has an effect"


def test_of_a_whole_plant_only_the_displacement_comes_later():
    """A rate-independent hysteresis and a delay commute: the response is the same, but later."""
    axis = load_configuration("picma_stage").override("motion_controller", type="open_loop")
    axis = axis.override("plant_simulator", **{"creep.type": "none"})
    prompt = simulate(single_axis(axis), duration=2.0, describe=False)
    late = axis.override("plant_simulator", **{"dynamics.delay": 2.0 * T})
    run = simulate(single_axis(late), duration=2.0, describe=False)
    assert run["voltage"].tobytes() == prompt["voltage"].tobytes()
    np.testing.assert_allclose(run["displacement"][2:], prompt["displacement"][:-2], rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "name", "text"),
    [
        ({"delay": T}, "delay", "needs sample_time"),
        ({"delay": -T, "sample_time": T}, "delay", "0"),
        ({"delay": 65.0 * T, "sample_time": T}, "delay", "at most 64 samples"),
    ],
)
def test_delays_that_cannot_be_are_refused_by_name(changes, name, text):
    with pytest.raises(ParameterError, match=text) as caught:
        LinearParameters(A=(0.8,), B=(0.2,), C=(1.0,), **changes).validated()
    assert [problem.name for problem in caught.value.problems] == [name]


def test_a_delay_changes_live_within_its_samples():
    block = LinearDynamics(replace(MODELS["lag"], delay=1.2 * T), T)
    block.settle(1.0)
    block.retune(replace(MODELS["lag"], delay=1.9 * T))
    np.testing.assert_allclose(block.simulate(np.ones(5)), 1.0, rtol=1e-12)
    with pytest.raises(ParameterError, match=r"delay.*as many samples"):
        block.retune(replace(MODELS["lag"], delay=2.1 * T))


def test_a_slower_plant_has_a_longer_delay_and_matrices_without_it():
    changed = slowed(replace(MODELS["lag"], delay=2.5 * T), 1.1)
    assert changed["delay"] == pytest.approx(2.75 * T) and len(changed["A"]) == 1
    assert slowed(replace(MODELS["no matrices"], delay=T), 0.9) == {"delay": pytest.approx(0.9 * T)}
