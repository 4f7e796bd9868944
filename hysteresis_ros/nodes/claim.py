# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One axis, one master: a node of an axis runs once in a ROS domain of this machine; imports no ROS.

A second graph of the same names would drive the same voltage. Discovery tells of it too late, after both have moved;
the kernel tells at once, and forgets a process however it ends.
"""

from __future__ import annotations

import hashlib
import pathlib
import socket
import struct
import sys
import time

from hysteresis_ros.errors import HysteresisError

#: Seconds that who is about to leave gets for it.
PATIENCE = 5.0
#: How often is looked whether it has left [s].
LOOK = 0.1


def _address(domain: int, name: str) -> bytes:
    return b"\0hysteresis_ros/" + hashlib.sha256(f"{domain}{name}".encode()).hexdigest().encode()


def holder(domain: int, name: str) -> str:
    """Say which process has claimed a node, by its number and command line; '' when nobody has.

    Parameters
    ----------
    domain : int
        ROS domain.
    name : str
        Full name of the node.
    """
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(_address(domain, name))
        except BlockingIOError:
            return "a process of this machine"
        except OSError:
            return ""
        peer = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    process = struct.unpack("3i", peer)[0]
    try:
        words = pathlib.Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        words = []
    return f"process {process} ({' '.join(words).strip()[:120]})" if any(words) else f"process {process}"


def claim(domain: int, name: str, patience: float = PATIENCE) -> socket.socket | None:
    """Claim a node of a domain on this machine, until what is returned is closed or the process ends.

    Parameters
    ----------
    domain : int
        ROS domain.
    name : str
        Full name of the node.
    patience : float, optional
        How long is waited for a process that has it already, which may be about to leave [s].

    Returns
    -------
    socket or None
        None where there are no such claims: not on Linux.

    Raises
    ------
    HysteresisError
        Somebody else has it: says who, and what to do.
    """
    if not sys.platform.startswith("linux"):
        return None
    until = time.monotonic() + patience
    while True:
        made = socket.socket(socket.AF_UNIX)
        try:
            made.bind(_address(domain, name))
            made.listen(8)
            return made
        except OSError:
            made.close()
        if time.monotonic() > until:
            break
        time.sleep(LOOK)
    who = holder(domain, name) or "a process of this machine"
    raise HysteresisError(
        f"{name} runs already in ROS domain {domain}: {who}; one axis has one master: stop that one, or give this axis "
        "another namespace or ROS_DOMAIN_ID"
    )
