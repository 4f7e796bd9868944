# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Scans of a plane: derivatives, periods, constant velocities, gaps, bounds, limits, clocks and harmonics."""

from __future__ import annotations

import math
import pathlib
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.references.scan import (
    ScanLimits,
    check_limits,
    frame_marks,
    harmonics,
    largest_frame_rate,
    line_marks,
    pixel_marks,
)
from hysteresis_ros.references.scans import SCANS, parsed_scan, rows_of, scan_of

MICRO = 1e-6
SHARED = dict(frame_rate=2.0, rotation=0.3, centre_x=50e-6, centre_y=40e-6)
TILTED = dict(axes=3, slope_x=0.02, slope_y=-0.01, height=3e-6)
RASTER = dict(width=80e-6, depth=60e-6, lines=12, flyback=4, turn=0.2)
ALL = {
    "raster": RASTER,
    "raster bidirectional": RASTER | dict(pattern="bidirectional", slow="ramped"),
    "raster trace": RASTER | dict(pattern="trace", turn=0.4),
    "raster parabolic": RASTER | dict(turn_law="parabolic"),
    "raster trace parabolic": RASTER | dict(turn_law="parabolic", pattern="trace", slow="ramped", flyback=3),
    "spiral": dict(diameter=80e-6, turns=8),
    "spiral clv": dict(diameter=80e-6, turns=8, law="clv"),
    "spiral clv with a small core": dict(diameter=80e-6, turns=8, law="clv", core=0.1, rim=2.0),
    "lissajous": dict(width=80e-6, depth=50e-6, lines=9),
    "cycloid": dict(width=80e-6, diameter=30e-6, lines=9),
    "rosette": dict(diameter=80e-6, lines=9),
}


def made(name: str, **more):
    return scan_of(name.split()[0], ALL[name] | SHARED | more)


def dense(scan, count=40_000):
    return (np.arange(count) + 0.5) * (scan.period / count)


def path_file(folder, closed: bool, kind: str = "csv"):
    """A file with a curve of 60 points at uneven times, closed or not."""
    angle = np.linspace(0.0, 2.0 * math.pi * (1.0 if closed else 0.8), 60)
    time = 0.5 * (angle + 0.2 * np.sin(angle)) / angle[-1]
    x, y = 30.0 * np.cos(angle), 20.0 * np.sin(2.0 * angle)
    if kind == "npz":
        np.savez(folder / "path.npz", x=x * MICRO, y=y * MICRO)
    else:
        rows = np.column_stack([time, x, y])
        np.savetxt(folder / "path.csv", rows, "%.12g", ",", header="time [s],x [um],y [um]", comments="")
    return str(folder / f"path.{kind}")


def file_of(folder, closed: bool) -> dict:
    return dict(path=path_file(folder, closed), way_back=0.0 if closed else 0.1)


@pytest.fixture(params=[*ALL, "file closed", "file"])
def scan(request, tmp_path):
    if request.param.startswith("file"):
        return scan_of("file", file_of(tmp_path, "closed" in request.param) | SHARED | TILTED)
    return made(request.param, **TILTED)


def test_derivatives_belong_to_each_other(scan):
    """Central differences, where no piece of the path ends within the step."""
    time, step = dense(scan, 4000), 1e-6 * scan.period
    for order in (1, 2, 3):
        before, after = (scan.derivative(time + sign * step, order - 1) for sign in (-1.0, 1.0))
        found, exact = (after - before) / (2.0 * step), scan.derivative(time, order)
        near = np.abs(found - exact) < 1e-5 * np.max(np.abs(exact)) + 1e-9 * np.max(np.abs(after)) / step
        assert np.mean(near) > 0.99, order


def test_it_repeats_and_has_no_jumps(scan):
    time = dense(scan, 2000)
    assert np.allclose(scan.position(time), scan.position(time + 3.0 * scan.period), rtol=0.0, atol=1e-15)
    edges = np.concatenate([scan.passes.begin, scan.passes.begin + scan.passes.duration]) / scan.rate
    for order in range(3 if "parabolic" not in str(scan) else 2):
        before, after = (scan.derivative(edges + sign * 1e-9 * scan.period, order) for sign in (-1.0, 1.0))
        assert np.max(np.abs(after - before)) < 1e-4 * np.max(np.abs(scan.derivative(time, order)))


def test_the_third_axis_follows_the_plane(scan):
    x, y, z = scan.position(dense(scan, 1000))
    assert np.allclose(z, 0.02 * x - 0.01 * y + 3e-6, rtol=0.0, atol=1e-16)
    u, v = scan.in_plane(np.array([x, y]))
    assert np.allclose([u, v], scan.plane(dense(scan, 1000) * scan.rate), rtol=0.0, atol=1e-16)


@pytest.mark.slow
def test_peaks_are_reached_and_never_exceeded(scan):
    time = dense(scan)
    low, high = scan.extent()
    assert np.all(scan.position(time) >= low[:, None] - 1e-15) and np.all(scan.position(time) <= high[:, None] + 1e-15)
    for order in (1, 2, 3):
        found, stated = np.max(np.abs(scan.derivative(time, order)), axis=1), scan.peak(order)
        assert np.all(found <= stated * (1.0 + 1e-9))
        if "parabolic" in str(scan) and order == 3:
            assert np.all(np.isinf(stated))
        else:  # for a spiral the vector, which may point between the axes
            assert np.max(found / stated) > (0.7 if hasattr(scan, "turns") else 0.98)


SIZES = dict(width=st.floats(1e-6, 1e-4), depth=st.floats(1e-6, 1e-4), frame_rate=st.floats(0.01, 100.0))
ROUND = dict(frame_rate=st.floats(0.01, 100.0), rotation=st.floats(-3.0, 3.0))
DRAWN = st.one_of(
    st.fixed_dictionaries(
        dict(
            kind=st.just("raster"),
            lines=st.integers(2, 9),
            flyback=st.integers(1, 4),
            turn=st.floats(0.01, 0.9),
            pattern=st.sampled_from(["trace", "trace_retrace"]),
            turn_law=st.sampled_from(["minimum_jerk", "parabolic"]),
            slow=st.sampled_from(["stepped", "ramped"]),
            rotation=st.floats(-3.0, 3.0),
            **SIZES,
        )
    ),
    st.fixed_dictionaries(dict(kind=st.just("lissajous"), lines=st.integers(2, 30), **SIZES)),
    st.fixed_dictionaries(
        dict(
            kind=st.just("spiral"),
            diameter=st.floats(1e-6, 1e-4),
            turns=st.integers(3, 12),
            law=st.sampled_from(["cav", "clv"]),
            core=st.floats(0.05, 2.0),
            rim=st.floats(0.05, 1.5),
            **ROUND,
        )
    ),
    st.fixed_dictionaries(
        dict(
            kind=st.just("cycloid"),
            width=st.floats(2e-5, 1e-4),
            diameter=st.floats(1e-6, 1e-5),
            lines=st.integers(2, 9),
            turn=st.floats(0.01, 0.9),
            **ROUND,
        )
    ),
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(DRAWN)
def test_peaks_hold_whatever_the_parameters(drawn):
    kind = drawn.pop("kind")
    scan = scan_of(kind, drawn)
    time = dense(scan, 3000)
    low, high = scan.extent()
    position = scan.position(time)
    slack = 1e-9 * scan.size
    assert np.all(position >= low[:, None] - slack) and np.all(position <= high[:, None] + slack)
    for order in (1, 2, 3):
        assert np.all(np.max(np.abs(scan.derivative(time, order)), axis=1) <= scan.peak(order) * (1.0 + 1e-9))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(DRAWN, st.floats(0.01, 100.0), st.sampled_from(["velocity", "acceleration", "jerk", "bandwidth"]))
def test_a_limit_refuses_with_the_factor_and_a_period_that_passes(drawn, factor, name):
    scan = scan_of(drawn["kind"], {key: value for key, value in drawn.items() if key != "kind"})
    if name == "bandwidth":
        order, peak = 1, scan.bandwidth
        limits = ScanLimits(bandwidth=peak / factor)
    else:
        order = ["velocity", "acceleration", "jerk"].index(name) + 1
        peak = scan.peak(order)
        if not np.all(np.isfinite(peak)):
            assert largest_frame_rate(scan, ScanLimits(jerk=(1.0,))) == 0.0
            return
        limits = ScanLimits(**{name: tuple(peak / factor)})
    best = largest_frame_rate(scan, limits)
    assert best == pytest.approx(scan.rate / factor ** (1.0 / order), rel=1e-9)
    if factor <= 1.0:
        check_limits(scan, limits)
        return
    with pytest.raises(ParameterError) as refused:
        check_limits(scan, limits)
    text = str(refused.value)
    assert float(re.search(r"is (\S+) times its limit", text)[1]) == pytest.approx(factor, rel=1e-3)
    allowed = float(re.search(r"allowed: ≤ (\S+) Hz", text)[1])
    assert 0.998 * best < allowed <= best * (1.0 + 1e-9)
    slower = dict(drawn, frame_rate=allowed)
    check_limits(scan_of(slower.pop("kind"), slower), limits)


def test_the_range_names_axis_excess_and_what_is_allowed():
    scan = made("raster", rotation=0.0)
    check_limits(scan, ScanLimits(low=(0.0, 0.0), high=(100e-6, 100e-6)))
    with pytest.raises(
        ParameterError,
        match="position of x = 3.75 µm: .* by 6.25 µm, allowed: ≥ 10 µm and ≤ 106 µm; move its centre by 6.25 µm",
    ):
        check_limits(scan, ScanLimits(low=(1e-5, 0.0), high=(106e-6, 100e-6)))
    middle = 0.5 * (scan.extent()[0][0] + scan.extent()[1][0])
    shifted = made("raster", rotation=0.0, centre_x=middle + 6.25e-6)
    check_limits(shifted, ScanLimits(low=(1e-5, 0.0), high=(106e-6, 100e-6)))
    with pytest.raises(ParameterError, match="position of y") as refused:
        check_limits(scan, ScanLimits(high=(100e-6, 65e-6)))
    assert len(refused.value.problems) == 1 and "by 5 µm, allowed: ≤ 65 µm; move its centre by -5 µm" in str(
        refused.value
    )
    # both ends in one line, with a factor that fits
    low, high = scan.extent()
    limits = ScanLimits(low=(low[0] + 5e-6, 0.0), high=(high[0] - 2e-6, 100e-6))
    with pytest.raises(ParameterError, match="range by 5 µm, and the other end too, allowed: ≥ .* and ≤ ") as refused:
        check_limits(scan, limits)
    assert len(refused.value.problems) == 1
    factor = float(re.search(r"make the scan at most (\S+) times as large", str(refused.value))[1])
    assert factor == pytest.approx(1.0 - 7e-6 / (high[0] - low[0]), rel=2e-3)
    smaller = {name: factor * ALL["raster"][name] for name in ("width", "depth")}
    middle = {"centre_x": 0.5 * (low[0] + high[0]) + 1.5e-6}
    check_limits(made("raster", rotation=0.0, **smaller, **middle), limits)
    with pytest.raises(ParameterError, match="has 3 values for 2 axes"):
        check_limits(scan, ScanLimits(velocity=(1.0, 1.0, 1.0)))
    with pytest.raises(ParameterError, match="acceleration jumps.*minimum_jerk"):
        check_limits(made("raster parabolic"), ScanLimits(jerk=(1e9,)))


@pytest.mark.parametrize("name", [name for name in ALL if name.startswith("raster")])
def test_a_raster_is_at_constant_velocity_for_the_part_it_states(name):
    scan = made(name, rotation=0.0)
    time = (np.arange(200_000) + 0.5) / 200_000 * scan.frame_time
    clock, along = scan.clock(time), scan.velocity(time)[0]
    on = clock.line >= 0
    assert np.allclose(np.abs(along[on]), scan.line_velocity, rtol=1e-9, atol=0.0)
    assert np.mean(on) == pytest.approx(scan.constant_share, abs=1e-4)
    # and nowhere else: samples with this velocity outside the lines belong to the flyback
    lines = time * scan.rate < scan.lines / (scan.lines + scan.flyback)
    same = np.isclose(np.abs(along), scan.line_velocity, rtol=1e-9, atol=0.0) & lines
    assert np.mean(same) == pytest.approx(scan.constant_share, abs=1e-4)
    u, v = scan.in_plane(scan.position(time))
    assert np.ptp(u[on]) == pytest.approx(scan.width, rel=1e-3)
    assert np.max(np.abs(u)) == pytest.approx(0.5 * scan.width + scan.overshoot, rel=1e-6)
    middles = np.array([np.mean(v[on & (clock.line == line)]) for line in range(scan.lines)])
    assert np.allclose(np.diff(middles), scan.pitch, rtol=1e-3)
    if scan.slow == "stepped":
        assert all(np.ptp(v[on & (clock.line == line)]) == 0.0 for line in range(scan.lines))


@pytest.mark.parametrize("rotation", [5e-324, 2e-308, 1e-17, 0.5 * math.pi])
def test_a_rotation_of_almost_nothing_changes_nothing(rotation):
    """The small part of the other coordinate must not make the roots of the larger one overflow."""
    peaks = [made("raster", rotation=rotation).peak(order) for order in (1, 2, 3)]
    straight = [made("raster", rotation=0.0).peak(order) for order in (1, 2, 3)]
    assert np.allclose(peaks, np.flip(straight, axis=1) if rotation > 1.0 else straight, rtol=1e-12)
    cycloid = made("cycloid", rotation=rotation, turn_law="parabolic").peak(3)
    assert np.isfinite(cycloid).tolist() == ([True, False] if rotation > 1.0 else [False, rotation < 1e-14])


def test_turns_have_the_peaks_of_their_laws():
    """Minimum jerk: 3 V/T and 12 V/T², 5/16 V T beyond the ends; parabolic: 2 V/T, V T/4."""
    for law, steepest, beyond in (("minimum_jerk", 3.0, 5.0 / 16.0), ("parabolic", 2.0, 0.25)):
        scan = made("raster", turn_law=law, rotation=0.0)
        turn = scan.turn / (2.0 * scan.lines_per_second)
        assert scan.peak(1)[0] == pytest.approx(scan.line_velocity)
        assert scan.peak(2)[0] == pytest.approx(steepest * scan.line_velocity / turn)
        assert scan.overshoot == pytest.approx(beyond * scan.line_velocity * turn)
        if law == "minimum_jerk":
            assert scan.peak(3)[0] == pytest.approx(12.0 * scan.line_velocity / turn**2)
            assert scan.peak(3)[1] == pytest.approx(60.0 * scan.pitch / turn**3)


def test_a_spiral_of_constant_linear_velocity_is_one():
    scan = made("spiral clv")
    time = (np.arange(40_000) + 0.5) / 40_000 * scan.period
    speed, radius = np.hypot(*scan.velocity(time)), np.hypot(*scan.in_plane(scan.position(time)))
    arm = scan.gap
    free = (radius > 1.01 * scan.core * arm) & (radius < 0.5 * scan.diameter)
    assert np.mean(free) == pytest.approx(scan.constant_share, abs=0.02)
    assert np.allclose(speed[free], np.mean(speed[free]), rtol=1e-9, atol=0.0)
    assert np.max(speed) < 1.3 * np.mean(speed[free])
    # the core limits the angular velocity to less than 3 times that of the angle at its end
    unlimited = scan_of("spiral", ALL["spiral clv"] | SHARED | dict(core=0.05))
    assert np.max(scan.peak(2)) < 0.5 * np.max(unlimited.peak(2))


@pytest.mark.parametrize("name", ["spiral clv", "spiral clv with a small core"])
def test_the_core_and_the_rim_of_a_spiral_join_smoothly(name):
    """The timing has three continuous derivatives; at the rim the jerk of the turn begins with a jump."""
    scan = made(name)
    core, rim = scan._elapsed(np.array([scan._inner, scan._outer])) * scan.frame_time
    for at, orders in ((core, 4), (rim, 3), (scan.period - core, 4), (scan.period - rim, 3), (scan.period, 4)):
        for order in range(orders):
            before, after = (scan.derivative([at + sign * 1e-9 * scan.period], order) for sign in (-1.0, 1.0))
            assert np.max(np.abs(after - before)) < 1e-4 * np.max(scan.peak(order)), (at, order)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["cav", "clv"])
def test_the_arms_of_a_spiral_are_as_far_apart_as_stated(law):
    scan = scan_of("spiral", dict(diameter=80e-6, turns=20, law=law, pixels=64))
    time = np.linspace(0.0, scan.frame_time, 400_001)
    u, v = scan.position(time)
    crossing = np.flatnonzero((v[1:] >= 0.0) & (v[:-1] < 0.0) & (u[1:] > 0.0))
    radii = u[crossing]
    assert radii.size == 20 and np.allclose(np.diff(radii), scan.gap, rtol=2e-3)
    assert scan.gap == pytest.approx(40e-6 / (20.25 - 0.25), rel=1e-9)
    assert np.max(np.hypot(u, v)) == pytest.approx(40e-6 + 5.0 / 16.0 * 0.5 * scan.gap, rel=1e-3)


@pytest.mark.parametrize("law", ["cav", "clv"])
def test_a_line_of_a_spiral_is_the_same_ring_outwards_and_inwards(law):
    scan = scan_of("spiral", dict(diameter=80e-6, turns=12, law=law))
    time = dense(scan, 20_000)
    radius, clock = np.hypot(*scan.in_plane(scan.position(time))), scan.clock(time)
    for line in range(11):  # the radius reverses in the last one
        for way in (1, -1):
            ring = radius[(clock.line == line) & (clock.direction == way)]
            assert [ring.min(), ring.max()] == pytest.approx(
                [line * scan.gap, (line + 1) * scan.gap], abs=0.02 * scan.gap
            )


@pytest.mark.slow
@pytest.mark.parametrize("lines, width, depth", [(24, 80e-6, 80e-6), (31, 100e-6, 40e-6)])
def test_the_gap_of_a_lissajous_scan_is_its_largest_empty_circle(lines, width, depth):
    scan = scan_of("lissajous", dict(width=width, depth=depth, lines=lines))
    tree = cKDTree(scan.position(np.linspace(0.0, scan.frame_time, 60_000)).T)
    middle = np.linspace(-2.0, 2.0, 400) * scan.gap
    points = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)
    distance, _ = tree.query(points)
    assert 2.0 * np.max(distance) == pytest.approx(scan.gap, rel=0.02)
    everywhere = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 300) * width, np.linspace(-0.5, 0.5, 300) * depth), -1)
    distance, _ = tree.query(everywhere.reshape(-1, 2))
    assert 2.0 * np.max(distance) < 1.02 * scan.gap


def test_the_tips_of_a_rosette_are_evenly_spaced_on_the_rim():
    scan = scan_of("rosette", dict(diameter=80e-6, lines=15))
    tips = scan.position(np.arange(15) / 15.0 * scan.frame_time)
    assert np.allclose(np.hypot(*tips), 40e-6)
    angles = np.sort(np.arctan2(tips[1], tips[0]))
    assert np.allclose(np.diff(angles), 2.0 * math.pi / 15)
    assert scan.gap == pytest.approx(80e-6 * math.sin(math.pi / 15))


def test_the_circles_of_a_cycloid_are_as_far_apart_as_stated():
    scan = scan_of("cycloid", dict(width=80e-6, diameter=20e-6, lines=20, turn=0.1))
    time = np.arange(2, 18) / 20 * scan.frame_time  # the same phase of consecutive circles, drifting at its velocity
    assert np.allclose(np.diff(scan.position(time)[0]), scan.gap)
    low, high = scan.extent()
    swing = 5.0 / 16.0 * 60e-6 / 0.9 * 0.1
    assert np.allclose(high - low, [80e-6 + 2.0 * swing, 20e-6])


def test_clock_and_marks_are_complete_and_in_order(scan):
    time = np.linspace(0.0, 2.0 * scan.period * (1.0 - 1e-6), 36_001)
    sample_time = time[1]
    frames, lines, pixels = frame_marks(scan, time), line_marks(scan, time), pixel_marks(scan, time)
    count = 2 * scan.frames_per_period
    assert frames.frame.tolist() == list(range(count)) and np.allclose(frames.time, np.arange(count) * scan.frame_time)
    each = len(scan.passes.begin) * 2
    assert lines.time.size == each and pixels.time.size == each * scan.pixels
    for marks in (frames, lines, pixels):
        assert np.all(np.diff(marks.time) > 0.0) and np.all(np.diff(marks.sample) >= 0)
        assert np.allclose(marks.place * sample_time, marks.time, rtol=0.0, atol=1e-9 * sample_time)
        assert np.all(marks.sample - marks.place >= -1e-5) and np.all(marks.sample - marks.place < 1.0)
    for frame in range(count):
        numbers = pixels.line[pixels.frame == frame] * scan.pixels + pixels.pixel[pixels.frame == frame]
        assert set(numbers) == set(range(scan.lines_per_frame * scan.pixels)), "every pixel of every frame"
    # the clock shows the lines that have begun, in the middle of the first pixels of all lines
    inside = np.flatnonzero(pixels.pixel == 0)
    width = np.tile(scan.passes.duration, 2) / scan.rate / scan.pixels
    clock = scan.clock(pixels.time[inside] + 0.5 * width)
    for name in ("frame", "line", "pixel", "direction"):
        assert np.array_equal(getattr(clock, name), getattr(pixels, name)[inside]), name
    exact = scan.clock(pixels.time)
    assert np.array_equal(exact.pixel, pixels.pixel) and np.array_equal(exact.line, pixels.line)


def test_the_pixels_of_trace_and_retrace_are_in_the_same_places():
    scan = made("raster", rotation=0.0, pixels=40)
    time = dense(scan)
    clock, (u, _) = scan.clock(time), scan.in_plane(scan.position(time))
    on = clock.line >= 0
    exact = (u[on] / scan.width + 0.5) * 40
    assert set(clock.direction[on]) == {1, -1} and np.all(np.abs(exact - clock.pixel[on] - 0.5) < 0.5 + 1e-3)


def test_harmonics_are_those_of_the_path(scan):
    """The strongest first: the discrete Fourier transform of samples, and the path that the harmonics add up to."""
    found = harmonics(scan, 100)
    count = 1 << 16
    lines = np.fft.rfft(scan.samples(count, scan.period / count), axis=1) / count
    orders = np.rint(found.frequencies * scan.period).astype(int)
    assert np.allclose(found.amplitudes, 2.0 * lines[:, orders], rtol=0.0, atol=1e-7 * scan.size)
    assert np.allclose(found.mean, lines[:, 0].real, rtol=0.0, atol=1e-7 * scan.size)
    size = np.linalg.norm(lines, axis=0)[1:]
    least = np.min(np.linalg.norm(found.amplitudes, axis=0)) / 2.0
    assert np.count_nonzero(size > 1.001 * least + 1e-12 * size.max()) <= orders.size, (
        "all stronger harmonics are listed"
    )
    time = dense(scan, 3000)
    waves = np.exp(2j * math.pi * found.frequencies * time[:, None])
    rebuilt = found.mean[:, None] + (found.amplitudes @ waves.T).real
    assert np.sqrt(np.mean((rebuilt - scan.position(time)) ** 2)) < 2e-3 * scan.size


def test_tones_are_where_the_laws_say():
    lissajous = made("lissajous", rotation=0.0)
    found = harmonics(lissajous, 5)
    assert np.allclose(found.frequencies, sorted(lissajous.frequencies))
    assert np.allclose(np.abs(found.amplitudes), [[0.0, 40e-6], [25e-6, 0.0]], atol=1e-12)
    rosette = made("rosette")
    assert np.allclose(harmonics(rosette, 2).frequencies, sorted(rosette.frequencies))
    spiral = made("spiral")
    tones = harmonics(spiral, 2).frequencies
    assert np.mean(tones) == pytest.approx(spiral.frequency) and np.ptp(tones) == pytest.approx(0.5 * spiral.rate)
    raster = made("raster", rotation=0.0)
    found = harmonics(raster, 40)
    assert found.frequencies[np.argmax(np.abs(found.amplitudes[0]))] == pytest.approx(raster.lines_per_second)
    assert raster.bandwidth >= raster.lines_per_second


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_a_path_of_a_file_goes_through_its_points(tmp_path, kind):
    more = dict(way_back=0.1) | ({} if kind == "csv" else dict(sample_rate=100.0))
    scan = scan_of("file", dict(path=path_file(tmp_path, False, kind), **more))
    angle = np.linspace(0.0, 1.6 * math.pi, 60)
    time = 0.5 * (angle + 0.2 * np.sin(angle)) / angle[-1] if kind == "csv" else np.arange(60) / 100.0
    time = time - time[0]
    expected = MICRO * np.array([30.0 * np.cos(angle), 20.0 * np.sin(2.0 * angle)])
    assert np.allclose(scan.position(time), expected, rtol=0.0, atol=1e-15)
    assert scan.frame_time == pytest.approx(time[-1] / 0.9)
    slower = scan_of("file", dict(path=scan.path, frame_rate=0.5, **more))
    assert np.allclose(slower.position(time * 2.0 / scan.frame_time), expected, rtol=0.0, atol=1e-13)
    assert np.allclose(slower.peak(2), scan.peak(2) * (0.5 * scan.frame_time) ** 2)


def test_a_path_that_closes_by_itself_closes_in_the_time_of_its_last_step(tmp_path):
    """Twelve points of a circle, in steps that become three times as long: the return lasts as long as the last one."""
    angles = 2.0 * np.pi * np.arange(12) / 12
    time = np.append(0.0, np.cumsum(np.linspace(0.1, 0.3, 11)))
    np.savez(tmp_path / "circle.npz", time=time, x=1e-5 * np.cos(angles), y=1e-5 * np.sin(angles))
    scan = scan_of("file", dict(path=str(tmp_path / "circle.npz")))
    assert scan.period == pytest.approx(time[-1] + 0.3, rel=1e-9)
    np.testing.assert_allclose(scan.position(time), 1e-5 * np.array([np.cos(angles), np.sin(angles)]), atol=1e-12)


def test_a_path_that_a_scan_wrote_is_that_scan(tmp_path):
    """A complete period of samples closes by itself, one step after the last sample."""
    scan = scan_of("lissajous", dict(width=80e-6, depth=50e-6, lines=6))
    time = np.arange(4000) * (scan.period / 4000)
    x, y = scan.position(time)
    np.savez(tmp_path / "path.npz", time=time, x=x, y=y)
    again = scan_of("file", dict(path=str(tmp_path / "path.npz")))
    assert again.period == pytest.approx(scan.period)
    between = dense(scan, 7001)
    assert np.allclose(again.position(between), scan.position(between), rtol=0.0, atol=1e-6 * scan.size)
    assert np.allclose(again.peak(2), scan.peak(2), rtol=1e-3)
    np.savez(tmp_path / "half.npz", time=time[:3000], x=x[:3000], y=y[:3000])
    with pytest.raises(ParameterError, match=r"way_back = 0.0: the last point is .* m from the first; give way_back"):
        scan_of("file", dict(path=str(tmp_path / "half.npz")))


@pytest.mark.parametrize(
    "text, message",
    [
        ("x [um],y [um]\n1,2\n", "sample_rate = 0.0: must be > 0 Hz|has 1 points"),
        ("time [s],x [um]\n0,1\n", "no column y"),
        ("time [s],x,y [um]\n0,1,1\n", "must name the unit"),
        ("time [s],x [um],y [um]\n0,1,1\n1,2,2\n1,3,3\n2,4,4\n", "time of point 2 must be later"),
        ("time [s],x [um],y [um]\n0,1,1\n1,nan,2\n2,3,3\n3,4,4\n", "x of point 1 is nan"),
        ("time [s],x [um],y [um]\n0,1,1\n1,1,1\n2,1,1\n3,1,1\n", "all points are the same"),
    ],
)
def test_files_that_are_no_path_are_refused(tmp_path, text, message):
    (tmp_path / "path.csv").write_text(text)
    with pytest.raises(ParameterError, match=message):
        scan_of("file", dict(path=str(tmp_path / "path.csv")))


@pytest.mark.parametrize(
    "kind, values, message",
    [
        ("rastr", {}, "no such scan.*did you mean raster"),
        ("raster", dict(width=1e-5), "depth = None: missing"),
        ("raster", dict(width=1e-5, depth=1e-5, frame_rate=0.0), "frame_rate = 0.0: must be > 0 Hz"),
        ("raster", dict(width=1e-5, depth=1e-5, pattern="bidirectional", flyback=3), "is odd.*use 4"),
        ("raster", dict(width=1e-5, depth=1e-5, slope_x=0.1), "third axis"),
        ("rosette", dict(diameter=1e-5, lines=8), "must be odd.*use 9"),
        ("cycloid", dict(width=1e-5, diameter=1e-5), "more than the diameter"),
        ("spiral", dict(diameter=1e-5, turns=4, law="clv", core=4.0), "core = 4.0 turns: must be less than 4"),
        ("spiral", dict(diameter=1e-5, turns=4, rim=5.0), "rim = 5.0: must be ≤ the turns of a frame, 4"),
        ("file", dict(path="missing.csv"), "no such file"),
        ("lissajous", dict(width=1e-5, depth=1e-5, line=5), "did you mean lines"),
    ],
)
def test_wrong_parameters_are_named(kind, values, message):
    with pytest.raises(ParameterError, match=message):
        scan_of(kind, values)
    if kind in SCANS:
        assert set(rows_of(kind)) >= {"frame_rate", "pixels"} and message


def test_harmonics_need_a_number():
    with pytest.raises(ParameterError, match="count = 0: must be ≥ 1"):
        harmonics(made("rosette"), 0)


@pytest.mark.slow
def test_the_python_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = pathlib.Path(__file__).resolve().parents[2] / "docs" / "scans.md"
    names: dict = {}
    for snippet in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        exec(compile(snippet, "docs/scans.md", "exec"), names)
    assert names["tones"].frequencies.size == 12 and (tmp_path / "scan.html").stat().st_size > 10_000


def test_rates_that_contradict_each_other_are_refused():
    words = ("width=10um", "depth=10um", "lines=4", "flyback=6", "line_rate=20Hz")
    with pytest.raises(ParameterError, match=r"frame_rate = 1\.0: line_rate = 20 Hz gives 2 frames per second"):
        parsed_scan("raster", (*words, "frame_rate=1Hz"))
    assert parsed_scan("raster", (*words, "frame_rate=2Hz")).rate == 2.0
