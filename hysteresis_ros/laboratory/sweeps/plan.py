# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which parameters vary over what, and which runs that makes: levels, draws, or the points a sensitivity asks for.

``1um:5um:lin10`` and ``0.1:2:log20`` are levels evenly spaced or in a constant ratio, ``12,14,16`` levels one by one.
``±5%`` is evenly distributed around the configured value, as ``±2nm`` is; ``uniform(A,B)``, ``loguniform(A,B)``,
``normal(MEAN,DEVIATION)`` and, around the configured value, ``normal(±5%)``, whose 5 % is the standard deviation.

Run i stands at level i mod L of the L combinations of levels and takes draw i div L of the distributions, so that all
levels meet the same draws, and a longer sweep begins with the shorter one. Draw j of D distributions is numbers j D …
(j + 1) D - 1 of the PCG64 generator of the seed: a point depends on seed and number only, not on who computes it.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Sequence
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
    """Values one by one."""

    values: tuple  #: In the parameter's type and unit.

    does = VALUE

    @property
    def ends(self) -> tuple[float, ...]:
        """Places of what has to be allowed before anything runs: all of them."""
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
    does: str = VALUE  #: Whether it is of values, of factors or of offsets.
    whole: bool = False  #: Of whole numbers, both ends included.

    @property
    def ends(self) -> tuple[float, ...]:
        """Places of what has to be allowed before anything runs; a normal distribution has no ends, only its mean."""
        return (0.5,) if self.kind == "normal" else (0.0, 1.0)

    def at(self, place: float) -> float:
        """Return the value at a place of the distribution (the inverse of its distribution function)."""
        if self.whole:
            return int(min(self.first + math.floor(place * (self.second - self.first + 1.0)), self.second))
        if self.kind == "normal":
            return self.first + self.second * float(scipy.special.ndtri(min(place + HALF, 1.0 - HALF)))
        if self.kind == "loguniform":
            return self.first * math.exp(place * math.log(self.second / self.first))
        return self.first + place * (self.second - self.first)


def parse_range(text: str, row: ParameterRow) -> Levels | Spread:
    """Return what a parameter varies over."""
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
    """Return the error of a variation."""
    return ParameterError([Problem(f"--vary {text}", value, allowed)])


#: What a plant as a whole may be off by, of which the models on the controller's side know nothing.
DEVIATIONS = {
    "gain": "factor on the displacement of the plant's hysteresis",
    "opening": "factor on the opening of its loops",
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
    """A parameter, and what it varies over."""

    node: str  #: node, name: Node and dotted name; of the plant also one of :data:`DEVIATIONS`.
    name: str
    row: ParameterRow  #: Its line of the table.
    over: Levels | Spread
    place: int | None = None  #: Which element of an array.

    @property
    def label(self) -> str:
        """Name of the column of the results."""
        return f"{self.node}.{self.name}" + ("" if self.place is None else f"[{self.place}]")

    @property
    def deviates(self) -> bool:
        """Whether it is no parameter but a deviation of the whole plant."""
        return self.node == PLANT and self.name in DEVIATIONS

    def setting(self, present, place: float):
        """Return the new value of the parameter, and the number that stands for it in the results."""
        drawn = self.over.at(place)
        if isinstance(present, tuple) and self.place is None:  # ranges of whole arrays are factors
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


def parse_variations(texts: Sequence[str], axis: AxisParameters) -> tuple[Variation, ...]:
    """Return what varies."""
    found: list[Variation] = []
    for text in texts:
        target, mark, words = text.partition("=")
        if not mark:
            raise refused(text, "", "write NODE.PARAMETER=RANGE, as motion_controller.pid.Kp=0.1:2:log20")
        found += [_variation(name, words, axis) for name in _whole_plant(target.strip(), axis)]
    labels = [one.label for one in found]
    twice = [label for label in labels if labels.count(label) > 1]
    if twice:
        raise refused(twice[0], "", "varies twice; say it once")
    for one in found:
        _require_allowed(one, _present(axis, one))
    return tuple(found)


def _require_allowed(one: Variation, present) -> None:
    """Refuse a range with an end, or a level, that the parameter may not have."""
    for place in one.over.ends:
        try:
            one.row.convert(one.setting(present, place)[0])
        except ParameterError as error:
            raise refused(one.label, error.problems[0].value, error.problems[0].allowed) from None


def _whole_plant(target: str, axis: AxisParameters) -> list[str]:
    if target != PLANT:
        return [target]
    plant = axis.plant_simulator
    there = {"slowness": plant.dynamics.order, "creep_rate": plant.creep.type != "none"}
    return [f"{PLANT}.{name}" for name in DEVIATIONS if there.get(name, True)]


def _variation(target: str, words: str, axis: AxisParameters) -> Variation:
    node, mark, dotted = target.partition(".")
    nodes = [name for name in NODE_PARAMETERS if getattr(axis, name) is not None]
    if node not in nodes or not mark:
        allowed = f"there is no such node in this axis; there are {', '.join(nodes)}{did_you_mean(node, nodes)}"
        raise refused(target, node, allowed if node not in nodes else "which of its parameters? Write NODE.PARAMETER")
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
        raise refused(target, words, "is a list of words, which cannot vary")
    try:
        over = parse_range(words, element)
    except ValueError as error:
        raise refused(target, words, str(error)) from None
    found = Variation(node, name, row, over, None if place is None else int(place))
    _require_fitting(target, words, found, _present(axis, found))
    return found


def _present(axis: AxisParameters, one: Variation):
    """Return the configured value of what varies."""
    if one.deviates:
        return 1.0
    value: Any = getattr(axis, one.node)
    for part in one.name.split("."):
        value = getattr(value, part)
    return value


def _require_fitting(target: str, words: str, one: Variation, present) -> None:
    """Refuse what cannot be done to the configured value."""
    row, over, place = one.row, one.over, one.place
    if present is None and (over.does != VALUE or place is not None):
        raise refused(target, words, "has no configured value; give values")
    if row.type == tuple[float, ...]:
        if place is None and over.does != FACTOR:
            count = len(present or ())
            raise refused(target, words, f"is an array: ±5% of all of it, or one element, {target}[0] … [{count - 1}]")
        if place is not None and place >= len(present):
            raise refused(target, words, f"has {len(present)} elements, [0] … [{len(present) - 1}]")
    elif place is not None:
        raise refused(target, words, "is no array: leave the number in brackets out")
    value = present[place] if place is not None else present
    if over.does == FACTOR and not np.any(value):
        raise refused(target, words, "is configured as 0, of which a part is 0: give ± with a unit, or values")


def settings(axis: AxisParameters, variations: Sequence[Variation], point) -> tuple[dict[str, dict[str, Any]], list]:
    """Return the values of a run by nodes and names, and the numbers that stand for them in the results."""
    numbers: list = []
    changes: dict[str, dict[str, Any]] = {}
    for one, place in zip(variations, point, strict=True):
        known = changes.setdefault("" if one.deviates else one.node, {})
        known[one.name], number = one.setting(known.get(one.name, _present(axis, one)), place)
        numbers.append(number)
    return changes, numbers


def varied(axis: AxisParameters, variations: Sequence[Variation], point) -> AxisParameters:
    """Return an axis with other parameters."""
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


#: Runs where there are distributions and nobody says how many.
DRAWS = 1000
#: Most runs of one sweep.
MOST_RUNS = 10**9
RANDOM, SOBOL, MORRIS = "random", "sobol", "morris"
MORRIS_LEVELS = 4


@dataclass(frozen=True)
class Plan:
    """The points of a sweep."""

    variations: tuple[Variation, ...]
    runs: int  #: How many.
    seed: int = 1  #: Of the draws.
    design: str = RANDOM  #: ``random``, or ``sobol`` or ``morris`` for a sensitivity.

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of levels of the variations that have some."""
        return tuple(len(one.over.values) for one in self.variations if isinstance(one.over, Levels))

    @property
    def combinations(self) -> int:
        """How many combinations of levels there are."""
        return math.prod(self.counts)

    @property
    def spreads(self) -> int:
        """How many distributions there are."""
        return len(self.variations) - len(self.counts)

    def points(self, numbers: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the points of some runs, shape (runs, variations): numbers of levels and places in distributions."""
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
        """The variations as SALib names them, on the unit cube."""
        count = len(self.variations)
        return {"num_vars": count, "names": [one.label for one in self.variations], "bounds": [[0.0, 1.0]] * count}

    @functools.cached_property
    def designed(self) -> np.ndarray:
        """The points that a sensitivity asks for, on the unit cube, shape (runs, variations)."""
        from SALib.sample import morris, sobol

        if self.design == SOBOL:
            base = self.runs // (len(self.variations) + 2)
            return sobol.sample(self.problem, base, calc_second_order=False, seed=self.seed)
        trajectories = self.runs // (len(self.variations) + 1)
        return morris.sample(self.problem, trajectories, num_levels=MORRIS_LEVELS, seed=self.seed)


def make_plan(variations: tuple[Variation, ...], runs: int | None = None, seed: int = 1, design: str = RANDOM) -> Plan:
    """Return the plan of a sweep."""
    if not variations:
        raise ConfigurationError("nothing varies: give --vary NODE.PARAMETER=RANGE")
    plan = Plan(variations, 0, seed, design)
    levels, spreads = plan.combinations, plan.spreads
    asked = runs if runs is not None else (max(DRAWS, levels) if spreads or design != RANDOM else levels)
    if not 1 <= asked <= MOST_RUNS:
        raise ConfigurationError(f"--runs {asked}: must be 1 … {MOST_RUNS:.0e}; the levels are {levels} together")
    if design == RANDOM:
        if asked < levels:
            raise ConfigurationError(
                f"--runs {asked}: the levels are {levels} together: give at least so many runs, or fewer levels"
            )
        return Plan(variations, asked if spreads else levels, seed, design)
    count = len(variations)
    if design == SOBOL:
        base = 2 ** int(math.log2(max(asked // (count + 2), 1)))  # the sequence is even for powers of two only
        least, made = 4 * (count + 2), base * (count + 2)
    else:
        least, made = 4 * (count + 1), asked // (count + 1) * (count + 1)
    if made < least:
        raise ConfigurationError(f"--runs {asked}: --sensitivity {design} of {count} variations needs at least {least}")
    return Plan(variations, made, seed, design)
