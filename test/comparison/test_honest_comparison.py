# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""No candidate uses data of the drawn plant, and the plants deviate by the stated amount."""

from __future__ import annotations

import dataclasses
import inspect
import types
import typing

import numpy as np
import pytest

from hysteresis_ros.configuration import Configuration, load_configuration, parse_configuration
from hysteresis_ros.control.learning import LearningParameters
from hysteresis_ros.control.margins import Requirements
from hysteresis_ros.identification.parameter_file import SECTION
from hysteresis_ros.laboratory.comparison import candidates, rows, tasks
from hysteresis_ros.laboratory.comparison import rows as others
from hysteresis_ros.laboratory.comparison.candidates import known
from hysteresis_ros.laboratory.comparison.compare import drawn_around, trial_around, trial_on_other
from hysteresis_ros.laboratory.comparison.tasks import Conditions
from hysteresis_ros.laboratory.foreign import ForeignParameters
from hysteresis_ros.loop.parameters import PlantNodeParameters
from hysteresis_ros.loop.plant import Plant
from hysteresis_ros.loop.simulation import mismatched
from hysteresis_ros.recordings.dataset import Recording

OPEN = "open loop", "exact inverse"
#: A plant with a constant gain; the error that its inverse leaves is the error of the gain.
PROPORTIONAL = """
/**:
  ros__parameters:
    sample_rate: 2000.0
/**/plant_simulator:
  ros__parameters: &plant
    limits.minimum: 0.0
    limits.maximum: 100.0
    hysteresis.type: proportional
    hysteresis.proportional.gain: 1.0e-7
/**/hysteresis_compensator:
  ros__parameters:
    limits.minimum: 0.0
    limits.maximum: 100.0
    inverse.type: exact
    hysteresis.type: proportional
    hysteresis.proportional.gain: 1.0e-7
/**/motion_controller:
  ros__parameters:
    type: open_loop
"""


def proportional() -> Configuration:
    return parse_configuration(PROPORTIONAL.replace(" &plant", ""), "proportional.yaml")


def drawn_gains(conditions: Conditions) -> np.ndarray:
    """Return the factors on the gain by the documented formula: 1 + m u, with u the first uniform number."""
    seeds = range(conditions.seed, conditions.seed + conditions.draws)
    return np.array([1.0 + conditions.mismatch * np.random.default_rng(seed).uniform(-1.0, 1.0) for seed in seeds])


@pytest.mark.parametrize("mismatch", [0.01, 0.05])
def test_in_open_loop_the_error_is_what_the_gain_of_the_drawn_plant_is_off(mismatch):
    """An inverse of the drawn plant would leave no error; a gain error of 10 % would leave 10 %."""
    conditions = Conditions(mismatch=mismatch, draws=6, others=0, noise=0.0, bits=0)
    trial = trial_around(proportional(), conditions)
    (row,), task = trial.rows({OPEN}), trial.tasks[0]
    swing = np.sqrt(np.mean(task.reference(np.linspace(0.0, 1.0, 1000, endpoint=False)) ** 2))
    stroke = (task.high - task.low) / conditions.sine_stroke
    expected = np.abs(drawn_gains(conditions) - 1.0) * swing / stroke
    assert row.results[task.name].rms == pytest.approx(expected, rel=0.03, abs=2e-4)
    assert np.max(expected) > 0.3 * mismatch


def test_plants_around_the_configured_one_deviate_as_far_as_is_said():
    conditions = Conditions(draws=20)
    found = drawn_around(proportional(), conditions)
    gains = np.array([plant.between(np.full(5, 80.0))[-1, -1] for plant in found]) / 80e-7
    assert gains == pytest.approx(drawn_gains(conditions), rel=1e-4)
    assert np.max(np.abs(gains - 1.0)) > 0.9 * conditions.mismatch
    sensors = [plant.parameters.sensor for plant in found]
    assert {sensor.noise for sensor in sensors} == {conditions.noise} and len({sensor.seed for sensor in sensors}) == 20
    assert {plant.parameters.limits.bits for plant in found} == {conditions.bits}


@pytest.mark.parametrize("name", ["picma_stage", "kim2009"])
def test_what_is_known_of_an_axis_does_not_depend_on_its_plant(name):
    configuration = load_configuration(name)
    expected = known(configuration, 16, Conditions.noise)
    for seed in (1, 2):
        plant = mismatched(configuration, 0.05, seed).override("plant_simulator", sensor__noise=1e-7, sensor__seed=seed)
        assert known(plant, 16, Conditions.noise) == expected
    trial = trial_around(configuration, Conditions(draws=2))
    assert trial.given == expected
    axis = expected.axis
    assert axis.plant_simulator.hysteresis == axis.hysteresis_compensator.hysteresis
    assert axis.plant_simulator.dynamics == axis.motion_controller.model.dynamics


def test_candidates_run_with_what_is_known_on_every_plant(monkeypatch):
    """Except for the plant, all runs of a row are the same and as its design states."""
    seen = []
    before = rows.Axis

    def axis(parameters, plant):
        seen.append((parameters, plant))
        return before(parameters, plant)

    monkeypatch.setattr(rows, "Axis", axis)
    trial = trial_around(load_configuration("picma_stage"), Conditions(draws=3))
    trial.rows({("feedforward", "exact inverse with creep")})
    assert len(seen) == 6 and len({id(plant) for _, plant in seen}) == 6
    for parameters, plant in seen:
        believed = trial.given.axis
        assert parameters.hysteresis_compensator.hysteresis == believed.hysteresis_compensator.hysteresis
        assert parameters.hysteresis_compensator.creep == believed.hysteresis_compensator.creep
        assert parameters.motion_controller.model == believed.motion_controller.model
        assert plant.parameters.hysteresis != believed.hysteresis_compensator.hysteresis


def reachable_types(annotation, found: set) -> set:
    """Return all classes of this package that values of an annotation may have, including those of fields."""
    for item in typing.get_args(annotation):
        reachable_types(item, found)
    if not isinstance(annotation, type) or isinstance(annotation, types.GenericAlias) or annotation in found:
        return found
    if annotation.__module__.startswith("hysteresis_ros"):
        found.add(annotation)
        if dataclasses.is_dataclass(annotation):
            for hint in typing.get_type_hints(annotation).values():
                reachable_types(hint, found)
    return found


@pytest.mark.parametrize(
    "function", [candidates.candidates, candidates.known, others.identified, candidates.Known, candidates.Given]
)
def test_no_design_can_be_handed_a_plant(function):
    hints = typing.get_type_hints(function)
    given = [hint for name, hint in hints.items() if name != "return"]
    found = set().union(*(reachable_types(hint, set()) for hint in given))
    forbidden = (tasks.DrawnPlant, ForeignParameters, Plant)
    assert not [kind for kind in found if issubclass(kind, forbidden)]
    names = set(inspect.signature(function).parameters)
    assert names - {"only", "tasks"} <= set(hints), "arguments without a type cannot be checked"


def test_what_is_identified_follows_from_recording_and_bench_alone():
    assert typing.get_type_hints(others.identified) == {
        "recording": Recording,
        "bench": others.Bench,
        "return": candidates.Known,
    }
    assert set(typing.get_type_hints(others.Bench)) == {"sample_rate", "voltage", "bits", "noise", "resolution"}
    assert issubclass(tasks.ForeignPlant, tasks.DrawnPlant) and PlantNodeParameters in reachable_types(
        tasks.ForeignPlant, set()
    )


def test_a_foreign_plant_is_recorded_as_it_is_before_it_deviates(monkeypatch):
    """Models and references of a trial come from the recording; the corners are applied after it."""
    bench, taken = others.Bench(), []
    monkeypatch.setattr(
        "hysteresis_ros.laboratory.comparison.compare.recorded",
        lambda plant, bench, seed: taken.append((plant, seed)) or "recording",
    )
    axis = known(proportional(), 16)
    monkeypatch.setattr(
        "hysteresis_ros.laboratory.comparison.compare.identified",
        lambda recording, bench: taken.append(recording) or axis,
    )
    trial = trial_on_other(5, Conditions(mismatch=0.05))
    plant = others.drawn(5, bench)
    assert taken == [(plant, 5), "recording"]
    assert trial.given is axis and trial.plants == tuple(others.around(plant, 0.05, 5))
    # the model reaches 0 … 10 µm; plants with an error of 5 % still have to reach the reference
    assert trial.stroke == pytest.approx(9.5e-6, rel=1e-3)


def test_references_on_a_foreign_plant_need_no_creep_of_the_model(monkeypatch):
    """The model creeps beyond 10 µm at 100 V, but a reference beyond it is refused without an inverse of the creep."""
    creep = {"creep.type": "logarithmic", "creep.logarithmic.rate": 0.05, "creep.logarithmic.reference_time": 1e-3}
    axis = known(proportional().override("hysteresis_compensator", **creep), 16)
    monkeypatch.setattr("hysteresis_ros.laboratory.comparison.compare.recorded", lambda *_: None)
    monkeypatch.setattr("hysteresis_ros.laboratory.comparison.compare.identified", lambda *_: axis)
    conditions = Conditions(mismatch=0.0)
    trial = trial_on_other(5, conditions)
    assert 9e-6 < trial.stroke <= 10e-6 * (1.0 + 1e-9)
    assert not trial.rows({("integral + static feedforward", "none")})[0].refused


def test_learning_is_designed_for_the_noise_and_the_identified_uncertainty(monkeypatch):
    taken = []

    def designed(axis, request, response):
        taken.append((axis.plant_simulator.sensor.noise, response))
        return types.SimpleNamespace(parameters=LearningParameters())

    monkeypatch.setattr(candidates, "design_learning", designed)
    section = {"response.frequencies": [1.0, 50.0], "response.uncertainty": [0.1, 0.6]}
    configuration = load_configuration("picma_stage")
    configuration = dataclasses.replace(configuration, entries=((SECTION, section), *configuration.entries))
    task = tasks.make_tasks(Conditions(), (0.0, 4e-5))[0]
    axis = known(configuration, 16, 7e-9).designed(candidates.Candidate("", "none", learning="inversion"), task)
    ((noise, response),) = taken
    assert noise == 7e-9 and response.at([50.0])[0] == 0.6
    assert axis.plant_simulator.sensor.noise == 0.0


def test_a_loop_that_does_not_bear_the_mismatch_is_marked_before_it_runs(monkeypatch):
    """M_s is near 2 on its model; with 1.5 times the gain and slower times the loop violates the requirement."""
    monkeypatch.setattr(candidates, "MISMATCHED", Requirements(2.3, 0.0, 0.0))
    given = known(load_configuration("picma_stage"), 16)
    controller = candidates.Candidate("PID", "none", {"type": "pid", "pid.Kp": 0.0, "pid.Ki": 90.0, "pid.Kd": 0.0})
    said = [candidates._with_margins(given, controller, mismatch).marked for mismatch in (0.0, 0.01, 0.5)]
    assert said[:2] == ["", ""] and "above 2.3 on a plant with gain +50 %, times" in said[2]
    still = candidates.Candidate("open loop", "none", {"type": "open_loop"})
    assert candidates._with_margins(given, still, 0.5).marked == ""
