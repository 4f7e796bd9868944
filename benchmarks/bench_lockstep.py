# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Lockstep loop of the four nodes, compared with a relay of the same graph; composed and as four processes."""

from __future__ import annotations

import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
from dataclasses import replace

import common

from hysteresis_ros.configuration import NODE_NAMES, load_configuration
from hysteresis_ros.loop.reach import axes
from hysteresis_ros.nodes.domain import entered

TARGET = 0.7
#: Processes of a graph, and samples per turn (30 to 50 ms).
GRAPHS = {"composed": (("all",), 200), "four processes": (NODE_NAMES, 80)}
#: Number of first turns that are not evaluated, because they include discovery and first calls.
WARM_UP = 3
#: Time-out of a run [s].
PATIENCE = 240.0

_WORKER = str(pathlib.Path(__file__).with_name("graphs.py"))
# a separate namespace, so that other axes on this machine do not interfere
_NAMESPACE = f"/benchmark_{os.getpid()}"


def parameter_file(folder: pathlib.Path, samples: int) -> pathlib.Path:
    """Write the configuration of a lockstep run of ``samples`` samples."""
    configuration = load_configuration(common.CONFIGURATION)
    configuration = configuration.override("", time_mode="lockstep", exit_at_end=True, autostart=True)
    axis = axes(configuration)[0]
    plant = replace(axis.plant_simulator, samples=samples)
    axis = replace(axis, namespace=f"{_NAMESPACE}/nodes", plant_simulator=plant)
    path = folder / f"{samples}.yaml"
    path.write_text(axis.configuration_text(), encoding="utf-8")
    return path


def turns(names, parameters: pathlib.Path, count: int, samples: int) -> list[tuple[float, float]]:
    """Run both graphs in turns, with a process for each name; return the times of nodes and relay [s] per turn."""
    further = [str(parameters), _NAMESPACE, str(count), str(samples)]
    with entered():  # an isolated domain, so that the nodes do not find other axes of this machine
        return _in_turns([[sys.executable, _WORKER, name, *further] for name in names], names)


def _in_turns(commands, names) -> list[tuple[float, float]]:
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for command in commands]
    try:
        outputs = [process.communicate(timeout=PATIENCE)[0] for process in processes]
    except subprocess.TimeoutExpired:
        raise common.BenchmarkError(f"the graphs did not end within {PATIENCE:g} s") from None
    finally:
        for process in processes:
            if process.poll() is None:
                process.kill()
                process.wait()
    codes = [process.returncode for process in processes]
    if any(codes):
        raise common.BenchmarkError(f"the processes {', '.join(names)} ended with exit codes {codes}")
    seconds = json.loads("".join(outputs))
    return list(zip(seconds["nodes"], seconds["relay"], strict=True))[WARM_UP:]


def main() -> int:
    """Run the benchmark; returns the exit code."""
    options = common.parser(__doc__, repeats=100).parse_args()
    count = options.repeats + WARM_UP
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for name, (processes, samples) in GRAPHS.items():
            parameters = parameter_file(pathlib.Path(folder), count * samples)
            pairs = turns(processes, parameters, count, samples)
            ratios = sorted(relay / nodes for nodes, relay in pairs)
            ours, bare = (samples / statistics.median(side) for side in zip(*pairs, strict=True))
            quartiles = f"{ratios[len(ratios) // 4]:.2f} ... {ratios[3 * len(ratios) // 4]:.2f}"
            detail = f"nodes {ours:.0f} Hz, relay {bare:.0f} Hz, half of the ratios are within {quartiles}"
            median = statistics.median(ratios)
            results.append(common.Result(f"lockstep loop, {name}", median, "at least", TARGET, detail))
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
