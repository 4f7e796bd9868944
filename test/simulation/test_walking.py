# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Continuous walking of a motor that differs from its models, evaluated between the samples."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.laboratory.papers.kim2009.inchworm import inchworm
from hysteresis_ros.laboratory.papers.kim2009.walking import SPEED, Walker, compared
from hysteresis_ros.loop.inchworm_checks import inchworm_warnings
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.block import COMPILED

WALK = {"walk__continuous": True, "walk__swing": 456.0, "walk__learning_speed": SPEED}


@pytest.mark.skipif(not COMPILED, reason="takes minutes without Numba")
def test_what_is_learned_at_one_speed_is_used_at_another():
    ((before, after),) = compared(3, parts=(2.0,), cycles=9, kick=1e-9).values()
    assert after.off_path < before.off_path / 8.0, (before, after)
    assert abs(after.speed_error) < 4e-3 < abs(before.speed_error)


def test_the_finer_motor_of_the_figures_is_the_motor():
    walker = Walker(seed=0)
    fine, coarse = walker.motor, walker.axis.plant.motor
    voltages = 60.0 * (1.0 - np.cos(np.linspace(0.0, 3.0, 300)))
    for voltage in voltages:
        coarse.advance(voltage, 100.0, 0.0)
        for _ in range(4):
            fine.advance(voltage, 100.0, 0.0)
    # creep and friction are distributed differently, the extender's dynamics are the same
    assert fine.displacement == pytest.approx(coarse.displacement, rel=2e-3)


def test_a_walk_that_does_not_fit_its_motor_is_doubted_or_refused():
    configuration = load_configuration("inchworm_travel").override("inchworm_sequencer", **WALK)
    axis = single_axis(configuration)
    assert inchworm_warnings(axis.plant_simulator, axis.inchworm_sequencer) == ()
    heavy = single_axis(configuration.override("plant_simulator", inchworm__slider__mass=0.1))
    (said,) = (
        text for text in inchworm_warnings(heavy.plant_simulator, heavy.inchworm_sequencer) if "walk.swing" in text
    )
    assert "456 Hz" in said and "322.3 Hz" in said
    loaded = single_axis(configuration.override("plant_simulator", inchworm__slider__external_force=-1.0))
    assert any("walk.bound" in text for text in inchworm_warnings(loaded.plant_simulator, loaded.inchworm_sequencer))
    with pytest.raises(ParameterError, match="walk.file"):
        inchworm(sequencer=WALK | {"walk__file": "nowhere.yaml"})
