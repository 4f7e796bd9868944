# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Changes of a running axis: in one run they have the same effect as between its pieces, and as in a node."""

from __future__ import annotations

import numpy as np
import pytest
from loop_support import HOLD, assert_same_bits, axis, parameters

from hysteresis_ros import signals
from hysteresis_ros.errors import ParameterError, RecordingError
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.controller import OFFSET_LEFT, PRELOAD
from hysteresis_ros.loop.simulation import changes_of, differences, simulate
from hysteresis_ros.loop.tick import ANSWER, ANSWERED, CONFIRM, MEASURE, MEASURED
from hysteresis_ros.recordings.dataset import Recording

CHANGES = (
    Change(100, "motion_controller", "retune", {"sliding_mode.phi": 0.9, "handover_time": 0.02}),
    Change(100, "hysteresis_compensator", "retune", {"hysteresis.polynomial.scale": 1.03}),
    Change(250, "motion_controller", "stop"),
    Change(300, "reference_generator", "stop"),
    Change(350, "motion_controller", "start"),
    Change(360, "reference_generator", "start"),
    Change(420, "motion_controller", "retune", {"type": "open_loop"}),
    Change(500, "hysteresis_compensator", "stop"),
    Change(590, "hysteresis_compensator", "start"),
    Change(600, "plant_simulator", "retune", {"hysteresis.polynomial.scale": 0.98}),
    Change(640, "plant_simulator", "start"),
    Change(799, "motion_controller", "retune", {"type": "sliding_mode"}),
)
SETPOINTS = 4e-6 * (np.arange(800) > 30) + 2e-6 * (np.arange(800) > 500)


def piece_by_piece(made, setpoints, changes):
    """Run to each change, apply it, and continue."""
    tables, first = [], 0
    for change in changes:
        tables.append(made.run(setpoints[first : change.sample]))
        made.apply(change)
        first = change.sample
    tables.append(made.run(setpoints[first:]))
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def test_a_run_with_changes_is_one_made_piece_by_piece_with_them_in_between():
    whole = axis(**HOLD).run(SETPOINTS, changes=CHANGES)
    assert_same_bits(piece_by_piece(axis(**HOLD), SETPOINTS, CHANGES), whole)
    plain = axis(**HOLD).run(SETPOINTS)
    assert_same_bits({name: values[:100] for name, values in whole.items()}, plain)
    assert np.any(whole["command"][101:200] != plain["command"][101:200])


def test_changes_come_in_the_order_of_their_samples_and_samples_count_from_the_beginning_of_the_axis():
    made, other = axis(**HOLD), axis(**HOLD)
    whole = made.run(SETPOINTS, changes=CHANGES)
    early = [change for change in CHANGES if change.sample < 400]
    late = [change for change in CHANGES if change.sample >= 400]
    first = other.run(SETPOINTS[:400], changes=early[::-1][::-1])
    second = other.run(SETPOINTS[400:], changes=late)
    assert_same_bits(first, whole)
    assert_same_bits(second, whole, 400)
    np.testing.assert_array_equal(second["time"], whole["time"][400:])


def test_a_change_after_the_end_of_a_run_holds_from_there_on():
    made, other = axis(**HOLD), axis(**HOLD)
    made.run(SETPOINTS[:200], changes=[Change(500, "motion_controller", "retune", {"type": "open_loop"})])
    other.run(SETPOINTS[:200])
    other.apply(Change(200, "motion_controller", "retune", {"type": "open_loop"}))
    assert_same_bits(made.run(SETPOINTS[200:400]), other.run(SETPOINTS[200:400]))


@pytest.mark.parametrize("gains", [{}, {"type": "pid", "pid__Ki": 20.0}], ids=str)
def test_a_change_of_the_preload_in_the_model_fades_and_jumps_nowhere(gains):
    """1 N is an offset of -2.44 µm; 635 Hz with damping 0.0018 would ring for long after any fast change."""
    given = {**HOLD, "motion_controller": {"handover_time": 0.05, **gains}}
    made = axis(**given)
    change = Change(1500, "motion_controller", "retune", {"model.preload.force": 1.0})
    table = made.run(np.full(4500, 5e-6), changes=[change])
    offset = made.controller.parameters.model.preload.offset
    assert offset == pytest.approx(-1.0e-6 / 0.41, rel=1e-3)
    start, end = table["displacement"][1499], table["displacement"][-1]
    assert start + offset - 2e-8 < np.min(table["displacement"][1500:]) and end < start - 0.1e-6
    assert np.max(table["displacement"][1500:]) < start + 0.1e-6
    assert np.ptp(table["displacement"][-300:]) < 5e-9
    assert np.max(np.abs(np.diff(table["command"][1498:]))) < 0.02 * abs(offset)
    assert abs(table["command"][1500] - table["command"][1499]) < 1e-9
    # the observer's estimate does not change when the model subtracts the preload
    assert abs(table["estimated"][1500] - table["measured"][1500]) < 2e-8
    plain = axis(**given).run(np.full(1500, 5e-6))
    assert_same_bits({name: values[:1500] for name, values in table.items()}, plain)


def test_a_second_change_of_the_preload_amid_the_first_one_jumps_neither():
    made = axis(**HOLD, motion_controller={"type": "pid", "pid__Ki": 20.0})
    forces = ((1500, 1.0), (1530, 0.0), (1560, 2.0), (1561, 0.0))
    changes = [Change(at, "motion_controller", "retune", {"model.preload.force": force}) for at, force in forces]
    table = made.run(np.full(4500, 5e-6), changes=changes)
    assert np.max(np.abs(np.diff(table["command"][1498:]))) < 0.1e-6
    assert table["displacement"][-1] == pytest.approx(table["displacement"][1499], abs=1e-8)
    # what is subtracted from the measurement stays the same at the moment of each change, and then fades up or down
    made.reset()
    for samples, force in ((5, 1.0), (7, 0.0), (3, 2.0)):
        made.run(np.full(samples, 5e-6))
        arrays = made.controller.arrays
        before = arrays.watch_p.own[PRELOAD] + arrays.watch_x.own[OFFSET_LEFT]
        made.apply(Change(made.sample, "motion_controller", "retune", {"model.preload.force": force}))
        arrays = made.controller.arrays
        left = arrays.watch_x.own[OFFSET_LEFT]
        assert arrays.watch_p.own[PRELOAD] + left == pytest.approx(before, abs=1e-18)
        made.run(np.full(1, 5e-6))
        assert 0.9 < arrays.watch_x.own[OFFSET_LEFT] / left < 1.0


def test_a_plant_that_was_measured_takes_new_parameters_only_for_what_follows():
    values = {"hysteresis.polynomial.scale": 1.1, "preload.force": 5.0, "sensor.offset": 1e-7}
    before = axis(**HOLD).run(SETPOINTS, changes=[Change(300, "plant_simulator", "retune", values)])
    after = axis(**HOLD).run(SETPOINTS, changes=[Change(300, "plant_simulator", "retune", values, after=MEASURED)])
    plain = axis(**HOLD).run(SETPOINTS)
    assert before["measured"][300] != plain["measured"][300] == after["measured"][300]
    assert after["voltage"][300] == plain["voltage"][300] and after["measured"][301] != plain["measured"][301]
    # the order of a node: measure, accept the parameters, answer
    made = axis(**HOLD)
    tables = [made.run(SETPOINTS[:300])]
    column, row = np.zeros((signals.ACTUATOR_ROW, 1)), np.zeros(signals.ACTUATOR_ROW)
    column[signals.SETPOINT] = SETPOINTS[300]
    made._run(column, MEASURE, row)
    made.apply(Change(300, "plant_simulator", "retune", values))
    made._run(column, ANSWER, row)
    made._run(column, CONFIRM, row)
    made.sample += 1
    tables.append({signal.name: column[k] for k, signal in enumerate(signals.ACTUATOR.row)})
    tables.append(made.run(SETPOINTS[301:]))
    whole = {name: np.concatenate([table[name] for table in tables]) for name in tables[1]}
    assert_same_bits(whole, after)


def test_measured_and_other_changes_of_one_sample_come_in_the_order_of_the_sample():
    changes = [
        Change(200, "plant_simulator", "retune", {"preload.force": 5.0}, after=MEASURED),
        Change(200, "motion_controller", "stop"),
    ]
    table = axis(**HOLD).run(SETPOINTS, changes=changes)
    assert table["controller_mode"][200] == 3.0
    plain = axis(**HOLD).run(SETPOINTS, changes=changes[1:])
    assert table["measured"][200] == plain["measured"][200] and table["measured"][201] != plain["measured"][201]


def test_a_controller_that_has_answered_takes_new_gains_before_it_hears_what_was_carried_out():
    change = Change(200, "motion_controller", "retune", {"type": "open_loop"}, after=ANSWERED)
    made = axis(**HOLD, plant_simulator={"limits__maximum": 60.0}, hysteresis_compensator={"limits__maximum": 60.0})
    other = axis(**HOLD, plant_simulator={"limits__maximum": 60.0}, hysteresis_compensator={"limits__maximum": 60.0})
    whole = made.run(SETPOINTS, changes=[change])
    tables = [other.run(SETPOINTS[:200])]
    column, row = np.zeros((signals.ACTUATOR_ROW, 1)), np.zeros(signals.ACTUATOR_ROW)
    column[signals.SETPOINT] = SETPOINTS[200]
    other._run(column, MEASURE, row)
    other._run(column, ANSWER, row)
    other.apply(change)
    other._run(column, CONFIRM, row)
    other.sample += 1
    tables.append({signal.name: column[k] for k, signal in enumerate(signals.ACTUATOR.row)})
    tables.append(other.run(SETPOINTS[201:]))
    assert_same_bits({name: np.concatenate([table[name] for table in tables]) for name in tables[1]}, whole)


def test_an_inverse_that_searches_searches_a_wider_range_once_the_limits_are_wider():
    narrow = {"inverse__type": "general", "limits__maximum": 40.0, "handover_time": 0.001}
    made = axis(**HOLD, hysteresis_compensator=narrow)
    wider = Change(300, "hysteresis_compensator", "retune", {"limits.maximum": 120.0})
    table = made.run(np.full(1200, 8e-6), changes=[wider])
    assert table["voltage"][299] == 40.0 and table["voltage"][-1] > 60.0
    assert table["displacement"][-1] == pytest.approx(8e-6, abs=2e-8)


def test_a_refused_change_ends_the_run_with_its_reason():
    wrong = Change(10, "motion_controller", "retune", {"sliding_mode.phi": 3.0})
    with pytest.raises(ParameterError, match="phi"):
        axis(**HOLD).run(SETPOINTS, changes=[wrong])


def test_changes_of_a_motor_are_repeated_too():
    changes = (
        Change(150, "inchworm_sequencer", "retune", {"measurement_timeout": 0.05}),
        Change(200, "motion_controller", "retune", {"pid.Ki": 80.0}),
        Change(300, "plant_simulator", "retune", {"inchworm.front_clamp.wear": 0.9}, after=MEASURED),
    )
    whole = axis("inchworm_travel").run(np.full(500, 3e-5), changes=changes)
    plain = axis("inchworm_travel").run(np.full(500, 3e-5))
    made = axis("inchworm_travel")
    first = made.run(np.full(250, 3e-5), changes=changes[:2])
    assert_same_bits(first, whole)
    assert_same_bits(made.run(np.full(250, 3e-5), changes=changes[2:]), whole, 250)
    assert np.any(whole["front_force"][301:] != plain["front_force"][301:])


# ------------------------------------------------------------------------------------------------------------- the log


def recorded(*entries):
    """Return a recording whose log has these entries."""
    return Recording(np.arange(3) / 3000.0, {"setpoint": np.zeros(3)}, metadata={"changes": list(entries)})


def entry(**more):
    """Return an entry of a log."""
    return {"sample": 7, "node": "motion_controller", "action": "retune", "parameters": {}, **more}


def test_the_log_of_a_recording_is_read_as_changes():
    given = recorded(
        entry(parameters={"kalman.L": [0.1, 0.2], "type": "pid"}),
        entry(sample=9, node="plant_simulator", action="start", after="measured"),
    )
    assert changes_of(given) == [
        Change(7, "motion_controller", "retune", {"kalman.L": (0.1, 0.2), "type": "pid"}),
        Change(9, "plant_simulator", "start", {}, MEASURED),
    ]
    assert changes_of(Recording(np.arange(3) / 3000.0, {"setpoint": np.zeros(3)})) == []


@pytest.mark.parametrize(
    "wrong",
    [
        "stop",
        None,
        {},
        entry(sample="soon"),
        entry(parameters=[1.0]),
        entry(action="explode"),
        entry(action="__init__"),
        entry(after="lunch"),
        entry(node="nobody"),
        entry(node="plant_simulator", action="stop"),
        {"sample": 1, "node": "motion_controller", "action": "stop"},
    ],
)
def test_an_entry_that_is_no_change_is_refused(wrong):
    with pytest.raises(RecordingError, match="not an entry of a change log"):
        changes_of(recorded(wrong))


def test_a_run_with_changes_is_compared_with_its_twin_through_its_log():
    given = parameters(**HOLD)
    run = simulate(given, setpoints=SETPOINTS, changes=CHANGES)
    log = [change._asdict() for change in CHANGES]
    with_log = Recording(run.time, run.signals, metadata={**run.metadata, "changes": log})
    assert differences(with_log, given) == {}
    assert "command" in differences(run, given)
