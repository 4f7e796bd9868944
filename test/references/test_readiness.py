# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Noise at rest and readiness from measurements: known noise, closed forms of steps, and disturbances."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hysteresis_ros.references.moves import Noise, NoiseMeter, Readiness

STEP, SENSOR, MOVED = 1e-3, 3e-9, 1e-9


def meter(displacement, seed: int = 1, block: int = 997) -> NoiseMeter:
    """Return a meter that has taken a displacement [m] around a reference of 1 µm, with the sensor's noise."""
    measured = 1e-6 + displacement + SENSOR * np.random.default_rng(seed).standard_normal(len(displacement))
    made = NoiseMeter(10.0 * STEP, STEP)
    for first in range(0, len(measured), block):
        part = measured[first : first + block]
        made.take(np.full(len(part), 1e-6), part)
    return made


def test_the_noise_of_the_sensor_and_that_of_the_displacement_are_told_apart():
    angle = 2.0 * math.pi * 0.01 * np.arange(20_000)
    still, shaken = meter(np.zeros(20_000)).noise(), meter(math.sqrt(2.0) * MOVED * np.sin(angle)).noise()
    assert still.sensor == pytest.approx(SENSOR, rel=0.03) and still.displacement < 0.3 * MOVED
    assert shaken.sensor == pytest.approx(SENSOR, rel=0.03)
    assert shaken.displacement == pytest.approx(MOVED, rel=0.3)
    assert Noise(SENSOR, MOVED).least_tolerance == pytest.approx(2.576 * MOVED)


def test_a_slow_drift_and_a_motion_of_the_reference_are_no_noise():
    assert meter(2e-6 * np.arange(20_000) * STEP / 20.0).noise().displacement < 0.4 * MOVED
    moving = NoiseMeter(10.0 * STEP, STEP)
    moving.take(1e-9 * np.arange(1000.0), np.sin(np.arange(1000.0)))
    assert moving.count == 0 and math.isnan(moving.sensor)


def moves(rest: int, count: int, sensor: float = 0.0) -> NoiseMeter:
    """Return a meter that has seen steps of 1 µm, each followed by a decay in 40 samples and a rest [samples]."""
    made, setpoint = NoiseMeter(0.01, STEP), 0.0
    random = np.random.default_rng(5)
    made.take(np.zeros(500), sensor * random.standard_normal(500))
    for _ in range(count):
        setpoint += 1e-6
        decay = setpoint - 1e-6 * np.exp(-np.arange(rest) / 40.0)
        made.take(np.full(rest, setpoint), decay + sensor * random.standard_normal(rest))
    return made


@pytest.mark.parametrize(("rest", "count"), [(150, 20), (320, 5), (1000, 3)])
def test_the_end_of_a_response_is_no_noise(rest, count):
    """The response of a move is left out, whether the rest is too short for it or it ends within the rest."""
    assert moves(rest, count).noise().displacement < 1e-9
    found = moves(rest, count, SENSOR).noise(0.5, 1.0)
    assert found.sensor == pytest.approx(SENSOR, rel=0.1)
    assert found.displacement == pytest.approx(0.5 * SENSOR, rel=0.5)


def test_a_disturbance_that_comes_later_is_noise():
    """A part of a rest with less variance replaces the part before; a part with more does not, and both count."""
    calm, shaken = np.zeros(2000), 10.0 * MOVED * np.sin(0.5 * np.arange(6000.0))
    made = meter(np.concatenate([calm, shaken]))
    assert made.noise().displacement == pytest.approx(10.0 * MOVED * math.sqrt(0.5 * 0.75), rel=0.05)
    after = meter(np.concatenate([shaken, calm]))
    assert after.noise().displacement < 2.0 * MOVED


@pytest.mark.parametrize(("moved", "error"), [(0.5, 1.2), (0.5, 1.0), (0.5, 0.6), (0.0, 0.0)])
def test_what_the_model_of_the_loop_does_not_explain_is_a_motion(moved, error):
    """Of a variance σ² the model explains (error · σ)², of which (moved · σ)² is the displacement's."""
    found = meter(np.zeros(20_000)).noise(moved, error)
    expected = SENSOR * math.sqrt(moved**2 + max(1.0 - error**2, 0.0))
    assert found.displacement == pytest.approx(expected, rel=0.05, abs=0.3 * SENSOR if error == 1.0 else 0.0)


def answers(error, tolerance=5e-9, dwell=0.01, noise=Noise(0.0, 0.0)):  # noqa: B008
    """Return the readiness after errors [m], and whether it was ready at each of them."""
    readiness = Readiness(tolerance, dwell, noise, STEP)
    return readiness, [readiness.look(0.0, one) for one in error]


def test_without_noise_it_is_the_time_since_which_the_error_has_been_within_the_tolerance():
    error = 1e-6 * np.exp(-np.arange(300) / 20.0)
    entered = math.ceil(20.0 * math.log(1e-6 / 5e-9))
    readiness, ready = answers(error)
    assert readiness.since == pytest.approx(entered * STEP)
    assert ready.index(True) == entered + 10


def test_with_noise_it_averages_and_is_never_ready_outside():
    noise = Noise(SENSOR, MOVED)
    error = 1e-6 * np.exp(-np.arange(600) / 20.0)
    random = np.random.default_rng(3)
    times = []
    for _ in range(50):
        readiness, ready = answers(error + SENSOR * random.standard_normal(600), noise=noise)
        assert not np.any(np.array(ready) & (error > 5e-9))
        times.append(readiness.since)
    # the margin of the displacement's noise decides when it is ready, the tolerance since when
    assert np.median(times) == pytest.approx(20.0 * math.log(1e-6 / 5e-9) * STEP, rel=0.05)


def test_a_disturbance_ends_it_until_the_dwell_time_has_passed_again():
    _, ready = answers([0.0] * 20 + [6e-9] + [0.0] * 20)
    assert ready[19] and not any(ready[20:31]) and ready[31]


def test_missing_measurements_end_it_when_they_last_longer_than_the_dwell_time():
    readiness, ready = answers([1e-6] * 5 + [0.0] * 3 + [math.nan] * 10 + [0.0] * 20)
    assert readiness.since == pytest.approx(5.0 * STEP), "what is missing is not outside"
    assert ready.index(True) == 5 + 10 + 10, "the dwell time consists of measurements"
    _, ready = answers([0.0] * 20 + [math.nan] * 10 + [math.inf] + [0.0] * 20)
    assert all(ready[11:30]) and not any(ready[30:41]) and ready[41]


def test_a_long_dwell_time_is_not_interrupted_by_noise_alone():
    error = SENSOR * np.random.default_rng(4).standard_normal(40_000)
    readiness, ready = answers(error, dwell=10.0, noise=Noise(SENSOR, 0.2e-9))
    assert ready.index(True) < 10_100 and all(ready[10_100:]) and readiness.since < 20 * STEP
