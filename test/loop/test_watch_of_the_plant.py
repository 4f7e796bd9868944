# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Counters and states of a plant: late voltages, the reason for a trip, and the voltage before the first one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from loop_support import HOLD, axis
from watch_support import guard, run_guard

from hysteresis_ros import signals
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.plant import actuate, sense
from hysteresis_ros.loop.tick import Laws
from hysteresis_ros.loop.watch import HOLDING, RUNNING, STOPPED
from hysteresis_ros.models.block import interpreted

NAN = math.nan


def test_a_jump_is_measured_from_the_last_good_value_downwards_as_upwards():
    got, *_ = run_guard(guard(spike=1.0, confirm=3), np.array([0.0, 0.9, 0.2, -0.6, -1.5, -2.6, -1.9]))
    np.testing.assert_array_equal(got, [0.0, 0.9, 0.2, -0.6, -1.5, NAN, -1.9])


def test_every_skipped_sample_is_a_late_voltage_that_the_plant_holds():
    """The voltage of that sample was never sent, whatever the row contains."""
    sine = {
        "waveform__type": "sine",
        "waveform__frequency": 50.0,
        "waveform__amplitude": 3e-6,
        "waveform__offset": 4e-6,
    }
    made = axis(reference_generator=sine, motion_controller={"type": "open_loop"}, plant_simulator={"late_limit": -1})
    skipped = np.zeros(300)
    skipped[100:200:7] = 1.0
    table = made.run(np.zeros(300), skipped=skipped)
    np.testing.assert_array_equal(table["late"], np.cumsum(skipped))
    np.testing.assert_array_equal(table["plant_mode"], np.where(skipped == 1.0, HOLDING, RUNNING))
    held = np.flatnonzero(skipped)
    np.testing.assert_array_equal(table["plant_voltage"][held], table["plant_voltage"][held - 1])


@pytest.mark.parametrize(("kind", "preview"), [("inverse_dynamics", 6), ("velocity", 0)])
def test_a_feedforward_follows_the_reference_while_samples_are_skipped(kind, preview):
    """Otherwise the path would be late by these samples until the whole preview has passed."""
    sine = {"waveform__type": "sine", "waveform__frequency": 20.0, "waveform__amplitude": 3e-6}
    feedforward = {"feedforward__type": kind, "feedforward__preview": preview}
    skipped, commands = np.zeros(400), []
    skipped[[200, 300, 301, 302]] = 1.0
    for missing in (np.zeros(400), skipped):
        made = axis(
            reference_generator={**sine, "waveform__offset": 4e-6},
            motion_controller={"type": "open_loop", **feedforward},
            plant_simulator={"late_limit": -1},
        )
        table = made.run(np.zeros(400), skipped=missing)
        commands.append(np.where(skipped == 1.0, 0.0, table["command"]))
    np.testing.assert_array_equal(*commands)


def test_before_the_first_voltage_nothing_is_late_and_afterwards_every_one_that_is_missing():
    made = axis(**HOLD, plant_simulator={"late_limit": -1})
    table = made.run(np.zeros(20), skipped=np.concatenate([np.ones(10), np.zeros(5), np.ones(5)]))
    np.testing.assert_array_equal(table["late"], [0] * 15 + [1, 2, 3, 4, 5])
    assert made.plant.late == 5
    # if a partner waits, or a voltage came too late but was put out, it counts, too
    made.plant.count_late()
    assert made.plant.late == 6
    other = axis(**HOLD, plant_simulator={"late_limit": -1})
    other.plant.await_voltages()
    assert other.run(np.zeros(4), skipped=np.ones(4))["late"].tolist() == [1, 2, 3, 4]


def test_a_plant_is_silent_when_any_of_its_voltages_has_not_come_for_its_time_out():
    made = axis("inchworm_travel", plant_simulator={"late_limit": -1, "voltage_timeout": 0.001})
    made.run(made.default_setpoints(30))
    assert not made.plant.silent
    timeout = round(0.001 * made.sample_rate)
    made.run(np.zeros(timeout - 1), skipped=np.ones(timeout - 1))
    assert not made.plant.silent
    made.run(np.zeros(1), skipped=np.ones(1))
    assert made.plant.silent
    one = axis(**HOLD, plant_simulator={"late_limit": -1, "voltage_timeout": 0.01})
    one.run(np.zeros(30))
    one.run(np.zeros(30), skipped=np.ones(30))
    assert one.plant.silent


def test_an_emergency_stop_is_the_reason_until_a_start_and_a_start_forgets_what_was_late():
    made = axis(**HOLD, plant_simulator={"late_limit": 8})
    made.run(np.zeros(50))
    made.run(np.zeros(6), skipped=np.ones(6))
    made.apply(Change(made.sample, "plant_simulator", "halt"))
    assert made.plant.halted and made.plant.tripped and not made.plant.overtravelled
    made.run(np.zeros(1))
    made.apply(Change(made.sample, "plant_simulator", "start"))
    table = made.run(np.zeros(8), skipped=np.array([0.0] + [1.0] * 7))
    # 6 before the start and 7 after it: each fewer than 8
    assert not table["tripped"].any() and not made.plant.tripped


def motor_rows(plant, given) -> np.ndarray:
    """Return rows of a motor's plant under voltages of extender, front and rear clamp; NaN: no voltage arrives."""
    laws = Laws(*plant.kernels, *(plant.kernels[0],) * (len(Laws._fields) - len(plant.kernels)))
    rows, row = [], np.zeros(signals.MOTOR_ROW)
    for extender, front, rear in given:
        interpreted(sense)(laws, plant.arrays, row)
        row[signals.VOLTAGE], row[signals.FRONT_VOLTAGE], row[signals.REAR_VOLTAGE] = extender, front, rear
        interpreted(actuate)(laws, plant.arrays, row)
        rows.append(row.copy())
    return np.array(rows)


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_each_of_the_three_voltages_of_a_motor_is_late_when_it_does_not_come(missing):
    plant = axis("inchworm_travel", plant_simulator={"late_limit": -1}).plant
    resting = plant.resting_voltages
    gap = [NAN if place == missing else value for place, value in enumerate(resting)]
    rows = motor_rows(plant, [resting] * 5 + [gap] * 4 + [resting] * 3)
    np.testing.assert_array_equal(rows[:, signals.LATE], [0] * 5 + [1, 2, 3, 4] + [4] * 3)


def test_clamps_that_hold_a_slider_keep_their_voltage_where_it_is_higher_than_safe():
    """The extender goes to safe; a clamp is never opened for safety."""
    motor = axis("inchworm_travel", plant_simulator={"late_limit": -1, "voltage_timeout": 0.001})
    plant = motor.plant
    safe, front_safe, rear_safe = plant.safe_voltages
    front, rear = front_safe + 8.0, rear_safe + 5.0
    # long enough for each to reach its commanded voltage
    rows = motor_rows(plant, [(safe + 20.0, front, rear)] * 3000 + [(NAN,) * 3] * 3000)
    before, after = rows[2999], rows[-1]
    assert before[signals.FRONT_PLANT_VOLTAGE] == pytest.approx(front, abs=0.01)
    assert after[signals.PLANT_VOLTAGE] == pytest.approx(safe, abs=0.01)
    assert after[signals.FRONT_PLANT_VOLTAGE] == before[signals.FRONT_PLANT_VOLTAGE]
    assert after[signals.REAR_PLANT_VOLTAGE] == before[signals.REAR_PLANT_VOLTAGE]


def test_after_a_stop_the_feedforward_begins_at_rest_where_the_axis_stands():
    """Its memory of the path before the stop has no effect on the return."""
    made = axis(motion_controller={"feedforward__type": "inverse_dynamics", "feedforward__preview": 6}, **HOLD)
    made.run(np.full(1500, 8e-6))
    made.apply(Change(made.sample, "motion_controller", "stop"))
    made.run(np.full(3000, 8e-6))
    made.apply(Change(made.sample, "motion_controller", "start"))
    made.run(np.full(6, 8e-6))
    _, delayed, fed, measured = made.controller.history.samples.T
    assert len(delayed) == 6 and abs(measured[0]) < 1e-6
    np.testing.assert_allclose(delayed, measured[0], atol=1e-9)
    assert np.max(np.abs(fed - fed[0])) < 1e-6


def test_the_last_voltage_of_a_compensator_that_leaves_is_the_safe_one_and_the_next_keeps_the_slew_rate():
    made = axis(**HOLD, hysteresis_compensator={"limits__slew_rate": 3000.0})
    made.run(np.full(600, 8e-6))
    before = made.compensator.voltage
    assert before > 30.0
    assert made.compensator.make_safe() == 0.0
    # one volt a sample
    voltages = made.run(np.full(20, 8e-6))["voltage"]
    assert np.max(np.diff(voltages, prepend=0.0)) <= 1.0 + 1e-2


def test_a_compensator_that_is_stopped_stays_so_when_the_axis_begins_again():
    made = axis(**HOLD)
    made.run(np.full(300, 8e-6))
    made.apply(Change(made.sample, "hysteresis_compensator", "stop"))
    made.reset()
    table = made.run(np.full(100, 8e-6))
    assert set(table["compensator_mode"]) == {STOPPED} and not table["voltage"].any()
    made.apply(Change(made.sample, "hysteresis_compensator", "start"))
    assert set(made.run(np.full(100, 8e-6))["compensator_mode"]) == {RUNNING}


def test_faults_that_are_injected_later_leave_commands_alone_until_they_begin():
    """Their samples count from now; the age of the last command does not change."""
    made = axis(**HOLD)
    made.run(np.full(500, 8e-6))
    made.inject(("lost_command:0.01:0.002",))
    modes = made.run(np.full(90, 8e-6))["compensator_mode"]
    np.testing.assert_array_equal(np.flatnonzero(modes != RUNNING), np.arange(30, 36))
