# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""With separate nodes a bag contains the device's actual input, in lockstep, in real time and with a Python driver."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, shortened, write_axis  # noqa: E402

from hysteresis_ros.analysis.metrics import limited_text  # noqa: E402
from hysteresis_ros.loop.watch import STALE  # noqa: E402

RATE = 100.0
SAMPLES = 200
PLANT = {"voltage_timeout": 0.05, "safe_slew_rate": 40.0, "late_limit": -1}
WAVE = {"waveform__type": "sine", "waveform__amplitude": 3e-6, "waveform__frequency": 1.0, "initial_setpoint": 5e-6}


def axis_of(time_mode, faults, **plant):
    overrides = {"plant_simulator": PLANT | plant, "reference_generator": WAVE}
    overrides["motion_controller"] = {"type": "open_loop"}
    common = {"sample_rate": RATE, "time_mode": time_mode, "faults": list(faults)}
    return shortened(axis_parameters("", overrides, **common, exit_at_end=True), SAMPLES)


def recorded(processes, tmp_path, axis):
    from hysteresis_ros.recordings.files import load_run

    verified = ["--verify"] if axis.plant_simulator.time_mode == "lockstep" else []
    path, bag = write_axis(tmp_path / "axis.yaml", axis), str(tmp_path / "bag")
    up = processes.command("up", path, "--composed", "--record", bag, *verified)
    assert up.wait() == 0, up.output
    assert bool(verified) == ("bit for bit" in up.output)
    return up.output, load_run(bag, further=True)


@pytest.mark.parametrize(
    ("time_mode", "driver"),
    [("lockstep", ""), ("realtime", "simulated")],
    ids=["lockstep", "driver"],
)
def test_a_voltage_that_was_held_back_is_recorded_as_what_left(processes, tmp_path, time_mode, driver):
    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.cdr import decode_float64s

    axis = axis_of(time_mode, ("lost_voltage:0.5:0.5",), driver=driver)
    output, run = recorded(processes, tmp_path, axis)
    left = run["plant_voltage"]
    told = np.isfinite(left) & np.isfinite(run["asked_voltage"])
    assert np.count_nonzero(told) > 0.8 * SAMPLES
    np.testing.assert_allclose(run["voltage"][told], left[told], rtol=0.0, atol=1e-8)
    away = told & (run["plant_mode"] == STALE)
    assert np.count_nonzero(away) >= 30 and np.max(np.abs(run["asked_voltage"] - left)[away]) > 10.0
    assert np.all(run["saturated"][away] == 1.0)
    said = limited_text(run)
    assert "the ramp to safe_voltage at safe_slew_rate" in said
    assert f"warning: {said}" in output
    # the requested voltage is in the topic of the compensator
    topic = decode_float64s(read_bag(tmp_path / "bag").topics["/voltage"].data, "/voltage")
    assert set(run["asked_voltage"][told]) <= set(topic)
    if time_mode == "lockstep":
        assert differences(run, axis) == {}


def test_without_a_cut_a_run_holds_what_the_compensator_asked_for_and_its_twin_agrees(processes, tmp_path):
    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.cdr import decode_float64s

    axis = axis_of("lockstep", (), limits__bits=10)
    output, run = recorded(processes, tmp_path, axis)
    assert "output was limited" not in output
    assert "asked_voltage" not in run and limited_text(run) == ""
    topic = decode_float64s(read_bag(tmp_path / "bag").topics["/voltage"].data, "/voltage")
    assert np.array_equal(run["voltage"], topic)
    assert np.max(np.abs(topic - run["plant_voltage"])) > 0.01, "the converter rounds"
    assert differences(run, axis) == {}
