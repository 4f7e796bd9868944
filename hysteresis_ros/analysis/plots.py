"""Plots of a run with Matplotlib's object interface (no pyplot, no display). Micrometres, because people read them."""

from __future__ import annotations

import base64
import io

import numpy as np

from hysteresis_ros.analysis.settings import axis_settings, judged_reference
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import loop_opening

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


def error_figure(recording: Recording):
    """Return the figure of reference - displacement over time [µm, s]."""
    figure, (axis,) = new_figure(2.6)
    error = judged_reference(recording) - (_displacement(recording) - axis_settings(recording).offset)
    time, values = envelope(recording.time, error * _MICRO)
    axis.axhline(0.0, color=_COLOURS["limit"], linewidth=0.8)
    axis.plot(time, values, color=_COLOURS["error"], linewidth=1.0)
    axis.set(xlabel="time [s]", ylabel="error [µm]")
    return figure


def loop_figure(recording: Recording):
    """Return the figure of the loop before compensation (over voltage) and after it (over reference) [µm, V]."""
    figure, (before, after) = new_figure(4.2, 2)
    displacement = _displacement(recording) - axis_settings(recording).offset
    reference = judged_reference(recording)
    stroke = float(np.nanmax(reference) - np.nanmin(reference))
    if recording.has("voltage"):
        _loop(before, recording["voltage"], displacement, 1.0, _COLOURS["voltage"])
    _title(before, "before compensation", recording.run_columns()["voltage"], displacement, stroke)
    before.set(xlabel="voltage [V]", ylabel="displacement [µm]")
    _loop(after, reference, displacement, _MICRO, _COLOURS["reference"])
    _title(after, "after compensation", reference, displacement, stroke)
    after.set(xlabel="reference [µm]", ylabel="displacement [µm]")
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


#: Plots of a report: caption and function.
FIGURES = (
    ("Displacement over time", traces_figure),
    ("Error (reference − displacement) over time", error_figure),
    ("Hysteresis loop before and after compensation", loop_figure),
    ("Voltage and its limits", voltage_figure),
)


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


def _loop(axis, u, displacement, factor, colour) -> None:
    stride = max(1, u.size // LOOP_POINTS)
    axis.plot(u[::stride] * factor, displacement[::stride] * _MICRO, color=colour, linewidth=0.9)


def _title(axis, text, u, displacement, stroke) -> None:
    opening = loop_opening(u, displacement) if stroke > 0.0 else None
    width = f": {100.0 * opening / stroke:.3g} % of stroke" if opening is not None else " (no loop in this run)"
    axis.set_title(f"{text}{width}", fontsize=11)


def add_legend(axis) -> None:
    """Put the legend above an axis."""
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False, fontsize=9, borderaxespad=0.2)
