# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A drifting plant: finally it is the requested plant, and on the way there are no jumps."""

from __future__ import annotations

import numpy as np
import pytest
from adapting_support import adapting

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import drifting, simulate

SAMPLES = 6000
FIXED = {"adaptation__type": "none"}


@pytest.mark.parametrize(("gain", "opening"), [(0.02, 0.0), (-0.02, 0.02), (0.0, -0.02)])
def test_a_plant_has_drifted_by_what_was_asked_for_and_never_jumped(gain, opening):
    axis = Axis(adapting(FIXED))
    before = np.array(axis.plant.parameters.hysteresis.prandtl_ishlinskii.weights)
    changes = drifting(axis.parameters, SAMPLES, gain, opening)
    assert len(changes) == 20 and changes[-1].sample == SAMPLES - 1
    moved = axis.run(axis.default_setpoints(SAMPLES), changes=changes)["displacement"]
    after = np.array(axis.plant.parameters.hysteresis.prandtl_ishlinskii.weights)
    np.testing.assert_allclose(after / before, (1.0 + gain) * np.where(np.arange(20) > 0, 1.0 + opening, 1.0))
    steps = np.abs(np.diff(moved[400:]))
    assert steps.max() < 1.5 * np.percentile(steps, 99)


@pytest.mark.slow
def test_without_drift_a_run_is_as_it_was_and_with_it_the_inverse_follows():
    given = adapting()
    plain, none = (simulate(given, duration=2.0, **words) for words in ({}, {"drift": (0.0, 0.0)}))
    np.testing.assert_array_equal(plain["displacement"], none["displacement"])
    drifted = simulate(given, duration=80.0, drift=(0.05, 0.0))["adapted_gain"]
    settled = simulate(given, duration=40.0)["adapted_gain"][-1]
    # a memory of eight seconds is a tenth of the drift
    assert drifted[-1] / settled == pytest.approx(1.05, abs=0.01)


@pytest.mark.parametrize(
    ("name", "gain", "said"), [("picma_stage", 0.6, "drift gain"), ("inchworm_travel", 0.1, "simulated actuator")]
)
def test_what_cannot_drift_is_refused(name, gain, said):
    with pytest.raises(ParameterError, match=said):
        drifting(single_axis(load_configuration(name)), 1000, gain)
