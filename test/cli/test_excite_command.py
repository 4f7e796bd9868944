# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Excitations stay within the limits of the amplifier, and their recordings can be used for identification."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.cli.excite import _stages
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.references.recipes import RECIPES, in_metres, recipe
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters


def voltages(name, low, high, rate, **options):
    """Return the voltage of a run [V]."""
    found = recipe(name, low, high, rate, **options)
    if found.samples is not None:
        return found.samples
    waveform = Waveform(WaveformParameters.from_mapping(found.waveform), 1.0 / rate)
    return waveform.simulate(np.zeros(round(found.duration * rate)))


@pytest.mark.parametrize("name", RECIPES)
@settings(deadline=None)
@given(
    low=st.floats(-150.0, 0.0), high=st.floats(1.0, 150.0), rate=st.floats(10.0, 1e4), amplitude=st.floats(0.01, 1.0)
)
def test_recipes_stay_within_the_limits(name, low, high, rate, amplitude):
    options = {"duration": 2000.0 / rate} if name in ("creep", "chirp", "multisine") else {}
    volts = voltages(name, low, high, rate, amplitude=amplitude, **options)
    tolerance = 1e-9 * (high - low)
    assert low - tolerance <= volts.min() and volts.max() <= high + tolerance
    assert np.ptp(volts) > 0.0


def test_triangles_grow_in_twenty_equal_steps_and_close_the_largest_loop():
    volts = voltages("triangles", 0.0, 120.0, 1000.0)
    peaks = volts[1:-1][(volts[1:-1] > volts[:-2]) & (volts[1:-1] > volts[2:])]
    assert peaks == pytest.approx([*np.arange(6.0, 120.5, 6.0), 120.0])
    assert volts[0] == volts[-1] == 0.0


def test_decaying_begins_with_two_whole_cycles():
    volts = voltages("decaying", -30.0, 120.0, 200.0)
    cycle = 500
    assert volts[0] == -30.0 and np.max(volts[: 2 * cycle]) == pytest.approx(120.0, abs=1e-2)
    assert np.min(volts[cycle : 2 * cycle + 1]) == pytest.approx(-30.0, abs=1e-2)
    assert np.ptp(volts[-cycle:]) < 0.03 * 150.0


def test_only_lengths_are_scaled_with_the_gain():
    given_ = recipe("multisine", 0.0, 100.0, 1000.0)
    metres = in_metres(given_, 1e-7)
    for name, value in given_.waveform.items():
        assert metres[name] == (value * 1e-7 if name in ("amplitude", "offset") else value)
    levels = recipe("steps", 0.0, 100.0, 1000.0)
    assert in_metres(levels, 1e-7)["steps.values"] == [value * 1e-7 for value in levels.waveform["steps.values"]]


@pytest.mark.parametrize(
    "options", [{"amplitude": 0.0}, {"amplitude": 1.5}, {"frequency": 900.0}, {"frequency": -1.0}, {"duration": 1e-9}]
)
def test_recipes_refuse_what_no_amplifier_does(options):
    with pytest.raises(ConfigurationError, match="must be"):
        recipe("triangles", 0.0, 100.0, 1000.0, **options)


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed")
def test_an_excited_axis_is_identified_from_its_bag(tmp_path):
    def hysteresis(*arguments):
        command = [sys.executable, "-m", "hysteresis_ros.cli.main", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=180)

    bag = tmp_path / "bag"
    arguments = ["--recipe", "decaying", "--frequency", 4, "--record", bag, "--rate", "lockstep", "--composed"]
    result = hysteresis("excite", "picma_stage", *arguments)
    assert result.returncode == 0, result.stderr
    again = hysteresis("excite", "picma_stage", *arguments)
    assert again.returncode == 2 and "exists already" in again.stderr
    path = tmp_path / "params.yaml"
    result = hysteresis(
        "identify", bag, "--model", "prandtl_ishlinskii", "-p", "zone_count=0", "-o", path, "--json", "-"
    )
    assert result.returncode == 0, result.stderr
    figures = json.loads(result.stdout)
    # the plant's block is a lag of 13.27 ms under held voltages: exp(-5 ms / 13.27 ms) = 0.686; creep takes part of it
    assert figures["lag_s"] == pytest.approx(0.01327, abs=0.002)
    assert figures["rmse_percent_of_stroke"] < 0.5


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed")
@pytest.mark.skipif(not COMPILED, reason="without Numba no axis runs fused")
def test_what_is_too_fast_for_messages_is_excited_fused_and_a_run_that_stopped_itself_is_no_recording(tmp_path):
    configuration = load_configuration("kim2009").override("plant_simulator", overtravel=1e-9, sensor__noise=1e-4)
    path = tmp_path / "noisy.yaml"
    path.write_text(single_axis(configuration).configuration_text(), encoding="utf-8")
    command = [sys.executable, "-m", "hysteresis_ros.cli.main", "excite", str(path), "--recipe", "steps"]
    command += ["--duration", "0.5", "--record", str(tmp_path / "bag")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=180)
    assert ", fused …" in result.stdout and "recorded: " in result.stdout
    assert result.returncode == 2 and "the axis tripped after" in result.stderr, result.stderr
    assert "Traceback" not in result.stderr and "outside the range of the actuator" in result.stderr


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed")
@pytest.mark.skipif(not COMPILED, reason="without Numba no stage runs fused")
def test_a_stage_that_is_too_fast_for_messages_is_excited_fused_and_refused_in_processes(tmp_path):
    command = [sys.executable, "-m", "hysteresis_ros.cli.main", "excite", "xy_scanner", "--recipe", "multisine"]
    command += ["--realisations", "2", "--periods", "1", "--record", str(tmp_path / "bag")]
    refused = subprocess.run([*command, "--processes"], capture_output=True, text=True, timeout=180)
    assert refused.returncode == 2 and refused.stderr.count("10000 samples/s are too many for the messages") == 1
    assert "recorded" not in refused.stdout and list(tmp_path.iterdir()) == []
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert ", fused …" in result.stdout, result.stderr
    # whether every voltage was in time is the machine's
    assert any((tmp_path / "bag").glob("*.mcap")), result.stderr


def test_the_progress_of_an_excitation_does_not_state_that_it_is_complete_while_it_runs(monkeypatch):
    """The loop may compile for a minute before the axis runs; the bar was full meanwhile."""
    axis = single_axis(load_configuration("picma_stage"), None)
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    words, state, part = _stages(axis, 10.0)
    assert words.endswith("run 10 s")
    clock[0] += 4.0
    assert part() == pytest.approx(0.4) and state() == ""
    clock[0] += 30.0
    assert part() is None and "compiles the loop" in state()
