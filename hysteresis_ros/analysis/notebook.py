# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""HTML of a run, a model or a design for a notebook: a small table and, if Matplotlib is installed, a plot."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable
from typing import Any

from hysteresis_ros.analysis.identification_report import loops_figure
from hysteresis_ros.analysis.plots import chart_figure, data_uri
from hysteresis_ros.analysis.run_charts import judged, traces_chart
from hysteresis_ros.analysis.side_by_side import report_of
from hysteresis_ros.control.margins import Margins
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.identification.workflow import Compared
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.units import figure_name, readable

#: Rows of the table of a run: figure, label, unit.
RUN_ROWS = (
    ("rms_error_m", "RMS error", "m"),
    ("max_error_m", "largest error", "m"),
    ("overshoot_percent", "overshoot", "%"),
    ("settling_time_s", "settling time", "s"),
    ("saturated_percent", "saturated", "%"),
)
MODEL_ROWS = (
    ("rmse_m", "RMS error", "m"),
    ("rmse_percent_of_stroke", "RMS error relative to the stroke", "%"),
    ("maximum_error_m", "largest error", "m"),
    ("fit_percent", "fit", "%"),
    ("inverse_rmse_v", "RMS error of the inverse", "V"),
)
#: Maximum number of warnings shown in one cell.
MOST_WARNINGS = 3


def run_cell(run: Recording) -> str:
    """Return the HTML of a run."""
    rows = [("samples", f"{len(run)}, every {readable(run.sample_time, 's')}")]
    try:
        judged_rows = _rows(report_of(run).figures(run), RUN_ROWS)
    except HysteresisError:  # the recording lacks the signals of an axis
        judged_rows = []
    rows += judged_rows or [("signals", ", ".join(f"{name} [{unit}]" for name, unit in run.units.items()))]
    return _cell("Run", rows, (), lambda: chart_figure(traces_chart(judged(run))))


def model_cell(found: Compared, title: str) -> str:
    """Return the HTML of a model compared with a recording."""
    rows = [("samples", f"{len(found.data)}, every {readable(found.data.sample_time, 's')}")]
    shown = dict(zip(("V", "m"), found.plant.units, strict=True))
    declared = tuple(
        (figure_name(name, found.plant.units), label, shown.get(unit, unit)) for name, label, unit in MODEL_ROWS
    )
    rows += _rows(found.figures, declared)
    return _cell(title, rows, found.warnings, lambda: loops_figure(found.data, found.predicted, found.validation))


def design_cell(title: str, margins: Margins, warnings: Iterable[str]) -> str:
    """Return the HTML of a designed controller."""
    rows = [
        ("bandwidth", f"{margins.bandwidth:.4g} Hz"),
        ("gain margin", f"{margins.gain_margin:.4g} dB"),
        ("phase margin", f"{margins.phase_margin:.4g}°"),
        ("delay margin", readable(margins.delay_margin, "s")),
        ("sensitivity peak", f"{margins.sensitivity_peak:.4g}"),
    ]
    return _cell(title, rows, warnings)


def _rows(figures: dict, declared: tuple[tuple[str, str, str], ...]) -> list[tuple[str, str]]:
    """Return the table rows of the figures that have a value."""
    return [(label, readable(figures[name], unit)) for name, label, unit in declared if figures.get(name) is not None]


def _cell(
    title: str, rows: list[tuple[str, str]], warnings: Iterable[str], draw: Callable[[], Any] | None = None
) -> str:
    lines = "".join(f"<tr><td>{html.escape(name)}</td><td>{html.escape(text)}</td></tr>" for name, text in rows)
    text = f"<div><b>{html.escape(title)}</b><table>{lines}</table>"
    warnings = tuple(warnings)
    if warnings:
        more = len(warnings) - MOST_WARNINGS
        shown = [*warnings[:MOST_WARNINGS], *([f"{more} more in .warnings"] if more > 0 else [])]
        text += "<ul>" + "".join(f"<li>{html.escape(warning)}</li>" for warning in shown) + "</ul>"
    try:
        source = data_uri(draw()) if draw else ""
    except HysteresisError:  # Matplotlib is not installed, or the signals of the plot are missing
        source = ""
    if source:
        text += f'<img src="{source}" alt="{html.escape(title)}" style="width:560px;max-width:100%">'
    return text + "</div>"
