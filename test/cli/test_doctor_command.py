# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis doctor``: its output and its file contain all measurements, on any machine."""

from __future__ import annotations

import contextlib
import json
import re

import pytest
from click.testing import CliRunner

from hysteresis_ros.cli import delays, doctor
from hysteresis_ros.cli import doctor as command
from hysteresis_ros.cli.main import main
from hysteresis_ros.loop import fused
from hysteresis_ros.loop.pacing import Lateness
from hysteresis_ros.models.block import COMPILED


@pytest.fixture
def short(monkeypatch):
    """Each measurement takes only a moment."""
    monkeypatch.setattr(command, "RATES", (500.0, 1000.0))
    monkeypatch.setattr(command, "SECONDS", 0.05)
    monkeypatch.setattr(command, "COMPOSED", 30)
    monkeypatch.setattr(command, "PROCESSES", 30)
    monkeypatch.setattr(command, "ANSWERED", 30)
    monkeypatch.setattr(command, "BUDGET", 600.0)
    monkeypatch.setattr(command, "HOPELESS", 2.0)
    monkeypatch.setattr(delays, "SECONDS", 0.02)
    monkeypatch.setattr(delays, "WHOLE_SECONDS", 0.02)


@pytest.mark.skipif(not COMPILED, reason="without Numba the rate is not measured")
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
    for delay in found["delays"]:
        assert delay["state"] and delay["cost"] and f"  {delay['name']} " in result.output
    assert len(found["delays"]) == 8
    assert_verdicts_end_their_blocks(result.output.splitlines())
    assert all(found["messages"][name]["lockstep_hz"] > 0.0 for name in ("composed", "processes"))
    for name in ("composed", "processes"):
        real = found["messages"][name]["realtime"]
        assert real["rate"] == 300.0 and 0 <= real["late"] <= real["samples"] <= 30
        answered = real["p50"] is not None  # on a busy machine there may be no result
        assert not answered or 0.0 < real["p50"] <= real["p99"] <= real["max"]
        said = "answered after p50" if answered else "none of"
        assert f"nodes, {name}, in real time at 300 Hz: {said}" in result.output
    assert found["middleware"].startswith("rmw_") and found["middleware"] in result.output
    assert found["kernel_cache"]["bytes"] > 0 and found["kernel_cache"]["folder"] in result.output
    assert found["libraries"]["numpy"] != "not installed"
    permitted = not any(row["warning"] for row in found["fused"])
    assert ("limits.conf" in result.output) != permitted


def assert_verdicts_end_their_blocks(lines):
    """A verdict follows the rows of its own heading, begins with a sign of its own, and is indented as they are."""
    rows = [number for number, line in enumerate(lines) if re.match(r" +\d+ Hz: late ", line)]
    headings = [number for number, line in enumerate(lines) if line.startswith("fused with ")]
    verdicts = [number for number, line in enumerate(lines) if line.startswith("  = ")]
    assert len(headings) == len(verdicts) == 2
    for heading, verdict in zip(headings, verdicts, strict=True):
        between = range(heading + 1, verdict)
        assert between and set(between) <= set(rows), lines[heading : verdict + 1]
        assert re.match(r"  = (holds|not permitted)", lines[verdict])
    assert not any(re.match(r"(= )?(holds|not permitted)", line) for line in lines)


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


# ------------------------------------------------------------------------------------------------ what delays a loop


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A synthetic machine of two sibling cores; returns a function that writes its files."""
    monkeypatch.setattr(delays, "PROCESSORS", tmp_path / "cpu")
    monkeypatch.setattr(delays, "PROC", tmp_path / "proc")
    monkeypatch.setattr(delays, "_usable", lambda: [0, 1])
    monkeypatch.setattr(delays, "_busy", lambda core: contextlib.nullcontext())
    monkeypatch.setattr(delays, "shallow_sleep", lambda: contextlib.nullcontext(True))

    def write(**files):
        for name, text in files.items():
            path = tmp_path / name.replace("__", "/")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + "\n")

    write(
        proc__interrupts="      CPU0  CPU1\n 24:  10  40  edge\nLOC:  1  2  timer",
        proc__irq__24__smp_affinity_list="0-1",
        proc__irq__25__smp_affinity_list="0",
        proc__sys__kernel__sched_rt_runtime_us="950000",
        proc__sys__kernel__sched_rt_period_us="1000000",
        cpu__cpu0__cpuidle__state0__name="C6",
        cpu__cpu0__cpuidle__state0__latency="133",
        cpu__cpu0__cpufreq__scaling_governor="powersave",
        cpu__cpu0__topology__thread_siblings_list="0-1",
    )
    return write


def paced(spin=-1.0, cpu=-1, whole=False):
    """Return a lateness that shows how the loop was run."""
    late = 49e-3 if whole else 1e-6 if spin < 0.0 else (20 + cpu) * 1e-6
    looked = 1e-5 if spin or whole else 0.0
    return Lateness(late, late, late, late, late, 5 if whole else 0, 100, 1e-6 * (2 + cpu), 1e-6, looked, looked)


def test_each_setting_says_what_it_is_what_it_costs_and_what_changes_it(machine):
    found = {delay.name: delay for delay in delays.delays(paced)}
    assert found["polls the clock"].cost == "lateness 19 / 19 µs without it, 1 / 1 µs with it"
    assert (
        found["isolated cores"].state == "none"
        and "core 0 20 / 20 µs, core 1 21 / 21 µs" in found["isolated cores"].cost
    )
    assert "isolcpus=1 nohz_full=1 irqaffinity=0; then realtime.cpu: 1" in found["isolated cores"].change
    assert found["interrupts"].state == "1 of 2 may go to core 1" and "core 1 0 per s" in found["interrupts"].cost
    assert found["sleep states"].state.startswith("C6 133 µs") and "deep states off" in found["sleep states"].cost
    assert found["frequency governor"].state == "powersave" and "performance" in found["frequency governor"].change
    assert found["frequency governor"].cost.startswith("not measured")
    assert found["SMT siblings"].state == "0+1" and "a sample takes 2.00 µs" in found["SMT siblings"].cost
    assert "cpu1/online; then realtime.cpu: 0" in found["SMT siblings"].change
    throttling = found["real-time throttling"]
    assert "interrupted for 49.0 ms at most, 5.0 % of its samples" in throttling.cost
    assert "sched_rt_runtime_us=-1" in throttling.change
    assert [line.strip() for line in delays.lines_of(throttling)][2].startswith("→ only for a loop")


def test_what_is_set_well_needs_no_change(machine):
    machine(
        cpu__isolated="1",
        proc__irq__24__smp_affinity_list="0",
        proc__sys__kernel__sched_rt_runtime_us="-1",
        cpu__cpu0__cpufreq__scaling_governor="performance",
        cpu__cpu0__topology__thread_siblings_list="0",
    )
    found = {delay.name: delay for delay in delays.delays(paced)}
    good = (
        "polls the clock",
        "isolated cores",
        "interrupts",
        "frequency governor",
        "SMT siblings",
        "real-time throttling",
    )
    assert [found[name].change for name in good] == [""] * 6
    assert found["isolated cores"].state == "1" and found["real-time throttling"].state == "off"


def test_what_is_not_permitted_is_not_measured(machine, monkeypatch):
    monkeypatch.setattr(delays, "shallow_sleep", lambda: contextlib.nullcontext(False))
    monkeypatch.setattr(delays, "_usable", lambda: [0])
    found = {delay.name: delay for delay in delays.delays(lambda **how: paced(0.0, how.get("cpu", -1)))}
    assert found["sleep states"].cost == "not measured: /dev/cpu_dma_latency is not permitted"
    assert found["SMT siblings"].cost == "not measured: this process may not use both"
    assert found["real-time throttling"].cost.startswith("not measured")
    assert found["isolated cores"].change == "a second core is needed"
    assert found["polls the clock"].state.startswith("off")


def test_a_loop_that_polls_beside_it_is_the_reason_and_not_the_end(machine, monkeypatch):
    monkeypatch.setattr(fused, "claim_of_a_core", lambda: None)

    def beside_another(spin=-1.0, cpu=-1, whole=False):
        if whole:
            fused.require_spin(1e-4)
        return paced(spin, cpu)

    found = {delay.name: delay for delay in delays.delays(beside_another)}
    assert found["real-time throttling"].cost == "not measured: another loop polls the clock"
    assert len(found) == 8


def test_lists_of_cores_are_read():
    assert delays.cores_of("0,2-4") == [0, 2, 3, 4] and delays.cores_of("") == []
