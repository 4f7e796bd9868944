# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Triggers and the trigger input in the loop of an axis, of a motor and of a stage: offline, fused, and replayed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fused_support import assert_twin, change, made_loop, whole
from loop_support import assert_same_bits, parameters

from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.simulation import differences, simulate
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage, stage_differences, with_scan
from hysteresis_ros.loop.watch import STOPPED
from hysteresis_ros.recordings.triggers import triggers_of
from hysteresis_ros.references.scan import line_marks
from hysteresis_ros.references.triggers import NUMBER
from hysteresis_ros.signals import TRIGGER_SIGNALS

TRIANGLE = {
    "waveform__type": "triangle",
    "waveform__frequency": 10.0,
    "waveform__amplitude": 8e-6,
    "waveform__offset": 1e-6,
}
GRID = {"triggers__start": 2e-6, "triggers__step": 0.5e-6, "triggers__stop": 8e-6}
SAMPLES = 620


def triggering(*own: dict, name: str = "kim2009", node: str = "reference_generator", **more) -> AxisParameters:
    """Return the parameters of an axis whose source has these parameters."""
    return parameters(name, **{node: {key: value for one in own for key, value in one.items()}}, **more)


def run_of(given: AxisParameters, pulses=(), setpoint: float = 0.0, samples: int = SAMPLES) -> dict[str, np.ndarray]:
    """Run an axis with a constant setpoint [m] and pulses of the trigger input at some samples."""
    at = np.zeros(samples)
    at[list(pulses)] = 1.0
    return Axis(given).run(np.full(samples, setpoint), pulses=at)


def test_an_axis_with_triggers_moves_bit_for_bit_like_one_without():
    plain, made = (run_of(triggering(TRIANGLE, some)) for some in ({}, GRID))
    assert_same_bits({name: values for name, values in plain.items() if name not in TRIGGER_SIGNALS}, made)
    assert not any(plain[name].any() for name in TRIGGER_SIGNALS)
    k = np.flatnonzero(made["trigger"])
    assert made["trigger"][k].tolist() == list(range(1, k.size + 1)) and k.size == 4 * 13
    positions = 2e-6 + 0.5e-6 * np.arange(13)
    np.testing.assert_allclose(made["trigger_position"][k[:26]], [*positions, *positions[::-1]], rtol=1e-12)
    assert made["trigger_direction"][k[:26]].tolist() == [1.0] * 13 + [-1.0] * 13
    before, after = made["measured"][k - 1], made["measured"][k]
    inside = (made["trigger_position"][k] - before) / (after - before)
    assert np.all((inside > 0.0) & (inside <= 1.0))
    # where the motion is even, a line between both measurements passes the position at nearly the same instant
    assert np.median(np.abs(1.0 - made["trigger_delay"][k] * 3000.0 - inside)) < 0.01


def test_the_fused_loop_makes_the_triggers_of_its_twin_and_takes_pulses_live():
    step = {"triggers__input__action": "step", "triggers__input__distance": 0.25e-6}
    loop, given = made_loop(samples=SAMPLES, reference_generator=TRIANGLE | GRID | step | {"waveform__amplitude": 5e-6})
    loop.pulse()
    loop.pulse()
    loop.start()
    assert loop.join()
    made = whole(loop)
    assert made["trigger_in"].nonzero()[0].tolist() == [0] and made["trigger_in"][0] == 2.0
    assert made["setpoint"][0] == made["setpoint"][-1] == 0.5e-6 and made["trigger"].any()
    assert_twin(loop, made, given)


def test_a_pulse_starts_a_waveform_that_waits_as_a_start_does():
    given = triggering(TRIANGLE, {"triggers__input__action": "start"})
    assert Axis(given).default_samples() == 0
    made = run_of(given, [200, 500])
    assert not np.ptp(made["reference"][:200]) and np.all(made["waveform_sample"][:200] == -1.0)
    assert made["waveform_sample"][200:500].tolist() == list(range(300)) and made["waveform_sample"][500] == 0.0
    # the same as ~/start at these samples
    axis = Axis(given)
    starts = [change("reference_generator", "start")._replace(sample=k) for k in (200, 500)]
    same = axis.run(np.zeros(SAMPLES), changes=starts)
    assert_same_bits({name: values for name, values in made.items() if name != "trigger_in"}, same)
    # a reset lets it wait again
    axis.reset()
    assert np.all(axis.run(np.zeros(50))["waveform_sample"] == -1.0)


@pytest.mark.parametrize("velocity", [1e-4, 0.0])
def test_a_waveform_that_waits_for_a_pulse_lets_the_axis_approach_its_setpoint_from_rest(velocity):
    """With limits the way is that of an axis without triggers; without limits it lasts approach.start_time, 0.1 s."""
    there = {"initial_setpoint": 6e-6, "approach__maximum_velocity": velocity, "approach__from_rest": True}
    there |= {"approach__maximum_acceleration": 100.0 * velocity, "approach__maximum_jerk": 0.0}
    waiting = triggering(TRIANGLE | {"waveform__amplitude": 2e-6}, there, {"triggers__input__action": "start"})
    axis = Axis(waiting)
    pulses = np.zeros(700)
    pulses[500] = 1.0
    setpoints = np.full(700, 6e-6)
    made = axis.run(setpoints, pulses=pulses)
    way = made["reference"][:500]
    assert abs(way[0]) < 1e-7 and way[-1] == 6e-6 and np.all(np.diff(way) >= 0.0)
    assert np.max(np.diff(way)) <= (velocity / 3000.0 if velocity else 2.0 * 6e-6 / 300.0) * (1.0 + 1e-6)
    assert np.all(made["waveform_sample"][:500] == -1.0)
    assert made["waveform_sample"][500:].tolist() == list(range(200)) and np.ptp(made["reference"][500:]) > 1e-6
    assert np.max(np.abs(np.diff(made["reference"]))) < 1e-7, "neither the beginning nor the pulse is a jump"
    if velocity:
        plain = triggering({"waveform__type": "hold"}, there)
        assert np.array_equal(Axis(plain).run(setpoints[:500])["reference"], way)
    axis.reset()
    assert np.array_equal(axis.run(setpoints[:500])["reference"], way)


def test_a_pulse_on_the_way_to_the_setpoint_does_not_let_the_reference_jump():
    there = {"initial_setpoint": 6e-6, "approach__maximum_velocity": 1e-4, "approach__from_rest": True}
    waiting = triggering(TRIANGLE | {"waveform__amplitude": 2e-6}, there, {"triggers__input__action": "start"})
    made = run_of(waiting, [60], 6e-6)
    assert 0.0 < made["reference"][59] < 3e-6 and made["waveform_sample"][60] == 0.0
    # the velocity of the triangle is 40 µm/s, that of the approach 100 µm/s
    assert np.max(np.abs(np.diff(made["reference"]))) <= 1.4e-4 / 3000.0 * (1.0 + 1e-6)
    assert np.abs(made["reference"][-1] - 6e-6) < 3.1e-6


def test_a_pulse_holds_the_reference_and_a_start_resumes_it():
    axis = Axis(triggering(TRIANGLE, {"triggers__input__action": "hold"}))
    pulses = np.zeros(SAMPLES)
    pulses[300] = 1.0
    made = axis.run(
        np.zeros(SAMPLES), pulses=pulses, changes=[change("reference_generator", "start")._replace(sample=400)]
    )
    assert np.ptp(made["reference"][:300]) > 5e-6 and not np.ptp(made["reference"][299:400])
    assert set(made["source_mode"][300:400]) == {STOPPED} and np.ptp(made["reference"][400:]) > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kim2009", "inchworm_travel"])
def test_pulses_step_the_setpoint_within_the_range_until_a_setpoint_comes(name):
    node = "inchworm_sequencer" if name == "inchworm_travel" else "reference_generator"
    step = {"triggers__input__action": "step", "triggers__input__distance": 5e-6}
    own = {} if node == "inchworm_sequencer" else {"waveform__type": "hold"}
    axis = Axis(triggering(own, step, name=name, node=node))
    setpoints, pulses = np.zeros(300), np.zeros(300)
    setpoints[200:] = 1e-6
    pulses[[50, 100, 101, 250]] = 1.0
    made = axis.run(setpoints, pulses=pulses)["setpoint"]
    if name == "kim2009":  # up to 12 um
        assert made[[49, 50, 99, 100, 101, 199, 200, 250]].tolist() == [0.0, 5e-6, 5e-6, 1e-5, 1e-5, 1e-5, 1e-6, 6e-6]
    else:
        np.testing.assert_allclose(
            made[[49, 50, 100, 101, 200, 250]], [0.0, 5e-6, 1e-5, 1.5e-5, 1e-6, 6e-6], rtol=1e-12
        )


@pytest.mark.slow
def test_a_motor_triggers_where_its_slider_passes():
    own = {"triggers__start": 1e-6, "triggers__step": 1e-6, "triggers__stop": 3e-6, "triggers__direction": "up"}
    given = triggering(
        own, {"setpoints__times": [], "setpoints__values": []}, name="inchworm_travel", node="inchworm_sequencer"
    )
    made = run_of(given, setpoint=1e-4, samples=1200)
    k = np.flatnonzero(made["trigger"])
    assert made["trigger"][k].tolist() == [1.0, 2.0, 3.0]
    for sample, position in zip(k, (1e-6, 2e-6, 3e-6), strict=True):
        assert made["measured"][sample - 1] < position <= made["measured"][sample]


def test_other_triggers_apply_from_their_sample_on_and_count_on():
    axis = Axis(triggering(TRIANGLE, GRID))
    other = change("reference_generator", "retune", triggers__step=0.0, triggers__positions=(5e-6,))._replace(
        sample=310
    )
    made = axis.run(np.zeros(SAMPLES), changes=[other])
    k = np.flatnonzero(made["trigger"])
    assert np.all(k[:26] < 310) and made["trigger_position"][k[26:]].tolist() == [5e-6] * (k.size - 26) and k.size > 27
    assert made["trigger"][k].tolist() == list(range(1, k.size + 1)) and axis.source.triggers.x[NUMBER] == k.size


def test_a_recorded_run_with_pulses_has_its_twin():
    given = triggering(TRIANGLE, GRID, {"triggers__input__action": "step", "triggers__input__distance": 0.1e-6})
    pulses = np.zeros(300)
    pulses[[20, 30]] = 1.0
    recorded = simulate(given, setpoints=np.zeros(300), pulses=pulses)
    assert differences(recorded, given) == {} and np.ptp(recorded["setpoint"]) > 1e-7
    found = triggers_of(recorded)
    np.testing.assert_array_equal(found.time, recorded.time[found.sample] - recorded["trigger_delay"][found.sample])
    assert found.lost == 0 and found.number[-1] == found.sample.size > 10
    # after a reset they count from 1 again, which loses none
    assert replace(found, number=np.array([1.0, 2.0, 5.0, 1.0, 2.0])).lost == 2


@pytest.mark.slow
def test_a_stage_triggers_at_the_lines_of_its_scan():
    words = ("width=2um", "depth=1um", "lines=3", "flyback=1", "frame_rate=25Hz", "turn=0.3")
    configuration = with_scan(load_configuration("xy_scanner"), "raster", words)
    configuration = configuration.override("x/reference_generator", triggers__each="line")
    given = StageParameters.from_configuration(configuration)
    run = simulate_stage(given, duration=0.08)
    found = triggers_of(run.axis("x"))
    marks = line_marks(given.scan, run.time)
    np.testing.assert_array_equal(found.sample, marks.sample)
    np.testing.assert_allclose(found.time, marks.time, atol=1e-12)
    assert not triggers_of(run.axis("y")).sample.size and found.sample.size == 12
    assert stage_differences(run, given) == {}


def test_the_device_of_a_plant_makes_the_triggers_of_its_source():
    with pytest.raises(ParameterError, match="trigger_output = True: needs the device of a driver"):
        parameters(plant_simulator={"trigger_output": True})
    real = {"every": {"time_mode": "realtime"}}
    driven = {"driver": "simulated", "trigger_output": True}
    with pytest.raises(ParameterError, match="the axis has no triggers: give reference_generator triggers"):
        parameters(**real, plant_simulator=driven)
    with pytest.raises(ParameterError, match="has no effect: give reference_generator triggers.input.action"):
        parameters(**real, plant_simulator={"driver": "simulated", "trigger_input": True})
    own = {"triggers__positions": (1e-6,)}
    found = parameters(**real, plant_simulator=driven, reference_generator=own)
    assert found.plant_simulator.triggers.positions == (1e-6,)
    # the files of its nodes contain them
    again = AxisParameters.from_configuration(parse_configuration(found.configuration_text(), "text"))
    assert again.plant_simulator.triggers == found.reference_generator.triggers
    with pytest.raises(ParameterError, match="plant_simulator: triggers .* remove them here"):
        parameters(**real, plant_simulator=driven | {"triggers__positions": (2e-6,)}, reference_generator=own)
