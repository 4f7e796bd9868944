# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The closed loop offline: the blocks' own composition, repeatability, and the length of a run."""

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.law import APPLIED, COMMAND
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.reach import axes, single_axis
from hysteresis_ros.loop.simulation import differences, simulate
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.signals import ACTUATOR

NOISY = {"sensor__noise": 5e-9, "preload__force": 5.88, "limits__slew_rate": 2.0e4}


def noisy_axis():
    return axes(load_configuration("kim2009").override("plant_simulator", **NOISY))[0]


def test_a_run_repeats_bit_for_bit_after_reset_and_may_be_cut_in_pieces():
    axis = Axis(noisy_axis())
    setpoints = 4e-6 * (np.arange(900) > 300)
    whole = axis.run(setpoints)
    axis.reset()
    pieces = [axis.run(part) for part in np.split(setpoints, [1, 250, 777])]
    for name, values in whole.items():
        np.testing.assert_array_equal(np.concatenate([piece[name] for piece in pieces]), values, err_msg=name)
    assert np.std(whole["measured"] - whole["displacement"]) == pytest.approx(5e-9, rel=0.1)


def test_blocks_called_one_by_one_as_the_nodes_do_give_the_same_bits():
    parameters = noisy_axis()
    table = Axis(parameters).run(np.zeros(600))
    axis = Axis(parameters)
    actuator, controller, compensator = axis.plant.actuator, axis.controller.controller, axis.compensator.compensator
    for k in range(600):
        measured = actuator.measure()
        reference = axis.source.generator.step(0.0)
        command = axis.controller.handover.step(controller.step(reference, measured))
        voltage = compensator.step(command)
        controller.x[COMMAND] = command
        controller.x[APPLIED] = compensator.applied
        assert (measured, reference, command, voltage) == tuple(
            table[name][k] for name in ("measured", "reference", "command", "voltage")
        ), k
        actuator.advance(voltage)


def test_the_first_answer_acts_on_the_second_sample():
    table = Axis(axes(load_configuration("kim2009"))[0]).run(np.zeros(3))
    assert table["displacement"][0] == 0.0 and table["command"][0] > 0.0 and table["displacement"][1] > 0.0


def test_signals_stay_within_the_limits_of_the_amplifier():
    configuration = load_configuration("kim2009").override("reference_generator", waveform__type="hold")
    table = Axis(axes(configuration)[0]).run(np.r_[np.full(500, 12e-6), np.zeros(500)])
    assert table["voltage"].min() >= -30.0 and table["voltage"].max() <= 120.0
    assert set(np.unique(table["saturated"])) <= {0.0, 1.0}
    step = 150.0 / (2**16 - 1)
    np.testing.assert_allclose((table["voltage"] + 30.0) / step, np.round((table["voltage"] + 30.0) / step), atol=1e-6)


def test_a_recording_of_a_run_is_complete_and_finds_its_differences():
    run = simulate(single_axis(load_configuration("kim2009")))
    assert isinstance(run, Recording) and run.time.size == 4800
    assert tuple(run.signals) == tuple(signal.name for signal in ACTUATOR.row)
    parameters = single_axis(load_configuration("kim2009"))
    assert differences(run, parameters) == {}
    changed = run.signals["voltage"].copy()
    changed[[7, 100]] = np.nextafter(changed[[7, 100]], 1e3)
    altered = Recording(run.time, dict(run.signals, voltage=changed), metadata=run.metadata)
    assert differences(altered, parameters) == {"voltage": 2}


def test_setpoints_are_replayed_and_the_last_one_holds():
    hold = load_configuration("kim2009").override("reference_generator", waveform__type="hold")
    parameters = single_axis(hold)
    run = simulate(parameters, setpoints=[0.0, 1e-6, 2e-6], duration=5 / 3000)
    np.testing.assert_array_equal(run.signals["setpoint"], [0.0, 1e-6, 2e-6, 2e-6, 2e-6])
    np.testing.assert_array_equal(run.signals["reference"], run.signals["setpoint"])


def test_a_run_without_an_end_is_refused():
    hold = load_configuration("kim2009").override("reference_generator", waveform__type="hold")
    with pytest.raises(ConfigurationError, match="give --duration"):
        simulate(single_axis(hold))
    for duration in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigurationError, match="duration = .*positive"):
            simulate(single_axis(hold), duration=duration)
