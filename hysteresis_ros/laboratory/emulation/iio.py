# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A folder like sysfs with a DAC and an ADC, and a simulated plant between them."""

from __future__ import annotations

import contextlib
import os
import pathlib
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.hardware.driver import EmulatedDevice
from hysteresis_ros.hardware.drivers.iio import MILLIVOLT, IioParameters
from hysteresis_ros.laboratory.emulation.bench import Bench, DeviceFaults, EmulatedPlant, Running

#: Name of the converter for the output.
DAC = "emulated-dac"
#: Name of the converter for the input.
ADC = "emulated-adc"
#: Name of the software trigger; a text written to its file stays there, because no buffer is connected to the trigger.
TRIGGER = "emulated-trigger"
#: Bits of both converters; code 0 is the lowest voltage.
BITS = 16
#: Upper end of the range of both converters [V]; the lower end is 0 V for the DAC, and the negative of this for the
#: ADC.
SPAN = 10.0
#: Number of codes of a converter.
LEVELS = 2**BITS
#: Voltage of the DAC per code [V].
OUTPUT_SCALE = SPAN / LEVELS
#: Voltage of the ADC per code [V].
INPUT_SCALE = 2.0 * SPAN / LEVELS
#: Number that is added to a code of the ADC before it is scaled.
INPUT_OFFSET = -(LEVELS // 2)


@dataclass(frozen=True)
class EmulatedConvertersParameters(Parameters):
    """Folder of the devices, and scales between converters and plant."""

    directory: str = parameter(description="folder to create for the devices; it is removed at the end")
    amplifier: float = parameter(10.0, description="volts at the actuator per volt of the DAC", low=1e-6, high=1e6)
    sensor: float = parameter(1.0e5, description="volts at the ADC per metre", unit="V/m", low=1e-6, high=1e12)
    period: float = parameter(
        1.0e-3, description="interval at which the files are read and written", unit="s", low=1e-4, high=1.0
    )


class Converters:
    """The files of a DAC and an ADC with a plant between them."""

    def __init__(self, given: EmulatedConvertersParameters, bench: Bench, faults: DeviceFaults):
        self._given, self._faults = given, faults
        self._plant = EmulatedPlant(bench.plant, bench.cycle)
        self._plant.control = self._amplified
        self._put_out = 0
        root = pathlib.Path(given.directory)
        self.output, self.input = root / "iio:device0", root / "iio:device1"
        try:
            root.mkdir()
        except OSError as error:
            raise ConfigurationError(
                f"{root}: cannot be created ({error}); give a folder that does not exist yet"
            ) from None
        self._make(self.output, DAC, self._output_files())
        self._make(self.input, ADC, self._input_files())
        self._make(root / "trigger0", TRIGGER, {"trigger_now": ""})

    def _output_files(self) -> dict[str, str]:
        return {
            "out_voltage0_raw": "0",
            "out_voltage0_scale": f"{OUTPUT_SCALE / MILLIVOLT:.12f}",
            "out_voltage0_raw_available": f"[0 1 {LEVELS - 1}]",
            "out_voltage0_powerdown": "1",
        }

    def _input_files(self) -> dict[str, str]:
        scale = f"{INPUT_SCALE / MILLIVOLT:.12f}"
        return {
            "in_voltage0_raw": str(-INPUT_OFFSET),
            "in_voltage_scale": scale,
            "in_voltage0_offset": str(INPUT_OFFSET),
        }

    def _make(self, folder: pathlib.Path, name: str, files: dict[str, str]) -> None:
        folder.mkdir()
        for file, text in {"name": name, **files}.items():
            (folder / file).write_text(text + "\n", encoding="ascii")

    def _amplified(self, measured: float) -> float:
        return self._put_out * OUTPUT_SCALE * self._given.amplifier

    def look(self) -> None:
        """Read the DAC's file, advance the plant and write the ADC's file; or imitate a fault."""
        here = self.input.is_dir()
        if "cut" in self._faults:
            shutil.rmtree(self.input, ignore_errors=True)
            return
        if not here:
            self._make(self.input, ADC, self._input_files())
        with contextlib.suppress(OSError, ValueError, IndexError):
            # while a number is only partly written, the previous value remains in use
            told = int((self.output / "out_voltage0_raw").read_text(encoding="ascii").split()[0])
            off = (self.output / "out_voltage0_powerdown").read_text(encoding="ascii").startswith("1")
            self._put_out = 0 if off else min(max(told, 0), LEVELS - 1)
        self._plant.advance()
        raw = self.input / "in_voltage0_raw"
        if "error" in self._faults or "busy" in self._faults:
            # reading a folder as a file fails, as with a driver that reports an error
            raw.unlink(missing_ok=True) if raw.is_file() else raw.mkdir(exist_ok=True)
        elif "silent" not in self._faults:
            if raw.is_dir():
                raw.rmdir()
            level = round(self._plant.measured * self._given.sensor / INPUT_SCALE) - INPUT_OFFSET
            new = self.input / ".new"
            new.write_text(f"{min(max(level, 0), LEVELS - 1)}\n", encoding="ascii")
            os.replace(new, raw)


@contextlib.contextmanager
def start(given: EmulatedConvertersParameters, bench: Bench) -> Iterator[Running]:
    """Run emulated converters in a separate thread."""
    faults = DeviceFaults(time.monotonic, bench.faults)
    converters, leaving = Converters(given, bench, faults), threading.Event()

    def run() -> None:
        while not leaving.is_set():
            converters.look()
            late = faults.value("slow")
            leaving.wait(given.period if late is None else late)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        driver = IioParameters(directory=given.directory, output_device=DAC, input_device=ADC)
        yield Running(f"{DAC} and {ADC} in {given.directory}", driver, faults)
    finally:
        leaving.set()
        thread.join()
        shutil.rmtree(given.directory, ignore_errors=True)


@contextlib.contextmanager
def emulator() -> Iterator[Parameters]:
    """Run emulated converters in a temporary folder, and yield the parameters of their driver."""
    with tempfile.TemporaryDirectory() as folder:
        given = EmulatedConvertersParameters(directory=str(pathlib.Path(folder) / "iio"))
        with start(given, Bench()) as running:
            yield running.driver


DEVICE = EmulatedDevice(EmulatedConvertersParameters, start)
