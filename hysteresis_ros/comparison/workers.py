# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Work shared by several processes, which talk over pipes and end with the one that started them."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from hysteresis_ros.errors import HysteresisError

#: How many threads multiply matrices: processes with several each would be in each other's way.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class Job(NamedTuple):
    """A function of a module, and what it is called with; all of it can be pickled.

    Parameters
    ----------
    function : callable
    arguments : tuple
    """

    function: Callable
    arguments: tuple

    def done(self) -> tuple[str, Any]:
        """Return the name of the function and its result."""
        return self.function.__name__, self.function(*self.arguments)


def done(jobs: list[Job], workers: int) -> Iterator[tuple[str, Any]]:
    """Yield name of the function and result of each job as it ends.

    Parameters
    ----------
    jobs : list of Job
    workers : int
        Processes; 1: none but this one.

    Raises
    ------
    HysteresisError
        A job did, in the same words; or a process ended by itself.
    """
    if workers < 2 or len(jobs) < 2:
        yield from (job.done() for job in jobs)
        return
    waiting, busy, processes = list(reversed(jobs)), [], []
    context = multiprocessing.get_context("spawn")
    try:
        with _alone():
            for _ in range(min(workers, len(jobs))):
                ours, theirs = context.Pipe()
                processes.append(context.Process(target=_work, args=(theirs,), daemon=True))
                processes[-1].start()
                theirs.close()
                ours.send(waiting.pop())
                busy.append(ours)
        while busy:
            for connection in wait(busy):
                yield _received(connection)
                if waiting:
                    connection.send(waiting.pop())
                else:
                    busy.remove(connection)
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Let processes that are started meanwhile not hear an interrupt, and compute with one thread each."""
    if threading.current_thread() is not threading.main_thread():  # only that one may
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the one that started them
    given = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        for name, value in given.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _received(connection: Connection) -> tuple[str, Any]:
    try:
        result, error = connection.recv()
    except (EOFError, ConnectionResetError):
        raise HysteresisError(
            "a process that shares the work has ended by itself; give --workers 1, or free some memory"
        ) from None
    if error:
        raise HysteresisError(error)
    return result


def _work(connection: Connection) -> None:
    """Do jobs until nobody sends one."""
    with contextlib.suppress(EOFError):
        while True:
            job = connection.recv()
            try:
                answer = job.done(), ""
            except HysteresisError as error:
                answer = None, str(error)
            connection.send(answer)
