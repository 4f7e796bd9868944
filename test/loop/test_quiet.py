# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Quiet hold of an axis: noise, creep, return, forecast, and what ends it; offline, fused and replayed."""

from __future__ import annotations

import numpy as np
import pytest
from fused_support import assert_twin, change, made_loop, whole
from loop_support import HOLD, assert_same_bits, axis, parameters

import hysteresis_ros as hr
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop import watch
from hysteresis_ros.loop.quiet import (
    AVERAGED,
    CONTINUES,
    LEFT,
    OWN_PARAMETERS,
    OWN_STATES,
    SEEN,
    Forecast,
    Quiet,
    begin_quiet,
    held_command,
    parse_quiet,
)
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import differences, mismatched, simulate
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.models.creep import Creep, CreepOperatorsParameters, CreepParameters, LogarithmicCreepParameters

#: The stage at rest after a step of 20 um, with the noise of a good capacitive sensor (assumed: 3 nm RMS).
STEP = {
    "reference_generator": {"waveform__type": "hold", "initial_setpoint": 20e-6},
    "plant_simulator": {"sensor__noise": 3e-9},
}
RATE = 200.0
NO_CREEP = {"creep__type": "none"}


def stage(creeping=1.0, **compensator):
    """Return the measured stage after a step; its creep is that of the model times a factor."""
    own = {node: dict(values) for node, values in STEP.items()}
    own["plant_simulator"]["creep__logarithmic__rate"] = 0.014638681 * creeping
    return parameters("picma_stage", hysteresis_compensator=compensator, **own)


def quiet_run(given, start=3.0, duration=3.0, end=8.0, **more):
    """Simulate a quiet hold; return the run and the numbers of the samples in which the command stood still."""
    run = simulate(given, duration=end, quiet=(Quiet(start, duration),), **more)
    return run, np.flatnonzero(run["controller_mode"] == watch.QUIET)


def test_the_command_stands_still_for_the_time_and_the_noise_does_not_reach_the_actuator():
    run, quiet = quiet_run(stage())
    # 50 ms to average, as long to fade, then the hold; both in samples of 5 ms
    assert quiet[0] == 600 + 20 and quiet.size == 600 and np.all(np.diff(quiet) == 1)
    assert not np.ptp(run["command"][quiet]) and np.all(run["reference"][quiet] == 20e-6)
    # the mean of the commands of 10 samples, so the axis stands where it stood on average
    assert run["command"][quiet[0]] == pytest.approx(np.mean(run["command"][600:610]), abs=1e-15)
    before, held = run["displacement"][300:600], run["displacement"][quiet[60:]]
    assert np.std(before) > 3e-10 and np.std(held) < 0.1 * np.std(before)
    assert abs(np.mean(held) - np.mean(before)) < 4.0 * np.std(before)
    # the measurements go on, and are as noisy as the sensor
    assert np.std(run["measured"][quiet]) == pytest.approx(3e-9, rel=0.1)


def test_the_voltage_follows_the_creep_of_the_model_and_is_constant_without_one():
    run, quiet = quiet_run(stage())
    voltage = run["voltage"][quiet]
    # less and less voltage, because creep goes on in the direction of the step
    assert voltage[-1] < voltage[0] - 1e-4 and np.all(np.diff(voltage) < 0.0) and np.all(np.diff(voltage, 2) > -1e-6)
    np.testing.assert_allclose(run["applied"][quiet], run["command"][quiet], rtol=0, atol=1e-13)
    plain, quiet = quiet_run(stage(**NO_CREEP))
    assert not np.ptp(plain["voltage"][quiet])
    # without the model the axis creeps away, with it it stays
    crept = np.ptp(plain["displacement"][quiet[60:]])
    assert crept > 5.0 * np.ptp(run["displacement"][quiet[60:]]) and crept > 5e-8


@pytest.mark.parametrize("creeping", [0.75, 1.25])
def test_the_drift_stays_within_the_forecast_if_the_creep_is_as_uncertain_as_assumed(creeping):
    given = stage(creeping)
    kept = {}
    run, quiet = quiet_run(given, duration=20.0, end=24.0)
    at = axis("picma_stage", reference_generator=STEP["reference_generator"])
    at.run(np.full(600, 20e-6))
    forecast = at.forecast()
    kept["drift"] = abs(run["displacement"][quiet[-1]] - run["displacement"][quiet[60]])
    predicted = 0.3 * forecast.creep(20.0)
    assert predicted > 1e-8 and 0.2 * predicted < kept["drift"] < predicted


def test_the_axis_returns_without_a_jump_and_goes_to_a_setpoint_that_came_meanwhile():
    given = stage()
    run, quiet = quiet_run(given)
    first, before = quiet[-1] + 1, slice(300, 600)
    assert run["controller_mode"][first] == watch.RUNNING and run["command"][first] == run["command"][first - 1]
    largest = np.max(np.abs(np.diff(run["voltage"][before])))
    assert np.max(np.abs(np.diff(run["voltage"][first - 1 : first + 40]))) < 1.5 * largest
    error = np.abs(run["displacement"] - 20e-6)
    assert np.max(error[first : first + 200]) < 2.0 * np.max(error[before])
    setpoints = np.full(1600, 20e-6)
    setpoints[800:] = 22e-6
    moved, quiet = quiet_run(given, setpoints=setpoints)
    assert moved["reference"][quiet[-1]] == 22e-6 and abs(moved["displacement"][quiet[-1]] - 20e-6) < 1e-8
    # the reference fades with handover_time: in the first sample nothing happens
    assert moved["command"][first] == moved["command"][first - 1]
    assert np.max(np.abs(np.diff(moved["displacement"][first - 1 : first + 40]))) < 0.5e-6
    assert abs(moved["displacement"][-1] - 22e-6) < 5e-9


def test_a_controller_that_corrects_its_model_keeps_the_correction_over_a_hold():
    configuration = load_configuration("picma_stage")
    for node, own in STEP.items():
        configuration = configuration.override(node, **own)
    given = single_axis(mismatched(configuration, 0.05, 3))
    run, quiet = quiet_run(given, duration=1.0, end=6.0)
    # the command differs from the displacement by far more than the axis may move
    assert abs(run["command"][quiet[0]] - 20e-6) > 1e-7
    error = np.abs(run["displacement"] - 20e-6)
    assert np.max(error[quiet[-1] + 1 :]) < 2.0 * np.max(error[300:600])


def test_a_resonance_that_the_loop_damps_does_not_ring_when_the_command_stands_still():
    noisy = {"plant_simulator": {"sensor__noise": 3e-9}, "motion_controller": {"quiet__average": 0.01}}
    given = parameters(reference_generator={"waveform__type": "hold", "initial_setpoint": 5e-6}, **noisy)
    run, quiet = quiet_run(given, start=0.4, duration=0.2, end=0.65)
    first, last = quiet[:30], quiet[-30:]
    ringing = np.sqrt(np.mean((run["displacement"][first] - np.mean(run["displacement"][last])) ** 2))
    # 4.8 nm RMS (six runs) with a step of the command to its mean, 0.8 nm as it is
    assert np.std(run["displacement"][600:1200]) > 1.5e-9 and ringing < 1.8e-9


def test_a_drift_that_no_model_compensates_fades_out_after_the_hold():
    run, quiet = quiet_run(stage(**NO_CREEP), duration=10.0, end=16.0)
    drift, first = run["displacement"][quiet[-1]] - 20e-6, quiet[-1] + 1
    assert drift > 1e-7
    # the voltage takes the drift back over handover_time (50 ms), not in a sample
    step = np.max(np.abs(np.diff(run["displacement"][first - 1 : first + 10])))
    assert step < 0.3 * drift and abs(np.mean(run["displacement"][first + 200 :]) - 20e-6) < 1e-9


def test_a_request_during_a_motion_starts_the_controller_anew():
    waveform = {"waveform__type": "triangle", "waveform__frequency": 1.0, "waveform__amplitude": 10e-6}
    given = parameters("picma_stage", reference_generator=waveform | {"waveform__offset": 10e-6, "initial_setpoint": 0})
    run, quiet = quiet_run(given, start=1.1, duration=0.33, end=3.0)
    assert quiet.size == 66 and not np.ptp(run["command"][quiet[1:]]) and np.ptp(run["reference"][quiet]) > 3e-6
    first = quiet[-1] + 1
    assert run["command"][first] == run["command"][first - 1]
    usual = np.max(np.abs(np.diff(run["command"][:200])))
    assert np.max(np.abs(np.diff(run["command"][first - 1 : first + 60]))) < 2.0 * usual
    tracking = np.abs(run["displacement"] - run["reference"])
    assert np.max(tracking[500:]) < 1.1 * np.max(tracking[100:200])
    # in the hold: the states of a moving axis are not kept, those of an axis at rest are
    for moves, kept in ((waveform, 0.0), ({"waveform__type": "hold"}, 1.0)):
        one = axis("picma_stage", reference_generator=moves | {"waveform__offset": 10e-6, "initial_setpoint": 5e-6})
        one.run(np.full(250, 5e-6), changes=[change("motion_controller", "quiet", duration=1.0)._replace(sample=220)])
        assert one.controller.arrays.watch_x.own[CONTINUES] == kept


def test_a_new_request_extends_the_hold_and_zero_ends_it():
    given = stage()
    asked = [change("motion_controller", "quiet", duration=1.0)._replace(sample=600)]
    asked += [change("motion_controller", "quiet", duration=1.0)._replace(sample=700)]
    table = simulate(given, duration=6.0, changes=asked)
    quiet = np.flatnonzero(table["controller_mode"] == watch.QUIET)
    assert quiet[0] == 620 and quiet[-1] == 899 and not np.ptp(table["command"][quiet])
    asked[1] = change("motion_controller", "quiet", duration=0.0)._replace(sample=700)
    table = simulate(given, duration=6.0, changes=asked)
    quiet = np.flatnonzero(table["controller_mode"] == watch.QUIET)
    assert quiet[0] == 620 and quiet[-1] == 699 and table["command"][700] == table["command"][699]
    # before the command stands still, zero leaves the loop as it was
    asked[1] = change("motion_controller", "quiet", duration=0.0)._replace(sample=605)
    assert not np.any(simulate(given, duration=4.0, changes=asked)["controller_mode"] == watch.QUIET)


def test_the_place_at_the_end_of_a_hold_is_that_of_the_last_measurements():
    own_p, own = np.zeros(OWN_PARAMETERS), np.zeros(OWN_STATES)
    own_p[AVERAGED] = 10.0
    for _ in range(2):  # the second hold knows nothing of the first one
        interpreted(begin_quiet)(own_p, own, 2000.0)
        for number in range(1000):
            interpreted(held_command)(own_p, own, np.nan if number % 7 == 3 else 1e-9 * number)
        assert 0.0 < 999e-9 - own[SEEN] < 15e-9, "an average over ten samples of a drift of 1 nm a sample"
        interpreted(begin_quiet)(own_p, own, 0.0)


def test_a_stop_in_a_hold_lets_the_controller_start_anew():
    one = axis("picma_stage", reference_generator={"waveform__type": "hold", "initial_setpoint": 5e-6})
    own = one.controller.arrays.watch_x.own
    for stop in ("stop", "halt"):
        one.run(np.full(400, 5e-6))
        asked = change("motion_controller", "quiet", duration=1.0)._replace(sample=one.sample)
        one.run(np.full(100, 5e-6), changes=[asked])
        assert own[CONTINUES] == 1.0
        part = one.controller if stop == "stop" else one.plant
        getattr(part, stop)()
        one.run(np.full(5, 5e-6))
        assert own[CONTINUES] == own[LEFT] == 0.0
        part.start()


def test_an_axis_without_a_quiet_hold_keeps_its_bits():
    plain = simulate(stage(), duration=4.0)
    asked, quiet = quiet_run(stage(), end=4.0)
    # up to the sample in which the command begins to fade
    for name in ("command", "voltage", "displacement"):
        np.testing.assert_array_equal(plain[name][:610], asked[name][:610])
    assert np.any(plain["command"][610:620] != asked["command"][610:620])


STOPS = {
    "stop": ([change("motion_controller", "stop")._replace(sample=800)], (), watch.STOPPED),
    "emergency stop": ([change("plant_simulator", "halt")._replace(sample=800)], (), watch.TRIPPED),
    "measurement": ([], ("stale:4:2",), watch.STALE),
    "compensator": ([], ("unanswered:4:2",), watch.FOLLOWING),
}


@pytest.mark.parametrize("what", STOPS)
def test_what_makes_an_axis_safe_acts_in_a_quiet_hold_as_always_and_ends_it(what):
    changes, faults, mode = STOPS[what]
    if what == "stop":
        changes = [*changes, change("motion_controller", "start")._replace(sample=1200)]
    if what == "emergency stop":
        changes = [*changes, change("plant_simulator", "start")._replace(sample=1200)]
    given = stage().with_faults(faults)
    run, quiet = quiet_run(given, duration=6.0, end=11.0, changes=changes)
    plain = simulate(given, duration=11.0, changes=changes)
    assert quiet[0] == 620 and quiet[-1] < 850
    # with the same modes in the same samples as without a quiet hold
    other = plain["controller_mode"] != watch.RUNNING
    other &= plain["controller_mode"] != watch.HOLDING
    np.testing.assert_array_equal(run["controller_mode"][other], plain["controller_mode"][other])
    assert mode in set(run["controller_mode"][other])
    first = np.flatnonzero(other)[0]
    if mode != watch.FOLLOWING:
        assert np.all(np.abs(run["command"][first + 40 : 1200]) < np.abs(run["command"][first]))
        if mode != watch.STALE:
            assert run["plant_voltage"][1150] < 0.5 * run["plant_voltage"][first - 1]
    # the hold does not go on afterwards, although its time is not over
    assert set(run["controller_mode"][1250:1400]) == {watch.RUNNING}
    assert abs(np.mean(run["displacement"][-200:]) - 20e-6) < 2e-9


def test_a_single_missing_measurement_does_not_end_a_quiet_hold():
    run, quiet = quiet_run(stage().with_faults(("stale:4:0.1",)))
    assert quiet.size == 600 and np.isnan(run["seen"][800:820]).all()


def test_a_quiet_hold_of_the_fused_loop_and_of_a_pulse_are_those_of_the_twin():
    own = {"quiet__average": 0.01, "quiet__on_trigger": 0.02}
    # the same machine code for both loops; only a fused axis takes pulses from the row of a sample
    common = {"motion_controller": own, "every": {"time_mode": "fused"}, **HOLD}
    loop, given = made_loop(samples=900, **common)
    assert loop.apply(change("motion_controller", "quiet", duration=0.05)) == 0
    loop.start()
    assert loop.join()
    made = whole(loop)
    quiet = np.flatnonzero(made["controller_mode"] == watch.QUIET)
    assert quiet[0] == 60 and quiet.size == 150
    twin = assert_twin(loop, made, given)
    assert np.any(twin["controller_mode"] == watch.QUIET)
    loop, given = made_loop(samples=400, **common)
    loop.pulse()
    loop.start()
    assert loop.join()
    made = whole(loop)
    quiet = np.flatnonzero(made["controller_mode"] == watch.QUIET)
    assert made["trigger_in"][0] == 1.0 and quiet[0] == 60 and quiet.size == 60
    assert_twin(loop, made, given)


def test_a_recorded_run_with_a_quiet_hold_has_its_twin():
    given = stage()
    recorded = simulate(
        given, duration=2.0, changes=[change("motion_controller", "quiet", duration=0.5)._replace(sample=150)]
    )
    entry = {"sample": 150, "node": "motion_controller", "action": "quiet", "parameters": {"duration": 0.5}}
    recorded.metadata["changes"] = [entry]
    assert differences(recorded, given) == {} and np.any(recorded["controller_mode"] == watch.QUIET)


def test_a_reset_ends_a_quiet_hold():
    one = axis("picma_stage")
    one.controller.quiet(10.0)
    one.reset()
    assert one.controller.arrays.watch_x.own[LEFT] == 0.0
    made = one.run(np.full(300, 1e-6))
    assert_same_bits(made, axis("picma_stage").run(np.full(300, 1e-6)))


def test_the_forecast_is_the_creep_of_the_model_at_rest():
    model = Creep(CreepParameters(type="logarithmic", logarithmic=LogarithmicCreepParameters(rate=0.015)), 0.005)
    for _ in range(200):  # 1 s after a step of 20 um
        model.step(20e-6)
    forecast = Forecast(model, 0.3)
    # gamma lg(t / t_0) from 1 s to 11 s after the step, by the law of the data sheet
    assert forecast.creep(10.0) == pytest.approx(0.015 * 20e-6 * np.log10(11.0), rel=0.02)
    longest = forecast.longest(0.3 * 0.015 * 20e-6 * np.log10(11.0))
    assert longest == pytest.approx(10.0, rel=0.05)
    assert forecast.creep(longest) * 0.3 <= 0.3 * 0.015 * 20e-6 * np.log10(11.0)
    assert forecast.longest(1e-6) == np.inf and forecast.longest(0.0) == 0.0
    # the model itself has not moved
    assert model.step(20e-6) == pytest.approx(20e-6 * (1.0 + 0.015), rel=1e-3)


@pytest.mark.parametrize("step", [20e-6, -20e-6])
def test_the_forecast_ends_with_the_hold_and_has_no_sign(step):
    slow = CreepOperatorsParameters(weights=(0.02,), time_constants=(2.0,))
    model = Creep(CreepParameters(type="operators", operators=slow), 0.005)
    model.step(step)
    forecast = Forecast(model, 0.3)
    # a single operator: 2 % of the step, times 1 - exp(-t / 2 s), for holds of a sample and for long ones
    durations = np.array([0.005, 0.0075, 0.02, 0.7, 3.3, 50.0])
    closed = 0.02 * abs(step) * (1.0 - np.exp(-durations / 2.0))
    np.testing.assert_allclose([forecast.creep(one) for one in durations], closed, rtol=1e-2)
    assert forecast.longest(0.3 * closed[3]) == pytest.approx(0.7, rel=0.03)
    with pytest.raises(ParameterError, match="the displacement would drift by"):
        forecast.require(0.7, 0.25 * closed[3])
    forecast.require(0.7, 0.31 * closed[3])


WRONG = {
    "1s:20s:5nm": r"quiet: duration = 20.0 s: the displacement would drift by .* \(30 % of .*: at most 1\d\d ms",
    "1s:2s:0.001nm": "allowed now: no quiet hold; or wait",
    "1s:-2s": "quiet: duration = -2.0 s: must be within 0",
    "-1s:2s": "quiet: start = -1.0 s: must be ≥ 0 s",
    "1s:2s:-5nm": "quiet: tolerance = -5e-09 m: must be ≥ 0 m",
    "1s:2s:5": "of which unit",
    "1s": "write START:DURATION",
    "9s:1s": "quiet: start = 9.0 s: must be before the end of the run, 8 s",
}


@pytest.mark.parametrize("text", WRONG)
def test_a_quiet_hold_longer_than_creep_allows_is_refused_with_what_would_do(text):
    configuration = load_configuration("picma_stage")
    for node, own in STEP.items():
        configuration = configuration.override(node, **own)
    with pytest.raises((ConfigurationError, ParameterError), match=WRONG[text]):
        hr.simulate(configuration, duration=8.0, quiet=[text])


def test_a_quiet_hold_that_creep_allows_is_carried_out():
    run = simulate(stage(), duration=8.0, quiet=[parse_quiet("3s:2s:50nm")])
    assert np.count_nonzero(run["controller_mode"] == watch.QUIET) == 400


def test_without_a_creep_model_a_tolerance_cannot_be_promised():
    with pytest.raises(ParameterError, match="is unknown, because hysteresis_compensator has no creep model"):
        simulate(stage(**NO_CREEP), duration=8.0, quiet=[Quiet(1.0, 1.0, 1e-6)])
    assert "the drift is unknown" in axis("kim2009").forecast().describe(1.0)


def test_a_motor_holds_with_its_clamps_and_a_stage_has_no_offline_holds():
    with pytest.raises(ParameterError, match="quiet when its clamps hold it"):
        axis("inchworm_travel").controller.quiet(1.0)
    with pytest.raises(ParameterError, match=r"quiet.on_trigger = 1.0 s: an inchworm motor"):
        parameters("inchworm_travel", motion_controller={"quiet__on_trigger": 1.0})
    with pytest.raises(ConfigurationError, match="quiet is for a single axis"):
        hr.simulate("xy_scanner", duration=0.1, quiet=[(0.0, 0.1)])
