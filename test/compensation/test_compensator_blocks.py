# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Compensator: inverse, limits, achieved command, retune, state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from compensator_support import GAIN, KINDS, SAMPLE_TIME, STROKE, compensator, offline, parameters, triangle
from hypothesis import given
from hypothesis import strategies as st
from interpreted import interpreted

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.compensator import BIAS, Compensator
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis, assumed_stack
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters

commands = st.lists(st.floats(-2e-6, 15e-6), min_size=1, max_size=15)


def steps(block, inputs):
    return np.array([block.step(value) for value in inputs])


@pytest.mark.slow
@given(wanted=commands)
def test_exact_inverse_before_the_same_stack_gives_the_command(wanted):
    block, plant = compensator(minimum=-60.0, maximum=200.0), PolynomialHysteresis(assumed_stack(), SAMPLE_TIME)
    for command in wanted:
        assert plant.step(block.step(command)) == pytest.approx(command, abs=1e-9 * STROKE)
        assert block.applied == pytest.approx(command, abs=1e-9 * STROKE)
        assert not block.saturated


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@given(wanted=commands)
def test_applied_is_what_the_model_does_at_the_voltage_put_out(kind, wanted):
    block = compensator(kind, slew_rate=5e4, bits=12)
    model = PolynomialHysteresis(assumed_stack(), SAMPLE_TIME)
    for command in wanted:
        voltage = block.step(command)
        assert -30.0 <= voltage <= 120.0
        expected = GAIN * voltage if kind == "none" else model.step(voltage)
        assert block.applied == pytest.approx(expected, abs=1e-12 * STROKE)


def test_saturation_is_told():
    block = compensator()
    assert block.step(20e-6) == 120.0
    assert block.saturated
    assert block.applied == pytest.approx(STROKE)
    block.step(10e-6)
    assert not block.saturated


def test_none_divides_by_the_gain_of_the_model():
    np.testing.assert_allclose(steps(compensator("none"), [1e-6, 5e-6]), [1e-6 / GAIN, 5e-6 / GAIN])


def test_residual_is_removed_by_a_small_negative_voltage():
    """After 20 V the stack keeps 0.25 µm; no positive voltage takes it back to zero (K9d)."""
    block = compensator()
    steps(block, [20.0 * GAIN, 0.25e-6])
    assert block.voltage == pytest.approx(0.0, abs=1e-9)
    assert -30.0 < block.step(0.0) < 0.0
    assert block.applied == pytest.approx(0.0, abs=1e-9 * STROKE)


def test_hold_puts_out_a_voltage_and_the_model_follows():
    block = compensator()
    block.step(8e-6)
    assert block.hold(10.0) == 10.0
    model = PolynomialHysteresis(assumed_stack(), SAMPLE_TIME)
    expected = model.simulate([8e-6 / GAIN, 10.0])[-1]
    assert block.applied == pytest.approx(expected, rel=1e-12)


def test_nan_command_holds():
    block = compensator()
    before = block.step(4e-6)
    assert block.step(float("nan")) == before


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@given(wanted=commands, scale=st.floats(0.9, 1.1))
def test_retune_is_bumpless_and_gives_way_to_the_new_model(kind, wanted, scale):
    block = compensator(kind)
    steps(block, wanted)
    before = block.voltage
    block.retune(parameters(kind, scale=scale))
    assert block.step(wanted[-1]) == pytest.approx(before, abs=1e-6)
    steps(block, np.full(200, wanted[-1]))
    assert block.xs.out[BIAS] == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_after_a_retune_the_new_gain_is_reached(kind):
    block = compensator(kind)
    steps(block, [6e-6] * 5)
    block.retune(parameters(kind, scale=1.05))
    steps(block, np.full(200, 6e-6))
    steps(block, np.linspace(6e-6, 1.05 * STROKE, 50))
    assert block.voltage == pytest.approx(120.0, abs=0.05 if kind == "picard_steps" else 1e-6)


@pytest.mark.parametrize(("end", "command"), [("maximum", 1.0), ("minimum", -1.0)])
def test_after_a_retune_all_of_a_wider_range_is_reached(end, command):
    """A root search that kept its old ends would stop there."""
    block = compensator("general")
    steps(block, [3e-6] * 5)
    block.retune(parameters("general", **{end: 200.0 * command}))
    steps(block, np.full(200, 1e-3 * command))
    assert block.voltage == 200.0 * command


@pytest.mark.parametrize("part", [0.0, 0.5, 1.0, 1.2])
def test_one_picard_step_goes_by_its_rate(part):
    """V = 2 V_r − R H(V_r): with H(V) = g V and R = part/g, (2 − part) V_r; R = 0 stands for 1/g."""
    given = parameters("picard_steps")
    model = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=GAIN))
    inverse = replace(given.inverse, picard_steps=1, picard_rate=part / GAIN)
    block = Compensator(replace(given, hysteresis=model, inverse=inverse), SAMPLE_TIME)
    assert block.step(2e-6) == pytest.approx((2.0 - (part or 1.0)) * 2e-6 / GAIN, rel=1e-12)


def test_refused_retune_changes_nothing():
    block = compensator()
    steps(block, triangle(50))
    before = block.state
    with pytest.raises(ParameterError, match=r"falling_C1|rising_C1"):
        broken = HysteresisParameters(type="polynomial", polynomial=assumed_stack(opening=0.6))
        block.retune(replace(block.parameters, hysteresis=broken))
    with pytest.raises(ParameterError, match=r"inverse.type.*fixed"):
        block.retune(parameters("none"))
    np.testing.assert_array_equal(block.state, before)


@pytest.mark.parametrize("kind", KINDS)
def test_state_restores_exactly_and_reset_starts_anew(kind):
    block = compensator(kind, bits=16, slew_rate=3e4)
    first = steps(block, triangle())
    kept = block.state
    ahead = steps(block, triangle())
    other = compensator(kind, bits=16, slew_rate=3e4)
    other.state = kept
    np.testing.assert_array_equal(steps(other, triangle()), ahead)
    block.reset()
    np.testing.assert_array_equal(steps(block, triangle()), first)


def test_wrong_parameters_are_named():
    with pytest.raises(ParameterError, match=r"safe_voltage = 130.0.*-30 … 120"):
        Compensator(replace(parameters(), safe_voltage=130.0), SAMPLE_TIME)
    with pytest.raises(ParameterError, match=r"inverse.type.*picard_steps"):
        Compensator(parameters("perfect"), SAMPLE_TIME)


def test_proportional_model():
    proportional = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=2e-7))
    block = Compensator(replace(parameters(), hysteresis=proportional), SAMPLE_TIME)
    assert block.step(1e-6) == pytest.approx(5.0)
    assert block.applied == pytest.approx(1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_compiled_loop_equals_calls_of_step_bit_for_bit(kind):
    np.testing.assert_array_equal(offline(kind), steps(compensator(kind, bits=16, slew_rate=3e4), triangle()))


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="kernels are interpreted already")
def test_compiled_equals_interpreted(tmp_path):
    others = interpreted("compensator_support", "[offline(kind) for kind in KINDS]", tmp_path)
    np.testing.assert_allclose([offline(kind) for kind in KINDS], others, rtol=0, atol=1.2e-10)
