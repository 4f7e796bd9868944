# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Dynamics found after a hysteresis: lag distinguished from delay, and resonances only where they exist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from foreign_plant import ForeignPlant

from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import (
    MODES,
    ModalSearch,
    ModalStructure,
    choose_dynamics,
    fit_stage,
    in_series,
    part_response,
    segment_spectra,
)
from hysteresis_ros.identification.linear_systems import LinearPart, Mode, undo
from hysteresis_ros.identification.plant_model import half_widths
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.workflow import identify, validate
from hysteresis_ros.laboratory.comparison.rows import Bench, drawn, recorded

RATE = 2000.0
STEP = 1e-3
PARTS = (
    LinearPart(lag=3e-3, hold=STEP),
    LinearPart(lag=2e-3, delay=2.3e-3, modes=(Mode(100.0, 0.03, 0.4, 0.1),), hold=STEP),
    LinearPart(modes=(Mode(100.0, 0.03), Mode(190.0, 0.1, 0.0, 0.2)), hold=STEP),
    LinearPart(delay=1e-3, modes=(Mode(100.0, 0.03, 0.6),), hold=STEP),
)


def multisine(rate: float = RATE, length: float = 8.0, amplitude: float = 50.0, seed: int = 0) -> np.ndarray:
    """Lines up to 0.4 of the rate around 50 V, repeated every 2000 samples."""
    period = 2000
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[1:800] = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=799))
    one = np.fft.irfft(spectrum)
    return 50.0 + amplitude * np.tile(one / np.abs(one).max(), int(length * rate / period))


def cycles(rate: float = RATE, length: float = 16.0, corners: bool = True, frequency: float = 1.0) -> np.ndarray:
    """Triangles or sines of 100 V from 0 V; the amplitude decays after two cycles."""
    time = np.arange(int(length * rate)) / rate
    place = (time * frequency) % 1.0
    wave = 2.0 * np.abs(2.0 * place - 1.0) - 1.0 if corners else np.cos(2.0 * np.pi * place)
    return 50.0 * (
        1.0 - np.where(time < 2.0 / frequency, 1.0, np.exp((2.0 / frequency - time) * frequency / 6.0)) * wave
    )


def recording(plant: ForeignPlant, voltage) -> IdentificationData:
    return IdentificationData(np.arange(len(voltage)) / plant.sample_rate, voltage, plant.record(voltage))


@pytest.mark.parametrize("part", PARTS)
def test_the_block_of_a_node_is_the_continuous_part_under_a_held_input(part):
    fine = 200
    held = np.repeat(np.random.default_rng(0).standard_normal(300), fine)
    late = np.append(np.zeros(round(part.delay / STEP * fine)), held)[: held.size]
    decay = np.exp(-STEP / fine / part.lag) if part.lag else 0.0
    share = 1.0 - sum(mode.position for mode in part.modes)
    truth = share * scipy.signal.lfilter([0.0, 1.0 - decay], [1.0, -decay], late)
    for mode in part.modes:
        omega = 2.0 * np.pi * mode.frequency
        transfer = ([mode.velocity * omega, mode.position * omega**2], [1.0, 2.0 * mode.damping * omega, omega**2])
        numerator, denominator, _ = scipy.signal.cont2discrete(transfer, STEP / fine)
        truth += scipy.signal.lfilter(np.ravel(numerator), denominator, late)
    found = np.convolve(held[::fine], part.impulse(300, STEP))[:300]
    np.testing.assert_allclose(found, truth[::fine], atol=1e-9)
    assert part.dynamics(STEP).state_space.dc_gain == pytest.approx(1.0, abs=1e-9)
    # the response used in the search is that of the block
    frequencies = np.array([3.0, 90.0, 200.0, 430.0])
    block = part.dynamics(STEP).state_space.held().response(np.exp(2j * np.pi * frequencies * STEP))[:, 0, 0]
    np.testing.assert_allclose(part_response(part, frequencies), block, rtol=1e-9)


def test_lag_and_modes_one_behind_the_other_are_the_product_of_their_responses():
    lag, pairs, step = 0.002, [(120.0, 0.05), (300.0, 0.02)], 1e-7
    frequencies = np.array([5.0, 110.0, 250.0, 400.0])
    s = 2j * np.pi * frequencies
    product = 1.0 / (1.0 + lag * s)
    for frequency, damping in pairs:
        omega = 2.0 * np.pi * frequency
        product *= omega**2 / (s**2 + 2.0 * damping * omega * s + omega**2)
    found = part_response(LinearPart(lag=lag, modes=in_series(lag, pairs), hold=step), frequencies)
    np.testing.assert_allclose(found, product, rtol=1e-3)


def chosen(plant: ForeignPlant, voltage) -> LinearPart:
    late = 0
    for _ in range(2):
        spectra = segment_spectra(1.2e-7 * voltage, plant.record(voltage), 1.0 / plant.sample_rate, 100, late)
        part = choose_dynamics(spectra).part
        late = round(part.group_delay * plant.sample_rate)
    return part


def test_half_of_a_95_percent_interval_has_the_unit_of_its_figure():
    numbers = {
        "lag_s": 1e-3,
        "delay_s": 2e-3,
        "mode_1_hz": 280.0,
        "mode_1_damping": 0.03,
        "creep_rate_per_decade": 0.02,
    }
    deviations = {"lag": 1e-5, "mode_1_hz": 0.1, "mode_1_damping": 1e-3, "elastic_share": 0.1}
    expected = {"lag_plus_minus_s": 1.96e-5, "mode_1_plus_minus_hz": 0.196, "mode_1_damping_plus_minus": 1.96e-3}
    assert half_widths(numbers, deviations) == pytest.approx(expected)


@pytest.mark.parametrize("turned", [False, True])
def test_the_deviations_of_two_modes_are_named_by_their_frequencies_and_there_is_none_of_the_delay(turned):
    """Whichever mode the search found first; the one with little damping and much motion is better known."""
    part = LinearPart(delay=0.75 / RATE, modes=(Mode(150.0, 0.01, 0.6), Mode(480.0, 0.1, 0.4)), hold=1.0 / RATE)
    given, noise = np.random.default_rng(1).standard_normal((2, 8000))
    search = ModalSearch(segment_spectra(given, part.apply(given, 1.0 / RATE) + 0.01 * noise, 1.0 / RATE))
    pairs = [np.log([150.0, 0.01]), np.log([480.0, 0.1])]
    values = np.concatenate([[0.75], *(pairs[::-1] if turned else pairs)])
    found = search.deviations(search.trial(ModalStructure(False, True, 2), values))
    assert list(found) == ["mode_1_hz", "mode_1_damping", "mode_2_hz", "mode_2_damping"]
    assert found["mode_1_hz"] < 0.2 * found["mode_2_hz"] and found["mode_2_damping"] < 0.1


@pytest.mark.slow
def test_the_delay_of_two_modes_behind_a_lag_is_within_its_interval():
    part = LinearPart(
        lag=0.5e-3, delay=1.25 / RATE, modes=in_series(0.5e-3, [(180.0, 0.02), (420.0, 0.03)]), hold=1.0 / RATE
    )
    errors = []
    for seed in range(4):
        given, noise = np.random.default_rng(seed).standard_normal((2, 8000))
        stage = fit_stage(given, part.apply(given, 1.0 / RATE) + 0.01 * noise, 1.0 / RATE, MODES)
        assert stage.deviations["delay"] < 0.02 / RATE
        errors.append((stage.part.delay - part.delay) / stage.deviations["delay"])
    assert np.all(np.abs(errors) < 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("outliers", [0, 20])
def test_a_mode_that_a_sweep_passes_at_its_end_is_found_in_the_samples(outliers):
    """The window of the spectra has hardly any weight there."""
    part = LinearPart(lag=1e-3, delay=0.75 / RATE, modes=in_series(1e-3, [(190.0, 0.02)]), hold=1.0 / RATE)
    time = np.arange(8000) / RATE
    given = np.sin(2.0 * np.pi * (5.0 + 23.5 * time) * time) + 3.0 * np.sin(2.0 * np.pi * time)
    random = np.random.default_rng(0)
    measured = part.apply(given, 1.0 / RATE) + 1e-3 * random.standard_normal(8000) + 0.02 * np.sin(20.0 * time)
    measured[random.integers(0, 8000, outliers)] += 2.0
    seen = choose_dynamics(segment_spectra(given, measured, 1.0 / RATE)).part.modes
    assert all(abs(mode.frequency - 190.0) > 4.0 for mode in seen)  # two modes stand for the one
    found = min(fit_stage(given, measured, 1.0 / RATE, MODES).part.modes, key=lambda mode: mode.damping)
    assert found.damping == pytest.approx(0.02, rel=0.02) and found.frequency == pytest.approx(190.0, abs=0.1)


@pytest.mark.slow
def test_a_recording_without_any_error_has_nothing_to_refine():
    part = LinearPart(lag=1e-3, modes=in_series(1e-3, [(280.0, 0.03)]), hold=1.0 / RATE)
    given = np.random.default_rng(0).standard_normal(4000)
    stage = fit_stage(given, part.apply(given, 1.0 / RATE), 1.0 / RATE, MODES)
    assert stage.part.modes[0].frequency == pytest.approx(280.0, abs=0.01)


@pytest.mark.slow
def test_deviations_of_lag_delay_and_mode_are_those_of_repeated_recordings():
    truth = {"lag": 1e-3, "delay": 0.75 / RATE, "mode_1_hz": 280.0, "mode_1_damping": 0.03}
    part = LinearPart(lag=1e-3, delay=0.75 / RATE, modes=in_series(1e-3, [(280.0, 0.03)]), hold=1.0 / RATE)
    errors = []
    for seed in range(8):
        given, noise = np.random.default_rng(seed).standard_normal((2, 3000))
        stage = fit_stage(given, part.apply(given, 1.0 / RATE) + 0.01 * noise, 1.0 / RATE, MODES)
        numbers = {"lag": stage.part.lag, "delay": stage.part.delay, **stage.numbers}
        errors.append([(numbers[name] - value) / stage.deviations[name] for name, value in truth.items()])
    errors = np.array(errors)
    assert np.all(np.abs(errors) < 3.0)
    assert np.all(np.mean(errors**2, axis=0) > 0.05), "none of them is stated much too large"
    assert 0.4 < np.mean(errors[:, :2] ** 2) < 1.4


@pytest.mark.slow
@pytest.mark.parametrize("corners", [True, False])
def test_a_lag_is_told_from_a_delay(corners):
    voltage = cycles() if corners else multisine()
    lag = chosen(ForeignPlant(RATE, hysteresis=0.0, lag=0.0187), voltage)
    assert lag.lag == pytest.approx(0.0187, rel=0.01) and lag.delay == 0.0 and not lag.modes
    both = chosen(ForeignPlant(RATE, hysteresis=0.0, lag=0.003, delay=0.002), voltage)
    assert both.lag == pytest.approx(0.003, rel=0.03) and both.delay == pytest.approx(0.002, rel=0.03)


@pytest.mark.slow
def test_resonances_are_found_where_they_are():
    two = ForeignPlant(RATE, hysteresis=0.0, lag=0.001, modes=((280.0, 0.03, 1.0), (450.0, 0.02, 0.3)))
    modes = sorted(chosen(two, multisine()).modes, key=lambda mode: mode.frequency)
    assert [round(mode.frequency) for mode in modes] == [280, 450]
    np.testing.assert_allclose([mode.damping for mode in modes], [0.03, 0.02], rtol=0.02)
    one = chosen(ForeignPlant(RATE, hysteresis=0.0, modes=((280.0, 0.03, 1.0),)), cycles())
    assert [round(mode.frequency) for mode in one.modes] == [280] and one.lag == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("plant", [ForeignPlant(RATE), ForeignPlant(RATE, modes=((280.0, 0.03, 1.0),))])
def test_no_resonance_is_found_where_nothing_excites_it(plant):
    assert not chosen(plant, cycles(corners=False)).modes


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "lag", "delay"), [(200.0, 0.0187, 0.0), (1000.0, 0.0187, 0.0), (1000.0, 0.0, 0.018)])
def test_lag_and_delay_behind_a_hysteresis_are_told_apart_by_triangles(rate, lag, delay):
    voltage = cycles(rate, 3.0, frequency=5.0)
    plant = ForeignPlant(rate, lag=lag, delay=delay)
    part = fit_prandtl_ishlinskii(voltage, plant.record(voltage), 1.0 / rate, zone_count=0).linear_part
    assert (part.lag > 0.0, part.delay > 0.0) == (lag > 0.0, delay > 0.0)
    # lines between the samples: half a sample of hold, or one sample of reading, is part of the lag
    assert 0.95 * (lag + delay) < part.group_delay < 1.1 * (lag + delay) + 1.0 / rate


@pytest.mark.slow
def test_the_resonance_behind_a_foreign_hysteresis_comes_into_the_file(tmp_path):
    plant = ForeignPlant(RATE, amplifier=0.0015, modes=((280.0, 0.03, 1.0),), rate=0.02, creep=0.02, noise=5e-9)
    data = recording(plant, multisine())
    found = identify(data, options={"zone_count": 0, "play_count": 10})
    sharp = [mode for mode in found.plant.linear_part.modes if mode.damping < 0.2]
    assert len(sharp) == 1 and sharp[0].frequency == pytest.approx(280.0, abs=1.0)
    assert sharp[0].damping == pytest.approx(0.03, rel=0.05)
    assert "mode" in found.identification.linear and found.figures["rmse_percent_of_stroke"] < 1.0
    found.save(tmp_path / "axis.yaml")
    again = validate(tmp_path / "axis.yaml", data, inverse=False)
    np.testing.assert_allclose(again.predicted, found.predicted, atol=1e-12)
    # at another rate the same continuous system runs
    other = validate(tmp_path / "axis.yaml", recording(plant, multisine(seed=1)[:4000]), inverse=False, skip=1000)
    assert other.figures["rmse_percent_of_stroke"] < 1.5


def test_the_input_of_a_resonance_comes_back():
    part = LinearPart(lag=0.001, modes=(Mode(120.0, 0.05, 0.5),), hold=STEP)
    time = np.arange(2000) * STEP
    w = np.sin(2.0 * np.pi * 4.0 * time) + 0.2 * np.sin(2.0 * np.pi * 110.0 * time)
    y = np.convolve(w, part.impulse(w.size, STEP))[: w.size]
    assert np.std((undo(y, part, STEP) - w)[200:-200]) < 0.02 * np.std(w)
    assert np.std((y - w)[200:-200]) > 0.5 * np.std(w)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 8, 13])
def test_a_strong_mode_above_half_the_rate_hides_no_mode_below_it(seed):
    """Lag and delay of a fit without modes stand for the missing modes; a search from there ends elsewhere."""
    plant = drawn(seed, Bench())
    linear = replace(plant, actuator=replace(plant.actuator, opening=1e-3, asymmetry=0.0, rate=0.0, creep=1e-6))
    recording = recorded(linear, Bench(), seed)
    found = choose_dynamics(segment_spectra(recording["voltage"], recording["measured"], 1.0 / 2000.0)).part
    low, high = plant.actuator.frequencies
    known, aliased = sorted(mode.frequency for mode in found.modes)
    assert known == pytest.approx(low, rel=5e-3) and aliased == pytest.approx(2000.0 - high, rel=5e-3)
    assert found.delay * 2000.0 > 0.5 and 0.0 < found.lag < 2e-3
