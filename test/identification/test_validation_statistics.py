# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Validation: figures by their definitions, and bounds that hold as often as stated."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from hysteresis_ros.identification.data import DataError
from hysteresis_ros.identification.validation import (
    input_cross_correlation,
    parameter_covariance,
    residual_autocorrelation,
    validate,
)

RANDOM = np.random.default_rng


def coloured(random, pole, samples):
    return scipy.signal.lfilter([1.0], [1.0, -pole], random.standard_normal(samples + 200))[200:]


def test_figures_are_their_definitions():
    y = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) * 1e-6
    p = y + 1e-7 * np.array([1, -1, 1, -1, 1, -1, 1, -1.0])
    result = validate(y, p, unit="m", parameters=2)
    assert result.rmse == pytest.approx(1e-7)
    assert result.rmse_percent_of_stroke == pytest.approx(100 * 0.1 / 7)
    assert result.fit_percent == pytest.approx(100 * (1 - np.sqrt(8 * 0.01 / 42)))
    assert result.fpe == pytest.approx(1e-14 * (1 + 2 / 8) / (1 - 2 / 8))
    assert result.maximum_error == pytest.approx(1e-7)
    assert set(result.to_dict()) >= {"rmse_m", "rmse_percent_of_stroke", "fit_percent", "mse_m2", "fpe_m2"}


def test_skipped_samples_and_a_free_offset_are_left_out_of_the_error():
    y = np.sin(np.arange(500) / 20.0)
    p = y - 3.0
    p[:100] += 50.0
    result = validate(y, p, np.cos(np.arange(500)), skip=100, free_offset=True)
    assert (result.samples, result.skipped) == (400, 100)
    assert result.offset == pytest.approx(3.0) and result.rmse < 1e-12
    assert validate(y, p, skip=100).rmse == pytest.approx(3.0)
    volts = validate(y, p, unit="V", skip=100, free_offset=True).to_dict()
    assert "rmse_V" in volts and volts["offset_V"] == pytest.approx(3.0)


@pytest.mark.slow
@pytest.mark.parametrize("confidence", [0.95, 0.99, 0.999])
def test_white_residuals_leave_the_bounds_as_often_as_promised(confidence):
    tests = [residual_autocorrelation(RANDOM(seed).standard_normal(1000), 25, confidence) for seed in range(400)]
    rate = np.mean([test.outside for test in tests]) / 25
    assert rate == pytest.approx(1 - confidence, rel=0.25, abs=6e-4)
    assert np.mean([test.passed for test in tests]) >= confidence - 0.02
    assert np.mean([test.probability < 0.05 for test in tests]) == pytest.approx(0.05, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("poles", [(0.0, 0.0), (0.9, 0.0), (0.9, 0.7)])
def test_independent_coloured_signals_leave_the_bounds_as_often_as_promised(poles):
    outside = []
    for seed in range(200):
        random = RANDOM(seed)
        u, e = coloured(random, poles[0], 3000), coloured(random, poles[1], 3000)
        outside.append(input_cross_correlation(u, e, 20, 0.95).outside / 41)
    assert np.mean(outside) == pytest.approx(0.05, abs=0.015)


def test_what_is_left_in_a_residual_is_found():
    random = RANDOM(5)
    u, e = random.standard_normal((2, 1000))
    y = 10 * np.sin(np.arange(1000) / 30.0)
    lagged = 0.3 * np.roll(u, 4)
    lagged[:4] = 0.0
    result = validate(y + e + lagged, y, u)
    assert not result.cross_correlation.passed
    cross = result.cross_correlation
    assert cross.lags[np.argmax(np.abs(cross.correlation))] == 4, "correlated with the input four samples earlier"
    assert any("depends on the input" in text for text in result.warnings)
    assert any("not white" in text for text in validate(y + coloured(random, 0.5, 1000), y).warnings)
    assert validate(y + e, y, u).warnings == ()


def test_covariance_is_that_of_a_straight_line():
    t = np.linspace(-1.0, 1.0, 201)
    e = RANDOM(0).standard_normal(201)
    J = np.column_stack([np.ones(201), 1e-6 * t])
    variance = e @ e / 199
    expected = np.diag([variance / 201, variance / (1e-12 * t @ t)])
    np.testing.assert_allclose(parameter_covariance(J, e), expected, atol=1e-3 * 1e6 * variance / 201, rtol=1e-9)
    with pytest.raises(DataError, match="does not determine all"):
        parameter_covariance(np.column_stack([t, 2 * t]), e)
    with pytest.raises(DataError, match="no influence"):
        parameter_covariance(np.column_stack([t, 0 * t]), e)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"measured": np.ones(50), "predicted": np.ones(50)}, "constant"),
        ({"measured": np.arange(50.0), "predicted": np.arange(40.0)}, "must both be"),
        ({"measured": np.arange(50.0), "predicted": np.r_[np.nan, np.arange(49.0)]}, "not finite"),
        ({"measured": np.arange(50.0), "predicted": np.arange(50.0), "skip": 49}, "too few"),
        ({"measured": np.arange(50.0), "predicted": np.arange(50.0), "skip": -1}, "skip = -1"),
        ({"measured": np.arange(50.0), "predicted": np.arange(50.0), "unit": ""}, "unit is empty"),
    ],
)
def test_bad_input_is_named(arguments, word):
    with pytest.raises(DataError, match=word):
        validate(**arguments)


def test_a_confidence_is_a_probability():
    with pytest.raises(DataError, match="between 0 and 1"):
        residual_autocorrelation(np.arange(50.0), 5, 99.9)
