# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Linear dynamics are exported to python-control and SciPy, and imported again as the same system."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
import scipy.signal

import hysteresis_ros as hr
from hysteresis_ros.errors import ConfigurationError, HysteresisError, MissingExtraError, ParameterError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters, linear_advance

T = 1.0 / 3000.0  # of kim2009
INPUT = np.sin(np.linspace(0.0, 9.0, 60)) + np.linspace(0.0, 1.0, 60)


def sampled(parameters: LinearParameters) -> np.ndarray:
    """Return the output of the nodes' block, read before the input of each sample changes."""
    block, found = LinearDynamics(parameters, T), []
    for u in INPUT:
        found.append(block.output())
        linear_advance(block.p, block.x, u)
    return np.array(found)


CASES = {
    "lag": LinearParameters(A=(0.9,), B=(0.1,), C=(1.0,), sample_time=T),
    "scaled": LinearParameters(A=(0.9,), B=(0.3,), C=(2.0,), input_scale=1e-6, output_scale=2e-6, sample_time=T),
    "feedthrough": LinearParameters(A=(0.8,), B=(0.1,), C=(1.0,), D=(0.5,), sample_time=T),
    "delay": LinearParameters(A=(0.9,), B=(0.1,), C=(1.0,), sample_time=T, delay=2.4 * T),
    "late feedthrough": LinearParameters(A=(0.8,), B=(0.1,), C=(1.0,), D=(0.5,), sample_time=T, delay=1.5 * T),
    "none": LinearParameters(),
}


def axis_with(parameters: LinearParameters):
    plain = hr.load("kim2009").override("motion_controller", type="open_loop")
    return hr.with_dynamics(plain, parameters)


@pytest.mark.parametrize("name", CASES)
def test_the_system_of_scipy_answers_as_the_block_of_the_nodes(name):
    system = hr.to_scipy(axis_with(CASES[name]))
    _, found, _ = scipy.signal.dlsim(system, INPUT)
    np.testing.assert_allclose(found[:, 0], sampled(CASES[name]), rtol=0.0, atol=1e-12)


def python_control():
    """Return python-control, or skip the test; the folder test/control is also a module of this name."""
    pytest.importorskip("control.statesp", reason="python-control is optional")
    return importlib.import_module("control")


@pytest.mark.parametrize("name", CASES)
def test_the_system_of_python_control_answers_as_the_block_of_the_nodes(name):
    control = python_control()
    system = hr.to_control(axis_with(CASES[name]))
    assert system.dt == pytest.approx(T)
    found = control.forced_response(system, inputs=INPUT, timepts=np.arange(INPUT.size) * T).outputs
    np.testing.assert_allclose(found, sampled(CASES[name]), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("way", ["to_scipy", "to_control"])
def test_there_and_back_is_the_same_dynamics(way):
    if way == "to_control":
        python_control()
    for node in ("plant_simulator", "motion_controller"):
        back = hr.from_control(getattr(hr, way)("kim2009", node=node))
        axis = single_axis(hr.load("kim2009"))
        there = axis.plant_simulator.dynamics if node == "plant_simulator" else axis.motion_controller.model.dynamics
        assert (back.A, back.B) == (there.A, there.B) and back.sample_time == pytest.approx(1.0 / 3000.0)
        z = np.exp(2j * np.pi * np.linspace(0.0, 0.5, 50))
        gains = (there.output_scale / there.resolved_input_scale, back.output_scale / back.resolved_input_scale)
        expected, found = (model.state_space.response(z) for model in (there, back))
        np.testing.assert_allclose(gains[1] * found, gains[0] * expected, rtol=1e-9)


def test_a_continuous_lag_is_sampled_in_closed_form():
    # 1 / (τ s + 1), input held: x⁺ = e^(-T/τ) x + (1 - e^(-T/τ)) u
    tau = 5e-3
    systems = [scipy.signal.lti([1.0], [tau, 1.0])]
    try:
        import control.statesp  # not the folder test/control

        systems += [control.tf([1.0], [tau, 1.0]), control.ss([[-1.0 / tau]], [[1.0 / tau]], [[1.0]], [[0.0]])]
    except ImportError:
        pass
    for system in systems:
        found = hr.from_control(system, sample_time=T)
        assert pytest.approx((np.exp(-T / tau),)) == found.A and found.D == ()
        assert found.B[0] * found.C[0] == pytest.approx(1.0 - np.exp(-T / tau))
        with pytest.raises(ConfigurationError, match="states no sample time"):
            hr.from_control(system)


def test_a_continuous_feedthrough_answers_the_input_before():
    # (s + 2 a) / (s + a) = 1 + a / (s + a)
    a = 200.0
    found = hr.from_control(scipy.signal.lti([1.0, 2.0 * a], [1.0, a]), sample_time=T, keep_gain=True)
    expected, x = np.empty(INPUT.size), 0.0
    for k in range(INPUT.size):
        expected[k] = x + (INPUT[k - 1] if k else 0.0)
        x = np.exp(-a * T) * x + (1.0 - np.exp(-a * T)) * INPUT[k]
    np.testing.assert_allclose(sampled(found), expected, rtol=0.0, atol=1e-12)


def test_the_gain_becomes_one_unless_it_is_kept():
    system = scipy.signal.dlti(*(np.array([[v]]) for v in (0.5, 1.0, 3.0, 0.0)), dt=T)
    assert hr.from_control(system).resolved_input_scale == pytest.approx(6.0)
    assert hr.from_control(system, keep_gain=True).resolved_input_scale == 1.0


def test_a_simulation_takes_the_dynamics_that_came_back():
    axis = hr.load("kim2009").override("motion_controller", type="open_loop")
    same = hr.with_dynamics(axis, hr.from_control(hr.to_scipy("kim2009")))
    run, expected = (hr.simulate(source, setpoints=np.full(60, 2e-6)) for source in (same, axis))
    np.testing.assert_allclose(run.displacement, expected.displacement, rtol=0.0, atol=1e-15)
    slower = hr.with_dynamics(axis, LinearParameters(A=(0.99,), B=(0.01,), C=(1.0,)))
    assert np.ptp(hr.simulate(slower, setpoints=np.full(60, 2e-6)).displacement - run.displacement) > 1e-9


def test_a_system_becomes_dynamics_at_the_rate_of_the_axis():
    lag, axis = scipy.signal.lti([1.0], [0.01, 1.0]), hr.load("kim2009")
    direct, converted = hr.with_dynamics(axis, lag), hr.with_dynamics(axis, hr.from_control(lag, T))
    assert direct.node("plant_simulator") == converted.node("plant_simulator")


def matrices(A=0.5, B=1.0, C=1.0, D=0.0, dt=T):
    return scipy.signal.dlti(*(np.atleast_2d(v) for v in (A, B, C, D)), dt=dt)


@pytest.mark.parametrize(
    "ask, error, message",
    [
        (lambda: hr.from_control(matrices(D=0.3)), ConfigurationError, "has a feedthrough D = 0.3"),
        (lambda: hr.from_control(matrices(dt=True)), ConfigurationError, "states no sample time"),
        (lambda: hr.from_control(matrices(), 2 * T), ConfigurationError, "the system is for 0.000333333333 s"),
        (lambda: hr.from_control(matrices(A=1.5)), ParameterError, "is unstable"),
        (lambda: hr.from_control(matrices(B=[1.0, 1.0], D=[0.0, 0.0])), ConfigurationError, "2 inputs and 1 outputs"),
        (lambda: hr.from_control(3.0), ConfigurationError, "a float: must be a StateSpace"),
        (lambda: hr.from_control(scipy.signal.lti([1.0], [1.0, 1.0]), -1.0), ConfigurationError, "must be above 0 s"),
        (lambda: hr.to_scipy("kim2009", node="plant_simulater"), ConfigurationError, "did you mean plant_simulator"),
        (lambda: hr.with_dynamics("kim2009", 3.0), ConfigurationError, "a float: must be a StateSpace"),
        (lambda: hr.with_dynamics("kim2009", CASES["lag"], node="plant"), ConfigurationError, "must be one of"),
    ],
)
def test_what_cannot_be_exchanged_is_refused(ask, error, message):
    with pytest.raises(error, match=message):
        ask()


def test_without_python_control_the_message_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(MissingExtraError, match=r'pip install "hysteresis_ros\[control\]"'):
        hr.to_control("kim2009")


def test_matrices_must_be_finite_and_the_sample_time_may_have_a_unit():
    system = scipy.signal.lti([1.0], [0.01, 1.0])
    assert hr.from_control(system, "1ms") == hr.from_control(system, 1e-3)
    with pytest.raises(HysteresisError, match="the system's A = .*nan.*: must be finite numbers"):
        hr.from_control(scipy.signal.StateSpace([[np.nan]], [[1.0]], [[1.0]], [[0.0]], dt=1e-3))
