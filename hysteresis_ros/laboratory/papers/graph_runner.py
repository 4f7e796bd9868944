# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runs axes by their nodes in lockstep, with the same result as a simulation; imports no ROS itself."""

from __future__ import annotations

import os
import pathlib
import tempfile
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from hysteresis_ros.errors import HysteresisError, RecordingError
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, AxisParameters
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph, GraphError, require_ros
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run


class GraphRunner:
    """Runs an axis as composed nodes, with a recorder, in an isolated ROS domain.

    A runner for :func:`hysteresis_ros.laboratory.papers.runs.through`. An axis that was run before is not run again,
    because a run in lockstep repeats bit for bit.
    """

    def __init__(self, on_run: Callable[[int, int, AxisParameters], None] = lambda number, known, axis: None):
        require_ros()
        self.runs = 0
        self._on_run = on_run
        self._known = 0
        self._found: dict[str, Recording] = {}
        self._lock = threading.Lock()

    def prepare(self, axes: Iterable[AxisParameters], jobs: int) -> None:
        """Run axes in advance, several graphs in parallel, because starting processes takes most of a short run."""
        distinct = list({axis.configuration_text(): axis for axis in axes}.values())
        self._known = len(distinct)
        with ThreadPoolExecutor(jobs) as pool:
            waiting = [pool.submit(self, axis) for axis in distinct]
            try:
                for run in waiting:
                    run.result()
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise

    def __call__(self, axis: AxisParameters) -> Recording:
        """Run an axis from rest, for the length in its parameters."""
        text = axis.configuration_text()
        if text not in self._found:
            with self._lock:
                self.runs += 1
                number = self.runs
            self._on_run(number, max(self._known, number), axis)
            try:
                run = self._run(axis, number)
            except HysteresisError as error:
                where = f"run {number} ({describe(axis)})"
                raise GraphError(f"{where}: {error}", getattr(error, "exit_code", 1)) from error
            metadata = {
                "configuration": text,
                "namespace": axis.namespace,
                "source": "nodes in lockstep",
                "joint": axis.plant_simulator.joint,
            }
            self._found[text] = replace(run, metadata=metadata)
        return self._found[text]

    def _run(self, axis: AxisParameters, number: int) -> Recording:
        with Domain() as domain:
            return self._run_in(domain, axis, number)

    def _run_in(self, domain: Domain, axis: AxisParameters, number: int) -> Recording:
        # also in a separate namespace, because another graph may enter the domain
        namespace = f"/reproduce_{os.getpid()}_{number}{axis.namespace}"
        with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
            bag = pathlib.Path(folder) / "bag"
            axes = [_in_lockstep(axis, namespace)]
            with Graph(axes, composed=True, record=bag, environment=domain.environment) as graph:
                graph.wait()
            run = load_run(bag, further=True)
        wanted, missing = axis.plant_simulator.samples, run.metadata["missing_samples"]
        if len(run) != wanted or missing:
            raise RecordingError(f"{len(run)} of {wanted} samples recorded, {missing} missing; run it again")
        return run


def describe(axis: AxisParameters) -> str:
    """Return a description of an axis' run."""
    generator = axis.reference_generator
    parts = (
        f"controller {axis.motion_controller.type}",
        f"inverse {axis.hysteresis_compensator.inverse.type}",
        f"waveform {generator.waveform.type}" if generator else "an inchworm",
        f"{axis.plant_simulator.samples} samples",
    )
    return ", ".join(parts)


def _in_lockstep(axis: AxisParameters, namespace: str) -> AxisParameters:
    """Return the axis with parameters for one run in lockstep, after which its nodes exit."""
    mode = dict(time_mode="lockstep", exit_at_end=True, autostart=True)
    there = {name: getattr(axis, name, None) for name in NODE_PARAMETERS}
    nodes = {name: replace(node, **mode) for name, node in there.items() if node is not None}
    return replace(axis, namespace=namespace, **nodes)
