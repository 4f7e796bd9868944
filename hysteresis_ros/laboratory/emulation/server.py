# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The link of an emulated device over TCP or a serial port: connections of clients, and faults."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import socketserver
import threading
import time
import tty
from collections.abc import Callable, Iterator
from typing import Protocol

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.emulation.bench import DeviceFaults, Garbler

#: Interval at which the plant of an idle device is advanced, and its link is checked [s].
TICK = 0.02
#: Time to wait until the connection of a disconnected client is free again [s].
HANGING_UP = 0.3


class Session(Protocol):
    """The session of a device with one client."""

    def feed(self, data: bytes) -> bytes:
        """Return the answers to received bytes."""
        ...


class DeviceServer(socketserver.ThreadingTCPServer):
    """The link of an emulated device."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(
        self,
        address: tuple[str, int],
        session: Callable[[], Session],
        tick: Callable[[], None],
        faults: DeviceFaults,
        masters: int = 1,
    ):
        super().__init__(address, _Connection)
        self.session, self.faults = session, faults
        self._tick, self.free = tick, threading.Semaphore(masters)
        self.lock, self.gone = threading.Lock(), threading.Event()

    @property
    def port(self) -> int:
        """Port to connect to."""
        return self.server_address[1]

    def service_actions(self) -> None:
        """Advance the time of the device, also while it is idle."""
        with self.lock:
            self._tick()

    def verify_request(self, request, client_address) -> bool:
        """Return whether a client may connect: the link is up, and a connection is free."""
        return "cut" not in self.faults and self.free.acquire(timeout=HANGING_UP)


class _Connection(socketserver.BaseRequestHandler):
    """Answers one client until it disconnects or the link is cut."""

    server: DeviceServer

    def handle(self) -> None:
        """Answer the client."""
        self.request.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        session, self._garbler = self.server.session(), Garbler(self.server.faults)
        try:
            with contextlib.suppress(OSError):
                while not self.server.gone.is_set() and "cut" not in self.server.faults:
                    if select.select([self.request], [], [], TICK)[0] and not self._answer(session):
                        return
        finally:
            self.server.free.release()

    def _answer(self, session: Session) -> bool:
        data = self.request.recv(65536)
        if not data:
            return False
        with self.server.lock:
            answer = session.feed(data)
        late = self.server.faults.value("slow")
        if late is not None and answer:
            time.sleep(late)
        if answer and "silent" not in self.server.faults:
            self.request.sendall(self._garbler.garble(answer))
        return not self._garbler.closed


@contextlib.contextmanager
def serving(
    address: tuple[str, int],
    session: Callable[[], Session],
    tick: Callable[[], None],
    faults: DeviceFaults,
    masters: int = 1,
) -> Iterator[DeviceServer]:
    """Serve an emulated device in a separate thread while the context lasts."""
    try:
        server = DeviceServer(address, session, tick, faults, masters)
    except (OSError, OverflowError) as error:
        where = f"{address[0]}:{address[1]}"
        raise ConfigurationError(f"{where}: cannot listen on it ({error}); choose another port or host") from None
    with server:
        thread = threading.Thread(target=server.serve_forever, args=(TICK,), daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.gone.set()
            server.shutdown()
            thread.join()


@contextlib.contextmanager
def serving_serial(session: Session, tick: Callable[[], None], faults: DeviceFaults) -> Iterator[str]:
    """Serve an emulated device at a serial port, in a thread, while the context lasts; yield the port's path."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    leaving, garbler = threading.Event(), Garbler(faults)

    def serve() -> None:
        while not leaving.is_set():
            tick()
            if not select.select([ours], [], [], TICK)[0]:
                continue
            data = os.read(ours, 65536)
            if "cut" in faults:
                continue
            answer, late = session.feed(data), faults.value("slow")
            if late is not None and answer:
                time.sleep(late)
            if answer and "silent" not in faults:
                os.write(ours, garbler.garble(answer))  # a serial port has no link to close

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        leaving.set()
        thread.join()
        os.close(ours)
        os.close(theirs)
