# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis doctor``: what it measures is in its words and in its file, whatever this machine holds."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from hysteresis_ros.cli import doctor
from hysteresis_ros.cli import doctor as command
from hysteresis_ros.cli.main import main
from hysteresis_ros.models.block import COMPILED


@pytest.fixture
def short(monkeypatch):
    """Everything that is measured, for a moment only."""
    monkeypatch.setattr(command, "RATES", (500.0, 1000.0))
    monkeypatch.setattr(command, "SECONDS", 0.05)
    monkeypatch.setattr(command, "COMPOSED", 30)
    monkeypatch.setattr(command, "PROCESSES", 30)
    monkeypatch.setattr(command, "ANSWERED", 30)
    monkeypatch.setattr(command, "BUDGET", 600.0)
    monkeypatch.setattr(command, "HOPELESS", 2.0)


@pytest.mark.skipif(not COMPILED, reason="without Numba no rate is measured")
def test_what_was_measured_is_said_and_written(tmp_path, short):
    pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
    path = tmp_path / "found.json"
    result = CliRunner().invoke(main, ["doctor", "--json", str(path)])
    assert result.exit_code == 0, result.output
    found = json.loads(path.read_text(encoding="utf-8"))
    normal = [row for row in found["fused"] if row["priority"] == 0]
    assert [row["rate_hz"] for row in normal] == [500.0, 1000.0]
    assert [row["samples"] for row in normal] == [25, 50]
    for row in found["fused"]:
        late = row["lateness_s"]
        assert late["p50"] <= late["p99"] <= late["p99.9"] <= late["max"]
        assert row["cost_s"] > 0.0 and f"{row['rate_hz']:g} Hz: late p50" in result.output
    assert all(found["messages"][name]["lockstep_hz"] > 0.0 for name in ("composed", "processes"))
    for name in ("composed", "processes"):
        real = found["messages"][name]["realtime"]
        assert real["rate"] == 300.0 and 0 <= real["late"] <= real["samples"] <= 30
        answered = real["p50"] is not None  # a machine that is busy may answer none of them
        assert not answered or 0.0 < real["p50"] <= real["p99"] <= real["max"]
        said = "answered after p50" if answered else "not one of"
        assert f"nodes, {name}, in real time at 300 Hz: {said}" in result.output
    assert found["middleware"].startswith("rmw_") and found["middleware"] in result.output
    assert found["kernel_cache"]["bytes"] > 0 and found["kernel_cache"]["folder"] in result.output
    assert found["libraries"]["numpy"] != "not installed"
    permitted = not any(row["warning"] for row in found["fused"])
    assert ("limits.conf" in result.output) != permitted


def test_nodes_that_answer_nothing_are_said_to(monkeypatch, tmp_path, short):
    trial = pytest.importorskip("hysteresis_ros.nodes.trial", reason="rosbags is not installed")
    monkeypatch.setattr("hysteresis_ros.models.block.COMPILED", False)
    monkeypatch.setattr(trial.Trial, "message_rate", lambda self: 1000.0)
    monkeypatch.setattr(trial.Trial, "answers", lambda self: trial.Answers(300.0, 30, 0, None, None, None))
    path = tmp_path / "found.json"
    result = CliRunner().invoke(main, ["doctor", "--json", str(path)])
    assert result.exit_code == 0 and "none of 30 measurements was answered" in result.output
    assert json.loads(path.read_text(encoding="utf-8"))["messages"]["composed"]["realtime"]["p50"] is None


def test_without_a_compiler_nothing_is_measured_and_the_reason_is_said(monkeypatch, short):
    monkeypatch.setattr("hysteresis_ros.models.block.COMPILED", False)
    monkeypatch.setattr(command, "_messages", lambda *arguments: {})
    result = CliRunner().invoke(main, ["doctor"])
    assert result.exit_code == 0 and "200 Hz at most without Numba" in result.output


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_measured(tmp_path):
    result = CliRunner().invoke(main, ["doctor", "--json", str(tmp_path / "nowhere" / "found.json")])
    assert result.exit_code == 2 and result.output.count("\n") == 1 and "the folder does not exist" in result.output


def test_what_is_missing_comes_with_what_to_do():
    system = {"cores": 2, "governor": "unknown"}
    libraries = dict.fromkeys(doctor.LIBRARIES, "1.0")
    assert doctor.advice({"system": system, "libraries": libraries}, True) == []
    libraries |= {"numba": "not installed", "rosbags": "not installed", "mcap": "not installed"}
    lines = doctor.advice({"system": {"cores": 1, "governor": "powersave"}, "libraries": libraries}, False)
    text = "\n".join(lines)
    assert 'numba missing: pip install "hysteresis_ros[fast]"' in text
    assert 'rosbags and mcap missing: pip install "hysteresis_ros"' in text
    assert "rtprio 80" in text and "realtime.cpu" in text and "powersave" in text
