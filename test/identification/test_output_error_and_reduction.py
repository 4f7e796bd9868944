# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""B2: continuous transfer functions by output error, G4 → G2 by matching responses, m, b and K."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from hysteresis_ros.identification.data import DataError
from hysteresis_ros.identification.linear_systems import FitError, simulate_transfer_function
from hysteresis_ros.identification.transfer_function import (
    Search,
    Structure,
    dominant_second_order,
    fit_transfer_function,
    mass_spring_damper,
)
from hysteresis_ros.identification.validation import validate

#: Paper B, eqs 1 and 2.
G4 = ([3400.0, 62060.0], [1.0, 572.5, 10120.0, 61670.0, 539200.0])
G2 = ([7.4192], [1.0, 3.2, 64.5151])
STEP = 0.01


def square(samples=400):
    return np.where(np.arange(samples) * STEP % 1.0 < 0.5, 150.0, 0.0)


def test_g4_reduces_to_g2_and_to_mass_damping_and_stiffness():
    reduced = dominant_second_order(*G4)
    np.testing.assert_allclose(reduced.denominator, G2[1], rtol=5e-3)
    np.testing.assert_allclose(reduced.gain, G4[0][-1] / G4[1][-1])
    assert reduced.rms < 0.02
    found = mass_spring_damper(reduced.numerator, reduced.denominator)
    assert found.mass == pytest.approx(0.1348, rel=5e-3)
    assert found.damping == pytest.approx(0.4313, rel=5e-3)
    assert found.stiffness == pytest.approx(8.6957, rel=5e-3)


def test_mass_damping_and_stiffness_of_the_papers_g2():
    found = mass_spring_damper(*G2)
    np.testing.assert_allclose([found.mass, found.damping, found.stiffness], [0.1348, 0.4313, 8.6957], rtol=2e-4)


def test_a_system_of_second_order_reduces_to_itself():
    reduced = dominant_second_order(*G2)
    np.testing.assert_allclose(reduced.denominator, G2[1], rtol=1e-6)


def test_simulation_with_held_input_is_the_textbook_discretisation():
    u = np.random.default_rng(0).standard_normal(300)
    b, a, _ = scipy.signal.cont2discrete(G4, STEP, method="zoh")
    expected = scipy.signal.lfilter(b.ravel(), a, u)
    np.testing.assert_allclose(simulate_transfer_function(*G4, u, STEP), expected, atol=1e-9 * np.ptp(expected))


@pytest.mark.parametrize(("intersample", "error"), [("zoh", 0.1), ("linear", 2e-3), ("bandlimited", 5e-5)])
def test_between_the_samples_a_sine_is_as_good_as_its_reconstruction(intersample, error):
    t, w = np.arange(256) * STEP, 2 * np.pi * 5 / (256 * STEP)
    gain = np.polyval(G4[0], 1j * w) / np.polyval(G4[1], 1j * w)
    y = simulate_transfer_function(*G4, np.sin(w * t), STEP, intersample, "periodic")
    assert np.max(np.abs(y - np.abs(gain) * np.sin(w * t + np.angle(gain)))) < error * np.abs(gain)


def test_a_ramp_is_followed_exactly_by_straight_lines_and_rest_is_rest():
    t = np.arange(400) * STEP
    y = simulate_transfer_function([2.0], [1.0, 2.0], t, STEP, "foh")
    np.testing.assert_allclose(y, t - 0.5 + 0.5 * np.exp(-2.0 * t), atol=1e-12)
    rest = simulate_transfer_function(*G4, np.full(50, 3.0), STEP, initial="rest")
    np.testing.assert_allclose(rest, 3.0 * G4[0][-1] / G4[1][-1], rtol=1e-9)
    late = simulate_transfer_function([2.0], [1.0, 2.0], t, STEP, "foh", delay=0.1)
    np.testing.assert_allclose(late[10:], y[:-10], atol=1e-12)


@pytest.mark.slow
def test_400_noisy_samples_of_g4_give_its_poles_and_pass_the_papers_tests():
    u = square()
    clean = simulate_transfer_function(*G4, u, STEP)
    y = clean + 0.01 * clean.std() * np.random.default_rng(1).standard_normal(u.size)
    fit = fit_transfer_function(u, y, STEP, Structure(4, 1), units=("V", "um"))
    assert fit.converged and fit.fit_percent > 98.0
    slow = fit.poles[np.argmin(np.abs(fit.poles.real))]
    assert abs(slow) == pytest.approx(np.sqrt(64.5213), rel=0.01)
    assert fit.dc_gain == pytest.approx(0.11510, rel=0.01)
    result = validate(y, fit.predicted, u, unit="um", parameters=6)
    assert result.autocorrelation.passed and result.cross_correlation.passed
    assert "weakly determined" in fit.warnings[0], "a pole at 554 rad/s is beyond 100 samples a second"
    assert len(fit.starts) == 6 and fit.starts[0].rmse <= fit.starts[-1].rmse
    low = fit_transfer_function(u, y, STEP, Structure(1))
    assert not validate(y, low.predicted, u, unit="um").autocorrelation.passed


@pytest.mark.slow
def test_scale_does_not_matter_and_deviations_are_those_of_repeated_experiments():
    u = np.repeat(np.random.default_rng(2).standard_normal(80), 5)
    clean = simulate_transfer_function([1e-6 * 2e6], [1.0, 600.0, 1e6], u, 1e-3)
    found, deviations = [], []
    for seed in range(30):
        y = clean + 0.02 * clean.std() * np.random.default_rng(seed).standard_normal(u.size)
        fit = fit_transfer_function(u, y, 1e-3, search=Search(1, np.roots([1.0, 600.0, 1e6])))
        found.append([*fit.numerator, *fit.denominator[1:]])
        deviations.append(fit.standard_deviations)
    np.testing.assert_allclose(np.mean(found, axis=0), [2.0, 600.0, 1e6], rtol=0.02)
    np.testing.assert_allclose(np.std(found, axis=0), np.mean(deviations, axis=0), rtol=0.4)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_slow_and_fast_systems_are_found_alike_from_a_rich_input(scale):
    u = np.repeat(np.random.default_rng(3).standard_normal(100), 4)
    den = np.array([1.0, 0.8 / scale, 25.0 / scale**2])
    fit = fit_transfer_function(u, simulate_transfer_function([25.0 / scale**2], den, u, 0.05 * scale), 0.05 * scale)
    np.testing.assert_allclose(fit.denominator, den, rtol=1e-5)
    np.testing.assert_allclose(
        fit.discrete().simulate(u), simulate_transfer_function(fit.numerator, den, u, 0.05 * scale), atol=1e-4
    )


@pytest.mark.slow
def test_unknown_start_and_offset_are_estimated():
    u = square()
    y = simulate_transfer_function(*G2, np.r_[np.full(130, 150.0), u], STEP)[130:] + 7.0
    fit = fit_transfer_function(u, y, STEP, Structure(initial="estimate", offset=True))
    np.testing.assert_allclose(fit.denominator, G2[1], rtol=1e-4)
    assert fit.offset == pytest.approx(7.0, rel=1e-4)
    wrong = fit_transfer_function(u, y, STEP)
    assert wrong.fit_percent < 95.0


@pytest.mark.slow
def test_non_minimum_phase_and_negative_gain_are_warned_of():
    u = np.repeat(np.random.default_rng(4).standard_normal(80), 5)
    y = simulate_transfer_function([-1.0, 5.0], [1.0, 2.0, 5.0], u, 0.05)
    assert any("non-minimum-phase" in t for t in fit_transfer_function(u, y, 0.05, Structure(zeros=1)).warnings)
    assert any("against" in t for t in fit_transfer_function(u, -u, 0.05, Structure(1)).warnings)


def test_bad_input_is_named():
    u = square()
    with pytest.raises(DataError, match="constant"):
        fit_transfer_function(np.ones(100), u[:100], STEP)
    with pytest.raises(DataError, match="too few"):
        fit_transfer_function(u[45:53], u[45:53], STEP)
    with pytest.raises(FitError, match="no more zeros than poles"):
        fit_transfer_function(u, u, STEP, Structure(1, 2))
    with pytest.raises(FitError, match="intersample"):
        simulate_transfer_function(*G2, u, STEP, "splines")
    with pytest.raises(FitError, match="left half plane"):
        dominant_second_order([1.0], [1.0, -1.0, 4.0])
    with pytest.raises(FitError, match="reduce the model first"):
        mass_spring_damper(*G4)
    with pytest.raises(FitError, match="must be positive"):
        mass_spring_damper([1.0], [1.0, 1.0, -4.0])
