# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Triggers at positions, times and marks of a scan, against one state machine per position; refused ones by name."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros import signals as at
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.parameters import InchwormSequencerNodeParameters, ReferenceNodeParameters
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.references.approach import ApproachParameters
from hysteresis_ros.references.scan import frame_marks, line_marks, pixel_marks
from hysteresis_ros.references.scan_clock import LEVELS, ScanClock
from hysteresis_ros.references.scans import parsed_scan
from hysteresis_ros.references.triggers import (
    HIGHEST,
    IN_FORCE,
    LOWEST,
    NUMBER,
    REFUSED,
    TriggerInputParameters,
    TriggerParameters,
    compare,
    longest_path,
    makes_triggers,
    step_setpoint,
    trigger_arrays,
)
from hysteresis_ros.references.waveforms import WaveformParameters
from hysteresis_ros.references.waveforms.steps import StepsParameters

STEP = 1e-3
OF_LEVEL = dict(zip(LEVELS[1:], (frame_marks, line_marks, pixel_marks), strict=True))
_COMPARE = interpreted(compare)


def events(given: TriggerParameters, measured, rearm: float, **columns) -> np.ndarray:
    """Return number, position, direction and delay at each sample, shape (4, N), for measurements [m]."""
    arrays = trigger_arrays(given, rearm, 0.0, STEP, columns.pop("clock", None))
    measured = np.asarray(measured, dtype=float)
    found = np.zeros((4, measured.size))
    row = np.zeros(at.MOTOR_ROW)
    for k in range(measured.size):
        row[:] = 0.0
        row[at.MEASURED], row[at.WAVEFORM_SAMPLE] = measured[k], k
        for name, values in columns.items():
            row[at.place(name)] = values[k]
        _COMPARE(arrays, row)
        found[:, k] = row[at.TRIGGER : at.TRIGGER_DELAY + 1]
    return found


def passed(positions, measured, rearm: float, up: bool) -> list[tuple[int, float]]:
    """Return sample and position of each event of one direction, with a state machine for each position."""
    sign = 1.0 if up else -1.0
    found = []
    for position in positions:
        armed = sign * measured[0] < sign * position
        for k in range(1, len(measured)):
            if armed and sign * measured[k] >= sign * position:
                found.append((k, position))
                armed = False
            elif sign * measured[k] < sign * position - rearm:
                armed = True
    return sorted(found, key=lambda event: (event[0], sign * event[1]))


paths = st.lists(st.integers(-40, 40), min_size=2, max_size=60)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    way=paths,
    up=st.sets(st.integers(-39, 39), max_size=9),
    down=st.sets(st.integers(-39, 39), min_size=1, max_size=9),
    rearm=st.sampled_from([0.0, 0.25, 1.0, 3.5]),
)
def test_each_position_fires_once_for_each_pass_and_is_armed_beyond_it(way, up, down, rearm):
    chosen = TriggerParameters(
        positions=tuple(1e-7 * p for p in sorted(up)), down_positions=tuple(1e-7 * p for p in sorted(down))
    )
    measured = 1e-7 * (np.array(way) + 0.1)  # never exactly at a position
    found = events(chosen, measured, 1e-7 * rearm)
    wanted = [(k, p, 1.0) for k, p in passed(chosen.positions, measured, 1e-7 * rearm, up=True)]
    wanted += [(k, p, -1.0) for k, p in passed(chosen.down, measured, 1e-7 * rearm, up=False)]
    wanted.sort(key=lambda event: event[0])
    # one trigger in a sample; the others are counted
    numbers = {}
    for number, (k, position, direction) in enumerate(wanted, start=1):
        numbers.setdefault(k, (number, position, direction))
    assert np.flatnonzero(found[0]).tolist() == sorted(numbers)
    for k, event in numbers.items():
        assert tuple(found[:3, k]) == event
        # the instant is between the samples, where a polynomial through the last four of them is at the position
        assert 0.0 <= found[3, k] <= STEP
        first = max(k - 3, 0)
        curve = np.polyfit(np.arange(first, k + 1) - k, measured[first : k + 1] * 1e7, k - first)
        assert np.polyval(curve, -found[3, k] / STEP) == pytest.approx(1e7 * event[1], abs=1e-9)


def test_the_instant_of_a_parabola_is_exact_and_that_of_a_sine_is_nearly():
    time = np.arange(200) * STEP
    acceleration, start = 4e-4, 1.5e-7
    found = events(TriggerParameters(start=1e-6, step=1e-6, stop=7e-6), start + 0.5 * acceleration * time**2, 1e-8)
    k = np.flatnonzero(found[0])
    exact = np.sqrt(2.0 * (found[1, k] - start) / acceleration)
    np.testing.assert_allclose(time[k] - found[3, k], exact, atol=1e-12)
    assert k.size == 7
    # for a line it would be 0.8 % of a sample's path
    omega, height = 2.0 * np.pi * 10.0, 5e-6
    found = events(TriggerParameters(positions=(-3e-6, 1e-6, 4e-6)), height * np.sin(omega * time), 1e-8)
    k = np.flatnonzero(found[0])
    instants = time[k] - found[3, k]
    error = np.abs(height * np.sin(omega * instants) - found[1, k])
    path = height * omega * STEP * np.abs(np.cos(omega * instants))
    assert k.size == 12 and np.max(error / path) < 2e-5


def test_noise_fires_once_a_pass_when_it_is_smaller_than_the_distance_that_arms():
    random = np.random.default_rng(3)
    measured = np.concatenate([np.linspace(0.0, 4e-6, 400), np.linspace(4e-6, 0.0, 400)])
    noisy = measured + random.normal(scale=20e-9, size=800)
    chosen = TriggerParameters(positions=(1e-6, 2e-6, 3e-6))
    found = events(chosen, noisy, 6 * 20e-9)
    assert found[2][found[0] > 0].tolist() == [1.0] * 3 + [-1.0] * 3
    assert np.count_nonzero(events(chosen, noisy, 0.0)[0]) > 8, "it would chatter"


def test_without_a_measurement_the_line_spans_the_gap_and_a_stopped_axis_does_not_fire():
    measured = np.array([0.0, 1.0, 2.0, np.nan, np.nan, 5.0, 6.0]) * 1e-6
    found = events(TriggerParameters(positions=(3.5e-6,)), measured, 1e-8)
    assert np.flatnonzero(found[0]).tolist() == [5] and found[3, 5] == pytest.approx(1.5 * STEP)
    # the measurements before a gap are no part of the cubic after it
    later = events(TriggerParameters(positions=(5.5e-6,)), measured, 1e-8)
    assert np.flatnonzero(later[0]).tolist() == [6] and later[3, 6] == pytest.approx(0.5 * STEP)
    skipped = np.array([0.0, 0, 0, 1, 1, 0, 0])
    same = events(TriggerParameters(positions=(3.5e-6,)), np.arange(7) * 1e-6, 1e-8, skipped=skipped)
    np.testing.assert_array_equal(same, found)
    tripped = np.array([0.0, 0, 0, 1, 1, 1, 0])
    way = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 3.0]) * 1e-6
    found = events(TriggerParameters(positions=(1.5e-6, 2.5e-6, 4.5e-6)), way, 1e-8, tripped=tripped)
    assert np.flatnonzero(found[0]).tolist() == [2], "where it was when it stopped counts for nothing"


def test_times_fire_in_their_order_and_again_when_the_waveform_begins_again():
    waveform_sample = np.array([0.0, 1, 2, 3, 4, -1, -1, 0, 1, 2, 3, 4])
    measured = np.arange(12) * 1e-6
    chosen = TriggerParameters(times=(0.0, 1.5e-3, 3e-3))
    found = events(chosen, measured, 1e-8, waveform_sample=waveform_sample)
    k = np.flatnonzero(found[0])
    assert k.tolist() == [0, 2, 3, 7, 9, 10] and found[0, k].tolist() == [1, 2, 3, 4, 5, 6]
    np.testing.assert_allclose(found[3, k], np.array([0.0, 0.5, 0.0, 0.0, 0.5, 0.0]) * STEP, atol=1e-15)
    np.testing.assert_allclose(found[1, k], measured[k] - found[3, k] / STEP * 1e-6, atol=1e-18)


@pytest.mark.parametrize("rate", [25.0, 1000.0 / 7.5])
@pytest.mark.parametrize("level", LEVELS[1:])
def test_the_marks_of_a_scan_fire_at_their_exact_instants(level, rate):
    words = ("width=2um", "depth=1um", "lines=3", "pixels=2", "flyback=1", f"frame_rate={rate / 8:.12g}Hz", "turn=0.3")
    scan = parsed_scan("raster", words)
    clock = ScanClock(scan, STEP, "pixel")
    edges = clock.edges()
    count = 3 * edges.size
    begun = edges[np.arange(count) % edges.size]
    found = events(TriggerParameters(each=level), np.zeros(count), 1e-8, clock=clock, scan_edges=begun)
    marks = OF_LEVEL[level](scan, np.arange(count) * STEP)
    inside = marks.sample < count
    k = np.flatnonzero(found[0])
    np.testing.assert_array_equal(k, marks.sample[inside])
    np.testing.assert_allclose(k - found[3, k] / STEP, marks.place[inside], atol=1e-6)
    assert k.size >= 3


@pytest.mark.parametrize("rate", [250.0, 300.0])
def test_an_output_that_needs_time_loses_the_triggers_in_between(rate):
    """3.3 samples at 300 Hz are over with the fourth one."""
    measured = np.arange(40) * 1e-6
    chosen = TriggerParameters(start=1e-6, step=1e-6, stop=38e-6, rate=rate)
    numbers = events(chosen, measured + 0.5e-6, 1e-8)[0]
    assert numbers[numbers > 0].tolist() == list(range(1, 39, 4))


def test_a_time_of_a_sample_is_in_this_sample_whatever_its_last_bit():
    times = tuple(np.cumsum([0.0, *[STEP] * 199]).tolist())
    assert any(time / STEP > k for k, time in enumerate(times)), "none is late by its last bit"
    found = trigger_arrays(TriggerParameters(times=times), 1e-8, 0.0, STEP, None).times
    np.testing.assert_array_equal(found[:, 0], np.arange(200))
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-15)


def test_pulses_step_the_setpoint_each_and_those_that_lead_out_of_the_range_are_counted():
    step = TriggerInputParameters(action="step", distance=-2e-6)
    arrays = trigger_arrays(TriggerParameters(input=step), 1e-8, 5e-6, STEP, None)
    arrays.p[LOWEST], arrays.p[HIGHEST] = 0.0, 12e-6

    def setpoint(pulses, tripped=0.0):
        row = np.zeros(at.MOTOR_ROW)
        row[at.SETPOINT], row[at.TRIGGER_IN], row[at.TRIPPED] = 5e-6, pulses, tripped
        interpreted(step_setpoint)(arrays, row)
        arrays.x[IN_FORCE] = row[at.SETPOINT]
        return row[at.SETPOINT]

    assert setpoint(1, tripped=2.0) == 5e-6, "a stopped axis does not step"
    assert setpoint(2) == pytest.approx(1e-6) and arrays.x[REFUSED] == 0.0
    assert setpoint(3) == pytest.approx(1e-6) and arrays.x[REFUSED] == 3.0


def refuse(kind, values) -> None:
    """Raise the ParameterError of a source with these parameters."""
    problems = list(kind.from_mapping(values).trigger_problems())
    if problems:
        raise ParameterError(problems)


WAVEFORM = {"waveform.type": "triangle", "waveform.frequency": 10.0, "waveform.amplitude": 8e-6}
SCAN = {
    "waveform.type": "scan",
    "waveform.scan.kind": "raster",
    "waveform.scan.values": ("width=2um", "depth=1um", "lines=4", "pixels=50", "line_rate=20Hz", "centre_x=5um"),
}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            WAVEFORM | {"triggers.positions": (1e-6, 13e-6)},
            r"positions = 1.3e-05 m: reaches 1.3e-05 m; allowed: 0 … 1.2e-05",
        ),
        (WAVEFORM | {"triggers.positions": (-1e-6, 3e-6)}, r"positions = -1e-06 m: reaches -1e-06 m; allowed: 0 "),
        (
            WAVEFORM | {"triggers.start": 1e-6, "triggers.step": 1e-6, "triggers.stop": 20e-6},
            r"triggers.stop = 2e-05 m: reaches 1.3e-05 m; allowed: 0 … 1.2e-05 m \(minimum … maximum\): trigger within",
        ),
        (
            WAVEFORM | {"triggers.start": 1e-6, "triggers.step": 0.1e-6, "triggers.stop": 5e-6},
            r"positions 1e-07 m apart are closer than the path of a sample, 1.6e-07 m \(the waveform triangle moves at "
            r"0.00016 m/s\): give a larger distance, or move slower",
        ),
        (
            WAVEFORM | {"triggers.positions": (1e-6, 2e-6), "triggers.rate": 100.0},
            r"1e-06 m apart are closer than the path of 1/triggers.rate = 0.01 s, 1.6e-06 m",
        ),
        (
            {"triggers.positions": (1e-6, 1.01e-6), "approach.maximum_velocity": 1e-3},
            r"closer than the path of a sample, 1e-06 m \(the approach moves at 0.001 m/s\)",
        ),
        (WAVEFORM | {"triggers.positions": (2e-6, 1e-6)}, r"positions = 1e-06 m: must be finite and increase"),
        (WAVEFORM | {"triggers.positions": (math.nan,)}, r"positions"),
        (WAVEFORM | {"triggers.step": 1e-6, "triggers.start": 3e-6}, r"stop = 0.0 m: must be above start = 3e-06 m"),
        (
            WAVEFORM | {"triggers.step": 1e-12, "triggers.stop": 3e-6},
            r"triggers.step = 1e-12 m: gives more than 100000 positions",
        ),
        (
            WAVEFORM | {"triggers.times": (0.1, 0.1005)},
            r"times = 0.0005 s: are closer than a sample: give times at least",
        ),
        (WAVEFORM | {"triggers.times": (0.1, 0.1005), "triggers.rate": 5000.0}, r"are closer than a sample"),
        (WAVEFORM | {"triggers.times": (0.1, 0.105), "triggers.rate": 100.0}, r"closer than 1/triggers.rate = 0.01 s"),
        (
            WAVEFORM | {"triggers.start": -2e-4, "triggers.step": 1e-9, "triggers.stop": 0.0},
            r"triggers.step = 1e-09 m: gives more than 100000 positions",
        ),
        (WAVEFORM | {"triggers.times": (-0.1, 0.5)}, r"times = -0.1 s: must not be negative"),
        (WAVEFORM | {"triggers.times": (0.1,), "triggers.positions": (1e-6,)}, r"give only one of them"),
        (WAVEFORM | {"triggers.each": "line"}, r"each = 'line': needs a scan: waveform.type: scan"),
        (SCAN | {"triggers.each": "pixel"}, r"waveform.scan.clock = 'line': must be pixel or finer"),
        (
            SCAN | {"triggers.each": "pixel", "waveform.scan.clock": "pixel"},
            r"each = 'pixel': begin 0.00\d+ s apart, less than a sample: give fewer pixels, or a slower scan",
        ),
        (WAVEFORM | {"triggers.positions": (1e-6, 2e-6), "triggers.rearm": 1e-6}, r"rearm = 1e-06 m: must be below"),
        (WAVEFORM | {"triggers.input.action": "step"}, r"input.distance = 0.0 m: must differ from 0"),
        (WAVEFORM | {"triggers.input.distance": 1e-6}, r"is only for action: step"),
        (
            WAVEFORM | {"triggers.down_positions": (1e-6,), "triggers.direction": "up"},
            r"direction = 'up': must be both with down_positions",
        ),
    ],
)
def test_what_an_axis_cannot_trigger_is_refused_with_what_would_do(values, said):
    given = {"sample_rate": 1000.0, "minimum": 0.0, "maximum": 12e-6} | values
    with pytest.raises(ParameterError, match=said):
        refuse(ReferenceNodeParameters, given)


def test_a_motor_has_positions_and_no_waveform():
    own = {"sample_rate": 1000.0, "triggers.positions": (1e-5, 2e-5)}
    assert makes_triggers(InchwormSequencerNodeParameters.from_mapping(own).validated().to_mapping())
    for values, said in (({"triggers.times": (1.0,)}, "beginning of a waveform"), ({"triggers.each": "line"}, "scan")):
        with pytest.raises(ParameterError, match=said):
            refuse(InchwormSequencerNodeParameters, {"sample_rate": 1000.0} | values)


@pytest.mark.parametrize("steps", [False, True])
def test_a_jump_takes_one_sample_unless_the_approach_limits_it(steps):
    values = StepsParameters(values=(0.0, 5e-6), times=(0.0, 0.1))
    waveform = WaveformParameters(type="steps", steps=values)
    approach = ApproachParameters(maximum_velocity=1e-3, maximum_acceleration=10.0, steps=steps)
    path, cause = longest_path(waveform, approach, 1e-5, STEP)
    assert path == pytest.approx(1e-3 * STEP if steps else 5e-6) and ("approach" in cause) == steps


def test_a_grid_has_both_ends_and_a_direction_alone_has_its_positions():
    grid = TriggerParameters(start=1e-6, step=0.1e-6, stop=2e-6)
    assert len(grid.up) == len(grid.down) == 11 and grid.up[-1] == pytest.approx(2e-6, rel=1e-12)
    assert TriggerParameters(positions=(1e-6,), direction="up").down == ()
    assert TriggerParameters(positions=(1e-6,), direction="down").up == ()
    assert grid.rearmed(0.0, 1e-5) == pytest.approx(0.025e-6)
    assert TriggerParameters(positions=(1e-6,)).rearmed(0.0, 1e-5) == pytest.approx(1e-7)
    assert TriggerParameters(positions=(1e-6,)).rearmed(-4e-6, 6e-6) == pytest.approx(1e-7)
    # the least distance is that of the direction in which the positions are closer
    near, far = (1e-6, 1.2e-6, 3e-6), (1e-6, 2e-6)
    for up, down in ((near, far), (far, near)):
        assert TriggerParameters(positions=up, down_positions=down).gap == pytest.approx(0.2e-6)
    assert makes_triggers({"triggers.down_positions": far})
    assert not TriggerParameters().asked and not makes_triggers({"triggers.each": "none", "triggers.step": 0.0})
    assert trigger_arrays(grid, 1e-8, 0.0, STEP, None).x[NUMBER] == 0.0
