# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One controller takes over from another on the running axis: the command continues, the displacement has no jump."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.controller import SAMPLES, ControllerParameters, History, controller_block, note, successor
from hysteresis_ros.control.law import APPLIED, COMMAND, STARTED
from hysteresis_ros.control.sliding_surface import LAST, OBSERVER
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.reach import single_axis

CONFIG = pathlib.Path(__file__).resolve().parents[2] / "config" / "kim2009.yaml"
STEP = 2.05e-6
HELD = 1200  # samples under each controller
ESTIMATING = {
    "kalman__gain": "riccati",
    "kalman__q": 0.685,
    "kalman__disturbance": "constant",
    "kalman__q_disturbance": 0.01,
}
GAINS = {
    "pid__Ki": 20.0,
    "super_twisting__gains": "given",
    "super_twisting__k1": 0.1,
    "super_twisting__k2": 0.1,
}
#: Every pair of closed-loop types, and the change to open loop.
ROUND = ("pid", "sliding_mode", "integral_sliding_mode", "super_twisting", "sliding_mode", "super_twisting")
ROUND += ("integral_sliding_mode", "sliding_mode", "pid", "integral_sliding_mode", "pid", "super_twisting", "pid")
ROUND += ("open_loop",)


def axis_of(mismatch: float = 0.0, **changes):
    """Return the axis of kim2009 at rest at zero and a function: type → parameters of its controller."""
    given = load_configuration(CONFIG).override("plant_simulator", limits__bits=0)
    given = given.override("hysteresis_compensator", limits__bits=0, hysteresis__polynomial__scale=1.0 + mismatch)
    given = given.override("reference_generator", waveform__type="hold")
    given = given.override("motion_controller", **GAINS, **changes)

    def parameters(kind, **more):
        return single_axis(given.override("motion_controller", type=kind, **more)).motion_controller

    return Axis(single_axis(given.override("motion_controller", type="pid"))), parameters


def run(axis, setpoints):
    """Run the axis; return commands and displacements, shape (N,)."""
    signals = axis.run(setpoints)
    return signals["command"], signals["displacement"]


def hold(axis, samples):
    """Run the axis at one setpoint."""
    return run(axis, np.full(samples, STEP))


def block(parameters):
    """Return the controller's own group of a node's parameters."""
    return part(parameters, ControllerParameters).without_preload


@pytest.mark.parametrize("changes", [ESTIMATING, {}], ids=["estimating", "published filter"])
@pytest.mark.parametrize("mismatch", [0.05, -0.05])
def test_command_goes_on_and_nothing_is_kicked_with_a_wrong_model(changes, mismatch):
    """At rest under one type, then under the next: the displacement moves between the two levels without overshoot."""
    axis, parameters = axis_of(mismatch, **changes)
    command, displacement = hold(axis, 2400)
    for kind in ROUND[1:]:
        axis.controller.retune(parameters(kind))
        last, before = command[-1], displacement[-1]
        command, displacement = hold(axis, HELD)
        assert command[0] == last, kind  # not by a rounding error
        assert abs(command[1] - last) < 0.01 * STEP, kind
        beyond = max(
            displacement.max() - max(before, displacement[-1]), min(before, displacement[-1]) - displacement.min()
        )
        assert beyond < 0.01e-6, kind
        if changes and kind != "open_loop":
            assert displacement[-1] == pytest.approx(STEP, abs=0.1e-9)
            assert np.max(np.abs(displacement - STEP)) < 0.01e-6


def test_a_moving_axis_is_taken_over_without_a_jump():
    axis, parameters = axis_of(0.05, **ESTIMATING)
    moving = STEP * (1.0 - np.cos(2 * np.pi * 5 * np.arange(900 * 6) / 3000.0)) / 2
    command, displacement, first = np.empty(0), np.empty(0), 0
    for kind in ("pid", "sliding_mode", "integral_sliding_mode", "super_twisting", "pid", "super_twisting"):
        if first:
            axis.controller.retune(parameters(kind))
        u, y = run(axis, moving[first : first + 900])
        command, displacement = np.append(command, u), np.append(displacement, y)
        if first:
            assert command[first] == command[first - 1]
            assert np.max(np.abs(np.diff(command[first : first + 300]))) < 0.01 * STEP
        first += 900
    error = np.abs(displacement - moving)
    assert error[900:].max() < error[:900].max() + 0.1e-6


def test_observer_goes_on_where_the_filter_is_shared():
    axis, parameters = axis_of(0.05, **ESTIMATING)
    axis.controller.retune(parameters("sliding_mode"))
    hold(axis, 300)
    before = axis.controller.controller
    made, _ = successor(block(parameters("super_twisting")), before.sample_time, before, History())
    assert made.shares_observer(before)
    assert (made.x[OBSERVER:] == before.x[OBSERVER:]).all()
    assert made.x[STARTED] == 1.0
    other, _ = successor(block(parameters("super_twisting", kalman__q=0.1)), before.sample_time, before, History())
    assert not other.shares_observer(before)
    assert other.x[STARTED] == 0.0  # without history, as from rest at the next measurement
    assert other.x[APPLIED] == before.x[APPLIED] and other.x[COMMAND] == before.x[COMMAND]


def test_observer_learns_from_the_last_samples_what_it_would_have_known():
    axis, parameters = axis_of(0.05, **ESTIMATING)
    hold(axis, 400)
    present, history = axis.controller.controller, axis.controller.history
    made, lasting = successor(block(parameters("sliding_mode")), present.sample_time, present, history)
    beside = controller_block(block(parameters("sliding_mode")), present.sample_time)
    wanted = []
    for applied, reference, _, measured in history.samples:
        beside.x[APPLIED] = applied
        wanted.append(beside.step(reference, measured))
    carried_out = [sample[0] for sample in history.samples][-49:] + [present.x[APPLIED]]
    assert lasting == pytest.approx(np.mean(carried_out) - np.mean(wanted[-50:]), abs=1e-18)
    assert (made.x[OBSERVER:] == beside.x[OBSERVER:]).all()
    assert made.x[LAST] == beside.x[LAST]
    for k in range(2 * SAMPLES):
        note(history.x, float(k), 0.0, 0.0, 0.0)
    assert len(history.samples) == SAMPLES and history.samples[0][0] == SAMPLES
    history.reset()
    assert len(history.samples) == 0


def test_integral_tracking_goes_on_from_the_present_command():
    """The integral starts at the command of the predecessor, so the level is held at once."""
    tracking = {
        "sliding_mode__tracking": "integral",
        "sliding_mode__hyperplane": "poles",
        "sliding_mode__poles": [-0.122, -0.7, 0.97],
    }
    axis, parameters = axis_of(0.05, **tracking)
    hold(axis, 2400)
    axis.controller.retune(parameters("sliding_mode"))
    _, displacement = hold(axis, HELD)
    assert np.max(np.abs(displacement - STEP)) < 0.01e-6


def test_a_design_that_cannot_work_leaves_the_running_controller_alone():
    axis, parameters = axis_of()
    hold(axis, 100)
    good = parameters("super_twisting")
    bad = replace(good, super_twisting=replace(good.super_twisting, k1=0.0))
    before, state = axis.controller.controller, axis.controller.controller.state
    with pytest.raises(ParameterError, match="super_twisting.k1"):
        axis.controller.retune(bad)
    assert axis.controller.controller is before and (before.state == state).all()
