# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Protection of a stage during commissioning: monitoring of its travel, and limits of the voltages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from commissioning_support import sitting

from hysteresis_ros.cli.commissioning import measuring as volts
from hysteresis_ros.cli.commissioning.situation import Outcome

STROKE = 100e-6


def with_device(folder):
    """Return the situation of an axis whose plant is a device."""
    situation = sitting(folder)
    configuration = situation.configuration.override("", time_mode="realtime")
    configuration = configuration.override("plant_simulator", driver="simulated")
    plant = replace(situation.axis.plant_simulator, driver="simulated")
    return replace(situation, configuration=configuration, axis=replace(situation.axis, plant_simulator=plant))


@pytest.mark.parametrize("zero", [0.0, 35e-6])
def test_once_the_zero_of_the_sensor_is_known_a_device_is_held_to_what_its_voltages_should_give(tmp_path, zero):
    """The expected gain gives the travel, the sensor its zero; half a stroke outside this range the axis is stopped."""
    situation = with_device(tmp_path)
    voltages = np.linspace(0.0, 40.0, 50)
    before = situation.driven_axis("noise", voltages).plant_simulator
    assert before.allowed_travel == (-np.inf, np.inf), "the zero of the sensor is unknown"
    # a device with a narrower range than the plan is refused by the first stage, before anything moves
    assert (before.limits.minimum, before.limits.maximum) == (0.0, 100.0)
    situation.found["noise"] = Outcome(["quiet"], {"noise_rms_m": 3e-9, "sensor_zero_m": zero})
    low, high = situation.driven_axis("gain", voltages).plant_simulator.allowed_travel
    # 40 of 100 V
    assert low == pytest.approx(zero - 0.5 * STROKE, abs=0.01 * STROKE)
    assert high == pytest.approx(zero + 0.9 * STROKE, abs=0.01 * STROKE)


def test_no_stage_puts_out_more_than_its_own_voltages(tmp_path):
    situation = with_device(tmp_path)
    situation.found["noise"] = Outcome(["quiet"], {"noise_rms_m": 3e-9, "sensor_zero_m": 0.0})
    axis = situation.driven_axis("gain", np.linspace(0.0, 40.0, 50))
    for part in (axis.plant_simulator, axis.hysteresis_compensator):
        assert (part.limits.minimum, part.limits.maximum) == pytest.approx((0.0, 40.0), abs=0.02)


def test_limits_around_the_voltages_of_a_stage_end_at_the_plan(tmp_path):
    situation = with_device(tmp_path)
    situation.plan = replace(situation.plan, minimum=0.0, maximum=40.0)
    situation.found["noise"] = Outcome(["quiet"], {"noise_rms_m": 3e-9, "sensor_zero_m": 0.0})
    axis = situation.driven_axis("hysteresis", np.linspace(0.0, 40.0, 50))
    for part in (axis.plant_simulator, axis.hysteresis_compensator):
        assert part.limits.minimum >= 0.0 and part.limits.maximum <= 40.0


@pytest.mark.parametrize(("low", "high"), [(0.0, 100.0), (-30.0, 120.0)])
def test_a_multisine_whose_peaks_are_higher_than_asked_ends_at_the_range(tmp_path, monkeypatch, low, high):
    """The peak of a sum of sines depends on the phases; the voltage is limited to the range of the stack."""
    plan = replace(sitting(tmp_path).plan, minimum=low, maximum=high)
    recipe = volts.recipe

    def louder(*asked):
        found = recipe(*asked)
        return replace(found, waveform={**found.waveform, "amplitude": 40.0 * found.waveform["amplitude"]})

    monkeypatch.setattr(volts, "recipe", louder)
    found = volts.small_multisine(plan, 0.0, 1000.0)
    assert found.min() == low and found.max() == high
