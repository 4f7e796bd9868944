# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Processes that tests fork from a preloaded one have the same state as after a normal start."""

import importlib.util
import os
import pathlib
import signal
import subprocess
import sys

import preloaded_support
import pytest
from waiting import until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux can give a fork another parent")

MAIN = [sys.executable, "-m", "hysteresis_ros.cli.main"]
NODES = ("axis", "plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator", "recorder")


@pytest.fixture(params=[False, True], ids=["forked", "started"])
def cold(request):
    preloaded_support.start_cold(request.param)
    yield request.param
    preloaded_support.start_cold(False)


@pytest.fixture
def claimed():
    pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
    from hysteresis_ros.nodes.domain import Domain

    with Domain() as domain:
        yield domain.environment


def imports_everything(process: subprocess.Popen) -> bool:
    """Return whether a process was forked, by its command line: it is that of its origin."""
    words = pathlib.Path(f"/proc/{process.pid}/cmdline").read_text().split("\0")
    return pathlib.Path(preloaded_support.__file__).name in pathlib.Path(words[1]).name


@pytest.mark.slow
def test_nothing_but_imports_differs(cold, tmp_path):
    environment = {**os.environ, "ROS_DOMAIN_ID": "17", "PYTHONPATH": str(preloaded_support.tested_folder())}
    options = {"cwd": tmp_path, "env": environment, "start_new_session": True, "stderr": subprocess.PIPE}
    command = [sys.executable, "-m", "hysteresis_ros.cli.entry", "emulate", "gcs", "--port", "0", "--model", "E-709"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **options) as process:
        try:
            assert b"E-709" in process.stdout.readline()
            assert imports_everything(process) != cold
            place = pathlib.Path(f"/proc/{process.pid}")
            assert os.getsid(process.pid) == process.pid and (place / "cwd").resolve() == tmp_path.resolve()
            assert f"PPid:\t{os.getpid()}\n" in (place / "status").read_text()
            process.send_signal(signal.SIGTERM)
            assert process.wait(30.0) == 143 and not process.stderr.read()
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.parametrize("node", NODES)
def test_output_and_exit_code_are_those_of_a_true_start(node, tmp_path):
    if importlib.util.find_spec("rclpy") is None:
        pytest.skip("rclpy is not installed: no nodes")
    command = [sys.executable, "-m", f"hysteresis_ros.nodes.{node}", "--ros-args", "--params-file", "nowhere.yaml"]
    said = []
    for cold in (False, True):
        preloaded_support.start_cold(cold)
        done = subprocess.run(command, capture_output=True, text=True)
        said.append((done.returncode, done.stdout, done.stderr))
    preloaded_support.start_cold(False)
    assert said[0] == said[1] and said[0][0] == 2 and "nowhere.yaml" in said[0][2]


@pytest.mark.slow
def test_what_a_forked_command_starts_is_forked_too_and_nothing_of_it_remains(claimed, tmp_path):
    axis = pathlib.Path(__file__).parents[1] / "config" / "kim2009.yaml"
    command = [*MAIN, "up", str(axis), "--rate", "lockstep", "--duration", "20", "--composed"]
    environment = {**os.environ, **claimed, "PYTHONPATH": str(preloaded_support.tested_folder())}
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, start_new_session=True, stderr=subprocess.PIPE, stdout=subprocess.PIPE
    ) as up:
        children = pathlib.Path(f"/proc/{up.pid}/task/{up.pid}/children")
        # its copy, and a process with the nodes; a true start has the name of a module in its command line
        started = until(lambda: len(found := children.read_text().split()) > 1 and found, what="its processes")
        for child in started:
            words = pathlib.Path(f"/proc/{child}/cmdline").read_text().split("\0")
            assert pathlib.Path(preloaded_support.__file__).name in words[1]
        up.send_signal(signal.SIGINT)
        assert up.wait(60.0) == 0, up.stderr.read()
        until(lambda: not any(pathlib.Path(f"/proc/{child}").exists() for child in started), what="their end")


@pytest.mark.slow
def test_pipes_and_files_are_closed_when_it_ends(cold, tmp_path):
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(2):
        with open(tmp_path / "out", "w") as output:
            subprocess.run([*MAIN, "--help"], stdout=output, stderr=subprocess.STDOUT, check=True)
        assert "Usage" in (tmp_path / "out").read_text()
        subprocess.run([*MAIN, "--help"], input="", capture_output=True, text=True, check=True)
    assert len(os.listdir("/proc/self/fd")) <= before + (0 if cold else 1)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["other variable", "other package in the path", "modules beside it"])
def test_what_could_import_otherwise_is_started_truly(case, tmp_path, monkeypatch):
    home = str(preloaded_support.tested_folder())
    beside, other = tmp_path / "beside", tmp_path / "other"
    beside.mkdir()
    (beside / "yaml.py").write_text("")
    (other / "hysteresis_ros").mkdir(parents=True)
    environment, folder = {**os.environ, "PYTHONPATH": home}, tmp_path
    if case == "other variable":
        environment["NUMBA_DISABLE_JIT"] = "1"
    elif case == "modules beside it":
        folder = beside
    else:
        environment["PYTHONPATH"] = os.pathsep.join([str(other), home])
    forked = []
    fork = preloaded_support._Starter.fork
    monkeypatch.setattr(preloaded_support._Starter, "fork", lambda self, *a: forked.append(a) or fork(self, *a))
    subprocess.run([*MAIN, "--help"], capture_output=True, env=environment, cwd=folder)
    assert not forked
    subprocess.run([*MAIN, "--help"], capture_output=True, env={**os.environ, "PYTHONPATH": home}, cwd=tmp_path)
    assert len(forked) == 1


@pytest.mark.slow
@pytest.mark.parametrize("words", [["--help"], ["--nonsense"]])
def test_exit_code_is_that_of_a_true_start_also_if_the_output_is_closed(words):
    codes = {False: [], True: []}
    for cold, found in codes.items():
        preloaded_support.start_cold(cold)
        reading, writing = os.pipe()
        os.close(reading)
        found.append(subprocess.run([*MAIN, *words], stdout=writing, stderr=subprocess.DEVNULL).returncode)
        os.close(writing)
        found.append(subprocess.run([*MAIN, *words], capture_output=True).returncode)
    preloaded_support.start_cold(False)
    assert codes[False] == codes[True]
