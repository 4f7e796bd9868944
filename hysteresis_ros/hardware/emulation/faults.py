# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Faults of an emulated device: it is busy, refuses, answers late, wrongly or not at all, or its link is cut.

They are written as the faults of an axis are, ``NAME:START:DURATION[:VALUE]``, with times in seconds of the device's
own clock, counted from where the device begins or where the fault is added. Those of single lines happen to the first
ones in that time, as many as the value says.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

from hysteresis_ros.errors import ConfigurationError, did_you_mean


class Kind(NamedTuple):
    """What a fault of a device is."""

    description: str
    #: Default of the value; None: it has none.
    value: float | None = None
    unit: str = ""


FAULTS = {
    "busy": Kind("commands are refused as long as something else is being done"),
    "error": Kind("commands are refused with the device's error of that number", 1.0, "code"),
    "slow": Kind("each answer comes so much later", 0.2, "s"),
    "silent": Kind("no answer comes"),
    "cut": Kind("the link is cut and nobody can connect"),
    "repeat": Kind("a line of an answer comes twice", 1.0, "lines"),
    "stale": Kind("the last line that was sent comes again before the answer", 1.0, "lines"),
    "echo": Kind("the last answer comes again, whole, before the answer", 1.0, "answers"),
    "drop": Kind("a line of an answer does not come", 1.0, "lines"),
    "garbage": Kind("bytes without sense come in the place of a line", 1.0, "lines"),
    "half": Kind("half a line comes, without its end", 1.0, "lines"),
    "close": Kind("half a line comes, then the link is closed; others can connect", 1.0, "lines"),
}
#: Faults of single lines.
OF_LINES = ("repeat", "stale", "echo", "drop", "garbage", "half", "close")
#: What a line without sense is: any bytes, and an end.
GARBAGE = b"\xff\x00=\xb5 1e9\n"


class DeviceFaults:
    """The faults of a device, and when they are there.

    Parameters
    ----------
    clock : callable
        Returns the time [s].
    texts : iterable of str
        Faults from the beginning on.

    Raises
    ------
    ConfigurationError
        One is unknown or not written as above.
    """

    def __init__(self, clock: Callable[[], float], texts: Iterable[str] = ()):
        self._clock = clock
        self._entries: list[tuple[str, float, float, float]] = []
        self._lines: dict[tuple, int] = {}
        for text in texts:
            self.add(text)

    def add(self, text: str) -> None:
        """Add a fault, its times counted from now on; ``none`` ends all.

        Raises
        ------
        ConfigurationError
            It is unknown or not written as above.
        """
        if text == "none":
            self._entries = []
            return
        name, *numbers = text.split(":")
        if name not in FAULTS:
            near = did_you_mean(name, FAULTS) or f"; there are {', '.join(FAULTS)}"
            raise ConfigurationError(f"fault '{text}': a device has no fault '{name}'{near}")
        kind = FAULTS[name]
        try:
            start, duration, *rest = map(float, numbers)
            sound = all(map(math.isfinite, (start, duration, *rest))) and start >= 0.0 < duration
        except ValueError:
            sound = False
        if not sound or len(rest) > (kind.value is not None) or min(rest, default=0.0) < 0.0:
            form = f"{name}:START:DURATION" + ("" if kind.value is None else f"[:VALUE in {kind.unit}]")
            raise ConfigurationError(f"fault '{text}': write {form}, times in seconds, START ≥ 0 and DURATION > 0")
        begin = self._clock() + start
        self._entries.append((name, begin, begin + duration, rest[0] if rest else kind.value or 0.0))

    def value(self, name: str) -> float | None:
        """Return the value of a fault that is there now (0 where it has none), None of one that is not.

        Parameters
        ----------
        name : str
        """
        now = self._clock()
        return next((value for kind, begin, end, value in self._entries if kind == name and begin <= now < end), None)

    def take_line(self) -> str:
        """Return the fault that happens to the next line, which is counted; empty: none."""
        now = self._clock()
        for entry in self._entries:
            name, begin, end, value = entry
            if name in OF_LINES and begin <= now < end and self._lines.get(entry, 0) < value:
                self._lines[entry] = self._lines.get(entry, 0) + 1
                return name
        return ""

    def __contains__(self, name: str) -> bool:
        return self.value(name) is not None


class Garbler:
    """The lines of a link, with what goes wrong with them.

    Parameters
    ----------
    faults : DeviceFaults

    Attributes
    ----------
    closed : bool
        Whether the link is closed behind what was returned last.
    """

    def __init__(self, faults: DeviceFaults):
        self._faults, self.closed = faults, False
        self._last = self._answer = b""

    def garble(self, answer: bytes) -> bytes:
        """Return what is sent in the place of an answer.

        Parameters
        ----------
        answer : bytes
            Whole lines.
        """
        sent = []
        for line in answer.splitlines(keepends=True):
            happens = self._faults.take_line()
            half = line[: len(line) // 2]
            sent.append(
                {
                    "repeat": line + line,
                    "stale": self._last + line,
                    "echo": self._answer + line,
                    "drop": b"",
                    "garbage": GARBAGE,
                    "half": half,
                    "close": half,
                }.get(happens, line)
            )
            self._last = line
            self.closed = happens == "close"
            if self.closed:
                break
        self._answer = answer
        return b"".join(sent)
