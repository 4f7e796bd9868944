# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A bag that ends in order when it cannot go on: a disk that is full, or nearly so, ends the recording only."""

from __future__ import annotations

import os
import pathlib
import time

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.bag_writer import BagWriter

#: Seconds between two looks at the disk.
LOOK = 1.0


class GuardedBag:
    """Writes into a bag as long as that can be done, and hands what it has to the operating system in time.

    Parameters
    ----------
    bag : BagWriter
        The bag, just made.
    flush_time : float
        Seconds after which :meth:`tend` hands on what was written.

    Attributes
    ----------
    bag : BagWriter or None
        None when the recording is over.
    stopped : str
        Why nothing is recorded any more; empty while all is well and after a regular end.
    free : int
        Bytes that are free on its disk, as :meth:`tend` last saw.
    """

    def __init__(self, bag: BagWriter, flush_time: float):
        self.bag: BagWriter | None = bag
        self.path: pathlib.Path = bag.path
        self.stopped = ""
        self.messages = 0
        self._flush_time = flush_time
        self._flushed = self._looked = time.monotonic()
        self.free = free_space(self.path)

    def attempt(self, write) -> None:
        """Call ``write(bag)`` unless the recording is over; what cannot be written ends it.

        Parameters
        ----------
        write : callable
            Raises RecordingError where the disk is full.
        """
        if self.bag is None:
            return
        try:
            write(self.bag)
        except RecordingError as error:
            self.stop(str(error))

    def tend(self, min_space: int) -> None:
        """Hand on what was written, when it is time, and look at the disk.

        Parameters
        ----------
        min_space : int
            Free bytes below which the recording ends.
        """
        now = time.monotonic()
        if now - self._flushed >= self._flush_time:
            self._flushed = now
            self.attempt(BagWriter.flush)
        if self.bag is not None and now - self._looked >= LOOK:
            self._looked, self.free = now, free_space(self.path)
            if self.free < min_space:
                self.stop(
                    f"{self.path}: {self.free / 1e6:.4g} MB are free on the disk, less than min_space = "
                    f"{min_space / 1e6:.4g} MB; make room and record into another folder"
                )

    def stop(self, reason: str) -> None:
        """End the recording for a reason; the bag is whole up to here where there is room for its end."""
        self.stopped = reason
        try:
            self.finish()
        except RecordingError:
            self.stopped += f"; its index is missing: hysteresis repair {self.path}"

    def finish(self) -> None:
        """End the recording in order.

        Raises
        ------
        RecordingError
            There is no room for the end of the bag.
        """
        bag, self.bag = self.bag, None
        if bag is not None:
            try:
                bag.close()
            finally:
                self.messages = bag.message_count

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return self.messages if self.bag is None else self.bag.message_count


def free_space(path: pathlib.Path) -> int:
    """Return how many bytes a process without privileges may still write beside a file or folder."""
    found = os.statvfs(path)
    return found.f_bavail * found.f_frsize


def require_space(path, least: int) -> None:
    """Refuse to begin a recording where there is no room for it.

    Parameters
    ----------
    path : path-like
        Folder to be created.
    least : int
        Bytes that must be free.

    Raises
    ------
    RecordingError
        There are fewer.
    """
    path = pathlib.Path(path).absolute()
    there = next(parent for parent in path.parents if parent.exists())
    free = free_space(there)
    if free < least:
        raise RecordingError(
            f"{path}: {free / 1e6:.4g} MB are free on the disk, less than min_space = {least / 1e6:.4g} MB; make room, "
            "record elsewhere, or lower min_space of the recorder"
        )
