# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""State spaces: transfer, gain and parts of the class, and the recursion of the kernels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import dfreqresp, dlti

from hysteresis_ros.models.block import interpreted
from hysteresis_ros.models.linear import StateSpace, accumulate, advance

NONE = np.zeros((0, 0))


def system(seed: int, n: int, m: int = 1, q: int = 1) -> StateSpace:
    """Return a random system with all poles inside the circle of radius 0.9."""
    generator = np.random.default_rng(seed)
    A = generator.normal(size=(n, n))
    A *= 0.9 / max(np.abs(np.linalg.eigvals(A)), default=1.0)
    return StateSpace(A, generator.normal(size=(n, m)), generator.normal(size=(q, n)), generator.normal(size=(q, m)))


@given(st.integers(0, 10**6), st.integers(1, 5))
def test_the_response_is_scipys(seed, n):
    found, w = system(seed, n), np.linspace(0.01, 3.1, 20)
    _, expected = dfreqresp(dlti(found.A, found.B, found.C, found.D, dt=1.0), w)
    scale = np.abs(expected).max()
    assert found.response(np.exp(1j * w))[:, 0, 0] == pytest.approx(expected, rel=1e-7, abs=1e-9 * scale)


def test_several_inputs_and_outputs_answer_entry_by_entry():
    whole, z = system(1, 3, m=2, q=3), np.exp(1j * np.array([0.1, 2.0]))
    for i in range(3):
        for j in range(2):
            one = StateSpace(whole.A, whole.B[:, j : j + 1], whole.C[i : i + 1], whole.D[i : i + 1, j : j + 1])
            assert whole.response(z)[:, i, j] == pytest.approx(one.response(z)[:, 0, 0], rel=1e-12)
    assert whole.dc_gain == pytest.approx(whole.response([1.0])[0].real)


def test_without_states_there_is_the_feedthrough():
    direct = StateSpace(NONE, np.zeros((0, 1)), np.zeros((1, 0)), np.array([[2.0]]))
    assert np.array_equal(direct.response([1.0, 1j]), np.full((2, 1, 1), 2.0 + 0j))
    assert (direct.order, direct.dc_gain, direct.stable) == (0, 2.0, True)


@pytest.mark.parametrize(("pole", "stable"), [(0.999, True), (1.0, False), (-1.1, False)])
def test_stable_are_poles_inside_the_unit_circle(pole, stable):
    assert StateSpace(np.array([[pole]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1))).stable is stable


@given(st.integers(0, 10**6), st.integers(0, 4))
def test_held_input_delays_the_feedthrough_alone(seed, n):
    found, z = system(seed, n), np.exp(1j * np.array([0.2, 1.5]))
    late = StateSpace(found.A, found.B, found.C, np.zeros((1, 1))).response(z)[:, 0, 0] + found.D.item() / z
    assert found.held().response(z)[:, 0, 0] == pytest.approx(late, rel=1e-9, abs=1e-9)
    assert not found.held().D.any()


def test_scaled_and_parts():
    whole = StateSpace(np.diag([0.5, 0.2]), np.ones((2, 1)), np.array([[1.0, 3.0]]), np.array([[4.0]]))
    assert whole.scaled(2.0).dc_gain == pytest.approx(2.0 * whole.dc_gain)
    assert whole.part([1]).dc_gain == pytest.approx(3.0 / 0.8 + 4.0)


@given(st.integers(0, 10**6), st.integers(0, 5))
def test_the_kernels_recursion_is_the_sum_in_order(seed, n):
    """The same additions in the same order give the same bits; the array around the state is unchanged."""
    found = system(seed, n)
    p = np.concatenate([[7.0], found.A.ravel(), found.B[:, 0], found.C[0]])
    x = np.concatenate([[3.0], np.random.default_rng(seed).normal(size=n), np.zeros(n), [5.0]])
    state = x[1 : 1 + n].copy()
    following = []
    for i in range(n):
        total = found.B[i, 0] * 0.3
        for j in range(n):
            total += found.A[i, j] * state[j]
        following.append(total)
    advance(p, 1, 1 + n * n, x, 1, n, 0.3)
    assert x[1 : 1 + n].tolist() == following and (x[0], x[-1]) == (3.0, 5.0)
    output = 0.1
    for j in range(n):
        output += found.C[0, j] * following[j]
    assert accumulate(0.1, p, 1 + n * n + n, x, 1, n) == output


def test_a_state_that_dies_out_becomes_zero_and_is_never_denormal():
    """0.9 · 2.5e-323 rounds to 2.5e-323: without a limit such a state stays, and slows every later sample."""
    smallest = np.finfo(float).tiny
    for form in (advance, interpreted(advance)):
        p, x = np.array([0.9, 0.0, 0.0, -0.9, 1.0, 1.0]), np.array([1e-5, 1e-5, 0.0, 0.0])
        seen = []
        for _ in range(7000):
            form(p, 0, 4, x, 0, 2, 0.0)
            seen.append(x[:2].copy())
        seen = np.abs(seen)
        assert np.all((seen == 0.0) | (seen > 1e6 * smallest)) and np.all(seen[-1] == 0.0)
        # larger states are unchanged, to the last bit
        np.testing.assert_array_equal(seen[:3, 0], [1e-5 * 0.9, 1e-5 * 0.9 * 0.9, 1e-5 * 0.9 * 0.9 * 0.9])


def test_what_is_no_number_stays_none():
    p, x = np.array([0.9, 0.1]), np.array([np.nan, 0.0])
    advance(p, 0, 1, x, 0, 1, 1.0)
    assert np.isnan(x[0])
