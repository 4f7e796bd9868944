# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report of a run: a page that can be read anywhere, and looked into where scripts run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hysteresis_ros.analysis.charts import Chart, chart_figure
from hysteresis_ros.analysis.error_charts import (
    histogram_chart,
    last_periods_chart,
    spectrum_chart,
    trace_retrace_chart,
)
from hysteresis_ros.analysis.limited import limited_text
from hysteresis_ros.analysis.metrics import compute_metrics
from hysteresis_ros.analysis.page import asset, origin, render_page, require_page, write_page
from hysteresis_ros.analysis.payload import TIME_POINTS, chart_payload, packed, script_text
from hysteresis_ros.analysis.plots import data_uri
from hysteresis_ros.analysis.run_charts import (
    Judged,
    adaptation_chart,
    error_chart,
    judged,
    late_samples_chart,
    lateness_chart,
    learned_chart,
    loops_chart,
    traces_chart,
    voltage_chart,
)
from hysteresis_ros.analysis.shown_figures import FINER, leading, part_rows
from hysteresis_ros.analysis.spans import ADDED, BLOCKS, block_sums, columns_of
from hysteresis_ros.analysis.tables import table_of
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.units import FINE

#: Charts of a run, in their order; each None where there is nothing to show.
CHARTS = (
    *(traces_chart, error_chart, loops_chart, trace_retrace_chart, last_periods_chart, spectrum_chart),
    *(histogram_chart, voltage_chart, adaptation_chart, learned_chart, lateness_chart, late_samples_chart),
)
#: Largest size of a page [bytes]; what is drawn becomes coarser before a page becomes larger.
LARGEST = 2_000_000


def charts_of(run: Judged) -> list[Chart]:
    """Return the charts that there are of a run.

    Parameters
    ----------
    run : Judged
    """
    return [chart for make in CHARTS if (chart := make(run)) is not None]


def sampling_text(recording: Recording) -> str:
    """Return at which instants a run is judged, in a sentence.

    Parameters
    ----------
    recording : Recording
    """
    if len(recording) < 2:
        return "Judged at a single sample."
    limited = limited_text(recording)
    first = f"{limited[0].upper()}{limited[1:]}. " if limited else ""
    judged_at = f"{first}Judged at all {len(recording)} samples, one every {1e3 * recording.sample_time:.6g} ms"
    held = _samples_per_voltage(recording)
    if held > 1:
        return f"{judged_at}: {held} for each voltage, so between the commands too."
    return f"{judged_at}; what happens between them is not in the recording."


def _samples_per_voltage(recording: Recording) -> int:
    """Return for how many samples each voltage is held; 1 where it changes from sample to sample."""
    if not recording.has("voltage"):
        return 1
    changes = np.flatnonzero(np.diff(recording["voltage"]) != 0.0)
    return int(np.gcd.reduce(np.diff(changes))) if changes.size > 2 else 1


def drawn(charts: Sequence[Chart], figures: dict) -> list[dict]:
    """Return the charts as a template shows them where no script runs: name, caption, picture and note.

    Parameters
    ----------
    charts : sequence of Chart
    figures : dict
        Name of a chart → the figure that is its picture, where it is not drawn from the chart.
    """
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
    """Return a page with charts, no larger than :data:`LARGEST` where that can be had by coarser charts.

    Parameters
    ----------
    template : str
    charts : sequence of Chart
    about : dict
        What the page's script needs beside the charts; what JSON can hold.
    figures : dict, optional
        See :func:`drawn`.
    **values
        For the template.
    """
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
    """Return the report as HTML: table of figures, charts, notes and configuration.

    Parameters
    ----------
    recording : Recording
        The run.
    title : str
        Heading, such as the name of the bag.
    figures : dict, optional
        What :func:`hysteresis_ros.analysis.metrics.compute_metrics` gave, when it is known already.
    first : sequence of (str, str)
        Further pictures before those of the run: caption, and :func:`hysteresis_ros.analysis.plots.data_uri`.

    Raises
    ------
    HysteresisError
        Matplotlib or Jinja2 is missing (the message says how to install them), or there is nothing to judge.
    """
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
    """Return the sums over blocks of a run as a page holds them.

    Parameters
    ----------
    run : Judged
    blocks : int
        Most blocks.
    """
    return {name: packed(values, "<f8") for name, values in block_sums(run, blocks).items()}


def write_report(
    recording: Recording, path, title: str, figures: dict | None = None, first: Sequence[tuple[str, str]] = ()
) -> None:
    """Write the report; the other parameters are those of :func:`render_report`.

    Parameters
    ----------
    recording : Recording
    path : path-like
        HTML file.
    title : str
    figures : dict, optional
    first : sequence of (str, str)

    Raises
    ------
    MissingExtraError
        Jinja2 is not installed.
    RecordingError
        There is nothing to judge, or the file cannot be written.
    """
    # before a second of drawing
    require_page(path)
    write_page(path, render_report(recording, title, figures, first))
