# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runs side by side: figures of each run, lines of all runs; runs that cannot be overlaid are named."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="matplotlib is not installed: no plots")
pytest.importorskip("jinja2", reason="jinja2 is not installed: no pages")

from click.testing import CliRunner

from hysteresis_ros.analysis import report
from hysteresis_ros.analysis.metrics import compute_metrics
from hysteresis_ros.analysis.run_charts import judged
from hysteresis_ros.analysis.side_by_side import compare_runs, configurations, overlaid, render_side_by_side
from hysteresis_ros.cli.main import main
from hysteresis_ros.recordings import Recording
from hysteresis_ros.recordings.files import save_run


def run(rate: float, seconds: float, lag: float, begin: float = 0.0, text: str = "") -> Recording:
    """A 4 Hz sine over 10 µm, tracked with a delay of ``lag`` seconds."""
    time = np.arange(round(rate * seconds)) / rate
    wave = [5e-6 * (1.0 - np.cos(2 * np.pi * 4.0 * (time - late))) for late in (0.0, lag)]
    columns = {"time": time + begin, "reference": wave[0], "displacement": wave[1], "voltage": wave[0] * 1e7}
    return Recording.from_columns(columns, {"configuration": text})


@pytest.fixture
def runs() -> dict[str, Recording]:
    slow = run(500.0, 2.0, 1e-3, text="a: 1\nb: 2\n")
    return {"slow": slow, "fast": run(2000.0, 1.2, 1e-5, begin=40.0, text="a: 1\nb: 3\n")}


def test_each_run_has_its_own_figures_and_line_from_its_first_sample_on(runs):
    figures = compare_runs(runs)
    assert figures == {name: compute_metrics(one) for name, one in runs.items()}
    since = {name: judged(replace(one, time=one.time - one.time[0])) for name, one in runs.items()}
    charts = {chart.name: chart for chart in overlaid(since)}
    assert set(charts) == {"traces", "error", "loops", "trace", "periods", "spectrum", "histogram", "voltage"}
    assert [line.label for line in charts["traces"].lines] == ["slow", "fast", "reference"]
    for name, line in zip(runs, charts["error"].lines, strict=True):
        error = 1e6 * (runs[name]["reference"] - runs[name]["displacement"])
        np.testing.assert_allclose(line.y, error, atol=1e-12)
        np.testing.assert_allclose(line.x, runs[name].time - runs[name].time[0])
    assert charts["error"].up == "error [µm]", "one unit for all runs, although one error is small"
    assert len({line.colour for line in charts["error"].lines}) == 2


def test_other_references_are_drawn_too(runs):
    fast = runs["fast"]
    runs["fast"] = Recording(fast.time, {**fast.signals, "reference": 0.5 * fast["reference"]})
    charts = overlaid({name: judged(replace(one, time=one.time - one.time[0])) for name, one in runs.items()})
    assert [line.label for line in charts[0].lines][2:] == ["reference", "reference of fast"]


@pytest.mark.slow
def test_the_page_reads_without_scripts_and_holds_the_sums_of_each_run(runs):
    figures = compare_runs(runs)
    page = render_side_by_side(runs, "two stages", figures)
    row = re.search(r'<tr data-figure="rms_error_m".*?</tr>', page, re.S).group(0)
    cells = re.findall(r'<td class="value">([^<]*)<', row)
    assert cells == [f"{1e9 * one['rms_error_m']:.4g}" for one in figures.values()]
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.S).group(1))
    assert [one["name"] for one in data["runs"]] == ["slow", "fast"] and data["whole"] == [0.0, pytest.approx(1.998)]
    assert page.count("<img") == len(data["charts"]) == 8 and len(page.encode()) < 2_000_000
    assert "slow: Evaluated at all 1000 samples" in page and "fast: Evaluated at all 2400 samples" in page


def test_a_name_cannot_leave_the_script_that_holds_it(runs, monkeypatch):
    monkeypatch.setattr(report, "drawn", lambda charts, figures: [])
    name = "</script><b>\u2028"
    page = render_side_by_side({name: runs["slow"], "fast": runs["fast"]}, name)
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.S).group(1))
    assert data["runs"][0]["name"] == data["charts"][0]["lines"][0]["label"] == name and "<b>" not in page


def test_configurations_are_told_by_what_differs(runs):
    (first, whole), (second, change) = configurations(runs)
    assert first == "Configuration of slow" and whole == "a: 1\nb: 2\n"
    assert "differences from slow" in second and "-b: 2\n+b: 3" in change and "\n a: 1" in change
    runs["fast"] = runs["slow"]
    assert configurations(runs)[1][1] == "the same as that of slow"


def invoke(*words):
    return CliRunner().invoke(main, ["report", *(str(word) for word in words)])


@pytest.mark.slow
def test_the_command_puts_runs_of_one_name_apart_by_their_folders(runs, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "drawn", lambda charts, figures: [])  # only the words are read
    for name, one in runs.items():
        (tmp_path / name).mkdir()
        save_run(one, tmp_path / name / "run.npz")
    paths = [tmp_path / name / "run.npz" for name in runs]
    page, figures = tmp_path / "both.html", tmp_path / "both.json"
    result = invoke(*paths, "-o", page, "--json", figures, "--skip", "0.25")
    assert result.exit_code == 0, result.output
    assert "slow/run.npz  fast/run.npz" in result.output and "note: slow/run.npz: judged from 0.25 s" in result.output
    stored = json.loads(figures.read_text(encoding="utf-8"))["runs"]
    assert list(stored) == ["slow/run.npz", "fast/run.npz"] and stored["fast/run.npz"]["samples"] == 1900
    assert "<h1>slow/run.npz · fast/run.npz</h1>" in page.read_text(encoding="utf-8")
    refused = invoke(*paths, "--skip", "1.5s")
    assert refused.exit_code == 2 and "fast/run.npz: fewer than two samples from 1.5 s to inf s" in refused.output


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("missing.npz", "missing.npz"),
        ("words.csv", "words.csv"),
        ("volts.csv", "no signal in common: good.npz has displacement, reference, voltage; volts.csv has current"),
        ("nothing.npz", "nothing.npz: the recording has no values of 'displacement' or 'measured'"),
        ("worm.npz", "worm.npz is a run of an inchworm"),
        ("good.npz", "good.npz is given more than once"),
    ],
)
def test_what_cannot_stand_beside_others_is_named(runs, tmp_path, monkeypatch, case, words):
    monkeypatch.chdir(tmp_path)
    slow = runs["slow"]
    save_run(slow, "good.npz")
    (tmp_path / "words.csv").write_text("no recording at all\n", encoding="utf-8")
    (tmp_path / "volts.csv").write_text("time [s],current [A]\n0,1\n1,2\n2,3\n", encoding="utf-8")
    save_run(Recording(slow.time, {"reference": slow["reference"]}), "nothing.npz")
    save_run(Recording(slow.time, {**slow.signals, "phase": slow.time}), "worm.npz")
    result = invoke("good.npz", case, "-o", "page.html")
    assert result.exit_code == 2 and words in result.output, result.output
    assert len(result.output.strip().splitlines()) <= 3 and "Traceback" not in result.output
    assert not (tmp_path / "page.html").exists()
