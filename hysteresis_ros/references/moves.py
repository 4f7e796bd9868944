# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Ends of motions: arrival of a move, settling of an axis, outcome of a trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.references.trajectory import HELD, OPEN, REPLACED, STOPPED


class Arrival:
    """Detects, from the times of the samples, that an error has stayed within a tolerance for a dwell time.

    Parameters
    ----------
    tolerance : float
        Largest error [m].
    dwell : float
        Time for which the error must stay within the tolerance [s]; 0: one sample is enough.
    """

    def __init__(self, tolerance: float, dwell: float):
        self.tolerance, self.dwell = float(tolerance), float(dwell)
        self.restart()

    def restart(self) -> None:
        """Begin a move; earlier samples do not count."""
        self._since = math.inf

    def take(self, time: float, error: float) -> bool:
        """Take a sample and return whether the move has arrived.

        Parameters
        ----------
        time : float
            Time of the sample on any monotonic clock [s].
        error : float
            Measurement minus target [m]; NaN: no measurement, so the move has not arrived.
        """
        if not abs(error) <= self.tolerance:
            self._since = math.inf
        else:
            self._since = min(self._since, time)
        return time - self._since >= self.dwell * (1.0 - 1e-9)


@dataclass(frozen=True)
class SettlingParameters(Parameters):
    """Criterion of a settled axis."""

    tolerance: float = parameter(
        0.0,
        description="largest distance of a measurement from the reference; 0: a hundredth of minimum … maximum",
        unit="m",
        low=0.0,
        read_only=True,
    )
    time: float = parameter(
        0.05,
        description="time for which the distance must stay below the tolerance without interruption",
        unit="s",
        low=0.0,
        high=3600.0,
        read_only=True,
    )


class Settling:
    """Determines at each sample whether an axis has settled.

    A sample counts when the measurement is within the tolerance of the reference, and the reference moves by less than
    the tolerance within the time. A sample that does not count (for instance without a measurement) and a new setpoint
    restart the time. So a step has settled when its response has stayed in the band for this time.

    Parameters
    ----------
    tolerance : float
        Half of the band [m], above 0.
    time : float
        Time for which the measurement must stay in the band [s].
    sample_time : float
        Sample time [s].

    Attributes
    ----------
    settled : bool
        Whether the axis was settled at the last sample.
    """

    def __init__(self, tolerance: float, time: float, sample_time: float):
        self._tolerance = tolerance
        self._samples = max(math.ceil(time / sample_time - 1e-9), 1)
        self._step = tolerance / self._samples
        self._setpoint = self._reference = math.nan
        self.restart()

    def restart(self) -> None:
        """Restart the time."""
        self._count = 0
        self.settled = False

    def look(self, setpoint: float, reference: float, measured: float, stopped: bool) -> bool:
        """Take a sample, and return whether the axis has settled.

        Parameters
        ----------
        setpoint, reference : float
            Setpoint and reference of the sample [m].
        measured : float
            Measurement [m]; NaN: none.
        stopped : bool
            Whether the plant has stopped the axis.
        """
        rests = setpoint == self._setpoint and abs(reference - self._reference) < self._step
        within = abs(measured - reference) <= self._tolerance  # false for NaN
        self._setpoint, self._reference = setpoint, reference
        self._count = self._count + 1 if rests and within and not stopped else 0
        self.settled = self._count >= self._samples
        return self.settled


class Ending(Enum):
    """Outcome of a move."""

    ARRIVED = "arrived"
    CANCELLED = "cancelled"
    REPLACED = "replaced"
    STOPPED = "stopped"
    PATH_VIOLATED = "left its path"
    GOAL_MISSED = "did not arrive"


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of a move.

    Parameters
    ----------
    goal : float
        Largest distance from the last point [m].
    dwell : float
        Time for which the measurement must stay within ``goal`` [s].
    goal_time : float
        Time after the last point within which the move must arrive [s].
    path : float
        Largest distance from the reference during the motion [m].
    """

    goal: float
    dwell: float
    goal_time: float
    path: float = math.inf


#: Outcomes of a move that follow from the outcome of its trajectory.
_ENDINGS = {
    REPLACED: (Ending.REPLACED, "another trajectory or a setpoint has taken its place"),
    HELD: (Ending.CANCELLED, "the motion was stopped and the axis keeps its position"),
    STOPPED: (Ending.STOPPED, "the axis, or its reference generator, was stopped or reset"),
}


class Move:
    """Monitors a trajectory in progress.

    Parameters
    ----------
    number : int
        Number of the trajectory, counted by the generator.
    tolerances : Tolerances
    """

    def __init__(self, number: int, tolerances: Tolerances):
        self.number, self.tolerances = number, tolerances
        self._arrival = Arrival(tolerances.goal, tolerances.dwell)
        self._ended = math.nan

    def look(self, time: float, trajectory: tuple[int, int], error: float) -> tuple[Ending, str] | None:
        """Evaluate a sample; return the outcome of the move and the reason as text, None while it continues.

        Parameters
        ----------
        time : float
            Time of the sample [s].
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
