# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Allowed contents of a stage's file, and the messages for refused ones."""

from __future__ import annotations

import numpy as np
import pytest
from coupled_stages import as_values, configured, internal_structure

from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.errors import ConfigurationError, HysteresisError
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import axes, single_axis
from hysteresis_ros.loop.stage_parameters import StageParameters


def read(**overrides) -> StageParameters:
    return StageParameters.from_configuration(configured(**overrides))


def refused(**overrides) -> str:
    """Return the message with which a file is refused."""
    with pytest.raises(HysteresisError) as caught:
        read(**overrides)
    return str(caught.value)


MODEL = {name.removeprefix("structure."): values for name, values in configured().node("stage").items()}


def test_the_text_of_a_stage_describes_the_same_stage():
    stage = read()
    assert stage.names == ("x", "y")
    again = StageParameters.from_configuration(parse_configuration(stage.configuration_text(), "the text"))
    assert again == stage


def test_a_stage_may_lie_in_a_namespace():
    text = (
        configured()
        .text.replace("\n/stage:", "\n/lab/stage:")
        .replace("\n/x/", "\n/lab/x/")
        .replace("\n/y/", "\n/lab/y/")
    )
    stage = StageParameters.from_configuration(parse_configuration(text, "the text"))
    assert stage.namespace == "/lab"
    assert [axis.namespace for axis in stage.axes] == ["/lab/x", "/lab/y"]
    assert stage.place("y") == stage.place("/lab/y") == 1


def test_a_file_without_stage_has_none():
    assert load_configuration("kim2009").stage is None
    with pytest.raises(ConfigurationError, match="has no section '/stage', which couples its axes"):
        StageParameters.from_configuration(load_configuration("kim2009"))


@pytest.mark.parametrize("namespace", ["", "/x"])
def test_what_takes_a_single_axis_refuses_a_stage(namespace):
    for call in (axes, single_axis, AxisParameters.from_configuration):
        with pytest.raises(ConfigurationError, match=r"describes a stage of coupled axes.*docs/coupled_axes\.md"):
            call(configured(), namespace)


def test_two_stages_in_a_file_are_refused():
    text = configured().text + "\n/other/stage:\n  ros__parameters:\n    axes: [x]\n"
    with pytest.raises(ConfigurationError, match="two stages, /stage and /other/stage: a file may describe only one"):
        StageParameters.from_configuration(parse_configuration(text, "the text"))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"axes": ["x", "x"]}, "/stage: axes = ('x', 'x'): 'x' is given twice: give each axis its own name"),
        ({"axes": []}, "/stage: axes = (): must name 1 … 16 axes"),
        ({"axes": ["x", "a b"]}, "'a b' is not a valid namespace"),
        ({"axes": ["x", "z"]}, "the stage has no sections of its axis /z"),
        ({"axes": ["x"]}, "structure.inputs = 2: must be 1: each of the axes x has an actuator"),
        ({"structure__A": [0.5]}, "structure.A = (0.5,): must be 16 numbers, as B has 4 rows"),
        ({"structure__B": MODEL["B"][:7]}, "structure.B"),
        ({"structure__C": MODEL["C"][:6]}, "structure.C = (1.0007996"),
        ({"structure__D": [0.0]}, "structure.D = (0.0,): has 1 numbers and must have q·m = 4"),
        (
            {"structure__sample_time": 2e-4},
            "/stage: structure.sample_time = 0.0002: the matrices are for this sample time",
        ),
        ({"sensor_matrix": [1.0, 0.0]}, "sensor_matrix = (1.0, 0.0): has 2 numbers and must have 2·2 = 4, or be empty"),
        ({"decoupling": [1.0, 0.0, 0.0]}, "decoupling = (1.0, 0.0, 0.0): has 3 numbers and must have 2·2 = 4"),
        ({"sensor_matrix": [1.0, 1.0, 1.0, 1.0]}, "is singular: the direction +0.71 sensor x, -0.71 sensor y is lost"),
        (
            {"decoupling": [1.0, 2.0, 2.0, 4.0]},
            "decoupling = (1.0, 2.0, 2.0, 4.0): is singular: the direction +0.89 x, -0.45 y",
        ),
        ({"structure__radii": [1.0], "structure__weights": [0.1, 0.1]}, "structure.radii = (1.0,): must be empty"),
        ({"type": "internal"}, "structure.radii = (): must have the radii of the plays with type: internal"),
        ({"type": "wiener"}, "type = 'wiener': unknown choice, allowed: string, one of hammerstein, internal"),
        ({"couplings": 1.0}, "/stage: couplings = 1.0: unknown parameter"),
    ],
)
def test_a_wrong_section_is_refused_by_name(values, words):
    assert words in refused(stage=values)


def test_an_unstable_structure_is_refused():
    assert "is unstable" in refused(stage={"structure__A": [1.2 * value for value in MODEL["A"]]})


def test_a_mode_that_nothing_moves_or_shows_is_named():
    B, C = np.reshape(MODEL["B"], (4, 2)).copy(), np.reshape(MODEL["C"], (2, 4)).copy()
    B[2:] = 0.0
    said = refused(stage={"structure__B": tuple(B.ravel().tolist())})
    assert "no actuator excites the mode at 800 Hz" in said and "np.float64" not in said
    C[:, :2] = 0.0
    assert "no sensor observes the mode at 700 Hz" in refused(stage={"structure__C": tuple(C.ravel())})


def test_a_singular_gain_names_the_direction_that_is_lost():
    C = np.reshape(MODEL["C"], (2, 4)).copy()
    C[1] = 2.0 * C[0]
    said = refused(stage={"structure__C": tuple(C.ravel())})
    assert "has a singular static gain: the direction" in said
    gain = C @ np.linalg.solve(np.eye(4) - _full(MODEL["A"]), np.reshape(MODEL["B"], (4, 2)))
    direction = np.linalg.svd(gain)[2][-1]
    assert f"{abs(direction[0]):.2f} actuator x" in said


def _full(blocks) -> np.ndarray:
    full = np.zeros((4, 4))
    full[:2, :2], full[2:, 2:] = np.reshape(blocks, (2, 2, 2))
    return full


@pytest.mark.parametrize(
    ("node", "values", "words"),
    [
        (
            "x__*",
            {"external_plant": True, "time_mode": "realtime"},
            "/x/plant_simulator: external_plant = True: an axis of a stage has a driver, or is simulated: give false",
        ),
        (
            "y__*",
            {"sample_rate": 5000.0},
            "/y/plant_simulator: sample_rate = 5000.0: must equal that of the stage, 10000.0",
        ),
        ("y__*", {"time_mode": "lockstep"}, "/y/plant_simulator: time_mode = 'lockstep': must equal that of the stage"),
        (
            "y__plant_simulator",
            {"real_time_factor": 0.5},
            "/y/plant_simulator: real_time_factor = 0.5: must equal that of /x, 1.0",
        ),
        ("y__plant_simulator", {"realtime__cpu": 1}, "/y/plant_simulator: realtime.cpu = 1: must equal that of /x, -1"),
        ("y__*", {"joint": "x"}, "/y/plant_simulator: joint = 'x': is already the joint of /x"),
        (
            "plant_simulator",
            {"dynamics__A": [0.5], "dynamics__B": [0.5], "dynamics__C": [1.0]},
            "/x/plant_simulator: dynamics.A = (0.5,): must be empty: the structure of the stage",
        ),
        (
            "x__plant_simulator",
            {"force_sensor__stack_stiffness": 1e7, "force_sensor__flexure_stiffness": 1e6},
            "a stage has no force sensors",
        ),
        ("x__plant_simulator", {"limits__minimum": 200.0}, "/x/plant_simulator: limits.minimum = 200.0: must be below"),
        ("y__reference_generator", {"initial_setpoint": 1e-3}, "/y/reference_generator: initial_setpoint = 0.001"),
    ],
)
def test_an_axis_that_does_not_fit_is_refused_by_name(node, values, words):
    assert words in refused(**{node: values})


def test_hysteresis_stands_in_one_place():
    values = {**as_values(internal_structure()), "type": "internal"}
    assert "/x/plant_simulator: hysteresis.type = 'prandtl_ishlinskii': must be proportional" in refused(stage=values)


def test_axes_of_the_file_are_axes_of_the_stage():
    text = configured().text + "\n/z/plant_simulator:\n  ros__parameters:\n    joint: z\n"
    with pytest.raises(ConfigurationError, match="/z is not an axis of the stage: add it to /stage axes"):
        StageParameters.from_configuration(parse_configuration(text, "the text"))


def test_a_misspelled_section_of_a_stage_is_noticed():
    text = configured().text.replace("\n/stage:", "\n/stages:")
    with pytest.raises(ConfigurationError, match="there is no node 'stages'; did you mean stage"):
        parse_configuration(text, "the text")


def test_the_decoupling_of_the_file_is_the_inverse_of_its_static_gain():
    from hysteresis_ros.control.coupling import static_decoupling

    stage = read().stage
    gain = stage.structure.linear.dc_gain
    np.testing.assert_allclose(gain, [[1.0, 0.04], [0.04, 1.0]], atol=1e-9)
    np.testing.assert_allclose(stage.matrix("decoupling"), static_decoupling(gain), rtol=1e-8)
    turns = np.sort(np.abs(np.angle(stage.structure.linear.poles)))[::2] / (2.0 * np.pi)
    np.testing.assert_allclose(turns * 1e4, [700.0, 800.0], rtol=1e-4)


@pytest.mark.parametrize(("maximum", "warned"), [(55e-6, False), (75e-6, True)])
def test_the_range_of_a_setpoint_is_what_the_actuators_reach_together(maximum, warned):
    """Both actuators of 50 µm move the axis x: it reaches 70 µm, and one of them alone 50 µm."""
    shared = np.linalg.inv([[1.0, 0.4], [0.4, 1.0]]).ravel().tolist()
    stage = read(stage={"decoupling": shared}, **{"x/reference_generator": {"maximum": maximum}})
    assert sum("maximum" in text and text.startswith("/x/") for text in stage.warnings()) == warned
