# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Duhem: f and g from branches (W3) reproduce the major loop; the inverse equation (W4); warnings; what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.hysteresis.duhem import DuhemHysteresis, DuhemParameters, shape_functions, spline_slopes

V = np.linspace(-1.0, 1.0, 41)
OPENING = 0.12


def rising(v):
    """A smooth rising branch from (-1, -1) to (1, 1), and its mirror image."""
    return v - OPENING * (1.0 - v**2) + 0.1 * (v**3 - v), 1.0 + 2.0 * OPENING * v + 0.1 * (3.0 * v**2 - 1.0)


def falling(v):
    return v + OPENING * (1.0 - v**2) + 0.1 * (v**3 - v), 1.0 - 2.0 * OPENING * v + 0.1 * (3.0 * v**2 - 1.0)


def from_branches(alpha, up=rising, down=falling, **changes):
    """Return the model by W3 with the correct signs."""
    (a, a_slope), (d, d_slope) = up(V), down(V)
    f = 0.5 * (a + d) + (a_slope - d_slope) / (2.0 * alpha)
    g = 0.5 * (a_slope + d_slope) + 0.5 * alpha * (a - d)
    given = dict(alpha=alpha, input_low=-1.0, input_high=1.0, output_low=-1.0, output_high=1.0)
    given |= dict(input_start=-1.0, output_start=-1.0, shape="spline", f_spline=tuple(f), g_spline=tuple(g))
    return DuhemParameters(**(given | changes))


@pytest.mark.parametrize("alpha", [1.0, 3.0, 80.0])
def test_major_loop_comes_back(alpha):
    block = DuhemHysteresis(from_branches(alpha), 1e-3)
    v = np.linspace(-1.0, 1.0, 101)
    for _ in range(2):
        np.testing.assert_allclose(block.simulate(v), rising(v)[0], rtol=0.0, atol=2e-5)
        np.testing.assert_allclose(block.simulate(v[::-1]), falling(v[::-1])[0], rtol=0.0, atol=2e-5)


def test_inverse_equation_returns_the_voltage():
    """W4: the branches of the inverse are those of the loop with exchanged axes, the rising one above the other."""
    alpha = 3.0
    v = np.linspace(-1.0, 1.0, 4001)

    def exchanged(branch):
        w, slope = branch(v)
        return lambda at: (np.interp(at, w, v), 1.0 / np.interp(at, w, slope))

    inverse = DuhemHysteresis(from_branches(alpha, exchanged(rising), exchanged(falling)), 1e-3)
    forward = DuhemHysteresis(from_branches(alpha), 1e-3)
    drive = np.concatenate([v[::20], v[::-20]])
    np.testing.assert_allclose(inverse.simulate(forward.simulate(drive)), drive, rtol=0.0, atol=1e-3)


def test_paper_s_alpha_first_moves_the_wrong_way_and_says_so():
    """α = 80 only switches between the branches (W7)."""
    paper, mild = from_branches(80.0), from_branches(1.0)
    assert "wrong way" in paper.warnings()[0] or "not positive" in paper.warnings()[0]
    assert mild.warnings() == ()
    block = DuhemHysteresis(paper, 1e-3)
    at_turn = block.simulate([0.0])[0]
    assert block.step(-0.01) > at_turn
    block = DuhemHysteresis(mild, 1e-3)
    at_turn = block.simulate([0.0])[0]
    assert block.step(-0.01) < at_turn


def test_not_a_knot_spline_reproduces_cubics():
    x = np.arange(7.0)
    np.testing.assert_allclose(spline_slopes(x**3 - 2.0 * x), 3.0 * x**2 - 2.0, atol=1e-11)


def test_units_do_not_matter():
    """The same normalised numbers in volts and metres give the same loop."""
    plain = from_branches(3.0)
    changes = dict(alpha=3.0 / 60.0, input_low=0.0, input_high=120.0, output_low=0.0, output_high=12e-6)
    scaled = dataclasses.replace(plain, **changes, input_start=0.0, output_start=0.0)
    drive = np.sin(0.05 * np.arange(300)) * np.exp(-0.005 * np.arange(300))
    y = DuhemHysteresis(plain, 1e-3).simulate(drive)
    np.testing.assert_allclose(
        DuhemHysteresis(scaled, 1e-3).simulate(60.0 + 60.0 * drive), 6e-6 * (1.0 + y), atol=1e-16
    )


def test_beyond_the_range_f_goes_on_straight():
    f, g = shape_functions(from_branches(1.0), [1.0, 1.5, 2.0])
    assert f[2] - f[1] == pytest.approx(f[1] - f[0])
    assert g[0] == g[1] == g[2]


def test_wrong_sizes_and_ranges_are_named():
    with pytest.raises(ParameterError, match=r"input_high = -2.*above input_low"):
        DuhemHysteresis(from_branches(1.0, input_high=-2.0), 1e-3)
    with pytest.raises(ParameterError, match=r"f_network.*3 m \+ 1"):
        DuhemHysteresis(from_branches(1.0, shape="network", f_network=(1.0, 2.0, 3.0)), 1e-3)
    with pytest.raises(ParameterError, match=r"g_spline.*as many numbers as f_spline: 41"):
        DuhemHysteresis(from_branches(1.0, g_spline=(1.0,) * 5), 1e-3)
