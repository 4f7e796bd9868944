# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The URDF of an axis: one prismatic joint with its name in joint_states and the limits of the configuration."""

from __future__ import annotations

import pathlib
import xml.etree.ElementTree as ET

import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.description import BASE, robot_description
from hysteresis_ros.loop.parameters import AxisParameters

CONFIG = pathlib.Path(__file__).resolve().parents[2] / "config"


def axis(name: str, node: str, **overrides) -> AxisParameters:
    return AxisParameters.from_configuration(load_configuration(CONFIG / f"{name}.yaml").override(node, **overrides))


def joint_of(text: str):
    """Return name, links and limits of the only joint of a URDF; the links form a tree with the base as its root."""
    robot = ET.fromstring(text)
    assert robot.tag == "robot" and robot.get("name")
    (joint,) = robot.findall("joint")
    links = [link.get("name") for link in robot.findall("link")]
    assert joint.get("type") == "prismatic" and joint.find("axis").get("xyz") == "0 0 1"
    assert links == [joint.find("parent").get("link"), joint.find("child").get("link")] and links[0] == BASE
    return joint.get("name"), {name: float(value) for name, value in joint.find("limit").attrib.items()}


def test_the_joint_has_the_name_and_the_range_of_the_axis():
    parameters = axis("kim2009", "reference_generator", approach__maximum_velocity=2.5e-5)
    source = parameters.reference_generator
    name, limits = joint_of(robot_description(source))
    assert name == parameters.plant_simulator.joint == "extender"
    assert limits == {"lower": source.minimum, "upper": source.maximum, "velocity": 2.5e-5, "effort": 0.0}
    steps = axis("kim2009", "reference_generator").reference_generator
    assert joint_of(robot_description(steps))[1]["velocity"] == pytest.approx(12e-6 * 3000.0)


def test_the_slider_of_a_motor_has_its_travel_and_the_speed_it_may_be_asked_for():
    parameters = axis("inchworm_travel", "inchworm_sequencer")
    source = parameters.inchworm_sequencer
    name, limits = joint_of(robot_description(source))
    assert name == parameters.plant_simulator.joint == "slider"
    assert (limits["lower"], limits["upper"]) == (source.minimum, source.maximum)
    assert source.refuse_speed(limits["velocity"]) is None
    assert source.refuse_speed(1.01 * limits["velocity"])


def test_the_command_prints_it_and_refuses_what_is_no_configuration():
    printed = CliRunner().invoke(main, ["urdf", "kim2009"])
    assert printed.exit_code == 0, printed.output
    assert printed.output == robot_description(axis("kim2009", "reference_generator").reference_generator)
    wrong = CliRunner().invoke(main, ["urdf", "no_such_axis"])
    assert wrong.exit_code == 2 and "no_such_axis" in wrong.output
