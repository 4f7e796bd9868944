# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Starts the process of an EPICS server, and its axes unless they already run; imports no ROS itself."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.epics.record import MotorSettings
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.nodes.launcher import Graph, die_with_parent, node_environment, require_messages, require_ros

#: Time that the server gets to exit before it is killed [s].
PATIENCE = 5.0
#: Polling interval of a server if another process runs the axes [s].
LOOK = 0.1
LOOPBACK = "127.0.0.1"


def require_caproto() -> None:
    """Raise HysteresisError when caproto is not installed; does not import it."""
    if importlib.util.find_spec("caproto") is None:
        raise HysteresisError('caproto is not installed: pip install "hysteresis_ros[epics]"')


def interfaces(given: str | None) -> list[str]:
    """Return the addresses to listen on: the given ones, else those in ``EPICS_CAS_INTF_ADDR_LIST``, else loopback."""
    text = given or os.environ.get("EPICS_CAS_INTF_ADDR_LIST", "")
    return text.replace(",", " ").split() or [LOOPBACK]


def server_environment(addresses: Sequence[str], port: int | None) -> dict[str, str]:
    """Return the environment of the server; a server on the loopback address does not announce itself elsewhere."""
    environment = node_environment()
    if list(addresses) == [LOOPBACK]:
        environment.setdefault("EPICS_CAS_AUTO_BEACON_ADDR_LIST", "NO")
    if port is not None:
        environment["EPICS_CA_SERVER_PORT"] = environment["EPICS_CAS_SERVER_PORT"] = str(port)
    return environment


def serve(
    motors: Sequence[MotorSettings],
    axes: Sequence[AxisParameters],
    addresses: Sequence[str],
    port: int | None,
    leave: Callable[[], bool],
    stage: StageParameters | None = None,
) -> int:
    """Serve motor records until a request to exit or the end of the server; return its exit code.

    The ``axes`` are started before the server; the axes of a ``stage`` are started together.
    """
    require_ros()
    require_caproto()
    if stage is not None:
        require_messages(stage)
    # an axis is served only when it can move
    served = {"motors": [asdict(motor) for motor in motors], "interfaces": list(addresses), "wait": bool(axes)}
    request = json.dumps(served)
    with contextlib.ExitStack() as stack:
        graph = stack.enter_context(Graph(list(axes), log_level="warn", stage=stage)) if axes else None
        # a separate process, because the pip wheels of ROS restart the interpreter on import
        server = subprocess.Popen(
            [sys.executable, "-m", "hysteresis_ros.laboratory.epics.server", request],
            env=server_environment(addresses, port),
            start_new_session=True,
            preexec_fn=partial(die_with_parent, os.getpid()),
        )
        stack.callback(_end, server)

        def over() -> bool:
            return leave() or server.poll() is not None

        if graph is not None:
            graph.wait(over)
        while graph is None and not over():
            with contextlib.suppress(subprocess.TimeoutExpired):
                server.wait(LOOK)
        return server.poll() or 0


def _end(server: subprocess.Popen) -> None:
    """End the server; it needs no cleanup."""
    if server.poll() is None:
        server.terminate()
        try:
            server.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
