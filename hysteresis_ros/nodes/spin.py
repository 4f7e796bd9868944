# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Run nodes until they finish, fail or are stopped, with the same exit codes and signals for all nodes."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import pathlib
import signal
import sys
import time
import warnings

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.signals import SignalHandlerOptions

from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.errors import ConfigurationError, HysteresisError, ParameterError
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.nodes.domain import require_admission, stay_on_this_machine
from hysteresis_ros.nodes.launcher import leave_with_ros2, node_environment, session
from hysteresis_ros.nodes.masters import await_discovery, claim

#: ``madvise``: these pages are not needed for now.
_MADV_DONTNEED = 4


def release_compiler() -> None:
    """Release the code pages of LLVM after all kernels are loaded; Linux reads them again on demand.

    Only executable pages that are mapped from the file are released; such pages are never written.
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


def given_configuration(arguments: list[str], what: str) -> Configuration:
    """Return the configuration in the file after ``--params-file``; ``what`` needs it to create its nodes."""
    if "--params-file" not in arguments[:-1]:
        raise ConfigurationError(f"the {what} has no parameters: give its file with --ros-args --params-file FILE")
    return load_configuration(arguments[arguments.index("--params-file") + 1])


def refused(error: HysteresisError) -> int:
    """Print each problem of a refused configuration; return the exit code."""
    for problem in error.problems if isinstance(error, ParameterError) else (error,):
        print(f"error: {problem}", file=sys.stderr)
    return 2


#: While no message arrives, interval of the check for signals and finished nodes [s].
LOOK = 0.05

#: Longest wait for acknowledgements at the regular end of a run, and at an end by a signal or an error [s]. An
#: acknowledgement waits for a heartbeat, which may come seconds after the message; a longer time would delay exits.
PATIENCE_AT_END = 5.0
PATIENCE_AT_EXIT = 0.3

#: Largest number of scheduled callbacks that an executor still runs after nodes were released.
MOST_SCHEDULED = 100

#: Module whose functions the compiler calls back.
COMPILER = "llvmlite.binding.executionengine"

#: Time without a message after which no message is pending [s].
QUIET = 0.1


def make_executor():
    """Return rclpy's EventsExecutor (a tenth of the default executor's processor time), or else the default one."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def called_by_compiler(frame) -> bool:
    """Return whether a callback of the compiler runs; it would swallow an exception, and compilation would fail."""
    while frame is not None and frame.f_globals.get("__name__") != COMPILER:
        frame = frame.f_back
    return frame is not None


def run(factories, arguments=None, steered: bool = False) -> int:
    """Create nodes, start them, and spin until the end.

    ``steered``: whether users send setpoints to these nodes; if so, and ``ros2`` has started them, a session for the
    users' commands is kept.
    """
    stop: list[int] = []

    starting = True

    def request_stop(number, frame):
        if number != signal.SIGALRM:
            stop.append(number)
        if starting and stop:
            if called_by_compiler(frame):
                signal.setitimer(signal.ITIMER_REAL, LOOK)
            else:
                raise SystemExit(0)  # do not wait for the end of a compilation, which may take long

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, request_stop)
    kept = contextlib.ExitStack()
    if leave_with_ros2() and steered:
        # before rclpy, because a process with other threads must not be forked
        kept.enter_context(session(node_environment()))
    nodes: list = []
    claims: list = []
    executor = None
    try:
        try:
            stay_on_this_machine()
            set_logger_level("rcl", LoggingSeverity.FATAL)  # wrong arguments also raise exceptions
            # a command that no longer waits for its answer has reported that itself
            warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)
            rclpy.init(
                args=arguments if arguments is not None else sys.argv, signal_handler_options=SignalHandlerOptions.NO
            )
            domain = rclpy.get_default_context().get_domain_id()
            require_admission(domain)
            nodes += [factory() for factory in factories]
            claims += [claim(domain, node.get_fully_qualified_name()) for node in nodes if node.kind != "recorder"]
        except Exception as error:  # for refused names and files, rclpy raises errors of its own and of C++
            # without the line numbers in rcl's C sources
            print(f"error: {' '.join(str(error).split(', at /')[0].split())}", file=sys.stderr)
            return 2
        executor = make_executor()
        for node in nodes:
            executor.add_node(node)
        code = _start(nodes)
        if code:
            return code
        starting = False
        release_compiler()
        return _spin(executor, nodes, stop)
    except SystemExit:
        return 0
    finally:
        starting = False
        _release(executor, nodes, claims)
        node = executor = None
        _collect()
        if rclpy.ok():
            rclpy.shutdown()
        kept.close()


def _start(nodes: list) -> int:
    """Configure all nodes, then activate them; return the exit code of a node that refuses, 0 if all are active."""
    for step in ("configure_now", "activate_now"):
        if step == "activate_now":
            await_discovery(nodes)
        for node in nodes:
            if node.autostart and not getattr(node, step)():
                return node.exit_code or 2
    return 0


def _release(executor, nodes: list, claims: list) -> None:
    """Release the nodes, their DDS entities and their names."""
    for node in nodes:
        node.release()  # also after an exception, because no thread may continue to publish
    if executor is not None:
        # while a callback is scheduled, the executor keeps its node, and the node keeps its participant
        for _ in range(MOST_SCHEDULED):
            executor.spin_once(timeout_sec=0.0)
    for node in nodes:
        if executor is not None:
            executor.remove_node(node)
        node.destroy_node()
    if executor is not None:
        executor.shutdown()
    nodes.clear()
    for claimed in filter(None, claims):
        claimed.close()


def _collect() -> None:
    """Free the nodes now: lifecycle nodes are in reference cycles, and keep the DDS participant until collected.

    Otherwise the C library destroys the participant at the end of the process while threads still use it, which has
    sometimes caused an abort long after the run was over and its bag was closed.
    """
    gc.unfreeze()
    gc.collect()


def _over(nodes) -> bool:
    """Return whether a node has failed or all have finished; fast, because it is called seven times per sample."""
    finished = True
    for node in nodes:
        # a node that was configured with wrong parameters waits for other parameters
        if node.failure and node.parameters is not None:
            return True
        finished = finished and node.finished
    return finished


def _spin(executor, nodes, stop) -> int:
    # The loop creates no reference cycles, and a garbage collection within a sample would take milliseconds.
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
    """Move outputs to their safe values, wait until they are received, then release threads and files."""
    deadline = time.monotonic() + PATIENCE_AT_END
    for node in nodes:
        node.leaving = True
        if node.active:
            node.runner.leave()
    if regular:
        for node in nodes:
            node.wait_acknowledged(deadline)
    # The controller exits before the compensator, and the compensator before the plant, so the plant still receives the
    # safe voltage.
    listening = []
    for node in reversed(nodes):
        if not node.active:
            continue
        # A lockstep run that ended regularly has exactly one voltage for each sample, and the plant has already left.
        if not (regular and node.runner.exact):
            node.runner.go_safe()
            if not node.is_fused:  # the recorder of a fused loop reads the change log directly
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
    for node in reversed(nodes):  # a recorder is the first node, so it receives everything until the end
        node.active = False
        node.release()
        node.tell_health()
