# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Input shaping: no residual vibration of the mode, little with a wrong frequency, and no motion at rest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import zero_order_hold
from hysteresis_ros.references.approach import RING, Shaper, ShapingParameters, zero_vibration
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters

T = 1e-3


def left(kind: str, frequency: float, damping: float, actual: float) -> float:
    """Vibration after a unit step, as a fraction of the vibration that the unshaped step causes at the same time."""
    omega = 2.0 * math.pi * actual
    A, B = zero_order_hold([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]], [[0.0], [omega**2]], T)
    shaper = Shaper(ShapingParameters(type=kind, frequency=frequency, damping=damping), T)
    shaper.rest_at(0.0)
    count = round(1.3 / (frequency * T)) + 6
    x, bare = np.zeros(2), np.zeros(2)
    for _ in range(count):
        x = A @ x + B[:, 0] * shaper.step(1.0)
        bare = A @ bare + B[:, 0]
    size = [math.hypot(state[0] - 1.0, state[1] / omega) for state in (x, bare)]
    return size[0] / size[1]


@settings(max_examples=30)
@given(st.sampled_from(["zv", "zvd"]), st.floats(2.0, 240.0), st.floats(0.0, 0.3))
def test_of_the_mode_it_is_for_nothing_is_left(kind, frequency, damping):
    assert left(kind, frequency, damping, frequency) < 1e-7
    weights = zero_vibration(frequency, damping, T)
    assert np.all(weights >= -1e-12) and np.sum(weights) == pytest.approx(1.0, abs=1e-12)
    assert np.flatnonzero(weights)[-1] <= 0.5 / (frequency * T * math.sqrt(1.0 - damping**2)) + 1.0


def test_what_a_wrong_frequency_leaves_is_that_of_the_two_impulses_and_its_square():
    # two equal impulses half a period apart leave |cos(π/2 f/f₀)| of an undamped mode, three leave the square of it
    for actual in (9.0, 10.0, 11.0):
        wanted = abs(math.cos(0.5 * math.pi * actual / 10.0))
        assert left("zv", 10.0, 0.0, actual) == pytest.approx(wanted, abs=1e-3)
        assert left("zvd", 10.0, 0.0, actual) == pytest.approx(wanted**2, abs=1e-3)
    assert left("none", 10.0, 0.0, 10.0) == 1.0


def generator(**shaping):
    values = {f"shaping.{name}": value for name, value in shaping.items()}
    return ReferenceGenerator(ReferenceParameters.from_mapping({"maximum": 1e-5, **values}), T)


def test_moves_are_shaped_arrive_exactly_and_stay_within_the_range():
    made = generator(type="zvd", frequency=20.0, damping=0.05)
    references = made.simulate(np.repeat([0.0, 7.7e-6, 1.1e-6], [10, 60, 60]))
    assert not np.any(references[:10]) and 0.0 < references[10] < 3e-6
    assert np.all(references[62:70] == 7.7e-6) and np.all(references[-8:] == 1.1e-6)
    assert np.all((references >= 0.0) & (references <= 7.7e-6 * (1.0 + 1e-12)))
    made.reset()
    assert made.step(0.0) == 0.0 and made.step(7.7e-6) == references[10]


def test_shaping_changes_while_the_setpoint_rests_and_only_then():
    made = generator(type="zv", frequency=20.0)
    other = ReferenceParameters.from_mapping(
        {"maximum": 1e-5, "shaping.type": "zvd", "shaping.frequency": 50.0, "shaping.damping": 0.1}
    )
    made.simulate(np.full(20, 4e-6))
    assert made.moving
    with pytest.raises(ParameterError, match=r"shaping\.\w+ = .*only while no move is in progress"):
        made.retune(other)
    assert made.parameters.shaping.type == "zv"
    made.simulate(np.full(RING + 20, 4e-6))
    made.retune(other)
    fresh = generator(type="zvd", frequency=50.0, damping=0.1)
    fresh.simulate(np.full(200, 4e-6))
    onwards = np.repeat([4e-6, 9e-6], [5, 60])
    assert np.array_equal(made.simulate(onwards), fresh.simulate(onwards))


def test_a_trajectory_is_not_shaped_and_a_move_after_it_begins_at_rest():
    made = generator(type="zv", frequency=20.0)
    made.follow([0.01, 0.02], [1e-6, 2e-6])
    references = made.simulate(np.zeros(60))
    assert references[19] == pytest.approx(2e-6, rel=1e-9) and np.all(references[21:] == references[-1])
    moved = made.simulate(np.full(60, 5e-6))
    assert 2e-6 < moved[0] < 4e-6 and moved[-1] == 5e-6


@pytest.mark.parametrize("frequency", [0.0, 0.1, 500.0])
def test_a_frequency_that_samples_cannot_shape_is_refused_by_name(frequency):
    with pytest.raises(ParameterError, match=rf"frequency = {frequency:g}"):
        generator(type="zv", frequency=frequency)
