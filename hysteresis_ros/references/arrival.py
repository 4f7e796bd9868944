# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""When a move has arrived: the measurement stays near its target for a while."""

from __future__ import annotations

import math


class Arrival:
    """Tells when an error has stayed within a tolerance for a dwell; fed with samples, no clock of its own.

    Parameters
    ----------
    tolerance : float
        Largest error [m].
    dwell : float
        How long the error has to stay within it [s]; 0: one sample is enough.
    """

    def __init__(self, tolerance: float, dwell: float):
        self.tolerance, self.dwell = float(tolerance), float(dwell)
        self.restart()

    def restart(self) -> None:
        """Begin a move: nothing that came before counts."""
        self._since = math.inf

    def take(self, time: float, error: float) -> bool:
        """Take a sample and tell whether the move has arrived.

        Parameters
        ----------
        time : float
            Of the sample, on any clock that goes forward [s].
        error : float
            Measurement minus target [m]; NaN, a missing measurement, is no arrival.
        """
        if not abs(error) <= self.tolerance:
            self._since = math.inf
        else:
            self._since = min(self._since, time)
        return time - self._since >= self.dwell * (1.0 - 1e-9)
