# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The clamp: normal force in closed form, lag, holding force, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.clamp import (
    Clamp,
    ClampParameters,
    FirstOrderParameters,
    LagParameters,
    SecondOrderParameters,
)
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.polynomial import assumed_stack
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.linear import zero_order_hold
from hysteresis_ros.models.sensor import SensorParameters

STEP = 1e-4
FAST = LagParameters(first_order=FirstOrderParameters(time_constant=1e-6))
PARAMETERS = ClampParameters(
    limits=LimitsParameters(minimum=0.0, maximum=120.0),
    hysteresis=HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=1e-7)),
    lag=FAST,
    gap=4e-6,
    stiffness=4e6,
    static_friction=0.3,
    kinetic_friction=0.25,
)
STACK = HysteresisParameters(type="polynomial", polynomial=assumed_stack(voltage_low=0.0))


def second_order(frequency, damping):
    return LagParameters(type="second_order", second_order=SecondOrderParameters(frequency=frequency, damping=damping))


@pytest.mark.parametrize("voltage", [0.0, 30.0, 40.0, 40.1, 100.0, 120.0, 150.0])
def test_normal_force_is_the_compression_of_the_contact(voltage):
    """N = w K max(0, x - gap); below the gap the clamp is open; the amplifier stops at 120 V."""
    clamp = Clamp(PARAMETERS, STEP)
    expected = 4e6 * max(0.0, 1e-7 * min(voltage, 120.0) - 4e-6)
    assert clamp.advance(voltage) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert PARAMETERS.normal_force(voltage) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert PARAMETERS.holding_force(voltage) == pytest.approx(0.3 * expected, rel=1e-9, abs=1e-9)
    worn = replace(PARAMETERS, wear=0.8)
    assert worn.holding_force(voltage) == pytest.approx(0.8 * 0.3 * expected, rel=1e-9, abs=1e-9)
    assert Clamp(worn, STEP).advance(voltage) == pytest.approx(0.8 * expected, rel=1e-9, abs=1e-9)


def test_hysteresis_holds_more_on_the_way_back():
    clamp = Clamp(replace(PARAMETERS, hysteresis=STACK), STEP)
    rising = [clamp.advance(v) for v in (0.0, 60.0, 120.0)]
    assert clamp.advance(60.0) > rising[1] + 1.0
    assert clamp.advance(0.0) == 0.0


@pytest.mark.parametrize("voltage", [50.0, 80.0, 120.0])
def test_holding_force_is_never_more_than_any_cycle_gives(voltage):
    parameters = replace(PARAMETERS, hysteresis=STACK)
    clamp = Clamp(parameters, STEP)
    forces = []
    for v in (voltage, 0.0, voltage, 0.0, voltage):
        forces.append(0.3 * [clamp.advance(v) for _ in range(5)][-1])
    assert min(forces[::2]) == pytest.approx(parameters.holding_force(voltage), rel=1e-6)


def test_first_order_lag():
    """63 % of a step after one time constant, and the stated settling time exact to the sample."""
    clamp = Clamp(replace(PARAMETERS, lag=LagParameters(first_order=FirstOrderParameters(time_constant=5e-4))), STEP)
    x = []
    for _ in range(100):
        clamp.advance(100.0)
        x.append(clamp.displacement)
    n = np.arange(1, 101)
    np.testing.assert_allclose(x, 1e-5 * -np.expm1(-n * STEP / 5e-4), rtol=1e-12)
    settling = clamp.parameters.settling_time(0.02)
    assert settling == pytest.approx(5e-4 * np.log(50.0))
    outside = n[np.abs(np.array(x) - 1e-5) > 0.02e-5] * STEP
    assert settling - STEP <= outside.max() <= settling


@given(st.floats(10.0, 4000.0), st.floats(0.01, 5.0) | st.just(1.0))
def test_second_order_lag_is_the_exact_discretisation(frequency, damping):
    lag = second_order(frequency, damping).discrete(STEP)
    omega = 2.0 * np.pi * frequency
    A, B = zero_order_hold([[0.0, omega], [-omega, -2.0 * damping * omega]], [0.0, omega], STEP)
    # the general matrix exponential squares repeatedly and loses digits if the norm is large
    tolerance = 1e-12 * (1.0 + damping * omega * STEP)
    np.testing.assert_allclose(lag.A, A.ravel(), atol=tolerance)
    np.testing.assert_allclose(lag.B, B.ravel(), atol=tolerance)


@pytest.mark.parametrize("damping", [0.05, 0.5, 0.9999999, 1.0, 1.0000001, 1.5, 4.0])
def test_second_order_settling_time_is_an_upper_bound(damping):
    clamp = Clamp(replace(PARAMETERS, lag=second_order(600.0, damping)), 1e-5)
    settling = clamp.parameters.settling_time(0.01)
    x = []
    for _ in range(6000):
        clamp.advance(100.0)
        x.append(clamp.displacement)
    time = np.arange(1, 6001) * 1e-5
    last = time[np.abs(np.array(x) - 1e-5) > 0.01e-5].max()
    assert last <= settling + 1e-9
    if damping >= 1.0:
        assert settling <= last + 2e-5


def test_slew_rate_lengthens_the_settling():
    slow = replace(PARAMETERS, limits=LimitsParameters(minimum=0.0, maximum=120.0, slew_rate=1.2e5))
    assert slow.settling_time() == pytest.approx(1e-3 + PARAMETERS.settling_time())


def test_starts_and_resets_at_the_initial_voltage():
    clamp = Clamp(replace(PARAMETERS, hysteresis=STACK, initial_voltage=100.0, lag=second_order(800.0, 0.5)), STEP)
    before = clamp.state
    assert clamp.voltage == 100.0 and clamp.normal_force == pytest.approx(4e6 * (1.025e-5 - 4e-6))
    assert clamp.measure() == clamp.displacement
    held = [clamp.advance(100.0) for _ in range(50)]
    np.testing.assert_allclose(held, held[0], rtol=1e-12)
    clamp.advance(20.0)
    clamp.reset()
    assert np.array_equal(clamp.state, before)


def test_sensor_noise_and_state():
    clamp = Clamp(replace(PARAMETERS, sensor=SensorParameters(noise=2e-9, seed=7)), STEP)
    clamp.advance(100.0)
    saved = clamp.state
    first = [clamp.measure() for _ in range(500)]
    assert np.std(np.array(first) - clamp.displacement) == pytest.approx(2e-9, rel=0.15)
    clamp.state = saved
    assert [clamp.measure() for _ in range(500)] == first


def test_retune_takes_numbers_and_refuses_structure():
    clamp = Clamp(PARAMETERS, STEP)
    clamp.advance(100.0)
    clamp.retune(replace(PARAMETERS, wear=0.5, gap=5e-6))
    assert clamp.advance(100.0) == pytest.approx(0.5 * 4e6 * 5e-6)
    before = clamp.state, [p.copy() for p in clamp.ps]
    for wrong, name in (
        (replace(PARAMETERS, lag=second_order(500.0, 0.5)), "lag.type"),
        (replace(PARAMETERS, hysteresis=STACK), "hysteresis.type"),
        (replace(PARAMETERS, stiffness=0.0), "stiffness"),
    ):
        with pytest.raises(ParameterError, match=name):
            clamp.retune(wrong)
        assert np.array_equal(clamp.state, before[0])
        assert all(np.array_equal(p, was) for p, was in zip(clamp.ps, before[1], strict=True))


@pytest.mark.parametrize(
    "wrong, text",
    [
        (dict(gap=12.1e-6), r"gap = .*never grips: at limits.maximum = 120 V"),
        (dict(gap=1.4e-6, hysteresis=STACK), r"gap = .*never opens: after .* at limits.minimum = 0 V"),
        (dict(stiffness=-1.0), "stiffness = -1.0"),
        (dict(kinetic_friction=0.31), r"kinetic_friction = 0.31: must not be above static_friction = 0.3"),
        (dict(initial_voltage=130.0), r"initial_voltage = 130.0: must lie within"),
        (dict(wear=1.2), "wear = 1.2"),
        (dict(lag=LagParameters()), "lag.first_order.time_constant = None: missing"),
    ],
)
def test_wrong_parameters_are_named(wrong, text):
    with pytest.raises(ParameterError, match=text):
        Clamp(replace(PARAMETERS, **wrong), STEP)
