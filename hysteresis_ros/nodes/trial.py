# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Measure the speed of nodes that exchange messages on this machine; imports no ROS itself."""

from __future__ import annotations

import contextlib
import os
import pathlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph
from hysteresis_ros.recordings.bag_reader import read_bag
from hysteresis_ros.recordings.files import load_run


@dataclass(frozen=True)
class Answers:
    """Response times of the nodes of an axis in real time."""

    rate: float  #: Sample rate [Hz].
    samples: int  #: samples, late: Number of samples, and number of samples with a late voltage.
    late: int
    #: p50, p99, max: Median, 99th percentile and maximum of the time from a measurement to its voltage [s], as received
    #: by the recorder; None if no voltage arrived during the run.
    p50: float | None
    p99: float | None
    max: float | None


@dataclass(frozen=True)
class Trial:
    """Runs of an axis as separate nodes in an isolated ROS domain, recorded to measure their speed."""

    axis: AxisParameters  #: Parameters of the axis.
    samples: int  #: Length of a run.
    composed: bool  #: Whether all nodes share one process.

    def message_rate(self) -> float:
        """Return the sample rate of the nodes in lockstep [Hz]."""
        with self._recorded("lockstep") as bag:
            return float(load_run(bag).metadata["timing"]["rate_hz"])

    def answers(self) -> Answers:
        """Run the nodes in real time and return their response times."""
        with self._recorded("realtime") as path:
            bag = read_bag(path)
            late = int(load_run(path).metadata["late_commands"])
        measured, voltage = (
            next(topic for name, topic in bag.topics.items() if name.endswith(ending)).received()
            for ending in ("/joint_states", "/voltage")
        )
        # a voltage answers the last measurement that was received before it
        asked = np.searchsorted(measured, voltage, side="right") - 1
        took = 1e-9 * (voltage - measured[np.maximum(asked, 0)])[asked >= 0]
        within = np.quantile(took, [0.5, 0.99, 1.0]).tolist() if took.size else (None,) * 3
        return Answers(self.axis.plant_simulator.sample_rate, measured.size, late, *within)

    @contextlib.contextmanager
    def _recorded(self, time_mode: str) -> Iterator[pathlib.Path]:
        """Run the axis and yield its bag, which is removed afterwards."""
        # also in a namespace of its own, because another graph may enter the domain while this one runs
        plant = replace(self.axis.plant_simulator, samples=self.samples, late_limit=-1)
        axis = replace(self.axis, namespace=f"/doctor_{os.getpid()}", plant_simulator=plant).with_time_mode(time_mode)
        with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder, Domain() as domain:
            options: dict[str, Any] = {"composed": self.composed, "record": pathlib.Path(folder) / "bag"}
            with Graph([axis], **options, environment=domain.environment) as graph:
                graph.wait()
            yield graph.bags[0]
