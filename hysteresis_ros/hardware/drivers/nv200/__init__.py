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

from hysteresis_ros.hardware.declaration import HardwareDriver
from hysteresis_ros.hardware.drivers.nv200.driver import Nv200Driver, Nv200Parameters
from hysteresis_ros.registry import later

DRIVER = HardwareDriver(
    name="nv200",
    title="the piezo amplifier NV200/D NET of piezosystem jena, through the makers' package",
    parameters=Nv200Parameters,
    driver=Nv200Driver,
    emulator=later("hysteresis_ros.hardware.drivers.nv200.emulator:emulator"),
    device="hysteresis_ros.hardware.drivers.nv200.emulator:DEVICE",
    package="nv200",
)
