# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One axis of the emulated controller: amplifier, servo and wave generator in front of a plant of the package."""

from __future__ import annotations

import math

from hysteresis_ros.hardware.drivers.gcs.emulator.recorder import Recorder
from hysteresis_ros.hardware.drivers.gcs.protocol import (
    AXIS_UNIT,
    CONTROL_VOLTAGE,
    OPEN_LOOP,
    POSITION,
    POSITION_ERROR,
    RANGE_MAXIMUM,
    RANGE_MINIMUM,
    SETTLING,
    TARGET,
    TOLERANCE,
    UNITS,
    VOLTAGE,
    VOLTAGE_MAXIMUM,
    VOLTAGE_MINIMUM,
)
from hysteresis_ros.hardware.emulation.plant import EmulatedPlant
from hysteresis_ros.hardware.emulation.servo import Servo

#: Assumed: largest velocity of the servo [m/s], its window [m] and the time in it until it has arrived [s].
VELOCITY, WINDOW, SETTLED = 1.0e-3, 20.0e-9, 5.0e-3


class Axis:
    """An axis with its servo.

    Parameters
    ----------
    name : str
    plant : EmulatedPlant
    recorder : Recorder
        Of the whole controller.
    """

    def __init__(self, name: str, plant: EmulatedPlant, recorder: Recorder):
        self.name, self.plant, self._recorder = name, plant, recorder
        low, high = plant.limits.minimum, plant.limits.maximum
        self.values: dict[int, float | str] = {
            AXIS_UNIT: "UM",
            RANGE_MINIMUM: low * plant.gain / UNITS["um"],
            RANGE_MAXIMUM: high * plant.gain / UNITS["um"],
            VOLTAGE_MINIMUM: low,
            VOLTAGE_MAXIMUM: high,
            TOLERANCE: WINDOW / UNITS["um"],
            SETTLING: SETTLED,
        }
        self.servo, self.velocity = False, VELOCITY
        self._servo = Servo(plant)
        self.open_value, self.target = plant.voltage, plant.measured
        self.wave: list[float] = []
        self._played, self._cycles, self._rate, self._inside = 0, 0, 1, 0
        plant.control = self._control

    @property
    def unit(self) -> float:
        """Metres of a unit of the axis."""
        return UNITS[str(self.values[AXIS_UNIT]).lower()]

    @property
    def moving(self) -> bool:
        """Whether the servo is on its way."""
        return self.servo and not self.on_target

    @property
    def on_target(self) -> bool:
        """Whether the position has been in the window for long enough; false without servo."""
        return self.servo and self._inside * self.plant.cycle >= float(self.values[SETTLING])

    @property
    def generating(self) -> bool:
        """Whether the wave generator runs."""
        return bool(self.wave)

    def switch(self, servo: bool) -> None:
        """Switch the servo on where the axis is, or off with the voltage that is put out.

        Parameters
        ----------
        servo : bool
        """
        if servo and not self.servo:
            self._hold_here()
        if self.servo and not servo:
            self.open_value = self._servo.voltage
        self.servo, self._inside = servo, 0

    def _hold_here(self) -> None:
        self._servo.begin()
        self.target = self._servo.way

    def move(self, target: float) -> None:
        """Let the servo go to a place.

        Parameters
        ----------
        target : float
            [m]
        """
        self.target, self._inside = target, 0

    def generate(self, wave: list[float], cycles: int, rate: int) -> None:
        """Start the wave generator.

        Parameters
        ----------
        wave : list of float
            Open-loop values [V], or positions [m] with the servo on.
        cycles : int
            How often it is played; 0: until it is stopped.
        rate : int
            Samples that a point is held.
        """
        self.wave, self._cycles, self._rate, self._played = wave, cycles, rate, 0

    def stop(self) -> None:
        """Stop the wave generator, and the servo where the axis is."""
        if self.generating:
            self.wave = []
            self.open_value = self._servo.voltage
        if self.servo:
            self._hold_here()

    def _wanted(self) -> float:
        """Return what the generator or the master wants in this sample."""
        if not self.wave:
            return self.target if self.servo else self.open_value
        point, length = self._played // self._rate, len(self.wave)
        self._played += 1
        if self._cycles and point >= self._cycles * length:
            last, self.wave = self.wave[-1], []
            if self.servo:
                self.target = last
            else:
                self.open_value = last
            return last
        return self.wave[point % length]

    def _control(self, measured: float) -> float:
        """Return the voltage of a sample."""
        wanted = self._wanted()
        if self.servo:
            voltage = self._servo.follow(wanted, self.velocity)
            inside = abs(wanted - measured) <= float(self.values[TOLERANCE]) * self.unit
            self._inside = self._inside + 1 if inside else 0
        else:
            voltage = self._servo.put_out(wanted)
        if self._recorder.running:
            self._record(wanted, measured, voltage)
        return voltage

    def _record(self, wanted: float, measured: float, voltage: float) -> None:
        target, position = (wanted if self.servo else math.nan) / self.unit, measured / self.unit
        signals = {
            TARGET: target,
            POSITION: position,
            POSITION_ERROR: target - position,
            CONTROL_VOLTAGE: voltage,
            OPEN_LOOP: self.open_value if self.servo else wanted,
            VOLTAGE: voltage,
        }
        self._recorder.record(self.name, signals)
