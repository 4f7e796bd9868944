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
from hysteresis_ros.laboratory.sweeps.page import Column, influence_figure, levels_figure, scatter_figure, share_figure
from hysteresis_ros.laboratory.sweeps.plan import Levels
from hysteresis_ros.laboratory.sweeps.summary import (
    Summary,
    _metric_line,
    _yield_lines,
    met,
    parse_bound,
    sensitivity,
    to_json,
    yield_of,
)
from hysteresis_ros.laboratory.sweeps.sweep import Results, _Table

REFUSED = np.array(["", "", "limits.minimum = 300"])


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


@pytest.mark.slow
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


@pytest.mark.parametrize("words", ["rms_error_m", "rms_error_m=", "rms_error_m=:", "rms_error_m=2nm:1nm"])
def test_a_bound_that_every_run_or_none_would_meet_is_refused(words):
    with pytest.raises(ConfigurationError, match="write NAME=MAXIMUM, NAME=MINIMUM:MAXIMUM or NAME=MINIMUM:"):
        parse_bound(words)


def test_a_longer_sweep_keeps_which_runs_of_the_shorter_one_were_stopped_or_refused():
    study, plan = asked(runs=4)
    short = Results({}, {}, {name: np.array([1.0, 2.0, np.nan]) for name in study.metrics}, np.arange(3) == 1, REFUSED)
    table = _Table(study, plan)
    table.take(short)
    found = table.results()
    assert found.tripped.tolist() == [False, True, False, False] and found.refused.tolist() == [*REFUSED, ""]
    for values in found.metrics.values():
        np.testing.assert_array_equal(values, [1.0, 2.0, np.nan, np.nan])
    assert [piece.tolist() for piece in table.missing] == [[3]]


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
    # errors are those of the whole path, other metrics those of the samples
    assert "between the samples" in text
    size = Results({}, {"gain": np.zeros(2)}, {"overshoot_percent": np.ones(2)}, np.zeros(2, bool), np.full(2, ""))
    assert "between the samples" not in _metric_line(Summary(size, plan), "overshoot_percent")


def test_the_median_is_not_the_mean():
    found = to_json(Summary(results([1e-9, 2e-9, 9e-9]), asked(runs=4)[1]))["metrics"]["rms_error_m"]
    assert found["median"] == pytest.approx(2e-9)


def test_of_many_levels_those_with_the_largest_yield_are_listed_and_the_others_counted():
    """The k-th level, 1 to 30, has k good runs of 30."""
    levels, draws = 30, 30
    varied = (f"reference_generator.initial_setpoint=1um:2um:lin{levels}", "plant_simulator.gain=uniform(1.1,1.3)")
    plan = asked(varied, runs=draws)[1]
    numbers = np.arange(levels * draws)
    level, draw = numbers % levels, numbers // levels
    parameters = {name: level for name in (one.label for one in plan.variations)}
    given = replace(results(np.where(draw <= level, 1e-9, 1e-6)), parameters=parameters)
    listed = _yield_lines(Summary(given, plan, (parse_bound("rms_error_m=10nm"),)))[1:]
    assert len(listed) == 26 and listed[-1] == "  … 5 more"
    shares = [int(re.search(r"(\d+) of 30", line)[1]) for line in listed[:-1]]
    assert shares == list(range(30, 5, -1)), listed


@pytest.mark.slow
def test_figures_of_a_sweep_show_values_and_bounds_in_the_displayed_unit():
    """Two of four runs are below 2 nm, three have a value; a run without one counts as not below."""
    column = Column("error [nm]", np.array([1e-9, 3e-9, np.inf, 2e-9]), 1e9)
    steps, bound = share_figure(column, [2.5e-9]).axes[0].lines
    np.testing.assert_allclose(steps.get_xdata(), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(steps.get_ydata(), [25.0, 50.0, 75.0])
    assert bound.get_xdata() == pytest.approx([2.5, 2.5])
    points, bound = scatter_figure(column, {"gain": np.arange(4.0)}, [2.5e-9]).axes[0].lines
    np.testing.assert_allclose(points.get_ydata(), [1.0, 3.0, np.nan, 2.0])
    np.testing.assert_allclose(points.get_xdata(), np.arange(4.0))
    assert bound.get_ydata() == pytest.approx([2.5, 2.5])
    # one parameter fills the figure, and five are in rows of three
    for count, cells in ((1, (1, 1)), (5, (2, 3))):
        figure = scatter_figure(column, {f"p{k}": np.arange(4.0) for k in range(count)}, [])
        assert figure.axes[0].get_subplotspec().get_gridspec().get_geometry() == cells
        assert sum(axis.get_visible() for axis in figure.axes) == count


def test_figures_at_levels_show_median_and_worst_run_and_the_yield_in_percent():
    spread = [np.array([1e-9, 2e-9, 6e-9]), np.array([np.nan, 4e-9, np.inf])]
    figure = levels_figure(Column("error [nm]", np.zeros(0), 1e9), "gain", [1.0, 2.0], spread, [(0.5, 0.25, 0.75)] * 2)
    lines = {line.get_label(): line.get_ydata().tolist() for line in figure.axes[0].lines}
    assert lines["median"] == pytest.approx([2.0, 4.0]) and lines["worst"] == pytest.approx([6.0, 4.0])
    assert lines["95 % below"] == pytest.approx([5.6, 4.0])
    assert figure.axes[1].lines[0].get_ydata() == pytest.approx([50.0, 50.0])
    linear, wide, words = (
        levels_figure(Column("e", np.zeros(0), 1.0), "gain", levels, [np.ones(2)] * 3, []).axes[0]
        for levels in ([0.9, 1.0, 1.1], [0.1, 1.0, 10.0], ["pid", "lqg", "smc"])
    )
    assert [axis.get_xscale() for axis in (linear, wide, words)] == ["linear", "log", "linear"]
    assert [text.get_text() for text in words.get_xticklabels()] == ["pid", "lqg", "smc"]


@pytest.mark.parametrize(("names", "scale"), [(("first", "total"), 1.0), (("mean", "deviation"), 0.25)])
def test_influences_are_fractions_of_the_variance_or_of_the_largest_effect(names, scale):
    columns = {names[0]: np.array([1.0, 4.0]), names[1]: np.array([2.0, 3.0]), f"{names[0]}_interval": np.ones(2)}
    (axis,) = influence_figure({"error": (("gain", "delay"), columns)}).axes
    widths = [bar.get_width() for bar in axis.patches]
    assert widths == pytest.approx([scale * width for name in names for width in columns[name]])
    # the first parameter is at the top, the first figure above the second
    assert [round(bar.get_y() + 0.18, 6) for bar in axis.patches] == [1.2, 0.2, 0.8, -0.2]


@pytest.mark.parametrize("runs", [1, 10, 50])
def test_the_interval_of_a_yield_has_the_confidence_of_95_percent_by_default(runs):
    """Clopper and Pearson in closed form: no good run is likely up to the share p with (1 - p)^n = 2.5 %."""
    none, all_ = yield_of(np.zeros(runs, dtype=bool)), yield_of(np.ones(runs, dtype=bool))
    assert (none.low, none.high) == pytest.approx((0.0, 1.0 - 0.025 ** (1.0 / runs)))
    assert (all_.low, all_.high) == pytest.approx((0.025 ** (1.0 / runs), 1.0))


@pytest.mark.parametrize(
    ("values", "unit", "words"),
    [
        ((1e-6, 2.5e-6), "m", "1e-06m,2.5e-06m"),
        ((12, 14), "", "12,14"),
        (("pid", "lqg"), "m", "pid,lqg"),
        ((True, False), "", "true,false"),
    ],
)
def test_levels_are_written_as_they_may_be_given(values, unit, words):
    assert Levels(values).words(unit) == words
