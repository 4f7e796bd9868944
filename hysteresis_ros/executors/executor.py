# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Who does jobs: this process, several of this machine, or the workers of a cluster."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from typing import Any

from hysteresis_ros.executors.cluster import cluster
from hysteresis_ros.executors.jobs import Executor, InProcess, Job
from hysteresis_ros.executors.processes import processes

#: Work that takes less than this in one process is not shared: others take a second or two to start [s].
WORTH = 10.0


def shared(jobs: Sequence[Job], seconds: float, workers: int | None = None) -> list[Any]:
    """Return the results of jobs, in their order.

    Parameters
    ----------
    jobs : sequence of Job
    seconds : float
        About what they take together in one process.
    workers : int, optional
        Processes; by default as many as there are processors where that is worth their start.

    Raises
    ------
    HysteresisError
        A job did, or a process ended by itself.
    """
    if workers is None and seconds < WORTH:
        workers = 1
    with executor(workers, jobs=len(jobs)) as found:
        results = dict(found.results(jobs))
    return [results[number] for number in range(len(jobs))]


@contextlib.contextmanager
def executor(
    workers: int | None = None, scheduler: str | None = None, *, jobs: int | None = None
) -> Iterator[Executor]:
    """Have somebody who does jobs, as long as the block runs.

    Parameters
    ----------
    workers : int, optional
        Processes of this machine; by default as many as it has processors. 1: none but this one.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do the jobs instead.
    jobs : int, optional
        How many there are: no more processes than that.

    Raises
    ------
    HysteresisError
        The scheduler does not answer, or what talks to it is not installed.
    """
    if scheduler is not None:
        with cluster(scheduler) as found:
            yield found
        return
    count = min(workers or os.cpu_count() or 1, jobs if jobs is not None else 2**31)
    if count < 2:
        yield InProcess()
        return
    with processes(count) as found:
        yield found
