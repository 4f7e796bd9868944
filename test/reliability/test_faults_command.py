# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis faults``: refusals, and one fault case with real processes."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main


def run(*words):
    return CliRunner().invoke(main, ["faults", *map(str, words)])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--only", "kil all"], "no fault case 'kil all'; did you mean kill all?"),
        (["--ways", "fusd"], "no way 'fusd'; did you mean fused?"),
        (["--rounds", "0"], "--rounds"),
        (["picma_stag"], "did you mean picma_stage?"),
        (["inchworm_travel"], "an inchworm motor"),
        (["-o", "nowhere/page.md"], "the folder does not exist"),
        (["--add", "nowhere.json"], "nowhere.json: cannot be read"),
        (["--add", "pyproject.toml"], "not a file of hysteresis faults --json"),
    ],
)
def test_wrong_input_is_refused_in_one_line(words, expected):
    result = run(*words)
    assert result.exit_code == 2 and len(result.output.splitlines()) == 1, result.output
    assert expected in result.output


def test_the_loss_of_a_node_is_tried_at_three_rates_by_default():
    output = run("--list", "--only", "Processes").output
    for node in ("motion_controller", "hysteresis_compensator", "reference_generator"):
        for rate in (10, 200, 3000):
            assert f"lose {node} at {rate} Hz [processes]: SIGKILL at {rate} Hz" in output


def test_what_would_be_done_is_listed():
    result = run("--list", "--only", "Machine")
    assert result.exit_code == 0
    assert (
        "busy cores [fused, composed, processes]: all cores busy" in result.output and "kill all" not in result.output
    )


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed: no nodes")
def test_a_stopped_process_is_judged_and_written_down(tmp_path):
    page = tmp_path / "reliability.md"
    words = ["faults", "--ways", "composed", "--only", "stop all", "-o", str(page)]
    done = subprocess.run([sys.executable, "-m", "hysteresis_ros.cli.main", *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 fault cases: all held" in done.stdout and "Traceback" not in done.stderr
    row = next(row for row in page.read_text(encoding="utf-8").splitlines() if row.startswith("| **stop all**"))
    assert "| held: " in row and "step 1.00" in row and "back after" in row


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed: no nodes")
def test_a_node_is_lost_at_the_rate_that_was_asked_for(tmp_path):
    figures = tmp_path / "figures.json"
    words = ["--ways", "processes", "--only", "kill motion_controller", "--rate", "10", "--json", str(figures)]
    command = [sys.executable, "-m", "hysteresis_ros.cli.main", "faults", *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 fault cases: all held" in done.stdout and "it trips, and continues with ~/start" in done.stdout
    assert json.loads(figures.read_text(encoding="utf-8"))["config"] == "picma_stage at 10 Hz"
