# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Files named over the graph must be in stated folders; files given at the start of a node are not restricted."""

from __future__ import annotations

import os
import pathlib

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from hysteresis_ros.hardware.registry import DRIVERS  # noqa: E402
from hysteresis_ros.laboratory.epics.server_process import interfaces  # noqa: E402
from hysteresis_ros.loop.parameters import NODE_PARAMETERS  # noqa: E402
from hysteresis_ros.nodes import parameters as places  # noqa: E402
from hysteresis_ros.nodes.domain import LOCALHOST_ONLY, RANGE, stay_on_this_machine  # noqa: E402
from hysteresis_ros.nodes.parameters import FOLDERS, misplaced  # noqa: E402
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode  # noqa: E402
from hysteresis_ros.nodes.recorder import RecorderNode  # noqa: E402

#: Parameters with arbitrary text that is not a path.
NO_PATHS = {"joint", "extender_joint", "force_joint", "faults", "topics", "waveform.file.column", "waveform.scan.kind"}
NO_PATHS |= {"gcs.host", "gcs.identification", "gcs.axis", "gcs.channel", "nv200.host", "nv200.actuator"}
NO_PATHS |= {"iio.output_channel", "iio.input_channel", "calibration.sensor.unit", "calibration.amplifier.unit"}


def row(node: str, name: str):
    return next(row for row in NODE_PARAMETERS[node].table() if row.name == name)


@pytest.fixture
def work(tmp_path, monkeypatch):
    """The folder in which a node is started."""
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.delenv(FOLDERS, raising=False)
    return folder


def test_the_working_folder_is_the_place_where_nothing_else_is_said(work):
    save = row("motion_controller", "learning.save_file")
    (work / "loop").symlink_to("loop")
    (work / "out").symlink_to("..")
    (work / "in").symlink_to(work)
    for allowed in ("learned.yaml", "a/b/learned.yaml", str(work / "learned.yaml"), "in/learned.yaml", "a/../b", ""):
        assert misplaced(save, allowed) is None, allowed
    outside = ["../learned.yaml", "/etc/passwd", "~/.bashrc", "out/learned.yaml", "a/../../x", "in/../../x"]
    for refused in (*outside, ".ssh/authorized_keys", "a/.hidden/x"):
        said = str(misplaced(save, refused))
        assert said.startswith(f"learning.save_file = '{refused}'") and FOLDERS in said, refused
        assert f"must be in {work}" in said
    for refused in ("loop/x", "x\0y", "~nobody-of-that-name/x"):
        assert misplaced(save, refused) is not None


def test_stated_folders_take_its_place(work, monkeypatch, tmp_path):
    save = row("motion_controller", "learning.save_file")
    monkeypatch.setenv(FOLDERS, f"{tmp_path / 'a'}:{tmp_path / '.b'}")
    assert misplaced(save, str(tmp_path / "a" / "x.yaml")) is None
    assert misplaced(save, str(tmp_path / ".b" / "x.yaml")) is None
    assert misplaced(save, "x.yaml") is not None
    assert misplaced(save, str(tmp_path / "ab" / "x.yaml")) is not None
    monkeypatch.setenv(FOLDERS, "")
    assert "must be in nowhere" in str(misplaced(save, "x.yaml"))


def test_a_service_that_is_started_in_the_root_has_no_place(work, monkeypatch):
    monkeypatch.chdir("/")
    assert "must be in nowhere" in str(misplaced(row("recorder", "path"), "tmp/bag"))


def test_code_is_never_named_over_the_graph(work):
    driver = row("plant_simulator", "driver")
    assert misplaced(driver, "gcs") is None and misplaced(driver, "") is None
    assert "may load code" in str(misplaced(driver, "./mine.py"))
    assert "may load code" in str(misplaced(row("plant_simulator", "driver_options"), ["port=/dev/sda"]))


def test_every_text_is_known_to_be_a_path_or_none():
    texts = {
        item.name: item.place
        for table in NODE_PARAMETERS.values()
        for item in table.table()
        if item.type in (str, tuple[str, ...]) and (item.paths or not item.choices)
    }
    assert {name for name, place in texts.items() if not place} == NO_PATHS
    # a scan along a path from a file contains the file's name in its values
    started = {name for name, place in texts.items() if place == "start"}
    assert started == {"driver", "driver_options", "waveform.scan.values"}


def test_a_node_refuses_them_in_any_state_and_keeps_what_it_was_started_with(inside, work, tmp_path):
    given = str(tmp_path / "elsewhere" / "bag")
    parameters = NODE_PARAMETERS["recorder"].from_mapping({"sample_rate": 100.0, "path": given})
    node = inside.add(RecorderNode, parameters, autostart=False)

    def put(**values):
        return node.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])

    for values in (
        {"configuration": "/etc/passwd"},
        {"path": "../bag"},
        {"path": "bag", "configuration": "/etc/passwd"},
    ):
        answer = put(**values)
        assert not answer.successful and FOLDERS in answer.reason, values
    assert node.get_parameter("path").value == given
    assert put(path="bag").successful and put(path=given).successful, "a path given at the start may be given again"
    assert not node.get_parameter("configuration").value


def test_nobody_makes_a_node_load_code_by_cleaning_it_up_first(inside, work):
    node = inside.add(PlantSimulatorNode, axis_parameters().plant_simulator, autostart=False)
    (work / "mine.py").write_text("raise SystemExit('loaded')")
    for value in ("./mine.py", str(work / "mine.py"), "/tmp/mine.so"):
        answer = node.set_parameters_atomically([Parameter("driver", value=value)])
        assert not answer.successful and "set it only in the parameter file or on the command line" in answer.reason
    assert node.get_parameter("driver").value == ""


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "LOCALHOST"),
        ({RANGE: ""}, "LOCALHOST"),
        ({RANGE: "SUBNET"}, "SUBNET"),
        ({RANGE: "OFF"}, "OFF"),
        ({LOCALHOST_ONLY: "0"}, None),
        ({LOCALHOST_ONLY: "1"}, None),
    ],
)
def test_nodes_stay_on_this_machine_unless_something_else_is_said(monkeypatch, given, expected):
    for name in (RANGE, LOCALHOST_ONLY):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    stay_on_this_machine()
    assert os.environ.get(RANGE) == expected


def test_whoever_enters_the_graph_stays_on_this_machine():
    nodes = pathlib.Path(places.__file__).parent
    for path in nodes.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        before, entered, _ = source.partition("rclpy.init(")
        assert not entered or "stay_on_this_machine()" in before, path


def test_servers_listen_on_this_machine_unless_asked(monkeypatch):
    monkeypatch.delenv("EPICS_CAS_INTF_ADDR_LIST", raising=False)
    assert interfaces(None) == ["127.0.0.1"] and interfaces("10.0.0.1") == ["10.0.0.1"]
    hosts = [
        item.default
        for driver in DRIVERS.values()
        if driver.emulated is not None
        for item in driver.emulated.parameters.table()
        if item.name == "host"
    ]
    assert hosts and set(hosts) == {"127.0.0.1"}
