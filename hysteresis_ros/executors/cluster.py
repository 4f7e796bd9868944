# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The workers of a Dask cluster: processes of any machines that have this package.

A worker that is lost has its jobs done by another one. Where none is left, or the scheduler is gone, that is said.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.executors.jobs import Executor, Job

#: How long a scheduler may take to answer [s], and to have a worker again.
CONNECT, PATIENCE = 10.0, 60.0
#: Workers that may be lost under one job before it is taken for what ends them.
LOSSES = 10
EXTRA = 'needs the extra: pip install "hysteresis_ros[cluster]"'


class Cluster(Executor):
    """The workers of a scheduler.

    Parameters
    ----------
    client : distributed.Client
        Connected.
    address : str
        Of the scheduler, for messages.
    """

    def __init__(self, client, address: str):
        self.client, self.address = client, address
        self._seen = time.monotonic()
        while not self._threads():
            self.require_alive()
            time.sleep(0.1)
        super().__init__(self._threads())
        self.pool = client.get_executor(pure=False, retries=LOSSES)

    def _threads(self) -> int:
        """Return how many jobs the cluster does at the same time."""
        try:
            return sum(self.client.nthreads().values())
        except (OSError, TimeoutError):
            raise self._gone() from None

    def _gone(self) -> HysteresisError:
        return HysteresisError(f"--scheduler {self.address}: the scheduler is gone; start it again, and repeat")

    def submit(self, job: Job) -> Future:
        """Begin a job, and return what becomes of it.

        Parameters
        ----------
        job : Job
        """
        return self.pool.submit(job.outcome)

    def result(self, future: Future) -> tuple[object, str]:
        """Return the outcome of a job that has ended.

        Parameters
        ----------
        future : Future

        Raises
        ------
        HysteresisError
            Its workers have ended by themselves, or cannot do it.
        """
        try:
            return future.result()
        except CancelledError:
            raise self._gone() from None
        except Exception as error:  # whatever the other machine lacks
            raise HysteresisError(
                f"--scheduler {self.address}: a worker could not do its work: {type(error).__name__}: {error}; all of "
                "them need this version of the package"
            ) from None

    def require_alive(self) -> None:
        """Refuse to wait for nobody.

        Raises
        ------
        HysteresisError
            The scheduler is gone, or has had no worker for :data:`PATIENCE` seconds.
        """
        if self.client.status not in ("running", "connecting"):
            raise self._gone()
        if self.client.status == "running" and self._threads():
            self._seen = time.monotonic()
        if time.monotonic() - self._seen > PATIENCE:
            raise HysteresisError(
                f"--scheduler {self.address}: no worker for {PATIENCE:g} s; start some with `dask worker "
                f"{self.address} --nthreads 1`, and repeat"
            )


@contextlib.contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Have the workers of a scheduler, as long as the block runs.

    Parameters
    ----------
    address : str
        ``tcp://host:8786``.

    Raises
    ------
    HysteresisError
        It does not answer, or ``distributed`` is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise HysteresisError(f"--scheduler {EXTRA}") from None

    class Connected(Client):
        """A client that, where nobody has answered, goes without waiting for nobody once more."""

        def __del__(self):
            pass

    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what is wrong is said in words of our own
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
