# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Run a module as a process of its own, in a ROS domain that nobody uses; imports no ROS itself."""

from __future__ import annotations

import json
import sys

from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import node_environment, require_ros, started


def run_apart(module: str, request: dict) -> int:
    """Run a module where nobody hears its nodes, and return its exit code.

    Parameters
    ----------
    module : str
        One that takes its only argument as JSON.
    request : dict
        What it is asked for.

    Raises
    ------
    HysteresisError
        rclpy is not installed, or all ROS domains are in use.
    """
    require_ros()
    with Domain() as domain:
        # the pip wheels of ROS restart the interpreter on import
        command = [sys.executable, "-m", module, json.dumps(request)]
        return started(command, node_environment() | domain.environment).wait()
