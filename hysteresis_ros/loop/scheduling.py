# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the operating system is asked for by a thread that keeps time."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
import time

from hysteresis_ros.loop.plant_parameters import RealtimeParameters

#: Turn of a thread of Python while the loop waits for another one [s].
TURN = 5e-4

_TIMER_SLACK = 29
_LOCK_PRESENT_AND_FUTURE = 3


def ask_for(parameters: RealtimeParameters) -> str:
    """Give the calling thread its priority and core, and keep the process in RAM, as far as that is permitted.

    Parameters
    ----------
    parameters : RealtimeParameters

    Returns
    -------
    str
        What was not permitted, and what to do about it; empty when all was.
    """
    library = ctypes.CDLL(None, use_errno=True)
    # without priority a thread is woken up to 50 µs late on purpose, to save energy
    if hasattr(library, "prctl"):
        library.prctl(_TIMER_SLACK, ctypes.c_ulong(1), ctypes.c_ulong(0), ctypes.c_ulong(0), ctypes.c_ulong(0))
    refused = []
    if parameters.priority:
        try:
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(parameters.priority))
        except (AttributeError, OSError) as error:
            refused.append(
                f"realtime.priority = {parameters.priority} ({_reason(error)}: a line '@GROUP - rtprio "
                f"{parameters.priority}' in /etc/security/limits.conf and a new login, or CAP_SYS_NICE)"
            )
    if parameters.cpu >= 0:
        try:
            os.sched_setaffinity(0, {parameters.cpu})
        except (AttributeError, OSError) as error:
            cores = ", ".join(map(str, sorted(os.sched_getaffinity(0)))) if hasattr(os, "sched_getaffinity") else "none"
            refused.append(f"realtime.cpu = {parameters.cpu} ({_reason(error)}: this process may use {cores})")
    if parameters.lock_memory and (not hasattr(library, "mlockall") or library.mlockall(_LOCK_PRESENT_AND_FUTURE)):
        refused.append(
            f"realtime.lock_memory = true ({os.strerror(ctypes.get_errno())}: a line '@GROUP - memlock unlimited' in "
            "/etc/security/limits.conf and a new login, or CAP_IPC_LOCK)"
        )
    return f"goes on without {'; without '.join(refused)}" if refused else ""


@contextlib.contextmanager
def boosted(parameters: RealtimeParameters):
    """Be nearly as urgent as the thread that keeps time, where that is permitted: on one core that one goes first."""
    priority = max(parameters.priority - 1, 1)
    before = None
    if parameters.priority:
        with contextlib.suppress(AttributeError, OSError):
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    try:
        yield
    finally:
        if before is not None:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, *before)


@contextlib.contextmanager
def undisturbed():
    """Run without the garbage collector, and with other threads of Python in the way as shortly as possible."""
    collects, interval = gc.isenabled(), sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(TURN)
    time.sleep(0.0)  # whoever waits for its turn has had one, and now waits for a whole turn again
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        if collects:
            gc.enable()


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or "this system does not know it"
