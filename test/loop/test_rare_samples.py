# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Rare samples: below the lower end of the range, skipped on the way to safe, and during the return to a path."""

from __future__ import annotations

import numpy as np
import pytest
from loop_support import HOLD, LEARNS, TRIANGLE, axis, steps

from hysteresis_ros.loop.axis import Change

RATE = 3000.0
#: Period of 30 samples, as in the tests of the learned correction.
N = 30


def test_an_axis_that_rests_is_stopped_by_the_first_measurement_below_its_range():
    """At rest a noisy sensor crosses the near, lower end by chance in one of 700 samples, and never the upper end."""
    given = {"motion_controller": {"type": "open_loop"}, **HOLD}
    quiet = axis(plant_simulator={"overtravel": 0.3e-6, "sensor__noise": 0.0}, **given)
    where = quiet.run(np.zeros(300))["displacement"][-1]
    low, high = quiet.plant.travel
    inside = where - low
    assert 0.0 < inside < 0.25 * (high - low)
    noisy = axis(plant_simulator={"overtravel": 0.3e-6, "sensor__noise": inside / 3.0}, **given)
    table = noisy.run(np.zeros(6000))
    below = table["measured"] < low
    assert below.any() and not (table["measured"] > high).any()
    np.testing.assert_array_equal(np.flatnonzero(table["tripped"] == 2.0), np.arange(np.argmax(below) + 1, 6000))
    assert noisy.plant.overtravelled


@pytest.mark.parametrize("stopped", ["hysteresis_compensator", "plant_simulator"])
def test_on_the_way_to_safe_a_skipped_sample_takes_no_step(stopped):
    """The amplifier did not receive the voltage of that sample, so the next voltage would be two steps away."""
    slow = {"hysteresis_compensator": {"safe_slew_rate": 900.0}, "plant_simulator": {"late_limit": -1}}
    made = axis(**HOLD, **slow)
    made.run(np.full(1500, 8e-6))
    skipped = np.zeros(120)
    skipped[40:100:3] = 1.0
    action = "stop" if stopped == "hysteresis_compensator" else "halt"
    made.apply(Change(made.sample, stopped, action))
    table = made.run(np.full(120, 8e-6), skipped=skipped)
    moved = np.concatenate([[0.0], steps(table["voltage"])])
    assert not moved[skipped == 1.0].any()
    ways = moved[40:100][skipped[40:100] == 0.0]
    assert ways == pytest.approx(np.full(ways.size, 900.0 / RATE), abs=2 * 150.0 / (2**16 - 1))


def test_nothing_is_learned_while_the_axis_returns_to_its_path():
    """The error is then the remaining distance, which decays exponentially and is not periodic."""
    made = axis(reference_generator=TRIANGLE, motion_controller=LEARNS)
    made.run(np.zeros(12 * N))
    made.apply(Change(made.sample, "motion_controller", "stop"))
    made.run(np.zeros(4 * N))
    assert made.controller.learning.missed == N
    before = made.controller.learning.learned().correction
    made.apply(Change(made.sample, "motion_controller", "start"))
    # the return decays with the hand-over's time constant: 5 periods
    for _ in range(3):
        made.run(np.zeros(N))
        assert made.controller.learning.missed == N
    np.testing.assert_array_equal(made.controller.learning.learned().correction, before)


def test_one_skipped_sample_leaves_no_trace_in_the_voltages_after_it():
    """The inverse responds to the current command: nothing fades, unlike after a stop."""
    given = {"reference_generator": TRIANGLE, "motion_controller": {"type": "open_loop"}}
    skipped = np.zeros(6 * N)
    skipped[3 * N + 7] = 1.0
    whole, other = axis(**given).run(np.zeros(6 * N)), axis(**given).run(np.zeros(6 * N), skipped=skipped)
    difference = np.abs(other["voltage"] - whole["voltage"])
    assert difference[3 * N + 7] > 1.0 and difference[3 * N + 8 :].max() < 0.01 * difference[3 * N + 7]
