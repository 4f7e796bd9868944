# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The fused loop as a process: suspended, without Numba, without permissions, and with a failing thread."""

from __future__ import annotations

import gc
import os
import pathlib
import signal as posix
import subprocess
import sys
import time

import numpy as np
import pytest
from fused_support import ANY_LATE, SLOWLY, assert_twin, change, made_loop, named
from loop_support import HOLD, axis
from waiting import until, until_clock

from hysteresis_ros.errors import ConfigurationError, LoopError
from hysteresis_ros.loop import fused
from hysteresis_ros.loop import fused as scheduling
from hysteresis_ros.loop.fused import INTERPRETED_RATE, FusedLoop

HERE = pathlib.Path(__file__).parent

STOPPED_PROCESS = """
import sys, time
import numpy as np
sys.path[:0] = sys.argv[1:]
from fused_support import assert_twin, whole
from waiting import until
from loop_support import HOLD, parameters
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.fused import FusedLoop
given = parameters(plant_simulator={"late_limit": -1}, **HOLD)
loop = FusedLoop(Axis(given), 0.05)
loop.set(setpoint=5e-6)
loop.start()
until(lambda: loop.sample > 10)
print("runs", flush=True)
sys.stdin.readline()
until(lambda: loop.missed >= 20)
before = loop.sample
until(lambda: loop.sample > before + 5)
loop.leave()
made = whole(loop)
assert_twin(loop, made, given)
# time went on: no burst of answers followed
print("missed", loop.missed, int(np.sum(made["skipped"])), loop.lateness().max >= 0.13, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [True, False])
def test_a_process_that_was_suspended_skips_what_it_missed(compiled):
    environment = os.environ | ({} if compiled else {"NUMBA_DISABLE_JIT": "1"})
    command = [sys.executable, "-c", STOPPED_PROCESS, str(HERE), str(HERE.parent)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment, **pipes) as process:
        assert process.stdout.readline() == "runs\n"
        process.send_signal(posix.SIGSTOP)
        until_clock(time.monotonic() + 0.4)  # the length of the interruption
        process.send_signal(posix.SIGCONT)
        out, _ = process.communicate("\n")
    word, missed, skipped, late = out.split()
    assert process.returncode == 0 and word == "missed" and missed == skipped and late == "True"


# --------------------------------------------------------------------------------------------------------- limits of it

INTERPRETED = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from fused_support import assert_twin, whole
from loop_support import parameters
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.fused import FusedLoop
for name in ("kim2009", "inchworm_travel"):
    given = parameters(name)
    loop = FusedLoop(Axis(given), np.inf, 200)
    loop.apply(Change(0, "motion_controller", "stop"))
    loop.apply(Change(0, "motion_controller", "start"))
    loop.start()
    loop.join()
    made = whole(loop)
    assert_twin(loop, made, given)
    made["voltage"].tofile(sys.stdout.buffer)
"""


@pytest.mark.slow
def test_without_numba_the_same_loop_runs_interpreted():
    command = [sys.executable, "-c", INTERPRETED, os.path.dirname(__file__)]
    given = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    plain = np.frombuffer(subprocess.run(command, env=given, check=True, stdout=subprocess.PIPE).stdout)
    quick = np.frombuffer(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    assert len(plain) == 400
    np.testing.assert_allclose(plain, quick, rtol=0, atol=1e-9)


def test_without_numba_an_axis_that_is_too_fast_is_refused(monkeypatch):
    monkeypatch.setattr(fused, "COMPILED", False)
    with pytest.raises(ConfigurationError, match=rf"3000 Hz.*without Numba.*{INTERPRETED_RATE:g} samples"):
        FusedLoop(axis(), 1.0)
    FusedLoop(axis(), 0.9 * INTERPRETED_RATE / 3000.0)


def test_what_is_not_permitted_is_said_once_and_the_loop_goes_on(monkeypatch):
    def refuse(*arguments):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(scheduling.os, "sched_setscheduler", refuse, raising=False)
    monkeypatch.setattr(scheduling.os, "sched_setaffinity", refuse, raising=False)
    told = []
    realtime = {"realtime__priority": 70, "realtime__cpu": 0}
    loop = FusedLoop(axis(plant_simulator=realtime), np.inf, 50, told.append)
    loop.start()
    loop.join()
    assert loop.sample == 50 and told == [loop.warning]
    for word in ("realtime.priority = 70", "rtprio", "limits.conf", "CAP_SYS_NICE", "realtime.cpu = 0"):
        assert word in loop.warning


def test_a_thread_that_fails_says_why_and_refuses_changes(monkeypatch):
    loop, _ = made_loop(factor=SLOWLY, **ANY_LATE)

    def fail(*arguments):
        raise ZeroDivisionError("nothing is left")

    monkeypatch.setattr(fused, "ask_for", fail)
    loop.start()
    loop.join()
    assert "sample 0" in loop.failure and "nothing is left" in loop.failure
    with pytest.raises(LoopError, match="nothing is left"):
        loop.apply(change("motion_controller", "retune", handover_time=0.02))


def test_whoever_changes_something_is_urgent_meanwhile_and_not_afterwards(monkeypatch):
    asked = []
    monkeypatch.setattr(scheduling.os, "sched_setscheduler", lambda *arguments: asked.append(arguments[1:]))
    loop, given = made_loop(factor=SLOWLY, plant_simulator={"late_limit": -1, "realtime__priority": 50}, **HOLD)
    loop.start()
    loop.apply(change("motion_controller", "retune", handover_time=0.02))
    loop.leave()
    urgent = scheduling.os.SCHED_FIFO | scheduling.os.SCHED_RESET_ON_FORK
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    found = [(policy, param.sched_priority) for policy, param in asked]
    assert sorted(found) == sorted([(urgent, 50), (urgent, 49), before])
    assert found.index((urgent, 49)) < found.index(before)
    assert loop.changes and not loop.failure


@pytest.fixture
def usual():
    """The process as Python starts it: a fused axis that ran in it has shortened the interval of its threads."""
    found = sys.getswitchinterval()
    sys.setswitchinterval(0.005)
    gc.enable()
    yield sys.getswitchinterval()
    sys.setswitchinterval(found)


def test_what_is_set_aside_for_a_change_is_back_afterwards(usual):
    with pytest.raises(KeyError), scheduling.undisturbed():
        assert not gc.isenabled() and sys.getswitchinterval() < usual
        raise KeyError
    assert gc.isenabled() and sys.getswitchinterval() == usual


def test_a_clock_that_is_set_moves_neither_samples_nor_their_times(monkeypatch):
    loop, given = made_loop(factor=SLOWLY, **ANY_LATE)
    loop.start()
    until(lambda: loop.sample > 10, what="samples")
    before, origin, jump = loop.take(), loop.origin, 3600 * 10**9
    present = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: present() - jump)
    reached = loop.sample
    until(lambda: loop.sample > reached + 10, what="samples after the jump")
    loop.leave()
    assert loop.origin == origin
    after = loop.take()
    steps = np.diff(np.concatenate([before.times, after.times]))
    assert np.all(steps > 0) and np.all(steps < jump // 2)
    assert_twin(loop, named(loop, np.concatenate([before.table, after.table], axis=1)), given)
