# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Polynomial branch hysteresis: corners, continuity, rate independence, exact inverse, retune."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.hysteresis import polynomial as model
from hysteresis_ros.models.hysteresis.polynomial import (
    PolynomialHysteresis,
    assumed_stack,
    polynomial,
    polynomial_inverse,
)

STROKE = 120.0 * 0.1025e-6
# whole microvolts: the continuity of a loop of 1e-300 V cannot be tested with a probe of 1e-9 V
voltages = st.lists(st.floats(-30.0, 160.0).map(lambda v: round(v, 6)), min_size=1, max_size=12)
coefficients = st.lists(st.floats(-1.0, 1.0), min_size=21, max_size=21)


def stack(**changes):
    return PolynomialHysteresis(assumed_stack(**changes), 1e-3)


def ramps(turns, points=40):
    """Voltage that goes from 0 V straight from one turning voltage to the next."""
    turns = [0.0, *turns]
    return np.concatenate([np.linspace(a, b, points + 1)[1:] for a, b in zip(turns, turns[1:], strict=False)])


def walked(turns, **changes):
    block = stack(**changes)
    block.simulate(ramps(turns))
    return block


def test_loop_to_120_volt_has_the_stated_corners_and_opening():
    block = stack()
    virgin = block.simulate(np.linspace(0.0, 120.0, 121))
    falling = block.simulate(np.linspace(120.0, 0.0, 121))
    rising = block.simulate(np.linspace(0.0, 120.0, 121))
    np.testing.assert_allclose(virgin, 0.1025e-6 * np.arange(121), atol=1e-18)
    assert falling[-1] == pytest.approx(1.5e-6, abs=1e-18)
    assert rising[-1] == pytest.approx(12.3e-6, abs=1e-18)
    opening = falling[::-1] - rising
    assert np.argmax(opening) == 60
    assert opening[60] == pytest.approx(0.15 * 12.3e-6, rel=1e-12)


def test_twenty_volt_leave_the_paper_s_residual():
    assert walked([20.0, 0.0]).x[model.DISPLACEMENT] == pytest.approx(0.25e-6, rel=1e-12)


def test_falling_branch_goes_on_below_zero():
    block = walked([120.0, -30.0])
    expected = model.falling_curve(block.p, 120.0, -30.0)
    assert block.x[model.DISPLACEMENT] == pytest.approx(expected, rel=1e-13)
    assert expected < 0.0


@pytest.mark.slow
@given(turns=voltages)
def test_output_is_continuous_at_every_reversal_for_any_coefficients(turns):
    """A tiny step in either direction from any turning point changes the output by a tiny amount only."""
    rng = np.random.default_rng(len(turns))
    p = np.append(rng.uniform(-1.0, 1.0, 21) * np.tile([1.0, 1e-2, 1e-4], 7), 120.0)
    check_continuity(p, turns)


@pytest.mark.slow
@given(p=coefficients, turns=voltages)
@settings(max_examples=50)
def test_output_is_continuous_for_coefficients_that_fit_nothing(p, turns):
    check_continuity(np.array([*p, 120.0]), turns)


def check_continuity(p, turns):
    block = stack()
    block.p[:] = p
    block.reset()
    size = float(np.abs(p[:21]).max()) * 200.0**4 + 1.0
    for voltage in turns:
        before = float(block.x[model.VOLTAGE])
        assume(abs(voltage - before) > 1e-3)
        for side in (-1e-9, 1e-9):
            x = block.x.copy()
            assert abs(polynomial(block.p, x, before + side) - block.x[model.DISPLACEMENT]) < 1e-9 * size
        block.step(voltage)


@pytest.mark.slow
@given(turns=voltages)
def test_output_is_continuous_along_a_whole_path(turns):
    """A step of 0.1 V moves a stack of 0.1 µm/V by at most 2.5 times 0.1 V times that gain."""
    path = np.concatenate([[0.0], *[[v] for v in turns]])
    fine = np.concatenate(
        [np.linspace(a, b, max(2, int(abs(b - a) / 0.1)) + 1)[1:] for a, b in zip(path, path[1:], strict=False)]
    )
    steps = np.abs(np.diff(stack().simulate(fine)))
    assert steps.max(initial=0.0) <= 2.5 * 0.1 * 0.1025e-6 * 1.01


@pytest.mark.slow
@given(turns=voltages, parts=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8))
def test_rate_independent(turns, parts):
    """The output depends on the turning voltages only, not on the number of samples between them."""
    coarse, fine = stack(), stack()
    for start, end in zip([0.0, *turns], turns, strict=False):
        y = coarse.step(end)
        for part in sorted(parts):
            fine.step(start + part * (end - start))
        assert fine.step(end) == pytest.approx(y, abs=1e-12 * STROKE)


@given(inner=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=8))
def test_returns_to_the_corners_of_the_major_loop(inner):
    block = walked([100.0, *inner])
    assert block.step(100.0) == pytest.approx(10.25e-6, abs=1e-12 * STROKE)
    assert block.step(0.0) == pytest.approx(1.25e-6, abs=1e-12 * STROKE)


def test_returns_to_a_negative_corner():
    block = walked([100.0, -20.0])
    corner = block.x[model.DISPLACEMENT]
    block.simulate(ramps([50.0, 10.0, 60.0])[1:])
    assert block.step(-20.0) == pytest.approx(corner, abs=1e-12 * STROKE)


def test_stack_at_rest_may_be_driven_negative_first():
    block = walked([-10.0, -4.0, -10.0])
    again = walked([-10.0]).x[model.DISPLACEMENT]
    assert block.x[model.DISPLACEMENT] == pytest.approx(again, abs=1e-12 * STROKE)
    assert block.step(20.0) == pytest.approx(20.0 * 0.1025e-6, rel=1e-12)


@pytest.mark.slow
@given(inner=st.lists(st.floats(0.0, 90.0), min_size=2, max_size=2), at=st.floats(0.0, 1.0))
def test_a_tiny_reversal_leads_back_onto_the_same_branch(inner, at):
    low, high = sorted(inner)
    assume(high - low > 1e-3)
    direct, detour = walked([100.0, low, high]), walked([100.0, low, high])
    detour.simulate([high - 1e-6, high])
    voltage = high + at * (100.0 - high)
    assert detour.step(voltage) == pytest.approx(direct.step(voltage), abs=1e-6 * STROKE)


@pytest.mark.slow
@given(turns=voltages, target=st.floats(-30.0, 160.0))
@settings(max_examples=300)
def test_inverse_of_forward_is_the_identity(turns, target):
    """For any history, within and above V_max, and below 0 V down to -30 V."""
    block = walked(turns)
    trial = block.x.copy()
    wanted = polynomial(block.p, trial, target)
    before = block.state
    scratch = np.zeros(len(block.x) + 2)
    voltage = polynomial_inverse(polynomial, np.zeros(1), scratch, block.p, block.x, wanted)
    np.testing.assert_array_equal(block.state, before)
    assert block.step(voltage) == pytest.approx(wanted, abs=1e-9 * STROKE)
    assert voltage == pytest.approx(target, abs=1e-6)


@pytest.mark.slow
def test_inverse_beyond_a_parabola_is_its_extremum():
    curve = dataclasses.replace(assumed_stack(), virgin=(0.0, 0.2e-6, -0.8e-9), voltage_high=120.0)
    block = PolynomialHysteresis(curve, 1.0)
    voltage = polynomial_inverse(polynomial, np.zeros(1), np.zeros(13), block.p, block.x, 1.0)
    assert voltage == pytest.approx(0.2e-6 / (2 * 0.8e-9))


def test_a_new_peak_moves_the_lower_end_back_to_zero():
    """A fall below 0 V sets the lower end; a larger peak resets it, and its loops close at 0 V again."""
    for turns in ([60.0, -20.0, 120.0, 90.0], [60.0, -20.0, 120.0, 60.0, 90.0]):
        block = walked([*turns, 0.0])
        assert block.x[model.DISPLACEMENT] == pytest.approx(model.falling_curve(block.p, 120.0, 0.0), abs=1e-16)
        block = walked([*turns, 0.0, 120.0])
        assert block.x[model.DISPLACEMENT] == pytest.approx(0.1025e-6 * 120.0, rel=1e-12)
    # without the larger peak they close at the end of the fall
    block = walked([60.0, -20.0, 40.0, 50.0, 20.0, -20.0])
    assert block.x[model.DISPLACEMENT] == pytest.approx(model.falling_curve(block.p, 60.0, -20.0), rel=1e-12)


def test_nan_holds():
    block = walked([50.0])
    before = block.state
    assert block.step(float("nan")) == before[model.DISPLACEMENT]
    np.testing.assert_array_equal(block.state, before)
    scratch = np.zeros(13)
    assert polynomial_inverse(polynomial, np.zeros(1), scratch, block.p, block.x, float("nan")) == 50.0


@pytest.mark.slow
@given(turns=voltages, scale=st.floats(0.9, 1.1))
def test_retune_is_bumpless_and_ends_on_the_new_curves(turns, scale):
    block = walked(turns)
    voltage, before = float(block.x[model.VOLTAGE]), float(block.x[model.DISPLACEMENT])
    block.retune(assumed_stack(scale=scale))
    for side in (-1e-9, 0.0, 1e-9):
        # If the range for blending is narrow, the curve is steep: the distance to a corner limits the slope.
        room = min(abs(voltage - corner) or 1e9 for corner in (block.x[model.V_MAX], 120.0, block.x[model.V_LOW]))
        bound = 1e-9 * (1.0 + 0.3 * STROKE / max(room, 1e-9))
        assert abs(polynomial(block.p, block.x.copy(), voltage + side) - before) <= max(bound, 1e-15)
    if voltage < 115.0:
        top = max(120.0, block.x[model.V_MAX])
        assert block.step(top) == pytest.approx(scale * 0.1025e-6 * top, rel=1e-9)


@pytest.mark.slow
@given(turns=voltages, later=voltages)
def test_state_restores_exactly(turns, later):
    block = walked(turns)
    kept = block.state
    first = block.simulate(ramps(later))
    other = stack()
    other.state = kept
    np.testing.assert_array_equal(other.simulate(ramps(later)), first)


def test_scale_multiplies_everything():
    path = ramps([100.0, 20.0, 70.0, -10.0])
    np.testing.assert_allclose(stack(scale=1.05).simulate(path), 1.05 * stack().simulate(path), rtol=1e-12)
    assert stack(scale=1.05).gain == pytest.approx(1.05 * 0.1025e-6)


def test_decreasing_branch_is_refused_with_its_name():
    with pytest.raises(ParameterError, match="falling_C1.*slope"):
        stack(opening=0.6)
    with pytest.raises(ParameterError, match="virgin.*slope"):
        PolynomialHysteresis(dataclasses.replace(assumed_stack(), virgin=(0.0, 0.1e-6, -1e-9)), 1.0)
    with pytest.raises(ParameterError, match="rising_C2.*exactly 3"):
        PolynomialHysteresis(dataclasses.replace(assumed_stack(), rising_C2=(1.0,)), 1.0)


def test_variant_is_chosen_by_type():
    polynomial_stack = hysteresis_block(HysteresisParameters(type="polynomial", polynomial=assumed_stack()), 1e-3)
    assert polynomial_stack.gain == pytest.approx(0.1025e-6)
    linear_stack = hysteresis_block(
        HysteresisParameters.from_mapping({"type": "proportional", "proportional.gain": 1e-7}), 1e-3
    )
    assert linear_stack.step(30.0) == pytest.approx(3e-6)
    with pytest.raises(ParameterError, match="polynomial.virgin.*missing"):
        HysteresisParameters.from_mapping({"type": "polynomial"})
