# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Starts one server process per axis; imports no ROS itself."""

from __future__ import annotations

import importlib.util
import json
import os
import pathlib
import socket
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.watch.access import is_loopback
from hysteresis_ros.nodes.launcher import die_with_parent, node_environment, require_ros

#: Default port of the first page, if it is free.
PORT = 8642
#: Loopback address: other machines cannot reach it.
LOOPBACK = "127.0.0.1"
#: Time that a server process gets to exit [s].
PATIENCE = 5.0


@dataclass(frozen=True)
class PageOptions:
    """Addresses of the pages, and the folder of their recordings."""

    port: int | None = None  #: First of consecutive ports, one per axis; None: :data:`PORT`, or any free port.
    bind: str = LOOPBACK  #: Address to listen on.
    folder: str = "."  #: Folder for recordings.


def require_aiohttp() -> None:
    """Raise HysteresisError when aiohttp is not installed, without importing it."""
    if importlib.util.find_spec("aiohttp") is None:
        raise HysteresisError('aiohttp is not installed: pip install "hysteresis_ros[watch]"')


class Pages:
    """The server processes of the pages, as a context manager."""

    def __init__(self, namespaces: Sequence[str], options: PageOptions):
        if namespaces:
            require_ros()
            require_aiohttp()
        folder = pathlib.Path(options.folder).absolute()
        if not folder.is_dir():
            raise HysteresisError(f"{options.folder}: is not a folder; create it first")
        self._requests = []
        for number, namespace in enumerate(namespaces):
            port = _free_port(options, number)
            given = {**asdict(options), "folder": str(folder), "port": port, "namespace": namespace}
            self._requests.append(json.dumps(given))
        self._processes: list[subprocess.Popen] = []

    def __enter__(self) -> Pages:
        guard = partial(die_with_parent, os.getpid())
        for request in self._requests:
            # a separate process, because the pip wheels of ROS restart the interpreter on import
            command = [sys.executable, "-m", "hysteresis_ros.laboratory.watch.server", request]
            options: dict[str, Any] = {"env": node_environment(), "start_new_session": True, "preexec_fn": guard}
            self._processes.append(subprocess.Popen(command, **options))
        return self

    def __exit__(self, *exception) -> None:
        for process in self._processes:
            if process.poll() is None:
                process.terminate()
        for process in self._processes:
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def over(self) -> bool:
        """Return whether a server process has ended."""
        return any(process.poll() is not None for process in self._processes)

    def exit_code(self) -> int:
        """Return the exit code of a server process that ended by itself; 0 when all run."""
        return max((process.returncode or 0 for process in self._processes), default=0)


def _free_port(options: PageOptions, number: int) -> int:
    """Return the port for the page of axis ``number``; 0: any free port."""
    if options.port == 0:
        return 0
    port = (options.port or PORT) + number
    if port > 65535:
        raise HysteresisError(
            f"--port {options.port}: there is no port {port} for the page of axis {number + 1}; give a lower port"
        )
    family = socket.AF_INET6 if ":" in options.bind else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((options.bind, port))
        except (OSError, OverflowError) as error:
            words = getattr(error, "strerror", None) or error
            if options.port is None and is_loopback(options.bind) and getattr(error, "errno", 0) == 98:
                return 0
            raise HysteresisError(f"{options.bind}:{port}: cannot listen on it: {words}") from None
    return port
