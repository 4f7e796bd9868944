"""The comparison of controllers as a table for people, as JSON and as plots."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.ranking import errors_figure, ranking_figure, write_ranking_page
from hysteresis_ros.comparison.compare import Comparison, Row

TITLE = "Controllers and compensators on one plant, under honest conditions"
RANKING = "Ranked by the geometric mean over the references of the RMS error on the worst plant."
#: Columns of a task, in % of the stroke: heading and what it is of a Result.
ERRORS = (
    ("RMS", lambda result: np.median(result.rms)),
    ("worst RMS", lambda result: np.max(result.rms)),
    ("worst error", lambda result: np.max(result.maximum)),
)
#: Columns of what it costs, the largest over the references: heading, unit, what it is of a Result.
COSTS = (
    ("effort", "V/s", lambda result: np.max(result.effort)),
    ("chattering", "nm", lambda result: np.max(result.chattering) * 1e9),
    ("at limits", "% of time", lambda result: 100.0 * result.saturated),
)


def blocks(comparison: Comparison) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return the blocks of columns behind rank, controller and compensator: name, then heading and unit of each."""
    found = [(task.name, [(heading, "%") for heading, _ in ERRORS]) for task in comparison.tasks]
    return [*found, ("largest of both", [(heading, unit) for heading, unit, _ in COSTS])]


def cells(comparison: Comparison, rank: int, row: Row) -> list[str]:
    """Return the cells of a row; a refused candidate has dashes."""
    names = [str(rank) if row.results else "–", row.candidate.controller, row.candidate.compensator]
    if row.refused:
        return names + ["–"] * (len(ERRORS) * len(comparison.tasks) + len(COSTS))
    results = [row.results[task.name] for task in comparison.tasks]
    numbers = [comparison.percent(float(value(result))) for result in results for _, value in ERRORS]
    numbers += [float(max(value(result) for result in results)) for _, _, value in COSTS]
    return names + [f"{number:.3g}" for number in numbers]


def format_comparison(comparison: Comparison) -> str:
    """Return the table for a terminal, with its conditions and what was refused."""
    rows = [cells(comparison, rank, row) for rank, row in enumerate(comparison.rows, 1)]
    parts = blocks(comparison)
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
        above += f"{name[:width]:-^{width}}  "
        column += len(columns)
    low, high = comparison.reach
    lines = [
        TITLE,
        f"stroke {comparison.stroke * 1e6:.4g} µm: every plant reaches {low * 1e6:.4g} … {high * 1e6:.4g} µm",
        "",
        above.rstrip(),
        line(heads),
        line(units),
        *(line(row) for row in rows),
        "",
        RANKING,
    ]
    refused = refusals(comparison)
    lines += ["", "Refused", *(f"- {text}" for text in refused)] if refused else []
    return "\n".join([*lines, "", "Conditions", *(f"- {text}" for text in comparison.assumptions)])


def refusals(comparison: Comparison) -> list[str]:
    """Return who was refused and why."""
    return [f"{label(row)}: {row.refused}" for row in comparison.rows if row.refused]


def write_page(comparison: Comparison, path) -> None:
    """Write the comparison as a page with plots.

    Raises
    ------
    MissingExtraError
        Matplotlib or Jinja2 is not installed.
    RecordingError
        The file cannot be written.
    """
    low, high = comparison.reach
    write_ranking_page(
        path,
        TITLE,
        summary=f"stroke {comparison.stroke * 1e6:.4g} µm: every plant reaches {low * 1e6:.4g} … {high * 1e6:.4g} µm",
        blocks=blocks(comparison),
        rows=[
            dict(cells=cells(comparison, rank, row), refused=bool(row.refused))
            for rank, row in enumerate(comparison.rows, 1)
        ],
        ranking=RANKING,
        plots=figures(comparison),
        refused=refusals(comparison),
        conditions=comparison.assumptions,
        configuration=comparison.configuration,
    )


def to_json(comparison: Comparison) -> dict:
    """Return everything JSON can hold, in SI units; the rows in order of rank under ``rows``."""
    conditions = comparison.conditions
    return {
        "stroke_m": comparison.stroke,
        "reach_m": list(comparison.reach),
        "conditions": {name: getattr(conditions, name) for name in conditions.__dataclass_fields__},
        "assumptions": list(comparison.assumptions),
        "tasks": [
            {
                "name": task.name,
                "waveform": task.waveform,
                "frequency_hz": task.frequency,
                "low_m": task.low,
                "high_m": task.high,
            }
            for task in comparison.tasks
        ],
        "rows": [
            {
                "rank": rank if row.results else None,
                "controller": row.candidate.controller,
                "compensator": row.candidate.compensator,
                "refused": row.refused or None,
                "score_m": row.score if row.results else None,
                "parameters": {
                    "motion_controller": {
                        name: _plain(value) for name, value in row.candidate.motion_controller.items()
                    },
                    "hysteresis_compensator": dict(row.candidate.hysteresis_compensator),
                },
                "results": {
                    name: {
                        "rms_m": result.rms.tolist(),
                        "rms_worst_percent": comparison.percent(float(np.max(result.rms))),
                        "max_m": result.maximum.tolist(),
                        "max_worst_percent": comparison.percent(float(np.max(result.maximum))),
                        "effort_v_s": result.effort.tolist(),
                        "chattering_m": result.chattering.tolist(),
                        "saturated": result.saturated,
                    }
                    for name, result in row.results.items()
                },
            }
            for rank, row in enumerate(comparison.rows, 1)
        ],
    }


def _plain(value):
    return list(value) if isinstance(value, tuple) else value


def figures(comparison: Comparison) -> list:
    """Return the plots, captions and figures: ranking, then error and displacement of chosen rows on each reference.

    Raises
    ------
    MissingExtraError
        Matplotlib is not installed.
    """
    done = [row for row in comparison.rows if row.results]
    labels = [label(row) for row in done]
    found = []
    values = {
        task.name: [comparison.percent(1.0) * row.results[task.name].rms for row in done] for task in comparison.tasks
    }
    found.append(
        ("RMS error of every combination: each plant a dot, the worst one filled", ranking_figure(labels, values))
    )
    for task in comparison.tasks:
        shown = {label(row): _shown(row, task) for row in chosen_rows(comparison)}
        found.append((f"Error on the plant where each does worst, {task.name}", errors_figure(shown)))
    return found


def label(row: Row) -> str:
    """Return the names of a row."""
    return f"{row.candidate.controller}, {row.candidate.compensator}"


def chosen_rows(comparison: Comparison) -> list[Row]:
    """Return the rows whose errors are worth a plot: open loop and PID alone, the best feedforward, the best of all."""
    found = []
    for controller, compensator in (("open loop", "none"), ("PID", "none")):
        found += [
            row
            for row in comparison.rows
            if row.results and (row.candidate.controller, row.candidate.compensator) == (controller, compensator)
        ]
    fed = [row for row in comparison.rows if row.results and row.candidate.controller == "feedforward"]
    best = [row for row in comparison.rows if row.results]
    for row in fed[:1] + best[:1]:
        if row not in found:
            found.append(row)
    return found


def _shown(row: Row, task) -> tuple[np.ndarray, np.ndarray]:
    """Return time and error of two periods."""
    time, error = row.errors[task.name]
    shown = time <= task.settling + 2.0 / task.frequency
    return time[shown], error[shown]
