# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The experiments of Wang, Alici & Tan 2014 give the stated results; the files equal the identification's results."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import numpy as np
import pytest
from claims_support import assert_shown

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.identification.arx import fit_arx
from hysteresis_ros.laboratory.papers import EXPERIMENTS
from hysteresis_ros.laboratory.papers.wang2014 import axis as wang
from hysteresis_ros.laboratory.papers.wang2014 import identification, model
from hysteresis_ros.laboratory.papers.wang2014 import reproduction as wang2014
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis
from hysteresis_ros.models.linear import LinearDynamics

DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs" / "wang2014.md"
SAMPLE_TIME = 0.005

#: Rows that do not hold, each with its reason in the table. A change of any row must be noticed.
NOT_HOLDING = {"w3.alpha_3.g_sign", "w3.alpha_80.g_sign", "honest.gain_5.pi"}


@pytest.fixture(scope="module")
def found():
    return wang2014.reproduce()


@pytest.fixture(scope="module")
def measured(found):
    return {claim.id: claim.measured for claim in found.claims}


def test_rows_have_unique_names_and_name_their_assumptions(found):
    names = [claim.id for claim in found.claims]
    assert len(names) == len(set(names))
    assert all(claim.assumptions for claim in found.claims)
    assert EXPERIMENTS["wang2014"] == wang2014.__name__


def test_exactly_the_known_rows_do_not_hold_and_say_why(found):
    failing = {claim.id: claim.reason for claim in found.claims if claim.holds is False}
    assert set(failing) == NOT_HOLDING
    assert all(failing.values())


@pytest.mark.parametrize("words", ["full", "half"])
@pytest.mark.parametrize("frequency", wang.FREQUENCIES)
def test_better_identifications_halve_the_error_of_the_linear_inverse(measured, words, frequency):
    for key in (wang.MINOR, wang.BETTER):
        assert measured[f"w6.{words}.{frequency}.{key}.reduction"] >= wang.REDUCTION


@pytest.mark.parametrize("frequency", wang.FREQUENCIES)
def test_the_papers_model_helps_at_the_amplitude_it_was_made_of_and_harms_at_half_of_it(measured, frequency):
    assert measured[f"w6.full.{frequency}.duhem80.reduction"] >= wang.REDUCTION
    assert measured[f"w6.full.{frequency}.duhem80.maximum"] <= wang.LARGEST_ERROR
    assert measured[f"w6.half.{frequency}.duhem80.reduction"] < 0.0


def test_the_duhem_equation_runs_along_the_branches_with_the_correct_signs_alone(measured):
    for alpha in (3, 80):
        assert measured[f"w3.alpha_{alpha}.closed_form"] < 1e-10
        assert measured[f"w3.alpha_{alpha}.g_sign"] == pytest.approx(
            2.0 * measured[f"w3.alpha_{alpha}.g_half"], rel=1e-6
        )


def test_feedback_removes_what_a_wrong_gain_leaves(measured):
    for condition in ("real", "gain_5", "loop_5", "creep"):
        for kind in ("pid", "ism"):
            assert measured[f"feedback.{condition}.{kind}"] < 0.5 * measured[f"feedback.{condition}.paper"]
    assert measured["feedback.gain_5.none"] > 5.0 * measured["feedback.gain_5.pid"]


def test_all_files_share_one_plant_and_invert_a_zero_inside_the_unit_circle():
    axes = wang.controllers()
    plants = [axis.node("plant_simulator") for axis in axes.values()]
    assert all(plant == plants[0] for plant in plants)
    assert plants[0]["hysteresis.type"] == "prandtl_ishlinskii"
    for axis in axes.values():
        linear = model.controller_dynamics(axis).state_space
        numerator = np.poly(linear.A - linear.B @ linear.C) - np.poly(linear.A)
        assert np.all(np.abs(np.roots(numerator[1:])) <= 0.98 + 1e-6)
        control = axis.node("motion_controller")
        assert (control["feedforward.type"], control["feedforward.preview"]) == ("inverse_dynamics", 1)


def test_the_models_are_not_the_plant():
    axis = load_configuration("wang2014")
    plant, compensator = axis.node("plant_simulator"), axis.node("hysteresis_compensator")
    for name in ("radii", "weights", "thresholds", "zone_weights"):
        name = f"hysteresis.prandtl_ishlinskii.{name}"
        assert len(plant[name]) != len(compensator[name])


def test_least_squares_anew_give_the_linear_model_of_the_file():
    """G1 (W1) from recordings without their first branch."""
    axis = load_configuration("wang2014_linear")
    inputs, outputs = [], []
    for frequency, (voltage, displacement) in zip(
        wang.RECORDED_CYCLES, wang.record_sines(wang.real(axis)), strict=True
    ):
        settled = round(0.25 / frequency / SAMPLE_TIME)
        inputs.append(voltage[settled:])
        outputs.append(displacement[settled:])
    found = fit_arx(inputs, outputs, SAMPLE_TIME, zero_radius=0.98)
    dynamics = model.controller_dynamics(axis)
    gain = axis.node("hysteresis_compensator")["hysteresis.proportional.gain"]
    assert found.model.dc_gain == pytest.approx(gain, rel=0.02)
    frequencies = list(wang.FREQUENCIES.values())
    fresh = replace(found.model.linear_parameters(), sample_time=SAMPLE_TIME)
    responses = [model.linear_response(item, frequencies) for item in (fresh, dynamics)]
    assert responses[0] == pytest.approx(responses[1], rel=0.01)


def test_plays_identified_anew_say_the_same_as_those_of_the_file():
    axis = load_configuration("wang2014")
    plant = wang.real(axis)
    decreasing, sweep = identification.record_decreasing(plant), identification.record_sweep(plant)
    plays, dynamics = identification.identify_plays(decreasing, sweep, SAMPLE_TIME)
    voltage = wang.record_sines(wang.ideal(axis), 0.7)[-1][0]
    passed = PrandtlIshlinskiiHysteresis(plays, SAMPLE_TIME).simulate(voltage)
    fresh = np.append(0.0, LinearDynamics(dynamics, SAMPLE_TIME).simulate(passed)[:-1])
    assert wang.rms(fresh - model.predict(axis, voltage)) < 1e-3 * np.ptp(fresh)


def test_writing_the_files_keeps_everything_but_the_identified_lines():
    text = load_configuration("wang2014").text
    changed = identification.replace_identified(text, "title", "# Controller: another\n")
    assert "# Controller: another\n" in changed
    assert changed.replace("# Controller: another\n", "") == identification.replace_identified(text, "title", "")


def test_the_document_shows_what_the_command_prints(found):
    assert_shown(found, DOCUMENT)


def test_plots_show_loops_errors_responses_residuals_and_training(found):
    pytest.importorskip("matplotlib")
    captions = [caption for caption, _ in wang2014.figures(found)]
    assert len(captions) == 7
