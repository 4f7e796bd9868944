# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The force in the stack: Newton's law, its value at rest, its zeros below the poles, delays, noise and high-pass."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.control.margins import plant_state_space
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.linear import zero_order_hold

STACK, FLEXURE, GAIN = 2e7, 2.5e6, 2e-7
OMEGA, DAMPING, T = 2.0 * math.pi * 700.0, 0.01, 5e-5


def actuator(sample_time: float = T, **changes) -> Actuator:
    A, B = zero_order_hold([[0.0, 1.0], [-(OMEGA**2), -2.0 * DAMPING * OMEGA]], [[0.0], [OMEGA**2]], sample_time)
    given_ = {
        "hysteresis.type": "proportional",
        "hysteresis.proportional.gain": GAIN,
        "limits.minimum": -100.0,
        "limits.maximum": 100.0,
        "dynamics.A": tuple(A.ravel().tolist()),
        "dynamics.B": tuple(B[:, 0].tolist()),
        "dynamics.C": (1.0, 0.0),
        "dynamics.sample_time": sample_time,
        "force_sensor.stack_stiffness": STACK,
        "force_sensor.flexure_stiffness": FLEXURE,
    }
    return Actuator(ActuatorParameters.from_mapping(given_ | changes), sample_time)


def followed(made: Actuator, voltages) -> np.ndarray:
    """Return displacement and force at each sample, shape (2, N)."""
    found = []
    for voltage in voltages:
        found.append((made.measure(), made.measure_force()))
        made.advance(voltage)
    return np.array(found).T


def test_the_force_is_what_moves_the_mass():
    # m y″ + c y′ + k_f y = F with m = (k_a + k_f)/ω², c = 2 ζ ω m, by central differences of a fast recording
    step, mass = 1e-6, (STACK + FLEXURE) / OMEGA**2
    y, force = followed(actuator(step), 10.0 * np.sin(2.0 * np.pi * 400.0 * step * np.arange(4000)))
    velocity = (y[2:] - y[:-2]) / (2.0 * step)
    acceleration = (y[2:] - 2.0 * y[1:-1] + y[:-2]) / step**2
    moved = mass * acceleration + 2.0 * DAMPING * OMEGA * mass * velocity + FLEXURE * y[1:-1]
    # the force at a sample is the mean of the held forces before and after it, at the displacement there
    acting = 0.5 * (force[1:-1] + force[2:] + STACK * (y[2:] - y[1:-1]))
    assert np.max(np.abs(moved - acting)) < 2e-5 * np.max(np.abs(force))


@pytest.mark.slow
def test_at_rest_it_is_that_of_the_flexure_and_the_zeros_lie_below_the_poles():
    y, force = followed(actuator(), np.full(20_000, 10.0))
    assert y[-1] == pytest.approx(10.0 * GAIN, rel=1e-9)
    assert force[-1] == pytest.approx(FLEXURE * y[-1], rel=1e-9)
    acted = plant_state_space(actuator(0.01 * T).parameters.dynamics, acting=True)
    zero = math.sqrt(FLEXURE / (STACK + FLEXURE)) * OMEGA

    def size(omega):
        both = acted.response([np.exp(0.01j * omega * T)])[0, :, 0]
        return abs((STACK + FLEXURE) * both[1] - STACK * both[0])

    around = np.linspace(0.5 * zero, 2.0 * zero, 3001)
    found = around[np.argmin([size(omega) for omega in around])]
    assert found == pytest.approx(zero, rel=5e-3) and found < OMEGA
    assert size(OMEGA) > 10.0 * (STACK + FLEXURE)


@settings(max_examples=20, deadline=None)
@given(st.sampled_from([0.0, 0.4, 1.0, 1.3, 2.0]), st.lists(st.floats(-50.0, 50.0), min_size=4, max_size=12))
def test_it_follows_from_what_acts_behind_the_delay(delay, voltages):
    made = actuator(**{"dynamics.delay": delay * T})
    y, force = followed(made, voltages)
    whole, part = int(delay), delay - int(delay)
    given_ = np.concatenate([np.zeros(whole + 2), GAIN * np.array(voltages)])
    acting = [(1.0 - part) * given_[k + 1] + part * given_[k] for k in range(len(voltages))]
    assert force == pytest.approx((STACK + FLEXURE) * np.array(acting) - STACK * y, abs=1e-9)


def test_a_sensor_that_loses_what_is_slow_and_has_noise_of_its_own():
    plain, lossy = actuator(), actuator(**{"force_sensor.high_pass": 50.0})
    voltages = np.full(4000, 10.0)
    (_, true), (_, read) = followed(plain, voltages), followed(lossy, voltages)
    slow, wanted, part = 0.0, [], 1.0 - math.exp(-2.0 * math.pi * 50.0 * T)
    for force in true:
        wanted.append(force - slow)
        slow += part * (force - slow)
    assert read == pytest.approx(wanted, abs=1e-9) and abs(read[-1]) < 0.01 * true[-1]
    noisy = actuator(**{"force_sensor.noise": 0.01})
    first = followed(noisy, np.zeros(4000))[1]
    assert np.std(first) == pytest.approx(0.01, rel=0.05)
    noisy.reset()
    assert np.array_equal(followed(noisy, np.zeros(4000))[1], first)


def test_without_a_sensor_there_is_no_force_and_with_one_the_displacement_is_the_same():
    bare, with_it = actuator(**{"force_sensor.stack_stiffness": 0.0}), actuator(**{"force_sensor.noise": 0.1})
    voltages = 20.0 * np.random.default_rng(1).standard_normal(50)
    (y, nothing), (same, _) = followed(bare, voltages), followed(with_it, voltages)
    assert np.all(np.isnan(nothing)) and np.array_equal(y, same)
    with pytest.raises(ParameterError, match=r"force_sensor\.stack_stiffness.*clean up and configure again"):
        bare.retune(with_it.parameters)
    with pytest.raises(ParameterError, match=r"flexure_stiffness = 0.*above 0"):
        actuator(**{"force_sensor.flexure_stiffness": 0.0})
