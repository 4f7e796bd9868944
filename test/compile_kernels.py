# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Compile the kernels of most tests in advance; otherwise each worker and the first nodes compile them themselves.

``make test`` runs this script first; without it the tests only take longer.
"""

from __future__ import annotations

import contextlib
import importlib.util

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph

for name in ("kim2009", "inchworm_travel"):
    axis = single_axis(load_configuration(name).override("", exit_at_end=True)).with_duration(0.02)
    simulate(axis, describe=False)
    FusedLoop(Axis(axis.with_time_mode("fused")))
FusedLoop(Stage(StageParameters.from_configuration(load_configuration("xy_scanner"))))
if importlib.util.find_spec("rclpy"):
    # nodes call kernels one by one, and compile other versions of them
    axis = single_axis(load_configuration("kim2009").override("", exit_at_end=True)).with_duration(0.02)
    with contextlib.ExitStack() as stack:
        domain = stack.enter_context(Domain())
        graph = Graph([axis.with_time_mode("lockstep")], composed=True, environment=domain.environment)
        stack.enter_context(graph).wait()
