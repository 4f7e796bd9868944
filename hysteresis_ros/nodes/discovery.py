# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Who may find the nodes: this machine only, unless the environment says otherwise; and who was found. No ROS here."""

from __future__ import annotations

import os

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
    """Return the full name of the node of a publisher or subscription that was found.

    Parameters
    ----------
    endpoint : TopicEndpointInfo
        Its node is not known before discovery has told of it, and never where it is no node of ROS.
    """
    if "UNKNOWN" in endpoint.node_name:  # the word of rmw: _NODE_NAME_UNKNOWN_
        return "somebody who has not told a name"
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def is_name(words: str) -> bool:
    """Tell whether what :func:`named` returned is the name of a node."""
    return words.startswith("/")
