# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Clamp of an inchworm motor: a normally open piezo that presses on the slider.

voltage → limits → hysteresis → lag → displacement d; the normal force is N = w · max(0, K (d - gap)), where K is the
combined stiffness of clamp and contact, and w the wear factor. Static friction can hold up to μ_s N; sliding friction
is μ_k N.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models import sensor as sensing
from hysteresis_ros.models.block import Chain, kernel
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.limits import FLAGS, OUTPUT, UNQUANTISED, Limits, LimitsParameters
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.models.sensor import Sensor, SensorParameters, sensor

# Layout of ps.contact; the sensor's own parameters come first.
GAP = 3  # [m]
STIFFNESS = 4  # [N/m], including the wear factor
STATIC = 5  # coefficients of friction
KINETIC = 6

# Layout of xs.contact; the sensor's own state comes first.
DISPLACEMENT = sensing.STATES  # [m]
NORMAL = sensing.STATES + 1  # normal force [N]


class ClampArrays(NamedTuple):
    """Parameter arrays, or state arrays, of a clamp; the array of the contact begins with the array of the sensor."""

    limits: np.ndarray
    hysteresis: np.ndarray
    lag: np.ndarray
    contact: np.ndarray


#: Number of samples of 1 ms after which a hysteresis model with internal dynamics is taken to be at rest.
RESTING_SAMPLES = 20000


@dataclass(frozen=True)
class FirstOrderParameters(Parameters):
    """Lag x' = (u - x)/T."""

    time_constant: float = parameter(description="time constant T", unit="s", low=1e-7, high=100.0)


@dataclass(frozen=True)
class SecondOrderParameters(Parameters):
    """Lag x'' + 2 ζ ω x' + ω² x = ω² u."""

    frequency: float = parameter(description="natural frequency ω/2π", unit="Hz", low=1e-2, high=1e6)
    damping: float = parameter(description="damping ratio ζ", low=1e-3, high=100.0)


@dataclass(frozen=True)
class LagParameters(Parameters):
    """Lag of a clamp: amplifier and mechanics together."""

    type: str = parameter(
        "first_order", choices=("first_order", "second_order"), description="order of the lag", read_only=True
    )
    first_order: FirstOrderParameters = group(FirstOrderParameters, variant_of="type")
    second_order: SecondOrderParameters = group(SecondOrderParameters, variant_of="type")

    def discrete(self, sample_time: float) -> LinearParameters:
        """Return the lag in discrete time, with unit DC gain, for an input that is held over ``sample_time`` [s]."""
        if self.type == "first_order":
            decay = elementary.exp(-sample_time / self.first_order.time_constant)
            return LinearParameters(A=(decay,), B=(1.0 - decay,), C=(1.0,))
        omega, damping = 2.0 * math.pi * self.second_order.frequency, self.second_order.damping
        # states: displacement and velocity/ω; the exponential of a 2 × 2 matrix has a closed form
        decay = damping * omega * sample_time
        turned = math.sqrt(abs(damping * damping - 1.0)) * omega * sample_time
        if damping < 1.0:
            fall, turned_once = elementary.exp(-decay), math.fmod(turned, 2.0 * math.pi)
            even, over = fall * elementary.cos(turned_once), fall * elementary.sin(turned_once)
        else:
            slow, fast = elementary.exp(turned - decay), elementary.exp(-turned - decay)
            even, over = 0.5 * (slow + fast), 0.5 * (slow - fast)
        odd = (over / turned if turned else even) * omega * sample_time
        A = (even + damping * odd, odd, -odd, even - damping * odd)
        return LinearParameters(A=A, B=(1.0 - A[0], -A[2]), C=(1.0, 0.0))

    def settling_time(self, tolerance: float = 0.02) -> float:
        """Return the time [s] from a step until the lag stays within ``tolerance``, a fraction of the step.

        Without overshoot the time is exact; for a damping ratio below 1, it is the settling time of the envelope.
        """
        if self.type == "first_order":
            return -self.first_order.time_constant * elementary.log(tolerance)
        omega, damping = 2.0 * math.pi * self.second_order.frequency, self.second_order.damping
        if damping < 1.0:
            return -elementary.log(tolerance * math.sqrt(1.0 - damping * damping)) / (damping * omega)
        root = math.sqrt(damping * damping - 1.0)
        slow, fast = omega / (damping + root), omega * (damping + root)

        def remaining(t):
            if fast - slow < 1e-6 * omega:
                return (1.0 + omega * t) * elementary.exp(-omega * t)
            return (fast * elementary.exp(-slow * t) - slow * elementary.exp(-fast * t)) / (fast - slow)

        low, high = 0.0, 1.0 / slow
        while remaining(high) > tolerance:
            high *= 2.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if remaining(middle) > tolerance else (low, middle)
        return high


@dataclass(frozen=True)
class ClampParameters(Parameters):
    """Parameters of one clamp with its amplifier and sensor."""

    limits: LimitsParameters = group(LimitsParameters)
    hysteresis: HysteresisParameters = group(HysteresisParameters)
    lag: LagParameters = group(LagParameters)
    gap: float = parameter(description="displacement at which the clamp touches the slider", unit="m", low=0.0)
    stiffness: float = parameter(
        description="normal force per displacement beyond the gap", unit="N/m", low=1.0, high=1e12
    )
    static_friction: float = parameter(description="coefficient of static friction", low=0.0, high=10.0)
    kinetic_friction: float = parameter(description="coefficient of kinetic friction", low=0.0, high=10.0)
    compliance: float = parameter(
        0.0,
        description="tangential compliance of the contact before it slides; 0: rigid",
        unit="m/N",
        low=0.0,
        high=1e-3,
        read_only=True,
    )
    kick: float = parameter(
        0.0,
        description="motion of the contact along the travel, per newton of normal force, while the clamp closes",
        unit="m/N",
        low=-1e-6,
        high=1e-6,
    )
    wear: float = parameter(1.0, description="factor on the normal force; 0.8: 20 % weaker", low=0.0, high=1.0)
    initial_voltage: float = parameter(0.0, description="voltage at the start and after a reset", unit="V")
    sensor: SensorParameters = group(SensorParameters)

    def check(self):
        """Yield a Problem for wrong friction, kick or initial voltage, or if the clamp never grips or never opens."""
        if self.kinetic_friction > self.static_friction:
            remedy = f"must not be above static_friction = {self.static_friction:g}"
            yield Problem("kinetic_friction", self.kinetic_friction, remedy)
        if self.kick != 0.0 and not self.compliance > 0.0:
            yield Problem("kick", self.kick, "needs a compliant contact: set compliance, e.g. 2e-8 m/N")
        low, high = self.limits.minimum, self.limits.maximum
        if not low <= self.initial_voltage <= high:
            remedy = f"must lie within limits.minimum … limits.maximum = {low:g} … {high:g} V"
            yield Problem("initial_voltage", self.initial_voltage, remedy)
        stroke, residual = self._displacements((high, low))
        if stroke <= self.gap:
            remedy = f"the clamp never grips: at limits.maximum = {high:g} V it reaches {stroke:.4g} m; narrow the gap"
            yield Problem("gap", self.gap, remedy)
        elif residual >= self.gap:
            remedy = (
                f"the clamp never opens: after {high:g} V, at limits.minimum = {low:g} V, its displacement is still "
                f"{residual:.4g} m; widen the gap"
            )
            yield Problem("gap", self.gap, remedy)

    def _displacements(self, voltages) -> list[float]:
        """Return the steady-state displacements [m] at the voltages [V], which are applied in the given order."""
        block = hysteresis_block(self.hysteresis, 1e-3)
        low, high = self.limits.minimum, self.limits.maximum
        limited = [min(max(voltage, low), high) for voltage in voltages]
        if block.rate_independent:
            return [float(block.step(voltage)) for voltage in limited]
        # a model with internal dynamics needs time to come to rest
        return [float(block.simulate(np.full(RESTING_SAMPLES, voltage))[-1]) for voltage in limited]

    def normal_force(self, voltage: float) -> float:
        """Return the steady-state normal force [N] at ``voltage`` [V].

        Because of hysteresis, the force depends on the history of the voltage. The result is the smaller of two forces:
        at the first closing, and at a closing after complete opening.
        """
        low = self.limits.minimum
        displacement = min(self._displacements((voltage, low, voltage))[::2])
        return self.wear * max(0.0, self.stiffness * (displacement - self.gap))

    def holding_force(self, voltage: float) -> float:
        """Return the load [N] that static friction can hold in steady state at ``voltage`` [V]."""
        return self.static_friction * self.normal_force(voltage)

    def settling_time(self, tolerance: float = 0.02) -> float:
        """Return the time [s] from a voltage step until the displacement stays within the fraction ``tolerance`` of it.

        If the slew rate is limited, the time for the whole voltage range at this rate is added, which gives an upper
        bound.
        """
        slew = self.limits.slew_rate
        ramp = (self.limits.maximum - self.limits.minimum) / slew if slew > 0.0 else 0.0
        return ramp + self.lag.settling_time(tolerance)


@kernel
def contact(p, x, displacement):
    """Return the normal force [N] of a clamp at ``displacement`` [m]."""
    x[DISPLACEMENT] = displacement
    x[NORMAL] = p[STIFFNESS] * max(0.0, displacement - p[GAP])
    return x[NORMAL]


class Clamp(Chain):
    """A clamp with amplifier and sensor; ``ps`` and ``xs`` are :class:`ClampArrays`.

    Parameters
    ----------
    parameters : ClampParameters
        Parameters, checked on construction.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        Parameters are wrong; the message states each wrong parameter.
    """

    def __init__(self, parameters: ClampParameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        self.limits = Limits(parameters.limits, sample_time)
        self.hysteresis = hysteresis_block(parameters.hysteresis, sample_time)
        self.lag = LinearDynamics(parameters.lag.discrete(sample_time), sample_time)
        self.sensor = Sensor(parameters.sensor, sample_time)
        p = np.concatenate([self.sensor.p, self._contact(parameters)])
        x = np.concatenate([self.sensor.x, np.zeros(2)])
        self.sensor.p, self.sensor.x = p[:GAP], x[:DISPLACEMENT]  # views: the sensor's block uses the same arrays
        self.ps = ClampArrays(self.limits.p, self.hysteresis.p, self.lag.p, p)
        self.xs = ClampArrays(self.limits.x, self.hysteresis.x, self.lag.x, x)
        self.hysteresis_kernel = self.hysteresis.kernel
        self._settle()

    @staticmethod
    def _contact(parameters: ClampParameters) -> np.ndarray:
        friction = (parameters.static_friction, parameters.kinetic_friction)
        return np.array([parameters.gap, parameters.stiffness * parameters.wear, *friction])

    def _settle(self) -> None:
        """Set all states to the steady state for the initial voltage."""
        self.limits.x[UNQUANTISED] = (
            self.parameters.initial_voltage
        )  # so that the slew rate does not limit the first step
        start = self.hysteresis.step(self.limits.step(self.parameters.initial_voltage))
        self.limits.x[FLAGS] = 0.0
        self.lag.settle(start)
        contact(self.ps.contact, self.xs.contact, self.lag.output())
        self.xs.contact[sensing.MEASURED] = self.displacement + self.ps.contact[sensing.OFFSET]

    def measure(self) -> float:
        """Return the reading [m] of the sensor; call it once per sample, because each call generates noise."""
        return sensor(self.ps.contact, self.xs.contact, self.displacement)

    def advance(self, voltage: float) -> float:
        """Hold ``voltage`` [V] for one sample; return the normal force [N] at the end of the sample."""
        displacement = self.lag.step(self.hysteresis.step(self.limits.step(voltage)))
        return contact(self.ps.contact, self.xs.contact, displacement)

    @property
    def displacement(self) -> float:
        """True displacement [m]."""
        return float(self.xs.contact[DISPLACEMENT])

    @property
    def normal_force(self) -> float:
        """Normal force [N]."""
        return float(self.xs.contact[NORMAL])

    @property
    def voltage(self) -> float:
        """Output voltage [V] of the amplifier."""
        return float(self.limits.x[OUTPUT])

    def reset(self) -> None:
        """Return to rest at the initial voltage, in the initial hysteresis state; the noise sequence starts again."""
        for block in (self.limits, self.hysteresis, self.lag, self.sensor):
            block.reset()
        self._settle()

    def check_retune(self, parameters: ClampParameters) -> None:
        """Raise ParameterError if the change to ``parameters`` is not allowed while running."""
        parameters.hysteresis.require_same(self.parameters.hysteresis)
        if parameters.lag.type != self.parameters.lag.type:
            remedy = f"is fixed while running: keep {self.parameters.lag.type}"
            raise ParameterError([Problem("lag.type", parameters.lag.type, remedy)])

    def retune(self, parameters: ClampParameters) -> None:
        """Change to parameters of the same structure while running; the displacement does not jump.

        Raises
        ------
        ParameterError
            The parameters are wrong or of another structure; the clamp then remains unchanged.
        """
        self.check_retune(parameters.validated())
        self.limits.retune(parameters.limits)
        self.hysteresis.retune(parameters.hysteresis.chosen)
        self.lag.retune(parameters.lag.discrete(self.sample_time))
        self.sensor.retune(parameters.sensor)
        self.ps.contact[GAP:] = self._contact(parameters)
        self.parameters = parameters
