# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plots of a run with Matplotlib's object interface (no pyplot, no display). Micrometres, because people read them."""

from __future__ import annotations

import base64
import io

import numpy as np

from hysteresis_ros.analysis.settings import axis_settings, judged_reference
from hysteresis_ros.analysis.steps import scan_start
from hysteresis_ros.compensation.recursive import ADAPTING
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import loop_opening
from hysteresis_ros.units import FINE

#: Points of a line on paper; longer signals are drawn as the minimum and maximum of as many intervals.
LINE_POINTS = 3000
#: Points of a loop.
LOOP_POINTS = 20000

_MICRO = 1e6
_COLOURS = {
    "setpoint": "#9a9a9a",
    "reference": "#1f3b73",
    "displacement": "#d1495b",
    "estimated": "#2a9d8f",
    "error": "#d1495b",
    "voltage": "#6a4c93",
    "limit": "#444444",
}


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


def traces_figure(recording: Recording):
    """Return the figure of setpoint, reference (as late as judged), displacement and estimate over time [µm, s]."""
    figure, (axis,) = new_figure(3.6)
    settings = axis_settings(recording)
    label = f"reference, {settings.preview} samples later" if settings.preview else "reference"
    styles = {
        "setpoint": dict(linestyle=(0, (4, 3)), linewidth=1.1, zorder=2),
        "reference": dict(linewidth=1.4, zorder=4),
        "displacement": dict(linewidth=1.2, zorder=3),
        "estimated": dict(linewidth=2.6, alpha=0.45, zorder=2.5),
    }
    for name, style in styles.items():
        if recording.has(name):
            signal = judged_reference(recording) if name == "reference" else recording[name]
            shift = settings.offset if name == "displacement" else 0.0
            time, values = envelope(recording.time, (signal - shift) * _MICRO)
            axis.plot(time, values, color=_COLOURS[name], label=label if name == "reference" else name, **style)
    axis.set(xlabel="time [s]", ylabel="displacement [µm]")
    add_legend(axis)
    return figure


def length_unit(largest: float) -> tuple[str, float]:
    """Return in which unit lengths are drawn, and how many of it are in a metre: nm where all of them are small.

    Parameters
    ----------
    largest : float
        [m]
    """
    return ("nm", 1e9) if 0.0 < largest * _MICRO < FINE else ("µm", _MICRO)


def error_figure(recording: Recording):
    """Return the figure of reference - displacement over time [µm or nm, s]."""
    figure, (axis,) = new_figure(2.6)
    reference, displacement = judged_reference(recording), _displacement(recording) - axis_settings(recording).offset
    error = reference - displacement
    good = np.flatnonzero(np.isfinite(error))
    start = scan_start(reference[good], displacement[good]) if good.size else 0
    largest = float(np.max(np.abs(error[good[start:]]))) if good.size else 0.0
    unit, factor = length_unit(largest)
    time, values = envelope(recording.time, error * factor)
    axis.axhline(0.0, color=_COLOURS["limit"], linewidth=0.8)
    axis.plot(time, values, color=_COLOURS["error"], linewidth=1.0)
    if start:
        ends = recording.time[0], recording.time[good[start]]
        axis.axvspan(*ends, color=_COLOURS["setpoint"], alpha=0.25, label="not counted: jump into the scan")
        # what does not count does not make the rest small
        axis.set_ylim(-1.5 * largest * factor, 1.5 * largest * factor)
        add_legend(axis)
    axis.set(xlabel="time [s]", ylabel=f"error [{unit}]")
    return figure


def loop_figure(recording: Recording):
    """Return the figure of the loop before compensation (over voltage) and after it (over reference) [µm, V].

    A voltage that does not go to and fro has no loop and is not drawn; None when the reference does not.
    """
    displacement = _displacement(recording) - axis_settings(recording).offset
    reference = judged_reference(recording)
    stroke = float(np.nanmax(reference) - np.nanmin(reference))
    voltage = recording.run_columns()["voltage"]
    loops = (
        ("before compensation", "voltage [V]", voltage, 1.0, _COLOURS["voltage"]),
        ("after compensation", "reference [µm]", reference, _MICRO, _COLOURS["reference"]),
    )
    before, after = (loop_opening(u, displacement) if stroke > 0.0 else None for _, _, u, _, _ in loops)
    if after is None:
        return None
    openings = (after,) if before is None else (before, after)
    figure, axes = new_figure(4.2, len(openings))
    for axis, opening, (text, label, u, factor, colour) in zip(axes, openings, loops[-len(openings) :], strict=True):
        stride = max(1, u.size // LOOP_POINTS)
        axis.plot(u[::stride] * factor, displacement[::stride] * _MICRO, color=colour, linewidth=0.9)
        axis.set_title(f"{text}: {100.0 * opening / stroke:.3g} % of stroke", fontsize=11)
        axis.set(xlabel=label, ylabel="displacement [µm]")
    return figure


def voltage_figure(recording: Recording):
    """Return the figure of the voltage over time with the limits of the configuration [V, s]."""
    figure, (axis,) = new_figure(2.6)
    settings = axis_settings(recording)
    time, values = envelope(recording.time, recording.run_columns()["voltage"])
    axis.plot(time, values, color=_COLOURS["voltage"], linewidth=1.0, label="voltage")
    limits = [limit for limit in (settings.voltage_minimum, settings.voltage_maximum) if limit is not None]
    for i, limit in enumerate(limits):
        label = "limits" if i == 0 else None
        axis.axhline(limit, color=_COLOURS["limit"], linestyle=(0, (5, 3)), linewidth=1.0, label=label)
    axis.set(xlabel="time [s]", ylabel="voltage [V]")
    add_legend(axis)
    return figure


def adaptation_figure(recording: Recording):
    """Return the figure of the gain of an inverse that adapts over time; None: it does not."""
    if not recording.has("adaptation") or not np.any(recording["adaptation"]):
        return None
    figure, (axis,) = new_figure(2.2)
    gain, adapts = recording["adapted_gain"], recording["adaptation"] == ADAPTING
    axis.plot(*envelope(recording.time, gain), color=_COLOURS["limit"], linewidth=1.0, label="frozen")
    axis.plot(
        *envelope(recording.time, np.where(adapts, gain, np.nan)),
        color=_COLOURS["voltage"],
        linewidth=1.8,
        label="adapting",
    )
    axis.set(xlabel="time [s]", ylabel="gain [1]")
    add_legend(axis)
    return figure


#: Plots of a report: caption and function.
FIGURES = (
    ("Displacement over time", traces_figure),
    ("Error (reference − displacement) over time", error_figure),
    ("Hysteresis loop before and after compensation", loop_figure),
    ("Voltage and its limits", voltage_figure),
)
#: Those of runs that adapt; None where there is nothing to show.
ADAPTED = ("Gain of the adapted inverse, as a part of the identified one", adaptation_figure)


def png(figure) -> bytes:
    """Return a figure as PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def data_uri(figure) -> str:
    """Return a figure as an address that an HTML file can hold in itself."""
    return "data:image/png;base64," + base64.b64encode(png(figure)).decode("ascii")


def _displacement(recording: Recording):
    return recording["displacement" if recording.has("displacement") else "measured"]


def add_legend(axis) -> None:
    """Put the legend above an axis."""
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False, fontsize=9, borderaxespad=0.2)
