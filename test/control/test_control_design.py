# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Gains: the published ones follow from the model, designs keep their specifications, bad designs are refused."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.kalman import filter_gain
from hysteresis_ros.control.sliding_surface import design_sliding_mode
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import StateSpace

PUBLISHED_S = np.array([-1.0744, -0.0904, 0.0781])


def stable_systems(order=3):
    """Random stable (A, B, C) of the given order, with a distance from uncontrollable and unobservable systems."""

    def build(entries):
        values = np.array(entries)
        A = values[: order**2].reshape(order, order)
        A = 0.9 * A / max(state_feedback.spectral_radius(A), 1e-3)
        return A, values[order**2 : order**2 + order, None], values[None, order**2 + order :]

    def well_posed(system):
        A, B, C = system
        reach = np.column_stack([np.linalg.matrix_power(A, k) @ B for k in range(order)])
        see = np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(order)])
        if min(np.abs(B).max(), np.abs(C).max()) < 0.1:
            return False
        return np.linalg.cond(A) < 1e4 and np.linalg.cond(reach) < 1e4 and np.linalg.cond(see) < 1e4

    entry = st.floats(-1.0, 1.0)
    size = order**2 + 2 * order
    return st.lists(entry, min_size=size, max_size=size).map(build).filter(well_posed)


def test_published_linear_gain_follows_from_S_and_phi(model):
    A, B = model.A, model.B
    K, switching_gain = state_feedback.sliding_gain(A, B, PUBLISHED_S, 0.93)
    assert pytest.approx([0.5130, -1.6069, 1.1001], abs=2e-4) == K
    assert switching_gain == pytest.approx(0.836, abs=1e-3)
    poles = np.sort(np.linalg.eigvals(A - B @ K[None]).real)
    assert poles == pytest.approx([-0.700, -0.122, 0.930], abs=1e-3)


def test_published_observer_gain_follows_from_q_over_r(model, parameters):
    L = filter_gain(parameters().kalman, model)
    assert pytest.approx([0.0040, 0.5771, 0.3558], abs=2e-4) == L


def test_dc_gain_of_published_model(model):
    state, command = state_feedback.steady_state(model)
    A, B, C = model.A, model.B, model.C
    assert 1.0 / command == pytest.approx(2.05, abs=1e-4)
    assert A @ state + B[:, 0] * command == pytest.approx(state, abs=1e-14)
    assert (C @ state).item() == pytest.approx(1.0, abs=1e-13)


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(stable_systems(), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_riccati_residual_vanishes_and_filter_is_stable(system, q, r):
    A, B, C = system
    Q = q * B @ B.T
    gain, P = state_feedback.kalman_gain(A, C, Q, r)
    innovation = r + (C @ P @ C.T).item()
    predicted = A @ P @ A.T
    residual = predicted - A @ P @ C.T @ C @ P @ A.T / innovation + Q - P
    # the terms may be far larger than their sum
    assert np.abs(residual).max() <= 1e-7 * np.abs(P).max() + 1e-12 * np.abs(predicted).max()
    assert gain == pytest.approx((P @ C.T)[:, 0] / innovation)
    assert state_feedback.spectral_radius(A - np.outer(A @ gain, C)) < 1.0


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(stable_systems(), st.lists(st.floats(-0.95, 0.95), min_size=2, max_size=2), st.floats(-0.95, 0.95))
def test_placed_poles_and_phi_are_the_poles_of_the_loop(system, poles, phi):
    A, B, _ = system
    S = state_feedback.hyperplane_from_poles(A, B, poles)
    K, switching_gain = state_feedback.sliding_gain(A, B, S, phi)
    assert switching_gain == pytest.approx(1.0, rel=1e-6)
    # Compared as polynomials: coinciding poles are ill-conditioned, their polynomial is not.
    assert np.poly(A - B @ K[None]) == pytest.approx(np.poly([*poles, phi]), abs=1e-5)


def test_complex_poles(parameters, model):
    chosen = parameters(
        {
            "sliding_mode.hyperplane": "poles",
            "sliding_mode.poles": (0.3, 0.3),
            "sliding_mode.poles_imaginary": (0.4, -0.4),
        }
    ).sliding_mode
    poles = design_sliding_mode(chosen, model).poles
    assert sorted(poles, key=lambda z: (z.real, z.imag)) == pytest.approx([0.3 - 0.4j, 0.3 + 0.4j, 0.93])


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(stable_systems(), st.floats(1e-3, 1e3))
def test_lq_hyperplane_slides_stably_whatever_the_input_weight(system, input_weight):
    A, B, C = system
    S = state_feedback.hyperplane_lq(A, B, C.T @ C + 1e-3 * np.eye(3), input_weight)
    assert (S @ B).item() == pytest.approx(1.0)
    assert state_feedback.spectral_radius((np.eye(3) - B @ S[None]) @ A) < 1.0


def test_lq_hyperplane_with_cheap_control_and_phi_zero_is_the_lq_gain(model):
    import scipy.linalg

    A, B, C = model.A, model.B, model.C
    Q, R = C.T @ C, 1e-9
    P = scipy.linalg.solve_discrete_are(A, B, Q, [[R]])
    regulator = (B.T @ P @ A)[0] / (R + (B.T @ P @ B).item())
    K, _ = state_feedback.sliding_gain(A, B, state_feedback.hyperplane_lq(A, B, Q, R), 0.0)
    assert pytest.approx(regulator, rel=1e-6) == K


def test_lq_weight_as_diagonal_or_as_matrix_is_the_same(parameters, model):
    def hyperplane(weight):
        chosen = parameters({"sliding_mode.hyperplane": "lq", "sliding_mode.lq_state_weight": weight}).sliding_mode
        return design_sliding_mode(chosen, model).S

    assert hyperplane((1.0, 2.0, 3.0)) == pytest.approx(hyperplane((1.0, 0, 0, 0, 2.0, 0, 0, 0, 3.0)))


def test_full_process_noise_equals_its_scalar_form(parameters, model):
    B = model.B
    full = parameters({"kalman.Q": tuple((0.685 * B @ B.T).ravel())})
    assert filter_gain(full.kalman, model) == pytest.approx(filter_gain(parameters().kalman, model))


@pytest.mark.parametrize("form", ["predictor", "current"])
@pytest.mark.parametrize("disturbance", ["none", "constant"])
def test_predictor_gain_is_A_times_current_gain(parameters, model, form, disturbance):
    whole = state_feedback.disturbance_system(model).A if disturbance == "constant" else model.A
    gains = {
        form: filter_gain(parameters({"kalman.form": form, "kalman.disturbance": disturbance}).kalman, model)
        for form in ("predictor", "current")
    }
    assert gains["predictor"] == pytest.approx(whole @ gains["current"], rel=1e-12)
    # The same gain when given passes the stability check of its own form.
    entries = {"kalman.form": form, "kalman.disturbance": disturbance, "kalman.gain": "given"}
    assert parameters(entries | {"kalman.L": tuple(gains[form])})


REFUSED = [
    ({"sliding_mode.S": (1.0, 2.0)}, "sliding_mode.S"),
    ({"sliding_mode.S": (-0.8674, 0.7907, 0.3855)}, "sliding_mode.S"),  # S = C slides on the sampling zero -3.09
    ({"sliding_mode.S": (0.3533, -0.7318, 0.0)}, "sliding_mode.S"),  # S B = 0
    ({"sliding_mode.S": None}, "sliding_mode.S"),
    ({"sliding_mode.phi": 1.0}, "sliding_mode.phi"),
    ({"sliding_mode.phi": 1.5}, "sliding_mode.phi"),
    ({"sliding_mode.eta": 2.0}, "sliding_mode.eta"),
    ({"sliding_mode.tracking": "integral"}, "sliding_mode.S"),
    ({"sliding_mode.hyperplane": "poles", "sliding_mode.poles": (0.5,)}, "sliding_mode.poles"),
    ({"sliding_mode.hyperplane": "poles", "sliding_mode.poles": (0.5, 1.0)}, "sliding_mode.poles"),
    (
        {
            "sliding_mode.hyperplane": "poles",
            "sliding_mode.poles": (0.5, 0.5),
            "sliding_mode.poles_imaginary": (0.1, 0.1),
        },
        "sliding_mode.poles_imaginary",
    ),
    ({"sliding_mode.hyperplane": "lq", "sliding_mode.lq_input_weight": 0.0}, "sliding_mode.lq_input_weight"),
    ({"sliding_mode.hyperplane": "lq", "sliding_mode.lq_state_weight": (1.0, 2.0)}, "sliding_mode.lq_state_weight"),
    (
        {"sliding_mode.hyperplane": "lq", "sliding_mode.lq_state_weight": (1.0, -1.0, 1.0)},
        "sliding_mode.lq_state_weight",
    ),
    ({"kalman.r": 0.0}, "kalman.r"),
    ({"kalman.Q": (1.0, 2.0)}, "kalman.Q"),
    ({"kalman.gain": "given"}, "kalman.L"),
    ({"kalman.gain": "given", "kalman.L": (5.0, 5.0, 5.0)}, "kalman.L"),
    ({"kalman.disturbance": "constant", "kalman.q_disturbance": 0.0}, "kalman.q_disturbance"),
    ({"kalman.form": "current", "model.dynamics.D": (0.1,)}, "kalman.form"),
    (
        {
            "kalman.disturbance": "constant",
            "sliding_mode.tracking": "integral",
            "sliding_mode.hyperplane": "lq",
        },
        "kalman.disturbance",
    ),
    ({"model.dynamics.C": (0.0, 0.0, 0.0), "model.dynamics.input_scale": 1.0}, "model.dynamics.C"),
    (
        {"sliding_mode.hyperplane": "poles", "sliding_mode.poles": (0.1, 0.2), "model.dynamics.B": (0.0, 0.0, 0.0)},
        "model.dynamics.",
    ),
    ({"model.dynamics.A": (), "model.dynamics.B": (), "model.dynamics.C": ()}, "model.dynamics.A"),
]


@pytest.mark.parametrize(("changes", "name"), REFUSED)
def test_designs_that_cannot_work_are_refused_by_name(parameters, changes, name):
    with pytest.raises(ParameterError) as caught:
        parameters(changes)
    assert any(problem.name.startswith(name) for problem in caught.value.problems), caught.value


def test_modes_that_cannot_be_seen_or_moved_are_refused():
    unstable = np.diag([0.5, 1.1])
    blind, lame = np.array([[1.0, 0.0]]), np.array([[1.0], [0.0]])
    with pytest.raises(ParameterError, match="model.dynamics.C"):
        state_feedback.kalman_gain(unstable, blind, np.eye(2), 1.0)
    with pytest.raises(ParameterError, match="model.dynamics.B"):
        state_feedback.hyperplane_lq(unstable, lame, np.eye(2), 1.0)
    with pytest.raises(ParameterError, match="model.dynamics.B"):
        state_feedback.hyperplane_from_poles(unstable, lame, [0.5])
    with pytest.raises(ParameterError, match="sliding_mode.lq_state_weight"):
        state_feedback.hyperplane_lq(unstable, np.ones((2, 1)), np.diag([1.0, 0.0]), 1.0)
    with pytest.raises(ParameterError, match="kalman.q"):
        state_feedback.kalman_gain(np.diag([0.5, 1.0]), np.ones((1, 2)), np.diag([1.0, 0.0]), 1.0)
    # An unobservable mode that decays is allowed.
    gain, _ = state_feedback.kalman_gain(np.diag([0.5, 0.9]), blind, np.eye(2), 1.0)
    assert np.isfinite(gain).all()


@given(st.floats(1e-9, 1e9), st.floats(1e-9, 1e9))
@settings(max_examples=25, deadline=None)
def test_rank_decisions_do_not_depend_on_units(model, input_unit, output_unit):
    A, B, C, D = model.A, model.B, model.C, model.D
    changed = StateSpace(A, B * input_unit, C * output_unit, D)
    state, command = state_feedback.steady_state(changed)
    assert command * input_unit * output_unit * 2.05 == pytest.approx(1.0, rel=1e-4)
    whole = state_feedback.disturbance_system(changed)
    assert state_feedback.detectable(whole.A, whole.C)


def test_other_types_do_not_check_the_sliding_mode_design(parameters):
    assert parameters({"type": "open_loop", "sliding_mode.S": None}).type == "open_loop"


@pytest.mark.slow
def test_designed_gains_need_no_scipy(tmp_path):
    script = (
        "import sys\n"
        "from hysteresis_ros.control.controller import ControllerParameters, controller_block\n"
        "block = controller_block(ControllerParameters.from_mapping({'type': 'sliding_mode',\n"
        "    'model.dynamics.A': [0.9], 'model.dynamics.B': [0.1], 'model.dynamics.C': [1.0],\n"
        "    'sliding_mode.hyperplane': 'lq', 'kalman.gain': 'riccati'}), 1e-3)\n"
        "block.step(1.0, 0.0)\n"
        "sys.exit('scipy.linalg' in sys.modules)\n"
    )
    import hysteresis_ros.models.block

    root = os.path.dirname(os.path.dirname(os.path.dirname(hysteresis_ros.models.block.__file__)))
    environment = os.environ | {"PYTHONPATH": root, "NUMBA_DISABLE_JIT": "1"}
    assert subprocess.run([sys.executable, "-c", script], env=environment, cwd=tmp_path).returncode == 0
