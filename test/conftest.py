# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What all tests share: how properties are tried, and how the tests are spread over workers (pytest-xdist)."""

from __future__ import annotations

import os

import preloaded_support
import pytest
from hypothesis import settings

# Before NumPy is there, and for every process of a test: workers whose linear algebra has threads wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Properties are not timed: the first example of a test may compile kernels.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

#: Tests that start graphs of nodes: one after the other in one worker, since they need the time they have.
GRAPHS = ("test/nodes/", "test/cli/test_excite_command.py")
#: Tests whose loops run against the clock in the test's own process.
CLOCKS = ("test/loop/", "test/hardware/", "test/commissioning/", "test/cli/")
#: Those in lockstep, or whose axis may miss any deadline, need no time of their own: the other worker may run them.
BESIDE = (
    *("lockstep", "faulty_nodes", "batch_recording", "processors", "graph_runner", "fused_driver", "fused_mishaps"),
    *("adapting_nodes", "live_changes_over_ros", "partners"),
)


def pytest_configure(config):
    """Let processes of this package be forked from one that has imported it, but where a start is the subject."""
    preloaded_support.install()


def pytest_unconfigure(config):
    """End what forks them."""
    preloaded_support.close()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Start the processes of a test truly when it is marked so; its fixtures come after this."""
    preloaded_support.remember_environment()
    preloaded_support.start_cold(item.get_closest_marker("cold") is not None)


def group_of(nodeid: str) -> str:
    """Return with what a test shares its worker: the tests of its file, or all that start graphs in real time."""
    file = nodeid.split("::", 1)[0]
    return "graphs" if nodeid.startswith(GRAPHS) and not file.endswith(tuple(f"test_{n}.py" for n in BESIDE)) else file


def pytest_collection_modifyitems(config, items):
    """Let a worker begin with the graphs, which take longest; without workers the order stays.

    A test over DDS that fails is tried again: on a busy machine two participants now and then do not find each other
    for a minute. So is one against the clock, once. What is wrong with the nodes fails again, and the summary counts
    every repetition.
    """
    for item in items:
        if item.nodeid.startswith((*GRAPHS, *CLOCKS)):
            item.add_marker(pytest.mark.flaky(reruns=2 if item.nodeid.startswith(GRAPHS) else 1))
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: group_of(item.nodeid) != "graphs")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out groups of tests in their order: by itself xdist begins with the groups of most tests, which are fast."""
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group_of(nodeid)

    config.option.loadscopereorder = False
    return Groups(config, log)
