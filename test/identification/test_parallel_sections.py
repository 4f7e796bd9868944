# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Filters of many columns at once, and the linear part that consists of them."""

import numpy as np
import pytest
import scipy.signal

from hysteresis_ros.identification.linear_systems import LinearPart, Mode, Section, filtered
from hysteresis_ros.identification.plant_model import simulate_chain
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters

SECTIONS = [Section(0.3), Section(0.2, 0.1, a1=-0.9), Section(0.05, 0.1, -0.02, -1.6, 0.8), Section(0.0, 0.0, 0.4)]
STEP = 1e-3
MODES = (Mode(100.0, 0.03, 0.4, 0.1), Mode(190.0, 0.1, 0.1, -0.2))


def walk(columns: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(columns).standard_normal((400, columns)), axis=0)


@pytest.mark.parametrize("columns", [1, 2, 7])
def test_the_sum_of_sections_is_the_sum_of_their_filters(columns):
    table = walk(columns)
    expected = sum(scipy.signal.lfilter(one[:3], (1.0, *one[3:]), table, axis=0) for one in SECTIONS)
    np.testing.assert_allclose(filtered(table, SECTIONS), expected, rtol=1e-11, atol=1e-11)
    # a table in another order of memory
    np.testing.assert_array_equal(filtered(np.asfortranarray(table), SECTIONS), filtered(table, SECTIONS))


def test_sections_without_recursion_scale_and_leave_the_columns_unchanged():
    table = walk(3)
    before = table.copy()
    np.testing.assert_array_equal(filtered(table, [Section(0.5), Section(0.25)]), 0.75 * before)
    filtered(table, SECTIONS)
    np.testing.assert_array_equal(table, before)


@pytest.mark.parametrize("hold", [0.0, STEP])
@pytest.mark.parametrize("modes", [(), MODES])
@pytest.mark.parametrize("lag", [0.0, 4e-3])
@pytest.mark.parametrize("delay", [0.0, 2.3e-3])
def test_columns_are_convolved_with_the_impulse_response(hold, modes, lag, delay):
    part = LinearPart(lag=lag, delay=delay, creep_rate=0.02, modes=modes, hold=hold)
    table = walk(4)
    response = part.impulse(len(table), STEP)
    expected = np.column_stack([np.convolve(column, response)[: len(table)] for column in table.T])
    found = part.apply(table, STEP)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(part.apply(table[:, 2], STEP), expected[:, 2], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("modes", [(), MODES])
def test_a_movement_that_is_linear_between_the_samples_is_late_by_the_delay(modes):
    # far behind a ramp, lag, modes and delay only shift: by their group delay
    part = LinearPart(lag=4e-3, delay=2.3e-3, modes=modes)
    ramp = np.arange(4000) * STEP
    late = ramp[-1] - part.apply(ramp, STEP)[-1]
    assert late == pytest.approx(part.group_delay, rel=1e-6)


def test_a_settled_part_starts_at_rest_under_the_first_sample():
    part = LinearPart(lag=4e-3, creep_rate=0.02, settled=True)
    np.testing.assert_allclose(part.apply(np.full(50, 3.0), STEP), 3.0 * part.settled_gain, rtol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.2, 1.3])
@pytest.mark.parametrize("lag", [0.0, 0.1, 0.4, 3.0])
def test_under_a_held_voltage_the_blocks_of_the_nodes_are_as_late_as_the_filters(lag, delay):
    """A sample is measured before its voltage acts, however short lag and delay are beside it."""
    part = LinearPart(lag=lag * STEP, delay=delay * STEP, hold=STEP)
    if not lag + delay:
        assert not part.synchronous(STEP)
        return
    gain = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=1e-7))
    voltage = 50.0 + walk(1)[:, 0]
    same = part.synchronous(STEP)
    moved = simulate_chain(gain, CreepParameters(), part.dynamics(STEP), voltage, STEP, synchronous=same)
    late = np.convolve(1e-7 * voltage, part.impulse(voltage.size, STEP))[: voltage.size]
    np.testing.assert_allclose(moved, late, atol=2e-9)
