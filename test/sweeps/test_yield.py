# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Yields count runs that finished and meet all bounds; other runs are not good."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from sweep_support import asked

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.sweeps.plan import Levels
from hysteresis_ros.laboratory.sweeps.summary import (
    Summary,
    _metric_line,
    met,
    parse_bound,
    sensitivity,
    to_json,
    yield_of,
)
from hysteresis_ros.laboratory.sweeps.sweep import Results


def results(error, tripped=(), refused=()) -> Results:
    """Return the results of runs with these errors [m], some of which were stopped or refused."""
    count = len(error)
    stopped = np.isin(np.arange(count), tripped)
    why = np.where(np.isin(np.arange(count), refused), "limits.minimum = 300", "")
    return Results({}, {}, {"rms_error_m": np.array(error, dtype=float)}, stopped, why)


def test_a_run_that_was_stopped_or_refused_is_not_good_however_small_its_error_was():
    """A run that trips early has no time for a large error."""
    found = results([1e-9, 1e-9, 1e-9, 5e-6, np.nan], tripped=[1], refused=[2])
    bound = parse_bound("rms_error_m=10nm")
    assert met(found, [bound]).tolist() == [True, False, False, False, False]
    assert met(found, []).tolist() == [True, False, False, True, True]
    counted = yield_of(met(found, [bound]))
    assert (counted.good, counted.runs) == (1, 5) and counted.share == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("words", "values", "good"),
    [
        ("rms_error_m=10nm", [9.9e-9, 1e-8, 1.01e-8], [True, True, False]),
        ("rms_error_m=10nm:", [9.9e-9, 1e-8, 1.01e-8], [False, True, True]),
        ("rms_error_m=10nm:20nm", [9e-9, 1e-8, 2e-8, 2.1e-8], [False, True, True, False]),
    ],
)
def test_both_ends_of_a_bound_are_good_and_what_has_no_value_is_not(words, values, good):
    assert met(results([*values, np.nan]), [parse_bound(words)]).tolist() == [*good, False]
    # every bound counts
    both = [parse_bound(words), parse_bound("rms_error_m=0:1m")]
    assert met(results([*values, np.nan]), both).tolist() == [*good, False]


def test_the_worst_run_is_the_one_of_the_largest_size_whatever_its_sign():
    found = Results(
        {}, {}, {"overshoot_percent": np.array([1.0, -9.0, np.nan, 4.0])}, np.zeros(4, bool), np.full(4, "")
    )
    assert Summary(found, asked(runs=4)[1]).worst("overshoot_percent") == 1
    nothing = Results({}, {}, {"overshoot_percent": np.full(4, np.nan)}, np.zeros(4, bool), np.full(4, ""))
    assert Summary(nothing, asked(runs=4)[1]).worst("overshoot_percent") is None


def test_a_sensitivity_of_which_runs_are_missing_is_none_and_says_how_many():
    _, plan = asked(runs=64, design="morris")
    count = len(plan.designed)
    values = np.arange(count, dtype=float)
    values[[3, 7]] = np.nan
    found = sensitivity(plan, "rms_error_m", values)
    assert not found.columns and found.why.startswith(f"2 of {count} runs have no value")
    assert "the same in all runs" in sensitivity(plan, "rms_error_m", np.ones(count)).why


def test_a_fraction_in_percent_and_a_number_are_the_same_bound():
    both = parse_bound("overshoot_percent=5%"), parse_bound("overshoot_percent=5")
    assert [bound.high for bound in both] == [pytest.approx(5.0)] * 2
    assert parse_bound("rms_error_percent_of_stroke=0.1%:0.2%").low == pytest.approx(0.1)
    with pytest.raises(ConfigurationError, match="is in V, but overshoot_percent is in %"):
        parse_bound("overshoot_percent=5V")


def test_a_single_level_is_the_low_end():
    for made in (Levels.linear, Levels.logarithmic):
        assert made(1.0, 4.0, 1).values == (1.0,) and made(1.0, 4.0, 2).values == (1.0, 4.0)


def test_quantiles_are_those_of_the_runs_that_have_a_value():
    """Errors of 0 … 100 nm: half of them are below 50 nm and 95 % below 95 nm; a run without a value has none."""
    plan = asked(runs=4)[1]
    summary = Summary(results([*np.linspace(0.0, 1e-7, 101), np.nan]), plan)
    found = to_json(summary)["metrics"]["rms_error_m"]
    assert (found["runs"], found["worst_run"]) == (101, 100)
    assert (found["median"], found["quantile"]) == (pytest.approx(50e-9), pytest.approx(95e-9))
    text = _metric_line(Summary(replace(summary.results, parameters={"gain": np.zeros(102)}), plan), "rms_error_m")
    assert re.search(r"median 50\S* nm, 95 % below 95\S* nm, worst 100\S* nm in run 100", text), text
    assert text.endswith("; 1 runs have no value")
