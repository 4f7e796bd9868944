# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plants of other classes than the models: their properties, their random parameters, and what a user knows of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.laboratory.comparison.rows import Bench, around, drawn, excitation, recorded
from hysteresis_ros.laboratory.foreign import HYSTERESES, Foreign, ForeignParameters
from hysteresis_ros.recordings.loops import loop_opening

T = 5e-4
#: Only the hysteresis.
BARE = dict(lag=0.0, creep=0.0, frequencies=(5000.0, 5000.0), dampings=(0.7, 0.7), delay=0.0)

hystereses = pytest.mark.parametrize("kind", HYSTERESES)


def cycles(low: float, high: float, count: int, samples: int = 2000) -> np.ndarray:
    """Voltages [V] of sine cycles from one end of a range."""
    angle = 2.0 * np.pi * np.arange(count * samples) / samples
    return 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)


def response(voltage, **parameters) -> np.ndarray:
    return Foreign(ForeignParameters(**parameters), T).between(voltage)[:, -1]


@hystereses
def test_the_widest_loop_opens_about_as_asked_and_not_without(kind):
    voltage = cycles(0.0, 100.0, 3)
    for opening in (0.1, 0.16):
        found = response(voltage, hysteresis=kind, opening=opening, rate=0.0, **BARE)[-2000:]
        assert loop_opening(voltage[-2000:], found) / np.ptp(found) == pytest.approx(opening, rel=0.35)
    none = response(voltage, hysteresis=kind, opening=0.0, rate=0.0, **BARE)[-2000:]
    assert loop_opening(voltage[-2000:], none) < 0.01 * np.ptp(none)


@hystereses
def test_minor_loops_close_and_lie_inside_the_wide_one(kind):
    voltage = np.concatenate([cycles(0.0, 100.0, 2), cycles(30.0, 70.0, 12)])
    found = response(voltage, hysteresis=kind, rate=0.0, **BARE)
    assert found[-2000:] == pytest.approx(found[-4000:-2000], abs=2e-3 * np.ptp(found))
    minor, wide = found[-2000:], found[2000:4000]
    assert loop_opening(voltage[-2000:], minor) < 0.5 * loop_opening(voltage[2000:4000], wide)


def test_only_play_operators_with_a_rate_depend_on_the_speed():
    for kind in HYSTERESES:
        slow = response(cycles(0.0, 100.0, 3, 4000), hysteresis=kind, rate=0.5, **BARE)[-4000:]
        fast = response(cycles(0.0, 100.0, 3, 200), hysteresis=kind, rate=0.5, **BARE)[-200:]
        widths = [loop_opening(cycles(0.0, 100.0, 1, len(y)), y) for y in (slow, fast)]
        # the fine grid and the two modes at 5 kHz cost a little
        assert (widths[1] > 1.1 * widths[0]) == (kind == "play")


@hystereses
def test_a_jump_ends_where_the_same_way_ends_slowly(kind):
    """The hysteresis depends on the path alone: 0 → 100 → 20 → 70 → 0 V, in jumps and in ramps."""
    turns = [0.0, 100.0, 20.0, 70.0, 0.0]
    jumps = np.repeat(turns, 500)
    ramps = np.concatenate([np.linspace(low, high, 500) for low, high in zip([0.0, *turns[:-1]], turns, strict=True)])
    jumped, moved = (response(voltage, hysteresis=kind, rate=0.0, **BARE)[499::500] for voltage in (jumps, ramps))
    assert jumped == pytest.approx(moved, abs=2e-3 * np.ptp(moved))


def test_creep_follows_a_power_of_time():
    time = np.arange(1, 40001) * T
    still = dict(BARE, hysteresis="bouc_wen", opening=0.0)
    crept = response(np.full(40000, 50.0), **{**still, "creep": 0.04, "exponent": 0.2})
    plain = response(np.full(40000, 50.0), **still)
    risen = (crept - plain) / plain[-1]
    at = [np.interp(seconds, time, risen) for seconds in (0.1, 1.0, 10.0)]
    assert at[2] - at[0] == pytest.approx(0.04, rel=1e-3)
    # a logarithm would rise by the same amount in both decades; the power 0.2 rises by 10^0.2 = 1.6 times in the second
    assert (at[2] - at[1]) / (at[1] - at[0]) == pytest.approx(10.0**0.2, rel=0.12)


@pytest.mark.parametrize("before", [True, False])
def test_a_step_comes_after_the_delay_through_lag_and_modes(before):
    given = dict(BARE, hysteresis="duhem", opening=0.0, lag_before=before, steps=50)
    late = Foreign(ForeignParameters(**{**given, "delay": 1.3 * T, "lag": 2e-3}), T).between(np.full(200, 1.0)).ravel()
    fine = T / 50
    assert np.all(late[:65] == 0.0) and late[66] > 0.0
    final = late[-1]
    reached = np.interp(0.632 * final, late, np.arange(1, len(late) + 1) * fine)
    # two well damped modes of 5 kHz in parallel lag by about 2 ζ/ω = 45 µs
    assert reached == pytest.approx(1.3 * T + 2e-3 + 45e-6, abs=1e-4)


def test_modes_ring_at_their_frequencies_with_their_damping():
    given = dict(BARE, hysteresis="duhem", opening=0.0, frequencies=(280.0, 1300.0), dampings=(0.03, 0.02), share=0.1)
    fine = Foreign(ForeignParameters(**given), T).between(np.full(4000, 1.0)).ravel()
    rate = 10.0 / T
    spectrum = np.abs(np.fft.rfft((fine - fine[-1]) * np.hanning(len(fine))))
    frequency = np.fft.rfftfreq(len(fine), 1.0 / rate)
    for low, high, mode in ((100.0, 700.0, 280.0), (900.0, 2000.0, 1300.0)):
        band = (frequency > low) & (frequency < high)
        assert frequency[band][np.argmax(spectrum[band])] == pytest.approx(mode, rel=0.01)
    peaks = np.abs(fine - fine[-1])
    turn = round(rate / 280.0)
    late = [np.max(peaks[k : k + turn]) for k in (2000, 2000 + 5 * turn)]
    assert np.log(late[0] / late[1]) == pytest.approx(5.0 * 2.0 * np.pi * 0.03, rel=0.1)


def test_what_is_between_the_samples_is_what_the_loop_had_at_them():
    block = Foreign(ForeignParameters(), T)
    voltage = np.random.default_rng(1).uniform(0.0, 100.0, 500)
    assert np.array_equal(block.simulate(voltage), block.between(voltage)[:, -1])


def test_two_modes_are_needed():
    with pytest.raises(ParameterError, match="dampings = .*2 numbers"):
        Foreign(ForeignParameters(dampings=(0.1,)), T)


def test_drawn_plants_go_through_all_classes_with_a_mode_in_the_band_one_above_and_a_delay():
    bench = Bench()
    found = [drawn(seed, bench).actuator for seed in range(1, 41)]
    assert {actuator.hysteresis for actuator in found[:4]} == set(HYSTERESES)
    assert {actuator.lag_before for actuator in found} == {True, False}
    for actuator in found:
        first, second = actuator.frequencies
        assert 100.0 < first < 0.5 * bench.sample_rate < second
        assert actuator.delay >= 1.0 / bench.sample_rate and max(actuator.dampings) <= 0.04
    assert drawn(3, bench) == drawn(3, bench) != drawn(7, bench)


@pytest.mark.parametrize("mismatch", [0.0, 0.05])
def test_around_a_plant_are_all_its_corners(mismatch):
    """Found by the gain at rest and by the frequency at which the plants ring."""
    plants = around(drawn(2, Bench()), mismatch, 2)

    def told(plant):
        quiet = replace(plant.actuator, creep=0.0, opening=0.0, share=0.0, lag=0.0, dampings=(0.01, 0.5))
        step = Foreign(quiet, T).between(np.full(1000, 100.0)).ravel()
        final, rate = np.mean(step[-2500:]), 10.0 / T
        crossings = np.flatnonzero(np.diff(np.sign(step - final)))
        return final, 0.5 * 40 / (crossings[40] - crossings[0]) * rate

    gain, frequency = np.array([told(plant) for plant in plants]).T
    assert np.ptp(gain / gain[0]) == pytest.approx(2.0 * mismatch, abs=2e-3)
    assert np.ptp(frequency[0] / frequency) == pytest.approx(2.0 * mismatch, abs=5e-3)
    corners = {
        (round(a, 9), round(b, 9), round(c, 9))
        for a, b, c in (
            (
                p.actuator.stroke / plants[0].actuator.stroke,
                p.actuator.opening / plants[0].actuator.opening,
                p.actuator.lag / plants[0].actuator.lag,
            )
            for p in plants[1:9]
        )
    }
    assert len(corners) == (8 if mismatch else 1)
    assert all(abs(value - 1.0) == pytest.approx(mismatch) for corner in corners for value in corner)
    assert len({plant.parameters.sensor.seed for plant in plants}) == len(plants), "each plant has its own noise"


def test_a_recording_is_what_sensor_and_converter_see():
    bench, quiet = Bench(bits=8, noise=20e-9), Bench(bits=0, noise=0.0, resolution=0.0)
    plant = drawn(1, bench)
    seen, true = recorded(plant, bench, 1), recorded(plant, quiet, 1)
    assert np.array_equal(true["voltage"], excitation(quiet))
    assert np.unique(seen["voltage"]).size <= 256 and np.ptp(seen["voltage"]) == pytest.approx(100.0)
    assert np.allclose(np.rint(seen["measured"] / 1e-9), seen["measured"] / 1e-9, atol=1e-6)
    # with the same voltages, true and measured displacement differ only by noise
    there = np.concatenate([[0.0], plant.between(seen["voltage"])[:-1, -1]])
    assert np.std(seen["measured"] - there) == pytest.approx(20e-9, rel=0.03)
    assert set(seen.signals) == {"voltage", "measured"}
