# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Errors that a user can act on: each names what is wrong, its value, what is allowed and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

#: A value in a message is shortened if its text is longer than this [characters].
LONGEST = 300
#: A message is shortened if it is longer than this [characters].
LONGEST_MESSAGE = 4000


class HysteresisError(ValueError):
    """Base of every error that wrong input causes; a command then prints one line and ends with exit code 2.

    The text is one printable line of limited length, because it may quote the content of a file.
    """

    def __str__(self) -> str:
        text = super().__str__()
        if not text.isprintable():
            shown = (c if c.isprintable() else " " if c.isspace() else repr(c)[1:-1] for c in text)
            text = "".join(shown)
        half = LONGEST_MESSAGE // 2
        return text if len(text) <= LONGEST_MESSAGE else f"{text[:half]} … {text[-half:]}"


@dataclass(frozen=True)
class Problem:
    """One thing wrong with one parameter."""

    name: str  #: Full dotted name of the parameter, e.g. ``hysteresis.polynomial.preload_force``.
    value: object  #: Given value.
    remedy: str  #: What is allowed, and what to do.
    unit: str = ""  #: Unit of the value, printed after it.

    def __str__(self) -> str:
        value = f"{shortened(self.value)} {self.unit}".rstrip()
        return f"{self.name} = {value}: {self.remedy}"


def shortened(value: object) -> str:
    """Return the repr of a value, with its middle left out when it is longer than :data:`LONGEST` characters."""
    try:
        text = repr(_plain(value))
    except ValueError:  # Python does not convert an integer of several thousand digits
        text = f"a {type(value).__name__} too large to be written"
    half = LONGEST // 2
    return text if len(text) <= LONGEST else f"{text[:half]} … ({len(text)} characters) … {text[-half:]}"


def _plain(value: object) -> object:
    """Return a value with NumPy numbers converted to Python numbers, so that its repr contains no types."""
    if type(value) is tuple:
        return tuple(map(_plain, value))
    if type(value) is list:
        return list(map(_plain, value))
    return value.item() if getattr(value, "ndim", None) == 0 and hasattr(value, "item") else value


class ParameterError(HysteresisError):
    """One or more parameters are unknown, missing, mistyped or out of range."""

    def __init__(self, problems: Iterable[Problem]):
        self.problems = tuple(problems)
        super().__init__("; ".join(str(problem) for problem in self.problems))


class ConfigurationError(HysteresisError):
    """A configuration file is missing, unreadable or describes an axis that cannot be built."""


class RecordingError(HysteresisError):
    """A recording is missing, unreadable or lacks the requested signals."""


class IdentificationError(HysteresisError):
    """A recording does not contain what an identification needs, or gives no usable model."""


class MissingExtraError(HysteresisError):
    """A library of an optional extra is not installed."""

    def __init__(self, library: str, extra: str = "report", purpose: str = "plots and reports need it"):
        """Name the library, the feature that needs it, and how to install it."""
        super().__init__(f'{library} is not installed; {purpose}: pip install "hysteresis_ros[{extra}]"')


class LoopError(HysteresisError):
    """The thread that runs the loop has failed, or a call of its device does not return; changes are refused."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of a message, ``; did you mean …?`` with the nearest known name; empty if no name is similar."""
    close = difflib.get_close_matches(str(name), list(known), n=1)
    return f"; did you mean {close[0]}?" if close else ""
