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


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="takes minutes without Numba")
def test_what_is_learned_at_one_speed_is_used_at_another():
    ((before, after),) = compared(3, parts=(2.0,), cycles=9, kick=1e-9).values()
    assert after.off_path < before.off_path / 8.0, (before, after)
    assert abs(after.speed_error) < 4e-3 < abs(before.speed_error)


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="takes minutes without Numba")
@pytest.mark.parametrize(("kick", "factors"), [(0.0, {2.0: 12.0, 4.0: 3.5}), (1.0e-9, {2.0: 4.0, 4.0: 1.4})])
def test_the_motor_that_improves_least_is_nearer_to_its_path_at_speeds_that_were_not_learned(kick, factors):
    for part, (before, after) in compared(1, parts=tuple(factors), kick=kick).items():
        assert before.off_path > factors[part] * after.off_path, (part, before, after)


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="takes minutes without Numba")
def test_a_motor_as_its_models_say_is_on_its_path_at_high_speed():
    found = {}
    for plain in (False, True):
        walker = Walker(seed=0, plain=plain)
        for _ in range(100):
            walker.sample()
        found[plain] = walker.judge(4.0 * SPEED).off_path
    assert found[False] < 1.3e-9 and found[True] > 10e-9, found


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


@pytest.mark.slow
def test_a_walk_that_does_not_fit_its_motor_is_doubted_or_refused():
    configuration = load_configuration("inchworm_travel").override("inchworm_sequencer", **WALK)
    axis = single_axis(configuration)
    assert inchworm_warnings(axis.plant_simulator, axis.inchworm_sequencer) == ()
    heavy = single_axis(configuration.override("plant_simulator", inchworm__slider__mass=0.1))
    (said,) = (
        text for text in inchworm_warnings(heavy.plant_simulator, heavy.inchworm_sequencer) if "walk.swing" in text
    )
    assert "456 Hz" in said and "322.3 Hz" in said
    stiff = single_axis(configuration.override("inchworm_sequencer", walk__resonance=800.0))
    (said,) = inchworm_warnings(stiff.plant_simulator, stiff.inchworm_sequencer)
    assert "walk.resonance = 800 Hz" in said and "635 Hz" in said
    right = single_axis(configuration.override("inchworm_sequencer", walk__resonance=635.0))
    assert inchworm_warnings(right.plant_simulator, right.inchworm_sequencer) == ()
    loaded = single_axis(configuration.override("plant_simulator", inchworm__slider__external_force=-1.0))
    assert any("walk.bound" in text for text in inchworm_warnings(loaded.plant_simulator, loaded.inchworm_sequencer))
    with pytest.raises(ParameterError, match="walk.file"):
        inchworm(sequencer=WALK | {"walk__file": "nowhere.yaml"})
