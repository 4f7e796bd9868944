# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The server process of a page; its argument is the JSON of :mod:`hysteresis_ros.laboratory.watch.server_process`."""

from __future__ import annotations

import asyncio
import contextlib
import json
import pathlib
import signal
import sys
import threading
from collections.abc import Callable

import rclpy
from rclpy.signals import SignalHandlerOptions

from hysteresis_ros.laboratory.watch.access import Access, new_token
from hysteresis_ros.laboratory.watch.link import AxisLink
from hysteresis_ros.laboratory.watch.server import Server
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.security.policy import PAGE, enclave_of

#: Time that open pages get to close at the end [s], and interval at which other events are checked [s].
PATIENCE, LOOK = 1.0, 0.2


def main() -> int:
    """Serve the page that the only argument describes until a signal arrives; return the exit code."""
    request = json.loads(sys.argv[1])
    stay_on_this_machine()
    namespace, bind = request["namespace"], request["bind"]
    enclave = ["--ros-args", "--enclave", enclave_of(namespace, PAGE)]
    over = threading.Event()
    try:
        rclpy.init(args=enclave, signal_handler_options=SignalHandlerOptions.NO)
        link = AxisLink(namespace, pathlib.Path(request["folder"]))
    except Exception as error:  # rclpy raises a different exception for each error in a name
        words = str(error).split(", at /")[0]
        print(f"hysteresis: --namespace {namespace}: {' '.join(words.split())}", file=sys.stderr)
        return 2
    hearing = threading.Thread(target=link.run, args=(over,), daemon=True)
    hearing.start()
    server = Server(link, Access(bind, new_token(bind)))
    try:
        asyncio.run(_serve(server, bind, request["port"], hearing.is_alive))
        if not hearing.is_alive():
            return 1  # the reason was printed
    except OSError as error:
        print(f"hysteresis: {bind}:{request['port']}: cannot listen on it: {error.strerror}", file=sys.stderr)
        return 2
    finally:
        over.set()
        hearing.join()
        rclpy.shutdown()
    return 0


async def _serve(server: Server, bind: str, port: int, is_heard: Callable[[], bool]) -> None:
    """Serve until a signal arrives, or the link to the axis ends."""
    leave = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, leave.set)
    async with server.listening(bind, port, PATIENCE) as port:
        host = f"[{bind}]" if ":" in bind else bind
        token = f"?token={server.access.token}" if server.access.token else ""
        print(f"watch {server.link.namespace or '/'}: http://{host}:{port}/{token}", flush=True)
        while not leave.is_set() and is_heard():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(leave.wait(), LOOK)


if __name__ == "__main__":
    raise SystemExit(main())
