# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Memory of the nodes in excess of an empty rclpy node, its growth in a long run, and modules not to import."""

from __future__ import annotations

import itertools
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace

import common

from hysteresis_ros.configuration import NODE_NAMES, load_configuration
from hysteresis_ros.loop.reach import axes
from hysteresis_ros.models.block import COMPILED

#: Memory of a node in excess of an empty one [MB], with compiled kernels and without.
TARGETS = {"compiled": 90.0, "plain": 30.0}
#: Largest growth between the first tenth of a long run and its end [MB]: one byte per tick in 10⁶ ticks.
GROWTH = 1.0
#: Modules that a running node does not need.
UNWANTED = (
    "scipy.signal",
    "scipy.optimize",
    "matplotlib",
    "jinja2",
    "click",
    "rosbags",
    "mcap",
    "tqdm",
    "hysteresis_ros.analysis",
    "hysteresis_ros.cli",
    "hysteresis_ros.laboratory.comparison",
    "hysteresis_ros.laboratory.papers",
    "hysteresis_ros.identification",
    "hysteresis_ros.recordings",
)
#: Number of samples after which a node has allocated all its memory: the queues of its topics (1000) are full.
WARM = 2500
#: Time-out of a start and of a measurement [s].
PATIENCE = 120.0

_WORKER = str(pathlib.Path(__file__).with_name("memory_worker.py"))
# a separate namespace, so that other axes on this machine do not interfere
_NAMESPACE = f"/benchmark_{os.getpid()}"


class Worker:
    """A process that reports its number of samples and its memory on request."""

    def __init__(self, node: str, parameters=None, compiled: bool = True, cache=None):
        ros = ["--ros-args", "--log-level", "warn", "-r", f"__ns:={_NAMESPACE}"]
        ros += ["--params-file", str(parameters)] if parameters else []
        command = [sys.executable, _WORKER, node, *([] if compiled else ["--without-numba"]), *ros]
        environment = os.environ | ({"XDG_CACHE_HOME": str(cache)} if cache else {})
        self.node = node
        self.process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self):
        return self

    def __exit__(self, *exception) -> None:
        self.process.stdin.close()
        try:
            self.process.wait(15.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()

    def read(self) -> dict:
        """Return the current sample number, the memory [MB] and the loaded modules."""
        try:
            self.process.stdin.write("\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise common.BenchmarkError(f"{self.node} ended early, with exit code {self.process.wait()}")
        return json.loads(line)

    def read_after(self, sample: int, patience: float = PATIENCE) -> dict:
        """Return the same data once ``sample`` has been reached."""
        deadline = time.monotonic() + patience
        while True:
            found = self.read()
            if found["sample"] >= sample:
                return found
            if time.monotonic() > deadline:
                raise common.BenchmarkError(f"{self.node} did not reach sample {sample} in {patience:g} s")
            time.sleep(0.1)


def parameter_file(folder: pathlib.Path) -> pathlib.Path:
    """Write the configuration of an endless lockstep run."""
    configuration = load_configuration(common.CONFIGURATION).override("", time_mode="lockstep", autostart=True)
    path = folder / "axis.yaml"
    path.write_text(replace(axes(configuration)[0], namespace=_NAMESPACE).configuration_text(), encoding="utf-8")
    return path


def bare_megabytes() -> float:
    """Return the memory of an empty node [MB]."""
    with Worker("bare") as worker:
        worker.read_after(0)
        time.sleep(1.0)  # until its discovery has finished
        return worker.read()["megabytes"]


def four_processes(parameters, compiled: bool, cache) -> list[dict]:
    """Return the data of four nodes, one process each, after WARM samples."""
    workers = []
    try:
        for name in NODE_NAMES:
            workers.append(Worker(name, parameters, compiled, cache))
        return [worker.read_after(WARM) for worker in workers]
    finally:
        for worker in workers:
            worker.__exit__()


def growth(parameters, ticks: int) -> tuple[float, list[float]]:
    """Return the growth of the composed process between 10 % and 100 % of ``ticks`` [MB], and all readings [MB].

    The growth is nine times the median of the nine tenths, because a leak appears in every tenth, whereas an allocator
    takes a new block only now and then. The table also shows the first and the last reading.
    """
    found = []
    with Worker("all", parameters) as worker:
        for tenth in range(1, 11):
            now = worker.read_after(max(tenth * ticks // 10, WARM), patience=PATIENCE + ticks / 1000.0)
            found.append(now["megabytes"])
    steps = [later - before for before, later in itertools.pairwise(found)]
    return len(steps) * statistics.median(steps), found


def unwanted(modules) -> list[str]:
    """Return the loaded modules that a node does not need."""
    return [name for name in UNWANTED if any(found == name or found.startswith(f"{name}.") for found in modules)]


def main() -> int:
    """Run the benchmark; returns the exit code."""
    parser = common.parser(__doc__)
    parser.add_argument(
        "--ticks", type=int, default=1_000_000, help="length of the long run; 0: skip it (default 10^6)"
    )
    options = parser.parse_args()
    results = []
    with tempfile.TemporaryDirectory() as folder:
        parameters = parameter_file(pathlib.Path(folder))
        bare = bare_megabytes()
        for kind in ("compiled", "plain") if COMPILED else ("plain",):
            compiled = kind == "compiled"
            cache = pathlib.Path(folder) / "cache"
            first = four_processes(parameters, True, cache) if compiled else None  # compiles, and fills the cache
            found = four_processes(parameters, compiled, cache)
            for index, (name, one) in enumerate(zip(NODE_NAMES, found, strict=True)):
                detail = f"{one['megabytes']:.0f} MB, empty node {bare:.0f} MB"
                if first:
                    detail += f"; at the first start, which compiles the kernels, {first[index]['megabytes']:.0f} MB"
                above = one["megabytes"] - bare
                results.append(
                    common.Result(f"MB above empty, {name}, {kind}", above, "at most", TARGETS[kind], detail)
                )
            loaded = [name for one in found for name in unwanted(one["modules"])]
            detail = ", ".join(sorted(set(loaded)))
            results.append(common.Result(f"useless modules, {kind}", len(loaded), "at most", 0, detail))
        if options.ticks:
            grown, megabytes = growth(parameters, options.ticks)
            detail = f"{megabytes[0]:.1f} MB at 10 %, {megabytes[-1]:.1f} MB at the end"
            results.append(common.Result(f"growth in {options.ticks} ticks [MB]", grown, "at most", GROWTH, detail))
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
