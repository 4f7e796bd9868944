# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Derivatives of the searches equal differences of the residuals, and what is computed together equals single calls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.identification import hammerstein
from hysteresis_ros.identification.dynamics import ModalSearch, ModalStructure, mode_columns, segment_spectra
from hysteresis_ros.identification.generalised_play import GeneralisedPlays
from hysteresis_ros.identification.hammerstein import held_out, robust_fit
from hysteresis_ros.identification.linear_systems import LinearPart, Mode
from hysteresis_ros.identification.play_fit import WeightSolver
from hysteresis_ros.identification.prandtl_ishlinskii import FreeWeights, SmoothDensity
from hysteresis_ros.identification.preprocessing import condense

STEP = 1e-3
#: Relative change of a parameter; the weights above 0 stay the same over such a step.
SMALL = 1e-6


def recording():
    """Return voltage [V] and displacement [m] of decaying loops with a bend, a lag, creep and noise."""
    t = STEP * np.arange(6000)
    voltage = 50.0 + 45.0 * np.exp(-t / 3.0) * np.sin(2.0 * np.pi * 1.5 * t + 0.7)
    fit = FreeWeights(condense(voltage, voltage, STEP), 8, 0)
    played = fit.plays @ np.linspace(1.0, 0.2, 8) + 4e-3 * voltage**2
    part = LinearPart(lag=2e-3, creep_rate=0.02, longest_time=6.0)
    noise = np.random.default_rng(3).standard_normal(len(t))
    return voltage, 1e-8 * (part.apply(played, STEP) + noise)


def data():
    """Return the recording for a fit, with some samples left out."""
    found = condense(*recording(), STEP)
    kept = found.kept.copy()
    kept[500:900] = False
    return replace(found, kept=kept, drifts=True)


PARTS = {
    "rest": LinearPart(lag=1.5e-3, delay=1.3e-3, creep_rate=0.015, longest_time=6.0),
    "settled": LinearPart(lag=1.5e-3, delay=1.3e-3, creep_rate=0.015, longest_time=6.0, settled=True),
    "mode": LinearPart(lag=1.5e-3, creep_rate=0.015, longest_time=6.0, modes=(Mode(80.0, 0.05, 0.4),), hold=STEP),
}


@pytest.mark.parametrize("name", PARTS)
def test_slopes_of_plays_equal_differences_of_the_residual(name, monkeypatch):
    """The slopes neglect that the size of the penalty follows the columns, so it is kept here."""
    monkeypatch.setattr(WeightSolver, "penalty", lambda solver, strength: 20.0 * strength * solver.roughness)
    part, shape = PARTS[name], {"rate": 1e-3, "bend": 0.1, "spread": 0.05}
    fit = GeneralisedPlays(data(), 8, tuple(shape))
    near = [(part, {**shape, key: value * (1.0 + SMALL)}) for key, value in shape.items()]
    names = ("lag", "creep_rate") if part.modes else ("lag", "delay", "creep_rate")
    near += [(replace(part, **{key: getattr(part, key) * (1.0 + SMALL)}), shape) for key in names]
    here = fit.solve(part, shape).copy()
    slopes = fit.slopes(part, shape, near)
    solved = np.column_stack([fit.solve(*point) - here for point in near])
    assert np.all(np.linalg.norm(slopes - solved, axis=0) < 2e-3 * np.linalg.norm(solved, axis=0))


def test_slopes_of_a_smooth_density_have_the_gradient_of_the_squared_residual():
    fit = SmoothDensity(data(), 10)
    fit.decay = 1.9
    part, shape = PARTS["rest"], {"elastic_share": 0.6, "map_slope": 0.1, "map_curvature": 0.05}
    near = [(part, {**shape, key: value * (1.0 + SMALL)}) for key, value in shape.items()]
    near += [(replace(part, **{key: getattr(part, key) * (1.0 + SMALL)}), shape) for key in ("lag", "creep_rate")]
    here = fit.solve(part, shape)
    slopes = fit.slopes(part, shape, near)
    frame = fit.centre, fit.span
    squares = np.array([np.sum(fit.solve(*point) ** 2) for point in near]) - np.sum(here**2)
    assert slopes.T @ here == pytest.approx(0.5 * squares, rel=1e-3)
    fit.solve(part, shape)
    assert (fit.centre, fit.span) == frame


def test_judging_a_fit_on_held_out_samples_does_not_change_it():
    fit = FreeWeights(data(), 8, 0)
    fit.behind(PARTS["rest"])
    before, weights = fit.output(), fit.weights.copy()
    errors = held_out(fit)
    assert np.array_equal(fit.weights, weights)
    assert fit.output() == pytest.approx(before, abs=1e-15)
    assert fit.reply is None
    assert np.std(errors) > np.std((fit.data.displacement - fit.output())[fit.data.first :][fit.data.kept])


def test_modes_that_are_tried_together_have_the_residuals_of_single_ones():
    voltage, displacement = recording()
    search = ModalSearch(segment_spectra(voltage, displacement, STEP, 100))
    columns = search.columns(ModalStructure(True, False), [np.log(2e-3)])
    places = np.array([[60.0], [90.0], [210.0]])
    together = mode_columns(places, np.full((3, 1), 0.05), search.f, search.T, 0.0)
    for cost, frequency, own in zip(search.costs_with(columns, together), places[:, 0], together, strict=True):
        single = mode_columns(float(frequency), 0.05, search.f, search.T, 0.0)
        assert own == pytest.approx(single, rel=1e-12)
        residual = search.solve(np.concatenate([columns, single], axis=1))[1]
        assert cost == pytest.approx(float(residual @ residual), rel=1e-9)


@pytest.mark.parametrize(
    "structure, values",
    [
        (ModalStructure(True, True), [np.log(2e-3), 0.4]),
        (ModalStructure(True, True, 1), [np.log(2e-3), 0.4, np.log(90.0), np.log(0.05)]),
        (ModalStructure(False, False, 1), [np.log(60.0), np.log(0.1)]),
        (ModalStructure(True, False, 1, series=True), [np.log(2e-3), np.log(90.0), np.log(0.05)]),
    ],
)
def test_the_slopes_of_a_modal_fit_include_the_change_of_its_coefficients(structure, values):
    voltage, displacement = recording()
    search = ModalSearch(segment_spectra(voltage, displacement, STEP, 100))
    values = np.array(values)

    def residual(place):
        return search.solve(search.columns(structure, place))[1]

    step = 3e-4 * np.eye(len(values))  # the normal equations of free numerators round smaller steps away
    central = np.column_stack([(residual(values + one) - residual(values - one)) / 6e-4 for one in step])
    slopes = search.slopes(structure, values, residual(values))
    scale = np.linalg.norm(central, axis=0)
    assert np.all(np.linalg.norm(slopes - central, axis=0) < 2e-3 * scale)


def test_a_repeated_fit_keeps_the_parts_of_the_dynamics_from_the_second_repetition_on(monkeypatch):
    voltage, displacement = recording()
    asked = []

    class Structure:
        data = condense(voltage, displacement, STEP)

    def again(before, data, settled):
        asked.append(settled)
        return before

    def repeated(fit, look, state):
        for _ in range(4):
            fit(state, None)
        raise StopIteration

    monkeypatch.setattr(hammerstein, "repeated", repeated)
    monkeypatch.setattr(hammerstein, "finished", lambda *_: None)
    with pytest.raises(StopIteration):
        robust_fit(voltage, displacement, STEP, lambda data: Structure(), again)
    assert asked == [False, True, True]
