# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Predicted times until moves are ready, against the simulated truth; the whole judgement is bench_ready.py."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.ready import SIZE, Predictor, deviated, entry, model_of
from hysteresis_ros.references.moves import Noise
from hysteresis_ros.signals import SOURCE

QUIET, TOLERANCE, DWELL = Noise(0.0, 0.0), 5e-9, 2e-3
MOVES, LENGTH = (12e-6, 4e-6, 9e-6, 17e-6, 6e-6, 14e-6), 1000


@pytest.fixture(scope="module")
def model():
    """The axis stage700, whose plant is its model."""
    axis = single_axis(load_configuration("stage700"))
    return model_of(axis.generator, axis.motion_controller, axis.hysteresis_compensator)


def run(axis, setpoints, noise: float = 0.0):
    """Return the true and the measured displacement [m] in moves to setpoints [m] of equal length."""
    plant = axis.plant_simulator
    noisy = replace(axis, plant_simulator=replace(plant, sensor=replace(plant.sensor, noise=noise)))
    rest = axis.reference_generator.initial_setpoint
    signals = Axis(noisy).run(np.repeat((rest, *setpoints), LENGTH))
    return signals["displacement"].reshape(-1, LENGTH)[1:], signals["measured"].reshape(-1, LENGTH)[1:]


def truth(displacement, setpoint: float) -> float:
    return entry(displacement - setpoint, TOLERANCE, round(DWELL * 20e3)) / 20e3


def test_the_first_sample_of_a_stay_that_is_long_enough():
    error = np.array([9.0, 1.0, 1.0, 9.0, 1.0, 1.0, 1.0])
    assert [entry(error, 2.0, dwell) for dwell in (0, 2, 3)] == [1, 1, 4]
    assert math.isinf(entry(error, 2.0, 4)) and entry(error, 9.0, 7) == 0


def test_the_offset_of_a_preload_in_the_controller_changes_no_prediction(model):
    axis = single_axis(load_configuration("stage700").override("motion_controller", model__preload__A1=7e-6))
    shifted = model_of(axis.generator, axis.motion_controller, axis.hysteresis_compensator)
    found = [Predictor(one).predict(12e-6, LENGTH, TOLERANCE, DWELL, QUIET) for one in (model, shifted)]
    assert found[0] == found[1] and math.isfinite(found[0])


def test_a_plant_that_is_the_model_is_predicted_to_the_sample(model):
    true, _ = run(model, MOVES[:3])
    predictor = Predictor(model)
    for displacement, setpoint in zip(true, MOVES, strict=False):
        predictor.follow(LENGTH)
        predicted = predictor.predict(setpoint, LENGTH, TOLERANCE, DWELL, QUIET)
        assert predicted == pytest.approx(truth(displacement, setpoint), rel=1e-9)


def test_deviations_are_learned_from_noisy_measurements(model):
    factors = (1.0 + SIZE, 1.0, 1.0 - SIZE, 1.0)
    true, measured = run(deviated(model, *factors), MOVES, noise=3e-9)
    predictor, noise, errors = Predictor(model), Noise(3e-9, 0.7e-9), []
    for displacement, seen, setpoint in zip(true, measured, MOVES, strict=True):
        predictor.follow(LENGTH)
        predicted = predictor.predict(setpoint, LENGTH, TOLERANCE, DWELL, noise)
        errors.append(abs(predicted / truth(displacement, setpoint) - 1.0))
        predictor.learn(seen, noise)
    assert max(errors[2:]) < 0.1
    assert predictor.deviations[[0, 2]] == pytest.approx([1.0, -1.0], abs=0.4)


def test_a_trajectory_is_followed_before_the_move_after_it(model):
    target = 8e-6
    path = {"times": (0.01, 0.02), "positions": (3e-6, target), "velocities": (2e-4, 0.0), "accelerations": ()}
    axis = Axis(model)
    rest = model.reference_generator.initial_setpoint
    signals = axis.run(np.full(2 * LENGTH, rest), changes=[Change(LENGTH, SOURCE, "follow", path)])
    predictor = Predictor(model)
    predictor.follow(LENGTH)
    found = predictor.predict(target, LENGTH, TOLERANCE, DWELL, QUIET, path)
    assert found == pytest.approx(truth(signals["displacement"][LENGTH:], target), rel=1e-9) and found > 0.02
    assert math.isfinite(predictor.predict(12e-6, LENGTH, TOLERANCE, DWELL, QUIET))


@pytest.mark.slow
def test_moves_and_trajectories_that_interrupt_each_other_are_those_of_the_axis(model):
    path = {"times": (0.01, 0.02), "positions": (3e-6, 8e-6), "velocities": (2e-4, 0.0), "accelerations": ()}
    # the third one repeats the given setpoint, so the axis stays where the trajectory has brought it
    moves = [(12e-6, 150, None), (8e-6, 700, path), (12e-6, 300, None), (4e-6, 90, None), (9e-6, 400, None)]
    given, changes, begins = [], [], [0]
    for setpoint, length, own in moves:
        changes += [Change(begins[-1], SOURCE, "follow", path)] if own else []
        given += [given[-1] if own else setpoint] * length
        begins.append(len(given))
    true = Axis(model).run(np.array(given), changes=changes)["displacement"]
    predictor, before = Predictor(model), 0
    for (setpoint, length, own), first in zip(moves, begins, strict=False):
        predictor.predict(setpoint, before, TOLERANCE, DWELL, QUIET, own)
        count = min(length, len(predictor.expected))
        np.testing.assert_allclose(predictor.expected[:count], true[first : first + count], rtol=0, atol=1e-15)
        for samples in (length // 3, length // 3, length // 2):
            predictor.follow(samples)
        before = length


def test_an_error_of_the_model_far_from_the_setpoint_counts_little(model):
    predictor, noise = Predictor(model), Noise(1e-9, 0.0)
    found = []
    for far in (0.0, 0.2):
        predictor = Predictor(model)
        predictor.predict(12e-6, 0, TOLERANCE, DWELL, QUIET)
        expected, left = predictor.expected.copy(), predictor.expected - 12e-6
        # a plant whose gain is larger by the expected deviation, and whose response is another one far away
        gained = predictor._slopes[0] + expected
        predictor.learn(gained + far * np.where(np.abs(left) > 1e-6, left, 0.0), noise)
        found.append(predictor.deviations[0])
    print(found)
    assert found[0] == pytest.approx(1.0, abs=0.2) and found[1] == pytest.approx(found[0], abs=0.3)


def test_a_plant_that_has_changed_is_learned_anew(model):
    """Each move counts 2 % less than the next one: 60 moves outweigh the 150 before them by 35 to 14."""
    predictor, noise = Predictor(model), Noise(1e-9, 0.0)
    predictor.predict(12e-6, 0, TOLERANCE, DWELL, QUIET)
    nominal, gained = predictor._traces[0].copy(), predictor._slopes[0].copy()
    for deviation, moves in ((1.0, 150), (-1.0, 60)):
        for _ in range(moves):
            predictor.learn(nominal + deviation * gained, noise)
    assert predictor.deviations[0] == pytest.approx((14.2 - 35.1) / (14.2 + 35.1), abs=0.1)


def test_the_prediction_under_noise_is_the_median_of_many_runs(model):
    predictor, size = Predictor(model), 1e-9
    predictor.rest_at(2e-6)
    predicted = predictor.predict(12e-6, 2000, TOLERANCE, DWELL, Noise(3e-9, size))
    trace, mean = predictor.resting.trace / predictor.resting.displacement, predictor.expected - 12e-6
    times = [
        entry(mean + size * np.roll(trace, -97 * k)[: len(mean)], TOLERANCE, round(DWELL * 20e3)) for k in range(80)
    ]
    low, high = np.quantile(times, (0.3, 0.7)) / 20e3
    assert low <= predicted <= high and high > low


def test_noise_delays_the_prediction_and_a_tolerance_below_it_is_never_kept(model):
    predictor = Predictor(model)
    times = []
    for size in (0.0, 1e-9, 1e-7):
        predictor.rest_at(2e-6)
        times.append(predictor.predict(12e-6, 2000, TOLERANCE, DWELL, Noise(3e-9, size)))
    assert times[0] < times[1] < times[2] and math.isinf(times[2])


def test_the_noise_of_the_displacement_is_that_of_the_loop(model):
    resting = Predictor(model).resting
    true, measured = run(model, (12e-6, 12e-6, 12e-6, 12e-6), noise=3e-9)
    assert 3e-9 * resting.displacement == pytest.approx(np.std(true[1:]), rel=0.15)
    assert 3e-9 * resting.error == pytest.approx(np.std(measured[1:]), rel=0.1)


def test_a_dwell_time_longer_than_the_simulated_time_does_not_prevent_a_prediction(model):
    found = []
    for dwell in (DWELL, 60.0):
        predictor = Predictor(model)
        found.append(predictor.predict(12e-6, 0, TOLERANCE, dwell, QUIET))
    assert found[0] == found[1] < 0.05
