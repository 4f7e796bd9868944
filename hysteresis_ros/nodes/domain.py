# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which nodes find each other: discovery on this machine, and ROS domains for graphs of their own; imports no ROS.

A graph that a command or a test starts must never meet an axis of the user: two graphs of one domain and namespace
hear each other's commands. It gets a domain above those that people choose (0 to 101), on this machine only, and
nodes that were not started for it are refused there as long as it runs.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
from collections.abc import Iterator

from hysteresis_ros.errors import HysteresisError

#: What says how far discovery reaches; the second one is the older, deprecated form.
RANGE, LOCALHOST_ONLY = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"

#: Machines that are found besides.
STATIC_PEERS = "ROS_STATIC_PEERS"


def stay_on_this_machine() -> None:
    """Let nobody of another machine find the nodes that are made from now on, if nothing was said about it.

    ROS 2 itself lets everybody of the network do so. Whoever finds an axis can move it.
    """
    if not (os.environ.get(RANGE) or os.environ.get(LOCALHOST_ONLY)):
        os.environ[RANGE] = "LOCALHOST"


def reaches_others() -> bool:
    """Tell whether nodes of other machines can be found."""
    if os.environ.get(LOCALHOST_ONLY) == "1":
        return False
    return os.environ.get(RANGE) not in ("LOCALHOST", "OFF") or bool(os.environ.get(STATIC_PEERS))


def named(endpoint) -> str:
    """Return the full name of the node of a publisher or subscription that was found."""
    if "UNKNOWN" in endpoint.node_name:  # the word of rmw: _NODE_NAME_UNKNOWN_
        return "somebody who has not told a name"
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def is_name(words: str) -> bool:
    """Tell whether what :func:`named` returned is the name of a node."""
    return words.startswith("/")


#: Domains whose ports lie above those that Linux hands out by itself, as far as that of a claim is one.
DOMAINS = range(231, 214, -1)

#: Environment variable that tells processes for which domain they were started.
OWN = "HYSTERESIS_DOMAIN"

#: Participants of a domain whose ports are looked at: all that it can have, for the first ones may have left.
_PARTICIPANTS = 120

#: Offset of the port that a claim binds: that of the last of 120 participants.
_CLAIM = 249


#: Where the next claim of this process begins to look.
_turns = itertools.count()


class Domain:
    """A ROS domain that nobody on this machine uses, promised to whoever made this until :meth:`close`.

    The promise is a bound port of the domain itself: the operating system gives it to one process of all users, and
    takes it back however that process ends. The caller's own domain (``ROS_DOMAIN_ID``) is never taken, even while it
    is empty. Use it in a ``with`` statement, or close it.
    """

    def __init__(self):
        own = os.environ.get("ROS_DOMAIN_ID", "0")
        # in turn: what is left of a graph that has just ended is not met by the next one
        first = (os.getpid() + next(_turns)) % len(DOMAINS)
        for number in (*DOMAINS[first:], *DOMAINS[:first]):
            claim = _bound(number, _CLAIM, "127.0.0.1") if str(number) != own.strip() else None
            if claim is not None:
                if _unused(number):
                    self.number, self._claim = number, claim
                    return
                claim.close()
        raise HysteresisError(f"all ROS domains from {DOMAINS[-1]} to {DOMAINS[0]} are in use; stop other graphs")

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables of the processes of the graph."""
        number = str(self.number)
        return {"ROS_DOMAIN_ID": number, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", OWN: number}

    def close(self) -> None:
        """Give the domain back."""
        self._claim.close()

    def __enter__(self) -> Domain:
        return self

    def __exit__(self, *error) -> None:
        self.close()


@contextlib.contextmanager
def entered() -> Iterator[Domain]:
    """Claim a domain and make it that of this process and the processes it starts, as long as the block runs."""
    with Domain() as domain:
        before = {name: os.environ.get(name) for name in domain.environment}
        os.environ.update(domain.environment)
        try:
            yield domain
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def require_admission(number: int) -> None:
    """Refuse that this process joins a graph that was made for itself by another one."""
    if number not in DOMAINS or os.environ.get(OWN) == str(number):
        return
    probe = _bound(number, _CLAIM, "127.0.0.1")
    if probe is None:
        raise HysteresisError(
            f"ROS domain {number} is that of a demonstration, a test or a benchmark that runs now: choose a "
            "ROS_DOMAIN_ID from 0 to 101"
        )
    probe.close()


def _bound(domain: int, offset: int, address: str = "") -> socket.socket | None:
    """Return a socket bound to a port of a domain, None when somebody has it."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.bind((address, 7400 + 250 * domain + offset))
    except OSError:
        made.close()
        return None
    return made


def _unused(domain: int) -> bool:
    """Tell whether the ports of discovery are free: of the multicast, and of the first participants (RTPS 9.6.1)."""
    for offset in (0, *(10 + 2 * participant for participant in range(_PARTICIPANTS))):
        probe = _bound(domain, offset)
        if probe is None:
            return False
        probe.close()
    return True
