# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Dynamic decoupling of a stage: the inverse of all axes together, zeros outside the unit circle, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_stage_support import PROPORTIONAL, SAMPLE_TIME, late_structure, stage

from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.control.feedforward import designed_preview, inverse_filter
from hysteresis_ros.designs.stage_feedforward import (
    GRID,
    VoltageSteps,
    _largest,
    design_stage_feedforward,
    finite_response,
    require_gentle_steps,
    stage_feedforward_file,
    voltage_steps,
    without_stage_feedforward,
)
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop.stage_parameters import StageFeedforwardParameters, StageParameters
from hysteresis_ros.loop.stage_response import damped_response
from hysteresis_ros.loop.stage_simulation import simulate_stage

#: Controllers that only pass on the command, so that nothing corrects what the feedforward does.
OPEN = {
    "motion_controller": {"type": "open_loop", "damping__type": "none"},
    "reference_generator": {f"approach__maximum_{name}": 0.0 for name in ("velocity", "acceleration", "jerk")},
}
#: A sine of x within the band, which begins and ends smoothly.
FREQUENCY, AMPLITUDE = 250.0, 2e-6


def response(parameters: StageParameters, z: np.ndarray) -> np.ndarray:
    """Return the feedforward of a stage, shape (F, n, n), term by term."""
    fed = parameters.stage.feedforward
    found = np.zeros((len(z), len(parameters.names), len(parameters.names)), dtype=complex)
    for i, axis in enumerate(parameters.axes):
        model = axis.motion_controller.before_damping(SAMPLE_TIME).model.dynamics
        found[:, i, i] = inverse_filter(model, axis.motion_controller.feedforward.preview).response(z)
    for i, row in enumerate(fed.matrix(len(parameters.names))):
        for j, taps in enumerate(row):
            found[:, i, j] += sum(tap * z**m for m, tap in enumerate(taps, start=-fed.preview))
    return found


def moved(parameters: StageParameters) -> np.ndarray:
    """Return the motion that a sine of x adds to x, apart from the sine, and to y [m], shape (2, N)."""
    time = np.arange(900) * SAMPLE_TIME
    sine = AMPLITUDE * np.sin(2.0 * np.pi * FREQUENCY * time) * np.hanning(len(time)) ** 2
    runs = [simulate_stage(parameters, setpoints={"x": 20e-6 + part * sine}) for part in (1.0, 0.0)]
    x, y = (runs[0][f"{name}/displacement"] - runs[1][f"{name}/displacement"] for name in "xy")
    late = parameters.axes[0].motion_controller.feedforward.preview
    return np.array([x - np.append(np.zeros(late), sine)[: len(sine)], y])


@pytest.mark.slow
@pytest.mark.parametrize("structure", [None, late_structure()], ids=["as it is", "zero outside"])
def test_the_displacements_of_all_axes_follow_without_coupling(structure):
    parameters = stage(structure=structure, **OPEN)
    if structure is not None:  # the sensor x has 4 % of static cross-talk here, too
        gain = parameters.stage.structure.linear.dc_gain
        decoupling = tuple(map(float, np.linalg.solve(gain, np.diag(np.diag(gain))).ravel()))
        parameters = replace(parameters, stage=replace(parameters.stage, decoupling=decoupling))
    found = design_stage_feedforward(parameters)
    without = replace(found.parameters, stage=replace(found.parameters.stage, feedforward=StageFeedforwardParameters()))
    (_, coupled), (own, left) = moved(without), moved(found.parameters)
    assert np.max(np.abs(coupled)) > 2e-3 * AMPLITUDE
    assert np.max(np.abs(left)) < 2e-6 * AMPLITUDE
    assert np.max(np.abs(own)) < 1e-4 * AMPLITUDE
    assert found.after < 1e-3 < 0.1 < found.before


def test_a_zero_outside_the_unit_circle_needs_preview():
    parameters = stage(structure=late_structure(), **OPEN)
    gain = parameters.stage.structure.linear.dc_gain
    decoupling = tuple(map(float, np.linalg.solve(gain, np.diag(np.diag(gain))).ravel()))
    parameters = replace(parameters, stage=replace(parameters.stage, decoupling=decoupling))
    left = [design_stage_feedforward(parameters, preview, 1000.0).after for preview in (12, 30, 50)]
    assert left[0] > 5.0 * left[1] and left[1] > 1.2 * left[2]


@pytest.mark.slow
@pytest.mark.parametrize("late", [0, 1])
def test_the_preview_is_that_of_the_axis_that_needs_most(late):
    """The model of one axis contains four more samples of delay."""
    parameters = stage(**OPEN)
    axes = list(parameters.axes)
    node = axes[late].motion_controller
    dynamics = replace(
        node.model.dynamics, delay=node.model.dynamics.delay + 4.0 * SAMPLE_TIME, sample_time=SAMPLE_TIME
    )
    axes[late] = replace(axes[late], motion_controller=replace(node, model=replace(node.model, dynamics=dynamics)))
    needed = [designed_preview(axis.motion_controller.model.dynamics) for axis in axes]
    assert needed[late] == needed[1 - late] + 4
    assert design_stage_feedforward(replace(parameters, axes=tuple(axes)), band=1000.0).preview >= needed[late]


def test_the_inverse_is_that_of_python_control():
    control = pytest.importorskip("control")
    parameters = design_stage_feedforward(stage(**OPEN)).parameters
    linear, into = parameters.stage.structure.linear, parameters.stage.matrix("decoupling")
    # the structure is measured before the command of the sample, and the actuators add a sample of delay
    plant = control.ss(linear.A, linear.B @ into, linear.C, np.zeros((2, 2)), SAMPLE_TIME)
    delay = control.ss(np.zeros((2, 2)), np.eye(2), np.eye(2), np.zeros((2, 2)), SAMPLE_TIME)
    turns = GRID[(GRID > 1e-3) & (GRID <= 0.1)]
    plant = np.moveaxis((plant * delay)(np.exp(2j * np.pi * turns)), 2, 0)
    whole = plant @ response(parameters, np.exp(2j * np.pi * turns))
    error = np.abs(whole - np.eye(2))
    assert np.max(error) < 3e-3 and np.max(error[:, [0, 1], [1, 0]]) < 1e-3
    np.testing.assert_allclose(damped_response(parameters, 2.0 * np.pi * turns), plant, atol=1e-9)


def test_the_response_behind_the_dampings_is_that_of_the_running_stage():
    """A pulse of the reference of one axis, on a stage that comes to rest because its resonances are damped."""
    parameters = stage(motion_controller={"type": "open_loop"}, reference_generator=OPEN["reference_generator"])
    assert {axis.motion_controller.damping.type for axis in parameters.axes} == {"irc"}
    pulse, size = np.zeros(2000), 1e-7
    pulse[50] = size
    runs = [simulate_stage(parameters, setpoints={"x": 20e-6 + part * pulse}) for part in (1.0, 0.0)]
    moved = np.array([runs[0][f"{name}/displacement"] - runs[1][f"{name}/displacement"] for name in "xy"])
    angles = 2.0 * np.pi * np.array([100.0, 300.0, 700.0, 1500.0]) * SAMPLE_TIME
    found = np.exp(-1j * np.outer(angles, np.arange(2000) - 50)) @ moved.T / size
    np.testing.assert_allclose(damped_response(parameters, angles)[:, :, 0], found, atol=1e-6)


def test_a_finite_response_in_its_window_is_found_exactly():
    taps = np.random.default_rng(1).normal(size=(2, 2, 8))
    taps -= taps.mean(axis=2, keepdims=True)
    z = np.exp(2j * np.pi * GRID)
    wanted = np.moveaxis(sum(taps[..., m, None] * z ** (m - 4) for m in range(8)), 2, 0)
    np.testing.assert_allclose(finite_response(wanted, 4, 0.5), taps, atol=1e-9)
    assert np.max(np.abs(finite_response(wanted, 4, 0.1).sum(axis=2))) < 1e-12


def test_a_stage_of_one_axis_gets_the_inverse_of_its_axis():
    configuration = load_configuration("xy_scanner")
    entries = tuple(entry for entry in configuration.entries if not entry[0].startswith("/y/"))
    model = configuration.node("motion_controller", "x")
    values = {f"structure__{name}": model[f"model.dynamics.{name}"] for name in ("A", "B", "C")}
    one = {"axes": ["x"], "decoupling": [], "structure__inputs": 1, "structure__outputs": 1, **values}
    parameters = StageParameters.from_configuration(replace(configuration, entries=entries).override("stage", **one))
    found = design_stage_feedforward(parameters)
    assert found.parameters.stage.feedforward == StageFeedforwardParameters()
    assert found.parameters.axes[0].motion_controller.feedforward.type == "inverse_dynamics"


@pytest.mark.slow
def test_what_a_stage_cannot_invert_is_refused():
    smc = stage(motion_controller={"type": "sliding_mode"})
    with pytest.raises(
        ConfigurationError, match="/x/motion_controller: type = sliding_mode: the feedforward of a stage needs"
    ):
        design_stage_feedforward(smc)
    with pytest.raises(
        ConfigurationError, match=r": 4 % of coupling remains at rest, .*: give decoupling: \[1.0016, -0.04"
    ):
        design_stage_feedforward(stage(structure={"decoupling": []}))
    with pytest.raises(ConfigurationError, match="--bandwidth 4000 Hz: must be 20 … 2500 Hz"):
        design_stage_feedforward(stage(), band=4000.0)
    with pytest.raises(ParameterError, match="feedforward.preview = 1: must be at least"):
        design_stage_feedforward(stage(), preview=1)
    fed = {"stage": {"feedforward__preview": 2, "feedforward__weights": [0.0] * 16}}
    with pytest.raises(ParameterError, match="/x/motion_controller: feedforward.type = 'none': must be inverse"):
        stage(**fed)
    with pytest.raises(ParameterError, match=r"/y/motion_controller: feedforward.preview = 3: must equal .* stage, 2"):
        stage(**fed, motion_controller={"feedforward__type": "static", "feedforward__preview": 3})
    fed["stage"]["feedforward__weights"] = [0.0] * 12
    with pytest.raises(ParameterError, match="feedforward.weights = .*: has 12 numbers and must have 2·2·2·2 = 16"):
        stage(**fed)


def gentle(controller=OPEN["motion_controller"], **limits) -> StageParameters:
    """Return a stage, by default in open loop, whose setpoints move at 1 mm/s."""
    slow = {"approach__maximum_velocity": 1e-3, "approach__maximum_acceleration": 0.0, "approach__maximum_jerk": 0.0}
    own = {"limits__bits": 0, "limits__slew_rate": limits.pop("compensator", 0.0)}
    plant = {"limits__bits": 0, "limits__slew_rate": limits.pop("plant", 0.0)}
    model = PROPORTIONAL | {"sensor__noise": 0.0, "sensor__resolution": 0.0, "overtravel": -1.0}
    return stage(
        motion_controller=controller,
        reference_generator=slow,
        plant_simulator=model | plant,
        hysteresis_compensator=PROPORTIONAL | own,
    )


@pytest.mark.slow
def test_the_voltage_steps_of_a_stage_are_those_of_its_setpoints_without_the_way_to_the_first_one():
    """1 mm/s at 10 kHz and 0.4 µm/V are 0.25 V a sample, of the axis that moves; from 0 V to 20 µm it is 50 V."""
    for step, name in zip(voltage_steps(gentle()), "xy", strict=True):
        assert step.asked == pytest.approx(0.25 * 1.0016, rel=1e-3) and step.what.endswith(f"µm away in {name}")
        assert step.allowed == np.inf and step.span == 100.0
    for rates in ({"plant": 7e4, "compensator": 5e4}, {"plant": 5e4, "compensator": 7e4}, {"plant": 5e4}):
        assert [step.allowed for step in voltage_steps(gentle(**rates))] == [pytest.approx(5.0)] * 2


def test_the_actuator_that_uses_most_of_its_range_in_a_sample_counts():
    """x moves by 10 of its 100 V, y by 8 of its 40 V."""
    parameters = gentle()
    x, y = parameters.axes
    node = y.hysteresis_compensator
    limits = replace(node.limits, maximum=node.limits.minimum + 40.0)
    narrower = replace(parameters, axes=(x, replace(y, hysteresis_compensator=replace(node, limits=limits))))
    run = {"x/voltage": np.array([0.0, 10.0, 10.0]), "y/voltage": np.array([0.0, 0.0, 8.0])}
    step = _largest(narrower, run, 0, "a move")
    assert (step.asked, step.span) == (8.0, pytest.approx(40.0))


def test_an_integrator_that_goes_to_the_first_setpoint_does_not_count():
    """At 60 1/s an error of 20 µm changes it by 0.3 V in a sample, and 20 ms of 1 mm/s by 0.25 (1 − e^-1.2)."""
    controller = {"type": "pid", "damping__type": "none", "pid__Kp": 0.0, "pid__Ki": 60.0, "pid__Kd": 0.0}
    for step in voltage_steps(gentle(controller)):
        assert step.asked == pytest.approx(0.25 * (1.0 - np.exp(-1.2)), rel=0.1)


@pytest.mark.slow
def test_what_no_preview_decouples_is_refused_unless_preview_and_band_are_both_given():
    """A zero close to the unit circle: what it leaves decays more slowly than the longest preview."""
    C = np.reshape(load_configuration("xy_scanner").node("stage")["structure.C"], (2, 4)).copy()
    C[0, 1] = -10.0
    parameters = stage(structure={"structure__C": tuple(C.ravel())}, **OPEN)
    assert design_stage_feedforward(parameters, 60, 1000.0).after > 0.1
    with pytest.raises(ConfigurationError, match=r"63 samples of preview \S+ % of coupling remain up to 1000 Hz"):
        design_stage_feedforward(parameters, None, 1000.0)
    # with this preview the lowest band leaves too much, too
    with pytest.raises(ConfigurationError, match=r"8 samples of preview \S+ % of coupling remain up to 134.218 Hz"):
        design_stage_feedforward(parameters, 8)


def test_an_axis_that_learns_gets_no_feedforward():
    given = {"learning__type": "inversion", "learning__period": 0.01, "learning__maximum": 1e-6}
    given |= {"learning__error_filter": [1.0], "learning__robustness_filter": [1.0]}
    with pytest.raises(ConfigurationError, match="learning.type = inversion: its corrections were designed without"):
        design_stage_feedforward(stage(motion_controller=given))


def test_full_scale_in_a_sample_is_refused():
    require_gentle_steps([VoltageSteps("a setpoint 1 µm away in x", 6.0, 7.0, 100.0)])
    require_gentle_steps([VoltageSteps("the configured waveforms", 8.0, 7.0, 100.0)])
    for steps in (
        VoltageSteps("a setpoint 1 µm away in x", 8.0, 7.0, 100.0),
        VoltageSteps("the configured waveforms", 100.0, np.inf, 100.0),
    ):
        with pytest.raises(ConfigurationError, match=f"{steps.what} needs a change of {steps.asked:g} V in a sample"):
            require_gentle_steps([steps])


@pytest.mark.slow
def test_the_file_has_the_designed_feedforward_and_loses_it_again():
    configuration = load_configuration("xy_scanner")
    found = design_stage_feedforward(StageParameters.from_configuration(configuration), preview=14)
    written = parse_configuration(stage_feedforward_file(configuration, found, "--feedforward"), "the file")
    again = StageParameters.from_configuration(written)
    assert again.stage == found.parameters.stage
    assert [axis.motion_controller for axis in again.axes] == [axis.motion_controller for axis in found.parameters.axes]
    twice = stage_feedforward_file(written, found, "--feedforward")
    assert twice.count("# Feedforward designed by") == 1
    bare = StageParameters.from_configuration(without_stage_feedforward(written))
    assert bare.stage.feedforward == StageFeedforwardParameters()
