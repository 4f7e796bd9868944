# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``python -m hysteresis_ros.nodes.remote.session``: executes the user's commands while an axis runs.

The session keeps a participant in the graph, so that a command needs no discovery. It sleeps between commands.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import select
import signal
import socket
import sys
import threading
import time

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

import hysteresis_ros.loop.parameters  # noqa: F401  imported at the start, not at the first use by a command
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.remote.__main__ import done
from hysteresis_ros.nodes.remote.client import Client
from hysteresis_ros.nodes.remote.door import address, is_of_this_user

#: Interval between attempts to take over the address of another session [s].
AGAIN = 1.0
#: Time in which all nodes are discovered [s]; a session that has run for longer does not wait for further nodes.
INTRODUCED = 5.0


class _Printed:
    """Replacement of a standard stream: each thread prints to the command that it serves."""

    def __init__(self, name: str, usual):
        self._name, self._usual = name, usual
        self.served = threading.local()

    def write(self, words: str) -> int:
        """Send text to the command of this thread."""
        connection = getattr(self.served, "connection", None)
        if connection is None:
            return self._usual.write(words)
        connection.sendall(json.dumps([self._name, words]).encode() + b"\n")
        return len(words)

    def flush(self) -> None:
        """Do nothing: output is not buffered."""


class Session:
    """Serves commands, one thread each."""

    def __init__(self, context: Context):
        self._context, self._begun, self._numbers = context, time.monotonic(), itertools.count()
        self._streams = (_Printed("out", sys.stdout), _Printed("err", sys.stderr))

    def serve(self) -> None:
        """Take the address as soon as it is free, then serve forever."""
        sys.stdout, sys.stderr = self._streams
        with socket.socket(socket.AF_UNIX) as door:
            while True:
                with contextlib.suppress(OSError):
                    door.bind(address())
                    break
                time.sleep(AGAIN)
            door.listen(8)
            while True:
                connection, _ = door.accept()
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError, ValueError):
            if not is_of_this_user(connection):
                return
            with connection.makefile("r", encoding="utf-8") as asked:
                request = json.loads(asked.readline())
            for stream in self._streams:
                stream.served.connection = connection
            code = done(request, lambda namespace, timeout: self._client(namespace, timeout, connection))
            connection.sendall(json.dumps(["code", code]).encode() + b"\n")

    def _client(self, namespace: str, timeout: float, connection: socket.socket) -> Client:
        """Return a client that stops when the command that it serves exits."""

        class Served(Client):
            def hear(self) -> None:
                # the command sends nothing more, so the connection becomes readable only when the command exits
                if select.select([connection], [], [], 0.0)[0]:
                    raise BrokenPipeError
                super().hear()

        client = Served(
            namespace,
            timeout,
            self._context,
            lambda: SingleThreadedExecutor(context=self._context),
            name=f"{os.getpid()}_{next(self._numbers)}",
        )
        if time.monotonic() - self._begun > INTRODUCED:
            client.settles = 0.0
        return client


def main() -> None:
    """Serve until the parent process ends this process."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    stay_on_this_machine()
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    # keeps the DDS participant
    _node = rclpy.create_node(
        "_hysteresis_session", context=context, start_parameter_services=False, enable_rosout=False
    )
    Session(context).serve()


if __name__ == "__main__":
    main()
