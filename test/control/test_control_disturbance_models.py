# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Kalman filters with a disturbance model: textbook recursion, estimation and rejection of disturbances, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.control import kalman, law, state_feedback
from hysteresis_ros.control.kalman import KalmanFilter, disturbance_model, filter_gain
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearParameters, StateSpace

SAMPLE_TIME = 1.0 / 3000.0
STEP = 2.05e-6
RAMP = {"kalman.disturbance": "ramp", "kalman.q_disturbance": 0.01, "kalman.q_disturbance_rate": 1e-4}
PERIODIC = {
    "kalman.disturbance": "periodic",
    "kalman.q_disturbance": 0.01,
    "kalman.q_disturbance_periodic": 0.01,
    "kalman.disturbance_frequency": 20.0,
}
CONSTANT = {"kalman.disturbance": "constant", "kalman.q_disturbance": 0.01}


def test_disturbances_obey_their_models(parameters):
    t = np.arange(50) * SAMPLE_TIME
    ramp, row, _ = disturbance_model(parameters(RAMP).kalman, SAMPLE_TIME)
    state, seen = np.array([2.0, 0.3]), []
    for _ in t:
        seen.append(row @ state)
        state = ramp @ state
    assert seen == pytest.approx(2.0 + 0.3 * np.arange(50))
    periodic, row, _ = disturbance_model(parameters(PERIODIC | {"kalman.disturbance_harmonics": 2}).kalman, SAMPLE_TIME)
    state, seen = np.array([0.5, 1.0, 0.0, 0.0, 0.7]), []
    for _ in t:
        seen.append(row @ state)
        state = periodic @ state
    assert seen == pytest.approx(0.5 + np.cos(2 * np.pi * 20 * t) + 0.7 * np.sin(2 * np.pi * 40 * t), abs=1e-12)


@pytest.mark.parametrize(
    ("kind", "quiet", "parts"), [(PERIODIC, "q_disturbance_periodic", [1, 2]), (RAMP, "q_disturbance_rate", [1])]
)
def test_a_part_of_a_disturbance_that_hardly_changes_is_hardly_corrected(parameters, model, kind, quiet, parts):
    """Each part has a variance of its own; the constant is corrected nearly as before."""
    usual, other = (
        filter_gain(parameters(kind | changes).kalman, model, SAMPLE_TIME)[model.order :]
        for changes in ({}, {f"kalman.{quiet}": 1e-12})
    )
    assert np.linalg.norm(other[parts]) < 1e-3 * np.linalg.norm(usual[parts])
    assert 0.5 < other[0] / usual[0] < 2.0


@pytest.mark.slow
@pytest.mark.parametrize(("form", "feedthrough"), [("predictor", 0.0), ("predictor", 0.3), ("current", 0.0)], ids=str)
@pytest.mark.parametrize("changes", [CONSTANT, RAMP, PERIODIC], ids=lambda c: c["kalman.disturbance"])
def test_filter_is_the_textbook_recursion_of_the_whole_system(parameters, model, form, feedthrough, changes):
    A, B, C = model.A, model.B, model.C
    chosen = parameters(changes | {"kalman.form": form}).kalman
    dynamics = LinearParameters(tuple(A.ravel()), tuple(B.ravel()), tuple(C.ravel()), (feedthrough,))
    observer = KalmanFilter(chosen, SAMPLE_TIME, dynamics)
    L = filter_gain(chosen, dynamics.state_space, SAMPLE_TIME)
    A_d, c_d, _ = disturbance_model(chosen, SAMPLE_TIME)
    disturbed = state_feedback.disturbance_system(dynamics.state_space, A_d, c_d)
    whole, output = disturbed.A, disturbed.C
    known = np.append(B[:, 0], np.zeros(len(A_d)))
    applied, measured = np.random.default_rng(1).normal(size=(2, 150))
    rest, rest_input = state_feedback.steady_state(dynamics.state_space)
    state = np.concatenate([rest * measured[0], [rest_input * measured[0] - applied[0]], np.zeros(len(A_d) - 1)])
    late, expected, disturbances = 0.0, [measured[0]], []
    for k in range(1, len(applied)):
        state = whole @ state + known * applied[k] + (L * late if form == "predictor" else 0.0)
        predicted = (output @ state).item() + feedthrough * applied[k]
        late = measured[k] - predicted
        if form == "current":
            state = state + L * late
            predicted = (output @ state).item()
        expected.append(predicted)
        disturbances.append(c_d @ state[3:])
    assert observer.simulate(applied, measured) == pytest.approx(expected, abs=1e-11)
    assert observer.estimate == pytest.approx(state[:3], abs=1e-11)
    assert observer.x[kalman.OFFSET] == pytest.approx(disturbances[-1], abs=1e-11)


@pytest.mark.parametrize("form", ["predictor", "current"])
def test_a_ramp_of_disturbance_is_compensated_in_the_sample_in_which_it_acts(loop, form):
    """The constant model lags behind a ramp; the ramp model, predicted by one sample, leaves no error."""
    samples, rate = 3000, 1e-9  # metres per sample
    errors = {}
    for name, changes in (("constant", CONSTANT), ("ramp", RAMP)):
        axis = loop(changes | {"kalman.form": form})
        y = np.empty(samples)
        for k in range(samples):
            axis.disturbance = rate * k
            y[k] = axis.run([STEP])[1][0]
        errors[name] = abs(y[-1] - STEP)
    assert errors["ramp"] < 1e-12
    assert errors["constant"] > 1e-9
    assert axis.controller.x[law.DISTURBANCE] == pytest.approx(rate * (samples - 1), rel=1e-6)


@pytest.mark.parametrize("changes", [RAMP, PERIODIC], ids=["ramp", "periodic"])
def test_behind_a_feedthrough_the_disturbance_of_the_previous_sample_is_measured(parameters, model, changes):
    """y_k = C x_k + D (u + d)_(k-1): without noise the disturbance of the next sample is found exactly."""
    through, count = 0.3, 4000
    dynamics = LinearParameters(*(tuple(matrix.ravel()) for matrix in (model.A, model.B, model.C)), (through,))
    observer = KalmanFilter(parameters(changes).kalman, SAMPLE_TIME, dynamics)
    k = np.arange(count)
    d = 1e-3 * k if changes is RAMP else np.cos(2.0 * np.pi * 20.0 * SAMPLE_TIME * k)
    u = np.sin(0.01 * k)
    x, before = np.zeros(model.order), (0.0, 0.0)
    for now in range(count):
        observer.step(before[0], float(model.C[0] @ x) + through * sum(before))
        before = u[now], d[now]
        x = model.A @ x + model.B[:, 0] * sum(before)
    assert observer.x[kalman.OFFSET] == pytest.approx(d[-1], abs=1e-6 * np.max(np.abs(d)))


@pytest.mark.parametrize("form", ["predictor", "current"])
def test_a_periodic_disturbance_is_rejected_at_its_frequencies(loop, form):
    k = np.arange(6000)
    cause = 1e-7 * np.sin(2 * np.pi * 20 * k * SAMPLE_TIME) + 5e-8 * np.cos(2 * np.pi * 60 * k * SAMPLE_TIME) + 2e-8
    left = {}
    for name, changes in (
        ("constant", CONSTANT),
        ("periodic", PERIODIC | {"kalman.disturbance_harmonics": 3}),
    ):
        axis = loop(changes | {"kalman.form": form})
        y = np.empty(len(k))
        for i in k:
            axis.disturbance = cause[i]
            y[i] = axis.run([STEP])[1][0]
        left[name] = np.max(np.abs(y[-500:] - STEP))
    assert left["periodic"] < 1e-12
    assert left["constant"] > 1e-8


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        (RAMP | {"kalman.q_disturbance_rate": 0.0}, "kalman.q_disturbance_rate"),
        (RAMP | {"kalman.gain": "given", "kalman.L": (0.0, 0.5, 0.3, 0.1)}, "kalman.L"),
        (RAMP | {"sliding_mode.tracking": "integral", "sliding_mode.hyperplane": "lq"}, "kalman.disturbance"),
    ],
)
def test_designs_that_cannot_work_are_refused_by_name(parameters, changes, name):
    with pytest.raises(ParameterError) as caught:
        parameters(changes)
    assert [problem.name for problem in caught.value.problems] == [name]


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        (PERIODIC | {"kalman.disturbance_frequency": 1500.0}, "kalman.disturbance_frequency"),
        (
            PERIODIC | {"kalman.disturbance_frequency": 400.0, "kalman.disturbance_harmonics": 4},
            "kalman.disturbance_fr",
        ),
        (PERIODIC | {"kalman.disturbance_frequency": 0.0}, "kalman.disturbance_frequency"),
        (PERIODIC | {"kalman.q_disturbance_periodic": 0.0}, "kalman.q_disturbance_periodic"),
    ],
)
def test_a_periodic_disturbance_is_checked_when_the_sample_time_is_known(controller, changes, name):
    with pytest.raises(ParameterError) as caught:
        controller(changes)
    assert caught.value.problems[0].name.startswith(name)


def test_a_disturbance_at_a_zero_of_the_model_is_refused():
    """x⁺ = u, y with a zero pair at ±j: signals at a quarter of the sample rate are blocked."""
    from hysteresis_ros.control.kalman import KalmanParameters

    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    blind = StateSpace(A, np.array([[0.0], [0.0], [1.0]]), np.array([[0.5, 0.0, 0.5]]), np.zeros((1, 1)))
    chosen = KalmanParameters(disturbance="periodic", disturbance_frequency=25.0)
    with pytest.raises(ParameterError, match="kalman.disturbance"):
        filter_gain(chosen, blind, 0.01)
    assert np.isfinite(filter_gain(chosen, blind, 0.011)).all()
