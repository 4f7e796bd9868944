# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The simulated actuator as a driver, with the parameters of ``plant_simulator``.

The model is that of the plant without a driver. The driver serves to test what every driver must do.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence

from hysteresis_ros.hardware.driver import Capabilities, Driver, HardwareDriver, Reading
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters


class SimulatedDriver(Driver):
    """An actuator that advances by one sample at each :meth:`write`."""

    def open(self, parameters: ActuatorParameters, sample_rate: float) -> Capabilities:
        """Create the actuator at rest.

        Parameters
        ----------
        parameters : ActuatorParameters
        sample_rate : float
            [Hz]
        """
        self._actuator = Actuator(parameters, 1.0 / sample_rate)
        self._actuator.advance(self._actuator.measure())  # compile now instead of in the first sample
        self._actuator.reset()
        self._rest = self._actuator.voltage
        limits = parameters.limits
        self._forces = int(parameters.force_sensor.there)
        return Capabilities(1, 1, limits.minimum, limits.maximum, highest_rate=math.inf, forces=self._forces)

    def read(self) -> Reading:
        """Return the reading of the sensor."""
        forces = (self._actuator.measure_force(),) if self._forces else ()
        return Reading((self._actuator.measure(),), forces)

    def write(self, voltages: Sequence[float]) -> None:
        """Advance by one sample with this voltage.

        Parameters
        ----------
        voltages : sequence of float
            [V]
        """
        self._actuator.advance(voltages[0])

    def make_safe(self) -> None:
        """Output the initial voltage."""
        self._actuator.advance(self._rest)

    def close(self) -> None:
        """Do nothing, because nothing is to be released."""


@contextlib.contextmanager
def emulator() -> Iterator[ActuatorParameters]:
    """Give the parameters of an actuator of 0.1 µm/V; no emulated device is needed."""
    limits = {"limits.minimum": -30.0, "limits.maximum": 120.0}
    yield ActuatorParameters.from_mapping(
        {"hysteresis.type": "proportional", "hysteresis.proportional.gain": 1.0e-7, **limits}
    )


DRIVER = HardwareDriver(
    name="simulated",
    title="the simulated actuator as a driver",
    parameters=ActuatorParameters,
    driver=SimulatedDriver,
    emulator=emulator,
)
