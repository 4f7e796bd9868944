# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Jobs shared by several processes, here or on a cluster: one way for all that computes the same thing many times.

Results come as they end, each with the number of its job, so that nothing depends on who did what when.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any, NamedTuple

from hysteresis_ros.errors import HysteresisError

#: Jobs that wait at each process, so that none is idle while a result is looked at.
AHEAD = 2
#: How often the executor is looked at while nothing comes [s].
LOOK = 1.0


class Job(NamedTuple):
    """A function of a module, and what it is called with; all of it can be pickled.

    Parameters
    ----------
    function : callable
    arguments : tuple
    """

    function: Callable
    arguments: tuple

    def outcome(self) -> tuple[Any, str]:
        """Return its result, and what was wrong with its input in words, which every process can hand on."""
        try:
            return self.function(*self.arguments), ""
        except HysteresisError as error:
            return None, str(error)


class Executor(ABC):
    """Who does jobs.

    Parameters
    ----------
    workers : int
        Jobs that are done at the same time.
    """

    def __init__(self, workers: int):
        self.workers = workers

    @abstractmethod
    def submit(self, job: Job) -> Future:
        """Begin a job, and return what becomes of it: its outcome.

        Parameters
        ----------
        job : Job
        """

    @abstractmethod
    def result(self, future: Future) -> tuple[Any, str]:
        """Return the outcome of a job that has ended.

        Parameters
        ----------
        future : Future

        Raises
        ------
        HysteresisError
            Who did it has ended by itself.
        """

    def require_alive(self) -> None:  # noqa: B027
        """Refuse to wait for nobody; who is no process of others is always there.

        Raises
        ------
        HysteresisError
            Nobody is left to do the jobs.
        """

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[int, Any]]:
        """Yield number and result of each job as it ends.

        Parameters
        ----------
        jobs : iterable of Job
            Taken one after the other, not more than are done soon.

        Raises
        ------
        HysteresisError
            A job did, in the same words; or a process ended by itself.
        """
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
    """Nobody but this process."""

    def __init__(self):
        super().__init__(1)

    def submit(self, job: Job) -> Future:
        """Do a job at once.

        Parameters
        ----------
        job : Job
        """
        future: Future = Future()
        future.set_result(job.outcome())
        return future

    def result(self, future: Future) -> tuple[Any, str]:
        """Return the outcome of a job.

        Parameters
        ----------
        future : Future
        """
        return future.result()

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[int, Any]]:
        """Yield number and result of each job, one after the other.

        Parameters
        ----------
        jobs : iterable of Job

        Raises
        ------
        HysteresisError
            A job did.
        """
        for number, job in enumerate(jobs):
            yield number, job.function(*job.arguments)
