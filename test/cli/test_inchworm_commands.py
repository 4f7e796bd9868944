"""Commands for a single actuator refuse an inchworm in one line, by name, with exit code 2."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("excite", "inchworm_travel", "--recipe", "chirp", "--record", "bag"), "inchworm_sequencer stands in"),
        (("compare", "inchworm_travel"), "sequencer stands in"),
        (("identify", "run.npz", "--model", "polynomial", "-o", "model.yaml"), "a run of an inchworm"),
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
