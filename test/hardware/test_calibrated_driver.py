# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A driver in volts or counts: displacement in m, volts at the actuator; in Python and in machine code."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from plant_rows import rows_of
from stage_support import listed_library, needs_compiler

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.loop.axis import Axis, Change, sample_times
from hysteresis_ros.loop.device import CompiledPlant, DrivenPlant, fused_plant_of
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.plant import FINDING_HOME
from hysteresis_ros.loop.simulation import differences
from hysteresis_ros.recordings.dataset import Recording

pytestmark = needs_compiler

#: The library reads 1e-7 times its voltage. After it come an amplifier of 20 V/V with inverted sign and a nonlinearity,
#: and a sensor in volts with inverted sign and a nonlinearity.
#: No pulse comes. With its trigger input the axis has the loop with triggers, which all devices of the tests share.
CALIBRATED = """
/**:
  ros__parameters: {{sample_rate: 3000.0, time_mode: realtime}}
/**/plant_simulator:
  ros__parameters:
    driver: {driver}
    driver_options: [unit=V]
    safe_voltage: 5.0
    overtravel: -1.0
    limits: {{minimum: 0.0, maximum: 100.0, slew_rate: 6.0e+4}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
    calibration:
      sensor: {{unit: V, scale: 20.0, sign: -1, offset: 1.0e-6, polynomial: [0.0, 1.0, 4.0e+4],
                minimum: -1.0e-5, maximum: 1.0e-5}}
      amplifier: {{scale: 20.0, sign: -1, offset: 2.0, polynomial: [0.0, 1.0, 0.02]}}
/**/reference_generator:
  ros__parameters:
    minimum: 0.0
    maximum: 10.0e-6
    initial_setpoint: 4.0e-6
    waveform: {{type: sine, amplitude: 3.0e-6, frequency: 20.0}}
    triggers: {{input: {{action: hold}}}}
/**/motion_controller:
  ros__parameters: {{type: open_loop}}
/**/hysteresis_compensator:
  ros__parameters:
    inverse: {{type: none}}
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return listed_library(tmp_path_factory.mktemp("driver"))


def axis_parameters(library, **changes) -> AxisParameters:
    configuration = parse_configuration(CALIBRATED.format(driver=library), "test")
    return AxisParameters.from_configuration(configuration.override("plant_simulator", **changes))


def told(voltage):
    """Return the voltage for the library that gives a voltage at the actuator."""
    u = (voltage - 2.0) / -20.0
    return u + 0.02 * u**2


def displacement(reading):
    return -20.0 * (reading + 4.0e4 * reading**2) + 1.0e-6


def run(plant, voltages) -> np.ndarray:
    return rows_of(plant, CompiledPlant.kernels[:1], voltages)


@pytest.mark.slow
def test_fused_and_in_python_it_is_told_and_understood_by_the_same_formula(library):
    given = axis_parameters(library)
    loop = FusedLoop(Axis(given, fused_plant_of(given.plant_simulator)), math.inf, 3000)
    loop.start()
    assert loop.join(60.0) and not loop.failure
    table = loop.take().table
    loop.axis.plant.close()
    voltage, measured = table[at.PLANT_VOLTAGE], table[at.MEASURED]
    assert np.ptp(voltage) > 50.0 and voltage.min() >= 0.0, "the recorded voltage must be that at the actuator"
    np.testing.assert_allclose(measured[1:], displacement(1e-7 * told(voltage[:-1])), rtol=1e-12)
    signals = {signal.name: table[place] for place, signal in enumerate(at.ACTUATOR.row)}
    assert differences(Recording(sample_times(0, 3000, 3000.0), signals, {}, {}), given) == {}
    plant = DrivenPlant(given.plant_simulator)
    plant.reset()  # as a fused axis does before it begins
    rows = run(plant, table[at.VOLTAGE])
    plant.close()
    np.testing.assert_array_equal(rows[:, at.MEASURED], measured)
    np.testing.assert_array_equal(rows[:, at.PLANT_VOLTAGE], voltage)


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_a_reading_out_of_its_range_is_lost_and_named_and_nothing_else_happens(library, kind):
    plant = kind(axis_parameters(library, calibration__sensor__minimum=-3.0e-7).plant_simulator)
    rows = run(plant, [30.0] * 200 + [90.0] * 200 + [30.0] * 200)
    assert np.isfinite(rows[[199, 599], at.MEASURED]).all() and math.isnan(rows[399, at.MEASURED])
    assert not rows[:, at.TRIPPED].any() and not plant.complaint
    run(plant, [90.0] * 200)
    assert "V, beyond calibration.sensor.minimum … maximum = -3e-07 … 1e-05 V" in plant.complaint
    plant.close()


RELATIVE = {"calibration__sensor__reference": "relative", "calibration__sensor__home": 2.0e-6}


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_a_relative_sensor_is_homed_at_the_safe_voltage_at_the_start_and_when_asked(library, kind):
    plant = kind(axis_parameters(library, calibration__sensor__homing_samples=5, **RELATIVE).plant_simulator)
    absolute = displacement(1e-7 * told(np.array([5.0, 60.0])))
    rows = run(plant, [60.0] * 6)
    assert rows[:, at.TRIPPED].tolist() == [FINDING_HOME] * 4 + [0.0, 0.0]
    assert rows[:4, at.PLANT_VOLTAGE].tolist() == [5.0] * 4, "the axis moved during homing"
    rows = rows[:, at.MEASURED]
    assert np.isnan(rows[:5]).all() and np.isfinite(rows[5])
    # the library is at 0 until it receives its first voltage
    first = (4 * absolute[0] + displacement(0.0)) / 5
    step = displacement(1e-7 * told(5.0 + 1000.0 / 3000.0)) - first
    assert rows[5] == pytest.approx(step + 2.0e-6, abs=1e-15)
    run(plant, [60.0] * 400)
    with pytest.raises(
        ParameterError, match=r"voltage = 60\.0: home is the position at safe_voltage = 5 V: stop the axis"
    ):
        plant.home()
    plant.halt()
    run(plant, [60.0])
    with pytest.raises(ParameterError, match="home is the position at safe_voltage"):  # stopped, but not safe yet
        plant.home()
    run(plant, [60.0] * 400)
    plant.start()
    run(plant, [5.0] * 10)
    assert plant.held() == 5.0
    with pytest.raises(ParameterError, match="stop the axis"):  # safe, but not stopped: it may still move
        plant.home()
    assert not plant.sensor.homing
    plant.halt()
    run(plant, [60.0] * 400)
    plant.home()
    assert plant.sensor.homing and plant.halted
    rows = run(plant, [60.0] * 6)[:, at.MEASURED]
    assert np.isnan(rows[:5]).all() and rows[5] == pytest.approx(2.0e-6, abs=1e-18) and plant.halted
    plant.start()
    there = run(plant, [60.0] * 400)[-1, at.MEASURED]
    assert there == pytest.approx(absolute[1] - absolute[0] + 2.0e-6, abs=1e-15)
    plant.close()


def test_homing_a_fused_axis_is_logged_and_its_twin_agrees(library):
    given = axis_parameters(library, **RELATIVE)
    axis = Axis(given, fused_plant_of(given.plant_simulator))
    tables, log = [], []
    for actions in ((), ("halt",), ("home", "start")):
        loop = FusedLoop(axis, math.inf, 600)
        for action in actions:
            loop.apply(Change(0, "plant_simulator", action))
        loop.start()
        assert loop.join(60.0) and not loop.failure
        tables.append(loop.take().table)
        log += [dict(change._asdict()) for change in loop.changes]
    table = np.concatenate(tables, axis=1)
    assert np.flatnonzero(np.isnan(table[at.MEASURED])).tolist() == [*range(10), *range(1200, 1210)]
    assert np.flatnonzero(table[at.TRIPPED] == FINDING_HOME).tolist() == [*range(9), *range(1200, 1209)]
    assert table[at.PLANT_VOLTAGE, :9].tolist() == [5.0] * 9 and np.ptp(table[at.PLANT_VOLTAGE, 1210:]) > 20.0
    assert [entry["action"] for entry in log] == ["halt", "home", "start"]
    signals = {signal.name: table[place] for place, signal in enumerate(at.ACTUATOR.row)}
    assert differences(Recording(sample_times(0, 1800, 3000.0), signals, {}, {"changes": log}), given) == {}
    axis.plant.close()


def test_a_device_that_failed_has_lost_the_zero_of_its_sensor(library):
    given = axis_parameters(library, driver_options=("unit=V", "fail_read=50"), **RELATIVE).plant_simulator
    plant = CompiledPlant(given)
    run(plant, [30.0] * 60)
    assert plant.failure and not plant.sensor.homing
    plant.start()
    assert plant.sensor.homing
    plant.close()


def test_an_absolute_sensor_is_not_homed_and_copies_keep_their_own_zero(library):
    plant = CompiledPlant(axis_parameters(library).plant_simulator)
    with pytest.raises(ParameterError, match="only a relative sensor is homed"):
        plant.home()
    copy.deepcopy(plant).sensor.x[:] = 7.0
    assert not (plant.sensor.x == 7.0).any()
    plant.close()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"calibration__sensor__unit": "mm"}, "the device reads 'V' and outputs 'V'; calibration.sensor.unit is 'mm'"),
        (
            {"calibration__amplifier__scale": 0.5, "calibration__amplifier__polynomial": ()},
            "100 V, which are -196 … 4 V",
        ),
    ],
)
def test_a_device_with_other_units_or_too_small_a_range_is_refused(library, changes, words):
    with pytest.raises((DriverError, ParameterError), match=words):
        CompiledPlant(axis_parameters(library, **changes).plant_simulator)


def test_an_amplifier_that_cannot_be_inverted_within_the_limits_is_refused_before_anything_moves(library):
    with pytest.raises(
        ParameterError, match=r"calibration\.amplifier\.polynomial .* rise everywhere from -4\.9 to 0\.1 V"
    ):
        axis_parameters(library, calibration__amplifier__polynomial=(0.0, 1.0, 0.2))


def test_limits_that_change_live_are_held_against_the_devices_range_in_its_own_unit(library):
    chosen = axis_parameters(library, calibration__amplifier__polynomial=()).plant_simulator
    plant = CompiledPlant(chosen)
    plant.retune(replace(chosen, limits=replace(chosen.limits, maximum=600.0)))
    with pytest.raises(ParameterError, match=r"limits\.maximum = 900\.0: must lie within the device's range of -30 …"):
        plant.retune(replace(chosen, limits=replace(chosen.limits, maximum=900.0)))
    plant.close()
