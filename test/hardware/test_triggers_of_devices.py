# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Triggers at the outputs of devices: a GCS controller that compares positions, an IIO trigger, a driver in Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driven_support import run
from gcs_support import CYCLE, RATE, Bench, serving_stand
from waiting import until

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.drivers.gcs import OUT_OF_RANGE, WRONG_COUNT
from hysteresis_ros.hardware.drivers.iio import IioParameters
from hysteresis_ros.hardware.drivers.simulated import SimulatedDriver
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.laboratory.emulation.bench import Bench as DeviceBench
from hysteresis_ros.laboratory.emulation.gcs import COMMANDS
from hysteresis_ros.laboratory.emulation.iio import TRIGGER, EmulatedConvertersParameters, start
from hysteresis_ros.loop.device import DrivenPlant
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.models.calibration import SensorCalibration, SensorCalibrationParameters


class Lines(SimulatedDriver):
    """The simulated actuator with a trigger output, a trigger input, or a position compare of its own."""

    can: dict = {}
    broken = False

    def open(self, parameters, sample_rate):
        self.outputs, self.compared, self.waiting = [], None, 0
        Lines.last = self
        return replace(super().open(parameters, sample_rate), **self.can)

    def output_trigger(self, number, delay):
        if self.broken:
            raise OSError("unplugged")
        self.outputs.append((number, delay))

    def compare(self, up, down):
        self.compared = up, down

    def pulses(self):
        count, self.waiting = self.waiting, 0
        return count


@pytest.fixture
def lines(monkeypatch):
    monkeypatch.setattr(Lines, "can", {})
    monkeypatch.setattr(Lines, "broken", False)
    monkeypatch.setitem(DRIVERS, "simulated", replace(DRIVERS["simulated"], driver=Lines))
    return Lines


def plant_of(source=None, **changes) -> DrivenPlant:
    """Return the device of an axis whose generator has a grid of triggers."""
    grid = {"triggers__start": 2e-6, "triggers__step": 1e-6, "triggers__stop": 6e-6} if source is None else source
    configuration = load_configuration("kim2009").override("", time_mode="realtime")
    configuration = configuration.override("reference_generator", waveform__type="hold", **grid)
    asked = {"driver": "simulated", "trigger_output": True} | changes
    return DrivenPlant(
        AxisParameters.from_configuration(configuration.override("plant_simulator", **asked)).plant_simulator
    )


def test_a_driver_in_python_outputs_triggers_and_reads_pulses(lines):
    lines.can = {"trigger_rate": 3000.0, "trigger_input": True}
    plant = plant_of({"triggers__positions": (1e-6,), "triggers__input__action": "hold"}, trigger_input=True)
    lines.last.waiting = 3
    assert run(plant, [0.0, 0.0])[:, at.TRIGGER_IN].tolist() == [3.0, 3.0], "the row of the caller keeps its pulses"
    plant.output_trigger(1, 1e-4)
    plant.output_trigger(2, 0.0)
    assert lines.last.outputs == [(1, 1e-4), (2, 0.0)]
    lines.broken = True
    plant.output_trigger(3, 0.0)
    assert plant.tripped and "cannot output a trigger: OSError: unplugged" in plant.failure
    plant.close()


def test_a_device_that_compares_gets_positions_in_its_units_and_its_direction(lines):
    lines.can = {"trigger_rate": 3000.0, "compares": True, "position_unit": "um"}
    sensor = {"unit": "um", "scale": 1e-6, "offset": 10e-6, "sign": -1}
    given = {"triggers__positions": (2e-6, 3e-6), "triggers__down_positions": (8e-6,)}
    plant = plant_of(given, **{f"calibration__sensor__{name}": value for name, value in sensor.items()})
    up, down = lines.last.compared
    # its readings fall when the displacement rises
    np.testing.assert_allclose(up, [2.0], rtol=1e-12)
    np.testing.assert_allclose(down, [7.0, 8.0], rtol=1e-12)
    plant.output_trigger(1, 0.0)
    assert lines.last.outputs == [], "the device triggers by itself"
    plant.close()


def test_a_reading_is_found_for_a_curved_sensor():
    curved = SensorCalibrationParameters(unit="V", scale=1e-5, minimum=-1.0, maximum=5.0, polynomial=(0.1, 1.0, 0.05))
    sensor = SensorCalibration(curved, 1e-3)
    for reading in (-0.5, 0.0, 1.0, 4.5):
        assert sensor.reading(sensor.step(reading)) == pytest.approx(reading, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("can", "source", "changes", "said"),
    [
        ({}, None, {}, "the device has no output for triggers; set trigger_output: false"),
        (
            {"trigger_rate": 500.0},
            None,
            {},
            r"at most 500 triggers/s, but triggers.rate = 0 \(at most one per sample\) allows 3000; "
            "set triggers.rate: 500",
        ),
        (
            {"trigger_rate": 500.0},
            {"triggers__positions": (1e-6,), "triggers__rate": 800.0},
            {},
            "outputs at most 500 triggers/s, but triggers.rate = 800 allows 800; set triggers.rate: 500",
        ),
        (
            {"trigger_rate": 3e3, "compares": True},
            {"triggers__times": (0.1,)},
            {},
            "the device compares positions itself: triggers.positions is empty; give positions",
        ),
        (
            {"trigger_rate": 3e3, "compares": True},
            None,
            {"calibration__sensor__reference": "relative"},
            "compares positions, which are unknown until it is homed; set trigger_output: false",
        ),
        (
            {"trigger_rate": 3e3},
            {"triggers__positions": (1e-6,), "triggers__input__action": "hold"},
            {"trigger_input": True},
            "the device has no trigger input; set trigger_input: false",
        ),
    ],
)
def test_a_device_that_cannot_make_the_triggers_is_refused_before_it_moves(lines, can, source, changes, said):
    lines.can = can
    with pytest.raises(DriverError, match=said):
        plant_of(source, **changes)
    assert not lines.last.outputs and lines.last.compared is None


def test_the_emulated_controller_pulses_where_the_axis_passes_a_grid_in_one_direction():
    bench = Bench("E-727")
    for line in ("CTO 1 2 1 1 3 0 1 1 5 1 8 5 1 9 27.5", "CTO 2 2 1 2 1 5 2 8 25 2 9 2.5", "TRO 1 1 2 1", "SVO 1 1"):
        bench.ask(line)
    assert bench.error() == 0 and bench.ask("TRO?") == "1=1 \n2=1 \n3=0 \n4=0" and bench.ask("CTO? 2 9") == "2 9=2.5"
    lines = bench.controller.lines
    bench.ask("MOV 1 40")
    bench.wait(0.5)
    assert lines["1"].pulses == [5.0, 10.0, 15.0, 20.0, 25.0] and lines["2"].pulses == []
    bench.ask("MOV 1 0")
    bench.wait(0.5)
    assert len(lines["1"].pulses) == 5 and lines["2"].pulses == [25.0, 20.0, 15.0, 10.0, 5.0]
    bench.ask("TRO 1 0")
    bench.ask("MOV 1 40")
    bench.wait(0.5)
    assert len(lines["1"].pulses) == 5
    for wrong, code in (
        ("CTO 9 1 1", OUT_OF_RANGE),
        ("CTO 1 6 1", OUT_OF_RANGE),
        ("TRO 1", WRONG_COUNT),
        ("CTO 1 1", WRONG_COUNT),
    ):
        bench.ask(wrong)
        assert bench.error() == code
    bench.controller.inputs["3"] = True
    assert bench.ask("DIO? 3") == "3=1"


@pytest.fixture
def stand():
    with serving_stand() as stand:
        yield stand


def test_the_driver_of_a_controller_lets_it_compare_from_the_first_voltage_until_it_is_safe(stand):
    device = stand.open(mode="servo", servo_scale=1e-6, trigger_line_up=2, trigger_line_down=1)
    assert device.capabilities.compares and device.capabilities.trigger_rate == pytest.approx(0.5 / CYCLE)
    positions = [5e-6, 10e-6, 15e-6]
    device.compare(positions, positions)
    lines = stand.controller.lines
    assert not lines["1"].on and not lines["2"].on
    device.write([0.0])
    until(lambda: lines["1"].on and lines["2"].on)
    device.write([20.0])
    until(lambda: device.read()[0] > 18e-6)
    assert lines["2"].pulses == [5.0, 10.0, 15.0] and not lines["1"].pulses
    device.write([0.0])
    until(lambda: device.read()[0] < 2e-6)
    np.testing.assert_allclose(lines["1"].pulses, [15.0, 10.0, 5.0])
    device.make_safe()
    assert not lines["1"].on and not lines["2"].on
    device.write([1.0])
    until(lambda: lines["1"].on and lines["2"].on)
    device.close()
    assert not lines["1"].on and not lines["2"].on


def test_a_controller_that_cannot_compare_these_positions_says_so(stand, monkeypatch):
    device = stand.open(trigger_line_up=1)
    grid = [1e-6, 2e-6, 3e-6]
    for up, down, said in (
        (grid, grid, "must trigger during motion down, but gcs.trigger_line_down is 0; give the digital output"),
        ([1e-6, 2e-6, 4e-6], [], "compares only equally spaced positions, at least two; give a grid: triggers.start"),
        ([1e-6], [], "compares only equally spaced positions, at least two"),
    ):
        with pytest.raises(DriverError, match=said):
            device.compare(up, down)
    # positions far from zero that were rounded to single precision are a grid
    device.compare(np.float32(1e-3) + np.arange(10, dtype=np.float32) * np.float32(1e-6), [])
    device.close()
    monkeypatch.delitem(COMMANDS, "TRO")
    with pytest.raises(DriverError, match="does not know TRO; set gcs.trigger_line_up"):
        stand.open(trigger_line_up=1)


def test_rising_edges_at_a_digital_input_of_a_controller_are_pulses(stand):
    stand.controller.inputs["2"] = True
    device = stand.open(trigger_input=2)
    counts = []
    for high in (True, False, True, True, False, True):
        stand.controller.inputs["2"] = high
        device.read()
        counts.append(device.pulses())
    assert counts == [0, 0, 1, 0, 0, 1] and device.capabilities.trigger_input
    device.close()


def test_the_software_trigger_of_a_tree_of_iio_devices_is_fired(tmp_path):
    given = EmulatedConvertersParameters(directory=str(tmp_path / "iio"))
    with start(given, DeviceBench()) as running:
        from hysteresis_ros.hardware.device import Device

        asked: IioParameters = replace(running.driver, trigger=TRIGGER)
        fired = tmp_path / "iio" / "trigger0" / "trigger_now"
        device = Device(DRIVERS["iio"], asked, RATE)
        assert device.capabilities.trigger_rate > 0.0 and fired.read_text().strip() == ""
        device.output_trigger(1, 0.0)
        assert fired.read_text().strip() == "1"
        fired.unlink()
        with pytest.raises(DriverError, match="IIO trigger trigger0 does not accept the value 1 at trigger_now"):
            device.output_trigger(2, 0.0)
        device.close()
        with pytest.raises(DriverError, match="has no file trigger_now; choose a trigger of iio-trig-sysfs"):
            Device(DRIVERS["iio"], asked, RATE)
        with pytest.raises(
            DriverError, match=r"is absent; there are trigger0 \(emulated-trigger\); load iio-trig-sysfs"
        ):
            Device(DRIVERS["iio"], replace(asked, trigger="sysfstrig7"), RATE)
        device = Device(DRIVERS["iio"], running.driver, RATE)
        assert device.capabilities.trigger_rate == 0.0
        device.close()
