# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Nodes exit with the process that started them, however it ends; those of others continue."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, until, write_axis  # noqa: E402

from hysteresis_ros.nodes.launcher import Graph, NodeProcess, starts_nodes  # noqa: E402

#: The behaviour of ``ros2``: start a process and wait for it.
STARTER = "import subprocess, sys\nsys.exit(subprocess.call(sys.argv[2:]))\n"
CHILD = """
from hysteresis_ros.nodes.launcher import leave_with_ros2
import signal

leave_with_ros2()
print("active")
# it only lives: whoever started it ends it
signal.pause()
"""


@pytest.mark.parametrize(
    ("command", "theirs"),
    [
        ("/opt/ros/jazzy/bin/ros2 launch hysteresis_ros axis.launch.py", True),
        ("/usr/bin/python3 /opt/ros/jazzy/bin/ros2 run hysteresis_ros plant_simulator", True),
        ("/usr/bin/python3 /opt/ros/jazzy/bin/ros2 topic echo run", False),
        ("bash launch", False),
        ("python3 -m hysteresis_ros.cli.main up", False),
        ("", False),
    ],
)
def test_who_starts_nodes_for_somebody_is_known_by_its_command_line(command, theirs):
    assert starts_nodes(command.split()) == theirs


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux informs a process of its parent's exit")
def test_a_node_leaves_with_ros2_that_is_killed_and_another_child_of_others_stays(processes, tmp_path):
    import psutil

    path = write_axis(tmp_path / "axis.yaml", axis_parameters(sample_rate=100.0))
    node = [sys.executable, "-m", "hysteresis_ros.nodes.reference_generator", "--ros-args", "--params-file", path]
    started = {}
    for name, command in (("ros2", node), ("tool", [sys.executable, "-uc", CHILD])):
        (tmp_path / name).write_text(STARTER)
        started[name] = processes.start([sys.executable, str(tmp_path / name), "run", *command], name)
    until(lambda: all("active" in process.output for process in started.values()), what="both children")
    children = {name: psutil.Process(process.popen.pid).children()[0] for name, process in started.items()}
    for process in started.values():
        process.send(signal.SIGKILL)
        process.wait()
    try:
        assert children["ros2"].wait(60) is None
        assert children["tool"].is_running()
    finally:
        children["tool"].kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_nodes_are_stopped_takes_effect_when_all_have_exited(monkeypatch, number):
    nodes = [subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"]) for _ in range(2)]
    graph = Graph([axis_parameters(sample_rate=100.0)])
    graph.processes = [
        NodeProcess(name, "", node) for name, node in zip(("plant_simulator", "recorder"), nodes, strict=True)
    ]
    wait = subprocess.Popen.wait

    def interrupted(process, *given):
        signal.raise_signal(number)
        return wait(process, *given)

    def left(number, frame):
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess.Popen, "wait", interrupted)
    before = signal.signal(number, left)
    try:
        with pytest.raises(KeyboardInterrupt):
            graph.stop()
        assert signal.getsignal(number) is left
    finally:
        signal.signal(number, before)
        running = [node for node in nodes if node.poll() is None]
        for node in running:
            node.kill()
    assert not running
