# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis commission``: asks before any motion, reports problems, writes a page; also with nodes."""

from __future__ import annotations

import importlib.util
import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from waiting import until

from hysteresis_ros.cli import commission, progress
from hysteresis_ros.cli.commissioning import fitting, stages
from hysteresis_ros.cli.commissioning.bench import require_sound
from hysteresis_ros.cli.commissioning.new_file import NewAxis, write_new
from hysteresis_ros.cli.commissioning.situation import Folder, plan_of
from hysteresis_ros.cli.commissioning.stages import Computation
from hysteresis_ros.cli.main import main
from hysteresis_ros.cli.progress import Progress
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import HysteresisError, IdentificationError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.references.recipes import driven, write_samples

DRIVER = """
from dataclasses import replace

from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.drivers.simulated import DRIVER, SimulatedDriver


class Absent(SimulatedDriver):
    def open(self, parameters, sample_rate):
        raise DriverError("port /dev/ttyUSB7", "is not there", "plug it in")


DRIVER = replace(DRIVER, driver=Absent)
"""
needs_ros = pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed: no nodes")


def written(folder, **values):
    """Return the path of a new axis."""
    path = folder / "stage.yaml"
    write_new(path, NewAxis(**{"stroke": 20e-6, "minimum": 0.0, "maximum": 100.0, "sample_rate": 500.0} | values))
    return path


def called(*words):
    """Run the command as a process without a terminal does."""
    return CliRunner().invoke(main, ["commission", *map(str, words)])


def test_stages_alone_offline_say_what_they_move_and_leave_a_page(tmp_path):
    path = written(tmp_path)
    answer = called(path, "--offline", "--yes", "--stage", "noise", "--stage", "gain")
    assert answer.exit_code == 0, answer.output
    assert "a step of +5 V from 0 V and back, about 1 µm; 2.35 s" in answer.output
    assert "+5 V moved the stage by 1 µm: 0.2 µm/V, the sign is right" in answer.output
    folder = tmp_path / "stage_commissioning"
    page = (folder / "report.html").read_text()
    assert "the sign is right" in page and page.count("data:image/png") == 2 and "Commissioning of stage.yaml" in page
    assert json.loads((folder / "gain.json").read_text())["figures"]["gain_m_per_v"] == pytest.approx(2e-7, rel=1e-3)


WRONG = {
    "nobody there": ((), "noise: no terminal to ask for permission to move; give --yes"),
    "no such stage": (("--yes", "--stage", "nois"), "no stage nois; there are noise, gain"),
    "before its time": (("--yes", "--stage", "creep"), "creep needs the results of noise, gain"),
    "nothing to resume": (("--resume",), "no commissioning to resume"),
    "file": (("--yes", "--directory", __file__), "is a file, but --directory must be a folder; choose another"),
    "file alone": (("--stage", "noise", "--directory", __file__), "is a file, but --directory must be a folder"),
    "unit": (("--yes", "--scan-stroke", "70V"), "--scan-stroke '70V': is in V"),
    "no unit": (("--scan-stroke", "60"), "--scan-stroke '60': of which unit? Write 60um or 60nm"),
    "no frequency": (("--yes", "--scan-frequency", "0Hz"), "/commissioning: scan_frequency"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_is_named(tmp_path, case):
    words, said = WRONG[case]
    answer = called(written(tmp_path), "--offline", *words)
    assert answer.exit_code == 2 and said in answer.output, answer.output
    assert not list(tmp_path.glob("*/noise.npz"))


def test_an_external_plant_too_fast_for_messages_is_refused_before_anything_begins(tmp_path):
    answer = called(written(tmp_path, sample_rate=2000.0), "--plant", "external", "--yes")
    assert answer.exit_code == 2 and "2000" in answer.output and "300 Hz" in answer.output, answer.output
    assert [one.name for one in tmp_path.iterdir()] == ["stage.yaml"]


def test_a_long_fit_shows_that_it_goes_on_and_its_state(tmp_path, monkeypatch):
    """The fit waits until its state is in the output."""
    lines = []
    say = Progress.say
    monkeypatch.setattr(Progress, "say", lambda self, text: (lines.append(text), say(self, text)))
    monkeypatch.setattr(commission, "SILENCE", 0.01)
    monkeypatch.setattr(progress, "SHORT", 0.01)

    def fit(*data, progress, **options):
        progress(7, "residual 12 nm")
        until(lambda: any("still running" in line and line.endswith(", residual 12 nm") for line in lines))
        raise IdentificationError("enough")

    for name in ("fast_data", "read_data", "slow_data", "_is_quick"):
        monkeypatch.setattr(fitting, name, lambda *arguments: None)
    monkeypatch.setattr(fitting, "identify", fit)
    # the stage of the fit comes first, because the movements before it take long
    monkeypatch.setitem(stages.STAGES, "noise", Computation("model", fitting.identify_stage))
    monkeypatch.setattr(Folder, "recording", lambda self, stage: None)
    answer = called(written(tmp_path), "--offline", "--yes", "--stage", "noise")
    assert "enough" in answer.output and re.search(r"… still running: \d+ s, residual 12 nm", answer.output)


@needs_ros
def test_a_device_that_is_not_there_is_named_by_its_node_and_ends_it(tmp_path, capfd):
    (tmp_path / "mine.py").write_text(DRIVER)
    options = ("hysteresis.type=proportional", "hysteresis.proportional.gain=2e-7")
    options += ("limits.minimum=0", "limits.maximum=100")
    path = written(tmp_path, driver="./mine.py", driver_options=options)
    answer = called(path, "--yes")
    assert answer.exit_code == 2 and "noise: /hysteresis_axis ended with exit code 2" in answer.output
    assert "port /dev/ttyUSB7 is not there; plug it in" in capfd.readouterr().err
    assert not (tmp_path / "stage_commissioning/noise.json").exists()


@needs_ros
def test_a_run_through_the_nodes_is_what_was_asked_for(tmp_path):
    from hysteresis_ros.cli.commissioning.bench import GraphBench

    configuration = load_configuration(written(tmp_path, sample_rate=100.0))
    axis = single_axis(configuration)
    voltages = np.concatenate([np.zeros(20), np.linspace(0.0, 5.0, 60), np.zeros(20)])
    gain = plan_of(configuration, axis).gain
    waveform = {"type": "file", "cycles": 1, "file.path": write_samples(tmp_path / "v.npz", gain * voltages, 100.0)}
    # a busy machine may be late, which is not tested here
    configuration = configuration.override("plant_simulator", late_limit=-1)
    asked = single_axis(driven(configuration, axis.hysteresis_compensator.limits, gain, waveform)).with_duration(1.0)
    found = require_sound(GraphBench(external=False).run(asked), 100)
    assert len(found) == 100 and np.nanmax(found["measured"]) == pytest.approx(1e-6, rel=0.05)


def test_the_bench_of_an_external_plant_is_known_from_the_file(tmp_path):
    path = written(tmp_path, external=True)
    with pytest.raises(HysteresisError, match="exists already"):
        written(tmp_path)
    assert called(path, "--offline", "--plant", "own", "--yes", "--stage", "noise").exit_code == 0
    state = json.loads((tmp_path / "stage_commissioning/state.json").read_text())
    assert state["bench"] == "offline"
