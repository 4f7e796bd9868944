# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The clock of a scan in a loop: the same as that of the equations of the path, sample by sample, for any time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters
from hysteresis_ros.references.scan import frame_marks, line_marks, pixel_marks
from hysteresis_ros.references.scan_clock import LEVELS, ScanClock
from hysteresis_ros.references.scans import scan_of, scan_words
from hysteresis_ros.signals import Edge

SCANS = {
    "raster": dict(width=3e-6, depth=2e-6, lines=5, flyback=2, pixels=7),
    "raster bidirectional": dict(width=3e-6, depth=2e-6, lines=5, flyback=3, pixels=64, pattern="bidirectional"),
    "spiral": dict(diameter=3e-6, turns=8, pixels=5),
    "lissajous": dict(width=3e-6, depth=2e-6, lines=9, pixels=16),
    "rosette": dict(diameter=3e-6, lines=9, pixels=4),
}
#: Whole periods of the path: 500 and 1000 samples; three periods of 533 1/3 samples.
RATES = (20.0, 3.0 / 0.16)
OF_LEVEL = {"frame": frame_marks, "line": line_marks, "pixel": pixel_marks}
STEP = 1e-4


def expected(scan, samples: int, levels) -> np.ndarray:
    """Return sample, frame, line, pixel and direction of all marks, by the functions for recordings."""
    time = np.arange(samples) * STEP
    found = [OF_LEVEL[level](scan, time) for level in levels]
    rows = [np.column_stack([m.sample, m.frame, m.line, m.pixel, m.direction]) for m in found]
    order = np.argsort(np.concatenate([m.place for m in found]).round(6), kind="stable")
    return np.vstack(rows)[order], np.concatenate([m.place for m in found])[order]


def table(marks) -> np.ndarray:
    return np.column_stack([marks.sample, marks.frame, marks.line, marks.pixel, marks.direction])


@pytest.mark.slow
@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("name", SCANS)
def test_it_is_the_clock_of_the_path(name, rate):
    scan = scan_of(name.split()[0], SCANS[name] | dict(frame_rate=rate))
    samples = 3500
    for level in LEVELS[1:]:
        clock = ScanClock(scan, STEP, level)
        rows, places = expected(scan, samples, LEVELS[1 : LEVELS.index(level) + 1])
        whole = clock.between(-1, samples - 1)
        np.testing.assert_array_equal(table(whole), rows)
        np.testing.assert_allclose(whole.place, places, atol=1e-6)
        np.testing.assert_allclose(whole.time, places * STEP, atol=1e-10)
        # the same marks come out one sample at a time, and only where the next one was announced
        alone, due = [], clock.next_after(-1)
        for k in range(samples):
            found = clock.between(k - 1, k)
            assert bool(found.sample.size) == (k == due)
            due = clock.next_after(k) if k == due else due
            alone.append(table(found))
        np.testing.assert_array_equal(np.vstack(alone), rows)


@pytest.mark.parametrize("name", SCANS)
def test_the_edges_of_a_level_end_with_the_first_one_of_the_next_period(name):
    """The distance over the end of a period counts too: the flyback of a raster lies there."""
    scan = scan_of(name.split()[0], SCANS[name] | dict(frame_rate=RATES[0]))
    clock = ScanClock(scan, STEP, "line")
    for edge, marks in ((Edge.FRAME, frame_marks), (Edge.LINE, line_marks)):
        time = np.arange(round(2 * scan.period / STEP)) * STEP
        first = marks(scan, time).time / STEP
        np.testing.assert_allclose(clock.of_level(edge), first[: len(clock.of_level(edge))], atol=1e-6)
        assert np.ptp(clock.of_level(edge)) == pytest.approx(scan.period / STEP)


def test_far_from_the_beginning_nothing_has_drifted():
    scan = scan_of("raster", SCANS["raster"] | dict(frame_rate=RATES[1]))
    clock = ScanClock(scan, STEP, "pixel")
    far = 1600 * 10**8  # 1600 samples are three periods; half a year at 10 kHz
    first, later = clock.between(-1, 1599), clock.between(far - 1, far + 1599)
    np.testing.assert_array_equal(later.sample - far, first.sample)
    np.testing.assert_array_equal(later.frame - 3 * 10**8, first.frame)
    np.testing.assert_array_equal(table(later)[:, 2:], table(first)[:, 2:])


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("name", SCANS)
def test_the_bits_of_a_sample_say_what_the_marks_say(name, rate):
    scan = scan_of(name.split()[0], SCANS[name] | dict(frame_rate=rate))
    waveform = {
        "type": "scan",
        "cycles": 2,
        "scan.kind": name.split()[0],
        "scan.values": scan_words(scan)[1],
        "scan.clock": "pixel",
    }
    given = {"minimum": -9e-6, "maximum": 9e-6, **{f"waveform.{key}": value for key, value in waveform.items()}}
    generator = ReferenceGenerator(ReferenceParameters.from_mapping(given), STEP)
    edges, end = generator.waveform.edges, generator.waveform.duration_samples
    assert end == math.ceil(2 * scan.period / STEP - 1e-6)
    wanted = np.zeros(end)
    for edge, level in zip(Edge, ("frame", "line", "pixel"), strict=True):
        begun = OF_LEVEL[level](scan, np.arange(end) * STEP).sample
        wanted += edge * np.isin(np.arange(end), begun)
    k = np.arange(end)
    np.testing.assert_array_equal(edges[k % edges.size], wanted)
    clock = ScanClock(scan, STEP, "pixel", periods=2)
    assert clock.next_after(end - 1) == math.inf and not clock.between(end - 1, end + 5000).sample.size
    assert clock.between(-1, end + 5000).sample.max() < end


def test_a_level_has_the_coarser_ones_none_has_nothing_and_another_is_refused():
    scan = scan_of("raster", SCANS["raster"] | dict(frame_rate=20.0))
    sizes = [ScanClock(scan, STEP, level).between(-1, 499).sample.size for level in LEVELS]
    # five lines with trace and retrace, and seven pixels in each
    assert sizes == [0, 1, 1 + 10, 1 + 10 + 70]
    assert not ScanClock(scan, STEP, "none").edges().any() and ScanClock(scan, STEP, "none").next_after(3) == math.inf
    with pytest.raises(ParameterError, match="clock = 'pixels': must be one of none, frame, line, pixel"):
        ScanClock(scan, STEP, "pixels")
