# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The contract of registered models: every hysteresis model follows its declaration, whatever package it is from."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import hysteresis_ros
from hysteresis_ros.configuration import dump_configuration, parse_configuration
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.parameter_file import example_text
from hysteresis_ros.identification.plant_model import Estimator, IdentifiedModel
from hysteresis_ros.identification.prediction import predict
from hysteresis_ros.identification.preprocessing import automatic_skip
from hysteresis_ros.identification.registry import identify
from hysteresis_ros.identification.workflow import HysteresisEstimator, validate
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import mismatched, simulate
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.compensator import Compensator, CompensatorParameters
from hysteresis_ros.models.declaration import PARAMETRIC, Deviation
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters, hysteresis_block
from hysteresis_ros.models.inverses import BROUGHT, NAMES, InverseParameters
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.registry import resolved

ROOT = pathlib.Path(__file__).resolve().parents[1]
#: Highest voltage of the examples [V], and sample time of the simulations here [s].
VOLTAGE, T = 100.0, 1e-3

models = pytest.mark.parametrize("model", MODELS.values(), ids=list(MODELS))


def example(model) -> HysteresisParameters:
    return HysteresisParameters(type=model.name, **{model.name: model.example})


def ramps(turns, points: int) -> np.ndarray:
    """Voltages from 0 V to one turning point after the other, with a number of steps each."""
    turns = [0.0, *turns]
    return np.concatenate([np.linspace(a, b, points + 1)[1:] for a, b in zip(turns, turns[1:], strict=False)])


#: A voltage with nested reversals, and growing loops as an identification needs.
WAVE = ramps([40.0, 15.0, 100.0, 30.0, 70.0, 50.0, 95.0, 0.0, 80.0], 25)
TURNS = [
    25.0,
    0.0,
    50.0,
    0.0,
    75.0,
    0.0,
    100.0,
    0.0,
    85.0,
    15.0,
    70.0,
    30.0,
    55.0,
    0.0,
    100.0,
    0.0,
    60.0,
    20.0,
    100.0,
    0.0,
]
LOOPS = ramps(TURNS, 50)


def output(parameters: HysteresisParameters, wave=WAVE) -> np.ndarray:
    return hysteresis_block(parameters, T).simulate(wave)


def stroke(model) -> float:
    return float(np.ptp(output(example(model))))


@models
def test_a_model_says_what_it_is_and_names_only_what_there_is(model):
    assert model.name == model.name.lower() and model.title and model.data
    assert MODELS[model.name] is model and HysteresisParameters(type=model.name).model is model
    assert model.inverses and set(model.inverses) <= set(NAMES)
    assert {BROUGHT[name].model for name in model.own_inverses} <= {model.name}
    assert callable(resolved(model.identify))
    rows = {row.name: row for row in model.rows()}
    assert all(row.description for row in rows.values())
    assert all(rows[name].type is float for name in model.free)
    assert {option.kind for option in model.options.values()} <= {int, float, str}


@models
def test_its_parameters_are_valid_and_come_back_from_yaml_as_they_were(model):
    parameters = example(model).validated()
    text = dump_configuration({"/**/plant_simulator": parameters.to_mapping()})
    assert HysteresisParameters.from_mapping(parse_configuration(text, "test").node("plant_simulator")) == parameters


@models
def test_its_parameters_are_in_the_documentation(model):
    if hysteresis_ros.__name__ != model.block.__module__.split(".")[0]:
        pytest.skip("a model of another package is documented there")
    text = (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
    missing = [row.name for row in model.rows() if f"`hysteresis.{model.name}.{row.name}`" not in text]
    assert not missing, "replace the tables of docs/parameters.md by what `hysteresis parameters` prints"


@models
def test_its_block_keeps_the_contract_of_blocks(model):
    block = hysteresis_block(example(model), T)
    first = block.simulate(WAVE)
    assert np.all(np.isfinite(first)) and stroke(model) > 0.0
    assert 0.3 * stroke(model) < block.gain * VOLTAGE < 3.0 * stroke(model)
    kept = block.state
    ahead = block.simulate(WAVE)
    block.state = kept
    assert [block.step(u) for u in WAVE] == ahead.tolist(), "step and simulate differ, or the state is incomplete"
    block.reset()
    assert block.simulate(WAVE).tolist() == first.tolist()
    if len(block.x) > 1:
        held, x = block.step(float("nan")), block.state
        assert held == first[-1] and np.all(np.isfinite(x)), "NaN must not change the state"


INTERPRETED = """
import sys
from dataclasses import replace
import numpy as np
from hysteresis_ros.models.hysteresis import MODELS
wave = np.load(sys.argv[1])
np.savez(sys.argv[2], **{name: model.block(model.example, 1e-3).simulate(wave) for name, model in MODELS.items()})
"""


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory):
    """Outputs of all models from kernels that run as plain Python."""
    folder = tmp_path_factory.mktemp("interpreted")
    np.save(folder / "wave.npy", WAVE)
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", INTERPRETED, folder / "wave.npy", folder / "y.npz"]
    subprocess.run(command, check=True, env=environment, timeout=300)
    return np.load(folder / "y.npz")


@pytest.mark.slow
@models
@pytest.mark.skipif(not COMPILED, reason="kernels are interpreted already")
def test_compiled_and_as_plain_python_it_is_the_same(model, interpreted):
    assert output(example(model)) == pytest.approx(interpreted[model.name], rel=0.0, abs=1e-12 * stroke(model))


@models
def test_new_parameters_do_not_move_the_output(model):
    block = hysteresis_block(example(model), T)
    before = block.simulate(WAVE)[-1]
    block.retune(model.scaled(model.example, 1.05))
    assert np.all(np.isfinite(block.simulate(WAVE)))
    block.reset()
    if model.block.invertible and len(block.x) > 1:
        block.retune(model.example)
        block.simulate(WAVE)
        block.retune(model.scaled(model.example, 1.05))
        # at rest, thresholds widened by the speed become narrow again
        narrowed = 0.0 if model.block.rate_independent else 5e-3 * stroke(model)
        assert abs(block.step(WAVE[-1]) - before) <= narrowed
        assert abs(block.step(WAVE[-1] + 1e-6) - before) < 1e-3 * stroke(model) + narrowed


@models
def test_it_is_rate_independent_or_not_as_it_says(model):
    turns = [60.0, 20.0, 100.0, 5.0, 45.0]
    coarse, fine = (output(example(model), ramps(turns, points))[points - 1 :: points] for points in (25, 400))
    difference = np.max(np.abs(coarse - fine)) / stroke(model)
    if model.block.rate_independent:
        assert difference < 1e-6
    else:
        assert difference > 1e-6
    if not model.block.invertible:
        assert callable(resolved(model.response))


@models
def test_it_rises_with_the_voltage_and_lags_behind_it(model):
    """Otherwise no inverse is unique; a loop in the opposite direction would lead."""
    points = 50 if model.block.rate_independent else 2000
    y = output(example(model), ramps([VOLTAGE, 0.0, VOLTAGE, 0.0], points))[points :: points // 50]
    falling, rising, again = y[:50], y[50:100], y[100:]
    assert np.all(np.diff(falling) < 0.0) and np.all(np.diff(rising) > 0.0) and np.all(np.diff(again) < 0.0)
    opening = (again[24] - rising[24]) / stroke(model)
    if len(hysteresis_block(example(model), T).x) > 1:
        assert 0.01 < opening < 0.5


@models
@pytest.mark.parametrize("factor", [2.0, 0.3])
def test_scaled_it_moves_so_many_times_as_far(model, factor):
    given = example(model).shifted(0.2 * stroke(model))
    scaled = given.scaled(factor).validated()
    error = output(scaled) - factor * output(given)
    assert np.max(np.abs(error)) < 1e-12 * factor * stroke(model)
    assert hysteresis_block(scaled, T).gain == pytest.approx(factor * hysteresis_block(given, T).gain)


@models
def test_shifted_it_moves_from_another_point(model):
    offset = 0.37 * stroke(model)
    shifted = example(model).shifted(offset)
    if model.shifted is None:
        assert shifted is not None and shifted == example(model)
        return
    error = output(shifted.validated()) - output(example(model)) - offset
    assert np.max(np.abs(error)) < 1e-12 * stroke(model)


def deviation(size: float, seed: int) -> Deviation:
    random = np.random.default_rng(seed)

    def factor(count=None):
        return 1.0 + size * random.uniform(-1.0, 1.0, count)

    return Deviation(factor(), factor(), factor)


@models
def test_a_plant_that_deviates_by_nothing_is_the_model(model):
    same = model.deviated(model.example, deviation(0.0, 1)).validated()
    error = output(example(model).changed(same)) - output(example(model))
    assert np.max(np.abs(error)) < 1e-12 * stroke(model)


@models
def test_a_plant_that_deviates_is_valid_and_differs_by_about_the_size_given(model):
    size, differences = 0.1, []
    for seed in range(12):
        drawn = model.deviated(model.example, deviation(size, seed)).validated()
        again = model.deviated(model.example, deviation(size, seed))
        assert drawn == again, "equal seeds must give equal plants"
        error = output(example(model).changed(drawn)) - output(example(model))
        differences.append(np.max(np.abs(error)) / stroke(model))
    assert all(0.0 < difference < 5.0 * size for difference in differences)
    assert 0.2 * size < np.mean(differences) < 2.0 * size
    for seed in range(5):
        model.deviated(model.example, deviation(0.5, seed)).validated()


def inverses() -> list:
    """Return every model with each of its inverses that finds the voltage of its own state."""
    following = {name for name, brought in BROUGHT.items() if brought.inverse.follows_model} | {"exact", "general"}
    pairs = [(model, name) for model in MODELS.values() for name in model.inverses if name in following]
    return [pytest.param(model, name, id=f"{model.name}-{name}") for model, name in pairs]


def compensator(model, inverse: str) -> Compensator:
    limits = LimitsParameters(minimum=-0.3 * VOLTAGE, maximum=1.3 * VOLTAGE)
    parameters = CompensatorParameters(
        inverse=InverseParameters(type=inverse), hysteresis=example(model), limits=limits
    )
    return Compensator(parameters, T)


@pytest.mark.parametrize(("model", "inverse"), inverses())
def test_its_inverses_find_the_voltage_that_makes_a_displacement(model, inverse):
    reached = output(example(model))
    block, plant = compensator(model, inverse), hysteresis_block(example(model), T)
    commands = np.concatenate([reached, reached[::-1]])
    found = np.array([block.step(command) for command in commands])
    assert np.max(np.abs(plant.simulate(found) - commands)) < 1e-9 * stroke(model)
    assert np.max(np.abs(found[: len(WAVE)] - WAVE)) < 1e-6 * VOLTAGE


@models
def test_the_inverses_it_names_fit_and_a_closed_form_is_offered(model):
    fitting = {
        name
        for name in NAMES
        if not list(InverseParameters(type=name).fits(example(model)))
        and (name not in BROUGHT or BROUGHT[name].model == model.name)
    }
    assert set(model.inverses) <= fitting
    if model.block.invertible and model.block.inverse is not None:
        assert "exact" in model.inverses
    if not model.block.invertible:
        assert model.inverses == ("none",)


@models
def test_its_example_is_an_axis_that_runs_and_whose_plant_may_deviate(model):
    configuration = parse_configuration(example_text(model), "example")
    axis = single_axis(configuration)
    assert axis.plant_simulator.hysteresis == axis.hysteresis_compensator.hysteresis == example(model)
    run = simulate(axis, duration=0.5, describe=False)
    assert np.all(np.isfinite(run.signals["displacement"])) and np.ptp(run.signals["displacement"]) > 0.0
    drawn = single_axis(mismatched(configuration, 0.1, 3))
    assert drawn.plant_simulator.hysteresis != example(model)
    assert drawn.hysteresis_compensator.hysteresis == example(model)
    assert single_axis(mismatched(configuration, 0.0, 3)).plant_simulator.hysteresis.type == model.name


def recording(model) -> IdentificationData:
    """Return the example's response to loops, or to a multisine across its resonance."""
    if model.block.invertible:
        return measured(LOOPS, output(example(model), LOOPS))
    random, lines = np.random.default_rng(2), np.arange(1, 160)
    time = np.arange(2000) * T
    phases = random.uniform(0.0, 2.0 * np.pi, lines.size)
    voltage = np.sum(np.sin(2.0 * np.pi * lines[:, None] * 2.5 * time + phases[:, None]), axis=0)
    response = resolved(model.response)
    return measured(voltage, response(model.example, voltage, T, "zoh", "zero"))


def measured(voltage, displacement) -> IdentificationData:
    return IdentificationData(np.arange(len(voltage)) * T, voltage, displacement)


@pytest.mark.slow
@models
def test_what_an_estimator_finds_predicts_is_judged_and_becomes_an_axis(model, tmp_path):
    data = replace(recording(model), source="loops")
    options = {"trials": 4} if "trials" in model.options else {}
    estimator = HysteresisEstimator(model.name, linear="none", options=options)
    assert isinstance(estimator, Estimator)
    found = estimator.fit(data)
    assert isinstance(found, IdentifiedModel)
    predicted = found.predict(data.input, measured=data.output)
    np.testing.assert_array_equal(predicted, found.predicted - found.identification.drift * data.time)
    score = found.score(data)
    assert score.figures["rmse_m"] < 0.01 * data.stroke
    axis = single_axis(found.to_axis())
    assert axis.plant_simulator.hysteresis.type == model.name
    # the same as with the file
    found.save(tmp_path / "axis.yaml")
    filed = validate(tmp_path / "axis.yaml", data)
    assert filed.figures["rmse_m"] == pytest.approx(score.figures["rmse_m"], rel=1e-6)
    assert filed.figures["identified_from"] == score.figures["identified_from"] == data.source


@pytest.mark.slow
@models
def test_fitted_to_its_own_data_it_predicts_them(model):
    data = recording(model)
    options = {"trials": 4} if "trials" in model.options else {}
    found = identify(data, model.name, linear="none", options=options)
    assert found.model == model.name and found.chain.hysteresis.type == model.name
    predicted = predict(found.chain, data.input, data.sample_time, measured=data.output)
    # a model may start from another history than the example's; once this is erased, it has no effect
    first = automatic_skip(data) if model.block.invertible else 0
    assert np.std((predicted - data.output)[first:]) < 0.01 * np.ptp(data.output)
    if model.identify == PARAMETRIC:
        for name in model.free:
            assert getattr(found.chain.hysteresis.chosen, name) == pytest.approx(getattr(model.example, name), rel=0.02)
