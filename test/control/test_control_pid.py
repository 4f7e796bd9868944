# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""PID: samples by hand, the continuous closed form, windup, bumpless start and retune, refusal of unstable gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.control import law
from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.control.laws import pid as module
from hysteresis_ros.control.laws.pid import PidParameters, pid_state_space
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters

T = 0.01
#: First-order lag of 50 ms at 100 Hz in the model's units, micrometres; `input_scale` 1e-6 too: unit DC gain.
LAG = np.exp(-T / 0.05)
MODEL = {
    "model.dynamics.A": (LAG,),
    "model.dynamics.B": (1.0 - LAG,),
    "model.dynamics.C": (1.0,),
    "model.dynamics.output_scale": 1e-6,
}
#: No model: the gains are not checked.
FREE = {"model.dynamics.input_scale": 1e-6, "model.dynamics.output_scale": 1e-6}


def block(changes, model=FREE, sample_time=T):
    """Build a PID controller from entries of its group."""
    entries = {name if "." in name else f"pid.{name}": value for name, value in changes.items()}
    return controller_block(ControllerParameters.from_mapping({"type": "pid"} | model | entries), sample_time)


def run(controller, reference, least=-np.inf, most=np.inf):
    """Return commands and displacements, shape (N,) [m], of the loop with the lag; input limits are least … most."""
    plant = LinearDynamics(LinearParameters(**{k.rsplit(".", 1)[1]: v for k, v in MODEL.items()}), T)
    commands, displacements = [], []
    for r in reference:
        y = plant.output()
        u = controller.step(r, y)
        applied = min(max(u, least), most)
        controller.x[law.APPLIED] = applied
        plant.step(applied)
        commands.append(u)
        displacements.append(y)
    return np.array(commands), np.array(displacements)


def test_hand_computed_samples():
    c = block({"Kp": 2.0, "Ki": 10.0, "Kd": 0.5, "setpoint_weight": 0.5, "derivative_weight": 0.25})
    # k = 0: y = 0, u = 2 (0.5·4 - 0) = 4; k = 1: I = 10·0.01·(4 + 3)/2, D = 0.5·(-1)/0.01
    assert c.step(4e-6, 0.0) == pytest.approx(4e-6)
    assert c.step(4e-6, 1e-6) == pytest.approx((2.0 * (2.0 - 1.0) + 0.35 - 50.0) * 1e-6)
    # k = 2: r = 8, y = 2: I += 0.1·(6 + 3)/2, D = 0.5·(0.25·4 - 1)/0.01 = 0
    assert c.step(8e-6, 2e-6) == pytest.approx((2.0 * (4.0 - 2.0) + 0.35 + 0.45) * 1e-6)
    assert c.x[law.ESTIMATED] == 2e-6


def test_derivative_filter_by_hand():
    c = block({"Kp": 1.0, "Kd": 0.1, "derivative_filter": 100.0})  # a = 1/e
    a = np.exp(-1.0)
    assert c.step(0.0, 0.0) == 0.0
    assert c.step(0.0, 1e-6) == pytest.approx((-1.0 - 0.1 * (1 - a) / T) * 1e-6)
    assert c.step(0.0, 1e-6) == pytest.approx((-1.0 - a * 0.1 * (1 - a) / T) * 1e-6)


@settings(max_examples=25, deadline=None)
@given(*(st.floats(0.0, high) for high in (5.0, 50.0, 0.5)), st.floats(5.0, 500.0), st.floats(-3.0, 3.0))
def test_a_ramp_of_the_error_gives_the_continuous_controllers_command(Kp, Ki, Kd, N, slope):
    c = block({"Kp": Kp + 0.1, "Ki": Ki, "Kd": Kd, "derivative_filter": N, "derivative_weight": 1.0})
    t = T * np.arange(60)
    u = c.simulate(slope * 1e-6 * t, np.zeros_like(t))
    exact = (Kp + 0.1) * slope * t + 0.5 * Ki * slope * t**2 + Kd * slope * -np.expm1(-N * t)
    assert u * 1e6 == pytest.approx(exact, rel=1e-9, abs=1e-12)


def test_state_space_is_the_kernel():
    gains = PidParameters(Kp=1.3, Ki=20.0, Kd=0.03, derivative_filter=80.0, derivative_weight=1.0)
    found = pid_state_space(gains, T)
    error = np.sin(np.arange(50.0))
    error[0] = 0.0
    x, expected = np.zeros(2), []
    for e in error:
        expected.append((found.C @ x).item() + found.D[0, 0] * e)
        x = found.A @ x + found.B[:, 0] * e
    c = block({"Kp": 1.3, "Ki": 20.0, "Kd": 0.03, "derivative_filter": 80.0, "derivative_weight": 1.0})
    assert c.simulate(1e-6 * error, np.zeros(50)) * 1e6 == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("gains", [{"Ki": 20.0}, {"Kp": 1.3, "Ki": 20.0, "Kd": 0.03, "derivative_filter": 80.0}])
def test_roll_off_is_two_low_passes_before_the_controller(gains):
    c = block({**gains, "derivative_weight": 1.0, "roll_off": 30.0})
    a, error = np.exp(-30.0 * T), np.sin(0.1 * np.arange(200.0))
    filtered = scipy.signal.lfilter([(1 - a) ** 2], [1.0, -2 * a, a * a], error)
    plain = block({**gains, "derivative_weight": 1.0})
    expected = plain.simulate(1e-6 * filtered, np.zeros(200))
    assert c.simulate(1e-6 * error, np.zeros(200)) == pytest.approx(expected, rel=1e-9, abs=1e-15)
    c, plain = (block({**gains, "derivative_weight": 1.0, "roll_off": f}) for f in (30.0, 0.0))
    measured = plain.simulate(np.zeros(200), 1e-6 * filtered)
    assert c.simulate(np.zeros(200), 1e-6 * error) == pytest.approx(measured, rel=1e-9, abs=1e-15)
    z = np.exp(1j * np.geomspace(1e-3, np.pi, 50))
    rolled, bare = (pid_state_space(PidParameters(**gains, roll_off=f), T).response(z)[:, 0, 1] for f in (30.0, 0.0))
    assert rolled == pytest.approx(bare * ((1 - a) * z / (z - a)) ** 2, rel=1e-9)


def test_roll_off_begins_at_rest_and_is_switched_on_without_a_jump():
    c = block({"Ki": 20.0, "roll_off": 30.0}, MODEL)
    assert [c.step(2e-6, 2e-6) for _ in range(5)] == pytest.approx([2e-6] * 5, rel=1e-9)
    plain = block({"Kp": 0.5, "Ki": 20.0})
    before = [plain.step(2e-6, 1e-6) for _ in range(3)]
    plain.retune(replace(plain.parameters, pid=replace(plain.parameters.pid, roll_off=30.0)))
    assert plain.step(2e-6, 1e-6) - before[-1] == pytest.approx(before[-1] - before[-2], rel=1e-9)


def test_offset_free_on_the_model():
    _, y = run(block({"Kp": 1.0, "Ki": 20.0}, MODEL), np.full(400, 3e-6))
    assert y[-1] == pytest.approx(3e-6, rel=1e-9)


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize(
    ("method", "beyond"), [("clamping", 4.2), ("back_calculation", 4.2), ("back_calculation", 8.0)]
)
def test_long_saturation_does_not_wind_up(method, beyond, own):
    # 5 s above the limit of 4 um, then a step to 1 um, compared with the same step from 4 um without saturation.
    # Clamping stops the integral where saturation began, so the P part of the large error then is missing later.
    gains = {"Kp": 1.0, "Ki": 20.0}
    limits = {"output_minimum": -4.0, "output_maximum": 4.0} if own else {}
    most = np.inf if own else 4e-6

    def growth(anti_windup, sign=1.0):
        grown = []
        for samples in (100, 500):
            controller = block(gains | limits | {"anti_windup": anti_windup}, MODEL)
            run(controller, np.full(samples, sign * beyond * 1e-6), least=-most, most=most)
            grown.append(sign * controller.x[module.INTEGRAL])
        return grown[1] - grown[0]

    assert abs(growth(method)) < 0.3 and growth(method, -1.0) == pytest.approx(growth(method), abs=1e-9)
    assert growth("none") > 15.0 * (beyond - 4.0), "the integral of the error continues to grow"
    reference = np.concatenate([np.full(500, beyond * 1e-6), np.full(300, 1e-6)])
    _, ideal = run(block(gains, MODEL), np.concatenate([np.full(500, 4e-6), np.full(300, 1e-6)]))
    _, y = run(block(gains | limits | {"anti_windup": method}, MODEL), reference, most=most)
    _, wound = run(block(gains | limits | {"anti_windup": "none"}, MODEL), reference, most=most)
    assert y[500:].min() > ideal[500:].min() - 0.2e-6
    late = [np.flatnonzero(np.abs(run_[500:] - 1e-6) > 0.1e-6)[-1] for run_ in (y, ideal, wound)]
    assert late[0] <= late[1] + 15 < late[2]


@pytest.mark.parametrize(
    ("gains", "part"),
    [
        ({"Kp": 1.0, "Ki": 20.0, "Kd": 0.05}, 0.2),  # √(K_d/K_i) = 50 ms
        ({"Kp": 1.0, "Ki": 20.0}, 0.2),  # K_p/K_i
        ({"Ki": 20.0}, 1.0),
        ({"Ki": 20.0, "tracking_time": 0.04}, 0.25),
        ({"Ki": 20.0, "tracking_time": 0.1 * T}, 1.0),  # not faster than a sample
        ({"Ki": 20.0, "tracking_time": 0.04, "anti_windup": "clamping"}, 0.0),
    ],
)
def test_the_integral_follows_the_achieved_command_in_the_tracking_time(gains, part):
    assert PidParameters(**gains).tracking(T) == pytest.approx(part)


def test_small_differences_of_an_approximate_inverse_do_not_stop_the_integral():
    c = block({"Kp": 0.5, "Ki": 20.0, "anti_windup": "clamping", "anti_windup_threshold": 0.1}, MODEL)
    plant = LinearDynamics(LinearParameters(**{k.rsplit(".", 1)[1]: v for k, v in MODEL.items()}), T)
    for _ in range(400):
        y = plant.output()
        applied = 0.95 * c.step(3e-6, y)
        c.x[law.APPLIED] = applied
        plant.step(applied)
    assert plant.output() == pytest.approx(3e-6, rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.floats(-5e-6, 5e-6).filter(lambda v: abs(v) > 1e-12), st.floats(-5e-6, 5e-6), st.floats(0.0, 1.0))
def test_first_command_is_the_last_one_where_the_reference_is_where_the_axis_stands(applied, measured, weight):
    c = block({"Kp": 3.0, "Ki": 10.0, "Kd": 0.1, "setpoint_weight": weight, "model.preload.A1": 1e-6})
    c.x[law.APPLIED] = applied
    assert c.step(measured - 1e-6, measured) == pytest.approx(applied, rel=1e-9, abs=1e-18)


def test_without_a_last_command_it_starts_from_the_measured_displacement():
    c = block({"Kp": 1.0, "Ki": 10.0}, MODEL)
    assert c.step(3e-6, 3e-6) == pytest.approx(3e-6)


def test_feedforward_is_added_and_the_integral_leaves_it_alone():
    c = block({"Kp": 2.0, "Ki": 10.0, "feedforward.type": "static"}, MODEL)
    c.x[law.FEEDFORWARD] = 3e-6
    assert c.step(3e-6, 3e-6) == pytest.approx(3e-6)
    c.x[law.FEEDFORWARD] = 4e-6
    assert c.step(4e-6, 3e-6) == pytest.approx(4e-6 + 2.0 * 1e-6 + 10.0 * T / 2 * 1e-6)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.1, 3.0), st.floats(0.0, 30.0), st.floats(0.0, 1.0), st.floats(-1e-6, 1e-6), st.floats(0.5, 2.0))
def test_new_gains_do_not_move_the_command(Kp, Ki, weight, offset, scale):
    c = block({"Kp": 1.0, "Ki": 10.0, "Kd": 0.02, "derivative_filter": 50.0})
    for k in range(30):
        before = c.step(1e-6 * np.sin(k), 1e-7 * k)
    entries = {"type": "pid", "pid.Kp": Kp, "pid.Ki": Ki, "pid.setpoint_weight": weight, "pid.derivative_filter": 50.0}
    entries |= {"model.preload.A1": offset, "pid.Kd": 0.02}
    other = {"model.dynamics.input_scale": scale * 1e-6}
    c.retune(ControllerParameters.from_mapping(entries | FREE | other))
    x = c.x
    now = (x[module.PROPORTION] + x[module.INTEGRAL] + x[module.DERIVATIVE]) * scale * 1e-6
    assert now == pytest.approx(before, rel=1e-9, abs=1e-18)


def test_whatever_comes_in_the_command_stays_finite():
    c = block({"Kp": 1e9, "Ki": 1e9, "Kd": 1e9, "derivative_weight": 1.0, "anti_windup": "none"})
    for r, y in [(1e300, -1e300), (-1e308, 1e308), (np.inf, -np.inf), (np.nan, np.nan), (0.0, 0.0)] * 5:
        assert np.isfinite(c.step(r, y))
        c.x[law.APPLIED] = r


REFUSED = [
    ({"Kp": 12.0, "Ki": 1.0}, "pid"),
    ({"Ki": 500.0}, "pid"),
    ({"Kp": -0.5, "Ki": -1.0}, "pid"),
    ({}, "pid.Kp"),
    ({"Kp": 1.0, "output_minimum": 2.0, "output_maximum": 1.0}, "pid.output_maximum"),
    ({"Kp": 1.0, "anti_windup": "sometimes"}, "pid.anti_windup"),
]


@pytest.mark.parametrize(("changes", "name"), REFUSED)
def test_gains_that_cannot_work_are_refused_by_name(changes, name):
    with pytest.raises(ParameterError) as caught:
        block(changes, MODEL)
    assert caught.value.problems[0].name.startswith(name), caught.value


def test_stability_limit_is_the_polynomials():
    # P on x+ = a x + (1 - a) u: pole a - (1 - a) Kp, so Kp < (1 + a)/(1 - a)
    limit = (1.0 + LAG) / (1.0 - LAG)
    block({"Kp": 0.999 * limit}, MODEL)
    with pytest.raises(ParameterError, match="unstable"):
        block({"Kp": 1.001 * limit}, MODEL)
    # P on one sample of delay: |Kp| < 1
    static = {"model.dynamics.output_scale": 1e-6}
    block({"Kp": 0.99}, static)
    with pytest.raises(ParameterError, match="unstable"):
        block({"Kp": 1.01}, static)
