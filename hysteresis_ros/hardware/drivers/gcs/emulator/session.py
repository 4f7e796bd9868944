# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What an emulated controller says to one of its masters: bytes that came become answers, whatever they are."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass

from hysteresis_ros.hardware.declaration import EmulatedDevice
from hysteresis_ros.hardware.drivers.gcs.driver import GcsParameters
from hysteresis_ros.hardware.drivers.gcs.emulator import motion_commands, table_commands  # noqa: F401  (they enter)
from hysteresis_ros.hardware.drivers.gcs.emulator.controller import MODELS, Controller
from hysteresis_ros.hardware.drivers.gcs.emulator.dictionary import COMMANDS, Refusal
from hysteresis_ros.hardware.drivers.gcs.protocol import (
    GENERATOR_STATUS,
    MOTION_STATUS,
    NOT_READY,
    READY,
    READY_STATUS,
    STATUS,
    STOP,
    TOO_LONG,
    UNKNOWN_COMMAND,
)
from hysteresis_ros.hardware.emulation.bench import Bench, Running
from hysteresis_ros.hardware.emulation.faults import DeviceFaults
from hysteresis_ros.hardware.emulation.server import serving
from hysteresis_ros.parameters import Parameters, parameter

#: Longest command.
LONGEST = 4096
_SINGLE = re.compile(rb"[\x00-\x09\x0b-\x1f]")


class Session:
    """What a controller says to one master.

    Parameters
    ----------
    controller : Controller
    """

    def __init__(self, controller: Controller):
        self._controller, self._rest = controller, b""

    def feed(self, data: bytes) -> bytes:
        """Return the answers to bytes that came, whatever they are.

        Parameters
        ----------
        data : bytes
        """
        answers, self._rest = [], self._rest + data
        while match := re.search(rb"[\x00-\x1f]", self._rest):
            before, mark, self._rest = self._rest[: match.start()], match.group(), self._rest[match.end() :]
            if _SINGLE.match(mark):
                if mark != b"\r":
                    answers.append(self.answer_single(mark.decode("latin-1")))
                self._rest = before + self._rest
            else:
                answers.append(self._line(before))
        if len(self._rest) > LONGEST:
            self._rest = b""
            self._controller.fail(TOO_LONG)
        return b"".join(answers)

    def _line(self, line: bytes) -> bytes:
        if len(line) > LONGEST:
            self._controller.fail(TOO_LONG)
            return b""
        lines = self.answer(line.decode("latin-1"))
        return " \n".join(lines).encode("latin-1") + b"\n" if lines else b""

    def answer(self, line: str) -> list[str]:
        """Return the lines with which a command is answered; none when it sets something, or is refused.

        Parameters
        ----------
        line : str
            Without its LF.
        """
        words, controller = line.split(), self._controller
        if not words:
            return []
        controller.tick()
        command = COMMANDS.get(words[0].upper())
        if command is None:
            controller.fail(UNKNOWN_COMMAND)
            return []
        try:
            return command(controller, words[1:]) or []
        except Refusal as refusal:
            controller.fail(refusal.args[0])
            return []

    def _status(self) -> int:
        """Return the status register; assumed: four bits an axis, on target, moving, servo on, generator running."""
        axes = enumerate(self._controller.axes.values())
        return sum(
            (axis.on_target | axis.moving << 1 | axis.servo << 2 | axis.generating << 3) << 4 * place
            for place, axis in axes
        )

    def answer_single(self, character: str) -> bytes:
        """Return the answer to a command of one character.

        Parameters
        ----------
        character : str
        """
        controller = self._controller
        controller.tick()
        axes = list(controller.axes.values())
        if character == STATUS:
            return b"0x%x\n" % self._status()
        if character == MOTION_STATUS:
            return b"%x\n" % sum(axis.moving << place for place, axis in enumerate(axes))
        if character == READY_STATUS:
            return (NOT_READY if controller.busy else READY) + b"\n"
        if character == GENERATOR_STATUS:
            return b"%x\n" % sum(axis.generating << place for place, axis in enumerate(axes))
        if character == STOP:
            controller.stop(axes)
        else:
            controller.fail(UNKNOWN_COMMAND)
        return b""


@dataclass(frozen=True)
class EmulatedControllerParameters(Parameters):
    """Which controller is emulated, and where it is found."""

    model: str = parameter("E-754", choices=tuple(MODELS), description="which controller")
    host: str = parameter("127.0.0.1", description="address at which it is found")
    port: int = parameter(50000, description="TCP port; 0: a free one", low=0, high=65535)
    masters: int = parameter(1, description="so many programs may be connected at a time", low=1, high=100)


@contextlib.contextmanager
def start(given: EmulatedControllerParameters, bench: Bench) -> Iterator[Running]:
    """Run an emulated controller.

    Parameters
    ----------
    given : EmulatedControllerParameters
    bench : Bench

    Raises
    ------
    ConfigurationError
        Its address cannot be had, or a fault is written wrongly.
    """
    faults = DeviceFaults(time.monotonic, bench.faults)
    controller = Controller(MODELS[given.model], bench.plant, bench.cycle, faults)
    address = given.host, given.port
    with serving(address, lambda: Session(controller), controller.tick, faults, given.masters) as server:
        where = f"{given.model} with {', '.join(controller.axes)} as axes at {given.host}:{server.port}"
        yield Running(where, GcsParameters(host=given.host, port=server.port), faults, controller)


@contextlib.contextmanager
def emulator() -> Iterator[Parameters]:
    """Give the parameters of an emulated controller on a free port."""
    with start(EmulatedControllerParameters(port=0), Bench()) as running:
        yield running.driver


DEVICE = EmulatedDevice(EmulatedControllerParameters, start)
