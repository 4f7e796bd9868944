# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""The bench of the nodes: a stage of a commissioning is a graph of its own, recorded; imports no ROS itself."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
from typing import Any

from hysteresis_ros.commissioning.bench import Bench
from hysteresis_ros.loop.axis_parameters import (
    AxisParameters,
    in_time,
    require_carried,
)
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph, require_ros
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run


class GraphBench(Bench):
    """Runs axes through their nodes in real time, fused where messages are too slow.

    Parameters
    ----------
    external : bool
        A node of the user's own, which runs already in the user's ROS domain, stands in the plant's place.

    Raises
    ------
    HysteresisError
        rclpy is not installed.
    """

    def __init__(self, external: bool):
        require_ros()
        self._external = external

    @property
    def name(self) -> str:
        """What it is, for the file of the state."""
        return "external plant" if self._external else "nodes"

    def run(self, axis: AxisParameters) -> Recording:
        """Run an axis once; its nodes bring the outputs to safe when they leave, also when it is interrupted.

        Parameters
        ----------
        axis : AxisParameters

        Raises
        ------
        GraphError
            A node died or refused to start, such as one whose device is not there.
        RecordingError
            Nothing was recorded.
        ConfigurationError
            Its samples come faster than messages can carry them.
        """
        require_carried(axis)
        with contextlib.ExitStack() as stack:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hysteresis_"))
            options: dict[str, Any] = {"composed": True, "record": pathlib.Path(folder) / "bag"}
            if not self._external:
                # nobody steers this graph: a running axis of the user must not hear its commands
                options["environment"] = stack.enter_context(Domain()).environment
            with Graph([in_time(axis)], **options) as graph:
                graph.wait()
            return load_run(graph.bags[0], further=True)
