# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The fused loop runs the samples of its offline twin, for any requests and any lateness."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from fused_support import ANY_LATE, SLOWLY, assert_twin, change, delay, made_loop, named, whole
from loop_support import HOLD, assert_same_bits, axis, parameters
from waiting import until

from hysteresis_ros import signals
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop import fused, pacing
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.plant import HALTED
from hysteresis_ros.loop.watch import HOLDING, STOPPED, TRIPPED
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.references import inchworm_layout as gait


@pytest.mark.parametrize("name", ["kim2009", "auwal2017", "inchworm_travel"])
def test_without_deadlines_it_makes_the_run_of_the_axis(name):
    late = {"plant_simulator": {"dynamics__delay": 1e-4}} if name == "kim2009" else {}
    loop, given = made_loop(name, samples=1500, **late)
    loop.start()
    assert loop.join()
    made = whole(loop)
    twin = axis(name, **late)
    asked = {"speeds": made["speed"]} if twin.kind.motor else {}
    assert_same_bits(made, twin.run(twin.default_setpoints(1500), **asked))
    assert loop.axis.sample == 1500 and loop.changes == [] and loop.missed == 0


def test_a_motor_that_learns_its_walk_makes_the_run_of_the_axis():
    walk = {"walk__continuous": True, "walk__learning": True, "walk__swing": 456.0, "gait__walking_speed": 1e-4}
    loop, given = made_loop("inchworm_travel", samples=4000, inchworm_sequencer=walk)
    loop.start()
    assert loop.join()
    made = whole(loop)
    assert_twin(loop, made, given)
    assert loop.axis.source.sequencer.x[gait.LEARNED_CYCLES] > 2 and np.any(made["correction"])


@pytest.mark.slow
def test_the_schedule_of_a_motor_holds_until_somebody_gives_a_setpoint():
    schedule = {"setpoints__times": [0.005, 0.02, 1e3], "setpoints__values": [2e-5, 5e-5, 1e-4]}
    loop, given = made_loop("inchworm_travel", samples=400, inchworm_sequencer=schedule)
    loop.start()
    loop.join()
    first = loop.take()
    np.testing.assert_array_equal(first.table[signals.SETPOINT], loop.axis.default_setpoints(400))
    assert set(first.table[signals.SETPOINT]) == {0.0, 2e-5, 5e-5}
    other, _ = made_loop("inchworm_travel", samples=400, inchworm_sequencer=schedule)
    other.set(setpoint=1e-5)
    other.start()
    other.join()
    assert set(other.take().table[signals.SETPOINT]) == {1e-5}


def test_the_clock_starts_when_the_compiled_loop_runs(monkeypatch):
    """What comes before the first sample, such as the arrays of a stage on their way into the loop, costs no sample."""
    prepared, compiled = [], fused.machine

    def machine(*arguments):
        made = compiled(*arguments)
        prepared.append(time.monotonic_ns())
        return made

    loop, _ = made_loop(factor=0.1)
    monkeypatch.setattr(fused, "machine", machine)
    for _ in range(2):
        first = loop.sample
        loop.start()
        assert loop.origin - loop._offset + deadlines(loop, first) >= prepared[-1] + pacing.LEAD
        until(lambda first=first: loop.sample > first)
        loop.leave()


def deadlines(loop, sample: int) -> int:
    """Return the time from sample 0 to a sample [ns]."""
    return sample * int(loop._state[pacing.PERIOD]) // pacing.FEMTO


@pytest.mark.slow
def test_it_goes_on_where_it_left():
    loop, given = made_loop(factor=1e-3)
    loop.start()
    until(lambda: loop.sample > 2)
    loop.leave()
    first = loop.take()
    assert not loop.running and loop.axis.sample == loop.sample == first.first + len(first.times)
    loop.set(setpoint=2e-6)
    loop.start()
    with pytest.raises(RuntimeError, match="is already running"):
        loop.start()
    until(lambda: loop.sample > first.first + len(first.times) + 2)
    loop.leave()
    assert_twin(loop, whole(loop, first), given)


# ------------------------------------------------------------------------------------------------------- live changes


@pytest.mark.slow
def test_a_run_with_everything_that_can_change_is_repeated_bit_for_bit():
    loop, given = made_loop(factor=SLOWLY, **ANY_LATE)
    loop.start()
    numbers = []
    steps = (
        change("motion_controller", "retune", sliding_mode__phi=0.9, handover_time=0.02),
        change("hysteresis_compensator", "retune", hysteresis__polynomial__scale=1.03),
        change("motion_controller", "stop"),
        change("reference_generator", "stop"),
        change("motion_controller", "start"),
        change("reference_generator", "retune", waveform__type="sine", waveform__amplitude=1e-7),
        change("reference_generator", "start"),
        change("motion_controller", "retune", type="open_loop"),
        change("hysteresis_compensator", "stop"),
        change("hysteresis_compensator", "start"),
        change("plant_simulator", "retune", hysteresis__polynomial__scale=0.98),
        change("plant_simulator", "halt"),
        change("plant_simulator", "start"),
        change("motion_controller", "retune", type="sliding_mode"),
    )
    for index, step in enumerate(steps):
        loop.set(setpoint=4e-6 + index * 1e-7)
        numbers.append(loop.apply(step))
        until(lambda: loop.sample >= numbers[-1] + 3)  # noqa: B023
    loop.leave()
    made = whole(loop)
    twin = assert_twin(loop, made, given)
    assert [(one.sample, *one[1:4]) for one in loop.changes] == [
        (number, *step[1:4]) for number, step in zip(numbers, steps, strict=True)
    ]
    assert numbers == sorted(numbers)
    assert {4e-6 + index * 1e-7 for index in range(len(steps))} <= set(made["setpoint"])
    plain = Axis(given).run(made["setpoint"], skipped=made["skipped"])
    assert np.any(plain["voltage"] != twin["voltage"])


@pytest.mark.slow
def test_an_emergency_stop_stops_everything_within_a_sample_and_stays():
    loop, given = made_loop(factor=SLOWLY, **ANY_LATE)
    loop.set(setpoint=5e-6)
    loop.start()
    until(lambda: loop.sample > 30)
    loop.halt()
    until(lambda: loop.changes)
    at = loop.changes[0].sample
    until(lambda: loop.sample > at + 10)
    loop.apply(change("plant_simulator", "start"))
    until(lambda: loop.sample > loop.changes[-1].sample + 5)
    loop.halt()
    loop.halt()
    until(lambda: loop.sample > at + 30 and loop.axis.plant.tripped)
    loop.leave()
    made = whole(loop)
    assert_twin(loop, made, given)
    first = [entry for entry in loop.changes if entry.sample == at]
    assert {(entry.node, entry.action) for entry in first} == {
        ("plant_simulator", "halt"),
        ("motion_controller", "stop"),
        ("hysteresis_compensator", "stop"),
        ("reference_generator", "stop"),
    }
    assert made["tripped"][at] == HALTED and made["tripped"][at - 1] == 0.0
    assert made["controller_mode"][at] == TRIPPED
    assert made["voltage"][at] < made["voltage"][at - 1] or made["voltage"][at - 1] == 0.0
    # only the plant was started
    again = loop.changes[4].sample
    assert made["tripped"][again] == 0.0 and made["controller_mode"][again] == STOPPED
    assert made["tripped"][-1] == HALTED


def test_an_emergency_stop_of_a_motor_asks_its_sequencer_to_stop():
    loop, given = made_loop("inchworm_travel", factor=0.02, plant_simulator={"late_limit": -1})
    loop.set(setpoint=2e-4)
    loop.start()
    until(lambda: loop.sample > 20)
    loop.halt()
    until(lambda: loop.changes)
    until(lambda: loop.sample > loop.changes[0].sample + 5)
    loop.leave()
    made = whole(loop)
    assert_twin(loop, made, given)
    assert list(np.flatnonzero(made["request"])) == [loop.changes[0].sample]
    assert made["request"][loop.changes[0].sample] == gait.STOP_REQUEST
    assert {entry.node for entry in loop.changes} == {
        "plant_simulator",
        "motion_controller",
        "hysteresis_compensator",
    }


def test_a_change_that_is_refused_is_refused_to_the_caller_and_changes_nothing():
    loop, given = made_loop(factor=SLOWLY, **ANY_LATE)
    loop.start()
    with pytest.raises(ParameterError, match="phi"):
        loop.apply(change("motion_controller", "retune", sliding_mode__phi=3.0))
    with pytest.raises(ParameterError, match="only while stopped"):
        loop.apply(change("reference_generator", "retune", waveform__type="sine"))
    until(lambda: loop.sample > 5)
    loop.leave()
    assert loop.changes == [] and not loop.failure
    assert_twin(loop, whole(loop), given)


def test_what_the_double_took_and_the_axis_refuses_is_raised_and_the_loop_goes_on(monkeypatch):
    loop, given = made_loop(factor=SLOWLY, **ANY_LATE)

    def refuse(parameters):
        raise ParameterError([])

    monkeypatch.setattr(loop.axis.controller, "retune", refuse)
    loop.start()
    with pytest.raises(ParameterError):
        loop.apply(change("motion_controller", "retune", handover_time=0.02))
    before = loop.sample
    until(lambda: loop.sample > before + 3)
    loop.leave()
    assert loop.changes == [] and not loop.failure


def test_changes_before_the_start_and_after_the_end_hold_too():
    loop, given = made_loop(samples=300, **HOLD)
    assert loop.apply(change("motion_controller", "stop")) == 0
    loop.start()
    loop.join()
    first = loop.take()
    assert set(named(loop, first.table)["controller_mode"]) == {STOPPED}
    assert loop.apply(change("motion_controller", "retune", type="open_loop")) == 300
    assert loop.apply(change("motion_controller", "start")) == 300
    loop._state[pacing.UNTIL] = 400
    loop.start()
    loop.join()
    assert_twin(loop, whole(loop, first), given)


@pytest.mark.slow
def test_requests_and_speeds_of_a_motor_are_taken_whole_and_once():
    loop, given = made_loop("inchworm_travel", factor=0.02, plant_simulator={"late_limit": -1})
    loop.start()
    for index in range(20):
        loop.set(setpoint=1e-5 * index, request=gait.START_REQUEST, speed=1e-4 * (index + 1))
        before = loop.sample
        until(lambda: loop.sample > before + 2)  # noqa: B023
    loop.leave()
    made = whole(loop)
    assert_twin(loop, made, given)
    asked = np.flatnonzero(made["request"])
    assert len(asked) == 20
    np.testing.assert_array_equal(made["setpoint"][asked], 1e-5 * np.arange(20))
    np.testing.assert_array_equal(made["speed"][asked], 1e-4 * (np.arange(20) + 1))


def test_only_a_motor_is_asked_for_a_speed():
    loop, _ = made_loop(samples=1)
    with pytest.raises(ValueError, match="motor"):
        loop.set(speed=1.0)


@pytest.mark.slow
def test_many_threads_may_steer_at_once():
    loop, given = made_loop(factor=SLOWLY, **ANY_LATE)
    loop.start()
    allowed = {0.0} | {1e-7 * k for k in range(40)}

    def steer(first):
        for k in range(first, first + 10):
            loop.set(setpoint=1e-7 * k)
            loop.apply(change("motion_controller", "retune", handover_time=0.01 + 0.001 * k))
            loop.apply(change("hysteresis_compensator", "stop" if k % 2 else "start"))

    threads = [threading.Thread(target=steer, args=(first,)) for first in range(0, 40, 10)]
    for thread in threads:
        thread.start()
    taken = []
    for thread in threads:
        while thread.is_alive():
            taken.append(loop.take())
            thread.join(0.01)
    loop.leave()
    made = whole(loop, *taken)
    assert_twin(loop, made, given)
    assert set(made["setpoint"]) <= allowed and len(loop.changes) == 80


# ----------------------------------------------------------------------------------------------------- missed deadlines


def test_missed_deadlines_are_skipped_samples_and_the_twin_skips_them_too():
    loop, given = made_loop(factor=SLOWLY, **ANY_LATE)
    loop.set(setpoint=5e-6)
    loop.start()
    until(lambda: loop.sample > 20)
    first = loop.take()
    delay(loop, 40)
    until(lambda: loop.missed >= 39)
    before = loop.sample
    until(lambda: loop.sample > before + 10)
    loop.leave()
    second = loop.take()
    made = whole(loop, first, second)
    assert_twin(loop, made, given)
    skipped = np.flatnonzero(made["skipped"])
    assert len(skipped) == loop.missed
    # exactly the samples that would have begun a period late or more are skipped
    begin = np.argmax(second.table[signals.SKIPPED])
    period = int(loop._state[pacing.PERIOD]) / pacing.FEMTO
    due = loop._state[pacing.ORIGIN] + (second.first + np.arange(len(second.times))) * period
    late = (second.times - loop._offset - due)[begin:]
    clear = np.abs(late - period) > 2.0  # [ns]
    np.testing.assert_array_equal((late >= period)[clear], (second.table[signals.SKIPPED, begin:] == 1.0)[clear])
    np.testing.assert_array_equal(np.isnan(made["seen"]), made["skipped"] == 1.0)
    for name in ("voltage", "plant_voltage"):
        np.testing.assert_array_equal(made[name][skipped], made[name][skipped - 1])
    np.testing.assert_array_equal(made["plant_mode"][skipped], HOLDING)
    np.testing.assert_array_equal(np.diff(made["late"]), made["skipped"][1:])
    assert loop.lateness().max >= 38 / (3000 * SLOWLY)
    # the reference continues as if there had been no delay
    np.testing.assert_array_equal(made["reference"], Axis(given).run(made["setpoint"])["reference"])


def test_a_reader_has_time_while_very_many_samples_are_skipped(monkeypatch):
    monkeypatch.setattr(fused, "KEPT", 0.0)
    monkeypatch.setattr(fused, "LEAST_KEPT", 4000)
    loop, given = made_loop(factor=SLOWLY, **ANY_LATE)
    loop.start()
    until(lambda: loop.sample > 5)
    delay(loop, 9000)
    heads = []
    until(lambda: heads.append(loop.sample) or heads[-1] >= 9000, every=1e-4)
    loop.leave()
    # the loop paused after each quarter of the ring
    assert any(900 < head < 8900 for head in heads)
    assert loop.missed >= 8990


@pytest.mark.parametrize("name", ["kim2009", "inchworm_travel"])
def test_offline_runs_may_skip_any_samples(name):
    given = parameters(name, every={"faults": ["drop:0.0:1.0:0.1"]}, plant_simulator={"late_limit": -1})
    random = np.random.default_rng(7)
    setpoints = np.full(2000, 4e-6 if name == "kim2009" else 5e-5)
    skipped = (random.random(2000) < 0.05).astype(float)
    skipped[700:720] = 1.0
    run = Axis(given).run(setpoints, skipped=skipped)
    plain = Axis(given).run(setpoints, skipped=np.zeros(2000))
    assert_same_bits(plain, Axis(given).run(setpoints))
    assert np.any(run["voltage"] != plain["voltage"])
    missed = np.flatnonzero(skipped)
    missed = missed[missed > 0]
    for signal in ("voltage", "plant_voltage"):
        np.testing.assert_array_equal(run[signal][missed], run[signal][missed - 1])
    assert np.all(np.isnan(run["seen"][missed]))
    np.testing.assert_array_equal(run["skipped"], skipped)
    for signal in ("front_plant_voltage", "rear_plant_voltage") if name != "kim2009" else ():
        np.testing.assert_array_equal(run[signal][missed], run[signal][missed - 1])


def test_too_many_skipped_samples_trip_the_axis():
    skipped = np.zeros(800)
    skipped[300:460] = 1.0
    run = axis(**HOLD).run(np.full(800, 4e-6), skipped=skipped)
    assert not run["tripped"][:450].any() and run["tripped"][460:].all()
    assert run["plant_voltage"][-1] < run["plant_voltage"][450]


@pytest.mark.parametrize("rate", [3000.0, 990.0, 20e3, 7.0])
def test_deadlines_do_not_drift_where_a_period_is_no_whole_number_of_nanoseconds(rate):
    own = pacing_arrays(rate)
    for sample in (0, 1, 3000, 10**6, 10**9):
        own.state[pacing.SAMPLE] = sample
        expected = 10**12 + round(sample * 1e9 / rate)
        # a period is kept in whole femtoseconds
        assert abs(int(interpreted(pacing.deadline_of)(own.state)) - expected) <= 1 + 5e-7 * sample


def pacing_arrays(rate):
    """Return the arrays of a loop at a rate [Hz] whose sample 0 is at 1000 s."""
    own = fused.pace_arrays(axis("kim2009"), rate / 3000.0)
    own.state[pacing.ORIGIN] = 10**12
    return own


def test_what_is_posted_several_times_between_two_samples_acts_once_each():
    loop, _ = made_loop()
    own, took, codes = loop._own, [], []
    # pulses, starts and stops of several samples: each post contains everything so far
    for pulses, setpoint, switch in (
        (2, None, True),
        (0, 3e-6, False),
        (1, 4e-6, True),
        (0, None, False),
        (3, None, False),
    ):
        for _ in range(pulses):
            loop.pulse()
        if setpoint is not None:
            loop.set(setpoint)
        if switch:
            loop._post({0: {pacing.POST_SWITCH: pacing.STOP_CONTROLLER}})
        own.state[pacing.TAKEN] = own.state[pacing.POSTED]
        interpreted(pacing.take_post)(own, 0, False)
        took.append((own.column[0, signals.TRIGGER_IN, 0], own.column[0, signals.SETPOINT, 0]))
        codes.append(int(own.column[0, own.row.shape[1], 0]))
    assert [pulses for pulses, _ in took] == [2.0, 0.0, 1.0, 0.0, 3.0]
    assert [setpoint for _, setpoint in took] == [0.0, 3e-6, 4e-6, 4e-6, 4e-6]
    assert codes == [pacing.STOP_CONTROLLER, 0, pacing.STOP_CONTROLLER, 0, 0]
