# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Displacement sensor: offset, Gaussian noise and resolution.

The noise comes from a generator whose state is part of the block's, so that a run can be repeated and continued bit for
bit: MRG32k3a of L'Ecuyer (Operations Research 47(1), 1999, figure I), whose integers are exact in float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import Block, kernel
from hysteresis_ros.parameters import Parameters, parameter

# Layout of p.
NOISE = 0
RESOLUTION = 1
OFFSET = 2

# Layout of x: six words of the generator, the second normal of the last pair, whether there is one, the last reading.
GENERATOR = 0
SPARE = 6
HAS_SPARE = 7
MEASURED = 8
STATES = 9

MODULUS_1, MODULUS_2 = 4294967087.0, 4294944443.0


@dataclass(frozen=True)
class SensorParameters(Parameters):
    """Errors of a displacement sensor."""

    noise: float = parameter(0.0, description="standard deviation of white Gaussian noise", unit="m", low=0.0)
    resolution: float = parameter(0.0, description="smallest step of the reading; 0: none", unit="m", low=0.0)
    offset: float = parameter(0.0, description="constant error", unit="m")
    seed: int = parameter(1, description="seed of the noise; equal seeds give equal noise", low=0, read_only=True)


def generator_state(seed: int) -> np.ndarray:
    """Return the six words of MRG32k3a for ``seed`` ≥ 0, shape (6,): SplitMix64 spreads it over their ranges."""
    words, state = [], seed
    for modulus in (int(MODULUS_1),) * 3 + (int(MODULUS_2),) * 3:
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        mixed = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) % 2**64
        words.append(1 + (mixed ^ (mixed >> 31)) % (modulus - 1))  # never 0: three zeros would stay zero for ever
    return np.array(words, dtype=np.float64)


@kernel
def uniform(x):
    """Next number in (0, 1) of MRG32k3a with the words ``x[0:6]``; all products stay below 2⁵³ and are exact."""
    first = 1403580.0 * x[1] - 810728.0 * x[0]
    first -= math.floor(first / MODULUS_1) * MODULUS_1
    x[0] = x[1]
    x[1] = x[2]
    x[2] = first
    second = 527612.0 * x[5] - 1370589.0 * x[3]
    second -= math.floor(second / MODULUS_2) * MODULUS_2
    x[3] = x[4]
    x[4] = x[5]
    x[5] = second
    difference = first - second
    if difference <= 0.0:
        difference += MODULUS_1
    return difference * 2.328306549295727688e-10


@kernel
def normal(x):
    """Next standard normal number; Box-Muller gives two, the second waits in the state."""
    if x[HAS_SPARE] > 0.0:
        x[HAS_SPARE] = 0.0
        return x[SPARE]
    radius = math.sqrt(-2.0 * elementary.log(uniform(x)))
    angle = 2.0 * math.pi * uniform(x)
    x[SPARE] = radius * elementary.sin(angle)
    x[HAS_SPARE] = 1.0
    return radius * elementary.cos(angle)


@kernel
def sensor(p, x, displacement):
    """Reading [m] of a sensor at ``displacement`` [m]."""
    y = displacement + p[OFFSET]
    if p[NOISE] > 0.0:
        y += p[NOISE] * normal(x)
    resolution = p[RESOLUTION]
    if resolution > 0.0:
        y = math.floor(y / resolution + 0.5) * resolution
    x[MEASURED] = y
    return y


class Sensor(Block):
    """Displacement sensor with offset, noise and resolution [m].

    Parameters
    ----------
    parameters : SensorParameters
        Errors and seed.
    sample_time : float
        Sample time [s], not used: the noise is white.
    """

    kernel = staticmethod(sensor)

    def pack(self, parameters: SensorParameters) -> np.ndarray:
        """Return p, shape (3,)."""
        return np.array([parameters.noise, parameters.resolution, parameters.offset])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (9,), with the generator at the start of the seed's sequence."""
        x = np.zeros(STATES)
        x[GENERATOR : GENERATOR + 6] = generator_state(self.parameters.seed)
        return x
