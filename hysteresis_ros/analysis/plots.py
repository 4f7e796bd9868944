# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Pictures with Matplotlib's object interface (no pyplot, no display). Micrometres, because people read them."""

from __future__ import annotations

import base64
import io

import numpy as np

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.units import FINE

#: Points of a line on paper; longer signals are drawn as the minimum and maximum of as many intervals.
LINE_POINTS = 3000

_MICRO = 1e6


class MissingExtraError(HysteresisError):
    """A library of the optional extra ``report`` is not installed."""

    def __init__(self, library: str):
        """Name the library and how to install it."""
        super().__init__(f'{library} is not installed; plots and reports need it: pip install "hysteresis_ros[report]"')


def new_figure(height: float, columns: int = 1, rows: int = 1):
    """Return a figure of ``height`` inches without a display, and its axes row by row, shape (rows · columns,).

    Raises
    ------
    MissingExtraError
        Matplotlib is not installed.
    """
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
    """Return ``time`` and ``values`` thinned so that no peak is lost: minimum and maximum of each interval.

    Parameters
    ----------
    time, values : array, shape (N,)
        A signal; NaN breaks the line where a whole interval is NaN.
    points : int
        About as many points are returned; shorter signals come back unchanged.

    Returns
    -------
    time, values : array, shape (M,)
    """
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
    """Return in which unit lengths are drawn, and how many of it are in a metre: nm where all of them are small.

    Parameters
    ----------
    largest : float
        [m]
    """
    return ("nm", 1e9) if 0.0 < largest * _MICRO < FINE else ("µm", _MICRO)


def png(figure) -> bytes:
    """Return a figure as PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def data_uri(figure) -> str:
    """Return a figure as an address that an HTML file can hold in itself."""
    return "data:image/png;base64," + base64.b64encode(png(figure)).decode("ascii")


def add_legend(axis, columns: int = 4) -> None:
    """Put the legend above an axis."""
    axis.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, fontsize=9, borderaxespad=0.2
    )
