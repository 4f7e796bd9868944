# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The inchworm sequencer on an ideal motor: an extender without error, clamps that hold or fail."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references import inchworm_steps
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.references.inchworm_sequencer import InchwormSequencer

RATE = 2000.0
PARAMETERS = InchwormSequencerParameters.from_mapping(
    {"guard.sensor_timeout": 0.0, "fine.smoothing_time": 1e-3, "gait.fine_margin": 1e-6}
)
STROKE = PARAMETERS.gait.stroke
CLOSED = PARAMETERS.gait.threshold_voltage


class Motor:
    """Slider and extender without dynamics; ``carried`` is the fraction of the motion that reaches the slider."""

    def __init__(self, parameters=PARAMETERS, **changes):
        self.sequencer = InchwormSequencer(replace(parameters, **changes), 1.0 / RATE)
        self.slider = self.extender = 0.0
        self.carried = 1.0
        self.drift = 0.0  # of the extender's sensor [m per sample]
        self.drifted = 0.0
        self.blind = False
        self.log = []

    @property
    def x(self):
        return self.sequencer.x

    def step(self, setpoint):
        s = self.sequencer
        measured = math.nan if self.blind else self.slider
        self.drifted += self.drift
        reference = s.step(setpoint, measured, self.extender + self.drifted)
        if s.x[at.SOURCE] == at.FOLLOWING:
            wanted = reference + s.origin - (self.slider - self.extender)
        else:
            wanted = reference + s.x[at.PRETENSION]
        if s.x[at.SOURCE] != at.BLOCKED:
            if s.front_voltage >= CLOSED > s.rear_voltage:
                self.slider += self.carried * (wanted - self.extender)
            self.extender = wanted
        self.log.append((s.front_voltage, s.rear_voltage, s.x[at.PHASE], self.slider))

    def run(self, setpoint, seconds=0.5, until=None):
        for k in range(round(seconds * RATE)):
            self.step(setpoint)
            if until is not None and until():
                return (k + 1) / RATE
        assert until is None, f"still {self.sequencer.phase} after {seconds} s"
        return seconds

    def never_both_open(self):
        started = next((k for k, row in enumerate(self.log) if row[2] != at.STARTING), len(self.log))
        voltages = np.array([[100.0, 100.0], *(row[:2] for row in self.log[started:])])
        gait = self.sequencer.parameters.gait
        assert np.all(voltages.max(axis=1) >= CLOSED)
        assert voltages.min() >= gait.release_voltage and voltages.max() <= gait.grip_voltage


def phases(log):
    codes = [row[2] for row in log]
    return [int(codes[0])] + [int(b) for a, b in zip(codes, codes[1:], strict=False) if a != b]


@pytest.mark.parametrize("setpoint", [100e-6, -100e-6, 3e-6, -0.5e-6, 8.1e-6])
def test_setpoints_are_reached_by_whole_steps_one_partial_step_and_fine_positioning(setpoint):
    motor = Motor()
    motor.run(setpoint, 2.0, lambda: motor.sequencer.arrived and motor.sequencer.phase == "positioning")
    motor.run(setpoint, 0.1)
    assert motor.slider == pytest.approx(setpoint, abs=1e-10)
    assert abs(motor.x[at.STEPS]) == pytest.approx(abs(setpoint) / STROKE, abs=2.0)
    assert max(abs(row[3]) for row in motor.log) <= abs(setpoint) + STROKE
    motor.never_both_open()


def test_a_cycle_goes_through_the_six_processes_in_their_order():
    motor = Motor()
    motor.run(1e-3, 0.5)
    cycle = [at.RELEASING_REAR, at.CARRYING, at.GRIPPING_REAR, at.RELEASING_FRONT, at.RETURNING, at.GRIPPING_FRONT]
    found = [phase for phase in phases(motor.log) if phase != at.HOLDING]
    first = found.index(at.RELEASING_REAR)
    assert found[first : first + 18] == 3 * cycle
    begins = [k for k in range(1, len(motor.log)) if motor.log[k][2] == 2 and motor.log[k - 1][2] != 2]
    assert set(np.diff(begins)) == {round(PARAMETERS.gait.period * RATE)}


def test_a_new_setpoint_turns_the_motor_back_after_the_phase_it_is_in():
    motor = Motor()
    motor.run(1e-3, 0.3)
    motor.run(1e-3, until=lambda: motor.sequencer.phase == "carrying")
    there = motor.slider
    motor.run(-1e-3, 0.3)
    assert max(row[3] for row in motor.log) <= there + STROKE
    assert motor.slider < there - 3 * STROKE
    motor.never_both_open()


@pytest.mark.parametrize("phase", at.PHASE_NAMES[2:10])
def test_stop_closes_both_clamps_within_one_phase_and_start_goes_on(phase):
    motor = Motor()
    motor.run(0.0, 0.1)
    if phase == "released":
        motor.sequencer.request(at.RELEASE_REQUEST)
    target = 0.0 if phase == "positioning" else 1e-3
    motor.run(target, until=lambda: motor.sequencer.phase == phase)
    motor.step(target)
    motor.sequencer.request(at.STOP_REQUEST)
    longest = max(PARAMETERS.gait.extend, PARAMETERS.gait.contract)
    closed = PARAMETERS.gait.grip_voltage
    motor.run(target, longest, lambda: motor.sequencer.front_voltage == motor.sequencer.rear_voltage == closed)
    motor.run(target, 0.1)
    there = motor.slider
    assert motor.sequencer.phase == "holding"
    motor.run(target, 0.3)
    assert motor.slider == there
    motor.sequencer.request(at.START_REQUEST)
    motor.run(60e-6, 1.0, lambda: motor.sequencer.arrived and abs(motor.slider - 60e-6) < 1e-8)
    motor.never_both_open()


def test_release_lets_go_with_the_front_clamp_only_and_home_goes_home():
    motor = Motor(home_position=20e-6)
    motor.run(60e-6, 1.0, lambda: motor.sequencer.arrived)
    motor.sequencer.request(at.RELEASE_REQUEST)
    motor.run(60e-6, until=lambda: motor.sequencer.phase == "released")
    assert (motor.sequencer.front_voltage, motor.sequencer.rear_voltage) == (0.0, 100.0)
    assert motor.sequencer.reference == motor.extender == 0.0
    motor.run(60e-6, 0.2)
    motor.sequencer.request(at.HOME_REQUEST)
    motor.run(60e-6, 1.0, lambda: motor.sequencer.arrived and abs(motor.slider - 20e-6) < 1e-9)
    motor.never_both_open()


@pytest.mark.parametrize("target", [1e-3, -1e-3])
@pytest.mark.parametrize("phase", at.PHASE_NAMES[2:8])
def test_a_release_in_any_phase_of_a_step_relaxes_the_extender(phase, target):
    motor = Motor()
    motor.run(target, 0.3)
    motor.run(target, until=lambda: motor.sequencer.phase == phase)
    motor.sequencer.request(at.RELEASE_REQUEST)
    motor.run(target, until=lambda: motor.sequencer.phase == "released")
    assert motor.sequencer.reference == PARAMETERS.resting_extension
    assert (motor.sequencer.front_voltage, motor.sequencer.rear_voltage) == (0.0, 100.0)
    motor.never_both_open()


def test_setpoints_outside_of_the_travel_are_refused_with_the_range_and_change_nothing():
    motor = Motor()
    assert "-5000 … 5000 µm" in motor.sequencer.refuse(6e-3)
    assert motor.sequencer.refuse(math.nan) and motor.sequencer.refuse(5e-3) is None
    motor.run(20e-6, 0.5, lambda: motor.sequencer.arrived)
    for wrong in (6e-3, math.nan, -math.inf):
        motor.run(wrong, 0.1)
    assert motor.slider == pytest.approx(20e-6, abs=1e-9) and motor.x[at.REFUSED] == 2.0


def test_without_a_measurement_both_clamps_close_until_it_is_back():
    motor = Motor()
    motor.run(1e-3, 0.3)
    motor.blind = True
    motor.run(1e-3, PARAMETERS.gait.grip + 2 / RATE)
    assert motor.sequencer.front_voltage == motor.sequencer.rear_voltage == 100.0
    assert motor.sequencer.error == "sensor"
    motor.run(1e-3, 0.1)
    there, motor.blind = motor.slider, False
    motor.run(1e-3, 0.3)
    assert motor.sequencer.error == "" and motor.slider > there + 3 * STROKE
    motor.never_both_open()


@pytest.mark.parametrize("wild", [math.inf, -math.inf])
@pytest.mark.parametrize("which", ["slider", "extender"])
def test_an_infinite_measurement_is_a_missing_one(wild, which):
    motor = Motor()
    motor.run(3e-6, 1.0, lambda: motor.sequencer.arrived)
    s = motor.sequencer
    before = s.x[at.SLIDER], s.x[at.EXTENDER]
    s.step(3e-6, *({"slider": motor.slider, "extender": motor.extender} | {which: wild}).values())
    assert s.x[at.BAD] == 1.0 and (s.x[at.SLIDER], s.x[at.EXTENDER]) == before
    assert s.x[at.ERROR] == at.SENSOR_ERROR and np.isfinite(s.x).all()


def test_a_motor_that_does_not_move_gives_up_after_as_many_steps_and_holds():
    motor = Motor()
    motor.carried = 0.0
    motor.run(1e-3, 2.0, lambda: motor.sequencer.error != "")
    assert motor.sequencer.error == "no_motion"
    assert motor.x[at.TOTAL_STEPS] == PARAMETERS.guard.still_steps == motor.x[at.MISSED]
    motor.run(1e-3, 0.1)
    assert motor.sequencer.phase == "holding"
    motor.carried = 1.0
    motor.sequencer.request(at.START_REQUEST)
    motor.run(50e-6, 1.0, lambda: motor.sequencer.arrived)
    assert motor.sequencer.error == ""


def test_a_front_clamp_that_slips_in_fine_positioning_is_gripped_anew_then_given_up():
    motor = Motor()
    motor.run(0.0, 0.3)
    motor.carried = 0.1
    motor.run(0.9e-6, 5.0, lambda: motor.sequencer.error != "")
    assert motor.sequencer.error in ("slip", "no_motion")
    motor.run(0.9e-6, 0.1)
    assert motor.sequencer.phase == "holding"
    motor.never_both_open()


@pytest.mark.parametrize(("part", "direction"), [(0.5, 1.0), (0.5, -1.0), (3.0, 1.0), (3.0, -1.0)])
def test_drift_is_no_slip_however_far_it_goes(part, direction):
    guard = replace(PARAMETERS.guard, slip=20e-9, drift=1e-6)
    motor = Motor(guard=guard)
    motor.run(0.9e-6, 1.0, lambda: motor.sequencer.arrived and motor.sequencer.phase == "positioning")
    motor.run(0.9e-6, 0.1)
    motor.log.clear()
    motor.drift = direction * part * guard.drift / RATE
    motor.run(0.9e-6, 1.0)
    assert abs(motor.drifted) > 20.0 * guard.slip
    # a drift slower than the guard's limit may last forever; a faster one means that the clamp slips
    assert (phases(motor.log) == [at.POSITIONING]) == (part < 1.0)
    if part < 1.0:
        assert np.ptp([row[3] for row in motor.log]) < 1e-12
        # a slip is nevertheless detected
        motor.extender += 1.5 * guard.slip
        motor.run(0.9e-6, 0.1)
        assert at.GRIPPING_REAR in phases(motor.log)


def test_slip_is_learned_reported_and_made_good_by_more_steps():
    motor = Motor()
    motor.carried = 0.7
    motor.run(400e-6, 4.0, lambda: motor.sequencer.arrived)
    assert motor.slider == pytest.approx(400e-6, abs=PARAMETERS.fine.tolerance)
    learned = motor.sequencer.learned
    assert learned["forward_gain"] + learned["forward_offset"] / STROKE == pytest.approx(0.7, abs=0.01)
    assert motor.x[at.TOTAL_STEPS] == pytest.approx(400e-6 / (0.7 * STROKE), abs=2.0)


def test_a_slider_that_runs_away_under_closed_clamps_is_an_error():
    motor = Motor()
    motor.run(0.0, 0.2)
    motor.sequencer.request(at.STOP_REQUEST)
    motor.run(0.0, 0.1)
    motor.slider += 2.0 * PARAMETERS.guard.runaway
    motor.run(0.0, 0.01)
    assert motor.sequencer.error == "runaway"
    assert motor.sequencer.front_voltage == motor.sequencer.rear_voltage == 100.0


@pytest.mark.parametrize("part", [1.0, -0.6, 0.05])
def test_continuous_walking_keeps_its_speed_and_then_holds(part):
    motor = Motor()
    motor.run(0.0, 0.1)
    speed = part * PARAMETERS.gait.speed
    assert motor.sequencer.walk(speed) is None
    assert "0.000307692 m/s" in motor.sequencer.walk(2.0 * PARAMETERS.gait.speed)
    motor.run(0.0, 0.2)
    before, step = motor.slider, max(abs(part), 0.1) * STROKE
    motor.run(0.0, 1.0)
    # to within one step
    assert motor.slider - before == pytest.approx(speed * 1.0, abs=1.05 * step)
    motor.sequencer.walk(0.0)
    motor.run(0.0, 0.1)
    there = motor.slider
    motor.run(0.0, 0.2)
    assert motor.slider == pytest.approx(there, abs=1e-8)
    motor.never_both_open()


@pytest.mark.slow
def test_least_squares_find_gain_and_offset_and_stay_bounded():
    x = np.zeros(inchworm_steps.SIZE)
    inchworm_steps.forget_all(x, 0, 1.0, 0.0)
    random = np.random.default_rng(1)
    for u in random.uniform(0.1, 1.0, 200):
        inchworm_steps.learn(x, 0, 0.98, u, 0.8 * u - 0.05 + 1e-4 * random.normal())
    assert x[inchworm_steps.GAIN] == pytest.approx(0.8, abs=1e-3) and x[inchworm_steps.OFFSET] == pytest.approx(
        -0.05, abs=1e-3
    )
    for _ in range(5000):
        inchworm_steps.learn(x, 0, 0.9, 1.0, 0.75)
    assert np.all(np.isfinite(x)) and x[inchworm_steps.COVARIANCE] + x[inchworm_steps.COVARIANCE + 2] < 0.02
    assert x[inchworm_steps.GAIN] + x[inchworm_steps.OFFSET] == pytest.approx(0.75, abs=1e-6)
    length = inchworm_steps.longest_step(x, 0, 0.5)
    assert inchworm_steps.extension_for(x, 0, length) == pytest.approx(0.5)


def test_full_steps_alone_leave_the_gain_where_it_was():
    x = np.zeros(inchworm_steps.SIZE)
    inchworm_steps.forget_all(x, 0, 1.0, 0.0)
    for u, z in [(1.0, 0.4), (0.7, 0.45), (0.55, 0.48), *[(0.54, 0.49)] * 2000]:  # a load that is being learned
        inchworm_steps.learn(x, 0, 0.98, u, z)
    assert 0.5 <= x[inchworm_steps.GAIN] <= 1.5
    assert x[inchworm_steps.GAIN] * 0.54 + x[inchworm_steps.OFFSET] == pytest.approx(0.49, abs=1e-3)
    assert inchworm_steps.extension_for(x, 0, 0.4) > 0.3


def test_a_wrong_model_that_wants_no_extension_gives_up_instead_of_stepping_on_the_spot():
    motor = Motor()
    motor.run(0.0, 0.2, lambda: motor.sequencer.arrived)
    motor.x[at.FORWARD_MODEL + inchworm_steps.OFFSET] = 1.0  # as if a load moved the slider
    motor.x[at.FORWARD_MODEL + inchworm_steps.COVARIANCE] = motor.x[
        at.FORWARD_MODEL + inchworm_steps.COVARIANCE + 2
    ] = 0.0
    motor.run(7e-6, 3.0, lambda: motor.sequencer.error == "no_motion")
    motor.never_both_open()


def test_the_schedule_gives_setpoints_without_hands():
    given = {"setpoints.values": [1e-3, -1e-3], "setpoints.times": [0.001, 0.002], "setpoints.duration": 0.003}
    sequencer = InchwormSequencer(InchwormSequencerParameters.from_mapping(given), 1.0 / RATE)
    np.testing.assert_array_equal(sequencer.scheduled(6), [0.0, 0.0, 1e-3, 1e-3, -1e-3, -1e-3])
    assert sequencer.duration_samples == 6
    for wrong in ({"setpoints.values": [6e-3], "setpoints.times": [0.0]}, {"setpoints.values": [1e-3]}):
        with pytest.raises(ParameterError, match="setpoints"):
            InchwormSequencerParameters.from_mapping(wrong)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0.0, 2e-6, 5e-5, -5e-5, 1e-3, 1.0, math.nan]),
            st.sampled_from([0, 0, 1, 2, 3, 4]),
            st.sampled_from([math.nan, math.nan, 0.0, 2e-4, -3e-4]),
            st.booleans(),
            st.integers(1, 60),
            st.sampled_from([1.0, 1.0, 0.3, 0.0]),
        ),
        min_size=3,
        max_size=15,
    )
)
def test_whatever_is_asked_never_are_both_clamps_open(events):
    motor = Motor()
    for setpoint, request, speed, blind, samples, carried in events:
        motor.sequencer.request(request)
        if speed == speed:
            motor.sequencer.walk(speed)
        motor.blind, motor.carried = blind, carried
        for _ in range(samples):
            motor.step(setpoint)
    motor.blind = False
    motor.never_both_open()
    assert np.all(np.isfinite(motor.x))


def test_parameters_do_not_change_under_a_walking_motor():
    sequencer = InchwormSequencer(PARAMETERS, 1.0 / RATE)
    sequencer.retune(PARAMETERS)
    with pytest.raises(ParameterError, match="configure again"):
        sequencer.retune(replace(PARAMETERS, home_position=1e-6))


def test_the_table_has_units_and_descriptions():
    for row in InchwormSequencerParameters.table():
        assert row.description, row.name
