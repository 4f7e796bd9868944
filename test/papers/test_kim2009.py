# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The experiments of Kim, Kim & Park 2009 give the stated results; rows under realistic conditions show the limits."""

from __future__ import annotations

import json
import pathlib

import numpy as np
import pytest
from claims_support import assert_shown
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.laboratory.papers.claims import format_claims
from hysteresis_ros.laboratory.papers.kim2009 import axis as kim
from hysteresis_ros.laboratory.papers.kim2009 import reproduction as kim2009
from hysteresis_ros.laboratory.papers.kim2009 import tracking

DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs" / "kim2009.md"

#: Rows that do not hold, each with its reason in the table. A change of any row must be noticed.
NOT_HOLDING = {
    "b.dynamics.exact",
    "honest.b.opening",
    "honest.d.level_error",
    "estimating.c.settling",
    "honest.estimating.c.settling",
    "honest.estimating.d.settling",
    "honest.limits_positive.error",
    "honest.limits_positive.estimated",
    "honest.limits_low.error",
    "honest.limits_low.estimated",
    "honest.limits_low.residual",
    "honest.off_1.error",
    "honest.coarse.error",
    "honest.coarse.estimated",
    "honest.creep.settling",
    "honest.creep.error",
}


@pytest.fixture(scope="module")
def found():
    return kim2009.reproduce()


@pytest.fixture(scope="module")
def measured(found):
    return {claim.id: claim.measured for claim in found.claims}


def test_rows_have_unique_names_and_name_their_assumptions(found):
    names = [claim.id for claim in found.claims]
    assert len(names) == len(set(names))
    assert all(claim.assumptions for claim in found.claims)


def test_exactly_the_known_rows_do_not_hold_and_say_why(found):
    failing = {claim.id: claim.reason for claim in found.claims if claim.holds is False}
    assert set(failing) == NOT_HOLDING
    assert all(failing.values())


def test_every_claim_of_the_paper_at_perfect_knowledge_holds(found):
    """Except for the 2 Hz triangle with the lag of the dynamics, which no inverse of hysteresis removes."""
    groups = ("model", "identification", "a", "b", "c", "d", "preload")
    own = [claim for claim in found.claims if claim.id.split(".")[0] in groups]
    assert [claim.id for claim in own if claim.holds is False] == ["b.dynamics.exact"]


def test_published_gains_follow_within_their_printed_digits(measured):
    assert max(measured[f"model.{name}"] for name in ("linear_gain", "observer_gain", "poles")) <= 2e-4


def test_exact_inverse_closes_the_loop_of_the_element_and_leaves_the_linear_lag(measured):
    assert measured["b.exact"] < 1e-9
    assert measured["b.dynamics.exact"] == pytest.approx(measured["b.dynamics.linear"], rel=1e-6)


def test_running_picard_steps_close_the_loop_further_the_more_there_are(measured):
    for rate in (100, 112):
        widths = [measured["b.none"], *(measured[f"b.rate_{rate}.picard_{steps}"] for steps in (1, 3, 6))]
        assert widths == sorted(widths, reverse=True)


def test_a_preload_shifts_the_loop_and_leaves_its_shape(measured):
    assert measured["preload.offset"] == pytest.approx(-kim.PRELOAD / kim.STIFFNESS, rel=1e-9)
    assert measured["preload.loop"] < 1e-9


def test_a_gain_that_is_off_leaves_a_level_error_which_the_estimated_disturbance_removes(measured):
    step = kim.DC_GAIN * kim.STEP
    assert 0.5 * kim.MISMATCH * step < measured["honest.d.level_error"] < 1.1 * kim.MISMATCH * step
    assert measured["honest.estimating.d.level_error"] < 0.02 * measured["honest.d.level_error"]
    assert measured["honest.estimating.d.residual"] < kim.NOISE


def test_only_a_wrong_opening_opens_the_loop_again(measured):
    assert measured["honest.b.exact"] < 0.005
    assert measured["honest.b.opening"] == pytest.approx(kim.MISMATCH * measured["b.none"], rel=0.2)


def test_identification_meets_the_papers_error_order_and_resonance(measured):
    assert measured["identification.model_error"] <= 0.125e-6
    assert measured["identification.order"] == 3
    assert measured["identification.resonance"] == pytest.approx(635.0, abs=0.5)
    assert measured["identification.preload"] == pytest.approx(kim.PRELOAD, rel=1e-3)


def test_without_negative_voltage_the_residual_of_the_falling_branch_stays(measured):
    """The lower corner of the loop to 20 V is at 20 V · 0.0125 µm/V."""
    assert measured["honest.limits_positive.error"] == pytest.approx(0.25e-6, rel=1e-3)
    assert measured["honest.limits_positive.estimated"] == pytest.approx(0.25e-6, rel=1e-3)


def test_a_limit_below_the_step_costs_what_it_does_not_reach_and_winds_nothing_up(measured):
    missing = kim.DC_GAIN * kim.STEP * (1.0 - tracking.LOW_LIMIT / (kim.AMPLIFIER * kim.STEP))
    assert measured["honest.limits_low.error"] == pytest.approx(missing, rel=1e-3)
    # the compensator's memory contains a peak of 20 V; the corner of the loop moves by 0.0125 µm per volt of the peak
    assert measured["honest.limits_low.residual"] == pytest.approx(0.0125e-6 * (20.0 - tracking.LOW_LIMIT), rel=0.05)
    assert measured["honest.limits_low.residual_estimated"] < 1e-9


def test_creep_that_nobody_knows_is_left_by_the_law_and_removed_by_estimator_or_inverse(measured):
    assert measured["honest.creep.error"] > kim.GOOD_RESIDUAL
    assert max(measured["honest.creep.estimated"], measured["honest.creep_known.error"]) < 1e-9


@pytest.mark.parametrize("mismatch", [-0.05, 0.01])
def test_another_structure_moves_the_resonance_and_keeps_damping_and_real_pole(mismatch):
    axis = load_configuration("kim2009")

    def modes(configuration):
        poles = np.linalg.eigvals(np.reshape(configuration.node("plant_simulator")["dynamics.A"], (3, 3)))
        return np.sort_complex(np.log(poles.astype(complex)))

    before, after = modes(axis), modes(tracking.other_structure(axis, mismatch))
    pair = np.abs(before.imag) < 3.0
    assert after[pair] == pytest.approx((1.0 + mismatch) * before[pair])
    assert after[~pair] == pytest.approx(before[~pair])


def test_conditions_change_the_compensator_and_never_the_plant():
    """The plant always differs from the model: a mismatch changes only one of them."""
    axis = load_configuration("kim2009")
    start = "hysteresis.polynomial."
    before = {name: value for name, value in axis.node("plant_simulator").items() if name.startswith(start)}
    for change in (kim.real, kim.real_opening):
        off = change(axis, kim.MISMATCH)
        after = {name: off.node("plant_simulator").get(name) for name in before}
        model = {name: value for name, value in off.node("hysteresis_compensator").items() if name.startswith(start)}
        assert after == before
        assert {name: value for name, value in model.items() if before.get(name, 1.0) != value}


def test_command_prints_the_table_and_writes_json_and_page(found, monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    monkeypatch.setattr(kim2009, "reproduce", lambda: found)
    page, rows = tmp_path / "kim.html", tmp_path / "kim.json"
    result = CliRunner().invoke(main, ["reproduce", "kim2009", "--json", str(rows), "-o", str(page)])
    assert result.exit_code == 0, result.output
    assert result.output == f"{format_claims(found)}\n\nreport: {page}\n"
    claims = json.loads(rows.read_text(encoding="utf-8"))["claims"]
    assert [claim["id"] for claim in claims] == [claim.id for claim in found.claims]
    html = page.read_text(encoding="utf-8")
    assert html.count("<img ") == html.count("data:image/png;base64,") == 6
    assert all(f"<td>{claim.id}</td>" in html for claim in found.claims)
    assert html.count('<tr class="fails">') == len(NOT_HOLDING)


def test_json_to_the_terminal_replaces_the_table(found, monkeypatch):
    monkeypatch.setattr(kim2009, "reproduce", lambda: found)
    result = CliRunner().invoke(main, ["reproduce", "kim2009", "--json", "-"])
    assert json.loads(result.output)["claims"][0]["id"] == found.claims[0].id


def test_wrong_input_ends_with_exit_code_2(found, monkeypatch, tmp_path):
    monkeypatch.setattr(kim2009, "reproduce", lambda: found)
    assert CliRunner().invoke(main, ["reproduce", "kim1999"]).exit_code == 2
    result = CliRunner().invoke(main, ["reproduce", "kim2009", "--json", str(tmp_path / "none" / "rows.json")])
    assert result.exit_code == 2 and "cannot be written" in result.output


def test_the_document_shows_what_the_command_prints(found):
    assert_shown(found, DOCUMENT)
