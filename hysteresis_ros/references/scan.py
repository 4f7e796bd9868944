# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Scans of a plane: the path of several axes in closed form, its limits, its line and pixel clock, its harmonics.

A scan is a frozen dataclass of parameters, derived from :class:`Scan`; each file in ``scans/`` contains one scan. The
path is a function of the number of frames s = frame rate · time, in coordinates (u, v) of the plane: u along the lines,
v across them. A rotation, a shift and a tilt convert it to the axes::

    x = centre_x + u cos φ − v sin φ
    y = centre_y + u sin φ + v cos φ
    z = slope_x x + slope_y y + height            (with three axes)

Therefore velocity, acceleration and jerk are proportional to the frame rate, its square and its cube. The frame rate
that the limits of an axis allow is computed without a search.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.linear_algebra import product
from hysteresis_ros.units import readable

#: Names of the axes; then name and SI unit of the position and of each derivative.
AXES = ("x", "y", "z")
ORDERS = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s²"), ("jerk", "m/s³"))
#: An instant that precedes a pixel by less than this fraction of the pixel's duration counts as part of the pixel.
EDGE = 1e-6
#: Relative tolerance of a limit, for rounding.
ROUNDING = 1e-9
#: Desired number of points per pass for the computation of harmonics.
POINTS = 1024
#: Smallest number of points per pass, even if a period then has more than MOST_POINTS points.
FEW_POINTS = 64
#: Smallest number of points per period for the computation of harmonics.
LEAST_POINTS = 1 << 15
#: Largest number of points per period, unless FEW_POINTS points per pass are more.
MOST_POINTS = 1 << 19
#: Fraction of the power of the motion within :attr:`Scan.bandwidth`. The remaining motion has at most 1 % of the total
#: RMS.
OCCUPIED = 0.9999


@dataclass(frozen=True, eq=False)
class Passes:
    """The passes of a period in order of time. A pass is a part of the path, along one line, on which data are taken.

    Parameters
    ----------
    begin, duration : ndarray, shape (P,)
        [frames]
    line : ndarray, shape (P,)
        Number of the line within the frame.
    direction : ndarray, shape (P,)
        1: trace, -1: retrace.
    """

    begin: np.ndarray
    duration: np.ndarray
    line: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True, eq=False)
class Clock:
    """Frame, line, pixel and direction at given instants of a scan.

    Parameters
    ----------
    frame : ndarray, shape (N,)
        Number of the frame, from 0.
    line, pixel : ndarray, shape (N,)
        Number of the line within the frame, and of the pixel within the line; -1 between lines. Pixels are numbered in
        the direction of a trace, so a retrace begins at the last pixel.
    direction : ndarray, shape (N,)
        1: trace, -1: retrace, 0: between lines.
    """

    frame: np.ndarray
    line: np.ndarray
    pixel: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True, eq=False)
class Marks:
    """Beginnings of frames, lines or pixels within a recording.

    Parameters
    ----------
    time : ndarray, shape (K,)
        Exact instants, computed from the equation of the path [s].
    sample : ndarray, shape (K,)
        The first sample at or after each instant.
    place : ndarray, shape (K,)
        The instant as a sample number with a fraction: 17.25 is a quarter of a sample time after sample 17.
    frame, line, pixel, direction : ndarray, shape (K,)
        The frame, line or pixel that begins, as in :class:`Clock`; -1 (direction: 0) for items that do not apply.
    """

    time: np.ndarray
    sample: np.ndarray
    place: np.ndarray
    frame: np.ndarray
    line: np.ndarray
    pixel: np.ndarray
    direction: np.ndarray


class Harmonics(NamedTuple):
    """Fourier series of a scan: axis i is at mean_i + Σ_k Re(amplitudes_ik exp(2πj frequencies_k t))."""

    frequencies: np.ndarray  #: shape (K,) [Hz]
    amplitudes: np.ndarray  #: shape (axes, K), complex [m]
    mean: np.ndarray  #: shape (axes,) [m]


@dataclass(frozen=True)
class Scan(Parameters, abc.ABC):
    """Parameters that all scans share, and quantities that are computed from the path.

    Parameters
    ----------
    frame_rate : float
        Frames per second [Hz].
    pixels : int
        Number of pixels per line.
    centre_x, centre_y : float
        Middle of the scan [m].
    rotation : float
        Angle φ from the x axis to the direction of the lines [rad].
    axes : int
        2 or 3.
    slope_x, slope_y, height : float
        Tilt and height [m] of the plane, which the third axis follows.
    """

    frame_rate: float = parameter(1.0, description="frames per second", unit="Hz", low=0.0, high=1e6)
    pixels: int = parameter(256, description="pixels per line", low=1, high=100_000)
    centre_x: float = parameter(0.0, description="x of the middle of the scan", unit="m", low=-1.0, high=1.0)
    centre_y: float = parameter(0.0, description="y of the middle of the scan", unit="m", low=-1.0, high=1.0)
    rotation: float = parameter(
        0.0, description="angle from the x axis to the direction of the lines", unit="rad", low=-7.0, high=7.0
    )
    axes: int = parameter(2, description="number of axes that move; with 3, z follows the plane", low=2, high=3)
    slope_x: float = parameter(0.0, description="z per x of a tilted plane", low=-10.0, high=10.0)
    slope_y: float = parameter(0.0, description="z per y of a tilted plane", low=-10.0, high=10.0)
    height: float = parameter(0.0, description="z of the plane at x = y = 0", unit="m", low=-1.0, high=1.0)

    def check(self) -> Iterable[Problem]:
        """Yield a Problem for each inconsistency."""
        if not self.rate > 0.0:
            yield Problem("frame_rate", self.frame_rate, "must be > 0 Hz")
        for name in ("slope_x", "slope_y", "height"):
            if self.axes == 2 and getattr(self, name) != 0.0:
                yield Problem(name, getattr(self, name), "belongs to a third axis; set axes = 3, or leave it out")

    # each scan defines the following, in numbers of frames and in coordinates of the plane

    @property
    @abc.abstractmethod
    def frames_per_period(self) -> int:
        """Number of frames after which the path repeats."""

    @property
    @abc.abstractmethod
    def size(self) -> float:
        """Diameter, or length of the longer side [m]; errors are stated in % of this size."""

    @property
    @abc.abstractmethod
    def gap(self) -> float:
        """Largest distance between neighbouring lines [m], which is the resolution."""

    @abc.abstractmethod
    def plane(self, frames: np.ndarray, order: int = 0) -> np.ndarray:
        """Return u and v, or a derivative of them with respect to the number of frames.

        Parameters
        ----------
        frames : ndarray, shape (N,)
            Number of frames since the beginning of a period, in 0 … :attr:`frames_per_period`.
        order : int, optional
            Order of the derivative, 0 … 3.

        Returns
        -------
        ndarray, shape (2, N)
            [m]
        """

    @abc.abstractmethod
    def plane_range(self, matrix: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of combinations of u and v, or of their derivatives with respect to the number of frames.

        Parameters
        ----------
        matrix : ndarray, shape (A, 2)
            Combinations.
        order : int
            Order of the derivative, 0 … 3.

        Returns
        -------
        low, high : ndarray, shape (A,)
            Bounds that are never exceeded; infinite if the derivative jumps or does not exist.
        """

    @property
    @abc.abstractmethod
    def passes(self) -> Passes:
        """The passes of a period."""

    @property
    def constant_share(self) -> float:
        """Fraction of a frame's duration in which data are taken at a constant velocity along the line."""
        return 0.0

    @property
    def slow_axis(self) -> bool:
        """Whether v is constant, or drifts slowly, while a line is scanned along u."""
        return False

    # the following is computed from these definitions

    @property
    def rate(self) -> float:
        """Frames per second [Hz]."""
        return self.frame_rate

    @property
    def period(self) -> float:
        """Time after which the path repeats [s]."""
        return self.frames_per_period / self.rate

    @property
    def frame_time(self) -> float:
        """Duration of a frame [s]."""
        return 1.0 / self.rate

    @property
    def lines_per_frame(self) -> int:
        """Number of lines per frame."""
        return int(self.passes.line.max()) + 1

    @cached_property
    def matrix(self) -> np.ndarray:
        """Matrix from (u, v) to the axes, shape (axes, 2)."""
        cosine, sine = math.cos(self.rotation), math.sin(self.rotation)
        rows = [[cosine, -sine], [sine, cosine]]
        slopes = [self.slope_x * cosine + self.slope_y * sine, self.slope_y * cosine - self.slope_x * sine]
        return np.array([*rows, slopes][: self.axes])

    @property
    def centre(self) -> np.ndarray:
        """Position of the axes at u = v = 0, shape (axes,) [m]."""
        height = self.slope_x * self.centre_x + self.slope_y * self.centre_y + self.height
        return np.array([self.centre_x, self.centre_y, height][: self.axes])

    def derivative(self, time, order: int) -> np.ndarray:
        """Return a time derivative of the path.

        Parameters
        ----------
        time : array_like, shape (N,)
            Time since the beginning [s]; the scan also repeats before the beginning.
        order : int
            0 … 3.

        Returns
        -------
        ndarray, shape (axes, N)
            [m], [m/s], [m/s²] or [m/s³].

        Raises
        ------
        ParameterError
            A parameter is missing or out of range.
        """
        self.validated()
        frames = np.atleast_1d(np.asarray(time, dtype=np.float64)) * self.rate
        # the loop follows these values, so their bits must not depend on the processor
        path = product(self.matrix, self.plane(np.mod(frames, self.frames_per_period), order)) * self.rate**order
        return path + self.centre[:, None] if order == 0 else path

    def position(self, time) -> np.ndarray:
        """Return the positions of the axes [m], shape (axes, N), at instants [s], shape (N,)."""
        return self.derivative(time, 0)

    def velocity(self, time) -> np.ndarray:
        """Return the velocity [m/s], shape (axes, N), at instants [s], shape (N,)."""
        return self.derivative(time, 1)

    def acceleration(self, time) -> np.ndarray:
        """Return the acceleration [m/s²], shape (axes, N), at instants [s], shape (N,)."""
        return self.derivative(time, 2)

    def jerk(self, time) -> np.ndarray:
        """Return the jerk [m/s³], shape (axes, N), at instants [s], shape (N,)."""
        return self.derivative(time, 3)

    def samples(self, count: int, sample_time: float) -> np.ndarray:
        """Return the first samples of the path, shape (axes, N) [m].

        Parameters
        ----------
        count : int
            Number N of samples.
        sample_time : float
            [s]
        """
        return self.position(np.arange(count) * sample_time)

    @cached_property
    def _peaks(self) -> np.ndarray:
        """Largest magnitudes of the derivatives with respect to the number of frames, shape (4, axes)."""
        self.validated()
        found = []
        for order in range(4):
            low, high = self.plane_range(self.matrix, order)
            found.append(np.maximum(np.abs(low), np.abs(high)))
        return np.array(found)

    def peak(self, order: int) -> np.ndarray:
        """Return the largest magnitude of a time derivative, shape (axes,).

        Parameters
        ----------
        order : int
            1: velocity [m/s], 2: acceleration [m/s²], 3: jerk [m/s³].

        Returns
        -------
        ndarray, shape (axes,)
            Exact for straight pieces and single sinusoids, otherwise a bound that is never exceeded. The jerk is
            infinite if the acceleration jumps.
        """
        return self._peaks[order] * self.rate**order

    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest position of each axis [m], shape (axes,), including the turns."""
        self.validated()
        low, high = self.plane_range(self.matrix, 0)
        return low + self.centre, high + self.centre

    def in_plane(self, position: np.ndarray) -> np.ndarray:
        """Return positions of the axes, shape (axes, N), as u and v, shape (2, N) [m]."""
        centred = np.asarray(position)[:2] - self.centre[:2, None]
        return self.matrix[:2].T @ centred

    def clock(self, time) -> Clock:
        """Return frame, line, pixel and direction at instants.

        Parameters
        ----------
        time : array_like, shape (N,)
            [s]

        Returns
        -------
        Clock
        """
        self.validated()
        passes = self.passes
        frames = np.atleast_1d(np.asarray(time, dtype=np.float64)) * self.rate
        frames = frames + EDGE * passes.duration.min() / self.pixels
        phase = np.mod(frames, self.frames_per_period)
        number = np.searchsorted(passes.begin, phase, "right") - 1
        part = (phase - passes.begin[number]) / passes.duration[number]
        on = (number >= 0) & (part < 1.0)
        pixel = np.clip((part * self.pixels).astype(np.int64), 0, self.pixels - 1)
        direction = passes.direction[number]
        pixel = np.where(direction > 0, pixel, self.pixels - 1 - pixel)
        return Clock(
            np.floor(frames).astype(np.int64),
            np.where(on, passes.line[number], -1),
            np.where(on, pixel, -1),
            np.where(on, direction, 0),
        )

    @cached_property
    def bandwidth(self) -> float:
        """Frequency [Hz] below which 99.99 % of the power of the motion lies."""
        self.validated()
        amplitudes, _ = self._series
        power = np.cumsum(np.sum(np.abs(amplitudes) ** 2, axis=0))
        order = int(np.searchsorted(power, OCCUPIED * power[-1]))
        return order / self.period

    @cached_property
    def _series(self) -> tuple[np.ndarray, np.ndarray]:
        """Complex amplitudes of the period's harmonics, shape (axes, K), with harmonic 0 set to 0; and the mean."""
        passes = len(self.passes.begin)
        wanted = max(min(max(LEAST_POINTS, POINTS * passes), MOST_POINTS), FEW_POINTS * passes)
        count = 1 << math.ceil(math.log2(wanted))
        path = self.matrix @ self.plane(np.arange(count) * (self.frames_per_period / count))
        lines = np.fft.rfft(path, axis=1) * (2.0 / count)
        mean = 0.5 * lines[:, 0].real + self.centre
        lines = lines[:, : count // 4]
        lines[:, 0] = 0.0
        return lines, mean


@dataclass(frozen=True, eq=False)
class ScanShape:
    """Declaration of a scan.

    Parameters
    ----------
    name : str
        Name under which the scan is chosen.
    parameters : type of Scan
        Class of the scan.
    summary : str
        Description in one line.
    """

    name: str
    parameters: type[Scan]
    summary: str


def harmonics(scan: Scan, count: int) -> Harmonics:
    """Return the strongest harmonics of a scan, for internal models and repetitive control.

    Parameters
    ----------
    scan : Scan
    count : int
        Number of harmonics; all other harmonics have a smaller norm over the axes.

    Returns
    -------
    Harmonics
        Harmonics in order of frequency; the frequencies are multiples of 1 / period. There are fewer than ``count`` if
        the scan has fewer: a Lissajous scan has two.

    Raises
    ------
    ParameterError
        The number is not positive.
    """
    if count < 1:
        raise ParameterError([Problem("count", count, "must be ≥ 1 harmonics")])
    scan.validated()
    amplitudes, mean = scan._series
    size = np.linalg.norm(amplitudes, axis=0)
    strongest = np.argsort(-size, kind="stable")[:count]
    orders = np.sort(strongest[size[strongest] > 1e-12 * size.max()])
    return Harmonics(orders / scan.period, amplitudes[:, orders], mean)


@dataclass(frozen=True)
class ScanLimits(Parameters):
    """Limits of the axes. One value applies to every axis, several apply to x, y, z in this order; empty: unlimited.

    Parameters
    ----------
    low, high : tuple of float
        Range [m].
    velocity, acceleration, jerk : tuple of float
        Largest magnitudes [m/s], [m/s²], [m/s³].
    bandwidth : float
        Bandwidth of the slowest axis [Hz]; 0: unlimited.
    """

    low: tuple[float, ...] = parameter((), description="lowest position of each axis", unit="m")
    high: tuple[float, ...] = parameter((), description="highest position of each axis", unit="m")
    velocity: tuple[float, ...] = parameter((), description="largest velocity of each axis", unit="m/s", low=0.0)
    acceleration: tuple[float, ...] = parameter(
        (), description="largest acceleration of each axis", unit="m/s²", low=0.0
    )
    jerk: tuple[float, ...] = parameter((), description="largest jerk of each axis", unit="m/s³", low=0.0)
    bandwidth: float = parameter(
        0.0,
        description="upper limit of the frequency below which 99.99 % of the motion's power lies; 0: none",
        unit="Hz",
        low=0.0,
    )

    def of_axes(self, name: str, axes: int) -> np.ndarray:
        """Return a limit for each axis; infinite if the axis is unlimited.

        Parameters
        ----------
        name : str
            ``velocity``, ``acceleration``, ``jerk``, ``low`` or ``high``.
        axes : int
            Number of axes.

        Returns
        -------
        ndarray, shape (axes,)

        Raises
        ------
        ParameterError
            The number of values is neither one nor the number of axes, or a limit of motion is not positive.
        """
        values = getattr(self, name)
        if not values:
            return np.full(axes, -np.inf if name == "low" else np.inf)
        if len(values) not in (1, axes):
            text = f"has {len(values)} values for {axes} axes; give one for all of them, or one for each"
            raise ParameterError([Problem(name, values, text)])
        if name not in ("low", "high") and min(values) <= 0.0:
            raise ParameterError([Problem(name, values, "must be > 0; leave it out if the axes are unlimited")])
        return np.broadcast_to(np.array(values), (axes,))


def largest_frame_rate(scan: Scan, limits: ScanLimits) -> float:
    """Return the largest frame rate at which a scan keeps its limits of velocity, acceleration, jerk and bandwidth.

    Parameters
    ----------
    scan : Scan
        The scan; its frame rate has no effect.
    limits : ScanLimits

    Returns
    -------
    float
        [Hz]; infinite without limits; 0 if the jerk is limited and the acceleration of the scan jumps.

    Raises
    ------
    ParameterError
        The number of limits does not match the number of axes.
    """
    rates = [math.inf]
    for order, (name, _) in enumerate(ORDERS[1:], start=1):
        allowed = limits.of_axes(name, scan.axes)
        for peak, limit in zip(scan._peaks[order], allowed, strict=True):
            if peak > 0.0 and math.isfinite(limit):
                rates.append((limit / peak) ** (1.0 / order))
    if limits.bandwidth > 0.0:
        rates.append(limits.bandwidth * scan.rate / scan.bandwidth)
    return min(rates)


def check_limits(scan: Scan, limits: ScanLimits) -> None:
    """Raise ParameterError if the axes cannot follow a scan.

    This is the case if an axis leaves its range or exceeds a limit. The message states each excess and the allowed
    frame rate.
    """
    found = [*_beyond_range(scan, limits)]
    best = largest_frame_rate(scan, limits)
    if best == 0.0:
        text = "the acceleration jumps, so the jerk exceeds any limit; use minimum_jerk"
        found.append(Problem("turn_law", getattr(scan, "turn_law", None), text))
    elif scan.rate > best * (1.0 + ROUNDING):
        rate = rounded_down(best)
        text = f"{'; '.join(_excesses(scan, limits))}; allowed: ≤ {rate:.6g} Hz, a frame in {1.0 / rate:.6g} s or more"
        found.append(Problem("frame_rate", scan.rate, text))
    if found:
        raise ParameterError(found)


def _beyond_range(scan: Scan, limits: ScanLimits) -> Iterable[Problem]:
    """Yield a Problem for each axis that leaves its range during a scan, at one end or at both."""
    lowest, highest = scan.extent()
    low, high = limits.of_axes("low", scan.axes), limits.of_axes("high", scan.axes)
    for axis in range(scan.axes):
        size, room = highest[axis] - lowest[axis], high[axis] - low[axis]
        ends = {float(lowest[axis]): low[axis] - lowest[axis], float(highest[axis]): highest[axis] - high[axis]}
        beyond = {value: excess for value, excess in ends.items() if excess > ROUNDING * size}
        if not beyond:
            continue
        lower = f"≥ {readable(low[axis], 'm')}" if math.isfinite(low[axis]) else ""
        upper = f"≤ {readable(high[axis], 'm')}" if math.isfinite(high[axis]) else ""
        allowed = " and ".join(filter(None, (lower, upper)))
        value, excess = max(beyond.items(), key=lambda one: one[1])
        if size > room:
            remedy = f"make the scan at most {rounded_down(room / size, 3):.3g} times as large"
        else:
            moved = excess if value == lowest[axis] else -excess
            remedy = f"move its centre by {readable(moved, 'm')}, or make it smaller"
        other = ", and the other end too" if len(beyond) > 1 else ""
        by = f"{readable(excess, 'm')}{other}"
        text = f"the path with its turns exceeds the range by {by}, allowed: {allowed}; {remedy}"
        yield Problem(f"position of {AXES[axis]}", float(f"{1e6 * value:.4g}"), text, "µm")


def _excesses(scan: Scan, limits: ScanLimits) -> Iterable[str]:
    """Yield a text for each limit of motion that is exceeded, with the ratio of the motion to the limit."""
    for order, (name, unit) in enumerate(ORDERS[1:], start=1):
        allowed = limits.of_axes(name, scan.axes)
        for axis, peak, limit in zip(AXES, scan.peak(order), allowed, strict=False):
            if peak > limit * (1.0 + ROUNDING):
                yield f"{name} of {axis} {peak:.4g} {unit} is {peak / limit:.4g} times its limit {limit:g} {unit}"
    if 0.0 < limits.bandwidth < scan.bandwidth:
        share = scan.bandwidth / limits.bandwidth
        yield f"bandwidth {scan.bandwidth:.4g} Hz is {share:.4g} times its limit {limits.bandwidth:g} Hz"


def rounded_down(value: float, digits: int = 4) -> float:
    """Return a positive number rounded down to significant digits, so that the printed number is within the limit."""
    if not 0.0 < value < math.inf:
        return value
    unit = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return math.floor(value / unit) * unit


def frame_marks(scan: Scan, time: np.ndarray) -> Marks:
    """Return the beginnings of frames within a recording; ``time`` [s] counts from the beginning of the scan."""
    first, last = _whole(time[0] * scan.rate, time[-1] * scan.rate, 1)
    frame = np.arange(first, last)
    nothing = np.full(frame.size, -1)
    return _marks(time, frame / scan.rate, frame, nothing, nothing, np.zeros_like(nothing))


def line_marks(scan: Scan, time: np.ndarray) -> Marks:
    """Return the beginnings of lines within a recording, both of traces and of retraces.

    Parameters
    ----------
    scan : Scan
    time : ndarray, shape (N,)
        Instants of the samples [s], counted from the beginning of the scan, increasing.

    Returns
    -------
    Marks
    """
    begin, _, line, direction = _passes_within(scan, time)
    return _marks(time, begin / scan.rate, _frame(begin), line, np.full(line.size, -1), direction)


def pixel_marks(scan: Scan, time: np.ndarray) -> Marks:
    """Return the beginnings of pixels within a recording; ``time`` [s] counts from the beginning of the scan."""
    begin, duration, line, direction = _passes_within(scan, time)
    number = np.tile(np.arange(scan.pixels), begin.size)
    frames = np.repeat(begin, scan.pixels) + number / scan.pixels * np.repeat(duration, scan.pixels)
    line, direction = np.repeat(line, scan.pixels), np.repeat(direction, scan.pixels)
    pixel = np.where(direction > 0, number, scan.pixels - 1 - number)
    return _marks(time, frames / scan.rate, _frame(frames), line, pixel, direction)


def _frame(frames: np.ndarray) -> np.ndarray:
    return np.floor(frames + ROUNDING).astype(np.int64)


def _whole(first: float, last: float, step: int) -> tuple[int, int]:
    """Return the number of the first period that overlaps an interval, and one plus the number of the last one."""
    return math.floor(first / step), math.floor(last / step) + 1


def _passes_within(scan: Scan, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return begin and duration [frames], line and direction of all passes in the periods that overlap a recording."""
    scan.validated()
    passes, period = scan.passes, scan.frames_per_period
    first, last = _whole(time[0] * scan.rate, time[-1] * scan.rate, period)
    starts = np.arange(first, last) * float(period)
    begin = (starts[:, None] + passes.begin).ravel()
    return begin, *(np.tile(values, starts.size) for values in (passes.duration, passes.line, passes.direction))


def _marks(time: np.ndarray, at: np.ndarray, frame, line, pixel, direction) -> Marks:
    """Return the marks that lie within a recording."""
    near = 1e-9 * (time[-1] - time[0]) / max(time.size - 1, 1)
    inside = (at >= time[0] - near) & (at <= time[-1] + near)
    columns = (values[inside] for values in (frame, line, pixel, direction))
    at = at[inside]
    place = np.interp(at, time, np.arange(float(time.size)))
    return Marks(at, np.ceil(place - EDGE).astype(np.int64), place, *columns)
