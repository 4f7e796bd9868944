# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Display of signals at kilohertz: no peak is lost, for any number of screen columns."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hysteresis_ros.laboratory.watch.views import History, amplitude_density, extremes, outline

VALUES = st.floats(-1e6, 1e6) | st.just(float("nan"))


@st.composite
def tables(draw):
    """Signals, and the number of samples per bin: (rows, bins × length)."""
    rows, bins, length = draw(st.integers(1, 4)), draw(st.integers(0, 6)), draw(st.integers(1, 9))
    return draw(arrays(float, (rows, bins * length), elements=VALUES)), length


@pytest.mark.slow
@given(tables())
def test_each_bin_keeps_its_least_and_greatest_value_in_their_order(given_table):
    table, length = given_table
    found = extremes(table, length)
    for row, bins in zip(table, found, strict=True):
        for values, (first, second) in zip(row.reshape(-1, length), bins, strict=True):
            known = values[np.isfinite(values)]
            if not known.size:
                assert np.isnan([first, second]).all()
                continue
            assert {first, second} == {known.min(), known.max()}
            places = np.flatnonzero(values == first), np.flatnonzero(values == second)
            assert places[0].min() <= places[1].max()


@pytest.mark.slow
@given(tables())
def test_a_curve_keeps_the_extremes_of_all_its_signals_and_their_pairs(given_table):
    table, length = given_table
    points = outline(table, length)
    pairs = {tuple(column) for column in np.nan_to_num(table.T, nan=-9e9)}
    assert {tuple(column) for column in np.nan_to_num(points.T, nan=-9e9)} <= pairs
    if np.isfinite(table).all() and table.size:
        assert np.array_equal(points.min(axis=1), table.min(axis=1))
        assert np.array_equal(points.max(axis=1), table.max(axis=1))


@pytest.mark.slow
@given(st.lists(st.integers(0, 40), max_size=30), st.integers(2, 25))
def test_the_last_samples_are_there_whatever_came_in_how_many_pieces(counts, kept):
    history = History(2, kept)
    for count in counts:
        history.append(np.array([[1.0], [-1.0]]) * np.arange(history.end, history.end + count))
    assert history.end == sum(counts) and history.end - history.begin == min(sum(counts), kept)
    expected = np.arange(history.begin, history.end, dtype=float)
    assert np.array_equal(history.part(history.begin, history.end), [expected, -expected])


def test_the_area_below_the_spectrum_is_the_variance_and_a_line_stands_where_it_belongs():
    rate, amplitude, frequency = 3000.0, 5e-9, 187.5
    time = np.arange(24000) / rate
    noise = np.random.default_rng(1).normal(0.0, 1e-9, time.size)
    found, density = amplitude_density(noise, rate)
    # white noise: a density of σ √(2 / rate) at all frequencies; the largest value of each displayed step
    assert np.median(density[found < 20.0]) == pytest.approx(1e-9 * np.sqrt(2.0 / rate), rel=0.25)
    found, density = amplitude_density(noise + amplitude * np.sin(2.0 * np.pi * frequency * time), rate)
    assert found[density.argmax()] == pytest.approx(frequency, rel=0.02)
    # Hann: a line of amplitude a is a / √(2 · 1.5 Δf) high
    assert density.max() == pytest.approx(amplitude / np.sqrt(3.0 * rate / 4096), rel=0.1)


def test_the_spectrum_begins_with_the_lowest_frequency_above_zero():
    found, density = amplitude_density(np.sin(2.0 * np.pi * np.arange(8000) * 7.0 / 1024.0), 1000.0)
    assert found[0] == pytest.approx(np.min(np.diff(found)), rel=1e-9) and density.size == found.size


def test_without_enough_samples_there_is_no_spectrum():
    assert amplitude_density(np.full(1000, np.nan), 1000.0)[0].size == 0
    assert amplitude_density(np.zeros(20), 1000.0)[0].size == 0
