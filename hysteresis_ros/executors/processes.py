# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Processes of this machine, which end with the one that started them."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import types
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.executors.jobs import Executor, Job

#: How many threads multiply matrices: processes with several each would be in each other's way.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class Processes(Executor):
    """A pool of processes.

    Parameters
    ----------
    workers : int
        How many.
    """

    def __init__(self, workers: int):
        super().__init__(workers)
        context = multiprocessing.get_context("spawn")  # a copy of a process with threads may hang
        self.pool = ProcessPoolExecutor(workers, context, initializer=_begin)

    def submit(self, job: Job) -> Future:
        """Begin a job, and return what becomes of it.

        Parameters
        ----------
        job : Job

        Raises
        ------
        HysteresisError
            A process has ended by itself.
        """
        try:
            return self.pool.submit(job.outcome)
        except BrokenProcessPool:
            raise _ended() from None

    def result(self, future: Future) -> tuple[Any, str]:
        """Return the outcome of a job that has ended.

        Parameters
        ----------
        future : Future

        Raises
        ------
        HysteresisError
            A process has ended by itself.
        """
        try:
            return future.result()
        except BrokenProcessPool:
            raise _ended() from None


@contextlib.contextmanager
def processes(workers: int) -> Iterator[Processes]:
    """Have processes as long as the block runs; what they still do at its end is broken off.

    Parameters
    ----------
    workers : int
        How many.
    """
    before = set(multiprocessing.active_children())
    found = Processes(workers)
    try:
        with _alone():
            for _ in range(workers):
                found.pool.submit(os.getpid)  # each of them starts one
        yield found
    finally:
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
            process.join()
        # what waits for them has nothing to wait for now; it holds semaphores, which somebody would miss
        found.pool.shutdown(wait=True, cancel_futures=True)


def _ended() -> HysteresisError:
    return HysteresisError("a process that shares the work has ended by itself; give --workers 1, or free some memory")


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Let processes that are started meanwhile not hear an interrupt, and compute with one thread each.

    They do not run the script of somebody who uses this package either, which need not be written for that.
    """
    main = sys.modules["__main__"]
    mine = threading.current_thread() is threading.main_thread()  # only that one may
    # an interrupt is for the one that started them
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if mine else None
    given = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        if mine:
            signal.signal(signal.SIGINT, before)
        for name, value in given.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _begin() -> None:
    """Let a process end with the one that started it, however that ends, and leave interrupts to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    starter = multiprocessing.parent_process()
    if starter is not None:
        threading.Thread(target=_follow, args=(starter.sentinel,), daemon=True).start()


def _follow(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
