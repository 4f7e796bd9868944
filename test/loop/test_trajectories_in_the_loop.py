# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Trajectories on a running axis: accepted completely at one sample, logged, and repeated bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from fused_support import ANY_LATE, SLOWLY, assert_twin, change, made_loop, named
from loop_support import HOLD, assert_same_bits, axis
from waiting import until

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.simulation import changes_of
from hysteresis_ros.recordings.dataset import Recording

SOURCE = "reference_generator"
POINTS = {"times": (0.04, 0.08), "positions": (3e-6, 5e-6), "velocities": (6e-5, 0.0)}
FOLLOW = Change(50, SOURCE, "follow", POINTS)


def test_a_trajectory_begins_at_its_sample_and_its_end_is_the_setpoint_that_is_recorded():
    table = axis(**HOLD).run(np.zeros(600), changes=[FOLLOW])
    reference = table["reference"]
    assert not reference[:50].any() and 0.0 < reference[50] < 1e-8
    assert reference[50 + 119] == pytest.approx(3e-6, abs=1e-18)
    assert np.all(reference[50 + 239 :] == 5e-6)
    assert not table["setpoint"][:50].any() and np.all(table["setpoint"][50:] == 5e-6)
    assert table["measured"][-1] == pytest.approx(5e-6, abs=2e-8)


@pytest.mark.parametrize("setpoint", [None, 2e-6])
def test_the_twin_of_a_recorded_run_repeats_it_from_the_log(setpoint):
    setpoints = np.zeros(600)
    if setpoint is not None:
        setpoints[150:] = setpoint
    changes = [FOLLOW, Change(400, SOURCE, "hold")]
    made = axis(**HOLD).run(setpoints, changes=changes)
    logged = [{**one._asdict(), "parameters": {k: list(v) for k, v in one.parameters.items()}} for one in changes]
    recorded = Recording(made.pop("time"), made, metadata={"changes": logged})
    assert_same_bits(made, axis(**HOLD).run(made["setpoint"], changes=changes_of(recorded)))
    assert made["reference"][-1] == (setpoint or 5e-6)


def test_the_setpoint_that_ends_a_trajectory_is_recorded_while_the_axis_still_brakes():
    limits = {"approach__maximum_velocity": 2e-4, "approach__maximum_acceleration": 4e-3}
    limited = {SOURCE: {**HOLD[SOURCE], **limits}}
    setpoints = np.where(np.arange(900) < 200, 0.0, 1e-6)
    change = FOLLOW._replace(parameters={"times": (0.2,), "positions": (9e-6,), "velocities": (0.0,)})
    made = axis(**limited).run(setpoints, changes=[change])
    assert np.all(made["setpoint"][50:200] == 9e-6) and np.all(made["setpoint"][200:] == 1e-6)
    assert made["reference"][201] > made["reference"][200] and made["reference"][-1] == 1e-6
    assert_same_bits(made, axis(**limited).run(made["setpoint"], changes=[change]))


def test_an_axis_that_is_stopped_gives_its_trajectory_up():
    changes = [FOLLOW, Change(120, "plant_simulator", "halt"), Change(200, "plant_simulator", "start")]
    table = axis(**HOLD).run(np.zeros(600), changes=changes)
    assert np.all(table["reference"][120:] == table["reference"][119]) and table["reference"][119] > 1e-7
    assert table["setpoint"][300] == table["reference"][119]


@pytest.mark.slow
def test_the_fused_loop_takes_holds_and_refuses_trajectories_as_its_twin_does():
    loop, given = made_loop(factor=SLOWLY, samples=60, **ANY_LATE)
    loop.start()
    first = loop.apply(change(SOURCE, "follow", **POINTS))
    with pytest.raises(ParameterError, match="out of range"):
        loop.apply(change(SOURCE, "follow", times=(0.1,), positions=(1.0,)))
    until(lambda: loop.sample > first + 5, what="a few samples of the way")
    held = loop.apply(change(SOURCE, "hold"))
    assert loop.join(60.0) and first < held < 60
    taken = loop.take()
    made = named(loop, taken.table)
    twin = assert_twin(loop, made, given)
    assert [entry.action for entry in loop.changes] == ["follow", "hold"]
    assert np.ptp(twin["reference"][held - 1 :]) == 0.0 < twin["reference"][held]
