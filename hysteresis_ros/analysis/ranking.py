# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Page and plots of a comparison: every combination on a logarithmic scale, and errors over time."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import data_uri, envelope, new_figure

_COLOURS = ("#1f6fb2", "#d1495b", "#2a9d8f", "#e09f3e")
_BACKGROUND = "#b8b8b8"


def ranking_figure(labels: list[str], values: dict[str, list[np.ndarray]]):
    """Return the figure of the errors of all combinations [% of stroke], best on top.

    Parameters
    ----------
    labels : list of str
        Combinations, best first.
    values : dict of str to list of array
        Reference → for each combination the errors on the plants [% of stroke].
    """
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
    """Label 1, 2 and 5 of each decade as plain numbers, of many decades 1 alone: all minor labels would overlap."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_xlim()
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())


def errors_figure(errors: dict[str, tuple[np.ndarray, np.ndarray]]):
    """Return the figure of errors over time, each in a panel of its own scale [% of stroke].

    Parameters
    ----------
    errors : dict of str to (array, array)
        Label → time [s] and error as a part of the stroke, shape (N,) each.
    """
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
    """Write a page with tables of ranked combinations that needs nothing beside it.

    Parameters
    ----------
    path : path-like
        HTML file.
    title : str
        Heading.
    tables : sequence of dict
        ``title`` and ``summary`` (str), ``blocks`` (list of (name, list of (heading, unit))), ``rows`` (list of dict
        with ``cells`` and ``plain``), ``notes`` (list of (heading, list of str)), ``figures`` (captions and figures).
    **contents : object
        ``ranking`` (str), ``judged`` (list of str), ``configuration`` (str).

    Raises
    ------
    MissingExtraError
        Matplotlib or Jinja2 is not installed.
    RecordingError
        The file cannot be written.
    """
    drawn = [
        {**table, "plots": [dict(caption=caption, source=data_uri(figure)) for caption, figure in table["figures"]]}
        for table in tables
    ]
    write_page(path, render_page("ranking.html.j2", title=title, tables=drawn, **contents))
