# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Discrete linear dynamics: Kim's realisation, unit DC gain, closed forms, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters, linear_output, zero_order_hold

A = (0.5856, 1.3305, -0.9172, -1.3085, 0.0475, -0.1471, -0.7609, 0.0803, -0.0809)
B = (-0.7318, -0.3533, 0.2288)
C = (-0.8674, 0.7907, 0.3855)
KIM = LinearParameters(A=A, B=B, C=C, output_scale=1e-6)
SAMPLE_TIME = 1.0 / 3000.0


def test_kim_has_2_05_micrometres_a_volt_and_unit_gain_in_si():
    assert KIM.state_space.dc_gain == pytest.approx(2.05, abs=0.005)
    assert KIM.resolved_input_scale == pytest.approx(2.05e-6, abs=0.005e-6)
    block = LinearDynamics(KIM, SAMPLE_TIME)
    assert block.simulate(np.full(20000, 3e-6))[-1] == pytest.approx(3e-6, rel=1e-9)


def test_kim_uncontrolled_step_peaks_and_settles_as_published():
    """One volt before the amplifier: peak 3.70 µm, within 2 % after 0.51 s (K7, K9a)."""
    block = LinearDynamics(KIM, SAMPLE_TIME)
    y = 1e6 * block.simulate(np.full(3000, KIM.resolved_input_scale))
    assert y.max() == pytest.approx(3.70, abs=0.02)
    outside = np.flatnonzero(np.abs(y - 2.05) > 0.02 * 2.05)
    assert (outside[-1] + 2) * SAMPLE_TIME == pytest.approx(0.51, abs=0.02)


def test_kim_resonates_at_635_hz():
    poles = KIM.state_space.poles
    frequencies = np.abs(np.angle(poles)) / (2 * np.pi * SAMPLE_TIME)
    assert np.min(np.abs(frequencies - 635.0)) < 2.0


def test_agrees_with_scipy_and_delays_by_one_sample():
    block = LinearDynamics(KIM, SAMPLE_TIME)
    u = np.random.default_rng(0).standard_normal(200)
    model = KIM.state_space
    _, expected, _ = dlsim((model.A, model.B, model.C, model.D, 1.0), np.append(u, 0.0))
    scale = KIM.output_scale / KIM.resolved_input_scale
    np.testing.assert_allclose(block.simulate(u), scale * expected[1:, 0], atol=1e-12)


def test_zero_order_hold_of_a_lag_is_an_exponential():
    a, b = zero_order_hold([[-100.0]], [[100.0]], 1e-3)
    assert a[0, 0] == pytest.approx(np.exp(-0.1))
    assert b[0, 0] == pytest.approx(1.0 - np.exp(-0.1))
    continuous = np.array([[0.0, 1.0], [-4e6, -20.0]]), np.array([[0.0], [4e6]])
    expected = cont2discrete((*continuous, np.eye(2), np.zeros((2, 1))), 1e-4)
    for mine, theirs in zip(zero_order_hold(*continuous, 1e-4), expected[:2], strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-10)


def test_without_matrices_the_output_is_the_input():
    block = LinearDynamics(LinearParameters(), 1.0)
    np.testing.assert_array_equal(block.simulate([1.0, -2.0]), [1.0, -2.0])


def test_feedthrough_acts_on_the_input_held_last():
    block = LinearDynamics(LinearParameters(A=(0.5,), B=(1.0,), C=(1.0,), D=(3.0,), input_scale=1.0), 1.0)
    np.testing.assert_allclose(block.simulate([1.0, 0.0]), [4.0, 0.5])


def test_settle_is_the_fixed_point():
    block = LinearDynamics(KIM, SAMPLE_TIME)
    block.settle(4e-6)
    assert linear_output(block.p, block.x) == pytest.approx(4e-6, rel=1e-12)
    np.testing.assert_allclose(block.simulate(np.full(50, 4e-6)), 4e-6, rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(A=(1.0, 2.0, 3.0)), "A = .*n·n numbers"),
        (dict(A=(0.5,), B=(1.0, 2.0), C=(1.0,)), "B = .*must be 1 numbers"),
        (dict(A=(1.01,), B=(1.0,), C=(1.0,)), "A = .*unstable.*1.01"),
        (dict(A=(0.5,), B=(0.0,), C=(1.0,)), "input_scale.*cannot be derived"),
        (dict(A=(0.5,), B=(1.0,), C=(1.0,), D=(1.0, 2.0)), "D = .*one number"),
    ],
)
def test_refusals_name_the_parameter(changes, message):
    with pytest.raises(ParameterError, match=message):
        LinearDynamics(LinearParameters(**changes), 1.0)


def test_order_is_fixed_while_running():
    block = LinearDynamics(KIM, SAMPLE_TIME)
    with pytest.raises(ParameterError, match="must have 3 rows"):
        block.retune(LinearParameters(A=(0.5,), B=(1.0,), C=(1.0,)))
