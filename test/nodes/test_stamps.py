# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Stamps in real time follow the wall clock, for any change of the clock and of the schedule."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, until  # noqa: E402

import hysteresis_ros.nodes.plant_simulator as module  # noqa: E402
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode  # noqa: E402

SECOND = 1_000_000_000
PERIOD = SECOND // 200


def plant_of(inside, **more) -> PlantSimulatorNode:
    values = {"plant_simulator": {"late_limit": -1, **more}}
    parameters = axis_parameters(sample_rate=200.0, time_mode="realtime", overrides=values).plant_simulator
    return inside.add(PlantSimulatorNode, parameters, autostart=False)


def next_stamp(plant) -> int:
    """Run a sample like the thread that keeps the time, and return its stamp."""
    plant.publish_sample()
    stamp = plant._message.header.stamp
    plant.finish_sample()
    if plant.stamps.are_off_clock:
        plant.stamps.go_on(plant.sample)
    return stamp.sec * SECOND + stamp.nanosec


def test_stamps_follow_a_clock_that_is_set_and_never_go_back(inside, monkeypatch):
    plant = plant_of(inside)
    assert plant.configure_now()
    now = [1_700_000_000 * SECOND]
    monkeypatch.setattr(module.time, "time_ns", lambda: now[0])
    plant.stamps.go_on(plant.sample)
    stamps = []
    for step in [PERIOD] * 5 + [3600 * SECOND] + [PERIOD] * 5 + [-7200 * SECOND] + [PERIOD] * 5:
        stamps.append(next_stamp(plant))
        now[0] += step
    assert stamps[:6] == [stamps[0] + k * PERIOD for k in range(6)] and stamps[0] == 1_700_000_000 * SECOND
    assert stamps[7] - stamps[5] == pytest.approx(3600 * SECOND, abs=3 * PERIOD), "a jump forward is followed"
    assert all(later - earlier >= PERIOD for earlier, later in zip(stamps[:-1], stamps[1:], strict=True))
    assert stamps[-1] - stamps[11] == (len(stamps) - 12) * PERIOD, "after a jump back, stamps continue"


def test_a_clock_that_cannot_be_read_stops_nothing(inside, monkeypatch):
    plant = plant_of(inside)
    assert plant.configure_now()
    plant.stamps.go_on(plant.sample)
    before = next_stamp(plant)

    def fails():
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(module.time, "time_ns", fails)
    assert [next_stamp(plant) for _ in range(3)] == [before + k * PERIOD for k in (1, 2, 3)]
    plant.stamps.go_on(plant.sample)
    assert next_stamp(plant) > before + 3 * PERIOD


def test_an_axis_that_is_the_source_of_time_or_runs_slower_has_stamps_of_its_own(inside, monkeypatch):
    plant = plant_of(inside, publish_clock=True)
    assert plant.configure_now()
    plant.stamps.go_on(plant.sample)
    assert [next_stamp(plant) for _ in range(3)] == [0, PERIOD, 2 * PERIOD]
    slow = plant_of(inside, real_time_factor=0.5)
    assert slow.configure_now()
    slow.stamps.go_on(slow.sample)
    next_stamp(slow)
    monkeypatch.setattr(module.time, "time_ns", lambda: 2_000_000_000 * SECOND)
    assert not slow.stamps.are_off_clock


@pytest.mark.parametrize("factor", [0.02, 1.0, 4.0])
def test_a_pause_is_a_gap_of_as_many_samples_as_it_lasted(inside, monkeypatch, factor):
    plant = plant_of(inside, real_time_factor=factor)
    assert plant.configure_now()
    now = [1_700_000_000 * SECOND]
    monkeypatch.setattr(module.time, "time_ns", lambda: now[0])
    plant.stamps.go_on(plant.sample)
    stamps = []
    for _ in range(5):
        stamps.append(next_stamp(plant))
        now[0] += round(PERIOD / factor)
    now[0] += round(20 * PERIOD / factor)
    plant.stamps.go_on(plant.sample)
    stamps.append(next_stamp(plant))
    assert stamps == [stamps[0] + k * PERIOD for k in (0, 1, 2, 3, 4, 25)] and stamps[0] == 1_700_000_000 * SECOND
    plant._clear()
    now[0] += 3600 * SECOND
    plant.stamps.go_on(plant.sample)
    assert next_stamp(plant) >= now[0], "a new run begins at the present time"


def test_stamps_stay_on_the_clock_when_samples_come_late(inside):
    plant = plant_of(inside)
    assert plant.configure_now() and plant.activate_now()
    until(lambda: plant.sample > 2, what="samples")
    with plant.lock:
        # no samples are run meanwhile
        until(lambda: time.time_ns() - plant.stamps.last > 16 * PERIOD, what="16 periods without a sample")
    late = plant.sample
    until(lambda: plant.sample > late + 1, what="further samples")
    until(
        lambda: time.time_ns() - plant.stamps.last < 6 * PERIOD, what="stamps that are on the clock again", timeout=10.0
    )
