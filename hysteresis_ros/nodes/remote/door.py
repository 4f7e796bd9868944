# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Connection of commands to the session that ``hysteresis up`` keeps in the graph; imports no ROS.

Without the session a command needs up to several seconds for discovery; the session already knows the nodes. The kernel
releases the address of the session however the session ends, and identifies the user at the other end of a connection.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import struct
import sys
from contextlib import suppress

#: Prefixes of the environment variables that determine discovery and identity; their values select the session.
ENVIRONMENT = ("ROS_", "RMW_", "FASTDDS_", "FASTRTPS_", "CYCLONEDDS_")
#: Variables with these prefixes that do not affect discovery or identity.
OTHERS = ("ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION", "ROS_LOG_DIR", "ROS_HOME", "ROS_PACKAGE_PATH")


def address() -> bytes:
    """Return the abstract address of the session of this environment."""
    from hysteresis_ros.nodes.domain import stay_on_this_machine

    stay_on_this_machine()
    settings = {key: os.environ[key] for key in os.environ if key.startswith(ENVIRONMENT) and key not in OTHERS}
    settings.setdefault("ROS_DOMAIN_ID", "0")
    words = json.dumps([os.getuid(), sorted(settings.items())])
    return b"\0hysteresis_ros/session/" + hashlib.sha256(words.encode()).hexdigest().encode()


def is_of_this_user(connection: socket.socket) -> bool:
    """Return whether the process at the other end belongs to this user."""
    peer = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    return struct.unpack("3i", peer)[1] == os.getuid()


def ask_session(request: dict) -> int | None:
    """Execute a command in the session, print its output, and return the exit code; None if no session answers."""
    if not sys.platform.startswith("linux"):
        return None
    with socket.socket(socket.AF_UNIX) as connection:
        try:
            connection.connect(address())
        except OSError:
            return None
        if not is_of_this_user(connection):
            return None
        # if the session is killed, the connection is reset
        with suppress(ConnectionResetError), connection.makefile("rw", encoding="utf-8") as answers:
            print(json.dumps(request), file=answers, flush=True)
            for line in answers:
                stream, words = json.loads(line)
                if stream == "code":
                    return int(words)
                print(words, end="", file=sys.stderr if stream == "err" else sys.stdout, flush=True)
    print("hysteresis: the axis ended before it answered; see `hysteresis status`", file=sys.stderr)
    return 1
