# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage that follows a scan: its path, limits of its axes, and displacements between the samples."""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace

import numpy as np
import pytest
from coupled_stages import LINEAR, SAMPLE_TIME, configured, modes

import hysteresis_ros as hr
from hysteresis_ros.analysis.scan_report import scan_figures, scan_plots
from hysteresis_ros.api import configuration_of
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.control.learning import LearningParameters
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_response import (
    check_scan,
    loop_bandwidths,
    path_bandwidths,
    scan_warnings,
    scanned_paths,
)
from hysteresis_ros.loop.stage_simulation import displacements_between, simulate_stage, with_scan
from hysteresis_ros.models.linear import zero_order_hold
from hysteresis_ros.references.scan import ScanLimits, frame_marks, largest_frame_rate, line_marks, pixel_marks
from hysteresis_ros.references.scan_clock import ScanClock
from hysteresis_ros.references.scans import parsed_scan, scan_of, scan_words
from hysteresis_ros.references.waveforms.scan import repetition
from hysteresis_ros.signals import Edge

RASTER = ("width=20um", "depth=10um", "lines=4", "flyback=2", "line_rate=50Hz", "slow=ramped", "rotation=10deg")
MIDDLE = 20e-6


def following(kind="raster", values=RASTER, **overrides) -> StageParameters:
    return StageParameters.from_configuration(with_scan(configured(**overrides), kind, values))


def refused(values, kind="raster", **overrides) -> str:
    with pytest.raises(ParameterError) as error:
        following(kind, values, **overrides)
    return str(error.value)


def test_the_axes_follow_the_path_about_their_setpoints():
    parameters = following()
    scan, run = parameters.scan, simulate_stage(parameters)
    assert run.time.size == round(2 * scan.period / SAMPLE_TIME) == 2400, "two periods"
    path = scan.position(run.time) + MIDDLE
    for place, name in enumerate("xy"):
        np.testing.assert_allclose(run[f"{name}/reference"], path[place], atol=1e-15)
    assert scan_of("raster", dict(width=20e-6, depth=10e-6, lines=4, flyback=2, line_rate=50.0)).rate == 50.0 / 6.0


def test_axes_are_chosen_by_name_and_the_others_hold():
    parameters = following(stage={"scan__axes": ["y", "x"], "scan__periods": 0})
    run = simulate_stage(parameters, duration=0.05)
    path = parameters.scan.position(run.time) + MIDDLE
    np.testing.assert_allclose(run["y/reference"], path[0], atol=1e-15)
    np.testing.assert_allclose(run["x/reference"], path[1], atol=1e-15)
    with pytest.raises(ConfigurationError, match="no end"):
        simulate_stage(parameters)
    assert "must name 2 different axes out of x, y" in refused(RASTER, stage={"scan__axes": ["y", "z"]})
    assert "must name 3 different axes" in refused((*RASTER, "axes=3"))


def test_a_feedforward_that_follows_the_scan_late_is_warned_of():
    late = {"feedforward__type": "inverse_dynamics", "feedforward__preview": 20}
    values = ("width=2um", "depth=2um", "lines=5", "frame_rate=2Hz")
    for warning in scan_warnings(following("lissajous", values, motion_controller=late)):
        assert re.search(r"^[xy]: its feedforward follows the scan 20 samples, 2 ms, late", warning), warning
    assert len(scan_warnings(following("lissajous", values, motion_controller=late))) == 2


def test_the_text_of_a_run_gives_the_scan_back():
    parameters = following()
    text = parameters.configuration_text()
    again = StageParameters.from_configuration(parse_configuration(text, "text"))
    assert again.scan == parameters.scan
    assert again == parameters


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            ("width=50um", "depth=10um", "line_rate=5Hz"),
            r"position of x = -28\S* µm: the path .* exceeds the range by",
        ),
        (("width=20um", "depth=10um", "lines=4", "line_rate=400Hz"), "velocity of x .* is 1.* times its limit 0.0154"),
        (("width=20um", "depth=10um", "lines=4", "line_rate=150Hz"), "acceleration of x .* times its limit 21.6"),
        (("width=20um", "depth=10um", "lines=4", "line_rate=150Hz"), r"allowed: ≤ \S+ Hz, a frame in \S+ s or more"),
        (("width=20um", "depth=10um", "turn_law=parabolic"), "turn_law = 'parabolic': the acceleration jumps"),
        (
            ("width=20um", "depth=10um", "line_rate=7.1234567Hz"),
            "must be a whole number, .* within 1000 periods; the nearest .* last",
        ),
        (("width=20um",), "scan.values: depth = None: missing"),
        (("width=20", "depth=10um"), "scan.values: width = '20': of which unit"),
        (("width", "depth=10um"), "write NAME=VALUE"),
        (("width=20um", "deptz=10um"), "there is no such parameter; .* did you mean depth"),
    ],
)
def test_what_the_axes_cannot_follow_is_refused_with_what_they_can(values, words):
    assert re.search(words, refused(values)), refused(values)


def test_the_frame_rate_that_a_refusal_names_is_the_largest_of_the_limits():
    values = ("width=20um", "depth=10um", "lines=4", "flyback=2")
    best = float(re.search(r"allowed: ≤ (\S+) Hz", refused((*values, "frame_rate=200Hz")))[1])
    limits = ScanLimits((), (), (0.0154,), (21.6,), (30200.0,))
    limit = largest_frame_rate(parsed_scan("raster", values), limits)
    assert best == pytest.approx(limit, rel=1e-3) and best <= limit


def slow_loop(frame_rate: float, **overrides) -> StageParameters:
    """Return a stage of integrators of 20/(2 π) = 3.2 Hz, for a Lissajous scan of 2 and 2.5 times the frame rate."""
    gains = {"type": "pid", "damping__type": "none", "pid__Kp": 0.0, "pid__Ki": 20.0, "pid__Kd": 0.0}
    values = ("width=2um", "depth=2um", "lines=5", f"frame_rate={frame_rate!r}Hz")
    return following("lissajous", values, motion_controller=gains | overrides)


@pytest.mark.slow
def test_a_scan_beyond_the_bandwidth_of_the_loop_is_warned_of_with_the_frame_rate_that_would_do():
    parameters = slow_loop(4.0)
    np.testing.assert_allclose(loop_bandwidths(parameters), 20.0 / (2.0 * np.pi), rtol=0.02)
    np.testing.assert_allclose(path_bandwidths(parameters), [10.0, 8.0])
    x, y = scan_warnings(parameters)
    assert re.search(r"^x: the path of the scan needs 10 Hz, 3\.1\d? times the bandwidth of the loop, 3\.\d+ Hz", x)
    rate = float(re.search(r"frame_rate ≤ (\S+) Hz", x)[1])
    assert rate == pytest.approx(4.0 * 3.18 / 10.0, rel=0.02) and "hysteresis design --learning" in x and y[0] == "y"
    assert 1.25 < rate < 1.28
    assert scan_warnings(slow_loop(1.25)) == () and len(scan_warnings(slow_loop(1.28))) == 1
    learns = LearningParameters("inversion", 0.25, (1.0,), robustness_filter=(1.0,), maximum=1e-6)
    first = replace(parameters.axes[0].motion_controller, learning=learns)
    axes = (replace(parameters.axes[0], motion_controller=first), parameters.axes[1])
    assert scan_warnings(replace(parameters, axes=axes)) == (y,), "corrections of the reference can follow it"
    assert scan_warnings(following()) == (), "xy_scanner follows its raster"
    with pytest.warns(UserWarning, match="times the bandwidth of the loop"):
        hr.simulate(parse_configuration(parameters.configuration_text(), "text"), duration=0.01)


def test_a_scan_beyond_what_actuators_and_samples_can_do_is_refused():
    assert re.search(
        r"bandwidth \S+ Hz is \S+ times its limit 5000 Hz; allowed: ≤ \S+ Hz",
        refused(("width=1nm", "depth=1nm", "lines=5", "frame_rate=3kHz"), "lissajous"),
    )
    # above the modes the actuators have to accelerate the mass of the stage
    values = ("width=10um", "depth=10um", "lines=5", "frame_rate={}Hz")
    limits = {"approach__maximum_velocity": 0.0, "approach__maximum_acceleration": 0.0, "approach__maximum_jerk": 0.0}
    fast = following("lissajous", (*values[:3], values[3].format(800)), reference_generator=limits)
    with pytest.raises(ParameterError) as error:
        check_scan(fast)
    words = re.search(
        r"would need commands that are (\S+) times its range, .* scan; allowed: ≤ (\S+) Hz", str(error.value)
    )
    assert float(words[1]) > 1.5
    rate = int(float(words[2]))
    assert 400 < rate < 800
    check_scan(following("lissajous", (*values[:3], values[3].format(rate)), reference_generator=limits))


@pytest.mark.slow
@pytest.mark.parametrize(("middle", "centre"), [(14.0, 6.0), (20.0, 0.0), (26.0, -6.0)])
def test_a_slow_scan_is_refused_exactly_when_its_commands_leave_the_range(middle, centre):
    """Setpoint and path are ±8 µm about 20 µm; what 4 % of cross-talk takes from it is more where the other is far."""
    values = ("width=16um", "depth=16um", "lines=5", "frame_rate=1Hz", f"centre_x={centre}um", f"centre_y={centre}um")
    place = {"reference_generator": {"initial_setpoint": middle * 1e-6}}
    free = following("lissajous", values, **place)
    gain = free.stage.structure.linear.dc_gain
    least = np.min(np.linalg.solve(gain, middle * 1e-6 + scanned_paths(free)))
    assert least < 11.5e-6
    nodes = ("plant_simulator", "hysteresis_compensator")
    for part, fits in ((0.999, True), (1.001, False)):
        volts = {"limits__minimum": part * least / 0.4e-6, "safe_voltage": part * least / 0.4e-6}
        parameters = following("lissajous", values, **{name: LINEAR[name] | volts for name in nodes}, **place)
        with (
            contextlib.nullcontext()
            if fits
            else pytest.raises(ParameterError, match=r"commands that are 1\.00\d+ times")
        ):
            check_scan(parameters)


def test_a_kind_that_does_not_exist_and_a_file_without_stage_are_refused():
    assert "there is no such scan" in refused((), "rastr") and "did you mean raster" in refused((), "rastr")
    with pytest.raises(ConfigurationError, match="has no section '/stage' that couples them"):
        with_scan(configured("kim2009"), "raster", RASTER)


def test_a_path_repeats_after_whole_samples_of_one_or_several_periods():
    assert repetition(0.2, 1e-4) == 2000
    assert repetition(2.0 / 37.5, 1e-4) == 1600, "three periods of 533 1/3 samples"
    with pytest.raises(ParameterError, match="the nearest whole periods last 0.1234 s and 0.1235 s"):
        repetition(0.1234567891, 1e-4)


@pytest.mark.parametrize("kind", ["raster", "spiral", "lissajous", "cycloid", "rosette"])
def test_a_scan_comes_back_from_its_words(kind):
    values = {"raster": dict(width=3e-6, depth=1e-6, rotation=0.3, lines=16, slow="ramped")}
    values |= {"spiral": dict(diameter=4e-6, law="clv"), "lissajous": dict(width=3e-6, depth=2e-6, lines=15)}
    values |= {"cycloid": dict(width=4e-6, diameter=1e-6), "rosette": dict(diameter=5e-6)}
    scan = scan_of(kind, values[kind] | dict(frame_rate=1.0 / 3.0, axes=3, slope_x=0.1))
    assert parsed_scan(*scan_words(scan)) == scan


def fine(rate: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A and B of modes at 700 and 800 Hz on a grid ``rate`` times finer than the samples."""
    A, B = np.zeros((4, 4)), np.zeros((4, 2))
    for i, frequency in enumerate((700.0, 800.0)):
        w, own = 2.0 * np.pi * frequency, slice(2 * i, 2 * i + 2)
        A[own, own], held = zero_order_hold([[0.0, w], [-w, -0.02 * w]], [[0.0], [w]], SAMPLE_TIME / rate)
        B[own, i] = held[:, 0]
    return A, B


def test_between_the_samples_is_what_a_finer_grid_gives():
    A, B = modes((700.0, 800.0), (0.01, 0.01))
    C = np.array([[1.0, 0.0, 0.1, 0.0], [0.0, 0.0, 1.0, 0.0]])
    values = {"structure__A": tuple(A.ravel()), "structure__B": tuple(B.ravel()), "structure__C": tuple(C.ravel())}
    configuration = with_scan(
        configured(**LINEAR, stage={**values, "decoupling": []}),
        "lissajous",
        ("width=2um", "depth=1um", "lines=3", "frame_rate=50Hz"),
    )
    parameters = StageParameters.from_configuration(configuration)
    run = simulate_stage(parameters, duration=0.02)
    time, found = displacements_between(parameters, run)
    for place, name in enumerate("xy"):
        np.testing.assert_allclose(found[place, ::5], run[f"{name}/displacement"], atol=1e-17)
    A, B = fine(5)
    drives = 0.4e-6 * np.array([run[f"{name}/plant_voltage"] for name in "xy"])
    x, expected = np.zeros(4), []
    for u in np.repeat(drives, 5, axis=1).T[: time.size]:
        expected.append(C @ x)
        x = A @ x + B @ u
    np.testing.assert_allclose(found, np.array(expected).T, atol=1e-15)
    assert time == pytest.approx(np.arange(time.size) * SAMPLE_TIME / 5, abs=1e-12)
    # rectangular interpolation is not sufficient, because the modes ring
    assert np.max(np.abs(np.diff(found[:, :200]))) > 1e-8


@pytest.mark.slow
def test_the_scan_of_a_run_is_judged_between_samples_against_the_path_itself():
    scan = parsed_scan("raster", RASTER)
    run = hr.simulate("xy_scanner", scan=scan)
    judged = hr.scan_run(run)
    assert judged.scan == scan
    assert judged.time[0] == pytest.approx(scan.period) and judged.time.size == 5 * 1199 + 1, "up to the last sample"
    np.testing.assert_allclose(judged.reference, scan.position(judged.time) + MIDDLE, atol=1e-15)
    figures = hr.report(run)
    assert figures["scan"] == scan_figures(judged) and {"x", "y"} <= figures.keys()
    assert hr.scan_run(run, 0.15).time[0] == pytest.approx(0.15)
    # a part of a simulated run does not begin at rest: only its samples are known
    part, same = hr.scan_run(run.between(0.13, 0.2), 0.0), hr.scan_run(run, 0.13, 0.2)
    assert scan_figures(part)["rms_error_m"] == pytest.approx(scan_figures(same)["rms_error_m"], rel=0.05)
    # for a measured run only the samples are known: an error of 10 nm across the plane is found at the samples
    shifted = {f"{name}/displacement": run[f"{name}/reference"] - 10e-9 for name in "xy"}
    other = replace(run, signals=run.signals | shifted, metadata=run.metadata | {"source": "bag"})
    assert scan_figures(hr.scan_run(other))["rms_error_m"] == pytest.approx(np.sqrt(2.0) * 10e-9, rel=1e-6)
    assert hr.scan_run(hr.simulate("kim2009", duration=0.02)) is None


@pytest.mark.slow
@pytest.mark.parametrize("source", ["bag", "offline simulation"])
def test_a_scan_that_was_stopped_and_began_again_is_judged_where_it_is(source):
    """Lines are those of the path at each sample, not those of the time since the run began."""
    parameters, stopped, started = following(stage={"scan__periods": 2}), 230, 1000
    scan, changes = (
        parameters.scan,
        [
            Change(stopped, "reference_generator", "stop"),
            Change(started, "reference_generator", "start"),
        ],
    )
    whole = simulate_stage(parameters, duration=started * SAMPLE_TIME + 2.5 * scan.period)
    found = Stage(parameters).run(Stage(parameters).default_setpoints(len(whole)), {"x": changes, "y": changes})
    signals = {f"{name}/{key}": found[name][key] for name in "xy" for key in whole.axis(name).signals}
    run = replace(whole, signals=signals, metadata=whole.metadata | {"source": source})
    judged, period = hr.scan_run(run), round(scan.period / SAMPLE_TIME)
    assert judged.time[0] == pytest.approx(started * SAMPLE_TIME + scan.period), "after the first whole period"
    assert judged.time[-1] < started * SAMPLE_TIME + 2.0 * scan.period
    fine = 5 if source == "offline simulation" else 1
    assert judged.time.size == fine * period
    np.testing.assert_array_equal(judged.clock.line, scan.clock(judged.time - started * SAMPLE_TIME).line)
    undelayed = scan.position(judged.time - started * SAMPLE_TIME) + MIDDLE
    np.testing.assert_allclose(judged.reference, undelayed, atol=1e-12)
    early = hr.scan_run(run, 0.0)
    assert early.time.size == fine * (stopped + 2 * period), "nothing counts while the scan is stopped"
    assert scan_figures(early)["frames"] == pytest.approx((stopped + 2 * period) * SAMPLE_TIME * scan.rate, rel=0.01)


def test_samples_that_the_recording_lacks_do_not_shift_the_lines_of_a_scan():
    run = simulate_stage(following(), duration=0.1)
    kept = np.r_[0:30, 330:1000]
    parts = {name: np.append(values[kept[:-1]], np.nan) for name, values in run.signals.items()}
    late = replace(run, time=run.time[kept], signals=parts, metadata=run.metadata | {"source": "bag"})
    # samples come late, and the waveform waits for them
    for name in "xy":
        late.signals[f"{name}/waveform_sample"][:-1] = np.arange(kept.size - 1)
    judged = hr.scan_run(late, 0.0)
    scan = following().scan
    np.testing.assert_array_equal(judged.clock.line, scan.clock(np.arange(kept.size - 1) * SAMPLE_TIME).line)


@pytest.mark.slow
def test_the_zero_of_the_sensors_is_no_error_of_a_scan():
    """References count from the zero of the controllers' models; the error does too, simulated or measured."""
    slow = ("width=2um", "depth=2um", "lines=4", "flyback=2", "line_rate=10Hz", "slow=ramped")
    given = with_scan(configured("xy_scanner"), "raster", slow)
    bare = scan_figures(hr.scan_run(hr.simulate(given)))
    zero = {"plant_simulator": {"preload__A1": 80e-9}, "motion_controller": {"model__preload__A1": 80e-9}}
    for node, values in zero.items():
        given = given.override(node, **values)
    run = hr.simulate(given)
    assert np.mean((run["y/displacement"] - run["y/reference"])[len(run) // 2 :]) == pytest.approx(80e-9, rel=0.1)
    measured = replace(run, metadata=run.metadata | {"source": "bag"})
    for one in (run, measured):
        found = scan_figures(hr.scan_run(one))
        assert found["across_error_m"] < 20e-9, "80 nm would be an offset across the lines"
        assert found["rms_error_m"] == pytest.approx(bare["rms_error_m"], rel=0.05)


@pytest.mark.slow
def test_a_stage_with_hysteresis_inside_is_judged_at_its_samples():
    configuration = with_scan(
        configured("steering_mirror"), "lissajous", ("width=0.4um", "depth=0.4um", "lines=3", "frame_rate=4Hz")
    )
    run = hr.simulate(configuration, duration=0.3)
    judged = hr.scan_run(run, 0.0)
    assert judged.time.size == run.time.size and np.max(judged.size) < 0.4e-6
    # the pictures name the axes of the stage
    (_, path), (_, plane), *_ = scan_plots(judged)
    assert [path.axes[0].get_xlabel(), path.axes[0].get_ylabel()] == ["s1 [µm]", "s2 [µm]"]
    assert [axis.get_title() for axis in plane.axes[1:3]] == ["mean error of s1", "mean error of s2"]
    assert StageParameters.from_configuration(configuration_of(run)).scanning_axes == ("s1", "s2")


def test_the_reference_is_one_of_the_stage_and_not_of_a_copy():
    """A reset stage begins its scan again."""
    stage = Stage(following())
    first = stage.run(stage.default_setpoints(300))["x"]["reference"].copy()
    stage.reset()
    assert np.array_equal(stage.run(stage.default_setpoints(300))["x"]["reference"], first)


def clock_rows(marks) -> np.ndarray:
    return np.column_stack([marks.sample, marks.frame, marks.line, marks.pixel, marks.direction])


def test_the_clock_of_a_run_is_that_of_the_path_also_after_a_stop_and_behind_the_end():
    parameters = following(stage={"scan__clock": "pixel", "scan__periods": 1})
    scan, stage = parameters.scan, Stage(parameters)
    period = round(scan.period / SAMPLE_TIME)
    stopped, started = 300, 700
    changes = [
        Change(stopped, "reference_generator", "stop"),
        Change(started, "reference_generator", "start"),
    ]
    samples = started + 2 * period
    found = stage.run(stage.default_setpoints(samples), {"x": changes, "y": changes})
    counted = np.full(samples, -1)
    counted[:stopped] = np.arange(stopped)
    counted[started:] = np.arange(samples - started)
    time = np.arange(period) * SAMPLE_TIME
    edges = np.zeros(period)
    for edge, marks_of in zip(Edge, (frame_marks, line_marks, pixel_marks), strict=True):
        begun = marks_of(scan, time).sample
        edges[np.unique(begun[begun < period])] += edge
    wanted = np.where((counted >= 0) & (counted < period), edges[np.clip(counted, 0, period - 1)], 0.0)
    for name in "xy":
        np.testing.assert_array_equal(found[name]["waveform_sample"], counted)
        np.testing.assert_array_equal(found[name]["scan_edges"], wanted)
    # what a listener gets from the samples of the waveform is what the path itself says
    clock = ScanClock(scan, SAMPLE_TIME, "pixel", parameters.stage.scan.periods)
    pixels = pixel_marks(scan, time)
    heard = clock.between(-1, samples)
    np.testing.assert_array_equal(clock_rows(heard)[heard.pixel >= 0], clock_rows(pixels))


def test_an_axis_that_is_stopped_by_the_plant_or_has_no_scan_has_no_clock():
    parameters = following(plant_simulator={"late_limit": 5}).with_faults("x", ("lost_voltage:0.01:0.01",))
    run = simulate_stage(parameters, duration=0.03)
    stopped = run["x/tripped"] != 0.0
    assert stopped[-1] and not stopped[:100].any()
    np.testing.assert_array_equal(run["x/waveform_sample"][stopped], -1.0)
    assert not run["x/scan_edges"][stopped].any() and run["x/scan_edges"][~stopped].any()
    assert not simulate_stage(following(stage={"scan__clock": "none"}), duration=0.01)["x/scan_edges"].any()
    assert not hr.simulate("kim2009", duration=0.01)["scan_edges"].any()
