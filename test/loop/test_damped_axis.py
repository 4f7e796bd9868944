# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis with damping after its law: the same offline, fused and with changes; effect of limits; no jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fused_support import ANY_LATE, STAGE_SLOWLY, assert_twin, change, made_loop, whole
from loop_support import assert_same_bits, axis, steps
from waiting import until

from hysteresis_ros.control import law as header
from hysteresis_ros.control.controller import BIAS, ControllerParameters, successor
from hysteresis_ros.control.damping import inner_loop
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.parameters import part as part_of

NOTCH = {"damping.notch.frequencies": (700.0,), "damping.notch.damping": (0.05,), "damping.notch.width": (0.5,)}
SETPOINTS = np.repeat([2e-6, 6e-6, 3e-6, 3e-6], 300)
CHANGES = (
    Change(200, "motion_controller", "retune", {"damping.irc.k": 900.0, "handover_time": 0.002}),
    Change(420, "motion_controller", "stop"),
    Change(450, "motion_controller", "start"),
    Change(700, "motion_controller", "retune", {"damping.type": "notch", **NOTCH}),
    Change(900, "motion_controller", "retune", {"damping.type": "irc", "type": "open_loop"}),
)


@pytest.mark.slow
def test_a_fused_axis_makes_the_samples_of_its_twin_with_damping_that_changes():
    loop, given = made_loop("stage700", factor=STAGE_SLOWLY, **ANY_LATE)
    loop.set(setpoint=5e-6)
    loop.start()
    until(lambda: loop.sample > 30)
    loop.apply(change("motion_controller", "retune", damping__irc__k=900.0))
    loop.set(setpoint=8e-6)
    until(lambda: loop.sample > 90)
    with pytest.raises(ParameterError, match=r"damping\.irc = .*inner loop is unstable"):
        loop.apply(change("motion_controller", "retune", damping__irc__feedthrough=-0.5))
    loop.apply(change("motion_controller", "retune", **NOTCH, **{"damping.type": "notch"}))
    until(lambda: loop.sample > 150)
    loop.leave()
    twin = assert_twin(loop, whole(loop), given)
    assert np.ptp(twin["command"]) > 1e-6 and len(loop.changes) == 2


def test_changes_of_damping_neither_jump_nor_leave_anything_behind():
    made, quiet = axis("stage700"), axis("stage700")
    whole_run = made.run(SETPOINTS, changes=CHANGES)
    plain = quiet.run(SETPOINTS)
    assert_same_bits({name: values[:200] for name, values in whole_run.items()}, plain)
    assert np.any(whole_run["command"][201:300] != plain["command"][201:300])
    for sample in (200, 700):
        # the first command after a change equals the last one before it, bit for bit
        assert whole_run["command"][sample] == whole_run["command"][sample - 1]
    made.reset()
    assert not np.any(made.controller.damping.x)
    made.apply(Change(0, "motion_controller", "retune", axis("stage700").controller.parameters.to_mapping()))
    made.reset()
    assert_same_bits(made.run(SETPOINTS[:400]), {name: values[:400] for name, values in plain.items()})


def test_a_law_that_takes_over_behind_a_damping_is_handed_over_in_units_of_the_command():
    """The laws differ by their outputs; behind the damping this is γ times as much."""
    made = axis("stage700")
    made.run(SETPOINTS[200:400])
    part, given = made.controller, part_of(made.controller.parameters, ControllerParameters)
    own = replace(given, type="open_loop").without_preload.before_damping(part.controller.sample_time)
    _, lasting = successor(own, part.controller.sample_time, part.controller, part.history)
    made.apply(Change(made.sample, "motion_controller", "retune", {"type": "open_loop"}))
    assert part.damping.direct == pytest.approx(0.6) and lasting != 0.0
    assert part.handover.x[BIAS] == lasting * part.damping.direct


def test_a_damping_that_would_be_unstable_is_refused_and_the_axis_does_not_notice():
    made, other = axis("stage700"), axis("stage700")
    for refused, named in (
        ({"damping.irc.feedthrough": -0.5}, r"damping\.irc = .*largest pole 1\."),
        ({"damping.irc.k": -5.0}, r"damping\.irc\.k"),
        ({"damping.type": "notch", **NOTCH, "damping.notch.frequencies": (1e4,)}, r"damping\.notch\.frequencies"),
    ):
        made.run(SETPOINTS[:50])
        with pytest.raises(ParameterError, match=named):
            made.apply(Change(0, "motion_controller", "retune", refused))
    other.run(SETPOINTS[:150])
    assert_same_bits(made.run(SETPOINTS[150:400]), other.run(SETPOINTS[150:400]))


def test_a_law_behind_limits_hears_what_was_carried_out_of_its_own_output_and_does_not_wind_up():
    out_of_reach = {"hysteresis_compensator": {"limits__maximum": 25.0}}
    made = axis("stage700", **out_of_reach)
    held = made.run(np.full(4000, 8e-6))
    x, between = made.controller.controller.x, made.controller.damping
    assert held["saturated"][-1] == 1.0 and held["applied"][-1] < held["command"][-1]
    carried = inner_loop.as_output(between.p, between.x, held["applied"][-1])
    assert x[header.APPLIED] == carried < between.x[inner_loop.OUTPUT]
    # the law's output stays at the limit, within its change in one sample
    assert between.x[inner_loop.OUTPUT] - carried < 2e-6
    free = made.run(np.full(1200, 2e-6))
    assert abs(np.mean(free["displacement"][60:120]) - 2e-6) < 1e-6
    assert np.all(np.abs(free["displacement"][600:] - 2e-6) < 2e-8)


def test_it_starts_at_rest_wherever_the_axis_is_when_it_is_started():
    made = axis("stage700")
    made.run(np.full(600, 6e-6))
    made.apply(Change(0, "motion_controller", "stop"))
    made.run(np.full(1000, 6e-6))
    made.apply(Change(0, "motion_controller", "start"))
    made.run(np.full(1, 6e-6))
    p, x = made.controller.damping.p, made.controller.damping.x
    rest = p[inner_loop.MATRICES + 3]  # of its single state, after A, B and C
    assert (
        x[inner_loop.STATE] == pytest.approx(rest * x[inner_loop.FILTERED], rel=1e-9)
        and 1e-6 < x[inner_loop.FILTERED] < 5e-6
    )
    made.run(np.full(6000, 6e-6))
    made.apply(Change(0, "motion_controller", "stop"))
    made.run(np.full(30, 6e-6))
    made.apply(Change(0, "motion_controller", "start"))
    before = made.controller.command
    again = made.run(np.full(6000, 6e-6))
    assert again["command"][0] == before
    assert steps(again["command"][:50]).max() < 1e-6
    assert np.abs(again["displacement"][-200:] - 6e-6).max() < 2e-8


def test_under_an_observer_another_damping_of_the_same_order_is_taken_and_one_of_another_is_refused_by_name():
    observer = {"type": "sliding_mode", "sliding_mode__hyperplane": "lq", "kalman__gain": "riccati"}
    made = axis("stage700", motion_controller=observer)
    made.run(np.full(100, 4e-6))
    made.apply(Change(0, "motion_controller", "retune", {"damping.irc.k": 900.0}))
    with pytest.raises(
        ParameterError, match=r"damping\.type = 'none': the damped plant would have 3 states.* for 4: keep irc"
    ):
        made.apply(Change(0, "motion_controller", "retune", {"damping.type": "none"}))
    assert np.abs(made.run(np.full(2000, 4e-6))["displacement"][-50:] - 4e-6).max() < 2e-7
