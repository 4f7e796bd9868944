# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameter files: read as by ROS, and refused with the place of the error."""

import itertools
import math
import re

import numpy as np
import pytest

from hysteresis_ros.configuration import (
    KNOWN_NAMES,
    config_path,
    dump_configuration,
    load_configuration,
    matches,
    parse_configuration,
)
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import axes


@pytest.mark.parametrize(
    ("pattern", "name", "expected"),
    [
        ("/**", "/plant_simulator", True),
        ("/**", "/left/plant_simulator", True),
        ("/**/plant_simulator", "/plant_simulator", True),
        ("/**/plant_simulator", "/a/b/plant_simulator", True),
        ("/**/plant_simulator", "/a/plant_simulator_2", False),
        ("/*/plant_simulator", "/left/plant_simulator", True),
        ("/*/plant_simulator", "/plant_simulator", False),
        ("plant_simulator", "/plant_simulator", True),
        ("plant_simulator", "/left/plant_simulator", False),
        ("/left/plant_simulator", "/left/plant_simulator", True),
    ],
)
def test_patterns_match_node_names_as_in_ros(pattern, name, expected):
    assert matches(pattern, name) is expected


def test_later_entries_win_and_groups_are_flattened():
    text = """
/**: {ros__parameters: {sample_rate: 1000.0, limits: {bits: 8}}}
/**/plant_simulator: {ros__parameters: {limits: {bits: 16, minimum: -30.0}}}
"""
    values = parse_configuration(text, "file").node("plant_simulator", "left")
    assert values == {"sample_rate": 1000.0, "limits.bits": 16, "limits.minimum": -30.0}


@pytest.mark.parametrize(
    ("node", "said"),
    [
        ("motion_controler", "there is no node 'motion_controler'; did you mean motion_controller?"),
        ("x/plant_simulatr", "there is no node 'plant_simulatr'; did you mean plant_simulator?"),
        ("qqq", "there is no node 'qqq'; there are plant_simulator, "),
        ("/y/motion_controller", "there is no node '/y/motion_controller'; there are /motion_controller"),
    ],
)
def test_a_change_of_an_unknown_node_is_refused(node, said):
    with pytest.raises(ConfigurationError, match=re.escape(said)):
        load_configuration("kim2009").override(node, type="open_loop")


def test_a_change_may_be_of_all_nodes_of_a_namespace_and_of_a_section_of_the_file():
    given = parse_configuration(load_configuration("kim2009").text + "/notes: {ros__parameters: {a: 1}}\n", "file")
    for node in ("", "**", "left/plant_simulator", "recorder", "stage", "notes"):
        assert given.override(node, a=2).entries[-1][1] == {"a": 2}


@pytest.mark.parametrize("name", ["kim2009", "xy_scanner", "inchworm_travel"])
def test_the_text_of_a_changed_configuration_has_its_present_values(name, tmp_path):
    given = load_configuration(name)
    assert given.text == given.original == config_path(name).read_text(encoding="utf-8")
    changed = given.override("", sample_rate=np.float64(2e4)).override("plant_simulator", sensor__noise=7e-9)
    changed = changed.override("x/reference_generator", minimum=-1e-6, further=np.array([1.0, 2.0]))
    changed.save(tmp_path / "changed.yaml")
    again = load_configuration(tmp_path / "changed.yaml")
    for node, space in itertools.product(KNOWN_NAMES, ("", *given.namespaces())):
        expected = {
            key: list(v) if np.iterable(v) and not isinstance(v, str) else v
            for key, v in changed.node(node, space).items()
        }
        assert again.node(node, space) == expected
    assert again.node("plant_simulator", "x")["sensor.noise"] == 7e-9


def test_a_change_that_a_later_section_would_hide_is_not_written():
    text = "/**/plant_simulator: {ros__parameters: {a: 1}}\n/**: {ros__parameters: {a: 2}}\n"
    changed = parse_configuration(text, "file").override("plant_simulator", a=3)
    with pytest.raises(ConfigurationError, match="changed values of plant_simulator cannot be written"):
        changed.text  # noqa: B018


def test_a_parameter_file_is_written_as_yaml_only(tmp_path):
    with pytest.raises(ConfigurationError, match=r"must end in .yaml or .yml"):
        load_configuration("kim2009").save(tmp_path / "axis.json")


def test_numbers_are_read_as_the_ros_parser_reads_them():
    text = "n: {ros__parameters: {a: 5e-6, b: 1.0e3, c: 3, d: [1e-7, .5], e: 'x', f: true, g: -2., h: 1e5x}}"
    values = parse_configuration(text, "file").node("n")
    assert values == {"a": 5e-6, "b": 1e3, "c": 3, "d": [1e-7, 0.5], "e": "x", "f": True, "g": -2.0, "h": "1e5x"}
    assert isinstance(values["a"], float) and isinstance(values["c"], int)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty"),
        ("- 1", "empty"),
        ("a: [", "not readable as YAML"),
        ("a: 1", "must hold 'ros__parameters'"),
        ("a: {ros__parameters: 3}", "must be a mapping"),
        ("a: {b: {}}", "no 'ros__parameters'"),
        ("/**/motion_controler: {ros__parameters: {a: 1}}", "did you mean motion_controller?"),
        ("a: {ros__parameters: &x {b: 1}}\nc: {ros__parameters: *x}", "line 2: ROS 2 does not read YAML aliases"),
    ],
)
def test_what_is_no_parameter_file_is_refused_by_name(text, said):
    with pytest.raises(ConfigurationError, match=r"^f\.yaml: ") as refusal:
        parse_configuration(text, "f.yaml")
    assert said in str(refusal.value)


def test_missing_and_unreadable_files_are_named(tmp_path):
    with pytest.raises(ConfigurationError, match="none.yaml: no such file"):
        load_configuration(tmp_path / "none.yaml")
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigurationError, match="binary.yaml: is not a text in UTF-8"):
        load_configuration(binary)
    run, bag = tmp_path / "run.npz", tmp_path / "bag"
    run.write_bytes(b"\xff\xfe\x00")
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    for recording in (run, bag):
        with pytest.raises(ConfigurationError, match=f"{recording.name}: is a recording, not a parameter file; give"):
            load_configuration(recording)
    with pytest.raises(ConfigurationError, match="no configuration 'nothing'.*kim2009"):
        config_path("nothing")


def test_written_parameters_come_back_bit_for_bit():
    axis = axes(load_configuration("kim2009"))[0]
    again = axes(parse_configuration(axis.configuration_text(), "text"))[0]
    assert again == axis
    awkward = {"/n": {"x.y": 0.1 + 0.2, "x.z": 1e22, "b": (5e-324, -1.7976931348623157e308)}}
    assert parse_configuration(dump_configuration(awkward), "t").node("n") == {
        "x.y": 0.1 + 0.2,
        "x.z": 1e22,
        "b": [5e-324, -1.7976931348623157e308],
    }


def test_one_array_in_two_places_is_written_out_twice():
    shared = (1.0, 2.0)
    text = dump_configuration({"/a": {"x": shared}, "/b": {"y": shared, "z": shared}})
    assert "*" not in text and "&" not in text
    assert parse_configuration(text, "t").node("b") == {"y": [1.0, 2.0], "z": [1.0, 2.0]}


def test_all_wrong_parameters_are_named_together():
    configuration = load_configuration("kim2009")
    configuration = configuration.override("plant_simulator", limits__bits=99, sensor__noyse=1.0)
    configuration = configuration.override("motion_controller", type="magic", sliding_mode__eta="much")
    with pytest.raises(ParameterError) as refusal:
        AxisParameters.from_configuration(configuration)
    named = {problem.name: str(problem) for problem in refusal.value.problems}
    assert set(named) == {
        "plant_simulator: limits.bits",
        "plant_simulator: sensor.noyse",
        "motion_controller: type",
        "motion_controller: sliding_mode.eta",
    }
    assert "0 … 32" in named["plant_simulator: limits.bits"]
    assert "did you mean plant_simulator: sensor.noise" in named["plant_simulator: sensor.noyse"]
    assert "open_loop, pid, sliding_mode" in named["motion_controller: type"]
    assert "double" in named["motion_controller: sliding_mode.eta"]


def test_a_missing_parameter_is_named_with_what_it_must_be():
    plant = "{limits: {minimum: 0.0, maximum: 100.0}, hysteresis: {type: proportional}}"
    text = f"/**/plant_simulator: {{ros__parameters: {plant}}}"
    with pytest.raises(ParameterError) as refusal:
        AxisParameters.from_configuration(parse_configuration(text, "f"))
    assert "plant_simulator: hysteresis.proportional.gain = None: missing; give a double" in str(refusal.value)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_refused(value):
    configuration = load_configuration("kim2009").override("plant_simulator", preload__force=value)
    with pytest.raises(ParameterError, match="preload.force.*must be finite"):
        axes(configuration)


def test_nodes_that_disagree_about_the_rate_are_refused():
    configuration = load_configuration("kim2009").override("motion_controller", sample_rate=1000.0)
    with pytest.raises(ParameterError, match=r"motion_controller: sample_rate = 1000.0: must equal .* 3000.0"):
        axes(configuration)


def test_axes_are_found_by_the_namespaces_that_the_file_names():
    base = load_configuration("kim2009")
    left = "/left/plant_simulator: {ros__parameters: {publish_clock: true}}"
    both = f"{base.text}\n{left}\n/right/plant_simulator: {{ros__parameters: {{}}}}\n"
    configuration = parse_configuration(both, "both.yaml")
    assert [axis.namespace for axis in axes(configuration)] == ["/left", "/right"]
    assert [axis.namespace for axis in axes(base)] == [""]
    two_clocks = configuration.override("plant_simulator", publish_clock=True)
    with pytest.raises(ConfigurationError, match="/left and /right both set publish_clock"):
        axes(two_clocks)


def test_a_driver_is_found_beside_the_file_that_names_it(tmp_path):
    text = "/**/plant_simulator:\n  ros__parameters: {{driver: {driver}}}\n"
    (tmp_path / "drivers").mkdir()
    (tmp_path / "drivers" / "mine.py").write_text("")
    file = tmp_path / "axis.yaml"
    for driver, found in (
        ("./drivers/mine.py", str(tmp_path / "drivers" / "mine.py")),
        ("drivers/other.py", str(tmp_path / "drivers" / "other.py")),  # reported as missing there
        (str(tmp_path / "drivers" / "mine.py"), str(tmp_path / "drivers" / "mine.py")),
        ("simulated", "simulated"),
    ):
        file.write_text(text.format(driver=driver))
        assert load_configuration(file).node("plant_simulator")["driver"] == found


@pytest.mark.parametrize(
    ("node", "changed"),
    [
        ("x/reference_generator", (True, False)),
        ("/x/reference_generator", (True, False)),
        ("/x/*", (True, False)),
        ("/**/reference_generator", (True, True)),
        ("reference_generator", (True, True)),
        ("/**", (True, True)),
    ],
)
def test_a_change_names_a_node_as_a_section_of_a_file_does(node, changed):
    configuration = load_configuration("xy_scanner").override(node, waveform__amplitude=1e-6)
    for one in (configuration, parse_configuration(configuration.text, "the text")):
        values = [one.node("reference_generator", axis)["waveform.amplitude"] == 1e-6 for axis in ("/x", "/y")]
        assert tuple(values) == changed
