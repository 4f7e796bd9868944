# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures of coupled loops: closed forms, and python-control on random systems."""

from __future__ import annotations

import importlib
import math

import numpy as np
import pytest

from hysteresis_ros.control.coupling import (
    _peak,
    disk_margins,
    lost_direction,
    relative_gain_array,
    singular_values,
    static_decoupling,
)
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import StateSpace


def python_control():
    """Return python-control, or skip the test; the folder of this test is also a module named control."""
    pytest.importorskip("control.statesp", reason="python-control is optional")
    return importlib.import_module("control")


def random_loop(count: int, seed: int, order: int = 4) -> StateSpace:
    """Return a stable random loop whose closed loop is stable too."""
    random = np.random.default_rng(seed)
    while True:
        A = random.standard_normal((order, order))
        A *= 0.9 / np.max(np.abs(np.linalg.eigvals(A)))
        B, C = random.standard_normal((order, count)), 0.15 * random.standard_normal((count, order))
        if np.max(np.abs(np.linalg.eigvals(A - B @ C))) < 0.98:
            return StateSpace(A, B, C, np.zeros((count, count)))


def diagonal(loops) -> StateSpace:
    """Return several loops of one input and output as one uncoupled loop."""
    order = sum(loop.order for loop in loops)
    A, B, C = np.zeros((order, order)), np.zeros((order, len(loops))), np.zeros((len(loops), order))
    first = 0
    for i, loop in enumerate(loops):
        part = slice(first, first + loop.order)
        A[part, part], B[part, i], C[i, part] = loop.A, loop.B[:, 0], loop.C[0]
        first += loop.order
    return StateSpace(A, B, C, np.zeros((len(loops), len(loops))))


def closed_but(loop: StateSpace, open_: int) -> StateSpace:
    """Return the transfer function around one opened loop while the other loops are closed."""
    others = [i for i in range(loop.B.shape[1]) if i != open_]
    A = loop.A - loop.B[:, others] @ loop.C[others]
    return StateSpace(A, loop.B[:, [open_]], loop.C[[open_]], np.zeros((1, 1)))


def test_the_static_decoupling_makes_the_gain_one():
    gain = np.array([[1.0, 0.3, 0.0], [-0.2, 2.0, 0.1], [0.05, 0.0, 0.5]])
    np.testing.assert_allclose(gain @ static_decoupling(gain), np.eye(3), atol=1e-14)


def test_a_singular_gain_names_the_direction_that_is_lost():
    gain = np.array([[1.0, 2.0], [2.0, 4.0]])
    assert lost_direction(gain, "xy") == "+0.89 x, -0.45 y"
    np.testing.assert_allclose(gain @ [0.894427191, -0.4472135955], 0.0, atol=1e-9)
    with pytest.raises(ParameterError, match=r"\+0\.89 x, -0\.45 y causes no motion"):
        static_decoupling(gain, "xy")
    assert lost_direction(np.diag([1.0, 1e-5]), "xy") == ""


def test_relative_gains_have_their_closed_form():
    g11, g12, g21, g22 = 2.0, 0.7, -0.4, 1.5
    first = 1.0 / (1.0 - g12 * g21 / (g11 * g22))  # Bristol 1966
    found = relative_gain_array([[g11, g12], [g21, g22]])
    np.testing.assert_allclose(found, [[first, 1.0 - first], [1.0 - first, first]], rtol=1e-13)


def test_rows_and_columns_of_relative_gains_add_up_to_one_and_ignore_units():
    random = np.random.default_rng(3)
    gain = random.standard_normal((5, 4, 4)) + 1j * random.standard_normal((5, 4, 4))
    found = relative_gain_array(gain)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-10)
    np.testing.assert_allclose(found.sum(axis=2), 1.0, atol=1e-10)
    units = np.diag([1e-6, 3.0, 1e3, 7.0])
    np.testing.assert_allclose(relative_gain_array(units @ gain @ units**2), found, rtol=1e-6)


def test_singular_values_are_those_of_python_control():
    control = python_control()
    loop = random_loop(3, 5)
    angles = np.array([0.01, 0.3, 2.0])
    expected = control.singular_values_response(control.ss(loop.A, loop.B, loop.C, loop.D, 1.0), angles)
    found = singular_values(loop.response(np.exp(1j * angles)))
    np.testing.assert_allclose(found, expected.magnitude[:, 0, :].T, rtol=1e-9)


@pytest.mark.parametrize("place", [0, 1, 4])
def test_a_peak_is_found_between_the_points_of_the_grid(place):
    """And at its first and last point."""
    grid = np.linspace(0.0, 1.0, 5)
    top = {0: 0.0, 1: 0.17, 4: 1.0}[place]
    assert _peak(lambda angle: 2.0 - (angle - top) ** 2, grid, place) == pytest.approx((top, 2.0), abs=1e-7)
    assert _peak(lambda angle: 2.0 - abs(angle - 0.61), grid, 2) == pytest.approx((0.61, 2.0), abs=1e-7)


def test_an_integrator_has_its_closed_form():
    # L = k/(z - 1): S - 1/2 = (z - 1 - k)/(2 (z - 1 + k)), largest at z = -1: (2 + k)/(2 (2 - k))
    k = 0.1
    margin = disk_margins(StateSpace(np.eye(1), k * np.eye(1), np.eye(1), np.zeros((1, 1))), 1e-3).together
    alpha = 2.0 * (2.0 - k) / (2.0 + k)
    assert margin.alpha == pytest.approx(alpha, rel=1e-6)
    assert margin.frequency == pytest.approx(500.0, rel=1e-4)
    assert margin.gains[1] == pytest.approx((2.0 + alpha) / (2.0 - alpha), rel=1e-5)
    assert margin.phase_margin == pytest.approx(math.degrees(2.0 * math.atan(alpha / 2.0)), rel=1e-6)


@pytest.mark.parametrize("skew", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize(("count", "seed"), [(1, 0), (1, 1), (2, 2), (2, 3), (3, 4)])
def test_margins_are_those_of_python_control(count, seed, skew):
    control = python_control()
    if count > 1:
        pytest.importorskip("slycot")
    loop = random_loop(count, seed)
    found = disk_margins(loop, 1.0, skew).together
    system = control.ss(loop.A, loop.B, loop.C, loop.D, 1.0)
    angles = 2.0 * np.pi * found.frequency * np.linspace(0.98, 1.02, 41)
    angles = np.concatenate([np.linspace(1e-4, np.pi, 2000), np.minimum(angles, np.pi)])
    alpha, gain, phase = control.disk_margins(system, np.unique(angles), skew=skew)
    assert found.alpha == pytest.approx(alpha, rel=1e-4)
    if skew == 0.0:  # where the gain margin is the same in both directions, and is the one that is returned
        assert found.gain_margin == pytest.approx(gain, rel=1e-3)
        assert found.phase_margin == pytest.approx(phase, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 7])
def test_the_margin_of_a_loop_is_that_of_the_loop_with_the_others_closed(seed):
    loop = random_loop(3, seed)
    found = disk_margins(loop, 1.0)
    for i, margin in enumerate(found.loops):
        alone = disk_margins(closed_but(loop, i), 1.0).together
        assert margin.alpha == pytest.approx(alone.alpha, rel=1e-6)
        assert found.together.alpha <= margin.alpha * (1.0 + 1e-9)


@pytest.mark.slow
def test_loops_that_do_not_couple_have_the_least_of_their_margins_together():
    loops = [random_loop(1, 10), random_loop(1, 11), random_loop(1, 12), random_loop(1, 13)]
    alone = [disk_margins(loop, 1.0).together.alpha for loop in loops]
    found = disk_margins(diagonal(loops), 1.0)
    np.testing.assert_allclose([margin.alpha for margin in found.loops], alone, rtol=1e-6)
    assert found.together.alpha == pytest.approx(min(alone), rel=1e-6)


def test_factors_at_the_margin_make_the_loops_unstable_and_smaller_ones_do_not():
    loop = random_loop(2, 3)
    margin = disk_margins(loop, 1.0).together
    random = np.random.default_rng(0)
    for _ in range(200):  # real factors within the disk
        delta = 0.99 * margin.alpha * random.uniform(-1.0, 1.0, 2)
        factors = (1.0 + 0.5 * delta) / (1.0 - 0.5 * delta)
        assert np.max(np.abs(np.linalg.eigvals(loop.A - loop.B * factors @ loop.C))) < 1.0
    # the worst pair of complex factors puts a pole on the circle, where det(I + L F) = 0
    z = np.exp(2j * np.pi * margin.frequency)
    response = loop.response([z])[0]
    phases = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 721))
    first, second = np.meshgrid(margin.alpha * phases, margin.alpha * phases)
    f, g = ((1.0 + 0.5 * delta) / (1.0 - 0.5 * delta) for delta in (first, second))
    determinant = (1.0 + response[0, 0] * f) * (1.0 + response[1, 1] * g) - response[0, 1] * response[1, 0] * f * g
    assert np.min(np.abs(determinant)) < 0.02 * np.median(np.abs(determinant))


def test_an_unstable_loop_has_no_margin():
    found = disk_margins(StateSpace(np.eye(1), 2.5 * np.eye(1), np.eye(1), np.zeros((1, 1))), 1.0)
    assert found.together.alpha == 0.0
    assert found.together.gain_margin == 0.0
    assert found.together.phase_margin == 0.0


def test_a_loop_has_to_be_square():
    with pytest.raises(ParameterError, match="as many outputs as inputs"):
        disk_margins(StateSpace(np.eye(1), np.ones((1, 2)), np.eye(1), np.zeros((1, 2))), 1.0)
