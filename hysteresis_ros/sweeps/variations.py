# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which parameter of an axis varies: one of a node, an element of an array, or how far its plant is from its model."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.errors import ParameterError, did_you_mean
from hysteresis_ros.loop.axis_parameters import NODE_PARAMETERS, AxisParameters
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.parameters import ParameterRow
from hysteresis_ros.simulation.mismatch import LARGEST, deviating
from hysteresis_ros.sweeps.ranges import FACTOR, OFFSET, VALUE, Levels, Spread, parse_range, refused

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
    """A parameter, and what it varies over.

    Parameters
    ----------
    node, name : str
        Node and dotted name; of the plant also one of :data:`DEVIATIONS`.
    row : ParameterRow
        Its line of the table.
    over : Levels or Spread
    place : int, optional
        Which element of an array.
    """

    node: str
    name: str
    row: ParameterRow
    over: Levels | Spread
    place: int | None = None

    @property
    def label(self) -> str:
        """Name of the column of the results."""
        return f"{self.node}.{self.name}" + ("" if self.place is None else f"[{self.place}]")

    @property
    def deviates(self) -> bool:
        """Whether it is no parameter but a deviation of the whole plant."""
        return self.node == PLANT and self.name in DEVIATIONS

    def setting(self, present, place: float):
        """Return the new value of the parameter, and the number that stands for it in the results.

        Parameters
        ----------
        present : object
            Its value before.
        place : float
            Number of a level, or place in a distribution.
        """
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
    """Return what varies.

    Parameters
    ----------
    texts : sequence of str
        Each ``NODE.PARAMETER=RANGE``, see :mod:`hysteresis_ros.sweeps.ranges`; ``plant_simulator=±5%`` lets each of
        :data:`DEVIATIONS` vary so.
    axis : AxisParameters
        As configured.

    Raises
    ------
    ParameterError
        A node or parameter does not exist, varies twice, or a range has an end that is not allowed.
    """
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
    """Return the values of a run by nodes and names, and the numbers that stand for them in the results.

    Parameters
    ----------
    axis : AxisParameters
        As configured.
    variations : sequence of Variation
    point : sequence of float
        Place of each.
    """
    numbers: list = []
    changes: dict[str, dict[str, Any]] = {}
    for one, place in zip(variations, point, strict=True):
        known = changes.setdefault("" if one.deviates else one.node, {})
        known[one.name], number = one.setting(known.get(one.name, _present(axis, one)), place)
        numbers.append(number)
    return changes, numbers


def varied(axis: AxisParameters, variations: Sequence[Variation], point) -> AxisParameters:
    """Return an axis with other parameters.

    Parameters
    ----------
    axis : AxisParameters
        As configured; nothing but what varies changes, so the models of the controller's side stay as they are.
    variations : sequence of Variation
    point : sequence of float
        Place of each.

    Raises
    ------
    ParameterError
        One is out of range, or they do not fit together.
    """
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
