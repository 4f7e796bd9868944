# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The amplifier of an emulated device, with the servo before it."""

from __future__ import annotations

from hysteresis_ros.hardware.emulation.plant import EmulatedPlant

#: Assumed: how fast the servo takes up an error [1/s].
INTEGRAL_RATE = 60.0


class Servo:
    """An integrator that takes a plant to a place, or the voltage that somebody wants.

    Parameters
    ----------
    plant : EmulatedPlant

    Attributes
    ----------
    voltage : float
        What the amplifier is told [V].
    way : float
        Where the servo wants the plant to be at the moment [m].
    """

    def __init__(self, plant: EmulatedPlant):
        self._plant, self.voltage, self.way = plant, plant.voltage, plant.measured

    def begin(self) -> None:
        """Begin where the plant is."""
        self.way = self._plant.measured

    def put_out(self, voltage: float) -> float:
        """Put out a voltage within the amplifier's range, and return it.

        Parameters
        ----------
        voltage : float
            [V]
        """
        limits = self._plant.limits
        self.voltage = min(max(voltage, limits.minimum), limits.maximum)
        return self.voltage

    def follow(self, target: float, velocity: float) -> float:
        """Go a sample further towards a place, and return the voltage.

        Parameters
        ----------
        target : float
            [m]
        velocity : float
            How fast the place may be approached [m/s].
        """
        plant = self._plant
        reach = velocity * plant.cycle
        self.way += min(max(target - self.way, -reach), reach)
        step = INTEGRAL_RATE * plant.cycle * (self.way - plant.measured) / plant.gain
        return self.put_out(self.voltage + step)
