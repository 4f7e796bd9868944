# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What an axis may stand in: a device that misbehaves, a disk that is nearly full."""

from __future__ import annotations

import socket
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


def small_disk() -> tuple[str, ...]:
    """Return what stands before a command whose disk is nearly full: a limit on files is that to whoever writes."""
    return "bash", "-c", f'ulimit -f {ROOM}; exec "$@"', "bash"


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
