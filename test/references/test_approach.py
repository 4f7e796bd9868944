# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The approach: bounds for any sequence of setpoints, no overshoot, exact arrival, no drift."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.references import Approach, ApproachParameters
from hysteresis_ros.references import approach as module
from hysteresis_ros.references.approach import RINGS, SLEWED, STEP, WINDOW1, WINDOW2, effective_limits

TS = 1e-3
STROKE = 15e-6
#: Rounding error of positions up to STROKE; the third difference contains eight times this error.
ROUNDING = 8 * 2.0**-48 * STROKE

limits = st.tuples(
    st.one_of(st.just(0.0), st.floats(1e-5, 1e-2)),
    st.one_of(st.just(0.0), st.floats(1e-3, 10.0)),
    st.one_of(st.just(0.0), st.floats(0.1, 1e4)),
)
sequences = st.lists(st.tuples(st.floats(0.0, STROKE), st.integers(1, 150)), min_size=1, max_size=8)


def build(velocity, acceleration, jerk, initial=0.0):
    return Approach(ApproachParameters(velocity, acceleration, jerk), TS, 0.0, STROKE, initial)


def rest(a):
    """Number of samples in which the reference settles from any state."""
    return round(a.duration(STROKE) / TS) + 1


@pytest.mark.slow
@given(limits, sequences)
@settings(deadline=None, max_examples=150)
def test_bounds_hull_and_arrival_for_any_setpoints(limit, sequence):
    a = build(*limit)
    settle = rest(a)
    u = np.concatenate([np.full(n, s) for s, n in sequence] + [np.full(settle, sequence[-1][0])])
    y = a.simulate(u)
    y = np.concatenate([np.zeros(3), y])
    for order, bound in enumerate(limit, start=1):
        if bound:
            allowed = bound * (1 + 1e-12) + ROUNDING / TS**order
            assert np.max(np.abs(np.diff(y, order))) / TS**order <= allowed
    hull = np.concatenate([[0.0], u])
    slack = 2.0**-48 * STROKE
    assert hull.min() - slack <= y.min() <= y.max() <= hull.max() + slack
    assert y[-1] == u[-1]


@given(limits, st.floats(0.0, STROKE), st.floats(0.0, STROKE))
@settings(deadline=None, max_examples=100)
def test_from_rest_it_is_monotone_and_arrives_when_stated(limit, start, target):
    a = build(*limit, initial=start)
    assert a.step(start) == start
    y = a.simulate(np.full(rest(a) + 5, target))
    arrival = round(a.duration(target - start) / TS)
    assert np.all(y[arrival:] == target)
    steps = np.diff(np.concatenate([[start], y])) * math.copysign(1.0, target - start)
    assert np.all(steps >= -(2.0**-48) * STROKE)
    assert np.all((y - target) * math.copysign(1.0, target - start) <= ROUNDING)


@pytest.mark.parametrize("limit", [(1e-3, 0.0, 0.0), (1e-3, 0.1, 0.0), (1e-4, 1e-2, 1.0)])
@pytest.mark.parametrize("target", [10.5e-6, 3e-6])
def test_it_arrives_in_the_stated_sample_and_not_before(limit, target):
    a = build(*limit)
    y = a.simulate(np.full(rest(a), target))
    assert np.flatnonzero(y == target)[0] + 1 == round(a.duration(target) / TS)


def test_all_limits_zero_passes_setpoints_through():
    u = np.random.default_rng(1).uniform(0, STROKE, 100)
    assert np.array_equal(build(0, 0, 0).simulate(u), u)


def test_velocity_alone_is_a_ramp():
    y = build(1e-3, 0, 0).simulate(np.full(20, 10e-6))
    assert y == pytest.approx(np.minimum(np.arange(1, 21) * 1e-6, 10e-6), abs=1e-19)


def test_a_long_move_reaches_the_velocity():
    y = build(1e-4, 1e-2, 1.0).simulate(np.full(400, STROKE))
    assert np.max(np.diff(y)) / TS == pytest.approx(1e-4, rel=1e-9)


def test_free_limits_make_the_stroke_fastest():
    v, a, j = effective_limits(ApproachParameters(0, 0, 2.0), STROKE)
    assert STROKE / v == pytest.approx(2 * v / a) == pytest.approx(2 * a / j)
    v, a, _ = effective_limits(ApproachParameters(0, 0.5, 0), STROKE)
    assert STROKE / v == pytest.approx(2 * v / a)


def test_running_sums_do_not_drift():
    a = build(2e-3, 0.3, 30.0)
    u = np.repeat(np.random.default_rng(5).uniform(0, STROKE, 20000), 10)
    a.simulate(u)
    a.simulate(np.full(rest(a), 3e-6))
    at_rest = build(2e-3, 0.3, 30.0, initial=3e-6)
    at_rest.simulate(np.zeros(0))
    assert np.array_equal(a.x[SLEWED : SLEWED + 6], at_rest.x[SLEWED : SLEWED + 6])
    assert not np.any(a.x[RINGS:])
    assert a.step(3e-6) == 3e-6


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1e-9, STROKE * 1.001])
def test_a_bad_setpoint_keeps_the_last_good_one(bad):
    a, b = build(1e-3, 0.1, 10.0), build(1e-3, 0.1, 10.0)
    u = np.full(100, 5e-6)
    mixed = u.copy()
    mixed[10:] = bad
    assert np.array_equal(a.simulate(mixed), b.simulate(u))


def test_compiled_and_interpreted_are_equal_bit_for_bit(monkeypatch):
    u = np.repeat(np.random.default_rng(3).uniform(0, STROKE, 30), 40)
    expected = build(1e-3, 0.1, 10.0).simulate(u)
    a = build(1e-3, 0.1, 10.0)
    monkeypatch.setattr(module, "quotient", interpreted(module.quotient))
    assert np.array_equal([interpreted(module.approach)(a.p, a.x, value) for value in u], expected)


def test_restored_state_goes_on_the_same():
    a = build(1e-3, 0.1, 10.0)
    a.simulate(np.full(30, 9e-6))
    state = a.state
    expected = a.simulate(np.full(100, 2e-6))
    a.reset()
    a.state = state
    assert np.array_equal(a.simulate(np.full(100, 2e-6)), expected)


def test_window_sizes_follow_the_proof():
    a = build(1e-3, 0.1, 10.0)
    assert (a.p[WINDOW1], a.p[WINDOW2]) == (20, 20)
    assert a.p[STEP] > 1e6


def test_limits_that_are_too_low_are_refused_by_name():
    for limit, name in [((1e-3, 1e-9, 0), "acceleration"), ((1e-3, 1e-1, 1e-9), "jerk"), ((1e-30, 0, 0), "velocity")]:
        with pytest.raises(ParameterError, match=f"approach.maximum_{name}"):
            build(*limit)
    with pytest.raises(ParameterError, match="approach"):
        build(1e-3, 0.1, 1.0).retune(ApproachParameters(1e-3, 0.1, 2.0))
