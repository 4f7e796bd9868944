# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Actuators of other classes than the models of the package, to test identification and design.

voltage → delay → (lag) → hysteresis → creep → two modes → (lag) → displacement; there is only one of the two lags.
The chain is integrated on a grid finer than the samples, with the voltage held during each sample; the displacement
between the samples is therefore known, too. The types of hysteresis, where s is the voltage divided by its range, are

* ``play``: generalised play operators with different envelopes for rising and falling input, and thresholds that grow
  with the speed of the input [1],
* ``preisach``: a Preisach operator in Krejčí's form Σ q(r, z_r), with play operators z_r, and q nonlinear in z_r [2],
* ``bouc_wen``: y = d(s) − h, h' = α s' − β |s'| h − γ s' |h| [3],
* ``duhem``: y' = a |s'| (f(s) − y) + g s' (Coleman & Hodgdon) [4].

The creep follows a power of time (fractional order), approximated by a sum of relaxations over six decades [5].

References
----------
.. [1] Al Janaideh, Rakheja & Su, IEEE/ASME Transactions on Mechatronics 16(5), 2011, on rate-dependent operators.
.. [2] Krejčí, Hysteresis, Convexity and Dissipation in Hyperbolic Equations, 1996, section II.3.
.. [3] Low & Guo, Review of Scientific Instruments 66, 1995.
.. [4] Coleman & Hodgdon, International Journal of Engineering Science 24(6), 1986.
.. [5] Liu, Shan & Qi, IEEE Transactions on Control Systems Technology 21(4), 2013, on creep of fractional order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import Block, compiled, composite, kernel
from hysteresis_ros.models.linear import zero_order_hold
from hysteresis_ros.models.linear_algebra import product

#: Kinds of hysteresis, in the order of their numbers in the kernel.
HYSTERESES = ("play", "preisach", "bouc_wen", "duhem")
#: Number of play operators; time constants of the creep relaxations [s]; number of modes.
PLAYS = 12
CREEP_TIMES = tuple(elementary.pow(10.0, 0.5 * place) for place in range(-6, 7))
MODES = 2
#: Speed of s at which the thresholds have half of their maximum widening [1/s].
SPEED_KNEE = 20.0
#: Averaging time of the speed of s [s].
SPEED_MEMORY = 2e-3
#: The longest delay [steps of the fine grid].
LONGEST_DELAY = 256

# Layout of p.
STEPS = 0  # steps of the fine grid per sample
KIND = 1  # index in HYSTERESES
PER_VOLT = 2
STROKE = 3
BEFORE, BEHIND = 4, 5  # decay factors per step of the lags before the hysteresis and after the modes; 0: no lag
DELAY = 6  # steps
LINEAR, SQUARE = 7, 8  # d(s) or f(s): LINEAR s + SQUARE s²
RATE = 9  # widening of the thresholds in the limit of high speed
KNEE = 10  # change of s per step at half of this widening
MEMORY = 11  # decay of the averaged change from step to step
TURN = 12  # β (Bouc-Wen) or a (Duhem)
SWING = 13  # α (Bouc-Wen) or g (Duhem)
SKEW = 14  # γ (Bouc-Wen)
CURVE = 15  # difference between the rising and the falling curve
THRESHOLDS = 16  # then weights and curvatures of the play operators
WEIGHTS = THRESHOLDS + PLAYS
CURVATURES = WEIGHTS + PLAYS
DECAYS = CURVATURES + PLAYS  # decays of the creep, then its weights
GROWTHS = DECAYS + len(CREEP_TIMES)
MODAL = GROWTHS + len(CREEP_TIMES)  # for each mode: A (4), B (2), share
A_MODE = 7
PARAMETERS = MODAL + A_MODE * MODES

# Layout of x.
LAGGED, FOLLOWED, LAST, OPENING = 0, 1, 2, 3  # outputs of the two lags; s of the last step; h (Bouc-Wen) or y (Duhem)
NEXT = 4  # index of the next voltage in the ring
SPEED = 5  # averaged change of s per step
PLAY = 6
CREPT = PLAY + PLAYS
MODE = CREPT + len(CREEP_TIMES)
RING = MODE + 2 * MODES
STATES = RING + LONGEST_DELAY


@dataclass(frozen=True)
class ForeignParameters(Parameters):
    """Parameters of an actuator whose class differs from that of every model."""

    hysteresis: str = parameter("play", choices=HYSTERESES, description="class of the hysteresis")
    stroke: float = parameter(40e-6, description="approximate stroke over the range of voltage", unit="m", low=1e-12)
    voltage: float = parameter(100.0, description="highest voltage; the lowest is 0", unit="V", low=1e-9)
    opening: float = parameter(
        0.13, description="approximate width of the widest loop, as a fraction of the stroke", low=0
    )
    asymmetry: float = parameter(0.15, description="difference between rising and falling branches", low=0.0, high=0.5)
    rate: float = parameter(0.4, description="play: widening of the thresholds at high speed", low=0.0, high=2.0)
    creep: float = parameter(
        0.03, description="creep from 0.1 to 10 s after a step, as a fraction of the step", low=0.0
    )
    exponent: float = parameter(0.2, description="exponent of time in the creep law", low=0.01, high=1.0)
    lag: float = parameter(1e-3, description="time constant of the lag; 0: none", unit="s", low=0.0)
    lag_before: bool = parameter(True, description="whether the lag is before the hysteresis")
    delay: float = parameter(0.0, description="delay of the voltage", unit="s", low=0.0)
    frequencies: tuple[float, ...] = parameter(
        (280.0, 1300.0), description="frequencies of the two modes", unit="Hz", low=1e-3
    )
    dampings: tuple[float, ...] = parameter(
        (0.03, 0.02), description="damping ratios of the two modes", low=1e-4, high=2.0
    )
    share: float = parameter(0.1, description="fraction of the displacement from the second mode", low=0, high=1)
    steps: int = parameter(10, description="steps of the fine grid per sample", low=1, high=100)

    def check(self):
        """Yield a Problem unless there are two modes."""
        for name in ("frequencies", "dampings"):
            if len(getattr(self, name)) != MODES:
                yield Problem(name, getattr(self, name), f"must be {MODES} numbers")


@kernel
def play_operators(p, x, s):
    """Output of the sum of linear or nonlinear play operators at the input ``s``."""
    x[SPEED] = abs(s - x[LAST]) + p[MEMORY] * (x[SPEED] - abs(s - x[LAST]))
    wider = 1.0 + p[RATE] * x[SPEED] / (x[SPEED] + p[KNEE])
    rising = s + p[CURVE] * s * (1.0 - s)
    y = p[LINEAR] * s + p[SQUARE] * s * s
    for i in range(PLAYS):
        threshold = wider * p[THRESHOLDS + i]
        z = max(rising - threshold, min(s + threshold, x[PLAY + i]))
        x[PLAY + i] = z
        y += p[WEIGHTS + i] * z * (1.0 + p[CURVATURES + i] * (1.0 - z))
    return y


@kernel
def bouc_wen(p, x, s):
    """Output of a Bouc-Wen hysteresis with a curved middle line; the solution is exact on a path without reversal."""
    change = s - x[LAST]
    if change != 0.0:
        way = abs(change)
        forwards = 1.0 if change > 0.0 else -1.0
        h = forwards * x[OPENING]
        if h < 0.0:  # h' = α - (β - γ) h, with h and s counted along the motion, until h is 0
            decay = p[TURN] - p[SKEW]
            to_zero = elementary.log1p(-h * decay / p[SWING]) / decay
            done = min(way, to_zero)
            h = p[SWING] / decay + (h - p[SWING] / decay) * elementary.exp(-decay * done)
            way -= done
        if way > 0.0:  # h' = α - (β + γ) h
            decay = p[TURN] + p[SKEW]
            h = p[SWING] / decay + (h - p[SWING] / decay) * elementary.exp(-decay * way)
        x[OPENING] = forwards * h
    return p[LINEAR] * s + p[SQUARE] * s * s - x[OPENING]


@kernel
def duhem(p, x, s):
    """Output of the Duhem equation of Coleman and Hodgdon; the solution is exact on a path without reversal."""
    change = s - x[LAST]
    if change != 0.0:
        turn = p[TURN] if change > 0.0 else -p[TURN]
        # the polynomial a0 + a1 s + a2 s² that solves y' = turn (f(s) - y) + g; a2 is the same as in f
        a1 = p[LINEAR] - 2.0 * p[SQUARE] / turn
        a0 = (p[SWING] - a1) / turn
        last = x[LAST]
        deviation = x[OPENING] - a0 - a1 * last - p[SQUARE] * last * last
        x[OPENING] = a0 + a1 * s + p[SQUARE] * s * s + deviation * elementary.exp(-turn * change)
    return x[OPENING]


@kernel
def substep(p, x, voltage):
    """Displacement [m] after one more step of the fine grid under ``voltage`` [V]."""
    place = int(x[NEXT])
    x[RING + place] = voltage * p[PER_VOLT]
    x[NEXT] = float((place + 1) % LONGEST_DELAY)
    s = x[RING + (place - int(p[DELAY])) % LONGEST_DELAY]
    x[LAGGED] = s + p[BEFORE] * (x[LAGGED] - s)
    s = x[LAGGED]
    kind = p[KIND]
    if kind < 2.0:
        y = play_operators(p, x, s)
    elif kind < 3.0:
        y = bouc_wen(p, x, s)
    else:
        y = duhem(p, x, s)
    x[LAST] = s
    u = y
    for i in range(GROWTHS - DECAYS):
        u += p[GROWTHS + i] * x[CREPT + i]
        x[CREPT + i] = y + p[DECAYS + i] * (x[CREPT + i] - y)
    moved = 0.0
    for mode in range(MODES):
        m = MODAL + A_MODE * mode
        q = MODE + 2 * mode
        first = p[m] * x[q] + p[m + 1] * x[q + 1] + p[m + 4] * u
        x[q + 1] = p[m + 2] * x[q] + p[m + 3] * x[q + 1] + p[m + 5] * u
        x[q] = first
        moved += p[m + 6] * first
    x[FOLLOWED] = moved + p[BEHIND] * (x[FOLLOWED] - moved)
    return p[STROKE] * x[FOLLOWED]


@kernel
def foreign(p, x, voltage):
    """Displacement [m] at the next sample when ``voltage`` [V] is held until then."""
    y = 0.0
    for _ in range(int(p[STEPS])):
        y = substep(p, x, voltage)
    return y


@composite("void", "array", "array", "array", "table")
def follow(p, x, voltage, displacement):
    """Fill row k of ``displacement`` [m] with the response while ``voltage[k]`` [V] is held."""
    for k in range(voltage.shape[0]):
        for i in range(displacement.shape[1]):
            displacement[k, i] = substep(p, x, voltage[k])


class Foreign(Block):
    """An actuator whose class differs from that of every model: voltage [V] to displacement [m] at the next sample.

    Units: ``sample_time`` [s].
    """

    kernel = staticmethod(foreign)

    def pack(self, parameters: ForeignParameters) -> np.ndarray:
        """Return the parameter array."""
        step = self.sample_time / parameters.steps
        p = np.zeros(PARAMETERS)
        p[STEPS], p[KIND] = parameters.steps, HYSTERESES.index(parameters.hysteresis)
        p[PER_VOLT], p[STROKE] = 1.0 / parameters.voltage, parameters.stroke
        decay = elementary.exp(-step / parameters.lag) if parameters.lag else 0.0
        p[BEFORE if parameters.lag_before else BEHIND] = decay
        p[DELAY] = min(round(parameters.delay / step), LONGEST_DELAY - 1)
        self._pack_hysteresis(p, parameters, step)
        p[DECAYS:GROWTHS] = _decayed(step)
        growths = np.array([elementary.pow(time, parameters.exponent) for time in CREEP_TIMES])
        p[GROWTHS:MODAL] = growths * parameters.creep / product(growths, _decayed(0.1) - _decayed(10.0))
        shares = (1.0 - parameters.share, parameters.share)
        for mode, values in enumerate(zip(parameters.frequencies, parameters.dampings, shares, strict=True)):
            p[MODAL + A_MODE * mode : MODAL + A_MODE * (mode + 1)] = _mode(*values, step)
        return p

    @staticmethod
    def _pack_hysteresis(p: np.ndarray, parameters: ForeignParameters, step: float) -> None:
        opening, asymmetry = parameters.opening, parameters.asymmetry
        if parameters.hysteresis in ("play", "preisach"):
            place = np.arange(1, PLAYS + 1) / PLAYS
            weights = np.array([elementary.exp(-2.0 * one) for one in place])
            weights *= 0.4 / product(weights, np.ones(PLAYS))
            # rising and falling branches each lag by a threshold
            p[THRESHOLDS:WEIGHTS] = place * opening / (2.0 * product(place, weights))
            p[WEIGHTS:CURVATURES] = weights
            p[LINEAR] = 0.6
            if parameters.hysteresis == "play":
                p[CURVE], p[RATE], p[KNEE] = asymmetry, parameters.rate, SPEED_KNEE * step
            else:
                # a density that varies along both coordinates
                p[CURVATURES:DECAYS] = asymmetry * 2.0 * (1.0 - 1.5 * place)
                p[KNEE] = 1.0
            p[MEMORY] = elementary.exp(-step / SPEED_MEMORY)
            return
        p[LINEAR], p[SQUARE] = 1.0 + 0.5 * asymmetry, -0.5 * asymmetry
        if parameters.hysteresis == "bouc_wen":
            p[TURN] = 5.0
            p[SWING], p[SKEW] = 0.5 * opening * p[TURN], asymmetry * p[TURN]
            p[LINEAR] += 0.5 * opening
        else:
            p[SWING] = 0.7
            p[TURN] = 2.0 * (1.0 - p[SWING]) / opening if opening else 1e3

    def initial_state(self) -> np.ndarray:
        """Return the state at rest at 0 V."""
        return np.zeros(STATES)

    def between(self, voltage) -> np.ndarray:
        """Return the displacement [m] on the fine grid, shape (N, steps), from rest; the block's state is not used.

        Units: ``voltage`` [V].
        """
        voltage = np.ascontiguousarray(voltage, dtype=float)
        found = np.empty((len(voltage), self.parameters.steps))
        compiled(follow)(self.p, self.initial_state(), voltage, found)
        return found


def _decayed(time: float) -> np.ndarray:
    """Return the remaining fraction of each relaxation of the creep after a time [s], shape (relaxations,)."""
    return np.array([elementary.exp(-time / constant) for constant in CREEP_TIMES])


def _mode(frequency: float, damping: float, share: float, step: float) -> np.ndarray:
    """Return A (4), B (2) and share of a mode of unit gain whose first state is its displacement."""
    angular = 2.0 * np.pi * frequency
    A = np.array([[0.0, angular], [-angular, -2.0 * damping * angular]])
    Ad, Bd = zero_order_hold(A, np.array([0.0, angular]), step)
    return np.concatenate([Ad.ravel(), Bd[:, 0], [share]])
