# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The sensor and its random generator MRG32k3a."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.models import sensor as model
from hysteresis_ros.models.sensor import Sensor, SensorParameters, generator_state, normal, uniform

M1, M2 = 2**32 - 209, 2**32 - 22853


def integer_mrg32k3a(words, count):
    """MRG32k3a in integer arithmetic, from the definition of its two recurrences."""
    a, b = list(words[:3]), list(words[3:])
    result = []
    for _ in range(count):
        a = [a[1], a[2], (1403580 * a[1] - 810728 * a[0]) % M1]
        b = [b[1], b[2], (527612 * b[2] - 1370589 * b[0]) % M2]
        z = (a[2] - b[2]) % M1
        result.append((z or M1) / (M1 + 1))
    return np.array(result)


def test_published_sequence_of_seed_12345():
    """First numbers of RngStreams, whose default seed is six times 12345 (L'Ecuyer et al. 2002)."""
    x = np.zeros(model.STATES)
    x[:6] = 12345.0
    published = [0.1270111220, 0.3185275654, 0.3091860156, 0.8258468629, 0.2216299158]
    np.testing.assert_allclose([uniform(x) for _ in published], published, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2**31])
def test_equals_the_integer_recurrences(seed):
    x = np.zeros(model.STATES)
    x[:6] = generator_state(seed)
    expected = integer_mrg32k3a([int(word) for word in x[:6]], 5000)
    np.testing.assert_allclose([uniform(x) for _ in range(5000)], expected, rtol=1e-15)


def test_largest_words_are_exact():
    x = np.zeros(model.STATES)
    words = [0, M1 - 1, M1 - 1, 0, M2 - 1, M2 - 1, M1 - 1, 0, 1]
    for start in range(4):
        x[:6] = words[start : start + 3] + [min(word, M2 - 1) for word in words[start + 1 : start + 4]]
        expected = integer_mrg32k3a([int(word) for word in x[:6]], 20)
        np.testing.assert_allclose([uniform(x) for _ in range(20)], expected, rtol=1e-15)


def test_moments_of_uniform_and_normal_numbers():
    """Mean, variance, skewness, kurtosis and correlation within five standard errors."""
    count = 40000
    x = Sensor(SensorParameters(seed=7), 1.0).x
    u = np.array([uniform(x) for _ in range(count)])
    assert 0.0 < u.min() < u.max() < 1.0
    assert u.mean() == pytest.approx(0.5, abs=5 * np.sqrt(1 / 12 / count))
    assert u.var() == pytest.approx(1 / 12, abs=5 * np.sqrt(1 / 180 / count))
    z = np.array([normal(x) for _ in range(count)])
    assert z.mean() == pytest.approx(0.0, abs=5 / np.sqrt(count))
    assert z.var() == pytest.approx(1.0, abs=5 * np.sqrt(2 / count))
    assert (z**3).mean() == pytest.approx(0.0, abs=5 * np.sqrt(15 / count))
    assert (z**4).mean() == pytest.approx(3.0, abs=5 * np.sqrt(96 / count))
    for lag in (1, 2, 3):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(0.0, abs=5 / np.sqrt(count))


def test_noise_offset_and_resolution():
    noisy = Sensor(SensorParameters(noise=5e-9, offset=1e-7, seed=3), 1.0).simulate(np.full(20000, 2e-6))
    assert noisy.mean() == pytest.approx(2.1e-6, abs=5 * 5e-9 / np.sqrt(20000))
    assert noisy.std() == pytest.approx(5e-9, rel=0.03)
    stepped = Sensor(SensorParameters(resolution=1e-8), 1.0).simulate(np.linspace(0.0, 1e-7, 101))
    np.testing.assert_allclose(stepped / 1e-8, np.round(stepped / 1e-8), atol=1e-9)
    assert np.abs(stepped - np.linspace(0.0, 1e-7, 101)).max() <= 0.5e-8 * (1 + 1e-9)


def test_without_noise_nothing_is_drawn():
    block = Sensor(SensorParameters(seed=3), 1.0)
    before = block.state
    assert block.step(1.25e-6) == 1.25e-6
    np.testing.assert_array_equal(block.x[:8], before[:8])


def test_same_seed_same_noise_and_a_restored_state_goes_on_exactly():
    parameters = SensorParameters(noise=1e-9, seed=11)
    first, second = Sensor(parameters, 1.0), Sensor(parameters, 1.0)
    np.testing.assert_array_equal(first.simulate(np.zeros(7)), second.simulate(np.zeros(7)))
    kept = first.state
    ahead = first.simulate(np.zeros(9))
    first.state = kept
    np.testing.assert_array_equal(first.simulate(np.zeros(9)), ahead)
    other = Sensor(SensorParameters(noise=1e-9, seed=12), 1.0)
    assert not np.any(other.simulate(np.zeros(9)) == ahead)
