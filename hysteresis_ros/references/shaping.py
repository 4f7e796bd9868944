# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Input shaping: a move to a setpoint in two or three parts, timed so that they leave no vibration of one mode behind.

ZV is a filter of three taps, at 0, m and m + 1 samples around half a period, with a zero on the pole of the mode,
z = exp((−ζ ω + i ω √(1 − ζ²)) T), and a sum of one: three equations. In continuous time these are the two impulses of
[1]_; placed between samples they would leave something behind. ZVD is ZV twice: a double zero, so that what a wrong
frequency leaves is of second order.

References
----------
.. [1] Singer & Seering, Preshaping command inputs to reduce system vibration, J. Dynamic Systems, Measurement and
   Control 112 (1990) 76-82.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import Block, called
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.linear_algebra import solve
from hysteresis_ros.parameters import Parameters, parameter

#: How often the filter of each type is applied.
TYPES = {"none": 0, "zv": 1, "zvd": 2}
#: Positions that are kept: the longest delay of a tap is one less.
RING = 4096
#: Most taps besides the first one.
MOST = 5

# Parameters: taps besides the first one, then delay [samples] and weight of each.
TAPS = 0
FIRST = 1
PARAMETERS = FIRST + 2 * MOST

# State: whether it runs (0.0: the next call starts at rest at REST_AT), place of the newest position, then the ring.
STARTED, NEWEST, REST_AT = range(3)
POSITIONS = 3


@dataclass(frozen=True)
class ShapingParameters(Parameters):
    """Input shaping of moves to setpoints."""

    type: str = parameter(
        "none",
        choices=tuple(TYPES),
        description="none; zv: in two parts, half a period apart; zvd: in three, less sensitive to the frequency",
    )
    frequency: float = parameter(
        0.0, unit="Hz", low=0.0, description="of the mode that is not to vibrate; changes while the setpoint rests"
    )
    damping: float = parameter(0.0, low=0.0, high=0.9, description="of that mode, part of the critical one")

    def check(self):
        """Yield that there is no frequency."""
        if self.type != "none" and not self.frequency > 0.0:
            yield Problem("frequency", self.frequency, "must be above 0: that of the mode, see `hysteresis design`")


def zero_vibration(frequency: float, damping: float, sample_time: float) -> np.ndarray:
    """Return the filter of ZV, shape (m + 2,), of which the first and the last two weights are not 0.

    Parameters
    ----------
    frequency : float
        [Hz]
    damping : float
        Below 1.
    sample_time : float
        [s]

    Raises
    ------
    ParameterError
        ``shaping.frequency``: not below half the sample rate, or too low to be kept in mind.
    """
    omega = 2.0 * math.pi * frequency * math.sqrt(1.0 - damping * damping)
    half = math.pi / (omega * sample_time)
    lowest = 1.0 / ((RING - 4) * sample_time * math.sqrt(1.0 - damping * damping))
    if not half > 1.0 or frequency < lowest:
        allowed = f"must be within {lowest:.4g} … {0.5 / sample_time:g} Hz, half the sample rate"
        raise ParameterError([Problem("shaping.frequency", frequency, allowed)])
    places = (0, math.floor(half), math.floor(half) + 1)
    # a zero on z = exp(pole T): Σ h exp(−pole T place) = 0
    rows = [[1.0, 1.0, 1.0], [], []]
    for place in places:
        grown = elementary.exp(2.0 * math.pi * frequency * damping * sample_time * place)
        angle = omega * sample_time * place
        rows[1].append(grown * elementary.cos(angle))
        rows[2].append(grown * elementary.sin(angle))
    weights = solve(np.array(rows), np.array([1.0, 0.0, 0.0]))
    found = np.zeros(places[2] + 1)
    found[list(places)] = weights
    return found


@called
def shaped(p, x, position):
    """Return the shaped ``position`` [m]."""
    count = int(p[TAPS])
    if count == 0:
        return position
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        for i in range(RING):
            x[POSITIONS + i] = x[REST_AT]
    newest = int(x[NEWEST]) + 1
    if newest == RING:
        newest = 0
    x[NEWEST] = float(newest)
    x[POSITIONS + newest] = position
    found = position
    for i in range(count):
        place = newest - int(p[FIRST + 2 * i])
        if place < 0:
            place += RING
        # what rests is the position itself, whatever the weights add up to
        found += p[FIRST + 2 * i + 1] * (x[POSITIONS + place] - position)
    return found


@called
def rest_shaper(x, position):
    """Be at rest at ``position`` [m]."""
    x[STARTED] = 0.0
    x[REST_AT] = position


class Shaper(Block):
    """Input shaping of positions [m].

    Parameters
    ----------
    parameters : ShapingParameters
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        ``shaping.frequency``: there is none, or it is too high or too low for the sample rate.
    """

    kernel = staticmethod(shaped)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array, shape (11,)."""
        p = np.zeros(PARAMETERS)
        if parameters.type == "none":
            return p
        whole = once = zero_vibration(parameters.frequency, parameters.damping, self.sample_time)
        for _ in range(TYPES[parameters.type] - 1):
            longer = np.zeros(len(whole) + len(once) - 1)
            for place in np.flatnonzero(once):
                longer[place : place + len(whole)] += once[place] * whole
            whole = longer
        taps = np.flatnonzero(whole)[1:]
        p[TAPS] = len(taps)
        p[FIRST : FIRST + 2 * len(taps)] = np.column_stack([taps, whole[taps]]).ravel()
        return p

    def initial_state(self) -> np.ndarray:
        """Return the state at rest at 0."""
        return np.zeros(POSITIONS + RING)

    @property
    def resting(self) -> bool:
        """Whether all positions that count are the same."""
        return self.x[STARTED] == 0.0 or bool(np.ptp(self.x[POSITIONS:]) == 0.0)

    def rest_at(self, position: float) -> None:
        """Be at rest at ``position`` [m]."""
        self.x[STARTED], self.x[REST_AT] = 0.0, float(position)
