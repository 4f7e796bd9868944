# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Controllers of Physik Instrumente with GCS 2.0 over TCP: E-709, E-727, E-754 and similar ones.

This module contains the commands of the protocol, which the emulated controller uses too, the link and the driver.

Sources: E-727 Digital Multi-Channel Piezo Controller, user manual E727T0005 (2019), sections "GCS commands", "Data
recorder" and "Wave generator"; C-863 Mercury Controller, user manual MS249E, section "GCS commands" (answers of
``DRR?`` and ``HPA?``). Commands and answers end with LF. In an answer of several lines, every line but the last has a
space before the LF. Commands of one character need no LF.
"""

from __future__ import annotations

import contextlib
import math
import re
import select
import socket
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.hardware.driver import (
    Capabilities,
    Driver,
    DriverError,
    HardwareDriver,
    Reading,
    highest_rate,
    ramp,
)
from hysteresis_ros.registry import later

#: Commands of one character: status register, motion status, ready status, status of the wave generator, stop.
STATUS, MOTION_STATUS, READY_STATUS, GENERATOR_STATUS, STOP = "\x04", "\x05", "\x07", "\x09", "\x18"
#: Answers to :data:`READY_STATUS`.
READY, NOT_READY = b"\xb1", b"\xb0"

#: Codes of ``ERR?`` and their meanings.
NO_ERROR, SYNTAX, UNKNOWN_COMMAND, TOO_LONG = 0, 1, 2, 3
SERVO_OFF, POSITION_LIMIT, STOPPED, WRONG_AXIS, OUT_OF_RANGE = 5, 7, 10, 15, 17
WRONG_COUNT, UNKNOWN_PARAMETER, READ_ONLY, SERVO_ON = 24, 54, 64, 79
NO_TABLE, GENERATOR_RUNS, NO_WAVE, VOLTAGE_LIMIT = 57, 73, 75, 302
WAVE_TYPE, WAVE_LENGTH, BUSY = 402, 403, 1005

MEANINGS = {
    NO_ERROR: "no error",
    SYNTAX: "a parameter of the command is not a number",
    UNKNOWN_COMMAND: "the command is not known",
    TOO_LONG: "the command is too long",
    SERVO_OFF: "a move was commanded with the servo off, or for an axis that is not referenced",
    POSITION_LIMIT: "the position is beyond the limits",
    8: "the velocity is beyond the limits, or the axis is not referenced",
    STOPPED: "the motion was stopped by a command",
    WRONG_AXIS: "there is no such axis",
    OUT_OF_RANGE: "a parameter is out of range",
    WRONG_COUNT: "the number of parameters is wrong",
    UNKNOWN_PARAMETER: "there is no such parameter",
    NO_TABLE: "there is no such record table",
    READ_ONLY: "the parameter is read only",
    66: "the voltage is beyond the limits",
    GENERATOR_RUNS: "a move was commanded while the wave generator runs",
    NO_WAVE: "the wave generator has no wave table",
    SERVO_ON: "an open-loop command was sent with the servo on",
    215: "the connection between controller and stage may be broken",
    VOLTAGE_LIMIT: "the voltage is beyond the limits",
    333: "a hardware fault",
    WAVE_TYPE: "there is no such type of wave",
    WAVE_LENGTH: "the wave is too long",
    602: "a fault in the high-voltage supply",
    603: "the temperature is out of range",
    BUSY: "the controller is busy with a lengthy operation",
}

#: Metres per unit, in the spelling of controllers.
UNITS = {"m": 1.0, "mm": 1.0e-3, "um": 1.0e-6, "µm": 1.0e-6, "nm": 1.0e-9}

#: Numbers of the controller's parameters.
RANGE_MINIMUM, RANGE_MAXIMUM, AXIS_UNIT = 0x07000000, 0x07000001, 0x07000601
VOLTAGE_MINIMUM, VOLTAGE_MAXIMUM = 0x0B000007, 0x0B000008
SERVO_CYCLE, WAVE_POINTS, RECORD_POINTS, RECORD_TABLES = 0x0E000200, 0x13000004, 0x16000200, 0x16000300
TOLERANCE, SETTLING = 0x07000900, 0x07000901

#: Parameters of a trigger output (CTO): distance of the positions, axis, mode, first and last position. Then the mode
#: that triggers at equally spaced positions. If the first position is below the last, the output triggers during upward
#: motion, otherwise during downward motion.
TRIGGER_STEP, TRIGGER_AXIS, TRIGGER_MODE, START_THRESHOLD, STOP_THRESHOLD = 1, 2, 3, 8, 9
POSITION_DISTANCE = 0

#: Contents of a record table.
TARGET, POSITION, POSITION_ERROR, CONTROL_VOLTAGE, OPEN_LOOP, VOLTAGE = 1, 2, 3, 7, 14, 16


def meaning(code: int) -> str:
    """Return the meaning of a code of ``ERR?``.

    Parameters
    ----------
    code : int
    """
    return f"error {code}: {MEANINGS.get(code, 'see ERR? in the manual of the controller')}"


#: End of an answer.
END = b"\n"
#: End of a line that is followed by another line of the same answer.
MORE = b" \n"
#: Maximum number of bytes per read.
CHUNK = 65536
#: More bytes than this without the end of a line are a fault, or come from another kind of device.
LONGEST_LINE = 1 << 20
#: An answer that continues after more than this number of lines is a fault, or comes from another kind of device.
MOST_LINES = 1 << 20
#: Maximum number of bytes of an answer that a message quotes.
SHOWN = 60
#: Query of the last error.
ERROR = "ERR?"
#: Pattern of the answer to the query of the last error, which no other answer in a sample matches.
CODE = re.compile(r"-?[0-9]{1,9}")


def _names(text: str) -> list[str]:
    """Return the words of a text, with hexadecimal numbers converted to decimal."""
    with contextlib.suppress(ValueError):
        return [str(int(word, 16)) if word[:2].lower() == "0x" else word for word in text.split()]
    return []


class GcsLink:
    """The connection to a controller: commands, answers and errors.

    Answers have no number that assigns them to queries. So no answer may be pending when a query is sent, each answer
    must match its query, and each exchange contains the answer to ``ERR?``, which has a form of its own. After a
    mismatch or a missing answer the link is not used any more, because each query would then get the answer to another
    one.

    Parameters
    ----------
    host : str
        Name or address.
    port : int
    timeout : float
        Time within which the controller accepts the connection and answers [s].

    Attributes
    ----------
    name : str
        For messages.
    broken : bool
        Whether the link can no longer be used.

    Raises
    ------
    DriverError
        The controller cannot be reached.
    """

    def __init__(self, host: str, port: int, timeout: float):
        self.name = f"controller at {host}:{port}"
        self.broken = False
        self._rest = b""
        self._leads = False
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except OSError as error:
            remedy = "switch it on, check address and network, end other programs that use it"
            raise DriverError(self.name, f"cannot be reached ({error})", remedy) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, *commands: str) -> None:
        """Send commands that have no answer.

        Parameters
        ----------
        *commands : str
            Commands without line ends.

        Raises
        ------
        DriverError
            The connection is lost, or an unexpected line was received.
        """
        self._put("".join(f"{command}\n" for command in commands), commands[0])

    def _put(self, text: str, what: str) -> None:
        self._require_silence(what)
        try:
            self._socket.sendall(text.encode("latin-1"))
        except OSError as error:
            raise self._gone(f"does not accept {what!r} ({error})") from error

    def _require_silence(self, what: str) -> None:
        """Refuse an unexpected line, because it would shift every later answer to another query."""
        said = self._rest
        if not said and select.select([self._socket], [], [], 0.0)[0]:
            said = self._receive(what)
        if said:
            text = said[:SHOWN].decode("latin-1")
            raise self._astray(f"sends {text!r} before {what!r}, an unexpected line")

    def _gone(self, problem: str) -> DriverError:
        self.broken = True
        return DriverError(self.name, problem, "check controller, network and other programs that use it")

    def _astray(self, problem: str) -> DriverError:
        """Return the error for an answer that does not match its query, and mark the link as broken."""
        self.broken = True
        return DriverError(self.name, problem, "give the address of a controller with GCS 2.0, check its network")

    def _receive(self, asked: str) -> bytes:
        try:
            data = self._socket.recv(CHUNK)
        except OSError as error:
            raise self._gone(f"does not answer {asked!r} ({error})") from error
        if not data:
            raise self._gone(f"has closed the connection at {asked!r}: it is off, or in use by another program")
        return data

    def _line(self, asked: str) -> bytes:
        while END not in self._rest:
            if len(self._rest) > LONGEST_LINE:
                raise self._gone(f"answers {asked!r} with more than {LONGEST_LINE} characters and no line end")
            self._rest += self._receive(asked)
        line, _, self._rest = self._rest.partition(END)
        return line + END

    def _lines(self, question: str) -> list[str]:
        lines = [self._line(question)]
        while lines[-1].endswith(MORE):
            if len(lines) > MOST_LINES:
                raise self._gone(f"answers {question!r} with more than {MOST_LINES} lines")
            lines.append(self._line(question))
        return [line.decode("latin-1").rstrip() for line in lines]

    def ask(self, question: str) -> list[str]:
        """Return the lines of the answer to a query; the answer to ``ERR?`` must follow them.

        DriverError: no answer, or a line is missing or unexpected.
        """
        self.send(question, ERROR)
        lines = self._lines(question)
        self._code()
        return lines

    def ask_single(self, character: str) -> str:
        """Return the answer to a command of one character; DriverError: no answer."""
        name = f"#{ord(character)}"
        self._put(character, name)
        return self._line(name).decode("latin-1").rstrip()

    def find(self, question: str, item: str) -> str | None:
        """Return the value of an item, such as ``2.5`` of item ``1`` in ``1=2.5``; None if the query is refused."""
        return self._asked(question, item)[0]

    def value(self, question: str, item: str) -> str:
        """Return the value of an item; raise DriverError if the query is refused or the answer names another item."""
        text, code = self._asked(question, item)
        if text is None:
            problem = f"does not answer '{question} {item}': {meaning(code)}"
            raise DriverError(self.name, problem, f"give a controller with GCS 2.0 that has {item}")
        return text

    def _asked(self, question: str, item: str) -> tuple[str | None, int]:
        asked = f"{question} {item}"
        self.send(asked, ERROR)
        lines = self._lines(asked)
        if CODE.fullmatch(lines[0]) and int(lines[0]) != NO_ERROR:
            return None, int(lines[0])  # the query got no answer, so this line is the answer to ERR?
        text = self._of_item(asked, item, lines)
        return text, self._code()

    def _of_item(self, asked: str, item: str, lines: list[str]) -> str:
        left, mark, right = lines[0].partition("=")
        if not mark or len(lines) != 1 or _names(left) != _names(item):
            raise self._astray(f"answers {asked!r} with {lines[0]!r}")
        return right.strip()

    def number(self, question: str, item: str) -> float:
        """Return the value of an item as a number; raise DriverError if it is not a number."""
        return self._real(f"{question} {item}", self.value(question, item))

    def _real(self, asked: str, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            raise self._astray(f"answers {asked!r} with {text!r}, which is not a number") from None

    def numbers(self, *questions: tuple[str, str]) -> tuple[list[float], int]:
        """Query several items in one exchange; return their numbers and the code of the last error.

        The answer to ``ERR?`` has no equals sign. ``ERR?`` is sent alternately after and before the query of a single
        item, and both before and after the queries of several items. So an extra, missing or repeated line cannot shift
        a number to another item.

        Parameters
        ----------
        *questions : tuple of (str, str)
            Question and item.

        Raises
        ------
        DriverError
            An answer is missing or does not match its query.
        """
        several = len(questions) > 1
        before, behind = several or self._leads, several or not self._leads
        self._leads = not several and not self._leads
        asked = [f"{question} {item}" for question, item in questions]
        self.send(*[ERROR] * before, *asked, *[ERROR] * behind)
        codes = [self._code()] if before else []
        texts = [self._of_item(text, item, self._lines(text)) for text, (_, item) in zip(asked, questions, strict=True)]
        codes += [self._code()] if behind else []
        values = [self._real(*pair) for pair in zip(asked, texts, strict=True)]
        return values, next((code for code in codes if code != NO_ERROR), NO_ERROR)

    def table(self, question: str, tables: int) -> tuple[float, np.ndarray]:
        """Return sample time [s] and numbers, shape (points, tables), of an answer that is an array.

        Parameters
        ----------
        question : str
        tables : int
            Number of tables.

        Raises
        ------
        DriverError
            The answer is not an array.
        """
        lines = self.ask(question)
        head = dict(line[1:].split("=", 1) for line in lines if line.startswith("#") and "=" in line)
        head = {name.strip(): text.strip() for name, text in head.items()}
        try:
            separator = chr(int(head["SEPARATOR"]))
            rows = [line.split(separator) for line in lines if not line.startswith("#")]
            sample_time = float(head["SAMPLE_TIME"])
            if not (int(head["DIM"]) == tables and 0.0 < sample_time < math.inf):
                raise ValueError(f"{head['DIM']} tables of {sample_time:g} s")
            return sample_time, np.array(rows, dtype=float).reshape(int(head["NDATA"]), tables)
        except (KeyError, ValueError, OverflowError) as error:
            problem = f"answers {question!r} with no array ({type(error).__name__}: {error})"
            raise DriverError(self.name, problem, "check the controller and its firmware") from None

    def error(self) -> int:
        """Return the code of the last error; the query clears it.

        Raises
        ------
        DriverError
            The answer is not a code.
        """
        self.send(ERROR)
        return self._code()

    def _code(self) -> int:
        """Return the code in the next answer."""
        lines = self._lines(ERROR)
        if len(lines) != 1 or not CODE.fullmatch(lines[0]):
            raise self._astray(f"answers {ERROR!r} with {lines[0]!r}")
        return int(lines[0])

    def require(self, code: int, what: str) -> None:
        """Raise an error unless the code is 0.

        Parameters
        ----------
        code : int
        what : str
            Description of the failed action, for the message.

        Raises
        ------
        DriverError
            The code is not 0.
        """
        if code != NO_ERROR:
            raise DriverError(self.name, f"{what}: {meaning(code)}", "remove the cause at the controller")

    def do(self, *commands: str) -> None:
        """Send commands and check that none was refused.

        Parameters
        ----------
        *commands : str

        Raises
        ------
        DriverError
            A command was refused.
        """
        self.send(*commands)
        self.require(self.error(), f"refuses {commands[-1][:40]!r}")

    def stop(self) -> None:
        """Stop all motion and clear the error that the controller reports because of the stop.

        Raises
        ------
        DriverError
            The controller does not answer, or reports another error.
        """
        self._put(STOP, f"#{ord(STOP)}")
        code = self.error()
        if code != STOPPED:
            self.require(code, "does not stop")

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._socket.close()


#: Number of stored recent voltages; a check allows any output between the lowest and the highest of them.
RECENT = 4
#: Maximum number of points of a wave in one command.
POINTS = 40
#: Polling interval for the end of the wave [s].
PATIENCE = 0.02
#: Number of attempts to make a controller safe; every attempt after the first uses a new connection.
ATTEMPTS = 3
#: Largest allowed variation of the steps of a grid, relative to the largest position.
UNEVEN = 1.0e-6
#: Largest relative difference between commanded and reported value that is attributed to rounding in the controller.
ROUNDING = 1.0e-3
#: Limit of a plausible servo cycle, relative to the period of the played voltages.
LONGEST = 1.0e6


@dataclass(frozen=True)
class GcsParameters(Parameters):
    """Address and axis of the controller, and the commanded quantity."""

    host: str = parameter("127.0.0.1", description="name or address of the controller", read_only=True)
    port: int = parameter(50000, description="TCP port of the controller", low=1, high=65535, read_only=True)
    identification: str = parameter(
        "", description="text that the answer to *IDN? must contain, for instance E-754; '': any", read_only=True
    )
    axis: str = parameter("1", description="name of the axis", read_only=True)
    channel: str = parameter(
        "", description="name of the output signal channel, for VOL?; '': the name of the axis", read_only=True
    )
    mode: str = parameter(
        "open_loop",
        choices=("open_loop", "servo"),
        description="open_loop: SVA with the servo off; servo: MOV with the servo on, one volt is servo_scale",
        read_only=True,
    )
    open_loop_scale: float = parameter(
        1.0, description="volts at the output for one unit of SVA", unit="V", low=1e-6, high=1e6, read_only=True
    )
    servo_scale: float = parameter(
        1.0e-6, description="servo: target displacement per volt", unit="m/V", low=1e-12, high=1.0, read_only=True
    )
    position_unit: str = parameter(
        "",
        choices=("", *UNITS),
        description="unit of the controller's positions, which must match the unit that it reports; '': the "
        "reported unit",
        read_only=True,
    )
    safe_voltage: float = parameter(
        0.0, description="voltage of the safe state", unit="V", low=-1.0e4, high=1.0e4, read_only=True
    )
    safe_time: float = parameter(
        0.2, description="time of the ramp to the safe voltage", unit="s", low=0.0, high=10.0, read_only=True
    )
    voltage_range: tuple[float, ...] = parameter(
        (),
        description="open_loop: least and greatest voltage, for a controller without the commands VMI? and VMA?",
        unit="V",
        read_only=True,
    )
    voltage_tolerance: float = parameter(
        2.0,
        description="open_loop: largest difference between VOL? and the commanded voltage",
        unit="V",
        low=1e-3,
        high=1e3,
        read_only=True,
    )
    check_period: float = parameter(
        0.2,
        description="time between two checks of servo and voltage",
        unit="s",
        low=1e-3,
        high=60.0,
        read_only=True,
    )
    trigger_line_up: int = parameter(
        0,
        description="digital output that triggers during upward motion, by the controller's own position compare (CTO, "
        "TRO); 0: none",
        low=0,
        high=16,
        read_only=True,
    )
    trigger_line_down: int = parameter(
        0, description="the same for downward motion; 0: none", low=0, high=16, read_only=True
    )
    trigger_input: int = parameter(
        0,
        description="digital input whose rising edges are pulses of the trigger input (DIO?); 0: none",
        low=0,
        high=16,
        read_only=True,
    )
    timeout: float = parameter(
        0.5, description="time within which the controller must answer", unit="s", low=0.001, high=60.0, read_only=True
    )

    def check(self):
        """Yield a Problem for each inconsistency."""
        if self.voltage_range and not (len(self.voltage_range) == 2 and self.voltage_range[0] < self.voltage_range[1]):
            yield Problem("voltage_range", self.voltage_range, "give the least and the greatest voltage, or nothing")
        if self.trigger_line_up and self.trigger_line_up == self.trigger_line_down:
            yield Problem("trigger_line_down", self.trigger_line_down, "must differ from trigger_line_up")

    @property
    def trigger_lines(self) -> tuple[int, ...]:
        """Digital outputs that trigger."""
        return tuple(line for line in (self.trigger_line_up, self.trigger_line_down) if line)


class Played(NamedTuple):
    """Data that a controller has played and recorded at its own sample rate, arrays of shape (N,)."""

    #: [s]
    time: np.ndarray
    #: Output voltage [V].
    voltage: np.ndarray
    #: [m]
    position: np.ndarray


class GcsDriver(Driver):
    """One axis of a controller; after a failure, the next read connects again."""

    _link: GcsLink | None = None
    _given: GcsParameters
    _failed = False
    #: Commands that make the controller compare positions, and whether these commands are in effect.
    _comparing: tuple[str, ...] = ()
    _compares = False
    #: Last state of the trigger input, and number of pulses since the last call of :meth:`pulses`.
    _high = math.nan
    _pulses = 0

    def __init__(self) -> None:
        self._recent: deque[float] = deque(maxlen=RECENT)

    def open(self, parameters: GcsParameters, sample_rate: float) -> Capabilities:
        """Connect, check the controller, bring it to its safe state, and measure the highest rate.

        Parameters
        ----------
        parameters : GcsParameters
        sample_rate : float
            [Hz]

        Raises
        ------
        DriverError
            The controller cannot be reached, is not the expected one, is in motion, busy or in error, or uses other
            units.
        """
        self._given = parameters
        link = self._taken(first=True)
        low, high = self._range
        safe = self._command(parameters.safe_voltage)
        rate = highest_rate(lambda: link.send(safe), lambda: link.numbers(("POS?", parameters.axis)))
        found = Capabilities(joints=1, voltages=1, minimum=low, maximum=high, highest_rate=rate)
        if parameters.trigger_input:
            self._require_known(link, "DIO?")
            found = replace(found, trigger_input=True)
        if not parameters.trigger_lines:
            return found
        self._require_known(link, "CTO", "TRO")
        cycle = link.number("SPA?", f"{parameters.axis} {SERVO_CYCLE:#x}")
        # one pulse and one pause take two cycles of the servo
        return replace(found, compares=True, trigger_rate=0.5 / cycle if cycle > 0.0 else 0.0)

    def _require_known(self, link: GcsLink, *commands: str) -> None:
        missing = set(commands) - self._commands
        if missing:
            remedy = "set gcs.trigger_line_up, trigger_line_down and trigger_input to 0"
            raise DriverError(link.name, f"does not know {', '.join(sorted(missing))}", remedy)

    # -- taking the controller -----------------------------------------------------------------------------------

    def _taken(self, first: bool = False) -> GcsLink:
        """Return the link to the controller; a new link brings the controller to its safe state."""
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
        said = link.ask("*IDN?")[0]  # clears earlier errors
        if given.identification.lower() not in said.lower():
            problem = f"identifies as {said!r}, which does not contain gcs.identification = {given.identification!r}"
            raise DriverError(link.name, problem, "correct gcs.host, gcs.port or gcs.identification")
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
            problem = (
                f"has a range of {low:g} … {high:g} V, which does not contain gcs.safe_voltage = "
                f"{given.safe_voltage:g} V"
            )
            raise DriverError(link.name, problem, "choose a safe voltage within this range")
        self._make_safe(link)
        self._check(link, *link.numbers(*self._looks))

    def _require_rest(self, link: GcsLink) -> None:
        """Refuse a controller that is busy, in motion, or not referenced."""
        if "#7" in self._commands and link.ask_single(READY_STATUS).encode("latin-1")[:1] != READY:
            raise DriverError(link.name, "is busy with another task", "wait until it is ready, or stop that task")
        for command, character in (("#5", MOTION_STATUS), ("#9", GENERATOR_STATUS)):
            if command in self._commands and link.ask_single(character).lower().lstrip("0x"):
                remedy = "end the program that moves it, stop its wave generator"
                raise DriverError(link.name, f"is in motion ({command})", remedy)
        if "FRF?" in self._commands and link.number("FRF?", self._given.axis) != 1.0:
            raise DriverError(link.name, f"has not referenced axis {self._given.axis}", "reference it first (FRF)")

    def _unit_of(self, link: GcsLink) -> float:
        """Return the size of the position unit [m]."""
        given, said = self._given, ""
        if "PUN?" in self._commands:
            said = link.value("PUN?", given.axis)
        else:
            said = link.find("SPA?", f"{given.axis} {AXIS_UNIT:#x}") or ""
        unit = said.lower() or given.position_unit
        if unit not in UNITS:
            problem = f"measures axis {given.axis} in {said}" if said else f"reports no unit of axis {given.axis}"
            raise DriverError(link.name, problem, f"an axis needs one of {', '.join(UNITS)} (gcs.position_unit)")
        if given.position_unit and UNITS[unit] != UNITS[given.position_unit]:
            problem = f"measures axis {given.axis} in {said}, but gcs.position_unit is {given.position_unit}"
            raise DriverError(link.name, problem, "make them equal")
        return UNITS[unit]

    def _range_of(self, link: GcsLink) -> tuple[float, float]:
        """Return the range of commands [V]."""
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
            raise DriverError(link.name, "does not report its voltage range", "give gcs.voltage_range")
        return link.number("SPA?", items[0]), link.number("SPA?", items[1])

    @property
    def _channel(self) -> str:
        return self._given.channel or self._given.axis

    # -- samples -------------------------------------------------------------------------------------------------

    def read(self) -> Reading:
        """Read position and last error; every ``check_period`` also check servo and voltage.

        Raises
        ------
        DriverError
            The answer does not match the query, the controller has an error, or another program has switched the servo
            or commands the voltage.
        """
        link, given = self._taken(), self._given
        due = time.monotonic() - self._checked >= given.check_period
        try:
            inputs = (("DIO?", str(given.trigger_input)),) if given.trigger_input else ()
            (position, *others), code = link.numbers(("POS?", given.axis), *inputs, *(self._looks if due else ()))
            if inputs:
                high, *others = others
                self._pulses += high > self._high
                self._high = high
            if code != NO_ERROR and not due:
                # report a changed setting before the error, because it explains the refused command
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
        """Queries that show whether settings of the controller were changed."""
        servo = ("SVO?", self._given.axis)
        looks = self._given.mode == "open_loop" and "VOL?" in self._commands
        return (servo, ("VOL?", self._channel)) if looks else (servo,)

    def _check(self, link: GcsLink, answers: list[float], code: int) -> None:
        """Raise an error if the device reports one, or if another program has changed its servo state or voltage."""
        given, (servo, *voltage) = self._given, answers
        on = given.mode == "servo"
        if bool(servo) != on:
            problem = f"has its servo switched {'off' if on else 'on'} by another program"
            raise DriverError(link.name, problem, "end the program that does so")
        link.require(code, "has an error")
        if voltage:
            (there,), tolerance = voltage, given.voltage_tolerance
            low, high = min(self._recent), max(self._recent)
            if not low - tolerance <= there <= high + tolerance:
                problem = f"outputs {there:g} V, but {self._recent[-1]:g} V are commanded"
                remedy = "check gcs.open_loop_scale, the amplifier, and programs that also command it"
                raise DriverError(link.name, problem, remedy)
        self._checked = time.monotonic()

    def write(self, voltages: Sequence[float]) -> None:
        """Send the voltage (open loop) or the corresponding target (servo).

        Parameters
        ----------
        voltages : sequence of float
            [V]

        Raises
        ------
        DriverError
            The connection is lost.
        """
        link = self._taken()
        if self._comparing and not self._compares:
            link.do(*self._comparing)
            self._compares = True
        link.send(self._command(voltages[0]))
        self._recent.append(voltages[0])

    def compare(self, up: Sequence[float], down: Sequence[float]) -> None:
        """Let the controller trigger at equally spaced positions, with one digital line for each direction of motion.

        Parameters
        ----------
        up, down : sequence of float
            [m]

        Raises
        ------
        DriverError
            The positions are not equally spaced, or a digital line is missing.
        """
        given, name = self._given, self._taken().name
        commands = []
        for way, line, positions, sign in (
            ("up", given.trigger_line_up, up, 1.0),
            ("down", given.trigger_line_down, down, -1.0),
        ):
            if not len(positions):
                continue
            if not line:
                problem = f"must trigger during motion {way}, but gcs.trigger_line_{way} is 0"
                raise DriverError(name, problem, "give the digital output, or choose another triggers.direction")
            places = np.array(positions) / self._unit
            steps = np.diff(places)
            if not places.size > 1 or np.ptp(steps) > UNEVEN * np.max(np.abs(places)):
                problem = "compares only equally spaced positions, at least two"
                raise DriverError(name, problem, "give a grid: triggers.start, step and stop")
            step = float(np.mean(steps))
            first, last = (places[0], places[-1]) if sign > 0.0 else (places[-1], places[0])
            numbers = {START_THRESHOLD: first, STOP_THRESHOLD: last + 0.5 * sign * step}
            commands += [f"CTO {line} {TRIGGER_AXIS} {given.axis}", f"CTO {line} {TRIGGER_MODE} {POSITION_DISTANCE}"]
            commands.append(f"CTO {line} {TRIGGER_STEP} {step:.9f}")
            commands += [f"CTO {line} {place} {value:.9f}" for place, value in numbers.items()]
            commands.append(f"TRO {line} 1")
        self._comparing = tuple(commands)

    def pulses(self) -> int:
        """Return the number of rising edges of the trigger input since the last call."""
        count, self._pulses = self._pulses, 0
        return count

    def _command(self, voltage: float) -> str:
        name = "MOV" if self._given.mode == "servo" else "SVA"
        return f"{name} {self._given.axis} {self._value(voltage):.9f}"

    def _value(self, voltage: float) -> float:
        """Return the value to command for a voltage, in the controller's unit."""
        given = self._given
        return voltage * given.servo_scale / self._unit if given.mode == "servo" else voltage / given.open_loop_scale

    # -- at the sample rate of the controller --------------------------------------------------------------------

    def play(self, voltages: Sequence[float], period: float) -> Played:
        """Play voltages with the wave generator and record the response, at the controller's own sample rate.

        Parameters
        ----------
        voltages : sequence of float
            [V]; with the servo on, they represent the targets of the servo.
        period : float
            Time between two voltages [s], rounded to servo cycles of the controller.

        Returns
        -------
        Played

        Raises
        ------
        DriverError
            The voltages are out of range or too many, or the controller has no generator or recorder.
        """
        link, given = self._taken(), self._given
        missing = {"WAV", "WGO", "DRC", "DRR?"} - self._commands
        if missing:
            raise DriverError(link.name, f"does not know {', '.join(sorted(missing))}", "send the voltages one by one")
        (low, high), item = self._range, f"{given.axis} {SERVO_CYCLE:#x}"
        longest = int(link.number("SPA?", f"{given.axis} {WAVE_POINTS:#x}"))
        if not 0 < len(voltages) <= longest or not low <= min(voltages) <= max(voltages) <= high:
            problem = f"plays up to {longest} voltages within {low:g} … {high:g} V"
            raise DriverError(link.name, problem, "give fewer or smaller voltages")
        cycle = link.number("SPA?", item)
        if not 0.0 < cycle < period * LONGEST:
            raise DriverError(
                link.name, f"reports a servo cycle of {cycle:g} s", "check the controller and its firmware"
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
        """Write the wave table and configure the recorder."""
        given = self._given
        for first in range(0, len(values), POINTS):
            part = values[first : first + POINTS]
            points = " ".join(f"{value:.6f}" for value in part)
            link.do(f"WAV 1 {'&' if first else 'X'} PNT {first + 1} {len(part)} {points}")
        link.do(f"WSL {given.axis} 1", f"WGC {given.axis} 1", f"WTR 0 {rate} 0", f"RTR {rate}")
        link.do(f"SPA {given.axis} {RECORD_TABLES} 2", f"DRC 1 {self._channel} {VOLTAGE} 2 {given.axis} {POSITION}")

    # -- end -----------------------------------------------------------------------------------------------------

    def make_safe(self) -> None:
        """Stop all motion, then go to the safe voltage or the corresponding target; use a new link if necessary.

        Raises
        ------
        DriverError
            The controller did not answer, or refused a command, in every attempt.
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
        if self._comparing:
            self._compares = False
            link.do(*(f"TRO {line} 0" for line in given.trigger_lines))
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
        """Check that the controller reports the safe value; an accepted command alone is not sufficient."""
        value = self._value(safe)
        given = link.number(question, self._given.axis)
        if not abs(given - value) <= ROUNDING * max(abs(value), abs(given), 1.0):
            problem = f"reports {given:g} for {question!r}, but {value:g} was commanded to make it safe"
            raise DriverError(link.name, problem, "end other programs that command it, and check its limits")

    @property
    def last_output(self) -> float | None:
        """Last commanded voltage [V], also during the ramp to the safe voltage."""
        return self._recent[-1] if self._recent else None

    def close(self) -> None:
        """Close the connection."""
        self._hang_up()

    def _hang_up(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
            self._failed = True


DRIVER = HardwareDriver(
    name="gcs",
    title="a piezo controller with GCS 2.0 over TCP (PI E-709, E-727, E-754)",
    parameters=GcsParameters,
    driver=GcsDriver,
    emulator=later("hysteresis_ros.laboratory.emulation.gcs:emulator"),
    device="hysteresis_ros.laboratory.emulation.gcs:DEVICE",
)
