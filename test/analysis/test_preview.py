# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""With a preview a run is evaluated against the reference that applies to a sample, not the one received then."""

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from hysteresis_ros.analysis.metrics import (  # noqa: E402
    axis_settings,
    compute_metrics,  # noqa: E402
    judged_reference,
    stage_axes,
)
from hysteresis_ros.analysis.parts import within  # noqa: E402
from hysteresis_ros.analysis.report import render_report  # noqa: E402
from hysteresis_ros.analysis.run_charts import judged, traces_chart  # noqa: E402
from hysteresis_ros.analysis.scan_report import plane_of  # noqa: E402
from hysteresis_ros.analysis.tables import format_table  # noqa: E402
from hysteresis_ros.laboratory.papers.runs import loop_width, step_figures  # noqa: E402
from hysteresis_ros.recordings import Recording  # noqa: E402

PREVIEW = 7
RATE = 1000.0


def recorded(reference, displacement, preview=PREVIEW, learning="none"):
    text = (
        f"/**/motion_controller:\n  ros__parameters: {{feedforward: {{type: inverse_dynamics, preview: {preview}}}, "
        f"learning: {{type: {learning}}}}}\n"
    )
    columns = {"time": np.arange(len(reference)) / RATE, "reference": reference, "displacement": displacement}
    return Recording.from_columns({**columns, "voltage": displacement}, {"configuration": text})


def late(signal, samples=PREVIEW):
    return np.concatenate([np.full(samples, signal[0]), signal[:-samples]])


def steps():
    return np.repeat([0.0, 2e-6, 0.0, 2e-6, 0.0], 200)


@pytest.mark.slow
def test_a_displacement_that_follows_the_delayed_reference_has_no_error():
    reference = steps()
    run = recorded(reference, late(reference))
    assert axis_settings(run).preview == PREVIEW
    assert np.array_equal(judged_reference(run), late(reference))
    figures = compute_metrics(run)
    assert figures["max_error_m"] == figures["settling_time_s"] == figures["overshoot_percent"] == 0.0
    assert any(f"delayed by {PREVIEW} samples (feedforward.preview)" in note for note in figures["notes"]["recording"])
    assert step_figures(run).settling == 0.0
    assert np.all(judged(run).error == 0.0)
    assert f"delayed by {PREVIEW} samples (feedforward.preview)" in render_report(run, "preview", figures)


@pytest.mark.parametrize("learning", ["none", "inversion"])
def test_an_axis_that_learns_is_evaluated_against_the_undelayed_reference_and_the_report_says_which(learning):
    reference = 5e-6 * (1.0 - np.cos(2.0 * np.pi * np.arange(4000) / RATE))
    run = recorded(reference, reference if learning != "none" else late(reference), learning=learning)
    figures, delay = compute_metrics(run), PREVIEW if learning == "none" else 0
    assert figures["max_error_m"] == pytest.approx(0.0, abs=1e-12) and np.nanmax(np.abs(judged(run).error)) < 1e-12
    assert axis_settings(run).preview == delay
    against = f"the reference delayed by {PREVIEW} samples" if delay else "the undelayed reference"
    assert f"maximum 0 µm (0 % of stroke) against {against}" in format_table(figures).splitlines()[0]
    (note,) = [note for note in figures["notes"]["recording"] if note.startswith(f"errors are computed from {against}")]
    apart = 1e6 * np.sqrt(np.mean((reference - late(reference)) ** 2))
    assert delay or f"delayed by {PREVIEW} samples (feedforward.preview) the RMS error is {apart:.4g} µm" in note
    label = f"reference, delayed by {PREVIEW} samples" if delay else "reference"
    assert traces_chart(judged(run)).lines[-1].label == label
    last = compute_metrics(within(run, 3.0, 3.5))
    assert last["rms_error_m"] == pytest.approx(0.0, abs=1e-12), "also in an excerpt"


def test_without_preview_the_received_reference_counts():
    reference = steps()
    run = recorded(reference, late(reference), preview=0)
    assert judged_reference(run) is run["reference"]
    figures = compute_metrics(run)
    assert figures["settling_time_s"] == pytest.approx(PREVIEW / RATE) and figures["max_error_m"] == 2e-6
    assert not any("preview" in note for note in figures["notes"]["recording"])


def test_loops_are_closed_when_the_delayed_reference_is_followed():
    time = np.arange(4000) / RATE
    reference = 5e-6 * (1.0 - np.cos(2.0 * np.pi * time))
    run = recorded(reference, late(reference))
    assert loop_width(run) == pytest.approx(0.0, abs=1e-9)
    assert compute_metrics(run)["loop_width_percent"] == pytest.approx(0.0, abs=1e-9)


def test_missing_samples_do_not_shift_what_comes_after_them():
    reference = np.linspace(0.0, 1e-5, 500)
    whole = recorded(reference, late(reference))
    kept = np.ones(500, dtype=bool)
    kept[200:203] = False
    columns = {name: values[kept] for name, values in {"time": whole.time, **whole.signals}.items()}
    judged = judged_reference(Recording.from_columns(columns, whole.metadata))
    expected = late(reference)
    expected[200 + PREVIEW : 203 + PREVIEW] = np.nan
    np.testing.assert_array_equal(judged, expected[kept])


def test_all_axes_of_a_stage_count_from_where_the_last_one_has_begun_its_scan():
    """The first motion of an axis, from where it rests into its scan, lasts until its first reversal."""
    number = np.arange(3000)
    axes = {}
    for name, half in (("x", 100), ("y", 300)):
        reference = 1e-6 * np.abs((number / half + 1.0) % 2.0 - 1.0) + 1e-6
        error = np.where(number < half, 5e-7, np.where(number < 300, 5e-9, 1e-9))
        axes[name] = Recording(number / 1e3, {"reference": reference, "displacement": reference - error})
    for axis in stage_axes(Recording.of_axes(axes, {})).values():
        found = compute_metrics(axis)
        assert found["max_error_m"] == pytest.approx(1e-9, rel=1e-6) and found["samples"] == 3000
        assert any(
            "errors of all axes of the stage are evaluated from 0.3 s on" in n for n in found["notes"]["recording"]
        )
        assert judged(axis).start == 300, "the charts count the same samples"
        assert compute_metrics(within(axis, 0.0, 0.5))["max_error_m"] == found["max_error_m"]
    assert plane_of(stage_axes(Recording.of_axes(axes, {}))).time[0] == 0.3
