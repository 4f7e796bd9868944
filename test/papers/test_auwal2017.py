# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The experiments of Auwal et al. 2017 give the stated results; rows under realistic conditions show the limits."""

from __future__ import annotations

import json
import pathlib

import numpy as np
import pytest
from claims_support import assert_shown
from click.testing import CliRunner

import hysteresis_ros as hr
from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.laboratory.papers.auwal2017 import axis as auwal
from hysteresis_ros.laboratory.papers.auwal2017 import control, model
from hysteresis_ros.laboratory.papers.auwal2017 import reproduction as auwal2017
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis

DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs" / "auwal2017.md"

#: Rows that do not hold, each with its reason in the table. A change of any row must be noticed.
NOT_HOLDING = {
    "model.fpe",
    "frequency.1.combined",
    "frequency.1.half.combined",
    "frequency.sine.1.combined",
    "frequency.sine.10.combined",
    "camera.delay_1",
}


@pytest.fixture(scope="module")
def found():
    return hr.reproduce("auwal2017")


@pytest.fixture(scope="module")
def measured(found):
    return {claim.id: claim.measured for claim in found.claims}


@pytest.fixture(scope="module")
def axis():
    return load_configuration("auwal2017")


def test_rows_have_unique_names_and_name_their_assumptions(found):
    names = [claim.id for claim in found.claims]
    assert len(names) == len(set(names))
    assert all(claim.assumptions for claim in found.claims)


def test_exactly_the_known_rows_do_not_hold_and_say_why(found):
    failing = {claim.id: claim.reason for claim in found.claims if claim.holds is False}
    assert set(failing) == NOT_HOLDING
    assert all(failing.values())


def test_the_papers_integrals_come_out_within_one_per_cent(measured):
    for method, published in auwal.IAE.items():
        assert measured[f"iae.{method}"] == pytest.approx(published, rel=0.01)
    for method, published in auwal.REDUCTION.items():
        assert measured[f"reduction.{method}"] == pytest.approx(published, abs=0.1)


def test_the_papers_case_needs_a_voltage_the_stack_must_not_have(measured):
    assert max(measured["voltage.pid"], measured["voltage.inverse"]) < -23.5
    assert measured["limited.inverse"] > 5.0 * measured["iae.inverse"]
    ways = [measured[f"limited.{method}"] for method in control.WAYS]
    assert measured["limited.unavoidable"] < min(ways)


def test_the_error_behind_the_inverse_is_the_lag_of_the_mass(found):
    """A ramp through 1/(m s² + b s + K) with unit DC gain is delayed by b/K; the hold adds half a sample."""
    run = found.runs["inverse"]
    middle = (run.time > 10.0) & (run.time < 20.0)
    slope = 2.0 * auwal.HEIGHT / auwal.PERIOD
    lag = auwal.TABLE_1["b"] / auwal.TABLE_1["K"] + 0.5 * run.sample_time
    assert auwal.error(run)[middle] == pytest.approx(slope * lag, rel=1e-3)


def test_inverse_feedback_and_feedforward_together_beat_both(measured):
    assert measured["iae.combined"] < 0.01 * measured["iae.inverse"]
    for condition in ("slow.limits", "slow.half", "slow.cycles", "slow.noise", "slow.creep", "slow.all"):
        better = min(measured[f"{condition}.pid"], measured[f"{condition}.inverse"])
        assert measured[f"{condition}.combined"] < 0.2 * better


def test_a_model_that_is_off_costs_the_inverse_most_and_the_combination_little(measured):
    for row in ("off.d_e_1", "off.d_e_5", "off.alpha_5"):
        assert measured[f"{row}.combined"] > 99.5 > measured[f"{row}.inverse"]


def test_dynamics_inverted_follow_a_sine_within_the_limits(measured):
    for row in ("frequency.sine.1", "frequency.sine.10"):
        assert measured[f"{row}.dynamic"] < 0.01 * measured[f"{row}.pid"]


def test_literal_equation_runs_away_by_the_same_amount_as_its_closed_form():
    """While V rises, h soon becomes negative: dh/dV = α − β V − γ |h|; then |V̇| V falls further while V returns."""
    assert model.misprinted(auwal.PEAK_VOLTAGE) == pytest.approx(93.93e-6, rel=1e-3)


def test_dynamics_of_the_file_are_the_published_transfer_function(axis):
    again = auwal.at_rate(axis, axis.node("plant_simulator")["sample_rate"])
    for node, start in (("plant_simulator", "dynamics"), ("motion_controller", "model.dynamics")):
        for name in "AB":
            stated, exact = (np.array(item.node(node)[f"{start}.{name}"]) for item in (axis, again))
            assert stated == pytest.approx(exact, rel=1e-10)


def test_a_triangle_of_10_hz_is_refused_by_name_before_anything_moves(axis):
    fast = auwal.limited(auwal.driven(axis, "pid"), *auwal.NEGATIVE)
    moved = dict(waveform__amplitude=auwal.HEIGHT, waveform__frequency=10.0)
    with pytest.raises(ParameterError, match="waveform.frequency"):
        single_axis(fast.override("reference_generator", **moved))


def test_what_zero_volt_leaves_is_on_the_falling_branch():
    """IAE of a ramp that ends ``left`` too high: a triangle of this height, with a length of ``left`` over slope."""
    slope = 2.0 * auwal.HEIGHT / auwal.PERIOD
    left = np.sqrt(2.0 * slope * control.unavoidable())
    element = BoucWenHysteresis(model.PUBLISHED_BOUC_WEN, 1.0)
    rising = element.simulate(np.linspace(0.0, 123.3, 200))
    assert rising[-1] == pytest.approx(auwal.HEIGHT, rel=2e-3)
    assert left == pytest.approx(float(element.step(0.0)), rel=2e-3)


def test_mismatch_belongs_to_the_compensator_and_creep_to_the_plant(axis):
    off = auwal.off(axis, "d_e", 0.05)
    assert off.node("plant_simulator") == axis.node("plant_simulator")
    assert off.node("hysteresis_compensator")["hysteresis.bouc_wen.d_e"] == pytest.approx(1.05 * 0.206e-6)
    creeping = auwal.creeping(axis)
    assert creeping.node("hysteresis_compensator") == axis.node("hysteresis_compensator")


def test_command_writes_json_and_page(found, monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    monkeypatch.setattr(auwal2017, "reproduce", lambda: found)
    page, rows = tmp_path / "auwal.html", tmp_path / "auwal.json"
    result = CliRunner().invoke(main, ["reproduce", "auwal2017", "--json", str(rows), "-o", str(page)])
    assert result.exit_code == 0, result.output
    claims = json.loads(rows.read_text(encoding="utf-8"))["claims"]
    assert [claim["id"] for claim in claims] == [claim.id for claim in found.claims]
    iae = next(claim for claim in claims if claim["id"] == "iae.pid")
    assert iae["unit"] == "m*s" and iae["paper"] == 3.099e-6 and iae["holds"] is True
    html = page.read_text(encoding="utf-8")
    assert html.count("<img ") == html.count("data:image/png;base64,") == 9
    assert html.count('<tr class="fails">') == len(NOT_HOLDING)


def test_the_document_shows_what_the_command_prints(found):
    assert_shown(found, DOCUMENT)
