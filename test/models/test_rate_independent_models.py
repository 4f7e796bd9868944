# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Properties of every hysteresis model: no memory of speed, continuity, exact states, equivariance, return points."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from interpreted import interpreted
from rate_independent_support import (
    MODELS,
    STROKE,
    bouc_wen,
    built,
    duhem,
    outputs,
    prandtl_ishlinskii,
    preisach,
    ramps,
)

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block

WITH_RETURN_POINTS = ("prandtl_ishlinskii", "preisach")
voltages = st.lists(st.floats(-40.0, 160.0), min_size=1, max_size=10)
names = pytest.mark.parametrize("name", MODELS)


def walked(name, turns, points=1):
    block = built(name)
    block.simulate(ramps(turns, points))
    return block


@names
@settings(max_examples=30)
@given(turns=voltages, points=st.integers(2, 60))
def test_output_does_not_depend_on_the_number_of_steps(name, turns, points):
    tolerance = 1e-6 if name == "bouc_wen_squared" else 1e-9
    one, many = walked(name, turns), walked(name, turns, points)
    np.testing.assert_allclose(many.x[1], one.x[1], rtol=0.0, atol=tolerance * STROKE)


@names
@settings(max_examples=30)
@given(turns=voltages, side=st.sampled_from([-1e-7, 1e-7]))
def test_output_is_continuous_at_reversals(name, turns, side):
    block = walked(name, turns)
    before = block.x[1]
    assert abs(block.step(turns[-1] + side) - before) < 1e-6 * 0.3e-6


@pytest.mark.slow
@names
@settings(max_examples=30)
@given(turns=voltages, ahead=voltages)
def test_state_is_restored_exactly(name, turns, ahead):
    block = walked(name, turns)
    kept = block.state
    expected = block.simulate(ahead)
    block.state = kept
    np.testing.assert_array_equal(block.simulate(ahead), expected)
    block.reset()
    np.testing.assert_array_equal(block.simulate(ramps(turns, 1)), built(name).simulate(ramps(turns, 1)))


@names
@settings(max_examples=30)
@given(turns=voltages, scale=st.sampled_from([0.01, 3.0, 1e3]))
def test_outputs_scale_with_the_parameters(name, turns, scale):
    plain, scaled = built(name).simulate(turns), built(name, scale).simulate(turns)
    np.testing.assert_allclose(scaled, scale * plain, rtol=1e-9, atol=1e-9 * scale * STROKE)


@pytest.mark.slow
@names
@settings(max_examples=30)
@given(turns=voltages, change=st.floats(0.9, 1.1))
def test_new_parameters_do_not_move_the_output(name, turns, change):
    block = walked(name, turns)
    before, voltage = float(block.x[1]), float(block.x[0])
    block.retune(MODELS[name][1](change))
    assert block.step(voltage) == before
    assert block.step(voltage + 1e-7) == pytest.approx(before, abs=1e-6 * 0.3e-6)
    assert block.step(voltage - 1e-7) == pytest.approx(before, abs=1e-6 * 0.3e-6)
    assert np.all(np.isfinite(block.simulate(ramps([150.0, -30.0, 100.0], 20))))


@names
def test_nan_holds(name):
    block = walked(name, [80.0, 30.0])
    kept = block.state
    assert block.step(float("nan")) == kept[1]
    np.testing.assert_array_equal(block.x, kept)


@names
def test_loops_are_open_and_rise(name):
    block = walked(name, [120.0, 0.0])
    up, down = block.simulate(ramps([120.0], 50)), block.simulate(np.linspace(120.0, 0.0, 51)[1:])
    assert np.all(np.diff(up) > 0.0) and np.all(np.diff(down) < 0.0)
    assert 0.03 < (down[24] - up[24]) / (up[-1] - down[-1]) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_RETURN_POINTS)
@settings(max_examples=50)
@given(turns=voltages, inner=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6), ahead=voltages)
def test_minor_loops_close_and_are_forgotten(name, turns, inner, ahead):
    """A return to a turning point gives the output there, and the later output is that without the loop."""
    last, before = turns[-1], ([0.0, *turns])[-2]
    # excursions between the last two turning points, which must not erase older ones
    excursion = [last + share * (before - last) for share in inner]
    straight, around = walked(name, turns), walked(name, turns)
    returned = around.simulate([*excursion, last])[-1] if before != last else straight.x[1]
    assert returned == pytest.approx(straight.x[1], abs=1e-12 * STROKE)
    np.testing.assert_allclose(around.simulate(ahead), straight.simulate(ahead), rtol=0.0, atol=1e-11 * STROKE)


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_RETURN_POINTS)
@settings(max_examples=30)
@given(turns=voltages, ahead=voltages)
def test_a_larger_peak_wipes_out_the_past(name, turns, ahead):
    one, other = built(name), built(name)
    for block, past in ((one, turns), (other, [])):
        block.simulate([-40.0, *past, 160.0, -40.0])
    np.testing.assert_allclose(one.simulate(ahead), other.simulate(ahead), rtol=0.0, atol=1e-11 * STROKE)


def test_every_type_is_built_by_name_and_refuses_another_structure():
    groups = {
        "bouc_wen": bouc_wen(),
        "duhem": duhem(),
        "prandtl_ishlinskii": prandtl_ishlinskii(),
        "preisach": preisach(),
    }
    for kind, given_parameters in groups.items():
        parameters = HysteresisParameters(type=kind, **{kind: given_parameters})
        block = hysteresis_block(parameters, 1e-3)
        assert type(block) is parameters.model.block
        again = HysteresisParameters.from_mapping(parameters.to_mapping())
        assert again == parameters
        assert 0.5e-7 < block.gain < 2e-7
    fewer = dataclasses.replace(prandtl_ishlinskii(), radii=(0.0, 5.0), weights=(1e-8, 1e-8))
    block = built("prandtl_ishlinskii")
    with pytest.raises(ParameterError, match=r"radii = 2.*keep 8"):
        block.retune(fewer)


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="kernels are interpreted already")
def test_compiled_models_equal_interpreted_ones(tmp_path):
    other = interpreted("rate_independent_support", "outputs()", tmp_path)
    np.testing.assert_allclose(outputs(), other, rtol=0.0, atol=1e-12 * STROKE)
