# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""How commands refuse impossible requests, and how they exit on a signal."""

from __future__ import annotations

import os
import pathlib
import signal
import subprocess
import sys
import tempfile

import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError, RecordingError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.nodes.launcher import Graph

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", ["report.pdf", "report"])
def test_a_report_that_is_no_page_is_refused_by_name(tmp_path, name):
    pytest.importorskip("matplotlib")
    result = CliRunner().invoke(main, ["reproduce", "kim2009", "-o", str(tmp_path / name)])
    assert result.exit_code == 2 and name in result.output and ".html" in result.output
    from hysteresis_ros.analysis.page import write_page

    with pytest.raises(RecordingError, match=r"\.html"):
        write_page(tmp_path / name, "")


def test_a_recording_that_cannot_be_created_is_refused_before_anything_starts(tmp_path):
    (tmp_path / "file").write_text("")
    axis = single_axis(load_configuration("kim2009"))
    with pytest.raises(ConfigurationError, match="cannot be created.*another folder"):
        Graph([axis], record=tmp_path / "file" / "bag")
    Graph([axis], record=tmp_path / "new" / "bag")
    assert not (tmp_path / "new" / "bag").exists()


WAITING = """
import signal, sys, tempfile
import click
from hysteresis_ros.cli import main as commands

@click.command()
def waiting():
    with tempfile.TemporaryDirectory(prefix="hysteresis_", dir=sys.argv[2]):
        print("there", flush=True)
        signal.pause()

commands.LazyGroup.get_command = lambda self, ctx, name: waiting
sys.argv[1:] = ["waiting", sys.argv[1]]
commands.main(args=["waiting"], prog_name="hysteresis")
"""


def test_sigterm_ends_a_command_and_its_temporary_folders_without_words():
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", WAITING, folder]
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=dict(os.environ, PYTHONPATH=paths),
        )
        assert process.stdout.readline() == "there\n"
        assert len(os.listdir(folder)) == 1
        process.terminate()
        output, errors = process.communicate(timeout=60)
        assert (process.returncode, output, errors) == (128 + signal.SIGTERM, "", "")
        assert not os.listdir(folder)
