# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The driver of controllers that speak GCS 2.0: open-loop voltages out, or targets of their servo; positions back."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.errors import Problem
from hysteresis_ros.hardware.bringup import highest_rate, ramp
from hysteresis_ros.hardware.driver import Capabilities, Driver, DriverError, Reading
from hysteresis_ros.hardware.drivers.gcs.link import GcsLink
from hysteresis_ros.hardware.drivers.gcs.protocol import (
    AXIS_UNIT,
    GENERATOR_STATUS,
    MOTION_STATUS,
    NO_ERROR,
    POSITION,
    READY,
    READY_STATUS,
    RECORD_TABLES,
    SERVO_CYCLE,
    UNITS,
    VOLTAGE,
    VOLTAGE_MAXIMUM,
    VOLTAGE_MINIMUM,
    WAVE_POINTS,
)
from hysteresis_ros.parameters import Parameters, parameter

#: Voltages that the output may still be at when it is looked at.
RECENT = 4
#: Points of a wave that are sent at a time, and how often is looked whether it has been played [s].
POINTS, PATIENCE = 40, 0.02
#: How often it is tried to make a controller safe, each time but the first on a new connection.
ATTEMPTS = 3
#: Part of a value that a controller may round away when it says what it was commanded.
ROUNDING = 1.0e-3
#: Servo cycles are at most so many times as long as what is played by them.
LONGEST = 1.0e6


@dataclass(frozen=True)
class GcsParameters(Parameters):
    """Which controller and axis, and what is commanded."""

    host: str = parameter("127.0.0.1", description="name or address of the controller", read_only=True)
    port: int = parameter(50000, description="its TCP port", low=1, high=65535, read_only=True)
    identification: str = parameter(
        "", description="what its answer to *IDN? contains, for instance E-754; '': anything", read_only=True
    )
    axis: str = parameter("1", description="name of the axis", read_only=True)
    channel: str = parameter(
        "", description="name of its output signal channel, for VOL?; '': that of the axis", read_only=True
    )
    mode: str = parameter(
        "open_loop",
        choices=("open_loop", "servo"),
        description="open_loop: SVA, servo off; servo: MOV, servo on, a volt being servo_scale",
        read_only=True,
    )
    open_loop_scale: float = parameter(
        1.0, description="volts at the output for one unit of SVA", unit="V", low=1e-6, high=1e6, read_only=True
    )
    servo_scale: float = parameter(
        1.0e-6, description="servo: target for a volt", unit="m/V", low=1e-12, high=1.0, read_only=True
    )
    position_unit: str = parameter(
        "",
        choices=("", *UNITS),
        description="unit of its positions, which it must have when it says one; '': what it says",
        read_only=True,
    )
    safe_voltage: float = parameter(
        0.0, description="voltage of the safe state", unit="V", low=-1.0e4, high=1.0e4, read_only=True
    )
    safe_time: float = parameter(
        0.2, description="time in which it goes there by itself", unit="s", low=0.0, high=10.0, read_only=True
    )
    voltage_range: tuple[float, ...] = parameter(
        (),
        description="open_loop: least and greatest voltage of a controller that does not say them",
        unit="V",
        read_only=True,
    )
    voltage_tolerance: float = parameter(
        2.0,
        description="open_loop: largest difference of VOL? and the voltage",
        unit="V",
        low=1e-3,
        high=1e3,
        read_only=True,
    )
    check_period: float = parameter(
        0.2,
        description="how often servo and voltage are looked at",
        unit="s",
        low=1e-3,
        high=60.0,
        read_only=True,
    )
    timeout: float = parameter(
        0.5, description="time within which it answers", unit="s", low=0.001, high=60.0, read_only=True
    )

    def check(self):
        """Yield what does not fit together."""
        if self.voltage_range and not (len(self.voltage_range) == 2 and self.voltage_range[0] < self.voltage_range[1]):
            yield Problem("voltage_range", self.voltage_range, "give the least and the greatest voltage, or nothing")


class Played(NamedTuple):
    """What a controller has played and recorded by itself, arrays of shape (N,)."""

    #: [s]
    time: np.ndarray
    #: At the output [V].
    voltage: np.ndarray
    #: [m]
    position: np.ndarray


class GcsDriver(Driver):
    """One axis of a controller; one that has failed is taken anew when it is read again."""

    _link: GcsLink | None = None
    _given: GcsParameters
    _failed = False

    def __init__(self) -> None:
        self._recent: deque[float] = deque(maxlen=RECENT)

    def open(self, parameters: GcsParameters, sample_rate: float) -> Capabilities:
        """Connect, look whether it is the right one, bring it to its safe state and try how fast it is.

        Parameters
        ----------
        parameters : GcsParameters
        sample_rate : float
            [Hz]

        Raises
        ------
        DriverError
            It cannot be reached, is another one, is in motion, busy or in error, or has other units.
        """
        self._given = parameters
        link = self._taken(first=True)
        low, high = self._range
        safe = self._command(parameters.safe_voltage)
        rate = highest_rate(lambda: link.send(safe), lambda: link.numbers(("POS?", parameters.axis)))
        return Capabilities(joints=1, voltages=1, minimum=low, maximum=high, highest_rate=rate)

    # -- taking the controller -----------------------------------------------------------------------------------

    def _taken(self, first: bool = False) -> GcsLink:
        """Return the link to the controller, in its safe state when it had to be taken."""
        given = self._given
        if self._link is not None and self._link.broken:
            self._hang_up()
        if self._link is None or self._failed:
            self._failed = True
            self._link = self._link or GcsLink(given.host, given.port, given.timeout)
            self._take(self._link, first)
            self._failed = False
        return self._link

    def _take(self, link: GcsLink, first: bool) -> None:
        given = self._given
        said = link.ask("*IDN?")[0]  # and what went wrong before is over
        if given.identification.lower() not in said.lower():
            problem = f"says it is {said!r}, which does not contain gcs.identification = {given.identification!r}"
            raise DriverError(link.name, problem, "give the address of the right one, or its name")
        axes = link.ask("SAI?")
        if given.axis not in axes:
            problem = f"has no axis {given.axis!r}, it has {', '.join(axes)}"
            raise DriverError(link.name, problem, "give one of them as gcs.axis")
        self._commands = {line.split()[0].upper() for line in link.ask("HLP?") if line.split()}
        if first:
            self._require_rest(link)
        self._unit = self._unit_of(link)
        low, high = self._range = self._range_of(link)
        if not low <= given.safe_voltage <= high:
            problem = f"has a range of {low:g} … {high:g} V without gcs.safe_voltage = {given.safe_voltage:g} V"
            raise DriverError(link.name, problem, "give one within it")
        self._make_safe(link)
        self._check(link, *link.numbers(*self._looks))

    def _require_rest(self, link: GcsLink) -> None:
        """Refuse a controller that is not ready, or moves an axis for somebody else."""
        if "#7" in self._commands and link.ask_single(READY_STATUS).encode("latin-1")[:1] != READY:
            raise DriverError(link.name, "is busy with something else", "wait until it is ready, or stop that")
        for command, character in (("#5", MOTION_STATUS), ("#9", GENERATOR_STATUS)):
            if command in self._commands and link.ask_single(character).lower().lstrip("0x"):
                remedy = "end the program that moves it, stop its wave generator"
                raise DriverError(link.name, f"is in motion ({command})", remedy)
        if "FRF?" in self._commands and link.number("FRF?", self._given.axis) != 1.0:
            raise DriverError(link.name, f"has not referenced axis {self._given.axis}", "reference it first (FRF)")

    def _unit_of(self, link: GcsLink) -> float:
        """Return the metres of a unit of the positions."""
        given, said = self._given, ""
        if "PUN?" in self._commands:
            said = link.value("PUN?", given.axis)
        else:
            said = link.find("SPA?", f"{given.axis} {AXIS_UNIT:#x}") or ""
        unit = said.lower() or given.position_unit
        if unit not in UNITS:
            problem = f"measures axis {given.axis} in {said}" if said else f"does not say the unit of axis {given.axis}"
            raise DriverError(link.name, problem, f"an axis needs one of {', '.join(UNITS)} (gcs.position_unit)")
        if given.position_unit and UNITS[unit] != UNITS[given.position_unit]:
            problem = f"measures axis {given.axis} in {said}, gcs.position_unit is {given.position_unit}"
            raise DriverError(link.name, problem, "make them equal")
        return UNITS[unit]

    def _range_of(self, link: GcsLink) -> tuple[float, float]:
        """Return the range of what is commanded [V]."""
        given = self._given
        if given.mode == "servo":
            volts = self._unit / given.servo_scale
            return link.number("TMN?", given.axis) * volts, link.number("TMX?", given.axis) * volts
        if {"VMI?", "VMA?"} <= self._commands:
            return link.number("VMI?", self._channel), link.number("VMA?", self._channel)
        if given.voltage_range:
            return given.voltage_range[0], given.voltage_range[1]
        items = [f"{self._channel} {number:#x}" for number in (VOLTAGE_MINIMUM, VOLTAGE_MAXIMUM)]
        if any(link.find("SPA?", item) is None for item in items):
            raise DriverError(link.name, "does not say its voltages", "give gcs.voltage_range")
        return link.number("SPA?", items[0]), link.number("SPA?", items[1])

    @property
    def _channel(self) -> str:
        return self._given.channel or self._given.axis

    # -- samples -------------------------------------------------------------------------------------------------

    def read(self) -> Reading:
        """Ask for the position and the last error, and now and then for servo and voltage.

        Raises
        ------
        DriverError
            It does not answer what it is asked, has an error, or somebody else has switched its servo or commands its
            voltage.
        """
        link, given = self._taken(), self._given
        due = time.monotonic() - self._checked >= given.check_period
        try:
            (position, *others), code = link.numbers(("POS?", given.axis), *(self._looks if due else ()))
            if code != NO_ERROR and not due:  # what has been changed says more than what was refused because of it
                (others, _), due = link.numbers(*self._looks), True
            if due:
                self._check(link, others, code)
            link.require(code, "has an error")
            return Reading((self._unit * position,))
        except DriverError:
            self._failed = True
            raise

    @property
    def _looks(self) -> tuple[tuple[str, str], ...]:
        """What is asked to see whether the controller is as this driver left it."""
        servo = ("SVO?", self._given.axis)
        looks = self._given.mode == "open_loop" and "VOL?" in self._commands
        return (servo, ("VOL?", self._channel)) if looks else (servo,)

    def _check(self, link: GcsLink, answers: list[float], code: int) -> None:
        """Refuse a controller that is not as this driver left it."""
        given, (servo, *voltage) = self._given, answers
        on = given.mode == "servo"
        if bool(servo) != on:
            problem = f"has its servo switched {'off' if on else 'on'} by somebody else"
            raise DriverError(link.name, problem, "end the program that does so")
        link.require(code, "has an error")
        if voltage:
            (there,), tolerance = voltage, given.voltage_tolerance
            low, high = min(self._recent), max(self._recent)
            if not low - tolerance <= there <= high + tolerance:
                problem = f"puts out {there:g} V where {self._recent[-1]:g} V are commanded"
                remedy = "look at gcs.open_loop_scale, the amplifier, and programs that command it too"
                raise DriverError(link.name, problem, remedy)
        self._checked = time.monotonic()

    def write(self, voltages: Sequence[float]) -> None:
        """Send the voltage, or the target that it stands for.

        Parameters
        ----------
        voltages : sequence of float
            [V]

        Raises
        ------
        DriverError
            The connection is gone.
        """
        self._taken().send(self._command(voltages[0]))
        self._recent.append(voltages[0])

    def _command(self, voltage: float) -> str:
        name = "MOV" if self._given.mode == "servo" else "SVA"
        return f"{name} {self._given.axis} {self._value(voltage):.9f}"

    def _value(self, voltage: float) -> float:
        """Return what the controller is told for a voltage."""
        given = self._given
        return voltage * given.servo_scale / self._unit if given.mode == "servo" else voltage / given.open_loop_scale

    # -- without a sample of the package -------------------------------------------------------------------------

    def play(self, voltages: Sequence[float], period: float) -> Played:
        """Let the wave generator play voltages and the recorder write down what comes of it, at the controller's pace.

        Parameters
        ----------
        voltages : sequence of float
            [V], or what stands for targets of the servo.
        period : float
            Time between two of them [s], rounded to samples of the controller.

        Returns
        -------
        Played

        Raises
        ------
        DriverError
            They are out of range or too many, or the controller has no generator or recorder.
        """
        link, given = self._taken(), self._given
        missing = {"WAV", "WGO", "DRC", "DRR?"} - self._commands
        if missing:
            raise DriverError(link.name, f"does not know {', '.join(sorted(missing))}", "send the voltages one by one")
        (low, high), item = self._range, f"{given.axis} {SERVO_CYCLE:#x}"
        longest = int(link.number("SPA?", f"{given.axis} {WAVE_POINTS:#x}"))
        if not 0 < len(voltages) <= longest or not low <= min(voltages) <= max(voltages) <= high:
            problem = f"plays up to {longest} voltages within {low:g} … {high:g} V"
            raise DriverError(link.name, problem, "give fewer or smaller ones")
        cycle = link.number("SPA?", item)
        if not 0.0 < cycle < period * LONGEST:
            raise DriverError(
                link.name, f"says a servo cycle of {cycle:g} s", "look at the controller and its firmware"
            )
        rate = max(round(period / cycle), 1)
        ramp(lambda voltage: link.do(self._command(voltage)), self._recent[-1], voltages[0], given.safe_time)
        self._define(link, [self._value(voltage) for voltage in voltages], rate)
        link.do(f"WGO {given.axis} 1")
        while link.number("DRL?", "1") < len(voltages) or link.ask_single(GENERATOR_STATUS).lower().lstrip("0x"):
            time.sleep(PATIENCE)
        sample, rows = link.table(f"DRR? 1 {len(voltages)}", 2)
        self._recent.extend(voltages[-RECENT:])
        return Played(sample * np.arange(len(rows)), rows[:, 0], self._unit * rows[:, 1])

    def _define(self, link: GcsLink, values: list[float], rate: int) -> None:
        """Write the wave table and say what is recorded."""
        given = self._given
        for first in range(0, len(values), POINTS):
            part = values[first : first + POINTS]
            points = " ".join(f"{value:.6f}" for value in part)
            link.do(f"WAV 1 {'&' if first else 'X'} PNT {first + 1} {len(part)} {points}")
        link.do(f"WSL {given.axis} 1", f"WGC {given.axis} 1", f"WTR 0 {rate} 0", f"RTR {rate}")
        link.do(f"SPA {given.axis} {RECORD_TABLES} 2", f"DRC 1 {self._channel} {VOLTAGE} 2 {given.axis} {POSITION}")

    # -- end -----------------------------------------------------------------------------------------------------

    def make_safe(self) -> None:
        """Stop all motion, then go to the safe voltage, or the place that it stands for; on a new link if need be.

        Raises
        ------
        DriverError
            It does not answer, or refuses, each time that it is tried.
        """
        for attempt in range(ATTEMPTS):
            try:
                if self._link is None or self._link.broken:
                    self._taken()
                else:
                    self._make_safe(self._link)
                return
            except DriverError:
                self._hang_up()
                if attempt + 1 == ATTEMPTS:
                    raise

    def _make_safe(self, link: GcsLink) -> None:
        given = self._given
        safe = given.safe_voltage
        link.stop()
        if given.mode == "servo":
            link.do(f"SVO {given.axis} 1", self._command(safe))
            self._require_there(link, "MOV?", safe)
            self._recent = deque([safe], RECENT)
            return
        link.do(f"SVO {given.axis} 0")
        now = link.number("SVA?", given.axis) * given.open_loop_scale
        self._recent = deque([now], RECENT)

        def put_out(voltage: float) -> None:
            self._recent.append(voltage)
            link.do(self._command(voltage))

        ramp(put_out, now, safe, given.safe_time)
        self._require_there(link, "SVA?", safe)

    def _require_there(self, link: GcsLink, question: str, safe: float) -> None:
        """Make sure that the controller was given the safe value, whatever else it has answered."""
        value = self._value(safe)
        given = link.number(question, self._given.axis)
        if not abs(given - value) <= ROUNDING * max(abs(value), abs(given), 1.0):
            problem = f"says {given:g} to {question!r} where {value:g} was commanded to make it safe"
            raise DriverError(link.name, problem, "end other programs that command it, look at its limits")

    @property
    def last_output(self) -> float | None:
        """Voltage that was commanded last, also on the way to the safe one [V]."""
        return self._recent[-1] if self._recent else None

    def close(self) -> None:
        """Hang up."""
        self._hang_up()

    def _hang_up(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
            self._failed = True
