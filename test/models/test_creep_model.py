# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Creep: the logarithmic law, exact first-order operators, no operators, and creep inside an actuator."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.creep import (
    Creep,
    CreepOperatorsParameters,
    CreepParameters,
    LogarithmicCreepParameters,
    creep_inverse,
)
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.polynomial import assumed_stack
from hysteresis_ros.models.limits import LimitsParameters

LOGARITHMIC = CreepParameters(
    type="logarithmic", logarithmic=LogarithmicCreepParameters(rate=0.015, longest_time=1000.0)
)
OPERATORS = CreepParameters(
    type="operators", operators=CreepOperatorsParameters(weights=(0.02, 0.03), time_constants=(0.5, 20.0))
)


def actuator(creep):
    return Actuator(
        ActuatorParameters(
            limits=LimitsParameters(minimum=-30.0, maximum=120.0),
            hysteresis=HysteresisParameters(type="polynomial", polynomial=assumed_stack()),
            creep=creep,
        ),
        1e-3,
    )


@pytest.mark.skipif(not COMPILED, reason="a million samples in plain Python")
def test_step_follows_the_logarithmic_law():
    """1 + γ lg(t/0.1 s) over four decades, within 2 % of the creep until then."""
    block = Creep(LOGARITHMIC, 1e-3)
    y = block.simulate(np.full(1_000_001, 1.0))
    for time in (0.1, 1.0, 10.0, 100.0, 1000.0):
        assert y[round(time * 1000)] == pytest.approx(1.0 + 0.015 * np.log10(time / 0.1), abs=0.02 * 0.06)
    assert y[100] == pytest.approx(1.0, abs=1e-12)


def test_operators_are_exact_at_the_samples():
    y = Creep(OPERATORS, 0.1).simulate(np.ones(500))
    t = 0.1 * np.arange(500)
    expected = 1.0 + 0.02 * (1.0 - np.exp(-t / 0.5)) + 0.03 * (1.0 - np.exp(-t / 20.0))
    np.testing.assert_allclose(y, expected, rtol=1e-12)


@pytest.mark.parametrize("parameters", [LOGARITHMIC, OPERATORS, CreepParameters()])
def test_feedforward_inverse_gives_the_command(parameters):
    block = Creep(parameters, 0.01)
    for command in np.random.default_rng(1).normal(size=300):
        assert block.step(creep_inverse(block.p, block.x, command)) == pytest.approx(command, abs=1e-13)


def test_without_creep_every_bit_is_kept():
    block = Creep(CreepParameters(), 1e-3)
    u = np.random.default_rng(2).normal(size=100) * 1e-6
    np.testing.assert_array_equal(block.simulate(u), u)
    np.testing.assert_array_equal([creep_inverse(block.p, block.x, value) for value in u], u)


def test_actuator_creeps_behind_its_hysteresis():
    plain, creeping = actuator(CreepParameters()), actuator(OPERATORS)
    for _ in range(3000):
        for plant in (plain, creeping):
            plant.measure()
            plant.advance(100.0)
    ratio = creeping.displacement / plain.displacement
    t = 2.998
    expected = 1.0 + 0.02 * (1.0 - np.exp(-t / 0.5)) + 0.03 * (1.0 - np.exp(-t / 20.0))
    assert ratio == pytest.approx(expected, rel=1e-9)
    kept = creeping.state
    ahead = [(creeping.measure(), creeping.advance(50.0)) for _ in range(20)]
    creeping.state = kept
    assert [(creeping.measure(), creeping.advance(50.0)) for _ in range(20)] == ahead


def test_structure_is_fixed_while_running():
    plant = actuator(OPERATORS)
    with pytest.raises(ParameterError, match=r"creep.type.*fixed while running"):
        plant.retune(dataclasses.replace(plant.parameters, creep=CreepParameters()))
    faster = CreepOperatorsParameters(weights=(0.01, 0.03), time_constants=(0.2, 20.0))
    plant.retune(dataclasses.replace(plant.parameters, creep=dataclasses.replace(OPERATORS, operators=faster)))


def test_what_has_no_inverse_is_refused():
    with pytest.raises(ParameterError, match=r"operators.weights.*must be as many numbers as time_constants \(1\)"):
        Creep(CreepParameters(type="operators", operators=CreepOperatorsParameters((0.1, 0.1), (1.0,))), 1e-3)
    with pytest.raises(ParameterError, match=r"operators.weights.*partial sums above -1"):
        Creep(CreepParameters(type="operators", operators=CreepOperatorsParameters((-1.1,), (1.0,))), 1e-3)
    with pytest.raises(ParameterError, match=r"longest_time.*above reference_time"):
        wrong = LogarithmicCreepParameters(rate=0.01, longest_time=0.05)
        Creep(CreepParameters(type="logarithmic", logarithmic=wrong), 1e-3)
