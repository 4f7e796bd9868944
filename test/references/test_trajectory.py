# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Trajectories: through their points, with the stated smoothness, within the bounds, and from any motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.references.approach import ApproachParameters
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters
from hysteresis_ros.references.moves import Arrival
from hysteresis_ros.references.trajectory import ENDED, HELD, OPEN, REPLACED, STOPPED, Points

TS = 1e-3
START = 2e-6


def generator(**limits) -> ReferenceGenerator:
    """Return a generator at rest at 2 µm of 0 … 15 µm; ``limits`` of its approach."""
    return ReferenceGenerator(ReferenceParameters(initial_setpoint=START, approach=ApproachParameters(**limits)), TS)


def play(made: ReferenceGenerator, samples: int, setpoint: float = START) -> np.ndarray:
    return made.simulate(np.full(samples, setpoint))


FIELDS = st.sampled_from(("positions", "velocities", "accelerations"))


@given(FIELDS, st.lists(st.floats(1e-6, 14e-6), min_size=1, max_size=5), st.data())
@settings(deadline=None, max_examples=60)
def test_it_goes_through_its_points_with_their_velocities_and_accelerations(fields, positions, data):
    count = len(positions)
    times = np.cumsum(data.draw(st.lists(st.integers(20, 80), min_size=count, max_size=count))) * TS
    inner = st.lists(st.floats(-1e-5, 1e-5), min_size=count - 1, max_size=count - 1)
    asked = {"times": times, "positions": positions}
    if fields != "positions":
        asked["velocities"] = [*data.draw(inner), 0.0]
    if fields == "accelerations":
        asked["accelerations"] = [*data.draw(inner), 0.0]
    segments = Points(**asked).segments(START, 0.0, 0.0)
    for index, (first, *coefficients) in enumerate(segments):
        path = np.polynomial.Polynomial(coefficients)
        end = times[index] - first
        assert path(end) == pytest.approx(positions[index], abs=1e-18)
        for order, name in enumerate(("velocities", "accelerations"), start=1):
            if name in asked:
                assert path.deriv(order)(end) == pytest.approx(asked[name][index], abs=1e-13 / end**order)
    made = generator()
    try:
        made.follow(**asked)
    except ParameterError as error:
        assert "out of range" in str(error)  # a cubic that leaves the range between its points
        return
    reference = play(made, round(times[-1] / TS) + 5)
    assert reference[np.rint(times / TS).astype(int) - 1] == pytest.approx(positions, abs=1e-18)
    assert np.all(reference[round(times[-1] / TS) - 1 :] == positions[-1])
    assert made.trajectory == (1, ENDED)


def test_a_quintic_from_rest_to_rest_is_the_minimum_jerk_move():
    made = generator()
    made.follow([0.1], [10e-6], [0.0], [0.0])
    s = np.arange(1, 101) / 100
    shape = START + 8e-6 * s**3 * (10 - 15 * s + 6 * s**2)
    assert play(made, 100) == pytest.approx(shape, abs=1e-18)


def test_it_takes_over_from_a_motion_with_its_velocity_and_acceleration():
    made = generator(maximum_velocity=2e-4, maximum_acceleration=2e-2)
    before = play(made, 30, 12e-6)
    made.follow([0.2], [10e-6], [0.0], [0.0])
    whole = np.concatenate([before, play(made, 300, 12e-6)])
    speed = np.diff(whole) / TS
    assert speed[29] == pytest.approx(speed[28], rel=0.05) and speed[29] > 1e-4
    assert np.abs(np.diff(speed)).max() / TS < 2.1e-2
    assert whole[-1] == 10e-6


def test_it_ends_at_a_new_setpoint_of_which_an_old_one_is_none():
    made = generator()
    made.follow([0.05], [9e-6])
    play(made, 80, START)
    assert made.trajectory == (1, ENDED) and made.step(START) == 9e-6
    assert made.step(9e-6) == 9e-6  # the trajectory's own setpoint, received again
    assert made.step(START) == START  # now it is another setpoint
    made.follow([0.05], [7e-6])
    play(made, 1, START)
    play(made, 49, 7e-6)  # echoed on the way
    assert made.trajectory == (2, ENDED)
    made.follow([0.05], [9e-6])
    play(made, 10, START)
    made.step(4e-6)
    assert made.step(4e-6) == 4e-6 and made.trajectory == (3, REPLACED)


def test_a_limited_axis_brakes_before_it_goes_elsewhere_or_stays():
    limits = {"maximum_velocity": 2e-4, "maximum_acceleration": 1e-2}
    for setpoint, outcome in ((START, HELD), (5e-6, REPLACED)):
        made = generator(**limits)
        made.follow([0.1], [12e-6], [0.0])
        whole = [play(made, 50)]
        if outcome == HELD:
            made.hold()
        whole.append(play(made, 400, setpoint))
        reference = np.concatenate(whole)
        assert made.trajectory == (1, outcome)
        assert np.abs(np.diff(reference, 2)).max() / TS**2 <= 1.2e-2
        stopped = reference[49] + 0.5 * (reference[49] - reference[48]) ** 2 / TS**2 / 1e-2
        assert reference.max() == pytest.approx(stopped, rel=1e-3)
        assert reference[-1] == (5e-6 if outcome == REPLACED else reference.max())


def test_an_axis_without_limits_stays_where_it_is_told_to():
    made = generator()
    made.follow([0.1], [12e-6])
    moving = play(made, 50)
    made.hold()
    assert np.all(play(made, 50) == moving[-1]) and made.trajectory == (1, HELD)


def test_a_newer_trajectory_replaces_one_and_a_stop_ends_it():
    made = generator()
    made.follow([0.1], [12e-6])
    play(made, 50)
    made.follow([0.1], [3e-6], [0.0])
    assert made.trajectory == (2, OPEN)
    at = play(made, 50)[-1]
    made.stop()
    assert made.trajectory == (2, STOPPED)
    with pytest.raises(ParameterError, match="stopped; call start"):
        made.follow([0.1], [3e-6])
    made.start()
    assert np.all(play(made, 20) == at)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ({"times": [0.1, 0.1], "positions": [1e-6, 2e-6]}, "must be later than 0.1 s"),
        ({"times": [-0.1], "positions": [1e-6]}, "must not be negative"),
        ({"times": [0.0], "positions": [START]}, "must be later than 0 s"),
        ({"times": [], "positions": []}, "allowed: 1 … 1000"),
        ({"times": [0.1], "positions": [1e-6, 2e-6]}, "give one for every point"),
        ({"times": [0.1], "positions": [math.nan]}, "must be a finite number"),
        ({"times": [0.1], "positions": [16e-6]}, "out of range, allowed: 0 … 1.5e-05 m"),
        ({"times": [0.1, 0.2], "positions": [14.9e-6] * 2, "velocities": [1e-4, 0.0]}, "out of range"),
        ({"times": [0.1], "positions": [3e-6], "velocities": [1e-4]}, "because the axis rests there"),
        ({"times": [0.1], "positions": [3e-6], "accelerations": [0.0]}, "without velocities"),
        ({"times": [0.1, 0.2], "positions": [3e-6] * 2, "velocities": [0.0]}, "give one for every point or none"),
        ({"times": [0.0, 0.1], "positions": [3e-6, 4e-6]}, "give the first point a later time"),
        ({"times": [0.01], "positions": [5e-6], "velocities": [0.0]}, "velocities = 0.00045.*allowed: ≤ 0.0002"),
        ({"times": [0.1], "positions": [5e-6]}, "at a corner"),
        ({"times": [0.025], "positions": [4e-6], "velocities": [0.0]}, "too high, allowed: ≤ 0.01"),
    ],
)
def test_what_is_no_trajectory_of_the_axis_is_refused_by_name_and_changes_nothing(points, words):
    made = generator(maximum_velocity=2e-4, maximum_acceleration=1e-2)
    before = made.state
    with pytest.raises(ParameterError, match=words):
        made.follow(**points)
    assert np.array_equal(made.state, before, equal_nan=True)


def test_a_first_point_at_time_0_is_where_the_axis_is_within_a_tolerance():
    made, other = generator(), generator()
    made.follow([0.0, 0.1], [START + 1.4e-7, 9e-6], [0.0, 0.0])
    other.follow([0.1], [9e-6], [0.0])
    assert np.array_equal(play(made, 150), play(other, 150))


def test_arrived_is_near_for_long_enough_without_a_break():
    arrival = Arrival(1e-8, 0.02)
    taken = [arrival.take(0.01 * k, error) for k, error in enumerate((5e-8, 9e-9, -9e-9, 9e-9, 2e-8, 0.0, math.nan))]
    assert taken == [False, False, False, True, False, False, False]
    arrival.restart()
    assert not arrival.take(1.0, 0.0)
    assert Arrival(1e-8, 0.0).take(3.0, 1e-8)
