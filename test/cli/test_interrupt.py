# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Ctrl-C at any point of a command: one line, exit code 130, no traceback. Real processes, stopped at known points."""

from __future__ import annotations

import contextlib
import os
import pathlib
import signal
import subprocess
import sys

import pytest
from waiting import until

from hysteresis_ros.cli import entry

ROOT = pathlib.Path(__file__).resolve().parents[2]

#: Code of the process: it prints a line and waits when it is about to import the module named by the first argument.
WAITING_AT_AN_IMPORT = """
import importlib.abc, signal, sys
from hysteresis_ros.cli.entry import main

class Wait(importlib.abc.MetaPathFinder):
    module = sys.argv.pop(1)

    def find_spec(self, name, path=None, target=None):
        if name == self.module:
            print("there", flush=True)
            signal.pause()

sys.meta_path.insert(0, Wait())
main()
"""

#: The same, but waiting in a finalizer, where Python drops an exception and prints a message instead of raising it.
WAITING_IN_A_FINALIZER = """
import signal, sys, time
import click
from hysteresis_ros.cli import entry, main

class Dropped:
    def __del__(self):
        print("there", flush=True)
        signal.pause()

@click.command()
@click.argument("afterwards")
def waiting(afterwards):
    Dropped()
    if afterwards == "goes on":
        signal.pause()
    raise RuntimeError("what a compiler says of a callback that failed")

main.LazyGroup.get_command = lambda self, ctx, name: waiting
sys.argv.insert(1, "simulate")
entry.main()
"""


def start(*arguments) -> subprocess.Popen:
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=dict(os.environ, PYTHONPATH=paths),
        # a background job of a shell ignores SIGINT, and Python keeps this setting
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def interrupted(process: subprocess.Popen) -> tuple[int, str]:
    """Send Ctrl-C and return the exit code and all output on stderr.

    Python notes a signal that arrives just before a blocking read, but acts on it only when the read ends. Hence it is
    sent repeatedly until the process reacts, as a user would do.
    """
    for _ in range(60):
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            _, errors = process.communicate(timeout=1.0)
            return process.returncode, errors
    raise AssertionError("still running after 60 interrupts")


@pytest.mark.parametrize(
    "module, words",
    [
        ("click", ["--help"]),
        ("yaml", ["simulate", "kim2009", "-o", "{}/a.npz"]),
        ("numpy", ["simulate", "kim2009", "-o", "{}/a.npz"]),
        ("scipy", ["identify", "{}/data.csv", "-o", "{}/a.yaml"]),
        ("hysteresis_ros.analysis.metrics", ["report", "{}/run.csv"]),
        ("hysteresis_ros.laboratory.commands", ["reproduce", "kim2009"]),
        ("hysteresis_ros.laboratory.papers.kim2009.reproduction", ["reproduce", "kim2009"]),
        ("hysteresis_ros.identification.workflow", ["validate", "{}/a.yaml", "{}/data.csv"]),
        ("hysteresis_ros.laboratory.comparison", ["compare", "kim2009"]),
        ("hysteresis_ros.cli.doctor", ["doctor"]),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else value,
)
def test_ctrl_c_during_an_import(tmp_path, module, words):
    (tmp_path / "run.csv").write_text("time [s],reference [m],displacement [m]\n0,0,0\n1,0,0\n")
    process = start("-c", WAITING_AT_AN_IMPORT, module, *[word.format(tmp_path) for word in words])
    assert process.stdout.readline() == "there\n"
    assert interrupted(process) == (130, "hysteresis: interrupted\n")


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "{pipe}", "-o", "{}/a.npz"],
        ["design", "{pipe}", "--controller", "pid", "-o", "{}/a.yaml"],
        ["compare", "{pipe}"],
        ["excite", "{pipe}", "--recipe", "steps", "--record", "{}/bag"],
    ],
    ids=lambda words: words[0],
)
def test_ctrl_c_while_a_command_works(tmp_path, words):
    """The command waits in the read of a pipe that receives no more data; the open pipe shows that it has got there."""
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    process = start("-m", "hysteresis_ros.cli.entry", *[word.format(tmp_path, pipe=pipe) for word in words])
    end = opened_for_writing(pipe, process)
    try:
        code, said = interrupted(process)
    finally:
        os.close(end)
    assert code == 130 and said.splitlines()[-1] == "hysteresis: interrupted" and "Traceback" not in said
    assert list(tmp_path.iterdir()) == [pipe], "no incomplete file is left"


def opened_for_writing(pipe: pathlib.Path, process: subprocess.Popen) -> int:
    """Open a pipe as soon as the process reads it."""

    def opened() -> int | None:
        try:
            return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:  # the process does not read the pipe yet
            assert process.poll() is None, process.stderr.read()
            return None

    return until(opened, what="a reader of the pipe")


@pytest.mark.parametrize("afterwards", ["goes on", "fails"])
def test_ctrl_c_where_python_cannot_raise_is_not_lost(afterwards):
    process = start("-c", WAITING_IN_A_FINALIZER, afterwards)
    assert process.stdout.readline() == "there\n"
    assert interrupted(process) == (130, "hysteresis: interrupted\n")


@pytest.mark.parametrize("asked", [None, "2"])
def test_linear_algebra_has_one_thread_unless_somebody_says_otherwise(asked):
    code = "import os, sys; from hysteresis_ros.cli import entry; print('numpy' in sys.modules)\n"
    code += "sys.argv[1:] = ['--help']\ntry: entry.main()\nexcept SystemExit: print(os.environ['OPENBLAS_NUM_THREADS'])"
    environment = {name: value for name, value in os.environ.items() if name not in entry.ONE_THREAD}
    environment |= {} if asked is None else {"OPENBLAS_NUM_THREADS": asked}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    first, *_, last = done.stdout.splitlines()
    assert (first, last) == ("False", asked or "1")
