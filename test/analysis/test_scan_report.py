# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report of a scan: figures against closed forms, the map of a known field, trace and retrace of a delay."""

from __future__ import annotations

import re

import numpy as np
import pytest

import hysteresis_ros as hr
from hysteresis_ros.analysis import report
from hysteresis_ros.analysis.scan_report import (
    ScanRun,
    error_map,
    line_errors,
    plane_figures,
    plane_of,
    profile,
    scan_figures,
    scan_plots,
    write_scan_report,
)
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import Recording
from hysteresis_ros.references.scans import scan_of

RASTER = dict(width=80e-6, depth=60e-6, lines=16, flyback=4, frame_rate=2.0, rotation=0.4, centre_x=50e-6, pixels=64)
MADE = {
    "raster": RASTER,
    "spiral": dict(diameter=80e-6, turns=12, frame_rate=2.0),
    "lissajous": dict(width=80e-6, depth=60e-6, lines=15, frame_rate=2.0),
}


def ran(kind: str = "raster", error=None, **more) -> ScanRun:
    """A run of two frames with the error that a function of time and reference returns."""
    scan = scan_of(kind, MADE[kind] | more)
    time = (np.arange(40_000) + 0.5) * (2.0 * scan.frame_time / 40_000)
    reference = scan.position(time)
    return ScanRun(scan, time, reference, reference - (0.0 if error is None else error(time, reference)))


def in_axes(scan, along, across):
    return scan.matrix[:2] @ np.array([along, across])


def test_trace_and_retrace_of_a_pure_delay_are_two_delays_apart():
    scan = scan_of("raster", RASTER)
    delay = 20e-6
    run = ran(error=lambda time, reference: reference - scan.position(time - delay))
    found = profile(run)
    shift = scan.line_velocity * delay
    inner = slice(4, -4)  # within a delay after its beginning, a line still follows the turn
    assert np.allclose(found.trace[inner], shift, rtol=1e-9) and np.allclose(found.retrace[inner], -shift, rtol=1e-9)
    figures = scan_figures(run)
    assert figures["trace_retrace_m"] == pytest.approx(2.0 * shift, rel=1e-3)
    assert figures["rms_error_m"] == pytest.approx(shift, rel=1e-3)
    assert figures["rms_error_percent"] == pytest.approx(100.0 * shift / 80e-6, rel=1e-3)
    assert figures["across_error_m"] < 1e-2 * shift and figures["coupling_error_m"] < 1e-2 * shift


def test_traces_are_not_compared_with_retraces_that_the_run_does_not_have():
    """A run that ends in its first line was a figure that is no number, and the command ended with a traceback."""
    whole = ran()
    on = np.flatnonzero(whole.clock.direction > 0)[:200]
    figures = scan_figures(ScanRun(whole.scan, whole.time[on], whole.reference[:, on], whole.displacement[:, on]))
    assert figures["trace_retrace_m"] is None and figures["worst_line_m"] == 0.0
    short = ScanRun(whole.scan, whole.time[on], whole.reference[:, on], whole.displacement[:, on])
    assert not any("retrace" in caption for caption, _ in scan_plots(short))


def test_coupling_is_what_the_line_leaves_across_itself():
    """0.1 % of u in v is coupling; an offset between lines is not."""
    scan = scan_of("raster", RASTER)

    def error(time, reference):
        u, v = scan.in_plane(reference)
        return in_axes(scan, np.zeros_like(u), 1e-3 * u + 0.01 * v + 30e-9)

    figures = scan_figures(ran(error=error))
    expected = 1e-3 * 80e-6 / np.sqrt(12.0)
    assert figures["coupling_error_m"] == pytest.approx(expected, rel=1e-3)
    assert figures["coupling_error_percent"] == pytest.approx(100.0 * expected / 80e-6, rel=1e-3)
    assert figures["across_error_m"] > 2.0 * expected and figures["along_error_m"] == pytest.approx(0.0, abs=1e-18)
    assert scan_figures(ran("spiral"))["coupling_error_m"] is None, "no coupling, because both axes scan"


@pytest.mark.parametrize("kind", list(MADE))
def test_the_map_shows_a_known_field(kind):
    def field(x, y):
        return np.array([1e-3 * (x - 40e-6), 2e-9 * np.cos(y / 20e-6)])

    run = ran(kind, lambda time, reference: field(*reference), pixels=200)
    found = error_map(run, 20)
    middles = np.meshgrid(0.5 * (found.x[1:] + found.x[:-1]), 0.5 * (found.y[1:] + found.y[:-1]))
    there = found.count > 20
    assert there.sum() > 100 and found.count.sum() == run.counted.sum()
    expected = field(*middles)
    # within a bin the field changes by its slope times half of the bin
    assert np.max(np.abs(found.mean[0] - expected[0])[there]) < 1e-3 * np.diff(found.x)[0]
    assert np.max(np.abs(found.mean[1] - expected[1])[there]) < 2e-9 * np.diff(found.y)[0] / 20e-6
    assert np.all(found.rms[there] >= np.hypot(*found.mean)[there] * (1.0 - 1e-12))
    assert np.all(np.isnan(found.rms[found.count == 0]))
    total = np.nansum(found.rms**2 * found.count) / found.count.sum()
    assert np.sqrt(total) == pytest.approx(scan_figures(run)["rms_error_m"], rel=1e-12)


def test_lines_are_judged_one_by_one():
    scan = scan_of("raster", RASTER)

    def error(time, reference):
        clock = scan.clock(time)
        size = np.where((clock.line == 5) & (clock.direction < 0), 7e-9, 1e-9)
        return in_axes(scan, np.where(clock.line < 0, 1e-6, size), 0.0 * size)

    run = ran(error=error)
    lines = line_errors(run)
    assert lines.rms.size == 2 * 2 * 16 and np.array_equal(lines.line[:6], [0, 0, 1, 1, 2, 2])
    worse = (lines.line == 5) & (lines.direction == -1)
    assert np.allclose(lines.rms[worse], 7e-9) and np.allclose(lines.rms[~worse], 1e-9) and worse.sum() == 2
    figures = scan_figures(run)
    assert figures["worst_line_m"] == pytest.approx(7e-9) and figures["turn_error_m"] == pytest.approx(1e-6)
    assert figures["rms_error_m"] == pytest.approx(np.sqrt((31.0 + 49.0) / 32.0) * 1e-9, rel=1e-3)


def test_missing_samples_do_not_count_and_the_third_axis_is_apart():
    def error(time, reference):
        found = np.full_like(reference, 2e-9)
        found[2] = 5e-9
        found[0, 1000:3000] = np.nan
        return found

    run = ran(error=error, axes=3, slope_x=0.01)
    figures = scan_figures(run)
    assert figures["normal_error_m"] == pytest.approx(5e-9)
    assert figures["rms_error_m"] == pytest.approx(np.sqrt(8.0) * 1e-9)
    assert figures["samples"] == np.count_nonzero(run.clock.line[np.r_[:1000, 3000:40_000]] >= 0)
    scan = run.scan
    with pytest.raises(RecordingError, match=r"displacement has shape \(2, 5\); it must be \(3, 5\)"):
        ScanRun(scan, np.zeros(5), np.zeros((3, 5)), np.zeros((2, 5)))
    with pytest.raises(RecordingError, match="no sample"):
        ScanRun(scan, np.zeros(5), np.zeros((3, 5)), np.full((3, 5), np.nan))


@pytest.mark.slow
@pytest.mark.parametrize("kind, count", [("raster", 4), ("spiral", 3)])
def test_the_page_has_every_figure_and_needs_nothing_beside_it(kind, count, tmp_path):
    def error(time, reference):
        return 3e-9 * np.sin(time * 1e3 + reference * 1e5)

    run = ran(kind, error)
    figures = [figure for _, figure in scan_plots(run)]
    labels = {axis.get_xlabel() for figure in figures for axis in figure.axes}
    assert (
        len(figures) == count
        and {"x [µm]", "line"} <= labels
        and {"position along the line [µm]"} <= labels | {"position along the line [µm]" if kind == "spiral" else ""}
    )
    write_scan_report(tmp_path / "scan.html", run, "A scan & its errors")
    text = (tmp_path / "scan.html").read_text(encoding="utf-8")
    assert text.count("<figure>") == count and text.count("data:image/png") == count
    assert "A scan &amp; its errors" in text and "% of size" in text and "nm" in text
    assert not re.search(r"(?:src|href)=\"(?!data:|#)", text)
    assert ("Coupling" in text) == (kind == "raster")


def lissajous(error_of_x: float = 0.0) -> Recording:
    """Return a run of two axes after 10 held samples; x lags by ``error_of_x`` [m] in the upper half of the plane."""
    time = np.arange(4000) * 1e-4
    moved = np.maximum(time - time[10], 0.0)
    reference = {"x": 5e-6 * np.sin(20.0 * np.pi * moved), "y": 5e-6 * np.sin(30.0 * np.pi * moved)}
    axes = {}
    for name, wanted in reference.items():
        late = np.where(reference["y"] > 0.0, error_of_x, 0.0) if name == "x" else 0.0
        axes[name] = Recording(time, {"reference": wanted, "displacement": wanted - late})
    return Recording.of_axes(axes, {})


@pytest.mark.slow
def test_two_axes_without_a_scan_are_judged_in_their_plane(tmp_path, monkeypatch):
    run = lissajous(3e-8)
    plane = plane_of({name: run.axis(name) for name in run.axes})
    assert plane.names == ("x", "y")
    assert plane.time.size >= len(run) - 11  # from the beginning of the scan on
    upper = plane.reference[1]
    figures = plane_figures(plane)
    assert figures["max_error_m"] == pytest.approx(3e-8)
    assert figures["rms_error_m"] == pytest.approx(3e-8 * np.sqrt(np.mean(upper > 0.0)))
    found = error_map(plane)
    above = found.y[:-1] >= 0.2e-6
    there = found.count[above] > 0
    np.testing.assert_allclose(found.mean[0][above][there], 3e-8)
    np.testing.assert_allclose(found.mean[1][found.count > 0], 0.0, atol=1e-18)
    assert plane_of({"x": run.axis("x")}) is None
    monkeypatch.setattr(report, "drawn", lambda charts, figures: [])  # the charts of each axis
    path = tmp_path / "page.html"
    reported = hr.report(run, path)
    assert reported["plane"] == figures and set(reported) == {"plane", "x", "y"}
    text = path.read_text(encoding="utf-8")
    assert "Path in the plane, coloured by the error" in text and "Map of the error in the plane" in text
    # there is no map for an axis that does not move
    held = Recording(run.time, dict.fromkeys(("reference", "displacement"), 0.0 * run.time))
    hr.report(Recording.of_axes({"x": run.axis("x"), "y": held}, {}), path)
    assert "Map of the error" not in path.read_text(encoding="utf-8")
