# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Claims and their reproduction: evaluated, printed and written without loss."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from hysteresis_ros.errors import ParameterError, RecordingError
from hysteresis_ros.laboratory.papers.claims import HEADINGS, Claim, Reproduction, format_claims
from hysteresis_ros.laboratory.papers.runs import loop_width, picard_width, step_figures, worst
from hysteresis_ros.models.hysteresis.polynomial import assumed_stack
from hysteresis_ros.recordings.dataset import Recording

RATE = 1000.0


def claim(**changes):
    return Claim(**(dict(id="x", group="g", quantity="q", measured=2e-8, unit="m") | changes))


@pytest.mark.parametrize(
    ("limits", "holds", "words"),
    [
        (dict(), None, ""),
        (dict(high=2e-8), True, "≤ 0.02"),
        (dict(high=1.9e-8), False, "≤ 0.019"),
        (dict(low=3e-8), False, "≥ 0.03"),
        (dict(low=1e-8, high=3e-8), True, "0.01 … 0.03"),
    ],
)
def test_a_claim_holds_within_its_inclusive_tolerance(limits, holds, words):
    assert claim(**limits).holds is holds
    assert claim(**limits).tolerance == words


@pytest.mark.parametrize(("name", "value"), [("unit", "furlong"), ("measured", math.nan), ("measured", math.inf)])
def test_what_no_table_can_hold_is_refused_by_name(name, value):
    with pytest.raises(ParameterError, match=f"x: {name}"):
        claim(**{name: value})


def test_json_holds_every_required_entry_in_si_units():
    found = Reproduction("n", "t", (claim(paper=2.5e-7, high=1e-8, assumptions=("a", "b"), details={"+5 %": 1.0}),), {})
    (row,) = json.loads(json.dumps(found.to_json(), allow_nan=False))["claims"]
    assert {"id", "paper", "measured", "unit", "tolerance", "holds", "assumptions"} <= row.keys()
    assert (row["measured"], row["paper"], row["unit"], row["tolerance"]) == (2e-8, 2.5e-7, "m", "≤ 0.01 µm")
    assert row["holds"] is False and row["assumptions"] == ["a", "b"] and row["details"] == {"+5 %": 1.0}


def test_table_shows_micrometres_and_numbers_assumptions_once():
    rows = (
        claim(id="one", paper=2.5e-7, high=1e-7, assumptions=("first",)),
        claim(id="two", measured=-1e-15, paper="gone", derived=True, high=0.0, assumptions=("second", "first")),
        claim(id="three", unit="s", measured=0.5, low=1.0, reason="slow"),
    )
    lines = format_claims(Reproduction("n", "t", rows, {})).splitlines()
    table = {line.split()[0]: line.split() for line in lines if line}
    assert table["row"] == list(HEADINGS)
    assert table["one"] == ["one", "q", "0.25", "0.0200", "µm", "≤", "0.1", "yes", "1"]
    assert table["two"] == ["two", "q", "gone*", "0.0000", "µm", "≤", "0", "yes", "2", "1"]
    assert "NO" in table["three"]
    assert "2 of 3 rows hold; not: three" in lines and "- three: slow" in lines
    assert lines[-2:] == ["1  first", "2  second"]


def steps_run(answer):
    """Return a run of a step of 1 µm up at 0.1 s and back at 0.6 s; ``answer(t)`` is the step response."""
    time = np.arange(1100) / RATE
    reference = np.where((time >= 0.1) & (time < 0.6), 1e-6, 0.0)
    displacement = np.where(time >= 0.1, answer(time - 0.1), 0.0) - np.where(time >= 0.6, answer(time - 0.6), 0.0)
    return Recording(time, {"reference": reference, "displacement": 1e-6 * displacement})


def test_step_figures_of_a_first_order_answer():
    figures = step_figures(steps_run(lambda t: 0.9 * (1.0 - np.exp(-np.maximum(t, 0.0) / 0.01))))
    assert figures.settling == pytest.approx(0.01 * math.log(0.9 / 0.02), abs=1.5 / RATE)
    assert figures.peak == pytest.approx(0.9e-6)
    assert figures.level_error == pytest.approx(0.1e-6)
    assert figures.residual == pytest.approx(0.0, abs=1e-12)
    assert figures.late_vibration == pytest.approx(0.0, abs=1e-12)


def test_a_vibration_that_never_settles_counts_with_the_whole_hold():
    figures = step_figures(steps_run(lambda t: 1.0 - np.cos(2 * np.pi * 50.0 * t)))
    assert figures.settling == pytest.approx(0.5, abs=1.0 / RATE)
    assert figures.late_vibration == pytest.approx(1e-6, rel=0.02)


def test_runs_without_steps_or_loop_are_refused():
    time = np.arange(100) / RATE
    flat = Recording(time, {"reference": np.zeros(100), "displacement": np.zeros(100)})
    with pytest.raises(RecordingError, match="step up and back"):
        step_figures(flat)
    with pytest.raises(RecordingError, match="does not reverse"):
        loop_width(flat)


@pytest.mark.parametrize("width", [0.0, 0.1])
def test_loop_width_of_parabolic_branches_and_the_delay_of_a_sample(width):
    """Branches u ± 2 w u (1 − u) have the width w at half the stroke; a plant responds one sample later."""
    up = np.linspace(0.0, 1.0, 501)
    reference = np.concatenate([up, up[::-1][1:], up[1:], up[::-1][1:]])
    direction = np.concatenate([-np.ones(501), np.ones(500), -np.ones(500), np.ones(500)])
    answer = reference + direction * 2.0 * width * reference * (1.0 - reference)
    run = Recording(np.arange(2001) / RATE, {"reference": reference, "displacement": np.append(0.0, answer[:-1])})
    assert loop_width(run) == pytest.approx(100.0 * width, abs=1e-9)


def test_no_picard_step_leaves_the_opening_of_the_branches():
    stack = assumed_stack(opening=0.1)
    stroke = 120.0 * stack.virgin[1]
    assert picard_width(stack, 120.0, stroke, 0, 1.0) == pytest.approx(10.0)
    # the iteration contracts, but not at every step
    assert picard_width(stack, 120.0, stroke, 40, 1.0) < 1e-3


def test_worst_keeps_the_sign():
    assert worst([0.1, -0.3, 0.2]) == -0.3
