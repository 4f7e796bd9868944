# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Creep: slow drift after a step, modelled by first-order operators in series with the hysteresis; inverse creep.

``y = d x + Σ a_i z_i``, ``τ_i z_i' = x - z_i``. The logarithmic law ``ΔL (1 + γ lg(t/t_0))`` of piezo data sheets (γ =
0.01 … 0.02 per decade, t_0 = 0.1 s) is realised by operators with equal weights and with time constants in a geometric
sequence; d is chosen so that the response to a unit step is exactly 1 at t_0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import Block, interpreted, kernel
from hysteresis_ros.models.declaration import require_structure
from hysteresis_ros.models.linear_algebra import product

# Layout of p, followed by the factors e^(-Ts/τ) and by the weights a.
FEEDTHROUGH = 0
OPERATORS = 1
DECAYS = 2

# Layout of x: the last output, then the operators z.
OUTPUT = 0
OPERATOR = 1

#: The time constants of the logarithmic law extend this number of decades beyond both ends of its time range.
MARGIN = 2.0


@dataclass(frozen=True)
class LogarithmicCreepParameters(Parameters):
    """Creep ΔL (1 + γ lg(t/t_0)) after a step."""

    rate: float = parameter(description="γ: creep per decade of time, as a fraction of the step", low=0.0, high=0.2)
    reference_time: float = parameter(
        0.1, description="t_0: time after a unit step at which the response is defined as 1", unit="s", low=1e-6
    )
    longest_time: float = parameter(1000.0, description="time up to which the law holds", unit="s", low=1e-6)
    operators_per_decade: int = parameter(2, description="operators per decade", low=1, high=10, read_only=True)

    def check(self):
        """Yield a Problem if the time range is empty."""
        if self.longest_time <= self.reference_time:
            remedy = f"must be above reference_time = {self.reference_time:g} s"
            yield Problem("longest_time", self.longest_time, remedy)

    def operators(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the feedthrough d, the weights a and the time constants τ [s]."""
        per_decade = self.operators_per_decade
        decades = math.log10(self.longest_time / self.reference_time) + 2.0 * MARGIN
        # rounded, so that the last digit of a logarithm does not affect the number of operators
        places = [i / per_decade - MARGIN for i in range(math.ceil(round(decades * per_decade, 9)) + 1)]
        time_constants = np.array([self.reference_time * elementary.pow(10.0, place) for place in places])
        weights = np.full(len(places), self.rate / per_decade)
        risen = [-elementary.expm1(-self.reference_time / time_constant) for time_constant in time_constants]
        return 1.0 - float(product(weights, risen)), weights, time_constants


@dataclass(frozen=True)
class CreepOperatorsParameters(Parameters):
    """Creep as a sum of first-order operators with given weights and time constants."""

    weights: tuple[float, ...] = parameter(description="weights a, as fractions of the step")
    time_constants: tuple[float, ...] = parameter(description="time constants τ", unit="s", low=1e-9)

    def check(self):
        """Yield a Problem if the numbers of weights and time constants differ."""
        if len(self.weights) != len(self.time_constants):
            yield Problem(
                "weights", self.weights, f"must be as many numbers as time_constants ({len(self.time_constants)})"
            )

    def operators(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the feedthrough 1, the weights a and the time constants τ [s]."""
        return 1.0, np.array(self.weights), np.array(self.time_constants)


@dataclass(frozen=True)
class CreepParameters(Parameters):
    """Type of creep and its parameters."""

    type: str = parameter("none", choices=("none", "logarithmic", "operators"), description="creep law", read_only=True)
    logarithmic: LogarithmicCreepParameters = group(LogarithmicCreepParameters, variant_of="type")
    operators: CreepOperatorsParameters = group(CreepOperatorsParameters, variant_of="type")

    def resolved(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Return feedthrough, weights and time constants [s] of the chosen law."""
        if self.type == "none":
            return 1.0, np.zeros(0), np.zeros(0)
        return getattr(self, self.type).operators()

    @property
    def structure(self) -> dict[str, int | str]:
        """Structure that cannot change while running."""
        return {"creep.type": self.type, "number of creep operators": len(self.resolved()[1])}

    def check(self):
        """Yield a Problem if the immediate part of a step is too small for an inverse."""
        feedthrough, weights, _ = self.resolved()
        if feedthrough <= 0.0:
            remedy = (
                f"the immediate part of a unit step is {feedthrough:.3g}; it must be > 0: lower rate or longest_time"
            )
            yield Problem("logarithmic.rate", self.logarithmic.rate, remedy)
        elif feedthrough + min(np.cumsum(weights), default=0.0) <= 0.0:
            yield Problem(
                "operators.weights",
                self.operators.weights,
                "must have partial sums above -1, or creep cancels a step; bring the negative weights closer to 0",
            )


@kernel
def crept(p, x):
    """Return Σ a z over the operators, which is the creep in the output at this sample [m]."""
    count = int(p[OPERATORS])
    total = 0.0
    for i in range(count):
        total += p[DECAYS + count + i] * x[OPERATOR + i]
    return total


@kernel
def creep(p, x, u):
    """Return the output [m] at this sample for the displacement ``u`` [m], which is held until the next sample.

    Without operators, the output is ``u``, bit for bit.
    """
    y = p[FEEDTHROUGH] * u + crept(p, x)
    for i in range(int(p[OPERATORS])):
        x[OPERATOR + i] = u + p[DECAYS + i] * (x[OPERATOR + i] - u)
    x[OUTPUT] = y
    return y


class Creep(Block):
    """Creep from displacement [m] to displacement [m].

    Parameters
    ----------
    parameters : CreepParameters
        Law and numbers.
    sample_time : float
        Sample time [s].
    """

    kernel = staticmethod(creep)

    def pack(self, parameters: CreepParameters) -> np.ndarray:
        """Return p, shape (2 + 2 operators,)."""
        feedthrough, weights, time_constants = parameters.resolved()
        decays = [elementary.exp(-self.sample_time / time_constant) for time_constant in time_constants]
        return np.concatenate([[feedthrough, len(weights)], decays, weights])

    def initial_state(self) -> np.ndarray:
        """Return the initial state x, shape (1 + operators,): at rest at zero displacement."""
        return np.zeros(OPERATOR + int(self.p[OPERATORS]))

    def settle(self, u: float) -> float:
        """Set the operators to their steady state for the displacement ``u`` [m], and return the output [m]."""
        self.x[OPERATOR:] = u
        self.x[OUTPUT] = self.p[FEEDTHROUGH] * u + interpreted(crept)(self.p, self.x)
        return float(self.x[OUTPUT])

    def retune(self, parameters: CreepParameters) -> None:
        """Change weights and time constants while running; the operators keep their values.

        Raises
        ------
        ParameterError
            The law or the number of operators differs, or the parameters are wrong; the block then remains unchanged.
        """
        require_structure(self.parameters, parameters.validated())
        super().retune(parameters)


@kernel
def creep_inverse(p, x, y):
    """Return the input [m] with which the creep model gives ``y`` [m] at this sample; its state ``x`` is not changed.

    The result is exact at the samples. The caller advances the model with the achieved displacement. Without operators,
    the result is ``y``, bit for bit.
    """
    return (y - crept(p, x)) / p[FEEDTHROUGH]
