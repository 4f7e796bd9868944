# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What is evaluated: the displacement between the samples, against the undelayed and the delayed reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.laboratory.between_samples import INSTANTS, between_samples
from hysteresis_ros.laboratory.comparison.tasks import (
    Conditions,
    Followed,
    ModelledPlant,
    best_delay,
    followed,
    judged,
    make_tasks,
)
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters, zero_order_hold

T = 1e-3
SINE, TRIANGLE = make_tasks(Conditions(), (0.0, 10e-6))


def lag_and_mode(sample_time: float) -> LinearParameters:
    """A lag of 2 ms and a mode of 180 Hz in parallel."""
    w = 2.0 * np.pi * 180.0
    A = np.array([[-500.0, 0.0, 0.0], [0.0, 0.0, w], [0.0, -w, -0.1 * w]])
    Ad, Bd = zero_order_hold(A, np.array([500.0, 0.0, w]), sample_time)
    return LinearParameters(A=Ad.ravel(), B=Bd[:, 0], C=(0.7, 0.3, 0.0), D=(0.05,), sample_time=sample_time)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), delay=st.integers(0, 30), rest=st.floats(-1.0, 1.0))
def test_dynamics_go_on_between_the_samples_as_a_finer_simulation_has_it(seed, delay, rest):
    held = np.random.default_rng(seed).normal(size=40)
    # whole samples of delay: a fractional delay is a mean over the sample, not a switch within it
    coarse = replace(lag_and_mode(T), delay=(delay // 10) * T)
    fine = replace(lag_and_mode(T / INSTANTS), delay=(delay // 10) * T)
    block = LinearDynamics(fine, T / INSTANTS)
    block.settle(rest)
    expected = block.simulate(np.repeat(held, INSTANTS)).reshape(-1, INSTANTS)
    assert between_samples(coarse, T, rest, held) == pytest.approx(expected, abs=1e-9)


@settings(max_examples=10, deadline=None)
@given(part=st.floats(0.0, 3.0))
def test_at_the_samples_it_is_the_displacement_of_the_loop(part):
    axis = single_axis(load_configuration("kim2009"))
    dynamics = replace(axis.plant_simulator.dynamics, sample_time=1.0 / 3000.0, delay=part / 3000.0)
    axis = replace(axis, plant_simulator=replace(axis.plant_simulator, dynamics=dynamics))
    run = simulate(axis, duration=0.1, describe=False)
    between = ModelledPlant(axis.plant_simulator).between(run["plant_voltage"])
    displacement = run["displacement"] - axis.plant_simulator.preload.offset
    assert between[:-1, -1] == pytest.approx(displacement[1:], abs=1e-9 * np.ptp(displacement))


def test_dynamics_of_no_continuous_model_go_in_a_straight_line():
    negative = LinearParameters(A=(-0.5,), B=(1.5,), C=(1.0,), sample_time=T)
    found = between_samples(negative, T, 0.0, np.array([1.0, 0.0]))
    assert found[0] == pytest.approx(np.arange(1, 11) / 10 * 1.5)
    assert found[1] == pytest.approx(1.5 + np.arange(1, 11) / 10 * (-0.75 - 1.5))


@pytest.mark.parametrize("task", [SINE, TRIANGLE], ids=lambda task: task.waveform)
def test_the_reference_between_the_samples_is_that_of_the_generator(task):
    configuration = load_configuration("picma_stage").override("reference_generator", **task.overrides())
    run = simulate(single_axis(configuration), duration=task.duration, describe=False)
    assert task.reference(run.time) == pytest.approx(run["reference"], abs=1e-18)


def ideal(task, delay: float, gain: float = 1.0, offset: float = 0.0) -> Followed:
    time = task.settling + np.arange(1, 40001) * 1e-4
    return Followed(time, gain * task.reference(time - delay) + offset, 0.0, 0.0, 0.0, False)


@settings(max_examples=20, deadline=None)
@given(delay=st.floats(0.0, 0.01))
def test_the_best_constant_delay_is_the_true_one_and_one_for_both_references(delay):
    runs = {task: [ideal(task, delay)] for task in (SINE, TRIANGLE)}
    found = best_delay(runs, 0.01)
    assert found == pytest.approx(delay, abs=1e-5)
    results = judged(runs, found, 10e-6)
    # 1 Hz over 90 %: the error of a delay d is π f d times the part, times √2 for the RMS of its cosine
    assert results[SINE.name].undelayed[0] == pytest.approx(0.9 * np.sqrt(0.5) * np.sin(np.pi * delay), abs=1e-6)
    assert all(result.rms[0] < 1e-4 for result in results.values())


def test_no_delay_is_found_beyond_the_longest_allowed():
    assert best_delay({SINE: [ideal(SINE, 0.03)], TRIANGLE: [ideal(TRIANGLE, 0.03)]}, 0.01) == pytest.approx(0.01)


def test_the_worst_plant_decides_on_the_delay():
    runs = {SINE: [ideal(SINE, 0.002), ideal(SINE, 0.004)]}
    assert best_delay(runs, 0.01) == pytest.approx(0.003, abs=1e-5)


def test_errors_are_of_the_true_displacement_at_ten_instants_a_sample():
    configuration = load_configuration("picma_stage").override("plant_simulator", sensor__noise=1e-6)
    task = make_tasks(Conditions(), (10e-6, 40e-6))[1]
    moved = configuration.override("motion_controller", type="open_loop").override(
        "plant_simulator", creep__type="none"
    )
    axis = single_axis(moved.override("reference_generator", **task.overrides()))
    run = simulate(axis, duration=task.duration, describe=False)
    plant = ModelledPlant(axis.plant_simulator)
    found = followed({"time": run.time, **run.signals}, plant, task)
    assert len(found.time) == 10 * round((task.duration - task.settling) * 200.0)
    ends = found.displacement[INSTANTS - 1 :: INSTANTS]
    assert ends[:-1] == pytest.approx(run["displacement"][run.time >= task.settling - 1e-4][1:], abs=1e-15)
    # a lag responds between the samples: the values at the samples do not show it
    assert np.std(found.displacement) > 0.0 and not np.allclose(
        np.interp(found.time, run.time, run["displacement"]), found.displacement, atol=1e-8
    )
    assert not found.unstable


def test_a_loop_that_does_not_settle_into_the_period_of_its_reference_is_called_unstable():
    axis = single_axis(load_configuration("picma_stage").override("reference_generator", **SINE.overrides()))
    run = simulate(axis, duration=SINE.duration, describe=False)
    plant, signals = ModelledPlant(axis.plant_simulator), {"time": run.time, **run.signals}
    assert not followed(signals, plant, SINE).unstable
    for frequency, unstable in ((7.3, True), (7.0, False)):
        ringing = 1.8 + 1.8 * np.sign(np.sin(2.0 * np.pi * frequency * run.time + 0.1))
        assert followed({**signals, "plant_voltage": ringing}, plant, SINE).unstable == unstable
    assert followed({**signals, "tripped": np.ones(len(run.time))}, plant, SINE).unstable
