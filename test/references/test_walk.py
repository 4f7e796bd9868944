# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Continuous walking over the phase of the cycle, on an ideal motor whose extender has the same error everywhere."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.interpolate import BSpline

from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references import inchworm_parameters as walks
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.references.inchworm_sequencer import InchwormSequencer
from hysteresis_ros.references.inchworm_walk import bend, carried, spline, spline_bend, tip

RATE = 4000.0
SPEED = 1.0e-4
PARAMETERS = InchwormSequencerParameters.from_mapping(
    {"walk.continuous": True, "walk.learning_speed": SPEED, "gait.initial_voltage": 100.0}
)
GAIT, WALK = PARAMETERS.gait, PARAMETERS.walk


class Motor:
    """The slider is on the extender's tip while the rear clamp is open, one sample after the outputs."""

    def __init__(self, **walk):
        parameters = replace(PARAMETERS, walk=replace(WALK, **walk))
        self.sequencer = InchwormSequencer(parameters, 1.0 / RATE)
        self.slider = self.tip = 0.0
        self.gripped = 0.0
        self.log = []

    @property
    def x(self):
        return self.sequencer.x

    def wrong(self, extension):
        """Return the true position of the tip: 2 % too long, and nonlinear."""
        return 1.02 * extension + 0.1e-6 * math.sin(extension / 1.1e-6)

    def step(self, setpoint=0.0, blind=False):
        s = self.sequencer
        # the tip of this sample is the mean of the previous and the current output: half a sample late
        s.step(setpoint, math.nan if blind else self.slider, self.tip)
        front, rear = s.front_voltage, s.rear_voltage
        before, self.tip = self.tip, self.wrong(self.x[at.TIP])
        if front < WALK.touch_voltage:
            self.gripped = 0.0
        elif not self.gripped:
            self.gripped = 1.0
        elif rear < WALK.touch_voltage:
            self.slider += self.tip - before
        self.log.append((front, rear, self.x[at.PHASE], self.slider, self.x[at.PATH_ERROR], self.x[at.CORRECTION]))

    def walk(self, speed, cycles, until=None):
        """Walk for some cycles; returns the errors from the path."""
        assert self.sequencer.walk(speed) is None
        samples = round(cycles * WALK.step / abs(speed) * RATE)
        first = len(self.log)
        for _ in range(samples):
            self.step()
            if until is not None and until():
                break
        return np.array([row[4] for row in self.log[first:]])

    def rms(self, speed):
        """RMS of the errors from the path over two cycles, from the third on."""
        self.walk(speed, 3)
        return float(np.std(self.walk(speed, 2)))


def learned(cycles=25, **walk):
    motor = Motor(**walk)
    motor.walk(SPEED, 1)
    motor.sequencer.request(at.LEARN_REQUEST)
    motor.walk(SPEED, cycles)
    motor.sequencer.request(at.FREEZE_REQUEST)
    motor.step()
    return motor


def test_the_carrying_motion_is_straight_between_smooth_ends():
    part = np.linspace(-0.1, 1.1, 2401)
    for blend in (0.05, 0.2, 0.4, 0.5):
        way = np.array([carried(blend, value) for value in part])
        assert way[0] == 0.0 and way[-1] == 1.0 and np.all(np.diff(way) >= -1e-15)
        np.testing.assert_allclose(way, 1.0 - way[::-1], atol=1e-12)
        middle = (part > blend + 1e-3) & (part < 1.0 - blend - 1e-3)
        np.testing.assert_allclose(np.gradient(way, part)[middle], 1.0 / (1.0 - blend), rtol=1e-9)
        inside = (part > 0.0) & (part < 1.0)
        second = np.gradient(np.gradient(way, part), part)[inside]
        found = np.array([bend(blend, value) for value in part[inside]])
        assert np.max(np.abs(second - found)) < 0.03 * np.max(np.abs(found))


def test_the_correction_is_a_periodic_cubic_spline():
    coefficients = np.random.default_rng(1).normal(size=12)
    phases = np.linspace(0.0, 0.999, 97)
    found = [spline(np.array([7.0, *coefficients]), 1, 12, phase) for phase in phases]
    knots = np.arange(-3, 16) / 12.0
    expected = BSpline(knots, np.take(coefficients, np.arange(-1, 14), mode="wrap"), 3)(phases)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(walks.basis(phases, 12) @ coefficients, expected, atol=1e-12)
    second = BSpline(knots, np.take(coefficients, np.arange(-1, 14), mode="wrap"), 3).derivative(2)(phases)
    found = [spline_bend(np.array([7.0, *coefficients]), 1, 12, phase) for phase in phases]
    np.testing.assert_allclose(found, second, atol=1e-9)
    np.testing.assert_allclose(walks.basis(phases, 12, second=True) @ coefficients, second, atol=1e-9)


def test_the_processes_of_a_cycle_take_their_part_of_it():
    gait = replace(GAIT, extend=8e-3, contract=5e-3, release=2e-3)
    for direction, carrying, returning in ((1, 8e-3, 5e-3), (-1, 5e-3, 8e-3)):
        ends = walks.phase_bounds(gait, direction) * gait.period
        assert ends[at.CARRIED] - ends[at.CARRY] == pytest.approx(carrying)
        assert ends[at.RETURNED] == pytest.approx(0.5 * returning)
        assert gait.period - ends[at.RETURN] == pytest.approx(0.5 * returning)
        assert ends[at.CARRY] - ends[at.OPEN_REAR] == pytest.approx(gait.release)
        assert ends[at.OPEN_FRONT] - ends[at.CLOSE_REAR] == pytest.approx(gait.grip)


@pytest.mark.parametrize("part", [0.3, 1.0, -1.0])
def test_a_motor_that_is_as_the_models_say_is_on_its_path_at_any_speed(part):
    motor = Motor()
    motor.wrong = lambda extension: extension
    fastest = WALK.fastest(GAIT)
    error = motor.walk(part * fastest, 4)[round(WALK.step / abs(part * fastest) * RATE) :]
    # the outputs are half a sample ahead, and this motor is a whole sample late
    speed = abs(part) * WALK.step / (1.0 - WALK.blend) / GAIT.extend
    assert np.max(np.abs(error)) < 0.51 * speed / RATE
    steps = motor.x[at.STEPS]
    assert steps == pytest.approx(math.copysign(4, part), abs=1.5) and motor.x[at.MISSED] == 0.0
    before = motor.slider
    motor.walk(part * fastest, 4)
    assert motor.slider - before == pytest.approx(math.copysign(4 * WALK.step, part), abs=1e-10)


def test_what_is_learned_at_one_speed_is_right_at_others():
    motor = Motor()
    before = {part: motor.rms(part * SPEED) for part in (0.2, 0.5, 1.0, 2.0)}
    assert min(before.values()) > 3e-8
    motor = learned(lead=0.5 / RATE)
    after = {part: motor.rms(part * SPEED) for part in before}
    assert after[1.0] < before[1.0] / 50.0
    assert all(after[part] < before[part] / 20.0 for part in before), (before, after)
    assert motor.x[at.LEARNED_CYCLES] >= 20 and not np.any(motor.sequencer.learned_walk.backward)


def test_a_correction_that_no_error_determines_becomes_smooth():
    motor = Motor()
    motor.wrong = lambda extension: extension
    motor.walk(SPEED, 1)
    # both clamps hold between these phases: the slider does not follow there
    held = np.flatnonzero((np.arange(WALK.splines) > 5) & (np.arange(WALK.splines) < 9))
    motor.x[at.WALK + held] = 0.4e-6 * (-1.0) ** held
    motor.sequencer.request(at.LEARN_REQUEST)
    motor.walk(SPEED, 30)
    found = motor.sequencer.learned_walk.forward
    assert np.max(np.abs(found - 0.5 * (np.roll(found, 1) + np.roll(found, -1)))) < 0.06e-6


def contact_and_ramp(motor, part):
    """Walk at a part of the highest speed; return the phases at which the rear clamp lets go and touches, and the
    duration of its opening [samples]."""
    fastest = WALK.fastest(GAIT)
    motor.walk(part * fastest, 3)
    phases, first = [], len(motor.log)
    for _ in range(round(1.5 * WALK.step / (part * fastest) * RATE)):
        motor.step()
        phases.append(motor.x[at.CYCLE_PHASE])
    rear = np.array(motor.log[first:])[:, 1]
    closed = rear > WALK.touch_voltage
    opens, closes = (np.flatnonzero(change)[0] for change in (closed[:-1] & ~closed[1:], ~closed[:-1] & closed[1:]))
    between = (rear > GAIT.release_voltage) & (rear < GAIT.grip_voltage)
    last = opens + int(np.argmin(between[opens:]))
    start = opens - int(np.argmin(between[opens::-1]))
    return phases[opens], phases[closes], last - start


def test_quick_clamps_take_the_gaits_time_and_touch_at_the_same_phase_at_any_speed():
    for quick in (True, False):
        for part in (0.05, 0.3, 1.0):
            motor = Motor(quick_clamps=quick)
            lets_go, touches, length = contact_and_ramp(motor, part)
            sample = part / (GAIT.period * RATE)
            bounds, (touch, free) = walks.phase_bounds(GAIT, 1), walks.contacts(motor.sequencer.parameters.walk, GAIT)
            ramp = GAIT.release / GAIT.period
            assert abs(lets_go - (bounds[at.OPEN_REAR] + free * ramp)) < 1.6 * sample
            assert abs(touches - (bounds[at.CLOSE_REAR] + touch * ramp)) < 1.6 * sample
            assert length == pytest.approx(GAIT.release * RATE / (1.0 if quick else part), abs=2.1)
            clamps = np.array(motor.log)[:, :2]
            assert np.all(clamps.max(axis=1) >= GAIT.threshold_voltage)


def test_clamps_lead_by_their_delay_at_any_speed():
    late = 8.0 / RATE
    for part in (0.3, 1.0):
        (one, two, _), (led, also, _) = (contact_and_ramp(Motor(clamp_lead=lead), part) for lead in (0.0, late))
        ahead = late * part / GAIT.period
        sample = part / (GAIT.period * RATE)
        assert abs(one - led - ahead) < 1.1 * sample and abs(two - also - ahead) < 1.1 * sample


def test_backward_is_learned_apart_from_forward():
    motor = learned()
    forward = motor.sequencer.learned_walk.forward
    before = motor.rms(-SPEED)
    motor.sequencer.request(at.LEARN_REQUEST)
    motor.walk(-SPEED, 20)
    assert motor.rms(-SPEED) < before / 20.0
    np.testing.assert_array_equal(motor.sequencer.learned_walk.forward, forward)


def test_frozen_or_at_another_speed_nothing_is_learned_and_forgotten_is_forgotten_without_a_jump():
    motor = learned(8)
    found = motor.sequencer.learned_walk.forward
    motor.walk(SPEED, 3)
    motor.sequencer.request(at.LEARN_REQUEST)
    motor.walk(0.7 * SPEED, 3)
    np.testing.assert_array_equal(motor.sequencer.learned_walk.forward, found)
    motor.x[at.WALK : at.WALK + WALK.splines] = 0.5e-6
    motor.walk(0.7 * SPEED, 2)
    motor.sequencer.request(at.FORGET_REQUEST)
    first = len(motor.log)
    motor.walk(0.7 * SPEED, 3)
    correction = np.array([row[5] for row in motor.log[first:]])
    assert not np.any(motor.sequencer.learned_walk.forward) and correction[-1] == 0.0
    assert correction[0] == pytest.approx(0.5e-6) and np.max(np.abs(np.diff(correction))) < 0.1e-6


def test_a_cycle_without_all_measurements_teaches_nothing():
    motor = Motor()
    motor.walk(SPEED, 1)
    motor.sequencer.request(at.LEARN_REQUEST)
    motor.sequencer.walk(SPEED)
    for k in range(round(4 * WALK.step / SPEED * RATE)):
        motor.step(blind=k % 100 == 0)
    assert motor.x[at.LEARNED_CYCLES] == 0.0 and motor.sequencer.error == ""


def test_a_correction_stays_within_its_bound_whatever_the_motor_does():
    motor = Motor(bound=0.2e-6)
    motor.wrong = lambda extension: 0.6 * extension
    motor.sequencer.request(at.LEARN_REQUEST)
    motor.walk(SPEED, 30)
    found = motor.sequencer.learned_walk.forward
    assert np.max(np.abs(found)) == 0.2e-6
    assert np.max(np.abs([row[5] for row in motor.log])) <= 0.2e-6 * (1.0 + 1e-12)


@pytest.mark.parametrize("phase", [2, 3, 4, 5, 6, 7])
@pytest.mark.parametrize("end", ["stop", "turn", "setpoint", "blind", "release"])
def test_a_walk_ends_from_any_process_with_both_clamps_closed(phase, end):
    motor = learned(2)
    motor.walk(SPEED, 3, until=lambda: motor.x[at.PHASE] == phase)
    for _ in range(3):
        motor.step()
    assert motor.x[at.CYCLE] == 1.0
    first = len(motor.log)
    request = {"stop": at.STOP_REQUEST, "release": at.RELEASE_REQUEST}.get(end)
    if request is not None:
        motor.sequencer.request(request)
    elif end in ("turn", "setpoint"):
        motor.sequencer.walk(-SPEED if end == "turn" else 0.0)
    closing = round((GAIT.grip + PARAMETERS.guard.sensor_timeout) * RATE) + 2
    for _ in range(closing):
        motor.step(blind=end == "blind")
        if motor.x[at.PHASE] == at.HOLDING and motor.x[at.CYCLE] == 0.0:
            break
    log = np.array(motor.log[first:])
    assert np.any(np.all(log[:, :2] == GAIT.grip_voltage, axis=1))
    for _ in range(200):
        motor.step(-2e-5 if end == "setpoint" else 0.0, blind=end == "blind")
    clamps = np.array(motor.log)[:, :2]
    assert np.all(clamps.max(axis=1) >= GAIT.threshold_voltage)
    if end in ("stop", "blind"):
        assert np.all(clamps[-150:] == GAIT.grip_voltage)
        assert abs(motor.slider - log[0, 3]) < WALK.step


def test_it_ends_where_the_travel_ends():
    parameters = replace(PARAMETERS, maximum=2.5 * WALK.step)
    motor = Motor()
    motor.sequencer = InchwormSequencer(parameters, 1.0 / RATE)
    motor.walk(2.0 * SPEED, 8)
    assert motor.slider == pytest.approx(2 * WALK.step, rel=0.05) and motor.x[at.PHASE] == at.HOLDING
    motor.walk(-2.0 * SPEED, 2)
    assert motor.slider < 1.5 * WALK.step


def test_what_was_learned_is_a_file_that_goes_on_as_before(tmp_path):
    motor = learned(8)
    path = tmp_path / "walk.yaml"
    motor.sequencer.save(path)
    motor.rms(0.5 * SPEED)
    other = Motor(file=str(path))
    np.testing.assert_array_equal(other.sequencer.learned_walk.forward, motor.sequencer.learned_walk.forward)
    fresh = Motor().rms(0.5 * SPEED)
    assert other.rms(0.5 * SPEED) < fresh / 5.0
    other.sequencer.reset()
    np.testing.assert_array_equal(other.sequencer.learned_walk.forward, motor.sequencer.learned_walk.forward)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "cannot be read"),
        ("[1, 2]", "not a file of a learned walk"),
        ("inchworm_walk: {step: 6.0e-6, forward: [a], backward: []}", "not a file of a learned walk"),
        ("inchworm_walk: {step: 5.0e-6, forward: [0.0], backward: [0.0]}", "steps of 5e-06 m"),
        ("inchworm_walk: {step: 6.0e-6, forward: [0.0], backward: [0.0]}", "has 1 coefficients; walk.splines is 32"),
        (yaml.dump({"inchworm_walk": {"step": 6e-6, "forward": [2e-6] * 32, "backward": [0.0] * 32}}), "1e-06 m"),
        (yaml.dump({"inchworm_walk": {"step": 6e-6, "forward": [math.nan] * 32, "backward": [0.0] * 32}}), "finite"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(tmp_path, text, said):
    path = tmp_path / "walk.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ParameterError, match=said):
        Motor(file=str(path))


def test_saving_without_a_file_or_into_nowhere_is_refused(tmp_path):
    with pytest.raises(ParameterError, match="names no file"):
        Motor().sequencer.save()
    with pytest.raises(ConfigurationError, match="cannot be written"):
        Motor().sequencer.save(tmp_path / "none" / "walk.yaml")
    with pytest.raises(ParameterError, match="walk.continuous"):
        InchwormSequencer(replace(PARAMETERS, walk=replace(WALK, continuous=False)), 1.0 / RATE).save()


@pytest.mark.parametrize(
    ("changes", "name", "said"),
    [
        ({"walk.step": 7e-6}, "walk.step", "half of stroke − step with stroke = 8e-06 m"),
        ({"walk.bound": 1.1e-6}, "walk.step", "1e-06"),
        ({"gait.overlap": 1e-3}, "gait.overlap", "must be 0"),
        ({"gait.walking_speed": 2.5e-4}, "gait.walking_speed", "0.000230769 m/s"),
        ({"walk.learning_speed": 2.5e-4}, "walk.learning_speed", "nothing would be learned"),
        ({"walk.gain": 1.9}, "walk.gain", "multiplies an error by"),
        ({"walk.gain": 1.8, "walk.swing": 456.0, "walk.learning_speed": 1.9e-4}, "walk.gain", "multiplies"),
    ],
)
def test_what_does_not_fit_is_refused_by_name_and_number(changes, name, said):
    with pytest.raises(ParameterError) as error:
        InchwormSequencerParameters.from_mapping({"walk.continuous": True, "walk.learning_speed": SPEED, **changes})
    found = {problem.name: problem.remedy for problem in error.value.problems}
    assert name in found and said in str(error.value)
    assert InchwormSequencerParameters.from_mapping(changes | {"gait.overlap": 0.0, "gait.walking_speed": 0.0})


def test_speeds_beyond_the_walk_are_refused_with_the_number():
    motor = Motor()
    assert "0.000230769 m/s" in motor.sequencer.walk(2.4e-4)
    assert motor.sequencer.walk(float("nan")) and motor.x[at.SPEED] == 0.0


def test_the_learning_finds_what_the_response_says_it_can():
    """A disturbance that the extender can cancel is reduced to the limit of the weights; other modes stay."""
    (learning, kept), moved = walks.learning_matrices(WALK, GAIT, 1), walks.response(WALK, GAIT, 1)
    np.testing.assert_allclose(moved @ np.ones(WALK.splines), 0.0, atol=1e-12)
    wanted = moved @ np.random.default_rng(2).normal(size=WALK.splines)
    rest = wanted - moved @ (learning @ wanted)
    assert np.std(rest) < 0.2 * np.std(wanted)
    # repeated, it ends where error and curvature are least together: also where the error determines nothing
    found = np.random.default_rng(3).normal(size=WALK.splines)
    for _ in range(2000):
        found += learning @ (wanted - moved @ found) - kept @ found
    curvature = np.roll(np.eye(WALK.splines), 1, axis=0) - 2.0 * np.eye(WALK.splines)
    curvature += np.roll(np.eye(WALK.splines), -1, axis=0)
    weight = walks.CURVATURE_WEIGHT * np.mean(np.sum(moved**2, axis=0))
    both = np.vstack([moved, np.sqrt(weight) * curvature])
    least = np.linalg.lstsq(both, np.r_[wanted, np.zeros(WALK.splines)], rcond=None)[0]
    np.testing.assert_allclose(both @ found, both @ least, atol=1e-6 * np.std(wanted))
    # before the rear clamp is open the slider does not follow, and after the last grip it keeps its position
    bounds = walks.phase_bounds(GAIT, 1)
    phases = (np.arange(len(moved)) + 0.5) / len(moved)
    assert not np.any(moved[phases < bounds[at.OPEN_REAR]])
    stays = moved[phases > bounds[at.OPEN_FRONT]]
    np.testing.assert_array_equal(stays, np.broadcast_to(stays[0], stays.shape))


def test_a_slider_that_oscillates_follows_a_correction_that_leads_by_its_dynamics():
    coefficients = np.exp(-(((np.arange(WALK.splines) - 15.0) / 1.5) ** 2))
    fast = replace(WALK, swing=456.0, resonance=635.0, learning_speed=1.9e-4)
    moved = walks.response(fast, GAIT, 1) @ coefficients
    phases = (np.arange(8 * len(moved)) + 0.5) / (8 * len(moved))
    wanted = (walks.basis(phases, WALK.splines) @ coefficients).reshape(-1, 8).mean(axis=1)
    assert np.max(np.abs(moved - wanted)) < 0.02 * np.max(wanted)


@pytest.mark.slow
def test_the_extender_leads_by_the_acceleration_of_path_and_correction():
    walk = replace(WALK, swing=300.0, swing_damping=0.2, resonance=635.0)
    sequencer = InchwormSequencer(replace(PARAMETERS, walk=walk), 1.0 / RATE)
    p, x, omega = sequencer.p, sequencer.x, 2.0 * math.pi * walk.swing / RATE
    x[at.DIRECTION] = 1.0
    x[at.WALK : at.WALK + WALK.splines] = 1e-7 * np.random.default_rng(4).normal(size=WALK.splines)

    def desired(phase, rate=0.0):
        x[at.CYCLE_RATE] = rate
        return tip(p, x, phase, 1.0)

    bounds, rate, d = walks.phase_bounds(GAIT, 1), 0.003, 1e-4
    for phase in np.linspace(bounds[at.CARRY] + 0.03, bounds[at.CARRIED] - 0.03, 23):
        late = phase - 2.0 * walk.swing_damping / omega * rate
        acceleration = (desired(late + d) - 2.0 * desired(late) + desired(late - d)) / d**2 * rate**2
        assert desired(phase, rate) - desired(phase) == pytest.approx(acceleration / omega**2, abs=1e-10)
