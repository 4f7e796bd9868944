# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report page of a commissioning: results and charts of every step, from data that JSON can store."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hysteresis_ros import __version__
from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import add_legend, data_uri, new_figure

#: Maximum number of stored points of a line.
POINTS = 3000
#: Colours of the lines, in order.
COLOURS = ("#1f3b73", "#d1495b", "#2a9d8f", "#6a4c93")


@dataclass(frozen=True)
class Line:
    """Data of one line in a figure."""

    label: str
    x: list[float]
    y: list[float]


@dataclass(frozen=True)
class Picture:
    """Data of a figure with lines."""

    caption: str  #: caption, across, up: Caption of the figure; labels of its horizontal and vertical axis, with units.
    across: str
    up: str
    lines: list[Line]
    logarithmic: str = ""  #: Which axes are logarithmic: ``x``, ``y``, ``xy`` or empty.
    equal: bool = False  #: Whether both axes have the same scale.


def line(label: str, x, y) -> Line:
    """Return a line, decimated to at most :data:`POINTS` points; points with a value that is not finite are omitted."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[finite], y[finite]
    stride = max(1, -(-x.size // POINTS))
    return Line(
        label, [float(f"{value:.6g}") for value in x[::stride]], [float(f"{value:.6g}") for value in y[::stride]]
    )


def picture_figure(picture: Picture):
    """Draw a picture with Matplotlib and return the figure."""
    figure, (axis,) = new_figure(5.0 if picture.equal else 3.4)
    for number, one in enumerate(picture.lines):
        width = 1.8 if number == 0 and len(picture.lines) > 1 else 1.0
        axis.plot(one.x, one.y, color=COLOURS[number % len(COLOURS)], linewidth=width, label=one.label)
    for name in picture.logarithmic:
        getattr(axis, f"set_{name}scale")("log")
    if picture.equal:
        axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel=picture.across, ylabel=picture.up)
    if len(picture.lines) > 1:
        add_legend(axis)
    return figure


class Found(Protocol):
    """Results of a step that the page shows."""

    lines: list[str]
    figures: dict
    pictures: list[Picture]
    seconds: float


def write_commissioning_report(path, source: str, found: Mapping[str, Found], titles: Mapping[str, str]) -> None:
    """Write the page as one self-contained HTML file."""
    stages = [
        dict(
            name=name,
            title=titles[name],
            seconds=f"{outcome.seconds:.3g} s" if outcome.seconds else "nothing moved",
            lines=outcome.lines,
            plots=[dict(caption=one.caption, source=data_uri(picture_figure(one))) for one in outcome.pictures],
        )
        for name, outcome in found.items()
    ]
    html = render_page(
        "commissioning.html.j2",
        title=f"Commissioning of {source}",
        version=__version__,
        stages=stages,
        seconds=f"{sum(outcome.seconds for outcome in found.values()):.3g}",
    )
    write_page(path, html)
