# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Candidates that learn: filters for each reference, evaluated from the eleventh period on, never written as best."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.comparison.candidates import LEARNERS, Candidate, controllers, learner
from hysteresis_ros.laboratory.comparison.compare import Comparison, Table, trial_around
from hysteresis_ros.laboratory.comparison.tasks import LEARNING_PERIODS, Conditions
from hysteresis_ros.loop.reach import single_axis

CONTROLLER = learner("offset-free", "norm_optimal")


@pytest.fixture(scope="module")
def rows():
    """Return the trial and rows of the configured controller without and with learning."""
    configuration = load_configuration("picma_stage")
    trial = trial_around(configuration, Conditions(draws=1, others=0, sine_frequency=4.0, sine_stroke=0.2))
    plain = Candidate("as configured", "none")
    return configuration, trial, trial.row(plain), trial.row(replace(plain, learning="norm_optimal"))


def test_what_is_learned_takes_lag_and_hysteresis_off_both_references(rows):
    *_, plain, learned = rows
    for task, result in learned.results.items():
        assert result.undelayed[0] < 0.1 * plain.results[task].undelayed[0], task
    # learning follows the undelayed reference
    assert plain.delays[0] > 5e-3 > 1e-3 > learned.delays[0]


def test_each_reference_has_filters_of_its_own_period_and_is_judged_after_ten_of_them(rows):
    _, trial, plain, learned = rows
    candidate = Candidate(CONTROLLER, "none", learning="norm_optimal")
    for task in trial.tasks:
        learning = trial.given.designed(candidate, task).motion_controller.learning
        assert learning.period == pytest.approx(1.0 / task.frequency) and learning.type == "norm_optimal"
        late = replace(task, periods=LEARNING_PERIODS)
        assert late.settling == max(10.0 / task.frequency, 2.0)
    sine = next(name for name in learned.errors if "sine" in name)
    assert plain.errors[sine][0][0] == pytest.approx(2.0, abs=6e-3)
    assert learned.errors[sine][0][0] == pytest.approx(2.5, abs=6e-3)
    assert trial.given.designed(candidate).motion_controller.learning.type == "none"


def test_one_that_does_not_contract_is_refused_with_the_reason(rows):
    _, trial, *_ = rows
    late = replace(trial, tasks=tuple(replace(task, frequency=7.3) for task in trial.tasks))
    assert "27.3973 samples" in late.row(Candidate(CONTROLLER, "none", learning="norm_optimal")).refused


def test_the_best_is_no_one_that_learns(rows):
    configuration, trial, plain, learned = rows
    tasks = tuple(plain.results)

    def best(*found):
        table = Table("", "", tasks, found, plain, ())
        return Comparison(trial.conditions, table, None, configuration).best

    plain, learned = (replace(row, marked="", better={}) for row in (plain, learned))
    assert best(learned, plain) is plain
    with pytest.raises(ConfigurationError):
        best(learned)


def test_all_who_learn_are_in_the_table():
    axis = single_axis(load_configuration("picma_stage"))
    assert {learner(*one) for one in LEARNERS} <= set(controllers(axis))
