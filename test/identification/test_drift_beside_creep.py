# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Drift is told from creep: a line in time counts only where it is more than slow creep could be."""

from dataclasses import replace

import numpy as np
import pytest

import hysteresis_ros as hr
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.drift import drift_beside_creep
from hysteresis_ros.identification.hammerstein import seen_drift, without_drift
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.prandtl_ishlinskii import FreeWeights, fit_prandtl_ishlinskii
from hysteresis_ros.identification.preprocessing import condense
from hysteresis_ros.identification.procedures import predicted_error
from hysteresis_ros.identification.workflow import identify
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters

STEP = 0.005
TIME = np.arange(1000) * STEP
VOLTAGE = 50.0 - 50.0 * np.exp(-0.3 * TIME) * np.cos(2.0 * np.pi * TIME)
PLAYS = PrandtlIshlinskiiParameters((0.0, 10.0, 20.0, 30.0, 40.0), (60e-9, 8e-9, 8e-9, 8e-9, 8e-9))


def recorded(creep=0.0, time_constant=1.0, drift=0.0, seed=1):
    """Displacement [m] of plays with one relaxation, a drift [m/s], and 10 nm of noise."""
    moved = PrandtlIshlinskiiHysteresis(PLAYS, STEP).simulate(VOLTAGE)
    relaxed = LinearPart(lag=time_constant).apply(moved, STEP)
    return moved + creep * relaxed + drift * TIME + 10e-9 * np.random.default_rng(seed).standard_normal(len(TIME))


def seen(displacement):
    """Drift that a fit without creep shows."""
    return seen_drift(FreeWeights(condense(VOLTAGE, displacement, STEP), 20, 0).behind(LinearPart()))


@pytest.mark.parametrize("time_constant", [5.0, 15.0, 50.0])
def test_creep_beyond_the_recording_is_no_drift(time_constant):
    found = seen(recorded(0.01, time_constant))
    assert not found.certain and abs(found.value) < 2.0 * found.deviation


@pytest.mark.parametrize("drift", [-0.3e-6, 0.3e-6])
def test_a_drift_beyond_creep_is_certain_and_within_its_deviation(drift):
    found = seen(recorded(0.01, 15.0, drift))
    assert found.certain and abs(found.value - drift) < 2.0 * found.deviation


def test_the_deviation_is_that_of_a_line_where_nothing_creeps():
    data = condense(VOLTAGE, recorded(), STEP, skip=0)
    noise = 10e-9 * np.random.default_rng(3).standard_normal((200, len(TIME)))
    found = [drift_beside_creep(data, np.zeros(len(TIME)), values, False) for values in noise]
    assert np.mean([one.deviation for one in found]) == pytest.approx(10e-9 * (12.0 / len(TIME)) ** 0.5 / 5.0, rel=0.1)
    within = np.mean([abs(one.value) < 2.0 * one.deviation for one in found])
    assert 0.9 <= within <= 0.99


@pytest.mark.slow
def test_an_identification_takes_slow_creep_for_no_drift_and_finds_a_drift_beside_it():
    # held-out blocks alone prefer a drift of 20 nm/s to this creep
    still = fit_prandtl_ishlinskii(VOLTAGE, recorded(0.03, 5.0), STEP, density="exponential", linear=("lag",))
    assert still.drift == 0.0 and "drift_m_per_s" not in still.numbers and still.drift_deviation > 0.0
    moving = fit_prandtl_ishlinskii(VOLTAGE, recorded(0.01, 5.0, 0.3e-6), STEP, density="exponential")
    assert moving.drift == pytest.approx(0.3e-6, abs=2.0 * moving.drift_deviation)


@pytest.mark.slow
def test_decaying_loops_of_another_model_are_no_drift():
    cycle = 0.5 - 0.5 * np.cos(np.linspace(0.0, 2.0 * np.pi, 200))
    voltage = np.concatenate([100.0 * cycle, 70.0 * cycle, 40.0 * cycle])
    data = condense(voltage, hr.models.BoucWen.example().simulate(voltage), 1e-3, skip=0)

    def fit(data):
        return FreeWeights(data, 8, 0).behind(LinearPart())

    # with a line, which is not part of the model, the fit has 49 nm
    found = without_drift(fit, data)
    assert not found.data.drifts and np.std(found.output() - data.displacement) < 80e-9
    drifting = replace(data, displacement=data.displacement + 10e-6 * np.linspace(0.0, 1.0, len(voltage)))
    assert without_drift(fit, drifting).data.drifts


@pytest.mark.slow
def test_the_error_with_a_drift_is_stated_too():
    time = np.arange(1200) * STEP
    voltage = 50.0 - 50.0 * np.cos(2.0 * np.pi * time)
    measured = 1e-7 * voltage + 0.3e-6 * time + 10e-9 * np.random.default_rng(1).standard_normal(len(time))
    data = IdentificationData(time, voltage, measured)
    found = identify(data, "proportional", linear="none")
    error = float(np.sqrt(np.mean((found.predict(voltage) - measured)[found.figures["skipped"] :] ** 2)))
    assert found.figures["rmse_m"] < 11e-9 < 1e-6 < error
    assert found.figures["rmse_with_drift_m"] == pytest.approx(error, rel=1e-6)
    assert any("the model does not drift, so its RMS error on the recording itself is 1." in w for w in found.warnings)


def test_the_predicted_error_adds_what_the_recording_does_not_determine():
    # 3, 4 and 12 nm: held out, other densities, and a line of up to 1.73 times 12 nm after 5 s
    numbers = {
        "held_out_rmse_m": 3e-9,
        "ambiguity_rms_m": 3.0**0.5 * 4e-9,
        "drift_deviation_m_per_s": 3.0**0.5 * 2.4e-9,
    }
    assert predicted_error(numbers, 5.0, 3.5e-9) == {"predicted_rmse_m": pytest.approx(13e-9, rel=1e-9)}
    # held-out parts have 9 nm; 31.5 nm² less in the fit make 12 nm on other loops
    numbers["held_out_rmse_m"], fitted = 9e-9, (81.0 - 31.5) ** 0.5 * 1e-9
    assert predicted_error(numbers, 5.0, fitted)["predicted_rmse_m"] == pytest.approx((144.0 + 160.0) ** 0.5 * 1e-9)
    assert predicted_error({"drift_deviation_m_per_s": 1e-9}, 5.0, 0.0) == {}
