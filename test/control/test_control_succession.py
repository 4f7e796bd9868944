"""One controller takes over from another while the axis runs: the command goes on, the displacement is not kicked."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.control.handover import arm
from hysteresis_ros.control.open_loop import APPLIED, COMMAND, STARTED
from hysteresis_ros.control.sliding_surface import LAST, OBSERVER
from hysteresis_ros.control.succession import SAMPLES, History, shares_observer, successor
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.simulation.axis import Axis
from hysteresis_ros.simulation.node_parameters import part
from hysteresis_ros.simulation.run import single_axis

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
#: Every pair of types that close the loop, and the way out.
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
        chosen = single_axis(given.override("motion_controller", type=kind, **more))
        return part(chosen.motion_controller, ControllerParameters)

    return Axis(single_axis(given.override("motion_controller", type="pid"))), parameters


def run(axis, history, setpoints):
    """Run the axis and keep what a node keeps; return commands and displacements, shape (N,)."""
    applied = axis.controller.x[APPLIED]
    signals = axis.run(setpoints)
    carried_out = np.append(applied, signals["applied"][:-1])
    for sample in zip(carried_out, signals["reference"], 0.0 * carried_out, signals["measured"], strict=True):
        history.note(*map(float, sample))
    return signals["command"], signals["displacement"]


def hold(axis, history, samples):
    """Run the axis at one setpoint."""
    return run(axis, history, np.full(samples, STEP))


def switch(axis, parameters, history):
    """Let another controller take over as the node does."""
    axis.controller, lasting = successor(parameters, axis.controller.sample_time, axis.controller, history)
    arm(axis.handover, lasting=lasting)


@pytest.mark.parametrize("changes", [ESTIMATING, {}], ids=["estimating", "published filter"])
@pytest.mark.parametrize("mismatch", [0.05, -0.05])
def test_command_goes_on_and_nothing_is_kicked_with_a_wrong_model(changes, mismatch):
    """At rest under one type, then under the next: the displacement goes from one level to the other, no further."""
    axis, parameters = axis_of(mismatch, **changes)
    history = History()
    command, displacement = hold(axis, history, 2400)
    for kind in ROUND[1:]:
        switch(axis, parameters(kind), history)
        last, before = command[-1], displacement[-1]
        command, displacement = hold(axis, history, HELD)
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
    history = History()
    moving = STEP * (1.0 - np.cos(2 * np.pi * 5 * np.arange(900 * 6) / 3000.0)) / 2
    command, displacement, first = np.empty(0), np.empty(0), 0
    for kind in ("pid", "sliding_mode", "integral_sliding_mode", "super_twisting", "pid", "super_twisting"):
        if first:
            switch(axis, parameters(kind), history)
        u, y = run(axis, history, moving[first : first + 900])
        command, displacement = np.append(command, u), np.append(displacement, y)
        if first:
            assert command[first] == command[first - 1]
            assert np.max(np.abs(np.diff(command[first : first + 300]))) < 0.01 * STEP
        first += 900
    error = np.abs(displacement - moving)
    assert error[900:].max() < error[:900].max() + 0.1e-6


def test_observer_goes_on_where_the_filter_is_shared():
    axis, parameters = axis_of(0.05, **ESTIMATING)
    history = History()
    switch(axis, parameters("sliding_mode"), history)
    hold(axis, history, 300)
    before = axis.controller
    made, _ = successor(parameters("super_twisting"), before.sample_time, before, History())
    assert shares_observer(made, before)
    assert (made.x[OBSERVER:] == before.x[OBSERVER:]).all()
    assert made.x[STARTED] == 1.0
    other, _ = successor(parameters("super_twisting", kalman__q=0.1), before.sample_time, before, History())
    assert not shares_observer(other, before)
    assert other.x[STARTED] == 0.0  # without a history from rest at the next measurement
    assert other.x[APPLIED] == before.x[APPLIED] and other.x[COMMAND] == before.x[COMMAND]


def test_observer_learns_from_the_last_samples_what_it_would_have_known():
    axis, parameters = axis_of(0.05, **ESTIMATING)
    history = History()
    hold(axis, history, 400)
    made, lasting = successor(parameters("sliding_mode"), axis.controller.sample_time, axis.controller, history)
    beside = controller_block(parameters("sliding_mode"), axis.controller.sample_time)
    wanted = []
    for applied, reference, _, measured in history.samples:
        beside.x[APPLIED] = applied
        wanted.append(beside.step(reference, measured))
    carried_out = [sample[0] for sample in history.samples][-49:] + [axis.controller.x[APPLIED]]
    assert lasting == pytest.approx(np.mean(carried_out) - np.mean(wanted[-50:]), abs=1e-18)
    assert (made.x[OBSERVER:] == beside.x[OBSERVER:]).all()
    assert made.x[LAST] == beside.x[LAST]
    for k in range(2 * SAMPLES):
        history.note(k, 0.0, 0.0, 0.0)
    assert len(history.samples) == SAMPLES and history.samples[0][0] == SAMPLES
    history.clear()
    assert not history.samples


def test_integral_tracking_goes_on_from_the_present_command():
    """The integral starts where the command of its predecessor is, so the level is held at once."""
    tracking = {
        "sliding_mode__tracking": "integral",
        "sliding_mode__hyperplane": "poles",
        "sliding_mode__poles": [-0.122, -0.7, 0.97],
    }
    axis, parameters = axis_of(0.05, **tracking)
    history = History()
    hold(axis, history, 2400)
    switch(axis, parameters("sliding_mode"), history)
    _, displacement = hold(axis, history, HELD)
    assert np.max(np.abs(displacement - STEP)) < 0.01e-6


def test_a_design_that_cannot_work_leaves_the_running_controller_alone():
    axis, parameters = axis_of()
    history = History()
    hold(axis, history, 100)
    good = parameters("super_twisting")
    bad = replace(good, super_twisting=replace(good.super_twisting, k1=0.0))
    before, state = axis.controller, axis.controller.state
    with pytest.raises(ParameterError, match="super_twisting.k1"):
        successor(bad, before.sample_time, before, history)
    assert axis.controller is before and (before.state == state).all()
