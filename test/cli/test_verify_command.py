# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis verify``: one line and an exit code state whether a recording is reproduced bit for bit.

A recording with missing samples or changes is called incomplete, neither equal to its offline twin nor different.
"""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.cli.recording import unlike
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.recordings.provenance import LARGEST, packed_files

#: A device moves to its first voltage within its safe slew rate, but its simulation does so at once.
DEVICE = {"driver": "simulated", "safe_slew_rate": 1.0}


def verify(path):
    result = CliRunner().invoke(main, ["verify", str(path)])
    assert result.output.count("\n") == 1
    return result.exit_code, result.output


@pytest.mark.parametrize(("name", "plant"), [("kim2009", {}), ("kim2009", DEVICE), ("inchworm_travel", {})])
def test_a_simulated_run_is_repeated(tmp_path, name, plant):
    path, configuration = tmp_path / "run.npz", load_configuration(name).override("plant_simulator", **plant)
    save_run(simulate(single_axis(configuration), duration=0.02), path)
    samples = load_run(path).time.size
    bag = tmp_path / "run.mcap"
    save_run(load_run(path), bag)
    for file in (path, bag):  # in a bag too, a simulated device is simulated again
        assert verify(file) == (0, f"{file}: {samples} samples equal the offline twin bit for bit, none missing\n")


def test_the_last_digit_of_one_sample_is_seen(tmp_path):
    run = simulate(single_axis(load_configuration("kim2009")), duration=0.02)
    run.signals["command"][7] = np.nextafter(run.signals["command"][7], 1.0)
    save_run(run, tmp_path / "run.npz")
    code, line = verify(tmp_path / "run.npz")
    assert code == 1 and "differs from the offline twin (command: 1 samples)" in line


def test_what_cannot_be_repeated_is_refused(tmp_path):
    run = simulate(single_axis(load_configuration("kim2009")), duration=0.02)
    save_run(run, tmp_path / "run.csv")
    code, line = verify(tmp_path / "run.csv")
    assert code == 2 and "contains no configuration" in line
    run.metadata["source"] = "bag"
    save_run(run, tmp_path / "run.npz")
    code, line = verify(tmp_path / "run.npz")
    assert code == 2 and "only lockstep and fused runs can be repeated" in line
    code, line = verify(tmp_path / "nothing")
    assert code == 2 and "no such file" in line


def test_a_recording_without_setpoints_is_refused(tmp_path):
    run = simulate(single_axis(load_configuration("kim2009")), duration=0.02)
    del run.signals["setpoint"], run.units["setpoint"]
    for named, said in ((run, "has no setpoint:"), (Recording.of_axes({"x": run}, run.metadata), "has no x/setpoint:")):
        save_run(named, tmp_path / "run.npz")
        code, line = verify(tmp_path / "run.npz")
        assert code == 2 and said in line and "verify the bag of 'up --record'" in line


@pytest.fixture
def scanned(tmp_path):
    """Return a function that records a lockstep run along a file with some empty lines, and returns that file."""

    def made(empty: int):
        scan = tmp_path / "scan.csv"
        scan.write_text("reference [um]\n" + "".join(f"{0.1 * k:.1f}\n" for k in range(20)) + "\n" * empty)
        of_file = {"path": str(scan), "sample_time": 1e-3}
        followed = {"waveform__type": "file"} | {f"waveform__file__{name}": value for name, value in of_file.items()}
        configuration = load_configuration("kim2009").override("reference_generator", **followed)
        run = simulate(single_axis(configuration.override("", time_mode="lockstep")), duration=0.02)
        run.metadata.update(source="bag", files=packed_files([scan]))
        save_run(run, tmp_path / "run.npz")
        return tmp_path / "run.npz", scan

    return made


def test_files_are_those_of_the_recording_whatever_has_become_of_them(scanned):
    path, scan = scanned(0)
    assert verify(path)[0] == 0
    scan.write_text(scan.read_text().replace("0.7", "0.8"))
    result = CliRunner().invoke(main, ["verify", str(path)])
    assert result.exit_code == 0 and "equal the offline twin bit for bit" in result.stdout
    assert f"{scan} on this disk differs from the file of the run" in result.stderr
    scan.unlink()
    code, line = verify(path)
    assert code == 0 and "bit for bit" in line


def test_a_file_that_is_too_large_for_the_recording_has_to_be_the_same_on_the_disk(scanned):
    path, scan = scanned(LARGEST)
    assert verify(path)[0] == 0
    scan.write_text(scan.read_text().replace("0.7", "0.8"))
    code, line = verify(path)
    assert code == 2 and f"{scan}: the run used this file" in line and "has changed on this disk since" in line
    scan.unlink()
    assert verify(path) == (code, line.replace("has changed on this disk since", "is no longer on this disk"))


def test_files_of_the_axes_of_a_stage_are_those_of_the_recording_too(tmp_path):
    scan, path = tmp_path / "scan.csv", tmp_path / "run.npz"
    scan.write_text("reference [um]\n" + "".join(f"{0.01 * k:.2f}\n" for k in range(50)))
    followed = {"waveform__type": "file", "waveform__file__path": str(scan), "waveform__file__sample_time": 1e-4}
    configuration = load_configuration("xy_scanner").override("y/reference_generator", **followed)
    run = simulate_stage(StageParameters.from_configuration(configuration), duration=0.01)
    run.metadata.update(files=packed_files([scan]))
    save_run(run, path)
    scan.unlink()
    assert verify(path) == (0, f"{path}: 100 samples equal the offline twin bit for bit, none missing\n")


@pytest.mark.parametrize(
    ("metadata", "found", "said"),
    [
        ({}, {}, ""),
        ({"missing_samples": 0, "missing_changes": 0}, {}, ""),
        ({"missing_samples": 3}, {}, "run lacks 3 samples, so it cannot be compared with the offline twin"),
        (
            {"missing_changes": 2},
            {},
            "run lacks 2 entries of the change log, so it cannot be compared with the offline twin",
        ),
        (
            {"missing_samples": 1, "missing_changes": 2},
            {"command": 4},
            "run lacks 1 samples and 2 entries of the change log, so it cannot be compared with the offline twin",
        ),
        ({}, {"command": 4}, "run differs from the offline twin (command: 4 samples)"),
    ],
)
def test_an_incomplete_recording_is_not_said_to_differ(metadata, found, said):
    run = Recording(np.arange(4.0), {"command": np.zeros(4)}, metadata=metadata)
    text = unlike("run", run, found)
    assert text == said


def test_a_recording_that_lost_samples_at_its_end_is_not_called_equal(tmp_path):
    run = simulate(single_axis(load_configuration("kim2009")), duration=0.02)
    run.metadata["missing_samples"] = 5
    save_run(run, tmp_path / "run.npz")
    result = CliRunner().invoke(main, ["verify", str(tmp_path / "run.npz")])
    assert result.exit_code == 1 and "lacks 5 samples, so it cannot be compared" in result.output
