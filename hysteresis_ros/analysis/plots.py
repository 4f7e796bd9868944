# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures drawn with Matplotlib's object interface (no pyplot, no display), and charts as data for pages.

Matplotlib is imported when the first figure is drawn.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import MissingExtraError
from hysteresis_ros.units import FINE

#: Maximum number of points of a drawn line; of longer signals, the minimum and maximum of each interval are drawn.
LINE_POINTS = 3000

_MICRO = 1e6


def new_figure(height: float, columns: int = 1, rows: int = 1):
    """Return a figure of ``height`` inches and its axes row by row, shape (rows · columns,)."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("Matplotlib") from None
    figure = Figure(figsize=(9.0, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes:
        axis.grid(True, color="#e2e2e2", linewidth=0.8)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    return figure, axes


def envelope(time, values, points: int = LINE_POINTS):
    """Return ``time`` and ``values``, thinned to the minimum and maximum of each interval so that peaks remain."""
    intervals = points // 2
    size = values.size // intervals
    if size < 2:
        return time, values
    whole = size * intervals
    table = values[:whole].reshape(intervals, size)
    empty = np.all(np.isnan(table), axis=1)
    low = np.argmin(np.where(np.isnan(table), np.inf, table), axis=1)
    high = np.argmax(np.where(np.isnan(table), -np.inf, table), axis=1)
    start = np.arange(intervals) * size
    chosen = np.sort(np.stack([start + low, start + high], axis=1), axis=1)
    picked = np.where(empty[:, None], np.nan, values[chosen])
    return (
        np.concatenate([time[chosen.ravel()], time[whole:]]),
        np.concatenate([picked.ravel(), values[whole:]]),
    )


def length_unit(largest: float) -> tuple[str, float]:
    """Return the unit of drawn lengths (µm, or nm if the largest length is small) and the factor from metres to it.

    Units: ``largest`` [m].
    """
    return ("nm", 1e9) if 0.0 < largest * _MICRO < FINE else ("µm", _MICRO)


def png(figure) -> bytes:
    """Return a figure as PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def data_uri(figure) -> str:
    """Return a figure as a data URL, which an HTML file can embed."""
    return "data:image/png;base64," + base64.b64encode(png(figure)).decode("ascii")


def add_legend(axis, columns: int = 4) -> None:
    """Put the legend above an axis."""
    axis.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, fontsize=9, borderaxespad=0.2
    )


#: Colours of lines, on a light and on a dark background.
COLOURS = {
    "setpoint": ("#9a9a9a", "#8b8f98"),
    "reference": ("#1f3b73", "#8fb0f0"),
    "displacement": ("#d1495b", "#f0808f"),
    "estimated": ("#2a9d8f", "#4fd0c0"),
    "voltage": ("#6a4c93", "#bda0ea"),
    "limit": ("#444444", "#b4b4b4"),
    "late": ("#b36a00", "#f0b050"),
}
#: Colours of the runs in a comparison, in order.
SIDE_BY_SIDE = ("reference", "displacement", "estimated", "voltage", "late", "limit")
#: Maximum number of points of a path in a static figure; a path on a page has fewer.
PATH_POINTS = 20000


@dataclass(frozen=True)
class Line:
    """A line of a chart."""

    label: str
    colour: str  #: One of :data:`COLOURS`.
    x: np.ndarray  #: x, y: shape (N,); In the units of the chart; NaN breaks the line.
    y: np.ndarray
    width: float = 1.2  #: [points]
    dash: tuple[float, ...] = ()  #: Lengths of dashes and gaps; empty: solid line.
    #: shape (N,); Time of each point of a path [s], by which the page selects the points of a time span.
    key: np.ndarray | None = None
    dots: bool = False  #: Draw points instead of a line.


@dataclass(frozen=True)
class Chart:
    """A chart."""

    name: str  #: Name of the chart, unique on the page.
    caption: str  #: caption, across, up: Caption of the chart; labels of its horizontal and vertical axis, with units.
    across: str
    up: str
    lines: Sequence[Line]
    #: ``time``: x is the time of the run [s], shared by all such charts; ``overlay``: x is time, but each line has its
    #: own times; ``graph``: x increases along each line; ``path``: x may reverse; ``steps``: x is the left edge of each
    #: bar.
    kind: str = "time"
    logarithmic: str = ""  #: Which axes are logarithmic: ``x``, ``y``, ``xy`` or empty.
    levels: Sequence[float] = ()  #: Horizontal lines, such as limits.
    level_label: str = ""  #: Meaning of the levels.
    shaded: tuple[float, float] | None = None  #: Shaded range of x; its label is :attr:`shaded_label`.
    shaded_label: str = ""
    #: Further marked ranges of x, shape (M, 2), in another colour; :attr:`marked_label` states their meaning.
    marked: np.ndarray | None = None
    marked_label: str = ""
    limits: tuple[float, float] | None = None  #: Ends of the vertical axis; by default the range of the lines.
    note: str = ""  #: A sentence below the chart.
    height: float = 2.8  #: Height of the static figure [inches].


def thin(time, columns: Sequence[np.ndarray], points: int) -> tuple[np.ndarray, list[np.ndarray], int]:
    """Return columns over common times, thinned to two points per block of samples so that extremes remain.

    Each column keeps the lowest and the highest value of each block, in their order. They get the times of the first
    and the middle sample of the block, so the time of a drawn peak is wrong by less than one block.

    Units: ``time`` [s].
    """
    if time.size <= points:
        return time, list(columns), 1
    size = -(-time.size // (points // 2))
    blocks = -(-time.size // size)
    padding = np.full(blocks * size - time.size, np.nan)
    starts = np.arange(blocks) * size
    middles = np.minimum(starts + size // 2, time.size - 1)
    # the last block may be a single sample; the second time of a block must be later than the first
    instants = np.stack([time[starts], np.where(middles > starts, time[middles], np.nan)], axis=1).ravel()
    thinned = []
    for values in columns:
        table = np.concatenate([values, padding]).reshape(blocks, size)
        empty = np.all(np.isnan(table), axis=1)
        low = np.argmin(np.where(np.isnan(table), np.inf, table), axis=1)
        high = np.argmax(np.where(np.isnan(table), -np.inf, table), axis=1)
        chosen = np.sort(np.stack([low, high], axis=1), axis=1)
        picked = np.take_along_axis(table, chosen, axis=1)
        picked[empty] = np.nan
        thinned.append(picked.ravel()[np.isfinite(instants)])
    return instants[np.isfinite(instants)], thinned, size


def thin_path(line: Line, points: int) -> Line:
    """Return a path thinned to the first point and the extremes of x and y in each block of points."""
    there = np.flatnonzero(np.isfinite(line.x) & np.isfinite(line.y))
    if there.size > points:
        blocks = max(1, points // 5)
        size = -(-there.size // blocks)
        starts = np.arange(0, there.size, size)
        padded = np.concatenate([there, np.full(starts.size * size - there.size, there[-1])]).reshape(-1, size)
        rows = np.arange(starts.size)
        found = [padded[:, 0]]
        for values in (line.x, line.y):
            table = values[padded]
            found += [padded[rows, np.argmin(table, axis=1)], padded[rows, np.argmax(table, axis=1)]]
        there = np.unique(np.concatenate(found))
    key = None if line.key is None else line.key[there]
    return Line(line.label, line.colour, line.x[there], line.y[there], line.width, line.dash, key)


def chart_figure(chart: Chart):
    """Draw a chart with Matplotlib and return the figure."""
    figure, (axis,) = new_figure(chart.height)
    if chart.shaded is not None:
        axis.axvspan(*chart.shaded, color=COLOURS["setpoint"][0], alpha=0.25, label=chart.shaded_label, linewidth=0)
    if chart.marked is not None:
        from matplotlib.collections import PolyCollection

        style = dict(color=COLOURS["late"][0], alpha=0.3, linewidth=0, transform=axis.get_xaxis_transform())
        corners = [[(left, 0), (right, 0), (right, 1), (left, 1)] for left, right in chart.marked]
        axis.add_collection(PolyCollection(corners, label=chart.marked_label, **style))
    for line in chart.lines:
        style = dict(color=COLOURS[line.colour][0], linewidth=line.width, label=line.label)
        if line.dash:
            style["linestyle"] = (0, line.dash)
        if line.dots:
            there = np.isfinite(line.y)
            axis.plot(line.x[there], line.y[there], **style | dict(linestyle="", marker=".", zorder=3))
            continue
        if chart.kind == "steps":
            axis.step(line.x, line.y, where="post", **style)
            axis.fill_between(line.x, line.y, step="post", color=style["color"], alpha=0.15, linewidth=0)
        elif chart.kind == "path":
            drawn = thin_path(line, PATH_POINTS)
            axis.plot(drawn.x, drawn.y, **style)
        else:
            axis.plot(*envelope(line.x, line.y), **style)
    for number, level in enumerate(chart.levels):
        style = dict(color=COLOURS["limit"][0], linestyle=(0, (5, 3)), linewidth=1.0)
        axis.axhline(level, label=None if number else chart.level_label or None, **style)
    for name in chart.logarithmic:
        getattr(axis, f"set_{name}scale")("log")
    if chart.limits is not None:
        axis.set_ylim(*chart.limits)
    axis.set(xlabel=chart.across, ylabel=chart.up)
    if len(chart.lines) > 1 or chart.shaded is not None or chart.marked is not None or chart.level_label:
        # labels of paths are long, so the legend has one column
        add_legend(axis, 1 if chart.kind == "path" else 4)
    return figure
