# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plants that no model of the package describes, for tests from a recording to a closed loop.

voltage → delay → amplifier lag → plays whose radius grows with the rate and whose branches are curved differently
+ relays of a Preisach plane → creep → lags and modes in series → sensor noise. The chain is integrated in steps finer
than a sample; the measurement of a sample is taken before its voltage acts. ``fast`` compiles the loop if Numba exists.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

try:
    from numba import njit

    fast = functools.partial(njit, cache=True)
except ImportError:  # slower, otherwise the same

    def fast(function):
        """Return the function unchanged."""
        return function


#: Steps of the integration in one sample.
STEPS = 8


@dataclass(frozen=True)
class ForeignPlant:
    """A stage of about 12 µm at 100 V.

    Parameters
    ----------
    sample_rate : float
        [Hz]
    amplifier : float
        Time constant before the hysteresis [s].
    delay : float
        [s], in multiples of 1/8 of a sample.
    lag : float
        Time constant after the hysteresis [s].
    modes : tuple of (float, float, float)
        Frequency [Hz], damping, and the fraction of the displacement that passes through the mode (1: all of it).
    hysteresis : float
        Fraction of the displacement that is hysteretic; 0: a proportional stage.
    rate : float
        Time by which the radius of the plays grows with the slope of the voltage, relative to 100 V [s].
    creep : float
        Fraction of a step by which each of the two operators (0.3 s, 6 s) creeps.
    noise : float
        Standard deviation [m].
    """

    sample_rate: float = 2000.0
    amplifier: float = 0.0
    delay: float = 0.0
    lag: float = 0.0
    modes: tuple[tuple[float, float, float], ...] = ()
    hysteresis: float = 0.3
    rate: float = 0.0
    creep: float = 0.0
    noise: float = 2e-9

    def start(self) -> PlantRun:
        """Return a run from rest at 0 V."""
        return PlantRun(self)

    def record(self, voltage, seed: int = 0) -> np.ndarray:
        """Return the measured displacements [m], shape (N,), under voltages of one sample each [V]."""
        run = self.start()
        clean = run.advance(np.asarray(voltage, dtype=float))
        return clean + self.noise * np.random.default_rng(seed).standard_normal(len(clean))


class PlantRun:
    """The state of a running plant."""

    def __init__(self, plant: ForeignPlant):
        step = 1.0 / plant.sample_rate / STEPS
        radii = 45.0 * np.arange(1, 16) / 16.0
        edges = -10.0 + 120.0 * (np.arange(24) + 0.5) / 24.0
        up, down = (grid.ravel() for grid in np.meshgrid(edges, edges, indexing="ij"))
        kept = up > down
        up, down = up[kept], down[kept]
        density = np.exp(-((up - down) / 40.0) - ((up + down - 90.0) / 90.0) ** 2)
        self.sizes = np.array([plant.hysteresis, plant.rate / 100.0, plant.creep, step])
        self.lags = np.array([plant.amplifier, plant.lag])
        self.modes = np.array(plant.modes, dtype=float).reshape(-1, 3)
        self.plays = np.zeros((len(radii), 2))
        self.plays[:, 0] = radii
        self.relays = np.column_stack([up, down, np.zeros(len(up)), density / density.sum()])
        self.line = np.zeros(max(int(round(plant.delay / step)), 0) + 1)
        #: amplifier, its last value, creep 0.3 s and 6 s, lag, then position and velocity of each mode
        self.state = np.zeros(5 + 2 * len(self.modes))
        self.output = 0.0

    def advance(self, voltage) -> np.ndarray:
        """Return the displacements [m] before each voltage acts, shape (N,)."""
        found = np.empty(len(voltage))
        arrays = (self.sizes, self.lags, self.modes, self.plays, self.relays, self.line, self.state)
        self.output = _advance(np.ascontiguousarray(voltage), found, self.output, *arrays)
        return found


@fast
def _advance(voltage, found, output, sizes, lags, modes, plays, relays, line, state):
    step = sizes[3]
    for k in range(len(voltage)):
        found[k] = output
        for _ in range(STEPS):
            for i in range(len(line) - 1, 0, -1):
                line[i] = line[i - 1]
            line[0] = voltage[k]
            v = line[-1]
            state[1] = state[0]
            state[0] = v if lags[0] == 0.0 else v + np.exp(-step / lags[0]) * (state[0] - v)
            slope = abs(state[0] - state[1]) / step
            w = _static(state[0], slope, sizes, plays, relays)
            crept = w * (1.0 - sizes[2]) + sizes[2] * (state[2] + state[3])
            for i, tau in ((2, 0.3), (3, 6.0)):
                state[i] = w + np.exp(-step / tau) * (state[i] - w)
            state[4] = crept if lags[1] == 0.0 else crept + np.exp(-step / lags[1]) * (state[4] - crept)
            output = state[4]
            for j in range(len(modes)):
                omega = 2.0 * np.pi * modes[j, 0]
                x, rate = state[5 + 2 * j] - output, state[6 + 2 * j]
                # exact for a held input
                damped = omega * np.sqrt(1.0 - modes[j, 1] ** 2)
                decay = np.exp(-modes[j, 1] * omega * step)
                c, s = np.cos(damped * step), np.sin(damped * step) / damped
                state[5 + 2 * j] = output + decay * (c * x + s * (rate + modes[j, 1] * omega * x))
                state[6 + 2 * j] = decay * (c * rate - s * (modes[j, 1] * omega * rate + omega**2 * x))
                output = (1.0 - modes[j, 2]) * output + modes[j, 2] * state[5 + 2 * j]
    return output


@fast
def _static(v, slope, sizes, plays, relays):
    """Displacement [m] of plays, relays and the linear part."""
    widening = 1.0 + sizes[1] * slope
    played = 0.0
    for i in range(len(plays)):
        r = plays[i, 0] * widening
        above, below = v - r, 1.08 * v - 0.0008 * v * v + r
        plays[i, 1] = max(above, min(below, plays[i, 1]))
        played += plays[i, 1] / len(plays)
    switched = 0.0
    for i in range(len(relays)):
        if v >= relays[i, 0]:
            relays[i, 2] = 1.0
        elif v <= relays[i, 1]:
            relays[i, 2] = 0.0
        switched += relays[i, 3] * relays[i, 2]
    return 1.2e-7 * ((1.0 - sizes[0]) * v + sizes[0] * (0.6 * played + 40.0 * switched))
