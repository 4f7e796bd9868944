# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The parameter tables: complete, and the same in the documentation."""

import pathlib
import subprocess
import sys

from hysteresis_ros.cli.describe import parameter_lines
from hysteresis_ros.configuration import STAGE
from hysteresis_ros.loop.parameters import NODE_PARAMETERS

DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs" / "parameters.md"


def test_the_documentation_holds_the_present_tables():
    text = DOCUMENT.read_text(encoding="utf-8")
    assert text.endswith("\n".join(parameter_lines([*NODE_PARAMETERS, STAGE, "axis_array"]))), (
        "docs/parameters.md is out of date: keep its head and replace the tables by what `hysteresis parameters` prints"
    )


def test_every_parameter_of_a_node_is_listed_with_range_and_meaning():
    printed = "\n".join(parameter_lines(["motion_controller"]))
    for row in NODE_PARAMETERS["motion_controller"].table():
        assert f"| `{row.name}` |" in printed and row.description
    assert "plant_simulator" not in printed.split("## motion_controller")[0].split("## Every node")[0]


def test_an_unknown_node_is_refused_with_the_names_there_are():
    answer = subprocess.run(
        [sys.executable, "-m", "hysteresis_ros.cli.main", "parameters", "nothing"], capture_output=True, text=True
    )
    assert answer.returncode == 2 and "plant_simulator" in answer.stderr and len(answer.stderr.splitlines()) == 1
