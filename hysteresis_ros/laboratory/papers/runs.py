# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runs of the experiments: the runner of the axes, triangles for identification, and numerical results of the runs."""

from __future__ import annotations

import contextlib
import contextvars
import os
import pathlib
import tempfile
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.analysis.metrics import axis_settings, judged_reference
from hysteresis_ros.analysis.parts import find_holds, step_responses
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import HysteresisError, RecordingError
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, AxisParameters
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.hysteresis.polynomial import PolynomialParameters
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph, GraphError, require_ros
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run
from hysteresis_ros.recordings.loops import loop_opening

SAMPLE_TIME = 1e-3  # of the simulated recordings [s]; the models are rate independent


def triangles(peaks, samples: int = 250) -> np.ndarray:
    """Return triangles from 0 to each of ``peaks`` and back, with ``samples`` per branch (250 at 1 kHz: 2 Hz)."""
    rise = np.arange(1, samples + 1) / samples
    return np.concatenate([[0.0], *(peak * np.concatenate([rise, 1.0 - rise]) for peak in peaks)])


#: Runs an axis from rest, for the duration in its parameters, and returns a recording.
Runner = Callable[[AxisParameters], Recording]

_runner: contextvars.ContextVar[Runner] = contextvars.ContextVar("runner", default=simulate)


@contextlib.contextmanager
def through(runner: Runner):
    """Use ``runner`` for every axis of the experiments while the context lasts."""
    token = _runner.set(runner)
    try:
        yield
    finally:
        _runner.reset(token)


class Noting:
    """A runner that simulates, and collects the axes in :attr:`axes`."""

    def __init__(self):
        self.axes: list[AxisParameters] = []

    def __call__(self, axis: AxisParameters) -> Recording:
        """Simulate an axis."""
        self.axes.append(axis)
        return simulate(axis)


def run(configuration: Configuration, duration: float) -> Recording:
    """Return the run of the only axis of ``configuration``, ``duration`` seconds from rest."""
    return _runner.get()(single_axis(configuration).with_duration(duration))


@dataclass(frozen=True)
class StepFigures:
    """Figures of a run with steps between 0 and one level; each figure is the worst of all steps."""

    #: 2 % settling time [s], around the final value; the hold time if a step does not settle.
    settling: float
    peak: float  #: Largest displacement [m].
    residual: float  #: Largest magnitude of the final displacement at zero reference after a step [m].
    level_error: float  #: Largest magnitude of the final error at the upper level [m].
    late_vibration: float  #: Largest deviation from the final value in the second half of the hold time [m].


def step_figures(run: Recording) -> StepFigures:
    """Evaluate a run of steps by its true displacement minus the preload's offset."""
    displacement = run["displacement"] - axis_settings(run).offset
    reference = judged_reference(run)
    responses = step_responses(run.time, reference, displacement)
    holds = find_holds(reference)[1:]
    back = [abs(answer.final) for answer in responses if answer.size < 0.0]
    up = [abs(answer.steady_state_error) for answer in responses if answer.size > 0.0]
    if not back or not up:
        raise RecordingError("the reference of the run does not step up and back to zero, so it cannot be evaluated")
    times, vibrations = [], []
    for hold, answer in zip(holds, responses, strict=True):
        length = (hold.stop - hold.start) * run.sample_time
        times.append(length if answer.settling_time is None else answer.settling_time)
        late = displacement[(hold.start + hold.stop) // 2 : hold.stop]
        vibrations.append(float(np.max(np.abs(late - answer.final))))
    return StepFigures(max(times), float(np.max(displacement)), max(back), max(up), max(vibrations))


def loop_width(run: Recording) -> float:
    """Return the largest width of the displacement-reference loop, in % of the reference's stroke.

    The reference of sample k first acts on the displacement of sample k + 1, so these two are compared. If there is a
    preview, the delayed reference is compared with the displacement of the same sample.
    """
    late = 0 if axis_settings(run).preview else 1
    reference, displacement = judged_reference(run)[: len(run) - late], run["displacement"][late:]
    opening = loop_opening(reference, displacement)
    if opening is None:
        raise RecordingError("the reference of the run does not reverse: it has no loop")
    return 100.0 * opening / float(np.ptp(reference))


def picard_width(stack: PolynomialParameters, v_max: float, stroke: float, steps: int, rate_times_gain: float) -> float:
    """Return the width of one loop [% of the stroke] after Picard steps (eq. 16), without memory.

    Units: ``v_max`` [V], ``stroke`` [m].
    """
    wanted = np.linspace(0.0, stroke, 1001)
    reached = []
    for branch in ("rising", "falling"):
        coefficients = [np.polyval(getattr(stack, f"{branch}_{name}")[::-1], v_max) for name in ("C2", "C1", "D")]
        voltage = wanted * (v_max / stroke)
        for _ in range(steps):
            output = np.polyval(coefficients, voltage)
            voltage = voltage + (wanted - rate_times_gain * output) * (v_max / stroke)
        reached.append(np.polyval(coefficients, voltage))
    return 100.0 * float(np.max(np.abs(reached[0] - reached[1]))) / stroke


def worst(values: list[float]) -> float:
    """Return the value of largest magnitude."""
    return max(values, key=abs)


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
        """Run an axis from rest, for the duration in its parameters."""
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
        # a separate namespace, too, because another graph may enter the domain
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
