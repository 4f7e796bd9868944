# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Policies of SROS 2 as ``ros2 security`` reads them (version 0.2.0); imports no ROS.

An enclave is the security identity of one process. Its profiles list the full names of all topics, services and actions
of the nodes in it; everything that is not listed is denied.
"""

from __future__ import annotations

import fnmatch
import xml.etree.ElementTree as xml
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

VERSION = "0.2.0"

#: Enclaves of an operator, a monitor, the page server, and the server of motor records.
OPERATOR, MONITOR, PAGE, RECORDS = "operator", "monitor", "watch", "epics_ioc"

#: Part that the names of an action's topics and services contain.
ACTION = "/_action/"

#: Elements of a policy file for each field of a profile: kind of name, and permission.
WORDS = {
    "publishes": ("topic", "publish"),
    "hears": ("topic", "subscribe"),
    "serves": ("service", "reply"),
    "asks": ("service", "request"),
    "executes": ("action", "execute"),
    "calls": ("action", "call"),
}

#: Interfaces of every node that are not needed to operate an axis.
INTERNAL = ("/rosout", "/parameter_events", "*/get_type_description")


def enclave_of(namespace: str, name: str) -> str:
    """Return the name of the enclave of a process; it has no effect without security."""
    return f"{namespace}/{name}"


@dataclass(frozen=True)
class Profile:
    """Interfaces of one node, as sorted full names."""

    namespace: str  #: namespace, node: Namespace (``/`` for the root) and name.
    node: str
    publishes: tuple[str, ...] = ()  #: publishes, hears: Topics.
    hears: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()  #: serves, asks: Services.
    asks: tuple[str, ...] = ()
    executes: tuple[str, ...] = ()  #: executes, calls: Actions.
    calls: tuple[str, ...] = ()


@dataclass(frozen=True)
class Enclave:
    """Permissions of one process."""

    path: str  #: Name of the enclave, a path that begins with a slash.
    profiles: tuple[Profile, ...]  #: Profiles of its nodes.


def profile(
    namespace: str, node: str, topics: tuple[Iterable, Iterable], services: tuple[Iterable, Iterable]
) -> Profile:
    """Return the profile of a node, in which the topics and services of an action are combined into the action."""
    (publishes, hears), (serves, asks) = topics, services

    def actions(names) -> tuple[str, ...]:
        return tuple(sorted({name.partition(ACTION)[0] for name in names if ACTION in name}))

    def plain(names) -> tuple[str, ...]:
        return tuple(sorted({name for name in names if ACTION not in name}))

    return Profile(
        namespace or "/",
        node,
        plain(publishes),
        plain(hears),
        plain(serves),
        plain(asks),
        actions(serves),
        actions(asks),
    )


def _all(profiles: Iterable[Profile], part: str) -> set[str]:
    return {name for one in profiles for name in getattr(one, part)}


def _steers(name: str) -> bool:
    return not any(fnmatch.fnmatch(name, pattern) for pattern in INTERNAL)


def without(one: Profile, names: set[str]) -> Profile:
    """Return a profile without these topics and actions."""
    hears, executes = (tuple(name for name in part if name not in names) for part in (one.hears, one.executes))
    return replace(one, hears=hears, executes=executes)


def operator(namespace: str, nodes: tuple[Profile, ...], own: Profile) -> Profile:
    """Return the permissions of an operator: publish external inputs, subscribe to all topics, call all services.

    An operator may not publish topics between the nodes of the axis, such as ``command`` and ``voltage``.
    """
    said = _all(nodes, "publishes")
    return Profile(
        namespace or "/",
        OPERATOR,
        tuple(sorted({*own.publishes, *(_all(nodes, "hears") - said)})),
        tuple(sorted({*own.hears, *said})),
        own.serves,
        tuple(sorted({*own.asks, *filter(_steers, _all(nodes, "serves"))})),
        own.executes,
        tuple(sorted({*own.calls, *_all(nodes, "executes")})),
    )


def monitor(namespace: str, nodes: tuple[Profile, ...], own: Profile) -> Profile:
    """Return the permissions of a monitor: subscribe to the topics of the nodes."""
    hears = tuple(sorted({*own.hears, *_all(nodes, "publishes")}))
    return Profile(namespace or "/", MONITOR, own.publishes, hears, own.serves)


def policy_text(enclaves: Iterable[Enclave]) -> str:
    """Return the text of a policy file."""
    policy = xml.Element("policy", version=VERSION)
    places = xml.SubElement(policy, "enclaves")
    for enclave in enclaves:
        profiles = xml.SubElement(xml.SubElement(places, "enclave", path=enclave.path), "profiles")
        for one in enclave.profiles:
            place = xml.SubElement(profiles, "profile", ns=one.namespace, node=one.node)
            for item in fields(one):
                names = getattr(one, item.name) if item.name in WORDS else ()
                if names:
                    kind, right = WORDS[item.name]
                    rules = xml.SubElement(place, f"{kind}s", {right: "ALLOW"})
                    for name in names:
                        xml.SubElement(rules, kind).text = name
    xml.indent(policy)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + xml.tostring(policy, encoding="unicode") + "\n"
