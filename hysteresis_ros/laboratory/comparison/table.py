# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Output of the comparison: tables, JSON, a page with plots, and the configuration of the best combination."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Sequence

import numpy as np

from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import data_uri, envelope, new_figure
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.identification.parameter_file import write_file
from hysteresis_ros.identification.safe_motion import with_safe_motion
from hysteresis_ros.laboratory.comparison.compare import Comparison, Table, judgement
from hysteresis_ros.laboratory.comparison.rows import Row
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import single_axis

_COLOURS = ("#1f6fb2", "#d1495b", "#2a9d8f", "#e09f3e")
_BACKGROUND = "#b8b8b8"


def ranking_figure(labels: list[str], values: dict[str, list[np.ndarray]]):
    """Return the figure of the errors of all combinations [% of stroke], best on top."""
    figure, axes = new_figure(1.2 + 0.26 * len(labels), len(values))
    places = np.arange(len(labels))[::-1]
    for number, (axis, (name, rows)) in enumerate(zip(axes, values.items(), strict=True)):
        colour = _COLOURS[number % len(_COLOURS)]
        for place, errors in zip(places, rows, strict=True):
            axis.plot(
                errors, np.full(len(errors), place), linestyle="", marker="o", markersize=3.0, mfc="none", mec=colour
            )
            axis.plot([np.max(errors)], [place], linestyle="", marker="o", markersize=6.0, color=colour)
        axis.set_xscale("log")
        _label_decades(axis)
        axis.set(xlabel="RMS error [% of stroke]", ylim=(-0.7, len(labels) - 0.3))
        axis.set_title(name, fontsize=11)
        axis.set_yticks(places, labels if number == 0 else [""] * len(labels), fontsize=8)
        axis.grid(True, which="both", axis="x", linewidth=0.4, alpha=0.6)
        axis.grid(True, axis="y", linewidth=0.4, alpha=0.4)
    return figure


def _label_decades(axis) -> None:
    """Label 1, 2 and 5 of each decade; with many decades only 1, so that the labels do not overlap."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_xlim()
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())


def errors_figure(errors: dict[str, tuple[np.ndarray, np.ndarray]]):
    """Return the figure of errors [% of stroke] versus time [s], each in a panel with its own scale."""
    figure, axes = new_figure(1.9 * len(errors), 1, rows=len(errors))
    for number, (axis, (name, (time, error))) in enumerate(zip(axes, errors.items(), strict=True)):
        axis.axhline(0.0, color=_BACKGROUND, linewidth=0.8)
        axis.plot(*envelope(time, 100.0 * error), color=_COLOURS[number % len(_COLOURS)], linewidth=1.0)
        rms = 100.0 * np.sqrt(np.mean(error**2))
        axis.set_title(f"{name}: RMS {rms:.3g} % in these periods", fontsize=10, loc="left")
        axis.set(ylabel="error [% of stroke]")
    axes[-1].set(xlabel="time [s]")
    return figure


def write_ranking_page(path, title: str, *, tables, **contents) -> None:
    """Write a self-contained page with tables of ranked combinations."""
    drawn = [
        {**table, "plots": [dict(caption=caption, source=data_uri(figure)) for caption, figure in table["figures"]]}
        for table in tables
    ]
    write_page(path, render_page("ranking.html.j2", title=title, tables=drawn, **contents))


TITLE = "Controllers and compensators under realistic conditions"
RANKING = "Ranked by the geometric mean over the references of the RMS error on the worst plant."
#: Columns of a task: heading, unit, and function of the row and its result.
ERRORS = (
    ("median RMS", "%", lambda row, task: 100.0 * np.median(row.results[task].rms)),
    ("worst RMS", "%", lambda row, task: 100.0 * row.results[task].worst),
    ("worst error", "%", lambda row, task: 100.0 * np.max(row.results[task].maximum)),
    ("undelayed", "%", lambda row, task: 100.0 * np.max(row.results[task].undelayed)),
    ("× PI", "", lambda row, task: row.better.get(task, 1.0)),
)
#: Columns of the control effort (the largest value over the references): heading, unit, and function of a Result.
COSTS = (
    ("effort", "V/s", lambda result: np.max(result.effort)),
    ("chattering", "nm", lambda result: np.max(result.chattering) * 1e9),
    ("at limits", "% of time", lambda result: 100.0 * result.saturated),
)
#: Controller whose best row is plotted, in addition to the benchmark and the best row of all.
SHOWN = "feedforward"


def blocks(table: Table) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return the blocks of columns after controller and compensator: block name, headings and units of its columns."""
    found = [(task, [(heading, unit) for heading, unit, _ in ERRORS]) for task in table.tasks]
    return [("", [("delay", "ms")]), *found, ("largest of both", [(heading, unit) for heading, unit, _ in COSTS])]


def cells(tasks: Sequence[str], rank: str, row: Row) -> list[str]:
    """Return the cells of a row in a table of these tasks; a refused candidate has dashes."""
    names = [rank, row.controller, row.compensator]
    if row.refused:
        return names + ["–"] * (1 + len(ERRORS) * len(tasks) + len(COSTS))
    numbers = [float(value(row, task)) for task in tasks for _, _, value in ERRORS]
    numbers += [float(max(value(result) for result in row.results.values())) for _, _, value in COSTS]
    return [*names, delays(row), *(f"{number:.3g}" for number in numbers)]


def delays(row: Row) -> str:
    """Return the constant delay of a row [ms], or the range over its designs."""
    ends = [f"{1e3 * delay:.3g}" for delay in (min(row.delays), max(row.delays))]
    return ends[0] if ends[0] == ends[1] else " … ".join(ends)


def ranks(table: Table) -> list[str]:
    """Return the cells of the first column: the rank of a row, or the reason why it has no rank."""
    found, rank = [], 0
    for row in table.rows:
        rank += row.ranked
        found.append(str(rank) if row.ranked else "–" if row.refused else "unstable" if row.unstable else "marked")
    return found


def all_cells(table: Table) -> list[list[str]]:
    """Return the cells of all rows, the benchmark last."""
    found = [cells(table.tasks, rank, row) for rank, row in zip(ranks(table), table.rows, strict=True)]
    return [*found, cells(table.tasks, "PI", table.yardstick)]


def format_table(table: Table) -> str:
    """Return a table for a terminal, with its plants and its refused and marked rows."""
    rows, parts = all_cells(table), blocks(table)
    heads = ["", "controller", "compensator"] + [heading for _, columns in parts for heading, _ in columns]
    units = ["", "", ""] + [unit for _, columns in parts for _, unit in columns]
    widths = [max(map(len, column)) for column in zip(heads, units, *rows, strict=True)]

    def line(values):
        pairs = zip(values, widths, strict=True)
        padded = [text.ljust(width) if i in (1, 2) else text.rjust(width) for i, (text, width) in enumerate(pairs)]
        return "  ".join(padded).rstrip()

    above, column = " " * (sum(widths[:3]) + 6), 3
    for name, columns in parts:
        width = sum(widths[column : column + len(columns)]) + 2 * (len(columns) - 1)
        above += f"{name[:width]:{'-' if name else ' '}^{width}}  "
        column += len(columns)
    lines = [table.title, table.summary, "", above.rstrip(), line(heads), line(units), *map(line, rows)]
    for heading, texts in (("Unstable", unstable(table)), ("Marked", marks(table)), ("Refused", refusals(table))):
        lines += ["", heading, *(f"- {text}" for text in texts)] if texts else []
    return "\n".join([*lines, "", "Plants", *(f"- {text}" for text in table.assumptions)])


def format_comparison(comparison: Comparison) -> str:
    """Return the tables for a terminal, with the rules of evaluation."""
    parts = [TITLE, *map(format_table, comparison.tables)]
    judged = [RANKING, "", "Judged", *(f"- {text}" for text in judgement(comparison.conditions))]
    return "\n\n".join([*parts, "\n".join(judged)])


def label(row: Row) -> str:
    """Return the names of a row."""
    return f"{row.controller}, {row.compensator}"


def refusals(table: Table) -> list[str]:
    """Return the refused rows with reasons."""
    return [f"{label(row)}: {row.refused}" for row in table.rows if row.refused]


def marks(table: Table) -> list[str]:
    """Return the marked rows with reasons."""
    return [f"{label(row)}: {row.marked}" for row in table.rows if row.marked]


def unstable(table: Table) -> list[str]:
    """Return the unstable rows with the number of unstable plants, and whether the row was marked."""
    return [
        f"{label(row)}: on {row.unstable} plants, {'marked beforehand' if row.marked else 'not marked beforehand'}"
        for row in table.rows
        if row.unstable
    ]


def write_comparison_page(comparison: Comparison, path) -> None:
    """Write the comparison as a page with plots."""
    tables = [
        dict(
            title=table.title,
            summary=table.summary,
            blocks=blocks(table),
            rows=[dict(cells=row, plain=row[0].isdigit()) for row in all_cells(table)],
            notes=[
                (heading, texts)
                for heading, texts in (
                    ("Unstable", unstable(table)),
                    ("Marked", marks(table)),
                    ("Refused", refusals(table)),
                    ("Plants", table.assumptions),
                )
                if texts
            ],
            figures=figures(table),
        )
        for table in comparison.tables
    ]
    write_ranking_page(
        path,
        TITLE,
        tables=tables,
        ranking=RANKING,
        judged=judgement(comparison.conditions),
        configuration=comparison.configuration.original,
    )


def to_json(comparison: Comparison) -> dict:
    """Return all data that JSON can hold, in SI units and fractions of the stroke; ``rows`` is in order of rank."""
    conditions = comparison.conditions
    return {
        "conditions": {name: getattr(conditions, name) for name in conditions.__dataclass_fields__},
        "judged": list(judgement(conditions)),
        "tables": [
            {
                "title": table.title,
                "summary": table.summary,
                "plants": list(table.assumptions),
                "rows": [
                    _row_to_json(rank, row)
                    for rank, row in zip([*ranks(table), "PI"], (*table.rows, table.yardstick), strict=True)
                ],
            }
            for table in comparison.tables
        ],
    }


def _row_to_json(rank: str, row: Row) -> dict:
    parameters = row.candidate
    return {
        "rank": int(rank) if rank.isdigit() else None,
        "controller": row.controller,
        "compensator": row.compensator,
        "refused": row.refused or None,
        "marked": row.marked or None,
        "unstable": row.unstable,
        "score": row.score if np.isfinite(row.score) else None,
        "delays_s": list(row.delays),
        "parameters": parameters
        and {
            "motion_controller": {name: _plain(value) for name, value in parameters.motion_controller.items()},
            "hysteresis_compensator": dict(parameters.hysteresis_compensator),
        },
        "results": {
            name: {
                "rms": result.rms.tolist(),
                "rms_worst_percent": 100.0 * result.worst,
                "max": result.maximum.tolist(),
                "max_worst_percent": 100.0 * float(np.max(result.maximum)),
                "undelayed_rms": result.undelayed.tolist(),
                "times_better_than_pi": row.better.get(name),
                "effort_v_s": result.effort.tolist(),
                "chattering_m": result.chattering.tolist(),
                "saturated": result.saturated,
            }
            for name, result in row.results.items()
        },
    }


def _plain(value):
    return list(value) if isinstance(value, tuple) else value


def figures(table: Table) -> list:
    """Return captions and figures of a table: ranking, then the error of chosen rows on each reference."""
    done = [row for row in (*table.rows, table.yardstick) if row.results and not row.unstable]
    values = {task: [100.0 * row.results[task].rms for row in done] for task in table.tasks}
    found = [
        (
            "RMS error of every stable combination: one dot per plant, the worst one filled",
            ranking_figure([label(row) + (" (marked)" if row.marked else "") for row in done], values),
        )
    ]
    for task in table.tasks:
        shown = {label(row): row.errors[task] for row in chosen_rows(table)}
        found.append((f"Error on the worst plant of each row, {task}", errors_figure(shown)))
    return found


def chosen_rows(table: Table) -> list[Row]:
    """Return the rows to plot: the benchmark, the best row of :data:`SHOWN`, and the best ranked row."""
    done = [row for row in table.rows if row.results and not row.unstable]
    found = [table.yardstick]
    for row in [row for row in done if row.controller == SHOWN][:1] + [row for row in done if row.ranked][:1]:
        if row not in found:
            found.append(row)
    return found


def best_text(comparison: Comparison) -> str:
    """Return the configuration with the best combination, every parameter written out."""
    best = comparison.best
    if best.candidate is None:
        raise ConfigurationError("the best row combines several designs, so it has no configuration")
    chosen = comparison.configuration.override("motion_controller", **best.candidate.motion_controller)
    chosen = chosen.override("hysteresis_compensator", **best.candidate.hysteresis_compensator)
    figures_ = ", ".join(f"{task}: {100.0 * result.worst:.3g} % RMS" for task, result in best.results.items())
    source = comparison.configuration.source.replace("\\", "/").rsplit("/", 1)[-1]
    header = (
        f"# Best of `hysteresis compare {source} --best`: {label(best)}\n"
        f"# on the worst plant {figures_}, with a delay of {delays(best)} ms.\n"
    )
    # with an inverse of the dynamics, a waveform with steps requires limits of motion in the file
    axis = AxisParameters.from_configuration(chosen, single_axis(comparison.configuration).namespace)
    text = with_safe_motion(header + axis.configuration_text(), "the best combination", axis.namespace)
    single_axis(parse_configuration(text, "the best combination"))
    return text


class Ranking(Comparison):  # numpydoc ignore=PR02
    """Controllers and compensators in order of rank; ``print`` shows the tables of ``hysteresis compare``.

    Parameters
    ----------
    conditions : Conditions
        Conditions of all runs.
    around, others : Table or None
        Tables of random plants close to the configured plant, and of plants of other classes; None if there are no such
        plants. Each has ``rows``, the best first.
    configuration : Configuration
        Configuration of the first table.
    """

    def __str__(self) -> str:
        return format_comparison(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the configuration with the best combination (``.yaml``), or a page with plots (``.html``).

        Parameters
        ----------
        path : path-like
            File to write; the suffix decides the content.

        Raises
        ------
        ConfigurationError
            No combination has a rank, or the suffix is unknown.
        HysteresisError
            The file cannot be written, or a page needs Matplotlib and Jinja2.
        """
        ending = pathlib.Path(path).suffix.lower()
        if ending == ".html":
            write_comparison_page(self, path)
        elif ending in (".yaml", ".yml"):
            write_file(path, best_text(self))
        else:
            raise ConfigurationError(f"{path}: must end in .yaml (the best combination) or .html (a page)")
