# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Adaptation of weights: known weights are found, invalid data do no harm, and without excitation nothing changes."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from hysteresis_ros.models import adaptation as adapting
from hysteresis_ros.models.adaptation import Adaptation, AdaptationParameters, adapt, adaptable, drive
from hysteresis_ros.models.compensator import Compensator, CompensatorParameters
from hysteresis_ros.models.creep import Creep, CreepParameters, LogarithmicCreepParameters
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters, hysteresis_block
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters

SAMPLE_TIME = 1.0 / 500.0
#: A lag of four samples and a delay of one and a half.
LAG = LinearParameters(A=(0.8,), B=(0.2,), C=(1.0,), sample_time=SAMPLE_TIME, delay=1.5 * SAMPLE_TIME)
CREEP = CreepParameters(type="logarithmic", logarithmic=LogarithmicCreepParameters(rate=0.02))
QUICK = {"memory": 4.0, "rate": 1.0, "slow": 0.2, "dynamics": LAG}


def given(name="prandtl_ishlinskii"):
    return HysteresisParameters(type=name, **{name: MODELS[name].example})


def made(hysteresis, creep=CREEP, **settings):
    """Return a compensator and the adaptation of its weights."""
    limits = LimitsParameters(minimum=-20.0, maximum=120.0)
    compensator = Compensator(CompensatorParameters(InverseParameters(), hysteresis, creep, limits), SAMPLE_TIME)
    return compensator, Adaptation(AdaptationParameters(type="recursive", **{**QUICK, **settings}), compensator)


def triangle(seconds, low=5.0, high=95.0, frequency=2.0):
    phase = frequency * SAMPLE_TIME * np.arange(round(seconds / SAMPLE_TIME))
    return low + (high - low) * np.abs((phase + 0.5) % 1.0 * 2.0 - 1.0)


def measured_of(hysteresis, voltages, dynamics=LAG, creep=CREEP):
    """Return the measurement of an actuator with this hysteresis: sample k is taken before the k-th voltage acts."""
    moved = hysteresis_block(hysteresis, SAMPLE_TIME).simulate(voltages)
    behind = LinearDynamics(dynamics, SAMPLE_TIME).simulate(Creep(creep, SAMPLE_TIME).simulate(moved))
    return np.concatenate([[0.0], behind[:-1]])


def run(compensator, adaptation, voltages, measured, usable=1.0):
    """Give voltages and measurements to the adaptation, sample by sample."""
    block, xs = compensator.hysteresis, adaptation.xs
    history = np.empty((len(voltages), len(xs.factors)))
    for k, (voltage, value) in enumerate(zip(voltages, measured, strict=True)):
        adapt(adaptation.settings, xs, block.p, block.x, compensator.voltage, value, usable)
        compensator.hold(voltage)
        drive(adaptation.settings, xs, compensator.creep.p, block.p, block.x, compensator.voltage)
        history[k] = xs.factors
    return history


def weighted(hysteresis, factors):
    return hysteresis.changed(hysteresis.model.weighted(hysteresis.chosen, np.asarray(factors)))


@functools.cache
def learned(name, scale, delay=1.5):
    """Return what is learned on an actuator: weights times ``scale``, those that widen loops times another 1.2."""
    model = given(name)
    compensator, adaptation = made(model)
    true = np.array([scale * (1.2 if opens else 1.0) for opens in adaptation.terms.opening])
    voltages = triangle(25.0)
    dynamics = LinearParameters(A=(0.8,), B=(0.2,), C=(1.0,), sample_time=SAMPLE_TIME, delay=delay * SAMPLE_TIME)
    history = run(compensator, adaptation, voltages, 3e-6 + measured_of(weighted(model, true), voltages, dynamics))
    return true, history, compensator, adaptation


@pytest.mark.slow
@pytest.mark.parametrize("name", ["prandtl_ishlinskii", "generalised_play", "proportional"])
@pytest.mark.parametrize("scale", [0.8, 1.2])
def test_known_weights_are_found_behind_creep_lag_delay_and_an_offset(name, scale):
    true, history, compensator, adaptation = learned(name, scale)
    np.testing.assert_allclose(history[-1], true, rtol=0.01)
    # the compensator now inverts this model: its loop is that of the actuator, except for a constant
    voltages = triangle(1.0)
    actuator = hysteresis_block(weighted(given(name), true), SAMPLE_TIME).simulate(voltages)
    model = hysteresis_block(adaptation.hysteresis, SAMPLE_TIME).simulate(voltages)
    assert np.ptp(model - actuator) < 2e-3 * np.ptp(actuator)
    np.testing.assert_array_equal(compensator.hysteresis.p, compensator.hysteresis.pack(adaptation.hysteresis.chosen))


def test_a_delay_that_is_not_modelled_is_taken_for_hysteresis():
    """The purpose of the dynamics: without them, a delay is learned as weights that widen the loop."""
    true, history, *_ = learned("prandtl_ishlinskii", 0.8, delay=5.5)
    opened = history[-1][1:] / true[1:]
    assert np.all(opened > 1.03)


def test_the_minimum_is_that_of_the_normal_equations():
    """Closed form: the weights of one window, solved at once, equal those of the recursion."""
    _, history, _, adaptation = learned("prandtl_ishlinskii", 1.2)
    count = len(history[-1])
    squares = adaptation.xs.squares.reshape(count, count)
    prior = adaptation.settings.prior.reshape(count, count)
    wanted = np.linalg.solve(squares + prior, adaptation.xs.products + prior @ np.ones(count))
    np.testing.assert_allclose(history[-1], wanted, rtol=1e-3)
    np.testing.assert_array_equal(squares, squares.T)


def test_noise_and_spikes_and_nothing_at_all_keep_within_bounds():
    model = given()
    random = np.random.default_rng(5)
    compensator, adaptation = made(model, range=1.3, rate=0.1)
    voltages = triangle(8.0)
    nonsense = random.choice([np.nan, np.inf, 1.0, -1e-5, 2e-5, 0.0], len(voltages)) * random.normal(size=len(voltages))
    history = run(compensator, adaptation, voltages, nonsense)
    assert history.min() >= 1.0 / 1.3 and history.max() <= 1.3
    assert np.abs(np.diff(history, axis=0)).max() <= 0.1 * SAMPLE_TIME * (1.0 + 1e-9)
    assert np.all(np.isfinite(np.concatenate(adaptation.xs)))
    assert np.all(np.array(adaptation.hysteresis.chosen.weights) > 0.0)
    # and the adaptation forgets it
    voltages = triangle(25.0)
    history = run(compensator, adaptation, voltages, measured_of(model, voltages))
    np.testing.assert_allclose(history[-1], 1.0, rtol=0.02)


def test_what_is_forgotten_does_not_pull_the_factors_afterwards():
    """The model is right: after forgetting, as before, nothing has to change."""
    model = given()
    compensator, adaptation = made(model)
    voltages = triangle(6.0)
    measured = measured_of(model, voltages)
    before = run(compensator, adaptation, voltages[:1500], measured[:1500])
    adaptation.forget()
    after = run(compensator, adaptation, voltages[1500:], measured[1500:])
    assert np.max(np.abs(before - 1.0)) < 0.01 and np.max(np.abs(after - 1.0)) < 0.01


def test_a_sensor_of_the_wrong_sign_ends_at_the_bound():
    compensator, adaptation = made(given(), range=1.25)
    voltages = triangle(8.0)
    history = run(compensator, adaptation, voltages, -measured_of(given(), voltages))
    np.testing.assert_allclose(history[-1], 0.8, rtol=1e-9)


@pytest.mark.slow
def test_without_excitation_nothing_moves_however_long():
    true, history, *_ = learned("prandtl_ishlinskii", 0.8)
    compensator, adaptation = made(given())
    voltages = np.concatenate([triangle(10.0), np.full(12000, 50.0), triangle(2.0)])
    measured = measured_of(weighted(given(), true), voltages)
    measured[5000:] += np.interp(np.arange(13000), [0, 12000], [0.0, 2e-6])  # and a drift at the same time
    before = run(compensator, adaptation, voltages[:8000], measured[:8000])[-1].copy()
    states = [array.copy() for array in (adaptation.xs.squares, adaptation.xs.products)]
    assert adaptation.condition == adapting.UNEXCITED
    paused = run(compensator, adaptation, voltages[8000:17000], measured[8000:17000])
    np.testing.assert_array_equal(paused - before, 0.0)
    for now, then in zip((adaptation.xs.squares, adaptation.xs.products), states, strict=True):
        np.testing.assert_array_equal(now, then)
    after = run(compensator, adaptation, voltages[17000:], measured[17000:])
    assert adaptation.condition == adapting.ADAPTING
    np.testing.assert_allclose(after[-1], true, rtol=0.03)


def test_the_voltage_does_not_jump_when_the_weights_change():
    compensator, adaptation = made(given(), rate=0.05, creep=CreepParameters())
    commands = np.interp(triangle(6.0), [0.0, 100.0], [1e-6, 7e-6])
    block, steps, before = compensator.hysteresis, [], compensator.step(commands[0])
    for command in commands:
        adapt(adaptation.settings, adaptation.xs, block.p, block.x, compensator.voltage, 1.4 * command, 1.0)
        voltage = compensator.step(command)
        drive(adaptation.settings, adaptation.xs, compensator.creep.p, block.p, block.x, voltage)
        steps.append(abs(voltage - before))
        before = voltage
    _, fixed = made(given(), creep=CreepParameters())
    unchanged = np.abs(np.diff(fixed.compensator.simulate(commands))).max()
    assert np.ptp(adaptation.factors) > 0.01 and max(steps[100:]) < 1.3 * unchanged


def test_models_that_are_not_linear_in_weights_are_refused_by_name():
    assert adaptable() == ("generalised_play", "prandtl_ishlinskii", "proportional")
    for name in set(MODELS) - set(adaptable()):
        (problem,) = AdaptationParameters(type="recursive").fits(given(name), "general")
        assert f"{name} is not linear in its weights" in problem.remedy and "prandtl_ishlinskii" in problem.remedy


@pytest.mark.parametrize(
    ("settings", "inverse", "said"),
    [
        ({}, "none", "the inverse none does not use the weights; use exact"),
        ({"factors": (1.0, 1.0)}, "exact", "one factor for each of the 5 weights of prandtl_ishlinskii"),
        ({"factors": (1.0,) * 4 + (3.0,)}, "exact", "must lie within 1/range … range = 0.5 … 2"),
    ],
)
def test_what_does_not_fit_is_refused(settings, inverse, said):
    (problem,) = AdaptationParameters(type="recursive", **settings).fits(given(), inverse)
    assert said in problem.remedy
