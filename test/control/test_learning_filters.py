# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Filters of the learned correction compared with closed forms: pure delays, two gains, and one uncertain band."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.designs.learning import SETTLED, knocked, settling
from hysteresis_ros.designs.learning_filters import (
    CHANGE,
    MARGIN,
    UNSEEN,
    Response,
    contraction,
    design_filters,
    low_pass,
)

POINTS = 2049
ANGLES = np.linspace(0.0, np.pi, POINTS)
N = 400


def test_a_low_pass_falls_by_half_at_its_cut_off():
    response = low_pass(0.1, 501)
    assert response[[0, 100, 500]] == pytest.approx([1.0, 0.5, 0.0]) and np.all(np.diff(response) <= 0.0)


@pytest.mark.parametrize("asked", [0.05, 0.2])
def test_the_bandwidth_of_a_filter_is_where_it_first_falls_by_3_db(asked):
    model = np.exp(-2j * ANGLES)
    found = design_filters("inversion", Response(model, model[np.newaxis]), N, bandwidth=asked)
    below, at = np.abs(found.responses(2.0 * np.pi * found.bandwidth * np.array([0.98, 1.0]))[0])
    assert at < np.sqrt(0.5) < below and found.bandwidth == pytest.approx(asked, rel=0.15)


@pytest.mark.parametrize("delay", [1, 3, 6])
def test_a_repetitive_filter_looks_ahead_by_the_delay_of_the_loop_no_sample_more_or_less(delay):
    """For a pure delay the lead equals this delay: G T is real at every frequency, k Q."""
    model = np.exp(-1j * delay * ANGLES)
    found = design_filters("repetitive", Response(model, model[np.newaxis]), N)
    passing, learned = found.responses(ANGLES)
    passed = np.abs(passing) > 0.1
    through = (learned * model)[passed]
    np.testing.assert_allclose(through.imag, 0.0, atol=1e-12)
    gains = through.real / passing[passed]
    np.testing.assert_allclose(gains, gains[0], rtol=1e-9)
    assert 0.3 <= gains[0] <= 0.9


@pytest.mark.parametrize(("low", "high"), [(1.0, 3.0), (0.5, 1.5)])
def test_norm_optimal_learning_weighs_what_is_not_known_of_the_plants(low, high):
    """At rest λ = 0: G = E T/(μ + E|T|² + ε²); the mean square contains the variance of the plants, (high − low)²/4."""
    flat = np.ones(POINTS, dtype=complex)
    response = Response(0.5 * (low + high) * flat, np.array([low * flat, high * flat]))
    _, learned = design_filters("norm_optimal", response, N, bandwidth=0.3).responses([0.0])
    mean, variance = 0.5 * (low + high), 0.25 * (high - low) ** 2
    expected = mean / (CHANGE + mean**2 + variance + UNSEEN**2)
    assert learned[0].real == pytest.approx(expected, rel=2e-3)
    # what the variance and the unseen part change is more than that
    assert abs(mean / (CHANGE + mean**2 + variance) / expected - 1.0) > 3e-3 or low == 1.0


def test_where_all_plants_agree_inversion_is_the_inverse():
    """An exact inverse leaves no error by which plants could be weighted."""
    for model in (np.exp(-2j * ANGLES), 2.0 * np.exp(-1j * ANGLES)):
        for plants in ([model], [model, model]):
            found = design_filters("inversion", Response(model, np.array(plants)), N)
            assert np.isfinite(found.contraction) and found.contraction <= 1.0 - MARGIN
            passing, learned = found.responses(ANGLES)
            passed = np.abs(ANGLES) < 0.5 * np.pi
            np.testing.assert_allclose((learned * model)[passed], passing[passed], atol=0.02)


def test_learning_by_inversion_leaves_out_one_band_of_doubt_and_goes_on_above_it():
    """The plants have opposite signs around a tenth of the sample rate: Q has a dip there, and is 1 on both sides."""
    place = ANGLES / (2.0 * np.pi)
    within = np.exp(-(((place - 0.1) / 0.06) ** 2))
    model = np.exp(-2j * ANGLES)
    other = model * np.exp(1j * np.pi * within)
    response = Response(model, np.array([model, other]))
    found = design_filters("inversion", response, N)
    passing, learned = found.responses(ANGLES)
    sizes = np.max(np.abs(passing - learned * response.possible), axis=0) + UNSEEN * np.abs(learned)
    assert np.max(sizes) == pytest.approx(found.contraction, rel=1e-9) and np.max(sizes) <= 1.0 - MARGIN
    middle, above = np.argmin(np.abs(place - 0.1)), np.argmin(np.abs(place - 0.25))
    assert found.bandwidth > 0.4 and abs(passing[middle]) < 0.9 and passing[above] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("late", [1, 4])
@pytest.mark.parametrize("pole", [0.5, 0.8, 0.97])
def test_how_long_a_loop_answers_a_step_and_a_wrong_sample(pole, late):
    """Step response of a lag with pole a: 1 − a^k at its k-th sample. Pulse: a^k of the peak, k samples after it."""
    z = np.exp(1j * np.linspace(0.0, np.pi, 2**14 + 1))
    lag = z**-late * (1.0 - pole) / (1.0 - pole / z)
    loop = Response(lag, lag[np.newaxis], lag, lag)
    left = np.log(SETTLED) / np.log(pole)
    # the step has settled in the sample in which less than 2 % are missing; the pulse is over one sample later
    assert settling(loop) == late + np.ceil(left) - 1 and knocked(loop) == late + np.floor(left) + 1


def test_with_a_smaller_gain_less_changes_and_without_any_nothing():
    model = np.exp(-2j * ANGLES)
    possible = np.array([0.8 * model, 1.3 * model])
    passing, learned = design_filters("inversion", Response(model, possible), N).responses(ANGLES)
    whole, half, none = (contraction(passing, learned, possible, gain) for gain in (1.0, 0.5, 0.0))
    np.testing.assert_allclose(none, 1.0, rtol=1e-12)
    # the bound is convex in the gain
    assert np.all(half <= 0.5 * (whole + none) + 1e-12)
