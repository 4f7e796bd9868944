# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis scan``: figures, limits, paths written as files and read again, refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.references.scans import SCANS, scan_of

RASTER = ["raster", "width=80um", "depth=60um", "lines=16", "flyback=4", "frame_rate=2Hz"]
EXAMPLES = {
    "raster": RASTER[1:],
    "spiral": ["diameter=20um", "turns=20"],
    "lissajous": ["width=80um", "depth=60um", "lines=20"],
    "cycloid": ["width=80um", "diameter=20um"],
    "rosette": ["diameter=20um", "lines=21"],
}


def run(*words):
    return CliRunner().invoke(main, ["scan", *map(str, words)])


def refusal(*words) -> str:
    result = run(*words)
    assert result.exit_code == 2 and result.stderr.startswith("hysteresis: ") and not result.stdout, result.output
    assert len(result.stderr.splitlines()) == 1
    return result.stderr


def test_it_prints_what_the_scan_asks_of_its_axes():
    result = run(*RASTER, "rotation=90deg", "--limit", "velocity=20mm/s")
    made = scan_of("raster", dict(width=80e-6, depth=60e-6, lines=16, flyback=4, frame_rate=2.0))
    assert result.exit_code == 0
    assert f"({1e3 * made.line_velocity:.4g} mm/s)" in result.stdout and "64 % of the time" in result.stdout
    rows = {line.split()[0]: line.split() for line in result.stdout.splitlines() if line[:2] in ("x ", "y ")}
    # rotated by a right angle: y scans
    velocity, acceleration, jerk = (made.peak(order)[0] for order in (1, 2, 3))
    assert rows["y"][-3:] == [f"{1e3 * velocity:.4g}", f"{acceleration:.4g}", f"{jerk:.4g}"]
    assert f"allow up to {2.0 * 20e-3 / velocity:.4g} Hz" in result.stdout


@pytest.mark.parametrize("kind", EXAMPLES)
def test_the_figures_are_json_and_the_picture_is_one(kind, tmp_path):
    words = [kind, *EXAMPLES[kind], "--harmonics", "3", "--json", "-"]
    result = run(*words, *(["--plot", tmp_path / "scan.png"] if kind == "raster" else []))
    found = json.loads(result.stdout)
    assert found["scan"] == kind and len(found["harmonics"]) <= 3 and set(found["axes"]) == {"x", "y"}
    if kind == "raster":
        assert (tmp_path / "scan.png").read_bytes().startswith(b"\x89PNG")
    assert set(EXAMPLES) | {"file"} == set(SCANS)


def test_the_fastest_scan_keeps_its_limits_and_the_next_one_does_not():
    words = [*RASTER, "--limit", "acceleration=5m/s^2,4mm/s²", "--limit", "low=-60um", "--limit", "high=60um"]
    fastest = json.loads(run(*words, "--fastest", "--json", "-").stdout)
    assert fastest["frame_rate_hz"] == pytest.approx(fastest["largest_frame_rate_hz"])
    peaks = [axis["acceleration_m_s2"] for axis in fastest["axes"].values()]
    assert peaks[1] == pytest.approx(4e-3) and peaks[0] < 5.0
    rate = fastest["frame_rate_hz"]
    assert run(*words[:-6], f"frame_rate={0.999 * rate}", *words[-6:]).exit_code == 0
    text = refusal(*words[:-6], f"frame_rate={2.0 * rate}", *words[-6:])
    assert "acceleration of y" in text and "is 4 times its limit 0.004 m/s²" in text


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_the_path_is_written_and_read_again(tmp_path, suffix):
    path = tmp_path / f"path.{suffix}"
    result = run(*RASTER, "--rate", "10kHz", "-o", path)
    assert f"{path}: written, 5000 samples at 10000 Hz" in result.stdout
    made = scan_of("raster", dict(width=80e-6, depth=60e-6, lines=16, flyback=4, frame_rate=2.0))
    time = np.arange(5000) / 1e4
    if suffix == "csv":
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        assert path.read_text().startswith("time [s],x [m],y [m],frame,line,pixel,direction\n")
    else:
        with np.load(path) as arrays:
            table = np.column_stack([arrays[name] for name in arrays])
    clock = made.clock(time)
    expected = [time, *made.position(time), clock.frame, clock.line, clock.pixel, clock.direction]
    assert np.array_equal(table, np.column_stack(expected))
    again = json.loads(run("file", f"path={path}", "--json", "-").stdout)
    assert again["period_s"] == pytest.approx(0.5)
    assert again["axes"]["x"]["velocity_m_s"] == pytest.approx(made.peak(1)[0], rel=1e-3)


@pytest.mark.parametrize(
    "words, expected",
    [
        (["rastr"], "did you mean raster"),
        (["raster", "width=80", "depth=60um"], "width = '80': of which unit? Write 80um"),
        (["raster", "width=80um"], "depth = None: missing"),
        (["raster", "width=80um", "depht=60um"], "did you mean depth"),
        (["raster", "width"], "write NAME=VALUE"),
        ([*RASTER, "rotation=3m"], "must be in rad"),
        ([*RASTER, "lines=2.5"], "whole number"),
        ([*RASTER, "--limit", "velocty=1mm/s"], "did you mean velocity"),
        ([*RASTER, "--limit", "velocity=1mm/s,2mm/s,3mm/s"], "3 values for 2 axes"),
        ([*RASTER, "--limit", "high=20um"], "position of x"),
        ([*RASTER, "--fastest"], "no limit determines a largest frame rate"),
        ([*RASTER, "turn_law=parabolic", "--limit", "jerk=1e6", "--fastest"], "the acceleration jumps"),
        ([*RASTER, "-o", "path.csv"], "--rate 20kHz"),
        ([*RASTER, "-o", "path.txt", "--rate", "1kHz"], "write .csv or .npz"),
        ([*RASTER, "--rate", "1kHz"], "give -o path.csv"),
        ([*RASTER, "-o", "missing/path.csv", "--rate", "1kHz"], "the folder does not exist"),
        ([*RASTER, "--plot", "path.pdf"], ".png"),
    ],
)
def test_what_cannot_be_computed_is_refused(words, expected):
    assert expected in refusal(*words)


def test_a_harmonic_that_an_axis_does_not_have_is_0_and_not_a_rounding_error_with_a_phase():
    lines = run("lissajous", "width=0.4um", "depth=0.4um", "lines=5", "frame_rate=2Hz").stdout.splitlines()
    first = next(number for number, line in enumerate(lines) if line.startswith("harmonic"))
    rows = {line.split()[0]: line.split()[1:] for line in lines[first + 1 :]}
    assert rows == {"4": ["0", "0.2", "µm,", "0.0°"], "5": ["0.2", "µm,", "0.0°", "0"]}
