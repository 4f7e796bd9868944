# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Compile the kernels of most tests in advance; otherwise each worker and the first nodes compile them themselves.

``make test`` runs this script first; without it the tests only take longer. Two processes compile, as two workers test.
"""

from __future__ import annotations

import contextlib
import importlib.util
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph


def axis_of(name: str):
    """Return a short run of a configuration that is part of the package."""
    return single_axis(load_configuration(name).override("", exit_at_end=True)).with_duration(0.02)


def stage() -> None:
    """Compile the loop of two coupled axes."""
    FusedLoop(Stage(StageParameters.from_configuration(load_configuration("xy_scanner"))))


def offline_and_fused(name: str) -> None:
    """Compile the loop of an axis offline and against the clock."""
    simulate(axis_of(name), describe=False)
    FusedLoop(Axis(axis_of(name).with_time_mode("fused")))


def nodes() -> None:
    """Compile what nodes call: kernels one by one, in other versions."""
    if not importlib.util.find_spec("rclpy"):
        return
    with contextlib.ExitStack() as stack:
        domain = stack.enter_context(Domain())
        graph = Graph([axis_of("kim2009").with_time_mode("lockstep")], composed=True, environment=domain.environment)
        stack.enter_context(graph).wait()


if __name__ == "__main__":
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        jobs = [pool.submit(stage), pool.submit(offline_and_fused, "kim2009")]
        jobs += [pool.submit(offline_and_fused, "inchworm_travel"), pool.submit(nodes)]
        for job in jobs:
            job.result()
