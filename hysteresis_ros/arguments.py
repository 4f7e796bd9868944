# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Check the arguments of the Python API against their annotations, and convert texts with units to SI.

Simple kinds are checked: numbers, texts, flags, paths, functions and sequences (``tuple``). Arguments with another
annotation, such as ``ArrayLike`` or a class of the package, are left to the function.
"""

from __future__ import annotations

import functools
import inspect
import numbers
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, ParamSpec, TypeAlias, TypeVar

import numpy as np

from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.units import quantity_in

P = ParamSpec("P")
R = TypeVar("R")

#: A number in SI units, or a text with its unit such as ``100ms``; in a checked function always a number.
Seconds: TypeAlias = "float | Any"
Hertz: TypeAlias = "float | Any"
Metres: TypeAlias = "float | Any"
Share: TypeAlias = "float | Any"

#: Annotation of a quantity → (SI unit, example of a text with a unit).
QUANTITIES = {"Seconds": ("s", "100ms"), "Hertz": ("Hz", "50Hz"), "Metres": ("m", "10nm"), "Share": ("", "5%")}
#: Annotation without its type arguments → (accepted class, its name in a message).
KINDS: dict[str, tuple[Any, str]] = {
    "float": (numbers.Real, "a finite number"),
    "int": (numbers.Integral, "a whole number"),
    "bool": (bool, "True or False"),
    "str": (str, "a text"),
    "os.PathLike": (os.PathLike, "a path"),
    "Callable": (Callable, "a function"),
    "tuple": (Iterable, "a sequence"),
    "None": (type(None), ""),
}


class Rule(NamedTuple):
    """What an argument may be."""

    classes: tuple[Any, ...]  #: Accepted classes.
    unit: str | None  #: SI unit of a text with a unit; None: such a text is not accepted.
    remedy: str  #: The end of a message.

    def allows(self, value: Any) -> bool:
        """Return whether a value is of an accepted class; numbers must be finite, and paths not empty."""
        if isinstance(value, (bool, str)) and type(value) not in self.classes:
            return False
        if isinstance(value, (int, float)) and not -sys.float_info.max <= value <= sys.float_info.max:
            return False
        return isinstance(value, self.classes) and not (value == "" and os.PathLike in self.classes)

    def value(self, name: str, given: Any) -> Any:
        """Return an argument, a text with a unit as a number [SI]; raise a ParameterError if it is not allowed."""
        value = given.item() if getattr(given, "ndim", None) == 0 else given
        if self.unit is not None and isinstance(value, str):
            try:
                return quantity_in(value, self.unit)
            except ValueError as error:
                raise ParameterError([Problem(name, given, f"{error}; {self.remedy}")]) from None
        if not self.allows(value):
            raise ParameterError([Problem(name, given, self.remedy)])
        return float(value) if numbers.Real in self.classes and isinstance(value, numbers.Real) else value


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of a function against its annotations whenever it is called."""
    annotations = {name: one.annotation for name, one in inspect.signature(function).parameters.items()}
    rules = rules_of(annotations)

    @functools.wraps(function)
    def call(*given: P.args, **named: P.kwargs) -> R:
        values: Any = list(given)
        for place, (name, one) in enumerate(zip(annotations, given, strict=False)):
            values[place] = rules[name].value(name, one) if name in rules else one
        others: Any = {name: rules[name].value(name, one) if name in rules else one for name, one in named.items()}
        return function(*values, **others)

    return call


def check_fields(instance: Any) -> None:
    """Check the fields of a dataclass, as :func:`checked` does with arguments."""
    for name, rule in rules_of(type(instance).__annotations__).items():
        object.__setattr__(instance, name, rule.value(name, getattr(instance, name)))


def checked_value(name: str, value: Any, annotation: str) -> Any:
    """Check one value against an annotation, as :func:`checked` does with arguments."""
    return rules_of({name: annotation})[name].value(name, value)


def rules_of(annotations: Mapping[str, str]) -> dict[str, Rule]:
    """Return the rules of the arguments whose annotations this module knows."""
    rules = {}
    for name, annotation in annotations.items():
        parts = [part.partition("[")[0] for part in annotation.split(" | ")]
        found = [KINDS["float"] if part in QUANTITIES else KINDS.get(part) for part in parts]
        known = [kind for kind in found if kind is not None]
        if len(known) < len(found):
            continue
        allowed = f"must be {' or '.join(text for _, text in known if text)}"
        unit, example = next((QUANTITIES[part] for part in parts if part in QUANTITIES), (None, ""))
        if unit is not None:
            allowed += f"{f' [{unit}]' if unit else ''}, or a text with its unit such as {example!r}"
        rules[name] = Rule(tuple(kind for kind, _ in known), unit, allowed)
    return rules


def real_array(values: Any) -> np.ndarray:
    """Return values as a contiguous float64 array; raise TypeError or ValueError if they are not real numbers."""
    if np.iscomplexobj(values):
        raise TypeError("complex numbers")
    return np.ascontiguousarray(values, dtype=np.float64)
