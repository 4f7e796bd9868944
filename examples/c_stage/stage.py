# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stage of this folder as a driver with named parameters: ``driver: PATH/stage.py`` in a parameter file.

Build it first, in this folder; HEADERS is the folder ``hysteresis_ros/hardware`` of the installed package::

    gcc -O2 stage_device.c -o stage_device -lm -lrt
    gcc -O2 -fPIC -shared -I HEADERS stage_driver.c -o libstage.so -lrt

``driver: PATH/libstage.so`` with ``driver_options: [name=/stage]`` does the same without this file.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.hardware.driver import HardwareDriver
from hysteresis_ros.hardware.library import SharedLibrary

FOLDER = pathlib.Path(__file__).parent


@dataclass(frozen=True)
class StageParameters(Parameters):
    """Which stage."""

    name: str = parameter("/stage", description="name of its shared memory", read_only=True)
    standstill: float = parameter(
        0.2, unit="s", low=0.001, high=60.0, description="time without a sample after which the stage counts as dead"
    )


class Stage(SharedLibrary):
    """The library beside this file."""

    path = FOLDER / "libstage.so"


@contextlib.contextmanager
def emulator(*options: str) -> Iterator[StageParameters]:
    """Start the stage's process under a unique name."""
    name = f"/stage_{os.getpid()}_{os.urandom(4).hex()}"
    command = [str(FOLDER / "stage_device"), name, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            if process.stdout is None or process.stdout.readline() != b"ready\n":
                raise OSError(f"{command[0]} did not start")
            yield StageParameters(name=name)
        finally:
            process.terminate()
            process.wait(10.0)


DRIVER = HardwareDriver(
    name="stage",
    title="a stage in another process, behind shared memory",
    parameters=StageParameters,
    driver=Stage,
    emulator=emulator,
)
