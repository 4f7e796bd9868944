# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common properties of all emulated devices: a plant in real time, and faults that begin and end."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.emulation.bench import (
    FAULTS,
    LONGEST_CATCH_UP,
    DeviceFaults,
    EmulatedPlant,
    assumed_stage,
)
from hysteresis_ros.models.actuator import Actuator

CYCLE = 1.0e-3


class Clock:
    """A clock controlled by the test."""

    def __init__(self):
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_asked_at_any_times_it_is_the_plant_of_the_package_sample_by_sample():
    clock, twin = Clock(), Actuator(assumed_stage(CYCLE), CYCLE)
    plant = EmulatedPlant(assumed_stage(CYCLE), CYCLE, clock)
    plant.control = lambda measured: 50.0 * math.sin(plant_sample() / 20.0)
    samples = iter(range(10**6))

    def plant_sample():
        return next(samples)

    measured = [twin.measure()]
    for sample in range(500):
        twin.advance(50.0 * math.sin(sample / 20.0))
        measured.append(twin.measure())
    seen = []
    for step in np.random.default_rng(5).uniform(0.0, 7.0 * CYCLE, size=100):
        clock.now += step
        plant.advance()
        assert plant.cycles == math.floor((clock.now - 100.0) / CYCLE)
        seen.append((plant.cycles, plant.measured))
    assert seen == [(number, measured[number]) for number, _ in seen] and seen[-1][0] > 200
    # the loop of a stage with hysteresis: the assumed stage is not linear
    assert max(measured) > 30.0e-6


def test_a_clock_that_was_away_for_hours_is_not_caught_up_with():
    clock = Clock()
    plant = EmulatedPlant(assumed_stage(CYCLE), CYCLE, clock)
    clock.now += 3600.0
    plant.advance()
    assert plant.cycles == round(LONGEST_CATCH_UP / CYCLE)
    clock.now += 2.5 * CYCLE
    plant.advance()
    assert plant.cycles == round(LONGEST_CATCH_UP / CYCLE) + 2


def test_faults_come_and_go_by_the_devices_clock():
    clock = Clock()
    faults = DeviceFaults(clock, ["slow:1:2:0.05", "busy:2:0.5"])
    seen = []
    for _ in range(8):
        seen.append((faults.value("slow"), "busy" in faults))
        clock.now += 0.5
    away = (None, False)
    assert seen == [away, away, (0.05, False), (0.05, False), (0.05, True), (0.05, False), away, away]
    faults.add("cut:0:10")
    assert "cut" in faults
    faults.add("none")
    assert not any(name in faults for name in FAULTS)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("slw:0:1", "no fault 'slw'; did you mean slow"),
        ("", "there are busy, error, slow, silent, cut"),
        ("busy", "write busy:START:DURATION,"),
        ("busy:0:1:3", "write busy:START:DURATION,"),
        ("slow:0:nan", r"write slow:START:DURATION\[:VALUE in s\]"),
        ("slow:0:1:-1", "write slow"),
        ("slow:-1:1", "START ≥ 0"),
        ("cut:0:0", "DURATION > 0"),
        ("cut:a:b", "write cut"),
    ],
)
def test_a_fault_that_is_written_wrongly_says_how(text, said):
    with pytest.raises(ConfigurationError, match=said):
        DeviceFaults(Clock(), [text])
