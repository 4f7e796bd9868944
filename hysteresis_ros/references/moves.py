# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A move that somebody waits for: a trajectory that is followed, and how it went."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from hysteresis_ros.references.arrival import Arrival
from hysteresis_ros.references.trajectory import HELD, OPEN, REPLACED, STOPPED


class Ending(Enum):
    """How a move has ended."""

    ARRIVED = "arrived"
    CANCELLED = "cancelled"
    REPLACED = "replaced"
    STOPPED = "stopped"
    PATH_VIOLATED = "left its path"
    GOAL_MISSED = "did not arrive"


@dataclass(frozen=True)
class Tolerances:
    """When a move is well done.

    Parameters
    ----------
    goal : float
        Largest distance from the last point [m].
    dwell : float
        How long it stays there [s].
    goal_time : float
        Time after the last point within which it has to arrive [s].
    path : float
        Largest distance from the reference on the way [m].
    """

    goal: float
    dwell: float
    goal_time: float
    path: float = math.inf


#: Endings that follow from how the trajectory itself has ended.
_ENDINGS = {
    REPLACED: (Ending.REPLACED, "another trajectory or a setpoint has taken its place"),
    HELD: (Ending.CANCELLED, "held where it was"),
    STOPPED: (Ending.STOPPED, "the axis, or its source, was stopped or reset"),
}


class Move:
    """A trajectory on its way.

    Parameters
    ----------
    number : int
        Of the trajectory, as the generator counts them.
    tolerances : Tolerances
    """

    def __init__(self, number: int, tolerances: Tolerances):
        self.number, self.tolerances = number, tolerances
        self._arrival = Arrival(tolerances.goal, tolerances.dwell)
        self._ended = math.nan

    def look(self, time: float, trajectory: tuple[int, int], error: float) -> tuple[Ending, str] | None:
        """Look at a sample; return how the move has ended, and in words why, None while it goes on.

        Parameters
        ----------
        time : float
            Of the sample [s].
        trajectory : tuple of int
            Number and outcome of the generator's last trajectory.
        error : float
            Measurement minus reference [m]; NaN: no measurement.
        """
        number, outcome = trajectory
        if number != self.number:
            return _ENDINGS[REPLACED]
        if outcome in _ENDINGS:
            return _ENDINGS[outcome]
        own = self.tolerances
        if outcome == OPEN:
            if abs(error) > own.path:
                return Ending.PATH_VIOLATED, f"{error:.6g} m from the reference, allowed: {own.path:g} m"
            return None
        if not self._ended <= time:
            self._ended = time
        if self._arrival.take(time, error):
            return Ending.ARRIVED, f"{error:.6g} m from the last point, {time - self._ended:.3g} s after it"
        if time - self._ended > own.goal_time + own.dwell:
            text = f"{error:.6g} m from the last point {time - self._ended:.3g} s after it, allowed: {own.goal:g} m"
            return Ending.GOAL_MISSED, text
        return None
