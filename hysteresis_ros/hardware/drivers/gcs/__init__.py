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

from hysteresis_ros.hardware.declaration import HardwareDriver
from hysteresis_ros.hardware.drivers.gcs.driver import GcsDriver, GcsParameters
from hysteresis_ros.registry import later

DRIVER = HardwareDriver(
    name="gcs",
    title="a piezo controller that speaks GCS 2.0 over TCP (PI E-709, E-727, E-754)",
    parameters=GcsParameters,
    driver=GcsDriver,
    emulator=later("hysteresis_ros.hardware.drivers.gcs.emulator.session:emulator"),
    device="hysteresis_ros.hardware.drivers.gcs.emulator.session:DEVICE",
)
