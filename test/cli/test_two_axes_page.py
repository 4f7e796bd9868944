# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The page on two axes is correct: its file has two axes, its commands exist, and those without ROS run."""

from __future__ import annotations

import pathlib
import re
import shlex

import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import config_path, load_configuration
from hysteresis_ros.recordings import load_run

PAGE = pathlib.Path(__file__).resolve().parents[2] / "docs" / "two_axes.md"
BLOCKS = re.findall(r"^```\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
COMMANDS = [
    shlex.split(line, comments=True)[1:]
    for block in BLOCKS
    for line in block.splitlines()
    if line.startswith("hysteresis ")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder with the page's file."""
    made = tmp_path_factory.mktemp("page")
    (added,) = re.findall(r"<<'END'\n(.*?)^END$", BLOCKS[0], re.MULTILINE | re.DOTALL)
    (made / "two.yaml").write_text(config_path("kim2009").read_text(encoding="utf-8") + added, encoding="utf-8")
    return made


def test_the_file_has_two_axes_that_differ(folder):
    configuration = load_configuration(folder / "two.yaml")
    assert configuration.namespaces() == ("/left", "/right")
    assert [configuration.node("reference_generator", space)["initial_setpoint"] for space in ("left", "right")] == [
        2e-6,
        0,
    ]
    assert [configuration.node("plant_simulator", space)["sensor.noise"] for space in ("left", "right")] == [0, 2e-9]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_of_the_page_is_one(words):
    name, *rest = words
    command = main.get_command(None, name)
    assert command is not None and command.make_context(name, rest).params


def test_the_commands_without_ros_run_as_they_stand(folder, monkeypatch):
    monkeypatch.chdir(folder)
    offline = [words for words in COMMANDS if words[0] == "simulate" or words[:2] == ["report", "right.npz"]]
    assert len(offline) == 3
    for words in offline:
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 0, result.output
    assert load_run("left.npz")["setpoint"][0] == 2e-6 and len(load_run("right.npz")) == 1500
    refused = CliRunner().invoke(main, ["simulate", "two.yaml", "-o", "a.npz"])
    assert refused.exit_code == 2 and "several axes (/left, /right); choose one with --namespace" in refused.output


def test_references_are_for_the_axes_that_are_asked_for(folder, monkeypatch):
    monkeypatch.chdir(folder)
    words = (
        "simulate two.yaml --namespace right -o sine.npz --reference sine --frequency 20Hz --amplitude 2um --offset 4um"
    )
    result = CliRunner().invoke(main, [*words.split(), "--cycles", "1"])
    assert result.exit_code == 0, result.output
    assert load_run("sine.npz")["reference"].max() == pytest.approx(6e-6, rel=1e-4)
