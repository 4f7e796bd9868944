# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Rates that a machine can keep: the criterion, the cost of a sample, and the refusal of too fast axes."""

from __future__ import annotations

import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop import fused as trials
from hysteresis_ros.loop.pacing import Lateness
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.block import COMPILED


def kim(**plant):
    return single_axis(load_configuration("kim2009").override("plant_simulator", **plant))


def done(rate=1000.0, p99=1e-4, missed=0, samples=1000):
    return trials.Trial(rate, Lateness(p99, p99, p99, p99, p99, missed, samples, 1e-6, 1e-6, 0.0, 0.0), "")


def test_a_rate_is_held_when_samples_begin_within_half_a_period_and_few_are_skipped():
    assert done().is_held
    assert done(p99=4.9e-4).is_held and not done(p99=5.1e-4).is_held
    assert done(missed=4).is_held and not done(missed=5).is_held


@pytest.mark.skipif(not COMPILED, reason="without Numba the loop itself refuses the axis")
def test_a_rate_that_no_machine_holds_is_refused_by_name_with_the_figure_and_the_option(monkeypatch):
    monkeypatch.setattr(trials, "tick_cost", lambda parameters: 2.0e-3)
    with pytest.raises(ConfigurationError) as refused:
        trials.require_speed(kim())
    text = str(refused.value)
    assert "sample_rate = 3000 Hz" in text and "2e+03 µs" in text and "500" in text and "--force" in text
    trials.require_speed(kim(real_time_factor=0.1))
    trials.require_speed(kim(realtime__force=True))


def test_the_cost_of_a_sample_leaves_the_axis_alone():
    assert 0.0 < trials.tick_cost(kim()) < 1.0


@pytest.mark.skipif(not COMPILED, reason="without Numba the loop is too slow for this axis")
def test_a_trial_counts_every_sample():
    made = trials.trial(kim(), seconds=0.05, priority=0)
    late = made.lateness
    assert made.rate == 3000.0 and late.samples == 150 and 0 <= late.missed <= 150
    assert late.p50 <= late.p90 <= late.p99 <= late.p999 <= late.max
