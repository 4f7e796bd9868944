# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Varied parameters with their ranges, and the resulting runs: levels, draws, or the points of a sensitivity analysis.

Levels: ``1um:5um:lin10`` (evenly spaced), ``0.1:2:log20`` (in a constant ratio) and ``12,14,16`` (single values).
Distributions: ``±5%`` and ``±2nm`` (uniform around the configured value), ``uniform(A,B)``, ``loguniform(A,B)``,
``normal(MEAN,DEVIATION)`` and ``normal(±5%)`` (around the configured value; 5 % is the standard deviation).

Run i has combination i mod L of the L combinations of levels, and draw i div L of the distributions. So all levels have
the same draws, and a longer sweep begins with the runs of a shorter one. With D distributions, draw j consists of the
numbers j D … (j + 1) D - 1 of the PCG64 generator with the seed. So a point depends only on seed and run number, not on
the process that computes it.
"""

from __future__ import annotations

import functools
import math
import numbers
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from hysteresis_ros.configuration import ParameterRow, parse_value
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem, did_you_mean
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, AxisParameters
from hysteresis_ros.loop.simulation import LARGEST, deviating
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.units import quantity, quantity_in

#: Whether a random number replaces, multiplies or is added to the configured value.
VALUE, FACTOR, OFFSET = "value", "factor", "offset"
#: Maximum number of levels of one parameter.
MOST_LEVELS = 100_000
#: Half the spacing of the random numbers; it is added to keep them off 0 and 1, where the inverse normal distribution
#: is infinite.
HALF = 2.0**-54

_SIGN = r"(?:±|\+/?-)"
_AROUND = re.compile(rf"^{_SIGN}\s*(?P<width>.+)$")
_STEPPED = re.compile(r"^(?P<low>[^:]+):(?P<high>[^:]+):(?P<kind>lin|log)(?P<count>\d+)$")
_DISTRIBUTED = re.compile(r"^(?P<kind>[a-z]+)\((?P<words>.*)\)$")
SPREADS = ("uniform", "loguniform", "normal")
WAYS = "write 0.1:2:log20, 1um:5um:lin10, 12,14,16, ±5%, uniform(A,B), loguniform(A,B), normal(MEAN,DEVIATION)"


class Range(ABC):
    """Range of a parameter, in SI units or relative to the configured value."""

    @abstractmethod
    def over(self, row: ParameterRow) -> Levels | Spread:
        """Return the levels or the distribution for a parameter; raise ValueError if the parameter cannot have them."""

    @abstractmethod
    def words(self, unit: str = "") -> str:
        """Return the text of the range for ``--vary``, for a parameter with this SI unit."""

    def __str__(self) -> str:
        return self.words()


@dataclass(frozen=True)
class Levels(Range):  # numpydoc ignore=PR02
    """Single values: ``12,14,16`` in ``--vary``.

    Parameters
    ----------
    values : sequence of float, int, str or bool
        Values of the parameter's type, numbers in SI units.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> print(hr.Levels([12.0, 14.0, 16.0]), hr.Levels.logarithmic(1.0, 100.0, 3))
    12,14,16 1,10,100
    """

    values: tuple

    does = VALUE

    def __post_init__(self):
        """Accept any sequence."""
        if isinstance(self.values, (str, bytes)) or not isinstance(self.values, (Sequence, np.ndarray)):
            raise ConfigurationError(f"levels = {self.values!r}: must be a sequence of values, such as [12, 14, 16]")
        object.__setattr__(self, "values", tuple(v.item() if isinstance(v, np.generic) else v for v in self.values))

    @classmethod
    def linear(cls, low: float, high: float, count: int) -> Levels:
        """Return evenly spaced levels; ``--vary`` writes ``LOW:HIGH:linCOUNT``.

        Parameters
        ----------
        low, high : float
            First and last level.
        count : int
            Number of levels.

        Returns
        -------
        Levels
            Both ends included.
        """
        return cls._spaced(low, high, count, np.linspace)

    @classmethod
    def logarithmic(cls, low: float, high: float, count: int) -> Levels:
        """Return levels in a constant ratio; ``--vary`` writes ``LOW:HIGH:logCOUNT``.

        Parameters
        ----------
        low, high : float
            First and last level, both above 0 or both below.
        count : int
            Number of levels.

        Returns
        -------
        Levels
            Both ends included.

        Raises
        ------
        ConfigurationError
            One end is 0, or the signs differ.
        """
        if not low * high > 0.0:
            raise ConfigurationError("log: both ends must be above 0, or both below")
        return cls._spaced(
            low, high, count, lambda low, high, count: low * np.exp(np.linspace(0.0, math.log(high / low), count))
        )

    @classmethod
    def _spaced(cls, low, high, count, spaced) -> Levels:
        if not 1 <= count <= MOST_LEVELS:
            raise ConfigurationError(f"{count} levels: must be 1 … {MOST_LEVELS}")
        values = spaced(low, high, count)
        values[-1] = high if count > 1 else low
        return cls(tuple(map(float, values)))

    def over(self, row: ParameterRow) -> Levels:
        """Return the levels in the parameter's type."""
        if not self.values:
            raise ValueError("has no levels: give at least one")
        if row.type in (str, bool):
            return self
        return Levels(tuple(_whole(_real(value, "level"), row) for value in self.values))

    def words(self, unit: str = "") -> str:
        """Return ``12,14,16``."""
        texts = (value if isinstance(value, str) else str(value).lower() for value in self.values)
        numbers = [isinstance(value, (int, float)) and not isinstance(value, bool) for value in self.values]
        written = zip(self.values, texts, numbers, strict=True)
        return ",".join(_written(value, unit) if number else text for value, text, number in written)

    @property
    def ends(self) -> tuple[float, ...]:
        """Positions to check before any run: all levels."""
        return tuple(range(len(self.values)))

    def at(self, place: float):
        """Return the value of a level."""
        return self.values[int(place)]


@dataclass(frozen=True)
class Spread:
    """A distribution."""

    kind: str  #: One of :data:`SPREADS`.
    first: float  #: first, second: Ends, or mean and standard deviation.
    second: float
    does: str = VALUE  #: Whether values, factors or offsets are drawn.
    whole: bool = False  #: Whether the values are integers; both ends are included.

    @property
    def ends(self) -> tuple[float, ...]:
        """Positions to check before any run: the ends; or the mean of a normal distribution, which has no ends."""
        return (0.5,) if self.kind == "normal" else (0.0, 1.0)

    def at(self, place: float) -> float:
        """Return the value at a position, by the inverse of the distribution function."""
        if self.whole:
            return int(min(self.first + math.floor(place * (self.second - self.first + 1.0)), self.second))
        if self.kind == "normal":
            return self.first + self.second * float(scipy.special.ndtri(min(place + HALF, 1.0 - HALF)))
        if self.kind == "loguniform":
            return self.first * math.exp(place * math.log(self.second / self.first))
        return self.first + place * (self.second - self.first)


@dataclass(frozen=True)
class Within(Range):
    """Uniformly distributed around the configured value: ``±5%`` or ``±2nm`` in ``--vary``.

    Parameters
    ----------
    width : float
        Largest deviation to either side: a fraction of the configured value (0.05 is 5 %), or in SI units.
    relative : bool
        Whether the width is a fraction of the configured value.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> print(hr.Within(0.05), hr.Within(0.5, relative=False))
    ±5% ±0.5
    """

    width: float
    relative: bool = True

    def over(self, row: ParameterRow) -> Spread:
        """Return the distribution of the factor or of the offset."""
        middle, width = _around(self, self.width, self.relative, row)
        return Spread("uniform", middle - width, middle + width, FACTOR if self.relative else OFFSET)

    def words(self, unit: str = "") -> str:
        """Return ``±5%``."""
        return f"±{_percent(self.width) if self.relative else _written(self.width, unit)}"


@dataclass(frozen=True)
class Normal(Range):
    """Normally distributed: ``normal(MEAN,DEVIATION)`` in ``--vary``.

    :meth:`around` is the distribution around the configured value, ``normal(±5%)``.

    Parameters
    ----------
    mean : float or None
        Mean in SI units; None for the configured value.
    deviation : float
        Standard deviation in SI units, or a fraction of the configured value.
    relative : bool
        Whether the deviation is a fraction of the configured value; if so, ``mean`` must be None.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> print(hr.Normal(2.0, 0.1), hr.Normal.around(0.05))
    normal(2,0.1) normal(±5%)
    """

    mean: float | None
    deviation: float
    relative: bool = False

    def __post_init__(self):
        """Refuse a relative deviation with a given mean."""
        if self.relative and self.mean is not None:
            raise ConfigurationError(
                "normal: a relative deviation is a fraction of the configured value, so mean must be None"
            )

    @classmethod
    def around(cls, deviation: float, relative: bool = True) -> Normal:
        """Return the normal distribution around the configured value; ``--vary`` writes ``normal(±5%)``.

        Parameters
        ----------
        deviation : float
            Standard deviation: a fraction of the configured value (0.05 is 5 %), or in SI units.
        relative : bool
            Whether the deviation is a fraction of the configured value.

        Returns
        -------
        Normal
            Its ``mean`` is None.
        """
        return cls(None, deviation, relative)

    def over(self, row: ParameterRow) -> Spread:
        """Return the distribution of the value, of the factor or of the offset."""
        if self.mean is None:
            middle, width = _around(self, self.deviation, self.relative, row)
            return Spread("normal", middle, width, FACTOR if self.relative else OFFSET)
        mean, deviation = _real(self.mean, "mean"), _real(self.deviation, "deviation")
        if not deviation > 0.0:
            raise ValueError("normal(): the deviation must be above 0")
        if row.type is int:
            raise ValueError("normal(): the parameter is a whole number; write uniform(A,B)")
        return Spread("normal", mean, deviation)

    def words(self, unit: str = "") -> str:
        """Return ``normal(MEAN,DEVIATION)`` or ``normal(±5%)``."""
        if self.mean is None:
            return f"normal({Within(self.deviation, self.relative).words(unit)})"
        return f"normal({_written(self.mean, unit)},{_written(self.deviation, unit)})"


@dataclass(frozen=True)
class Uniform(Range):
    """Uniformly distributed between two ends: ``uniform(LOW,HIGH)`` in ``--vary``.

    Parameters
    ----------
    low, high : float
        Ends in SI units; for an integer parameter both ends are included.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> print(hr.Uniform(1, 99))
    uniform(1,99)
    """

    low: float
    high: float

    def over(self, row: ParameterRow) -> Spread:
        """Return the distribution."""
        low, high = _ends("uniform", self.low, self.high)
        if row.type is int:
            return Spread("uniform", _whole(low, row), _whole(high, row), whole=True)
        return Spread("uniform", low, high)

    def words(self, unit: str = "") -> str:
        """Return ``uniform(LOW,HIGH)``."""
        return f"uniform({_written(self.low, unit)},{_written(self.high, unit)})"


@dataclass(frozen=True)
class LogUniform(Range):
    """Log-uniformly distributed between two ends: ``loguniform(LOW,HIGH)`` in ``--vary``.

    Parameters
    ----------
    low, high : float
        Ends in SI units, above 0.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> print(hr.LogUniform(0.1, 10.0))
    loguniform(0.1,10)
    """

    low: float
    high: float

    def over(self, row: ParameterRow) -> Spread:
        """Return the distribution."""
        low, high = _ends("loguniform", self.low, self.high)
        if not low > 0.0:
            raise ValueError("loguniform(): both ends must be above 0")
        if row.type is int:
            raise ValueError("loguniform(): the parameter is a whole number; write uniform(A,B)")
        return Spread("loguniform", low, high)

    def words(self, unit: str = "") -> str:
        """Return ``loguniform(LOW,HIGH)``."""
        return f"loguniform({_written(self.low, unit)},{_written(self.high, unit)})"


def _real(value, name: str) -> float:
    """Return a finite number as float."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise ValueError(f"{name} = {value!r}: must be a finite number")
    return float(value)


def _ends(kind: str, low, high) -> tuple[float, float]:
    """Return the ends of a distribution."""
    low, high = _real(low, "low"), _real(high, "high")
    if not high > low:
        raise ValueError(f"{kind}(): the second end must be above the first")
    return low, high


def _around(of: Range, width, relative: bool, row: ParameterRow) -> tuple[float, float]:
    """Return middle and half width of the factor or of the offset that changes the configured value."""
    if row.type is int:
        raise ValueError("is a whole number: give its values, 12,14,16 or 4:16:lin13, or uniform(4,16)")
    width = _real(width, "width")
    if not 0.0 < width < (1.0 if relative else math.inf):
        text = Within(width, relative).words()
        raise ValueError(f"{text}: must be above 0{' and below 100 %' if relative else ''}")
    return (1.0 if relative else 0.0), width


def _written(value: float, unit: str = "") -> str:
    """Return a number as text from which the same bits are read; a length gets its unit."""
    return repr(float(value)).removesuffix(".0") + (unit if unit == "m" else "")


def _percent(part: float) -> str:
    """Return a fraction in per cent as text from which, if possible, the same bits are read."""
    percents = 100.0 * part
    near = (percents, math.nextafter(percents, 0.0), math.nextafter(percents, math.inf), float(f"{percents:.12g}"))
    return _written(next((value for value in reversed(near) if value / 100.0 == part), percents)) + "%"


def parse_words(text: str, row: ParameterRow) -> Range:
    """Return the range that a text describes."""
    text = text.strip()
    around, stepped, distributed = (pattern.match(text) for pattern in (_AROUND, _STEPPED, _DISTRIBUTED))
    if row.type in (str, bool):
        if around or distributed or not text:
            raise ValueError("is not a number: give its values, separated by commas")
        words = [word.strip() for word in text.split(",")]
        return Levels(tuple(words if row.type is str else map(parse_value, words)))
    if around:
        return Within(*_width(around["width"], row))
    if stepped:
        low, high = _number(stepped["low"], row), _number(stepped["high"], row)
        spaced = Levels.logarithmic if stepped["kind"] == "log" else Levels.linear
        return spaced(low, high, int(stepped["count"]))
    if distributed:
        return _distributed(distributed["kind"], [word.strip() for word in distributed["words"].split(",")], row)
    return Levels(tuple(_number(word, row) for word in text.split(",")))


def parse_range(text: str, row: ParameterRow) -> Levels | Spread:
    """Return the levels or the distribution that a text describes for a parameter."""
    return parse_words(text, row).over(row)


def _width(text: str, row: ParameterRow) -> tuple[float, bool]:
    """Return a width around the configured value, and whether it is relative."""
    width, unit = quantity(text)
    relative = unit == "1" and text.rstrip().endswith("%")
    return width if relative or row.type is int else _number(text, row), relative


def _distributed(kind: str, words: list[str], row: ParameterRow) -> Range:
    if kind not in SPREADS:
        raise ValueError(f"{kind}(): unknown distribution, there are {', '.join(SPREADS)}")
    around = _AROUND.match(words[0]) if kind == "normal" and len(words) == 1 else None
    if around:
        return Normal.around(*_width(around["width"], row))
    if len(words) != 2:
        raise ValueError(f"{kind}(): takes two numbers, {'mean and deviation' if kind == 'normal' else 'both ends'}")
    first, second = (_number(word, row) for word in words)
    return {"uniform": Uniform, "loguniform": LogUniform, "normal": Normal}[kind](first, second)


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


def refused(text: str, value, remedy: str) -> ParameterError:
    """Return the error for an invalid ``--vary``."""
    return ParameterError([Problem(f"--vary {text}", value, remedy)])


#: Deviations of the whole plant; they leave the models of compensator and controller unchanged.
DEVIATIONS = {
    "gain": "factor on the displacement of the plant's hysteresis",
    "opening": "factor on the width of its loops",
    "slowness": "factor on all times of its dynamics",
    "creep_rate": "factor on the rate of its creep",
}
PLANT = "plant_simulator"
_DEVIATION_ROWS = {
    name: ParameterRow(name, float, 1.0, "", 1.0 - LARGEST, 1.0 + LARGEST, None, text, False, False)
    for name, text in DEVIATIONS.items()
}
_PLACE = re.compile(r"^(?P<name>.*?)(?:\[(?P<place>\d+)\])?$")


@dataclass(frozen=True)
class Variation:
    """A varied parameter with its range."""

    node: str  #: node, name: Node and dotted name; for the plant also one of :data:`DEVIATIONS`.
    name: str
    row: ParameterRow  #: Row of the parameter in the table of parameters.
    over: Levels | Spread
    place: int | None = None  #: Index of the element of an array.

    @property
    def label(self) -> str:
        """Name of the column of the results."""
        return f"{self.node}.{self.name}" + ("" if self.place is None else f"[{self.place}]")

    @property
    def deviates(self) -> bool:
        """Whether this is a deviation of the whole plant instead of a parameter."""
        return self.node == PLANT and self.name in DEVIATIONS

    def setting(self, present, place: float):
        """Return the new value of the parameter, and the number that stands for it in the results."""
        drawn = self.over.at(place)
        if isinstance(present, tuple) and self.place is None:  # a whole array is multiplied by one factor
            return tuple(drawn * value for value in present), drawn
        before = present if self.place is None else present[self.place]
        value = drawn
        if self.over.does == FACTOR:
            value = before * drawn
        elif self.over.does == OFFSET:
            value = before + drawn
        if self.place is None:
            return value, value
        return (*present[: self.place], value, *present[self.place + 1 :]), value


def parse_variations(
    vary: Sequence[str] | Mapping[str, str | Range | Sequence], axis: AxisParameters
) -> tuple[Variation, ...]:
    """Return the variations from texts ``NODE.PARAMETER=RANGE``, or from a mapping of ``NODE.PARAMETER`` to ranges."""
    given: list[tuple[str, str | Range]] = []
    if isinstance(vary, str) or not isinstance(vary, Iterable):
        raise refused(
            str(vary), "", "must be a list of NODE.PARAMETER=RANGE, or a mapping from NODE.PARAMETER to its range"
        )
    if isinstance(vary, Mapping):
        for target, over in vary.items():
            if not isinstance(over, (str, Range)) and not np.iterable(over):
                raise refused(target, over, "must be several values, a text such as '0.1:2:log20', or hr.Uniform")
            given.append((target, over if isinstance(over, (str, Range)) else Levels(tuple(over))))
    else:
        for text in vary:
            target, mark, words = text.partition("=")
            if not mark:
                raise refused(text, "", "write NODE.PARAMETER=RANGE, as motion_controller.pid.Kp=0.1:2:log20")
            given.append((target, words))
    found: list[Variation] = []
    for target, asked in given:
        found += [_variation(name, asked, axis) for name in _whole_plant(target.strip(), axis)]
    labels = [one.label for one in found]
    twice = [label for label in labels if labels.count(label) > 1]
    if twice:
        raise refused(twice[0], "", "is given twice; give each parameter once")
    for one in found:
        _require_allowed(one, _present(axis, one))
    return tuple(found)


def _require_allowed(one: Variation, present) -> None:
    """Refuse a range with an end or a level outside the range of the parameter."""
    for place in one.over.ends:
        try:
            one.row.convert(one.setting(present, place)[0])
        except ParameterError as error:
            raise refused(one.label, error.problems[0].value, error.problems[0].remedy) from None


def _whole_plant(target: str, axis: AxisParameters) -> list[str]:
    if target != PLANT:
        return [target]
    plant = axis.plant_simulator
    there = {"slowness": plant.dynamics.order, "creep_rate": plant.creep.type != "none"}
    return [f"{PLANT}.{name}" for name in DEVIATIONS if there.get(name, True)]


def _variation(target: str, words: str | Range, axis: AxisParameters) -> Variation:
    node, mark, dotted = target.partition(".")
    nodes = [name for name in NODE_PARAMETERS if getattr(axis, name) is not None]
    if node not in nodes or not mark:
        remedy = f"unknown node in this axis; there are {', '.join(nodes)}{did_you_mean(node, nodes)}"
        raise refused(target, node, remedy if node not in nodes else "its parameter is missing: write NODE.PARAMETER")
    parts = _PLACE.match(dotted)
    name, place = (parts["name"], parts["place"]) if parts else (dotted, None)
    rows = {row.name: replace(row, name=f"{node}: {row.name}") for row in NODE_PARAMETERS[node].table()}
    if node == PLANT:
        rows = {**_DEVIATION_ROWS, **rows}
    if name not in rows:
        raise refused(
            target, words, f"{node} has no such parameter{did_you_mean(name, rows)}; see `hysteresis parameters {node}`"
        )
    row = rows[name]
    element = replace(row, type=float) if row.type == tuple[float, ...] else row
    if row.type == tuple[str, ...]:
        raise refused(target, words, "is a list of words and cannot vary")
    try:
        over = words.over(element) if isinstance(words, Range) else parse_range(words, element)
    except ValueError as error:
        raise refused(target, words, str(error)) from None
    found = Variation(node, name, row, over, None if place is None else int(place))
    _require_fitting(target, words, found, _present(axis, found))
    return found


def _present(axis: AxisParameters, one: Variation):
    """Return the configured value of a variation."""
    if one.deviates:
        return 1.0
    value: Any = getattr(axis, one.node)
    for part in one.name.split("."):
        value = getattr(value, part)
    return value


def _require_fitting(target: str, words: str | Range, one: Variation, present) -> None:
    """Refuse a variation that the configured value does not allow."""
    row, over, place = one.row, one.over, one.place
    if present is None and (over.does != VALUE or place is not None):
        raise refused(target, words, "has no configured value; give values")
    if row.type == tuple[float, ...]:
        if place is None and over.does != FACTOR:
            count = len(present or ())
            raise refused(
                target, words, f"is an array: give ±5%, or the values of one element, {target}[0] … [{count - 1}]"
            )
        if place is not None and place >= len(present):
            raise refused(target, words, f"has {len(present)} elements, [0] … [{len(present) - 1}]")
    elif place is not None:
        raise refused(target, words, "is not an array: remove the number in brackets")
    value = present[place] if place is not None else present
    if over.does == FACTOR and not np.any(value):
        raise refused(
            target, words, "is configured as 0, so a relative change has no effect: give a width with a unit, or values"
        )


def settings(axis: AxisParameters, variations: Sequence[Variation], point) -> tuple[dict[str, dict[str, Any]], list]:
    """Return the values of a run by node and name, and the numbers that stand for them in the results."""
    numbers: list = []
    changes: dict[str, dict[str, Any]] = {}
    for one, place in zip(variations, point, strict=True):
        known = changes.setdefault("" if one.deviates else one.node, {})
        known[one.name], number = one.setting(known.get(one.name, _present(axis, one)), place)
        numbers.append(number)
    return changes, numbers


def varied(axis: AxisParameters, variations: Sequence[Variation], point) -> AxisParameters:
    """Return the axis with the parameters of one point."""
    changes, _ = settings(axis, variations, point)
    for one in variations:
        known = changes["" if one.deviates else one.node]
        known[one.name] = one.row.convert(known[one.name])
    parts = {name: getattr(axis, name) for name in NODE_PARAMETERS}
    if "" in changes:
        parts[PLANT] = _deviating(parts[PLANT], **changes.pop(""))
    for node, values in changes.items():
        parts[node] = parts[node].with_values(values, f"{node}: ")
    return AxisParameters.of_nodes(axis.namespace, parts)


def _deviating(plant, gain=1.0, opening=1.0, slowness=1.0, creep_rate=1.0):
    deviation = Deviation(gain, opening, lambda count=None: 1.0 if count is None else np.ones(count))
    found = deviating(plant, deviation, slowness, creep_rate)
    return plant.with_values(
        {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}
    )


#: Default number of runs with distributions.
DRAWS = 1000
#: Maximum number of runs of one sweep.
MOST_RUNS = 10**9
RANDOM, SOBOL, MORRIS = DESIGNS = "random", "sobol", "morris"
MORRIS_LEVELS = 4


@dataclass(frozen=True)
class Plan:
    """The points of a sweep."""

    variations: tuple[Variation, ...]
    runs: int  #: Number of runs.
    seed: int = 1  #: Seed of the draws.
    design: str = RANDOM  #: ``random``, or ``sobol`` or ``morris`` for a sensitivity.

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of levels of the variations with levels."""
        return tuple(len(one.over.values) for one in self.variations if isinstance(one.over, Levels))

    @property
    def combinations(self) -> int:
        """Number of combinations of levels."""
        return math.prod(self.counts)

    @property
    def spreads(self) -> int:
        """Number of distributions."""
        return len(self.variations) - len(self.counts)

    def points(self, numbers: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the points of some runs, shape (runs, variations): indices of levels, positions in distributions."""
        numbers = np.arange(int(numbers[0]), int(numbers[-1]) + 1)
        found = np.empty((len(numbers), len(self.variations)))
        if self.design != RANDOM:
            found[:] = self.designed[numbers]
            for i, one in enumerate(self.variations):
                if isinstance(one.over, Levels):
                    count = len(one.over.values)
                    found[:, i] = np.minimum(np.floor(found[:, i] * count), count - 1)
            return found
        stepped = [isinstance(one.over, Levels) for one in self.variations]
        if self.counts:
            found[:, stepped] = np.transpose(np.unravel_index(numbers % self.combinations, self.counts))
        if self.spreads:
            draws = numbers // self.combinations
            first = int(draws[0])
            generator = np.random.PCG64(self.seed).advance(first * self.spreads)
            places = np.random.Generator(generator).random((int(draws[-1]) - first + 1, self.spreads))
            found[:, np.logical_not(stepped)] = places[draws - first]
        return found

    @property
    def problem(self) -> dict:
        """Definition of the variables for SALib, on the unit cube."""
        count = len(self.variations)
        return {"num_vars": count, "names": [one.label for one in self.variations], "bounds": [[0.0, 1.0]] * count}

    @functools.cached_property
    def designed(self) -> np.ndarray:
        """The points of a sensitivity analysis, on the unit cube, shape (runs, variations)."""
        from SALib.sample import morris, sobol

        if self.design == SOBOL:
            base = self.runs // (len(self.variations) + 2)
            return sobol.sample(self.problem, base, calc_second_order=False, seed=self.seed)
        trajectories = self.runs // (len(self.variations) + 1)
        return morris.sample(self.problem, trajectories, num_levels=MORRIS_LEVELS, seed=self.seed)


def make_plan(variations: tuple[Variation, ...], runs: int | None = None, seed: int = 1, design: str = RANDOM) -> Plan:
    """Return the plan of a sweep."""
    if not variations:
        raise ConfigurationError("no varied parameter: give --vary NODE.PARAMETER=RANGE")
    if seed < 0:
        raise ParameterError([Problem("seed", seed, "must be 0 or more")])
    if design not in DESIGNS:
        near = did_you_mean(design, DESIGNS)
        raise ConfigurationError(f"sensitivity = {design!r}: must be {SOBOL} or {MORRIS}{near}")
    plan = Plan(variations, 0, seed, design)
    levels, spreads = plan.combinations, plan.spreads
    asked = runs if runs is not None else (max(DRAWS, levels) if spreads or design != RANDOM else levels)
    if not 1 <= asked <= MOST_RUNS:
        raise ConfigurationError(f"--runs {asked}: must be 1 … {MOST_RUNS:.0e}; the levels have {levels} combinations")
    if design == RANDOM:
        if asked < levels:
            raise ConfigurationError(
                f"--runs {asked}: there are {levels} combinations of levels: give at least as many runs, or fewer "
                "levels"
            )
        return Plan(variations, asked if spreads else levels, seed, design)
    count = len(variations)
    if design == SOBOL:
        base = 2 ** int(math.log2(max(asked // (count + 2), 1)))  # the Sobol sequence is uniform only for powers of two
        least, made = 4 * (count + 2), base * (count + 2)
    else:
        least, made = 4 * (count + 1), asked // (count + 1) * (count + 1)
    if made < least:
        raise ConfigurationError(f"--runs {asked}: --sensitivity {design} of {count} variations needs at least {least}")
    return Plan(variations, made, seed, design)
