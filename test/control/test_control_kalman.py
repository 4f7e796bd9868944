# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Kalman filter: both forms against their closed form, exact decay of the error, the estimated disturbance."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.control import kalman, state_feedback
from hysteresis_ros.control.kalman import KalmanFilter, KalmanParameters, filter_gain
from hysteresis_ros.models.linear import LinearParameters

N = 200


@pytest.fixture
def signals():
    generator = np.random.default_rng(1)
    return generator.normal(size=N), generator.normal(size=N)


def build(parameters, changes=None, dynamics=None):
    chosen = parameters(changes)
    return KalmanFilter(chosen.kalman, 1 / 3000, dynamics or chosen.model.dynamics)


@pytest.mark.parametrize("form", ["predictor", "current"])
@pytest.mark.parametrize("disturbance", ["none", "constant"])
def test_filter_is_its_textbook_recursion(parameters, model, signals, form, disturbance):
    applied, measured = signals
    changes = {"kalman.form": form, "kalman.disturbance": disturbance}
    observer = build(parameters, changes)
    A, B, C = model.A, model.B, model.C
    B_known = B[:, 0]
    if disturbance == "constant":
        whole = state_feedback.disturbance_system(model)
        A, C = whole.A, whole.C
        B_known = np.append(B_known, 0.0)
    L = filter_gain(observer.parameters, model)
    rest, rest_input = state_feedback.steady_state(model)
    state = rest * measured[0]
    if disturbance == "constant":
        state = np.append(state, rest_input * measured[0] - applied[0])
    late, expected = 0.0, [measured[0]]
    for k in range(1, N):
        state = A @ state + B_known * applied[k] + (L * late if form == "predictor" else 0.0)
        late = measured[k] - (C @ state).item()
        if form == "current":
            state = state + L * late
        expected.append((C @ state).item())
    assert observer.simulate(applied, measured) == pytest.approx(expected, abs=1e-12)
    assert observer.estimate == pytest.approx(state[:3], abs=1e-12)


def test_current_estimate_is_the_prediction_corrected_by_the_newest_innovation(parameters, model, signals):
    applied, measured = signals
    predictor, current = build(parameters), build(parameters, {"kalman.form": "current"})
    gain = filter_gain(current.parameters, model)
    predictor.step(applied[0], measured[0])
    current.step(applied[0], measured[0])
    for u, y in zip(applied[1:], measured[1:], strict=True):
        predictor.step(u, y)
        current.step(u, y)
        innovation = predictor.x[kalman.INNOVATION]
        assert current.x[kalman.INNOVATION] == pytest.approx(innovation, abs=1e-12)
        assert current.estimate == pytest.approx(predictor.estimate + gain * innovation, abs=1e-12)


@pytest.mark.parametrize("feedthrough", [0.0, 0.3])
def test_error_decays_with_the_poles_of_the_filter(parameters, model, signals, feedthrough):
    A, B, C = model.A, model.B, model.C
    dynamics = LinearParameters(tuple(A.ravel()), tuple(B.ravel()), tuple(C.ravel()), (feedthrough,))
    observer = build(parameters, dynamics=dynamics)
    L = filter_gain(observer.parameters, dynamics.state_space)
    applied, _ = signals
    state = np.array([1.0, -2.0, 0.5])
    observer.step(0.0, 0.0)
    error = state.copy()
    for k in range(60):
        # The measurement comes before the input changes: the feedthrough acts on the last held input.
        state = A @ state + B[:, 0] * applied[k]
        # The first measurement, which started the filter, gave no innovation.
        transition = A - np.outer(L, C) if k else A
        error = transition @ error
        observer.step(applied[k], (C @ state).item() + feedthrough * applied[k])
        assert state - observer.estimate == pytest.approx(error, abs=1e-12)


@pytest.mark.parametrize("form", ["predictor", "current"])
def test_constant_disturbance_is_found(parameters, model, form):
    A, B, C = model.A, model.B, model.C
    observer = build(parameters, {"kalman.form": form, "kalman.disturbance": "constant", "kalman.q_disturbance": 0.01})
    state = np.zeros(3)
    for k in range(600):
        u = np.sin(0.05 * k)
        measured = (C @ state).item()
        observer.step(np.sin(0.05 * (k - 1)) if k else 0.0, measured)
        state = A @ state + B[:, 0] * (u + 0.7)
    assert observer.x[kalman.OFFSET] == pytest.approx(0.7, abs=1e-9)


def test_filter_starts_from_rest_at_the_first_measurement(parameters):
    observer = build(parameters, {"kalman.disturbance": "constant"})
    for _ in range(50):
        assert observer.step(0.4, 1.5) == pytest.approx(1.5, abs=1e-12)
    assert observer.x[kalman.OFFSET] == pytest.approx(1.5 / 2.05 - 0.4, abs=1e-5)


def test_more_measurement_noise_means_less_gain(model):
    sizes = [np.linalg.norm(filter_gain(KalmanParameters(q=1.0, r=r), model)) for r in (0.01, 1.0, 100.0)]
    assert sizes[0] > sizes[1] > sizes[2]
