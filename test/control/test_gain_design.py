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

import numpy as np
import pytest

from hysteresis_ros.control.controller import DESIGNS, ControllerParameters
from hysteresis_ros.control.kalman import KalmanParameters, filter_gain
from hysteresis_ros.control.laws.pid import PidParameters, design_pid, pid_state_space, pid_with_zeros
from hysteresis_ros.control.sliding_gains import scaled
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
