# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Safety: for any fault an axis moves to safe at the stated rate and time, and recovers without a jump."""

from __future__ import annotations

import math

import numpy as np
import pytest
from loop_support import HOLD, axis, steps

from hysteresis_ros.control.law import APPLIED
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop import watch
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.references import inchworm_layout as gait

RATE = 3000.0
SETPOINT = 8e-6
#: Twice the step of a 16-bit converter over 150 V, because both values of a difference are rounded.
GRID = 2 * 150.0 / (2**16 - 1)
TIMEOUT = 60  # samples
#: Displacement of 120 V [m]. If most samples of an inchworm's command are lost, it crosses the range in a few samples,
#: and its mode at 635 Hz, with damping 0.03, responds to a step with up to twice the height.
STROKE, OVERSHOOT = 12.3e-6, {"kim2009": 1.2, "inchworm_travel": 1.9}
QUICK = {
    "motion_controller": {"measurement_timeout": TIMEOUT / RATE, "safe_slew_rate": 1e-4},
    "hysteresis_compensator": {"command_timeout": TIMEOUT / RATE, "safe_slew_rate": 900.0},
    "plant_simulator": {"voltage_timeout": TIMEOUT / RATE, "safe_slew_rate": 600.0, "sensor__noise": 1e-9},
}
COMMAND_STEP, VOLTAGE_STEP, PLANT_STEP = 1e-4 / RATE, 900.0 / RATE, 600.0 / RATE


def settled(name="kim2009", samples=1500, **more):
    """Return an axis that has been at the setpoint for a while."""
    overrides = {**HOLD, **QUICK} if name == "kim2009" else {}
    for node, values in more.items():
        overrides[node] = {**overrides.get(node, {}), **values}
    made = axis(name, **overrides)
    made.run(np.full(samples, SETPOINT))
    return made


def after(made, *faults, samples=3000, **more):
    """Return the following run with these faults, whose times count from now."""
    made.inject(faults)
    return made.run(np.full(samples, SETPOINT), **more)


def lasting(samples: int) -> float:
    """Return a duration [s] of some samples."""
    return samples / RATE


def assert_towards(values, first, target, step, tolerance):
    """Refuse a signal that does not move to its target from sample ``first`` on by exactly one step per sample."""
    start = values[first - 1]
    count = math.ceil(abs(target - start) / step)
    away = np.maximum(abs(start - target) - step * np.arange(1, count + 1), 0.0)
    expected = target + math.copysign(1.0, start - target) * away
    np.testing.assert_allclose(values[first : first + count], expected, rtol=0, atol=tolerance)
    return first + count


PID = {"type": "pid", "pid__Kp": 0.0, "pid__Ki": 50.0}


@pytest.mark.parametrize("law", [{}, PID])
@pytest.mark.parametrize("fault", ["stale", "nan", "drop", "frozen"])
def test_without_measurements_the_command_goes_to_safe_after_exactly_its_timeout_and_comes_back(fault, law):
    frozen = 40 if fault == "frozen" else 0
    made = settled(motion_controller={"frozen_samples": frozen, **law})
    value = ":1" if fault == "drop" else ""
    table = after(made, f"{fault}:{lasting(100)}:{lasting(900)}{value}")
    quiet = 100 + frozen
    held = slice(quiet, quiet + TIMEOUT - 1)
    assert set(table["controller_mode"][held]) == {watch.HOLDING}
    # the observer's prediction for an axis at rest is that it stays at rest
    np.testing.assert_allclose(table["command"][held], table["command"][quiet - 1], rtol=0, atol=0 if law else 1e-8)
    assert set(table["controller_mode"][quiet + TIMEOUT - 1 : 1000]) == {watch.STALE}
    safe = assert_towards(table["command"], quiet + TIMEOUT - 1, 0.0, COMMAND_STEP, 1e-18)
    assert not table["command"][safe:1000].any()
    assert set(table["controller_mode"][1000:]) == {watch.RUNNING}
    comes_back_calmly(table, 1000)


@pytest.mark.parametrize("fault", ["drop:0.1:0.8:0.3", "drop:0.1:0.8:0.6", "stale:0.1:0.015", "nan:0.11:0.019"])
def test_an_observer_carries_the_axis_over_measurements_that_are_missing(fault):
    """With an exact model and without noise, missing measurements have no effect, even on a moving axis."""
    quiet = {**QUICK, "plant_simulator": {**QUICK["plant_simulator"], "sensor__noise": 0.0}}
    runs = [axis(**quiet) for _ in range(2)]
    runs[1].inject((fault,))
    with_all, with_few = (made.run(np.full(3000, SETPOINT)) for made in runs)
    assert np.count_nonzero(np.isnan(with_few["seen"])) > 40
    assert not np.isin(with_few["controller_mode"], (watch.STALE, watch.TRIPPED)).any()
    for name, allowed in (("command", 2e-9), ("displacement", 2e-9)):
        np.testing.assert_allclose(with_few[name], with_all[name], rtol=0, atol=allowed, err_msg=name)


def test_every_second_measurement_serves_a_filter_that_is_slow_enough_and_stops_the_axis_under_the_published_one():
    """With the published gain at every second sample, the error of the estimate grows by 7 % in two samples."""
    slow = {"kalman__gain": "riccati", "kalman__q": 0.1, "kalman__L": ()}
    for law, tripped in ((slow, False), ({}, True)):
        made = settled(motion_controller=law)
        table = after(made, "disorder:0.1:0.8")
        assert table["tripped"].any() == tripped
        if not tripped:
            np.testing.assert_allclose(table["displacement"], SETPOINT, rtol=0, atol=2e-8)
        else:
            assert np.max(np.abs(table["displacement"])) < 4.0 * STROKE
            assert np.max(np.abs(table["displacement"][-300:])) < 2e-6  # at 0 V, after large loops


@pytest.mark.parametrize(("overtravel", "why"), [(0.0, 2.0), (-1.0, 0.0), (1.0e-6, 2.0)])
def test_a_loop_that_has_become_unstable_is_stopped_when_it_overtravels(overtravel, why):
    made = settled(plant_simulator={"overtravel": overtravel})
    low, high = made.plant.travel
    if overtravel == 0.0:
        at_rest = axis(plant_simulator={"overtravel": 1e-9}).plant.travel
        stroke = at_rest[1] - at_rest[0]
        assert (low, high) == pytest.approx((at_rest[0] - stroke, at_rest[1] + stroke), abs=3e-9)
        assert 12e-6 < stroke < 16e-6
    table = after(made, "late:0.1:0.5:2")
    beyond = (table["measured"] < low) | (table["measured"] > high)
    assert table["tripped"][-1] == why
    if why:
        first = int(np.argmax(beyond))
        assert beyond.any() and made.plant.overtravelled
        np.testing.assert_array_equal(table["tripped"], np.where(np.arange(3000) > first, 2.0, 0.0))
        assert np.max(np.abs(table["displacement"][-300:])) < 2e-6  # at 0 V, after large loops
        made.apply(Change(made.sample, "plant_simulator", "start"))
        assert made.run(np.full(3000, SETPOINT))["displacement"][-1] == pytest.approx(SETPOINT, abs=2e-8)
    else:
        assert not beyond.any() and np.max(np.abs(table["displacement"])) > 1e-4


def comes_back_calmly(table, first):
    """Refuse a jump of the command at the end of a fault, or a setpoint that is not reached again."""
    # up: the hand-over's time constant of 0.05 s
    allowed = max(COMMAND_STEP, SETPOINT * (1 - math.exp(-1.0 / (0.05 * RATE)))) * 1.1
    assert np.max(steps(table["command"][first - 1 :])) <= allowed
    assert np.max(steps(table["command"][first - 1 : first + 1])) <= COMMAND_STEP
    assert table["displacement"][-1] == pytest.approx(SETPOINT, abs=2e-8)
    assert np.min(table["displacement"]) > -0.1e-6 and np.max(table["displacement"]) < 1.02 * SETPOINT


@pytest.mark.parametrize("force", [0.0, 2.0])
def test_on_the_way_back_the_reference_starts_where_the_axis_stands_and_fades_to_the_one_received(force):
    loaded = {"preload__force": force}
    made = settled(plant_simulator=loaded, motion_controller={f"model__{name}": f for name, f in loaded.items()})
    changes = (Change(1600, "motion_controller", "stop"), Change(2500, "motion_controller", "start"))
    table = after(made, samples=1300, changes=changes)
    given = made.controller.history.samples  # achieved command, reference, feedforward, measurement
    assert len(given) == 300
    np.testing.assert_array_equal(given[:, 3], table["seen"][1000:] - made.controller.parameters.model.preload.offset)
    standing = given[0, 3]
    assert abs(standing) < 0.1e-6 and (made.controller.parameters.model.preload.offset < -1e-6) == (force > 0.0)
    faded = SETPOINT + (standing - SETPOINT) * np.exp(-np.arange(300) / (0.05 * RATE))
    np.testing.assert_allclose(given[:, 1], faded, rtol=0, atol=1e-15)


def test_a_controller_that_is_stopped_and_started_goes_to_safe_and_comes_back():
    table = after(settled(), f"stop:{lasting(100)}:{lasting(900)}")
    safe = assert_towards(table["command"], 100, 0.0, COMMAND_STEP, 1e-18)
    assert not table["command"][safe:1000].any()
    comes_back_calmly(table, 1000)
    changes = (Change(1600, "motion_controller", "stop"), Change(2500, "motion_controller", "start"))
    by_hand = after(settled(), changes=changes)
    for name in ("command", "voltage", "displacement", "controller_mode"):
        np.testing.assert_array_equal(by_hand[name], table[name], err_msg=name)


def test_without_commands_the_voltage_goes_to_safe_after_exactly_its_timeout_and_comes_back():
    table = after(settled(), f"lost_command:{lasting(100)}:{lasting(900)}")
    modes = table["compensator_mode"]
    np.testing.assert_array_equal(np.flatnonzero(modes == watch.HOLDING), 100 + np.arange(TIMEOUT - 1))
    np.testing.assert_array_equal(np.flatnonzero(modes == watch.STALE), np.arange(100 + TIMEOUT - 1, 1000))
    safe = assert_towards(table["voltage"], 100 + TIMEOUT - 1, 0.0, VOLTAGE_STEP, GRID)
    assert np.max(np.abs(table["voltage"][safe:1000])) < GRID
    np.testing.assert_array_equal(table["plant_voltage"], table["voltage"])
    assert np.max(steps(table["voltage"][999:])) <= max(VOLTAGE_STEP, 90.0 * (1 - math.exp(-1 / (0.05 * RATE)))) * 1.1
    assert np.max(steps(table["voltage"][999:1001])) <= VOLTAGE_STEP + GRID
    assert np.max(table["displacement"]) < 1.1 * SETPOINT
    assert table["displacement"][-1] == pytest.approx(SETPOINT, abs=3e-8)


def test_a_compensator_that_is_stopped_and_started_goes_to_safe_and_comes_back():
    changes = (Change(1600, "hysteresis_compensator", "stop"), Change(2500, "hysteresis_compensator", "start"))
    table = after(settled(), changes=changes)
    safe = assert_towards(table["voltage"], 100, 0.0, VOLTAGE_STEP, GRID)
    assert np.max(np.abs(table["voltage"][safe:1000])) < GRID
    assert set(table["compensator_mode"][100:1000]) == {watch.STOPPED}
    assert np.max(steps(table["voltage"])) <= max(VOLTAGE_STEP, 90.0 * (1 - math.exp(-1 / (0.05 * RATE)))) * 1.1
    assert table["displacement"][-1] == pytest.approx(SETPOINT, abs=3e-8)


def test_without_voltages_a_plant_that_does_not_trip_goes_to_safe_and_follows_again():
    table = after(settled(plant_simulator={"late_limit": -1}), f"lost_voltage:{lasting(100)}:{lasting(900)}")
    voltage = table["plant_voltage"]
    np.testing.assert_array_equal(voltage[100 : 100 + TIMEOUT - 1], voltage[99])
    np.testing.assert_array_equal(np.flatnonzero(table["plant_mode"] == watch.STALE), 100 + np.arange(TIMEOUT - 1, 900))
    safe = assert_towards(voltage, 100 + TIMEOUT - 1, 0.0, PLANT_STEP, GRID)
    assert np.max(np.abs(voltage[safe:1000])) < GRID
    assert not table["tripped"].any() and table["late"][-1] == 900.0
    back = 1000 + int(np.argmax(voltage[1000:] == table["voltage"][1000:]))
    # in addition to its own step it moves no farther than its input has moved
    asked = np.concatenate([[0.0], steps(table["voltage"][1000 : back + 1])])
    assert np.all(steps(voltage[999 : back + 1]) <= PLANT_STEP + asked + GRID)
    np.testing.assert_array_equal(voltage[back:], table["voltage"][back:])


def test_a_tripped_plant_stops_the_whole_axis_in_one_sample_until_it_is_started():
    made = settled(plant_simulator={"late_limit": 50})
    started = Change(2700, "plant_simulator", "start")
    table = after(made, f"lost_voltage:{lasting(100)}:{lasting(200)}", changes=(started,))
    first = 100 + 50  # the 51st late voltage
    assert np.argmax(table["plant_mode"] == watch.TRIPPED) == first
    stopped = slice(first + 1, 1200)
    for name in ("source_mode", "controller_mode", "compensator_mode"):
        np.testing.assert_array_equal(np.flatnonzero(table[name] == watch.TRIPPED), np.arange(first + 1, 1200), name)
    assert table["tripped"][stopped].all() and not table["tripped"][1200:].any()
    np.testing.assert_array_equal(table["reference"][stopped], table["reference"][first])
    ends = [
        assert_towards(table["plant_voltage"], first, 0.0, PLANT_STEP, GRID),
        assert_towards(table["voltage"], first + 1, 0.0, VOLTAGE_STEP, GRID),
    ]
    # the controller follows the voltage, one sample later
    np.testing.assert_array_equal(table["command"][first + 2 : 1200], table["applied"][first + 1 : 1199])
    # all signals are safe after range over slew rate
    assert max(ends) <= first + 1 + max(150.0 / VOLTAGE_STEP, 150.0 / PLANT_STEP)
    for name in ("plant_voltage", "voltage"):
        assert np.max(np.abs(table[name][max(ends) : 1200])) < GRID, name
    # from the current value, and afterwards no more than the law itself requires against the ringing
    assert np.max(steps(table["plant_voltage"][1199:1202])) <= PLANT_STEP + GRID
    assert np.max(steps(table["plant_voltage"][1199:])) < 3.0
    assert np.max(steps(table["command"][1199:])) < 3e-7
    assert table["displacement"][-1] == pytest.approx(SETPOINT, abs=2e-8)
    assert np.max(table["displacement"]) < 1.1 * SETPOINT


def test_a_trip_is_not_undone_by_anything_but_a_start_of_the_plant():
    made = settled(plant_simulator={"late_limit": 20})
    others = [
        Change(1700, node, action)
        for node in ("motion_controller", "hysteresis_compensator", "reference_generator")
        for action in ("stop", "start")
    ]
    retuned = Change(1750, "plant_simulator", "retune", {"safe_slew_rate": 500.0})
    table = after(made, f"lost_voltage:0:{lasting(30)}", samples=1000, changes=(*others, retuned))
    assert table["tripped"][21:].all() and np.max(np.abs(table["plant_voltage"][700:])) < GRID


@pytest.mark.parametrize("name", ["kim2009", "inchworm_travel"])
@pytest.mark.parametrize("part", [0.02, 0.1, 0.3, 0.7, 0.95])
def test_late_voltages_of_any_part_never_lead_beyond_the_stroke(name, part):
    noise = {"plant_simulator": {"sensor__noise": 5e-9}} if name == "kim2009" else {}
    made = axis(name, **(HOLD if name == "kim2009" else {}), **noise)
    made.inject((f"late_voltage:0.1:9:{part}",))
    high = 9e-6 if name == "kim2009" else 1e-3
    table = made.run(np.where(np.arange(12000) // 1000 % 2 == 0, high, 0.0))
    moved = table["extender_displacement"] if made.kind.motor else table["displacement"]
    assert np.min(moved) > -0.5 * STROKE and np.max(moved) < OVERSHOOT[name] * STROKE
    if part >= 0.1:
        assert table["tripped"].any()
    else:
        assert not table["tripped"].any()


@pytest.mark.parametrize(("name", "setpoint"), [("kim2009", 6e-6), ("inchworm_travel", 6e-5)])
def test_commands_that_nobody_answers_follow_the_displacement_without_running_away(name, setpoint):
    more = {**HOLD, "plant_simulator": {"sensor__noise": 5e-9}} if name == "kim2009" else {}
    made = axis(name, **more)
    made.inject(("unanswered:0.1:0.4",))
    table = made.run(np.full(9000, setpoint))
    following = table["controller_mode"] == watch.FOLLOWING
    assert 0.9 < np.count_nonzero(following) / (0.4 * made.sample_rate) <= 1.0
    step = made.controller.parameters.safe_slew_rate / made.sample_rate
    assert np.max(steps(table["command"])[following[1:]]) <= step * (1 + 1e-9)
    moved = table["extender_displacement"] if made.kind.motor else table["displacement"]
    assert np.max(moved) < 1.2 * STROKE and np.min(moved) > -1e-6
    assert table["displacement"][-1] == pytest.approx(setpoint, abs=3e-8)
    assert not made.kind.motor or not table["error"].any()


def test_commands_that_are_not_carried_out_end_where_the_displacement_is():
    """An amplifier is off and its compensator silent: the command waits at the actual displacement."""
    made = settled(plant_simulator={"late_limit": -1})
    table = after(made, "unanswered:0:0.5", "lost_voltage:0:0.5", samples=1500)
    assert set(table["controller_mode"][30:]) == {watch.FOLLOWING}
    assert np.max(np.abs(table["plant_voltage"][800:])) < GRID
    resting = table["displacement"][-1]
    assert resting < 2e-6 and table["command"][-1] == pytest.approx(resting, abs=2e-8)


# ------------------------------------------------------------------------------------------------------------ inchworm


def test_a_tripped_inchworm_closes_both_clamps_and_walks_on_after_a_start():
    made = axis("inchworm_travel")
    made.inject(("lost_voltage:0.3:0.06",))  # 600 late voltages, 500 are allowed
    table = made.run(np.full(12000, 2e-4), changes=(Change(7000, "plant_simulator", "start"),))
    assert np.argmax(table["plant_mode"] == watch.TRIPPED) == 3500
    stopped = slice(3501, 7000)
    for name in ("source_mode", "controller_mode", "compensator_mode"):
        assert set(table[name][stopped]) == {watch.TRIPPED}, name
    step = 1000.0 / made.sample_rate
    grid = 2 * 120.0 / (2**16 - 1)
    for name in ("plant_voltage", "front_plant_voltage", "rear_plant_voltage"):
        assert np.max(steps(table[name][3499:7000])) <= step + grid, name
    safe = 3500 + math.ceil(120.0 / step)
    assert np.min(table["front_plant_voltage"][safe:7000]) > 99.9 < np.min(table["rear_plant_voltage"][safe:7000])
    assert not table["plant_voltage"][safe:7000].any()
    np.testing.assert_array_equal(table["command"][safe:7000], table["applied"][safe - 1 : 6999])
    assert np.min(np.maximum(table["front_plant_voltage"], table["rear_plant_voltage"])) > 60.0
    assert table["displacement"][-1] == pytest.approx(2e-4, abs=1e-8) and table["error"][-1] == gait.NO_ERROR


@pytest.mark.parametrize(
    "fault", ["stale", "frozen", "late:30", "disorder", "drop:0.5", "lost_command", "stop", "offset"]
)
def test_faults_of_a_walking_inchworm_never_open_both_clamps_nor_lead_far(fault):
    made = axis("inchworm_travel")
    name, _, value = fault.partition(":")
    made.inject((":".join([name, "0.1", "0.4", *([value] if value else [])]),))
    table = made.run(np.full(8000, 1e-4))
    assert np.min(np.maximum(table["front_plant_voltage"], table["rear_plant_voltage"])) > 60.0
    assert np.min(np.maximum(table["front_force"], table["rear_force"])) > 15.0
    assert np.max(table["extender_displacement"]) < OVERSHOOT["inchworm_travel"] * STROKE
    assert np.min(table["displacement"]) > -1e-6 and np.max(table["displacement"]) < 1e-4 + 12.3e-6
    assert np.isfinite(table["command"]).all() and np.isfinite(table["voltage"]).all()


def test_without_measurements_a_walking_inchworm_closes_both_clamps_after_its_timeout():
    made = axis("inchworm_travel")
    made.inject(("stale:0.1:0.6",))
    table = made.run(np.full(7000, 1e-3))
    assert np.ptp(table["front_plant_voltage"][:1000]) > 90.0
    quiet = slice(1000 + 2000 + 1300, 7000)
    assert np.min(table["front_plant_voltage"][quiet]) > 99.9 < np.min(table["rear_plant_voltage"][quiet])
    assert np.ptp(table["displacement"][quiet]) < 1e-7


def test_a_plant_started_too_early_opens_no_clamp_before_the_other_one_has_closed():
    """The sequencer assumes that a clamp is closed once it has commanded it; in the plant it is still moving."""
    made = axis("inchworm_travel")
    made.inject(("lost_voltage:0.105:0.06",))  # trips while the front clamp is open
    started = Change(1800, "plant_simulator", "start")
    table = made.run(np.full(8000, 2e-4), changes=(started,))
    assert table["tripped"][1799] and not table["tripped"][1800:].any()
    asked = np.minimum(table["front_voltage"], table["rear_voltage"])[1800:2700]
    front, rear = table["front_plant_voltage"], table["rear_plant_voltage"]
    assert np.min(np.minimum(front, rear)[1800:2700]) < 60.0 and np.min(asked) == 0.0
    assert np.min(np.maximum(front, rear)) > 60.0
    assert np.min(np.maximum(table["front_force"], table["rear_force"])) > 15.0
    assert np.max(steps(front[1650:2700])) < 15.0 and np.max(steps(rear[1650:2700])) < 15.0


def test_a_voltage_that_is_only_rounded_to_the_grid_does_not_count_as_limited_and_one_at_an_end_does():
    table = axis(**HOLD).run(np.where(np.arange(900) < 600, 5e-6, 12e-6))
    # a voltage rarely lies on the grid by chance, so rounding changes nearly every one
    assert not table["saturated"][:600].any()
    narrow = axis(**HOLD, hysteresis_compensator={"limits__maximum": 40.0})
    table = narrow.run(np.full(600, 5e-6))
    np.testing.assert_array_equal(table["saturated"] == 1.0, table["voltage"] == 40.0)
    assert table["saturated"][-1] == 1.0


@pytest.mark.parametrize(("gains", "lie"), [({}, 6e-5), ({"type": "pid", "pid__Ki": 20.0}, 1e-2)], ids=str)
def test_no_command_leaves_its_range_and_nothing_else_changes_by_that(gains, lie):
    """A wrong sensor causes commands far beyond the stroke; anti-windup returns from there in the same way."""
    wide = {"command_minimum": -1.0, "command_maximum": 1.0}
    fault = f"offset:{lasting(100)}:{lasting(300)}:{lie}"
    bounded, free = (settled(motion_controller=gains | more) for more in ({}, wide))
    low, high = bounded.controller.parameters.command_range
    table, other = after(bounded, fault), after(free, fault)
    assert np.min(table["command"]) == low and low < np.min(table["applied"]) - 0.5 * STROKE
    assert np.min(other["command"]) < 1.5 * low
    assert np.max(table["command"]) <= high
    np.testing.assert_array_equal(table["command"], np.clip(other["command"], low, high))
    for name in ("voltage", "applied", "displacement", "estimated", "switching", "disturbance"):
        np.testing.assert_array_equal(table[name], other[name])


def test_where_nobody_says_what_was_carried_out_the_law_takes_it_for_what_was_sent():
    made = settled(motion_controller={"type": "pid", "pid__Ki": 20.0})
    table = after(made, f"offset:0:{lasting(10)}:1e-2", f"unanswered:0:{lasting(10)}", samples=5)
    assert made.controller.controller.x[APPLIED] == table["command"][-1] == made.controller.parameters.command_range[0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"command_minimum": 1e-6},
        {"command_minimum": 2e-6, "command_maximum": 1e-6},
        {"command_minimum": 1e-6, "command_maximum": 2e-6},
        {"command_maximum": 2e-6, "safe_command": 3e-6},
    ],
    ids=str,
)
def test_a_range_of_commands_that_is_none_or_leaves_safe_out_is_refused(wrong):
    with pytest.raises(ParameterError, match=r"command_m.*imum"):
        axis(**HOLD, motion_controller=wrong)
