# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""`hysteresis simulate`: the same run in every format, replayed setpoints, and messages for wrong input."""

import numpy as np
import pytest
from command_support import hysteresis, hysteresis_process

from hysteresis_ros.recordings import COLUMNS, load_run


@pytest.fixture(scope="module")
def run_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.npz"
    assert "600 samples at 3000 Hz" in hysteresis_process("simulate", "kim2009", "-o", path, "--duration", 0.2)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_every_format_holds_the_same_numbers(run_file, tmp_path, suffix):
    other = tmp_path / f"run{suffix}"
    hysteresis("simulate", "kim2009", "-o", other, "--duration", 0.2)
    first, second = load_run(run_file), load_run(other)
    np.testing.assert_array_equal(first.time, second.time)
    for name in COLUMNS:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def test_recorded_setpoints_are_replayed_sample_by_sample(run_file, tmp_path):
    given = load_run(run_file)
    setpoints = np.where(given.time > 0.05, 3e-6, 0.0)
    from hysteresis_ros.recordings import Recording, save_run

    save_run(Recording(given.time, {**given.signals, "setpoint": setpoints}), tmp_path / "given.npz")
    hysteresis("simulate", "kim2009", "-o", tmp_path / "replay.npz", "--setpoints", tmp_path / "given.npz")
    replay = load_run(tmp_path / "replay.npz")
    np.testing.assert_array_equal(replay["setpoint"], setpoints)
    # the steps of 2.05 µm of the file's waveform are added to the setpoint
    assert replay["reference"][-1] == pytest.approx(5.05e-6)


def test_a_fault_after_the_end_of_the_run_is_reported(tmp_path):
    words = "--duration", 0.02, "--fault", "stale:0.5:0.1", "-o", tmp_path / "run.npz"
    text = hysteresis("simulate", "kim2009", *words)
    assert "warning: fault 'stale:0.5:0.1': begins after the end of the run, 0.02 s" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nothing.yaml", "-o", "x.npz"), "nothing.yaml: no such file"),
        (("nothing", "-o", "x.npz"), "kim2009"),
        (("kim2009", "-o", "x.txt", "--duration", "0.01"), "write .npz, .csv or .mcap"),
        (("kim2009", "-o", "x.npz", "--duration", "-1"), "positive number of seconds"),
        (("kim2009", "-o", "nowhere/x.npz", "--duration", "0.01"), "nowhere"),
        (("kim2009", "-o", "x.npz", "--setpoints", "none.npz"), "none.npz"),
    ],
)
def test_wrong_input_gets_one_line_and_exit_code_2(tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    text = hysteresis("simulate", *words, code=2)
    assert said in text and len(text.splitlines()) == 1 and "Traceback" not in text
