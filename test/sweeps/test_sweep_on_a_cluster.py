# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The same sweep on a real cluster, one of whose processes is killed meanwhile: the same bits as on one core."""

from __future__ import annotations

import json
import os
import pathlib
import signal
import subprocess
import sys

import pytest
from sweep_support import asked, same_bits
from waiting import until

from hysteresis_ros.executors import cluster
from hysteresis_ros.laboratory.sweeps.sweep import sweep

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

ROOT = pathlib.Path(__file__).resolve().parents[2]
#: A scheduler, and two workers of one process each, without a dashboard.
SCHEDULER = ("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
WORKER = ("worker", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")


def start(folder, *words):
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, "-m", "dask", *words, "--scheduler-file", str(folder / "scheduler.json")]
    log = open(folder / f"{words[0]}.log", "ab")  # noqa: SIM115
    return subprocess.Popen(command, stdout=log, stderr=log, env=environment, cwd=folder)


@pytest.fixture
def workers(tmp_path):
    """Yield the address of a scheduler and its two workers."""
    running = [start(tmp_path, *SCHEDULER)]
    try:
        file = tmp_path / "scheduler.json"
        until(lambda: file.exists() and file.read_text().endswith("}"))
        running += [start(tmp_path, *WORKER, "--local-directory", str(tmp_path / f"w{i}")) for i in range(2)]
        yield json.loads(file.read_text())["address"], running[1:]
    finally:
        for process in running:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_finds_what_one_core_does(workers, tmp_path, monkeypatch):
    address, processes = workers
    monkeypatch.setattr("hysteresis_ros.laboratory.sweeps.sweep.JOB_RUNS", 10)
    with cluster(address) as found:
        until(lambda: len(found.client.nthreads()) == 2)
    progress = []

    def kill_one(done):
        progress.append(done)
        if done > 100 and processes[0].poll() is None:
            processes[0].send_signal(signal.SIGKILL)
            processes[0].wait()

    shared = sweep(*asked(runs=400), tmp_path / "f.npz", scheduler=address, progress=kill_one)
    assert processes[0].returncode == -signal.SIGKILL and progress[-1] == 400 and len(progress) > 20
    assert same_bits(shared, sweep(*asked(runs=400), workers=1))
