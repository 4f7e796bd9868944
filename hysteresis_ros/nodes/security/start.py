# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Write the policy of a graph, in a process of its own and a ROS domain that nobody uses; imports no ROS itself."""

from __future__ import annotations

import json
import sys

from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import node_environment, require_ros, started


def write_policy(request: dict) -> int:
    """Write a policy file and return the exit code.

    Parameters
    ----------
    request : dict
        ``config``, ``output``, ``namespace`` (or None), ``rate`` (or None), ``processes`` (or None: as `up` decides),
        ``record`` and ``external`` (truths), ``remap`` (list).

    Raises
    ------
    HysteresisError
        rclpy is not installed, or all ROS domains are in use.
    """
    require_ros()
    with Domain() as domain:
        # the pip wheels of ROS restart the interpreter on import
        command = [sys.executable, "-m", "hysteresis_ros.nodes.security", json.dumps(request)]
        return started(command, node_environment() | domain.environment).wait()
