# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""Several inputs and outputs: response matrix with covariances, subspace method, refined modes, recovered plays."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.configuration import dump_configuration, load_configuration, parse_configuration
from hysteresis_ros.errors import ConfigurationError, HysteresisError, IdentificationError
from hysteresis_ros.identification.coupled import StructureData, StructureEstimator, identify_structure
from hysteresis_ros.identification.data import DataError
from hysteresis_ros.identification.frequency_response import FrequencyResponse, response_matrix
from hysteresis_ros.identification.linear_systems import FitError, LinearModel
from hysteresis_ros.identification.parameter_file import load_chain
from hysteresis_ros.identification.structure_fit import (
    LINEAR_GROUPS,
    Experiments,
    ModalStructure,
    _normal_equations,
    refine_in_time,
)
from hysteresis_ros.identification.subspace import modal, refine_on_response, subspace_model
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.models.structure import Structure, StructureParameters

SAMPLE_TIME = 1e-3
PERIOD = 512
#: Lines 1 … 200 of 512, to 391 Hz.
LINES = np.arange(1, 201)


def plant(order=4, seed=2) -> LinearModel:
    """Two inputs, two outputs [µm], modes of 3 % damping from 60 Hz on, a feedthrough."""
    random = np.random.default_rng(seed)
    A = np.zeros((order, order))
    for mode in range(order // 2):
        angle = 2 * np.pi * (0.06 + 0.07 * mode)
        r = np.exp(-0.03 * angle)
        A[2 * mode : 2 * mode + 2, 2 * mode : 2 * mode + 2] = r * np.array(
            [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        )
    B, C = random.standard_normal((order, 2)), 1e-6 * random.standard_normal((2, order))
    # a basis with dense matrices
    T = random.standard_normal((order, order)) + 2.0 * np.eye(order)
    return LinearModel(
        T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), 1e-7 * random.standard_normal((2, 2)), SAMPLE_TIME
    )


def multisines(realisations, periods=2, seed=0, level=1.0):
    """Full random-phase multisines, shape (R, P N, 2)."""
    random = np.random.default_rng(seed)
    spectrum = np.zeros((realisations, PERIOD // 2 + 1, 2), dtype=complex)
    spectrum[:, LINES] = np.exp(2j * np.pi * random.random((realisations, len(LINES), 2)))
    u = np.fft.irfft(spectrum, PERIOD, axis=1)
    return level * np.tile(u / u.std(), (1, periods, 1))


def steady(model, u):
    """Return the steady state of a model under periodic inputs."""
    return np.array([model.simulate(np.concatenate([one] * 4))[3 * len(one) :] for one in u])


def test_without_noise_the_matrix_is_that_of_the_plant():
    model = plant()
    u = multisines(3)
    found = response_matrix(u, steady(model, u), SAMPLE_TIME, PERIOD)
    assert found.response.response.shape == (200, 2, 2)
    np.testing.assert_allclose(found.response.frequency, LINES / (PERIOD * SAMPLE_TIME))
    truth = model.frequency_response(found.response.frequency)
    np.testing.assert_allclose(found.response.response, truth, atol=1e-9 * np.abs(truth).max())
    assert np.all(found.condition >= 1.0)


def test_bands_cover_the_truth_and_noise_is_apart_from_distortion():
    """The covariance of the sensors' correlated noise is found; a cubic output is distortion, not noise."""
    model, random = plant(), np.random.default_rng(5)
    u = multisines(8, periods=4)
    clean = steady(model, u)
    size = clean.std()
    mixing = 0.01 * size * np.array([[1.0, 0.0], [0.8, 0.6]])
    noise = random.standard_normal(clean.shape) @ mixing.T
    found = response_matrix(u, clean + noise, SAMPLE_TIME, PERIOD)
    truth = model.frequency_response(found.response.frequency)
    inside = np.abs(found.response.response - truth) <= found.response.radius(0.95)
    assert 0.92 < inside.mean() < 0.98
    # a spectrum averaged over 4 periods of 512 samples has 1/(4 · 512) of the variance of a sample
    expected = mixing @ mixing.T / (4 * PERIOD)
    for covariance in (found.noise, found.total):
        np.testing.assert_allclose(covariance.mean(axis=0).real, expected, rtol=0.15)
    cubic = clean + noise + 0.1 * size * (clean / size) ** 3
    distorted = response_matrix(u, cubic, SAMPLE_TIME, PERIOD)
    np.testing.assert_allclose(distorted.level(distorted.noise), found.level(found.noise), rtol=0.05)
    assert np.all(distorted.level(distorted.total) > 5.0 * distorted.level(distorted.noise))


def test_correlated_excitations_are_refused_with_their_condition_number():
    u = multisines(3)
    u[:, :, 1] = u[:, :, 0] * (1.0 + 1e-5 * u[:, :, 1])
    with pytest.raises(
        HysteresisError, match=r"correlated: condition number \S+ of the inputs at \S+ Hz, at most 1000"
    ):
        response_matrix(u, u, SAMPLE_TIME, PERIOD)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda u: (u[:1], u[:1], PERIOD), DataError, "1 experiments cannot separate 2 inputs"),
        (lambda u: (u, u[:2], PERIOD), DataError, "differ in realisations or samples"),
        (lambda u: (u[:, :-1], u[:, :-1], PERIOD), DataError, "not a whole number of periods of 512"),
        (lambda u: (u, u, 15), DataError, "a period of 15 samples is too short: at least 16 are needed"),
        (lambda u: (u[:, :0], u[:, :0], PERIOD), DataError, "input has no samples"),
        (lambda u: (u[0], u[0], PERIOD), DataError, r"must be \(realisations, samples, channels\)"),
        (lambda u: (u * np.where(u == u.max(), np.nan, 1.0), u, PERIOD), DataError, "input.* is not finite"),
        (lambda u: (0.0 * u, u, PERIOD), DataError, "inputs are constant"),
    ],
)
def test_experiments_that_do_not_fit_are_refused(change, error, words):
    u, y, period = change(multisines(3))
    with pytest.raises(error, match=words):
        response_matrix(u, y, SAMPLE_TIME, period)


def exact(model, frequency=None):
    frequency = LINES / (PERIOD * SAMPLE_TIME) if frequency is None else frequency
    return FrequencyResponse(frequency, model.frequency_response(frequency), SAMPLE_TIME)


def test_the_subspace_method_finds_the_poles_exactly_on_any_lines():
    model = plant(6)
    uneven = np.sort(np.random.default_rng(1).uniform(5.0, 450.0, 90))
    for frequency in (None, uneven):
        found = subspace_model(exact(model, frequency), 6)
        np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(model.poles), atol=1e-9)
        truth = model.frequency_response(uneven)
        np.testing.assert_allclose(found.frequency_response(uneven), truth, atol=1e-8 * np.abs(truth).max())


def test_one_input_and_output_give_the_entry_of_the_matrix():
    """The scalar response of a plant with one input is found in the same way, and has the poles of the matrix."""
    model = plant(4)
    data = exact(model)
    single = FrequencyResponse(data.frequency, data.response[:, :1, :1], SAMPLE_TIME)
    scalar = subspace_model(single, 4)
    np.testing.assert_allclose(np.sort_complex(scalar.poles), np.sort_complex(model.poles), atol=1e-8)
    whole = subspace_model(data, 4).frequency_response(data.frequency)[:, :1, :1]
    np.testing.assert_allclose(scalar.frequency_response(data.frequency), whole, atol=1e-8 * np.abs(whole).max())


def test_a_model_of_noise_is_stable():
    random = np.random.default_rng(3)
    noise = random.standard_normal((60, 2, 2)) + 1j * random.standard_normal((60, 2, 2))
    data = FrequencyResponse(np.linspace(5.0, 480.0, 60), noise, SAMPLE_TIME)
    model = subspace_model(data, 12)
    assert model.stable
    refined, _ = refine_on_response(model, data, steps=5, radius=0.99)
    assert np.abs(refined.poles).max() <= 0.99 + 1e-12


def test_modes_are_blocks_and_change_nothing():
    model = plant(6)
    # two real poles and the modes
    real = np.zeros((8, 8))
    real[:6, :6], real[6, 6], real[7, 7] = model.A, 0.5, -0.3
    random = np.random.default_rng(0)
    whole = replace(
        model,
        A=real,
        B=np.vstack([model.B, random.standard_normal((2, 2))]),
        C=np.hstack([model.C, 1e-6 * random.standard_normal((2, 2))]),
    )
    blocks = modal(whole)
    outside = blocks.A.copy()
    for i in range(0, 8, 2):
        outside[i : i + 2, i : i + 2] = 0.0
        assert blocks.A[i, i] == blocks.A[i + 1, i + 1]
    assert not outside.any()
    frequency = np.linspace(5.0, 450.0, 30)
    truth = whole.frequency_response(frequency)
    np.testing.assert_allclose(blocks.frequency_response(frequency), truth, atol=1e-10 * np.abs(truth).max())
    with pytest.raises(FitError, match="choose an even order"):
        modal(replace(model, A=real[:7, :7], B=whole.B[:7], C=whole.C[:, :7]))


def test_refinement_on_the_response_finds_the_plant_from_a_detuned_model():
    model = modal(plant(4))
    detuned = replace(model, A=0.995 * model.A, B=1.1 * model.B, C=0.9 * model.C)
    found, course = refine_on_response(detuned, exact(model))
    assert course.cost < 1e-12 * course.costs[0]
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(model.poles), atol=1e-6)


def hysteretic(radii=(0.2, 0.6)) -> ModalStructure:
    """The plant with plays that depend on the motion of the structure."""
    linear = ModalStructure.linear(modal(plant(4)), 1e-6)
    motion = 0.05 * np.random.default_rng(4).standard_normal((2, 4))
    return replace(
        linear,
        B_w=0.3 * linear.B,
        C_z=motion,
        gains=np.array([0.8, 1.1]),
        weights=np.array([[0.3, 0.2], [0.25, 0.35]]),
        radii=np.array(radii),
    )


def recorded(structure: ModalStructure, realisations=3, run_in=256) -> Experiments:
    """Return recordings of a structure at rising levels."""
    u = np.concatenate([multisines(1, 1, seed, 0.5 + 0.5 * seed) for seed in range(realisations)])
    u = np.concatenate([u[:, -run_in:], u], axis=1)
    empty = Experiments(u, np.empty((realisations, PERIOD, 2)), np.full(realisations, 1e-6))
    return replace(empty, y=empty.simulated(structure.parameters()))


@pytest.mark.slow
def test_sensitivities_are_derivatives_of_the_simulation():
    """Jᵀr of every parameter against central differences of the cost."""
    truth = hysteretic()
    data = recorded(truth)
    random = np.random.default_rng(9)
    names = ("sigma", "gamma", "B", "B_w", "C_z", "gains", "weights", "radii", "C", "D")
    point = replace(truth, **{name: getattr(truth, name) * 0.99 for name in names})
    shapes = {name: getattr(point, name).shape for name in names}
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    places = {name: slice(a, b) for name, a, b in zip(names, ends[:-1], ends[1:], strict=True)}
    matrix, gradient = _normal_equations(point, data, places, shapes)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    for name in names:
        for _ in range(3):
            index = tuple(random.integers(0, size) for size in shapes[name])
            step, costs = 1e-6, []
            for sign in (1.0, -1.0):
                moved = getattr(point, name).copy()
                moved[index] += sign * step
                costs.append(data.cost(replace(point, **{name: moved}).parameters()))
            slope = gradient[places[name]].reshape(shapes[name])[index]
            expected = 0.5 * (costs[0] - costs[1]) / (2.0 * step)
            assert slope == pytest.approx(expected, rel=2e-3, abs=1e-4 * np.abs(gradient).max()), (name, index)


def test_gauss_newton_finds_the_plays_of_a_structure_in_its_own_recording():
    truth = hysteretic()
    data = recorded(truth)
    start = replace(truth, gains=np.array([1.0, 1.0]), weights=0.8 * truth.weights, radii=np.array([0.25, 0.55]))
    found, course = refine_in_time(start, data, ("gains", "weights", "radii"), steps=60)
    assert course.cost < 1e-8 * course.costs[0]
    for name in ("gains", "weights", "radii"):
        np.testing.assert_allclose(getattr(found, name), getattr(truth, name), rtol=1e-3)


def test_a_wrong_sign_of_the_plays_cannot_explain_the_recording():
    """A force with the wrong sign leaves an error that the right sign does not leave."""
    truth = hysteretic()
    data = recorded(truth)
    wrong = replace(truth, B_w=-truth.B_w)
    held = refine_in_time(replace(wrong, weights=0.9 * wrong.weights), data, ("radii",), steps=10)[0]
    right = refine_in_time(replace(truth, radii=1.2 * truth.radii), data, ("radii",), steps=30)[0]
    assert data.cost(right.parameters()) < 1e-6 * data.cost(held.parameters())


def test_linear_dynamics_in_time_are_the_case_without_plays():
    truth = ModalStructure.linear(modal(plant(4)), 1e-6)
    data = recorded(truth)
    found, course = refine_in_time(
        replace(truth, sigma=0.995 * truth.sigma, C=0.9 * truth.C), data, LINEAR_GROUPS, steps=40
    )
    assert course.cost < 1e-10 * course.costs[0]
    poles, expected = (np.sort_complex(s.parameters().linear.poles) for s in (found, truth))
    np.testing.assert_allclose(poles, expected, atol=1e-5)


def test_the_best_point_of_the_held_out_realisations_is_kept():
    """With noise in the training data the search ends when the held-out error begins to rise."""
    truth = hysteretic()
    data, held = recorded(truth), recorded(truth, realisations=2)
    noisy = replace(data, y=data.y + 3e-7 * np.random.default_rng(0).standard_normal(data.y.shape))
    start = replace(truth, gains=1.2 * truth.gains)
    found, _ = refine_in_time(
        start, noisy, ("gains", "weights", "radii", "B", "C"), steps=15, held_out=held, patience=2
    )
    full, _ = refine_in_time(start, noisy, ("gains", "weights", "radii", "B", "C"), steps=15)
    assert held.cost(found.parameters()) <= held.cost(full.parameters())
    assert held.cost(found.parameters()) < held.cost(start.parameters())


def measured(structure: ModalStructure, levels=(0.5, 1.5), realisations=4, noise=2e-8) -> StructureData:
    """Return two periods in steady state of several realisations at each level, with noise of the sensors."""
    random = np.random.default_rng(8)
    u = np.concatenate([multisines(realisations, 2, 10 + seed, level) for seed, level in enumerate(levels)])
    block = Structure(structure.parameters(), SAMPLE_TIME)
    y = []
    for one in u:
        block.reset()
        for _ in range(3):
            block.simulate(one)
        y.append(block.simulate(one))
    return StructureData(u, np.array(y) + noise * random.standard_normal(u.shape), SAMPLE_TIME, PERIOD)


@pytest.fixture(scope="module")
def found_of_the_whole():
    data = measured(hysteretic())
    estimator = StructureEstimator(order=(2, 4), plays=3, hystereses=1, run_in=256, steps=15)
    return data, estimator.fit(data), replace(estimator, plays=0).fit(data)


@pytest.mark.slow
def test_one_structure_serves_all_levels_better_than_linear_dynamics(found_of_the_whole):
    data, found, linear = found_of_the_whole
    assert [len(level) for level in data.levels] == [4, 4]
    assert found.parameters.order == linear.parameters.order == 4
    held = np.array(found.figures["held_out_rmse_m"])
    assert np.all(held < 0.3 * np.array(linear.figures["held_out_rmse_m"]))
    fresh = measured(hysteretic(), levels=(0.8, 1.2), realisations=1)
    assert np.all(found.score(fresh) < 0.3 * linear.score(fresh))
    np.testing.assert_allclose(found.predict(fresh.u[0]), found.predict(fresh.u)[0])
    # noise of 20 nm in spectra of two periods
    np.testing.assert_allclose(found.figures["noise_m"], 2e-8 / np.sqrt(2.0) * np.sqrt(2 * 200 / PERIOD), rtol=0.1)


@pytest.mark.slow
def test_a_saved_structure_is_read_back_with_the_same_numbers(found_of_the_whole, tmp_path):
    _, found, _ = found_of_the_whole
    found.save(tmp_path / "structure.yaml")
    values = load_configuration(tmp_path / "structure.yaml").node("plant_simulator")
    flat = {name.removeprefix("structure."): value for name, value in values.items()}
    assert StructureParameters.from_mapping(flat).validated() == found.parameters


@pytest.mark.parametrize("call", [load_chain, AxisParameters.from_configuration])
def test_a_saved_structure_alone_is_refused_in_one_sentence(call):
    structure = {"structure.inputs": 2, "structure.A": [0.5, 0.1, -0.1, 0.5]}
    alone = parse_configuration(dump_configuration({"/**/plant_simulator": structure}), "mirror.yaml")
    with pytest.raises(ConfigurationError, match=r"mirror.yaml: is the structure of coupled axes alone.*StageColumns"):
        call(alone)


def test_inputs_that_do_not_repeat_are_refused():
    u = np.random.default_rng(1).standard_normal((4, 2 * PERIOD, 2))
    with pytest.raises(DataError, match=rf"do not repeat with a period of {PERIOD} samples: \d+ % of the samples of"):
        identify_structure(u, u, SAMPLE_TIME, PERIOD, order=2, plays=0)
    late = np.tile(u[:, :PERIOD], (1, 2, 1))
    late[:, 10 : 10 + PERIOD // 20] = 0.0  # skipped samples
    assert len(StructureData(late, late, SAMPLE_TIME, PERIOD).u) == 4


def test_levels_are_told_apart_by_the_size_of_the_input():
    u = np.concatenate([multisines(2, 1, seed, level) for seed, level in enumerate((3.0, 1.0, 1.1))])
    data = StructureData(u, u, SAMPLE_TIME, PERIOD)
    assert [level.tolist() for level in data.levels] == [[2, 3, 4, 5], [0, 1]]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"order": 5}, "order = 5: must be even numbers"),
        ({"order": ()}, "order = ()"),
        ({"plays": -1}, "plays = -1: must be ≥ 0"),
        ({"hystereses": 0}, "hystereses = 0: must be ≥ 1"),
        ({"held_out": 3}, "4 realisations of a level: 2 inputs and held_out = 3 need at least 5"),
        ({"weighting": "even"}, "weighting = 'even': must be one of distortion, absolute"),
        ({"run_in": 0}, "run_in = 0: must be ≥ 1 sample"),
        ({"orders": 4}, "orders: no such option; there are order, plays"),
    ],
)
def test_options_that_cannot_be_used_are_refused(options, words):
    u = multisines(4)
    with pytest.raises(IdentificationError, match=re.escape(words)):
        identify_structure(u, u, SAMPLE_TIME, PERIOD, **options)


def test_unknown_orders_are_refused():
    with pytest.raises(IdentificationError, match="order = 0"):
        subspace_model(exact(plant()), 0)
    with pytest.raises(IdentificationError, match="too few for a subspace model of order 200"):
        subspace_model(exact(plant()), 200)
