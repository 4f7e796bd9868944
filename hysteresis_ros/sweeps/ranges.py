# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a parameter varies over, in the words of a command line: levels, or a distribution.

``1um:5um:lin10`` and ``0.1:2:log20`` are levels evenly spaced or in a constant ratio, ``12,14,16`` levels one by one.
``±5%`` is evenly distributed around the configured value, as ``±2nm`` is; ``uniform(A,B)``, ``loguniform(A,B)``,
``normal(MEAN,DEVIATION)`` and, around the configured value, ``normal(±5%)``, whose 5 % is the standard deviation.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
import scipy

from hysteresis_ros.configuration import parse_value
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.parameters import ParameterRow
from hysteresis_ros.units import quantity, quantity_in

#: What a number does to the configured value.
VALUE, FACTOR, OFFSET = "value", "factor", "offset"
#: Most levels of one parameter.
MOST_LEVELS = 100_000
#: Half the distance of the numbers that a generator draws: none is at an end, where a normal distribution is infinite.
HALF = 2.0**-54

_SIGN = r"(?:±|\+/?-)"
_AROUND = re.compile(rf"^{_SIGN}\s*(?P<width>.+)$")
_STEPPED = re.compile(r"^(?P<low>[^:]+):(?P<high>[^:]+):(?P<kind>lin|log)(?P<count>\d+)$")
_DISTRIBUTED = re.compile(r"^(?P<kind>[a-z]+)\((?P<words>.*)\)$")
SPREADS = ("uniform", "loguniform", "normal")
WAYS = "write 0.1:2:log20, 1um:5um:lin10, 12,14,16, ±5%, uniform(A,B), loguniform(A,B), normal(MEAN,DEVIATION)"


@dataclass(frozen=True)
class Levels:
    """Values one by one.

    Parameters
    ----------
    values : tuple
        In the parameter's type and unit.
    """

    values: tuple

    does = VALUE

    @property
    def ends(self) -> tuple[float, ...]:
        """Places of what has to be allowed before anything runs: all of them."""
        return tuple(range(len(self.values)))

    def at(self, place: float):
        """Return the value of a level.

        Parameters
        ----------
        place : float
            Its number.
        """
        return self.values[int(place)]


@dataclass(frozen=True)
class Spread:
    """A distribution.

    Parameters
    ----------
    kind : str
        One of :data:`SPREADS`.
    first, second : float
        Ends, or mean and standard deviation.
    does : str
        Whether it is of values, of factors or of offsets.
    whole : bool
        Of whole numbers, both ends included.
    """

    kind: str
    first: float
    second: float
    does: str = VALUE
    whole: bool = False

    @property
    def ends(self) -> tuple[float, ...]:
        """Places of what has to be allowed before anything runs; a normal distribution has no ends, only its mean."""
        return (0.5,) if self.kind == "normal" else (0.0, 1.0)

    def at(self, place: float) -> float:
        """Return the value at a place of the distribution (the inverse of its distribution function).

        Parameters
        ----------
        place : float
            Part of the values below it, 0 … 1.
        """
        if self.whole:
            return int(min(self.first + math.floor(place * (self.second - self.first + 1.0)), self.second))
        if self.kind == "normal":
            return self.first + self.second * float(scipy.special.ndtri(min(place + HALF, 1.0 - HALF)))
        if self.kind == "loguniform":
            return self.first * math.exp(place * math.log(self.second / self.first))
        return self.first + place * (self.second - self.first)


def parse_range(text: str, row: ParameterRow) -> Levels | Spread:
    """Return what a parameter varies over.

    Parameters
    ----------
    text : str
    row : ParameterRow
        Of the parameter; of an array that of its elements.

    Raises
    ------
    ValueError
        It is none of the ways in which that can be said; the text says which there are.
    """
    text = text.strip()
    around, stepped, distributed = (pattern.match(text) for pattern in (_AROUND, _STEPPED, _DISTRIBUTED))
    if row.type in (str, bool):
        if around or distributed or not text:
            raise ValueError("has no numbers to draw: give its values, with commas between")
        words = [word.strip() for word in text.split(",")]
        return Levels(tuple(words if row.type is str else map(parse_value, words)))
    if around:
        width, does = _around(around["width"], row)
        middle = 1.0 if does == FACTOR else 0.0
        return Spread("uniform", middle - width, middle + width, does)
    if stepped:
        return _stepped(stepped, row)
    if distributed:
        return _distributed(distributed["kind"], [word.strip() for word in distributed["words"].split(",")], row)
    return Levels(tuple(_whole(_number(word, row), row) for word in text.split(",")))


def _around(text: str, row: ParameterRow) -> tuple[float, str]:
    """Return a width around the configured value, and whether it is a part of that or in its unit."""
    if row.type is int:
        raise ValueError("is a whole number: give its values, 12,14,16 or 4:16:lin13, or uniform(4,16)")
    width, unit = quantity(text)
    relative = unit == "1" and text.rstrip().endswith("%")
    width = width if relative else _number(text, row)
    if not 0.0 < width < (1.0 if relative else math.inf):
        raise ValueError(f"±{text}: must be above 0{' and below 100 %' if relative else ''}")
    return width, FACTOR if relative else OFFSET


def _stepped(parts: re.Match, row: ParameterRow) -> Levels:
    low, high, count = _number(parts["low"], row), _number(parts["high"], row), int(parts["count"])
    if not 1 <= count <= MOST_LEVELS:
        raise ValueError(f"{count} levels: must be 1 … {MOST_LEVELS}")
    if parts["kind"] == "log":
        if not low * high > 0.0:
            raise ValueError("log: both ends must be above 0, or both below")
        values = low * np.exp(np.linspace(0.0, math.log(high / low), count))
    else:
        values = np.linspace(low, high, count)
    values[-1] = high if count > 1 else low
    return Levels(tuple(_whole(float(value), row) for value in values))


def _distributed(kind: str, words: list[str], row: ParameterRow) -> Spread:
    if kind not in SPREADS:
        raise ValueError(f"{kind}(): there is no such distribution, there are {', '.join(SPREADS)}")
    around = _AROUND.match(words[0]) if kind == "normal" and len(words) == 1 else None
    if around:
        width, does = _around(around["width"], row)
        return Spread(kind, 1.0 if does == FACTOR else 0.0, width, does)
    if len(words) != 2:
        raise ValueError(f"{kind}(): takes two numbers, {'mean and deviation' if kind == 'normal' else 'both ends'}")
    first, second = (_number(word, row) for word in words)
    if kind == "normal" and not second > 0.0:
        raise ValueError("normal(): the deviation must be above 0")
    if kind != "normal" and not second > first:
        raise ValueError(f"{kind}(): the second end must be above the first")
    if kind == "loguniform" and not first > 0.0:
        raise ValueError("loguniform(): both ends must be above 0")
    if row.type is int:
        if kind != "uniform":
            raise ValueError(f"{kind}(): this is a whole number: write uniform(A,B)")
        return Spread(kind, _whole(first, row), _whole(second, row), whole=True)
    return Spread(kind, first, second)


def _number(text: str, row: ParameterRow) -> float:
    """Return a number in the parameter's unit."""
    try:
        return quantity_in(text, row.unit)
    except ValueError as error:
        raise ValueError(f"{text.strip()}: {error}; allowed: {row.allowed()}; {WAYS}") from None


def _whole(value: float, row: ParameterRow):
    if row.type is not int:
        return value
    if not float(value).is_integer():
        raise ValueError(f"{value:g}: must be a whole number")
    return int(value)


def refused(text: str, value, allowed: str) -> ParameterError:
    """Return the error of a variation.

    Parameters
    ----------
    text : str
        What varies.
    value : object
    allowed : str
    """
    return ParameterError([Problem(f"--vary {text}", value, allowed)])
