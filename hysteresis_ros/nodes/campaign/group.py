# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The processes of an axis, each of which can be killed, stopped and started again by itself."""

from __future__ import annotations

import pathlib
import signal
import subprocess
import time

from hysteresis_ros.configuration import NODE_NAMES
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.nodes.axis import WITH_RECORDER
from hysteresis_ros.nodes.launcher import PATIENCE, STOP_ORDER, node_command, node_environment, started
from hysteresis_ros.reliability.mishaps import FUSED, PROCESSES

#: The process that holds all nodes, and the one that records beside those of messages.
AXIS, RECORDER = "hysteresis_axis", "recorder"

#: So many words of what was printed last say why somebody left.
LAST_WORDS = 30


class Group:
    """The processes of one axis.

    Parameters
    ----------
    axis : AxisParameters
    way : str
        Of :data:`hysteresis_ros.reliability.mishaps.WAYS`.
    folder : pathlib.Path
        For parameter files, recordings and what the processes print.
    remap : tuple of str
        Remappings ``node:topic:=other``.
    prefix : tuple of str
        Before the command line of each process.
    environment : dict of str to str, optional
        Variables of the processes beside those of this one.
    """

    def __init__(
        self,
        axis: AxisParameters,
        way: str,
        folder: pathlib.Path,
        remap: tuple[str, ...] = (),
        prefix: tuple[str, ...] = (),
        environment: dict[str, str] | None = None,
    ):
        self.names = NODE_NAMES[:4] if way == PROCESSES else (AXIS,)
        self.log = folder / "log.txt"
        self.bags: list[pathlib.Path] = []
        self._axis, self._way, self._folder = axis, way, folder
        self._more = [word for rule in remap for word in ("-r", rule)]
        self._prefix = list(prefix)
        self._environment = {**node_environment(), **(environment or {}), "PYTHONUNBUFFERED": "1"}
        self._processes: dict[str, subprocess.Popen] = {}
        self._ended: set[str] = set()
        for name in self.names:
            self.start(name)

    def start(self, name: str) -> None:
        """Start a process; one that was ended is started anew.

        Parameters
        ----------
        name : str
            Of :attr:`names`, or :data:`RECORDER`.
        """
        axis, more = self._axis, []
        if self._way == FUSED or name == RECORDER:
            self.bags.append(self._folder / f"bag{len(self.bags)}")
            axis, more = axis.with_recorder(str(self.bags[-1])), [] if name == RECORDER else [WITH_RECORDER]
        path = self._folder / f"{name}.yaml"
        path.write_text(axis.configuration_text(), encoding="utf-8")
        command = [*self._prefix, *node_command(name, axis.namespace, path, *more, log_level="info"), *self._more]
        self._ended.discard(name)
        with open(self.log, "a", encoding="utf-8") as log:
            self._processes[name] = started(command, self._environment, stdout=log, stderr=subprocess.STDOUT)

    def send(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a process; ``SIGKILL`` is waited for.

        Parameters
        ----------
        name : str
        number : signal.Signals
        """
        if number == signal.SIGKILL:
            self._ended.add(name)
        self._processes[name].send_signal(number)
        if number == signal.SIGKILL:
            self._processes[name].wait()

    def identifier(self, name: str) -> int:
        """Return the number of a process."""
        return self._processes[name].pid

    def end(self, name: str) -> int | None:
        """End a process as Ctrl-C does; return its exit code, None when it had to be killed."""
        self._ended.add(name)
        process = self._processes[name]
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGTERM)
        try:
            return process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return None

    def codes(self) -> list[int | None]:
        """Return the exit codes of the processes, None of those that run."""
        return [process.poll() for process in self._processes.values()]

    def died(self) -> list[str]:
        """Return who ended without having been asked to, in words."""
        found = []
        for name, process in self._processes.items():
            code = process.poll()
            if code is not None and name not in self._ended:
                found.append(f"{name} ended by itself with exit code {code}")
        return found

    def printed(self, since: int = 0) -> str:
        """Return what the processes have printed.

        Parameters
        ----------
        since : int
            Bytes that are left out.
        """
        with open(self.log, "rb") as log:
            log.seek(since)
            return log.read().decode("utf-8", "replace")

    def close(self) -> list[str]:
        """End all processes; return in words what went wrong with that."""
        found = []
        begun = time.monotonic()
        for name in sorted(self._processes, key=STOP_ORDER.index):
            if self._processes[name].poll() is not None:
                continue
            code = self.end(name)
            if code and not (code == 1 and self._prefix):  # what has no room ends with a recording that is too short
                last = " ".join(self.printed().split()[-LAST_WORDS:])
                found.append(f"{name} left with exit code {code}: {last}")
            elif code is None:
                found.append(f"{name} had to be killed after {time.monotonic() - begun:.0f} s")
        return found
