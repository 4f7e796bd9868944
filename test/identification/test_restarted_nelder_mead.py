# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Nelder-Mead and the static Bouc-Wen fit of paper B (B3)."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.bouc_wen import PUBLISHED_GUESS, STATIC_FREE, identify_bouc_wen_static
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings, restarted_nelder_mead
from hysteresis_ros.laboratory.papers.auwal2017.model import PUBLISHED_BOUC_WEN, paper_b
from hysteresis_ros.laboratory.papers.runs import triangles
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis, BoucWenParameters


def rosenbrock(x):
    return (1.0 - x[0]) ** 2 + 100.0 * (x[1] - x[0] ** 2) ** 2


def test_rosenbrock_with_its_trajectory():
    result = restarted_nelder_mead(rosenbrock, [-1.2, 1.0])
    np.testing.assert_allclose(result.x, [1.0, 1.0], atol=1e-5)
    run = result.runs[0]
    assert result.converged and run.converged
    np.testing.assert_array_equal(run.trajectory[0], [-1.2, 1.0])
    assert run.trajectory.shape == (run.iterations + 1, 2)
    assert np.all(np.diff(run.costs) <= 0.0)


def test_scales_make_units_irrelevant():
    plain = restarted_nelder_mead(rosenbrock, [-1.2, 1.0])
    scaled = restarted_nelder_mead(lambda x: rosenbrock(x * [1e6, 1e-3]), [-1.2e-6, 1.0e3])
    np.testing.assert_allclose(scaled.x * [1e6, 1e-3], plain.x, rtol=1e-6)


def test_several_starts_find_the_lower_minimum():
    def two_valleys(x):
        return min((x[0] - 3.0) ** 2 + 1.0, 4.0 * (x[0] - 1.0) ** 2)

    assert restarted_nelder_mead(two_valleys, [3.5]).cost == pytest.approx(1.0)
    many = restarted_nelder_mead(two_valleys, [3.5], settings=SimplexSettings(starts=12))
    assert many.cost == pytest.approx(0.0, abs=1e-9) and 1 <= many.agreeing < 12
    np.testing.assert_array_equal(
        many.x, restarted_nelder_mead(two_valleys, [3.5], settings=SimplexSettings(starts=12)).x
    )


def test_budget_spent_is_said_and_the_best_point_kept():
    seen = []
    result = restarted_nelder_mead(
        rosenbrock, [-1.2, 1.0], settings=SimplexSettings(iterations=10), progress=lambda *state: seen.append(state)
    )
    assert not result.converged
    assert result.cost == rosenbrock(result.x) < rosenbrock([-1.2, 1.0])
    assert seen[-1] == (0, 10, result.cost)


def test_useless_starts_are_refused():
    with pytest.raises(IdentificationError, match="zeros need a scale"):
        restarted_nelder_mead(rosenbrock, [0.0, 1.0])
    with pytest.raises(IdentificationError, match="not finite at any start"):
        restarted_nelder_mead(lambda x: np.nan, [1.0])


@pytest.mark.parametrize("seed", range(3))
def test_paper_b_all_four_within_one_percent(seed):
    """400 samples with 10 nm noise, from the paper's initial guess; β + γ < 0 is reported."""
    found = paper_b(seed=seed)
    assert max(abs(error) for error in found.errors.values()) < 0.01, found.errors
    assert found.model.converged
    assert any("outside the bounded class" in warning for warning in found.model.warnings)
    assert found.model.rms == pytest.approx(10e-9, rel=0.15)
    trajectory = found.model.search.runs[0].trajectory
    np.testing.assert_allclose(trajectory[0], [getattr(PUBLISHED_GUESS, name) for name in STATIC_FREE])
    for name, error in found.errors.items():
        assert abs(error * getattr(PUBLISHED_BOUC_WEN, name)) < 4.5 * found.model.standard_errors[name]


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_a_bounded_element_without_a_guess(exponent):
    """In other units and from the ranges alone; the sensor's offset is removed."""
    saturation = 0.8e-6 ** (1.0 - exponent)
    truth = BoucWenParameters(1.2e-7, 2e-8, 0.02 * saturation, 0.008 * saturation, exponent)
    voltage = triangles([60.0, 100.0, 40.0], 60)
    x = BoucWenHysteresis(truth, 1.0).simulate(voltage)
    result = identify_bouc_wen_static(voltage, x + 2e-6, exponent=exponent, free_offset=True)
    for name in STATIC_FREE:
        assert getattr(result.parameters, name) == pytest.approx(getattr(truth, name), rel=1e-3), name
    assert result.offset == pytest.approx(2e-6, rel=1e-3)
    assert result.converged and result.warnings == truth.warnings()


def test_bad_recordings_are_refused_and_budgets_reported():
    voltage = triangles([100.0], 60)
    x = BoucWenHysteresis(PUBLISHED_BOUC_WEN, 1.0).simulate(voltage)
    with pytest.raises(IdentificationError, match="rising branch.*Bouc-Wen"):
        identify_bouc_wen_static(voltage[:61], x[:61])
    with pytest.raises(IdentificationError, match="falls with rising voltage"):
        identify_bouc_wen_static(voltage, -x)
    short = identify_bouc_wen_static(voltage, x, guess=PUBLISHED_GUESS, settings=SimplexSettings(iterations=20))
    assert not short.converged and any("not converged after 20" in warning for warning in short.warnings)


@pytest.mark.slow
def test_starts_shared_by_processes_take_the_same_paths():
    here, there = (
        restarted_nelder_mead(np.linalg.norm, [1.0, -2.0], settings=SimplexSettings(starts=3, workers=workers))
        for workers in (1, 2)
    )
    assert there.x.tobytes() == here.x.tobytes() and there.best == here.best
    assert [run.trajectory.tobytes() for run in there.runs] == [run.trajectory.tobytes() for run in here.runs]
