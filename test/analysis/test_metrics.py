# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures of merit against closed forms."""

import json
import warnings

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

import hysteresis_ros as hr
from hysteresis_ros.analysis.inchworm import MOVE_FIGURES, RUN_FIGURES
from hysteresis_ros.analysis.metrics import FIGURES, compute_metrics, lost_offsets
from hysteresis_ros.analysis.parts import step_responses
from hysteresis_ros.analysis.tables import format_table
from hysteresis_ros.cli.main import main
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import Recording
from hysteresis_ros.recordings.loops import loop_opening, turning_points

RATE = 10_000.0


def run(time, reference, displacement, metadata=None, **more):
    columns = {"time": time, "reference": reference, "displacement": displacement, **more}
    return Recording.from_columns(columns, metadata)


def step(duration=1.0, height=2e-6, before=0.1):
    time = np.arange(-before, duration, 1.0 / RATE)
    return time, np.where(time >= -0.5 / RATE, height, 0.0)


@pytest.mark.parametrize("damping", [0.1, 0.2, 0.5, 0.8])
@pytest.mark.parametrize("height", [2e-6, -3e-6])
def test_second_order_step_overshoots_by_its_damping(damping, height):
    time, reference = step(duration=4.0 / damping, height=height)
    w = 10.0
    wd = w * np.sqrt(1 - damping**2)
    t = np.maximum(time, 0.0)
    displacement = height * (1 - np.exp(-damping * w * t) * (np.cos(wd * t) + damping * w / wd * np.sin(wd * t)))
    figures = compute_metrics(run(time, reference, displacement))
    expected = 100 * np.exp(-np.pi * damping / np.sqrt(1 - damping**2))
    assert figures["overshoot_percent"] == pytest.approx(expected, rel=1e-4, abs=1e-4)
    assert figures["steps"] == 1


def test_a_run_at_its_limits_says_so():
    time, reference = step()
    cut = np.where(time < 0.1, 1.0, 0.0)
    figures = compute_metrics(run(time, reference, reference, saturated=cut))
    assert figures["saturated_percent"] == pytest.approx(100.0 * np.mean(cut))
    assert "Samples limited by range or slew rate" in format_table(figures)
    silent = compute_metrics(run(time, reference, reference))
    assert silent["saturated_percent"] is None and "does not contain" in silent["notes"]["saturated_percent"]


@pytest.mark.parametrize("time_constant", [0.01, 0.05])
def test_exponential_settles_after_ln_50_time_constants(time_constant):
    time, reference = step()
    displacement = 2e-6 * (1 - np.exp(-np.maximum(time, 0.0) / time_constant))
    figures = compute_metrics(run(time, reference, displacement))
    assert figures["settling_time_s"] == pytest.approx(time_constant * np.log(50), abs=1.1 / RATE)
    assert figures["overshoot_percent"] == pytest.approx(0.0, abs=1e-3)
    assert figures["iae_m_s"] == pytest.approx(2e-6 * time_constant, rel=1e-2)


def test_settling_is_judged_around_the_value_reached_and_the_offset_reported():
    time, reference = step()
    displacement = 1.5e-6 * (1 - np.exp(-np.maximum(time, 0.0) / 0.02))
    figures = compute_metrics(run(time, reference, displacement))
    assert figures["steady_state_error_m"] == pytest.approx(0.5e-6)
    assert figures["settling_time_s"] == pytest.approx(0.02 * np.log(1.5 / 0.04), abs=2 / RATE)


def test_vibration_that_outlasts_the_hold_has_no_settling_time():
    time, reference = step()
    displacement = 2e-6 * (1 + 0.3 * np.cos(400 * time)) * (time >= 0)
    figures = compute_metrics(run(time, reference, displacement))
    assert figures["settling_time_s"] is None
    assert "1 of 1 steps" in figures["notes"]["settling_time_s"]


def test_a_limited_move_counts_from_where_the_hold_ends():
    time = np.arange(0.0, 1.0, 1e-3)
    reference = 1e-6 * np.clip((time - 0.2) / 0.1, 0.0, 1.0)
    (response,) = step_responses(time, reference, reference)
    assert response.start == pytest.approx(0.2)
    assert response.settling_time == pytest.approx(0.098, abs=1.1e-3)
    assert response.overshoot == pytest.approx(0.0, abs=1e-12)


def test_the_worst_of_several_steps_counts():
    time = np.arange(3000) / 1000.0
    reference = np.repeat([0.0, 1e-6, 3e-6], 1000)
    displacement = reference.copy()
    displacement[1000:1005] = 1.2e-6
    displacement[2000:2020] = 3.1e-6
    figures = compute_metrics(run(time, reference, displacement))
    assert figures["overshoot_percent"] == pytest.approx(20.0)
    assert figures["settling_time_s"] == pytest.approx(0.020)


@pytest.mark.slow
@given(gain=st.floats(1e-9, 1e3), offset=st.floats(-1.0, 1.0))
def test_constant_error_has_itself_as_rms_and_maximum(gain, offset):
    time = np.linspace(0.0, 2.0, 101)
    reference = gain * np.sin(time)
    figures = compute_metrics(run(time, reference, reference - offset * gain))
    assert figures["rms_error_m"] == pytest.approx(abs(offset) * gain, rel=1e-6, abs=1e-14 * gain)
    assert figures["max_error_m"] == pytest.approx(abs(offset) * gain, rel=1e-6, abs=1e-14 * gain)
    assert figures["iae_m_s"] == pytest.approx(2.0 * abs(offset) * gain, rel=1e-6, abs=1e-14 * gain)
    assert figures["stroke_m"] == pytest.approx(gain, rel=1e-2)
    assert figures["max_error_percent_of_stroke"] == pytest.approx(
        100 * figures["max_error_m"] / figures["stroke_m"], rel=1e-12
    )


def test_rms_of_a_sine_is_its_amplitude_over_root_two():
    time = np.arange(10_000) / RATE
    error = 3e-9 * np.sin(2 * np.pi * 10 * time)
    reference = 1e-6 * np.sin(2 * np.pi * time)
    figures = compute_metrics(run(time, reference, reference - error))
    assert figures["rms_error_m"] == pytest.approx(3e-9 / np.sqrt(2), rel=1e-9)
    assert figures["rms_error_percent_of_stroke"] == pytest.approx(100 * 3e-9 / np.sqrt(2) / 2e-6, rel=1e-6)


def test_residual_is_what_is_left_at_the_last_zero():
    time = np.arange(3000) / 1000.0
    reference = np.repeat([0.0, 1e-6, 0.0], 1000)
    displacement = np.concatenate([np.zeros(1000), np.full(1000, 1e-6), 0.25e-6 + 1e-6 * np.exp(-np.arange(1000) / 20)])
    assert compute_metrics(run(time, reference, displacement))["residual_m"] == pytest.approx(0.25e-6)
    figures = compute_metrics(run(time[:2000], reference[:2000], displacement[:2000]))
    assert figures["residual_m"] is None and "return to zero" in figures["notes"]["residual_m"]


def test_residual_is_taken_from_the_end_of_the_last_hold_at_zero():
    time = np.arange(5000) / 1000.0
    reference = np.repeat([0.0, 1e-6, 0.0, -1e-6, 0.0], 1000)
    left = np.concatenate([np.full(900, 0.8e-6), np.full(100, 0.3e-6)])
    displacement = np.concatenate(
        [np.zeros(1000), np.full(1000, 1e-6), np.full(1000, 0.5e-6), np.full(1000, -1e-6), left]
    )
    assert compute_metrics(run(time, reference, displacement))["residual_m"] == pytest.approx(0.3e-6)
    # a hold at zero before any motion is not counted as a hold
    assert compute_metrics(run(time[:2000], reference[:2000], displacement[:2000]))["residual_m"] is None


def test_iae_is_the_integral_of_the_size_also_where_the_sign_changes_every_sample():
    time = np.arange(1001) / 1000.0
    error = 2e-6 * (-1.0) ** np.arange(1001)
    assert compute_metrics(run(time, np.zeros(1001), -error))["iae_m_s"] == pytest.approx(2e-6)
    # trapezoids: the error is a triangle between three samples
    figures = compute_metrics(run(time[:3], np.zeros(3), np.array([0.0, 1e-6, 0.0])))
    assert figures["iae_m_s"] == pytest.approx(1e-9)


#: Factor from each displayed unit to SI.
SHOWN = {
    **{"µm": 1e-6, "µm s": 1e-6, "µm/s": 1e-6, "nm rms": 1e-9, "nm": 1e-9, "mm": 1e-3, "ms": 1e-3, "µs": 1e-6},
    **dict.fromkeys(
        ("", "%", "% of stroke", "% of samples", "% of extension", "1/s", "V", "V/s rms", "s", "Hz", "N", "1"), 1.0
    ),
}


@pytest.mark.parametrize("row", [*FIGURES, *MOVE_FIGURES, *RUN_FIGURES], ids=lambda row: row[0])
def test_every_figure_is_shown_in_the_unit_that_stands_beside_it(row):
    _, _, unit, factor = row
    assert factor == pytest.approx(1.0 / SHOWN[unit])


def test_the_table_shows_steady_state_error_and_jitter_in_their_units():
    time, reference = step()
    timing = {"timing": {"rate_hz": 998.0, "jitter_p99_s": 2e-5}}
    lines = format_table(compute_metrics(run(time, reference, 0.9 * reference, timing))).splitlines()
    shown = {line.split("  ")[0]: line.split()[-2:] for line in lines}
    assert shown["Steady-state error"] == ["0.2", "µm"]
    assert shown["Jitter p99"] == ["20", "µs"]


@pytest.mark.parametrize("wild", [np.inf, -np.inf])
def test_an_infinite_measurement_does_not_count(wild):
    time = np.arange(100) / 1000.0
    displacement = np.full(100, 1e-6)
    displacement[50] = wild
    figures = compute_metrics(run(time, np.zeros(100), displacement))
    assert figures["rms_error_m"] == figures["max_error_m"] == pytest.approx(1e-6)


@pytest.mark.parametrize("phase", [0.01, 0.1, 0.5, 1.0])
def test_ellipse_opens_by_twice_the_sine_of_its_phase(phase):
    """y = sin(wt - φ) over u = sin(wt): y = u cos φ ∓ √(1 - u²) sin φ, loop width 2 sin φ at u = 0."""
    time = np.arange(30_000) / RATE
    reference = 1e-6 * np.sin(2 * np.pi * time)
    displacement = 1e-6 * np.sin(2 * np.pi * time - phase)
    figures = compute_metrics(run(time, reference, displacement))
    assert figures["loop_width_percent"] == pytest.approx(100 * np.sin(phase), rel=1e-3)


def triangle(cycles, samples=2000):
    return np.abs((np.arange(cycles * samples + 1) / (samples / 2) + 1) % 2 - 1)


@pytest.mark.parametrize(
    ("picard_steps", "rate", "percent"),
    [(0, 1.0, 15.0), (1, 1.0, 8.2), (3, 1.0, 1.7), (6, 1.0, 0.26), (1, 1.12, 9.3), (3, 1.12, 1.8), (6, 1.12, 0.10)],
)
def test_loop_widths_of_the_inverse_are_those_published(picard_steps, rate, percent):
    """A loop of 120 V with 15 % width: 15, 8.2, 1.7, 0.26 % after 0, 1, 3, 6 Picard steps, R g = 1 (PAPERS K7a, K8)."""
    g, d, w, v_max = 0.1025e-6, 0.0125e-6, 0.15, 120.0
    corner = d * v_max

    def branch(voltage, sign):
        return corner + (g - d + sign * 2 * w * g) * voltage - sign * 2 * w * g / v_max * voltage**2

    reference = g * v_max * triangle(3)
    falling = np.append(np.diff(reference) < 0, True)
    wanted = reference / g
    voltage = wanted
    for _ in range(picard_steps):
        voltage = voltage + wanted - rate / g * np.where(falling, branch(voltage, 1), branch(voltage, -1))
    displacement = np.where(falling, branch(voltage, 1), branch(voltage, -1))
    figures = compute_metrics(run(np.arange(reference.size) / RATE, reference, displacement, voltage=voltage))
    assert figures["loop_width_percent"] == pytest.approx(percent, rel=0.05)


@given(noise=st.floats(0.0, 0.004), cycles=st.integers(1, 4))
def test_turning_points_are_the_corners_whatever_the_noise(noise, cycles):
    u = triangle(cycles, 200)
    jitter = noise * np.random.default_rng(0).uniform(-1.0, 1.0, u.size)
    corners = np.arange(0, u.size, 100)
    points = turning_points(u + jitter)
    assert points.size == corners.size
    assert np.max(np.abs(points - corners)) <= 1


def test_a_line_has_no_opening_and_a_jump_no_loop():
    u = triangle(3)
    assert loop_opening(u, 2 * u) == pytest.approx(0.0, abs=1e-12)
    assert loop_opening(np.repeat([0.0, 1.0, 0.0, 1.0], 100), np.zeros(400)) is None
    assert loop_opening(np.linspace(0, 1, 100), np.zeros(100)) is None
    assert loop_opening(np.zeros(100), np.zeros(100)) is None
    assert loop_opening(np.zeros(0), np.zeros(0)) is None


def test_the_virgin_curve_is_no_branch_of_the_loop():
    u = triangle(2)
    y = u.copy()
    y[:1000] += 0.5
    assert loop_opening(u, y) == pytest.approx(0.0, abs=1e-3)
    assert loop_opening(u[:2001], y[:2001]) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("order", [(0.1, 0.4, 0.2), (0.4, 0.1, 0.2), (0.2, 0.1, 0.4)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_opening_is_that_of_the_widest_loop_wherever_it_stands(order, sign):
    u = triangle(len(order))
    falling = np.append(np.diff(u) < 0.0, False)
    opened = np.repeat(order, 2000)
    y = u + 0.5 * sign * np.append(opened, 0.0) * np.where(falling, 1.0, -1.0) * (1.0 - u**2)
    # the first branch belongs to no loop; the second one falls in the cycle of the first loop width
    widest = max(0.5 * (a + b) for a, b in zip(np.repeat(order, 2)[1:-1], np.repeat(order, 2)[2:], strict=True))
    assert loop_opening(u, y) == pytest.approx(widest, rel=0.02)


def test_branches_are_compared_where_both_are():
    u = np.concatenate(
        [np.linspace(a, b, 200) for a, b in [(0.0, 1.0), (1.0, 0.0), (0.0, 1.0), (1.0, 0.8), (0.8, 1.0)]]
    )
    assert loop_opening(u, 3.0 * u) == pytest.approx(0.0, abs=1e-9)


def test_an_axis_at_rest_has_figures_without_meaning_and_says_why():
    time = np.arange(50) / 1000.0
    figures = compute_metrics(run(time, np.zeros(50), np.full(50, 1e-9), {"notes": ["a note"], "missing_samples": 3}))
    for name in (
        "rms_error_percent_of_stroke",
        "overshoot_percent",
        "settling_time_s",
        "residual_m",
        "loop_width_percent",
        "jitter_p99_s",
    ):
        assert figures[name] is None and figures["notes"][name], name
    assert figures["rms_error_m"] == pytest.approx(1e-9)
    assert figures["missing_samples"] == 3 and figures["notes"]["recording"] == ["a note"]
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    assert list(figures) == ["parts", *(name for name, *_ in FIGURES), "notes"]
    assert "a note" in format_table(figures)


def test_missing_values_do_not_count():
    time = np.arange(100) / 1000.0
    reference = np.sin(time * 60)
    displacement = reference - 1.0
    displacement[[0, 50, 99]] = np.nan
    assert compute_metrics(run(time, reference, displacement))["rms_error_m"] == pytest.approx(1.0)
    with pytest.raises(RecordingError, match="no values of 'displacement' or 'measured'.*it has reference"):
        compute_metrics(run(time, reference, np.full(100, np.nan)))


def test_times_of_reception_give_rate_and_jitter():
    time = np.arange(100) / 1000.0
    figures = compute_metrics(run(time, time, time, {"timing": {"rate_hz": 998.0, "jitter_p99_s": 2e-5}}))
    assert figures["rate_hz"] == 998.0 and figures["jitter_p99_s"] == 2e-5
    assert figures["sample_rate_hz"] == pytest.approx(1000.0)


def test_a_csv_that_loses_a_preload_offset_is_warned_of(tmp_path):
    """A CSV table has no metadata, so a report of it would count the offset as an error."""
    time = np.arange(50) / 1000.0
    signals = {"reference": time, "displacement": time + 2e-6}
    text = "/**/motion_controller:\n  ros__parameters: {model: {preload: {force: 1.0, A1: 2.0e-6}}}\n"
    made = hr.Run(time, signals, {}, {"configuration": text})
    with pytest.warns(UserWarning, match=r"preload offset of 2 µm.*write \.npz or \.mcap"):
        made.save(tmp_path / "run.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made.save(tmp_path / "run.npz")
        hr.Run(time, signals).save(tmp_path / "none.csv")
    arguments = ["export", str(tmp_path / "run.npz"), "-o", str(tmp_path / "again.csv")]
    assert "a CSV table does not contain the preload offset of 2 µm" in CliRunner().invoke(main, arguments).output
    stage = Recording.of_axes({"x": made, "y": hr.Run(time, signals)}, {"axes": {"x": made.metadata}})
    assert [text.split(": ")[1] for text in lost_offsets(stage, "s.csv")] == ["x"]


def test_preload_of_the_controllers_model_is_no_error():
    text = """
/**/motion_controller:
  ros__parameters:
    model: {preload: {force: 2.0, A1: 1.0e-6, B1: -2.0e-6, B2: 0.5e-6}}
"""
    time = np.arange(100) / 1000.0
    offset = 1e-6 - 2e-6 * 2.0 + 0.5e-6 * 4.0
    figures = compute_metrics(run(time, 1e-6 * time, 1e-6 * time + offset, {"configuration": text}))
    assert figures["max_error_m"] == pytest.approx(0.0, abs=1e-18)
    assert any("preload" in note for note in figures["notes"]["recording"])


def test_samples_that_a_recording_without_a_bag_lacks_are_counted():
    time = np.delete(np.arange(1000) * 1e-3, np.arange(500, 520))
    run = Recording(time, {"reference": np.sin(time), "displacement": np.sin(time)})
    assert compute_metrics(run)["missing_samples"] == 20
