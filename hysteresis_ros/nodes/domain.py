# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Discovery range of the nodes of this machine, and isolated ROS domains for graphs; this module imports no ROS.

A graph that a command or a test starts must never exchange messages with an axis of the user, because two graphs in the
same domain and namespace receive each other's commands. So it runs in a domain of its own, above the domains that users
choose (0 to 101). The graph cannot be discovered from other machines. While the graph runs, its domain refuses nodes
that were not started for it.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
from collections.abc import Iterator

from hysteresis_ros.errors import HysteresisError

#: Environment variable of the discovery range.
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
#: Deprecated environment variable of the discovery range.
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"

#: Environment variable with the addresses of further machines to discover.
STATIC_PEERS = "ROS_STATIC_PEERS"


def stay_on_this_machine() -> None:
    """Limit the discovery of new nodes to this machine, unless the environment configures it.

    By default ROS 2 allows discovery from the whole network, and every node that finds an axis can move it.
    """
    if not (os.environ.get(RANGE) or os.environ.get(LOCALHOST_ONLY)):
        os.environ[RANGE] = "LOCALHOST"


def reaches_others() -> bool:
    """Return whether nodes of other machines can be discovered."""
    if os.environ.get(LOCALHOST_ONLY) == "1":
        return False
    return os.environ.get(RANGE) not in ("LOCALHOST", "OFF") or bool(os.environ.get(STATIC_PEERS))


def named(endpoint) -> str:
    """Return the full name of the node that owns a discovered publisher or subscription."""
    if "UNKNOWN" in endpoint.node_name:  # placeholder of rmw: _NODE_NAME_UNKNOWN_
        return "a node without a known name"
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def is_name(words: str) -> bool:
    """Return whether a result of :func:`named` is the name of a node."""
    return words.startswith("/")


#: Domains whose ports are above the ephemeral ports of Linux; the port of a claim is still a valid port number.
DOMAINS = range(231, 214, -1)

#: Environment variable with the number of the isolated domain for which a process was started.
OWN = "HYSTERESIS_DOMAIN"

#: Number of participants whose ports are checked: all possible ones, because the first ones may have left.
_PARTICIPANTS = 120

#: Port offset of a claim, which is the offset of the last of 120 participants.
_CLAIM = 249


#: Counter of the claims of this process; it selects the domain that the next claim tries first.
_turns = itertools.count()


class Domain:
    """A ROS domain that no other process on this machine uses, reserved until :meth:`close`.

    The claim is a bound port of the domain. The operating system gives the port to one process at a time, of any user,
    and releases it however that process ends. The caller's own domain (``ROS_DOMAIN_ID``) is never claimed, even if no
    node uses it. Use the object in a ``with`` statement, or close it.
    """

    def __init__(self):
        own = os.environ.get("ROS_DOMAIN_ID", "0")
        # domains are used in turn, because nodes of a graph that has just ended may still be discovered in its domain
        first = (os.getpid() + next(_turns)) % len(DOMAINS)
        for number in (*DOMAINS[first:], *DOMAINS[:first]):
            claim = _bound(number, _CLAIM, "127.0.0.1") if str(number) != own.strip() else None
            if claim is not None:
                if _unused(number):
                    self.number, self._claim = number, claim
                    return
                claim.close()
        raise HysteresisError(f"all ROS domains from {DOMAINS[-1]} to {DOMAINS[0]} are in use: stop other graphs")

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables of the processes of the graph."""
        number = str(self.number)
        return {"ROS_DOMAIN_ID": number, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", OWN: number}

    def close(self) -> None:
        """Release the domain."""
        self._claim.close()

    def __enter__(self) -> Domain:
        return self

    def __exit__(self, *error) -> None:
        self.close()


@contextlib.contextmanager
def entered() -> Iterator[Domain]:
    """Claim a domain for this process and the processes that it starts, while the block runs."""
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
    """Refuse to join an isolated graph of another process."""
    if number not in DOMAINS or os.environ.get(OWN) == str(number):
        return
    probe = _bound(number, _CLAIM, "127.0.0.1")
    if probe is None:
        raise HysteresisError(
            f"ROS domain {number} is in use by a demonstration, a test or a benchmark: choose a ROS_DOMAIN_ID"
            " from 0 to 101"
        )
    probe.close()


def _bound(domain: int, offset: int, address: str = "") -> socket.socket | None:
    """Return a socket that is bound to the domain's port with this offset; None if the port is in use."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.bind((address, 7400 + 250 * domain + offset))
    except OSError:
        made.close()
        return None
    return made


def _unused(domain: int) -> bool:
    """Return whether the domain's discovery ports are free: for multicast and for each participant (RTPS 9.6.1)."""
    for offset in (0, *(10 + 2 * participant for participant in range(_PARTICIPANTS))):
        probe = _bound(domain, offset)
        if probe is None:
            return False
        probe.close()
    return True
