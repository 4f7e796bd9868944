# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Ends of motions: arrival of a move, settling of an axis, readiness within a tolerance, outcome of a trajectory."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum
from statistics import NormalDist

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.references.trajectory import HELD, OPEN, REPLACED, STOPPED


class Arrival:
    """Detector of an arrival: the error has stayed within a tolerance for a dwell time, by the samples' time stamps.

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
        """Take a sample and return whether the axis has arrived.

        Parameters
        ----------
        time : float
            Time of the sample on any monotonic clock [s].
        error : float
            Measurement minus target [m]; NaN: there is no measurement, so the axis has not arrived.
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
        description="time for which the distance must stay within the tolerance without interruption",
        unit="s",
        low=0.0,
        high=3600.0,
        read_only=True,
    )


class Settling:
    """Detector of a settled axis, evaluated at each sample.

    A sample counts if the measurement is within the tolerance of the reference, and if the reference moves by less than
    the tolerance within ``time``. A sample that does not count (for example, one without a measurement) restarts
    ``time``, and so does a new setpoint. Therefore a step has settled when its response has stayed in the band for
    ``time``.

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
        """Restart the time for which the measurement must stay in the band."""
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


@dataclass(frozen=True)
class ReadyParameters(Parameters):
    """Criterion of a ready move: its displacement stays within a tolerance of the setpoint."""

    tolerance: float = parameter(
        0.0,
        description="largest distance of the displacement from the setpoint; 0: only moves of `~/move` are predicted",
        unit="m",
        low=0.0,
        high=1.0,
    )
    dwell: float = parameter(
        0.005,
        description="time for which the displacement must stay within the tolerance without interruption",
        unit="s",
        low=0.0,
        high=3600.0,
    )
    deadband: float = parameter(
        0.0,
        description="a move to a setpoint within this distance of the present one does not move the axis (SPDB of "
        "EPICS); 0: every move does",
        unit="m",
        low=0.0,
        high=1.0,
    )


#: Of normally distributed values, 99 % are within this number of standard deviations of their mean.
BOTH_SIDES = 2.576
#: Of normally distributed values, 99 % are less than this number of standard deviations above their mean.
ONE_SIDE = 2.326


@dataclass(frozen=True)
class Noise:
    """Noise of an axis that is at rest in closed loop.

    Parameters
    ----------
    sensor : float
        Standard deviation of the noise of a measurement [m].
    displacement : float
        Standard deviation of the displacement [m], caused by the sensor noise that the loop feeds back.
    """

    sensor: float
    displacement: float

    @property
    def least_tolerance(self) -> float:
        """Smallest tolerance: distance from the setpoint that the displacement exceeds during 1 % of the time [m]."""
        return BOTH_SIDES * self.displacement


class NoiseMeter:
    """Meter for the noise of an axis, from the samples at which the reference has been constant for the time ``rest``.

    The second difference of white noise has six times the variance of the noise, and the second difference of a slow
    motion is small. The variance of the error is the sum of the variances of the sensor's noise and of the
    displacement, because noise does not move the axis within the same sample. In each block of samples, the variance is
    taken around a straight line, so that a slow drift does not count as noise. The end of a response does not count
    either: if a block has much less variance than the previous blocks while the reference rests, the new block replaces
    the previous ones.

    Parameters
    ----------
    rest : float
        Time for which the reference must be constant [s]; it must also be constant for :data:`SETTLED` samples.
    sample_time : float
        Sample time [s].
    """

    #: Smallest number of samples for an estimate, and largest number of samples that an estimate averages.
    FEWEST, AVERAGED = 100, 10_000
    #: Smallest number of samples for which the reference must be constant; smallest number of samples in a block; and
    #: smallest factor by which the variance must fall if a block is to replace the previous ones.
    SETTLED, BLOCK, LESS = 200, 256, 4.0

    def __init__(self, rest: float, sample_time: float):
        self._rest = max(round(rest / sample_time), self.SETTLED)
        self._length = max(round(rest / sample_time), self.BLOCK)
        self._last = np.full((2, 2), math.nan)
        self._still = self.count = 0
        self._differences = 0.0
        # number of samples and variance of the error: before the reference came to its present rest, and since then
        self._before, self._present = (0, 0.0), (0, 0.0)

    def take(self, reference, measured) -> None:
        """Take consecutive samples: references and measurements [m], shape (N,); NaN: no measurement."""
        for first in range(0, len(reference), self._length):
            block = slice(first, first + self._length)
            self._take(reference[block], measured[block])

    def _take(self, reference, measured) -> None:
        given = np.concatenate([self._last, np.array([reference, measured], dtype=float)], axis=1)
        self._last = given[:, -2:]
        places = np.arange(given.shape[1] - 2)
        moved = np.where(np.diff(given[0])[1:] != 0.0, places, -1 - self._still)
        still = places - np.maximum.accumulate(moved)
        self._still = int(still[-1])
        differences, errors = np.diff(given[1], 2), (given[1] - given[0])[2:]
        used = (still >= self._rest) & np.isfinite(differences)
        count = int(np.sum(used))
        if count >= 3:
            self.count = min(self.count + count, self.AVERAGED)
            squares = float(np.mean(differences[used] ** 2))
            self._differences += min(count / self.count, 1.0) * (squares - self._differences)
            line = places[used] - np.mean(places[used])
            around = errors[used] - np.mean(errors[used])
            around -= line * (line @ around / (line @ line))
            block = count, float(around @ around) / (count - 2)
            replaces = count >= self._length // 2 and self.LESS * block[1] < self._present[1]
            self._present = block if replaces else self._together(self._present, block)
        if np.any(moved >= 0):
            self._before, self._present = self._together(self._before, self._present), (0, 0.0)

    def _together(self, one, other) -> tuple[int, float]:
        """Return number of samples (at most :data:`AVERAGED`) and mean variance of two sets of samples."""
        count = one[0] + other[0]
        mean = (one[0] * one[1] + other[0] * other[1]) / count if count else 0.0
        return min(count, self.AVERAGED), mean

    @property
    def sensor(self) -> float:
        """Standard deviation of the noise of a measurement [m]; NaN: not measured yet."""
        return math.sqrt(self._differences / 6.0) if self.count >= self.FEWEST else math.nan

    def noise(self, displacement: float = 0.0, error: float = 1.0) -> Noise:
        """Return the axis' noise; variance that the loop's model does not explain counts as motion (vibration, hum).

        Parameters
        ----------
        displacement, error : float, optional
            Standard deviations of the displacement and of the measured error, according to the model of the loop, for a
            sensor noise of one metre [m]; by default, those of a loop that does not react to noise.
        """
        sensor = self.sensor
        variance = self._together(self._before, self._present)[1]
        unexplained = max(variance - (sensor * error) ** 2, 0.0)
        return Noise(sensor, math.sqrt((sensor * displacement) ** 2 + unexplained))


class Readiness:
    """Detector of the time since which the displacement has stayed within a tolerance of a setpoint, in spite of noise.

    The error is averaged over as many samples as the noise requires. The margin within the tolerance is chosen for the
    noise of the displacement, so that the displacement is outside the tolerance during less than 1 % of the time.
    Missing measurements are not part of the mean; if they last longer than the dwell time, the displacement is unknown.

    Parameters
    ----------
    tolerance : float
        Largest distance of the displacement from the setpoint [m].
    dwell : float
        Time for which the displacement must stay within the tolerance [s].
    noise : Noise
        Noise of the axis at rest.
    sample_time : float
        Sample time [s].

    Attributes
    ----------
    ready : bool
        Whether the axis is ready.
    since : float
        Time from the first sample of the move to the instant since which the displacement has stayed within the
        tolerance [s]; NaN: not yet.
    """

    #: Smallest margin, as a fraction of the tolerance; accepted probability that noise alone interrupts the dwell time.
    MARGIN, INTERRUPTED = 0.25, 0.01
    #: Largest number of averaged samples.
    LONGEST = 10_000

    def __init__(self, tolerance: float, dwell: float, noise: Noise, sample_time: float):
        self.tolerance, self._sample_time = tolerance, sample_time
        self._inner = max(tolerance - ONE_SIDE * noise.displacement, self.MARGIN * tolerance)
        self._dwell = math.ceil(dwell / sample_time - 1e-9)
        # number of standard errors of the mean that must fit into the margin
        certainty = NormalDist().inv_cdf(1.0 - 0.5 * self.INTERRUPTED / max(self._dwell, 1))
        averaged = math.ceil((certainty * noise.sensor / self._inner) ** 2) if noise.sensor > 0.0 else 1
        self.averaged = min(max(averaged, 1), self.LONGEST)
        self._gap = max(self._dwell, self.averaged)
        self.restart()

    def restart(self) -> None:
        """Begin a move."""
        self._window: deque[float] = deque()
        self._sum = 0.0
        self._sample = -1
        self._missing = 0
        # numbers of the samples since which the mean has been within the tolerance, and within the inner limit
        self._entered = self._inside = math.nan
        self.ready, self.since = False, math.nan

    def look(self, setpoint: float, measured: float) -> bool:
        """Take a sample, and return whether the axis is ready.

        Parameters
        ----------
        setpoint : float
            Setpoint of the move [m].
        measured : float
            Measurement [m]; NaN: none.
        """
        self._sample += 1
        error, window = measured - setpoint, self._window
        if math.isfinite(error):
            self._missing = 0
            window.append(error)
            self._sum += error
            if len(window) > self.averaged:
                self._sum -= window.popleft()
        else:
            self._missing += 1
            if self._missing <= self._gap:
                self._inside += 1  # the dwell time counts only samples with a measurement
                return self.ready
            window.clear()
            self._sum = 0.0
        mean = abs(self._sum) / self.averaged if len(window) == self.averaged else math.inf
        if not mean <= self.tolerance:
            self._entered, self.ready = math.nan, False
        elif self._entered != self._entered:
            self._entered = self._sample - 0.5 * (self.averaged - 1)
        if not mean <= self._inner:
            self._inside = math.nan
        elif self._inside != self._inside:
            self._inside = self._sample
        if not self.ready and self._sample - self._inside >= self._dwell:
            self.ready, self.since = True, self._entered * self._sample_time
        return self.ready


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


#: Outcomes of a move that follow directly from the outcome of its trajectory.
_ENDINGS = {
    REPLACED: (Ending.REPLACED, "another trajectory or a setpoint has taken its place"),
    HELD: (Ending.CANCELLED, "the motion was stopped and the axis keeps its position"),
    STOPPED: (Ending.STOPPED, "the axis, or its reference generator, was stopped or reset"),
}


class Move:
    """Monitor of a trajectory in progress.

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
        """Evaluate a sample; return the outcome of the move and the reason as text, or None while the move continues.

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
                return Ending.PATH_VIOLATED, f"{error:.6g} m from the reference, allowed: at most {own.path:g} m"
            return None
        if not self._ended <= time:
            self._ended = time
        if self._arrival.take(time, error):
            return Ending.ARRIVED, f"{error:.6g} m from the last point, {time - self._ended:.3g} s after it"
        if time - self._ended > own.goal_time + own.dwell:
            text = f"{error:.6g} m from the last point {time - self._ended:.3g} s after it, allowed: {own.goal:g} m"
            return Ending.GOAL_MISSED, text
        return None
