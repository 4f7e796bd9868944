# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Benches that run an axis, or coupled axes, for a stage: offline, or through nodes; imports no ROS itself."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from hysteresis_ros.cli.commissioning.situation import CommissioningError
from hysteresis_ros.loop.parameters import MESSAGE_RATE, AxisParameters, in_time, require_carried
from hysteresis_ros.loop.plant import BEYOND_TRAVEL, DEVICE_FAILED, HALTED, PARTNER_LOST, WITHOUT_VOLTAGE
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph, require_ros
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run

#: Causes of a trip of the axis, and remedies.
TRIPPED = {
    WITHOUT_VOLTAGE: "too many voltages came late: this machine does not achieve the sample rate; lower sample_rate "
    f"(messages between nodes are reliable up to {MESSAGE_RATE:g} Hz), leave a core free, permit a real-time priority "
    "(hysteresis doctor), or use a driver in C (docs/hardware.md)",
    BEYOND_TRAVEL: "a measurement is outside the range of the actuator: check scaling, sign and cable of the sensor",
    HALTED: "a stop was requested; start again when the axis may move",
    DEVICE_FAILED: "the device failed, see the line above; repair it and begin again",
    PARTNER_LOST: "a node of the axis was lost, see the line above; begin again",
}
#: Largest fraction of the samples that may lack a measurement.
MOST_MISSING = 0.05
#: Signals that every stage of the commissioning needs.
JUDGED = ("reference", "voltage", "measured")
#: Further signals that only a run in closed loop has.
FURTHER = ("command", "applied", "seen", "skipped")
#: Relative difference up to which sample intervals count as equal.
IRREGULAR = 0.01


class Bench(ABC):
    """Runs an axis, or coupled axes, for each stage of a commissioning; each run begins and ends in the safe state."""

    @abstractmethod
    def run(self, axis: AxisParameters | StageParameters) -> Recording:
        """Run an axis once, for the duration in its parameters."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the bench in the file that stores the state of a commissioning."""


class OfflineBench(Bench):
    """Runs the simulated plant of the file as fast as possible, without ROS."""

    name = "offline"

    def run(self, axis: AxisParameters | StageParameters) -> Recording:
        """Simulate."""
        if isinstance(axis, StageParameters):
            return simulate_stage(axis, duration=run_samples(axis) / axis.sample_rate)
        return simulate(axis)


def run_samples(axis: AxisParameters | StageParameters) -> int:
    """Return the number of samples of a run."""
    return (axis.axes[0] if isinstance(axis, StageParameters) else axis).plant_simulator.samples


def require_sound(recording: Recording, samples: int) -> Recording:
    """Return the recording with all samples at regular times; interpolate a few missing samples, refuse many."""
    if recording.axes:
        sound = {}
        for name in recording.axes:
            try:
                sound[name] = require_sound(recording.axis(name), samples)
            except CommissioningError as error:
                raise CommissioningError(f"axis {name}: {error}") from None
        return Recording.of_axes(sound, recording.metadata)
    if recording.has("tripped"):
        codes = recording["tripped"]
        stopped = np.flatnonzero(codes > 0.0)  # codes below 0 mean that the sensor is being homed
        if stopped.size:
            first = stopped[0]
            why = TRIPPED.get(int(codes[first]), f"code {codes[first]:g}")
            raise CommissioningError(f"the axis tripped after {recording.time[first]:.3g} s: {why}")
    there = np.isfinite(recording["measured"]) & np.isfinite(recording["voltage"])
    missing = 1.0 - np.count_nonzero(there) / samples
    if missing > MOST_MISSING:
        raise CommissioningError(
            f"{100.0 * missing:.1f} % of {samples} samples have no measurement or no voltage: check the sensor "
            "and its cable, whether the run was cut off, and whether this machine achieves the "
            "sample rate (hysteresis doctor)"
        )
    distances = np.diff(recording.time)
    regular = np.ptp(distances) < IRREGULAR * distances.mean()
    return recording if missing <= 0.0 and regular else _complete(recording, samples)


def _complete(recording: Recording, samples: int) -> Recording:
    """Return the recording at regular times; interpolate missing samples linearly."""
    begin, period = recording.time[0], float(np.median(np.diff(recording.time)))
    time = begin + period * np.arange(min(samples, 1 + round((recording.time[-1] - begin) / period)))
    signals = {}
    for name in (*JUDGED, *(further for further in FURTHER if recording.has(further))):
        known = np.isfinite(recording[name])
        signals[name] = np.interp(time, recording.time[known], recording[name][known])
    return Recording(time, signals, {}, recording.metadata)


def held_back(recording: Recording, effect: str = "increases the error during motion") -> list[str]:
    """Return a line if voltages were late, otherwise nothing; in a stage, a voltage is late for all axes."""
    if recording.axes:
        recording = recording.axis(recording.axes[0])
    count = int(np.nanmax(recording["late"])) if recording.has("late") else 0
    if recording.has("skipped"):  # a recording with interpolated samples has no "late"
        count = max(count, int(np.count_nonzero(recording["skipped"] > 0.5)))
    if not count:
        return []
    return [
        f"this machine was too busy for {count} of {len(recording)} samples: the previous voltage "
        f"was held in these samples, which {effect}"
    ]


class GraphBench(Bench):
    """Runs the nodes of an axis in real time; the axis is fused if messages are too slow."""

    def __init__(self, external: bool):
        require_ros()
        self._external = external

    @property
    def name(self) -> str:
        """Name of the bench in the file that stores the state of a commissioning."""
        return "external plant" if self._external else "nodes"

    def run(self, axis: AxisParameters | StageParameters) -> Recording:
        """Run an axis once; its nodes bring the outputs to the safe state when they exit, also after an interrupt."""
        stage: StageParameters | None = None
        if isinstance(axis, StageParameters):
            stage = axis.in_time()
            axes = list(stage.axes)
        else:
            axes = [in_time(axis)]
        for one in axes:
            require_carried(one)
        with contextlib.ExitStack() as stack:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hysteresis_"))
            options: dict[str, Any] = {"composed": True, "record": pathlib.Path(folder) / "bag"}
            if not self._external:
                # isolated, because the user's running axis must not receive the commands of this graph
                options["environment"] = stack.enter_context(Domain()).environment
            with Graph(axes, stage=stage, **options) as graph:
                graph.wait()
            return load_run(graph.bags[0], further=True)
