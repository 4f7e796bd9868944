"""Waiting for conditions, never for time."""

from __future__ import annotations

import threading
import time

#: Seconds a condition may take; only a broken test waits that long.
PATIENCE = 60.0


def until(condition, timeout: float = PATIENCE, what: str = "", every: float = 0.01):
    """Wait until ``condition()`` is true, looked at ``every`` so many seconds, and return its value."""
    deadline = time.monotonic() + timeout
    pause = threading.Event()
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {timeout:g} s: {what or condition}")
        pause.wait(every)
