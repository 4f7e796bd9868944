# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common settings of all tests: how properties are tested, and how tests are distributed to workers (pytest-xdist)."""

from __future__ import annotations

import gc
import os
import pathlib

import preloaded_support
import pytest
from hypothesis import settings

# Before NumPy is imported, for all processes: workers whose linear algebra uses several threads block each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Properties are not timed: the first example of a test may compile kernels.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

ROOT = pathlib.Path(__file__).parents[1]
#: Tests that start graphs of nodes.
GRAPHS = ("test/nodes/", "test/cli/test_excite_command.py")
#: Tests that run loops in real time in the test's own process.
CLOCKS = ("test/loop/", "test/hardware/", "test/commissioning/", "test/cli/")
#: Graphs whose clock needs processor time: one after the other in one worker. The others are in lockstep, slow, or may
#: miss any deadline, and run in the other workers.
CLOCKED = (
    *("realtime", "fused_axis", "external_plant", "demo", "inchworm_nodes", "scan_clock", "late_voltages", "driver"),
    *("output_that_left", "order_in_real_time", "gcs_axis", "quiet_hold", "watch_page", "excite_command"),
    *("trigger_topics", "epics", "playing_back", "diagnostics", "masters", "campaign", "claim", "parent"),
)
#: Tests of one compiled loop of a device, in one worker: otherwise each worker compiles it.
DEVICES = ("c_stage", "compiled_driver", "calibrated_driver", "fused_python_driver", "driven_stage")


def pytest_configure(config):
    """Fork processes of this package from one that has imported it, except where the start itself is tested.

    Processes that a test starts in another folder import the tested package, too: an installed copy beside it would
    compile all kernels again.
    """
    tested, given = str(preloaded_support.tested_folder()), os.environ.get("PYTHONPATH", "")
    if "site-packages" not in tested and given.split(os.pathsep)[0] != tested:
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [tested, given]))
    preloaded_support.install()


def pytest_unconfigure(config):
    """End the process from which the others are forked."""
    preloaded_support.close()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Start the processes of a test without forking if it is marked so; its fixtures come later."""
    preloaded_support.remember_environment()
    preloaded_support.start_cold(item.get_closest_marker("cold") is not None)


def group_of(nodeid: str) -> str:
    """Return the group of a test, whose tests share a worker: its file, clocked graphs, or loops of devices."""
    file = nodeid.split("::", 1)[0]
    if file.startswith(GRAPHS) and file.endswith(tuple(f"test_{n}.py" for n in CLOCKED)):
        return "clocked"
    return "devices" if file in [f"test/hardware/test_{name}.py" for name in DEVICES] else file


def turns(groups: list[str]) -> list[str]:
    """Return the groups in the order in which workers take them: graphs, which wait, in turns with computations."""
    waiting = [group for group in groups if group.startswith(GRAPHS)]
    waiting.sort(key=lambda file: -(ROOT / file).stat().st_size)  # the last one to end should not be a long one
    computing = [group for group in groups if group not in waiting]
    # loops of devices are compiled before the clocked graphs reach them
    first = [group for group in ("clocked", "devices") if group in groups]
    computing = [group for group in computing if group not in first]
    each, ordered = max(len(computing) // max(len(waiting), 1), 1), first
    while waiting or computing:
        ordered += [*waiting[:1], *computing[:each]]
        del waiting[:1], computing[:each]
    return ordered


def pytest_collection_modifyitems(config, items):
    """Let a worker begin with the clocked graphs, which take longest; without workers the order is unchanged.

    A failed test over DDS is repeated, because on a busy machine two participants sometimes do not find each other for
    a minute. A failed test in real time is repeated once. A real fault fails again, and the summary counts every
    repetition.
    """
    for item in items:
        if item.nodeid.startswith((*GRAPHS, *CLOCKS)):
            item.add_marker(pytest.mark.flaky(reruns=2 if item.nodeid.startswith(GRAPHS) else 1))
    if hasattr(config, "workerinput"):
        groups = turns(list(dict.fromkeys(group_of(item.nodeid) for item in items)))
        items.sort(key=lambda item: groups.index(group_of(item.nodeid)))


def pytest_collection_finish():
    """Exclude all objects of pytest's collection from garbage collection, and run the collector as rarely as a command.

    A collection of half a million objects takes 0.2 s, and each graph of nodes begins with one.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, *gc.get_threshold()[1:])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Assign groups of tests in their order; by default xdist begins with the largest groups, which are fast."""
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group_of(nodeid)

    config.option.loadscopereorder = False
    return Groups(config, log)
