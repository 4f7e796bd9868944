# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""How regularly a fused loop makes its samples, in the words that diagnostics have for it."""

from __future__ import annotations

import time

from hysteresis_ros.nodes.timing import CountedRate


class LoopPace:
    """Rate, jitter and misses of the loop, in the words of :class:`hysteresis_ros.nodes.timing.Pace`.

    Parameters
    ----------
    fused : FusedAxis
    """

    def __init__(self, fused):
        self._fused = fused
        self._last = 0.0
        self._rate = CountedRate()

    @property
    def total(self) -> int:
        """Samples so far."""
        loop = self._fused.loop
        return loop.sample if loop is not None else 0

    @property
    def overruns(self) -> int:
        """Samples so far that were skipped."""
        loop = self._fused.loop
        return loop.missed if loop is not None else 0

    @property
    def age(self) -> float:
        """Seconds since samples were last seen; infinite before the first."""
        return time.monotonic() - self._last if self._last else float("inf")

    def tick(self) -> None:
        """Note that there are new samples."""
        self._last = time.monotonic()

    def restart(self) -> None:
        """Forget the last samples, so that a pause is not taken for a rate."""
        self._rate.restart()
        self._rate.begin(time.monotonic(), self.total)

    def read(self) -> tuple[float, float]:
        """Return the rate of the last second [Hz] and the lateness that 99 % of all samples do not exceed [s]."""
        rate = self._rate.read(time.monotonic(), self.total)
        loop = self._fused.loop
        return rate, loop.lateness().p99 if loop is not None else 0.0
