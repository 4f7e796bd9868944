# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The loop of a stage: that of its axes if they do not couple, and with the stability of the running stage."""

from __future__ import annotations

import numpy as np
import pytest
from coupled_stages import LINEAR, configured, internal_structure

from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.coupling import disk_margins
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.control.margins import margins_of
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_response import stage_loop, stage_plant

SAMPLE_TIME = 1e-4
MODEL = configured().node("stage")


def read(**overrides) -> StageParameters:
    return StageParameters.from_configuration(configured(**overrides))


def alone() -> dict:
    """Return values of an uncoupled stage: each actuator moves its own mode, each sensor measures its own mode."""
    B, C = np.reshape(MODEL["structure.B"], (4, 2)).copy(), np.zeros((2, 4))
    B[:2, 1] = B[2:, 0] = 0.0
    C[0, 0] = C[1, 2] = 1.0
    B[:2, 0] *= 0.0948954024682 / B[0, 0]
    B[2:, 1] *= 0.123281616262 / B[2, 1]
    return {"structure__B": tuple(B.ravel()), "structure__C": tuple(C.ravel()), "decoupling": []}


def test_the_decoupled_plant_is_one_at_rest():
    np.testing.assert_allclose(stage_plant(read()).dc_gain, np.eye(2), atol=1e-8)
    np.testing.assert_allclose(
        stage_plant(read(stage={"decoupling": []})).dc_gain, [[1.0, 0.04], [0.04, 1.0]], atol=1e-8
    )


def test_without_coupling_each_loop_has_the_sensitivity_of_its_design():
    stage = read(stage=alone())
    found = disk_margins(stage_loop(stage), SAMPLE_TIME, skew=1.0)
    for margin, axis in zip(found.loops, stage.axes, strict=True):
        designed = margins_of(*whole_loop(part(axis.motion_controller, ControllerParameters), SAMPLE_TIME), SAMPLE_TIME)
        assert 1.0 / margin.alpha == pytest.approx(designed.sensitivity_peak, rel=1e-3)


@pytest.mark.slow
def test_coupling_takes_from_the_margin_of_both_loops_together_and_decoupling_gives_it_back():
    coupled, decoupled, apart = (
        disk_margins(stage_loop(read(stage=values)), SAMPLE_TIME).together.alpha
        for values in ({"decoupling": []}, {}, alone())
    )
    assert coupled < 0.985 * apart
    assert decoupled == pytest.approx(apart, rel=2e-3)


@pytest.mark.slow
def test_the_running_stage_is_stable_up_to_the_gain_that_its_loop_tolerates():
    loop = stage_loop(read())

    def stable(factor) -> bool:
        return bool(np.max(np.abs(np.linalg.eigvals(loop.A - factor * loop.B @ loop.C))) < 1.0)

    assert not loop.D.any()
    low, high = 1.0, 10.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    assert low > disk_margins(loop, SAMPLE_TIME).together.gains[1]
    linear = {
        name: LINEAR[name] | {"limits__minimum": -100.0} for name in ("plant_simulator", "hysteresis_compensator")
    }
    linear["plant_simulator"] |= {"dynamics__delay": SAMPLE_TIME}
    linear["reference_generator"] = LINEAR["reference_generator"]
    for factor, grows in ((0.98, False), (1.02, True)):
        C = tuple(low * factor * value for value in MODEL["structure.C"])
        one = Stage(read(**linear, stage={"structure__C": C}))
        # a step so small that nothing saturates
        found = one.run({name: np.full(3000, 1e-9) for name in "xy"})
        error = np.array([found[name]["displacement"] - 1e-9 for name in "xy"])
        early, late = (np.sqrt(np.mean(error[:, first : first + 500] ** 2)) for first in (1000, 2500))
        assert (late > early) == grows, (factor, early, late)
        assert np.max(np.abs(error)) < 1e-5


def test_with_hysteresis_inside_the_loop_is_that_of_motions_too_small_for_any_play():
    structure = internal_structure()
    values = {f"structure__{name}": value for name, value in structure.to_mapping().items()}
    inside = read(plant_simulator=LINEAR["plant_simulator"], stage={**values, "type": "internal"})
    small = structure.small
    kept = {name: () for name in ("B_w", "C_z", "input_gains", "radii", "weights")}
    kept |= {name: tuple(getattr(small, name).ravel()) for name in "ABCD"}
    prompt = {"dynamics__delay": 0.0}
    outside = read(plant_simulator=prompt, stage={f"structure__{name}": value for name, value in kept.items()})
    z = np.exp(1j * np.array([1e-3, 0.1, 0.44, 2.0]))
    np.testing.assert_allclose(stage_loop(inside).response(z), stage_loop(outside).response(z), rtol=1e-9)
