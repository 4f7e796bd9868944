# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The oscillator's parameters are recovered from its noisy output, for any input between the samples."""

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.bouc_wen import fit_bouc_wen_mechanical, simulate_oscillator
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters

SAMPLE_TIME = 1.0 / 750.0
TRUTH = dict(mass=2.0, damping=10.0, stiffness=5e4, alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1)


def multisine(samples, periods=1, seed=0):
    random = np.random.default_rng(seed)
    lines = np.arange(2, int(150.0 * samples * SAMPLE_TIME))
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * random.random(lines.size))
    u = np.fft.irfft(spectrum, samples)
    return np.tile(50.0 * u / u.std(), periods)


def test_a_held_input_does_not_depend_on_the_grid():
    parameters = BoucWenMechanicalParameters(**TRUTH)
    u = multisine(256)
    fine = simulate_oscillator(parameters, u, SAMPLE_TIME, "zoh", grid=32)
    coarse = simulate_oscillator(parameters, u, SAMPLE_TIME, "zoh", grid=16)
    assert fine[0] == 0.0
    np.testing.assert_allclose(coarse, fine, atol=3e-5 * np.ptp(fine))


def test_a_periodic_start_repeats_itself():
    parameters = BoucWenMechanicalParameters(**TRUTH)
    u = multisine(2048)
    one = simulate_oscillator(parameters, u, SAMPLE_TIME, initial="periodic")
    three = simulate_oscillator(parameters, np.tile(u, 3), SAMPLE_TIME)
    np.testing.assert_allclose(three[-2048:], one, atol=2e-4 * np.ptp(one))


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="takes minutes without Numba")
@pytest.mark.parametrize("intersample", ["zoh", "bandlimited"])
def test_parameters_come_back_from_thirty_percent_off(intersample):
    u = multisine(2048, 2)
    clean = simulate_oscillator(BoucWenMechanicalParameters(**TRUTH), u, SAMPLE_TIME, intersample)
    y = clean + 5e-6 * np.random.default_rng(3).standard_normal(clean.size)
    factors = dict(mass=1.35, damping=0.65, stiffness=0.68, alpha=1.4, beta=1.0, gamma=1.4, delta=0.65)
    start = BoucWenMechanicalParameters(**{name: factors[name] * value for name, value in TRUTH.items()})
    fit = fit_bouc_wen_mechanical(u, y, SAMPLE_TIME, start, intersample=intersample)
    assert fit.converged
    assert fit.rmse == pytest.approx(5e-6, rel=0.1)
    for name in ("mass", "damping", "stiffness", "alpha"):
        error = abs(getattr(fit.parameters, name) - TRUTH[name])
        assert error < 6.0 * fit.deviations[name] and error < 0.02 * TRUTH[name]
    np.testing.assert_allclose(fit.parameters.gamma, TRUTH["gamma"], rtol=0.05)
    np.testing.assert_allclose(fit.parameters.delta, TRUTH["delta"], rtol=0.05)
    assert np.std(fit.simulate(u, SAMPLE_TIME) - clean) < 1e-6


def test_bad_data_and_settings_are_refused():
    start = BoucWenMechanicalParameters(**TRUTH)
    u = multisine(256)
    with pytest.raises(IdentificationError, match="constant"):
        fit_bouc_wen_mechanical(u, np.zeros(256), SAMPLE_TIME, start)
    with pytest.raises(IdentificationError, match="intersample"):
        fit_bouc_wen_mechanical(u, u, SAMPLE_TIME, start, intersample="spline")
    with pytest.raises(IdentificationError, match="both must have the same number of samples"):
        fit_bouc_wen_mechanical(u, u[:-1], SAMPLE_TIME, start)
