# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Registries: what a folder of the package offers, found by itself, and what other packages add to it.

Every module (or folder) in such a folder declares one thing under one name, for instance ``MODEL``. A file put there is
found; nothing else has to be told. Packages of others add theirs by an entry point of the registry's group.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import pkgutil
import sys
import warnings
from collections.abc import Callable
from typing import Any, Protocol, TypeVar


class Named(Protocol):
    """What every declaration has."""

    @property
    def name(self) -> str:
        """Name by which it is found."""
        ...


Declaration = TypeVar("Declaration", bound=Named)


def discover(package: str, attribute: str, kind: type[Declaration], group: str) -> dict[str, Declaration]:
    """Return what the modules of a package and the entry points of a group declare, by name, in alphabetical order.

    Parameters
    ----------
    package : str
        Dotted name of the package whose modules declare; it has begun to be imported. Modules whose names begin with
        an underscore are passed over.
    attribute : str
        Name under which each module has its declaration.
    kind : type
        Class of the declarations; each has a ``name``.
    group : str
        Group of entry points, each naming a declaration: ``dahl = my_package.dahl:MODEL``. One that cannot be loaded,
        declares something else or has a name that is taken is left out with a warning.

    Raises
    ------
    TypeError
        A module of the package has no such declaration, or two have the same name.
    """
    found: dict[str, Declaration] = {}
    for item in pkgutil.iter_modules(sys.modules[package].__path__):
        if not item.name.startswith("_"):
            module = importlib.import_module(f"{package}.{item.name}")
            _add(found, getattr(module, attribute, None), kind, f"{module.__name__}.{attribute}")
    return added(found, kind, group)


def added(found: dict[str, Declaration], kind: type[Declaration], group: str) -> dict[str, Declaration]:
    """Return what is found and what the entry points of a group declare, by name, in alphabetical order.

    Parameters
    ----------
    found : dict
        What the package itself declares, by name.
    kind, group
        As for :func:`discover`, which also says what is left out.
    """
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
    """Return the entry points of all that is installed along ``path``, which is read once for all registries."""
    return importlib.metadata.entry_points()


def _add(found: dict[str, Declaration], declared: object, kind: type[Declaration], source: str) -> None:
    if not isinstance(declared, kind):
        raise TypeError(f"{source} must be a {kind.__name__}, it is {declared!r}")
    if declared.name in found:
        raise TypeError(f"{source}: the name {declared.name!r} is taken")
    found[declared.name] = declared


def resolved(path: str) -> Any:
    """Return what a dotted path ``package.module:name`` names, importing its module.

    So a declaration names something of a folder that it may not import.
    """
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def later(path: str) -> Callable[..., Any]:
    """Return a function that calls the one of a dotted path ``package.module:function``, imported only then."""

    def call(*given: Any) -> Any:
        return resolved(path)(*given)

    return call
