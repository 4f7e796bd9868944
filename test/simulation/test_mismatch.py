# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Random plants: every factor within its bound, common corners, equal seeds give equal plants, models unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.uncertainty import slowed
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import mismatched
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.models.linear import LinearParameters


def plant_of(name: str, mismatch: float, seed: int):
    return single_axis(mismatched(load_configuration(name), mismatch, seed)).plant_simulator


@pytest.mark.parametrize("name", ["kim2009", "picma_stage"])
def test_no_mismatch_is_the_configured_plant(name):
    configured = single_axis(load_configuration(name)).plant_simulator
    drawn = plant_of(name, 0.0, 3)
    voltages = np.concatenate([np.linspace(0.0, 3.0, 50), np.linspace(3.0, 1.0, 30), np.linspace(1.0, 3.6, 40)])
    same, as_drawn = (
        hysteresis_block(plant.hysteresis, 1.0).simulate(voltages * plant.limits.maximum / 3.6)
        for plant in (configured, drawn)
    )
    assert as_drawn == pytest.approx(same, rel=1e-12)
    assert pytest.approx(configured.dynamics.A, abs=1e-12) == drawn.dynamics.A


def test_a_seed_names_a_plant_and_the_models_stay():
    configuration = load_configuration("picma_stage")
    first, again, other = (single_axis(mismatched(configuration, 0.05, seed)) for seed in (1, 1, 2))
    assert first.plant_simulator == again.plant_simulator != other.plant_simulator
    configured = single_axis(configuration)
    assert first.hysteresis_compensator == configured.hysteresis_compensator
    assert first.motion_controller == configured.motion_controller


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), mismatch=st.floats(0.0, 0.2))
def test_factors_stay_within_their_bounds(seed, mismatch):
    configured = single_axis(load_configuration("picma_stage")).plant_simulator
    drawn = plant_of("picma_stage", mismatch, seed)
    pairs = configured.hysteresis.prandtl_ishlinskii, drawn.hysteresis.prandtl_ishlinskii
    ratio = np.divide(*(np.array(item.weights) for item in pairs[::-1]))
    # gain, loop width and a separate factor
    assert np.all(ratio >= (1.0 - mismatch) ** 3 - 1e-12) and np.all(ratio <= (1.0 + mismatch) ** 3 + 1e-12)
    assert drawn.creep.logarithmic.rate == pytest.approx(configured.creep.logarithmic.rate, rel=mismatch + 1e-12)
    time = [-1.0 / np.log(item.dynamics.A[0]) for item in (configured, drawn)]
    assert time[1] == pytest.approx(time[0], rel=mismatch + 1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_branches_of_a_drawn_polynomial_plant_still_meet_at_their_corners(seed):
    drawn = plant_of("kim2009", 0.05, seed).hysteresis.polynomial
    for peak in (20.0, 60.0, 120.0):
        upper = []
        for branch in ("rising", "falling"):
            D, C1, C2 = (np.polyval(getattr(drawn, f"{branch}_{name}")[::-1], peak) for name in ("D", "C1", "C2"))
            upper.append(D + C1 * peak + C2 * peak**2)
        assert upper[0] == pytest.approx(upper[1], rel=1e-12)


def test_slower_dynamics_have_the_same_gain_and_longer_times():
    dynamics = single_axis(load_configuration("kim2009")).plant_simulator.dynamics
    changed = slowed(dynamics, 1.1)
    slow = LinearParameters(A=tuple(changed["A"]), B=tuple(changed["B"]), C=dynamics.C)
    assert slow.state_space.dc_gain == pytest.approx(dynamics.state_space.dc_gain, rel=1e-12)
    before = np.sort_complex(np.log(dynamics.state_space.poles.astype(complex)))
    after = np.sort_complex(np.log(slow.state_space.poles.astype(complex)))
    assert after * 1.1 == pytest.approx(before, rel=1e-9)
    assert slowed(LinearParameters(), 1.1) == {}


def test_a_mismatch_beyond_sense_is_refused():
    with pytest.raises(ParameterError, match="mismatch = 0.6.*0 … 0.5"):
        mismatched(load_configuration("picma_stage"), 0.6, 1)
