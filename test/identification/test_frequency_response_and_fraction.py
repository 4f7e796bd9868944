# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""K4: a frequency response with its uncertainty, a matrix fraction by linear least squares, the lowest order."""

from __future__ import annotations

import numpy as np
import pytest
from measured_data import measured_data

from hysteresis_ros.identification.data import DataError
from hysteresis_ros.identification.frequency_response import FrequencyResponse, multisine_response, welch_response
from hysteresis_ros.identification.linear_systems import FitError, LinearModel, propagate
from hysteresis_ros.identification.matrix_fraction import (
    balanced_realisation,
    fit_matrix_fraction,
    identify_matrix_fraction,
    stable_part,
    truncate,
)
from hysteresis_ros.models.linear import LinearDynamics

RATE = 3000.0
#: The realisation of paper K's gains (PAPERS.md K7): poles at 635 Hz with damping 0.0018 and at 1228 Hz.
KIM = LinearModel(
    np.array([[0.5856, 1.3305, -0.9172], [-1.3085, 0.0475, -0.1471], [-0.7609, 0.0803, -0.0809]]),
    np.array([[-0.7318], [-0.3533], [0.2288]]),
    np.array([[-0.8674, 0.7907, 0.3855]]) * 1e-6,
    np.zeros((1, 1)),
    1 / RATE,
)
#: The band of paper K: 1 kHz wide around 635 Hz.
BAND = np.arange(135.0, 1135.5, 1.0)


def noisy(frequency, share, seed=0, known=True):
    G = KIM.frequency_response(frequency)
    random = np.random.default_rng(seed)
    deviation = share * np.abs(G)
    noise = deviation * (random.standard_normal(G.shape) + 1j * random.standard_normal(G.shape)) / np.sqrt(2)
    return FrequencyResponse(frequency, G + noise, 1 / RATE, deviation**2 if known else None)


def test_propagation_is_the_recursion():
    random = np.random.default_rng(3)
    A = np.array([[0.9, 1.0, 0.0], [0.0, 0.9, 1.0], [0.0, 0.0, 0.9]])  # one pole three times: no eigenvector basis
    w, x = random.standard_normal((50, 3)), np.array([1.0, -2.0, 0.5])
    states = propagate(A, w, x)
    for k in range(50):
        np.testing.assert_allclose(states[k], x, atol=1e-10)
        x = A @ x + w[k]


def test_model_and_block_have_one_response():
    block = LinearDynamics(KIM.linear_parameters(), 1 / RATE)
    u = np.random.default_rng(0).standard_normal(200)
    expected = KIM.simulate(np.r_[u, 0.0])[1:] / KIM.dc_gain
    np.testing.assert_allclose([block.step(value) for value in u], expected, atol=1e-9)


def test_poles_zeros_and_gain_are_those_published():
    assert [round(mode.frequency) for mode in KIM.modes] == [635, 1228]
    assert KIM.modes[0].damping == pytest.approx(0.0018, abs=5e-5)
    assert KIM.dc_gain == pytest.approx(2.05e-6, rel=1e-3)
    np.testing.assert_allclose(np.sort(KIM.zeros.real), [-3.09, -0.59], atol=0.005)
    assert "non-minimum-phase" in KIM.warnings[0]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("known", [True, False], ids=["variance known", "unknown"])
def test_order_three_and_635_hz_come_back_from_one_percent_noise(seed, known):
    fit = identify_matrix_fraction(noisy(BAND, 0.01, seed, known))
    assert fit.suggested_order == fit.order == 3
    assert fit.model.modes[0].frequency == pytest.approx(635.0, abs=0.1)
    assert fit.model.modes[0].damping == pytest.approx(0.00183, abs=5e-5)
    assert fit.model.dc_gain == pytest.approx(2.05e-6, rel=0.01)
    assert any("non-minimum-phase" in text for text in fit.warnings)
    if known:
        assert fit.misfit[2] == pytest.approx(1.0, abs=0.1), "the misfit equals the noise"


def test_an_exact_response_is_fitted_exactly():
    fit = identify_matrix_fraction(noisy(BAND, 0.0, known=False))
    assert fit.order == 3
    np.testing.assert_allclose(np.sort_complex(fit.model.poles), np.sort_complex(KIM.poles), atol=1e-6)
    fraction = fit_matrix_fraction(noisy(BAND, 0.0, known=False), 3)
    np.testing.assert_allclose(fraction.denominator[:, 0, 0], np.poly(KIM.poles).real, atol=1e-6)


@pytest.mark.slow
def test_welch_tells_its_own_uncertainty():
    random = np.random.default_rng(1)
    u = random.standard_normal(60000)
    y = KIM.simulate(u)
    y += 0.1 * y.std() * random.standard_normal(y.size)
    estimate = welch_response(u, y, 1 / RATE, segment=4096)
    low = estimate.band(1.0, 500.0)  # away from the resonance, the leakage of the windows is below the noise
    error = np.abs(low.response - KIM.frequency_response(low.frequency)) ** 2
    assert np.mean(error) / np.mean(low.total_variance) == pytest.approx(1.0, abs=0.35)
    fit = identify_matrix_fraction(welch_response(u, y, 1 / RATE, segment=8192).band(135.0, 1135.0))
    assert fit.suggested_order == 3
    assert fit.model.modes[0].frequency == pytest.approx(635.0, abs=0.3)


@pytest.mark.slow
def test_coherence_is_the_share_explained():
    random = np.random.default_rng(2)
    u, e = random.standard_normal((2, 200000))
    estimate = welch_response(u, 2.0 * u + 2.0 * e, 1.0, segment=512)
    np.testing.assert_allclose(np.mean(estimate.coherence), 0.5, atol=0.02)
    np.testing.assert_allclose(np.mean(estimate.single.real), 2.0, atol=0.02)
    assert any("coherence" in text for text in welch_response(u, e, 1.0).warnings)


def multisine(samples, random):
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[1 : samples // 2] = np.exp(2j * np.pi * random.random(samples // 2 - 1))
    return np.fft.irfft(spectrum) * np.sqrt(samples)


def test_multisine_separates_noise_from_distortion_and_two_inputs():
    random = np.random.default_rng(4)
    N, P, R = 512, 4, 40
    G = np.array([[1.0, 0.3], [-0.2, 2.0]])
    u = np.array([[multisine(N, random), multisine(N, random)] for _ in range(R)])[:, None].repeat(P, axis=1)
    noise = 0.05 * random.standard_normal((R, P, 2, N))
    clean = np.einsum("ij,rpjn->rpin", G, u)
    linear = multisine_response(u, clean + noise, 1e-3)
    error = np.mean(np.abs(linear.response - G) ** 2)
    assert linear.response.shape == (N // 2 - 1, 2, 2)
    assert error / np.mean(linear.noise_variance) == pytest.approx(1.0, abs=0.2)
    assert error / np.mean(linear.total_variance) == pytest.approx(1.0, abs=0.2)
    bent = multisine_response(u, clean + 0.1 * u**2 + noise, 1e-3)
    assert np.mean(bent.noise_variance) == pytest.approx(np.mean(linear.noise_variance), rel=0.1)
    assert np.mean(bent.total_variance) > 3.0 * np.mean(bent.noise_variance)


def test_single_multisine_in_steady_state_is_exact():
    u = np.tile(multisine(600, np.random.default_rng(5)), 3)
    y = np.tile(u[:600] - 0.5 * np.roll(u[:600], 2), 3)
    estimate = multisine_response(u, y, 1e-3, period=600)
    np.testing.assert_allclose(estimate.single, 1 - 0.5 * np.exp(-2j * np.pi * estimate.frequency * 2e-3), atol=1e-9)
    assert estimate.total_variance is None and np.max(estimate.noise_variance) < 1e-20


def test_several_inputs_and_outputs_are_realised_together():
    A = np.diag([0.9, 0.5, -0.3])
    B, C = np.array([[1.0, 0.2], [0.3, 1.0], [1.0, -1.0]]), np.array([[1.0, 0.5, 0.0], [0.2, 1.0, 1.0]])
    truth = LinearModel(A, B, C, np.zeros((2, 2)), 1.0)
    frequency = np.linspace(0.002, 0.498, 200)
    fit = identify_matrix_fraction(FrequencyResponse(frequency, truth.frequency_response(frequency), 1.0))
    assert fit.order == 3
    np.testing.assert_allclose(np.sort(fit.model.poles.real), [-0.3, 0.5, 0.9], atol=1e-6)
    np.testing.assert_allclose(fit.model.dc_gain, truth.dc_gain, rtol=1e-6)


def test_a_balanced_model_cut_short_loses_cancelling_pairs_and_nothing_else():
    A = np.block([[KIM.A, np.zeros((3, 1))], [np.zeros((1, 3)), np.array([[0.7]])]])
    B, C = np.vstack([KIM.B, [[1.0]]]), np.hstack([KIM.C, [[1e-14]]])  # a pole at 0.7, a zero nearly there
    model = LinearModel(A, B, C, KIM.D, 1 / RATE)
    balanced, values = balanced_realisation(model)
    assert np.count_nonzero(values > 1e-6 * values[0]) == 3
    least = truncate(balanced, 3)
    np.testing.assert_allclose(least.frequency_response(BAND), KIM.frequency_response(BAND), rtol=1e-4)
    values = balanced_realisation(KIM)[1]
    assert len(values) == 3 and np.all(np.diff(values) <= 0.0)


def test_unstable_poles_are_split_off_with_their_own_share():
    stable = LinearModel(np.array([[0.5]]), np.array([[1.0]]), np.array([[1.0]]), np.zeros((1, 1)), 1.0)
    both = LinearModel(np.array([[0.5, 0.0], [0.0, 1.2]]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), 1.0)
    assert "unstable" in both.warnings[0]
    part, dropped = stable_part(both)
    np.testing.assert_allclose(dropped, [1.2])
    np.testing.assert_allclose(part.frequency_response([0.1, 0.3]), stable.frequency_response([0.1, 0.3]))
    with pytest.raises(FitError, match="unstable"):
        balanced_realisation(both)
    with pytest.raises(FitError, match="unstable"):
        both.linear_parameters()


def test_the_response_of_an_unstable_system_is_never_taken_silently():
    both = LinearModel(np.diag([0.5, 1.2]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), 1.0)
    frequency = np.linspace(0.005, 0.495, 150)
    fit = identify_matrix_fraction(FrequencyResponse(frequency, both.frequency_response(frequency), 1.0))
    assert fit.model.stable
    assert any("unstable linear fit" in text for text in fit.warnings), fit.warnings
    assert not any("unstable" in text for text in identify_matrix_fraction(noisy(BAND, 0.01)).warnings)


def test_bad_input_is_named():
    with pytest.raises(DataError, match="constant"):
        welch_response(np.ones(500), np.arange(500.0), 1e-3)
    with pytest.raises(DataError, match="too few"):
        welch_response(np.arange(20.0), np.arange(20.0), 1e-3)
    with pytest.raises(DataError, match="not finite"):
        welch_response(np.r_[np.nan, np.arange(500.0)], np.arange(501.0), 1e-3)
    with pytest.raises(DataError, match="whole number of periods"):
        multisine_response(np.arange(100.0), np.arange(100.0), 1e-3, period=33)
    with pytest.raises(DataError, match="no line in"):
        noisy(BAND, 0.0).band(2000.0, 3000.0)
    with pytest.raises(FitError, match="order = 99"):
        identify_matrix_fraction(noisy(BAND[:60], 0.01), order=99, degree=6)
    with pytest.raises(DataError, match="too few"):
        fit_matrix_fraction(noisy(BAND[:5], 0.01), 20)


def test_measured_mirror_response_predicts_new_phases():
    """The response of six realisations predicts three others better than the published linear models (0.114 µm)."""
    folder = measured_data("fsm_cubespec")
    arrays = [np.load(folder / f"{signal}_100mV_{part}.npy") for part in ("train", "test") for signal in "uy"]
    u, y, u_test, y_test = (array.transpose(2, 3, 1, 0) for array in arrays)
    estimate = multisine_response(u, y, 1 / 6400.0)
    N = u.shape[-1]
    lines = np.rint(estimate.frequency * N / 6400.0).astype(int)
    spectrum = np.fft.rfft(u_test, axis=3)
    predicted = np.zeros_like(spectrum)
    predicted[..., lines] = np.einsum("fij,rpjf->rpif", estimate.response, spectrum[..., lines])
    rmse = np.sqrt(np.mean((y_test - np.fft.irfft(predicted, N, axis=3)) ** 2))
    assert rmse < 0.09e-6
    assert np.median(estimate.total_variance) > 2.0 * np.median(estimate.noise_variance), "hysteresis is not noise"
