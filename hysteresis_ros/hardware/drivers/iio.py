# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Converters of the Linux subsystem *industrial I/O*, through sysfs: DAC before the amplifier, ADC after the sensor.

The voltage of a channel in mV is ``(raw + offset) · scale``; scale and offset are in files of the channel or of all
channels of its direction (kernel documentation, ABI/testing/sysfs-bus-iio).
"""

from __future__ import annotations

import os
import pathlib
import re
from collections.abc import Sequence
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.hardware.driver import (
    Capabilities,
    Driver,
    DriverError,
    HardwareDriver,
    Reading,
    claim,
    highest_rate,
    ramp,
)
from hysteresis_ros.registry import later

#: Volts per millivolt, the unit of ``scale``.
MILLIVOLT = 1.0e-3
#: Largest plausible magnitude of a raw value, scale or offset; the smallest one above 0 is the reciprocal.
LARGEST = 1.0e20
CHANNEL = re.compile(r"(alt)?voltage\d*")


def device_at(directory: pathlib.Path, wanted: str) -> pathlib.Path:
    """Return the folder of a device below ``directory``.

    ``wanted`` is the content of the device's file ``name``, or the name of its folder. DriverError: the device is
    absent, or several devices have this name.
    """
    names = {}
    for folder in sorted(directory.glob("iio:device*")) if directory.is_dir() else ():
        try:
            names[folder] = (folder / "name").read_text(encoding="utf-8").strip()
        except OSError:
            names[folder] = ""
    found = [folder for folder, name in names.items() if wanted in (folder.name, name)]
    if len(found) != 1:
        there = ", ".join(f"{folder.name} ({name})" for folder, name in names.items()) or "none"
        what = "is absent" if not found else "exists more than once: give its folder"
        raise DriverError(
            f"IIO device {wanted!r} in {directory}", f"{what}; there are {there}", "check its kernel driver"
        )
    return found[0]


def trigger_at(directory: pathlib.Path, wanted: str) -> pathlib.Path:
    """Return the file that fires a software trigger, below ``directory``.

    ``wanted`` is the content of the trigger's file ``name``, or the name of its folder. DriverError: the trigger is
    absent, or it cannot be fired by software.
    """
    names = {}
    for folder in sorted(directory.glob("trigger*")) if directory.is_dir() else ():
        file = folder / "name"
        names[folder] = file.read_text(encoding="utf-8").strip() if file.is_file() else ""
    found = [folder for folder, name in names.items() if wanted in (folder.name, name)]
    device = f"IIO trigger {wanted!r} in {directory}"
    if len(found) != 1:
        there = ", ".join(f"{folder.name} ({name})" for folder, name in names.items()) or "none"
        what = "is absent" if not found else "exists more than once: give its folder"
        raise DriverError(device, f"{what}; there are {there}", "load iio-trig-sysfs and add the trigger")
    file = found[0] / "trigger_now"
    if not file.is_file():
        raise DriverError(device, "has no file trigger_now", "choose a trigger of iio-trig-sysfs")
    return file


def write_number(path: pathlib.Path, value: int, name: str) -> None:
    """Write an attribute of the device ``name``; DriverError if it cannot be written."""
    try:
        file = os.open(path, os.O_WRONLY)
        try:
            os.write(file, b"%d\n" % value)
        finally:
            os.close(file)
    except OSError as error:
        problem = f"does not accept the value {value} at {path.name} ({error})"
        raise DriverError(name, problem, "check the device and its kernel driver") from error


class Channel:
    """A voltage channel of a device.

    Parameters
    ----------
    folder : pathlib.Path
        Folder of the device.
    direction : str
        ``in`` or ``out``.
    channel : str
        For instance ``voltage0``.

    Raises
    ------
    DriverError
        The device has no such channel, or a required attribute is missing or not a number.
    """

    def __init__(self, folder: pathlib.Path, direction: str, channel: str):
        self.folder, self.direction, self.channel = folder, direction, channel
        self.name = f"IIO device {folder.name}"
        self.raw = folder / f"{direction}_{channel}_raw"
        if not self.raw.is_file():
            there = sorted(path.name[len(direction) + 1 : -4] for path in folder.glob(f"{direction}_*_raw"))
            problem = f"has no channel {direction}_{channel}, it has {', '.join(there) or 'none'}"
            raise DriverError(self.name, problem, "choose one of them")
        scale = self.number("scale")
        if not scale:
            raise DriverError(self.name, f"has no scale for {self.raw.name}", "check its kernel driver")
        self.volts, self.offset = scale * MILLIVOLT, self.number("offset") or 0.0

    def attribute(self, name: str) -> str | None:
        """Return an attribute of the channel, or of all channels of its direction and kind; None if it does not exist.

        Only the first line is read, because an ordinary file (of the emulator) may still contain the end of an older,
        longer text.

        Parameters
        ----------
        name : str

        Raises
        ------
        DriverError
            The attribute exists but cannot be read.
        """
        kind = self.channel.rstrip("0123456789")
        for path in (self.folder / f"{self.direction}_{part}_{name}" for part in dict.fromkeys((self.channel, kind))):
            try:
                return path.read_text(encoding="ascii").partition("\n")[0].strip()
            except FileNotFoundError:
                continue
            except (OSError, UnicodeDecodeError) as error:
                raise self._failed(path, "cannot be read", error) from error
        return None

    def number(self, name: str) -> float | None:
        """Return a numerical attribute.

        Parameters
        ----------
        name : str

        Raises
        ------
        DriverError
            The attribute is not a number.
        """
        text = self.attribute(name)
        try:
            return None if text is None else _believed(text)
        except ValueError:
            problem = f"has {text!r} in {self.direction}_{self.channel}_{name}, which is not a number"
            raise DriverError(self.name, problem, "check its kernel driver") from None

    def _failed(self, path: pathlib.Path, what: str, error: Exception) -> DriverError:
        return DriverError(self.name, f"{what} at {path.name} ({error})", "check the device and its kernel driver")

    def read(self) -> float:
        """Return the voltage [V].

        Raises
        ------
        DriverError
            The voltage cannot be read.
        """
        raw = self.number("raw")
        if raw is None:
            raise DriverError(self.name, f"has lost {self.raw.name}", "check whether the device is still connected")
        return (raw + self.offset) * self.volts

    def put_out(self, voltage: float) -> None:
        """Output a voltage, rounded to the converter's quantisation step.

        Parameters
        ----------
        voltage : float
            [V]

        Raises
        ------
        DriverError
            The voltage cannot be written.
        """
        self.write(self.raw, round(voltage / self.volts - self.offset))

    def write(self, path: pathlib.Path, value: int) -> None:
        """Write an attribute.

        Parameters
        ----------
        path : pathlib.Path
        value : int

        Raises
        ------
        DriverError
            The attribute cannot be written.
        """
        write_number(path, value, self.name)

    def range(self, given: tuple[float, ...]) -> tuple[float, float]:
        """Return the voltage range [V], from the range of raw numbers that the device or the parameter file states.

        Parameters
        ----------
        given : tuple of float
            Least and greatest raw number, for a device that does not report its range.

        Raises
        ------
        DriverError
            The range is unknown.
        """
        said = re.fullmatch(r"\[\s*(\S+)\s+(\S+)\s+(\S+)\s*\]", self.attribute("raw_available") or "")
        try:
            ends = (_believed(said[1]), _believed(said[3])) if said else given
        except ValueError:
            ends = ()
        if not ends:
            raise DriverError(self.name, f"has no range for {self.raw.name}", "give iio.output_raw_range")
        low, high = sorted((raw + self.offset) * self.volts for raw in ends)
        return low, high

    def claim(self) -> int:
        """Lock the channel for this process and return the descriptor that holds the lock.

        Raises
        ------
        DriverError
            Another process holds the lock.
        """
        return claim(self.raw, self.name)


def _believed(text: str) -> float:
    """Return the number in a text; raise ValueError if it is not a number or not plausible."""
    value = float(text)
    if not abs(value) <= LARGEST or 0.0 < abs(value) < 1.0 / LARGEST:
        raise ValueError(text)
    return value


@dataclass(frozen=True)
class IioParameters(Parameters):
    """The converters of an axis; ``calibration`` converts the volts of the ADC to displacements."""

    directory: str = parameter(
        "/sys/bus/iio/devices", description="folder of the devices", read_only=True, place="files"
    )
    output_device: str = parameter(
        "",
        description="the DAC: content of its file `name`, or its folder, for instance iio:device0",
        read_only=True,
        place="files",
    )
    output_channel: str = parameter("voltage0", description="its channel", read_only=True)
    output_raw_range: tuple[float, ...] = parameter(
        (), description="least and greatest raw number of a DAC that has no …_raw_available", read_only=True
    )
    input_device: str = parameter(
        "",
        description="the ADC: content of its file `name`, or its folder",
        read_only=True,
        place="files",
    )
    input_channel: str = parameter("voltage0", description="its channel", read_only=True)
    trigger: str = parameter(
        "",
        description="software trigger (iio-trig-sysfs) that each trigger of the axis fires: content of its file "
        "`name`, or its folder, for instance trigger0; '': none",
        read_only=True,
        place="files",
    )
    safe_voltage: float = parameter(
        0.0, description="voltage of the DAC in the safe state", unit="V", low=-1.0e4, high=1.0e4, read_only=True
    )
    safe_time: float = parameter(
        0.2, description="time of the ramp to the safe voltage", unit="s", low=0.0, high=10.0, read_only=True
    )

    def check(self):
        """Yield a Problem for each inconsistency."""
        for name in ("output_channel", "input_channel"):
            if not CHANNEL.fullmatch(getattr(self, name)):
                yield Problem(name, getattr(self, name), "must be a voltage channel, for instance voltage0")
        ends = self.output_raw_range
        if ends and not (len(ends) == 2 and ends[0] < ends[1]):
            yield Problem("output_raw_range", ends, "give the least and the greatest raw number, or nothing")


class IioDriver(Driver):
    """A DAC and an ADC; after a failure, the next read searches for them again."""

    _given: IioParameters
    _claimed: int | None = None
    _output: Channel | None = None
    _trigger: pathlib.Path | None = None

    def open(self, parameters: IioParameters, sample_rate: float) -> Capabilities:
        """Find both devices, bring the DAC to its safe voltage and measure the highest rate.

        Parameters
        ----------
        parameters : IioParameters
        sample_rate : float
            [Hz]

        Raises
        ------
        DriverError
            A device is absent, ambiguous or in use, or has no scale or range.
        """
        self._given = parameters
        output = self._taken()
        low, high = output.range(parameters.output_raw_range)
        rate = highest_rate(lambda: output.put_out(parameters.safe_voltage), self._input.read)
        if parameters.trigger:
            self._trigger = trigger_at(pathlib.Path(parameters.directory), parameters.trigger)
        return Capabilities(1, 1, low, high, rate, position_unit="V", trigger_rate=rate if self._trigger else 0.0)

    def output_trigger(self, number: int, delay: float) -> None:
        """Fire the software trigger, which starts the buffers of the devices that are connected to it.

        Parameters
        ----------
        number : int
        delay : float
            [s]

        Raises
        ------
        DriverError
            The trigger cannot be fired.
        """
        if self._trigger is None:
            super().output_trigger(number, delay)
        else:
            write_number(self._trigger, 1, f"IIO trigger {self._trigger.parent.name}")

    def _taken(self) -> Channel:
        """Return the channel of the DAC; if it is not locked yet, lock it and bring the DAC to its safe voltage."""
        if self._output is None:
            given = self._given
            directory = pathlib.Path(given.directory)
            self._input = Channel(device_at(directory, given.input_device), "in", given.input_channel)
            output = Channel(device_at(directory, given.output_device), "out", given.output_channel)
            low, high = output.range(given.output_raw_range)
            if not low <= given.safe_voltage <= high:
                problem = (
                    f"has a range of {low:g} … {high:g} V, which does not contain iio.safe_voltage = "
                    f"{given.safe_voltage:g} V"
                )
                raise DriverError(output.name, problem, "choose a safe voltage within this range")
            self._claimed = output.claim()
            self._output = output
            self.make_safe()
            self._input.read()
        return self._output

    def read(self) -> Reading:
        """Read the ADC [V].

        Raises
        ------
        DriverError
            The ADC cannot be read.
        """
        self._taken()
        try:
            return Reading((self._input.read(),))
        except DriverError:
            self._let_go()
            raise

    def write(self, voltages: Sequence[float]) -> None:
        """Write the DAC.

        Parameters
        ----------
        voltages : sequence of float
            [V]

        Raises
        ------
        DriverError
            The DAC cannot be written.
        """
        self._taken().put_out(voltages[0])

    def make_safe(self) -> None:
        """Bring the DAC to its safe voltage, then switch the output on if it was off.

        Raises
        ------
        DriverError
            The DAC cannot be written.
        """
        if self._output is None:
            self._taken()
            return
        output, given = self._output, self._given
        try:
            ramp(output.put_out, output.read(), given.safe_voltage, given.safe_time)
            if output.number("powerdown"):
                output.write(output.folder / f"out_{output.channel}_powerdown", 0)
        except DriverError:
            self._let_go()
            raise

    def _let_go(self) -> None:
        self._output = None
        if self._claimed is not None:
            os.close(self._claimed)
            self._claimed = None

    def close(self) -> None:
        """Release the devices."""
        self._let_go()


DRIVER = HardwareDriver(
    name="iio",
    title="a DAC and an ADC of Linux industrial I/O, through sysfs",
    parameters=IioParameters,
    driver=IioDriver,
    emulator=later("hysteresis_ros.laboratory.emulation.iio:emulator"),
    device="hysteresis_ros.laboratory.emulation.iio:DEVICE",
)
