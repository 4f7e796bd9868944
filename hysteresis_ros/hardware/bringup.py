"""What a driver does when it takes a device: go to the safe voltage without a jump, and try how fast the device is."""

from __future__ import annotations

import time
from collections.abc import Callable

#: Steps of a ramp.
STEPS = 20
#: Samples that are tried, the part of them that the highest rate is for, and how much of a sample a driver may take.
TRIALS, SURE, SHARE = 50, 0.9, 0.5


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
