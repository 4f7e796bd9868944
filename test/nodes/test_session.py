# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The session that an axis keeps on the graph, and commands executed by it."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, until, write_axis  # noqa: E402

from hysteresis_ros.nodes.remote.door import address  # noqa: E402

RATE = 50.0


@pytest.fixture
def kept(processes, monkeypatch, tmp_path):
    """A running axis and its session."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(processes.domain))
    axis = axis_parameters(overrides={"plant_simulator": {"late_limit": -1}}, sample_rate=RATE, time_mode="realtime")
    run = processes.command("up", write_axis(tmp_path / "axis.yaml", axis), "--composed")
    until(lambda: _is_there() or run.popen.poll() is not None, what="a session")
    return run


def _is_there() -> bool:
    with socket.socket(socket.AF_UNIX) as probe:
        return probe.connect_ex(address()) == 0


def _without_ros(processes, *words: str):
    """Run a command in a process that cannot start another one, and therefore can only use the session."""
    code = (
        "import signal, subprocess, sys\n"
        # a background job of a shell ignores SIGINT, and so would its processes
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "subprocess.run = subprocess.Popen = None\n"
        "from hysteresis_ros.cli.main import main\n"
        "main(sys.argv[1:])"
    )
    return processes.start([sys.executable, "-c", code, *words], words[0])


def test_commands_are_done_by_the_session_of_the_axis(kept, processes):
    """Output, exit code and refusals are those of a command without the session."""
    taken = _without_ros(processes, "setpoint", "5um")
    assert taken.wait() == 0 and taken.output.endswith("setpoint 5 µm taken by /reference_generator\n")
    refused = _without_ros(processes, "setpoint", "5mm")
    assert refused.wait() == 2 and "hysteresis: /reference_generator: setpoint 5000 µm refused" in refused.output
    asked = _without_ros(processes, "get", "motion_controller", "type")
    assert asked.wait() == 0 and asked.output == "type: sliding_mode\n"
    heard = _without_ros(processes, "echo", "joint_states", "--count", "3")
    assert heard.wait() == 0 and len(heard.output.splitlines()) == 3
    endless = _without_ros(processes, "echo", "joint_states")
    until(lambda: "extender" in endless.output, what="a message")
    code, _ = endless.leave(signal.SIGINT)
    assert code == 130 and endless.output.endswith("hysteresis: interrupted\n")
    assert _without_ros(processes, "get", "motion_controller", "type").wait() == 0


def test_the_session_ends_with_its_axis(kept, processes):
    code, _ = kept.leave(signal.SIGINT)
    assert code == 0, kept.output
    assert not _is_there()


def test_a_command_of_another_domain_is_not_the_session_s(kept, monkeypatch, processes):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(processes.domain + 1))
    assert not _is_there()


def test_a_session_that_ends_amid_a_command_is_said(monkeypatch, capsys):
    """It is unknown whether the setpoint was accepted: exit code 1."""
    from hysteresis_ros.nodes.remote import door

    name = b"\0hysteresis_ros/test" + str(id(capsys)).encode()
    monkeypatch.setattr(door, "address", lambda: name)
    assert door.ask_session({"command": "status"}) is None
    code = (
        "import socket, sys\n"
        f"with socket.socket(socket.AF_UNIX) as made:\n    made.bind({name!r})\n    made.listen(1)\n"
        "    print(flush=True)\n    made.accept()[0].recv(1)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as leaving:
        leaving.stdout.readline()
        assert door.ask_session({"command": "status"}) == 1
    assert "ended before it answered" in capsys.readouterr().err


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux informs a process of its parent's exit")
def test_a_node_of_ros2_run_keeps_a_session_as_long_as_it_runs(processes, monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(processes.domain))
    path = write_axis(tmp_path / "axis.yaml", axis_parameters(sample_rate=RATE, time_mode="realtime"))
    (tmp_path / "ros2").write_text("import subprocess, sys\nsys.exit(subprocess.call(sys.argv[2:]))\n")
    node = [sys.executable, "-m", "hysteresis_ros.nodes.reference_generator", "--ros-args", "--params-file", path]
    run = processes.start([sys.executable, str(tmp_path / "ros2"), "run", *node], "ros2")
    until(_is_there, what="a session")
    until(lambda: "active" in run.output, what="a node")
    asked = _without_ros(processes, "get", "reference_generator", "sample_rate")
    assert asked.wait() == 0 and asked.output == f"sample_rate: {RATE}\n"
    run.send(signal.SIGKILL)
    until(lambda: not _is_there(), what="the session has ended")
