# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis emulate``: a device for any program, with the plant of an axis and faults, until it is ended."""

from __future__ import annotations

import re
import socket
import subprocess
import sys

import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.laboratory.emulation.command import _bench_of


def refusal(*words) -> str:
    result = CliRunner().invoke(main, ["emulate", *words])
    lines = result.output.splitlines()
    assert result.exit_code == 2 and len(lines) == 1, result.output
    return lines[0]


def test_its_help_names_the_devices_and_each_one_its_options():
    devices = [declared for declared in DRIVERS.values() if declared.device is not None]
    said = CliRunner().invoke(main, ["emulate", "--help"]).output
    assert devices and all(re.search(rf"^  {declared.name} ", said, re.MULTILINE) for declared in devices)
    for declared in devices:
        said = CliRunner().invoke(main, ["emulate", declared.name, "--help"]).output
        assert all(f"--{row.name.replace('_', '-')} " in said for row in declared.emulated.parameters.table())
        assert "--plant" in said and "--fault" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["gsc"], "gcs"),
        (["gcs", "--model", "E-712"], "'E-712' is not one of"),
        (["gcs", "--port", "70000"], "port = 70000: out of range"),
        (["gcs", "--port", "0", "--fault", "slw:0:1"], "did you mean slow?"),
        (["gcs", "--port", "0", "--plant", "kim209"], "kim2009"),
    ],
)
def test_what_cannot_be_emulated_is_refused(words, said):
    assert said in refusal(*words)


def test_a_port_that_is_taken_is_named():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert f"127.0.0.1:{port}: cannot listen on it" in refusal("gcs", "--port", str(port))


def test_the_plant_is_that_of_an_axis_with_its_samples():
    bench = _bench_of("picma_stage")
    assert bench.cycle == 1.0 / 200.0 and bench.plant.limits.maximum == 3.6


def test_it_runs_takes_faults_from_its_input_and_ends_by_a_signal():
    command = [sys.executable, "-m", "hysteresis_ros.cli.entry", "emulate", "gcs", "--port", "0", "--model", "E-709"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as process:
        assert process.stdin is not None and process.stdout is not None
        port = int(re.search(r"E-709 .* at 127\.0\.0\.1:(\d+)", process.stdout.readline())[1])
        with socket.create_connection(("127.0.0.1", port), 30.0) as link:
            link.sendall(b"*IDN?\n")
            assert b"E-709" in link.recv(200)
            process.stdin.write("cut:0:60\n")
            assert process.stdout.readline() == "from now on: cut:0:60\n"
            assert link.recv(200) == b""
        process.terminate()
        assert process.wait(30.0) == 143
