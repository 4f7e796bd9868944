# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The page of a sweep: distributions of the metrics, and their dependence on the parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import data_uri, new_figure
from hysteresis_ros.laboratory.sweeps.plan import RANDOM
from hysteresis_ros.laboratory.sweeps.study import METRICS
from hysteresis_ros.laboratory.sweeps.summary import Summary, lines

_COLOURS = ("#1f6fb2", "#d1495b", "#2a9d8f", "#e09f3e")
_BOUND = dict(color="#222222", linewidth=1.0, linestyle=(0, (4, 3)))
#: Maximum number of points of a scatter plot; if there are more runs, only every n-th run is plotted.
POINTS = 5000


class Column(NamedTuple):
    """Values of a metric, and their display."""

    label: str  #: Label with the displayed unit.
    values: np.ndarray  #: shape (runs,); Values in SI.
    factor: float  #: Factor from SI to the displayed unit.

    @property
    def shown(self) -> np.ndarray:
        """Values in the displayed unit; NaN for runs without a value."""
        return np.where(np.isfinite(self.values), self.values, np.nan) * self.factor


def share_figure(column: Column, ends: Sequence[float]):
    """Return the figure of the empirical distribution of a metric."""
    figure, (axis,) = new_figure(3.2)
    known = np.sort(column.shown[np.isfinite(column.values)])
    # the fraction refers to all runs, including those without a value
    share = 100.0 * np.arange(1, known.size + 1) / len(column.values)
    axis.step(known, share, where="post", color=_COLOURS[0], linewidth=1.4)
    for end in ends:
        axis.axvline(end * column.factor, **_BOUND)
    axis.set(xlabel=column.label, ylabel="runs below [%]", ylim=(0.0, 102.0))
    return figure


def scatter_figure(column: Column, parameters: dict[str, np.ndarray], ends: Sequence[float]):
    """Return the figure of a metric versus each parameter."""
    columns = min(len(parameters), 3)
    rows = -(-len(parameters) // columns)
    figure, axes = new_figure(2.7 * rows, columns, rows)
    stride = -(-len(column.values) // POINTS)
    for place, (axis, (label, values)) in enumerate(zip(axes, parameters.items(), strict=False)):
        size = dict(linestyle="", marker=".", markersize=2.5, alpha=0.5)
        axis.plot(values[::stride], column.shown[::stride], color=_COLOURS[0], **size)
        for end in ends:
            axis.axhline(end * column.factor, **_BOUND)
        axis.set_xlabel(label.replace(".", ".\n", 1), fontsize=8)
        axis.tick_params(labelsize=8)
        axis.locator_params(axis="x", nbins=5)
        if place % columns == 0:
            axis.set_ylabel(column.label, fontsize=9)
    for axis in axes[len(parameters) :]:
        axis.set_visible(False)
    return figure


def levels_figure(column: Column, label: str, levels, spread: Sequence[np.ndarray], shares: Sequence[tuple]):
    """Return the figure of a metric and the yield at each level of a parameter."""
    figure, axes = new_figure(3.2, 2 if shares else 1)
    numbers = all(isinstance(level, (int, float, np.number)) for level in levels)
    places = np.array(levels, dtype=float) if numbers else np.arange(len(levels))
    table = [np.where(np.isfinite(values), values, np.nan) * column.factor for values in spread]
    known = [values[~np.isnan(values)] for values in table]
    for part, name, colour in ((0.5, "median", 0), (0.95, "95 % below", 3), (1.0, "worst", 1)):
        line = [np.quantile(values, part) if values.size else np.nan for values in known]
        axes[0].plot(places, line, marker=".", color=_COLOURS[colour], label=name)
    axes[0].set(ylabel=column.label)
    axes[0].legend(frameon=False, fontsize=9)
    if shares:
        share, low, high = 100.0 * np.transpose(shares)
        axes[1].fill_between(places, low, high, color=_COLOURS[2], alpha=0.25, linewidth=0.0)
        axes[1].plot(places, share, marker=".", color=_COLOURS[2])
        axes[1].set(ylabel="yield [%]", ylim=(-2.0, 102.0))
    for axis in axes:
        axis.set_xlabel(label, fontsize=9)
        if not numbers:
            axis.set_xticks(places, [str(level) for level in levels])
        elif len(places) > 2 and np.all(places > 0.0) and np.ptp(np.diff(np.log(places))) < 1e-6:
            axis.set_xscale("log")
    return figure


def influence_figure(found: Mapping[str, tuple[Sequence[str], dict[str, np.ndarray]]]):
    """Return the figure of sensitivities, one panel for each metric."""
    count = max(len(labels) for labels, _ in found.values())
    figure, axes = new_figure((0.9 + 0.5 * count) * len(found), 1, len(found))
    for axis, (metric, (labels, columns)) in zip(axes, found.items(), strict=True):
        places = np.arange(len(labels))[::-1]
        variance = "first" in columns
        pairs = ("first", "total") if variance else ("mean", "deviation")
        scale = 1.0 if variance else max(float(np.max(columns["mean"])), 1e-300)
        for number, name in enumerate(pairs):
            width = columns.get(f"{name}_interval")
            error = None if width is None else width / scale
            place = places + 0.2 - 0.4 * number
            style = dict(height=0.36, color=_COLOURS[number], label=name, error_kw=dict(linewidth=0.8))
            axis.barh(place, columns[name] / scale, xerr=error, **style)
        axis.set_yticks(places, labels, fontsize=8)
        axis.set_title(metric, fontsize=10, loc="left")
        axis.set_xlabel(
            "fraction of the variance" if variance else "effect, as a fraction of the largest mean", fontsize=9
        )
        axis.legend(frameon=False, fontsize=8)
    return figure


def write_sweep_page(path, title: str, *, figures: Sequence[tuple[str, object]], **contents) -> None:
    """Write a self-contained page."""
    plots = [dict(caption=caption, source=data_uri(figure)) for caption, figure in figures]
    write_page(path, render_page("sweep.html.j2", title=title, plots=plots, **contents))


#: Maximum number of parameters against which a metric is plotted.
MOST_DRAWN = 6


def write(summary: Summary, path, title: str) -> None:
    """Write the page of a sweep."""
    results = summary.results
    write_sweep_page(
        path,
        f"Sweep of {title}",
        lines=lines(summary),
        asked=results.about["vary"],
        figures=figures(summary),
        configuration=results.about["configuration"],
    )


def figures(summary: Summary) -> list[tuple[str, object]]:
    """Return captions and figures of a sweep."""
    results, found = summary.results, []
    drawn = {label: values for label, values in results.parameters.items() if values.dtype.kind in "if"}
    chosen = dict(list(drawn.items())[:MOST_DRAWN])
    bounds = {bound.metric: bound for bound in summary.bounds}
    for name, values in results.metrics.items():
        column, bound = _column(name, values), bounds.get(name)
        ends = () if bound is None else tuple(end for end in (bound.low, bound.high) if np.isfinite(end))
        if not np.any(np.isfinite(values)):
            continue
        found.append((f"{column.label}: fraction of the runs below each value", share_figure(column, ends)))
        if chosen:
            found.append((f"{column.label} versus the varied parameters", scatter_figure(column, chosen, ends)))
        at_levels = summary.at_levels
        if at_levels and len(summary.plan.counts) == 1:
            label = next(iter(at_levels[0][0]))
            levels = [levels[label] for levels, *_ in at_levels]
            spread = [metrics[name] for *_, metrics in at_levels]
            shares = [(one.share, one.low, one.high) for _, one, _ in at_levels] if summary.bounds else []
            found.append((f"{column.label} at each level", levels_figure(column, label, levels, spread, shares)))
    if summary.plan.design != RANDOM:
        known = {METRICS[one.metric][0]: (one.labels, one.columns) for one in summary.sensitivities if one.columns}
        if known:
            found.append(("Sensitivity of the metrics", influence_figure(known)))
    return found


def _column(name: str, values: np.ndarray) -> Column:
    label, unit, factor = METRICS[name]
    return Column(f"{label} [{unit}]" if unit else label, np.asarray(values), factor)
