# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the fused loop has made, for others: rows, times and lateness of its samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.loop import pacing as at
from hysteresis_ros.loop.pacing import LEAST, RESOLUTION, Pace


class Samples(NamedTuple):
    """Samples that follow one another.

    Parameters
    ----------
    first : int
        Number of the first one, counted from the beginning of the axis.
    table : ndarray, shape (row length, N)
        A column for each sample, a row for each signal, see :func:`hysteresis_ros.signals.row_signals`.
    times : ndarray, shape (N,)
        When each was begun [ns since 1970], whole numbers.
    joints : ndarray or None, shape (JOINT_NUMBERS, N)
        Of a motor: positions [m], velocities [m/s] and efforts [N] of its joints.
    lost : int
        Samples before the first one that were overwritten before anybody took them.
    """

    first: int
    table: np.ndarray
    times: np.ndarray
    joints: np.ndarray | None
    lost: int


class Lateness(NamedTuple):
    """How late samples began, skipped ones included, and what they took.

    Parameters
    ----------
    p50, p99, p999, max : float
        So late [s] at most began 50, 99, 99.9 and 100 % of the samples; the first three to 2 %.
    missed : int
        Samples that were skipped.
    samples : int
        All of them.
    cost, highest_cost : float
        Time that a sample took beyond waiting [s]: the mean, and the longest.
    """

    p50: float
    p99: float
    p999: float
    max: float
    missed: int
    samples: int
    cost: float
    highest_cost: float


class Reader:
    """Takes samples out of the ring, each once; it begins with the next one.

    Parameters
    ----------
    own : Pace
        Arrays of the loop.
    offset : callable
        ``offset()`` returns what to add to the loop's clock for the time since 1970 [ns].
    """

    def __init__(self, own: Pace, offset):
        self._own = own
        self._offset = offset
        self._next = int(own.state[at.HEAD])

    def take(self) -> Samples:
        """Return all samples since the last time, none when there are none."""
        state, rows = self._own.state, self._own.rows
        size = len(rows)
        head = int(state[at.HEAD])
        first = max(self._next, head - size)
        places = np.arange(first, head) % size
        table, times = np.ascontiguousarray(rows[places].T), self._own.times[places] + self._offset()
        joints = np.ascontiguousarray(self._own.joints[places].T) if self._own.joints.shape[1] else None
        # what was overwritten while it was copied; of the next sample a part may stand in the ring already
        whole = min(max(first, int(state[at.HEAD]) + 1 - size), head)
        lost, self._next = whole - self._next, head
        begin = int(state[at.FIRST])
        if whole > first:
            table, times = np.ascontiguousarray(table[:, whole - first :]), times[whole - first :]
            joints = None if joints is None else np.ascontiguousarray(joints[:, whole - first :])
        return Samples(begin + whole, table, times, joints, lost)


def latest(own: Pace) -> tuple[int, np.ndarray]:
    """Return number and row of the last sample, -1 and NaN before the first one."""
    state, rows = own.state, own.rows
    while True:
        head = int(state[at.HEAD])
        row = rows[(head - 1) % len(rows)].copy()
        if int(state[at.HEAD]) - head < len(rows) - 1:
            return (int(state[at.FIRST]) + head - 1 if head else -1), row


def quantile(histogram: np.ndarray, part: float) -> float:
    """Return the lateness [s] that a part of the samples does not exceed, to 2 %."""
    counts = np.cumsum(histogram)
    if not counts[-1]:
        return 0.0
    index = int(np.searchsorted(counts, part * counts[-1]))
    return LEAST * elementary.exp(max(index - 0.5, 0.0) / RESOLUTION) * 1e-9


def lateness(own: Pace) -> Lateness:
    """Return the figures of all samples so far."""
    state, histogram = own.state, own.histogram.copy()
    largest, samples = float(state[at.LATEST]) * 1e-9, int(state[at.HEAD])
    found = [min(quantile(histogram, part), largest) for part in (0.5, 0.99, 0.999)]
    cost, highest = float(state[at.BUSY]) * 1e-9 / max(samples, 1), float(state[at.BUSIEST]) * 1e-9
    return Lateness(*found, largest, int(state[at.MISSED]), samples, cost, highest)
