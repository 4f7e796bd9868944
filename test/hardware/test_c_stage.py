# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The driver in C of examples/c_stage, whose stage is a separate process with its own clock and watchdog."""

from __future__ import annotations

import ctypes
import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from stage_support import HEADERS, built, compile_c, needs_compiler, running_stage
from waiting import until

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.library import _Capabilities
from hysteresis_ros.hardware.registry import driver_of, options_of
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.device import DrivenPlant, fused_plant_of
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.parameters import AxisParameters

pytestmark = needs_compiler

#: No pulse comes. With its trigger input the axis has the loop with triggers, which all devices of the tests share.
AXIS = """
/**:
  ros__parameters: {{sample_rate: 1000.0, time_mode: realtime}}
/**/plant_simulator:
  ros__parameters:
    driver: {driver}
    driver_options: ['name={name}']
    late_limit: -1
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
/**/reference_generator:
  ros__parameters:
    minimum: 0.0
    maximum: 10.0e-6
    initial_setpoint: 4.0e-6
    waveform: {{type: sine, amplitude: 3.0e-6, frequency: 5.0}}
    triggers: {{input: {{action: hold}}}}
/**/motion_controller:
  ros__parameters: {{type: open_loop}}
/**/hysteresis_compensator:
  ros__parameters:
    inverse: {{type: none}}
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
"""

#: A watchdog long enough for a busy machine.
PATIENT = ("--watchdog", "20", "--rate", "5000")


def axis_parameters(name: str, file: str = "libstage.so", **changes) -> AxisParameters:
    text = AXIS.format(driver=built() / file, name=name)
    return AxisParameters.from_configuration(parse_configuration(text, "test").override("plant_simulator", **changes))


def opened(name: str, *options: str) -> Device:
    declared = driver_of(str(built() / "libstage.so"))
    return Device(declared, options_of(declared, (f"name={name}", *options)), 1000.0)


def await_position(device: Device, wanted: float) -> None:
    """Wait until the stage has reached a position [m]."""
    until(lambda: math.isclose(device.read()[0], wanted, abs_tol=2e-8), what=f"the stage at {wanted} m", every=0.002)


@pytest.mark.slow
def test_the_stage_has_hysteresis_and_moves_in_its_own_time():
    with running_stage(*PATIENT) as stage:
        device = opened(stage.name)
        # gain times the mean of voltage and play, whose half width is 5 V
        for voltage, resting in ((100.0, 97.5), (50.0, 52.5), (53.0, 54.0), (0.0, 2.5)):
            device.write([voltage])
            await_position(device, 1e-7 * resting)
        device.close()


@pytest.mark.slow
@pytest.mark.parametrize("driver", ["libstage.so", "stage.py"])
def test_a_fused_axis_runs_it_against_the_clock_and_its_twin_is_the_same_bit_for_bit(driver):
    with running_stage(*PATIENT) as stage:
        given = axis_parameters(stage.name, driver)
        axis = Axis(given, fused_plant_of(given.plant_simulator))
        loop = FusedLoop(axis, samples=600)
        loop.start()
        assert loop.join(60.0) and not loop.failure and not axis.plant.failure
        table = loop.take().table
        assert table.shape[1] == 600 and np.nanmax(table[at.MEASURED]) > 4e-6
        twin = Axis(given, fused_plant_of(given.plant_simulator, linked=False))
        answers = {"measured": table[at.MEASURED], "tripped": table[at.TRIPPED]}
        again = twin.run(table[at.SETPOINT], skipped=table[at.SKIPPED], answers=answers)
        for place, signal_ in enumerate(at.ACTUATOR.row):
            np.testing.assert_array_equal(again[signal_.name], table[place], err_msg=signal_.name)
        axis.plant.make_safe()
        axis.plant.close()


@pytest.mark.slow
def test_two_masters_are_refused_and_the_first_goes_on():
    with running_stage(*PATIENT) as stage:
        first = opened(stage.name)
        with pytest.raises(DriverError, match=f"stage {stage.name} has another master, process {os.getpid()}; end"):
            opened(stage.name)
        first.write([40.0])
        await_position(first, 3.75e-6)
        first.close()
        opened(stage.name).close()


@pytest.mark.slow
def test_a_stage_that_is_not_there_is_named_and_exit_code_2_follows(tmp_path):
    path = tmp_path / "axis.yaml"
    path.write_text(AXIS.format(driver=built() / "libstage.so", name="/nowhere_at_all"))
    command = [sys.executable, "-m", "hysteresis_ros.nodes.plant_simulator", "--ros-args", "--params-file", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2, done.stderr
    assert "cannot be opened: libstage.so: stage /nowhere_at_all is not there; start `stage_device" in done.stderr


def fail_fused(stage, number: int) -> tuple[Axis, np.ndarray]:
    """Run a fused axis, send the stage a signal, and wait until the axis has stopped."""
    given = axis_parameters(stage.name)
    axis = Axis(given, fused_plant_of(given.plant_simulator))
    loop = FusedLoop(axis)
    loop.start()
    until(lambda: loop.sample >= 200, what="200 samples")
    assert not axis.plant.tripped, axis.plant.failure
    stage.process.send_signal(number)
    until(lambda: axis.plant.tripped, what="the trip")
    loop.leave()
    assert axis.plant.tripped and not loop.failure
    return axis, loop.take().table


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "said"),
    [
        (signal.SIGKILL, "cannot be read: libstage.so: the process of stage {name} has died; start"),
        (signal.SIGSTOP, "cannot be read: libstage.so: the process of stage {name} has stopped; check stage_device"),
        (signal.SIGUSR1, "returns a position that is not a number; check the sensor and its scaling"),
    ],
)
def test_a_stage_that_dies_stands_still_or_answers_nonsense_stops_the_axis(number, said):
    with running_stage(*PATIENT) as stage:
        axis, table = fail_fused(stage, number)
        assert said.format(name=stage.name) in axis.plant.failure
        first = int(np.flatnonzero(table[at.TRIPPED])[0])
        # a stage that has died cannot be made safe: the recorded voltage is that at which it was left
        left = table[at.PLANT_VOLTAGE, first - 1] if number == signal.SIGKILL else 0.0
        assert np.isnan(table[at.MEASURED, first:]).all() and set(table[at.PLANT_VOLTAGE, first:]) == {left}
        assert np.all((table[at.PLANT_VOLTAGE] >= 0.0) & (table[at.PLANT_VOLTAGE] <= 100.0))
        axis.plant.close()


@pytest.mark.slow
def test_after_nonsense_the_axis_goes_on_when_it_is_started():
    with running_stage(*PATIENT) as stage:
        axis, _ = fail_fused(stage, signal.SIGUSR1)
        stage.process.send_signal(signal.SIGUSR1)
        axis.plant.start()
        loop = FusedLoop(axis)
        loop.start()

        def goes_on() -> bool:
            assert not loop.failure, axis.plant.failure
            axis.plant.start()  # the stage may not have received the signal yet
            return not axis.plant.tripped and loop.latest()[1][at.MEASURED] >= 2e-6

        until(goes_on, what="an axis that goes on")
        loop.leave()
        axis.plant.close()


def test_without_voltages_its_watchdog_puts_out_the_safe_one_and_takes_none_until_it_was_made_safe():
    with running_stage("--watchdog", "0.2", "--rate", "5000") as stage:
        device = opened(stage.name)
        device.write([100.0])
        await_position(device, 9.75e-6)
        await_position(device, 0.25e-6)  # nobody wrote a voltage
        with pytest.raises(DriverError, match=f"the watchdog of stage {stage.name} has output the safe voltage"):
            device.write([100.0])
        device.make_safe()
        device.write([100.0])
        await_position(device, 9.75e-6)
        device.close()


MASTER = """
import sys
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.library import _Capabilities
from hysteresis_ros.hardware.registry import driver_of, options_of
declared = driver_of(sys.argv[1])
device = Device(declared, options_of(declared, (sys.argv[2],)), 1000.0)
while device.read()[0] < 9.7e-6:  # what stays at 0 V depends on how far it went
    device.write([100.0])
print("open", flush=True)
while True:
    device.write([100.0])
"""


@pytest.mark.slow
def test_when_the_master_is_killed_the_watchdog_acts_and_the_next_one_may_come():
    with running_stage("--watchdog", "0.5", "--rate", "5000") as stage:
        command = [sys.executable, "-c", MASTER, str(built() / "libstage.so"), f"name={stage.name}"]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as master:
            assert master.stdout.readline() == b"open\n"
            with pytest.raises(DriverError, match=f"has another master, process {master.pid};"):
                opened(stage.name)
            master.kill()
            master.wait()
        device = opened(stage.name)
        await_position(device, 0.25e-6)
        device.write([0.0])
        await_position(device, 0.25e-6)
        device.close()


def test_message_by_message_the_same_library_is_called_through_python():
    with running_stage(*PATIENT) as stage:
        plant = DrivenPlant(axis_parameters(stage.name).plant_simulator)
        row = [0.0] * at.MOTOR_ROW
        patience = time.monotonic() + 60.0
        while row[at.MEASURED] < 3.7e-6:
            plant.sense(row)
            row[at.VOLTAGE] = 40.0
            plant.actuate(row)
            assert time.monotonic() < patience and not plant.failure
        plant.make_safe()
        plant.close()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"driver_options": ("depth=2",)}, r"driver_options: depth = '2': unknown parameter"),
        ({"driver_options": ("name",)}, r"driver_options = 'name': write NAME=VALUE with a string"),
        ({"driver_options": ("standstill=soon",)}, "standstill=soon': write NAME=VALUE with a double in 0.001"),
        ({"driver": "/nowhere/driver.py"}, "driver /nowhere/driver.py does not exist; give the path"),
        ({"driver": "/nowhere/lib.so"}, "library /nowhere/lib.so does not exist; build it"),
        (
            {"driver": "/nowhere/driver"},
            "driver /nowhere/driver is neither a Python file nor a shared library; give a Python file",
        ),
        ({"driver": str(HEADERS / "errors.py")}, "does not exist"),
        ({"driver": str(HEADERS / "device.py")}, "declares no driver: DRIVER is None; DRIVER = HardwareDriver"),
        ({"driver": "simulated"}, "driver_options = .*belong to a driver given by its path"),
    ],
)
def test_what_a_path_does_not_lead_to_is_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        axis_parameters("/stage", "stage.py", **changes)


def test_what_is_no_library_is_refused(tmp_path):
    (tmp_path / "lib.so").write_text("text")
    with pytest.raises(DriverError, match=f"library {tmp_path}/lib.so cannot be loaded .*; build it for this machine"):
        driver_of(str(tmp_path / "lib.so"))


def test_the_structure_of_the_header_is_that_of_python(tmp_path):
    (tmp_path / "size.c").write_text(
        '#include "hysteresis_driver.h"\n#include <stddef.h>\n#include <stdio.h>\nint main(void) { printf("%zu %zu",'
        " sizeof(struct hysteresis_capabilities), offsetof(struct hysteresis_capabilities, voltage_unit)); }\n"
    )
    program = compile_c(tmp_path / "size.c", tmp_path / "size")
    size, offset = map(int, subprocess.run([program], capture_output=True, check=True).stdout.split())
    assert (ctypes.sizeof(_Capabilities), _Capabilities.voltage_unit.offset) == (size, offset)
