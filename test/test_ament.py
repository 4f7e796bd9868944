# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The linters of ament, if they are installed: `colcon test` runs them, as for any package of ROS 2."""

from __future__ import annotations

import pathlib
import shutil
import xml.etree.ElementTree as ET

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
FOLDERS = ("hysteresis_ros", "launch", "test", "examples", "benchmarks", "docs")
#: Docstrings are numpydoc, except that magic methods have Python's meaning, and a property says "Whether".
DOCUMENTED = ("--convention", "numpy", "--add-ignore", "D105", "D401")


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch):
    monkeypatch.chdir(ROOT)


def linter(name: str):
    return pytest.importorskip(f"ament_{name}.main", reason=f"ament_{name} is not installed")


@pytest.mark.copyright
@pytest.mark.linter
def test_ament_copyright():
    assert linter("copyright").main(argv=[*FOLDERS, "LICENSE", "CONTRIBUTING.md"]) == 0


@pytest.mark.flake8
@pytest.mark.linter
def test_ament_flake8():
    """With a configuration: quotes, width and order of imports are those of this project, which ruff checks."""
    given = ["--config", "test/ament_flake8.ini", *FOLDERS, "setup.py"]
    code, errors = linter("flake8").main_with_errors(argv=given)
    assert code == 0, "\n".join(errors)


@pytest.mark.pep257
@pytest.mark.linter
def test_ament_pep257():
    assert linter("pep257").main(argv=[*DOCUMENTED, "--", "hysteresis_ros", "launch"]) == 0


@pytest.mark.xmllint
@pytest.mark.linter
def test_ament_xmllint():
    if shutil.which("xmllint") is None:
        pytest.skip("xmllint is not installed")
    assert linter("xmllint").main(argv=["package.xml"]) == 0


def test_the_manifest_says_who_where_and_what_tests_need():
    package = ET.parse(ROOT / "package.xml").getroot()
    assert package.find("author").get("email") == package.find("maintainer").get("email")
    assert {url.get("type") for url in package.findall("url")} == {"website", "repository", "bugtracker"}
    needed = {element.text for element in package.findall("test_depend")}
    assert {f"ament_{name}" for name in ("copyright", "flake8", "pep257", "xmllint")} <= needed
    order = [element.tag for element in package]
    assert order.index("license") < order.index("url") < order.index("author") < order.index("exec_depend")
