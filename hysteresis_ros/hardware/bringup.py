# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a driver does when it takes a device: claim it, go to the safe voltage without a jump, try how fast it is."""

from __future__ import annotations

import fcntl
import os
import pathlib
import time
from collections.abc import Callable

from hysteresis_ros.hardware.driver import DriverError

#: Steps of a ramp.
STEPS = 20
#: Samples that are tried, the part of them that the highest rate is for, and how much of a sample a driver may take.
TRIALS, SURE, SHARE = 50, 0.9, 0.5


def claim(path: pathlib.Path, name: str) -> int:
    """Take the file of a device for this process and return what holds it, until that is closed.

    Parameters
    ----------
    path : pathlib.Path
    name : str
        Of the device, for messages.

    Raises
    ------
    DriverError
        It cannot be opened, or another process has it.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError as error:
        raise DriverError(name, f"cannot be opened ({error})", "look at its address and its cable") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        raise DriverError(name, f"has another master at {path.name}", "end the other program first") from None
    return file


def ramp(put_out: Callable[[float], None], start: float, end: float, duration: float) -> None:
    """Take a voltage to another one in equal steps.

    Parameters
    ----------
    put_out : callable
        Puts a voltage out [V].
    start, end : float
        [V]
    duration : float
        [s]
    """
    for step in range(1, STEPS) if start != end else ():
        put_out(start + (end - start) * step / STEPS)
        time.sleep(duration / STEPS)
    put_out(end)


def highest_rate(write: Callable[[], None], read: Callable[[], object]) -> float:
    """Return at which rate nearly all samples leave time for the rest of an axis [Hz].

    Parameters
    ----------
    write, read : callable
        What is done once a sample.
    """
    durations = []
    for _ in range(TRIALS):
        begun = time.perf_counter()
        write()
        read()
        durations.append(time.perf_counter() - begun)
    return SHARE / sorted(durations)[int(SURE * TRIALS)]
