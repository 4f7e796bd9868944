# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Accuracy of a scan in a plane: figures, error map, errors of each line, traces and retraces, and the page.

Errors are reference - displacement. Only errors on the passes (:class:`hysteresis_ros.references.scan.Passes`) count,
because only there data are taken; turns and flyback have a figure of their own. *Along* is the direction of the lines,
*across* is the other direction in the plane.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hysteresis_ros.analysis.metrics import Tracked, judged_reference, judged_start
from hysteresis_ros.analysis.page import render_page, require_page, write_page
from hysteresis_ros.analysis.plots import COLOURS, add_legend, data_uri, length_unit, new_figure
from hysteresis_ros.analysis.tables import aligned, shown, shown_row
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import replacing
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.triggers import triggers_of
from hysteresis_ros.references.scan import AXES, Clock, Scan
from hysteresis_ros.units import readable

#: Maximum number of bins of the map along its longer side.
BINS = 64
#: Maximum number of points of a path in a picture.
PATH_POINTS = 20_000
#: Number of passes in the plot of the velocities of a scan.
SHOWN = 6
#: Smallest span of both references [m] for a map; an axis with a smaller span holds its position.
LEAST_MAP = 1e-8
_MICRO = 1e6
#: Error message for a run without samples that can be evaluated.
NO_LINE = "no sample on a line of the scan has a displacement"
#: Rows of the table: name, label, unit, factor that converts from the SI unit.
ROWS = (
    ("rms_error_m", "RMS error in the plane", "µm", 1e6),
    ("rms_error_percent", "RMS error in the plane", "% of size", 1.0),
    ("max_error_m", "Largest error in the plane", "µm", 1e6),
    ("max_error_percent", "Largest error in the plane", "% of size", 1.0),
    ("along_error_m", "RMS error along the lines", "µm", 1e6),
    ("across_error_m", "RMS error across the lines", "µm", 1e6),
    ("coupling_error_m", "Coupling: RMS across a line, about its mean", "µm", 1e6),
    ("coupling_error_percent", "Coupling", "% of size", 1.0),
    ("trace_retrace_m", "Trace - retrace along the lines, RMS over pixels", "µm", 1e6),
    ("worst_line_m", "RMS error of the worst line", "µm", 1e6),
    ("normal_error_m", "RMS error of the third axis", "µm", 1e6),
    ("turn_error_m", "RMS error in turns and flyback", "µm", 1e6),
    ("size_m", "Size", "µm", 1e6),
    ("gap_m", "Largest distance between neighbouring lines", "µm", 1e6),
    ("constant_share_percent", "Data at constant velocity", "% of time", 1.0),
    ("frames", "Frames", "", 1.0),
    ("samples", "Samples that count", "", 1.0),
)


class InPlane:
    """Errors of a run of two or more axes; the first two axes are x and y of a plane."""

    time: np.ndarray
    reference: np.ndarray
    displacement: np.ndarray
    #: Names of the axes.
    names: tuple[str, ...] = AXES
    #: Times of the triggers of all axes [s].
    triggers: np.ndarray

    @cached_property
    def error(self) -> np.ndarray:
        """Reference - displacement, shape (axes, N) [m]."""
        return self.reference - self.displacement

    @cached_property
    def size(self) -> np.ndarray:
        """Magnitude of the error vector in the plane, shape (N,) [m]."""
        return np.hypot(*self.error[:2])

    @cached_property
    def measured(self) -> np.ndarray:
        """Whether reference and displacement of all axes are known at each sample, shape (N,)."""
        return np.all(np.isfinite(self.error), axis=0)

    @property
    def counted(self) -> np.ndarray:
        """Whether the error of each sample counts, shape (N,)."""
        return self.measured

    @property
    def gap(self) -> float:
        """Distance between neighbouring lines [m]; 0 if it is not known."""
        return 0.0


@dataclass(frozen=True, eq=False)
class PlaneRun(InPlane):
    """A run of two axes of a stage without a scan."""

    time: np.ndarray  #: shape (N,); Increasing [s].
    reference: np.ndarray  #: shape (2, N) [m]
    displacement: np.ndarray  #: shape (2, N) [m]; NaN: no measurement.
    names: tuple[str, ...] = AXES[:2]  #: Names of the axes.
    triggers: np.ndarray = field(default_factory=lambda: np.zeros(0))  #: shape (M,); Times of triggers [s].


def plane_of(axes: Mapping[str, Recording]) -> PlaneRun | None:
    """Return the run of the first two axes of a recording; None if they do not form a plane.

    The run begins when the errors of both axes count.
    """
    if len(axes) < 2:
        return None
    (first, one), (second, other), *_ = axes.items()
    needed = ("reference", "displacement")
    if not np.array_equal(one.time, other.time) or not all(run.has(name) for run in (one, other) for name in needed):
        return None
    reference = np.array([judged_reference(run) for run in (one, other)])
    displacement = np.array([run["displacement"] for run in (one, other)])
    begin = max(
        judged_start(run, Tracked(one.time, *signals))[0]
        for run, *signals in zip((one, other), reference, displacement, strict=True)
    )
    names = (first.rpartition(" ")[2], second.rpartition(" ")[2])
    times = one.time[begin:]
    found = PlaneRun(times, reference[:, begin:], displacement[:, begin:], names, trigger_times((one, other), times))
    return found if np.any(found.counted) else None


def trigger_times(runs: Iterable[Recording], time: np.ndarray, origin: float = 0.0) -> np.ndarray:
    """Return the trigger times of several axes within a run [s], relative to ``origin`` [s]."""
    found = np.sort(np.concatenate([triggers_of(run).time for run in runs])) - origin
    return found[(found >= time[0]) & (found <= time[-1])]


def plane_figures(run: PlaneRun) -> dict[str, float]:
    """Return RMS and largest error in the plane [m]."""
    there = run.size[run.counted]
    return {"rms_error_m": _rms(there), "max_error_m": float(np.max(there))}


@dataclass(frozen=True, eq=False)
class ScanRun(InPlane):
    """The recorded run of a scan."""

    scan: Scan
    time: np.ndarray  #: shape (N,); Time since the beginning of the scan, increasing [s].
    reference: np.ndarray  #: shape (axes, N) [m]
    displacement: np.ndarray  #: shape (axes, N) [m]; NaN: no measurement.
    triggers: np.ndarray = field(default_factory=lambda: np.zeros(0))  #: shape (M,); Times of triggers [s].
    #: shape (N,); Time on the path at each sample [s], if it differs from ``time`` because the scan was restarted.
    moment: np.ndarray | None = None
    names: tuple[str, ...] = AXES  #: Names of the axes.

    def __post_init__(self):
        """Refuse inconsistent shapes, and a run in which no sample counts."""
        expected = (self.scan.axes, np.size(self.time))
        for name in ("reference", "displacement"):
            given = np.shape(getattr(self, name))
            if given != expected:
                raise RecordingError(f"{name} has shape {given}; it must be {expected}: axes of the scan, samples")
        if not np.any(self.counted):
            raise RecordingError(NO_LINE)

    @cached_property
    def clock(self) -> Clock:
        """Frame, line and pixel of each sample."""
        return self.scan.clock(self.time if self.moment is None else self.moment)

    @property
    def lasts(self) -> float:
        """Time for which the axes follow the scan [s], without stops."""
        if self.moment is None:
            return float(self.time[-1] - self.time[0])
        steps = np.diff(self.moment)
        return float(np.sum(steps[steps > 0.0]))

    @cached_property
    def in_plane(self) -> np.ndarray:
        """Error along and across the lines, shape (2, N) [m]."""
        return self.scan.matrix[:2].T @ self.error[:2]

    @cached_property
    def counted(self) -> np.ndarray:
        """Whether the error of each sample counts: only samples on a line count; shape (N,)."""
        return self.measured & (self.clock.line >= 0)

    @property
    def gap(self) -> float:
        """Distance between neighbouring lines [m]; 0 if there are no lines."""
        return self.scan.gap if np.isfinite(self.scan.gap) else 0.0


@dataclass(frozen=True, eq=False)
class LineErrors:
    """Errors of each pass, in order of time."""

    frame: np.ndarray  #: frame, line, direction: shape (P,)
    line: np.ndarray
    direction: np.ndarray
    rms: np.ndarray  #: shape (P,); RMS error in the plane [m].
    across: np.ndarray  #: shape (P,); RMS error across the line, about its mean [m].


@dataclass(frozen=True, eq=False)
class Profile:
    """Mean errors along the lines at each pixel, over all lines and frames; NaN for a pixel without samples."""

    trace: np.ndarray  #: trace, retrace: shape (pixels,) [m]
    retrace: np.ndarray


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Errors over the plane, in bins of the reference; NaN for a bin without samples."""

    x: np.ndarray  #: x, y: shape (columns + 1,), (rows + 1,); Edges of the bins [m].
    y: np.ndarray
    count: np.ndarray  #: shape (rows, columns); Number of samples in each bin.
    mean: np.ndarray  #: shape (2, rows, columns); Mean errors of x and y [m].
    rms: np.ndarray  #: shape (rows, columns); RMS of the magnitude of the error [m].


def judged_from(scan: Scan, time: np.ndarray) -> float:
    """Return the time on the path from which a run counts [s]: after the first period; in a short run, the first line.

    ``time`` is the time on the path at each sample [s].
    """
    lasts = np.max(time, initial=0.0)
    return scan.period if lasts >= 1.9 * scan.period else float(scan.passes.begin[1]) / scan.rate


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def line_errors(run: ScanRun) -> LineErrors:
    """Return the errors of each pass over the plane."""
    clock, on = run.clock, run.counted
    keys = np.stack([clock.frame[on], clock.line[on], clock.direction[on]])
    changes = np.flatnonzero(np.any(np.diff(keys, axis=1) != 0, axis=0)) + 1
    starts = np.concatenate([[0], changes])
    number = np.diff(np.append(starts, keys.shape[1]))
    across = run.in_plane[1, on]
    mean = np.add.reduceat(across, starts) / number
    spread = np.add.reduceat((across - np.repeat(mean, number)) ** 2, starts) / number
    rms = np.sqrt(np.add.reduceat(run.size[on] ** 2, starts) / number)
    frame, line, direction = keys[:, starts]
    return LineErrors(frame, line, direction, rms, np.sqrt(spread))


def profile(run: ScanRun) -> Profile:
    """Return the mean error along the lines at each pixel, separately for traces and retraces."""
    clock, along, found = run.clock, run.in_plane[0], []
    for direction in (1, -1):
        on = run.counted & (clock.direction == direction)
        number = np.bincount(clock.pixel[on], minlength=run.scan.pixels)
        total = np.bincount(clock.pixel[on], along[on], minlength=run.scan.pixels)
        found.append(np.divide(total, number, out=np.full(number.size, np.nan), where=number > 0))
    return Profile(*found)


def error_map(run: InPlane, bins: int | None = None) -> ErrorMap:
    """Return the error map; by default bins are at least as wide as the distance between lines."""
    on = run.counted
    places, errors = run.reference[:2, on], run.error[:2, on]
    low, high = places.min(axis=1), places.max(axis=1)
    span = np.maximum(high - low, 1e-12)
    if bins is None:
        apart = max(run.gap, span.max() / BINS)
        bins = int(np.clip(min(BINS, span.max() / apart, np.sqrt(on.sum() / 4.0)), 1, BINS))
    counts = np.maximum(np.rint(bins * span / span.max()).astype(int), 1)
    edges = [low[i] + span[i] * np.arange(counts[i] + 1) / counts[i] for i in range(2)]
    cell = [np.clip(((places[i] - low[i]) / span[i] * counts[i]).astype(int), 0, counts[i] - 1) for i in range(2)]
    flat, shape = cell[1] * counts[0] + cell[0], (counts[1], counts[0])
    number = np.bincount(flat, minlength=counts.prod())

    def averaged(values):
        total = np.bincount(flat, values, minlength=number.size)
        return np.divide(total, number, out=np.full(number.size, np.nan), where=number > 0).reshape(shape)

    mean = np.array([averaged(values) for values in errors])
    rms = np.sqrt(averaged(np.sum(errors**2, axis=0)))
    return ErrorMap(edges[0], edges[1], number.reshape(shape), mean, rms)


def retraced(run: ScanRun) -> bool:
    """Return whether traces and retraces pass through the same points and can be compared."""
    return run.scan.slow_axis and bool(np.any(run.scan.passes.direction < 0))


def scan_figures(run: ScanRun) -> dict:
    """Return the figures of a scan, see :data:`ROWS`; None for a figure that does not apply to this kind of scan.

    Coupling is the error across a line caused by the motion along the line. The mean error of the line is subtracted,
    because an offset of the whole line is an error of the other axis itself.
    """
    scan, on = run.scan, run.counted
    lines, sides = line_errors(run), profile(run)
    turning = run.measured & (run.clock.line < 0)
    coupling = None
    if scan.slow_axis:
        samples = np.diff(np.append(np.flatnonzero(_begins(run)), on.sum())).astype(float)
        coupling = float(np.sqrt(np.average(lines.across**2, weights=samples)))
    difference = sides.trace - sides.retrace
    both = np.isfinite(difference)
    largest = float(np.max(run.size[on]))
    rms = _rms(run.size[on])
    return {
        "rms_error_m": rms,
        "rms_error_percent": 100.0 * rms / scan.size,
        "max_error_m": largest,
        "max_error_percent": 100.0 * largest / scan.size,
        "along_error_m": _rms(run.in_plane[0, on]) if scan.slow_axis else None,
        "across_error_m": _rms(run.in_plane[1, on]) if scan.slow_axis else None,
        "coupling_error_m": coupling,
        "coupling_error_percent": None if coupling is None else 100.0 * coupling / scan.size,
        "trace_retrace_m": _rms(difference[both]) if np.any(both) and retraced(run) else None,
        "worst_line_m": float(np.max(lines.rms)),
        "normal_error_m": _rms(run.error[2, on]) if scan.axes == 3 else None,
        "turn_error_m": _rms(run.size[turning]) if np.any(turning) else None,
        "size_m": scan.size,
        "gap_m": scan.gap if np.isfinite(scan.gap) else None,
        "constant_share_percent": 100.0 * scan.constant_share if scan.constant_share else None,
        "frames": float(run.lasts * scan.rate),
        "samples": int(on.sum()),
    }


def _begins(run: ScanRun) -> np.ndarray:
    """Return whether each counted sample is the first sample of its pass."""
    clock, on = run.clock, run.counted
    keys = np.stack([clock.frame[on], clock.line[on], clock.direction[on]])
    return np.concatenate([[True], np.any(np.diff(keys, axis=1) != 0, axis=0)])


def path_figure(run: InPlane):
    """Return the figure of reference and path in the plane; the colour of the path shows the magnitude of the error."""
    figure, (axis,) = new_figure(6.4)
    from matplotlib.collections import LineCollection

    there = np.flatnonzero(run.measured)
    step = -(-there.size // PATH_POINTS)
    starts = np.arange(0, there.size, step)
    # each segment shows its largest error, so that no peak is lost
    sizes = np.maximum.reduceat(run.size[there], starts)
    unit, factor = length_unit(float(np.max(sizes)))
    points = run.displacement[:2, there[starts]].T * _MICRO
    lines = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis", linewidths=1.1)
    lines.set_array(sizes[:-1] * factor)
    wanted = run.reference[:2, there[starts]] * _MICRO
    axis.plot(*wanted, color=COLOURS["setpoint"][0], linewidth=2.6, alpha=0.35, label="reference", zorder=1)
    axis.add_collection(lines)
    if run.triggers.size:
        places = [np.interp(run.triggers, run.time, way) * _MICRO for way in run.displacement[:2]]
        style = dict(color=COLOURS["late"][0], markersize=6.0, zorder=3)
        axis.plot(*places, ".", label=f"{run.triggers.size} triggers", **style)
    axis.autoscale_view()
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel=f"{run.names[0]} [µm]", ylabel=f"{run.names[1]} [µm]")
    add_legend(axis)
    figure.colorbar(lines, ax=axis, label=f"error in the plane [{unit}]")
    return figure


def map_figure(run: InPlane):
    """Return the figure of the error maps: RMS error, and mean errors of x and y."""
    found = error_map(run)
    ratio = (found.y[-1] - found.y[0]) / (found.x[-1] - found.x[0])
    figure, axes = new_figure(float(np.clip(1.6 + 2.5 * ratio, 2.5, 6.0)), 3)
    edges = [found.x * _MICRO, found.y * _MICRO]
    unit, factor = length_unit(float(np.nanmax(found.rms)))
    # the percentile keeps extreme bins, such as bins with a single sample at the edge, out of the colour scale
    steepest = max(float(np.nanpercentile(np.abs(found.mean), 99.0)), 1e-15) * factor
    panels = [("RMS error", found.rms, dict(cmap="viridis", vmin=0.0))]
    panels += [
        (f"mean error of {name}", mean, dict(cmap="RdBu_r", vmin=-steepest, vmax=steepest))
        for name, mean in zip(run.names[:2], found.mean, strict=True)
    ]
    for axis, (label, values, style) in zip(axes, panels, strict=True):
        axis.grid(False)
        drawn = axis.pcolormesh(*edges, values * factor, **style)
        axis.set_aspect("equal")
        axis.set(xlabel=f"{run.names[0]} [µm]", ylabel=f"{run.names[1]} [µm]" if axis is axes[0] else "")
        axis.set_title(label, fontsize=10)
        figure.colorbar(
            drawn,
            ax=axis,
            orientation="horizontal",
            label=f"[{unit}]",
            extend="neither" if "vmax" not in style else "both",
        )
    return figure


def lines_figure(run: ScanRun):
    """Return the figure of the RMS error of each line: mean, smallest and largest over the frames."""
    lines = line_errors(run)
    figure, (axis,) = new_figure(3.2)
    unit, factor = length_unit(float(np.max(lines.rms)))
    for direction, label, colour in ((1, "trace", "reference"), (-1, "retrace", "displacement")):
        on = lines.direction == direction
        if not np.any(on):
            continue
        numbers = np.unique(lines.line[on])
        each = [lines.rms[on & (lines.line == number)] * factor for number in numbers]
        colour = COLOURS[colour][0]
        axis.plot(numbers, [np.mean(values) for values in each], ".-", color=colour, linewidth=1.0, label=label)
        bounds = [[np.min(values) for values in each], [np.max(values) for values in each]]
        axis.fill_between(numbers, *bounds, color=colour, alpha=0.2, linewidth=0)
    top = 1.1 * factor * float(np.max(lines.rms))
    axis.set(xlabel="line", ylabel=f"RMS error in the plane [{unit}]", ylim=(0.0, top or 1.0))
    add_legend(axis)
    return figure


def trace_figure(run: ScanRun):
    """Return the figure of the mean error along the lines, for traces and retraces."""
    found, scan = profile(run), run.scan
    figure, (axis,) = new_figure(3.2)
    place = ((np.arange(scan.pixels) + 0.5) / scan.pixels - 0.5) * getattr(scan, "width", scan.size) * _MICRO
    both = np.concatenate([found.trace, found.retrace])
    unit, factor = length_unit(float(np.nanmax(np.abs(both))))
    for label, values, colour in (
        ("trace", found.trace, "reference"),
        ("retrace", found.retrace, "displacement"),
        ("trace - retrace", found.trace - found.retrace, "estimated"),
    ):
        axis.plot(place, values * factor, color=COLOURS[colour][0], linewidth=1.2, label=label)
    axis.set(xlabel="position along the line [µm]", ylabel=f"mean error along the line [{unit}]")
    add_legend(axis)
    return figure


def scan_picture(scan: Scan):
    """Return the figure of a scan without a run: the path of one period, and the velocities in a few of its lines."""
    figure, (left, right) = new_figure(4.4, 2)
    time = np.linspace(0.0, scan.period, PATH_POINTS)
    x, y = scan.position(time)[:2] * _MICRO
    direction = scan.clock(time).direction
    # a retrace is drawn below its trace, with a wider line
    for value, label, colour, width in (
        (0, "turns", "setpoint", 0.9),
        (-1, "retrace", "displacement", 2.2),
        (1, "trace", "reference", 0.8),
    ):
        on = direction == value
        if np.any(on):
            near = on | np.roll(on, 1)
            style = dict(color=COLOURS[colour][0], linewidth=width, label=label, alpha=0.6 if value < 0 else 1.0)
            left.plot(np.where(near, x, np.nan), np.where(near, y, np.nan), **style)
    left.set_aspect("equal", adjustable="datalim")
    left.set(xlabel="x [µm]", ylabel="y [µm]")
    add_legend(left)
    begins = scan.passes.begin[scan.passes.begin < 1.0]
    few = begins[max(begins.size // 2 - SHOWN, 0) :][: SHOWN + 1]
    first, last = (float(few[0]), float(few[-1])) if few.size > SHOWN else (0.0, 1.0)
    time = np.linspace(first, last, PATH_POINTS // 4) * scan.frame_time
    colours = ("reference", "displacement", "estimated")
    for name, velocity, colour in zip(AXES, scan.velocity(time), colours, strict=False):
        right.plot(time * 1e3, velocity * 1e3, color=COLOURS[colour][0], linewidth=1.1, label=name)
    right.set(xlabel="time [ms]", ylabel="velocity [mm/s]")
    add_legend(right)
    return figure


def format_scan(figures: dict) -> str:
    """Return the figures of a scan as aligned lines for a terminal."""
    rows = [(label, *shown(figures[name], unit, factor)) for name, label, unit, factor in ROWS]
    there = [row for row, (name, *_) in zip(rows, ROWS, strict=True) if figures[name] is not None]
    return "\n".join(aligned([(label, [value], unit) for label, value, unit in there]))


def plane_plots(run: InPlane) -> Iterable[tuple[str, object]]:
    """Yield captions and charts of a run in the plane; the error map only if both axes move."""
    yield "Path in the plane, coloured by the error", path_figure(run)
    if np.min(np.ptp(run.reference[:2, run.counted], axis=1)) > LEAST_MAP:
        yield "Map of the error in the plane", map_figure(run)


def format_plane(run: PlaneRun) -> str:
    """Return the figures of a run in the plane as one line for a terminal."""
    figures = plane_figures(run)
    rms, largest = (readable(figures[name], "m") for name in ("rms_error_m", "max_error_m"))
    return f"plane {run.names[0]}-{run.names[1]}: RMS error {rms}, largest {largest}"


def write_picture(path, figure) -> None:
    """Write a figure as PNG."""
    with replacing(path, RecordingError) as beside:
        figure.savefig(beside, format="png")


def scan_plots(run: ScanRun) -> Iterable[tuple[str, object]]:
    """Yield captions and figures of a scan."""
    yield from plane_plots(run)
    yield "RMS error line by line", lines_figure(run)
    if scan_figures(run)["trace_retrace_m"] is not None:
        yield "Mean error along the lines, trace against retrace", trace_figure(run)


def write_scan_report(path, run: ScanRun, title: str) -> None:
    """Write the page of a scan as one self-contained HTML file."""
    require_page(path)
    figures = scan_figures(run)
    rows = [shown_row(label, figures[name], unit, factor) for name, label, unit, factor in ROWS]
    html = render_page(
        "identification.html.j2",
        title=title,
        summary=f"RMS error in the plane {readable(figures['rms_error_m'], 'm')}, "
        f"{figures['rms_error_percent']:.3g} % of {readable(run.scan.size, 'm')}, at {run.scan.rate:.4g} frames/s",
        warnings=[],
        rows=[row for row, (name, *_) in zip(rows, ROWS, strict=True) if figures[name] is not None],
        plots=[dict(caption=caption, source=data_uri(figure)) for caption, figure in scan_plots(run)],
        assumptions=(),
    )
    write_page(path, html)
