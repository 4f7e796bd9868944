# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""W1 and W6: ARX models by least squares, on request with zeros inside the unit circle."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.identification.arx import ArxOrders, fit_arx, suggest_arx_orders
from hysteresis_ros.identification.data import DataError
from hysteresis_ros.identification.linear_systems import FitError

A, B = np.array([1.0, -1.5, 0.7]), np.array([0.5, 0.2])
INPUT = np.random.default_rng(0).standard_normal(800)


def response(u, b=B, noise=0.0, seed=1):
    e = noise * np.random.default_rng(seed).standard_normal(len(u))
    return scipy.signal.lfilter(np.r_[0.0, b], A, u) + scipy.signal.lfilter([1.0], A, e)


def test_paper_w_model_is_recovered_exactly_without_noise():
    fit = fit_arx(INPUT, response(INPUT), 0.01)
    np.testing.assert_allclose(fit.denominator, A, atol=1e-10)
    np.testing.assert_allclose(fit.numerator, B, atol=1e-10)
    np.testing.assert_allclose(fit.model.simulate(INPUT), response(INPUT), atol=1e-8)
    assert fit.warnings == ()


def test_standard_deviations_are_those_of_repeated_experiments():
    fits = []
    for seed in range(120):
        u = np.random.default_rng(1000 + seed).standard_normal(800)
        fits.append(fit_arx(u, 1e-6 * response(u, noise=0.1, seed=seed), 0.01))
    found = np.array([np.r_[fit.denominator[1:], fit.numerator] for fit in fits])
    np.testing.assert_allclose(found.std(axis=0), np.mean([f.standard_deviations for f in fits], axis=0), rtol=0.25)
    np.testing.assert_allclose(found.mean(axis=0), np.r_[A[1:], 1e-6 * B], rtol=2e-3)
    assert fits[0].residual_variance == pytest.approx(1e-14, rel=0.2)
    assert fits[0].fpe > fits[0].residual_variance * 0.99


def test_records_of_several_frequencies_make_one_regression():
    t = np.arange(0, 40, 0.05)
    inputs = [np.sin(w * t) for w in (0.5 * np.pi, np.pi, 2 * np.pi)]
    fit = fit_arx(inputs, [response(u) for u in inputs], 0.05)
    np.testing.assert_allclose(fit.numerator, B, rtol=1e-6)


def test_offset_and_delay():
    y = response(np.r_[np.zeros(2), INPUT[:-2]])
    fit = fit_arx(INPUT, y + 30.0, 0.01, ArxOrders(delay=3), offset=True)
    np.testing.assert_allclose(fit.numerator, B, atol=1e-8)
    assert fit.offset == pytest.approx(30.0 * A.sum())
    assert fit.model.order == 4
    np.testing.assert_allclose(fit.model.simulate(INPUT), y, atol=1e-7)
    assert suggest_arx_orders(np.r_[INPUT[2:], 0, 0], response(INPUT, noise=0.1), 0.01) == (2, 2, 3)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=2), st.floats(-2.0, 2.0).filter(lambda x: abs(x) > 0.1))
def test_constrained_zeros_are_inside_and_the_cost_is_the_least_there(zeros, gain):
    b = gain * np.poly(zeros)
    y = response(INPUT, b, noise=0.01)
    fit = fit_arx(INPUT, y, 0.01, ArxOrders(nb=len(b)), zero_radius=0.95)
    free = fit_arx(INPUT, y, 0.01, ArxOrders(nb=len(b)))
    assert np.all(np.abs(fit.zeros) <= 0.95 + 1e-5)
    assert fit.residual_variance >= free.residual_variance * (1 - 1e-9)
    if not fit.constrained:
        np.testing.assert_allclose(fit.numerator, free.numerator, rtol=1e-8, atol=1e-12)
    else:
        assert "without the constraint" in fit.warnings[0]


def test_constrained_solution_is_the_best_on_the_boundary():
    y = response(INPUT, np.array([0.5, 0.8]), noise=0.01)
    fit = fit_arx(INPUT, y, 0.01, zero_radius=0.95)
    assert fit.constrained and fit.zeros[0] == pytest.approx(-0.95)
    table = np.column_stack([-y[1:-1], -y[:-2], INPUT[1:-1] + 0.95 * INPUT[:-2]])
    best = np.linalg.lstsq(table, y[2:], rcond=None)[0]
    np.testing.assert_allclose([*fit.denominator[1:], fit.numerator[0]], best, rtol=1e-6)


def test_unstable_and_non_minimum_phase_fits_say_so():
    u = INPUT[:60]
    growing = scipy.signal.lfilter([0.0, 1.0], [1.0, -1.2], u)
    assert "unstable" in fit_arx(u, growing, 0.01, ArxOrders(1, 1)).warnings[0]
    assert any("non-minimum-phase" in t for t in fit_arx(INPUT, response(INPUT, [0.5, 0.8]), 0.01).warnings)
    assert any("DC gain" in t for t in fit_arx(INPUT, response(INPUT, [-0.5, -0.2]), 0.01).warnings)


def test_bad_input_is_named():
    with pytest.raises(DataError, match="too few"):
        fit_arx(INPUT[:8], INPUT[:8], 0.01)
    with pytest.raises(DataError, match="constant"):
        fit_arx(np.ones(100), INPUT[:100], 0.01)
    with pytest.raises(DataError, match="not finite"):
        fit_arx(INPUT, np.where(INPUT > 2, np.nan, INPUT), 0.01)
    with pytest.raises(FitError, match="more frequencies"):
        t = np.arange(500) * 0.01
        fit_arx(np.sin(t), np.cos(t), 0.01, ArxOrders(3, 3))
    with pytest.raises(FitError, match="nb ≤ 3"):
        fit_arx(INPUT, response(INPUT), 0.01, ArxOrders(nb=4), zero_radius=0.9)
    with pytest.raises(FitError, match="delay ≥ 1"):
        fit_arx(INPUT, response(INPUT), 0.01, ArxOrders(delay=0))
