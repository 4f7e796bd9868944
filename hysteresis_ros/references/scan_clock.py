# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The clock of a scan in a loop: which frames, lines and pixels begin at which sample of the scan's waveform.

A period of a path in samples is a fraction of whole numbers, so that the position of each sample within the period is
exact for any number of samples. An edge between two samples belongs to the later one.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.references.scan import EDGE, Marks, Scan, frame_marks, line_marks, pixel_marks
from hysteresis_ros.signals import Edge

#: Largest number of periods that together make a whole number of samples.
MOST_PERIODS = 1000
#: Largest distance by which the sample that counts as the end of a path may precede this end [samples].
WHOLE = 1e-6
#: Levels of a clock; each level includes the coarser ones.
LEVELS = ("none", "frame", "line", "pixel")
_MARKS = {Edge.FRAME: frame_marks, Edge.LINE: line_marks, Edge.PIXEL: pixel_marks}


def samples_of_period(period: float, sample_time: float) -> Fraction:
    """Return the period of a path in samples, as the nearest fraction with a denominator of at most 1000.

    Units: ``period``, ``sample_time`` [s].
    """
    return Fraction(period / sample_time).limit_denominator(MOST_PERIODS)


def end_of(periods: int, period: float, sample_time: float) -> int:
    """Return the first sample after a number of periods of a path; 0 if the path has no end.

    Units: ``period``, ``sample_time`` [s].
    """
    return math.ceil(periods * period / sample_time - WHOLE)


class ScanClock:
    """Edges of a scan that runs in a loop: the samples at which its frames, lines and pixels begin.

    Parameters
    ----------
    scan : Scan
    sample_time : float
        [s]
    level : str
        Finest of ``frame``, ``line`` and ``pixel``; coarser levels are included. With ``none`` there are no edges.
    periods : int, optional
        Number of periods of the path, after which nothing begins; 0: without end.

    Attributes
    ----------
    sample_time : float
        [s]

    Raises
    ------
    ParameterError
        There is no such level, or the scan is invalid.

    Examples
    --------
    >>> from hysteresis_ros.references.scan_clock import ScanClock
    >>> from hysteresis_ros.references.scans import scan_of
    >>> scan = scan_of("raster", dict(width=2e-6, depth=2e-6, lines=4, line_rate=50.0))
    >>> found = ScanClock(scan, 1e-3, "line").between(-1, 39)
    >>> found.sample.tolist(), found.line.tolist(), found.direction.tolist()
    ([0, 0, 10, 20, 30], [-1, 0, 0, 1, 1], [0, 1, -1, 1, -1])
    """

    def __init__(self, scan: Scan, sample_time: float, level: str, periods: int = 0):
        if level not in LEVELS:
            raise ParameterError([Problem("clock", level, f"must be one of {', '.join(LEVELS)}")])
        scan.validated()
        self.sample_time = sample_time
        self._period = samples_of_period(scan.period, sample_time)
        self._frames = scan.frames_per_period
        self._end = end_of(periods, scan.period, sample_time)
        #: Frame, line, pixel and direction of all marks of a period, shape (M, 4), and the positions of the marks
        #: [samples].
        self._rows, self._places = np.zeros((0, 4), dtype=np.int64), np.zeros(0)
        self._of_level: dict[Edge, np.ndarray] = {}
        # the marks of the period itself; the last instant belongs to the next period
        span = np.array([0.0, scan.period])
        for edge in tuple(Edge)[: LEVELS.index(level)]:
            marks = _MARKS[edge](scan, span)
            inside = marks.time < scan.period * (1.0 - 1e-12)
            places = self._of_level[edge] = marks.time[inside] / sample_time
            rows = np.column_stack([marks.frame, marks.line, marks.pixel, marks.direction])[inside]
            self._rows, self._places = np.vstack([self._rows, rows]), np.concatenate([self._places, places])
        # in order of time; at the same instant, a frame begins before its line, and a line before its pixel
        order = np.argsort(self._places, kind="stable")
        self._rows, self._places = self._rows[order], self._places[order]

    def _counts(self, samples: ArrayLike, places: np.ndarray, end: int) -> np.ndarray:
        """Return how many of the marks at ``places`` in each period have begun up to each of the ``samples``.

        From sample ``end`` on, nothing begins; 0: there is no end.
        """
        k = np.asarray(samples, dtype=np.int64)
        if end:
            k = np.minimum(k, end - 1)
        numerator, denominator = self._period.numerator, self._period.denominator
        repeated, rest = np.divmod(k, numerator)
        period, place = np.divmod(rest * denominator, numerator)
        begun = np.searchsorted(places, place / denominator + EDGE, "right")
        return np.where(k < 0, 0, (repeated * denominator + period) * places.size + begun)

    def _marks(self, first: int, last: int) -> Marks:
        """Return the marks with the numbers ``first`` … ``last`` - 1, counted from the beginning of the waveform."""
        period, index = np.divmod(np.arange(first, last), max(self._places.size, 1))
        whole, part = np.divmod(period * self._period.numerator, self._period.denominator)
        begun = part / self._period.denominator + self._places[index]
        frame, line, pixel, direction = self._rows[index].T
        place = whole + begun
        sample = whole + np.ceil(begun - EDGE).astype(np.int64)
        return Marks(place * self.sample_time, sample, place, frame + period * self._frames, line, pixel, direction)

    def between(self, after: int, until: int) -> Marks:
        """Return the edges after one sample of the waveform, up to and including another sample.

        Parameters
        ----------
        after, until : int
            Numbers of samples, counted from the beginning of the waveform; -1: before the beginning.

        Returns
        -------
        Marks
            In order of time; ``sample`` and ``place`` count samples, and ``time`` seconds, from the beginning of the
            waveform.
        """
        return self._marks(*map(int, self._counts([after, until], self._places, self._end)))

    def next_after(self, sample: int) -> float:
        """Return the first sample after ``sample`` at which something begins; infinite if there is no such sample.

        Parameters
        ----------
        sample : int
        """
        if not self._places.size:
            return math.inf
        number = int(self._counts(sample, self._places, self._end))
        found = int(self._marks(number, number + 1).sample[0])
        return math.inf if self._end and found >= self._end else found

    def of_level(self, edge: Edge) -> np.ndarray:
        """Return the positions [samples] of a level's edges in a period, and of the first edge in the next period.

        Parameters
        ----------
        edge : Edge
        """
        places = self._of_level[edge]
        return np.append(places, places[0] + float(self._period))

    def delays(self, edge: Edge) -> np.ndarray:
        """Return the time from the exact edge to each sample [s], for the loop; shape (N,).

        Parameters
        ----------
        edge : Edge
            Level. N is the same as for :meth:`edges`; the time is 0 for samples at which nothing begins.
        """
        samples, periods = self._period.numerator, self._period.denominator
        starts = [Fraction(number * samples, periods) for number in range(periods)]
        begun = np.concatenate([float(start) % 1.0 + self._of_level[edge] for start in starts])
        whole = np.concatenate([np.full(self._of_level[edge].size, math.floor(start)) for start in starts])
        at = np.ceil(begun - EDGE)
        found = np.zeros(samples)
        inside = whole + at < samples
        found[(whole + at)[inside].astype(np.int64)] = np.maximum(at - begun, 0.0)[inside] * self.sample_time
        return found

    def edges(self) -> np.ndarray:
        """Return the :class:`~hysteresis_ros.signals.Edge` bits of each sample, for the loop; shape (N,).

        N is the number of samples after which the path repeats: sample k has the bits of sample k mod N. The bits do
        not mark the end of the scan.
        """
        samples = np.arange(-1, self._period.numerator)
        found = np.zeros(samples.size - 1)
        for edge, places in self._of_level.items():
            found += edge * (np.diff(self._counts(samples, places, end=0)) > 0)
        return found
