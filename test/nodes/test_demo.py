# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The demonstration as in `make demo`: in real time over DDS, and as four processes in lockstep."""

import importlib
import json
import signal

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from command_support import run  # noqa: E402
from nodes_support import axis_parameters, until, write_axis  # noqa: E402

from hysteresis_ros.cli.demo import (  # noqa: E402
    PROCESSES,
    SETPOINTS,
    STEPS,
    TRIANGLES,
    WITH,
    WITHOUT,
    inverse_figure,
    message,
    opening_of_stroke,
)
from hysteresis_ros.recordings import Recording, load_run  # noqa: E402


@pytest.fixture
def running(processes):
    """An axis of the user that holds its position, in real time, without a namespace."""
    held = {"reference_generator": {"initial_setpoint": 2.0e-6}}
    axis = axis_parameters(overrides=held, sample_rate=20.0, time_mode="realtime")
    path = write_axis(processes.folder / "axis.yaml", axis)
    run = processes.command("up", path, "--composed", "--record", "held", "--log-level", "info")
    until(lambda: (processes.folder / "held" / "held.mcap").exists(), what="a recording")
    return run


def test_the_demonstration_leaves_bags_a_picture_a_report_and_a_table(tmp_path, running, domain, monkeypatch, capfd):
    # the demonstration starts while an axis of the user runs; neither may affect the other
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    pytest.importorskip("matplotlib", reason="the report needs the extra 'report'")
    # the beginning of the first triangle: four processes need 1 ms for each sample
    monkeypatch.setattr(importlib.import_module("hysteresis_ros.cli.demo"), "LOCKSTEP", 0.1)
    made = tmp_path / "demo"
    answer = run("demo", "-o", made)
    assert answer.exit_code == 0, answer.output
    code, _ = running.leave(signal.SIGINT)
    assert code == 0 and "publishers" not in running.output and "runaway" not in running.output
    held = load_run(running.log.parent / "held")
    # before the first measurement a generator does not know the position of the axis, and publishes no reference
    asked = held["setpoint"][np.isfinite(held["setpoint"])]
    assert asked.size > 20 and set(asked) == {2.0e-6}

    runs = {name: load_run(made / name, further=True) for name in (WITHOUT, WITH, STEPS, PROCESSES)}
    counts = ", ".join(f"{name} {run.time.size}" for name, run in runs.items())
    assert f"all samples equal the offline twin bit for bit, none missing: {counts}" in answer.stdout
    # first the message, then no more progress lines than a user can read
    said = answer.stdout.splitlines()
    assert said[0].startswith("The hysteresis loop is 12 % of the stroke wide without the inverse")
    assert "0.25 % with it" in said[0] and said[1].startswith("This machine skipped")
    printed = answer.stderr + capfd.readouterr().err  # its own, and that of its processes
    assert len(said) <= 12 and len(printed.splitlines()) <= 10, answer.stdout + printed
    without, inverse, steps, processes = runs.values()
    frequency, stroke, cycles = TRIANGLES
    assert without.time.size == inverse.time.size == round(cycles / frequency * 3000)
    assert np.ptp(without["reference"]) == pytest.approx(stroke, rel=1e-3)
    size = processes.time.size
    assert size == round(0.1 * 3000)
    if inverse["skipped"][:size].any():
        assert "the samples differ" in answer.stdout
    else:
        assert np.array_equal(processes["displacement"], inverse["displacement"][:size])
        assert f"the same {size} samples" in answer.stdout
    _judge_steps(steps)
    metrics = json.loads((made / "metrics.json").read_text(encoding="utf-8"))
    shown = metrics["demonstration"]
    assert shown["loop_opening_of_stroke"][WITHOUT] == pytest.approx(opening_of_stroke(without))
    alone = shown["loop_opening_without_missed_deadlines"]
    assert alone[WITHOUT] == pytest.approx(0.12, abs=0.005) and alone[WITH] == pytest.approx(0.0025, abs=0.00005)
    if not inverse["skipped"].any() and not without["skipped"].any():
        assert shown["loop_opening_of_stroke"] == alone
    assert shown["skipped_percent"][WITH] == pytest.approx(100.0 * np.mean(inverse["skipped"] != 0.0))
    assert shown["skipped_samples"] == {name: int(runs[name]["skipped"].sum()) for name in (WITHOUT, WITH, STEPS)}
    assert metrics["steps"] == len(SETPOINTS) and metrics["stroke_m"] == 9.0e-6
    page = (made / "report.html").read_text(encoding="utf-8")
    assert [one["part"] for one in metrics["parts"]][-2:] == ["steps", "shutdown"]
    assert metrics["duration_s"] == pytest.approx(steps.time[-1] - steps.time[0]), "all samples are evaluated"
    assert page.count("<img") >= 4 and page.index("without the inverse") < page.index("Displacement over time")
    assert (made / "inverse.png").read_bytes().startswith(b"\x89PNG")

    again = run("demo", "-o", made)
    assert again.exit_code == 2 and "exists already" in again.stderr


def _judge_steps(run):
    """Every setpoint arrived, and was reached where it was held and no sample was skipped, which excites the stack."""
    assert set(np.unique(run["setpoint"])) == {value for _, value in SETPOINTS}
    starts = np.flatnonzero(np.diff(run["setpoint"])) + 1
    assert len(starts) == len(SETPOINTS)
    # on a busy machine two of them may directly follow each other
    for start, end, (_, value) in zip(starts, [*starts[1:], run.time.size], SETPOINTS, strict=True):
        if end - start >= 500 and not run["skipped"][start : start + 500].any():
            assert np.median(run["displacement"][start + 200 : start + 500]) == pytest.approx(value, abs=0.05e-6)


def test_the_message_is_the_method_and_beside_it_what_the_machine_made_of_it():
    clean = message((0.12, 0.0025), (0.12, 0.0025), (0.0, 0.0), live=True)
    assert "12 %" in clean[0] and "0.25 % with it" in clean[0] and "skipped no sample" in clean[1]
    first, second = message((0.13, 0.031), (0.12, 0.0025), (3.2, 2.1), live=True)
    assert first == clean[0]
    assert "3.2 % and 2.1 % of the samples" in second and "13 % wide without the inverse, 3.1 % with it" in second


def test_the_picture_is_the_clean_one_and_marks_what_was_skipped():
    pytest.importorskip("matplotlib", reason="the picture needs the extra 'report'")
    time = np.arange(2000) / 1000.0
    reference = 1e-5 * np.abs(((time + 1e-9) % 1.0) - 0.5)
    clean = Recording(time, {"reference": reference, "displacement": reference + 1e-8, "skipped": np.zeros(2000)})
    skipped = np.zeros(2000)
    skipped[[100, 900, 1500]] = 1.0
    here = Recording(time, {"reference": reference, "displacement": reference - 1e-6 * skipped, "skipped": skipped})
    loop, error = inverse_figure(clean, clean, clean, here).axes
    (marks,) = [line for line in loop.lines if line.get_marker() == "x"]
    # the first branch is not plotted
    np.testing.assert_allclose(marks.get_ydata(), 1e6 * here["displacement"][[900, 1500]])
    np.testing.assert_allclose(error.lines[1].get_ydata(), 0.01, rtol=1e-6)
    assert not [line for line in inverse_figure(clean, clean, clean, clean).axes[0].lines if line.get_marker() == "x"]
