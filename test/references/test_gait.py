# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The gait: its cycle in numbers, smooth profiles, and refusals with the value."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.references.inchworm_parameters import GaitParameters, crossing, cycloid, ramp

GAIT = GaitParameters()


def problems(**changes):
    with pytest.raises(ParameterError) as error:
        replace(GAIT, **changes).validated("gait.")
    return {problem.name: problem.remedy for problem in error.value.problems}


def test_a_cycle_is_the_sum_of_its_six_processes():
    gait = replace(GAIT, release=2e-3, grip=3e-3, extend=5e-3, contract=4e-3, settle=0.5e-3, overlap=1e-3)
    assert gait.period == pytest.approx(2e-3 + 5e-3 + 3e-3 + 2e-3 + 4e-3 + 3e-3 + 2 * 0.5e-3 - 2 * 1e-3)
    assert gait.frequency == pytest.approx(1.0 / 18e-3)
    assert gait.speed == pytest.approx(gait.stroke * gait.frequency)


def test_the_cycloid_rests_at_both_ends_and_is_fastest_in_the_middle():
    s = np.linspace(0.0, 1.0, 1001)
    y = np.array([cycloid(value) for value in s])
    velocity = np.gradient(y, s)
    acceleration = np.gradient(velocity, s)
    assert y[0] == 0.0 and y[-1] == 1.0 and np.all(np.diff(y) >= 0.0)
    assert np.max(velocity) == pytest.approx(2.0, rel=1e-4) and abs(velocity[0]) < 1e-4
    assert np.max(np.abs(acceleration)) == pytest.approx(2.0 * np.pi, rel=1e-3)
    assert [cycloid(value) for value in (-1.0, 2.0)] == [0.0, 1.0]


def test_a_linear_ramp_crosses_a_level_at_that_part_of_its_time():
    assert crossing(True, 0.3) == pytest.approx(0.3)
    assert cycloid(crossing(False, 0.3)) == pytest.approx(0.3)
    assert crossing(False, 0.5) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("changes", "name", "said"),
    [
        ({"grip": 0.5e-3}, "gait.grip", "clamp_settling = 0.001 s"),
        ({"release": 0.9e-3}, "gait.release", "clamp_settling = 0.001 s"),
        ({"overlap": 2.5e-3}, "gait.overlap", "closed for only 0.0005 s"),
        ({"overlap": 3e-3}, "gait.overlap", "below 0.003 s"),
        ({"threshold_voltage": 100.0}, "gait.threshold_voltage", "between 0 and 100 V"),
        ({"grip_voltage": -1.0}, "gait.grip_voltage", "release_voltage = 0 V"),
        ({"initial_voltage": 120.0}, "gait.initial_voltage", "0 … 100 V"),
        ({"lowest_extension": 9e-6}, "gait.highest_extension", "lowest_extension = 9e-06 m"),
        ({"walking_speed": -4e-4}, "gait.walking_speed", "reaches 0.000307692 m/s"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_number(changes, name, said):
    assert said in problems(**changes)[name]


def test_speeds_that_the_gait_can_do_are_not_refused():
    assert [GAIT.refuse_speed(value) for value in (0.0, GAIT.speed, -GAIT.speed)] == [None] * 3
    assert "8e-06 m at 38.4615 Hz" in GAIT.refuse_speed(1.01 * GAIT.speed)
    assert GAIT.refuse_speed(float("nan"))


@settings(max_examples=60, deadline=None)
@given(
    grip=st.floats(1e-3, 10e-3),
    release=st.floats(1e-3, 10e-3),
    part=st.floats(0.0, 1.0),
    level=st.floats(5.0, 95.0),
    linear=st.booleans(),
)
def test_no_allowed_exchange_opens_both_clamps(grip, release, part, level, linear):
    shape = "linear" if linear else "cycloidal"
    overlap = part * min(grip, release)
    gait = replace(GAIT, grip=grip, release=release, overlap=overlap, threshold_voltage=level, clamp_ramp=shape)
    assume(not gait.problems())
    t = np.linspace(0.0, grip + release, 2000)
    closing = np.array([100.0 * ramp(float(linear), value) for value in t / grip])
    opening = np.array([100.0 * (1.0 - ramp(float(linear), value)) for value in (t - grip + overlap) / release])
    assert np.all(np.maximum(closing, opening) >= level)
    assert gait.closed_margin >= gait.clamp_settling
