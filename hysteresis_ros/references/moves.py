# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Moves and how they end: when a move has arrived, when an axis has settled, how a trajectory went."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.references.trajectory import HELD, OPEN, REPLACED, STOPPED


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


@dataclass(frozen=True)
class SettlingParameters(Parameters):
    """When an axis is called settled."""

    tolerance: float = parameter(
        0.0,
        description="largest distance of a measurement from the reference; 0: a hundredth of minimum … maximum",
        unit="m",
        low=0.0,
        read_only=True,
    )
    time: float = parameter(
        0.05, description="for so long without a break", unit="s", low=0.0, high=3600.0, read_only=True
    )


class Settling:
    """Tells sample by sample whether an axis has settled.

    A sample counts when the measurement is within the tolerance of the reference, and the reference moves by less than
    the tolerance within the time. One that does not count, also because nothing was measured, and another setpoint
    begin the time anew: a step has settled when its response has stayed in the band for that time.

    Parameters
    ----------
    tolerance : float
        Half of the band [m], above 0.
    time : float
        How long it has to stay in it [s].
    sample_time : float
        Sample time [s].

    Attributes
    ----------
    settled : bool
        What the last sample said.
    """

    def __init__(self, tolerance: float, time: float, sample_time: float):
        self._tolerance = tolerance
        self._samples = max(math.ceil(time / sample_time - 1e-9), 1)
        self._step = tolerance / self._samples
        self._setpoint = self._reference = math.nan
        self.restart()

    def restart(self) -> None:
        """Begin the time anew."""
        self._count = 0
        self.settled = False

    def look(self, setpoint: float, reference: float, measured: float, stopped: bool) -> bool:
        """Take a sample, and return whether the axis has settled.

        Parameters
        ----------
        setpoint, reference : float
            Of the sample [m].
        measured : float
            [m], NaN: nothing was.
        stopped : bool
            Whether the plant has stopped the axis.
        """
        rests = setpoint == self._setpoint and abs(reference - self._reference) < self._step
        within = abs(measured - reference) <= self._tolerance  # not so with NaN
        self._setpoint, self._reference = setpoint, reference
        self._count = self._count + 1 if rests and within and not stopped else 0
        self.settled = self._count >= self._samples
        return self.settled


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
