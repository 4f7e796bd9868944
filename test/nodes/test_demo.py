"""The demonstration as `make demo` runs it: four processes over DDS, moved by setpoints on the topic."""

import json
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from nodes_support import axis_parameters, until, write_axis  # noqa: E402

from hysteresis_ros.cli.demo import DURATION, LATE, SETPOINTS  # noqa: E402
from hysteresis_ros.recordings import load_run  # noqa: E402
from hysteresis_ros.recordings.align import read_recording  # noqa: E402


@pytest.fixture
def running(processes):
    """An axis of the user that holds its place, in real time, without a namespace."""
    held = {"reference_generator": {"initial_setpoint": 2.0e-6}}
    axis = axis_parameters(overrides=held, sample_rate=20.0, time_mode="realtime")
    path = write_axis(processes.folder / "axis.yaml", axis)
    run = processes.command("up", path, "--composed", "--record", "held", "--log-level", "info")
    until(lambda: (processes.folder / "held" / "held.mcap").exists(), what="a recording")
    return run


def test_the_demonstration_leaves_a_bag_a_report_and_a_table(tmp_path, running, domain, monkeypatch):
    # the demonstration is started where an axis of the user runs: neither may notice the other
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    pytest.importorskip("matplotlib", reason="the report needs the extra 'report'")
    command = [
        sys.executable,
        "-m",
        "hysteresis_ros.cli.main",
        "demo",
        "-o",
        str(tmp_path / "demo"),
        "--factor",
        "0.1",
    ]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    code, _ = running.leave(signal.SIGINT)
    assert code == 0 and "publishers" not in running.output and "runaway" not in running.output
    held = load_run(running.log.parent / "held")
    assert held.time.size > 20 and set(held["setpoint"]) == {2.0e-6}
    assert re.search(r"RMS error +[\d.]+ µm", answer.stdout)
    assert re.search(r"real-time factor reached: 0\.\d+", answer.stdout)
    run = read_recording(tmp_path / "demo" / "bag", further=True)
    assert run.time.size == round(DURATION * 3000)
    assert set(np.unique(run["setpoint"])) == {value for _, value in SETPOINTS}
    starts = np.flatnonzero(np.diff(run["setpoint"])) + 1
    assert len(starts) == len(SETPOINTS)
    # every setpoint is reached, where the machine has time for it: late voltages shake the stack, hence the median, and
    # many of them more than the loop can damp
    if run.metadata["late_commands"] <= LATE * run.time.size and not run["tripped"].any():
        for start, (_, value) in zip(starts, SETPOINTS, strict=True):
            settled = run["displacement"][start + 200 : start + 500]
            assert np.median(settled) == pytest.approx(value, abs=0.05e-6)
    page = (tmp_path / "demo" / "report.html").read_text(encoding="utf-8")
    assert page.count("<img") >= 3 or page.count("<svg") >= 3
    metrics = json.loads((tmp_path / "demo" / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["stroke_m"] == 9.0e-6
    if not run["tripped"].any():
        assert metrics["steps"] == len(SETPOINTS)

    again = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert again.returncode == 2 and "exists already" in again.stderr
