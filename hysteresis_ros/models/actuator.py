# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The plant: voltage → limits → hysteresis → creep → linear dynamics → + preload → sensor (Hammerstein model)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.models import sensor as sensing
from hysteresis_ros.models.block import Chain, interpreted, kernel, nested
from hysteresis_ros.models.creep import Creep, CreepParameters, creep
from hysteresis_ros.models.declaration import require_structure
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.limits import OUTPUT, Limits, LimitsParameters, limits
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters, linear_advance, linear_output
from hysteresis_ros.models.sensor import (
    ForceSensorParameters,
    Sensor,
    SensorParameters,
    force_reading,
    force_state,
    note_acting,
    pack_force,
    sensor,
    settle_force,
)


@dataclass(frozen=True)
class PreloadParameters(Parameters):
    """Preload L0 and the coefficients of W = A1 + B1 L0 + B2 L0² (Kim, Kim & Park 2009, eqs 3-5)."""

    force: float = parameter(0.0, description="preload L0, positive in compression", unit="N", low=0.0)
    A1: float = parameter(0.0, description="offset without preload", unit="m")
    B1: float = parameter(0.0, description="compliance: offset per preload", unit="m/N")
    B2: float = parameter(0.0, description="change of the compliance with the preload", unit="m/N²")

    @property
    def offset(self) -> float:
        """Offset W of the displacement [m]."""
        return self.A1 + self.force * (self.B1 + self.force * self.B2)


PRELOAD = 3  # ps.sensor[PRELOAD]: offset W [m], after the sensor's own parameters
DISPLACEMENT = sensing.STATES  # xs.sensor[DISPLACEMENT]: true displacement at the last measurement [m]


class ActuatorArrays(NamedTuple):
    """Parameter arrays, or state arrays, of an actuator."""

    limits: np.ndarray
    hysteresis: np.ndarray
    dynamics: np.ndarray
    sensor: np.ndarray
    creep: np.ndarray
    force: np.ndarray


@dataclass(frozen=True)
class ActuatorParameters(Parameters):
    """Parameters of a complete actuator with amplifier and sensor."""

    limits: LimitsParameters = group(LimitsParameters)
    hysteresis: HysteresisParameters = group(HysteresisParameters)
    creep: CreepParameters = group(CreepParameters)
    dynamics: LinearParameters = group(LinearParameters)
    preload: PreloadParameters = group(PreloadParameters)
    sensor: SensorParameters = group(SensorParameters)
    force_sensor: ForceSensorParameters = group(ForceSensorParameters)


@kernel
def reading(dynamics_p, dynamics_x, sensor_p, sensor_x):
    """Return the reading [m] of the sensor at the present sample; the sensor's state stores the true displacement."""
    displacement = linear_output(dynamics_p, dynamics_x) + sensor_p[PRELOAD]
    sensor_x[DISPLACEMENT] = displacement
    return sensor(sensor_p, sensor_x, displacement)


@nested
def actuator_measure(ps, xs):
    """Return the reading [m] of an actuator's sensor; ``ps`` and ``xs`` are :class:`ActuatorArrays`."""
    return reading(ps.dynamics, xs.dynamics, ps.sensor, xs.sensor)


@nested
def actuator_force(ps, xs):
    """Return the reading of the force sensor [N], or NaN if there is no sensor; call it once per sample."""
    displacement = linear_output(ps.dynamics, xs.dynamics) if ps.force.shape[0] > 0 else 0.0
    return force_reading(ps.force, xs.force, displacement)


@nested
def actuator_advance(hysteresis, ps, xs, voltage):
    """Hold ``voltage`` [V] until the next sample; return the output voltage of the amplifier [V]."""
    applied = limits(ps.limits, xs.limits, voltage)
    displacement = hysteresis(ps.hysteresis, xs.hysteresis, applied)
    crept = creep(ps.creep, xs.creep, displacement)
    note_acting(ps.force, xs.force, xs.dynamics, crept)
    linear_advance(ps.dynamics, xs.dynamics, crept)
    return applied


class Actuator(Chain):
    """A hysteretic actuator with amplifier and sensor.

    Call :meth:`measure` and then :meth:`advance` once per sample. Composites use ``ps``, ``xs`` and
    ``hysteresis_kernel`` directly.

    Parameters
    ----------
    parameters : ActuatorParameters
        Parameters, checked on construction.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        Parameters are wrong; the message states each wrong parameter.
    """

    def __init__(self, parameters: ActuatorParameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        self.limits = Limits(parameters.limits, sample_time)
        self.hysteresis = hysteresis_block(parameters.hysteresis, sample_time)
        self.creep = Creep(parameters.creep, sample_time)
        self.dynamics = LinearDynamics(parameters.dynamics, sample_time)
        self.sensor = Sensor(parameters.sensor, sample_time)
        p = np.append(self.sensor.p, parameters.preload.offset)
        x = np.append(self.sensor.x, 0.0)
        self.sensor.p, self.sensor.x = p[:PRELOAD], x[:DISPLACEMENT]  # views: the sensor's block uses the same arrays
        force_p = pack_force(parameters.force_sensor, parameters.dynamics, self.sample_time)
        force_x = force_state(parameters.force_sensor)
        self.ps = ActuatorArrays(self.limits.p, self.hysteresis.p, self.dynamics.p, p, self.creep.p, force_p)
        self.xs = ActuatorArrays(self.limits.x, self.hysteresis.x, self.dynamics.x, x, self.creep.x, force_x)
        self.hysteresis_kernel = self.hysteresis.kernel
        self._settle()

    def _settle(self) -> None:
        """Set creep and dynamics to their steady state for the initial voltage of the limits."""
        start = self.hysteresis.step(self.limits.x[OUTPUT])
        rest = self.creep.settle(start)
        self.dynamics.settle(rest)
        settle_force(self.ps.force, self.xs.force, rest, self.dynamics.output())
        self.xs.sensor[DISPLACEMENT] = self.dynamics.output() + self.ps.sensor[PRELOAD]
        self.xs.sensor[sensing.MEASURED] = self.xs.sensor[DISPLACEMENT] + self.ps.sensor[sensing.OFFSET]

    def measure(self) -> float:
        """Return the reading [m] of the sensor; call it once per sample, because each call generates noise."""
        return interpreted(actuator_measure)(self.ps, self.xs)

    def measure_force(self) -> float:
        """Return the reading [N] of the force sensor, or NaN without a sensor; call it only once per sample (noise)."""
        return interpreted(actuator_force)(self.ps, self.xs)

    def advance(self, voltage: float) -> float:
        """Hold ``voltage`` [V] for one sample; return the output voltage of the amplifier [V]."""
        return interpreted(actuator_advance)(self.hysteresis_kernel, self.ps, self.xs, float(voltage))

    @property
    def displacement(self) -> float:
        """True displacement [m] at the last measurement."""
        return float(self.xs.sensor[DISPLACEMENT])

    @property
    def voltage(self) -> float:
        """Output voltage [V] of the amplifier."""
        return float(self.limits.x[OUTPUT])

    @property
    def saturated(self) -> bool:
        """Whether the range or the slew rate limited the last voltage."""
        return self.limits.saturated

    def reset(self) -> None:
        """Return to rest, with the hysteresis in its initial state; the noise sequence starts again."""
        for block in (self.limits, self.hysteresis, self.creep, self.dynamics, self.sensor):
            block.reset()
        self.xs.force[:] = force_state(self.parameters.force_sensor)
        self._settle()

    def retune(self, parameters: ActuatorParameters) -> None:
        """Change to parameters of the same structure while running; the hysteresis continues from the present point.

        Raises
        ------
        ParameterError
            The parameters are wrong or change the structure; the actuator then remains unchanged.
        """
        parameters = parameters.validated()
        parameters.hysteresis.require_same(self.parameters.hysteresis)
        require_structure(self.parameters.creep, parameters.creep)
        parameters.force_sensor.require_same(self.parameters.force_sensor)
        self.dynamics.retune(parameters.dynamics)  # first, because it may still raise an error
        self.limits.retune(parameters.limits)
        self.hysteresis.retune(parameters.hysteresis.chosen)
        self.creep.retune(parameters.creep)
        self.sensor.retune(parameters.sensor)
        self.ps.sensor[PRELOAD] = parameters.preload.offset
        self.ps.force[:] = pack_force(parameters.force_sensor, parameters.dynamics, self.sample_time)
        self.parameters = parameters
