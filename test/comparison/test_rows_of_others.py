# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Rows of the comparison that are added by laws of other packages; the rows of built-in laws stay the same."""

from __future__ import annotations

import pathlib
import subprocess
import sys

import pytest

from hysteresis_ros.control.law import ControllerLaw
from hysteresis_ros.control.laws.open_loop import OpenLoop

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGE = """
from hysteresis_ros.laboratory.comparison.laws import ComparedLaw
COMPARED = ComparedLaw("leaky_pi", {{"{row}": lambda given: {{"type": "leaky_pi", "leaky_pi.Kp": 2.0}}}})
"""
CODE = """
from hysteresis_ros.laboratory.comparison.candidates import controllers
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
found = controllers(single_axis(load_configuration("picma_stage"), None))
print(*found, sep="|")
print(found["leaky PI"](None))
"""


def ran(folder: pathlib.Path, row: str) -> subprocess.CompletedProcess:
    """Return the names in the comparison with a package that adds a row."""
    information = folder / "others-1.0.dist-info"
    information.mkdir()
    (folder / "leaky_rows.py").write_text(PACKAGE.format(row=row))
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: others\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[hysteresis_ros.compared]\nleaky_pi = leaky_rows:COMPARED\n")
    code = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(folder)!r}]\n{CODE}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def test_a_law_of_another_package_has_its_rows_by_an_entry_point(tmp_path):
    said = ran(tmp_path, "leaky PI")
    names, design = said.stdout.splitlines()
    assert names.startswith("as configured|integral sliding mode + feedforward|leaky PI|open loop|"), said.stderr
    assert design == "{'type': 'leaky_pi', 'leaky_pi.Kp': 2.0}"


def test_two_laws_with_one_row_are_named(tmp_path):
    said = ran(tmp_path, "feedforward")
    assert "TypeError: hysteresis_ros.compared: leaky_pi and open_loop both have a row 'feedforward'" in said.stderr


def test_a_law_that_still_holds_its_rows_is_told_where_they_stand():
    rows = {"mine": lambda given: {}}
    with pytest.warns(
        RuntimeWarning, match=r'controller mine: compared = .* the group "hysteresis_ros.compared"'
    ) as seen:
        law = ControllerLaw(name="mine", block=OpenLoop, description="mine", compared=rows)
    assert law.name == "mine" and seen[0].filename == __file__
