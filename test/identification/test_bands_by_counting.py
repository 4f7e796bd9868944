# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Coverage of bands of frequency responses: stated variance and scatter of many recordings, with few averages."""

from __future__ import annotations

import numpy as np
import pytest
from excited_support import RATE, plant, truth

from hysteresis_ros.identification.excitations import Experiment, excitation
from hysteresis_ros.identification.frequency_response import analyse, multisine_response, welch_response

#: A gain without memory: windows do not leak, and the scatter is caused by noise alone.
GAIN, NOISE = 2.0, 0.7


def noisy(random, shape):
    """Return an input and the output of the gain with noise."""
    u = random.standard_normal(shape)
    return u, GAIN * u + NOISE * random.standard_normal(shape)


def counted(responses, probability=0.95):
    """Return the ratio of scatter to stated variance, and the fraction of responses within their bands."""
    errors = np.array([np.abs(one.response[:, 0, 0] - GAIN) for one in responses])
    variances = [one.noise_variance if one.total_variance is None else one.total_variance for one in responses]
    inside = np.array([one.radius(probability)[:, 0, 0] for one in responses]) > errors
    return np.mean(errors**2) / np.mean(variances), np.mean(inside)


@pytest.mark.slow
@pytest.mark.parametrize("window", ["hann", "boxcar"])
def test_the_variance_of_overlapping_segments_is_that_of_the_scatter(window):
    """Overlapping segments count as fewer averages than as many separate ones: a third fewer without a window."""
    random = np.random.default_rng(5)
    found = [welch_response(*noisy(random, 512 * 17), 1.0, segment=1024, window=window) for _ in range(50)]
    ratio, inside = counted(found)
    assert ratio == pytest.approx(1.0, abs=0.035)
    assert inside == pytest.approx(0.95, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("segments", [4, 6])
@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_with_few_averages_the_band_is_as_much_wider_as_its_own_variance_is_uncertain(segments, probability):
    random = np.random.default_rng(6)
    samples = 512 * (segments + 1)
    found = [welch_response(*noisy(random, samples), 1.0, segment=1024) for _ in range(62)]
    _, inside = counted(found, probability)
    assert inside == pytest.approx(probability, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("periods", [2, 3])
def test_of_two_periods_the_band_has_the_one_degree_of_freedom_of_their_difference(periods):
    random = np.random.default_rng(7)
    one = np.fft.irfft(np.exp(2j * np.pi * random.random(65))) * 128.0
    u = np.tile(one, (periods, 1))
    found = [multisine_response(u, GAIN * u + random.standard_normal(u.shape), 1.0) for _ in range(400)]
    for probability in (0.5, 0.95):
        _, inside = counted(found, probability)
        assert inside == pytest.approx(probability, abs=0.012)


def test_of_one_realisation_the_band_holds_the_distortion_that_its_free_lines_show():
    """The best linear approximation of a cubic c is known: it adds 3 c σ² (Bussgang, for a Gaussian input)."""
    inside = []
    for seed in range(30):
        u, plan = excitation(Experiment(period=0.4, realisations=1, periods=6, seed=10 * seed + 1), RATE)
        found = analyse(plan, 1.0 / RATE, u, plant(u + 0.5 * u**3, 1e-4, seed)).response
        best = truth(found.frequency) * (1.0 + 1.5 * np.mean(u**2))
        inside.append(np.mean(np.abs(found.single - best) < found.radius()[:, 0, 0]))
        # the noise alone is a thousandth of this
        assert np.median(found.total_variance) > 100.0 * np.median(found.noise_variance)
    assert 0.85 < np.mean(inside) < 0.99, np.mean(inside)
