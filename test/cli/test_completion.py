# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Shell completion of the commands, and messages during long commands."""

from __future__ import annotations

import importlib
import inspect
import io
import re
import sys
import time

import numpy as np
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner
from waiting import until

from hysteresis_ros.cli import progress as module
from hysteresis_ros.cli.identify import FitState
from hysteresis_ros.cli.main import COMMANDS, main
from hysteresis_ros.cli.progress import Progress


def offered(*words: str) -> list[str]:
    *before, incomplete = words
    completer = ShellComplete(main, {}, "hysteresis", "_HYSTERESIS_COMPLETE")
    return [item.value for item in completer.get_completions(before, incomplete)]


def test_commands_options_waveforms_and_nodes_are_offered():
    assert set(offered("")) >= set(COMMANDS)
    assert offered("simu") == ["simulate"]
    assert offered("up", "kim2009", "--ref") == ["--reference"]
    assert offered("up", "kim2009", "--reference", "st") == ["staircase", "steps"]
    assert offered("get", "motion") == ["motion_controller"]
    assert "simulate" in offered("simlate", ""), "a mistyped command is completed too"


@pytest.mark.parametrize("command", ["up", "watch", "simulate", "excite", "design", "compare", "validate"])
def test_configurations_are_those_of_the_package_and_files_here(tmp_path, monkeypatch, command):
    (tmp_path / "kimono.yaml").write_text("")
    (tmp_path / "kimono.csv").write_text("")
    (tmp_path / "stands").mkdir()
    (tmp_path / "stands" / "mine.yml").write_text("")
    monkeypatch.chdir(tmp_path)
    assert offered(command, "kim") == ["kim2009", "kimono.yaml"]
    assert offered(command, "stan") == ["stands/"]
    assert offered(command, "stands/") == ["stands/mine.yml"]
    assert offered(command, "nowhere/") == []


class Terminal(io.StringIO):
    """A terminal that stores its output."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def soon(monkeypatch):
    """Every command counts as long at once."""
    monkeypatch.setattr(module, "SHORT", 0.0)
    monkeypatch.setattr(module, "LOOK", 0.01)


def test_a_terminal_shows_a_bar_and_what_is_said_beside_it(monkeypatch, soon):
    pytest.importorskip("rich", reason="rich is not installed: no bars")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", Terminal())
    shown = sys.stderr
    progress = Progress(err=True)
    with progress.during("identifying", lambda: "residual [1]", lambda: 0.25):
        until(lambda: "identifying" in shown.getvalue() and "residual [1]" in shown.getvalue())
        progress.say("half of [it]")
    assert "half of [it]" in shown.getvalue()


def test_nothing_is_shown_while_somebody_is_asked(monkeypatch, soon):
    pytest.importorskip("rich", reason="rich is not installed: no bars")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", Terminal())
    shown, told = sys.stderr, []
    progress = Progress(err=True)
    with progress.during("measuring", lambda: told.append(1) or f"look {len(told)}"):
        until(lambda: "look" in shown.getvalue())
        with progress.paused():
            asked, looked = shown.getvalue(), len(told)
            until(lambda: len(told) > looked + 5)
            assert shown.getvalue() == asked
        until(lambda: shown.getvalue() != asked)


def test_without_a_terminal_lines_say_that_it_goes_on(capsys, soon):
    progress = Progress(err=True, silence=0.01)
    told = []
    with progress.during("exciting", lambda: told.append(1) or "well", lambda: 0.5):
        until(lambda: len(told) > 2)
    assert "  … exciting: 0 s, 50 %, well\n" in capsys.readouterr().err
    with Progress(err=True, silence=0.01, bars_only=True).during("simulating", lambda: told.append(1) or "well"):
        pass
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("steady", [False, True])
def test_without_a_terminal_it_becomes_quiet(capsys, soon, steady):
    told = []
    with Progress(err=True, silence=0.05, steady=steady).during(
        "exciting", lambda: told.append(time.monotonic()) or ""
    ):
        until(lambda: len(told) > 3)
    silences = np.diff(told[:4])  # a busy machine makes these intervals longer, never shorter
    assert np.all(silences > 0.99 * 0.05 * 2.0 ** (np.zeros(3) if steady else np.arange(1, 4)))
    assert len(capsys.readouterr().err.splitlines()) == len(told)


def test_a_fit_of_unknown_length_never_goes_back():
    state = FitState()
    parts = []
    for number in (0, 1, 60, 30, 600):
        state.report(number, "words")
        parts.append(state.part)
    assert parts[0] is None and parts[2] == 0.5 and parts[1:] == sorted(parts[1:]) and parts[-1] < 1.0


#: Commands that are fast, report their progress themselves, or run until they are ended.
QUICK = {"new", "urdf", "policy", "parameters", "models"}
QUICK |= {"setpoint", "move", "quiet", "status", "get", "set", "call", "echo"}
TALKATIVE = {"up", "ioc", "emulate", "watch"}


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in QUICK | TALKATIVE])
def test_what_may_last_shows_that_it_goes_on(name):
    module = importlib.import_module(COMMANDS[name][0].split(":")[0])
    words = set(re.findall(r"\w+", inspect.getsource(module)))
    assert words & {"Progress", "shown", "run_apart"}, "wrap long work in hysteresis_ros.cli.progress.shown"


@pytest.mark.parametrize(
    "words, expected",
    [
        (["design", "kim2009", "--controller", "pid", "-o", "F.yaml"], ["designing"]),
        (["simulate", "kim2009", "--duration", "0.01", "-o", "run.npz"], ["simulating"]),
        (["report", "run.npz"], ["reading", "evaluating 30 samples"]),
        (["verify", "run.npz"], ["reading run.npz", "repeating the run"]),
        (["export", "run.npz", "-o", "run.csv"], ["writing run.csv"]),
    ],
)
def test_bars_are_shown_while_something_is_computed_and_results_go_where_they_belong(
    words, expected, runs, monkeypatch, soon
):
    during, seen = Progress.during, []
    monkeypatch.setattr(Progress, "during", lambda self, what, *rest: seen.append(what) or during(self, what, *rest))
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0 and result.stderr == "" and result.stdout
    assert len(seen) == len(expected)
    assert all(what.startswith(begun) for what, begun in zip(seen, expected, strict=True))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a run in it."""
    folder = tmp_path_factory.mktemp("runs")
    CliRunner().invoke(main, ["simulate", "kim2009", "--duration", "0.01", "-o", str(folder / "run.npz")])
    return folder


@pytest.fixture
def runs(made, monkeypatch):
    """The current folder has a run in it."""
    monkeypatch.chdir(made)
