# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Run nodes until they finish, fail or are stopped; exit codes and signals are the same for all of them."""

from __future__ import annotations

import ctypes
import gc
import pathlib
import signal
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.signals import SignalHandlerOptions

from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.nodes.domain import require_admission, stay_on_this_machine
from hysteresis_ros.nodes.launcher import leave_with_ros2
from hysteresis_ros.nodes.masters import await_discovery, claim

#: ``madvise``: these pages are not needed for now.
_MADV_DONTNEED = 4


def release_compiler() -> None:
    """Give the code pages of LLVM back once all kernels are loaded; should it be used again, they come back.

    Only pages that are mapped from the file for execution, which nobody writes: Linux reads them again on demand.
    """
    maps = pathlib.Path("/proc/self/maps")
    if not COMPILED or not maps.exists():
        return
    madvise = ctypes.CDLL(None).madvise
    madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for line in maps.read_text().splitlines():
        span, rights, *_, path = line.split(maxsplit=5)
        if "libllvmlite" in path and rights == "r-xp":
            start, end = (int(address, 16) for address in span.split("-"))
            madvise(start, end - start, _MADV_DONTNEED)


#: Seconds between two looks at signals and at nodes that have finished, when nothing happens otherwise.
LOOK = 0.05

#: Seconds that messages get to be acknowledged: at the regular end of a run, and when a signal or an error ends it. An
#: acknowledgement waits for a heartbeat, seconds after the message has come: more would only make every exit slow.
PATIENCE_AT_END = 5.0
PATIENCE_AT_EXIT = 0.3

#: Module whose functions the compiler calls back.
COMPILER = "llvmlite.binding.executionengine"

#: Seconds without a message after which nothing is under way any more.
QUIET = 0.1


def make_executor():
    """Return rclpy's EventsExecutor (a tenth of the default executor's cost), or the default one if it is missing."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def called_by_compiler(frame) -> bool:
    """Tell whether Python runs on behalf of the compiler, which swallows exceptions and fails on them in its own words."""
    while frame is not None and frame.f_globals.get("__name__") != COMPILER:
        frame = frame.f_back
    return frame is not None


def run(factories, arguments=None) -> int:
    """Make nodes, start them, and spin until the end."""
    stop: list[int] = []

    starting = True

    def request_stop(number, frame):
        if number != signal.SIGALRM:
            stop.append(number)
        if starting and stop:
            if called_by_compiler(frame):
                signal.setitimer(signal.ITIMER_REAL, LOOK)
            else:
                raise SystemExit(0)  # compiling the kernels may take long

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, request_stop)
    leave_with_ros2()
    nodes: list = []
    claims: list = []
    executor = None
    try:
        try:
            stay_on_this_machine()
            set_logger_level("rcl", LoggingSeverity.FATAL)  # what it says about wrong arguments is raised as well
            rclpy.init(
                args=arguments if arguments is not None else sys.argv, signal_handler_options=SignalHandlerOptions.NO
            )
            domain = rclpy.get_default_context().get_domain_id()
            require_admission(domain)
            nodes += [factory() for factory in factories]
            claims += [claim(domain, node.get_fully_qualified_name()) for node in nodes if node.kind != "recorder"]
        except Exception as error:  # rclpy raises its own and plain C++ errors for names and files that it refuses
            # without the places in rcl's C sources
            print(f"error: {' '.join(str(error).split(', at /')[0].split())}", file=sys.stderr)
            return 2
        executor = make_executor()
        for node in nodes:
            executor.add_node(node)
        # all are configured before the first one moves
        for step in ("configure_now", "activate_now"):
            if step == "activate_now":
                await_discovery(nodes)
            for node in nodes:
                if node.autostart and not getattr(node, step)():
                    return node.exit_code or 2
        starting = False
        release_compiler()
        return _spin(executor, nodes, stop)
    except SystemExit:
        return 0
    finally:
        starting = False
        for node in nodes:
            node.release()  # also after an exception: no thread may go on publishing
        _destroy(executor, nodes)
        for claimed in filter(None, claims):
            claimed.close()
        node = executor = None
        _collect()
        if rclpy.ok():
            rclpy.shutdown()


def _destroy(executor, nodes: list) -> None:
    """Let go of all that the nodes hold in DDS, and of the nodes."""
    for node in nodes:
        if executor is not None:
            executor.remove_node(node)
        node.destroy_node()
    if executor is not None:
        executor.shutdown()
    nodes.clear()


def _collect() -> None:
    """Free the nodes now: lifecycle nodes stand in reference cycles, and hold the DDS participant until collected.

    A participant that is still there when the process ends is taken down by the C library beside the threads that use
    it, which now and then ended in an abort long after the run was over and its bag was closed.
    """
    gc.unfreeze()
    gc.collect()


def _over(nodes) -> bool:
    """Tell whether a node has failed, or all have finished; asked some seven times a sample, so without generators."""
    finished = True
    for node in nodes:
        # a node that could not be configured by hand waits for better parameters
        if node.failure and node.parameters is not None:
            return True
        finished = finished and node.finished
    return finished


def _spin(executor, nodes, stop) -> int:
    # The loop makes no reference cycles; a collection in the middle of a sample would cost milliseconds.
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        while not stop:
            executor.spin_once(timeout_sec=LOOK)
            if _over(nodes):
                break
    finally:
        regular = not stop and all(node.finished and not node.failure for node in nodes)
        _leave(executor, nodes, regular)
    if stop:
        return max((node.exit_code for node in nodes if node.has_lost), default=0)
    return max((node.exit_code for node in nodes if node.failure), default=0)


def _leave(executor, nodes, regular: bool) -> None:
    """Bring outputs to their safe values and wait until they have arrived, then let go of threads and files."""
    deadline = time.monotonic() + PATIENCE_AT_END
    for node in nodes:
        node.leaving = True
        if node.active:
            node.runner.part()
    if regular:
        for node in nodes:
            node.wait_acknowledged(deadline)
    # The controller before the compensator, the compensator before the plant: it still sees the voltage return.
    listening = []
    for node in reversed(nodes):
        if not node.active:
            continue
        # A lockstep run that ended regularly has exactly one voltage a sample, and its plant is gone.
        if not (regular and node.runner.exact):
            node.runner.go_safe()
            if not node.is_fused:  # a loop's recorder takes the log where it is made
                node.changes.end(node.sample, stopped=True)
        if node.listens_at_exit and not regular:
            listening.append(node)
        else:
            node.active = False
    if not regular:
        deadline = time.monotonic() + PATIENCE_AT_EXIT
        for node in nodes:
            node.wait_acknowledged(deadline)
    start = time.monotonic()
    while listening:
        executor.spin_once(timeout_sec=0.01)
        elapsed = time.monotonic() - start
        if elapsed > QUIET:
            listening = [node for node in listening if elapsed < node.listens_for and not node.drained()]
    for node in reversed(nodes):  # a recorder is the first: it gets what is made until the end
        node.active = False
        node.release()
        node.tell_health()
