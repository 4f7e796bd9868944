# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The plants that are simulated: an actuator, and an inchworm motor."""

from __future__ import annotations

from hysteresis_ros.loop.common_parameters import part
from hysteresis_ros.loop.plant import STIFFNESS, ActuatorPlantArrays, MotorPlantArrays, Plant
from hysteresis_ros.loop.plant_parameters import PlantNodeParameters
from hysteresis_ros.models import clamp as clamping
from hysteresis_ros.models import limits as limiting
from hysteresis_ros.models.actuator import (
    Actuator,
    ActuatorParameters,
)
from hysteresis_ros.models.inchworm import (
    Inchworm,
    InchwormPlantParameters,
)


class ActuatorPlant(Plant):
    """One actuator.

    Parameters
    ----------
    parameters : PlantNodeParameters
        Of type actuator.
    """

    def __init__(self, parameters: PlantNodeParameters):
        self.actuator = Actuator(part(parameters, ActuatorParameters), 1.0 / parameters.sample_rate)
        super().__init__(parameters)
        self.arrays = ActuatorPlantArrays(self.actuator.ps, self.actuator.xs, self._watch_p, self._watch_x)

    @property
    def kernels(self):
        """Hysteresis of the plant for the loop: of the extender and of the clamps, which are not there."""
        return (self.actuator.hysteresis_kernel,) * 3

    @property
    def measures_force(self) -> bool:
        """Whether there is a force sensor."""
        return self.parameters.force_sensor.there

    @property
    def rounding(self) -> float:
        """Rounding [V] of the voltage that is put out."""
        return float(self.arrays.p.limits[limiting.STEP])

    @property
    def resting_voltages(self) -> tuple[float, float, float]:
        """Voltages [V] before any is received."""
        return self.actuator.voltage, 0.0, 0.0

    @property
    def travel(self) -> tuple[float, float]:
        """Between which measurements [m] the axis may go on."""
        return self.parameters.allowed_travel

    @property
    def saturated(self) -> bool:
        """Whether range or slew rate limited the last voltage."""
        return self.actuator.saturated

    @property
    def limited_samples(self) -> int:
        """Samples so far that range or slew rate limited."""
        return self.actuator.limits.limited_samples

    def reset(self) -> None:
        """Begin again at rest."""
        self.actuator.reset()
        super().reset()

    def retune(self, parameters: PlantNodeParameters) -> None:
        """Take new parameters of the same structure while running."""
        self.actuator.retune(part(parameters, ActuatorParameters))
        super().retune(parameters)


class MotorPlant(Plant):
    """An inchworm motor: three voltages, four joints.

    Parameters
    ----------
    parameters : PlantNodeParameters
        Of type inchworm.
    """

    def __init__(self, parameters: PlantNodeParameters):
        self.motor = Inchworm(part(parameters, InchwormPlantParameters), 1.0 / parameters.sample_rate)
        super().__init__(parameters)
        self.arrays = MotorPlantArrays(self.motor.ps, self.motor.xs, self._watch_p, self._watch_x)

    def _pack(self, parameters: PlantNodeParameters) -> None:
        super()._pack(parameters)
        self._watch_p.trip[STIFFNESS] = self.motor.ps.front_contact[clamping.STIFFNESS]

    @property
    def kernels(self):
        """Hysteresis of extender, front and rear clamp, for the loop."""
        return self.motor.hysteresis_kernels

    @property
    def resting_voltages(self) -> tuple[float, float, float]:
        """Voltages [V] before any is received."""
        return self.motor.voltages

    @property
    def safe_voltages(self) -> tuple[float, float, float]:
        """Voltages [V] without commands; a clamp stays where it is when that is higher."""
        motor = self.parameters.inchworm
        return self.parameters.safe_voltage, motor.front_clamp.initial_voltage, motor.rear_clamp.initial_voltage

    @property
    def saturated(self) -> bool:
        """Whether range or slew rate limited one of the last voltages."""
        return self.motor.saturated

    @property
    def limited_samples(self) -> int:
        """Samples so far in which range or slew rate limited a voltage, summed over the three amplifiers."""
        motor = self.motor
        return sum(item.limits.limited_samples for item in (motor.extender, motor.front_clamp, motor.rear_clamp))

    def reset(self) -> None:
        """Begin again at rest, the clamps at their initial voltages."""
        self.motor.reset()
        super().reset()

    def retune(self, parameters: PlantNodeParameters) -> None:
        """Take new parameters of the same structure while running."""
        self.motor.retune(part(parameters, InchwormPlantParameters))
        super().retune(parameters)
