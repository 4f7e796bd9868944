# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Policies of SROS 2 as ``ros2 security`` reads them (version 0.2.0); imports no ROS.

An enclave is what one key opens: a process. Its profiles are those of the nodes in it, with the names of all that they
publish, subscribe, serve and ask for, written out whole; whatever is not named is denied.
"""

from __future__ import annotations

import fnmatch
import xml.etree.ElementTree as xml
from collections.abc import Iterable
from dataclasses import dataclass, fields

VERSION = "0.2.0"

#: Enclaves of who steers an axis, who watches one, who serves its page, and who serves motor records.
OPERATOR, MONITOR, PAGE, RECORDS = "operator", "monitor", "watch", "epics_ioc"

#: Names of the topics and services that an action consists of have this in them.
ACTION = "/_action/"

#: What the parts of a profile are in the language of a policy: kind of name, and what is allowed.
WORDS = {
    "publishes": ("topic", "publish"),
    "hears": ("topic", "subscribe"),
    "serves": ("service", "reply"),
    "asks": ("service", "request"),
    "executes": ("action", "execute"),
    "calls": ("action", "call"),
}

#: Every node's own affairs: what people do not steer an axis by.
INTERNAL = ("/rosout", "/parameter_events", "*/get_type_description")


def enclave_of(namespace: str, name: str) -> str:
    """Return the enclave whose key a process has; without security it is a name and no more."""
    return f"{namespace}/{name}"


@dataclass(frozen=True)
class Profile:
    """What one node uses, as sorted full names."""

    namespace: str  #: namespace, node: Where it is, ``/`` for the root, and its name.
    node: str
    publishes: tuple[str, ...] = ()  #: publishes, hears: Topics.
    hears: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()  #: serves, asks: Services.
    asks: tuple[str, ...] = ()
    executes: tuple[str, ...] = ()  #: executes, calls: Actions.
    calls: tuple[str, ...] = ()


@dataclass(frozen=True)
class Enclave:
    """What one process is allowed."""

    path: str  #: Name of the enclave, a path that begins with a slash.
    profiles: tuple[Profile, ...]  #: Of the nodes in it.


def profile(
    namespace: str, node: str, topics: tuple[Iterable, Iterable], services: tuple[Iterable, Iterable]
) -> Profile:
    """Return the profile of a node whose actions are still the topics and services they consist of."""
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


def operator(namespace: str, nodes: tuple[Profile, ...], own: Profile) -> Profile:
    """Return what whoever steers an axis may: say what its nodes hear from outside, hear all, ask for all services.

    What one node of the axis says to another, such as ``command`` and ``voltage``, is no part of it.
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
    """Return what whoever only watches an axis may: hear what its nodes say."""
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
