# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The piezo amplifier NV200/D NET of piezosystem jena."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass

from hysteresis_ros.hardware.declaration import EmulatedDevice, HardwareDriver
from hysteresis_ros.hardware.drivers.nv200.driver import Nv200Driver, Nv200Parameters
from hysteresis_ros.hardware.drivers.nv200.emulator import NAME, Amplifier
from hysteresis_ros.hardware.emulation.bench import Bench, Running
from hysteresis_ros.hardware.emulation.faults import DeviceFaults
from hysteresis_ros.hardware.emulation.plant import EmulatedPlant
from hysteresis_ros.hardware.emulation.serial import serving_serial
from hysteresis_ros.hardware.emulation.server import serving
from hysteresis_ros.parameters import Parameters, parameter


@dataclass(frozen=True)
class EmulatedAmplifierParameters(Parameters):
    """Where the emulated amplifier is found."""

    link: str = parameter("tcp", choices=("tcp", "serial"), description="serial: a pseudo terminal, whose name is told")
    host: str = parameter("127.0.0.1", description="tcp: address at which it is found")
    port: int = parameter(2300, description="TCP port; 0: a free one", low=0, high=65535)


@contextlib.contextmanager
def start(given: EmulatedAmplifierParameters, bench: Bench) -> Iterator[Running]:
    """Run an emulated amplifier.

    Parameters
    ----------
    given : EmulatedAmplifierParameters
    bench : Bench

    Raises
    ------
    ConfigurationError
        Its address cannot be had, or a fault is written wrongly.
    """
    faults = DeviceFaults(time.monotonic, bench.faults)
    amplifier = Amplifier(EmulatedPlant(bench.plant, bench.cycle), faults)
    if given.link == "serial":
        with serving_serial(amplifier.session(), amplifier.tick, faults) as path:
            yield Running(f"{NAME} at {path}", Nv200Parameters(serial_port=path), faults)
        return
    with serving((given.host, given.port), amplifier.session, amplifier.tick, faults) as server:
        driver = Nv200Parameters(host=given.host, port=server.port, configure_link=False)
        yield Running(f"{NAME} at {given.host}:{server.port}", driver, faults)


@contextlib.contextmanager
def emulator() -> Iterator[Parameters]:
    """Give the parameters of an emulated amplifier at a pseudo terminal."""
    with start(EmulatedAmplifierParameters(link="serial"), Bench()) as running:
        yield running.driver


DRIVER = HardwareDriver(
    name="nv200",
    title="the piezo amplifier NV200/D NET of piezosystem jena, through the makers' package",
    parameters=Nv200Parameters,
    driver=Nv200Driver,
    emulator=emulator,
    device=EmulatedDevice(EmulatedAmplifierParameters, start),
    package="nv200",
)
