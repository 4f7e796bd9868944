# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Generalised, rate-dependent plays: the slow limit, the area of loops, envelopes, and the inverse in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.compensator import Compensator, CompensatorParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.generalised_play import (
    MODEL,
    SPEED,
    GeneralisedPlayHysteresis,
    GeneralisedPlayParameters,
)
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import (
    PrandtlIshlinskiiHysteresis,
    PrandtlIshlinskiiParameters,
)
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.models.limits import LimitsParameters

T = 1e-3
PLAIN = replace(MODEL.example, rate=0.0, rising_bend=0.0, falling_bend=0.0)
RATED = replace(PLAIN, rate=4e-3, memory=8e-3)


def triangle(amplitude: float, period: float, cycles: int) -> np.ndarray:
    """Return a triangle between minus and plus the amplitude, from 0 V on, with its corners at samples."""
    quarter = round(0.25 * period / T)
    one = np.concatenate([np.linspace(a, b, 2 * quarter + 1)[1:] for a, b in ((1.0, -1.0), (-1.0, 1.0))])
    return amplitude * np.concatenate([np.linspace(0.0, 1.0, quarter + 1)[1:], np.tile(one, cycles)])


def test_without_envelopes_and_rate_it_is_the_classical_model():
    voltage = np.random.default_rng(0).uniform(-40.0, 100.0, 500)
    classical = PrandtlIshlinskiiParameters(radii=(0.0, *PLAIN.radii), weights=(PLAIN.slope, *PLAIN.weights))
    wanted = PrandtlIshlinskiiHysteresis(classical, T).simulate(voltage)
    np.testing.assert_allclose(GeneralisedPlayHysteresis(PLAIN, T).simulate(voltage), wanted, rtol=0.0, atol=1e-18)


@pytest.mark.parametrize("period", [40.0, 400.0])
def test_slow_movement_is_that_of_the_thresholds_at_rest(period):
    voltage = triangle(60.0, period, 1)
    difference = [GeneralisedPlayHysteresis(given, T).simulate(voltage) for given in (PLAIN, RATED)]
    speed = 240.0 / period
    assert np.max(np.abs(difference[1] - difference[0])) <= RATED.rate * speed * sum(RATED.weights) * (1.0 + 1e-6)
    assert np.max(np.abs(difference[1] - difference[0])) > 0.5 * RATED.rate * speed * sum(RATED.weights)


@pytest.mark.parametrize("period", [0.4, 0.8, 4.0])
def test_the_area_of_a_loop_is_that_of_its_widened_plays(period):
    """A play of threshold r under a triangle of ±A encloses 4 r (A - r); |V'| = 4 A/period does not change."""
    amplitude = 60.0
    voltage = triangle(amplitude, period, 5)
    y = GeneralisedPlayHysteresis(RATED, T).simulate(voltage)
    last = slice(len(voltage) - round(period / T) - 1, None)
    enclosed = abs(
        float(np.trapezoid(y[last], voltage[last]) if hasattr(np, "trapezoid") else np.trapz(y[last], voltage[last]))
    )
    radii = np.array(RATED.radii) + RATED.rate * 4.0 * amplitude / period
    assert enclosed == pytest.approx(
        float(np.sum(np.array(RATED.weights) * 4.0 * radii * (amplitude - radii))), rel=2e-3
    )


def test_the_branches_follow_the_envelopes():
    given = replace(MODEL.example, rate=0.0, voltage_low=-20.0, voltage_high=100.0)
    voltage = np.concatenate(
        [np.linspace(0.0, 100.0, 201), np.linspace(100.0, -20.0, 241), np.linspace(-20.0, 100.0, 241)]
    )
    y = GeneralisedPlayHysteresis(given, T).simulate(voltage)
    for first, bend, side in ((201, given.falling_bend, 1.0), (442, given.rising_bend, -1.0)):
        part = slice(first + 160, first + 235)  # where all plays move
        place = (voltage[part] - 40.0) / 60.0
        curve = voltage[part] + 0.5 * bend * 60.0 * (place**2 - 1.0)
        wanted = given.slope * voltage[part] + sum(
            w * (curve + side * r) for r, w in zip(given.radii, given.weights, strict=True)
        )
        np.testing.assert_allclose(y[part], wanted, rtol=1e-12)


def test_the_speed_is_averaged_over_the_memory():
    block = GeneralisedPlayHysteresis(RATED, T)
    block.simulate(0.5 * np.arange(1, 13))  # 500 V/s for 12 ms
    assert block.x[SPEED] == pytest.approx(500.0 * (1.0 - np.exp(-0.012 / RATED.memory)), rel=1e-12)


def test_held_still_the_thresholds_narrow_to_those_at_rest():
    fast = np.concatenate([np.linspace(0.0, 80.0, 41), np.full(600, 80.0)])
    block, slow = GeneralisedPlayHysteresis(RATED, T), GeneralisedPlayHysteresis(PLAIN, T)
    y = block.simulate(fast)
    assert block.x[SPEED] < 1e-9
    assert y[-1] == pytest.approx(slow.simulate(fast)[-1], rel=1e-12) and y[-1] > y[40] + 1e-8
    assert np.all(np.diff(y[41:]) >= 0.0)


shapes = st.fixed_dictionaries(
    {
        "rate": st.sampled_from([0.0, 3e-4, 5e-3]),
        "falling_bend": st.floats(-0.85, 0.0),
        "rising_bend": st.floats(0.0, 0.85),
        "slope": st.floats(2e-8, 1e-7),
        "memory": st.sampled_from([1e-2, 0.1]),
    }
)


def test_an_inverse_that_may_swing_is_warned_of():
    steep = replace(RATED, slope=2.0 * sum(RATED.weights))
    flat = replace(RATED, slope=0.5 * sum(RATED.weights))
    assert steep.warnings() == replace(flat, rate=0.0).warnings() == ()
    assert len(flat.warnings("hysteresis.")) == 1 and "hysteresis.slope" in flat.warnings("hysteresis.")[0]


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(shape=shapes, seed=st.integers(0, 1000), inverse=st.sampled_from(["exact", "general"]))
def test_the_inverse_finds_every_voltage_again(shape, seed, inverse):
    given = replace(MODEL.example, **shape)
    turns = np.random.default_rng(seed).uniform(-30.0, 130.0, 12)
    steps = np.random.default_rng(seed + 1).integers(1, 12, 11)
    voltage = np.concatenate([np.linspace(a, b, n + 1)[1:] for a, b, n in zip(turns, turns[1:], steps, strict=False)])
    plant = GeneralisedPlayHysteresis(given, T)
    reached = plant.simulate(voltage)
    parameters = CompensatorParameters(
        inverse=InverseParameters(type=inverse),
        hysteresis=HysteresisParameters(type="generalised_play", generalised_play=given),
        limits=LimitsParameters(minimum=-40.0, maximum=140.0),
    )
    found = Compensator(parameters, T).simulate(reached)
    np.testing.assert_allclose(found, voltage, rtol=0.0, atol=1e-9)
    plant.reset()
    np.testing.assert_allclose(plant.simulate(found), reached, rtol=0.0, atol=1e-13 * np.ptp(reached) + 1e-20)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"radii": (3.0, 3.0, 8.0, 9.0)}, "rise strictly"),
        ({"weights": (1e-9,)}, "as many numbers as radii"),
        ({"falling_bend": 0.3}, "not be above rising_bend"),
        ({"rising_bend": 0.95}, "rising_bend"),
        ({"voltage_low": 100.0}, "above voltage_low"),
        ({"rate": -1e-3}, "rate"),
        ({"rate": 1.1e-3}, "oscillates from sample to sample"),
        ({"slope": 0.0}, "slope"),
    ],
)
def test_what_is_no_actuator_is_refused(change, words):
    with pytest.raises(ParameterError, match=words):
        replace(MODEL.example, **change).validated()


def test_sizes_are_fixed_while_running():
    block = GeneralisedPlayHysteresis(MODEL.example, T)
    with pytest.raises(ParameterError, match="fixed while running"):
        block.retune(GeneralisedPlayParameters(radii=(1.0,), weights=(1e-9,), slope=1e-8))
