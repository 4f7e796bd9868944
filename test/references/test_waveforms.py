# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Waveforms compared with their closed forms, for small and huge sample counters."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.references import Waveform, WaveformParameters, declaration

TS = 1.0 / 3000.0
A = 5e-6


def waveform(sample_time=TS, **mapping):
    """Build a waveform; dots of names are written as two underscores."""
    return Waveform(
        WaveformParameters.from_mapping({name.replace("__", "."): value for name, value in mapping.items()}),
        sample_time,
    )


def play(w, count, start=0):
    w.x[0] = start
    return w.simulate(np.zeros(count))


ALL = {
    "hold": dict(offset=1e-6),
    "steps": dict(steps__values=(1e-6, 3e-6), steps__times=(0.1, 0.2), steps__period=0.5),
    "square": dict(amplitude=A, frequency=3.0, square__duty=0.25),
    "triangle": dict(amplitude=A, frequency=2.0),
    "decreasing_triangle": dict(amplitude=A, frequency=2.0, cycles=4),
    "sine": dict(amplitude=A, frequency=3.7, phase=0.3, offset=1e-6),
    "decaying_sine": dict(amplitude=A, frequency=7.0, decaying_sine__decay_time=0.3),
    "staircase": dict(amplitude=A, frequency=2.0, staircase__steps=5),
    "multisine": dict(amplitude=A, frequency=10.0, multisine__last_harmonic=20),
    "chirp": dict(amplitude=A, frequency=1.0, chirp__final_frequency=100.0, chirp__duration=2.0),
}


def test_hold_is_its_offset():
    assert np.all(play(waveform(type="hold", offset=2e-6), 10) == 2e-6)


def test_steps_change_at_the_first_sample_of_their_time():
    w = waveform(1e-3, type="steps", **{"steps.values": (1e-6, -2e-6), "steps.times": (0.003, 0.0071)})
    expected = [0.0] * 3 + [1e-6] * 5 + [-2e-6] * 4
    assert np.array_equal(play(w, 12), expected)
    assert play(w, 1, 10**12)[0] == -2e-6
    assert (w.lowest, w.highest) == (-2e-6, 1e-6)


def test_steps_repeat_and_end():
    w = waveform(
        1e-3, type="steps", cycles=2, **{"steps.values": (1.0, 2.0), "steps.times": (0, 2e-3), "steps.period": 4e-3}
    )
    assert np.array_equal(play(w, 12), [1, 1, 2, 2, 1, 1, 2, 2, 2, 2, 2, 2])


def test_square_has_exactly_its_duty_cycle():
    w = waveform(1e-3, type="square", amplitude=A, frequency=10.0, offset=1e-6, square__duty=0.3)
    assert np.array_equal(play(w, 300), np.tile([1e-6 + A] * 30 + [1e-6] * 70, 3))


@given(period=st.integers(2, 3000), cycle=st.integers(0, 10**9))
@settings(deadline=None, max_examples=60)
def test_square_edges_fall_on_their_samples_at_any_counter(period, cycle):
    w = waveform(type="square", amplitude=A, frequency=3000.0 / period)
    got = play(w, period, cycle * period)
    assert np.array_equal(got, np.where(np.arange(period) < math.ceil(period / 2), A, 0.0))


@pytest.mark.parametrize(("polarity", "lowest"), [("unipolar", 0.0), ("symmetric", -A)])
def test_triangle_corners_slope_and_range(polarity, lowest):
    w = waveform(1e-3, type="triangle", amplitude=A, frequency=2.0, polarity=polarity)
    y = play(w, 1000)
    slope = (A - lowest) / 0.25 * 1e-3
    assert (y[0], y.min(), y.max()) == pytest.approx((0.0, lowest, A), abs=1e-21)
    assert (w.lowest, w.highest) == (lowest, A)
    assert np.abs(np.diff(y)) == pytest.approx(np.full(999, slope), rel=1e-9)


def test_decreasing_triangle_peaks_shrink_linearly_to_zero():
    w = waveform(1e-3, type="decreasing_triangle", amplitude=A, frequency=2.0, cycles=4, offset=1e-6)
    y = play(w, 2400)
    assert y[250:2000:500] == pytest.approx(1e-6 + A * np.array([1, 0.75, 0.5, 0.25]))
    assert y[0:2500:500] == pytest.approx(1e-6)
    assert np.all(y[2000:] == 1e-6)


def test_sine_is_the_closed_form_with_phase():
    k = np.arange(6000)
    y = play(waveform(type="sine", amplitude=A, frequency=3.7, phase=-1.0, offset=1e-6), k.size)
    assert y == pytest.approx(1e-6 + A * np.sin(2 * np.pi * 3.7 * k * TS - 1.0), abs=1e-12 * A)


def test_decaying_sine_is_the_closed_form_and_holds_its_end():
    k = np.arange(1000)
    w = waveform(
        1e-3, type="decaying_sine", amplitude=A, frequency=5.0, phase=1.0, cycles=4, decaying_sine__decay_time=0.2
    )
    t = np.minimum(k * 1e-3, 0.8)
    closed = A * np.exp(-t / 0.2) * np.sin(2 * np.pi * 5.0 * t + 1.0)
    assert play(w, k.size) == pytest.approx(closed, abs=1e-11 * A)


@pytest.mark.parametrize("polarity", ["unipolar", "symmetric"])
def test_staircase_levels_are_equidistant_and_equally_long(polarity):
    y = play(
        waveform(1e-3, type="staircase", amplitude=4.0, frequency=1.0, staircase__steps=4, polarity=polarity), 1000
    )
    levels = [0, 1, 2, 3, 4, 3, 2, 1]
    if polarity == "symmetric":
        levels += [0, -1, -2, -3, -4, -3, -2, -1]
    starts = np.arange(1000) * len(levels) // 1000
    assert y == pytest.approx(np.array(levels, dtype=float)[starts])


@pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
def test_chirp_is_the_closed_form_of_its_sweep(sweep):
    f0, f1, duration = 2.0, 200.0, 3.0
    w = waveform(type="chirp", amplitude=A, frequency=f0, phase=0.5, cycles=1, chirp__final_frequency=f1,
                 chirp__duration=duration, chirp__sweep=sweep)  # fmt: skip
    t = np.minimum(np.arange(9100) * TS, duration)
    if sweep == "linear":
        turns = f0 * t + 0.5 * (f1 - f0) * t**2 / duration
    else:
        turns = f0 * duration / math.log(f1 / f0) * ((f1 / f0) ** (t / duration) - 1.0)
    assert play(w, t.size) == pytest.approx(A * np.sin(2 * np.pi * turns + 0.5), abs=1e-9 * A)


@pytest.mark.parametrize("phases", ["schroeder", "random"])
def test_multisine_has_a_flat_spectrum_on_its_harmonics_only(phases):
    band = dict(multisine__first_harmonic=3, multisine__last_harmonic=41, multisine__harmonic_step=2)
    w = waveform(type="multisine", amplitude=A, frequency=10.0, multisine__phases=phases, **band)
    y = play(w, 300)
    magnitude = np.abs(np.fft.rfft(y)) / 150
    excited = np.arange(3, 42, 2)
    assert magnitude[excited] == pytest.approx(np.full(20, magnitude[3]))
    assert np.max(np.delete(magnitude, excited)) < 1e-12 * A
    assert np.max(np.abs(y)) == pytest.approx(A)
    assert np.max(np.abs(y)) <= A
    assert w.crest_factor == pytest.approx(np.max(np.abs(y)) / np.sqrt(np.mean(y**2)))
    assert (w.lowest, w.highest) == pytest.approx((y.min(), y.max()))


def test_schroeder_phases_keep_the_crest_factor_low():
    """Schroeder (1970): near the crest factor of a swept sine, far below √(2 M) of equal phases."""
    w = waveform(type="multisine", amplitude=A, frequency=1.0, multisine__last_harmonic=100)
    assert math.sqrt(2) < w.crest_factor < 1.8


def test_random_phases_depend_on_the_seed_alone():
    def samples(seed):
        return play(waveform(type="multisine", amplitude=A, frequency=10.0, multisine__phases="random",
                             multisine__seed=seed), 300)  # fmt: skip

    assert np.array_equal(samples(7), samples(7))
    assert not np.allclose(samples(7), samples(8))


@pytest.mark.parametrize("kind", [k for k in ALL if k not in ("decreasing_triangle", "decaying_sine")])
def test_output_repeats_bit_for_bit_at_huge_counters(kind):
    w = waveform(type=kind, **ALL[kind])
    assert w.period is not None
    first = play(w, 3000)
    assert np.array_equal(play(w, 3000, w.period * (10**12 // w.period)), first)


@given(frequency=st.floats(1e-3, 1499.0), rate=st.floats(3000.0, 20000.0), k=st.integers(0, 2 * 10**9))
@settings(deadline=None, max_examples=50)
def test_position_is_accurate_after_two_milliard_samples(frequency, rate, k):
    w = waveform(1.0 / rate, type="triangle", amplitude=1.0, frequency=frequency)
    exact = Fraction(frequency) * Fraction(1.0 / rate) * k
    # The rule may use frequency · sample time as the fraction that agrees within the rounding of the two.
    allowed = 1e-14 + float(exact) * 2.0**-51
    difference = declaration.turns(w.p, float(k)) - float(exact - math.floor(exact))
    assert abs(difference - round(difference)) <= allowed


@pytest.mark.parametrize("frequency", [3.7, 1.0 / 3.0, math.pi, 1499.0])
@pytest.mark.parametrize("phase", [0.0, 2.0])
def test_end_holds_the_final_value(frequency, phase):
    w = waveform(type="sine", amplitude=A, frequency=frequency, phase=phase, cycles=3)
    end = math.ceil(Fraction(3) / (Fraction(frequency) * Fraction(TS)) - Fraction(1, 10**9))
    y = play(w, end + 10)
    assert np.all(y[end:] == y[end])
    assert y[end] == pytest.approx(A * math.sin(phase), abs=1e-12 * A)


@pytest.mark.parametrize("kind", ALL)
def test_output_stays_in_the_stated_range(kind):
    w = waveform(type=kind, **ALL[kind])
    y = play(w, 20000)
    assert w.lowest - 1e-20 <= y.min() <= y.max() <= w.highest + 1e-20


@pytest.mark.parametrize("kind", ALL)
def test_compiled_and_interpreted_agree(kind, monkeypatch):
    w = waveform(type=kind, **ALL[kind])
    compiled = play(w, 700, 12345)
    plain = interpreted(w.kernel)
    for helper in ("turns", "whole_turns", "triangle_shape"):
        if helper in plain.__globals__:
            monkeypatch.setitem(plain.__globals__, helper, interpreted(getattr(declaration, helper)))
    w.x[0] = 12345
    assert compiled == pytest.approx([plain(w.p, w.x, 0.0) for _ in range(700)], abs=1e-12 * A, rel=0)


@pytest.mark.parametrize("kind", ALL)
def test_restored_state_goes_on_the_same(kind):
    w = waveform(type=kind, **ALL[kind])
    play(w, 777)
    state = w.state
    expected = w.simulate(np.zeros(500))
    w.reset()
    w.state = state
    assert np.array_equal(w.simulate(np.zeros(500)), expected)


@pytest.mark.parametrize(
    ("mapping", "name"),
    [
        (dict(type="sine", frequency=0.0), "frequency"),
        (dict(type="sine", frequency=1500.1), "waveform.frequency"),
        (dict(type="decreasing_triangle"), "cycles"),
        (dict(type="triangle_wave"), "type"),
        (dict(type="steps"), "steps.values"),
        (dict(type="steps", steps__values=(1.0, 2.0), steps__times=(0.0,)), "steps.times"),
        (dict(type="steps", steps__values=(1.0, 2.0), steps__times=(0.1, 0.1)), "steps.times"),
        (dict(type="steps", steps__values=(1.0, 2.0), steps__times=(0.10001, 0.1002)), "waveform.steps.times"),
        (dict(type="multisine", frequency=7.0, amplitude=A), "waveform.frequency"),
        (dict(type="multisine", frequency=100.0, multisine__last_harmonic=15), "waveform.multisine.last_harmonic"),
        (dict(type="chirp", chirp__duration=1.0, chirp__final_frequency=2000.0), "waveform.chirp.final_frequency"),
        (dict(type="chirp", chirp__duration=1.0, chirp__final_frequency=0.0, chirp__sweep="logarithmic"),
         "chirp.final_frequency"),
        (dict(type="file"), "file.path"),
    ],
)  # fmt: skip
def test_wrong_parameters_are_named(mapping, name):
    with pytest.raises(ParameterError) as error:
        waveform(**mapping)
    assert name in [problem.name for problem in error.value.problems]
