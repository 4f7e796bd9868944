# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runs of inchworm motors side by side: what their moves come to, and slider and final error laid over each other."""

from __future__ import annotations

from dataclasses import replace

from hysteresis_ros.analysis.charts import SIDE_BY_SIDE, Chart
from hysteresis_ros.analysis.inchworm import COMMON_FIGURES, RUN_FIGURES, inchworm_figures
from hysteresis_ros.analysis.inchworm_moves import inchworm_run
from hysteresis_ros.analysis.inchworm_plots import inchworm_charts
from hysteresis_ros.analysis.side_by_side import figures_of_each, format_rows, render_laid_over
from hysteresis_ros.analysis.tables import table_of
from hysteresis_ros.recordings.dataset import Recording

#: What the moves of a run come to: name, label, unit shown to people, factor from SI.
SUMMARY = (
    ("moves", "Moves", "", 1.0),
    ("arrived", "Moves that arrived", "", 1.0),
    ("failed", "Moves that did not arrive, or ended with an error", "", 1.0),
    ("time_s", "Time of the moves that arrived", "s", 1.0),
    ("walking_speed_m_s", "Walking speed, slowest move", "µm/s", 1e6),
    ("final_error_rms_m", "Final error, RMS, worst move", "nm", 1e9),
    ("final_error_max_m", "Final error, largest", "nm", 1e9),
    ("overshoot_m", "Overshoot, worst move", "µm", 1e6),
)
#: Which line of a chart stands for a run.
OVERLAID = {"travel": "slider", "final_error": "slider − setpoint"}


def summary(moves: list[dict]) -> dict:
    """Return what moves come to, by the names of :data:`SUMMARY`; None where none has such a figure.

    Parameters
    ----------
    moves : list of dict
        Of :func:`hysteresis_ros.analysis.inchworm.inchworm_figures`.
    """

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
    """Return the figures of each run, and under ``summary`` what its moves come to.

    Parameters
    ----------
    runs : dict of str to Recording
        Label and run.

    Raises
    ------
    RecordingError
        A run cannot be judged; the message begins with its label.
    """
    found = figures_of_each(runs, inchworm_figures)
    return {name: {"summary": summary(figures["moves"]), **figures} for name, figures in found.items()}


def _rows(figures: dict[str, dict]) -> list[dict]:
    """Return the rows of the table: the moves together, the run, and what every run has."""
    of = list(figures.values())
    return [
        *table_of([one["summary"] for one in of], SUMMARY),
        *table_of([one["run"] for one in of], RUN_FIGURES),
        *table_of(of, COMMON_FIGURES),
    ]


def format_motors(figures: dict[str, dict]) -> str:
    """Return the figures of several runs as aligned lines for a terminal.

    Parameters
    ----------
    figures : dict of str to dict
        Of :func:`compare_motors`.
    """
    return format_rows(figures, _rows(figures))


def laid_over(runs: dict[str, Recording]) -> list[Chart]:
    """Return position and final error of several runs over each other, each from its first sample on.

    Parameters
    ----------
    runs : dict of str to Recording
        Label and run.
    """
    found: dict[str, Chart] = {}
    for number, (label, run) in enumerate(runs.items()):
        colour = SIDE_BY_SIDE[number % len(SIDE_BY_SIDE)]
        for chart in inchworm_charts(inchworm_run(replace(run, time=run.time - run.time[0]))):
            if chart.name in OVERLAID:
                (line,) = [line for line in chart.lines if line.label == OVERLAID[chart.name]]
                first = found.setdefault(chart.name, replace(chart, lines=[], kind="overlay"))
                first.lines.append(replace(line, label=label, colour=colour, width=1.2))
    return [found[name] for name in OVERLAID if name in found]


def render_motors(runs: dict[str, Recording], title: str, figures: dict[str, dict] | None = None) -> str:
    """Return the page of several runs: table of figures, charts laid over each other, configurations.

    Parameters
    ----------
    runs : dict of str to Recording
        Label and run.
    title : str
        Heading.
    figures : dict of str to dict, optional
        What :func:`compare_motors` gave, when it is known already.

    Raises
    ------
    HysteresisError
        Matplotlib or Jinja2 is missing, or see :func:`compare_motors`.
    """
    figures = figures or compare_motors(runs)
    return render_laid_over(runs, title, figures, laid_over(runs), _rows(figures))
