# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Jerk-limited approach to a setpoint that may change at any time, followed by input shaping.

Structure (FIR trajectory filter; Biagiotti & Melchiorri, *FIR filters for online trajectory planning with time- and
frequency-domain specifications*, Control Engineering Practice 20 (2012) 1385-1399): a slew limiter moves q towards the
setpoint by at most d = V Ts per sample; two moving averages of N1 and N2 samples follow.

**Bounds for every sequence of setpoints.** Let Δq be the increments of q, |Δq| ≤ d, and y the output:

* velocity: Δy is a mean of Δq, so |Δy|/Ts ≤ d/Ts ≤ V;
* acceleration: the first average turns Δ²q into (Δq_k − Δq_{k−N1})/N1, at most 2 d/N1, and the second one takes a mean
  of this: |Δ²y|/Ts² ≤ 2 V/(N1 Ts) ≤ A for N1 ≥ 2 V/(A Ts);
* jerk: Δ³y = (Δq_k − Δq_{k−N1} − Δq_{k−N2} + Δq_{k−N1−N2})/(N1 N2), so |Δ³y|/Ts³ ≤ 4 V/(N1 N2 Ts²) ≤ J for
  N2 ≥ 4 V/(N1 J Ts²).

A reversal at full speed needs the factors 2 and 4; motions from rest to rest would only need 1 and 2.

**Overshoot.** y is a weighted mean of past values of q with weights ≥ 0, and q never passes the setpoint. Therefore y
moves monotonically from rest to the setpoint, and never leaves the interval spanned by the setpoints that were received
since y was last at rest. If a new setpoint is nearer, or on the other side, the motion in progress may pass it (in
general, no bounded deceleration can avoid this), but y stays within that interval.

**Exact arrival.** A distance D takes ceil(D/d) + N1 + N2 − 2 samples, and then y *is* the setpoint, bit for bit. The
filter works with whole multiples of a quantum (a power of two, at most 2⁻⁴⁹ of the largest position), stored as
float64; running sums are stored in two words below 2⁵³. Every addition is exact, so the sums never drift, and the last
step from the grid to the setpoint is no larger than about the float64 rounding of the position.

**A limit of zero is free.** If a limit is 0 and the limit of a higher derivative is not, the limit of 0 is replaced by
the value with which the full stroke R takes the least time. This time, R/V + 2 V/A + 2 A/J, is least where the terms
with free limits are equal. If all three limits are 0, the output is the setpoint.

The shaper ZV is a filter with three taps, at 0 and at the samples m and m + 1 around half a period. It has a zero at
the pole of the mode, z = exp((−ζ ω + i ω √(1 − ζ²)) T), and its taps have the sum 1: these are three equations for
three taps. In continuous time, ZV has the two impulses of [1]_; if they were rounded to samples, a vibration would
remain. ZVD is ZV applied twice. It has a double zero, so the residual vibration is of second order in the error of the
frequency.

References
----------
.. [1] Singer & Seering, Preshaping command inputs to reduce system vibration, J. Dynamic Systems, Measurement and
   Control 112 (1990) 76-82.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import Block, called, kernel
from hysteresis_ros.models.linear_algebra import solve

#: Parameters: WEIGHT = N1 N2; SPLIT: size of the lower word; setpoints outside LOW … HIGH are ignored.
QUANTUM, STEP, WINDOW1, WINDOW2, WEIGHT, SPLIT, LOW, HIGH = range(8)

#: State: WHOLE + REST/WEIGHT is the output in quanta, SLEWED the output of the slew limiter. Each sum of a window has
#: an upper and a lower word. The ring buffers of N1 increments and 2 × N2 sums follow.
SETPOINT, SLEWED, WHOLE, REST, SUM1_UPPER, SUM1_LOWER, SUM2_UPPER, SUM2_LOWER, INDEX1, INDEX2, ARRIVED = range(11)
RINGS = 11

LONGEST_WINDOWS = 2**20


@dataclass(frozen=True)
class ApproachParameters(Parameters):
    """Limits of the motion to a new setpoint; 0 = unlimited."""

    maximum_velocity: float = parameter(
        0.0, description="largest velocity of the approach, 0 = unlimited", unit="m/s", low=0.0, read_only=True
    )
    maximum_acceleration: float = parameter(
        0.0, description="largest acceleration of the approach, 0 = unlimited", unit="m/s²", low=0.0, read_only=True
    )
    maximum_jerk: float = parameter(
        0.0, description="largest jerk of the approach, 0 = unlimited", unit="m/s³", low=0.0, read_only=True
    )
    steps: bool = parameter(
        False,
        description="true: the jumps of a waveform (steps, square, staircase) keep these limits too; required by "
        "a feedforward that inverts the dynamics",
        read_only=True,
    )
    from_rest: bool = parameter(
        False,
        description="true: the reference begins where the axis rests, at 0 m, also outside the range, and the motion "
        "to the initial setpoint keeps these limits; false: it begins at the initial setpoint",
        read_only=True,
    )
    start_time: float = parameter(
        0.1,
        description="time in which the reference returns to the setpoint after a start, if the approach is unlimited",
        unit="s",
        low=0.0,
        high=3600.0,
        read_only=True,
    )

    @property
    def unlimited(self) -> bool:
        """Whether all limits are 0, so that setpoints pass unchanged."""
        return not (self.maximum_velocity or self.maximum_acceleration or self.maximum_jerk)


def effective_limits(parameters: ApproachParameters, stroke: float) -> tuple[float, float, float]:
    """Return the limits of velocity [m/s], acceleration [m/s²] and jerk [m/s³] for a ``stroke`` [m]; inf: unlimited."""
    velocity = parameters.maximum_velocity or math.inf
    acceleration = parameters.maximum_acceleration or math.inf
    jerk = parameters.maximum_jerk or math.inf
    if math.isinf(velocity) and math.isinf(acceleration) and math.isfinite(jerk):
        equal = math.cbrt(4.0 * stroke / jerk)
        acceleration = 0.5 * jerk * equal
        velocity = 0.5 * acceleration * equal
    if math.isinf(acceleration) and math.isfinite(jerk):
        acceleration = math.sqrt(velocity * jerk)
    if math.isinf(velocity) and math.isfinite(acceleration):
        velocity = math.sqrt(0.5 * stroke * acceleration)
    return velocity, acceleration, jerk


@kernel
def quotient(a, m):
    """Return the floor of a/m for whole numbers below 2⁵³, exact in spite of the rounding of a division."""
    n = math.floor(a / m)
    rest = a - n * m
    if rest < 0.0:
        n -= 1.0
    elif rest >= m:
        n += 1.0
    return n


@kernel
def approach(p, x, u):
    """Advance towards setpoint ``u`` [m] and return the position [m]; NaN and values outside LOW … HIGH are ignored."""
    if u >= p[LOW] and u <= p[HIGH]:
        x[SETPOINT] = u
    target = math.floor(x[SETPOINT] / p[QUANTUM] + 0.5)
    increment = min(max(target - x[SLEWED], -p[STEP]), p[STEP])
    x[SLEWED] += increment
    x[ARRIVED] = x[ARRIVED] + 1.0 if increment == 0.0 else 1.0

    n1, n2 = int(p[WINDOW1]), int(p[WINDOW2])
    i1 = int(x[INDEX1])
    oldest = x[RINGS + i1]
    x[RINGS + i1] = increment
    x[INDEX1] = i1 + 1.0 if i1 + 1 < n1 else 0.0
    upper, upper_oldest = math.floor(increment / p[SPLIT]), math.floor(oldest / p[SPLIT])
    x[SUM1_UPPER] += upper - upper_oldest
    x[SUM1_LOWER] += (increment - upper * p[SPLIT]) - (oldest - upper_oldest * p[SPLIT])

    i2 = int(x[INDEX2])
    j = RINGS + n1 + i2
    x[SUM2_UPPER] += x[SUM1_UPPER] - x[j]
    x[SUM2_LOWER] += x[SUM1_LOWER] - x[j + n2]
    x[j] = x[SUM1_UPPER]
    x[j + n2] = x[SUM1_LOWER]
    x[INDEX2] = i2 + 1.0 if i2 + 1 < n2 else 0.0

    # output += second sum/WEIGHT, with the remainder kept: first the upper word, then its remainder with the lower word
    weight = p[WEIGHT]
    n = quotient(x[SUM2_UPPER], weight)
    lower = (x[SUM2_UPPER] - n * weight) * p[SPLIT] + x[SUM2_LOWER] + x[REST]
    m = quotient(lower, weight)
    x[REST] = lower - m * weight
    x[WHOLE] += n * p[SPLIT] + m
    if x[ARRIVED] >= p[WINDOW1] + p[WINDOW2] - 1.0 and x[SLEWED] == target:
        return x[SETPOINT]
    return (x[WHOLE] + x[REST] / weight) * p[QUANTUM]


@kernel
def rest(p, x, position, setpoint):
    """Set the state to rest at ``position`` [m], before the motion to ``setpoint`` [m]."""
    for i in range(x.shape[0]):
        x[i] = 0.0
    x[SETPOINT] = setpoint
    x[SLEWED] = math.floor(position / p[QUANTUM] + 0.5)
    x[WHOLE] = x[SLEWED]
    x[ARRIVED] = p[WINDOW1] + p[WINDOW2]


class Approach(Block):
    """Jerk-limited approach to setpoints within ``minimum`` … ``maximum``.

    Parameters
    ----------
    parameters : ApproachParameters
        Limits.
    sample_time : float
        Sample time [s].
    minimum, maximum : float
        Range of the reference [m]. It determines the quantum of the arithmetic, and the stroke that replaces limits of
        0.
    initial_setpoint : float
        Initial position [m], at rest.

    Raises
    ------
    ParameterError
        The limits are too low for the memory or for exact arithmetic.
    """

    kernel = staticmethod(approach)

    def __init__(self, parameters, sample_time, minimum: float, maximum: float, initial_setpoint: float = 0.0):
        self._range = (float(minimum), float(maximum))
        self._initial = float(initial_setpoint)
        self._sample_time = float(sample_time)
        parameters.validated("approach.")
        super().__init__(parameters, sample_time)

    def pack(self, parameters) -> np.ndarray:
        """Return the kernel's parameters; their layout is at the top of the module."""
        low, high = self._range
        velocity, acceleration, jerk = effective_limits(parameters, high - low)
        # four times the range, because at a start setpoint and waveform may each be outside the range
        exponent = math.frexp(max(abs(low), abs(high)))[1] + 2
        quantum = math.ldexp(1.0, exponent - 52)
        step = 2.0**52
        if math.isfinite(velocity):
            step = min(step, math.floor(velocity * self._sample_time / quantum))
        n1 = n2 = 1.0
        if math.isfinite(acceleration):
            n1 = max(1.0, math.ceil(2.0 * velocity / (acceleration * self._sample_time) * (1.0 - 1e-14)))
        if math.isfinite(jerk):
            n2 = max(1.0, math.ceil(4.0 * velocity / (n1 * jerk * self._sample_time**2) * (1.0 - 1e-14)))
        weight = n1 * n2
        split = math.ldexp(1.0, max(51 - math.frexp(weight)[1], 0))
        if step < 1.0:
            least = quantum / self._sample_time
            remedy = f"too slow for the range, allowed: 0 (unlimited) or ≥ {least:g} m/s"
            raise ParameterError([Problem("approach.maximum_velocity", parameters.maximum_velocity, remedy)])
        if n1 + n2 > LONGEST_WINDOWS or weight * (step / split + 1.0) > 2.0**52:
            name = "maximum_acceleration" if n1 > n2 else "maximum_jerk"
            remedy = f"too low: the approach would take {(n1 + n2) * self._sample_time:g} s to settle; raise it"
            raise ParameterError([Problem(f"approach.{name}", getattr(parameters, name), remedy)])
        return np.array([quantum, step, n1, n2, weight, split, low, high])

    def initial_state(self) -> np.ndarray:
        """Return the state at rest at the initial setpoint."""
        x = np.zeros(RINGS + int(self.p[WINDOW1]) + 2 * int(self.p[WINDOW2]))
        rest(self.p, x, self._initial, self._initial)
        return x

    def rest_at(self, position: float) -> None:
        """Stop at ``position`` [m] with velocity zero; the setpoint stays."""
        rest(self.p, self.x, position, self.x[SETPOINT])

    def duration(self, distance: float) -> float:
        """Return the time [s] from rest to the exact arrival at a new setpoint at a ``distance`` [m]."""
        moving = max(math.ceil(abs(distance) / (self.p[STEP] * self.p[QUANTUM])), 1)
        return (moving + self.p[WINDOW1] + self.p[WINDOW2] - 2.0) * self.sample_time

    def retune(self, parameters) -> None:
        """Refuse a change: the sizes of the windows determine the state, so an approach is fixed after construction.

        Raises
        ------
        ParameterError
            The parameters differ from the present ones.
        """
        if parameters != self.parameters:
            text = "fixed while the node is configured; clean up and configure again"
            raise ParameterError([Problem("approach", parameters.to_mapping(), text)])


#: Number of times that each type applies the filter ZV.
TYPES = {"none": 0, "zv": 1, "zvd": 2}
#: Number of stored positions; the longest delay of a tap is one sample less.
RING = 4096
#: Maximum number of taps in addition to the first.
MOST = 5

# Parameters: number of taps in addition to the first, then delay [samples] and weight of each of these taps.
TAPS = 0
FIRST = 1
PARAMETERS = FIRST + 2 * MOST

# State: 1.0 while running (0.0: the next call starts at rest at REST_AT); index of the newest position; then the ring.
STARTED, NEWEST, REST_AT = range(3)
POSITIONS = 3


@dataclass(frozen=True)
class ShapingParameters(Parameters):
    """Input shaping of moves to setpoints."""

    type: str = parameter(
        "none",
        choices=tuple(TYPES),
        description="none; zv: two impulses, half a period apart; zvd: three, less sensitive to errors of the "
        "frequency",
    )
    frequency: float = parameter(
        0.0,
        unit="Hz",
        low=0.0,
        description="natural frequency of the mode to suppress; can change while no move is in progress",
    )
    damping: float = parameter(0.0, low=0.0, high=0.9, description="damping ratio of that mode")

    def check(self):
        """Yield a Problem if the frequency is missing."""
        if self.type != "none" and not self.frequency > 0.0:
            yield Problem(
                "frequency",
                self.frequency,
                "must be > 0 Hz: the natural frequency of the mode; `hysteresis design` finds it",
            )


def zero_vibration(frequency: float, damping: float, sample_time: float) -> np.ndarray:
    """Return the weights of the filter ZV, shape (m + 2,); only the first and the last two of them are not 0.

    Units: ``frequency`` [Hz], ``sample_time`` [s]; the damping must be below 1. ParameterError:
    ``shaping.frequency`` is not below half the sample rate, or is too low for the number of stored positions.
    """
    omega = 2.0 * math.pi * frequency * math.sqrt(1.0 - damping * damping)
    half = math.pi / (omega * sample_time)
    lowest = 1.0 / ((RING - 4) * sample_time * math.sqrt(1.0 - damping * damping))
    if not half > 1.0 or frequency < lowest:
        remedy = f"must be at least {lowest:.4g} Hz and below {0.5 / sample_time:g} Hz, half the sample rate"
        raise ParameterError([Problem("shaping.frequency", frequency, remedy)])
    places = (0, math.floor(half), math.floor(half) + 1)
    # a zero at z = exp(pole T) requires Σ h exp(−pole T place) = 0
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
        # differences from the position: at rest, the output is exactly the position even if rounded weights do not sum
        # to 1
        found += p[FIRST + 2 * i + 1] * (x[POSITIONS + place] - position)
    return found


@called
def rest_shaper(x, position):
    """Set the state to rest at ``position`` [m]."""
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
        ``shaping.frequency`` is missing, or too high or too low for the sample rate.
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
        """Whether all positions within the filter's length are equal."""
        return self.x[STARTED] == 0.0 or bool(np.ptp(self.x[POSITIONS:]) == 0.0)

    def rest_at(self, position: float) -> None:
        """Set the state to rest at ``position`` [m]."""
        self.x[STARTED], self.x[REST_AT] = 0.0, float(position)
