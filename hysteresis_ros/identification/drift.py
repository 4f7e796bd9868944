# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Drift and creep: a straight line in time, and how much of this line could be creep.

A drift is independent of the voltage. Creep with time constants longer than the recording is almost a straight line
too, because the mean voltage of a recording differs from its first voltage. The line in the residual is therefore
fitted together with slow relaxations of the modelled displacement. Each relaxation may be as large as in known
materials (:data:`CREEP`). Creep that the recording cannot distinguish from a drift thus increases the standard
deviation of the drift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hysteresis_ros.identification.data import loops_resemble_drift
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.thresholds import DRIFT, DRIFT_OF_CHANGING_LOOPS, Threshold
from hysteresis_ros.identification.validation import inflation

#: Time constants of the relaxations, as fractions of the duration of the recording.
SLOW = (0.1, 0.3, 1.0, 3.0, 10.0)
#: The residual may contain relaxations that the fitted creep does not describe. Assumed standard deviation of the
#: amplitude of each of them, as a fraction of a step. With this spacing of the time constants, relaxations of 0.01
#: correspond to creep of 2 % per decade.
CREEP = 0.01
#: Number of held-out blocks for the test of a drift.
BLOCKS = 5
#: A drift is significant if it exceeds this multiple of its standard deviation.
CERTAIN = 2.0


class Drift(NamedTuple):
    """A straight line in the residual of a fit."""

    value: float  #: [m/s]
    deviation: float  #: Standard deviation [m/s], including creep that the recording does not distinguish from a drift.

    @property
    def certain(self) -> bool:
        """Whether the drift is larger than its uncertainty from noise and unmodelled creep."""
        return abs(self.value) > CERTAIN * self.deviation


def drift_beside_creep(data, moved, residual, settled: bool) -> Drift:
    """Return the straight line in a residual, shape (n,), from a fit that includes slow relaxations.

    ``data`` is condensed; ``moved`` is the modelled displacement without constants, shape (N,), which relaxes. Units:
    ``moved`` [m], ``residual`` [m].
    """
    duration = len(moved) * data.sample_time
    relaxed = [LinearPart(lag=part * duration, settled=settled).apply(moved, data.sample_time) for part in SLOW]
    line = np.linspace(0.0, duration, len(moved))
    table = data.counted(np.column_stack([line, np.ones(len(moved)), moved, *relaxed]))
    expected = np.append(np.zeros(3), np.full(len(SLOW), CREEP**-2))
    left = residual - table @ np.linalg.lstsq(table, residual, rcond=1e-9)[0]
    variance = inflation(left) * float(np.var(left))
    size = np.linalg.norm(table, axis=0)
    size[size == 0.0] = 1.0
    covariance = np.linalg.pinv(table.T @ table / np.outer(size, size) + np.diag(variance * expected / size**2))
    found = covariance @ (table.T @ residual / size) / size
    return Drift(float(found[0]), float(np.sqrt(variance * covariance[0, 0]) / size[0]))


def drift_threshold(voltage) -> Threshold:
    """Return the improvement on held-out blocks that a drift needs under this voltage [V], shape (N,)."""
    return DRIFT_OF_CHANGING_LOOPS if loops_resemble_drift(voltage) else DRIFT


def drift_of(error, kept, threshold: Threshold = DRIFT) -> float:
    """Return the drift per sample of an error, shape (N,); 0 if a drift does not help to predict held-out blocks."""
    place = kept / len(error)
    line = np.column_stack([np.ones(len(kept)), place])
    left = {1: 0.0, 2: 0.0}
    for block in np.array_split(np.arange(len(kept)), BLOCKS):
        others = np.delete(np.arange(len(kept)), block)
        for columns in left:
            found = np.linalg.lstsq(line[others, :columns], error[kept][others], rcond=None)[0]
            left[columns] += float(np.sum((error[kept][block] - line[block, :columns] @ found) ** 2))
    if not left[2] < threshold.bound(1.0) ** 2 * left[1]:
        return 0.0
    return float(np.linalg.lstsq(line, error[kept], rcond=None)[0][1]) / len(error)
