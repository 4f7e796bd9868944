# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""History of signals for a page: the last minute, reduced to the columns of the screen.

At kilohertz, one column of the screen covers many samples. It shows their minimum and maximum, in the order in which
they occurred, so no peak is lost however short it is.
"""

from __future__ import annotations

import numpy as np
from scipy import signal

#: Maximum number of stored samples: one minute at 20 kHz, less at higher rates.
MOST_SAMPLES = 1_200_000
#: Spectrum: largest and smallest segment length [samples], and number of segments.
LONGEST, SHORTEST, SEGMENTS = 16384, 64, 4
#: Maximum number of points of a spectrum, logarithmically spaced in frequency.
POINTS = 320


class History:
    """The last samples of some signals."""

    def __init__(self, rows: int, samples: int):
        self._keeps = int(min(samples, MOST_SAMPLES))
        self._table = np.empty((rows, 2 * self._keeps))
        self._filled = 0
        self.end = 0

    @property
    def begin(self) -> int:
        """Number of the oldest sample that is kept."""
        return self.end - min(self._filled, self._keeps)

    def append(self, table: np.ndarray) -> None:
        """Append samples."""
        self.end += table.shape[1]
        table = table[:, -self._keeps :]
        if self._filled + table.shape[1] > self._table.shape[1]:
            kept = self._keeps - table.shape[1]
            self._table[:, :kept] = self._table[:, self._filled - kept : self._filled]
            self._filled = kept
        self._table[:, self._filled : self._filled + table.shape[1]] = table
        self._filled += table.shape[1]

    def part(self, first: int, last: int) -> np.ndarray:
        """Return samples, shape (rows, last − first), as a view."""
        behind = self.end - self._filled
        return self._table[:, first - behind : last - behind]


def places_of_extremes(table: np.ndarray, length: int) -> np.ndarray:
    """Return the indices of the minimum and the maximum in each bin, in the order in which they occurred."""
    rows = table.shape[0]
    bins = table.reshape(rows, -1, length)
    missing = np.isnan(bins)
    low = np.where(missing, np.inf, bins).argmin(axis=2)
    high = np.where(missing, -np.inf, bins).argmax(axis=2)
    begins = length * np.arange(bins.shape[1])
    return np.sort(np.stack([low, high], axis=2), axis=2) + begins[:, None]


def extremes(table: np.ndarray, length: int) -> np.ndarray:
    """Return the minimum and the maximum of each bin, in the order in which they occurred, shape (rows, bins, 2)."""
    places = places_of_extremes(table, length)
    return np.take_along_axis(table, places.reshape(len(table), -1), axis=1).reshape(places.shape)


def outline(table: np.ndarray, length: int) -> np.ndarray:
    """Return the points of a curve of several signals at which one of them has its minimum or maximum in a bin."""
    rows = len(table)
    if length <= 2 * rows:
        return table
    places = places_of_extremes(table, length)
    return table[:, np.sort(np.concatenate(list(places), axis=1), axis=1).ravel()]


def amplitude_density(values: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies [Hz] and amplitude density of a signal by Welch's method, thinned without losing a peak.

    ``rate`` is the sample rate [Hz].
    """
    segment = min(LONGEST, 2 ** int(np.log2(max(values.size // SEGMENTS, 1))))
    known = np.isfinite(values)
    if segment < SHORTEST or not known.any():
        return np.empty(0), np.empty(0)
    filled = np.where(known, values, values[known].mean())
    frequency, power = signal.welch(filled, rate, nperseg=segment)
    frequency, density = frequency[1:], np.sqrt(power[1:])
    edges = np.geomspace(frequency[0], frequency[-1] * (1.0 + 1e-9), POINTS + 1)
    begins = np.unique(np.searchsorted(frequency, edges[:-1]))
    return frequency[begins], np.maximum.reduceat(density, begins)
