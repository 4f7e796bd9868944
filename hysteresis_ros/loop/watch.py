# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Monitoring of the inputs of a part: missing, late or wrong values; all times are counted in samples.

A missing input is NaN: no value was received, or the value is unusable. :func:`accept` decides this for measurements
and commands, :func:`hold_voltage` for the voltage of an amplifier. The *mode* of a part is its reaction. Late voltages
and trips of the whole axis are in :mod:`.plant`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hysteresis_ros import signals
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.models.block import called, kernel

#: Modes of a part, see :mod:`hysteresis_ros.signals`.
RUNNING, HOLDING, STALE = signals.MODE_RUNNING, signals.MODE_HOLDING, signals.MODE_STALE
STOPPED, TRIPPED, FOLLOWING = signals.MODE_STOPPED, signals.MODE_TRIPPED, signals.MODE_FOLLOWING
QUIET = signals.MODE_QUIET
MODE_NAMES = ("running", "holding", "stale", "stopped", "tripped", "following", "quiet")


class WatchArrays(NamedTuple):
    """Parameter arrays, or state arrays, of the monitoring of a part's inputs."""

    guard: np.ndarray
    faults: np.ndarray
    own: np.ndarray


# Parameters of a guard.
TIMEOUT = 0  # samples without a good value after which the input is stale
SPIKE = 1  # largest change from one good value to the next, 0: any
CONFIRM = 2  # number of consecutive values with larger changes, of which the last is accepted
FROZEN = 3  # consecutive repetitions of a value from which a sensor counts as frozen, 0: never

# State of a guard.
GOOD = 0  # last good value
AGE = 1  # samples since the last good value
BEGUN = 2  # 1 after the first good value
STAMP = 3  # sample number of the last good value
SUSPECTS = 4  # consecutive values with too large a change
SAME = 5  # consecutive repetitions of the last value
LAST = 6  # last value, good or not
REJECTED = 7  # rejected values so far
GUARD_STATES = 8


def guard_parameters(timeout: float, sample_rate: float, spike: float = 0.0, confirm: int = 3, frozen: int = 0):
    """Return the parameter array of a guard with a ``timeout`` [s] at ``sample_rate`` [Hz]."""
    return np.array([samples_of(timeout, sample_rate), spike, confirm, frozen], dtype=float)


def samples_of(duration: float, sample_rate: float) -> float:
    """Return a duration [s] in whole samples, at least one."""
    return float(max(round(duration * sample_rate), 1))


@called
def accept(p, x, value, stamp):
    """Return ``value`` when it is accepted, NaN otherwise.

    A value is rejected if it is not finite, if its sample number ``stamp`` is not greater than that of the last good
    value, if it is too far from the last good value, or if the sensor is frozen. After a time-out neither sample number
    nor distance is checked, because there is no recent good value to compare with.
    """
    usable = value - value == 0.0
    stale = x[AGE] >= p[TIMEOUT]
    if usable and x[BEGUN] != 0.0:
        if stamp <= x[STAMP] and not stale:
            usable = False
        if p[FROZEN] > 0.0:
            x[SAME] = x[SAME] + 1.0 if value == x[LAST] else 0.0
            if x[SAME] >= p[FROZEN]:
                usable = False
        if p[SPIKE] > 0.0 and usable and not stale and abs(value - x[GOOD]) > p[SPIKE]:
            x[SUSPECTS] += 1.0
            if x[SUSPECTS] < p[CONFIRM]:
                usable = False
        x[LAST] = value
    if not usable:
        x[REJECTED] += 1.0
        if x[BEGUN] != 0.0:
            x[AGE] += 1.0
        return math.nan
    x[GOOD] = value
    x[LAST] = value
    x[AGE] = 0.0
    x[SUSPECTS] = 0.0
    x[STAMP] = stamp
    x[BEGUN] = 1.0
    return value


@kernel
def receive(guard_p, guard_x, faults_p, faults_x, target, value, missing):
    """Begin a sample; return its input ``value`` after fault injection if it is accepted, NaN otherwise."""
    faulty.begin_sample(faults_x)
    given = faulty.given_instead(faults_p, faults_x, target, value)
    if missing != 0.0:
        given = math.nan
    return accept(guard_p, guard_x, given, faults_x[faulty.STAMP])


@kernel
def is_stale(p, x):
    """Tell whether a guard has had no good value for its time-out; false before the first good value."""
    return x[AGE] >= p[TIMEOUT]


@kernel
def towards(value, target, step):
    """Return ``value`` moved towards ``target`` by at most ``step``."""
    return value + min(max(target - value, -step), step)


# Parameters of a held voltage.
SAFE = 0  # [V]
SAFE_STEP = 1  # [V] a sample
HOLD_TIMEOUT = 2  # samples
KEEP = 3  # 1: the safe voltage is never below the present output, for a clamp that must not open

# State of a held voltage.
HELD = 0  # output [V]
GIVEN = 1  # last received voltage [V]
HELD_AGE = 2  # samples since the last received voltage
HELD_BEGUN = 3  # 1 after the first received voltage
FOLLOWS = 4  # 1 while the output equals the received voltage


@called
def hold_voltage(p, x, voltage, stopped, least):
    """Return the output voltage [V] of a sample, given the voltage received in time (NaN: no voltage).

    The output is the last received voltage. After the time-out, or while ``stopped`` is not 0, it slews to the safe
    voltage by at most one step per sample. On the way back, in each sample the output may move by this step plus the
    change of the received voltage. So their difference decreases by at least one step per sample, and the output always
    reaches the received voltage. A target below ``least`` is replaced by ``least``.
    """
    step = p[SAFE_STEP]
    if voltage - voltage == 0.0:
        if x[HELD_BEGUN] != 0.0 and x[HELD_AGE] < p[HOLD_TIMEOUT]:
            step += abs(voltage - x[GIVEN])
        x[GIVEN] = voltage
        x[HELD_AGE] = 0.0
        x[HELD_BEGUN] = 1.0
    elif x[HELD_BEGUN] != 0.0:
        x[HELD_AGE] += 1.0
    target = x[GIVEN]
    silent = stopped != 0.0 or x[HELD_AGE] >= p[HOLD_TIMEOUT]
    if silent:
        x[FOLLOWS] = 0.0
        step = p[SAFE_STEP]
        target = max(p[SAFE], x[HELD]) if p[KEEP] != 0.0 else p[SAFE]
    if target < least:
        step = p[SAFE_STEP]
        x[FOLLOWS] = 0.0
        target = least
    if x[FOLLOWS] != 0.0:
        x[HELD] = target
        return target
    x[HELD] = towards(x[HELD], target, step)
    if not silent and x[HELD_BEGUN] != 0.0 and x[HELD] == x[GIVEN]:
        x[FOLLOWS] = 1.0
    return x[HELD]


@kernel
def least_beside(x, other):
    """Return the least allowed voltage [V] of a clamp: the present one while the ``other`` is below its target.

    Otherwise the result is -inf. The sequencer opens one clamp after it has commanded the other to close; after a stop
    the other clamp may still be closing.
    """
    return x[HELD] if other[HELD] < other[GIVEN] else -math.inf


def hold_state(voltage: float) -> np.ndarray:
    """Return the state of a held voltage with the output ``voltage`` [V], before any voltage was received."""
    return np.array([voltage, voltage, 0.0, 0.0, 1.0])
