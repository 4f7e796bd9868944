# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Long recordings: omitted samples contain no new information, and the result is that of all samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.preprocessing import FEWEST_REDUCED, MOST_SAMPLES, coarser, condense, reduced
from hysteresis_ros.identification.reading import Columns, read_data
from hysteresis_ros.identification.workflow import identify, validate

RATE = 2000.0
SIZE = 300_000
TIME = np.arange(SIZE) / RATE


def recording(voltage, output=None):
    return IdentificationData(TIME[: len(voltage)], voltage, 1e-5 * (voltage if output is None else output))


def sine(frequency=2.0, low=0.0, high=3.6):
    return low + 0.5 * (high - low) * (1.0 - np.cos(2 * np.pi * frequency * TIME))


def test_short_data_stays_as_it_is():
    data = recording(sine()[:MOST_SAMPLES])
    assert reduced(data) is data


def test_a_sine_is_condensed_to_what_carries_information():
    noise = 1e-3 * np.random.default_rng(1).standard_normal(SIZE)
    data = reduced(recording(sine(), sine() + noise))
    assert FEWEST_REDUCED // 2 < len(data) <= 2 * FEWEST_REDUCED and data.factor == 3
    assert data.sample_time == pytest.approx(data.factor / RATE)
    # every sample is the mean of the samples that it represents, at their middle
    first = slice(0, data.factor)
    assert data.time[0] == pytest.approx(TIME[first].mean()) and data.input[0] == pytest.approx(sine()[first].mean())
    assert np.ptp(data.input) == pytest.approx(3.6, rel=1e-3)
    # averages contain less noise than samples
    held = np.std(data.output - 1e-5 * data.input)
    assert held == pytest.approx(1e-8 / np.sqrt(data.factor), rel=0.1)
    assert f"averaged over {data.factor}" in data.notes[-1] and "--all-samples" in data.notes[-1]


def test_a_resonance_keeps_its_samples():
    resonance = scipy.signal.sosfilt(scipy.signal.butter(2, [270, 290], "band", fs=RATE, output="sos"), sine() > 1.8)
    data = reduced(recording(sine(), sine() + 0.05 * resonance))
    assert data.factor == 1 and len(data) == pytest.approx(10 * RATE, rel=0.01)


def test_the_stretch_that_reaches_both_ends_is_taken():
    voltage = np.where(TIME < 60.0, sine(2.0, 1.0, 2.0), sine())
    data = reduced(recording(voltage))
    assert data.first > 0 and np.ptp(data.input) == pytest.approx(3.6, rel=2e-3)
    assert "s show the loops" in data.notes[-1]
    growing = reduced(recording(sine() * np.minimum(TIME / TIME[-1], 1.0)))
    assert np.ptp(growing.input) > 0.95 * 3.6


def test_a_sweep_is_taken_whole_and_so_is_what_is_judged():
    """Every part of a sweep has another frequency, so no part represents the others."""
    sweep = 1.8 + 1.8 * scipy.signal.chirp(TIME, 1.0, TIME[-1], 40.0)
    data = reduced(recording(sweep))
    assert len(data) * data.factor > 0.99 * SIZE
    judged = reduced(recording(sine()), whole=True)
    assert len(judged) * judged.factor > 0.99 * SIZE and judged.factor > 1


@pytest.mark.slow
def test_what_is_found_is_what_all_samples_say_at_the_recorded_rate(tmp_path):
    lag = 0.01
    voltage = sine()[: SIZE // 2]
    output = LinearPart(lag=lag).apply(voltage, 1 / RATE)
    output = output + 1e-3 * np.random.default_rng(1).standard_normal(voltage.size)
    data = recording(voltage, output)
    found = identify(read_data(data), "proportional", linear="lag")
    assert found.data.factor > 1
    assert found.plant.sample_time == pytest.approx(1 / RATE)
    # the file has the sample rate of the recording: its lag is the true one minus half a sample of hold
    decay = found.plant.dynamics.A[0]
    assert -1 / RATE / np.log(decay) == pytest.approx(lag - 0.5 / RATE, rel=0.01)
    found.save(tmp_path / "axis.yaml")
    whole = validate(tmp_path / "axis.yaml", read_data(data, Columns(all_samples=True)), inverse=False)
    assert whole.figures["rmse_m"] == pytest.approx(1e-8, rel=0.1)


def test_what_is_far_off_is_in_no_coarser_sample_that_counts():
    voltage = sine()[:24_000]
    far = np.random.default_rng(1).choice(24_000, 60, replace=False)
    displacement, good = 1e-7 * voltage, np.ones(24_000, dtype=bool)
    displacement[far] += 1e-3
    good[far] = False
    fine = condense(voltage, displacement, 1.0 / RATE, 0, kept=good, enough=24_000)
    for data in (fine, coarser(fine, 3000)):
        beside = data.counted(data.displacement) - 1e-7 * data.counted(data.voltage)
        assert np.max(np.abs(beside)) < 1e-9 and len(beside) > 0.8 * len(data.voltage)
    assert len(data.voltage) < 0.5 * len(fine.voltage)


@pytest.mark.slow
def test_skip_counts_samples_of_the_recording():
    data = read_data(recording(sine()))
    figures = identify(data, "proportional", linear="none", skip=10_000).figures
    assert figures["skipped"] == -(-10_000 // data.data.factor)
    assert replace(data.data, factor=1).factor == 1
