# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What an axis may stand in: a device that misbehaves, a disk that is nearly full, a time of day that can be set."""

from __future__ import annotations

import os
import pathlib
import socket
import struct
import subprocess
import sys
import time
from dataclasses import replace

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.nodes.launcher import node_environment, started

#: Largest file of a process on a small disk [KiB].
ROOM = 1024
#: Seconds in which an emulated device is there, and between two looks.
DEVICE_START, LOOK = 60.0, 0.05
#: What Python runs first in a process whose time of day can be set.
TIME_OF_DAY = """import os, struct, time
_time, _time_ns, _file = time.time, time.time_ns, os.open({path!r}, os.O_RDONLY)
def _offset():
    return struct.unpack("q", os.pread(_file, 8, 0))[0]
time.time = lambda: _time() + _offset()
time.time_ns = lambda: _time_ns() + 1_000_000_000 * _offset()
"""


def small_disk() -> tuple[str, ...]:
    """Return what stands before a command whose disk is nearly full: a limit on files is that to whoever writes."""
    return "bash", "-c", f'ulimit -f {ROOM}; exec "$@"', "bash"


class Clock:
    """A time of day that processes see in the place of the machine's; steady clocks and DDS go on with the machine's.

    Libraries that are put before the C library's clocks (libfaketime 0.9.10) let every sleep of Python 3.11 fail, and
    the clock of the machine is everybody's: so it is Python's own that is replaced, before anything else is imported.

    Parameters
    ----------
    folder : pathlib.Path
        For the files from which they know it.
    """

    def __init__(self, folder: pathlib.Path):
        self._folder, self._file = folder, folder / "time_of_day"
        self.set(0)
        (folder / "sitecustomize.py").write_text(TIME_OF_DAY.format(path=str(self._file)), encoding="utf-8")

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables of the processes."""
        paths = (str(self._folder), node_environment().get("PYTHONPATH", ""))
        return {"PYTHONPATH": os.pathsep.join(path for path in paths if path)}

    def set(self, offset: int) -> None:
        """Let the time of day be off by so much from now on.

        Parameters
        ----------
        offset : int
            [s]
        """
        with open(self._file, "r+b" if self._file.exists() else "wb") as file:
            file.write(struct.pack("q", offset))

    def close(self) -> None:
        """Nothing is left of it."""


class Device:
    """An emulated controller in the simulated plant's place, with a plant inside.

    Parameters
    ----------
    config : str
        Whose plant it has.

    Raises
    ------
    HysteresisError
        It does not start.
    """

    def __init__(self, config: str):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        words = ["emulate", "gcs", "--port", str(self._port), "--plant", config]
        command = [sys.executable, "-m", "hysteresis_ros.cli.main", *words]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "text": True}
        self._process = started(command, node_environment(), **pipes)
        patience = time.monotonic() + DEVICE_START
        while not self._answers():
            if self._process.poll() is not None or time.monotonic() > patience:
                self.close()
                raise HysteresisError(f"the emulated controller does not start: hysteresis {' '.join(words)}")
            time.sleep(LOOK)

    def _answers(self) -> bool:
        with socket.socket() as probe:
            probe.settimeout(LOOK)
            return probe.connect_ex(("127.0.0.1", self._port)) == 0

    def driven(self, axis: AxisParameters) -> AxisParameters:
        """Return an axis that drives it.

        Parameters
        ----------
        axis : AxisParameters
        """
        plant = axis.plant_simulator
        back = (plant.limits.maximum - plant.limits.minimum) / plant.safe_slew_rate
        gcs = replace(plant.gcs, port=self._port, safe_time=back)
        return replace(axis, plant_simulator=replace(plant, driver="gcs", gcs=gcs))

    def go_wrong(self, fault: str, seconds: float) -> None:
        """Let something go wrong from now on.

        Parameters
        ----------
        fault : str
            Of ``hysteresis emulate --help``.
        seconds : float
        """
        assert self._process.stdin is not None
        self._process.stdin.write(f"{fault}:0:{seconds:g}\n")
        self._process.stdin.flush()

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()
