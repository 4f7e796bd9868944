# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An emulated NV200/D NET amplifier with its protocol and a simulated plant.

The commands follow the help texts of the manufacturer's package ``nv200`` 1.6. A line is a command with comma-separated
values. Its answer is enclosed by XOFF and XON, and is empty for a setting. An empty line requests the name of the
device.
"""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.hardware.driver import EmulatedDevice
from hysteresis_ros.hardware.drivers.nv200 import Nv200Parameters
from hysteresis_ros.laboratory.emulation.bench import Bench, DeviceFaults, EmulatedPlant, Running, Servo
from hysteresis_ros.laboratory.emulation.server import serving, serving_serial

NAME = "NV200/D_NET"
XON, XOFF = b"\x11", b"\x13"
#: Codes of errors.
NOT_SPECIFIED, UNKNOWN, MISSING, TOO_MANY, READ_ONLY, LOW, HIGH = 1, 2, 3, 5, 6, 9, 10
#: Bits of the status register.
CONNECTED, CAPACITIVE, CLOSED, HARDWARE = 1 << 0, 1 << 2, 1 << 3, 1 << 12
#: Length of the longest line [characters].
LONGEST = 1024
#: Assumed: largest velocity with the loop closed [m/s].
VELOCITY = 1.0e-3
MICROMETRE = 1.0e-6
#: Telnet commands, which do not belong to the device.
_TELNET = re.compile(rb"\xff(?:[\xfb-\xfe].|\xfa.*?\xff\xf0|[\xf0-\xf9\xff])", re.DOTALL)

#: Stored settings without effect: smallest, largest and initial value.
SETTINGS = {
    "modsrc": (0, 3, 0),
    "monsrc": (0, 7, 0),
    "spisrc": (0, 9, 0),
    "ctrlmode": (0, 3, 0),
    "sr": (8e-7, 2000.0, 2000.0),
    "kp": (0.0, 10000.0, 0.0),
    "ki": (0.0, 10000.0, 60.0),
    "kd": (0.0, 10000.0, 0.0),
    "setlpon": (0, 1, 0),
    "setlpf": (1, 10000, 1000),
    "poslpon": (0, 1, 0),
    "poslpf": (100, 10000, 1000),
    "notchon": (0, 1, 0),
    "notchf": (1, 10000, 500),
    "notchb": (1, 10000, 100),
}


class _Refusal(Exception):
    """Raised when a command is refused; the argument is the error code."""


class Amplifier:
    """The emulated amplifier."""

    def __init__(self, plant: EmulatedPlant, faults: DeviceFaults):
        self.plant, self.faults = plant, faults
        self.closed, self.settings = False, {name: first for name, (_, _, first) in SETTINGS.items()}
        self.unit, self.voltage_unit, self.sensor = "µm", "V", 2
        self._servo = Servo(plant)
        self.voltage, self.target = plant.voltage, plant.measured
        plant.control = self._control

    def _control(self, measured: float) -> float:
        return self._servo.follow(self.target, VELOCITY) if self.closed else self._servo.put_out(self.voltage)

    def session(self) -> Session:
        """Return the session with one client."""
        return Session(self)

    def tick(self) -> None:
        """Advance to the present time."""
        self.plant.advance()

    @property
    def setpoint_range(self) -> tuple[float, float]:
        """Range of the setpoint, in volts or micrometres."""
        limits = self.plant.limits
        scale = self.plant.gain / MICROMETRE if self.closed else 1.0
        return limits.minimum * scale, limits.maximum * scale

    def answer(self, line: str) -> str:
        """Return the answer to a line; empty for a setting."""
        self.tick()
        if not line.strip():
            return f"{NAME}>"
        name, *values = (word.strip() for word in line.split(","))
        try:
            return self._set(name, values) if values else self._said(name)
        except _Refusal as refusal:
            return f"error,{refusal.args[0]}"

    def _said(self, name: str) -> str:
        plant, limits = self.plant, self.plant.limits
        scale = plant.gain / MICROMETRE
        setpoint = self.target / MICROMETRE if self.closed else self.voltage
        known: dict[str, Callable[[], str]] = {
            "set": lambda: f"{setpoint:.3f}",
            "meas": lambda: f"{plant.measured / MICROMETRE if self.sensor else plant.voltage:.4f}",
            "cl": lambda: str(int(self.closed)),
            "stat": lambda: str(self._status()),
            "avmin": lambda: f"{limits.minimum:.3f}",
            "avmax": lambda: f"{limits.maximum:.3f}",
            "posmin": lambda: f"{limits.minimum * scale:.3f}",
            "posmax": lambda: f"{limits.maximum * scale:.3f}",
            "unitcl": lambda: self.unit,
            "unitol": lambda: self.voltage_unit,
            "desc": lambda: "EMULATED",
            "acserno": lambda: "0",
            "acmeasure": lambda: str(self.sensor),
            "temp": lambda: "25.0",
        }
        if name in known:
            return f"{name},{known[name]()}"
        if name in self.settings:
            return f"{name},{self.settings[name]:g}"
        raise _Refusal(UNKNOWN)

    def _status(self) -> int:
        sensor = CAPACITIVE if self.sensor else 0
        return CONNECTED | sensor | CLOSED * self.closed | HARDWARE * ("error" in self.faults)

    def _set(self, name: str, values: list[str]) -> str:
        if name not in ("set", "cl", *self.settings):
            try:
                self._said(name)
            except _Refusal:
                raise _Refusal(UNKNOWN) from None
            raise _Refusal(READ_ONLY)
        if len(values) > 1:
            raise _Refusal(TOO_MANY)
        try:
            value = float(values[0])
        except ValueError:
            raise _Refusal(MISSING) from None
        low, high = {"set": self.setpoint_range, "cl": (0.0, 1.0)}.get(name) or SETTINGS[name][:2]
        if not value >= low:
            raise _Refusal(LOW)
        if value > high or math.isinf(value):
            raise _Refusal(HIGH)
        lasting = self.faults.value("error")
        if lasting is not None or "busy" in self.faults:
            raise _Refusal(NOT_SPECIFIED if lasting is None else int(lasting))
        if name == "cl":
            self._switch(bool(value))
        elif name == "set" and self.closed:
            self.target = value * MICROMETRE
        elif name == "set":
            self.voltage = value
        else:
            self.settings[name] = value
        return ""

    def _switch(self, closed: bool) -> None:
        """Close the loop at the present position, or open it at the present voltage."""
        if closed and not self.closed:
            self._servo.begin()
            self.target = self._servo.way
        elif self.closed and not closed:
            self.voltage = self._servo.voltage
        self.closed = closed


class Session:
    """The session of an amplifier with one client."""

    def __init__(self, amplifier: Amplifier):
        self._amplifier, self._rest = amplifier, b""

    def feed(self, data: bytes) -> bytes:
        """Return the answers to received bytes."""
        *lines, self._rest = _TELNET.sub(b"", self._rest + data).split(b"\r")
        answers = [self._framed(line.strip(b"\n\x00 ")) for line in lines]
        if len(self._rest) > LONGEST:
            self._rest = b""
        return b"".join(answers)

    def _framed(self, line: bytes) -> bytes:
        answer = self._amplifier.answer(line[:LONGEST].decode("latin-1"))
        return XOFF + (answer.encode("latin-1") + b"\r\n" if answer else b"") + XON


@dataclass(frozen=True)
class EmulatedAmplifierParameters(Parameters):
    """Address of the emulated amplifier."""

    link: str = parameter(
        "tcp", choices=("tcp", "serial"), description="serial: a pseudo terminal, whose name is printed"
    )
    host: str = parameter("127.0.0.1", description="tcp: address to listen on")
    port: int = parameter(2300, description="TCP port; 0: a free one", low=0, high=65535)


@contextlib.contextmanager
def start(given: EmulatedAmplifierParameters, bench: Bench) -> Iterator[Running]:
    """Run an emulated amplifier."""
    faults = DeviceFaults(time.monotonic, bench.faults)
    amplifier = Amplifier(EmulatedPlant(bench.plant, bench.cycle), faults)
    if given.link == "serial":
        with serving_serial(amplifier.session(), amplifier.tick, faults) as path:
            yield Running(f"{NAME} at {path}", Nv200Parameters(serial_port=path), faults)
        return
    with serving((given.host, given.port), amplifier.session, amplifier.tick, faults) as server:
        driver = Nv200Parameters(host=given.host, port=server.port, configure_link=False)
        yield Running(f"{NAME} at {given.host}:{server.port}", driver, faults)


@contextlib.contextmanager
def emulator() -> Iterator[Parameters]:
    """Run an emulated amplifier at a pseudo terminal, and yield the parameters of its driver."""
    with start(EmulatedAmplifierParameters(link="serial"), Bench()) as running:
        yield running.driver


DEVICE = EmulatedDevice(EmulatedAmplifierParameters, start)
