# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report of a run: a page that, with scripts enabled, also shows the figures of a selected time span."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import numpy as np

from hysteresis_ros.analysis.metrics import compute_metrics, limited_text
from hysteresis_ros.analysis.page import (
    TIME_POINTS,
    asset,
    chart_payload,
    origin,
    packed,
    render_page,
    require_page,
    script_text,
    write_page,
)
from hysteresis_ros.analysis.parts import Kind, period_ends, within
from hysteresis_ros.analysis.plots import Chart, chart_figure, data_uri
from hysteresis_ros.analysis.run_charts import (
    Judged,
    adaptation_chart,
    error_chart,
    histogram_chart,
    judged,
    last_periods_chart,
    late_samples_chart,
    lateness_chart,
    learned_chart,
    loops_chart,
    spectrum_chart,
    trace_retrace_chart,
    traces_chart,
    voltage_chart,
)
from hysteresis_ros.analysis.tables import FINER, leading, part_rows, table_of
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.units import FINE

#: Maximum number of blocks of samples. The page contains sums over each block; a time span consists of whole blocks.
BLOCKS = 1500
#: Maximum number of periods at the end of a run in the column of the last periods.
LAST = 2
#: Kinds of parts that get a column of their own.
SHOWN = (Kind.STEPS, Kind.SCAN, Kind.PATH)
#: Maximum number of columns for parts; the longest parts are shown.
PARTS = 2
#: A part that covers at least this fraction of the run counts as the whole run, and gets no column.
WHOLE = 0.98
#: Figures that the page computes for the selected time span; the other figures need every sample.
ADDED = (
    *("rms_error_m", "rms_error_percent_of_stroke", "max_error_m", "max_error_percent_of_stroke", "iae_m_s"),
    *("voltage_rate_v_s", "voltage_variation_v", "saturated_percent", "stroke_m", "samples", "duration_s"),
    *("lateness_max_s", "skipped_samples"),
)


def columns_of(recording: Recording, figures: dict) -> list[tuple[str, float, float, dict]]:
    """Return name, start, end and figures of each column: the whole run, its longest parts, its last periods."""
    time = recording.time
    found = [("whole run", float(time[0]), float(time[-1]), figures)]
    # a part that is the whole run gets no separate column
    parts = [one for one in figures.get("parts", ()) if one["part"] in SHOWN]
    parts = [one for one in parts if one["to_s"] - one["from_s"] < WHOLE * (time[-1] - time[0])]
    parts = sorted(parts, key=lambda one: one["to_s"] - one["from_s"])[-PARTS:]
    spans = [(one["part"], one["from_s"], one["to_s"]) for one in sorted(parts, key=lambda one: one["from_s"])]
    ends = time[0] + (period_ends(recording) if recording.has("reference") else time[:0])
    count = min(LAST, ends.size - 2)
    if count > 0:
        # the sample at the end of a period belongs to the next period
        name = "last period" if count == 1 else f"last {count} periods"
        spans.append((name, float(ends[count]), float(ends[0]) - 0.5 * recording.sample_time))
    for name, first, last in spans:
        # the measurement may end earlier than the reference
        with contextlib.suppress(RecordingError):
            part = within(recording, first - time[0], last - time[0])
            found.append((name, float(part.time[0]), float(part.time[-1]), compute_metrics(part)))
    return found


def block_sums(run: Judged, blocks: int = BLOCKS) -> dict[str, np.ndarray]:
    """Return sums over blocks of samples; they give the exact figures of any span of whole blocks.

    A term between two samples belongs to the block of the later sample; ``joint_…`` is the term between the last sample
    of the block before and the first sample of this block. A span that begins with this block omits it.

    ====================== ================================================================================
    ``from``, ``to``       first and last time of the block [s]
    ``samples``            number of samples
    ``errors``, ``square`` number of errors that count, and Σ e² [m²]
    ``largest``            largest abs(e) [m]
    ``area``               Σ ½ (abs(e_k) + abs(e_(k-1))) (t_k - t_(k-1)) [m s]
    ``low``, ``high``      range of the reference, or of the displacement without one [m]
    ``volts``, ``rises``   number of voltages, Σ abs(V_k - V_(k-1)) [V]
    ``rates``              Σ ((V_k - V_(k-1)) / (t_k - t_(k-1)))² [V²/s²]
    ``flags``, ``cut``     samples with a saturation flag, and saturated samples
    ``late``, ``skipped``  largest lateness [s], skipped samples
    ====================== ================================================================================
    """
    recording, time = run.recording, run.recording.time
    size = -(-time.size // blocks)
    block = np.arange(time.size) // size
    count = int(block[-1]) + 1
    starts = np.arange(count) * size
    found = {
        "from": time[starts],
        "to": time[np.minimum(starts + size, time.size) - 1],
        "samples": np.bincount(block, minlength=count),
    }
    judged = np.isfinite(run.displacement) & (True if run.reference is None else np.isfinite(run.reference))
    level = run.displacement if run.reference is None else run.reference
    found["low"] = np.fmin.reduceat(np.where(judged, level, np.nan), starts)
    found["high"] = np.fmax.reduceat(np.where(judged, level, np.nan), starts)
    if run.error is not None:
        found |= _error_sums(block[run.counted], time[run.counted], np.abs(run.error[run.counted]), count)
    volts = judged & np.isfinite(recording["voltage"]) if "voltage" in recording else np.zeros(time.size, dtype=bool)
    if np.count_nonzero(volts) > 2:
        found |= _voltage_sums(block[volts], time[volts], recording["voltage"][volts], count)
    if recording.has("saturated"):
        flags = np.isfinite(recording["saturated"])
        found["flags"] = np.bincount(block[flags], minlength=count)
        found["cut"] = np.bincount(block[flags], recording["saturated"][flags] > 0.0, minlength=count)
    if recording.has("lateness"):
        found["late"] = np.fmax.reduceat(recording["lateness"], starts)
    if recording.has("skipped"):
        found["skipped"] = np.bincount(block, np.nan_to_num(recording["skipped"]), minlength=count)
    return found


def _error_sums(block, time, error, count: int) -> dict[str, np.ndarray]:
    area = np.diff(time) * 0.5 * (error[1:] + error[:-1])
    largest = np.zeros(count)
    np.maximum.at(largest, block, error)
    return {
        "errors": np.bincount(block, minlength=count),
        "square": np.bincount(block, error**2, minlength=count),
        "largest": largest,
        **_joined("area", block, area, count),
    }


def _voltage_sums(block, time, voltage, count: int) -> dict[str, np.ndarray]:
    step = np.diff(voltage)
    return {
        "volts": np.bincount(block, minlength=count),
        **_joined("rises", block, np.abs(step), count),
        **_joined("rates", block, (step / np.diff(time)) ** 2, count),
    }


def _joined(name: str, block, terms, count: int) -> dict[str, np.ndarray]:
    """Return for each block the sum of the terms between neighbouring samples, and the term before its first sample."""
    joint = np.zeros(count)
    crossing = np.flatnonzero(np.diff(block)) + 1
    joint[block[crossing]] = terms[crossing - 1]
    return {name: np.bincount(block[1:], terms, minlength=count), f"joint_{name}": joint}


#: Functions that make the charts of a run, in order; each returns None if the run has no data for its chart.
CHARTS = (
    *(traces_chart, error_chart, loops_chart, trace_retrace_chart, last_periods_chart, spectrum_chart),
    *(histogram_chart, voltage_chart, adaptation_chart, learned_chart, lateness_chart, late_samples_chart),
)
#: Size limit of a page [bytes]; a larger page is made again with fewer points per chart.
LARGEST = 2_000_000


def charts_of(run: Judged) -> list[Chart]:
    """Return all charts for which the run has data."""
    return [chart for make in CHARTS if (chart := make(run)) is not None]


def sampling_text(recording: Recording) -> str:
    """Return a sentence about the samples from which the figures are computed."""
    if len(recording) < 2:
        return "Evaluated at a single sample."
    limited = limited_text(recording)
    first = f"{limited[0].upper()}{limited[1:]}. " if limited else ""
    judged_at = f"{first}Evaluated at all {len(recording)} samples, one every {1e3 * recording.sample_time:.6g} ms"
    held = _samples_per_voltage(recording)
    if held > 1:
        return f"{judged_at}: {held} for each voltage, and thus also between the commands."
    return f"{judged_at}; what happens between them is not in the recording."


def _samples_per_voltage(recording: Recording) -> int:
    """Return the number of samples for which each voltage is held."""
    if not recording.has("voltage"):
        return 1
    changes = np.flatnonzero(np.diff(recording["voltage"]) != 0.0)
    return math.gcd(*np.diff(changes).tolist()) if changes.size > 2 else 1


def drawn(charts: Sequence[Chart], figures: dict) -> list[dict]:
    """Return the charts for display without scripts: name, caption, picture and note."""
    return [
        dict(
            name=chart.name,
            caption=chart.caption,
            note=chart.note,
            source=data_uri(figures.get(chart.name) or chart_figure(chart)),
        )
        for chart in charts
    ]


def render_interactive(
    template: str, charts: Sequence[Chart], about: dict, figures: dict | None = None, **values
) -> str:
    """Return a page with charts, with fewer points if the page would otherwise exceed :data:`LARGEST`."""
    pictures = drawn(charts, figures or {})
    points, html = TIME_POINTS, ""
    while not html or (len(html.encode("utf-8")) > LARGEST and points > TIME_POINTS // 32):
        payload = chart_payload(charts, points) | dict(finer=FINER, fine=FINE) | about
        html = render_page(
            template,
            charts=pictures,
            block=payload["samples"],
            data=script_text(payload),
            styles=asset("uPlot.min.css"),
            scripts=[asset("uPlot.iife.min.js"), asset("span.js"), asset("charts.js")],
            **values,
        )
        points //= 2
    return html


def render_report(
    recording: Recording, title: str, figures: dict | None = None, first: Sequence[tuple[str, str]] = ()
) -> str:
    """Return the report as HTML: table of figures, charts, notes and configuration."""
    figures = figures or compute_metrics(recording)
    run = judged(recording)
    spans = columns_of(recording, figures)
    about = {
        "whole": [float(recording.time[0]), float(recording.time[-1])],
        "first": float(recording.metadata.get("first_s", recording.time[0])),
        "spans": [[name, begin, end] for name, begin, end, _ in spans],
        "runs": [dict(name="", sums=packed_sums(run))],
    }
    return render_interactive(
        "report.html.j2",
        charts_of(run),
        about,
        title=title,
        columns=[(name, f"{begin:.7g} … {end:.7g} s") for name, begin, end, _ in spans],
        spans=about["spans"],
        rows=table_of([figures for *_, figures in spans], leading([figures])),
        parts=part_rows(figures),
        added=ADDED,
        shown=[""],
        plots=[dict(caption=caption, source=source) for caption, source in first],
        notes=figures["notes"]["recording"],
        judged=[sampling_text(recording)],
        configurations=[("Configuration", recording.configuration)] if recording.configuration else [],
        origins=[origin(recording)],
    )


def packed_sums(run: Judged, blocks: int = BLOCKS) -> dict[str, str]:
    """Return sums over blocks of a run, encoded for a page."""
    return {name: packed(values, "<f8") for name, values in block_sums(run, blocks).items()}


def write_report(
    recording: Recording, path, title: str, figures: dict | None = None, first: Sequence[tuple[str, str]] = ()
) -> None:
    """Write the report; the other parameters are those of :func:`render_report`."""
    # checked first, because drawing is slow
    require_page(path)
    write_page(path, render_report(recording, title, figures, first))
