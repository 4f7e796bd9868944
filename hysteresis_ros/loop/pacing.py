# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The compiled loop of the fused runner: samples against absolute deadlines, its switches, and the ring it writes.

Starts and stops within a sample are switched here; every other change is made in Python
(:meth:`hysteresis_ros.loop.axis.Axis.apply`). A switch does the same as the methods ``start``, ``stop``, ``halt`` and
``hold`` of the parts.

A sample that would begin a whole period or more after its deadline is skipped: there is no measurement and no command,
the voltage stays, and time goes on. So a burst of late outputs never follows a missed deadline.

A core that rests takes some 10 µs to wake. So the thread sleeps only until a time *ahead* of the deadline, and then
looks at the clock until the deadline. The time ahead is fixed, or it follows the wake-up times of this machine.
"""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.loop import compensator as compensating
from hysteresis_ros.loop import controller as controlling
from hysteresis_ros.loop import plant as planting
from hysteresis_ros.loop.plant import tell_joints
from hysteresis_ros.loop.source import hold, rest
from hysteresis_ros.loop.tick import WHOLE
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import COMPILED, nested

# Codes of the switches; HALT is the emergency stop, which stops everything that can be stopped.
NOTHING, START_PLANT, HALT_PLANT, START_CONTROLLER, STOP_CONTROLLER, START_COMPENSATOR, STOP_COMPENSATOR = range(7)
STOP_GENERATOR, HALT, HOLD_GENERATOR = 7, 8, 9

#: Node and action of each code.
SWITCHES = {
    START_PLANT: ("plant_simulator", "start"),
    HALT_PLANT: ("plant_simulator", "halt"),
    START_CONTROLLER: ("motion_controller", "start"),
    STOP_CONTROLLER: ("motion_controller", "stop"),
    START_COMPENSATOR: ("hysteresis_compensator", "start"),
    STOP_COMPENSATOR: ("hysteresis_compensator", "stop"),
    STOP_GENERATOR: ("reference_generator", "stop"),
    HOLD_GENERATOR: ("reference_generator", "hold"),
}

#: Code of each node and action.
CODES = {what: code for code, what in SWITCHES.items()}


def switched(code: int, nodes: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return node and action of everything that a code switches; a motor's sequencer gets a stop request instead."""
    codes = (HALT_PLANT, STOP_CONTROLLER, STOP_COMPENSATOR, STOP_GENERATOR) if code == HALT else (code,)
    return [SWITCHES[one] for one in codes if SWITCHES[one][0] in nodes]


@nested
def switch(laws, parts, column, code):
    """Start or stop a part, beginning with this sample; resulting inputs of a source are written into the column."""
    trip = parts.plant.watch_x.trip
    controller, compensator = parts.controller.watch_x.own, parts.compensator.watch_x.own
    if code == START_PLANT:
        for i in range(trip.shape[0]):
            if i != planting.LATE:
                trip[i] = 0.0
    if code in (HALT_PLANT, HALT):
        trip[planting.TRIP] = max(trip[planting.TRIP], planting.HALTED)
    if code in (STOP_CONTROLLER, HALT):
        controller[controlling.STOP] = 1.0
    if code in (STOP_COMPENSATOR, HALT):
        compensator[compensating.STOP] = 1.0
    if code in (STOP_GENERATOR, HALT):
        rest(laws, parts.source, column)
    if code == HOLD_GENERATOR:
        hold(laws, parts.source, column)
    if code == START_CONTROLLER:
        controller[controlling.STOP] = 0.0
        controller[controlling.RETURNING] = 1.0
    if code == START_COMPENSATOR:
        compensator[compensating.STOP] = 0.0
        compensator[compensating.RETURNING] = 1.0


class Pace(NamedTuple):
    """The arrays between the loop and the threads of Python around it."""

    #: Counters and flags, int64, see below.
    state: np.ndarray
    #: Inputs of the parts, and the row they work on.
    given: np.ndarray
    column: np.ndarray
    row: np.ndarray
    #: Setpoints of the configuration: first sample, value [m]; shape (N, 2).
    schedule: np.ndarray
    #: Requests, a row per request, shape (POSTS, POST).
    posts: np.ndarray
    #: Switches that were made: sample, code; int64, shape (EVENTS, 2).
    events: np.ndarray
    #: Samples by their lateness, int64, shape (BINS,).
    histogram: np.ndarray
    #: Rows of the last samples, shape (N, row length), and the time each began [ns], int64, shape (N,).
    rows: np.ndarray
    times: np.ndarray
    #: Contents of ``joint_states`` of a motor, shape (N, JOINTS).
    joints: np.ndarray
    #: For the C library, int64, shape (2,).
    timespec: np.ndarray


# State, written by the loop: number of the next sample; samples ever in the ring; skipped samples; posts, setpoints,
# requests, speeds, switches and emergency stops taken; setpoints of the schedule so far; greatest lateness, all time
# spent beyond waiting, the longest of it [ns].
SAMPLE, HEAD, MISSED, TAKEN, SETPOINTS, REQUESTS, SPEEDS, SWITCHED, HALTED = range(9)
SCHEDULED, EVENT_COUNT, LATEST, BUSY, BUSIEST, IN_ROW = range(9, 15)
# Written by other threads: 1: end before the next sample; sample before which to end, 0: never; number of posts; time
# of sample 0 [ns], period [fs]; 1: without waiting; number of the first sample in the ring; number of the last pause
# that was requested, and of the last one that is over.
LEAVE, UNTIL, POSTED, ORIGIN, PERIOD, UNPACED, FIRST, PAUSE, RESUMED = range(15, 24)
# Number of the last pause that has begun; start of the sample in progress [ns], 0: no sample is in progress.
PAUSED, AT_WORK = 24, 25
# Time ahead of a deadline from which the thread looks at the clock [ns]; upper bound of it while it follows the wake-up
# times [ns], 0: it is fixed; estimated quantile of the wake-up times [ns]; all time spent looking [ns].
AHEAD, MOST_AHEAD, WAKE, LOOKED = 26, 27, 28, 29
STATES = 30

# Columns of a post: each value is followed by the number of times that it has been set.
POST_SETPOINT, POST_SETPOINTS, POST_REQUEST, POST_REQUESTS, POST_SPEED, POST_SPEEDS = range(6)
POST_SWITCH, POST_SWITCHES, POST_HALTS = range(6, 9)
POST = 9

#: Capacity for posts and events: many more than are made or left unread within a sample.
POSTS, EVENTS = 64, 1024

#: Lateness of the first bin [ns], number of bins, and bins per factor e.
LEAST, BINS, RESOLUTION = 100.0, 700, 30.0

#: Longest uninterrupted wait [ns], hence the delay after which a request to end is noticed.
PIECE = 50_000_000
#: Steps of the estimated quantile at a longer and at a shorter wake-up time [ns]: it settles where they are balanced,
#: at 98 %, and follows a change of 10 µs within some 200 long wake-ups.
LONGER, SHORTER = 49, 1
#: First estimate of the wake-up time [ns].
FIRST_WAKE = 50_000
#: Polling interval for the end of a pause [ns].
PAUSE_PIECE = 20_000
#: Skipped samples in a row, as a part of the ring, after which the loop waits for readers, and how long [ns].
CATCH_UP, BREATH = 4, 20_000_000

MONOTONIC, ABSOLUTE = 1, 1
FEMTO = 1_000_000

if COMPILED:
    from numba import types

    # by symbol, not by ctypes: addresses of this process could not be cached with the code
    _gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
    _nanosleep: Any = types.ExternalFunction(
        "clock_nanosleep", types.int32(types.int32, types.int32, types.intp, types.intp)
    )

    @nested
    def clock(timespec):
        """Return the time of the monotonic clock [ns]."""
        _gettime(MONOTONIC, timespec.ctypes.data)
        return timespec[0] * 1_000_000_000 + timespec[1]

    @nested
    def sleep_until(timespec, instant):
        """Wait until an instant of the monotonic clock [ns], or a signal."""
        timespec[0], timespec[1] = instant // 1_000_000_000, instant % 1_000_000_000
        _nanosleep(MONOTONIC, ABSOLUTE, timespec.ctypes.data, 0)

else:

    def clock(timespec):
        """Return the time of the monotonic clock [ns]."""
        return time.monotonic_ns()

    def sleep_until(timespec, instant):
        """Wait until an instant of the monotonic clock [ns]."""
        time.sleep(max(instant - time.monotonic_ns(), 0) * 1e-9)


@nested
def deadline_of(state):
    """Return the deadline of the next sample [ns]."""
    samples, whole, rest = state[SAMPLE], state[PERIOD] // FEMTO, state[PERIOD] % FEMTO
    return state[ORIGIN] + samples * whole + samples * rest // FEMTO


@nested
def pause(state, timespec):
    """Pause between two samples while another thread changes the parts; return the time [ns]."""
    state[PAUSED] = state[PAUSE]
    now = clock(timespec)
    while state[RESUMED] != state[PAUSED]:
        sleep_until(timespec, now + PAUSE_PIECE)
        now = clock(timespec)
    return now


@nested
def note_wake(state, late):
    """Let the time ahead follow a wake-up that came ``late`` [ns] after its instant."""
    if state[MOST_AHEAD] == 0:
        return
    state[WAKE] = max(state[WAKE] + (LONGER if late > state[WAKE] else -SHORTER), 0)
    # what a sample computes takes the core too
    most = state[MOST_AHEAD] - state[BUSY] // max(state[HEAD], 1)
    state[AHEAD] = max(min(state[WAKE], most), 0)


@nested
def await_deadline(state, timespec, deadline):
    """Wait for a deadline [ns], or until a pause or the end is requested; return the time [ns]."""
    now = clock(timespec)
    edge = deadline - state[AHEAD]
    while now < edge and state[LEAVE] == 0 and state[PAUSE] == state[RESUMED]:
        sleep_until(timespec, min(edge, now + PIECE))
        now = clock(timespec)
        if now >= edge:
            note_wake(state, now - edge)
    begun = now
    while now < deadline and state[LEAVE] == 0 and state[PAUSE] == state[RESUMED]:
        now = clock(timespec)
    state[LOOKED] += now - begun
    return now


@nested
def note_lateness(state, histogram, late):
    """Count a sample that began ``late`` [ns] after its deadline."""
    state[LATEST] = max(state[LATEST], late)
    index = 0
    if late > LEAST:
        index = min(1 + int(RESOLUTION * elementary.log(late / LEAST)), BINS - 1)
    histogram[index] += 1


@nested
def take_setpoint(state, schedule, column):
    """Write a new setpoint of the schedule into the column, unless a setpoint was ever received."""
    index = state[SCHEDULED]
    while state[SETPOINTS] == 0 and index < schedule.shape[0] and schedule[index, 0] <= state[SAMPLE]:
        column[at.SETPOINT, 0] = schedule[index, 1]
        index += 1
    state[SCHEDULED] = index


@nested
def take_post(own, motor):
    """Read all requests since the last sample; return the switches to make.

    Several posts between two samples act as one: each contains all requests so far. The row of a post is complete
    before its number is written, and it is overwritten POSTS posts later.
    """
    state, column = own.state, own.column
    column[at.SKIPPED, 0] = 0.0
    if motor:
        column[at.REQUEST, 0] = 0.0
        column[at.SPEED, 0] = math.nan
    posted = state[POSTED]
    if posted == state[TAKEN]:
        return NOTHING, NOTHING
    post = own.posts[posted % POSTS]
    state[TAKEN] = posted
    if post[POST_SETPOINTS] != state[SETPOINTS]:
        column[at.SETPOINT, 0] = post[POST_SETPOINT]
    if motor and post[POST_REQUESTS] != state[REQUESTS]:
        column[at.REQUEST, 0] = post[POST_REQUEST]
    if motor and post[POST_SPEEDS] != state[SPEEDS]:
        column[at.SPEED, 0] = post[POST_SPEED]
    first = int(post[POST_SWITCH]) if post[POST_SWITCHES] != state[SWITCHED] else NOTHING
    then = HALT if post[POST_HALTS] != state[HALTED] else NOTHING
    state[SETPOINTS], state[REQUESTS] = int(post[POST_SETPOINTS]), int(post[POST_REQUESTS])
    state[SPEEDS], state[SWITCHED] = int(post[POST_SPEEDS]), int(post[POST_SWITCHES])
    state[HALTED] = int(post[POST_HALTS])
    return first, then


@nested
def log_switch(state, events, code):
    """Log a switch before the next sample."""
    event = events[state[EVENT_COUNT] % EVENTS]
    event[0], event[1] = state[SAMPLE], code
    state[EVENT_COUNT] += 1


@nested
def keep(laws, parts, own, begun):
    """Write the finished sample into the ring."""
    state, column = own.state, own.column
    slot = state[HEAD] % own.rows.shape[0]
    for i in range(column.shape[0]):
        own.rows[slot, i] = column[i, 0]
    own.times[slot] = begun
    tell_joints(laws, parts.plant, own.joints[slot % own.joints.shape[0]])


def pace(step, laws, parts, own, motor):
    """Run the loop until the last sample, or until the end is requested."""
    state, column, timespec = own.state, own.column, own.timespec
    now = clock(timespec)
    while state[LEAVE] == 0 and (state[UNTIL] == 0 or state[SAMPLE] < state[UNTIL]):
        if state[PAUSE] != state[RESUMED]:
            now = pause(state, timespec)
            continue
        deadline = now
        if state[UNPACED] == 0:
            deadline = deadline_of(state)
            if now < deadline:
                now = await_deadline(state, timespec, deadline)
                if now < deadline:
                    continue
        begun = now
        take_setpoint(state, own.schedule, column)
        for code in take_post(own, motor):
            if code != NOTHING:
                log_switch(state, own.events, code)
                switch(laws, parts, column, code)
        state[IN_ROW] += 1
        if state[UNPACED] == 0 and now - deadline >= state[PERIOD] // FEMTO:
            column[at.SKIPPED, 0] = 1.0
            state[MISSED] += 1
        else:
            state[IN_ROW] = 0
        note_lateness(state, own.histogram, now - deadline)
        state[AT_WORK] = begun
        step(laws, parts, own.given, column, own.row, WHOLE)
        keep(laws, parts, own, begun)
        now = clock(timespec)
        spent = now - begun
        state[AT_WORK] = 0
        state[BUSY] += spent
        state[BUSIEST] = max(state[BUSIEST], spent)
        # after a call that is opaque to the compiler, so that the store is not moved before the row is complete
        state[HEAD] += 1
        state[SAMPLE] += 1
        if state[IN_ROW] * CATCH_UP >= own.rows.shape[0]:
            state[IN_ROW] = 0
            sleep_until(timespec, now + BREATH)
            now = clock(timespec)


class Samples(NamedTuple):
    """Consecutive samples."""

    first: int  #: Number of the first sample, counted from the start of the axis.
    #: Shape (row length, N): a column for each sample, a row for each signal, see
    #: :class:`hysteresis_ros.signals.AxisKind`.
    table: np.ndarray
    times: np.ndarray  #: Start of each sample [ns since 1970], whole numbers, shape (N,).
    #: Positions [m], velocities [m/s] and efforts [N] of a motor's joints, shape (JOINT_NUMBERS, N).
    joints: np.ndarray | None
    lost: int  #: Samples before the first one that were overwritten before they were read.


class Lateness(NamedTuple):
    """Lateness of the samples, skipped samples included, and their cost."""

    #: p50, p90, p99, p999, max: quantiles of the lateness [s]; all but the last are accurate to 2 %.
    p50: float
    p90: float
    p99: float
    p999: float
    max: float
    missed: int  #: Samples that were skipped.
    samples: int  #: All samples.
    cost: float  #: cost, highest_cost: mean and largest computing time of a sample [s].
    highest_cost: float
    ahead: float  #: Time ahead of a deadline from which the thread looks at the clock, at present [s].
    looked: float  #: Mean time per sample spent looking [s].


class Reader:
    """Reads samples from the ring, each once, beginning with the next sample."""

    def __init__(self, own: Pace, offset):
        self._own = own
        self._offset = offset
        self._next = int(own.state[HEAD])

    def take(self) -> Samples:
        """Return all samples since the last call; may be empty."""
        state, rows = self._own.state, self._own.rows
        size = len(rows)
        head = int(state[HEAD])
        first = max(self._next, head - size)
        places = np.arange(first, head) % size
        table, times = np.ascontiguousarray(rows[places].T), self._own.times[places] + self._offset()
        joints = np.ascontiguousarray(self._own.joints[places].T) if self._own.joints.shape[1] else None
        # drop samples that were overwritten during the copy; the next sample may be partly in the ring already
        whole = min(max(first, int(state[HEAD]) + 1 - size), head)
        lost, self._next = whole - self._next, head
        begin = int(state[FIRST])
        if whole > first:
            table, times = np.ascontiguousarray(table[:, whole - first :]), times[whole - first :]
            joints = None if joints is None else np.ascontiguousarray(joints[:, whole - first :])
        return Samples(begin + whole, table, times, joints, lost)


def latest(own: Pace) -> tuple[int, np.ndarray]:
    """Return number and row of the last sample; -1 and NaN before the first one."""
    state, rows = own.state, own.rows
    while True:
        head = int(state[HEAD])
        row = rows[(head - 1) % len(rows)].copy()
        if int(state[HEAD]) - head < len(rows) - 1:
            return (int(state[FIRST]) + head - 1 if head else -1), row


def quantile(histogram: np.ndarray, part: float) -> float:
    """Return a quantile of the lateness [s], accurate to 2 %."""
    counts = np.cumsum(histogram)
    if not counts[-1]:
        return 0.0
    index = int(np.searchsorted(counts, part * counts[-1]))
    return LEAST * elementary.exp(max(index - 0.5, 0.0) / RESOLUTION) * 1e-9


def lateness(own: Pace) -> Lateness:
    """Return the lateness of all samples so far."""
    state, histogram = own.state, own.histogram.copy()
    largest, samples = float(state[LATEST]) * 1e-9, int(state[HEAD])
    p50, p90, p99, p999 = (min(quantile(histogram, part), largest) for part in (0.5, 0.9, 0.99, 0.999))
    cost, looked = (float(state[total]) * 1e-9 / max(samples, 1) for total in (BUSY, LOOKED))
    highest, ahead = (float(state[value]) * 1e-9 for value in (BUSIEST, AHEAD))
    return Lateness(p50, p90, p99, p999, largest, int(state[MISSED]), samples, cost, highest, ahead, looked)
