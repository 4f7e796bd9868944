# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Registries of declarations in folders and in other packages, and notebook classes generated from them.

Every module (or subfolder) in a registry's folder declares an object, or a tuple of objects, under the same name, for
instance ``MODEL``. The registry finds every module of the folder whose name does not begin with ``_``. Other packages
add declarations by an entry point of the registry's group.

``hr.models``, ``hr.inverses``, ``hr.controllers`` and ``hr.references`` consist of classes for notebooks, one for every
entry of a registry. Each class is a subclass of the block; its constructor takes the parameters as keywords.

A keyword is the last part of a parameter's dotted name if that is unique (``Kp`` for ``pid.Kp``), otherwise the
shortest unique end of the name, with dots written as two underscores (``dynamics__sample_time``). The full name is
always accepted.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import inspect
import pkgutil
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol, TypeVar

import numpy as np

from hysteresis_ros.configuration import ParameterRow, Parameters
from hysteresis_ros.errors import HysteresisError, ParameterError, did_you_mean


class Named(Protocol):
    """Attributes of every declaration."""

    @property
    def name(self) -> str:
        """Name of the declaration in the registry."""
        ...


Declaration = TypeVar("Declaration", bound=Named)


def discover(package: str, attribute: str, kind: type[Declaration], group: str) -> dict[str, Declaration]:
    """Return the declarations of a package's modules and of a group's entry points, by name, in alphabetical order."""
    found: dict[str, Declaration] = {}
    for item in pkgutil.iter_modules(sys.modules[package].__path__):
        if not item.name.startswith("_"):
            module = importlib.import_module(f"{package}.{item.name}")
            declared = getattr(module, attribute, None)
            for one in declared if isinstance(declared, tuple) else (declared,):
                _add(found, one, kind, f"{module.__name__}.{attribute}")
    return added(found, kind, group)


def added(found: dict[str, Declaration], kind: type[Declaration], group: str) -> dict[str, Declaration]:
    """Return the found declarations and those of a group's entry points, by name, in alphabetical order."""
    found = dict(found)
    for entry in _entry_points(tuple(sys.path)).select(group=group):
        try:
            _add(found, entry.load(), kind, entry.value)
        except Exception as error:
            text = f"entry point {entry.name} = {entry.value} of {group} is left out: {type(error).__name__}: {error}"
            warnings.warn(text, RuntimeWarning, stacklevel=2)
    return dict(sorted(found.items()))


@functools.lru_cache(maxsize=1)
def _entry_points(path: tuple[str, ...]) -> Any:
    """Return all entry points installed along ``path``, read once for all registries."""
    return importlib.metadata.entry_points()


def _add(found: dict[str, Declaration], declared: object, kind: type[Declaration], source: str) -> None:
    if not isinstance(declared, kind):
        raise TypeError(f"{source} must be a {kind.__name__}, it is {declared!r}")
    if declared.name in found:
        raise TypeError(f"{source}: the name {declared.name!r} is taken")
    found[declared.name] = declared


def resolved(path: str) -> Any:
    """Import the module of a dotted path ``package.module:name`` and return the named object.

    With such a path a declaration can refer to an object in a package that the declaration's module must not import.
    """
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def later(path: str) -> Callable[..., Any]:
    """Return a function that imports and calls ``package.module:function`` when it is called."""

    def call(*given: Any) -> Any:
        return resolved(path)(*given)

    return call


#: Default sample time of a block [s].
SAMPLE_TIME = 1e-3
#: Keywords of the constructors that are not parameters.
RESERVED = ("self", "parameters", "sample_time", "model", "type")


class KeywordError(HysteresisError):
    """A keyword matches no parameter, or more than one."""


def class_name(name: str) -> str:
    """Return the name of the class for a name in a registry: ``bouc_wen`` → ``BoucWen``."""
    return "".join(word[:1].upper() + word[1:] for word in name.split("_"))


def keywords_of(rows: Iterable[ParameterRow], own: tuple[str, ...] = ()) -> dict[str, ParameterRow]:
    """Return the keyword of each parameter: the shortest unique end of its dotted name."""
    rows = list(rows)
    found = {}
    for row in rows:
        parts = row.name.split(".")
        if len(parts) == 2 and parts[0] in own and parts[1] not in RESERVED:
            found[parts[1]] = row
            continue
        for count in range(1, len(parts) + 1):
            end = parts[-count:]
            alone = sum(other.name.split(".")[-count:] == end for other in rows) == 1
            if (alone and "__".join(end) not in RESERVED) or count == len(parts):
                found["__".join(end)] = row
                break
    return found


def plain(value: Any) -> Any:
    """Return a value as parameters store it: arrays as flat tuples, NumPy numbers as Python numbers."""
    if isinstance(value, (str, bytes)):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (np.ndarray, list, tuple)):
        return tuple(np.asarray(value).ravel().tolist())
    return value


def from_keywords(
    owner: str,
    parameters: type[Parameters],
    fixed: Mapping[str, Any],
    keywords: Mapping[str, ParameterRow],
    values: Mapping[str, Any],
) -> Parameters:
    """Return checked parameters from keywords."""
    flat = dict(fixed)
    whole = {row.name.replace(".", "__"): row for row in keywords.values()}
    for keyword, value in values.items():
        row = keywords.get(keyword) or whole.get(keyword)
        if row is None:
            near = did_you_mean(keyword, keywords) or f"; there are {', '.join(keywords)}"
            raise KeywordError(f"{owner} has no parameter {keyword}{near}")
        flat[row.name] = plain(value)
    return parameters.from_mapping(flat)


def samples(name: str, values: Any) -> np.ndarray:
    """Return samples as writable float64, shape (N,), as the kernels require; masked samples are NaN, i.e. missing."""
    try:
        given = np.asanyarray(values)
        if np.iscomplexobj(given):
            raise TypeError
        array = np.require(np.ma.filled(given.astype(np.float64, copy=False), np.nan), requirements=["C", "W"])
    except (TypeError, ValueError):
        raise HysteresisError(f"{name}: must be an array of real numbers") from None
    if given.ndim != 1:
        raise HysteresisError(f"{name} has shape {given.shape}; it must be one-dimensional, one value a sample")
    return array


def missing(parameters: type[Parameters], fixed: Mapping[str, Any]) -> frozenset[str]:
    """Return the dotted names of the required parameters, without those of variants that are not chosen."""
    try:
        parameters.from_mapping(fixed)
    except ParameterError as error:
        return frozenset(problem.name for problem in error.problems if problem.value is None)
    return frozenset()


def described(rows: Mapping[str, ParameterRow], required: frozenset[str]) -> str:
    """Return the entries of a numpydoc section for parameters."""
    entries = []
    for keyword, row in rows.items():
        kind = _PYTHON_NAMES[row.type_name]
        default = ", optional" if row.required else f", default {row.default!r}"
        default = "" if row.name in required else default
        text = f"{row.description}. Allowed: {row.allowed()}."
        entries.append(f"{keyword} : {kind}{default}\n{textwrap.fill(text, 112, **_INDENT)}")
    return "\n".join(entries)


#: Python names of the parameter types.
_PYTHON_NAMES = {
    "double": "float",
    "integer": "int",
    "bool": "bool",
    "string": "str",
    "double array": "array_like",
    "string array": "sequence of str",
}
_INDENT: dict[str, Any] = {"initial_indent": "    ", "subsequent_indent": "    "}


def signature_of(
    rows: Mapping[str, ParameterRow], required: frozenset[str], *before: inspect.Parameter
) -> inspect.Signature:
    """Return the signature of a constructor with these keywords."""
    keywords = [
        inspect.Parameter(
            keyword,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if row.name in required else row.default,
            annotation=row.type,
        )
        for keyword, row in rows.items()
    ]
    positional = [item for item in before if item.kind is not inspect.Parameter.KEYWORD_ONLY]
    named = [item for item in before if item.kind is inspect.Parameter.KEYWORD_ONLY]
    return inspect.Signature([*positional, *keywords, *named])


def law_of(block: type) -> str:
    """Return the equations of a block for a class docstring, from the docstring of its module."""
    _, _, text = inspect.cleandoc(sys.modules[block.__module__].__doc__ or "").partition("\n\n")
    return f"\nNotes\n-----\n{text.strip()}\n" if text.strip() else ""


def block_class(
    name: str,
    bases: tuple[type, ...],
    parameters: type[Parameters],
    *,
    module: str,
    summary: str,
    fixed: Mapping[str, Any] | None = None,
    own: tuple[str, ...] = (),
    hidden: Callable[[str], bool] = lambda name: False,
    law: type | None = None,
) -> type:
    """Return a class whose constructor takes the parameters of a block as keywords."""
    decided = dict(fixed or {})
    rows = keywords_of((row for row in parameters.table() if row.name not in decided and not hidden(row.name)), own)
    required = missing(parameters, decided)

    def __init__(self: Any, parameters_: Any = None, *, sample_time: float = SAMPLE_TIME, **values: Any) -> None:
        if parameters_ is not None and values:
            raise KeywordError(f"{name} takes parameters or keywords, not both: leave out {', '.join(values)}")
        if parameters_ is None:
            parameters_ = from_keywords(name, parameters, decided, rows, values)
        super(made, self).__init__(parameters_, sample_time)

    given = inspect.Parameter("parameters", inspect.Parameter.POSITIONAL_OR_KEYWORD, default=None)
    period = inspect.Parameter("sample_time", inspect.Parameter.KEYWORD_ONLY, default=SAMPLE_TIME, annotation=float)
    own_self = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    vars(__init__)["__signature__"] = signature_of(rows, required, own_self, given, period)
    document = f"""{summary}

Parameters
----------
parameters : {parameters.__name__}, optional
    All parameters in one object, in place of the keywords.
{described(rows, required)}
sample_time : float, default {SAMPLE_TIME}
    Sample time [s].

Raises
------
ParameterError
    A parameter is missing, mistyped or out of range; the message states what is allowed.
KeywordError
    The parameter does not exist; the message names the nearest one.
{law_of(law) if law else ""}"""
    members = {"__init__": __init__, "__doc__": document, "__module__": module, "keywords": rows}
    made: Any = type(name, bases, members)
    return made


def find(classes: Mapping[str, type], name: str, module: str) -> type:
    """Return a class by its name, for a module's ``__getattr__``."""
    if name.startswith("_") or name not in classes:
        near = did_you_mean(name, classes)
        raise AttributeError(f"module {module!r} has no attribute {name!r}{near}")
    return classes[name]
