# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The recorded voltage is the device's input, even if the compensator could not be informed in time."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.analysis.metrics import limited_text
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.compensator import note_output as note_in_loop
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import differences, simulate
from hysteresis_ros.loop.watch import HOLDING, RUNNING, STALE
from hysteresis_ros.recordings.align import read_recording
from hysteresis_ros.recordings.dataset import note_output, output_tolerance
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.recordings.run_bag import write_recording
from hysteresis_ros.signals import ACTUATOR_ROW, PLANT_VOLTAGE, SATURATED, VOLTAGE

RATE = 200.0


LOST = ("lost_voltage:0.5:0.3",)


def axis(faults=LOST, **plant):
    """Kim's axis on a sine with messages; its plant receives no voltage from 0.5 to 0.8 s."""
    quick = {"voltage_timeout": 0.05, "safe_slew_rate": 40.0, "late_limit": -1}
    common = {"sample_rate": RATE, "time_mode": "lockstep", "faults": list(faults)}
    configuration = load_configuration("kim2009").override("", **common)
    configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0, **(quick | plant))
    configuration = configuration.override("motion_controller", model__dynamics__sample_time=0.0, type="open_loop")
    wave = {"waveform__type": "sine", "waveform__amplitude": 3e-6, "waveform__frequency": 1.0}
    configuration = configuration.override("reference_generator", initial_setpoint=5e-6, **wave)
    return single_axis(configuration)


@pytest.mark.parametrize("kept", ["bag", "run.mcap", "run.npz"])
def test_a_run_of_messages_holds_what_left_and_what_was_asked_and_is_its_own_twin(tmp_path, kept):
    parameters = axis()
    run = simulate(parameters, duration=2.0)
    left, asked = run["plant_voltage"], run["asked_voltage"]
    assert np.array_equal(run["voltage"], left)
    mode = run["plant_mode"]
    away = mode == STALE
    back = (mode == RUNNING) & (np.abs(left - asked) > 1e-6)
    late = mode == HOLDING
    # the way to safe, the return, and merely late voltages all occur
    assert np.sum(away) > 40 and np.sum(back) > 5 and np.sum(late) == 9
    assert np.all(run["saturated"][away | back] == 1.0) and not np.any(run["saturated"][late])
    still = ~(away | back | late)
    assert np.array_equal(left[still], asked[still]) and np.sum(still) > 250
    said = limited_text(run)
    assert "the ramp to safe_voltage at safe_slew_rate" in said and "safe_slew_rate or limits.slew_rate" in said
    if kept == "bag":
        write_recording(run, tmp_path / kept)
    else:
        save_run(run, tmp_path / kept)
    again = load_run(tmp_path / kept, further=True)
    for name in ("voltage", "asked_voltage", "saturated", "plant_voltage"):
        assert again[name].tobytes() == run[name].tobytes(), name
    assert differences(again, parameters) == {}
    assert limited_text(again) == said


def test_without_a_cut_nothing_is_changed_and_nothing_added(tmp_path):
    converters = {"limits__bits": 12}
    run = simulate(axis((), **converters), duration=1.0)
    assert np.max(np.abs(run["voltage"] - run["plant_voltage"])) > 1e-3, "the converter rounds"
    assert "asked_voltage" not in run and not np.any(run["saturated"])
    write_recording(run, tmp_path / "bag")
    again = read_recording(tmp_path / "bag", further=True)
    assert "asked_voltage" not in again and again["voltage"].tobytes() == run["voltage"].tobytes()


def test_a_plant_narrower_than_the_compensator_cuts_and_that_is_said():
    run = simulate(axis((), limits__maximum=40.0), duration=2.0)
    assert np.max(run["asked_voltage"]) > 41.0 and np.max(run["voltage"]) == 40.0
    assert "the range limits.minimum … limits.maximum" in limited_text(run)


def test_the_rule_is_that_of_the_fused_loop():
    random = np.random.default_rng(1)
    asked = random.uniform(0.0, 100.0, 400)
    left = asked + random.choice([0.0, 0.01, -0.01, 0.03, -0.03, 5.0], 400)
    plant = {"limits.minimum": 0.0, "limits.maximum": 100.0, "limits.bits": 12}
    tolerance = output_tolerance(plant, {**plant, "limits.bits": 0})
    assert tolerance == pytest.approx(100.0 / 4095.0, abs=1e-8)
    signals = {"voltage": asked, "saturated": np.zeros(400)}
    note_output(signals, left, np.full(400, float(RUNNING)), tolerance)
    for k in range(400):
        row = np.zeros(ACTUATOR_ROW)
        row[VOLTAGE], row[PLANT_VOLTAGE] = asked[k], left[k]
        note_in_loop(np.array([0.0, 0.0, tolerance]), row)
        assert (row[VOLTAGE], row[SATURATED]) == (signals["voltage"][k], signals["saturated"][k])
    assert 150 < np.sum(signals["saturated"]) < 250
    assert signals["asked_voltage"] is asked


def test_what_nobody_said_is_left_as_it_was():
    asked = np.arange(5.0)
    signals = {"voltage": asked}
    note_output(signals, np.full(5, np.nan), np.full(5, np.nan), 0.0)
    assert signals == {"voltage": asked}
    limits = {"limits.minimum": 0.0, "limits.maximum": 100.0}
    # without data of the converters, any difference may be theirs
    assert output_tolerance({}, limits) == output_tolerance(limits, {}) == np.inf
    assert output_tolerance({**limits, "limits.bits": "x"}, limits) == np.inf
    # a device rounds by itself, and reports the voltage that it was given
    bits = {**limits, "limits.bits": 4, "driver": "x:Y"}
    assert output_tolerance(bits, limits) == output_tolerance(limits, limits) < 1e-8
