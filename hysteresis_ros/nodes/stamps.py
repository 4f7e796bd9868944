# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Stamps of the samples: on the wall clock, or from zero where the axis is the source of time itself."""

from __future__ import annotations

import time

import numpy as np

#: How far the stamps of a sample may be from the wall clock [ns] before they go on from there.
OFF_CLOCK = 100_000_000


def _wall_clock() -> int | None:
    """Return the time since 1970 [ns]; None where the clock cannot be read."""
    try:
        return time.time_ns()
    except OSError:
        return None


class Stamps:
    """Which sample has which stamp.

    Parameters
    ----------
    parameters : PlantNodeParameters
    """

    def __init__(self, parameters):
        self._rate = parameters.sample_rate
        self._is_source = parameters.publish_clock
        self._stands_for_the_clock = not parameters.publish_clock and parameters.real_time_factor == 1.0
        self._start = 0
        #: Of the last sample that was published [ns].
        self.last = 0

    def _since_start(self, sample: int) -> int:
        return round(sample * 1e9 / self._rate)

    def of(self, sample: int) -> int:
        """Return the stamp of a sample [ns]."""
        return self._start + self._since_start(sample)

    def of_all(self, samples: np.ndarray) -> np.ndarray:
        """Return the stamps [ns] of samples, both of shape (N,)."""
        return self._start + np.rint(samples * 1e9 / self._rate).astype(np.int64)

    def begin(self, origin: int = 0) -> None:
        """Take the time of sample 0 [ns since 1970]."""
        self._start = 0 if self._is_source else origin

    def go_on(self, sample: int) -> None:
        """Let the stamps go on with this sample from now, or from zero where they are the source of time themselves.

        A clock that was set back, or cannot be read, does not take them back: no node accepts an earlier stamp.
        """
        now = max(_wall_clock() or 0, self.last + self._since_start(1))
        self.begin(now - self._since_start(sample))

    @property
    def are_off_clock(self) -> bool:
        """Whether stamps that stand for the wall clock are off it, because it was set; False if it cannot be read."""
        now = _wall_clock() if self._stands_for_the_clock else None
        return now is not None and abs(now - self.last) > OFF_CLOCK + self._since_start(1)
