# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Controllers of Physik Instrumente that speak GCS 2.0 over TCP: E-709, E-727, E-754 and their like."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass

from hysteresis_ros.hardware.declaration import EmulatedDevice, HardwareDriver
from hysteresis_ros.hardware.drivers.gcs.driver import GcsDriver, GcsParameters
from hysteresis_ros.hardware.drivers.gcs.emulator.controller import MODELS, Controller
from hysteresis_ros.hardware.drivers.gcs.emulator.session import Session
from hysteresis_ros.hardware.emulation.bench import Bench, Running
from hysteresis_ros.hardware.emulation.faults import DeviceFaults
from hysteresis_ros.hardware.emulation.server import serving
from hysteresis_ros.parameters import Parameters, parameter


@dataclass(frozen=True)
class EmulatedControllerParameters(Parameters):
    """Which controller is emulated, and where it is found."""

    model: str = parameter("E-754", choices=tuple(MODELS), description="which controller")
    host: str = parameter("127.0.0.1", description="address at which it is found")
    port: int = parameter(50000, description="TCP port; 0: a free one", low=0, high=65535)
    masters: int = parameter(1, description="so many programs may be connected at a time", low=1, high=100)


@contextlib.contextmanager
def start(given: EmulatedControllerParameters, bench: Bench) -> Iterator[Running]:
    """Run an emulated controller.

    Parameters
    ----------
    given : EmulatedControllerParameters
    bench : Bench

    Raises
    ------
    ConfigurationError
        Its address cannot be had, or a fault is written wrongly.
    """
    faults = DeviceFaults(time.monotonic, bench.faults)
    controller = Controller(MODELS[given.model], bench.plant, bench.cycle, faults)
    address = given.host, given.port
    with serving(address, lambda: Session(controller), controller.tick, faults, given.masters) as server:
        where = f"{given.model} with {', '.join(controller.axes)} as axes at {given.host}:{server.port}"
        yield Running(where, GcsParameters(host=given.host, port=server.port), faults, controller)


@contextlib.contextmanager
def emulator() -> Iterator[Parameters]:
    """Give the parameters of an emulated controller on a free port."""
    with start(EmulatedControllerParameters(port=0), Bench()) as running:
        yield running.driver


DRIVER = HardwareDriver(
    name="gcs",
    title="a piezo controller that speaks GCS 2.0 over TCP (PI E-709, E-727, E-754)",
    parameters=GcsParameters,
    driver=GcsDriver,
    emulator=emulator,
    device=EmulatedDevice(EmulatedControllerParameters, start),
)
