# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Commands for a single actuator refuse an inchworm in one line, by name, with exit code 2."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("excite", "inchworm_travel", "--recipe", "chirp", "--record", "bag"), "has an inchworm_sequencer instead"),
        (("compare", "inchworm_travel"), "needs a reference generator"),
        (
            ("identify", "run.npz", "--model", "polynomial", "-o", "model.yaml"),
            "this run of an inchworm motor records the displacement of the slider",
        ),
    ],
)
def test_commands_for_one_actuator_refuse_an_inchworm(arguments, named, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = np.zeros(100)
    names = ("voltage", "displacement", "front_voltage", "rear_voltage")
    np.savez("run.npz", time=np.arange(100) * 1e-3, **{name: rows for name in names})
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert named in result.output and result.output.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.npz"]


def test_a_design_that_reaches_the_sliders_swing_warns_with_both_frequencies(tmp_path):
    result = CliRunner().invoke(
        main, ("design", "inchworm_travel", "--controller", "pid", "-o", str(tmp_path / "designed.yaml"))
    )
    assert result.exit_code == 0 and "455.8 Hz" in result.output
