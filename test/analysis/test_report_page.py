# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report as a page: scripts draw all data, its figures are those of the metrics, and it works without scripts."""

from __future__ import annotations

import base64
import html.parser
import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("matplotlib", reason="matplotlib is not installed: no plots")
pytest.importorskip("jinja2", reason="jinja2 is not installed: no pages")

from hysteresis_ros.analysis import report, run_charts
from hysteresis_ros.analysis import report as spans
from hysteresis_ros.analysis.metrics import compute_metrics
from hysteresis_ros.analysis.page import chart_payload
from hysteresis_ros.analysis.parts import within
from hysteresis_ros.analysis.plots import Line, thin, thin_path
from hysteresis_ros.analysis.run_charts import error_chart, judged, late_samples_chart, lateness_chart, traces_chart
from hysteresis_ros.recordings import Recording

RATE = 1000.0


def scan(samples: int = 2000, **further) -> Recording:
    """A 5 Hz sine over 10 µm, tracked with a lag and noise of 5 nm."""
    time = np.arange(samples) / RATE
    noise = np.random.default_rng(3).normal(size=(2, samples))
    reference = 5e-6 * (1.0 - np.cos(2 * np.pi * 5.0 * time))
    displacement = 5e-6 * (1.0 - np.cos(2 * np.pi * 5.0 * (time - 1e-4))) + 5e-9 * noise[0]
    columns = {"time": time, "reference": reference, "displacement": displacement}
    columns |= {"voltage": reference / 1e-7 + 0.01 * noise[1], "saturated": (noise[0] > 1.0).astype(float)}
    return Recording.from_columns(columns, {"configuration": "/**/motion_controller: {}\n", **further})


def data_of(page: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S).group(1))


def unpacked(text: str, kind: str = "<f4"):
    return np.frombuffer(base64.b64decode(text), dtype=kind)


class Words(html.parser.HTMLParser):
    """The content of a page without scripts: its text, its pictures, and elements that were not closed."""

    def __init__(self, page: str):
        super().__init__()
        self.text, self.pictures, self.open = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img", "br", "input"):
            self.open.append(tag)
        if tag == "img":
            self.pictures.append(dict(attributes)["alt"])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"script", "style"} & set(self.open):
            self.text.append(data)


# -- nothing is lost -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@given(size=st.integers(1, 3000), points=st.integers(4, 400), seed=st.integers(0, 20))
def test_thinned_columns_keep_every_extreme_near_its_place(size, points, seed):
    random = np.random.default_rng(seed)
    time = np.arange(size) + 0.25 * random.random(size)
    columns = [random.normal(size=size), random.normal(size=size)]
    columns[1][random.random(size) < 0.3] = np.nan
    instants, thinned, block = thin(time, columns, points)
    assert instants.size <= max(size if size <= points else points, 2) and np.all(np.diff(instants) > 0.0)
    assert block == 1 or block * points >= 2 * size > points
    for values, kept in zip(columns, thinned, strict=True):
        assert kept.size == instants.size
        for place in range(0, size, block):
            inside = values[place : place + block]
            shown = kept[(instants >= time[place]) & (instants <= time[min(place + block, size) - 1])]
            if np.any(np.isfinite(inside)):
                assert np.nanmin(shown) == np.nanmin(inside) and np.nanmax(shown) == np.nanmax(inside)
            else:
                assert np.all(np.isnan(shown))


@pytest.mark.slow
@given(size=st.integers(1, 2000), points=st.integers(5, 300), seed=st.integers(0, 20))
def test_thinned_paths_keep_their_extremes_in_both_directions(size, points, seed):
    random = np.random.default_rng(seed)
    x, y = random.normal(size=(2, size))
    y[random.random(size) < 0.1] = np.nan
    path = thin_path(Line("path", "voltage", x, y, key=np.arange(size, dtype=float)), points)
    there = np.isfinite(y)
    assert path.x.size <= max(points, 5)
    if np.any(there):
        assert (path.x.min(), path.x.max()) == (x[there].min(), x[there].max())
        assert (path.y.min(), path.y.max()) == (y[there].min(), y[there].max())
    np.testing.assert_array_equal(x[path.key.astype(int)], path.x)


def test_a_short_run_stands_in_the_page_sample_by_sample(monkeypatch):
    monkeypatch.setattr(report, "drawn", lambda charts, figures: [])
    run = scan()
    data = data_of(report.render_report(run, "run"))
    np.testing.assert_array_equal(unpacked(data["time"], "<f8"), run.time)
    chart = next(chart for chart in data["charts"] if chart["name"] == "error")
    error = 1e9 * (run["reference"] - run["displacement"])
    np.testing.assert_allclose(unpacked(chart["lines"][0]["y"]), error, rtol=1e-6, atol=1e-6)
    assert data["samples"] == 1 and data["whole"] == [0.0, run.time[-1]]


# -- figures of a span ----------------------------------------------------------------------------------------------


def added_up(sums: dict, i: int, j: int) -> dict:
    """Return the result of the page's script for the sums of blocks i to j."""

    def between(name, counts):
        first = next((k for k in range(i, j) if sums[counts][k]), j)
        return np.sum(sums[name][i : j + 1]) - sums[f"joint_{name}"][first]

    errors, volts = np.sum(sums["errors"][i : j + 1]), np.sum(sums["volts"][i : j + 1])
    stroke = np.nanmax(sums["high"][i : j + 1]) - np.nanmin(sums["low"][i : j + 1])
    rms, largest = np.sqrt(np.sum(sums["square"][i : j + 1]) / errors), np.max(sums["largest"][i : j + 1])
    return {
        "rms_error_m": rms,
        "rms_error_percent_of_stroke": 100.0 * rms / stroke,
        "max_error_m": largest,
        "max_error_percent_of_stroke": 100.0 * largest / stroke,
        "iae_m_s": between("area", "errors"),
        "voltage_rate_v_s": np.sqrt(between("rates", "volts") / (volts - 1)),
        "voltage_variation_v": between("rises", "volts"),
        "saturated_percent": 100.0 * np.sum(sums["cut"][i : j + 1]) / np.sum(sums["flags"][i : j + 1]),
        "stroke_m": stroke,
        "samples": np.sum(sums["samples"][i : j + 1]),
        "duration_s": sums["to"][j] - sums["from"][i],
        "lateness_max_s": np.max(sums["late"][i : j + 1]),
        "skipped_samples": np.sum(sums["skipped"][i : j + 1]),
    }


@pytest.mark.slow
@settings(deadline=None)
@given(ends=st.tuples(st.integers(0, 39), st.integers(0, 39)), blocks=st.integers(40, 60), holes=st.booleans())
def test_figures_of_a_span_are_those_of_the_metrics(ends, blocks, holes):
    run = scan(600)
    signals = {name: values.copy() for name, values in run.signals.items()}
    random = np.random.default_rng(5)
    if holes:
        for name in ("reference", "voltage", "saturated"):
            signals[name][random.random(600) < 0.1] = np.nan
        signals["displacement"][100:130] = np.nan  # whole blocks without an error
    signals["lateness"] = random.exponential(1e-5, 600)
    signals["skipped"] = (random.random(600) < 0.05).astype(float)
    run = Recording(run.time, signals, {"lateness": "s"})
    sums = spans.block_sums(judged(run), blocks)
    i, j = min(ends), max(ends)
    if np.sum(sums["errors"][i : j + 1]) < 3 or np.sum(sums["volts"][i : j + 1]) < 3:
        return
    found = added_up(sums, i, j)
    metrics = compute_metrics(within(run, sums["from"][i], sums["to"][j]))
    assert set(found) == set(spans.ADDED)
    for name, value in found.items():
        assert value == pytest.approx(metrics[name], rel=1e-9, abs=1e-18), name


def test_the_page_carries_these_sums_and_the_last_periods(monkeypatch):
    monkeypatch.setattr(report, "drawn", lambda charts, figures: [])
    run = scan()
    page = report.render_report(run, "run")
    data = data_of(page)
    expected = spans.block_sums(judged(run))
    (sums,) = (run["sums"] for run in data["runs"])
    assert set(sums) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(unpacked(sums[name], "<f8"), values)
    (whole, *_), (name, begin, end) = data["spans"]
    assert (whole, name) == ("whole run", "last 2 periods") and end - begin == pytest.approx(0.4 - 1 / RATE)
    figures = compute_metrics(within(run, begin, end))
    row = re.search(r'<tr data-figure="max_error_m".*?</tr>', page, re.S).group(0)
    assert f'<td class="value">{1e9 * figures["max_error_m"]:.4g}' in row.replace(" nm", "")


def test_what_begins_within_a_run_is_not_called_a_jump_into_it():
    """An excerpt may begin with any error, because the reader chose its beginning."""
    run = scan()
    signals = {**run.signals, "displacement": run["displacement"].copy()}
    signals["displacement"][700] += 1e-6
    part = within(Recording.from_columns({"time": run.time, **signals}), 0.7, 1.9)
    assert compute_metrics(part)["max_error_m"] == pytest.approx(1e-6, rel=0.2) and judged(part).start == 0


# -- error charts ---------------------------------------------------------------------------------------------------


def test_a_sine_has_its_line_and_its_variance_in_the_spectrum():
    time = np.arange(20000) / RATE
    values = 30e-9 * np.sin(2 * np.pi * 50.0 * time) + 7e-9
    values[np.arange(0, 20000, 500)] = np.nan
    there = np.isfinite(values)
    frequency, density = run_charts.amplitude_spectrum(time[there], values[there], 1.0 / RATE)
    assert frequency[np.argmax(density)] == pytest.approx(50.0, abs=0.1)
    assert np.sum((1e9 * density) ** 2) * frequency[0] == pytest.approx(0.5 * 30.0**2, rel=0.01)


def test_trace_and_retrace_are_told_apart():
    """A displacement with a lag of 10 nm is 10 nm behind in both directions: 20 nm between trace and retrace."""
    turn = np.arange(1000) / 200.0 % 1.0
    reference = 10e-6 * (1.0 - np.abs(1.0 - 2.0 * turn))
    displacement = reference - 10e-9 * np.where(turn < 0.5, 1.0, -1.0)
    run = judged(
        Recording.from_columns({"time": np.arange(1000) / RATE, "reference": reference, "displacement": displacement})
    )
    chart = run_charts.trace_retrace_chart(run)
    trace, retrace = chart.lines
    assert trace.label.startswith("trace") and np.median(trace.y) == pytest.approx(10.0)
    assert retrace.label.startswith("retrace") and np.median(retrace.y) == pytest.approx(-10.0)
    assert all(np.all(np.diff(line.x) >= 0.0) for line in chart.lines) and "at most 20 nm" in chart.note
    periods = run_charts.last_periods_chart(run)
    assert [line.label for line in periods.lines] == ["third to last", "second to last", "last"]
    assert periods.up == "error [nm]" and all(line.x[-1] < 200.0 for line in periods.lines)


def test_bars_of_the_histogram_are_all_samples():
    chart = run_charts.histogram_chart(judged(scan()))
    bars, normal = chart.lines
    assert np.sum(bars.y) == pytest.approx(100.0) and np.sum(normal.y) == pytest.approx(100.0, rel=0.05)


def test_lateness_is_drawn_where_it_was_noted():
    run = scan()
    assert lateness_chart(judged(run)) is None and late_samples_chart(judged(run)) is None
    late = np.full(2000, 5e-6)
    late[700] = 2e-3
    chart = late_samples_chart(judged(Recording(run.time, {**run.signals, "lateness": late}, {"lateness": "s"})))
    (line,) = chart.lines
    assert line.x[-1] == pytest.approx(2000.0) and line.y[-1] == pytest.approx(1 / 2000) and line.y[0] == 1.0


# -- the page -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_page_says_everything_without_scripts():
    run = scan(notes=["a remark"], source="first")
    figures = compute_metrics(run)
    words = Words(report.render_report(run, "A </script> title", figures))
    text = " ".join("".join(words.text).split())
    assert words.open == [] and "A </script> title" in text and "a remark" in text and "motion_controller" in text
    assert "Evaluated at all 2000 samples, one every 1 ms; what happens between them is not in the recording." in text
    assert f"{figures['rms_error_m'] * 1e9:.4g}" in text and "last 2 periods" in text and "hysteresis_ros" in text
    for caption in (
        "Displacement",
        "Error (ref",
        "Hysteresis loop before and after",
        "Trace against",
        "Error in the last",
    ):
        assert any(alt.startswith(caption) for alt in words.pictures), caption
    assert {"Spectrum of the error", "Histogram of the error"} <= set(words.pictures)


def test_voltages_that_are_held_are_judged_between_them():
    run = scan()
    held = {**run.signals, "voltage": np.repeat(run["voltage"][::5], 5)}
    said = report.sampling_text(Recording.from_columns({"time": run.time, **held}))
    assert said.endswith("5 for each voltage, and thus also between the commands.")


@pytest.mark.slow
def test_a_recording_without_a_reference_has_a_page_too():
    run = scan()
    signals = {name: run[name] for name in ("displacement", "voltage")}
    page = report.render_report(Recording(run.time, {**signals, "counter": run.time}, {"counter": "1"}), "foreign")
    words = Words(page)
    text = " ".join("".join(words.text).split())
    assert "no reference in the recording: the error is unknown" in text
    assert words.pictures == ["Displacement over time", "Hysteresis loop", "Voltage"]
    assert "errors" not in data_of(page)["runs"][0]["sums"]


@pytest.mark.slow
@pytest.mark.parametrize("case", ["one sample", "at rest", "measured for a while", "not finite", "a gap"])
def test_odd_recordings_have_pages(case, monkeypatch):
    monkeypatch.setattr(report, "drawn", lambda charts, figures: [])
    run = scan()
    part = np.where(run.time < 0.5, run["displacement"], np.nan)
    broken = np.where(run.time > 0.1, np.inf, run["reference"])
    twice = {name: np.tile(values, 2) for name, values in run.signals.items()}
    recordings = {
        "one sample": Recording(run.time[:1], {name: values[:1] for name, values in run.signals.items()}),
        "at rest": Recording(run.time, {"displacement": np.zeros(2000), "voltage": run["voltage"]}),
        "measured for a while": Recording(run.time, {**run.signals, "displacement": part}),
        "not finite": Recording(run.time, {**run.signals, "reference": broken}),
        "a gap": Recording(np.append(run.time, run.time + 1e4), twice),
    }
    data = data_of(report.render_report(recordings[case], case))
    assert {"traces"} <= {chart["name"] for chart in data["charts"]} and data["runs"][0]["sums"]["samples"]


@pytest.mark.slow
def test_long_runs_make_no_larger_pages(monkeypatch):
    """Ten minutes at 10 kHz: the sizes of picture and table do not depend on the length."""
    samples = 6_000_000
    time = np.arange(samples) / 1e4
    wave = np.tile(scan(2000)["reference"], samples // 2000)
    lines = [Line("reference", "reference", time, wave), Line("displacement", "displacement", time, wave)]
    run = scan(24_000)
    charts = [traces_chart(judged(run)), error_chart(judged(run))]
    long = [type(charts[0])("traces", "", "", "", lines), type(charts[0])("error", "", "", "", lines[:1])]
    sizes = [len(json.dumps(chart_payload(drawn))) for drawn in (charts, long)]
    assert sizes[1] < 1.1 * sizes[0]
    page = report.render_report(run, "long", compute_metrics(run))
    assert len(page.encode()) < report.LARGEST and data_of(page)["samples"] == 4
    assert "the lowest and the highest of them" in page
    monkeypatch.setattr(report, "drawn", lambda charts, figures: [])
    wordy = Recording(run.time, run.signals, {}, {"configuration": "x" * 1_400_000})
    assert len(report.render_report(wordy, "long", compute_metrics(run)).encode()) < report.LARGEST
