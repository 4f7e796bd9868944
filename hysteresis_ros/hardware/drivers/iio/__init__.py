# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Converters of the Linux subsystem *industrial I/O*, through sysfs."""

from __future__ import annotations

from hysteresis_ros.hardware.declaration import HardwareDriver
from hysteresis_ros.hardware.drivers.iio.driver import IioDriver, IioParameters
from hysteresis_ros.registry import later

DRIVER = HardwareDriver(
    name="iio",
    title="a DAC and an ADC of Linux industrial I/O, through sysfs",
    parameters=IioParameters,
    driver=IioDriver,
    emulator=later("hysteresis_ros.hardware.drivers.iio.emulator:emulator"),
    device="hysteresis_ros.hardware.drivers.iio.emulator:DEVICE",
)
