# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Force sensor in series with the stack of an actuator: what it reads follows exactly from the dynamics.

The stage is a mass m on a flexure k_f and a damper c, moved by a stack of stiffness k_a whose free stroke is δ [1]_:

m y″ + c y′ + k_f y = F,  F = k_a (δ − y)

At rest y = k_a δ/(k_a + k_f), which is the displacement d that hysteresis and creep give and the dynamics, of unit gain
at rest, make y of. So the force needs no dynamics of its own whatever is between d and y, if y is where the stack is:

F = (k_a + k_f) d − k_a y

with k_f y at rest, and zeros at ω √(k_f/(k_a + k_f)), below the poles at ω. Like the displacement it is read before the
voltage of its sample changes: d is what has acted until then, behind amplifier and delay. The preload is not in it.

A piezoelectric sensor with its amplifier loses what is constant: a first-order high-pass, of the samples here.

References
----------
.. [1] Preumont, Vibration Control of Active Structures, 3rd ed. 2011, chapters 5 and 7 (collocated force feedback).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import called, kernel
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import linear
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.sensor import generator_state, normal
from hysteresis_ros.models.state_space import accumulate
from hysteresis_ros.parameters import Parameters, parameter

# Layout of p, empty where there is no sensor; the row that d is of the dynamics' states follows.
NOISE = 0  # [N] rms
WHOLE = 1  # k_a + k_f [N/m]
STACK = 2  # k_a [N/m]
RATE = 3  # part of the force that the high-pass takes off a sample later; 0: there is none
THROUGH = 4  # part of d that is of the input itself
ROW = 5

# Layout of x: eight numbers of the noise's generator, then
ACTING = 8  # d [m], acting since the last sample
SLOW = 9  # what the high-pass takes off [N]
STATES = 10


@dataclass(frozen=True)
class ForceParameters(Parameters):
    """Stack and flexure of a stage with a force sensor, and how slow a force the sensor reads."""

    stack_stiffness: float = parameter(
        0.0, unit="N/m", low=0.0, high=1e12, description="of the stack with its force sensor; 0: there is no sensor"
    )
    flexure_stiffness: float = parameter(
        0.0, unit="N/m", low=0.0, high=1e12, description="of the flexure that the stack pushes against"
    )
    high_pass: float = parameter(
        0.0, unit="Hz", low=0.0, description="corner below which the sensor reads nothing (charge amplifier); 0: none"
    )

    def check(self):
        """Yield that a stage has no flexure."""
        if self.stack_stiffness and not self.flexure_stiffness:
            allowed = "must be above 0: a stack that pushes against nothing has no force at rest"
            yield Problem("flexure_stiffness", self.flexure_stiffness, allowed)

    @property
    def there(self) -> bool:
        """Whether there is a sensor."""
        return self.stack_stiffness > 0.0

    @property
    def whole(self) -> float:
        """Stiffness of stack and flexure together [N/m]."""
        return self.stack_stiffness + self.flexure_stiffness

    def require_same(self, present: ForceParameters) -> None:
        """Refuse a sensor that comes or goes while running.

        Parameters
        ----------
        present : ForceParameters

        Raises
        ------
        ParameterError
        """
        if self.there != present.there:
            allowed = f"must stay {'above' if present.there else 'at'} 0 while running: clean up and configure anew"
            raise ParameterError([Problem("force_sensor.stack_stiffness", self.stack_stiffness, allowed)])

    def slow_part(self, sample_time: float) -> float:
        """Return which part of the force the high-pass has taken off a sample later.

        Parameters
        ----------
        sample_time : float
            [s]
        """
        return -elementary.expm1(-2.0 * math.pi * self.high_pass * sample_time)


@dataclass(frozen=True)
class ForceSensorParameters(ForceParameters):
    """A force sensor in series with the stack."""

    noise: float = parameter(0.0, unit="N", low=0.0, description="standard deviation of white Gaussian noise")
    seed: int = parameter(2, description="seed of the noise; equal seeds give equal noise", low=0, read_only=True)


@kernel
def note_acting(p, x, dynamics_x, u):
    """Keep what acts on the dynamics of state ``dynamics_x`` in the sample in which their input is ``u`` [m]."""
    n = p.shape[0] - ROW
    if n >= 0:
        x[ACTING] = accumulate(p[THROUGH] * u, p, ROW, dynamics_x, linear.STATE, n)


@called
def force_reading(p, x, displacement):
    """Return what the sensor reads [N] while the dynamics are at ``displacement`` [m]; NaN: there is none."""
    if p.shape[0] == 0:
        return math.nan
    reading = p[WHOLE] * x[ACTING] - p[STACK] * displacement - x[SLOW]
    x[SLOW] += p[RATE] * reading
    if p[NOISE] > 0.0:
        reading += p[NOISE] * normal(x)
    return reading


def pack_force(parameters: ForceSensorParameters, dynamics: LinearParameters, sample_time: float) -> np.ndarray:
    """Return the parameter array of a force sensor, empty where there is none.

    Parameters
    ----------
    parameters : ForceSensorParameters
    dynamics : LinearParameters
        Between hysteresis and displacement.
    sample_time : float
        [s]
    """
    if not parameters.there:
        return np.zeros(0)
    row, through = dynamics.acting
    rest = dynamics.matrices.dc_gain * dynamics.output_scale
    head = [parameters.noise, parameters.whole, parameters.stack_stiffness, parameters.slow_part(sample_time)]
    return np.concatenate([head, [through * rest / dynamics.resolved_input_scale], row * rest])


def force_state(parameters: ForceSensorParameters) -> np.ndarray:
    """Return the state of a force sensor before the first sample, empty where there is none.

    Parameters
    ----------
    parameters : ForceSensorParameters
    """
    if not parameters.there:
        return np.zeros(0)
    x = np.zeros(STATES)
    x[:6] = generator_state(parameters.seed)
    return x


def settle_force(p: np.ndarray, x: np.ndarray, acting: float, displacement: float) -> None:
    """Put a sensor to rest.

    Parameters
    ----------
    p, x : ndarray
        Changed in place.
    acting : float
        What acts on the dynamics [m].
    displacement : float
        At which they rest [m].
    """
    if p.size:
        x[ACTING] = acting
        x[SLOW] = p[WHOLE] * acting - p[STACK] * displacement if p[RATE] > 0.0 else 0.0
