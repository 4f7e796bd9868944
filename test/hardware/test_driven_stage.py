# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage whose axes are devices: two stages of examples/c_stage, each a process with its own clock and watchdog."""

from __future__ import annotations

import contextlib
import signal
from dataclasses import replace

import numpy as np
import pytest
from stage_support import built, needs_compiler, running_stage
from waiting import until

from hysteresis_ros import signals
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.loop.device import fused_plant_of
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.plant import DEVICE_FAILED, PARTNER_LOST
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage, stage_differences
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.recordings.dataset import Recording

STAGE = """
/stage:
  ros__parameters:
    axes: ["x", "y"]
    sensor_matrix: [1.0, -0.04, -0.02, 1.0]
    decoupling: [1.0, -0.05, -0.03, 1.0]
    structure: {{inputs: 2, outputs: 2, A: [0.5, 0.0, 0.0, 0.5], B: [0.5, 0.0, 0.0, 0.5], C: [1.0, 0.04, 0.02, 1.0],
      sample_time: 1.0e-3}}
/**:
  ros__parameters: {{sample_rate: 1000.0, time_mode: {mode}}}
/**/plant_simulator:
  ros__parameters:
    driver: {driver}
    late_limit: -1
    safe_slew_rate: 5.0e+4
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
/**/reference_generator:
  ros__parameters: {{minimum: 0.0, maximum: 10.0e-6, initial_setpoint: 4.0e-6}}
/**/motion_controller:
  ros__parameters: {{type: open_loop}}
/**/hysteresis_compensator:
  ros__parameters:
    inverse: {{type: none}}
    safe_slew_rate: 5.0e+4
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
/x/**:
  ros__parameters: {{joint: slide_x}}
/y/**:
  ros__parameters: {{joint: slide_y}}
/x/plant_simulator:
  ros__parameters: {{{x}}}
/y/plant_simulator:
  ros__parameters: {{{y}}}
/x/reference_generator:
  ros__parameters: {{waveform: {{type: sine, amplitude: 3.0e-6, frequency: 5.0}}}}
"""
#: A watchdog long enough for a busy machine.
PATIENT = ("--watchdog", "20", "--rate", "5000")


def parameters(driver, x: str = "", y: str = "", mode: str = "fused") -> StageParameters:
    """Return the parameters of the stage; ``x`` and ``y`` are further parameters of the two plants."""
    text = STAGE.format(driver=driver, mode=mode, x=x, y=y)
    return StageParameters.from_configuration(parse_configuration(text, "test"))


@contextlib.contextmanager
def running(samples: int = 0):
    """Yield the fused loop of a stage with a driver in Python and a device, its stage, and the device's process."""
    with running_stage(*PATIENT) as device:
        given = parameters(built() / "libstage.so", "driver: simulated", f"driver_options: ['name={device.name}']")
        ranges = zip(given.axes, given.travel(), strict=True)
        stage = Stage(given, [fused_plant_of(axis.plant_simulator, travel=travel) for axis, travel in ranges])
        try:
            yield FusedLoop(stage, samples=samples), stage, device
        finally:
            for plant in stage.plants:
                with contextlib.suppress(DriverError):  # it was killed
                    plant.make_safe()
                plant.close()


def recorded(loop, readers) -> Recording:
    """Return what the readers of the axes of a loop have read, as a recording of the stage."""
    names = [signal_.name for signal_ in signals.ACTUATOR.row]
    axes = {}
    for place, (name, reader) in enumerate(zip(loop.axis.names, readers, strict=True)):
        table = reader.take().table
        metadata = {"changes": [change._asdict() for change in loop.changes_of(place)]}
        columns = dict(zip(names, map(np.ascontiguousarray, table), strict=True))
        axes[name] = Recording(np.arange(table.shape[1]) / 1000.0, columns, metadata=metadata)
    return Recording.of_axes(axes, {})


@pytest.mark.slow
@needs_compiler
@pytest.mark.skipif(not COMPILED, reason="without Numba the loop is too slow for a stage")
def test_a_fused_stage_of_devices_is_repeated_bit_for_bit():
    with running(samples=1200) as (loop, stage, _):
        readers = [loop.reader(place) for place in (0, 1)]
        loop.start()
        assert loop.join(60.0) and not loop.failure and not any(plant.failure for plant in stage.plants)
        assert loop.patience > 1.0, "drivers in Python have time-outs of their own"
        run = recorded(loop, readers)
        # each device got its own voltage, with the decoupling, once it has returned from its safe voltage
        x, y = (run[f"{name}/voltage"][1000:] for name in "xy")
        used = np.flatnonzero(run["x/skipped"][1000:] == 0.0)
        command = [run[f"{name}/command"][1000:][used] for name in "xy"]
        np.testing.assert_allclose(x[used], 1e7 * (command[0] - 0.05 * command[1]), atol=0.02)
        np.testing.assert_allclose(y[used], 1e7 * (command[1] - 0.03 * command[0]), atol=0.02)
        # and the sensor matrix gives the degrees of freedom; half of the device's play of 5 V is left open
        seen = run["y/measured"][1000:]
        rest = 1e-7 * (run["y/voltage"][1000:] - 0.02 * run["x/voltage"][1000:])
        assert np.nanmax(np.abs(seen - rest)) < 1e-6 and np.nanmax(run["x/measured"]) > 4e-6
        assert stage_differences(run, loop.axis.parameters) == {}
        # a twin that reads the sensors in another order differs
        other = replace(loop.axis.parameters, stage=replace(loop.axis.parameters.stage, decoupling=()))
        assert stage_differences(run, other)


@needs_compiler
@pytest.mark.skipif(not COMPILED, reason="without Numba the loop is too slow for a stage")
def test_a_device_that_fails_stops_the_stage_and_the_other_device_goes_to_safe():
    with running() as (loop, stage, device):
        readers = [loop.reader(place) for place in (0, 1)]
        loop.start()
        until(lambda: loop.sample > 100 or loop.failure, what="samples")
        device.process.send_signal(signal.SIGKILL)
        until(lambda: stage.plants[1].tripped and stage.plants[0].tripped, what="both stopped")
        until(lambda: abs(stage.plants[0].held()) < 1e-9, what="the safe voltage of the other device")
        count = loop.sample
        until(lambda: loop.sample > count + 20, what="samples at rest")
        loop.leave()
        run = recorded(loop, readers)
        assert run["y/tripped"][-1] == DEVICE_FAILED and run["x/tripped"][-1] == PARTNER_LOST
        assert run["x/plant_voltage"][-1] == 0.0 and "has died" in stage.plants[1].failure
        assert stage.plants[0].stopped_with_stage and not stage.plants[1].stopped_with_stage
        assert stage_differences(run, loop.axis.parameters) == {}


def test_without_its_devices_the_stage_is_simulated_with_its_structure():
    given = parameters("simulated", mode="realtime")
    run = simulate_stage(given.scanning([]), setpoints={"x": [4e-6], "y": [4e-6]}, duration=0.4)
    # C times the decoupling, which is not quite its inverse
    pose = np.array([[1.0, -0.04], [-0.02, 1.0]]) @ [[1.0, 0.04], [0.02, 1.0]] @ [[1.0, -0.05], [-0.03, 1.0]]
    command = [run[f"{name}/command"][-1] for name in "xy"]
    np.testing.assert_allclose([run["x/displacement"][-1], run["y/displacement"][-1]], pose @ command, rtol=0.02)


def test_an_axis_without_a_driver_beside_one_with_a_driver_is_refused():
    with pytest.raises(ParameterError, match="/y/plant_simulator: driver = .*/x has the driver simulated: give"):
        parameters("simulated", y="driver: ''", mode="realtime")


def test_the_clock_of_a_stage_by_messages_is_refused_at_its_devices():
    with pytest.raises(ParameterError, match="/x/plant_simulator: scan_clock = True: .* give time_mode: fused, or"):
        parameters("simulated", x="scan_clock: true", mode="realtime")
