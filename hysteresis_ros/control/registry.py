# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The controllers there are: those of the folder ``laws`` and those that other packages add by an entry point."""

from __future__ import annotations

from collections.abc import Callable

import hysteresis_ros.control.laws  # noqa: F401  (its folder is searched)
from hysteresis_ros.control.law import ControllerLaw
from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.parameters import Parameters, group
from hysteresis_ros.registry import discover

#: Group of entry points by which a package adds a controller: ``lead_lag = my_package.lead_lag:CONTROLLER``.
GROUP = "hysteresis_ros.controllers"

#: What each controller declares, by type.
LAWS: dict[str, ControllerLaw] = discover("hysteresis_ros.control.laws", "CONTROLLER", ControllerLaw, GROUP)


def _designs() -> dict[str, tuple[ControllerLaw, Callable]]:
    """Return law and design of each name; two laws with a design of one name are a mistake, a TypeError."""
    found: dict[str, tuple[ControllerLaw, Callable]] = {}
    for law in LAWS.values():
        for name, function in law.designs.items():
            if name in found:
                raise TypeError(f"controllers {found[name][0].name} and {law.name} both have a design {name!r}")
            found[name] = law, function
    return found


#: Law and design of each name that ``hysteresis design --controller`` takes.
DESIGNS = _designs()


def with_groups(cls):
    """Nest the parameter groups of all laws; stands under ``@dataclass(frozen=True)``.

    Those named as laws come first, then what laws share.

    Raises
    ------
    TypeError
        Two laws mean different parameters by one group.
    """
    found: dict[str, tuple[type[Parameters], list[str]]] = {}
    for law in LAWS.values():
        for name, kind in law.groups.items():
            known, users = found.setdefault(name, (kind, []))
            if known is not kind:
                raise TypeError(f"controllers {users[0]} and {law.name} both have a group {name}, of other parameters")
            users.append(law.name)
    for name in sorted(found, key=lambda name: (name not in LAWS, name)):
        kind, users = found[name]
        cls.__annotations__[name] = kind
        setattr(cls, name, group(kind, variant_of="type" if users == [name] else None))
    return cls


def design_of(name: str):
    """Return law and design of a name that ``hysteresis design --controller`` takes.

    Raises
    ------
    ConfigurationError
        There is none of that name; the message lists what there is.
    """
    if name not in DESIGNS:
        there = ", ".join(sorted(DESIGNS))
        raise ConfigurationError(f"no controller '{name}' to design; there are: {there}{did_you_mean(name, DESIGNS)}")
    return DESIGNS[name]
