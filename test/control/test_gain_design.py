# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Designs reach the requested bandwidth, place the stated poles, and refuse models and requests by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.control.controller import DESIGNS, ControllerParameters
from hysteresis_ros.control.kalman import KalmanParameters, filter_gain
from hysteresis_ros.control.laws.pid import (
    PidParameters,
    design_integral,
    design_pid,
    pid_state_space,
    pid_with_zeros,
    slowest_poles,
)
from hysteresis_ros.control.margins import AIMED, REQUIRED, judge, plant_state_space
from hysteresis_ros.control.sliding_gains import scaled, wandering
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearParameters

T = 1.0 / 3000.0


@pytest.mark.slow
@pytest.mark.parametrize("controller", DESIGNS)
def test_bandwidth_is_met_on_the_published_axis(parameters, controller):
    found = design_gains(parameters({"super_twisting.bound": 10.0}), controller, T, bandwidth=100.0)
    assert found.parameters.type == DESIGNS[controller][0].name
    assert found.margins.bandwidth == pytest.approx(100.0, rel=1e-3)
    assert found.margins.stable


def test_order_one_pi_has_the_closed_form():
    # the zero cancels the lag: L = g/(z - 1), with the single pole 1 - g
    a, time = 0.686131723, 0.005
    lag = LinearParameters(A=(a,), B=(1.0 - a,), C=(1.0,), output_scale=1e-6)
    gains = design_pid(PidParameters(), lag, time, bandwidth=10.0)
    zero = (gains.Kp - 0.5 * gains.Ki * time) / (gains.Kp + 0.5 * gains.Ki * time)
    assert zero == pytest.approx(a)
    g = gains.Ki * time
    w, p = 2.0 * np.pi * 10.0 * time, 1.0 - g
    assert g * g / (1.0 - 2.0 * p * np.cos(w) + p * p) == pytest.approx(0.5, rel=1e-4)


def test_zeros_stand_where_they_are_wanted():
    zeros = [0.3 + 0.9j, 0.3 - 0.9j]
    Kp, Ki, Kd = pid_with_zeros(zeros, 0.2, T, 3000.0)
    found = pid_state_space(PidParameters(Kp=Kp, Ki=Ki, Kd=Kd, derivative_filter=3000.0), T)
    D, of_zeros = found.D[0, 0], found.A - found.B[:, :1] @ found.C / found.D[0, 0]
    assert sorted(np.linalg.eigvals(of_zeros), key=np.imag) == pytest.approx(sorted(zeros, key=np.imag))
    assert pytest.approx(0.2) == D


def test_q_sets_the_filter_and_offset_free_estimates_a_disturbance(parameters):
    found = design_gains(parameters(), "offset_free", T, q=0.5).parameters.kalman
    assert (found.gain, found.disturbance, found.q / found.r) == ("riccati", "constant", 0.5)


@pytest.mark.slow
def test_the_noise_of_a_filter_counts_in_units_of_that_of_the_measurement(parameters):
    """q is a ratio of variances; a search that makes all noises of the process larger is one of a better sensor."""
    quiet, loud = (parameters({"kalman.r": r}) for r in (1e-4, 4e-4))
    for given in (quiet, loud):
        found = design_gains(given, "offset_free", T, q=0.5).parameters.kalman
        assert found.q / found.r == pytest.approx(0.5)
    dynamics = quiet.model.dynamics.state_space
    for Q in ((), (1e-3, 3e-3, 2e-3), (2e-3, 1e-3, 0.0, 1e-3, 4e-3, 0.0, 0.0, 0.0, 3e-3)):
        for disturbance in ("none", "constant", "ramp"):
            louder = KalmanParameters(Q=Q, r=0.04, disturbance=disturbance)
            clear = KalmanParameters(Q=Q, r=0.01, disturbance=disturbance)
            gain = filter_gain(scaled(louder, 2.0), dynamics, T)
            np.testing.assert_allclose(gain, filter_gain(clear, dynamics, T), rtol=1e-6, err_msg=f"{Q} {disturbance}")


@pytest.mark.slow
def test_a_given_filter_stays_where_it_keeps_the_margins(parameters):
    slow = {"kalman.gain": "given", "kalman.L": (1e-4, 1e-3, 1e-3)}
    assert design_gains(parameters(slow), "smc", T).parameters.kalman.L == (1e-4, 1e-3, 1e-3)
    published = {"kalman.gain": "given", "kalman.L": (0.004, 0.5771, 0.3558)}
    found = design_gains(parameters(published), "smc", T)
    assert found.parameters.kalman.L == () and found.margins.meets


def model(**changes):
    """Parameters with a model of two states."""
    entries = {"A": (0.9, 0.0, 0.0, 0.5), "B": (0.1, 0.5), "C": (1.0, 1.0), "input_scale": 1.0} | changes
    return ControllerParameters.from_mapping({f"model.dynamics.{name}": value for name, value in entries.items()})


REFUSED = [
    ("pid", {"B": (0.0, 0.5)}, {}, "not controllable"),
    ("smc", {"B": (0.0, 0.5)}, {}, "not controllable"),
    ("pid", {"C": (1.0, 0.0)}, {}, "not observable"),
    ("offset_free", {"C": (1.0, 0.0)}, {}, "not observable"),
    ("smc", {"A": (), "B": (), "C": ()}, {}, "needs a model"),
    ("pid", {}, {"bandwidth": 1600.0}, "half the sample rate"),
    ("pid", {}, {"bandwidth": -1.0}, "half the sample rate"),
    ("super_twisting", {"A": (0.9,), "B": (0.1,), "C": (1.0,)}, {"bandwidth": 10.0}, "no pole to place"),
    ("pid", {"sample_time": 0.01}, {}, "sample_time"),
    ("pid", {"A": (0.9, 0.0, 0.0, 1.0)}, {}, "unstable"),
]


@pytest.mark.parametrize(("controller", "changes", "options", "text"), REFUSED)
def test_what_cannot_be_designed_is_refused_by_name(controller, changes, options, text):
    with pytest.raises(ParameterError, match=text) as caught:
        design_gains(model(**changes), controller, T, **options)
    assert caught.value.problems[0].name.startswith(("model.dynamics.", "bandwidth", "sample"))


def test_a_pid_reaches_only_what_its_margins_allow(parameters):
    with pytest.raises(ParameterError, match=r"at most [\d.]+ Hz"):
        design_gains(parameters(), "pid", T, bandwidth=1400.0)


def modal(*terms):
    """Parameters of a model that is the sum of share (1 − p)/(z − p) over (p, share), with conjugates of complex p."""
    blocks, entries, outputs = [], [], []
    for pole, share in terms:
        if isinstance(pole, complex):
            blocks.append(np.array([[pole.real, pole.imag], [-pole.imag, pole.real]]))
            entries += [share, 0.0]
            outputs += [1.0, 1.0]
        else:
            blocks.append(np.array([[pole]]))
            entries.append(share * (1.0 - pole))
            outputs.append(1.0)
    A, place = np.zeros((len(entries), len(entries))), 0
    for block in blocks:
        A[place : place + len(block), place : place + len(block)] = block
        place += len(block)
    return LinearParameters(A=tuple(A.ravel()), B=tuple(entries), C=tuple(outputs), input_scale=1.0, output_scale=1e-6)


CANCELLED = {
    "no dynamics": ((), [0.0]),
    "one lag": ([(0.9, 1.0)], [0.9]),
    "the two slowest lags": ([(0.5, 0.2), (0.9, 0.4), (0.7, 0.4)], [0.9, 0.7]),
    "a resonance slower than a lag": ([(0.5, 0.5), (0.8 + 0.4j, 0.1)], [0.8 + 0.4j, 0.8 - 0.4j]),
    "a resonance of large imaginary part": ([(0.8, 0.5), (0.3 + 0.8j, 0.1)], [0.3 + 0.8j, 0.3 - 0.8j]),
    "a lag slower than a resonance": ([(0.6 + 0.3j, 0.1), (0.9, 0.5)], [0.9]),
    "a resonance between two lags": ([(0.6 + 0.3j, 0.1), (0.4, 0.2), (0.9, 0.5)], [0.9, 0.4]),
    "a lag of 1.97 % of the step": ([(0.95, 0.0197), (0.8, 0.5803), (0.5, 0.4)], [0.8, 0.5]),
    "a lag of 2.005 % of the step": ([(0.95, 0.02005), (0.8, 0.57995), (0.5, 0.4)], [0.95, 0.8]),
    "a falling lag of 2.05 % of the step": ([(0.95, -0.0205), (0.8, 0.6205), (0.5, 0.4)], [0.95, 0.8]),
    "two lags of little size": ([(0.98, 0.01), (0.95, -0.01), (0.8, 1.0)], [0.8]),
    "a delay and a lag": ([(0.9, 1.0), (0.995e-3, 0.5)], [0.9]),
    "a pole that is no delay": ([(0.9, 1.0), (1.005e-3, 0.5)], [0.9, 1.005e-3]),
    "delays alone": ([(1e-4, 0.5), (-1e-4, 0.5)], [0.0]),
}


@pytest.mark.parametrize("gain", [1.0, -0.3])
@pytest.mark.parametrize(("terms", "expected"), CANCELLED.values(), ids=CANCELLED)
def test_the_slowest_poles_that_matter_are_cancelled(terms, expected, gain):
    """A delay cannot be cancelled, and a pole with a zero near it (less than 2 % of the step response) need not be."""
    model = modal(*((pole, gain * share) for pole, share in terms))
    assert slowest_poles(model.state_space) == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pid_has_the_largest_gain_within_the_margins(sign):
    """A gain 0.001 % larger misses a requirement; a stage that moves the other way gets the negative gains."""
    plant = modal((0.9, sign * 0.8), (0.5, sign * 0.2))
    given = PidParameters(setpoint_weight=0.3, derivative_weight=0.4, roll_off=50.0)
    gains = design_pid(given, plant, T)
    assert (gains.setpoint_weight, gains.derivative_weight, gains.roll_off) == (1.0, 1.0, 0.0)
    # the default filter, one fifth of the sampling angular frequency
    assert gains.derivative_filter == pytest.approx(0.2 * 2.0 * np.pi / T, rel=1e-12)
    assert gains.Ki * sign > 0.0

    def judged(factor):
        larger = replace(gains, Kp=factor * gains.Kp, Ki=factor * gains.Ki, Kd=factor * gains.Kd)
        system = pid_state_space(larger, T).scaled(plant.resolved_input_scale / plant.output_scale)
        return judge(system, plant_state_space(plant), T)

    assert judged(1.0).meets(AIMED)
    assert not judged(1.00001).meets(AIMED)
    # a bandwidth below the largest is met closely, and the gain is the smallest with this bandwidth
    wanted = 0.5 * judged(1.0).bandwidth
    gains = design_pid(given, plant, T, bandwidth=wanted)
    assert judged(1.0).bandwidth >= wanted > judged(0.9999).bandwidth
    # REQUIRED allows more than AIMED, and a design with a requested bandwidth has to meet only REQUIRED
    most = design_pid(given, plant, T, aimed=REQUIRED)
    assert abs(most.Ki) > 1.01 * abs(design_pid(given, plant, T).Ki)
    assert abs(design_pid(given, plant, T, bandwidth=1.01 * 2.0 * wanted).Ki) <= abs(most.Ki)


def test_a_derivative_filter_is_chosen_only_where_one_is_needed_and_none_is_given():
    slow, fast = modal((0.9, 1.0)), modal((0.9, 0.8), (0.5, 0.2))
    assert design_pid(PidParameters(), slow, T).derivative_filter == 0.0
    for plant in (slow, fast):
        assert design_pid(PidParameters(derivative_filter=3000.0), plant, T).derivative_filter == 3000.0


def test_an_integral_controller_has_the_sensitivity_peak_of_a_calm_loop():
    plant = modal((0.9, 1.0))
    gains = design_integral(PidParameters(Kp=3.0, Kd=2.0, roll_off=5.0), plant, T)
    assert (gains.Kp, gains.Kd, gains.roll_off) == (0.0, 0.0, 0.0)
    loop = judge(pid_state_space(gains, T), plant_state_space(plant, scaled=False), T)
    assert loop.sensitivity_peak == pytest.approx(1.4, rel=1e-3)


WANDERING = {
    # standard deviations of the noise of the input, and of the changes of constant, rate and periodic part
    "none": (10.0, None, None, None),
    "constant": (0.1, 1.0, None, None),
    "ramp": (0.1, 0.1, 0.3, None),
    "periodic": (0.1, 1.0, None, 1.0),
}


@pytest.mark.parametrize("disturbance", WANDERING)
@pytest.mark.parametrize("size", [1.0, 3.0])
def test_a_filter_for_a_wandering_disturbance_has_fixed_ratios_of_noise(disturbance, size):
    given = KalmanParameters(gain="given", L=(0.1, 0.2), Q=(1.0,), r=0.04, disturbance_frequency=7.0)
    found = wandering(given, disturbance, size)
    assert (found.gain, found.L, found.Q, found.disturbance) == ("riccati", (), (), disturbance)
    assert (found.r, found.disturbance_frequency) == (0.04, 7.0)
    noises = ("q", "q_disturbance", "q_disturbance_rate", "q_disturbance_periodic")
    for name, deviation in zip(noises, WANDERING[disturbance], strict=True):
        expected = getattr(given, name) if deviation is None else (deviation * size) ** 2
        assert getattr(found, name) == pytest.approx(expected, rel=1e-9), name
