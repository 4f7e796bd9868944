# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which part of a run is evaluated (a part, the last periods, no jump into a scan), and how the report states it."""

from __future__ import annotations

import importlib.util
import pathlib
import shutil
import sys
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="matplotlib is not installed: no plots")
pytest.importorskip("jinja2", reason="jinja2 is not installed: no pages")

from click.testing import CliRunner

from hysteresis_ros.analysis import report
from hysteresis_ros.analysis.metrics import compute_metrics, judged_reference
from hysteresis_ros.analysis.parts import last_periods, seconds, within
from hysteresis_ros.analysis.plots import chart_figure
from hysteresis_ros.analysis.report import render_report
from hysteresis_ros.analysis.run_charts import error_chart, judged, loops_chart
from hysteresis_ros.analysis.tables import format_table
from hysteresis_ros.cli.main import main
from hysteresis_ros.cli.recording import _bounds
from hysteresis_ros.configuration import config_path, load_configuration, parse_configuration
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.recordings import Recording, load_run, save_run
from hysteresis_ros.recordings.run_bag import write_recording

RATE = 1000.0
#: Amplitude of the error of the scan [m], small enough to be shown in nanometres.
RIPPLE = 20e-9


def scan(seconds_: float = 1.0, start: float = 0.0, noise: float = 0.0):
    """A 5 Hz triangle over 10 µm, tracked with a ripple; the axis reaches it from ``start`` [m] within 20 ms."""
    time = np.arange(round(seconds_ * RATE)) / RATE
    turn = (5.0 * time + 1e-9) % 1.0
    reference = 5e-6 + 10e-6 * (1.0 - np.abs(1.0 - 2.0 * turn))
    jump = (start - reference[0]) * np.exp(-time / 4e-3) if start else 0.0
    displacement = reference + jump - np.sqrt(2.0) * RIPPLE * np.sin(2 * np.pi * 25.0 * time)
    voltage = reference / 0.1e-6 + noise * np.random.default_rng(1).normal(size=time.size)
    columns = {"time": time, "reference": reference, "displacement": displacement, "voltage": voltage}
    return Recording.from_columns(columns)


@pytest.mark.slow
def test_the_jump_into_a_scan_does_not_count_and_is_said():
    figures = compute_metrics(scan(start=1e-9))
    assert figures["rms_error_m"] == pytest.approx(RIPPLE, rel=1e-3)
    assert figures["max_error_m"] == pytest.approx(np.sqrt(2.0) * RIPPLE, rel=1e-2)
    assert figures["stroke_m"] == pytest.approx(10e-6)
    assert any("errors are evaluated from 0.1 s on" in note for note in figures["notes"]["recording"])
    for name in ("loop_width_percent", "voltage_loop_width_percent"):
        assert figures[name] == pytest.approx(compute_metrics(scan())[name], rel=0.05)
        short = compute_metrics(scan(seconds_=0.2, start=1e-9))
        assert short[name] > 20.0 and "includes the motion to the beginning" in short["notes"][name]
        assert name not in figures["notes"]
    (axis,) = chart_figure(error_chart(judged(scan(start=1e-9)))).axes
    assert axis.get_legend() is not None and axis.get_ylabel() == "error [nm]"
    assert np.ptp(axis.get_ylim()) < 200.0, "samples that are not evaluated determine the scale"


def test_steps_and_a_scan_without_a_jump_count_from_the_beginning():
    assert compute_metrics(scan())["notes"]["recording"] == []
    steps = np.repeat([0.0, 5e-6, 0.0, 5e-6, 0.0], 100)
    late = np.concatenate([np.zeros(10), steps[:-10]])
    run = Recording.from_columns({"time": np.arange(500) / RATE, "reference": steps, "displacement": late})
    assert compute_metrics(run)["max_error_m"] == 5e-6


def test_parts_of_a_run_are_those_samples():
    run = scan()
    part = within(run, 0.25, 0.5)
    np.testing.assert_array_equal(part.time, run.time[250:501])
    np.testing.assert_array_equal(part["reference"], run["reference"][250:501])
    assert part.notes == ["judged from 0.25 s to 0.5 s of 0.999 s"]
    assert within(run, 0.0, np.inf) is run
    with pytest.raises(RecordingError, match="fewer than two samples from 3 s to 4 s: the run lasts 0.999 s"):
        within(run, 3.0, 4.0)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_last_periods_are_whole_ones_up_to_the_last_reversal(count):
    part = last_periods(scan(), count)
    assert len(part) == count * 200 and part.time[0] == pytest.approx(0.9 - 0.2 * count)
    assert np.mean(part["reference"]) == pytest.approx(10e-6, rel=1e-9)


def test_what_has_no_last_periods_is_refused():
    with pytest.raises(RecordingError, match="--last-periods 5: the run has 4 whole periods"):
        last_periods(scan(), 5)
    time = np.arange(1000) / RATE
    sweep = Recording.from_columns({"time": time, "reference": np.sin(40 * time**2), "displacement": time})
    with pytest.raises(RecordingError, match="is not periodic"):
        last_periods(sweep, 1)


@pytest.mark.parametrize(("text", "value"), [("0.5", 0.5), ("500ms", 0.5), ("0", 0.0)])
def test_times_have_units(text, value):
    assert seconds(text, "--skip") == value


@pytest.mark.parametrize("text", ["-1", "5um", "soon"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(RecordingError, match=f"--skip {text}: "):
        seconds(text, "--skip")
    for option, words in (
        ("--skip", (None, text)),
        ("--range", (f"{text}:2s", None)),
        ("--range", (f"0:{text}", None)),
    ):
        with pytest.raises(RecordingError, match=f"{option} {text}: "):
            _bounds(*words)


def test_small_lengths_are_nanometres_and_large_ones_are_not():
    table = format_table(compute_metrics(scan()))
    assert "20 nm" in table and "0.02 µm" not in table and "10 µm" in table


def test_a_loop_that_is_drawn_has_a_width_also_where_the_voltage_is_noisy():
    """A loop is found even if noise reverses the voltage by more than a hundredth of its range."""
    run = scan(noise=3.0)
    assert compute_metrics(run)["voltage_loop_width_percent"] is not None
    lines = loops_chart(judged(run)).lines
    assert [line.label.split(",")[0] for line in lines] == ["before compensation", "after compensation"]


@pytest.mark.slow
def test_no_loop_is_drawn_where_there_is_none():
    reference = np.repeat([0.0, 5e-6, 0.0, 5e-6], 100)
    columns = {"reference": reference, "displacement": reference + 1e-9, "voltage": reference * 1e7}
    run = Recording.from_columns({"time": np.arange(400) / RATE, **columns})
    assert loops_chart(judged(run)) is None
    page = render_report(run, "steps")
    assert "loop before and after" not in page and 'id="chart-voltage"' in page


@pytest.mark.slow
def test_a_page_says_what_when_and_with_which_version(tmp_path, monkeypatch):
    from hysteresis_ros import __version__

    monkeypatch.setattr(report, "drawn", lambda charts, figures: [])  # only the words are read

    path = tmp_path / "run.npz"
    metadata = {"recorded_ns": 1_700_000_000 * 10**9, "source": "first"}
    save_run(Recording.from_columns({"time": scan().time, **scan().signals}, metadata), path)
    page = tmp_path / "page.html"
    result = CliRunner().invoke(main, ["report", str(path), "-o", str(page), "--title", "A stage", "--skip", "200ms"])
    assert result.exit_code == 0, result.output
    text = page.read_text(encoding="utf-8")
    assert "<h1>A stage</h1>" in text and "first · recorded 2023-11-14 22:13 UTC" in text
    assert f"<footer>hysteresis_ros {__version__}, 20" in text and "judged from 0.2 s" in text
    for words in (["--skip", "0.1", "--range", "0:1"], ["--range", "1"], ["--skip", "later"], ["--last-periods", "9"]):
        refused = CliRunner().invoke(main, ["report", str(path), *words])
        assert refused.exit_code == 2 and len(refused.output.splitlines()) == 1, refused.output


@pytest.mark.slow
def test_a_bag_with_a_raw_file_is_an_axis_and_a_folder_names_its_bags(tmp_path):
    """A section for each node, including the sequencer, does not make an actuator's axis an inchworm."""
    for name in ("left", "right"):
        write_recording(scan(), tmp_path / name, config_path("kim2009").read_text(encoding="utf-8"))
    result = CliRunner().invoke(main, ["report", str(tmp_path / "left")])
    assert result.exit_code == 0 and "RMS error" in result.output, result.output
    exported = CliRunner().invoke(main, ["export", str(tmp_path / "left"), "-o", str(tmp_path / "left.npz")])
    assert exported.exit_code == 0 and len(load_run(tmp_path / "left.npz")) == 1000
    (tmp_path / "left.npz").unlink()
    refused = CliRunner().invoke(main, ["report", str(tmp_path)])
    assert refused.exit_code == 2 and f"{tmp_path / 'left'}, {tmp_path / 'right'}" in refused.output


def test_a_launched_recording_holds_the_numbers_of_its_file(tmp_path, monkeypatch):
    """`ros2 launch … record:=` merges two files: 5e-6 remains a number, and the axis does not become an inchworm."""
    launch = load_launch_file(monkeypatch)
    path = tmp_path / "axis.yaml"
    text = config_path("kim2009").read_text(encoding="utf-8").replace("maximum: 12.0e-6", "maximum: 12e-6")
    path.write_text(text, encoding="utf-8")
    given = {"rate": "", "plant": "own", "samples": "", "factor": "", "autostart": "", "description": ""}
    given["record"] = str(tmp_path / "bag")
    merged = launch.merged(str(path), launch.override(given, "described.yaml"))
    write_recording(scan(), tmp_path / "bag", merged)
    result = CliRunner().invoke(main, ["report", str(tmp_path / "bag")])
    assert result.exit_code == 0 and "RMS error" in result.output, result.output
    values = parse_configuration(load_run(tmp_path / "bag").configuration, "bag").node("reference_generator")
    assert values["maximum"] == 12e-6


#: Processes of a stage, one for each kind of node.
KINDS = ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "expected", "mode"),
    [
        ({"record": "bag"}, [["--recorder"]], "fused"),
        (
            {"rate": "lockstep"},
            [["plant_simulator"], ["hysteresis_compensator"], ["motion_controller"], ["reference_generator"]],
            "lockstep",
        ),
        ({"factor": "0.02", "composed": "true", "record": "bag"}, [[], ["recorder"]], "realtime"),
    ],
)
def test_the_launch_file_starts_the_processes_of_a_stage(monkeypatch, words, expected, mode):
    launch = load_launch_file(monkeypatch)
    started = []
    monkeypatch.setattr(launch, "Node", lambda **options: started.append(options))
    given = {"config": "xy_scanner", "plant": "own", "composed": "false", "fused": "false", "description": "false"}
    given |= {"samples": "500"} | words
    names = [*given, "namespace", "rate", "factor", "record", "autostart", "log_level"]
    monkeypatch.setattr(launch, "ARGUMENTS", [SimpleNamespace(name=name) for name in dict.fromkeys(names)])
    monkeypatch.setattr(
        launch, "LaunchConfiguration", lambda name: SimpleNamespace(perform=lambda context: given.get(name, ""))
    )
    launch.axis(None)
    assert {one["executable"] for one in started} == {"hysteresis_stage"}
    assert [one["arguments"] for one in started] == expected
    (described,) = {path for one in started for path in one["parameters"]}
    parameters = StageParameters.from_configuration(load_configuration(described))
    shutil.rmtree(pathlib.Path(described).parent)
    assert parameters.stage.time_mode == mode
    for axis in parameters.axes:
        plant, recorder = axis.plant_simulator, axis.recorder
        assert (plant.samples, plant.exit_at_end, plant.real_time_factor) == (500, True, float(given.get("factor", 1)))
        assert plant.wait_for_recorder == bool(given.get("record"))
        assert not given.get("record") or (recorder.path, recorder.configuration) == ("bag", described)
    given["namespace"] = "left"
    with pytest.raises(ValueError, match="namespace:=left: xy_scanner describes a stage"):
        launch.axis(None)


def load_launch_file(monkeypatch):
    """Return the launch file as a module; its imports from ROS, which are not needed here, are replaced."""
    for name in ("launch", "launch.actions", "launch.event_handlers", "launch.events", "launch.substitutions"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    for name in ("launch_ros", "launch_ros.actions", "launch_ros.parameter_descriptions", "launch_ros.substitutions"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    path = pathlib.Path(__file__).resolve().parents[2] / "launch" / "axis.launch.py"
    specification = importlib.util.spec_from_file_location("axis_launch", path)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_what_a_preview_looks_back_to_before_an_excerpt_is_not_made_up():
    run = scan()
    text = "/**/motion_controller:\n  ros__parameters:\n    feedforward: {preview: 3}\n"
    described = Recording.from_columns({"time": run.time, **run.signals}, {"configuration": text})
    judged = judged_reference(within(described, 0.5, 0.6))
    assert np.isnan(judged[:3]).all()
    np.testing.assert_array_equal(judged[3:], run["reference"][500:598])
    np.testing.assert_array_equal(judged_reference(within(described, 0.0, 0.6))[:3], run["reference"][0])


def test_a_launch_file_refuses_what_is_no_parameter_file(monkeypatch, tmp_path):
    module = load_launch_file(monkeypatch)
    assert module.configuration("kim2009").endswith("config/kim2009.yaml")
    for text in (
        "root:x:0:0:root:/root:/bin/bash\n",
        "[1, 2]\n",
        "a: {b: 1}\n",
        "a: [\n",
        "x: 1\ny: {ros__parameters: {}}\n",
    ):
        (tmp_path / "given").write_text(text)
        with pytest.raises(ValueError, match="config:=.*given: not a ROS 2 parameter file"):
            module.configuration(str(tmp_path / "given"))
