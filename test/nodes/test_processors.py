# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A lockstep run of nodes on one processor is repeated bit for bit on another processor."""

import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from processors_support import PROCESSORS, environment_on  # noqa: E402


def test_a_bag_made_on_one_processor_verifies_on_another(processes, tmp_path, monkeypatch):
    for name, value in PROCESSORS["Haswell"].items():
        monkeypatch.setenv(name, value)
    bag = str(tmp_path / "bag")
    arguments = ["kim2009", "--composed", "--rate", "lockstep", "--duration", "0.2", "--record", bag, "--verify"]
    run = processes.command("up", *arguments)
    assert run.wait() == 0, run.output
    for processor in PROCESSORS:
        command = [sys.executable, "-m", "hysteresis_ros.cli.main", "verify", bag]
        done = subprocess.run(command, env=environment_on(processor), capture_output=True, text=True)
        expected = f"{bag}: 600 samples equal the offline twin bit for bit, none missing\n"
        assert (done.returncode, done.stdout) == (0, expected), (processor, done.stderr)
