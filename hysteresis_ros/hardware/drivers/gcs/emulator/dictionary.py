# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The names of the commands, and what their words mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from hysteresis_ros.hardware.drivers.gcs.emulator.axis import Axis
from hysteresis_ros.hardware.drivers.gcs.emulator.controller import Controller
from hysteresis_ros.hardware.drivers.gcs.protocol import BUSY, OUT_OF_RANGE, SYNTAX, WRONG_AXIS, WRONG_COUNT

Command = Callable[[Controller, list[str]], list[str] | None]

#: Commands by name; what they do stands in their docstrings.
COMMANDS: dict[str, Command] = {}


class Refusal(Exception):
    """A command is refused; its argument is the code of the error."""


def command(*names: str) -> Callable[[Command], Command]:
    """Return a decorator that enters a command under its names."""

    def enter(function: Command) -> Command:
        COMMANDS.update(dict.fromkeys(names, function))
        return function

    return enter


def real(text: str) -> float:
    """Return the number that a word is.

    Raises
    ------
    Refusal
        It is none, or not finite.
    """
    try:
        value = float(text)
    except ValueError:
        raise Refusal(SYNTAX) from None
    if not math.isfinite(value):
        raise Refusal(SYNTAX)
    return value


def whole(text: str, low: int, high: int) -> int:
    """Return the whole number within a range that a word is.

    Raises
    ------
    Refusal
        It is none.
    """
    value = real(text)
    if value != int(value) or not low <= value <= high:
        raise Refusal(OUT_OF_RANGE)
    return int(value)


def axis_of(controller: Controller, name: str) -> Axis:
    """Return the axis of a name.

    Raises
    ------
    Refusal
        There is none.
    """
    if name not in controller.axes:
        raise Refusal(WRONG_AXIS)
    return controller.axes[name]


def pairs_of(controller: Controller, words: list[str]) -> Iterator[tuple[Axis, float]]:
    """Go through pairs of axis and number, all of which are looked at before the first is given.

    Raises
    ------
    Refusal
        A word is missing, names no axis or is no number.
    """
    if not words or len(words) % 2:
        raise Refusal(WRONG_COUNT)
    pairs = [(axis_of(controller, name), real(text)) for name, text in zip(words[::2], words[1::2], strict=True)]
    return iter(pairs)


def require_free(controller: Controller) -> None:
    """Refuse while something is wrong with the controller, or it does something else.

    Raises
    ------
    Refusal
        It is so.
    """
    lasting = controller.faults.value("error")
    if lasting is not None:
        raise Refusal(int(lasting))
    if controller.busy:
        raise Refusal(BUSY)
