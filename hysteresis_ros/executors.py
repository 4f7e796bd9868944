# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Run jobs in parallel: in processes on this machine, or on the workers of a Dask cluster.

Each result arrives with the number of its job as soon as the job ends, so no result depends on the order of execution.
A worker process exits when the process that started it exits. Another worker repeats the jobs of a lost worker; an
error is raised when no worker is left or the scheduler no longer answers.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import itertools
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait as connection_wait
from typing import Any, NamedTuple

from hysteresis_ros.errors import HysteresisError

#: Number of jobs queued for each process, so that no process is idle while a result is handled.
AHEAD = 2
#: Interval between checks of the executor while no result arrives [s].
LOOK = 1.0


class Job(NamedTuple):
    """A function of a module and its arguments, which can all be pickled."""

    function: Callable
    arguments: tuple

    def outcome(self) -> tuple[Any, str]:
        """Return the result and, for wrong input, the message as text, because not every error can be pickled."""
        try:
            return self.function(*self.arguments), ""
        except HysteresisError as error:
            return None, str(error)


class Executor(ABC):
    """Base of the executors of jobs."""

    def __init__(self, workers: int):
        self.workers = workers

    @abstractmethod
    def submit(self, job: Job) -> Future:
        """Start a job and return the future of its outcome."""

    @abstractmethod
    def result(self, future: Future) -> tuple[Any, str]:
        """Return the outcome of a job that has ended."""

    def require_alive(self) -> None:  # noqa: B027
        """Raise an error when no worker is left; overridden by executors that can lose workers."""

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[int, Any]]:
        """Yield number and result of each job as it ends."""
        numbered = enumerate(jobs)
        waiting = {self.submit(job): number for number, job in itertools.islice(numbered, AHEAD * self.workers)}
        while waiting:
            finished, _ = wait(waiting, LOOK, FIRST_COMPLETED)
            if not finished:
                self.require_alive()
            for future in finished:
                number = waiting.pop(future)
                result, error = self.result(future)
                if error:
                    raise HysteresisError(error)
                waiting |= {self.submit(job): after for after, job in itertools.islice(numbered, 1)}
                yield number, result


class InProcess(Executor):
    """Run all jobs in this process."""

    def __init__(self):
        super().__init__(1)

    def submit(self, job: Job) -> Future:
        """Run a job at once."""
        future: Future = Future()
        future.set_result(job.outcome())
        return future

    def result(self, future: Future) -> tuple[Any, str]:
        """Return the outcome of a job."""
        return future.result()

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[int, Any]]:
        """Yield number and result of each job, one after the other."""
        for number, job in enumerate(jobs):
            yield number, job.function(*job.arguments)


#: Environment variables for the threads of linear algebra: one per process, because the processes share the cores.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


#: Modules that are linked with a BLAS, and names of its functions in OpenBLAS builds (NumPy, SciPy, Linux
#: distributions): with or without a prefix, for 32-bit or 64-bit integers.
LINKED = ("numpy.linalg._umath_linalg", "scipy.linalg._fblas")
OPENBLAS = tuple(f"{prefix}openblas_%s_num_threads{suffix}" for prefix in ("scipy_", "") for suffix in ("64_", ""))
_threads_lock = threading.Lock()
_threads_users = 0
_threads_before: list[tuple[Any, int]] = []


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Compute linear algebra in one thread of this process; restore the previous number of threads at the end.

    Small arrays gain nothing from several threads of OpenBLAS, which busy-wait for each other. The number stays
    unchanged if the environment sets a variable of :data:`THREADS`, or with another BLAS.
    """
    global _threads_users
    if any(os.environ.get(name) for name in THREADS):
        yield
        return
    with _threads_lock:
        if _threads_users == 0:
            _threads_before[:] = [(set_number, get_number()) for get_number, set_number in _blas_threads()]
            for set_number, _ in _threads_before:
                set_number(1)
        _threads_users += 1
    try:
        yield
    finally:
        with _threads_lock:
            _threads_users -= 1
            if _threads_users == 0:
                for set_number, number in _threads_before:
                    set_number(number)


def _blas_threads() -> list[tuple[Any, Any]]:
    """Return, for each OpenBLAS of NumPy and SciPy, the functions that get and set its number of threads."""
    found = []
    for name in LINKED:
        with contextlib.suppress(ImportError, OSError):
            library = ctypes.CDLL(importlib.import_module(name).__file__)
            for words in OPENBLAS:
                if hasattr(library, words % "set") and hasattr(library, words % "get"):
                    found.append((getattr(library, words % "get"), getattr(library, words % "set")))
    return found


class Processes(Executor):
    """A pool of processes."""

    def __init__(self, workers: int):
        super().__init__(workers)
        context = multiprocessing.get_context("spawn")  # a forked copy of a process with threads may hang
        self.pool = ProcessPoolExecutor(workers, context, initializer=_begin)

    def submit(self, job: Job) -> Future:
        """Start a job and return its future."""
        try:
            return self.pool.submit(job.outcome)
        except BrokenProcessPool:
            raise _ended() from None

    def result(self, future: Future) -> tuple[Any, str]:
        """Return the outcome of a job that has ended."""
        try:
            return future.result()
        except BrokenProcessPool:
            raise _ended() from None


@contextlib.contextmanager
def processes(workers: int) -> Iterator[Processes]:
    """Provide processes while the block runs; jobs that still run at its end are cancelled."""
    before = set(multiprocessing.active_children())
    found = Processes(workers)
    try:
        with _alone():
            for _ in range(workers):
                found.pool.submit(os.getpid)  # each job starts one process
        yield found
    finally:
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
            process.join()
        # releases the semaphores of the thread that waited for the processes
        found.pool.shutdown(wait=True, cancel_futures=True)


def _ended() -> HysteresisError:
    return HysteresisError("a worker process ended unexpectedly; give --workers 1, or free some memory")


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Start the processes of the block without interrupts, and with one thread for linear algebra each.

    An interrupt of this process is delivered at the end of the block. The processes do not run the user's main script,
    so the script needs no ``if __name__ == "__main__"``.
    """
    main = sys.modules["__main__"]
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # the processes inherit the signal mask
    given = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        for name, value in given.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Make this process exit when its parent process exits, and ignore interrupts, which the parent handles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    starter = multiprocessing.parent_process()
    if starter is not None:
        threading.Thread(target=_follow, args=(starter.sentinel,), daemon=True).start()


def _follow(sentinel: int) -> None:
    connection_wait([sentinel])
    os._exit(1)


#: Time-out for the connection to the scheduler, and for closing it [s].
CONNECT = 10.0
#: Longest time without any worker [s].
PATIENCE = 60.0
#: Number of lost workers after which their common job counts as the cause.
LOSSES = 10
EXTRA = 'needs the extra: pip install "hysteresis_ros[cluster]"'


class Cluster(Executor):
    """The workers of a scheduler."""

    def __init__(self, client, address: str):
        self.client, self.address = client, address
        self._seen = time.monotonic()
        while not self._threads():
            self.require_alive()
            time.sleep(0.1)
        super().__init__(self._threads())
        self.pool = client.get_executor(pure=False, retries=LOSSES)

    def _threads(self) -> int:
        """Return how many jobs the cluster runs at the same time."""
        try:
            return sum(self.client.nthreads().values())
        except (OSError, TimeoutError):
            raise self._gone() from None

    def _gone(self) -> HysteresisError:
        return HysteresisError(
            f"--scheduler {self.address}: the scheduler no longer answers; start it again, and repeat the command"
        )

    def submit(self, job: Job) -> Future:
        """Start a job and return its future."""
        return self.pool.submit(job.outcome)

    def result(self, future: Future) -> tuple[object, str]:
        """Return the outcome of a job that has ended."""
        try:
            return future.result()
        except CancelledError:
            raise self._gone() from None
        except Exception as error:  # the other machine may lack packages or files
            raise HysteresisError(
                f"--scheduler {self.address}: a worker has failed: {type(error).__name__}: {error}; all workers "
                "need this version of the package"
            ) from None

    def require_alive(self) -> None:
        """Raise an error when no worker has been present for ``PATIENCE``."""
        if self.client.status not in ("running", "connecting"):
            raise self._gone()
        if self.client.status == "running" and self._threads():
            self._seen = time.monotonic()
        if time.monotonic() - self._seen > PATIENCE:
            raise HysteresisError(
                f"--scheduler {self.address}: no worker for {PATIENCE:g} s; start workers with `dask worker "
                f"{self.address} --nthreads 1`, and repeat the command"
            )


@contextlib.contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Provide the workers of a scheduler while the block runs."""
    try:
        from distributed import Client
    except ImportError:
        raise HysteresisError(f"--scheduler {EXTRA}") from None

    class Connected(Client):
        """A client that does not wait in close() for a scheduler that has not answered."""

        def __del__(self):
            pass

    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # this module reports the error itself
    try:
        client = Connected(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise HysteresisError(
            f"--scheduler {address}: no scheduler answers there ({type(error).__name__}); start one with `dask "
            "scheduler`, and give its address, as tcp://host:8786"
        ) from None
    try:
        yield Cluster(client, address)
    finally:
        client.close(timeout=CONNECT)


#: Work shorter than this [s] is not shared, because further processes take one or two seconds to start.
WORTH = 10.0


def shared(jobs: Sequence[Job], seconds: float, workers: int | None = None) -> list[Any]:
    """Run jobs and return their results, in the order of the jobs."""
    if workers is None and seconds < WORTH:
        workers = 1
    with executor(workers, jobs=len(jobs)) as found:
        results = dict(found.results(jobs))
    return [results[number] for number in range(len(jobs))]


@contextlib.contextmanager
def executor(
    workers: int | None = None, scheduler: str | None = None, *, jobs: int | None = None
) -> Iterator[Executor]:
    """Provide an executor of jobs while the block runs."""
    if scheduler is not None:
        with cluster(scheduler) as found:
            yield found
        return
    if workers is not None and workers < 1:
        raise HysteresisError(f"workers = {workers}: must be 1 or more; leave it out for the number of processors")
    count = min(workers or os.cpu_count() or 1, jobs if jobs is not None else 2**31)
    if count < 2:
        yield InProcess()
        return
    with processes(count) as found:
        yield found
