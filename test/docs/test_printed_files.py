# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameter files on the pages, or written by the commands on the pages, limit the steps of the voltage."""

from __future__ import annotations

import pathlib
import re
import shlex

import numpy as np
import pytest
from click.testing import CliRunner
from safe_motion_support import NODES, quantum, stated, steps

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import dump_configuration, load_configuration, parse_configuration
from hysteresis_ros.loop.reach import single_axis

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
#: Stages of coupled axes; test_safe_motion.py judges their files.
COUPLED = {"steering_mirror", "xy_scanner"}
SHIPPED = {path.stem for path in (ROOT / "config").glob("*.yaml")}


def printed() -> dict[str, str]:
    """Return the parameter files of a complete axis on the pages, by page and number."""
    found = {}
    for page in PAGES:
        for block in re.findall(r"^```yaml\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
            if "/hysteresis_compensator:" in block:
                found[f"{page.stem}-{len(found)}"] = block
    return found


def writing() -> dict[str, list[str]]:
    """Return the words of the commands on the pages that create a file, or design one from a shipped configuration."""
    found = {}
    for page in PAGES:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for line in re.findall(r"^hysteresis ((?:new|design) .*)$", text, re.MULTILINE):
            # the simulated stage is used
            words = shlex.split(re.sub(r"--driver(-option)? \S+", "", line), comments=True)
            if "--axes" in words:
                continue  # a stage: test_new_command.py judges its manual commands
            if words[0] == "new" or (words[1] in SHIPPED - COUPLED and "-o" in words and "leaky_pi" not in words):
                found[f"{page.stem}-{len(found)}"] = words
    return found


def judge(text: str) -> None:
    """Move a file's axis, with a simulated plant, to its farthest setpoint and back, with and without the approach."""
    configuration = parse_configuration(text, "printed.yaml")
    nodes = NODES
    # the simulated plant replaces the device
    entries = {
        name: {key: value for key, value in values.items() if not key.startswith(("driver", "tcp_stage."))}
        for name, values in configuration.entries
    }
    simulated = parse_configuration(dump_configuration(entries), "printed.yaml")
    if not configuration.describes("plant_simulator"):  # an external plant is replaced by a linear one
        nodes, plant = NODES[1:], configuration.node("hysteresis_compensator")
        model = {name: value for name, value in plant.items() if name.startswith(("hysteresis.", "limits."))}
        simulated = simulated.override("plant_simulator", **model)
    allowed = stated(text, single_axis(simulated), nodes)
    for bare in (False, True):
        largest = np.max(np.abs(np.diff(steps(simulated, bare))))
        assert 0.0 < largest <= allowed + 1e-9 + 2.0 * quantum(simulated)


@pytest.mark.parametrize("name", printed())
def test_a_printed_file_states_how_far_the_voltage_steps(name):
    judge(printed()[name])


@pytest.mark.parametrize("name", writing())
def test_a_file_that_a_command_of_a_page_writes_states_how_far_the_voltage_steps(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = writing()[name]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    (path,) = tmp_path.glob("*.yaml")
    judge(load_configuration(path).text)


def test_there_are_files_to_judge():
    assert len(printed()) >= 3 and {words[0] for words in writing().values()} == {"new", "design"}
