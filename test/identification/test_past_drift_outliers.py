# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Initial state, drift and outliers, for models without own terms for them."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.bouc_wen import simulate_oscillator
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.drift import drift_of
from hysteresis_ros.identification.plant_model import pass_through
from hysteresis_ros.identification.preprocessing import cleaned
from hysteresis_ros.identification.workflow import identify, validate
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.hysteresis import MODELS, hysteresis_block
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis, BoucWenParameters
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters

STEP = 0.005
TIME = np.arange(800) * STEP
GROWING = 25.0 * (TIME + 0.2) * (1.0 - np.cos(2.0 * np.pi * TIME)) / 2.1
CYCLES = 50.0 * (1.0 - np.cos(2.0 * np.pi * TIME))
BOUC_WEN = BoucWenParameters(d_e=1.2e-7, alpha=4e-8, beta=0.02, gamma=0.008)


def data(voltage, displacement) -> IdentificationData:
    noise = 1e-9 * np.random.default_rng(2).standard_normal(len(voltage))
    return IdentificationData(np.arange(len(voltage)) * STEP, voltage, displacement + noise)


def bouc_wen(voltage, history=()) -> np.ndarray:
    block = BoucWenHysteresis(BOUC_WEN, STEP)
    pass_through(block, history)
    return block.simulate(voltage)


def far_off(found) -> float:
    """Largest relative error of the parameters."""
    names = ("d_e", "alpha", "beta", "gamma")
    return max(abs(getattr(found.parameters, name) / getattr(BOUC_WEN, name) - 1.0) for name in names)


@pytest.mark.slow
def test_a_remanent_bouc_wen_element_is_found_behind_its_past():
    recording = data(GROWING, bouc_wen(GROWING, (90.0, 0.0)))
    wrong = identify(recording, "bouc_wen", linear="none", initial="zero")
    for initial in (None, "estimate"):
        found = identify(recording, "bouc_wen", linear="none", initial=initial)
        assert "remanent" in found.figures["start"]
        assert found.figures["rmse_m"] < 0.01e-6
        assert far_off(found) < 0.25 * far_off(wrong) and far_off(found) < 0.1


@pytest.mark.slow
def test_one_cycle_of_a_repeated_drive_is_fitted_as_such():
    recording = data(CYCLES[:200], bouc_wen(np.tile(CYCLES[:200], 2))[200:])
    found = identify(recording, "bouc_wen", linear="none", initial="periodic")
    assert far_off(found) < 0.02 and found.figures["rmse_m"] < 1.2e-9
    assert found.plant.initial == "periodic" and found.figures["start"].startswith("as requested")


@pytest.mark.slow
def test_a_rest_that_explains_the_beginning_keeps_the_first_rise():
    virgin = identify(data(CYCLES, bouc_wen(CYCLES)), "bouc_wen", linear="none")
    assert "explains its beginning" in virgin.figures["start"] and far_off(virgin) < 0.02
    remanent = data(CYCLES, bouc_wen(CYCLES, (150.0, 0.0)))
    assert "omitted" in identify(remanent, "bouc_wen", linear="none").figures["start"]
    assert far_off(identify(remanent, "bouc_wen", linear="none", initial="estimate")) < 0.02


@pytest.mark.slow
def test_the_highest_voltage_of_the_past_decides_the_polynomial_branches():
    block = MODELS["polynomial"].block(MODELS["polynomial"].example, STEP)
    pass_through(block, (80.0, 0.0))
    recording = data(GROWING, block.simulate(GROWING))
    found, wrong = (identify(recording, "polynomial", linear="none", initial=start) for start in ("estimate", "zero"))
    assert found.figures["rmse_m"] < 0.1 * wrong.figures["rmse_m"]


@pytest.mark.slow
@pytest.mark.parametrize("model, error", [("polynomial", 0.02), ("bouc_wen", 5e-4), ("proportional", 5e-4)])
def test_drift_and_samples_far_off_leave_the_model_alone(model, error):
    gain = 1e-7 * CYCLES
    clean = gain if model == "proportional" else bouc_wen(CYCLES)
    spoilt = clean + 0.3e-6 * TIME
    spoilt[205::97] += 4e-6
    voltage = np.linspace(0.0, 90.0, 200)
    undisturbed, found = (identify(data(CYCLES, y), model, linear="none") for y in (clean, spoilt))
    shapes = undisturbed.plant.hysteresis, found.plant.hysteresis
    before, after = (hysteresis_block(shape, STEP).simulate(voltage) for shape in shapes)
    assert np.std(after - before) < error * np.ptp(before)
    assert found.figures["drift_m_per_s"] == pytest.approx(0.3e-6, rel=0.06)
    assert found.figures["outliers"] == 7
    assert any("drifts by 0.3" in text for text in found.warnings)
    assert any("7 outliers" in text for text in found.warnings)


def test_what_is_far_off_is_put_where_the_fit_expects_it():
    truth = np.sin(TIME)
    spoilt = truth + 0.5 * TIME + 0.1
    spoilt[[100, 333]] += 7.0
    recording = IdentificationData(TIME, CYCLES, spoilt)
    found = cleaned(recording, truth)
    assert found.outliers == 2 and found.drift == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(found.data.output, truth + 0.1, atol=1e-3)
    # a long deviation is not an outlier, and many outliers mean that the model is wrong
    spoilt[500:530] += 7.0
    assert cleaned(IdentificationData(TIME, CYCLES, spoilt), truth).outliers in range(2, 24)
    spoilt[::7] += 7.0
    assert cleaned(IdentificationData(TIME, CYCLES, spoilt), truth).outliers == 0


def test_a_drift_has_to_go_on_through_all_blocks():
    places, noise = np.arange(1000), np.random.default_rng(3).standard_normal(1000)
    assert drift_of(noise + 0.01 * places, places) == pytest.approx(0.01, rel=0.05)
    assert drift_of(noise, places) == 0.0
    assert drift_of(noise + 10.0 * (places > 900), places) == 0.0


OSCILLATOR = BoucWenMechanicalParameters(
    mass=2.0, damping=10.0, stiffness=5e4, alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1
)
GUESS = dict(mass=2.1, damping=11.0, stiffness=4.8e4, alpha=5.3e4, beta=1e3, gamma=0.85, delta=-1.05, trials=0)


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="takes minutes without Numba")
def test_an_oscillator_in_a_repeated_drive_with_drift_and_outliers():
    rate, count = 750.0, 1024
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    spectrum[2:200] = np.exp(2j * np.pi * np.random.default_rng(5).random(198))
    u = np.fft.irfft(spectrum, count)
    u *= 50.0 / u.std()
    truth = simulate_oscillator(OSCILLATOR, np.tile(u, 3), 1.0 / rate, "zoh")[2 * count :]
    y = truth + 1e-6 * np.random.default_rng(6).standard_normal(count)
    time = np.arange(count) / rate
    recording = IdentificationData(time, u, y + 2e-4 * time)
    recording.output[77::211] += 5e-3
    found = identify(recording, "bouc_wen_mechanical", options=GUESS, initial="periodic")
    assert found.figures["outliers"] == 5
    assert found.figures["drift_m_per_s"] == pytest.approx(2e-4, rel=0.05)
    for name in ("mass", "stiffness", "alpha"):
        assert getattr(found.parameters, name) == pytest.approx(getattr(OSCILLATOR, name), rel=0.02)
    quiet = identify(IdentificationData(time, u, y), "bouc_wen_mechanical", options=GUESS)
    assert quiet.plant.initial == "periodic" and "periodic" in quiet.figures["start"]
    assert quiet.figures["rmse_m"] < 1.2e-6
    checked = validate(found, IdentificationData(time, u, y))
    assert checked.figures["start"] == quiet.figures["start"] and checked.figures["rmse_m"] < 2e-6


def test_the_state_of_an_oscillator_is_not_estimated():
    recording = data(CYCLES, bouc_wen(CYCLES))
    with pytest.raises(IdentificationError, match=r"state of an oscillator is not fitted.*--skip"):
        identify(recording, "bouc_wen_mechanical", options=GUESS, initial="estimate")
