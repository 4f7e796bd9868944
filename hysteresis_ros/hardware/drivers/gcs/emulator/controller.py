# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The emulated controller: its axes, wave tables, recorder and errors."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from hysteresis_ros.hardware.drivers.gcs.emulator.axis import Axis
from hysteresis_ros.hardware.drivers.gcs.emulator.recorder import Recorder
from hysteresis_ros.hardware.drivers.gcs.protocol import NO_ERROR, STOPPED
from hysteresis_ros.hardware.emulation.faults import DeviceFaults
from hysteresis_ros.hardware.emulation.plant import EmulatedPlant
from hysteresis_ros.models.actuator import ActuatorParameters


@dataclass(frozen=True)
class Model:
    """One of the controllers that are emulated."""

    #: Answer to ``*IDN?``.
    identification: str
    axes: int
    #: Input signals of sensors and analog inputs.
    inputs: int
    #: Whether it leaves leading zeros of the number of a parameter out of its answer.
    strips: bool = False


MODELS = {
    "E-709": Model("Physik Instrumente, E-709.CRG, 0000000000, 1.000 (emulated)", 1, 2),
    "E-727": Model("Physik Instrumente, E-727.3CDA, 0000000000, 1.000 (emulated)", 3, 7, strips=True),
    "E-754": Model("Physik Instrumente, E-754.1CD, 0000000000, 1.000 (emulated)", 1, 3),
}


class Controller:
    """A controller with its axes.

    Parameters
    ----------
    model : Model
    plant : ActuatorParameters
        Of each axis.
    cycle : float
        Time between two samples of the servo [s].
    faults : DeviceFaults
    clock : callable
        Returns the time [s].
    """

    def __init__(
        self,
        model: Model,
        plant: ActuatorParameters,
        cycle: float,
        faults: DeviceFaults,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.model, self.faults, self.cycle = model, faults, cycle
        names = [str(number + 1) for number in range(model.axes)]
        self.recorder = Recorder(names)
        self.axes = {name: Axis(name, EmulatedPlant(plant, cycle, clock), self.recorder) for name in names}
        self.waves: dict[int, list[float]] = {}
        #: Of each generator: its wave table, how often it is played, how many samples a point is held.
        self.chosen: dict[str, int] = {}
        self.repeats, self.wave_rate = dict.fromkeys(names, 0), 1
        self._error = NO_ERROR
        self.own = {0x02000200: 0.0, 0x02000300: 1.0, 0x07000A00: 0.0, 0x07000A01: 100.0, 0x06000500: 0.0}

    def tick(self) -> None:
        """Let time go on."""
        for axis in self.axes.values():
            axis.plant.advance()

    @property
    def busy(self) -> bool:
        """Whether something else is being done."""
        return "busy" in self.faults

    def fail(self, code: int) -> None:
        """Keep an error until it is asked for."""
        self._error = code

    def take_error(self) -> int:
        """Return the error that is kept, and forget it; a fault of the hardware stays."""
        lasting = self.faults.value("error")
        code, self._error = self._error, NO_ERROR
        return code if lasting is None else int(lasting)

    def stop(self, axes: Iterable[Axis]) -> None:
        """Stop axes, which counts as an error."""
        for axis in axes:
            axis.stop()
        self._error = STOPPED
