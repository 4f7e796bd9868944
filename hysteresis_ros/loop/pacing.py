# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The compiled loop of the fused runner: absolute deadlines, start and stop requests, a ring of finished samples.

The loop computes one axis (:class:`Alone`) or all axes of a stage (:class:`Together`), which have one clock. Requests,
inputs and the ring have an entry for each axis.

This loop starts and stops parts between two samples; every other change is made in Python
(:meth:`hysteresis_ros.loop.axis.Axis.apply`). A start or stop has the same effect as the methods ``start``, ``stop``,
``halt`` and ``hold`` of a part.

A sample that would begin a whole period or more after its deadline is skipped: it has no measurement and no command,
and the voltage is held. So a missed deadline is never followed by a burst of late outputs.

An idle core takes tens of microseconds to wake up. So the thread sleeps only until a certain time before the deadline,
and then polls the clock. This time is fixed, or it follows the wake-up times of this machine.
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
from hysteresis_ros.models.block import COMPILED, by_part, each, nested

# Codes of the start and stop requests; HALT is the emergency stop of all parts that can be stopped.
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
    """Return node and action of each part that a code starts or stops; a sequencer gets a stop request instead."""
    codes = (HALT_PLANT, STOP_CONTROLLER, STOP_COMPENSATOR, STOP_GENERATOR) if code == HALT else (code,)
    return [SWITCHES[one] for one in codes if SWITCHES[one][0] in nodes]


@nested
def switch(laws, parts, column, code):
    """Start or stop a part, beginning with this sample; requests to a source are written into ``column``."""
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


class Alone(NamedTuple):
    """What the loop runs: one axis."""

    laws: Any  #: Of :class:`hysteresis_ros.loop.tick.Laws`.
    parts: Any  #: Of :class:`hysteresis_ros.loop.tick.Parts`.


class Together(NamedTuple):
    """What the loop runs: all axes of a stage."""

    laws: Any  #: Tuple of the laws of each axis.
    parts: Any  #: Tuple of the parts of each axis.
    group: Any  #: Arrays that the axes share, of :class:`hysteresis_ros.loop.stage.GroupArrays`.


class Pace(NamedTuple):
    """The arrays that the loop shares with the threads of Python."""

    #: Counters and flags, int64, see below.
    state: np.ndarray
    #: Counters of each axis, int64, shape (axes, COUNTS), see below.
    counts: np.ndarray
    #: Indices of the inputs in a row.
    given: np.ndarray
    #: Row of the sample with the inputs of the parts, followed by the starts and stops to execute before the sample,
    #: shape (axes, row length + MOST_SWITCHES, 1).
    column: np.ndarray
    #: Rows that the parts read and write, shape (axes, row length).
    row: np.ndarray
    #: Setpoints of the configuration: first sample, value [m], axis; shape (N, 3), in the order of the samples.
    schedule: np.ndarray
    #: Requests to all axes, one table for each post, shape (POSTS, axes, POST).
    posts: np.ndarray
    #: Executed starts and stops: sample, code, axis; int64, shape (EVENTS, 3).
    events: np.ndarray
    #: Histogram of the lateness, int64, shape (BINS,).
    histogram: np.ndarray
    #: Rows of the last samples, shape (N, axes, row length), and the time at which each began [ns], int64, shape (N,).
    rows: np.ndarray
    times: np.ndarray
    #: Contents of ``joint_states`` of a motor, shape (N, JOINTS).
    joints: np.ndarray
    #: ``timespec`` of the C library: seconds, nanoseconds; int64, shape (2,).
    timespec: np.ndarray


# State, written by the loop. SAMPLE: number of the next sample. HEAD: number of samples written to the ring so far.
# MISSED: skipped samples. TAKEN: posts taken. EVENT_COUNT: number of events. LATEST: greatest lateness [ns].
# BUSY, BUSIEST: total and longest computing time of samples [ns]. IN_ROW: consecutive skipped samples.
SAMPLE, HEAD, MISSED, TAKEN, EVENT_COUNT, LATEST, BUSY, BUSIEST, IN_ROW = range(9)
# State, written by other threads. LEAVE: 1 ends the loop before the next sample. UNTIL: number of the sample before
# which the loop ends, 0: never. POSTED: number of posts. ORIGIN: time of sample 0 [ns], 0: not started. PERIOD: sample
# time [fs]. UNPACED: 1 runs the loop without waiting. FIRST: number of the first sample in the ring. PAUSE: number of
# the last requested pause. RESUMED: number of the last pause that is over.
LEAVE, UNTIL, POSTED, ORIGIN, PERIOD, UNPACED, FIRST, PAUSE, RESUMED = range(9, 18)
# PAUSED: number of the last pause that has begun. AT_WORK: start of the sample in progress [ns], 0: no sample.
PAUSED, AT_WORK = 18, 19
# AHEAD: time before a deadline at which the thread begins to poll the clock [ns]. MOST_AHEAD: upper bound of AHEAD if
# it follows the wake-up times [ns], 0: AHEAD is fixed. WAKE: estimated quantile of the wake-up times [ns]. LOOKED:
# total time of polling [ns].
AHEAD, MOST_AHEAD, WAKE, LOOKED = 20, 21, 22, 23
STATES = 24

# Counters of an axis, written by the loop: accepted setpoints, requests, speeds, starts or stops, emergency stops;
# index of the next entry of the schedule; accepted pulses of the trigger input.
SETPOINTS, REQUESTS, SPEEDS, SWITCHED, HALTED, SCHEDULED, PULSED = range(7)
COUNTS = 7

# Columns of a post: each value, followed by the number of times it was set.
POST_SETPOINT, POST_SETPOINTS, POST_REQUEST, POST_REQUESTS, POST_SPEED, POST_SPEEDS = range(6)
POST_SWITCH, POST_SWITCHES, POST_HALTS, POST_PULSES = range(6, 10)
POST = 10

#: Largest number of starts and stops of an axis between two samples.
MOST_SWITCHES = 2

#: Capacity of the rings of posts and events, far more than occur within a sample.
POSTS, EVENTS = 64, 1024

#: Upper limit of the first bin of the lateness [ns].
LEAST = 100.0
#: Number of bins of the lateness.
BINS = 700
#: Number of bins per factor e of the lateness.
RESOLUTION = 30.0

#: Longest uninterrupted wait [ns]; a request to end the loop is delayed by at most this time.
PIECE = 50_000_000
#: Increase of the estimated wake-up time after a longer wake-up [ns]: the estimate follows an increase of 10 µs within
#: about 200 longer wake-ups.
LONGER = 49
#: Decrease of the estimated wake-up time after a wake-up that is not longer [ns]: the estimate converges to the 98 %
#: quantile, where both steps balance.
SHORTER = 1
#: First estimate of the wake-up time [ns].
FIRST_WAKE = 50_000
#: Polling interval for the end of a pause [ns].
PAUSE_PIECE = 20_000
#: The loop waits for the readers after (ring length / this number) consecutive skipped samples.
CATCH_UP = 4
#: Time for which the loop then waits for the readers [ns].
BREATH = 20_000_000

MONOTONIC, ABSOLUTE = 1, 1
FEMTO = 1_000_000
#: Time from the start to the first sample [ns].
LEAD = 5_000_000

if COMPILED:
    from numba import types

    # called by symbol, because an address from ctypes is valid only in this process and cannot be cached with the code
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
        """Wait until an instant of the monotonic clock [ns], or until a signal arrives."""
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
    """Pause between two samples while another thread changes the parts; return the present time [ns]."""
    state[PAUSED] = state[PAUSE]
    now = clock(timespec)
    while state[RESUMED] != state[PAUSED]:
        sleep_until(timespec, now + PAUSE_PIECE)
        now = clock(timespec)
    return now


@nested
def note_wake(state, late):
    """Adapt the start of polling to a wake-up that came ``late`` [ns] after the requested instant."""
    if state[MOST_AHEAD] == 0:
        return
    state[WAKE] = max(state[WAKE] + (LONGER if late > state[WAKE] else -SHORTER), 0)
    # the computation of a sample also needs time on the core
    most = state[MOST_AHEAD] - state[BUSY] // max(state[HEAD], 1)
    state[AHEAD] = max(min(state[WAKE], most), 0)


@nested
def await_deadline(state, timespec, deadline):
    """Wait for a deadline [ns], or until a pause or the end is requested; return the present time [ns]."""
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
def take_setpoint(own, i):
    """Write a due setpoint of the schedule into an axis' column, unless the axis has already received a setpoint."""
    counts, schedule = own.counts[i], own.schedule
    index = counts[SCHEDULED]
    while counts[SETPOINTS] == 0 and index < schedule.shape[0] and schedule[index, 0] <= own.state[SAMPLE]:
        if schedule[index, 2] == i:
            own.column[i, at.SETPOINT, 0] = schedule[index, 1]
        index += 1
    counts[SCHEDULED] = index


@nested
def take_post(own, i, motor):
    """Read all requests to an axis since the last sample; write its starts and stops after its row in the column.

    Each post contains all requests so far, so several posts between two samples act as one. The table of a post is
    complete before its number is written, and the table is overwritten POSTS posts later.
    """
    counts, column = own.counts[i], own.column[i]
    post = own.posts[own.state[TAKEN] % POSTS, i]
    if post[POST_SETPOINTS] != counts[SETPOINTS]:
        column[at.SETPOINT, 0] = post[POST_SETPOINT]
    if motor and post[POST_REQUESTS] != counts[REQUESTS]:
        column[at.REQUEST, 0] = post[POST_REQUEST]
    if motor and post[POST_SPEEDS] != counts[SPEEDS]:
        column[at.SPEED, 0] = post[POST_SPEED]
    column[at.TRIGGER_IN, 0] = post[POST_PULSES] - counts[PULSED]
    first = own.row.shape[1]
    column[first, 0] = post[POST_SWITCH] if post[POST_SWITCHES] != counts[SWITCHED] else NOTHING
    column[first + 1, 0] = HALT if post[POST_HALTS] != counts[HALTED] else NOTHING
    counts[SETPOINTS], counts[REQUESTS] = int(post[POST_SETPOINTS]), int(post[POST_REQUESTS])
    counts[SPEEDS], counts[SWITCHED] = int(post[POST_SPEEDS]), int(post[POST_SWITCHES])
    counts[HALTED], counts[PULSED] = int(post[POST_HALTS]), int(post[POST_PULSES])
    log_switches(own, i)


@nested
def log_switches(own, i):
    """Log the starts and stops of an axis before the next sample."""
    state, first = own.state, own.row.shape[1]
    for place in range(first, first + MOST_SWITCHES):
        if own.column[i, place, 0] != NOTHING:
            event = own.events[state[EVENT_COUNT] % EVENTS]
            event[0], event[1], event[2] = state[SAMPLE], int(own.column[i, place, 0]), i
            state[EVENT_COUNT] += 1


@nested
def make_switches(laws, parts, column):
    """Execute the starts and stops that follow the row of one axis."""
    for place in range(column.shape[0] - MOST_SWITCHES, column.shape[0]):
        code = int(column[place, 0])
        if code != NOTHING:
            switch(laws, parts, column, code)


@each
def switch_axes(laws, parts, column):
    """Execute the starts and stops that follow the row of one axis of a stage."""
    make_switches(laws, parts, column)


@by_part
def switch_all(step, part, own):
    """Execute the starts and stops of all axes."""


@by_part
def compute(step, part, own):
    """Compute the sample in the columns with the compiled step."""


@by_part
def keep_joints(step, part, numbers):
    """Write the contents of ``joint_states`` that are not in the row."""


@nested
def _switch_alone(step, part, own):
    """Execute the starts and stops of the axis."""
    make_switches(part.laws, part.parts, own.column[0])


@nested
def _compute_alone(step, part, own):
    """Compute a sample of the axis."""
    step(part.laws, part.parts, own.given, own.column[0], own.row[0], WHOLE)


@nested
def _keep_alone(step, part, numbers):
    """Write positions, velocities and efforts of a motor."""
    tell_joints(part.laws, part.parts.plant, numbers)


@nested
def _switch_together(step, part, own):
    """Execute the starts and stops of all axes of the stage."""
    switch_axes(part.laws, part.parts, own.column)


@nested
def _compute_together(step, part, own):
    """Compute a sample of the stage."""
    step(part.laws, part.parts, part.group, own.given, own.column, own.row)


@nested
def _keep_together(step, part, numbers):
    """Do nothing, because the axes of a stage are actuators."""


switch_all.kinds[Alone], switch_all.kinds[Together] = _switch_alone, _switch_together
compute.kinds[Alone], compute.kinds[Together] = _compute_alone, _compute_together
keep_joints.kinds[Alone], keep_joints.kinds[Together] = _keep_alone, _keep_together


@nested
def keep(step, part, own, begun):
    """Write the finished sample into the ring."""
    state = own.state
    slot = state[HEAD] % own.rows.shape[0]
    for i in range(own.rows.shape[1]):
        for j in range(own.rows.shape[2]):
            own.rows[slot, i, j] = own.column[i, j, 0]
    own.times[slot] = begun
    keep_joints(step, part, own.joints[slot % own.joints.shape[0]])


def pace(step, part, own, motor):
    """Run the loop until the last sample, or until the end is requested."""
    state, timespec = own.state, own.timespec
    axes = own.column.shape[0]
    now = clock(timespec)
    if state[ORIGIN] == 0:
        # for the arrays of a stage, calling this function takes milliseconds, so time starts here and not before the
        # call
        state[ORIGIN] = now + LEAD - deadline_of(state)
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
        skipped = 0.0
        state[IN_ROW] += 1
        if state[UNPACED] == 0 and now - deadline >= state[PERIOD] // FEMTO:
            skipped = 1.0
            state[MISSED] += 1
        else:
            state[IN_ROW] = 0
        for i in range(axes):
            own.column[i, at.SKIPPED, 0], own.column[i, at.TRIGGER_IN, 0] = skipped, 0.0
            if motor:
                own.column[i, at.REQUEST, 0] = 0.0
                own.column[i, at.SPEED, 0] = math.nan
            take_setpoint(own, i)
        posted = state[POSTED]
        if posted != state[TAKEN]:
            state[TAKEN] = posted
            for i in range(axes):
                take_post(own, i, motor)
            switch_all(step, part, own)
        note_lateness(state, own.histogram, now - deadline)
        state[AT_WORK] = begun
        compute(step, part, own)
        keep(step, part, own, begun)
        now = clock(timespec)
        spent = now - begun
        state[AT_WORK] = 0
        state[BUSY] += spent
        state[BUSIEST] = max(state[BUSIEST], spent)
        # the preceding call is opaque to the compiler, which therefore cannot move this store before the row is
        # complete
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
    lost: int  #: Number of samples before the first one that were overwritten before they were read.


class Lateness(NamedTuple):
    """Lateness of the samples, including skipped ones, and their computing time."""

    #: p50, p90, p99, p999, max: quantiles and maximum of the lateness [s]; quantiles are accurate to 2 %.
    p50: float
    p90: float
    p99: float
    p999: float
    max: float
    missed: int  #: Number of skipped samples.
    samples: int  #: All samples.
    cost: float  #: cost, highest_cost: mean and largest computing time of a sample [s].
    highest_cost: float
    ahead: float  #: Present time before a deadline at which the thread begins to poll the clock [s].
    looked: float  #: Mean time of polling per sample [s].


class Reader:
    """Reads samples of one axis from the ring, each once, beginning with the next sample."""

    def __init__(self, own: Pace, offset, axis: int = 0):
        self._own = own
        self._offset = offset
        self._axis = axis
        self._next = int(own.state[HEAD])

    def take(self, until: int | None = None) -> Samples:
        """Return all samples since the last call, or only those before number ``until``; the result may be empty."""
        state, rows = self._own.state, self._own.rows
        size = len(rows)
        head = int(state[HEAD])
        if until is not None:
            head = min(head, max(until - int(state[FIRST]), self._next))
        first = max(self._next, head - size)
        places = np.arange(first, head) % size
        table, times = np.ascontiguousarray(rows[places, self._axis].T), self._own.times[places] + self._offset()
        joints = np.ascontiguousarray(self._own.joints[places].T) if self._own.joints.shape[1] else None
        # drop samples that were overwritten during the copy; a part of the next sample may already be in the ring
        whole = min(max(first, int(state[HEAD]) + 1 - size), head)
        lost, self._next = whole - self._next, head
        begin = int(state[FIRST])
        if whole > first:
            table, times = np.ascontiguousarray(table[:, whole - first :]), times[whole - first :]
            joints = None if joints is None else np.ascontiguousarray(joints[:, whole - first :])
        return Samples(begin + whole, table, times, joints, lost)


def latest(own: Pace, axis: int = 0) -> tuple[int, np.ndarray]:
    """Return the number of the last sample and the row of an axis; -1 and NaN before the first sample."""
    state, rows = own.state, own.rows
    while True:
        head = int(state[HEAD])
        row = rows[(head - 1) % len(rows), axis].copy()
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
