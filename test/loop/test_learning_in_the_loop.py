# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The learned correction in an axis: runs without it, when it learns, and agreement of all runners."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from fused_support import ANY_LATE, assert_twin, change, made_loop, whole
from loop_support import HOLD, LEARNS, TRIANGLE, assert_same_bits, axis, parameters
from waiting import until

from hysteresis_ros.cli.commissioning.closed_loop import learned_line
from hysteresis_ros.control import learning as at
from hysteresis_ros.control.learning import LIMITED, shown
from hysteresis_ros.designs.learning import LearningRequest, design_learning
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Axis, Change

#: Period of 30 samples.
N = 30


def learning_axis(reference=None, **controller):
    return axis(reference_generator=reference or TRIANGLE, motion_controller={**LEARNS, **controller})


def corrections(made, count):
    """Run sample by sample, and return the correction of each sample."""
    found = np.empty(count)
    for k in range(count):
        made.run([0.0])
        found[k] = made.controller.learning.x[at.CORRECTION]
    return found


def test_one_that_has_learned_nothing_and_does_not_learn_changes_no_bit():
    plain, idle = axis(reference_generator=TRIANGLE), learning_axis(learning__active=False)
    assert_same_bits(plain.run(np.zeros(200)), idle.run(np.zeros(200)))
    assert np.any(learning_axis().run(np.zeros(200))["command"] != plain.run(np.zeros(200))["command"])


def test_without_a_measurement_it_repeats_itself():
    made = learning_axis()
    made.run(np.zeros(8 * N))
    made.inject((f"nan:0.0:{2 * N / 3000}",))
    blind = corrections(made, 5 * N).reshape(5, N)
    # earlier measurements are learned in the first period, later ones in the fourth
    assert np.any(blind[0]) and np.any(blind[3] != blind[2])
    assert np.array_equal(blind[2][:-6], blind[1][:-6])


def test_stopped_it_repeats_itself_in_phase_and_goes_on_without_a_jump():
    made = learning_axis()
    made.run(np.zeros(8 * N))
    made.controller.stop()
    stopped = corrections(made, 4 * N).reshape(4, N)
    # measurements before the stop are learned in the period after it
    assert np.any(stopped[1]) and np.array_equal(stopped[2], stopped[1]) and np.array_equal(stopped[3], stopped[1])
    made.controller.start()
    after = made.run(np.zeros(3 * N))["command"]
    assert np.max(np.abs(np.diff(after))) < 1e-6


def test_nothing_is_learned_while_the_command_is_not_carried_out():
    given = parameters(reference_generator=TRIANGLE, motion_controller=LEARNS)
    own = given.hysteresis_compensator  # a configuration with this slew rate is refused
    slow = replace(own, limits=replace(own.limits, slew_rate=10.0))
    made = Axis(replace(given, hysteresis_compensator=slow))
    # the first samples, of a triangle that begins at zero, are still achieved
    assert not np.any(corrections(made, 6 * N).reshape(6, N)[1:, 10:-10])
    assert np.any(corrections(learning_axis(), 6 * N).reshape(6, N)[1:, 10:-10])


def test_the_error_is_that_of_the_displacement_without_its_preload():
    given = {"reference_generator": TRIANGLE, "motion_controller": LEARNS | {"model__preload__force": 1.0}}
    loaded = axis(plant_simulator={"preload__force": 1.0}, **given)
    learned, plain = corrections(loaded, 4 * N), corrections(learning_axis(), 4 * N)
    assert np.max(np.abs(plain)) > 1e-8
    np.testing.assert_allclose(learned, plain, rtol=0, atol=1e-12)


def test_nor_while_the_axis_still_answers_to_what_was_not_carried_out():
    block = axis(motion_controller={**LEARNS, "learning__recovery": 2 / 3000}, **HOLD).controller.learning
    shortfalls = [0.0, 1e-6, -1e-6, 0.0, 0.0, 0.0, 2e-6, 0.0]
    seen = [shown(block.p, block.x, 1e-9, shortfall, 0.0) for shortfall in shortfalls]
    assert seen == [1e-9, LIMITED, LIMITED, LIMITED, LIMITED, 1e-9, LIMITED, LIMITED]


def test_nor_while_it_answers_to_a_voltage_that_came_too_late_and_that_takes_nothing_back():
    block = axis(motion_controller={**LEARNS, "learning__recovery": 2 / 3000}, **HOLD).controller.learning
    skipped = [0.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    seen = [shown(block.p, block.x, 1e-9, 0.0, late) for late in skipped]
    np.testing.assert_array_equal(seen, [1e-9, np.nan, np.nan, np.nan, np.nan, 1e-9])


def test_a_late_voltage_does_not_shorten_the_time_after_limits_nor_turn_it_into_a_lesson():
    given = {**LEARNS, "learning__recovery": 4 / 3000, "learning__late_recovery": 1 / 3000}
    block = axis(motion_controller=given, **HOLD).controller.learning
    events = [
        (1e-6, 0.0),
        (0.0, 0.0),
        (0.0, 1.0),
        (0.0, 0.0),
        (0.0, 0.0),
        (0.0, 0.0),
        (0.0, 1.0),
        (0.0, 0.0),
        (0.0, 0.0),
    ]
    seen = [shown(block.p, block.x, 1e-9, shortfall, late) for shortfall, late in events]
    np.testing.assert_array_equal(seen, [LIMITED] * 5 + [1e-9, np.nan, np.nan, 1e-9])


def test_a_missed_deadline_is_left_out_with_what_the_axis_answers_to_it():
    late = np.zeros(8 * N)
    late[7 * N + 7 : 7 * N + 9] = 1.0
    missed = []
    for recovery in (0, 4):
        made = learning_axis(learning__recovery=recovery / 3000)
        made.run(np.zeros(8 * N), skipped=late)
        missed.append(made.controller.learning.missed)
    assert missed[0] >= 2 and missed[1] == missed[0] + 4


PERIOD = 300  # samples of Kim's axis, 0.1 s


def learned_with_missed_samples(seed, late_recovery):
    """Return the RMS error [m] of samples that were not missed, after 32 periods with 0.5 % missed, and the periods.

    After saturation nothing is learned for 2 s, which is 20 periods.
    """
    reference = {**TRIANGLE, "waveform__frequency": 10.0}
    plain = parameters(**{**ANY_LATE, "reference_generator": reference})
    designed = design_learning(plain, LearningRequest("inversion", period=0.1)).parameters
    assert 0.0 < designed.late_recovery <= designed.recovery
    chosen = replace(designed, recovery=2.0, late_recovery=late_recovery or designed.late_recovery)
    made = Axis(replace(plain, motion_controller=replace(plain.motion_controller, learning=chosen)))
    count = 32 * PERIOD
    skipped = np.zeros(count) if seed is None else np.random.default_rng(seed).random(count) < 0.005
    run = made.run(made.default_setpoints(count), skipped=skipped.astype(float))
    made.controller.learning.set_mode(at.FROZEN)
    after = made.run(made.default_setpoints(2 * PERIOD))
    error = (after["reference"] - after["measured"])[-PERIOD:]
    return np.sqrt(np.mean(error**2)), learned_line(chosen, 3000.0, run, 0, 32)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_where_a_sample_in_200_is_missed_it_learns_from_the_others_however_long_limits_are_remembered(seed):
    whole, every = learned_with_missed_samples(None, None)
    missed, line = learned_with_missed_samples(seed, None)
    assert every == "of 32 periods, 32 were learned completely"
    assert missed < 1.5 * whole < 4e-9
    # if a late sample blocks learning as long as saturation does, nothing is learned in most periods
    blocked, why = learned_with_missed_samples(seed, 2.0)
    assert blocked > 1.5 * whole
    used, unused = (int(re.search(r", (\d+) not at all", text)[1]) for text in (line, why))
    assert used == 0 and unused > 15
    assert "because of late samples" in line and "the response of the axis to late samples" in line


def test_learning_frozen_forgotten_and_retuned_in_a_fused_loop_are_those_of_its_twin():
    loop, given = made_loop(samples=3000, factor=10.0, reference_generator=TRIANGLE, motion_controller=LEARNS)
    loop.start()
    asked = [("freeze", {}), ("learn", {}), ("retune", {"learning__gain": 0.5}), ("forget", {}), ("learn", {})]
    for number, (action, values) in enumerate(asked, 1):
        until(lambda number=number: loop.sample > 400 * number)
        loop.apply(change("motion_controller", action, **values))
    assert loop.join()
    made = whole(loop)
    assert [one.action for one in loop.changes] == [action for action, _ in asked]
    assert_twin(loop, made, given)


@pytest.mark.parametrize("name, value", [("error_filter", (1.0,)), ("lead", 2), ("period", 0.02), ("type", "none")])
def test_its_structure_is_fixed_while_it_runs(name, value):
    made = learning_axis()
    before = made.controller.parameters
    with pytest.raises(ParameterError, match=f"learning.{name}"):
        made.apply(Change(0, "motion_controller", "retune", {f"learning.{name}": value, "type": "open_loop"}))
    assert made.controller.parameters is before


def test_an_axis_that_does_not_learn_says_so():
    with pytest.raises(ParameterError, match="learning.type = 'none': learning is off"):
        axis(**HOLD).controller.learn()
