# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A path from a file: a smooth curve through points; if necessary, a way back to the first point closes the path.

Between the points each coordinate is a cubic spline in time. Its velocity and acceleration are continuous, also
from one frame to the next. A path closes by itself if its last point is the first point or at most two steps away from
it. Any other path needs a way back, which takes a given fraction of the frame. The way back is the polynomial of fifth
degree that continues position and velocity at both ends, with zero acceleration there.
"""

from __future__ import annotations

import csv
import pathlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hysteresis_ros.configuration import parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.references.pieces import Pieces
from hysteresis_ros.references.scan import Passes, Scan, ScanShape
from hysteresis_ros.references.waveforms.file import read_columns

#: Smallest and largest number of points in a file.
LEAST, MOST = 4, 1_000_000
#: A path closes by itself if the distance from its last to its first point is at most this multiple of the path's
#: largest step.
NEAR = 2.0
#: Points that are closer than this fraction of the size count as one.
TOGETHER = 1e-9


@dataclass(frozen=True)
class File(Scan):
    """A path through points.

    A frame is one line that is divided into pixels of equal duration; the way back belongs to no pixel.

    Parameters
    ----------
    frame_rate : float
        Frames per second [Hz]; 0: determined by the times of the file.
    path : str
        CSV with a header that states units (``time [s], x [um], y [um]``), or NPZ with arrays ``time`` [s], ``x`` and
        ``y`` [m].
    sample_rate : float
        Points per second [Hz], for a file without a column ``time``.
    way_back : float
        Fraction of the frame that the way back to the first point takes; 0: the path closes by itself.
    """

    frame_rate: float = parameter(
        0.0, description="frames per second; 0: determined by the times of the file", unit="Hz", low=0.0, high=1e6
    )
    path: str = parameter(description="CSV (time [s], x [um], y [um]) or NPZ with time, x and y", place="files")
    sample_rate: float = parameter(
        0.0, description="points per second, for a file without a column time", unit="Hz", low=0.0, high=1e9
    )
    way_back: float = parameter(
        0.0,
        description="fraction of the frame for the way back to the first point; 0: the path closes by itself",
        low=0.0,
        high=0.9,
    )

    def check(self) -> Iterable[Problem]:
        """Yield a Problem for each inconsistency, also within the file."""
        try:
            self._points  # noqa: B018
        except ParameterError as error:
            yield from error.problems
        else:
            yield from super().check()

    @property
    def rate(self) -> float:
        """Frames per second [Hz]."""
        return self.frame_rate or 1.0 / self._points[0][-1]

    @property
    def frames_per_period(self) -> int:
        """Number of frames after which the path repeats."""
        return 1

    @property
    def size(self) -> float:
        """Longer side of the rectangle around the points [m]."""
        _, points, _ = self._points
        return float(np.max(np.ptp(points, axis=1)))

    @property
    def gap(self) -> float:
        """Distance between neighbouring lines: NaN, because the points of a file do not determine it."""
        return float("nan")

    @cached_property
    def _points(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Instants from the first point to the return to this point [s]; points [m]; end of the data [s].

        The shapes are (N,) and (2, N); the last point is equal to the first one.
        """
        time, points = self._read()
        size = float(np.max(np.ptp(points, axis=1)))
        if not size > 0.0:
            raise self._refused("path", "all points are the same; a path needs two different points")
        if np.max(np.abs(points[:, -1] - points[:, 0])) <= TOGETHER * size:
            points[:, -1] = points[:, 0]
            return time, points, float(time[-1])
        steps = np.hypot(*np.diff(points, axis=1))
        away = float(np.hypot(*(points[:, -1] - points[:, 0])))
        if self.way_back == 0.0:
            if away > NEAR * float(np.max(steps)):
                text = (
                    f"the last point is {away:.4g} m from the first; give way_back, the fraction of the frame "
                    "for the return"
                )
                raise self._refused("way_back", f"{text}, e.g. 0.1")
            time = np.append(time, 2.0 * time[-1] - time[-2])
            return time, np.append(points, points[:, :1], axis=1), float(time[-1])
        # on the way back, the points are as dense as in the file
        end = float(time[-1])
        lasts = end * self.way_back / (1.0 - self.way_back)
        count = max(8, min(MOST, round(lasts / end * (time.size - 1))))
        s = np.arange(1, count + 1) / count
        first, last = points[:, :1], points[:, -1:]
        begin = (points[:, -1:] - points[:, -2:-1]) / (time[-1] - time[-2]) * lasts
        finish = (points[:, 1:2] - first) / (time[1] - time[0]) * lasts
        step = 10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5
        leave = s - 6.0 * s**3 + 8.0 * s**4 - 3.0 * s**5
        arrive = -4.0 * s**3 + 7.0 * s**4 - 3.0 * s**5
        way = last + (first - last) * step + begin * leave + finish * arrive
        way[:, -1] = points[:, 0]
        return np.concatenate([time, end + lasts * s]), np.concatenate([points, way], axis=1), end

    def _read(self) -> tuple[np.ndarray, np.ndarray]:
        source = pathlib.Path(self.path).expanduser()
        if not source.is_file():
            raise self._refused("path", "no such file; give the path of a CSV or NPZ file")
        if source.suffix.lower() not in (".csv", ".npz"):
            raise self._refused("path", "unknown kind of file; allowed: .csv, .npz")
        try:
            time, columns = read_columns(source, ["x", "y"])
        except (KeyError, OSError, ValueError, csv.Error) as error:
            raise self._refused("path", f"cannot be read: {error.args[0] if error.args else error}") from None
        if any(column.ndim != 1 or column.size != columns[0].size for column in columns):
            raise self._refused("path", "x and y must be columns of equal length")
        points = np.array(columns)
        count = points.shape[1]
        if not LEAST <= count <= MOST:
            raise self._refused("path", f"has {count} points, allowed: {LEAST} … {MOST}")
        if time is None:
            if not self.sample_rate > 0.0:
                raise self._refused("sample_rate", "must be > 0 Hz for a file without a column time")
            time = np.arange(count) / self.sample_rate
        elif self.sample_rate > 0.0:
            raise self._refused("sample_rate", "leave it out: the file has a column time")
        for name, values in zip(("time", "x", "y"), (time, *points), strict=True):
            for row in np.flatnonzero(~np.isfinite(values))[:1]:
                raise self._refused("path", f"{name} of point {row} is {values[row]}; all must be finite")
        for row in np.flatnonzero(np.diff(time) <= 0.0)[:1]:
            raise self._refused("path", f"time of point {row + 1} must be later than that of point {row}")
        return time - time[0], points

    def _refused(self, name: str, text: str) -> ParameterError:
        return ParameterError([Problem(name, getattr(self, name), text)])

    @cached_property
    def _spline(self) -> Pieces:
        from scipy.interpolate import CubicSpline

        time, points, _ = self._points
        frames = time / time[-1]
        # coefficients with the highest power first, shape (4, P, 2)
        spline = CubicSpline(frames, points, axis=1, bc_type="periodic")
        return Pieces(frames, np.ascontiguousarray(np.moveaxis(spline.c[::-1], 0, 1)))

    def plane(self, frames: np.ndarray, order: int = 0) -> np.ndarray:
        """Return u and v, or a derivative of them with respect to the number of frames, shape (2, N) [m].

        Parameters
        ----------
        frames : ndarray, shape (N,)
        order : int, optional
        """
        return self._spline(frames, order)

    def plane_range(self, matrix: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the extremes of combinations of u and v, or of their derivatives, shapes (A,).

        Parameters
        ----------
        matrix : ndarray, shape (A, 2)
        order : int
        """
        return self._spline.range(matrix, order)

    @cached_property
    def passes(self) -> Passes:
        """The only pass of a period: the points of the file."""
        time, _, end = self._points
        return Passes(np.zeros(1), np.array([end / time[-1]]), np.zeros(1, dtype=np.int64), np.ones(1, dtype=np.int64))


SCAN = ScanShape("file", File, "a path from a CSV or NPZ file")
