# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The driver of converters of Linux industrial I/O: a DAC before the amplifier, an ADC behind the sensor."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass

from hysteresis_ros.errors import Problem
from hysteresis_ros.hardware.bringup import highest_rate, ramp
from hysteresis_ros.hardware.driver import Capabilities, Driver, DriverError, Reading
from hysteresis_ros.hardware.drivers.iio.tree import CHANNEL, Channel, device_at
from hysteresis_ros.parameters import Parameters, parameter


@dataclass(frozen=True)
class IioParameters(Parameters):
    """Which converters; what their volts mean is said by ``calibration``."""

    directory: str = parameter(
        "/sys/bus/iio/devices", description="where the devices are", read_only=True, place="files"
    )
    output_device: str = parameter(
        "",
        description="the DAC: what its file name says, or its folder, for instance iio:device0",
        read_only=True,
        place="files",
    )
    output_channel: str = parameter("voltage0", description="its channel", read_only=True)
    output_raw_range: tuple[float, ...] = parameter(
        (), description="least and greatest raw number of a DAC that has no …_raw_available", read_only=True
    )
    input_device: str = parameter(
        "",
        description="the ADC, likewise",
        read_only=True,
        place="files",
    )
    input_channel: str = parameter("voltage0", description="its channel", read_only=True)
    safe_voltage: float = parameter(
        0.0, description="voltage of the DAC in the safe state", unit="V", low=-1.0e4, high=1.0e4, read_only=True
    )
    safe_time: float = parameter(
        0.2, description="time in which it goes there by itself", unit="s", low=0.0, high=10.0, read_only=True
    )

    def check(self):
        """Yield what does not fit together."""
        for name in ("output_channel", "input_channel"):
            if not CHANNEL.fullmatch(getattr(self, name)):
                yield Problem(name, getattr(self, name), "must be a channel of voltage, for instance voltage0")
        ends = self.output_raw_range
        if ends and not (len(ends) == 2 and ends[0] < ends[1]):
            yield Problem("output_raw_range", ends, "give the least and the greatest raw number, or nothing")


class IioDriver(Driver):
    """A DAC and an ADC; when they have failed they are looked for anew as soon as they are read again."""

    _given: IioParameters
    _claimed: int | None = None
    _output: Channel | None = None

    def open(self, parameters: IioParameters, sample_rate: float) -> Capabilities:
        """Find both devices, bring the DAC to its safe voltage and try how fast they are.

        Parameters
        ----------
        parameters : IioParameters
        sample_rate : float
            [Hz]

        Raises
        ------
        DriverError
            One is not there, is another one, has another master, or does not say its scale or range.
        """
        self._given = parameters
        output = self._taken()
        low, high = output.range(parameters.output_raw_range)
        rate = highest_rate(lambda: output.put_out(parameters.safe_voltage), self._input.read)
        return Capabilities(1, 1, low, high, rate, position_unit="V")

    def _taken(self) -> Channel:
        """Return the channel of the DAC, which is taken and brought to its safe voltage when it is not held."""
        if self._output is None:
            given = self._given
            directory = pathlib.Path(given.directory)
            self._input = Channel(device_at(directory, given.input_device), "in", given.input_channel)
            output = Channel(device_at(directory, given.output_device), "out", given.output_channel)
            low, high = output.range(given.output_raw_range)
            if not low <= given.safe_voltage <= high:
                problem = f"has a range of {low:g} … {high:g} V without iio.safe_voltage = {given.safe_voltage:g} V"
                raise DriverError(output.name, problem, "give one within it")
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
            It cannot be read.
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
            It cannot be written.
        """
        self._taken().put_out(voltages[0])

    def make_safe(self) -> None:
        """Take the DAC to its safe voltage, then switch it on if it was off.

        Raises
        ------
        DriverError
            It cannot be written.
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
        """Let go of the devices."""
        self._let_go()
