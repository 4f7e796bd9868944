# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Contract of the drivers: each follows its declaration, with its emulator, including the example in C."""

from __future__ import annotations

import contextlib
import math
import pathlib
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from stage_support import built, needs_compiler
from waiting import until_clock

from hysteresis_ros.configuration import dump_configuration, parse_configuration
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import NOTHING_NEW, Driver, DriverError
from hysteresis_ros.hardware.library import option_texts
from hysteresis_ros.hardware.registry import DRIVERS, driver_of
from hysteresis_ros.loop.device import MAKE_SAFE, READ, WRITE, call_alone, call_with, link_to
from hysteresis_ros.loop.parameters import PlantNodeParameters
from hysteresis_ros.models.actuator import ActuatorParameters

ROOT = pathlib.Path(__file__).resolve().parents[1]
RATE = 100.0
#: The driver of the example in C.
C_STAGE = "c_stage"
drivers = pytest.mark.parametrize("name", [*DRIVERS, pytest.param(C_STAGE, marks=needs_compiler)])


@pytest.fixture
def declared(name):
    """Return the declaration of a driver; that of the example is made from its file."""
    declared = driver_of(str(built() / "stage.py")) if name == C_STAGE else DRIVERS[name]
    if declared.package:
        pytest.importorskip(declared.package, reason=f"{declared.package} is not installed: no driver {name}")
    return declared


@pytest.fixture
def opened(declared):
    """Open the device at the driver's emulator."""
    with declared.emulator() as parameters:
        device = Device(declared, parameters, RATE)
        yield device
        device.close()


def recording(declared, heard: list):
    """Return the same driver, which stores what reaches it."""

    class Recorded(declared.driver):
        def write(self, voltages):
            heard.append(tuple(voltages))
            super().write(voltages)

    return replace(declared, driver=Recorded)


def hold(device, voltage: float, samples: int = 20) -> float:
    """Hold a voltage for some samples, and return the last position of the first joint."""
    for _ in range(samples):
        device.write([voltage])
        until_clock(time.monotonic() + 1.0 / RATE)  # the sample that a device with its own clock needs
        position = device.read()[0]
    return position


@drivers
def test_it_says_what_it_is_and_its_parameters_are_documented_and_come_back_from_yaml(declared):
    assert declared.title and issubclass(declared.driver, Driver)
    if declared.name in DRIVERS:
        assert declared.name == declared.name.lower()
        rows = {row.name: row for row in PlantNodeParameters.table()}
        assert declared.name in rows["driver"].choices
        own = "" if issubclass(PlantNodeParameters, declared.parameters) else f"{declared.name}."
        assert {own + row.name for row in declared.parameters.table()} <= set(rows), "another group has this name"
    assert all(row.description for row in declared.parameters.table())
    with declared.emulator() as parameters:
        assert isinstance(parameters, declared.parameters)
        given = {name: value for name, value in parameters.validated().to_mapping().items() if value != ()}
        text = dump_configuration({"/**/node": given})
        assert declared.parameters.from_mapping(parse_configuration(text, "test").node("node")) == parameters
    if declared.name in DRIVERS and declared.driver.__module__.startswith("hysteresis_ros."):
        text = (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
        missing = [row for row in declared.parameters.table() if f"`{own}{row.name}`" not in text]
        assert declared.name in text and not missing, "update the tables with `hysteresis parameters`"


@drivers
def test_it_is_opened_by_the_parameters_of_the_plants_node(declared):
    limits = {"hysteresis.type": "proportional", "hysteresis.proportional.gain": 1e-7}
    with declared.emulator() as parameters:
        if declared.name in DRIVERS:
            own = "" if declared.parameters is ActuatorParameters else f"{declared.name}."
            given = {own + name: value for name, value in parameters.to_mapping().items()}
        else:
            given = {"driver_options": option_texts(parameters)}
        values = {"limits.minimum": 0.0, "limits.maximum": 1.0, **limits, **given, "driver": declared.name}
        assert PlantNodeParameters.from_mapping(values).driver_parameters == parameters


@drivers
def test_its_capabilities_make_sense(opened):
    can = opened.capabilities
    assert can.joints >= 1 and can.voltages >= 1 and can.highest_rate > 0.0
    assert math.isfinite(can.minimum) and math.isfinite(can.maximum) and can.minimum < can.maximum
    assert can.watchdog is None or can.watchdog * RATE > 1.0


@pytest.mark.slow
@drivers
def test_a_voltage_moves_it_and_make_safe_brings_it_back(opened):
    can = opened.capabilities
    opened.make_safe()
    rest = hold(opened, min(max(0.0, can.minimum), can.maximum))
    moved = hold(opened, 0.5 * (can.minimum + can.maximum) if can.minimum + can.maximum else can.maximum)
    assert math.isfinite(rest) and abs(moved - rest) > 1e-12
    opened.make_safe()
    opened.make_safe()
    assert len(opened.read()) == can.joints


@drivers
def test_no_voltage_that_is_no_number_or_out_of_range_reaches_it(declared):
    heard: list = []
    with declared.emulator() as parameters:
        device = Device(recording(declared, heard), parameters, RATE)
        can = device.capabilities
        for wrong in (math.nan, math.inf, -math.inf, can.maximum + 1e-9 * abs(can.maximum) + 1e-9, can.minimum - 1.0):
            with pytest.raises(DriverError, match=rf"driver {declared.name}: cannot be written.*V is not within"):
                device.write([wrong])
        with pytest.raises(DriverError, match="voltages for"):
            device.write([can.minimum] * (can.voltages + 1))
        assert heard == []
        device.write([can.minimum])
        device.write([can.maximum])
        assert heard == [(can.minimum,), (can.maximum,)]
        device.close()


@pytest.mark.slow
@drivers
def test_what_machine_code_calls_is_what_python_calls(opened):
    """Functions of a driver without a compiled form call its methods."""
    compiled = opened.compiled()
    can = opened.capabilities
    voltages, positions = np.full(can.voltages, can.minimum), np.full(can.joints, math.nan)
    link = link_to(compiled)
    voltages[0] = 0.5 * (can.minimum + can.maximum)
    for _ in range(30):
        assert call_with(link, WRITE, voltages) == 0
        until_clock(time.monotonic() + 1.0 / RATE)  # the sample that a device with its own clock needs
        assert call_with(link, READ, positions) in (0, NOTHING_NEW)
    there = hold(opened, voltages[0])
    assert positions[0] == pytest.approx(there, abs=0.02 * abs(there))
    assert call_alone(link, MAKE_SAFE) == 0


@drivers
def test_closed_it_does_nothing_more_and_it_can_be_opened_again(declared):
    with declared.emulator() as parameters:
        for _ in range(2):
            device = Device(declared, parameters, RATE)
            device.make_safe()
            device.close()
            device.close()
            device.make_safe()
            for call in (device.read, lambda device=device: device.write([0.0])):
                with pytest.raises(DriverError, match="it is closed"):
                    call()


@pytest.mark.slow
@drivers
def test_a_second_master_is_refused_or_has_a_device_of_its_own(declared):
    with contextlib.ExitStack() as stack:
        parameters = stack.enter_context(declared.emulator())
        first = Device(declared, parameters, RATE)
        stack.callback(first.close)
        can = first.capabilities
        try:
            second = Device(declared, parameters, RATE)
        except DriverError as error:
            assert str(error).startswith(f"driver {declared.name}: cannot be opened: ")
            hold(first, can.minimum, samples=2)  # and the first one continues
            return
        stack.callback(second.close)
        for _ in range(30):
            low, high = hold(first, can.minimum, samples=1), hold(second, can.maximum, samples=1)
        assert abs(high - low) > 1e-12, "both work on one device"


@drivers
def test_a_device_that_is_gone_is_a_driver_error_within_moments(declared):
    with declared.emulator() as parameters:
        device = Device(declared, parameters, RATE)
    start = time.monotonic()
    for call in (device.read, device.make_safe):
        # a driver without external effects does not touch the outside
        with contextlib.suppress(DriverError):
            call()
    device.close()
    assert time.monotonic() - start < 5.0


@pytest.mark.slow
def test_a_driver_loads_its_emulator_only_when_that_is_asked_for():
    code = (
        "import sys; from hysteresis_ros.hardware.registry import DRIVERS\n"
        "held = lambda: {name for name in sys.modules if name.startswith('hysteresis_ros.') and 'emulat' in name}\n"
        "print(sorted(held())); DRIVERS['gcs'].emulated; print(len(held()) > 0)\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert ran.stdout.split("\n")[:2] == ["[]", "True"], ran.stdout + ran.stderr
