# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Settling of an axis: closed forms of step responses and ramps, and the definition itself on any samples."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.references.moves import Settling

TOLERANCE, TIME, STEP = 2e-8, 0.01, 1e-3


def first_settled(samples, tolerance=TOLERANCE, time=TIME, step=STEP) -> int | None:
    """Return the first of (setpoint, reference, measured, stopped) at which the axis has settled."""
    settling = Settling(tolerance, time, step)
    return next((k for k, sample in enumerate(samples) if settling.look(*sample)), None)


def test_a_step_has_settled_when_its_response_has_been_in_the_band_for_the_time():
    lag, height = 0.02, 5e-6
    response = [(height, height, height * (1.0 - math.exp(-k * STEP / lag)), False) for k in range(1000)]
    entered = math.ceil(lag * math.log(height / TOLERANCE) / STEP)
    assert first_settled(response) == entered + round(TIME / STEP) - 1


def test_an_overshoot_out_of_the_band_begins_the_time_anew():
    error = [0.0] * 8 + [1.5 * TOLERANCE] + [0.0] * 20
    assert first_settled([(1e-6, 1e-6, 1e-6 + e, False) for e in error]) == 9 + 9


def test_an_axis_that_follows_a_ramp_has_not_settled_unless_the_ramp_is_as_good_as_at_rest():
    for speed, settles in ((1.01 * TOLERANCE / TIME, False), (0.99 * TOLERANCE / TIME, True)):
        ramp = [(0.0, speed * k * STEP, speed * k * STEP, False) for k in range(200)]
        assert (first_settled(ramp) is not None) == settles


def test_a_wrong_measurement_a_trip_and_another_setpoint_end_it():
    good = (1e-6, 1e-6, 1e-6, False)
    for bad in ((1e-6, 1e-6, math.nan, False), (1e-6, 1e-6, 1e-6, True), (2e-6, 1e-6, 1e-6, False)):
        settling = Settling(TOLERANCE, TIME, STEP)
        assert [settling.look(*good) for _ in range(11)][-1]
        assert not settling.look(*bad)
        assert not settling.look(*good)


@given(st.lists(st.tuples(st.sampled_from([0.0, 1e-6]), st.integers(-3, 3), st.booleans()), max_size=60))
def test_it_is_what_the_last_samples_say_and_nothing_else(steps):
    settling = Settling(TOLERANCE, 0.004, STEP)
    counted, before = [], math.nan
    for setpoint, error, stopped in steps:
        settled = settling.look(setpoint, setpoint, setpoint + 0.45 * error * TOLERANCE, stopped)
        counted.append(setpoint == before and abs(error) <= 2 and not stopped)
        before = setpoint
        assert settled == (len(counted) >= 4 and all(counted[-4:]))
