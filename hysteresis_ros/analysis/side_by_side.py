# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Comparison of several runs, all of actuators or all of inchworm motors: a table of figures, and overlaid charts."""

from __future__ import annotations

import difflib
import os
import pathlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros.analysis.inchworm import (
    COMMON_FIGURES,
    RUN_FIGURES,
    format_inchworm,
    inchworm_figures,
    inchworm_run,
    is_inchworm,
)
from hysteresis_ros.analysis.inchworm_report import inchworm_charts, write_inchworm_report
from hysteresis_ros.analysis.metrics import compute_metrics
from hysteresis_ros.analysis.page import origin, write_page
from hysteresis_ros.analysis.plots import SIDE_BY_SIDE, Chart, Line, data_uri, length_unit
from hysteresis_ros.analysis.report import (
    ADDED,
    BLOCKS,
    charts_of,
    packed_sums,
    render_interactive,
    sampling_text,
    write_report,
)
from hysteresis_ros.analysis.run_charts import Judged, judged, largest_error
from hysteresis_ros.analysis.scan_report import PlaneRun, plane_plots
from hysteresis_ros.analysis.tables import aligned, format_parts, format_table, leading, part_rows, table_of
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording

#: For each chart, the lines that are overlaid for several runs, and their dash styles.
OVERLAID: dict[str, dict[str, tuple[float, ...]]] = {
    "traces": {"displacement": ()},
    "error": {"error": ()},
    "loops": {"after compensation": (), "before compensation": (2.0, 2.0)},
    "trace": {"trace": (), "retrace": (2.0, 2.0)},
    "periods": {"last": ()},
    "spectrum": {"error": ()},
    "histogram": {"samples": ()},
    "voltage": {"voltage": ()},
    "learned": {"period": ()},
    "late_samples": {"samples": ()},
}


def compare_runs(runs: dict[str, Recording]) -> dict[str, dict]:
    """Return the figures of merit of each run."""
    require_common({name: _there(run) for name, run in runs.items()})
    return figures_of_each(runs, compute_metrics)


def figures_of_each(runs: dict[str, Recording], figures: Callable[[Recording], dict]) -> dict[str, dict]:
    """Return the figures of each run."""
    found = {}
    for name, run in runs.items():
        try:
            found[name] = figures(run)
        except RecordingError as error:
            raise RecordingError(f"{name}: {error}") from None
    return found


def _there(run: Recording) -> set[str]:
    """Return the names of the signals that have values; ``measured`` counts as ``displacement``."""
    return {"displacement" if name == "measured" else name for name in run.signals if run.has(name)}


def require_common(signals: dict[str, set[str]]) -> set[str]:
    """Return the signals that all runs have."""
    common = set.intersection(*signals.values())
    if not common:
        said = "; ".join(f"{name} has {', '.join(sorted(there)) or 'nothing'}" for name, there in signals.items())
        raise RecordingError(f"the runs have no signal in common: {said}; give runs with a common signal")
    return common


def format_runs(figures: dict[str, dict]) -> str:
    """Return the figures of several runs as aligned lines for a terminal."""
    parts = [line for name, one in figures.items() for line in format_parts(one, name)]
    columns = list(figures.values())
    return "\n".join([*parts, format_rows(figures, table_of(columns, leading(columns)))])


def format_rows(figures: dict[str, dict], rows: list[dict]) -> str:
    """Return a table of several runs as aligned lines for a terminal, with the notes of each run."""
    lines = [("Run", list(figures), ""), *((row["label"], row["cells"], row["shown_unit"]) for row in rows)]
    notes = [f"note: {name}: {note}" for name, one in figures.items() for note in one["notes"]["recording"]]
    return "\n".join([*aligned(lines), *notes])


def overlaid(runs: dict[str, Judged]) -> list[Chart]:
    """Return the overlaid charts of several runs; time 0 is the first sample of each run."""
    unit = length_unit(max(largest_error(run) for run in runs.values()))
    charts: dict[str, list[tuple[str, str, Chart]]] = {}
    for number, (label, run) in enumerate(runs.items()):
        colour = SIDE_BY_SIDE[number % len(SIDE_BY_SIDE)]
        for chart in charts_of(replace(run, unit=unit)):
            if chart.name in OVERLAID:
                charts.setdefault(chart.name, []).append((label, colour, chart))
    return [_laid_over(name, charts[name]) for name in OVERLAID if name in charts]


def _laid_over(name: str, charts: list[tuple[str, str, Chart]]) -> Chart:
    lines, notes = [], []
    for label, colour, chart in charts:
        for line in chart.lines:
            found = next((start for start in OVERLAID[name] if line.label.startswith(start)), None)
            if found is not None and not (name == "periods" and line.label != "last"):
                words = label if len(OVERLAID[name]) == 1 else f"{label}: {line.label}"
                lines.append(replace(line, label=words, colour=colour, dash=OVERLAID[name][found], width=1.2))
        notes += [f"{label}: {chart.note}"] if chart.note else []
    first = charts[0][2]
    if name == "traces":
        lines += _references(charts)
    kind = "overlay" if first.kind == "time" else first.kind
    caption = first.caption if name != "traces" else "Displacement over time since the first sample"
    return replace(
        first, caption=caption, lines=lines, kind=kind, shaded=None, marked=None, limits=None, note="\n".join(notes)
    )


def _references(charts: list[tuple[str, str, Chart]]) -> list[Line]:
    """Return the distinct references of the runs."""
    found: list[Line] = []
    for label, _, chart in charts:
        for line in chart.lines:
            if line.colour != "reference" or any(_alike(line, other) for other in found):
                continue
            words = "reference" if not found else f"reference of {label}"
            found.append(replace(line, label=words, colour="setpoint", dash=(4.0, 3.0), width=1.0))
    return found


def _alike(line: Line, other: Line) -> bool:
    """Return whether two lines agree in their common interval of x, within a thousandth of their range."""
    last = min(line.x[-1], other.x[-1])
    there = line.x <= last
    apart = np.abs(np.interp(line.x[there], other.x, other.y) - line.y[there])
    return bool(np.nanmax(apart, initial=0.0) <= 1e-3 * max(np.nanmax(line.y) - np.nanmin(line.y), 1e-12))


def configurations(runs: dict[str, Recording]) -> list[tuple[str, str]]:
    """Return headings and texts: configuration of the first run, and how the other configurations differ from it."""
    (first, base), *others = [(name, run.configuration) for name, run in runs.items()]
    texts = [(f"Configuration of {first}", base)] if base else []
    for name, text in others:
        if text == base:
            texts += [(f"Configuration of {name}", f"the same as that of {first}")] if text else []
        elif text:
            lines = difflib.unified_diff(base.splitlines(), text.splitlines(), first, name, lineterm="")
            texts.append((f"Configuration of {name}: differences from {first}", "\n".join(lines)))
    return texts


def render_side_by_side(
    runs: dict[str, Recording],
    title: str,
    figures: dict[str, dict] | None = None,
    plane: PlaneRun | None = None,
) -> str:
    """Return the page of several runs: table of figures, overlaid charts, the plane of two axes, configurations."""
    figures = figures or compare_runs(runs)
    # time 0 is the first sample of each run
    since = {name: judged(replace(run, time=run.time - run.time[0])) for name, run in runs.items()}
    blocks = max(100, BLOCKS // len(runs))
    sums = [dict(name=name, sums=packed_sums(run, blocks)) for name, run in since.items()]
    rows = table_of(list(figures.values()), leading(list(figures.values())))
    drawn = () if plane is None else plane_plots(plane)
    plots = [dict(caption=caption, source=data_uri(figure)) for caption, figure in drawn]
    return render_laid_over(runs, title, figures, overlaid(since), rows, sums, plots)


def render_laid_over(
    runs: dict[str, Recording],
    title: str,
    figures: dict[str, dict],
    charts: list[Chart],
    rows: list[dict],
    sums: Sequence[dict] = (),
    plots: Sequence[dict] = (),
) -> str:
    """Return a page of several runs from given charts and a given table."""
    longest = max(float(run.time[-1] - run.time[0]) for run in runs.values())
    about = {"whole": [0.0, longest], "first": 0.0, "spans": [["all", 0.0, longest]], "runs": list(sums)}
    return render_interactive(
        "report.html.j2",
        charts,
        about,
        title=title,
        columns=[(name, f"{figures[name]['duration_s']:.7g} s") for name in runs],
        spans=about["spans"],
        rows=rows,
        parts=[row | dict(run=name) for name in runs for row in part_rows(figures[name])],
        added=ADDED if sums else (),
        shown=list(runs) if sums else [],
        plots=plots,
        notes=[f"{name}: {note}" for name in runs for note in figures[name]["notes"]["recording"]],
        judged=[f"{name}: {sampling_text(run)}" for name, run in runs.items()],
        configurations=configurations(runs),
        origins=[f"{name}: {origin(run)}" for name, run in runs.items()],
    )


#: Figures that summarise the moves of a run: name, label, displayed unit, factor that converts from the SI unit.
SUMMARY = (
    ("moves", "Moves", "", 1.0),
    ("arrived", "Moves that arrived", "", 1.0),
    ("failed", "Moves that did not arrive, or ended with an error", "", 1.0),
    ("time_s", "Total time of the moves that arrived", "s", 1.0),
    ("walking_speed_m_s", "Walking speed, slowest move", "µm/s", 1e6),
    ("final_error_rms_m", "Final error, RMS, worst move", "nm", 1e9),
    ("final_error_max_m", "Final error, largest", "nm", 1e9),
    ("overshoot_m", "Overshoot, worst move", "µm", 1e6),
)
#: For each chart, the line that is drawn for each run.
OVERLAID_OF_MOTORS = {"travel": "slider", "final_error": "slider − setpoint"}


def summary(moves: list[dict]) -> dict:
    """Return the summary of moves by the names in :data:`SUMMARY`; a figure that no move has is None."""

    def of(name: str) -> list[float]:
        return [move[name] for move in moves if move[name] is not None]

    outcomes = [move["outcome"] for move in moves]
    worst = {name: max(of(name), default=None) for name in ("final_error_rms_m", "final_error_max_m", "overshoot_m")}
    return {
        "moves": len(moves),
        "arrived": outcomes.count("arrived"),
        "failed": sum(outcome == "not arrived" or outcome.startswith("error") for outcome in outcomes),
        "time_s": sum(of("time_s")) if of("time_s") else None,
        "walking_speed_m_s": min(of("walking_speed_m_s"), default=None),
        **worst,
    }


def compare_motors(runs: dict[str, Recording]) -> dict[str, dict]:
    """Return the figures of each run, with a summary of its moves under ``summary``."""
    found = figures_of_each(runs, inchworm_figures)
    return {name: {"summary": summary(figures["moves"]), **figures} for name, figures in found.items()}


def _rows(figures: dict[str, dict]) -> list[dict]:
    """Return the rows of the table: summary of the moves, figures of the run, figures that any axis has."""
    of = list(figures.values())
    return [
        *table_of([one["summary"] for one in of], SUMMARY),
        *table_of([one["run"] for one in of], RUN_FIGURES),
        *table_of(of, COMMON_FIGURES),
    ]


def format_motors(figures: dict[str, dict]) -> str:
    """Return the figures of several runs as aligned lines for a terminal."""
    return format_rows(figures, _rows(figures))


def laid_over(runs: dict[str, Recording]) -> list[Chart]:
    """Return the overlaid charts of position and final error of several runs; time 0 is each run's first sample."""
    found: dict[str, Chart] = {}
    lines: dict[str, list[Line]] = {}
    for number, (label, run) in enumerate(runs.items()):
        colour = SIDE_BY_SIDE[number % len(SIDE_BY_SIDE)]
        for chart in inchworm_charts(inchworm_run(replace(run, time=run.time - run.time[0]))):
            if chart.name in OVERLAID_OF_MOTORS:
                (line,) = [line for line in chart.lines if line.label == OVERLAID_OF_MOTORS[chart.name]]
                own = lines.setdefault(chart.name, [])
                found.setdefault(chart.name, replace(chart, lines=own, kind="overlay"))
                own.append(replace(line, label=label, colour=colour, width=1.2))
    return [found[name] for name in OVERLAID_OF_MOTORS if name in found]


def render_motors(
    runs: dict[str, Recording],
    title: str,
    figures: dict[str, dict] | None = None,
    plane: PlaneRun | None = None,
) -> str:
    """Return the page of several runs: table of figures, overlaid charts, configurations; ``plane`` is not used."""
    figures = figures or compare_motors(runs)
    return render_laid_over(runs, title, figures, laid_over(runs), _rows(figures))


class Report(NamedTuple):
    """Functions for one kind of axis: figures, table and page of one run, and of several runs together."""

    figures: Callable[[Recording], dict]
    table: Callable[[dict], str]  #: ``table(figures)`` returns lines for a terminal.
    write: Callable[..., None]  #: ``write(run, path, title, figures)`` writes a page.
    compare: Callable[[dict[str, Recording]], dict[str, dict]]  #: ``compare(runs)`` returns the figures of each run.
    compared_table: Callable[[dict[str, dict]], str]  #: ``compared_table(figures)`` returns lines for a terminal.
    render_compared: Callable[..., str]  #: ``render_compared(runs, title, figures, plane)`` returns a page.


REPORT = Report(compute_metrics, format_table, write_report, compare_runs, format_runs, render_side_by_side)
INCHWORM_REPORT = Report(
    inchworm_figures, format_inchworm, write_inchworm_report, compare_motors, format_motors, render_motors
)


def report_of(run: Recording) -> Report:
    """Return the report for the kind of axis in a run."""
    return INCHWORM_REPORT if is_inchworm(run) else REPORT


def labels_of(paths: Sequence[str | os.PathLike[str]]) -> dict[str, pathlib.Path]:
    """Return a name for each recording: the file name, preceded by as much of the path as makes it unique."""
    whole = [pathlib.Path(path).resolve() for path in paths]
    if len(set(whole)) < len(whole):
        again = next(path for path, full in zip(paths, whole, strict=True) if whole.count(full) > 1)
        raise RecordingError(f"{again} is given more than once; give each recording once")
    for parts in range(1, max((len(path.parts) for path in whole), default=1) + 1):
        labels = ["/".join(path.parts[-parts:]) for path in whole]
        if len(set(labels)) == len(labels):
            break
    return dict(zip(labels, map(pathlib.Path, paths), strict=True))


def common_report(runs: dict[str, Recording]) -> Report:
    """Return the report for runs of the same kind of axis."""
    names = {report_of(run): name for name, run in reversed(runs.items())}
    if len(names) > 1:
        raise RecordingError(
            f"{names[INCHWORM_REPORT]} is a run of an inchworm motor, whose figures describe moves, and "
            f"{names[REPORT]} is a run of an actuator: compare runs of one kind only"
        )
    (report,) = names
    return report


def report_several(
    runs: dict[str, Recording], path=None, title: str | None = None, plane: PlaneRun | None = None
) -> tuple[dict[str, dict], str]:
    """Compare runs; return the figures of each run, and lines for a terminal; with ``path``, also write a page.

    If the runs are two axes of a stage, ``plane`` contains both, and the page also shows pictures of the plane.
    """
    if not runs:
        raise RecordingError("no run to report: give at least one recording")
    report = common_report(runs)
    figures = report.compare(runs)
    if path is not None:
        write_page(path, report.render_compared(runs, title or " · ".join(runs), figures, plane))
    return figures, report.compared_table(figures)
