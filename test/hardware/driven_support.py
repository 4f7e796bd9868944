# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the tests of driven plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_rows import rows_of

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.hardware.driver import Capabilities
from hysteresis_ros.hardware.drivers.simulated import SimulatedDriver
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.loop.parameters import AxisParameters

#: A plant with limits, noise and 16 bits.
PLANT = {"limits__slew_rate": 4.0e4, "limits__bits": 12, "sensor__noise": 5e-9, "late_limit": -1, "driver": "simulated"}


def parameters(**changes):
    configuration = load_configuration("kim2009").override("", time_mode="realtime")
    return AxisParameters.from_configuration(
        configuration.override("plant_simulator", **PLANT | changes)
    ).plant_simulator


def run(plant, voltages) -> np.ndarray:
    return rows_of(plant, plant.kernels, voltages)


class Device(SimulatedDriver):
    """The simulated actuator, which stores its voltages and fails on request."""

    failing = ""
    can: Capabilities | None = None

    def open(self, given, sample_rate):
        self.heard, Device.last = [], self
        return self.can or super().open(given, sample_rate)

    def read(self):
        if "read" in self.failing:
            raise OSError("unplugged")
        return super().read()

    def write(self, voltages):
        if "write" in self.failing:
            raise OSError("unplugged")
        self.heard += voltages
        super().write(voltages)

    def make_safe(self):
        self.heard.append("safe")
        if "safe" in self.failing:
            raise OSError("silent")
        super().make_safe()


@pytest.fixture
def device(monkeypatch):
    monkeypatch.setattr(Device, "failing", "")
    monkeypatch.setattr(Device, "can", None)
    monkeypatch.setitem(DRIVERS, "simulated", replace(DRIVERS["simulated"], driver=Device))
    return Device
