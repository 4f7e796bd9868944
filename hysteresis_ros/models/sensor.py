# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sensors: displacement with offset, noise and resolution, and force in series with the stack of an actuator.

The noise comes from a generator whose state is part of the block's, so that a run can be repeated and continued bit for
bit: MRG32k3a of L'Ecuyer (Operations Research 47(1), 1999, figure I), whose integers are exact in float64.

The stage is a mass m on a flexure k_f and a damper c, moved by a stack of stiffness k_a and free stroke δ [1]_:

m y″ + c y′ + k_f y = F,  F = k_a (δ − y)

Let d be the displacement from hysteresis and creep. The dynamics from d to y have unit DC gain, so at rest y = k_a
δ/(k_a + k_f) equals d. So for any dynamics between d and y the force needs no dynamics of its own, if y is the position
of the stack:

F = (k_a + k_f) d − k_a y

At rest the force is k_f y. Its zeros are at ω √(k_f/(k_a + k_f)), below the poles at ω. Like the displacement, the
force is read before the voltage of its sample changes: d is the displacement that has acted until then, after amplifier
and delay, without the preload.

A piezoelectric sensor with its amplifier does not measure constant forces: its model is a discrete first-order
high-pass.

References
----------
.. [1] Preumont, Vibration Control of Active Structures, 3rd ed. 2011, chapters 5 and 7 (collocated force feedback).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import elementary, linear
from hysteresis_ros.models.block import Block, called, kernel
from hysteresis_ros.models.linear import LinearParameters, accumulate

# Layout of p.
NOISE = 0
RESOLUTION = 1
OFFSET = 2

# Layout of x: six words of the generator, the second normal number of the last pair, a flag for it, the last reading.
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
    """Return the six words of MRG32k3a for ``seed`` ≥ 0, shape (6,): SplitMix64 spreads the seed over their ranges."""
    words, state = [], seed
    for modulus in (int(MODULUS_1),) * 3 + (int(MODULUS_2),) * 3:
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        mixed = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) % 2**64
        words.append(1 + (mixed ^ (mixed >> 31)) % (modulus - 1))  # never 0: three zeros would stay zero
    return np.array(words, dtype=np.float64)


@kernel
def uniform(x):
    """Return the next number in (0, 1) of MRG32k3a with the words ``x[0:6]``; all products are below 2⁵³ and exact."""
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
    """Return the next standard normal number; Box-Muller gives two, and the state stores the second."""
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


# Layout of p, empty without a sensor; the row from the dynamics' states to d follows.
FORCE_NOISE = 0  # [N] rms
WHOLE = 1  # k_a + k_f [N/m]
STACK = 2  # k_a [N/m]
RATE = 3  # fraction of the force that the high-pass removes one sample later; 0: no high-pass
THROUGH = 4  # feedthrough from the input to d
ROW = 5

# Layout of x: eight numbers of the noise's generator, then
ACTING = 8  # d [m], which has acted since the last sample
SLOW = 9  # slow component of the force, which the high-pass removes [N]
FORCE_STATES = 10


@dataclass(frozen=True)
class ForceParameters(Parameters):
    """Stiffnesses of stack and flexure of a stage with a force sensor, and the sensor's high-pass."""

    stack_stiffness: float = parameter(
        0.0, unit="N/m", low=0.0, high=1e12, description="stiffness of the stack with its force sensor; 0: no sensor"
    )
    flexure_stiffness: float = parameter(
        0.0, unit="N/m", low=0.0, high=1e12, description="stiffness of the flexure against which the stack pushes"
    )
    high_pass: float = parameter(
        0.0, unit="Hz", low=0.0, description="corner of the sensor's high-pass (charge amplifier); 0: none"
    )

    def check(self):
        """Yield a Problem when a stage with a force sensor has no flexure."""
        if self.stack_stiffness and not self.flexure_stiffness:
            remedy = "must be above 0: without a flexure the stack has no force at rest"
            yield Problem("flexure_stiffness", self.flexure_stiffness, remedy)

    @property
    def there(self) -> bool:
        """Whether there is a sensor."""
        return self.stack_stiffness > 0.0

    @property
    def whole(self) -> float:
        """Stiffness of stack and flexure together [N/m]."""
        return self.stack_stiffness + self.flexure_stiffness

    def require_same(self, present: ForceParameters) -> None:
        """Raise ParameterError to add or remove the sensor while running."""
        if self.there != present.there:
            remedy = f"must stay {'above' if present.there else 'at'} 0 while running: clean up and configure again"
            raise ParameterError([Problem("force_sensor.stack_stiffness", self.stack_stiffness, remedy)])

    def slow_part(self, sample_time: float) -> float:
        """Return the fraction of the force that the high-pass removes one sample later."""
        return -elementary.expm1(-2.0 * math.pi * self.high_pass * sample_time)


@dataclass(frozen=True)
class ForceSensorParameters(ForceParameters):
    """A force sensor in series with the stack."""

    noise: float = parameter(0.0, unit="N", low=0.0, description="standard deviation of white Gaussian noise")
    seed: int = parameter(2, description="seed of the noise; equal seeds give equal noise", low=0, read_only=True)


@kernel
def note_acting(p, x, dynamics_x, u):
    """Store the displacement d acting on the dynamics with state ``dynamics_x`` and input ``u`` [m] in this sample."""
    n = p.shape[0] - ROW
    if n >= 0:
        x[ACTING] = accumulate(p[THROUGH] * u, p, ROW, dynamics_x, linear.STATE, n)


@called
def force_reading(p, x, displacement):
    """Return the sensor's reading [N] while the dynamics are at ``displacement`` [m]; NaN: no sensor."""
    if p.shape[0] == 0:
        return math.nan
    reading = p[WHOLE] * x[ACTING] - p[STACK] * displacement - x[SLOW]
    x[SLOW] += p[RATE] * reading
    if p[FORCE_NOISE] > 0.0:
        reading += p[FORCE_NOISE] * normal(x)
    return reading


def pack_force(parameters: ForceSensorParameters, dynamics: LinearParameters, sample_time: float) -> np.ndarray:
    """Return the parameter array of a force sensor; empty if there is no sensor.

    ``dynamics`` are those between hysteresis and displacement. Units: ``sample_time`` [s].
    """
    if not parameters.there:
        return np.zeros(0)
    row, through = dynamics.acting
    rest = dynamics.matrices.dc_gain * dynamics.output_scale
    head = [parameters.noise, parameters.whole, parameters.stack_stiffness, parameters.slow_part(sample_time)]
    return np.concatenate([head, [through * rest / dynamics.resolved_input_scale], row * rest])


def force_state(parameters: ForceSensorParameters) -> np.ndarray:
    """Return the state of a force sensor before the first sample; empty if there is no sensor."""
    if not parameters.there:
        return np.zeros(0)
    x = np.zeros(FORCE_STATES)
    x[:6] = generator_state(parameters.seed)
    return x


def settle_force(p: np.ndarray, x: np.ndarray, acting: float, displacement: float) -> None:
    """Set the arrays of a force sensor to its steady state, in place.

    ``acting`` is the displacement d that acts on the dynamics, ``displacement`` their steady-state displacement [m].
    """
    if p.size:
        x[ACTING] = acting
        x[SLOW] = p[WHOLE] * acting - p[STACK] * displacement if p[RATE] > 0.0 else 0.0
