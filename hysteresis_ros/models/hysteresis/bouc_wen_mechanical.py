# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Bouc-Wen oscillator: the hysteretic force is part of the equation of motion (Noël & Schoukens' benchmark).

.. math::

   m \ddot y + c \dot y + k y + z = u, \qquad
   \dot z = \alpha \dot y - \beta \left( \gamma |\dot y| |z|^{\nu - 1} z + \delta \dot y |z|^\nu \right)

The hysteretic force depends on the velocity and also affects it. Therefore this model is one block with internal
feedback, not a hysteresis followed by linear dynamics. It is integrated by the classical Runge-Kutta method in equal
substeps of the sample time.

References
----------
.. [1] Noël & Schoukens, Hysteretic benchmark with a dynamic nonlinearity, doi 10.4121/12967592.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.declaration import (
    DISPLACEMENT,
    VOLTAGE,
    Deviation,
    HysteresisBlock,
    HysteresisModel,
    Option,
    times,
)

# Layout of p.
INVERSE_MASS = 0
DAMPING = 1
STIFFNESS = 2
ALPHA = 3
BETA_GAMMA = 4
BETA_DELTA = 5
EXPONENT = 6
FORCE_PER_INPUT = 7
SUBSTEP = 8  # [s]
SUBSTEPS = 9
LINEAR = 10  # 1: linear input between samples; 0: held input

# Layout of x; VOLTAGE (the last input) and DISPLACEMENT come first.
VELOCITY = 2
Z = 3  # hysteretic force [N]
STARTED = 4
STATES = 5

#: Largest product of substep and highest angular frequency of the oscillator; the method is stable up to 2.8.
LARGEST_STEP = 1.5


@dataclass(frozen=True)
class BoucWenMechanicalParameters(Parameters):
    """Parameters of the Bouc-Wen oscillator, with the names of the benchmark."""

    mass: float = parameter(description="m", unit="kg", low=1e-15)
    damping: float = parameter(description="c", unit="N·s/m", low=0.0)
    stiffness: float = parameter(description="k", unit="N/m", low=1e-15)
    alpha: float = parameter(description="α: stiffness of the hysteretic force z at z = 0", unit="N/m", low=0.0)
    beta: float = parameter(description="β: factor on both γ and δ", unit="1/m (N^(1-ν)/m for exponent ν)")
    gamma: float = parameter(description="γ of |y'| |z|^(ν-1) z")
    delta: float = parameter(description="δ of y' |z|^ν")
    exponent: float = parameter(1.0, description="exponent ν", low=1.0, high=20.0)
    force_per_input: float = parameter(1.0, description="force per unit of input; 1 for an input in N", unit="N/V")
    intersample: str = parameter(
        "zoh",
        choices=("zoh", "linear"),
        description="input between samples: zoh (held, as a converter does) or linear",
        read_only=True,
    )
    substeps: int = parameter(4, description="integration steps per sample", low=1, high=10000)

    def check(self):
        """Yield a Problem if the input has no effect."""
        if self.force_per_input == 0.0:
            yield Problem("force_per_input", 0.0, "must not be 0")

    def warnings(self, prefix: str = "") -> tuple[str, ...]:
        """Return a warning if the hysteretic force is unbounded."""
        total = self.beta * (self.gamma + self.delta)
        steady = self.beta * (self.gamma - self.delta)
        if total <= 0.0 and steady <= 0.0:
            return (
                f"{prefix}beta (gamma + delta) = {total:.4g} and beta (gamma - delta) = {steady:.4g}: z is unbounded",
            )
        return ()


@kernel
def _force_rate(p, velocity, z):
    """Return the rate z' [N/s] of the hysteretic force."""
    n = p[EXPONENT]
    size = abs(z)
    power = size if n == 1.0 else elementary.pow(size, n)
    signed = power if z > 0.0 else -power
    return p[ALPHA] * velocity - (p[BETA_GAMMA] * abs(velocity) * signed + p[BETA_DELTA] * velocity * power)


@kernel
def _acceleration(p, force, y, velocity, z):
    return (force - p[DAMPING] * velocity - p[STIFFNESS] * y - z) * p[INVERSE_MASS]


@kernel
def _advance(p, x, start, end):
    """Integrate over one sample, in which the input goes from ``start`` to ``end``."""
    step, count = p[SUBSTEP], int(p[SUBSTEPS])
    force_per_input = p[FORCE_PER_INPUT]
    rise = (end - start) / count
    y, v, z = x[DISPLACEMENT], x[VELOCITY], x[Z]
    half = 0.5 * step
    for i in range(count):
        first = force_per_input * (start + rise * i)
        middle = force_per_input * (start + rise * (i + 0.5))
        last = force_per_input * (start + rise * (i + 1.0))
        a1, r1 = _acceleration(p, first, y, v, z), _force_rate(p, v, z)
        v2, z2 = v + half * a1, z + half * r1
        a2, r2 = _acceleration(p, middle, y + half * v, v2, z2), _force_rate(p, v2, z2)
        v3, z3 = v + half * a2, z + half * r2
        a3, r3 = _acceleration(p, middle, y + half * v2, v3, z3), _force_rate(p, v3, z3)
        v4, z4 = v + step * a3, z + step * r3
        a4, r4 = _acceleration(p, last, y + step * v3, v4, z4), _force_rate(p, v4, z4)
        y += step * ((v + v4) + 2.0 * (v2 + v3)) / 6.0
        v += step * ((a1 + a4) + 2.0 * (a2 + a3)) / 6.0
        z += step * ((r1 + r4) + 2.0 * (r2 + r3)) / 6.0
    x[DISPLACEMENT], x[VELOCITY], x[Z] = y, v, z


@kernel
def bouc_wen_mechanical(p, x, u):
    """Return the displacement [m] at the end of the sample (held input) or at the time of ``u`` (linear input).

    A held ``u`` acts during the sample that begins now, as in :func:`hysteresis_ros.models.linear.linear`. A linear
    input goes from its last value to ``u``; the first call has no last value and returns the displacement at the start.
    NaN changes nothing.
    """
    if u != u:
        return x[DISPLACEMENT]
    if p[LINEAR] == 0.0:
        _advance(p, x, u, u)
    elif x[STARTED] != 0.0:
        _advance(p, x, x[VOLTAGE], u)
    x[STARTED] = 1.0
    x[VOLTAGE] = u
    return x[DISPLACEMENT]


class BoucWenOscillator(HysteresisBlock):
    """Mass on a linear and a hysteretic spring: force [N] or voltage [V] to displacement [m].

    In an actuator, it is used as a hysteresis without further dynamics. It is rate dependent, so it works only with the
    inverse ``none``. A change of parameters keeps position, velocity and force, so that the output does not jump.

    Parameters
    ----------
    parameters : BoucWenMechanicalParameters
        Mass, damping, stiffness and the hysteretic force.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        A parameter is wrong, or the substeps are too long for the oscillator's frequency.
    """

    kernel = staticmethod(bouc_wen_mechanical)

    def pack(self, parameters: BoucWenMechanicalParameters) -> np.ndarray:
        """Return p, shape (11,)."""
        given = parameters
        step = self.sample_time / given.substeps
        frequency = math.sqrt((given.stiffness + given.alpha) / given.mass) + given.damping / given.mass
        if step * frequency > LARGEST_STEP:
            needed = math.ceil(self.sample_time * frequency / LARGEST_STEP)
            raise ParameterError(
                [Problem("substeps", given.substeps, f"must be at least {needed} at this sample time")]
            )
        return np.array(
            [
                *(1.0 / given.mass, given.damping, given.stiffness, given.alpha),
                *(given.beta * given.gamma, given.beta * given.delta, given.exponent, given.force_per_input),
                *(step, given.substeps, given.intersample == "linear"),
            ],
            dtype=np.float64,
        )

    def initial_state(self) -> np.ndarray:
        """Return x, shape (5,), at rest."""
        return np.zeros(STATES)

    def response(self, u) -> np.ndarray:
        """Return the displacement, shape (N,), *at* the times of the inputs ``u``, shape (N,).

        The first value is the displacement of the present state, both for a held and for a linear input.
        """
        if self.parameters.intersample == "linear":
            return self.simulate(u)
        return np.append(self.x[DISPLACEMENT], self.simulate(np.asarray(u)[:-1]))

    @property
    def gain(self) -> float:
        """Nominal gain: static displacement divided by the input, at zero hysteretic force [m per input unit]."""
        return float(self.p[FORCE_PER_INPUT] / (self.p[STIFFNESS] + self.p[ALPHA]))


def _scaled(parameters: BoucWenMechanicalParameters, factor: float) -> BoucWenMechanicalParameters:
    """Scale the displacement: divide mass, damping, stiffness and hysteretic force by the factor."""
    return times(parameters, 1.0 / factor, "mass", "damping", "stiffness", "alpha", "beta")


def _deviated(parameters: BoucWenMechanicalParameters, deviation: Deviation) -> BoucWenMechanicalParameters:
    """Apply a random factor to each parameter; gain and loop width follow from them."""
    names = ("mass", "damping", "stiffness", "alpha", "beta", "gamma", "delta")
    return replace(parameters, **{name: getattr(parameters, name) * deviation.factor() for name in names})


MODEL = HysteresisModel(
    name="bouc_wen_mechanical",
    title="Bouc-Wen force inside a mass-damper-spring equation (grey box, by output error)",
    data="a dynamic excitation that passes the resonance, e.g. a multisine",
    parameters=BoucWenMechanicalParameters,
    block=BoucWenOscillator,
    example=BoucWenMechanicalParameters(
        mass=0.5,
        damping=80.0,
        stiffness=1e6,
        alpha=0.3e6,
        beta=0.4e6,
        gamma=0.8,
        delta=-0.3,
        force_per_input=0.12,
    ),
    scaled=_scaled,
    deviated=_deviated,
    inverses=("none",),
    identify="hysteresis_ros.identification.procedures:bouc_wen_mechanical",
    parts=(),
    stages=False,
    response="hysteresis_ros.identification.bouc_wen:simulate_oscillator",
    options={
        "mass": Option(float, "initial value [kg]"),
        "damping": Option(float, "initial value [N·s/m]"),
        "stiffness": Option(float, "initial value [N/m]"),
        "alpha": Option(float, "initial value [N/m]"),
        "beta": Option(float, "initial value [1/m]; only its products with γ and δ are fitted"),
        "gamma": Option(float, "initial value"),
        "delta": Option(float, "initial value"),
        "exponent": Option(float, "exponent ν, not fitted"),
        "trials": Option(int, "trial points around the initial values", low=0),
        "seed": Option(int, "seed of the random starts", low=0),
    },
)
