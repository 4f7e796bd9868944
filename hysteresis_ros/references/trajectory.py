# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Trajectories through points: they replace the approach, from rest or during a motion.

Between two points, the path is a polynomial in time. Its degree is chosen as in ``joint_trajectory_controller`` of
ros2_controllers: a line for positions alone, a cubic with velocities, a quintic with accelerations. The first segment
begins with the position, velocity and acceleration of the previous sample, so that a trajectory continues the motion
that it replaces.

The whole state is one array of fixed size; nodes, fused loop and offline simulation replace it between two samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import kernel

#: Parameters: SMOOTH is 1 if the approach has limits: the samples then define a velocity. DECELERATION 0: stop within
#: one sample.
SAMPLE_TIME, SMOOTH, DECELERATION, LOWEST, HIGHEST = range(5)

#: State: ACTIVE is one of the codes below; PENDING is 1 if a trajectory is accepted but no sample is computed yet;
#: ELAPSED and LENGTH are in samples; POSITION, VELOCITY and ACCELERATION are those of the last sample, and GIVEN is the
#: setpoint of that sample; TARGET is the end of the trajectory, which then replaces the setpoint; AFTER is the setpoint
#: after braking; NUMBER counts the trajectories, and OUTCOME is the outcome of the last one. Segments of WIDTH numbers
#: follow.
ACTIVE, PENDING, ELAPSED, LENGTH, SEGMENT, COUNT, POSITION, VELOCITY, ACCELERATION = range(9)
GIVEN, TARGET, AFTER, NUMBER, OUTCOME = range(9, 14)
SEGMENTS = 14
#: Value of TARGET and AFTER for "no position".
NOWHERE = math.inf
#: Numbers of a segment: its beginning [s], and the coefficients of the powers of the time since its beginning.
BEGIN, COEFFICIENTS, WIDTH = 0, 1, 7

#: Codes of ACTIVE.
IDLE, FOLLOWING, BRAKING = range(3)
#: Codes of OUTCOME: in progress, completed, replaced by another trajectory or a setpoint, held, stopped with the axis.
OPEN, ENDED, REPLACED, HELD, STOPPED = range(5)

#: Largest number of points.
MOST_POINTS = 1000
#: Number of intervals of a segment; at their ends, position, velocity and acceleration are checked.
LOOKS = 64
#: Relative tolerance of a limit, for rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class TrajectoryParameters(Parameters):
    """Conditions for accepting a trajectory and for its arrival."""

    start_tolerance: float = parameter(
        0.0,
        description="largest distance of a first point at time 0 from the reference; 0: a hundredth of minimum … "
        "maximum",
        unit="m",
        low=0.0,
        read_only=True,
    )
    goal_tolerance: float = parameter(
        0.0,
        description="distance from the last point within which a move has arrived; 0: a hundredth of minimum … maximum",
        unit="m",
        low=0.0,
        read_only=True,
    )
    dwell: float = parameter(
        0.02,
        description="time for which a move must stay within goal_tolerance",
        unit="s",
        low=0.0,
        high=3600.0,
        read_only=True,
    )
    goal_time: float = parameter(
        1.0,
        description="time within which a move must arrive after its last point",
        unit="s",
        low=0.0,
        high=3600.0,
        read_only=True,
    )


@kernel
def advance(p, x):
    """Return the position [m] of the next sample of a trajectory; the last sample ends the trajectory."""
    x[PENDING] = 0.0
    x[ELAPSED] += 1.0
    if x[ELAPSED] >= x[LENGTH]:
        if x[ACTIVE] == FOLLOWING:
            x[OUTCOME] = ENDED
        x[ACTIVE] = IDLE
        return x[TARGET]
    time = x[ELAPSED] * p[SAMPLE_TIME]
    segment = int(x[SEGMENT])
    while segment + 1 < x[COUNT] and time >= x[SEGMENTS + WIDTH * (segment + 1) + BEGIN]:
        segment += 1
    x[SEGMENT] = segment
    first = SEGMENTS + WIDTH * segment
    tau = time - x[first + BEGIN]
    position = 0.0
    for i in range(first + WIDTH - 1, first + COEFFICIENTS - 1, -1):
        position = position * tau + x[i]
    return min(max(position, p[LOWEST]), p[HIGHEST])


@kernel
def note_motion(p, x, position, smooth):
    """Store position, velocity and acceleration of a sample; unless ``smooth``, velocity and acceleration are 0."""
    velocity, acceleration = 0.0, 0.0
    if smooth != 0.0:
        velocity = (position - x[POSITION]) / p[SAMPLE_TIME]
        acceleration = (velocity - x[VELOCITY]) / p[SAMPLE_TIME]
    x[POSITION], x[VELOCITY], x[ACCELERATION] = position, velocity, acceleration


@kernel
def brake(p, x, after, outcome):
    """Bring any motion to rest, within one sample or with the allowed deceleration.

    Parameters
    ----------
    p, x : ndarray
        Parameters and state of the trajectory.
    after : float
        Next setpoint [m]; NOWHERE: the position stays.
    outcome : int
        Outcome of the present trajectory.
    """
    if x[ACTIVE] == FOLLOWING:
        x[OUTCOME] = outcome
    velocity = x[VELOCITY]
    duration = abs(velocity) / p[DECELERATION] if p[DECELERATION] > 0.0 else 0.0
    for i in range(SEGMENTS, SEGMENTS + WIDTH):
        x[i] = 0.0
    if duration > 0.0:
        x[SEGMENTS + COEFFICIENTS] = x[POSITION]
        x[SEGMENTS + COEFFICIENTS + 1] = velocity
        x[SEGMENTS + COEFFICIENTS + 2] = -0.5 * velocity / duration
    rest = x[POSITION] + 0.5 * velocity * duration
    x[TARGET] = min(max(rest, p[LOWEST]), p[HIGHEST])
    x[ACTIVE], x[PENDING], x[AFTER] = BRAKING, 1.0, after
    x[ELAPSED], x[SEGMENT], x[COUNT] = 0.0, 0.0, 1.0
    x[LENGTH] = math.ceil(duration / p[SAMPLE_TIME])


def initial_state(position: float) -> np.ndarray:
    """Return the state at rest at a position [m], large enough for the longest trajectory; shape (N,)."""
    x = np.zeros(SEGMENTS + WIDTH * MOST_POINTS)
    x[POSITION] = x[GIVEN] = position
    x[TARGET] = x[AFTER] = NOWHERE
    return x


def begin_trajectory(x: np.ndarray, segments: np.ndarray, points: Points, sample_time: float) -> None:
    """Write a path into the state; the path begins with the next sample.

    ``segments`` has the shape (N, WIDTH). Units: ``sample_time`` [s].
    """
    x[SEGMENTS : SEGMENTS + segments.size] = segments.ravel()
    x[ACTIVE], x[PENDING], x[AFTER] = FOLLOWING, 1.0, NOWHERE
    x[ELAPSED], x[SEGMENT], x[COUNT] = 0.0, 0.0, len(segments)
    x[LENGTH] = math.ceil(points.times[-1] / sample_time * (1.0 - ROUNDING))
    x[TARGET] = points.positions[-1]
    x[NUMBER] += 1.0
    x[OUTCOME] = OPEN


class Points:
    """The points of a trajectory, with consistency checks.

    Parameters
    ----------
    times : sequence of float, shape (N,)
        Time of each point since the beginning [s].
    positions : sequence of float, shape (N,)
        [m]
    velocities, accelerations : sequence of float, shape (N,), optional
        [m/s], [m/s²]; accelerations only with velocities. The last velocity must be 0.

    Raises
    ------
    ParameterError
        The lengths differ, a number is not finite, the times do not increase, the last velocity is not 0, or there are
        too many points.
    """

    def __init__(self, times, positions, velocities=(), accelerations=()):
        given = {"times": times, "positions": positions, "velocities": velocities, "accelerations": accelerations}
        self.given = {name: tuple(map(float, values)) for name, values in given.items()}
        values = {name: np.array(numbers) for name, numbers in self.given.items()}
        self.times, self.positions = values["times"], values["positions"]
        self.velocities, self.accelerations = values["velocities"], values["accelerations"]
        count = len(self.times)
        if not 0 < count <= MOST_POINTS:
            raise _refused(
                "points",
                count,
                f"allowed: 1 … {MOST_POINTS}; join nearly straight segments, or send several trajectories",
            )
        for name, numbers in values.items():
            needed = name in ("times", "positions")
            if len(numbers) != count and (needed or len(numbers)):
                text = f"the path has {count} points; give one for every point{'' if needed else ' or none'}"
                raise _refused(name, len(numbers), text, "numbers")
            for number in numbers[~np.isfinite(numbers)][:1]:
                raise _refused(name, number, "must be a finite number")
        if len(self.accelerations) and not len(self.velocities):
            text = "cannot be given without velocities: give both, velocities alone, or neither"
            raise _refused("accelerations", count, text, "numbers")
        self._check_times()
        if len(self.velocities) and self.velocities[-1] != 0.0:
            raise _refused(
                "velocities", self.velocities[-1], "must be 0 at the last point, because the axis rests there", "m/s"
            )

    def _check_times(self) -> None:
        times = self.times
        if times[0] < 0.0:
            raise _refused("times", times[0], "the time of the first point must not be negative", "s")
        for index in np.flatnonzero(np.diff(times) <= 0.0)[:1]:
            text = f"point {index + 1} must be later than {times[index]:g} s, the time of the point before it"
            raise _refused("times", times[index + 1], text, "s")
        if times[-1] == 0.0:
            raise _refused("times", 0.0, "the last point must be later than 0 s", "s")

    def segments(self, position: float, velocity: float, acceleration: float) -> np.ndarray:
        """Return the segments of a path that continues the present motion, shape (segments, WIDTH).

        A first point at time 0 states where the sender assumes the axis to be; the path begins at the actual position.
        """
        first = 1 if self.times[0] == 0.0 else 0
        knots = [np.concatenate([[0.0], self.times[first:]]), np.concatenate([[position], self.positions[first:]])]
        for present, values in ((velocity, self.velocities), (acceleration, self.accelerations)):
            knots.append(np.concatenate([[present], values[first:]]) if len(values) else np.zeros(0))
        times, positions, velocities, accelerations = knots
        duration = np.diff(times)
        made = np.zeros((len(duration), WIDTH))
        made[:, BEGIN], made[:, COEFFICIENTS] = times[:-1], positions[:-1]
        rise = np.diff(positions) / duration
        own = made[:, COEFFICIENTS:]
        if not len(velocities):
            own[:, 1] = rise
            return made
        own[:, 1] = velocities[:-1]
        # velocities relative to the straight line; without powers, because C libraries round them differently
        start, end = velocities[:-1] - rise, velocities[1:] - rise
        if not len(accelerations):
            own[:, 2] = -(2.0 * start + end) / duration
            own[:, 3] = (start + end) / (duration * duration)
            return made
        before, after = accelerations[:-1] * duration, accelerations[1:] * duration
        own[:, 2] = 0.5 * accelerations[:-1]
        own[:, 3] = (-6.0 * start - 4.0 * end - 1.5 * before + 0.5 * after) / (duration * duration)
        own[:, 4] = (8.0 * start + 7.0 * end + 1.5 * before - after) / (duration * duration * duration)
        own[:, 5] = (-3.0 * start - 3.0 * end - 0.5 * before + 0.5 * after) / (
            duration * duration * duration * duration
        )
        return made


@dataclass(frozen=True)
class Bounds:
    """Limits of a trajectory.

    Parameters
    ----------
    low, high : float
        Positions [m].
    velocity, acceleration : float
        Largest velocity [m/s] and acceleration [m/s²]; 0: unlimited.
    sample_time : float
        [s]
    """

    low: float
    high: float
    velocity: float
    acceleration: float
    sample_time: float

    def check(self, segments: np.ndarray, length: float, velocity: float) -> None:
        """Refuse a path that exceeds the limits, also between its points.

        Parameters
        ----------
        segments : ndarray, shape (N, WIDTH)
        length : float
            Duration of the path [s].
        velocity : float
            Velocity of the motion before the path [m/s].

        Raises
        ------
        ParameterError
            A limit is exceeded; the message states the time, the value and the limit.
        """
        ends = np.concatenate([segments[1:, BEGIN], [length]])
        tau = np.linspace(0.0, 1.0, LOOKS + 1)[:, None] * (ends - segments[:, BEGIN])
        times = tau + segments[:, BEGIN]
        orders = [segments[:, COEFFICIENTS:].T]
        for _ in range(2):
            orders.append(orders[-1][1:] * np.arange(1.0, len(orders[-1]))[:, None])
        position, speed, acceleration = (_polynomials(coefficients, tau) for coefficients in orders)
        slack = ROUNDING * (self.high - self.low)
        for bad in np.argwhere((position < self.low - slack) | (position > self.high + slack))[:1]:
            text = f"at {times[tuple(bad)]:g} s out of range, allowed: {self.low:g} … {self.high:g} m"
            raise _refused("positions", position[tuple(bad)], text, "m")
        _within("velocities", "m/s", np.abs(speed), self.velocity, times)
        _within("accelerations", "m/s²", np.abs(acceleration), self.acceleration, times)
        corners = np.abs(np.concatenate([speed[0], [0.0]]) - np.concatenate([[velocity], speed[-1]]))
        steep = corners[None, :] / self.sample_time
        at = np.concatenate([segments[:, BEGIN], [length]])[None, :]
        _within(
            "accelerations",
            "m/s²",
            steep,
            self.acceleration,
            at,
            "at a corner at",
            "velocities, which round the corner",
        )


def _within(name, unit, values: np.ndarray, limit: float, times: np.ndarray, at="at", remedy="more time") -> None:
    """Refuse the values if the largest of them exceeds the limit; a limit of 0 does not apply."""
    worst = np.unravel_index(np.argmax(values), values.shape)
    if limit > 0.0 and values[worst] > limit * (1.0 + ROUNDING):
        text = f"{at} {times[worst]:g} s too high, allowed: ≤ {limit:g} {unit}; give {remedy}"
        raise _refused(name, values[worst], text, unit)


def _polynomials(coefficients: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Return N polynomials with ``coefficients``, shape (degree + 1, N), each at its own M times, shape (M, N)."""
    value = np.zeros_like(tau)
    for row in coefficients[::-1]:
        value = value * tau + row
    return value


def _refused(name: str, value, text: str, unit: str = "") -> ParameterError:
    return ParameterError([Problem(f"trajectory {name}", float(value), text, unit)])
