# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Done to the machine: its cores are taken, its disk is full."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator

from hysteresis_ros.nodes.campaign.rig import Rig
from hysteresis_ros.nodes.launcher import node_environment, started
from hysteresis_ros.reliability.mishaps import Mishap

#: Keeps a core busy.
BURN = "while True: sum(range(100000))"


@contextlib.contextmanager
def busy() -> Iterator[None]:
    """Keep all cores busy as long as the block runs."""
    environment = node_environment()
    command = [sys.executable, "-c", BURN]
    burning = [started(command, environment, stderr=subprocess.DEVNULL) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in burning:
            process.kill()
            process.wait()


def load(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Keep all cores busy while the axis moves to and fro.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
        [s]
    """
    until = time.monotonic() + amount
    with busy():
        while time.monotonic() < until:
            rig.ask(rig.anywhere())
            time.sleep(0.25)
