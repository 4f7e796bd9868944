# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Limits of an amplifier and its converter: range, slew rate and quantisation of the voltage."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models.block import Block, interpreted, kernel

# Layout of p.
MINIMUM = 0
MAXIMUM = 1
SLEW = 2  # largest change per sample [V]; 0: unlimited
STEP = 3  # step of the converter's grid [V]; 0: no quantisation

# Layout of x.
OUTPUT = 0
FLAGS = 1
LIMITED_SAMPLES = 2
UNQUANTISED = 3

#: Bits of ``x[FLAGS]``.
RANGE, SLEWING, QUANTISED = 1, 2, 4
#: Excess over the range that does not count as limited, as a fraction of the range: less than a step of any converter.
NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class LimitsParameters(Parameters):
    """Range, slew rate and resolution of a voltage."""

    minimum: float = parameter(description="lowest voltage", unit="V")
    maximum: float = parameter(description="highest voltage", unit="V")
    slew_rate: float = parameter(0.0, description="largest change of the voltage; 0: unlimited", unit="V/s", low=0.0)
    bits: int = parameter(0, description="bits of the converter for this range; 0: no quantisation", low=0, high=32)

    def check(self):
        """Yield a Problem if the range is empty."""
        if not self.minimum < self.maximum:
            yield Problem("minimum", self.minimum, f"must be below maximum ({self.maximum:g} V)")


@kernel
def limits(p, x, u):
    """Return the output voltage [V] for the input ``u`` [V]: range, then slew rate, then the converter's grid.

    The slew rate acts on the value before quantisation; otherwise, a slow change would never leave its grid point. For
    NaN, the output keeps its last value, and the sample counts as out of range.
    """
    flags = 0.0
    last = x[UNQUANTISED]
    v = u
    if v != v:
        v = last
        flags += RANGE
    elif v < p[MINIMUM]:
        if v < p[MINIMUM] - NEGLIGIBLE * (p[MAXIMUM] - p[MINIMUM]):
            flags += RANGE
        v = p[MINIMUM]
    elif v > p[MAXIMUM]:
        if v > p[MAXIMUM] + NEGLIGIBLE * (p[MAXIMUM] - p[MINIMUM]):
            flags += RANGE
        v = p[MAXIMUM]
    slew = p[SLEW]
    if slew > 0.0:
        if v > last + slew:
            v = last + slew
            flags += SLEWING
        elif v < last - slew:
            v = last - slew
            flags += SLEWING
    x[UNQUANTISED] = v
    if flags > 0.0:
        x[LIMITED_SAMPLES] += 1.0
    step = p[STEP]
    if step > 0.0:
        grid = min(p[MINIMUM] + math.floor((v - p[MINIMUM]) / step + 0.5) * step, p[MAXIMUM])
        if grid != v:
            flags += QUANTISED
        v = grid
    x[FLAGS] = flags
    x[OUTPUT] = v
    return v


@kernel
def is_limited(x):
    """Return 1.0 if the range or the slew rate limited the last voltage; quantisation does not count."""
    return 1.0 if x[FLAGS] % 4.0 != 0.0 else 0.0


class Limits(Block):
    """Range, slew rate and quantisation of a voltage [V].

    Parameters
    ----------
    parameters : LimitsParameters
        Limits.
    sample_time : float
        Sample time [s], for the slew rate.
    """

    kernel = staticmethod(limits)

    def pack(self, parameters: LimitsParameters) -> np.ndarray:
        """Return p, shape (4,)."""
        span = parameters.maximum - parameters.minimum
        step = span / (2**parameters.bits - 1) if parameters.bits else 0.0
        return np.array([parameters.minimum, parameters.maximum, parameters.slew_rate * self.sample_time, step])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (4,): the voltage in the range and on the grid that is nearest to 0 V, and no flags."""
        v = min(max(0.0, self.p[MINIMUM]), self.p[MAXIMUM])
        x = np.array([v, 0.0, 0.0, v])
        unlimited = self.p.copy()
        unlimited[SLEW] = 0.0
        interpreted(limits)(unlimited, x, v)
        x[FLAGS] = x[LIMITED_SAMPLES] = 0.0
        return x

    @property
    def saturated(self) -> bool:
        """Whether the range or the slew rate limited the last voltage."""
        return bool(int(self.x[FLAGS]) & (RANGE | SLEWING))

    @property
    def limited_samples(self) -> int:
        """Number of samples so far in which the range or the slew rate limited the voltage."""
        return int(self.x[LIMITED_SAMPLES])
