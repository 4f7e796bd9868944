# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters as used in ROS: dumped and loaded, on the command line, described with their ranges."""

from __future__ import annotations

import sys

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode  # noqa: E402
from hysteresis_ros.nodes.parameters import assigned  # noqa: E402
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode  # noqa: E402
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode  # noqa: E402


def set_(node, **values):
    return node.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])


def dumped(node) -> list[Parameter]:
    """Return the output of ``ros2 param dump`` as ``--params-file`` reads it: [] is nothing, 1e-6 is a text."""
    found = node.get_parameters(node.list_parameters([], 0).names)
    own = [one for one in found if one.name not in ("use_sim_time", "start_type_description_service")]
    return [Parameter(one.name, value=one.value or None if one.value == [] else one.value) for one in own]


def test_what_is_dumped_is_taken_back_at_the_start_and_live(inside):
    node = inside.add(HysteresisCompensatorNode, axis_parameters().hysteresis_compensator)
    names = node.list_parameters([], 0).names
    assert "hysteresis.duhem.alpha" not in names  # a parameter without a value is not dumped
    assert all(one.type_ != Parameter.Type.NOT_SET for one in node.get_parameters(names))
    given = dumped(node)
    again = HysteresisCompensatorNode(context=inside.context, parameter_overrides=given)
    inside.nodes.append(again)
    assert again.configure_now(), again.failure
    assert again.parameters == node.parameters
    for one in given:  # as `ros2 param load` does, one by one
        if one.value is not None:
            text = f"{one.value:g}" if isinstance(one.value, float) and 0.0 < abs(one.value) < 1e-4 else one.value
            result = node.set_parameters([Parameter(one.name, value=text)])[0]
            assert result.successful, result.reason
    assert again.parameters == node.parameters


def test_whole_numbers_and_numbers_in_words_are_doubles_where_doubles_are_wanted(inside):
    node = inside.add(HysteresisCompensatorNode, axis_parameters().hysteresis_compensator)
    for value, wanted in ((1, 1.0), ("2.5e-1", 0.25)):
        assert set_(node, **{"command_timeout": value}).successful
        stored = node.get_parameter("command_timeout")
        assert (stored.type_, stored.value) == (Parameter.Type.DOUBLE, wanted)
        assert node.parameters.command_timeout == wanted
    refused = set_(node, **{"command_timeout": "often"})
    assert not refused.successful and "'often'" in refused.reason and "double" in refused.reason


def test_what_is_fixed_stays_until_the_node_is_cleaned_up(inside):
    node = inside.add(ReferenceGeneratorNode, axis_parameters().reference_generator)
    rate = node.parameters.sample_rate
    assert set_(node, sample_rate=rate).successful
    refused = set_(node, sample_rate=2.0 * rate)
    assert not refused.successful and f"{rate}" in refused.reason and "cleanup" in refused.reason
    assert node.get_parameter("sample_rate").value == rate
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert set_(node, sample_rate=2.0 * rate).successful
    assert node.configure_now() and node.parameters.sample_rate == 2.0 * rate


def test_ranges_are_described_and_refused_in_words(inside):
    node = inside.add(ReferenceGeneratorNode, axis_parameters().reference_generator)
    rows = {row.name: row for row in node.interface._cls.table()}
    for name, row in rows.items():
        told = node.describe_parameter(name)
        ranges = list(told.floating_point_range) + list(told.integer_range)
        ends = {float: (-sys.float_info.max, sys.float_info.max), int: (-(2**63), 2**63 - 1)}.get(
            row.type, (None, None)
        )
        found = tuple(end if own is None else own for own, end in zip((row.low, row.high), ends, strict=True))
        bounded = row.type in (float, int) and (row.low is not None or row.high is not None)
        assert [(one.from_value, one.to_value) for one in ranges] == ([found] if bounded else []), name
        if name != "use_sim_time":
            assert told.read_only == row.read_only and told.type != 0
    refused = set_(node, **{"waveform.frequency": -1.0})
    assert not refused.successful and "allowed" in refused.reason


@pytest.mark.parametrize("cls", [HysteresisCompensatorNode, PlantSimulatorNode])
def test_limits_of_the_voltage_are_narrowed_live_and_widened_at_the_start_only(inside, cls):
    """They protect the connected device; a typing error on the command line must not remove the protection."""
    name = "hysteresis_compensator" if cls is HysteresisCompensatorNode else "plant_simulator"
    given = {"limits__minimum": -30.0, "limits__maximum": 90.0, "limits__slew_rate": 500.0, "safe_slew_rate": 200.0}
    node = inside.add(cls, getattr(axis_parameters(overrides={name: given}), name), autostart=False)
    assert node.configure_now()
    refused = set_(node, **{"limits.maximum": 10000.0})
    assert not refused.successful and "beyond its start value of 90 V" in refused.reason
    refused = set_(node, **{"limits.slew_rate": 0.0})  # unlimited
    assert not refused.successful and "beyond its start value of 500 V/s" in refused.reason
    for limit, value in (("limits.minimum", -30.1), ("limits.slew_rate", 500.1), ("safe_slew_rate", 200.1)):
        assert not set_(node, **{limit: value}).successful, limit
    narrow = {"limits.minimum": 0.0, "limits.maximum": 50.0, "limits.slew_rate": 100.0, "safe_slew_rate": 50.0}
    for values in (narrow, {key.replace("__", "."): value for key, value in given.items()}):
        for limit, value in values.items():
            assert set_(node, **{limit: value}).successful, limit
            assert node.get_parameter(limit).value == value


def test_what_has_no_slew_rate_at_its_start_takes_any_live(inside):
    given = axis_parameters(overrides={"hysteresis_compensator": {"limits__slew_rate": 0.0}}).hysteresis_compensator
    node = inside.add(HysteresisCompensatorNode, given)
    for value in (500.0, 1000.0, 0.0):
        assert set_(node, **{"limits.slew_rate": value}).successful


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["-p", "a:=1e-6"], {"a": 1e-6}),
        (["-p", "a:=1", "--param", "a:=2"], {"a": 2}),
        (["-p", "it:a:=x", "-p", "/left/it:b:=[1, 2e-3]", "-p", "other:c:=1"], {"a": "x", "b": [1, 2e-3]}),
        (["-p", "a:=true", "--", "-p", "b:=1"], {"a": True}),
    ],
)
def test_values_of_the_command_line(words, wanted):
    assert assigned("it", "/left/it", ["program", "-p", "no:randomly", "--ros-args", *words]) == wanted


def test_the_command_line_wins_over_sections_of_files(inside, monkeypatch):
    parameters = axis_parameters(overrides={"reference_generator": {"initial_setpoint": 2e-6}}).reference_generator
    words = ["program", "--ros-args", "-p", "initial_setpoint:=1e-6", "-p", "motion_controller:handover_time:=0.7"]
    monkeypatch.setattr(sys, "argv", words)
    assert inside.add(ReferenceGeneratorNode, parameters).parameters.initial_setpoint == 1e-6
