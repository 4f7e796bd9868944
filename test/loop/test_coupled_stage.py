# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage in the loop: one axis has the bits of the single axis, and coupled axes follow their structure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from coupled_stages import (
    LINEAR,
    SAMPLE_TIME,
    as_values,
    configured,
    driven,
    internal_stage,
    internal_structure,
    linear_stage,
    modes,
    stage,
)
from interpreted import interpreted
from loop_support import assert_same_bits

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.feedforward import FeedforwardParameters, designed_preview
from hysteresis_ros.designs.stage_feedforward import design_stage_feedforward
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.controller import RETURNING, STOP
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.plant import BEYOND_TRAVEL, PARTNER_LOST
from hysteresis_ros.loop.stage import WITH_STAGE, Stage, hold_with_stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import coupling_errors, simulate_stage, stage_differences
from hysteresis_ros.loop.watch import RUNNING, STALE, STOPPED
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.sensor import MEASURED


def bits(values) -> np.ndarray:
    return np.ascontiguousarray(values).view(np.int64)


def columns(run) -> np.ndarray:
    """Return displacements, measurements, voltages and commands of all axes, shape (4 n, N)."""
    return np.array([one[name] for one in run.values() for name in ("displacement", "measured", "voltage", "command")])


def whole_run(samples: int, **overrides) -> np.ndarray:
    """Return :func:`columns` of a run of xy_scanner."""
    one = stage(**overrides)
    return columns(one.run(one.default_setpoints(samples)))


def internal_run(samples: int) -> np.ndarray:
    """Return :func:`columns` of a stage with hysteresis inside its structure."""
    one = internal_stage()
    time = np.arange(samples)
    setpoints = {"x": 20.0 * (1.0 - np.cos(2e-3 * time)), "y": 9.0 * (1.0 - np.cos(5e-3 * time))}
    return columns(one.run(setpoints))


def adapting_run(samples: int) -> np.ndarray:
    """Return :func:`columns` of a stage with one adapting axis: the parts of its axes have two classes."""
    return whole_run(samples, x__hysteresis_compensator=adapting())


def adapting() -> dict:
    """Return parameters with which the compensator of x is adapted."""
    model = configured().node("motion_controller", "x")
    names = ("A", "B", "C", "sample_time", "delay")
    dynamics = {f"adaptation__dynamics__{name}": model[f"model.dynamics.{name}"] for name in names}
    return {"adaptation__type": "recursive", **dynamics}


def fed(preview: int = 3) -> dict:
    """Return parameters of a feedforward of the stage without symmetry, as values of its nodes."""
    weights = np.random.default_rng(7).normal(scale=0.01, size=(2, 2, 2 * preview))
    weights -= weights.mean(axis=2, keepdims=True)
    given = {"feedforward__preview": preview, "feedforward__weights": tuple(map(float, weights.ravel()))}
    own = {"feedforward__type": "static", "feedforward__preview": preview}
    return {"stage": given, "motion_controller": own}


def single(dynamics: dict) -> Configuration:
    """Return the axis x of xy_scanner alone, with given dynamics."""
    own = configured()
    entries = tuple((name, values) for name, values in own.entries if name != "/stage" and not name.startswith("/y/"))
    alone = replace(own, entries=entries)
    return alone.override("plant_simulator", **{f"dynamics__{name}": value for name, value in dynamics.items()})


def impulse(preview: int, offset: int, moved: int = 0) -> dict:
    """Return a feedforward whose only weight is that of r(k + offset) of the moved axis in the other one.

    Besides there is that of the oldest reference, so that nothing is added at rest.
    """
    weights = np.zeros((2, 2, 2 * preview))
    weights[1 - moved, moved, preview + offset] += 0.1
    weights[1 - moved, moved, 0] -= 0.1
    given = fed(preview)
    given["stage"]["feedforward__weights"] = tuple(map(float, weights.ravel()))
    return given


def test_the_feedforward_of_a_stage_is_the_sum_over_the_references_of_all_axes():
    preview, random = 3, np.random.default_rng(3)
    given = fed(preview)
    one = stage(
        **{**LINEAR, "motion_controller": LINEAR["motion_controller"] | given["motion_controller"]},
        stage=given["stage"],
    )
    weights = one.parameters.stage.feedforward.matrix(2)
    references = 20e-6 + random.uniform(-1e-6, 1e-6, (2, 40))
    references[:, :6] = 20e-6
    found = one.run(dict(zip("xy", references, strict=True)))
    # what the stage is given at sample k is r(k + N)
    ahead = np.hstack([np.full((2, 2 * preview), 20e-6), references])
    for i, name in enumerate("xy"):
        own = ahead[i, preview : preview + 40]
        across = [np.sum(weights[i] * ahead[:, k : k + 2 * preview]) for k in range(40)]
        np.testing.assert_allclose(found[name]["command"], own + across, atol=1e-18)


@pytest.mark.parametrize(("moved", "other"), ["xy", "yx"])
def test_an_axis_that_is_stopped_adds_nothing_to_the_others_and_returns_without_a_jump(moved, other):
    given = impulse(3, 2, "xy".index(moved))
    values = {**LINEAR, "motion_controller": LINEAR["motion_controller"] | given["motion_controller"]}
    one = stage(**values, stage=given["stage"])
    moving = 20e-6 + 1e-6 * np.sin(0.05 * np.arange(800))
    changes = {moved: [Change(300, "motion_controller", "stop"), Change(500, "motion_controller", "start")]}
    command = one.run({moved: moving, other: np.full(800, 20e-6)}, changes)[other]["command"] - 20e-6
    assert np.max(np.abs(command[10:300])) > 1e-8
    assert np.max(np.abs(command[301:500])) == 0.0
    assert np.max(np.abs(command[510:])) > 1e-8
    assert np.max(np.abs(np.diff(command[302:]))) < 2e-8


@pytest.mark.parametrize(("moved", "other"), ["xy", "yx"])
def test_after_a_reset_of_its_controller_the_references_of_an_axis_count_as_always_constant(moved, other):
    given = impulse(3, 2, "xy".index(moved))
    values = {**LINEAR, "motion_controller": LINEAR["motion_controller"] | given["motion_controller"]}
    one = stage(**values, stage=given["stage"])
    moving = 20e-6 + 1e-6 * np.sin(0.05 * np.arange(800))
    changes = {moved: [Change(300, "motion_controller", "reset")]}
    command = one.run({moved: moving, other: np.full(800, 20e-6)}, changes)[other]["command"] - 20e-6
    assert np.min(np.abs(command[290:301])) > 1e-9
    assert abs(command[301]) < 1e-18, "the first reference is the only one that is known"
    assert np.max(np.abs(command[310:])) > 1e-8


def test_a_plant_that_is_reset_is_at_rest_with_its_structure():
    one = linear_stage()
    changes = {name: [Change(50, "plant_simulator", "reset")] for name in "xy"}
    found = one.run({name: np.full(60, 20e-6) for name in "xy"}, changes)
    for name in "xy":
        assert abs(found[name]["displacement"][50]) < 1e-15 < 1e-6 < found[name]["displacement"][49]
        np.testing.assert_array_equal(found[name]["displacement"][50:60], found[name]["displacement"][:10])


@pytest.mark.slow
@pytest.mark.parametrize("feeds", [False, True], ids=["feedback", "feedforward"])
@pytest.mark.parametrize("delay", [0.0, SAMPLE_TIME], ids=["prompt", "late"])
def test_a_stage_of_one_axis_has_the_bits_of_the_axis(delay, feeds):
    A, B = modes((700.0,), (0.01,))
    dynamics = {"A": tuple(A.ravel()), "B": tuple(B.ravel()), "C": (1.0, 0.0), "input_scale": 1.0}
    own = AxisParameters.from_configuration(single({**dynamics, "delay": delay, "sample_time": SAMPLE_TIME}), "/x")
    # the delay is part of the structure here, and part of the axis' linear dynamics there
    model = LinearParameters(**dynamics, delay=delay, sample_time=SAMPLE_TIME).state_space
    values = {f"structure__{name}": tuple(getattr(model, name).ravel()) for name in ("A", "B", "C", "D")} | {
        "structure__inputs": 1,
        "structure__outputs": 1,
        "axes": ["x"],
        "decoupling": [],
    }
    entries = tuple((name, given) for name, given in configured().entries if not name.startswith("/y/"))
    configuration = replace(configured(), entries=entries).override("stage", **values)
    configuration = configuration.override("plant_simulator", dynamics__delay=0.0, dynamics__sample_time=0.0)
    parameters = StageParameters.from_configuration(configuration)
    if feeds:
        parameters = design_stage_feedforward(parameters).parameters
        control = own.motion_controller
        feedforward = FeedforwardParameters(
            "inverse_dynamics", designed_preview(control.before_damping(SAMPLE_TIME).model.dynamics)
        )
        own = replace(own, motion_controller=replace(control, feedforward=feedforward))
    alone, coupled = Axis(own), Stage(parameters)
    samples = 1500
    expected = alone.run(alone.default_setpoints(samples))
    assert np.ptp(expected["displacement"]) > 15e-6
    assert_same_bits(expected, coupled.run(coupled.default_setpoints(samples))["x"])


@pytest.mark.slow
def test_three_axes_that_do_not_couple_are_the_axes_that_they_are_alone():
    A, B = modes((700.0,), (0.01,))
    dynamics = {"A": tuple(A.ravel()), "B": tuple(B.ravel()), "C": (1.0, 0.0), "input_scale": 1.0}
    names = ("one", "two", "three")
    entries = [(name, values) for name, values in configured().entries if not name.startswith(("/x/", "/y/"))]
    for name in names:
        own = [
            (key.replace("/x/", f"/{name}/"), values) for key, values in configured().entries if key.startswith("/x/")
        ]
        entries += [*own, (f"/{name}/**", {"joint": name})]
    structure = {
        "A": np.kron(np.eye(3), A),
        "B": np.kron(np.eye(3), B),
        "C": np.kron(np.eye(3), [[1.0, 0.0]]),
    }
    values = {f"structure__{name}": tuple(matrix.ravel()) for name, matrix in structure.items()}
    values |= {"structure__inputs": 3, "structure__outputs": 3, "axes": list(names), "decoupling": []}
    configuration = replace(configured(), entries=tuple(entries)).override("stage", **values)
    prompt = {"dynamics__delay": 0.0, "dynamics__sample_time": 0.0}
    coupled = Stage(StageParameters.from_configuration(configuration.override("plant_simulator", **prompt)))
    setpoints = {name: np.full(800, place) for name, place in zip(names, (9e-6, 20e-6, 31e-6), strict=True)}
    found = coupled.run(setpoints)
    alone = Axis(AxisParameters.from_configuration(single({**dynamics, "delay": 0.0}), "/x"))
    for name in names:
        alone.reset()
        assert_same_bits(alone.run(setpoints[name]), found[name])


@pytest.mark.slow
def test_the_compiled_loop_has_the_bits_of_its_python_form(tmp_path):
    runs = "whole_run(400)", "internal_run(400)", "adapting_run(400)", "whole_run(400, **fed())"
    others = interpreted("test_coupled_stage", f"[{', '.join(runs)}]", tmp_path)
    for expression, other in zip(runs, others, strict=True):
        np.testing.assert_array_equal(bits(eval(expression)), bits(other), err_msg=expression)


@pytest.mark.slow
def test_axes_with_parts_of_two_classes_run_in_one_loop():
    one = stage(x__hysteresis_compensator=adapting())
    assert len({type(axis.parts.compensator) for axis in one.axes}) == 2
    found = one.run(one.default_setpoints(2000))
    assert np.all(found["x"]["adaptation"] > 0.0)
    assert not found["y"]["adaptation"].any()
    assert np.ptp(found["x"]["displacement"]) > 15e-6


def test_a_linear_stage_superposes_as_its_state_space_says():
    one = linear_stage(decoupling=[])
    voltages = np.random.default_rng(0).uniform(0.0, 100.0, (2000, 2))
    voltages[0] = 0.0
    model = one.parameters.stage.structure.linear
    found = driven(one, voltages)
    expected = scipy.signal.dlsim((model.A, model.B, model.C, model.D, SAMPLE_TIME), 0.4e-6 * voltages)[1]
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.ptp(expected))
    alone = []
    for i in range(2):
        one.reset()
        alone.append(driven(one, voltages * np.eye(2)[i]))
    np.testing.assert_allclose(alone[0] + alone[1], found, atol=1e-12 * np.ptp(expected))


def test_cross_talk_at_rest_is_that_of_the_static_gain():
    one = linear_stage(decoupling=[])
    voltages = np.zeros((6000, 2))
    voltages[1:, 0] = 50.0
    found = driven(one, voltages)[-1]
    model = one.parameters.stage.structure.linear
    gain = model.C @ np.linalg.solve(np.eye(4) - model.A, model.B)
    np.testing.assert_allclose(found, 20e-6 * gain[:, 0], rtol=1e-6)
    assert found[1] / found[0] == pytest.approx(0.04, rel=1e-6)


def test_the_decoupling_takes_the_cross_talk_away_at_rest():
    one = linear_stage()
    setpoints = {"x": np.full(6000, 20e-6), "y": np.full(6000, 5e-6)}
    found = one.run(setpoints)
    for name, setpoint in (("x", 20e-6), ("y", 5e-6)):
        assert found[name]["displacement"][-1] == pytest.approx(setpoint, rel=1e-6)
        assert found[name]["command"][-1] == pytest.approx(setpoint, rel=1e-12)
        assert found[name]["applied"][-1] == pytest.approx(setpoint, rel=1e-12)
    # the actuators receive the commands times the matrix: 1.0016 and -0.04006
    matrix = one.parameters.stage.matrix("decoupling")
    voltages = matrix @ [20e-6, 5e-6] / 0.4e-6
    np.testing.assert_allclose([found[name]["voltage"][-1] for name in "xy"], voltages, rtol=1e-12)


def test_a_command_that_an_actuator_cannot_achieve_comes_back_through_the_decoupling():
    one = linear_stage()
    found = one.run({"x": np.full(50, 20e-6), "y": np.zeros(50)})
    # y would need -0.8 µm of its actuator, whose range ends at 0: the actuator of x moves y by 4 %
    matrix = one.parameters.stage.matrix("decoupling")
    achieved = np.linalg.inv(matrix) @ [(matrix @ [20e-6, 0.0])[0], 0.0]
    np.testing.assert_allclose([found[name]["applied"][-1] for name in "xy"], achieved, rtol=1e-9)
    assert found["y"]["saturated"][-1] == 1.0
    assert found["y"]["command"][-1] == 0.0


def permuted_stage(**overrides) -> Stage:
    """Return xy_scanner with its axes in the other order."""
    model = configured().node("stage")
    B, C = np.reshape(model["structure.B"], (4, 2)), np.reshape(model["structure.C"], (2, 4))
    M = np.reshape(model["decoupling"], (2, 2))
    values = {
        "axes": ["y", "x"],
        "structure__B": tuple(B[:, ::-1].ravel()),
        "structure__C": tuple(C[::-1].ravel()),
        "decoupling": tuple(M[::-1, ::-1].ravel()),
    }
    return stage(stage=values, **overrides)


def test_a_permutation_of_the_axes_permutes_the_run_bit_for_bit():
    one, other = stage(), permuted_stage()
    first, second = (each.run(each.default_setpoints(1500)) for each in (one, other))
    assert list(second) == ["y", "x"]
    for name in "xy":
        assert_same_bits(first[name], second[name])


@pytest.mark.parametrize("feeds", [False, True], ids=["feedback", "feedforward"])
def test_a_run_in_pieces_and_a_run_after_a_reset_have_the_bits_of_the_run(feeds):
    one = stage(**(fed() if feeds else {}))
    setpoints = one.default_setpoints(900)
    whole = one.run(setpoints)
    one.reset()
    assert not np.any(one.group.commands), "a command that is missing in the first sample counts as 0 again"
    pieces = [
        one.run({name: values[part] for name, values in setpoints.items()}) for part in (slice(400), slice(400, 900))
    ]
    for name in "xy":
        assert_same_bits(pieces[0][name], {key: values[:400] for key, values in whole[name].items()})
        assert_same_bits(pieces[1][name], {key: values[400:] for key, values in whole[name].items()})


@pytest.mark.parametrize(("place", "frequency"), [(0, 700.0), (1, 800.0)])
def test_a_blow_rings_at_the_mode_of_its_axis_and_dies_out_with_its_damping(place, frequency):
    one = linear_stage(decoupling=[])
    voltages = np.zeros((8192, 2))
    voltages[1, place] = 50.0
    found = driven(one, voltages)[:, place]
    size = np.abs(np.fft.rfft(found[2:] * np.hanning(len(found) - 2), 2**18))
    measured = np.argmax(size) / 2**18 / SAMPLE_TIME
    assert measured == pytest.approx(frequency, rel=2e-3)
    # the energy falls by exp(-2 ζ ω t): between windows that are 20 ms apart
    early, late = (np.sum(found[first : first + 200] ** 2) for first in (100, 300))
    assert late / early == pytest.approx(np.exp(-2.0 * 0.01 * 2.0 * np.pi * frequency * 0.02), rel=0.03)


def test_frequency_response_of_the_running_stage_is_that_of_its_structure():
    one = linear_stage(decoupling=[])
    voltages = np.zeros((16384, 2))
    voltages[1, 0] = 50.0
    found = np.fft.rfft(driven(one, voltages), axis=0)
    angles = 2.0 * np.pi * np.arange(len(found)) / len(voltages)
    model = one.parameters.stage.structure.linear.response(np.exp(1j * angles))[:, :, 0]
    expected = 20e-6 * model * np.exp(-1j * angles)[:, None]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.max(np.abs(expected)))


def blown(one: Stage, volts: float, place: int = 0) -> float:
    """Return the frequency [Hz] at which an axis rings after a short pulse, with both actuators at 30 V."""
    voltages = np.full((6096, 2), 30.0)
    voltages[:2000] *= 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 2000)))[:, None]
    still = driven(one, voltages)
    one.reset()
    voltages[4000:4007, place] += volts
    moved = (driven(one, voltages) - still)[4010:4266, place]
    size = np.abs(np.fft.rfft((moved - moved.mean()) * np.hanning(len(moved)), 2**18))
    return float(np.argmax(size) / 2**18 / SAMPLE_TIME)


def test_modes_shift_with_the_level_when_the_hysteresis_is_inside_the_structure():
    structure = internal_structure()
    one = internal_stage(structure)
    low, high = (
        np.sort(np.abs(np.angle(model.poles)))[0] / (2.0 * np.pi * SAMPLE_TIME)
        for model in (structure.small, structure.large)
    )
    assert abs(high - low) > 20.0
    found = []
    for volts in (0.02, 10.0, 60.0):
        one.reset()
        found.append(blown(one, volts))
    # plays with a radius above 0 do not move in small motions; with large ones the stage approaches the sliding plays
    assert found[0] == pytest.approx(low, rel=2e-3)
    assert low < found[1] < found[2] < high
    assert found[2] - found[0] > 5.0


def test_modes_do_not_shift_when_the_hysteresis_is_in_front_of_the_structure():
    plant = {**LINEAR["plant_simulator"], "hysteresis__type": "prandtl_ishlinskii"}
    one = stage(**{**LINEAR, "plant_simulator": plant}, stage={"decoupling": []})
    found = []
    for volts in (0.5, 10.0, 60.0):
        one.reset()
        found.append(blown(one, volts))
    np.testing.assert_allclose(found, 700.0, rtol=2e-3)


def test_hysteresis_inside_the_structure_remembers_its_return_points():
    one = internal_stage()

    def ramp(first, last):
        return first + (last - first) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 3000)))

    legs = [ramp(0.0, 60.0), ramp(60.0, 20.0), ramp(20.0, 45.0), ramp(45.0, 20.0), ramp(20.0, 60.0), ramp(60.0, 20.0)]
    x = driven(one, np.column_stack([np.concatenate(legs)] * 2))[:, 0]
    ends = x[np.arange(1, 7) * 3000 - 1]
    stroke = np.ptp(x)
    # the inner loop closes at its reversal point, and the earlier curve continues as if there had been no inner loop
    assert ends[3] == pytest.approx(ends[1], abs=1e-4 * stroke)
    assert ends[5] == pytest.approx(ends[1], abs=1e-4 * stroke)
    assert ends[4] == pytest.approx(ends[0], abs=1e-4 * stroke)
    up, down = x[9000 - 1500], x[12000 - 1500]
    assert abs(up - down) > 1e-3 * stroke


def test_readings_become_degrees_of_freedom():
    tip = [0.5, 0.5, 1.0, -1.0]  # mean and difference of two sensors
    noisy = LINEAR | {"plant_simulator": LINEAR["plant_simulator"] | {"sensor__noise": 1e-8}}
    plain, turned = (stage(**noisy, stage={"decoupling": [], **own}) for own in ({}, {"sensor_matrix": tip}))
    setpoints = {"x": np.full(300, 4e-6), "y": np.full(300, 1e-6)}
    one, other = plain.run(setpoints), turned.run(setpoints)
    assert np.std(one["x"]["measured"] - one["x"]["displacement"]) > 1e-9
    for name in ("displacement", "measured"):
        expected = np.reshape(tip, (2, 2)) @ [one["x"][name], one["y"][name]]
        np.testing.assert_allclose([other["x"][name], other["y"][name]], expected, atol=1e-18)
    low, high = plain.parameters.travel(), turned.parameters.travel()
    assert np.all(np.isinf(low)) and np.all(np.isinf(high))  # overtravel: -1


def test_the_allowed_travel_is_that_of_the_degrees_of_freedom():
    one = linear_stage(decoupling=[]).parameters
    axes = tuple(replace(axis, plant_simulator=replace(axis.plant_simulator, overtravel=1e-6)) for axis in one.axes)
    # 40 µm of its own actuator, and 4 % of the other actuator
    np.testing.assert_allclose(replace(one, axes=axes).travel(), [[-1e-6, 42.6e-6]] * 2, rtol=1e-9)
    # a preload moves the zero of its own sensor
    plant = replace(axes[0].plant_simulator, preload=replace(axes[0].plant_simulator.preload, A1=3e-6))
    loaded = replace(one, axes=(replace(axes[0], plant_simulator=plant), axes[1]))
    np.testing.assert_allclose(loaded.travel(), [[2e-6, 45.6e-6], [-1e-6, 42.6e-6]], rtol=1e-9)


def test_an_axis_that_leaves_its_range_stops_the_whole_stage():
    plant = {**LINEAR["plant_simulator"], "overtravel": 1e-6, "safe_slew_rate": 1e5}
    one = stage(**{**LINEAR, "plant_simulator": plant})
    setpoints = {name: np.full(3000, 10e-6) for name in "xy"}
    setpoints["x"][300:] = np.where(np.arange(2700) % 14 < 7, 40e-6, 0.0)  # drives the mode at 714 Hz
    found = one.run(setpoints)
    first = int(np.flatnonzero(found["x"]["tripped"])[0])
    assert first > 300
    assert set(found["x"]["tripped"][first:]) == {BEYOND_TRAVEL}
    assert found["y"]["tripped"][first] == PARTNER_LOST
    assert np.all(found["y"]["tripped"][first:])
    assert not found["y"]["tripped"][:first].any()
    for name in "xy":
        assert found[name]["plant_voltage"][-1] == 0.0
    one.start()
    assert not one.run({name: np.zeros(5) for name in "xy"})["y"]["tripped"].any()


def test_a_fault_of_one_axis_leaves_the_others_in_control():
    parameters = StageParameters.from_configuration(configured())
    one = Stage(parameters.with_faults("y", ("stale:0.05:0.02",)))
    found = one.run(one.default_setpoints(1000))
    np.testing.assert_array_equal(np.flatnonzero(found["y"]["controller_mode"]), np.arange(500, 700))
    assert not found["x"]["controller_mode"].any()
    error = found["x"]["reference"] - found["x"]["displacement"]
    assert np.max(np.abs(error[500:])) < 0.5e-6


@pytest.mark.parametrize("by_user", [False, True])
def test_a_stage_that_was_stale_resumes_without_what_a_user_has_stopped(by_user):
    parameters = StageParameters.from_configuration(configured(motion_controller={"measurement_timeout": 2e-3}))
    one = Stage(parameters.with_faults("y", ("stale:0.02:0.01",)))
    changes = {"x": [Change(100, "motion_controller", "stop")]} if by_user else None
    found = one.run(one.default_setpoints(600), changes)
    mode = found["x"]["controller_mode"]
    # stale 2 ms after the last measurement of y, and x with it from the next sample on
    np.testing.assert_array_equal(np.flatnonzero(found["y"]["controller_mode"] == STALE), np.arange(219, 300))
    assert set(mode[230:300]) == {STOPPED} and set(mode[310:]) == {STOPPED if by_user else RUNNING}
    assert set(found["y"]["controller_mode"][310:]) == {RUNNING}


def test_a_change_of_one_axis_takes_effect_at_its_sample():
    one = stage()
    setpoints = one.default_setpoints(600)
    plain = one.run(setpoints)
    one.reset()
    changed = one.run(setpoints, {"y": [Change(300, "motion_controller", "retune", {"pid.Ki": 0.0})]})
    for name in ("x", "y"):
        np.testing.assert_array_equal(bits(changed[name]["command"][:300]), bits(plain[name]["command"][:300]))
    assert changed["y"]["command"][-1] != plain["y"]["command"][-1]
    with pytest.raises(ConfigurationError, match="takes effect within sample 5"):
        one.run(setpoints, {"y": [Change(5, "motion_controller", "stop", after="measured")]})


def test_changes_of_several_axes_take_effect_in_the_order_of_their_samples():
    """Samples count from the beginning of the first of three runs."""
    one, samples = stage(), {"x": 40, "y": 20}
    changes = {name: [Change(30 + sample, "motion_controller", "stop")] for name, sample in samples.items()}
    for count in (10, 20):
        one.run(one.default_setpoints(count))
    found = one.run(one.default_setpoints(60), changes)
    assert found["x"]["time"][0] == pytest.approx(30 * SAMPLE_TIME)
    for name, sample in samples.items():
        assert np.flatnonzero(found[name]["controller_mode"] == STOPPED)[0] == sample


def test_a_controller_that_stopped_with_its_stage_returns_and_one_that_a_user_stopped_does_not():
    own = np.zeros(32)
    hold_with_stage(own, 1.0)
    assert own[STOP] == WITH_STAGE and own[RETURNING] == 0.0
    hold_with_stage(own, 0.0)
    assert own[STOP] == 0.0 and own[RETURNING] == 1.0
    own[:] = 0.0
    own[STOP] = 1.0
    for held in (1.0, 0.0):
        hold_with_stage(own, held)
        assert own[STOP] == 1.0 and own[RETURNING] == 0.0


def test_each_plant_trips_at_the_travel_of_its_own_axis():
    one = stage()
    travel = one.parameters.travel()
    assert abs(travel[0][1] - travel[1][1]) > 1e-6
    for plant, own in zip(one.plants, travel, strict=True):
        assert plant.travel == tuple(own)


def test_setpoints_go_by_the_names_of_all_axes():
    one = stage()
    with pytest.raises(ConfigurationError, match="setpoints are given for x: give them for x, y"):
        one.run({"x": np.zeros(5)})
    with pytest.raises(ConfigurationError, match="different lengths"):
        one.run({"x": np.zeros(5), "y": np.zeros(6)})


@pytest.mark.slow
def test_decoupling_takes_most_of_the_coupling_error_away_and_noise_is_none():
    with_, without = (
        StageParameters.from_configuration(configured(stage=values)) for values in ({}, {"decoupling": []})
    )
    quiet = StageParameters.from_configuration(configured(plant_simulator={"sensor__noise": 0.0}))
    (error,) = coupling_errors(with_, 0.2)
    assert (error.scanning, error.held) == ("x", "y")
    assert error.scanned == pytest.approx(16e-6, rel=0.01)
    assert coupling_errors(without, 0.2)[0].rms > 5.0 * error.rms
    # there are 5 nm of noise; the coupling found is less than 1 nm
    assert error.rms < 1e-9
    assert coupling_errors(quiet, 0.2)[0].rms == pytest.approx(error.rms, rel=0.3)


@pytest.mark.parametrize("build", [linear_stage, internal_stage])
def test_a_stage_whose_range_is_not_around_zero_begins_at_rest(build):
    values = {"limits__minimum": 20.0, "safe_voltage": 20.0}
    volts = np.full((200, 2), 20.0)
    volts[100:, 0] = 21.0
    found = driven(build(decoupling=[], nodes=values), volts)
    assert found[0, 0] > 5e-6
    assert np.ptp(found[:100], axis=0) == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(found[100:, 0]) > 1e-7


def test_before_the_first_sample_a_preloaded_stage_is_where_the_first_sample_finds_it():
    volts = {"limits__minimum": 20.0, "safe_voltage": 20.0}
    one = linear_stage(nodes=volts, decoupling=[]).parameters
    plants = [axis.plant_simulator for axis in one.axes]
    plants = [
        replace(plant, preload=replace(plant.preload, A1=3e-6), sensor=replace(plant.sensor, offset=2e-6))
        for plant in plants
    ]
    axes = tuple(replace(axis, plant_simulator=plant) for axis, plant in zip(one.axes, plants, strict=True))
    one = Stage(replace(one, axes=axes))
    before = [plant.actuator.displacement for plant in one.plants]
    read = [float(plant.actuator.xs.sensor[MEASURED]) for plant in one.plants]
    assert read == pytest.approx([place + 2e-6 for place in before], rel=1e-12)
    found = one.run({name: np.full(3, 20e-6) for name in "xy"})
    assert before == [found[name]["displacement"][0] for name in "xy"] == pytest.approx([11.3e-6] * 2, rel=0.03)


def test_the_last_setpoint_of_a_run_is_held():
    parameters = linear_stage().parameters
    given = {"x": [1e-6, 2e-6, 3e-6], "y": [5e-6]}
    for duration, count in ((None, 3), (6 * SAMPLE_TIME, 6), (2 * SAMPLE_TIME, 2)):
        run = simulate_stage(parameters, setpoints=given, duration=duration)
        np.testing.assert_array_equal(run["x/setpoint"], [1e-6, 2e-6, *[3e-6] * 4][:count])
        np.testing.assert_array_equal(run["y/setpoint"], [5e-6] * count)


def test_rows_are_those_of_a_single_axis():
    found = stage().run({name: np.zeros(2) for name in "xy"})
    assert list(found["x"]) == ["time", *(signal.name for signal in at.ACTUATOR.row)]
    assert as_values(internal_structure())["structure__inputs"] == 2


def test_a_run_of_a_stage_is_as_long_as_that_of_its_longest_axis():
    scans = {"waveform__type": "triangle", "waveform__frequency": 50.0, "waveform__cycles": 2}
    holds = {"waveform__type": "hold"}
    for x, y in ((scans, holds), (holds, scans), (scans, scans | {"waveform__cycles": 1})):
        assert stage(x__reference_generator=x, y__reference_generator=y).default_samples() == 400


def test_pulses_of_a_recorded_stage_are_repeated():
    steps = {"triggers__input__action": "step", "triggers__input__distance": 1e-6}
    own = {"reference_generator": LINEAR.get("reference_generator", {}) | steps}
    parameters = stage(**LINEAR | own).parameters
    pulses = np.zeros(60)
    pulses[[20, 40]] = 1.0
    run = simulate_stage(parameters, setpoints={name: np.full(60, 2e-6) for name in "xy"}, pulses={"x": pulses})
    assert np.ptp(run["x/reference"]) > 0.5e-6 and not stage_differences(run, parameters)
