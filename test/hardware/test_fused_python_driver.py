# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A driver in Python whose methods machine code calls: the same rows as from Python, and the same failures."""

from __future__ import annotations

import math
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from driven_loops import assert_equal_to_twin, fused, run
from waiting import until

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.hardware.driver import DriverError, Reading
from hysteresis_ros.hardware.drivers.simulated import SimulatedDriver
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.device import CompiledPlant, DrivenPlant
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.plant import DEVICE_FAILED


class Noting(SimulatedDriver):
    """The simulated actuator, which notes what it is asked to do, and fails when it is told to."""

    #: The last instance; what fails, and the exception; readings that replace those of the sensor, by their number.
    last: Noting
    broken: dict = {}
    readings: dict = {}

    def open(self, parameters, sample_rate):
        Noting.last = self
        self.sent, self.clocked, self.triggered, self.safes, self.reads, self.waiting = [], [], [], 0, 0, 0
        return replace(super().open(parameters, sample_rate), clock=True, trigger_rate=1e4, trigger_input=True)

    def _may_fail(self, what):
        if what in self.broken:
            raise self.broken[what]

    def read(self):
        self._may_fail("read")
        self.reads += 1
        return self.readings.get(self.reads) or super().read()

    def write(self, voltages):
        self._may_fail("write")
        self.sent.append(tuple(voltages))
        super().write(voltages)

    def output_clock(self, edges):
        self._may_fail("clock")
        self.clocked.append(edges)

    def output_trigger(self, number, delay):
        self._may_fail("trigger")
        self.triggered.append((number, delay))

    def pulses(self):
        self._may_fail("pulses")
        count, self.waiting = self.waiting, 0
        return count

    def make_safe(self):
        self.safes += 1
        self._may_fail("safe")
        super().make_safe()


@pytest.fixture
def noting(monkeypatch):
    monkeypatch.setattr(Noting, "broken", {})
    monkeypatch.setattr(Noting, "readings", {})
    monkeypatch.setitem(DRIVERS, "simulated", replace(DRIVERS["simulated"], driver=Noting))
    return Noting


#: The pixels of a scan, and triggers every 0.4 µm.
EVENTS = {
    "waveform__type": "scan",
    "initial_setpoint": 6e-6,
    "waveform__amplitude": 0.0,
    "waveform__cycles": 2,
    "waveform__scan__kind": "raster",
    "waveform__scan__values": ["width=3um", "depth=2um", "lines=4", "pixels=5", "flyback=2", "frame_rate=20Hz"],
    "waveform__scan__clock": "pixel",
    "triggers__start": 4.5e-6,
    "triggers__step": 0.4e-6,
    "triggers__stop": 7.5e-6,
    "triggers__input__action": "step",
    "triggers__input__distance": 1e-7,
}


#: No pulse comes. With its trigger input the axis has the loop with triggers, which all devices of the tests share.
TRIGGERED = {"triggers__input__action": "hold"}


def axis_of(source=None, **changes) -> AxisParameters:
    configuration = load_configuration("kim2009").override("", time_mode="realtime")
    configuration = configuration.override("reference_generator", **(TRIGGERED | (source or {})))
    asked = {"driver": "simulated", "late_limit": -1, "realtime__priority": 0} | changes
    return AxisParameters.from_configuration(configuration.override("plant_simulator", **asked))


def test_machine_code_and_python_call_it_alike(noting):
    k = np.arange(2000)
    voltages = 45.0 + 70.0 * np.sin(k / 40.0) + np.random.default_rng(2).normal(scale=3.0, size=k.size)
    voltages[k % 7 == 3] = math.nan
    noting.readings = {200: Reading((math.nan,))}
    found = []
    for kind in (CompiledPlant, DrivenPlant):
        plant = kind(axis_of().plant_simulator)
        plant.reset()
        rows = run(plant, voltages)
        found.append((rows, noting.last.sent, noting.last.reads))
        assert plant.calls_python == (kind is CompiledPlant)
        plant.close()
    (compiled, *called), (python, *called_by_python) = found
    np.testing.assert_array_equal(compiled, python)
    assert called == called_by_python and math.isnan(compiled[199, at.MEASURED])
    assert np.isfinite(np.delete(compiled[:, at.MEASURED], 199)).all()


@pytest.mark.parametrize(
    ("what", "error", "said"),
    [
        ("read", OSError("unplugged"), "cannot be read: OSError: unplugged; check the device"),
        ("write", OSError("unplugged"), "cannot be written: OSError: unplugged; check the device"),
        ("read", DriverError("card 3", "does not answer", "plug it in"), "read: card 3 does not answer; plug it in"),
        ("write", ZeroDivisionError("oh"), "cannot be written: ZeroDivisionError: oh; check the device"),
        ("two", None, "cannot be read: ValueError: 2 positions for 1 joints; check the device"),
        ("infinite", None, "cannot be read: ValueError: an infinite position; check the device"),
    ],
)
def test_an_exception_stops_the_axis_in_that_sample_with_the_same_words(noting, what, error, said):
    readings = {"two": Reading((1e-6, 2e-6)), "infinite": Reading((math.inf,))}
    for kind in (CompiledPlant, DrivenPlant):
        noting.broken, noting.readings = {}, {}
        plant = kind(axis_of().plant_simulator)
        plant.reset()
        assert not run(plant, [60.0] * 50)[:, at.TRIPPED].any() and not plant.failure
        device = noting.last
        if error is None:
            noting.readings = {51: readings[what]}
        else:
            noting.broken = {what: error}
        safes, sent = device.safes, len(device.sent)
        rows = run(plant, [60.0] * 20)
        assert rows[-1, at.TRIPPED] == DEVICE_FAILED and device.safes == safes + 1 and len(device.sent) == sent
        assert f"driver simulated: {said}"[-len(said) :] == said and said in plant.failure, plant.failure
        assert plant.failure.count("cannot be") == 1
        noting.broken, noting.readings = {}, {}
        plant.halt()
        run(plant, [60.0] * 5)
        assert len(device.sent) == sent, "a safe device must not be called"
        plant.start()
        back = run(plant, [60.0] * 400)
        assert not plant.tripped and not plant.failure and back[-1, at.PLANT_VOLTAGE] == 60.0
        plant.close()


@pytest.mark.parametrize("what", ["read", "write"])
@pytest.mark.parametrize("error", [SystemExit(3), KeyboardInterrupt()])
@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_an_exit_in_a_driver_stops_the_axis_as_an_exception_does(noting, kind, error, what):
    plant = kind(axis_of().plant_simulator)
    plant.reset()
    run(plant, [60.0] * 50)
    device = noting.last
    safes, sent = device.safes, len(device.sent)
    noting.broken = {what: error}
    thread = threading.Thread(target=run, args=(plant, [60.0] * 20))  # the thread that keeps the time
    thread.start()
    thread.join()
    noting.broken = {}
    assert plant.tripped and device.safes == safes + 1 and len(device.sent) == sent
    assert f"{type(error).__name__}: " in plant.failure, plant.failure
    plant.close()


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_one_that_exits_when_made_safe_is_reported_and_closed(noting, monkeypatch, kind):
    closed: list = []
    monkeypatch.setattr(noting, "close", lambda self: closed.append(self) or sys.exit(2))
    plant = kind(axis_of().plant_simulator)
    run(plant, [40.0] * 20)
    noting.broken = {"safe": SystemExit(1)}
    with pytest.raises(DriverError, match="cannot be made safe: SystemExit: 1: the output is still at"):
        plant.make_safe()
    assert "the output is still at" in plant.close() and closed == [noting.last]


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_the_voltage_of_one_that_cannot_be_made_safe_is_the_last_that_it_got(noting, kind):
    plant = kind(axis_of().plant_simulator)
    run(plant, [40.0] * 400)
    while plant.step_to_safe():
        pass
    assert noting.last.sent[-1] == (plant.parameters.safe_voltage,) != noting.last.sent[0]
    noting.broken = {"safe": OSError("unplugged")}
    for _ in range(2):
        with pytest.raises(DriverError, match="the output is still at 0 V"):
            plant.make_safe()
    noting.broken = {}
    plant.make_safe()
    plant.close()


def test_one_that_cannot_be_made_safe_is_tried_again_until_it_is(noting):
    plant = CompiledPlant(axis_of().plant_simulator)
    plant.insists_every = 0.005
    run(plant, [40.0] * 20)
    noting.broken = {"read": OSError("unplugged"), "safe": OSError("no answer")}
    run(plant, [40.0] * 5)
    left = f"the device cannot be made safe: no answer: the output is still at {noting.last.sent[-1][0]:.6g} V"
    assert plant.failure.endswith(left), plant.failure
    assert plant.held() == noting.last.sent[-1][0] != 0.0
    until(lambda: noting.last.safes > 3, what="two more attempts")
    noting.broken = {}
    until(lambda: "cannot be made safe" not in plant.failure, what="the attempt that succeeds")
    assert plant.tripped and plant.held() == plant.parameters.safe_voltage
    assert plant.close() == ""


def test_before_a_start_one_that_was_left_at_a_voltage_is_made_safe(noting):
    plant = CompiledPlant(axis_of().plant_simulator)
    plant.insists_every = 1e3
    run(plant, [40.0] * 20)
    assert not plant.recover(), "nothing to do"
    noting.broken = {"read": OSError("unplugged"), "safe": OSError("no answer")}
    run(plant, [40.0] * 5)
    with pytest.raises(DriverError, match="cannot be made safe"):
        plant.recover()
    assert plant.held() == noting.last.sent[-1][0] != 0.0
    noting.broken = {}
    safes = noting.last.safes
    assert plant.recover() and noting.last.safes == safes + 1
    assert run(plant, [40.0])[0, at.PLANT_VOLTAGE] == plant.held() == plant.parameters.safe_voltage
    plant.close()


@pytest.mark.slow
def test_a_fused_run_has_a_twin(noting):
    parameters = axis_of()
    loop, table = fused(parameters, 1200)
    sent = [voltage for (voltage,) in noting.last.sent]
    assert sent[-1200:] == table[at.PLANT_VOLTAGE].tolist() and np.ptp(table[at.MEASURED]) > 1e-6
    assert_equal_to_twin(parameters, loop, table)
    loop.axis.plant.make_safe()
    assert noting.last.safes
    loop.axis.plant.close()


def test_clock_triggers_and_the_trigger_input_are_called_by_machine_code(noting):
    parameters = axis_of(EVENTS, scan_clock=True, trigger_output=True, trigger_input=True)
    _, table = fused(parameters, 3000)
    device = noting.last
    edges = table[at.SCAN_EDGES]
    assert device.clocked == [int(value) for value in edges[edges != 0.0]] and len(device.clocked) > 5
    numbers = table[at.TRIGGER]
    fired = numbers != 0.0
    expected = list(zip(numbers[fired].astype(int).tolist(), table[at.TRIGGER_DELAY][fired].tolist(), strict=True))
    assert device.triggered == expected and len(expected) >= 5
    plant = CompiledPlant(parameters.plant_simulator)
    noting.last.waiting = 2
    assert run(plant, [1.0])[0, at.TRIGGER_IN] == 2.0 and noting.last.waiting == 0
    plant.close()


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("clock", "cannot output the clock of the scan"),
        ("trigger", "output a trigger"),
        ("pulses", "its trigger input"),
    ],
)
def test_an_exception_of_an_optional_method_stops_the_axis_too(noting, what, said):
    noting.broken = {what: OSError("unplugged")}
    parameters = axis_of(EVENTS, scan_clock=True, trigger_output=True, trigger_input=True)
    plant = CompiledPlant(parameters.plant_simulator)
    loop = FusedLoop(Axis(parameters, plant), math.inf, 1500)
    loop.start()
    assert loop.join(60.0)
    assert plant.tripped and f"{said}: OSError: unplugged" in plant.failure and noting.last.safes
    plant.close()


def test_a_closed_device_is_not_called(noting):
    plant = CompiledPlant(axis_of().plant_simulator)
    run(plant, [5.0] * 3)
    device = noting.last
    plant.close()
    reads, sent = device.reads, len(device.sent)
    run(plant, [5.0] * 3)
    assert (device.reads, len(device.sent)) == (reads, sent)
