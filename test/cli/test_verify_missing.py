# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A recording with missing samples or changes is called incomplete, neither equal to its offline twin nor different."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.cli.recording import unlike
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import save_run


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
