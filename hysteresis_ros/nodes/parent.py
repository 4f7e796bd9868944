# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Nodes leave with who has started them, however that ends; imports no ROS."""

from __future__ import annotations

import contextlib
import ctypes
import os
import pathlib
import signal

_PR_SET_PDEATHSIG = 1

#: What starts nodes for somebody: at SIGTERM and SIGKILL it leaves them behind.
STARTERS = ("launch", "run")


def die_with_parent(parent: int) -> None:
    """Linux: a child does not outlive the process that started it; in the child, or for its ``preexec_fn``.

    Parameters
    ----------
    parent : int
        Process identifier of the one who starts it.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(1)


def starts_nodes(command: list[str]) -> bool:
    """Tell whether a command line is that of ``ros2 launch`` or ``ros2 run``.

    Parameters
    ----------
    command : list of str
        Program and arguments; an interpreter may come first.
    """
    words = [pathlib.PurePath(word).name for word in command[:3]]
    return "ros2" in words[:2] and any(word in STARTERS for word in words[1:])


def leave_with_ros2() -> None:
    """Let this process be told to leave when the ``ros2 launch`` or ``ros2 run`` that started it is gone.

    Both pass on Ctrl-C only: ended by SIGTERM, as by a service manager, they leave their nodes behind, and an axis at
    work. Another parent may end as it likes, as a shell that has put a node into the background.
    """
    parent = os.getppid()
    with contextlib.suppress(OSError):
        text = pathlib.Path(f"/proc/{parent}/cmdline").read_bytes().decode(errors="replace")
        if starts_nodes(text.split("\0")):
            die_with_parent(parent)
