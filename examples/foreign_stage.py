# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage for trying a commissioning: an actuator of a class that no model of the package describes, as a driver.

It moves by one sample at each voltage, 100 µm over 0 … 100 V: another class of hysteresis, creep of fractional order, a
resonance of 420 Hz with a damping ratio of 1.5 %, a sample of delay, noise of 3 nm. Between two runs a file stores its
state. With Numba it has a compiled form, so that it runs fused. All its numbers are assumed.

    hysteresis new stage.yaml --stroke 100um --voltage 0:100V --rate 2kHz --driver ./foreign_stage.py
    hysteresis commission stage.yaml --yes
"""

from __future__ import annotations

import contextlib
import functools
import math
import pathlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.hardware.driver import Capabilities, Compiled, Driver, DriverError, HardwareDriver, Reading
from hysteresis_ros.laboratory.foreign import HYSTERESES, PARAMETERS, STATES, Foreign, ForeignParameters, foreign
from hysteresis_ros.models.block import COMPILED, kernel
from hysteresis_ros.models.sensor import STATES as SENSOR_STATES
from hysteresis_ros.models.sensor import Sensor, SensorParameters, sensor

LOW, HIGH = 0.0, 100.0


@dataclass(frozen=True)
class StageParameters(Parameters):
    """Options and faults of the stage."""

    hysteresis: str = parameter("bouc_wen", choices=HYSTERESES, description="class of the hysteresis")
    memory: str = parameter("", description="file that stores its state between two runs; empty: none")
    polarity: float = parameter(1.0, description="direction of the sensor; 0: no signal", low=-1.0, high=1.0)
    unit: float = parameter(1.0, description="reading of the sensor per metre", low=1e-12)
    noise: float = parameter(3e-9, description="standard deviation of the sensor's noise", unit="m", low=0.0)


# the whole state is one array; the functions called from C receive its address
READING, SCALE, P = 0, 1, 2
X = P + PARAMETERS
SENSOR_P = X + STATES
SENSOR_X = SENSOR_P + 3
WHOLE = SENSOR_X + SENSOR_STATES


@kernel
def move(everything, voltage):
    """Advance by one sample at ``voltage`` [V]."""
    place = foreign(everything[P:X], everything[X:SENSOR_P], voltage)
    seen = everything[SCALE] * place
    everything[READING] = sensor(everything[SENSOR_P:SENSOR_X], everything[SENSOR_X:WHOLE], seen)
    return everything[READING]


class Stage(Driver):
    """The stage."""

    def open(self, parameters: StageParameters, sample_rate: float) -> Capabilities:
        """Restore the state of the last run."""
        sample_time = 1.0 / sample_rate
        actuator = ForeignParameters(
            hysteresis=parameters.hysteresis,
            stroke=100e-6,
            voltage=HIGH,
            creep=0.02,
            lag=0.0,
            delay=sample_time,
            frequencies=(420.0, 1700.0),
            dampings=(0.015, 0.02),
            share=0.0,
        )
        block = Foreign(actuator, sample_time)
        eye = Sensor(SensorParameters(noise=parameters.unit * parameters.noise), sample_time)
        self._everything = np.concatenate(
            [[0.0, parameters.unit * parameters.polarity], block.p, block.x, eye.p, eye.x]
        )
        self._memory = pathlib.Path(parameters.memory) if parameters.memory else None
        if self._memory is not None and self._memory.exists():
            self._remember()
        move(self._everything, LOW)
        return Capabilities(1, 1, LOW, HIGH, highest_rate=math.inf)

    def _remember(self) -> None:
        try:
            remembered = np.load(self._memory, allow_pickle=False)
            self._everything[X:SENSOR_P], self._everything[SENSOR_X:] = np.split(remembered, [STATES])
        except (OSError, ValueError) as error:
            raise DriverError(f"file {self._memory}", f"holds no state: {error}", "remove it") from None

    def read(self) -> Reading:
        """Return the reading of the sensor."""
        return Reading((float(self._everything[READING]),))

    def write(self, voltages) -> None:
        """Hold a voltage for a sample."""
        move(self._everything, float(voltages[0]))

    def compiled(self) -> Compiled | None:
        """Return its compiled form."""
        if not COMPILED:
            return None
        read, write, make_safe = (function.address for function in as_c_calls())
        return Compiled(read, write, make_safe, self._everything.ctypes.data, explained)

    def make_safe(self) -> None:
        """Put out 0 V."""
        self.write((LOW,))

    def close(self) -> None:
        """Store the state."""
        if self._memory is not None:
            with self._memory.open("wb") as file:
                np.save(file, np.concatenate([self._everything[X:SENSOR_P], self._everything[SENSOR_X:]]))


def explained(code: int) -> DriverError:
    """Return the meaning of an error code; the stage has none."""
    return DriverError("the stage", f"answers with code {code}", "look at it")


@functools.cache
def as_c_calls():
    """Return read, write and make_safe for C."""
    from numba import carray, cfunc, types

    place = types.CPointer(types.float64)

    @cfunc(types.int32(place, place))
    def read(device, positions):
        positions[0] = carray(device, WHOLE)[READING]
        return 0

    @cfunc(types.int32(place, place))
    def write(device, voltages):
        move(carray(device, WHOLE), voltages[0])
        return 0

    @cfunc(types.int32(place))
    def make_safe(device):
        move(carray(device, WHOLE), LOW)
        return 0

    return read, write, make_safe


@contextlib.contextmanager
def emulator() -> Iterator[StageParameters]:
    """Check the parameters of the stage; it needs no hardware."""
    yield StageParameters()


DRIVER = HardwareDriver(
    name="foreign_stage",
    title="a stage of a class that no model describes",
    parameters=StageParameters,
    driver=Stage,
    emulator=emulator,
)
