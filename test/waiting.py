# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Waiting for conditions, never for a fixed time."""

from __future__ import annotations

import threading
import time

#: Time-out of a condition [s]; only a failing test waits this long.
PATIENCE = 60.0


def until(condition, timeout: float = PATIENCE, what: str = "", every: float = 0.01):
    """Wait until ``condition()`` is true, checked ``every`` few seconds, and return its value."""
    deadline = time.monotonic() + timeout
    pause = threading.Event()
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {timeout:g} s: {what or condition}")
        pause.wait(every)


def until_clock(moment: float) -> None:
    """Wait until ``time.monotonic()`` reaches ``moment`` [s], where the duration itself is tested."""
    until(lambda: time.monotonic() >= moment, every=1e-3, what="the moment")
