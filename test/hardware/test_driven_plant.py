# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A device as plant: it behaves like the simulated plant, is monitored like it, and may fail."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from driven_support import Device, parameters, run
from waiting import until

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.hardware.driver import Capabilities, DriverError
from hysteresis_ros.loop.device import DrivenPlant, plant_of
from hysteresis_ros.loop.parameters import PlantNodeParameters
from hysteresis_ros.loop.plant import DEVICE_FAILED
from hysteresis_ros.loop.watch import STALE, TRIPPED


def test_behind_a_driver_the_simulated_actuator_is_the_same_bit_for_bit():
    k = np.arange(5000)
    voltages = 45.0 + 90.0 * np.sin(k / 40.0) + np.random.default_rng(2).normal(scale=3.0, size=k.size)
    voltages[k % 7 == 3] = math.nan
    voltages[2000:3900] = math.nan  # beyond voltage_timeout
    chosen = parameters()
    driven, simulated = (run(plant_of(replace(chosen, driver=name)), voltages) for name in ("simulated", ""))
    there = [at.MEASURED, at.PLANT_MODE, at.TRIPPED, at.LATE]
    assert driven[:, there].tolist() == simulated[:, there].tolist()
    assert np.ptp(driven[:, at.MEASURED]) > 5e-6 and STALE in driven[:, at.PLANT_MODE]
    # the grid of the converter depends on the device only
    grid = 150.0 / (2**12 - 1)
    assert np.max(np.abs(driven[:, at.PLANT_VOLTAGE] - simulated[:, at.PLANT_VOLTAGE])) <= 0.5001 * grid
    assert np.all(np.isnan(driven[:, at.DISPLACEMENT]))


def test_every_voltage_keeps_range_and_slew_of_the_file(device):
    chosen = parameters(limits__minimum=-5.0, limits__maximum=80.0)
    plant = DrivenPlant(chosen)
    run(plant, np.random.default_rng(3).choice([-500.0, 40.0, 500.0, math.nan], size=2000))
    heard = np.array(device.last.heard)
    assert heard.min() == -5.0 and heard.max() == 80.0
    assert np.max(np.abs(np.diff(heard))) <= 4.0e4 / chosen.sample_rate * (1 + 1e-12)
    assert plant.limited_samples > 100


@pytest.mark.parametrize(("call", "said"), [("read", "read"), ("write", "written")])
def test_a_device_that_fails_is_made_safe_and_left_alone_until_start(device, call, said):
    plant = DrivenPlant(parameters(safe_voltage=5.0))
    run(plant, [60.0] * 50)
    device.failing = call
    rows = run(plant, [60.0] * 20)
    assert plant.tripped and plant.failure.startswith(f"driver simulated: cannot be {said}: OSError: unplugged")
    assert rows[-1, at.TRIPPED] == DEVICE_FAILED and rows[-1, at.PLANT_MODE] == TRIPPED
    assert math.isnan(rows[-1, at.MEASURED]) and rows[-1, at.PLANT_VOLTAGE] == 5.0
    assert device.last.heard.count("safe") == 1 and device.last.heard[-1] == "safe"
    device.failing = ""
    assert np.isnan(run(plant, [60.0] * 20)[:, at.MEASURED]).all(), "the device recovered without ~/start"
    plant.start()
    back = run(plant, [60.0] * 400)
    assert not plant.tripped and plant.failure == "" and np.isfinite(back[:, at.MEASURED]).all()
    # from the safe voltage, at the safe slew rate
    assert np.max(np.diff(back[:, at.PLANT_VOLTAGE], prepend=5.0)) <= 1000.0 / 3000.0 * (1 + 1e-9)
    assert back[-1, at.PLANT_VOLTAGE] == 60.0


def test_a_device_that_cannot_be_made_safe_either_is_said_to_be_so(device):
    plant = DrivenPlant(parameters())
    device.failing = "read safe"
    run(plant, [1.0] * 3)
    assert plant.failure.endswith("the device cannot be made safe: OSError: silent")
    with pytest.raises(DriverError, match="cannot be made safe"):
        plant.make_safe()


def test_a_device_that_could_not_be_made_safe_is_made_safe_as_soon_as_it_can_be_unasked(device):
    plant = DrivenPlant(parameters(safe_voltage=5.0))
    plant.insists_every = 0.01
    run(plant, [60.0] * 50)
    device.failing = "read safe"
    run(plant, [60.0] * 3)
    heard = device.last.heard
    attempts = heard.count("safe")
    until(lambda: heard.count("safe") > attempts + 3, what="further attempts")
    assert "still at 60 V" in plant.failure and plant.held() == 60.0
    device.failing = "read"
    until(lambda: "still" not in plant.failure, what="the end of the message")
    assert "unplugged" in plant.failure and plant.tripped and plant.held() == 5.0
    assert run(plant, [60.0])[0, at.PLANT_VOLTAGE] == 5.0
    attempts = heard.count("safe")
    pause = threading.Event()
    assert not pause.wait(0.1) and heard.count("safe") == attempts, "a safe device is not called"


@pytest.mark.parametrize("seen", ["start", "reset", "close"])
def test_a_device_that_a_person_has_seen_is_not_made_safe_behind_their_back(device, seen):
    plant = DrivenPlant(parameters())
    plant.insists_every = 0.01
    run(plant, [60.0] * 50)
    device.failing = "read safe"
    run(plant, [60.0] * 3)
    heard = device.last.heard
    until(lambda: heard.count("safe") > 4, what="further attempts")
    device.failing = "" if seen != "close" else "safe"
    getattr(plant, seen)()
    after = heard.count("safe")
    if seen != "close":
        run(plant, [60.0] * 400)
        assert plant.held() == 60.0
    pause = threading.Event()
    assert not pause.wait(0.1) and heard.count("safe") == after


@pytest.mark.parametrize(("begun", "safe"), [(60.0, 5.0), (-20.0, 5.0), (12.1, 12.0)])
def test_each_step_to_the_safe_voltage_is_one_of_the_safe_slew_rate_and_the_last_is_there(device, begun, safe):
    plant = DrivenPlant(parameters(safe_voltage=safe, limits__minimum=-30.0))
    run(plant, [begun] * 200)
    heard = device.last.heard
    heard.clear()
    while plant.step_to_safe():
        assert len(heard) < 10_000
    step = 1000.0 / 3000.0  # safe_slew_rate over sample_rate
    whole = math.floor(abs(safe - begun) / step)
    expected = [begun + math.copysign(step, safe - begun) * (k + 1) for k in range(whole)]
    np.testing.assert_allclose(heard[:whole], expected, rtol=0.0, atol=1e-9)
    assert heard[-1] == safe and len(heard) - whole in (0, 1) and not plant.step_to_safe()


def test_a_device_that_fails_on_its_way_to_safe_is_left_alone(device):
    plant = DrivenPlant(parameters())
    run(plant, [60.0] * 50)
    assert plant.step_to_safe()
    device.failing = "write"
    plant.step_to_safe()
    heard = list(device.last.heard)
    assert heard[-1] == "safe" and plant.failure
    device.failing = ""
    assert not plant.step_to_safe() and device.last.heard == heard


def test_at_the_end_it_goes_to_its_safe_voltage_step_by_step(device):
    chosen = parameters(safe_voltage=5.0)
    plant = DrivenPlant(chosen)
    run(plant, [60.0] * 50)
    before, steps = device.last.heard[-1], 0
    while plant.step_to_safe():
        steps += 1
    assert before == 60.0 and device.last.heard[-1] == 5.0
    assert steps == pytest.approx(55.0 / 1000.0 * chosen.sample_rate, abs=1.5)
    plant.make_safe()
    assert device.last.heard[-1] == "safe" and not plant.step_to_safe()


def test_a_reset_does_not_make_the_voltage_jump(device):
    plant = DrivenPlant(parameters())
    run(plant, [60.0] * 50)
    plant.reset()
    rows = run(plant, [math.nan] * 10 + [0.0] * 400)
    voltages = np.append(60.0, rows[:, at.PLANT_VOLTAGE])
    assert np.max(np.abs(np.diff(voltages))) <= 1000.0 / 3000.0 * (1 + 1e-9) and voltages[-1] == 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joints": 2}, "has 2 joints; an axis has 1"),
        ({"voltages": 0}, "has no voltage output"),
        ({"minimum": 0.0}, r"range of 0 … 120 V does not contain limits\.minimum … limits\.maximum = -30 … 120 V"),
        ({"maximum": math.nan}, "range of -30 … nan V"),
        ({"highest_rate": 1000.0}, "supports at most 1000 Hz; lower sample_rate"),
        ({"watchdog": 1e-4}, "watchdog of 0.0001 s is not longer than a sample"),
    ],
)
def test_a_device_that_is_not_what_the_axis_needs_is_refused(device, monkeypatch, changes, words):
    can = Capabilities(1, 1, -30.0, 120.0, 10_000.0, 0.1)
    monkeypatch.setattr(Device, "can", can)
    DrivenPlant(parameters()).close()
    monkeypatch.setattr(Device, "can", replace(can, **changes))
    with pytest.raises(DriverError, match=f"driver simulated: the device.*{words}"):
        DrivenPlant(parameters())


def test_a_device_has_its_own_converter_also_after_a_change_of_its_limits(device):
    chosen = parameters(limits__bits=6)
    plant = DrivenPlant(chosen)
    for _ in range(2):  # the grid of 6 bits is coarser than a volt
        assert run(plant, [30.123] * 400)[-1, at.PLANT_VOLTAGE] == device.last.heard[-1] == 30.123
        plant.retune(chosen)


def test_limits_change_live_within_the_devices_range_and_what_it_was_opened_with_does_not(device):
    chosen = parameters()
    plant = DrivenPlant(chosen)
    plant.retune(replace(chosen, limits=replace(chosen.limits, maximum=50.0), voltage_timeout=0.1))
    assert run(plant, [100.0] * 20)[-1, at.PLANT_VOLTAGE] == 50.0
    with pytest.raises(ParameterError, match=r"limits\.maximum = 500\.0: must lie within the device's range"):
        plant.retune(replace(chosen, limits=replace(chosen.limits, maximum=500.0)))
    with pytest.raises(ParameterError, match=r"sensor\.noise = 0\.0: the driver simulated is open"):
        plant.retune(replace(chosen, sensor=replace(chosen.sensor, noise=0.0)))
    assert run(plant, [100.0] * 20)[-1, at.PLANT_VOLTAGE] == 50.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"driver": "simulatd"}, "driver = 'simulatd': unknown choice.*did you mean simulated"),
        ({"real_time_factor": 0.5}, "real_time_factor = 0.5: must be 1 with a driver"),
        ({"time_mode": "lockstep"}, "driver = 'simulated': a device does not wait for nodes: give time_mode"),
    ],
)
def test_what_a_driver_cannot_do_is_refused_before_it_is_opened(device, changes, words):
    with pytest.raises(ParameterError, match=words):
        parameters(**changes)


def test_an_inchworm_motor_has_no_driver():
    changes = {"driver": "simulated", "real_time_factor": 1.0, "time_mode": "realtime"}
    given = load_configuration("inchworm_travel").override("plant_simulator", **changes).node("plant_simulator")
    with pytest.raises(ParameterError, match=r"driver = 'simulated': drives one actuator .*; an inchworm motor needs"):
        PlantNodeParameters.from_mapping(given)
