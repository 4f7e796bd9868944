# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis verify``: one line, and an exit code that says whether a recording is repeated bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.run import simulate


def verify(path):
    result = CliRunner().invoke(main, ["verify", str(path)])
    assert result.output.count("\n") == 1
    return result.exit_code, result.output


@pytest.mark.parametrize("name", ["kim2009", "inchworm_travel"])
def test_a_simulated_run_is_repeated(tmp_path, name):
    path = tmp_path / "run.npz"
    save_run(simulate(single_axis(load_configuration(name)), duration=0.02), path)
    samples = load_run(path).time.size
    assert verify(path) == (0, f"{path}: {samples} samples equal the offline twin bit for bit, none missing\n")


def test_the_last_digit_of_one_sample_is_seen(tmp_path):
    run = simulate(single_axis(load_configuration("kim2009")), duration=0.02)
    run.signals["command"][7] = np.nextafter(run.signals["command"][7], 1.0)
    save_run(run, tmp_path / "run.npz")
    code, line = verify(tmp_path / "run.npz")
    assert code == 1 and "differs from the offline twin (command: 1 samples; 0 samples missing)" in line


def test_what_cannot_be_repeated_is_refused(tmp_path):
    run = simulate(single_axis(load_configuration("kim2009")), duration=0.02)
    save_run(run, tmp_path / "run.csv")
    code, line = verify(tmp_path / "run.csv")
    assert code == 2 and "holds no configuration" in line
    run.metadata["source"] = "bag"
    save_run(run, tmp_path / "run.npz")
    code, line = verify(tmp_path / "run.npz")
    assert code == 2 and "only lockstep and fused runs repeat" in line
    code, line = verify(tmp_path / "nothing")
    assert code == 2 and "no such file" in line
