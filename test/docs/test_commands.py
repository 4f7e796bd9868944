# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Commands and snippets of the documents: all are parsed, those of the guide are run in the order of their page."""

from __future__ import annotations

import pathlib
import re
import shlex
import types

import click
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import COMMANDS, main
from hysteresis_ros.designs import stage_identification
from hysteresis_ros.identification import workflow

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"])
#: Pages that are run as printed.
GUIDE = ("install", "first_axis", "models", "real_time", "coupled_axes", "troubleshooting")
#: What replaces the placeholders of a page.
PLACEHOLDERS = {"CONFIG": "kim2009", "RECORDING": "run.npz", "BAG": "run.npz"}
#: Commands of the guide that need nodes, minutes or hardware, and the test that runs them.
TRIED_ELSEWHERE = {
    **{name: "test/nodes/test_remote.py" for name in ("setpoint", "status", "set", "get", "call", "echo")},
    "up": "test/nodes/test_lockstep.py",
    "doctor": "test/cli/test_doctor_command.py",
    "commission": "test/commissioning/test_coupled_commissioning.py",
}
#: Pages whose Python code is run by other tests, or needs something that is not available here, with the reason.
SNIPPETS = {
    "api": "test/test_api.py",
    "extending": "test/test_extending.py",
    "README": "two recordings of one's own; the same lines are in api.md",
    "identification": "recordings of one's own; the same calls are in api.md",
    "hardware": "a driver of one's own: examples/driver_skeleton.py is run by test/nodes/test_external_plant.py",
    "scale": "test/loop/test_axis_arrays.py",
    "scans": "test/references/test_scans.py",
    "benchmark": "test/benchmark/test_benchmark_command.py",
    "triggers": "test/loop/test_triggers_in_the_loop.py",
    "coupled_identification": "recordings of one's own; test/identification/test_coupled_identification.py",
    "epics": "ophyd and bluesky are not installed",
}


def fenced(path: pathlib.Path, *languages: str) -> list[str]:
    """Return the blocks of these languages on a page, including those within lists."""
    blocks = re.findall(r"^( *)```(\S*)\n(.*?)^ *```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [re.sub(rf"^{indent}", "", text, flags=re.MULTILINE) for indent, kind, text in blocks if kind in languages]


def commands(path: pathlib.Path) -> list[list[str]]:
    """Return the words of every command `hysteresis …` in the blocks of a page, with variables replaced."""
    found, variables = [], {}
    for block in fenced(path, "", "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            given = re.fullmatch(r'([A-Z]+)="(.*)"', line)
            if given:
                variables[f"${given[1]}"] = given[2]
            if line.startswith("hysteresis "):
                for name, value in variables.items():
                    line = line.replace(name, value)
                words = shlex.split(line.partition(" > ")[0], comments=True)[1:]
                found.append([PLACEHOLDERS.get(word, word) for word in words])
    return found


def option_names(command: click.Command) -> set[str]:
    return {name for item in command.params for name in (*item.opts, *item.secondary_opts)} | {"--help"}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_every_command_of_a_page_is_one(path):
    """Names, options and choices exist; the named files need not exist."""
    for words in commands(path):
        with click.Context(main) as context:
            if words[0] in ("--version", "--help"):
                continue
            assert words[0] in COMMANDS, words
            command = main.get_command(context, words[0])
            command.make_context(words[0], list(words[1:]), parent=context)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_every_command_within_a_sentence_is_one(path):
    text = re.sub(r"^ *```.*?^ *```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    with click.Context(main) as context:
        for sentence in re.findall(r"`hysteresis ([^`]*)`", text):
            words = re.split(r"[\s=]+", sentence.replace("\\|", " "))
            if not re.fullmatch(r"[a-z]+", words[0]):
                continue
            assert words[0] in COMMANDS, sentence
            command = main.get_command(context, words[0])
            if isinstance(command, click.Group) and set(words[1:2]) & set(command.commands):
                command = command.commands[words[1]]
            assert {word for word in words if re.match(r"--?[a-z]", word)} <= option_names(command), sentence


def run_commands(page: str) -> int:
    """Run the commands of a page of the guide in process; `up` by its offline twin, which has the same bits."""
    runner, done = CliRunner(), 0
    twins: dict[str, str] = {}
    for words in commands(ROOT / "docs" / f"{page}.md"):
        if words[0] == "up" and "--record" in words:
            name = words[words.index("--record") + 1]
            twins[name] = f"{name}.mcap"
            words = ["simulate", words[1], "--duration", words[words.index("--duration") + 1], "-o", twins[name]]
        elif words[0] in TRIED_ELSEWHERE:
            continue
        result = runner.invoke(main, [twins.get(word, word) for word in words])
        assert result.exit_code == 0, (words, result.output)
        done += 1
    return done


@pytest.mark.parametrize("page", GUIDE)
def test_the_guide_runs(page, tmp_path, monkeypatch):
    """First its commands, then its Python code.

    The loops of an identified stage stay open, and its actuators have no linear dynamics of their own, which take
    seconds to find; test/identification/test_stage_identification.py runs the same commands with both.
    """
    monkeypatch.chdir(tmp_path)
    static = types.SimpleNamespace(identify=lambda data, model, linear: workflow.identify(data, model, linear="none"))
    monkeypatch.setattr(stage_identification, "workflow", static)
    monkeypatch.setattr(stage_identification, "design_identified", lambda text, *given: (text, {}, []))
    done = run_commands(page)
    names: dict = {}
    for snippet in fenced(ROOT / "docs" / f"{page}.md", "python"):
        exec(compile(snippet, f"docs/{page}.md", "exec"), names)
        done += 1
    assert done


def test_what_is_not_run_here_is_run_there():
    for name, path in TRIED_ELSEWHERE.items():
        text = (ROOT / path).read_text(encoding="utf-8")
        assert re.search(rf"\b{name}_?\b", text), f"{path} does not run {name}"
    pages = {path.stem for path in PAGES if fenced(path, "python")}
    assert pages == set(SNIPPETS) | {name for name in GUIDE if fenced(ROOT / "docs" / f"{name}.md", "python")}


@pytest.mark.parametrize("page", sorted(set(SNIPPETS) - {"api", "extending"}))
def test_python_that_cannot_run_here_is_python(page):
    path = ROOT / "README.md" if page == "README" else ROOT / "docs" / f"{page}.md"
    for snippet in fenced(path, "python"):
        compile(snippet, str(path), "exec")


def test_messages_that_troubleshooting_names_exist():
    text = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    said = {part.strip() for quoted in re.findall(r'"([^"\n`]*[a-z][^"\n`]*)"', text) for part in quoted.split("…")}
    said = {part for part in said if " " in part and "hysteresis_ros[" not in part}
    assert len(said) >= 4
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "hysteresis_ros").rglob("*.py"))
    assert {part for part in said if part not in sources} == set()
