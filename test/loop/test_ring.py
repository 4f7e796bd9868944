# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Readers of the fused loop: each sample once, or the number of lost samples; and the lateness of samples."""

from __future__ import annotations

import numpy as np
import pytest
from fused_support import named
from hypothesis import given
from hypothesis import strategies as st
from loop_support import axis

from hysteresis_ros.loop import fused, pacing
from hysteresis_ros.loop import pacing as ring
from hysteresis_ros.loop.fused import FusedLoop


def small_loop(monkeypatch, samples, kept=100):
    """Return a loop with a ring of few samples."""
    monkeypatch.setattr(fused, "KEPT", 0.0)
    monkeypatch.setattr(fused, "LEAST_KEPT", kept)
    return FusedLoop(axis(), np.inf, samples)


def run(loop):
    """Run all samples."""
    loop.start()
    loop.join()


def test_a_reader_that_is_too_slow_is_told_how_many_samples_it_lost(monkeypatch):
    loop = small_loop(monkeypatch, 60)
    run(loop)
    first = loop.take()
    assert (first.first, first.lost, first.table.shape[1]) == (0, 0, 60)
    loop._state[pacing.UNTIL] = 460
    run(loop)
    second = loop.take()
    # the entry of the next sample is not read, because it may be incomplete
    assert (second.first, second.lost, second.table.shape[1]) == (361, 301, 99)
    whole = axis().run(axis().default_setpoints(460))
    for name, values in named(loop, second.table).items():
        np.testing.assert_array_equal(values, whole[name][361:])
    last = loop.take()
    assert (last.first, last.lost, last.table.shape[1], len(last.times)) == (460, 0, 0, 0)


def test_each_reader_gets_everything_from_its_beginning_on(monkeypatch):
    loop = small_loop(monkeypatch, 30)
    run(loop)
    later = loop.reader()
    loop._state[pacing.UNTIL] = 50
    run(loop)
    assert loop.take().table.shape[1] == 50
    taken = later.take()
    assert (taken.first, taken.table.shape[1], taken.lost) == (30, 20, 0)
    assert later.take().table.shape[1] == 0
    assert np.all(np.diff(taken.times) >= 0)


def test_what_is_overwritten_while_it_is_copied_is_lost(monkeypatch):
    loop = small_loop(monkeypatch, 90)
    run(loop)
    state = loop._state

    class Moving:
        """Rows that are overwritten while they are read."""

        def __len__(self):
            return 100

        def __getitem__(self, places):
            rows = loop._own.rows[places]
            state[pacing.HEAD] += 40
            return rows

    taken = ring.Reader.take(_reader_of(loop, Moving()))
    assert (taken.first, taken.lost, taken.table.shape[1]) == (31, 31, 59)


def _reader_of(loop, rows):
    reader = loop.reader()
    reader._next = 0
    reader._own = loop._own._replace(rows=rows)
    return reader


def test_the_last_row_is_there_at_any_time(monkeypatch):
    loop = small_loop(monkeypatch, 250)
    number, row = loop.latest()
    assert number == -1 and np.all(np.isnan(row))
    run(loop)
    number, row = loop.latest()
    assert number == 249
    np.testing.assert_array_equal(row, loop.take().table[:, -1])


def noted(lateness):
    """Return the arrays of a loop with these latenesses [ns]."""
    loop_state, histogram = np.zeros(pacing.STATES, dtype=np.int64), np.zeros(pacing.BINS, dtype=np.int64)
    for late in lateness:
        pacing.note_lateness(loop_state, histogram, late)
    return loop_state, histogram


@given(st.lists(st.integers(0, 10**11), min_size=1, max_size=200), st.sampled_from([0.5, 0.9, 0.99, 0.999]))
def test_quantiles_are_right_to_two_percent(values, part):
    state, histogram = noted(values)
    exact = np.sort(values)[max(int(np.ceil(part * len(values))) - 1, 0)] * 1e-9
    assert ring.quantile(histogram, part) == pytest.approx(exact, rel=0.02, abs=1.01e-7)
    assert state[pacing.LATEST] == max(values) and histogram.sum() == len(values)


def test_the_figures_of_known_latenesses():
    state, histogram = noted([10_000] * 980 + [1_000_000] * 15 + [50_000_000] * 5)
    state[pacing.HEAD], state[pacing.MISSED], state[pacing.BUSY], state[pacing.BUSIEST] = 1000, 7, 700_000, 9000
    own = fused.pace_arrays(axis())._replace(state=state, histogram=histogram)
    found = ring.lateness(own)
    assert found.p50 == pytest.approx(1e-5, rel=0.02)
    assert found.p99 == pytest.approx(1e-3, rel=0.02)
    assert found.p999 == pytest.approx(5e-2, rel=0.02)
    assert found.p90 == pytest.approx(1e-5, rel=0.02)
    assert found.max == 0.05 and (found.missed, found.samples) == (7, 1000)
    assert found.cost == pytest.approx(7e-7) and found.highest_cost == pytest.approx(9e-6)
    assert not any(ring.lateness(fused.pace_arrays(axis())))


def test_a_reader_of_an_axis_that_has_run_before_stops_before_the_sample_it_is_told():
    before = axis()
    before.run(before.default_setpoints(40))
    loop = FusedLoop(before, np.inf, 60)
    run(loop)
    taken = [loop._reader.take(until) for until in (30, 55, 90, None)]
    assert [(one.first, one.table.shape[1], one.lost) for one in taken] == [
        (40, 0, 0),
        (40, 15, 0),
        (55, 35, 0),
        (90, 10, 0),
    ]
