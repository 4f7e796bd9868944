# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Only voltages within the range of a device reach its driver."""

from __future__ import annotations

import contextlib
import math

import pytest

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import Capabilities, Driver, DriverError, HardwareDriver, Reading


class Noting(Driver):
    """Stores the written voltages."""

    written: list[float] = []
    minimum, maximum = -10.0, 100.0
    reading = Reading((0.0,))

    def open(self, parameters, sample_rate):
        return Capabilities(1, 1, self.minimum, self.maximum, 1000.0)

    def read(self):
        return self.reading

    def write(self, voltages):
        self.written += voltages

    def make_safe(self):
        self.written.append("safe")

    def close(self):
        self.written.append("closed")


@pytest.fixture
def device(monkeypatch):
    monkeypatch.setattr(Noting, "written", [])
    return Device(HardwareDriver("noting", "notes", Parameters, Noting, contextlib.nullcontext), Parameters(), 100.0)


@pytest.mark.parametrize("voltage", [math.nan, math.inf, -math.inf, -10.000001, 100.000001])
def test_what_is_no_voltage_of_its_range_does_not_reach_a_device(device, voltage):
    with pytest.raises(DriverError, match=r"cannot be written.*is not within -10 … 100 V"):
        device.write([voltage])
    assert device._driver.written == []
    device.write([-10.0])
    device.write([100.0])
    assert device._driver.written == [-10.0, 100.0]


@pytest.mark.parametrize("voltage", [math.inf, -math.inf])
def test_nor_does_an_infinite_one_where_the_device_has_no_end_of_its_range(monkeypatch, voltage):
    monkeypatch.setattr(Noting, "written", [])
    monkeypatch.setattr(Noting, "minimum", -math.inf)
    monkeypatch.setattr(Noting, "maximum", math.inf)
    endless = Device(HardwareDriver("noting", "notes", Parameters, Noting, contextlib.nullcontext), Parameters(), 100.0)
    with pytest.raises(DriverError, match="cannot be written"):
        endless.write([voltage])
    assert endless._driver.written == []


def test_more_voltages_than_the_device_has_are_refused(device):
    with pytest.raises(DriverError, match="2 voltages for 1"):
        device.write([1.0, 2.0])
    assert device._driver.written == []


def test_an_infinite_position_is_no_reading_and_a_missing_one_is(device, monkeypatch):
    monkeypatch.setattr(Noting, "reading", Reading((math.inf,)))
    with pytest.raises(DriverError, match="an infinite position"):
        device.read()
    monkeypatch.setattr(Noting, "reading", Reading((math.nan,)))
    assert math.isnan(device.read()[0])
    monkeypatch.setattr(Noting, "reading", Reading((0.0,), (1.0,)))
    with pytest.raises(DriverError, match="1 forces, but Capabilities.forces is 0"):
        device.read()


def test_once_it_is_closed_nothing_is_written_or_made_safe(device):
    device.close()
    with pytest.raises(DriverError, match="it is closed"):
        device.write([1.0])
    with pytest.raises(DriverError, match="it is closed"):
        device.read()
    device.make_safe()
    assert device._driver.written == ["closed"]
