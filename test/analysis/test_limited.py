# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The report states by what the output of a run was limited, if it was limited for more than a moment."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

import hysteresis_ros as hr
from hysteresis_ros.analysis.metrics import limited_text
from hysteresis_ros.analysis.report import render_report, sampling_text
from hysteresis_ros.cli.main import main
from hysteresis_ros.loop.watch import STALE
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import save_run

N = 2000


def run(cut, voltage=None, mode=0.0):
    time = np.arange(N) / 1000.0
    voltage = 50.0 + 40.0 * np.sin(20.0 * time) if voltage is None else voltage
    signals = {"voltage": voltage, "saturated": np.asarray(cut, dtype=float), "plant_mode": np.full(N, mode)}
    return Recording(time, signals, {}, {})


def test_most_of_a_run_at_a_slew_rate_is_said_first_with_its_share_and_time():
    recording = run(np.arange(N) < 1340)
    said = limited_text(recording)
    share = "the output was limited for 67 % of the run, 1.34 s between 0 s and 1.339 s"
    assert said.startswith(f"{share}, by safe_slew_rate or limits.slew_rate")
    assert sampling_text(recording).startswith("The output was limited for 67 %")
    assert "Evaluated at all 2000 samples" in sampling_text(recording)


@pytest.mark.slow
def test_the_page_of_a_run_says_it_before_its_figures():
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: no plots")
    pytest.importorskip("jinja2", reason="jinja2 is not installed: no pages")
    cut = run(np.arange(N) < 1340)
    path = 5e-6 * (1.0 - np.cos(20.0 * cut.time))
    signals = {"reference": path, "displacement": path, "measured": path}
    page = render_report(Recording(cut.time, {**cut.signals, **signals}, {}, {}), "cut")
    share = "The output was limited for 67 % of the run, 1.34 s between 0 s and 1.339 s"
    said = f"{share}, by safe_slew_rate or limits.slew_rate"
    assert page.count(said) == 1 and page.index(said) < page.index('<table class="figures">')


@pytest.mark.parametrize(("samples", "said"), [(0, False), (19, False), (20, False), (21, True), (101, True)])
def test_a_moment_is_not_mentioned(samples, said):
    assert bool(limited_text(run(np.arange(N) < samples))) == said


@pytest.mark.parametrize("samples", [0, 1340])
def test_a_report_warns_of_a_limited_run_and_of_no_other(samples, tmp_path):
    cut = run(np.arange(N) < samples)
    path = 5e-6 * (1.0 - np.cos(20.0 * cut.time))
    names = ("reference", "displacement", "measured")
    save_run(Recording(cut.time, {**cut.signals, **dict.fromkeys(names, path)}, {}, {}), tmp_path / "run.npz")
    result = CliRunner().invoke(main, ["report", str(tmp_path / "run.npz")])
    assert result.exit_code == 0
    assert ("hysteresis: warning: the output was limited for 67 %" in result.output) == (samples > 0)


def test_the_range_and_the_way_to_safe_are_named():
    voltage = np.clip(50.0 + 90.0 * np.sin(20.0 * np.arange(N) / 1000.0), 0.0, 100.0)
    ends = (voltage == 0.0) | (voltage == 100.0)
    assert "by the range limits.minimum … limits.maximum" in limited_text(run(ends, voltage))
    assert "by the ramp to safe_voltage at safe_slew_rate (50 %)" in limited_text(run(np.arange(N) < 1000, mode=STALE))


def test_single_samples_at_the_recorded_range_are_told_from_the_slew_rate():
    """Every tenth sample is cut at 0 V, every fifth of the others by the slew rate."""
    number = np.arange(N)
    voltage = np.where(number % 10 == 0, 0.0, 50.0 + 40.0 * np.sin(0.02 * number))
    text = "/**/hysteresis_compensator:\n  ros__parameters: {limits: {minimum: 0.0, maximum: 100.0}}\n"
    recording = run((number % 10 == 0) | (number % 20 == 5), voltage)
    said = limited_text(Recording(recording.time, recording.signals, {}, {"configuration": text}))
    assert "by the range limits.minimum … limits.maximum (10 %), safe_slew_rate or limits.slew_rate (5 %)" in said


@pytest.mark.slow
def test_simulations_warn_of_a_limited_output(tmp_path):
    configuration = hr.load("kim2009").override("hysteresis_compensator", limits__slew_rate=100.0)
    with pytest.warns(UserWarning, match="the output was limited for .* by safe_slew_rate or limits.slew_rate"):
        run = hr.simulate(configuration, duration=0.1)
    configuration.save(tmp_path / "slow.yaml")
    result = CliRunner().invoke(
        main, ["simulate", str(tmp_path / "slow.yaml"), "--duration", "0.1", "-o", str(tmp_path / "run.npz")]
    )
    assert result.exit_code == 0 and f"hysteresis: warning: {limited_text(run)}" in result.output


def test_a_recording_that_does_not_say_what_was_cut_says_nothing():
    recording = Recording(np.arange(3) / 1000.0, {"voltage": np.zeros(3)}, {}, {})
    assert limited_text(recording) == ""
