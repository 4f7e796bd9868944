# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Range, slew rate and quantisation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models import limits as model
from hysteresis_ros.models.limits import Limits, LimitsParameters

inputs = st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=40)


def test_range_is_clipped_flagged_and_counted():
    block = Limits(LimitsParameters(minimum=-30.0, maximum=120.0), 1e-3)
    np.testing.assert_array_equal(block.simulate([50.0, 200.0, -80.0, 0.0]), [50.0, 120.0, -30.0, 0.0])
    assert block.x[model.LIMITED_SAMPLES] == 2.0
    assert not block.saturated
    block.step(121.0)
    assert block.saturated
    assert block.x[model.FLAGS] == model.RANGE


@pytest.mark.parametrize("excess, limited", [(1e-6, False), (1e-3, True)])
def test_an_excess_smaller_than_a_step_of_any_converter_is_clipped_but_does_not_count(excess, limited):
    block = Limits(LimitsParameters(minimum=-30.0, maximum=120.0), 1e-3)
    for voltage, end in ((-30.0 - excess, -30.0), (120.0 + excess, 120.0)):
        assert block.step(voltage) == end and block.saturated == limited
    assert block.x[model.LIMITED_SAMPLES] == 2.0 * limited


def test_slew_rate_is_volts_per_second():
    block = Limits(LimitsParameters(minimum=0.0, maximum=100.0, slew_rate=1000.0), 1e-3)
    np.testing.assert_allclose(block.simulate([10.0] * 3 + [0.0]), [1.0, 2.0, 3.0, 2.0])
    assert block.x[model.FLAGS] == model.SLEWING


def test_slow_slew_is_not_caught_on_a_grid_point():
    block = Limits(LimitsParameters(minimum=0.0, maximum=100.0, slew_rate=10.0, bits=4), 1e-3)
    assert block.simulate(np.full(11000, 100.0))[-1] == pytest.approx(100.0)


@given(bits=st.integers(1, 32), u=st.floats(-40.0, 130.0))
def test_quantisation_is_idempotent_and_within_half_a_step(bits, u):
    block = Limits(LimitsParameters(minimum=-30.0, maximum=120.0, bits=bits), 1e-3)
    v = block.step(u)
    assert abs(v - min(max(u, -30.0), 120.0)) <= 0.5 * block.p[model.STEP] * (1.0 + 1e-6)
    assert block.step(v) == v
    assert int(block.x[model.FLAGS]) & model.QUANTISED == 0


def test_grid_has_two_to_the_bits_values():
    block = Limits(LimitsParameters(minimum=-1.0, maximum=1.0, bits=3), 1.0)
    values = np.unique(block.simulate(np.linspace(-1.0, 1.0, 1001)))
    np.testing.assert_allclose(values, np.linspace(-1.0, 1.0, 8), atol=1e-15)


@given(u=inputs)
def test_never_outside_the_range_nor_faster_than_the_slew_rate(u):
    block = Limits(LimitsParameters(minimum=-30.0, maximum=120.0, slew_rate=5e3), 1e-3)
    v = np.append(0.0, block.simulate(u))
    assert v.min() >= -30.0
    assert v.max() <= 120.0
    assert np.abs(np.diff(v)).max() <= 5.0 + 1e-12


def test_nan_holds_and_counts_as_limited():
    block = Limits(LimitsParameters(minimum=0.0, maximum=10.0), 1.0)
    block.step(4.0)
    assert block.step(float("nan")) == 4.0
    assert block.saturated


def test_quantisation_is_no_saturation():
    block = Limits(LimitsParameters(minimum=0.0, maximum=10.0, bits=4), 1.0)
    for voltage in (3.3, 7.1, 3.3):
        block.step(voltage)
        assert block.x[model.FLAGS] == model.QUANTISED and model.is_limited(block.x) == 0.0
        assert not block.saturated and block.limited_samples == 0
    block.step(11.0)
    assert model.is_limited(block.x) == 1.0 and block.saturated and block.limited_samples == 1


def test_empty_range_is_refused():
    with pytest.raises(ParameterError, match="minimum = 5.0: must be below maximum"):
        Limits(LimitsParameters(minimum=5.0, maximum=5.0), 1.0)


def test_starts_at_the_allowed_voltage_next_to_zero():
    assert Limits(LimitsParameters(minimum=6.0, maximum=120.0), 1.0).x[model.OUTPUT] == 6.0
