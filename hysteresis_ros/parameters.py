# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Typed parameters: one dataclass per block, which maps 1:1 to the YAML of the nodes.

A block's parameters are a frozen dataclass derived from :class:`Parameters`; every field is made by
:func:`parameter` (a value) or :func:`group` (a nested dataclass). The same table serves the offline simulation,
the declaration of ROS parameters and the generated documentation.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, ClassVar, get_type_hints

from hysteresis_ros.errors import ParameterError, Problem, did_you_mean

#: Types a ROS 2 parameter can have and the words users know them by.
TYPE_NAMES = {
    float: "double",
    int: "integer",
    bool: "bool",
    str: "string",
    tuple[float, ...]: "double array",
    tuple[str, ...]: "string array",
}


#: Most elements of an array, and characters of a text.
MOST_ITEMS, LONGEST_TEXT = 100_000, 4096

#: Types whose values are tuples.
ARRAY_TYPES = (tuple[float, ...], tuple[str, ...])


@dataclass(frozen=True)
class ParameterRow:
    """One line of the parameter table (name, type, default, unit, range, description, read_only)."""

    name: str
    type: Any
    default: Any
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...] | None
    description: str
    read_only: bool
    required: bool
    paths: bool = False
    place: str = ""

    @property
    def type_name(self) -> str:
        """Name of the type as ROS 2 users know it."""
        return TYPE_NAMES[self.type]

    def allowed(self) -> str:
        """What may be given, in words, for error messages and documentation."""
        unit = f" {self.unit}" if self.unit else ""
        text = self.type_name
        if self.choices:
            text += ", one of " + ", ".join(choice or "''" for choice in self.choices)
            text += ", or a path with a /" if self.paths else ""
        elif self.low is not None and self.high is not None:
            text += f" in {self.low:g} … {self.high:g}{unit}"
        elif self.low is not None:
            text += f" ≥ {self.low:g}{unit}"
        elif self.high is not None:
            text += f" ≤ {self.high:g}{unit}"
        elif unit:
            text += f" in{unit}"
        return text

    def convert(self, value):
        """Return ``value`` in this row's type, or raise ParameterError naming the parameter and what is allowed.

        Whole numbers are accepted where a double is wanted (``0`` for ``0.0``); nothing else is converted.
        """
        try:
            converted = _convert(self.type, value)
        except (TypeError, OverflowError):  # a whole number may have any size, a double not
            raise ParameterError([Problem(self.name, value, f"wrong type, allowed: {self.allowed()}")]) from None
        items = converted if isinstance(converted, tuple) else (converted,)
        longest = max((len(item) for item in items if isinstance(item, str)), default=0)
        if len(items) > MOST_ITEMS or longest > LONGEST_TEXT:
            allowed = f"too long, allowed: {MOST_ITEMS} elements, of {LONGEST_TEXT} characters each"
            raise ParameterError([Problem(self.name, value, allowed)])
        for item in items:
            if isinstance(item, float) and not math.isfinite(item):
                raise ParameterError([Problem(self.name, value, f"must be finite, allowed: {self.allowed()}")])
            if isinstance(item, (int, float)) and not isinstance(item, bool):
                below = self.low is not None and item < self.low
                above = self.high is not None and item > self.high
                if below or above:
                    raise ParameterError([Problem(self.name, value, f"out of range, allowed: {self.allowed()}")])
            if self.choices and item not in self.choices and not (self.paths and "/" in item):
                near = did_you_mean(item, self.choices)
                raise ParameterError([Problem(self.name, value, f"unknown choice, allowed: {self.allowed()}{near}")])
        return converted


def _convert(kind, value):
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if kind is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind is bool and isinstance(value, bool):
        return value
    if kind is str and isinstance(value, str):
        return value
    if kind in ARRAY_TYPES and not isinstance(value, (str, bytes)):
        try:
            items = list(value)
        except TypeError:
            raise TypeError from None
        item_kind = float if kind == tuple[float, ...] else str
        return tuple(_convert(item_kind, item) for item in items)
    raise TypeError


def parameter(
    default=MISSING,
    *,
    description: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
    read_only: bool = False,
    paths: bool = False,
    place: str = "",
) -> Any:
    """Declare one parameter of a block.

    Parameters
    ----------
    default : float, int, bool, str or tuple, optional
        Value when YAML does not give one. Without it the parameter is required wherever its group is in use.
    description, unit : str
        Shown by ``ros2 param describe`` and in the documentation.
    low, high : float, optional
        Inclusive range, of each element for arrays.
    choices : tuple of str, optional
        Allowed strings.
    read_only : bool
        True for structure (sizes, rates, types); such parameters cannot change while a node is configured.
    paths : bool
        Beside the choices, a path is allowed: whatever contains a slash.
    place : str
        Where from it may be given a path: ``files``, over the graph only one in stated folders; ``start``, not over the
        graph at all.
    """
    required = default is MISSING
    metadata = dict(description=description, unit=unit, low=low, high=high, choices=choices, paths=paths)
    metadata |= dict(read_only=read_only, required=required, place=place)
    return field(default=None if required else default, metadata=metadata)


def group(cls, *, variant_of: str | None = None) -> Any:
    """Nest another parameter dataclass; its YAML names get this field's name as prefix.

    With ``variant_of="type"`` the group is only checked when the field ``type`` of the same dataclass equals this
    field's name: a file may keep the parameters of several models and choose one of them.
    """
    return field(default_factory=cls, metadata=dict(group=cls, variant_of=variant_of))


def variants(chooser: str, choices: dict[str, type]):
    """Return a class decorator that nests one group for each name that the parameter ``chooser`` may have.

    It stands under ``@dataclass(frozen=True)``. So the groups of a class can come from a registry.

    Parameters
    ----------
    chooser : str
        Name of the parameter that chooses.
    choices : dict of str to type
        Name of each group → its dataclass.
    """

    def add(cls):
        for name, variant in choices.items():
            cls.__annotations__[name] = variant
            setattr(cls, name, group(variant, variant_of=chooser))
        return cls

    return add


#: Annotations are strings here, and evaluating them at every look-up is slow.
_type_hints: Callable[[type], dict[str, Any]] = lru_cache(maxsize=None)(get_type_hints)


def _rows(cls: type[Parameters], prefix: str) -> tuple[ParameterRow, ...]:
    """Return the rows of a dataclass and its groups."""
    hints = _type_hints(cls)
    rows: list[ParameterRow] = []
    for item in fields(cls):
        nested = item.metadata.get("group")
        if nested is not None:
            rows += nested.table(f"{prefix}{item.name}.")
        else:
            row = ParameterRow(name=prefix + item.name, type=hints[item.name], default=item.default, **item.metadata)
            rows.append(row)
    return tuple(rows)


_table: Callable[[type, str], tuple[ParameterRow, ...]] = lru_cache(maxsize=None)(_rows)


class Parameters:
    """Base of all parameter dataclasses. Subclasses are ``@dataclass(frozen=True)``."""

    __dataclass_fields__: ClassVar[dict[str, Field]]

    @classmethod
    def table(cls, prefix: str = "") -> list[ParameterRow]:
        """Return all rows of this dataclass and its groups, with dotted names."""
        return list(_table(cls, prefix))

    @classmethod
    def from_mapping(cls, mapping, prefix: str = ""):
        """Build and check the parameters from a flat mapping of dotted names to values.

        Raises
        ------
        ParameterError
            Names every unknown, missing, mistyped or out-of-range entry together.
        """
        rows = {row.name: row for row in cls.table()}
        problems, values = [], {}
        for name, value in mapping.items():
            row = rows.get(name)
            if row is None:
                close = difflib.get_close_matches(name, rows, n=1)
                hint = f"did you mean {prefix}{close[0]}?" if close else "remove it or see the parameter table"
                problems.append(Problem(prefix + name, value, f"unknown parameter; {hint}"))
                continue
            try:
                values[name] = replace(row, name=prefix + name).convert(value)
            except ParameterError as error:
                problems += error.problems
        result = cls._assemble(values)
        if not problems:
            problems += result.problems(prefix)
        if problems:
            raise ParameterError(problems)
        return result._valid()

    @classmethod
    def _assemble(cls, values: dict):
        arguments = {}
        for item in fields(cls):
            nested = item.metadata.get("group")
            if nested is not None:
                start = item.name + "."
                part = {name[len(start) :]: value for name, value in values.items() if name.startswith(start)}
                arguments[item.name] = nested._assemble(part)
            elif item.name in values:
                arguments[item.name] = values[item.name]
        return cls(**arguments)

    def with_values(self, values, prefix: str = ""):
        """Return the parameters with some values changed, as :meth:`from_mapping` builds and checks them.

        What is not changed is not converted once more, which makes this ten times as quick.

        Parameters
        ----------
        values : mapping of str to object
            By dotted names, each of its row's type (:meth:`ParameterRow.convert`).
        prefix : str
            Put before the names in messages.

        Raises
        ------
        ParameterError
            They do not fit together.
        """
        result = self._changed(values)
        problems = result.problems(prefix)
        if problems:
            raise ParameterError(problems)
        return result._valid()

    def _changed(self, values):
        groups: dict[str, dict] = {}
        for name, value in values.items():
            first, _, rest = name.partition(".")
            groups.setdefault(first, {})[rest] = value
        given = {
            first: part[""] if "" in part else getattr(self, first)._changed(part) for first, part in groups.items()
        }
        return replace(self, **given)

    def problems(self, prefix: str = "") -> list[Problem]:
        """Return everything that is missing or inconsistent, with full names; empty when all is well."""
        if self.__dict__.get("_is_valid"):
            return []
        found = []
        for item in fields(self):
            nested = item.metadata.get("group")
            value = getattr(self, item.name)
            if nested is not None:
                chooser = item.metadata.get("variant_of")
                if chooser is None or getattr(self, chooser) == item.name:
                    found += value.problems(f"{prefix}{item.name}.")
            elif value is None:
                row = next(row for row in self.table() if row.name == item.name)
                found.append(Problem(prefix + item.name, None, f"missing; give a {row.allowed()}"))
        if not found:
            found += [Problem(prefix + p.name, p.value, p.allowed) for p in self.check()]
        return found

    def check(self):
        """Yield a Problem for every inconsistency between several parameters; overridden where there are any."""
        return ()

    def warnings(self, prefix: str = "") -> tuple[str, ...]:
        """Return a sentence for each doubt about parameters that are allowed, of the groups in use too.

        Parameters
        ----------
        prefix : str
            Put before the names of the parameters.
        """
        found = []
        for item in fields(self):
            chooser = item.metadata.get("variant_of")
            if item.metadata.get("group") is not None and (chooser is None or getattr(self, chooser) == item.name):
                found += getattr(self, item.name).warnings(f"{prefix}{item.name}.")
        return tuple(found)

    def validated(self, prefix: str = ""):
        """Return self, or raise ParameterError with all problems. For parameters that are built in Python."""
        if self.__dict__.get("_is_valid"):
            return self
        problems = self._unfit(prefix) or self.problems(prefix)
        if problems:
            raise ParameterError(problems)
        return self._valid()

    def _valid(self):
        """Return self, of which all is known to be well.

        Nothing in it can change: what was found once is kept, for changes that may take no time. What of its groups is
        not in use has not been looked at.
        """
        for item in fields(self):
            chooser = item.metadata.get("variant_of")
            if item.metadata.get("group") is not None and (chooser is None or getattr(self, chooser) == item.name):
                group_ = getattr(self, item.name)
                if not group_.__dict__.get("_is_valid"):
                    group_._valid()
        self.__dict__["_is_valid"] = True
        return self

    def _unfit(self, prefix: str) -> list[Problem]:
        """Return a Problem for each value that its row does not allow."""
        found: list[Problem] = []
        rows = {row.name: row for row in _table(type(self), "") if "." not in row.name}
        for item in fields(self):
            value = getattr(self, item.name)
            if item.metadata.get("group") is not None:
                found += [] if value.__dict__.get("_is_valid") else value._unfit(f"{prefix}{item.name}.")
            elif value is not None:
                try:
                    rows[item.name].convert(value)
                except ParameterError as error:
                    found += [replace(problem, name=prefix + item.name) for problem in error.problems]
        return found

    def to_mapping(self) -> dict:
        """Return the flat mapping of dotted names to values; parameters without a value are left out."""
        flat = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if item.metadata.get("group") is not None:
                flat.update({f"{item.name}.{name}": inner for name, inner in value.to_mapping().items()})
            elif value is not None:
                flat[item.name] = value
        return flat
