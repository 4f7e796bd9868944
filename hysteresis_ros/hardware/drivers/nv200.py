# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The piezo amplifier NV200/D NET of piezosystem jena, through the manufacturer's package ``nv200``.

That package is asynchronous: its event loop runs in a thread, and each call waits for its result.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pathlib
import threading
import time
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass
from typing import Any

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

#: Metres per unit of the sensor; both characters for micro are in use.
UNITS = {"µm": 1.0e-6, "μm": 1.0e-6, "um": 1.0e-6, "nm": 1.0e-9, "mm": 1.0e-3}
#: Bits of the status register, and the meaning of a set bit.
CONNECTED, CLOSED = 1 << 0, 1 << 3
FAULTS = {1 << 10: "it is too hot", 1 << 11: "the actuator has an error", 1 << 12: "its hardware has an error"}
#: Time-out of the connection [s].
CONNECTING = 10.0


@dataclass(frozen=True)
class Nv200Parameters(Parameters):
    """Address and settings of the amplifier."""

    host: str = parameter(
        "", description="name or address of the amplifier; '': it is connected to serial_port", read_only=True
    )
    port: int = parameter(23, description="TCP port of the amplifier", low=1, high=65535, read_only=True)
    serial_port: str = parameter(
        "", description="serial port, for instance /dev/ttyUSB0", read_only=True, place="files"
    )
    configure_link: bool = parameter(
        True, description="TCP: let the package set the flow control of the Ethernet module, once", read_only=True
    )
    actuator: str = parameter(
        "",
        description="text that the name of the actuator must contain, for instance TRITOR100; '': any",
        read_only=True,
    )
    safe_voltage: float = parameter(
        0.0, description="voltage of the safe state", unit="V", low=-1.0e3, high=1.0e3, read_only=True
    )
    safe_time: float = parameter(
        0.2, description="time of the ramp to the safe voltage", unit="s", low=0.0, high=10.0, read_only=True
    )
    check_period: float = parameter(
        0.5, description="time between two checks of the status", unit="s", low=1e-3, high=60.0, read_only=True
    )
    timeout: float = parameter(
        1.0, description="time within which the amplifier must answer", unit="s", low=0.01, high=60.0, read_only=True
    )

    def check(self):
        """Yield a Problem for each inconsistency."""
        if self.host and self.serial_port:
            yield Problem("serial_port", self.serial_port, "give either host or serial_port")


class Nv200Driver(Driver):
    """One amplifier in open loop; after a failure, the next read connects again."""

    _given: Nv200Parameters
    _loop: asyncio.AbstractEventLoop | None = None
    _device: Any = None
    _claimed: int | None = None

    def open(self, parameters: Nv200Parameters, sample_rate: float) -> Capabilities:
        """Connect, check the amplifier, bring it to its safe state and measure the highest rate.

        Parameters
        ----------
        parameters : Nv200Parameters
        sample_rate : float
            [Hz]

        Raises
        ------
        DriverError
            The amplifier cannot be reached, has another actuator than expected or no sensor, is in error, or uses other
            units.
        """
        self._given = parameters
        self._name = f"NV200 at {f'{parameters.host}:{parameters.port}' if parameters.host else parameters.serial_port}"
        if not (parameters.host or parameters.serial_port):
            raise DriverError("NV200", "has no address", "give nv200.host or nv200.serial_port")
        self._taken()
        rate = highest_rate(lambda: self._put_out(parameters.safe_voltage), self._measure)
        low, high = self._range
        return Capabilities(joints=1, voltages=1, minimum=low, maximum=high, highest_rate=rate)

    # -- the manufacturer's package ------------------------------------------------------------------------------

    def _wait(self, what: str, work: Callable[[], Coroutine], timeout: float | None = None) -> Any:
        """Return the result of a coroutine."""
        if self._loop is None:
            self._loop = asyncio.new_event_loop()
            threading.Thread(target=self._loop.run_forever, name="nv200", daemon=True).start()
        limited = asyncio.wait_for(work(), timeout or self._given.timeout)
        try:
            return asyncio.run_coroutine_threadsafe(limited, self._loop).result()
        except TimeoutError as error:
            raise self._failed(f"does not answer when it {what}") from error
        except Exception as error:  # the package may raise exceptions of any type
            raise self._failed(f"fails when it {what} ({type(error).__name__}: {error})") from error

    def _failed(self, problem: str) -> DriverError:
        self._hang_up()
        return DriverError(self._name, problem, "check amplifier, cable and other programs that use it")

    def _hang_up(self) -> None:
        if self._device is not None and self._loop is not None:
            device, self._device = self._device, None
            closing = asyncio.run_coroutine_threadsafe(device.close(), self._loop)
            with contextlib.suppress(Exception):  # no caller can handle the error any more
                closing.result(self._given.timeout)
        if self._claimed is not None:
            os.close(self._claimed)
            self._claimed = None

    # -- taking the amplifier ------------------------------------------------------------------------------------

    def _taken(self) -> Any:
        """Return the device; if it is not connected, connect it and bring it to its safe state."""
        if self._device is None:
            given = self._given
            if given.serial_port:
                self._claimed = claim(pathlib.Path(given.serial_port), self._name)
            device = self._device = self._made()
            self._wait("is connected", lambda: device.connect(given.configure_link and bool(given.host)), CONNECTING)
            try:
                self._suits(device)
                self._make_safe()
                self._check()
            except DriverError:
                self._hang_up()
                raise
        return self._device

    def _made(self) -> Any:
        from nv200.nv200_device import NV200Device
        from nv200.serial_protocol import SerialProtocol
        from nv200.telnet_protocol import TelnetProtocol

        given = self._given
        link = TelnetProtocol(given.host, given.port) if given.host else SerialProtocol(given.serial_port)
        device = NV200Device(link)
        device.CMD_CACHE_ENABLED = False  # read from the device instead of a cache
        return device

    def _suits(self, device: Any) -> None:
        """Refuse a device that is not suitable for the axis."""
        given = self._given
        actuator = self._wait("is asked for its actuator", device.get_actuator_name)
        if given.actuator.lower() not in actuator.lower():
            problem = f"has the actuator {actuator!r}, which does not contain nv200.actuator = {given.actuator!r}"
            raise DriverError(self._name, problem, "connect the right actuator, or correct nv200.actuator")
        if not self._wait("is asked for its sensor", device.has_position_sensor):
            raise DriverError(self._name, "has an actuator without a sensor", "use an actuator with a sensor")
        units = (
            self._wait("is asked for its position unit", device.get_position_unit),
            self._wait("is asked for its voltage unit", device.get_voltage_unit),
        )
        if units[0] not in UNITS or units[1] != "V":
            problem = f"measures in {units[0]} and outputs {units[1]}"
            raise DriverError(self._name, problem, f"an axis needs V and one of {', '.join(UNITS)}")
        self._unit = UNITS[units[0]]
        low, high = self._range = self._wait("is asked for its voltage range", device.get_voltage_range)
        if not low <= given.safe_voltage <= high:
            problem = (
                f"has a range of {low:g} … {high:g} V, which does not contain nv200.safe_voltage = "
                f"{given.safe_voltage:g} V"
            )
            raise DriverError(self._name, problem, "choose a safe voltage within this range")

    def _check(self) -> None:
        """Refuse a device in error, without an actuator, or with its loop closed by another program."""
        status = self._wait("is asked for its status", lambda: self._device.read_int_value("stat"))
        found = [text for bit, text in FAULTS.items() if status & bit]
        found += [] if status & CONNECTED else ["no actuator is connected"]
        found += ["another program has closed its loop"] if status & CLOSED else []
        if found:
            self._hang_up()
            raise DriverError(self._name, f"is not ready: {', '.join(found)}", "remove the cause, then start again")
        self._checked = time.monotonic()

    # -- samples -------------------------------------------------------------------------------------------------

    def _put_out(self, voltage: float) -> None:
        answer = self._wait("is sent a voltage", lambda: self._device.write(f"set,{voltage:.3f}"))
        if answer is None:  # the package returns None for a missing answer
            raise self._failed("does not answer when a voltage is sent")

    def _measure(self) -> float:
        return self._unit * self._wait("measures", self._device.get_current_position)

    def read(self) -> Reading:
        """Read the position and, every ``check_period``, the status.

        Raises
        ------
        DriverError
            The amplifier does not answer, has an error, or another program has closed its loop.
        """
        self._taken()
        if time.monotonic() - self._checked >= self._given.check_period:
            self._check()
        return Reading((self._measure(),))

    def write(self, voltages: Sequence[float]) -> None:
        """Send the voltage.

        Parameters
        ----------
        voltages : sequence of float
            [V]

        Raises
        ------
        DriverError
            The amplifier refuses the voltage.
        """
        self._taken()
        self._put_out(voltages[0])

    # -- end -----------------------------------------------------------------------------------------------------

    def make_safe(self) -> None:
        """Open the amplifier's loop, make this connection the only source of its setpoint, and go to the safe voltage.

        Raises
        ------
        DriverError
            The amplifier does not answer, or refuses a command.
        """
        if self._device is None:
            self._taken()
        else:
            self._make_safe()

    def _make_safe(self) -> None:
        device, given = self._device, self._given
        self._wait("opens its loop", lambda: device.pid.set_closed_loop(False))
        self._wait("selects the source of its setpoint", lambda: device.write("modsrc,0"))
        now = self._wait("is asked for its setpoint", device.get_setpoint)
        ramp(self._put_out, now, given.safe_voltage, given.safe_time)

    def close(self) -> None:
        """Disconnect and end the thread."""
        self._hang_up()
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._loop = None


DRIVER = HardwareDriver(
    name="nv200",
    title="the piezo amplifier NV200/D NET of piezosystem jena, through the manufacturer's package",
    parameters=Nv200Parameters,
    driver=Nv200Driver,
    emulator=later("hysteresis_ros.laboratory.emulation.nv200:emulator"),
    device="hysteresis_ros.laboratory.emulation.nv200:DEVICE",
    package="nv200",
)
