# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The fused runner: one compiled thread runs an axis or a stage against absolute deadlines.

Other threads control the loop. Between two samples, the compiled code accepts setpoints, and starts or stops parts. For
any other change the loop pauses between two samples while the calling thread makes the change. Every change is logged
with its sample, so an :class:`~hysteresis_ros.loop.axis.Axis` or a :class:`~hysteresis_ros.loop.stage.Stage` with the
same setpoints, changes and skipped samples gives the same bits. All axes of a stage have one clock and skip the same
samples.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import gc
import math
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros import signals
from hysteresis_ros.configuration import Parameters
from hysteresis_ros.errors import ConfigurationError, LoopError, ParameterError
from hysteresis_ros.loop import pacing as at
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.pacing import (
    CODES,
    Alone,
    Lateness,
    Pace,
    Reader,
    Samples,
    Together,
    lateness,
    latest,
    pace,
    switched,
)
from hysteresis_ros.loop.parameters import SPIN_PART, AxisParameters, PlantNodeParameters, RealtimeParameters
from hysteresis_ros.loop.stage import Stage, stage_ticks
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.tick import WHOLE, ticks
from hysteresis_ros.models.block import COMPILED, specialised

#: Switch interval of Python's threads while the loop waits for another thread [s].
TURN = 5e-4

_TIMER_SLACK = 29
_LOCK_PRESENT_AND_FUTURE = 3


def ask_for(parameters: RealtimeParameters) -> str:
    """Set priority and core of the calling thread, lock the process in RAM; return a text with the refused settings."""
    library = ctypes.CDLL(None, use_errno=True)
    # without this the kernel may delay the wake-up of a thread without priority by 50 µs to save energy
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
    return f"continues without {'; without '.join(refused)}" if refused else ""


def has_priority() -> bool:
    """Whether the calling thread has a real-time priority."""
    return hasattr(os, "sched_getscheduler") and bool(os.sched_getparam(0).sched_priority)


#: Upper limit of the automatic time before a deadline at which polling of the clock begins [ns].
LONGEST_SPIN = 100_000
#: Name of the claims of cores for polling the clock, the same in all processes; there is one claim less than cores.
CLAIM = "hysteresis_ros/looks"
#: While this file is open, the processor uses only sleep states with at most the wake-up latency [µs] written to it.
_DMA_LATENCY = "/dev/cpu_dma_latency"


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def claim_of_a_core() -> socket.socket | None:
    """Claim a core on which a loop may poll the clock; return the claim, or None if no core is free.

    The caller closes the claim. Together the loops of all processes on this machine leave one core for other work.
    """
    for index in range(usable_cores() - 1):
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0{CLAIM}/{index}")  # abstract socket: no file, and freed when the process exits
        except OSError:
            claim.close()
        else:
            return claim
    return None


def require_spin(spin: float) -> None:
    """Refuse polling of the clock for ``spin`` [s] if the loop would take the core that the nodes need."""
    if spin <= 0.0:
        return
    what = f"realtime.spin = {spin:g} s"
    instead = "give 0 (off) or -1 (automatic, off here)"
    if not COMPILED:
        raise ConfigurationError(
            f"{what}: without Numba no other thread of Python runs while the loop polls the clock; {instead}, or "
            "install Numba (the extra [fast])"
        )
    if usable_cores() < 2:
        raise ConfigurationError(
            f"{what}: this process may use a single core, on which the nodes wait while the loop polls the clock; "
            f"{instead}, or permit a second core"
        )
    claim = claim_of_a_core()
    if claim is None:
        raise ConfigurationError(
            f"{what}: other loops poll the clock on all but one of the {usable_cores()} cores, and the nodes need "
            f"that one; {instead}, or end another fused axis"
        )
    claim.close()


@contextlib.contextmanager
def shallow_sleep():
    """Keep the processor out of deep sleep states, from which it wakes slowly; yield whether this is permitted."""
    with contextlib.ExitStack() as stack:
        held = None
        with contextlib.suppress(OSError):
            held = stack.enter_context(open(_DMA_LATENCY, "wb", buffering=0))
            held.write(bytes(4))  # 0 µs
        yield held is not None


def boost(parameters: RealtimeParameters) -> None:
    """Set the priority of the calling thread just below that of the loop's thread, if permitted."""
    if parameters.priority:
        priority = os.sched_param(max(parameters.priority - 1, 1))
        with contextlib.suppress(AttributeError, OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, priority)


@contextlib.contextmanager
def boosted(parameters: RealtimeParameters):
    """Run just below the priority of the loop's thread, if permitted, so that the loop is first on a shared core."""
    before = None
    with contextlib.suppress(AttributeError, OSError):
        before = os.sched_getscheduler(0), os.sched_getparam(0)
    boost(parameters)
    try:
        yield
    finally:
        if before is not None:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, *before)


@contextlib.contextmanager
def undisturbed():
    """Run without the garbage collector and with the shortest switch interval of Python's threads."""
    collects, interval = gc.isenabled(), sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(TURN)
    time.sleep(0.0)  # so that threads that wait for the interpreter lock use the new interval
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        if collects:
            gc.enable()


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or "this system does not support it"


#: Sample rate that the loop sustains without Numba [Hz]: a sample of a motor takes up to 0.4 ms, and another thread of
#: Python may hold the interpreter for 5 ms, one period at this rate.
INTERPRETED_RATE = 200.0
#: Time for which samples are kept for readers [s].
KEPT = 5.0
#: Minimum number of samples that are kept for readers.
LEAST_KEPT = 4096
#: Maximum number of samples that are kept for readers.
MOST_KEPT = 2**18
#: Time allowed for a suspended process to continue [s].
WAKING = 0.02
#: Interval of the checks whether the loop has accepted a request [s].
LOOK = 2e-4
#: Longest busy wait for the loop to pause [s]. After this time the waiting thread sleeps between checks; a sleep may
#: take 5 ms if another thread runs.
HASTE = 2e-3


def pace_arrays(axis: Axis | Stage, factor: float = math.inf, samples: int = 0) -> Pace:
    """Return the arrays of a loop that continues with the next sample of an axis or a stage."""
    axes = axis.axes
    size = len(axis.kind.row)
    rate = axis.sample_rate * (factor if math.isfinite(factor) else 1.0)
    kept = min(max(math.ceil(KEPT * rate), LEAST_KEPT), MOST_KEPT)
    state = np.zeros(at.STATES, dtype=np.int64)
    state[at.SAMPLE] = state[at.FIRST] = axis.sample
    state[at.UNTIL] = axis.sample + samples if samples else 0
    state[at.PERIOD] = round(1e15 / rate)
    state[at.UNPACED] = not math.isfinite(factor)
    schedule = np.concatenate([np.insert(one.source.schedule, 2, i, axis=1) for i, one in enumerate(axes)])
    return Pace(
        state,
        np.zeros((len(axes), at.COUNTS), dtype=np.int64),
        axis.given,
        np.zeros((len(axes), size + at.MOST_SWITCHES, 1)),
        np.zeros((len(axes), size)),
        np.ascontiguousarray(schedule[np.argsort(schedule[:, 0], kind="stable")]),
        np.zeros((at.POSTS, len(axes), at.POST)),
        np.zeros((at.EVENTS, 3), dtype=np.int64),
        np.zeros(at.BINS, dtype=np.int64),
        np.full((kept, len(axes), size), math.nan),  # written once, so that the memory is allocated before the run
        np.full(kept, -1, dtype=np.int64),
        np.full((kept, sum(one.plant.joint_numbers for one in axes)), math.nan),
        np.zeros(2, dtype=np.int64),
    )


def machine(axis: Axis | Stage, own: Pace):
    """Return the compiled loop of an axis or a stage, and its arguments."""
    part: Alone | Together
    if isinstance(axis, Stage):
        part = Together(axis.laws, axis.parts, axis.group)
        step = specialised(stage_ticks, *part, own.given, own.column, own.row)
    else:
        part = Alone(axis.laws, axis.parts)
        step = specialised(ticks, *part, own.given, own.column[0], own.row[0], WHOLE)
    arguments = step, part, own, int(axis.kind.motor)
    return specialised(pace, *arguments), arguments


class FusedLoop:
    """Runs an axis, or all axes of a stage, in a thread of its own.

    All methods may be called from any thread. While the loop runs, nothing else may run or change the axis. For an axis
    of a stage, methods take its index among the axes (``place``); a single axis has index 0.
    """

    def __init__(
        self,
        axis: Axis | Stage,
        factor: float = 1.0,
        samples: int = 0,
        warn: Callable[[str], object] | None = None,
    ):
        rate = axis.sample_rate * factor
        if not COMPILED and INTERPRETED_RATE < rate < math.inf:
            raise ConfigurationError(
                f"sample_rate = {axis.sample_rate:g} Hz at real_time_factor {factor:g}: without Numba the fused loop "
                f"reaches only {INTERPRETED_RATE:g} samples per second; install Numba (the extra [fast]), or lower "
                "sample_rate or real_time_factor"
            )
        require_spin(axis.axes[0].parameters.plant_simulator.realtime.spin)
        self.axis = axis
        self.failure = self.warning = ""
        self._warn = warn
        self._own = pace_arrays(axis, factor, samples)
        self._state = self._own.state
        self._asked = np.zeros((len(axis.axes), at.POST))
        self._offset = 0
        self._posting = threading.Lock()
        self._changing = threading.Lock()
        self._log: list[tuple[int, int, int, Change]] = []
        self._events_read = 0
        self._ending = False
        self._thread: threading.Thread | None = None
        self._over = threading.Event()
        self._double = copy.deepcopy(axis)
        self._double_own = pace_arrays(self._double)
        self._reader = self.reader()
        self._rehearse(0, None)

    # -- beginning and end ---------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin with the next sample."""
        if self.running:
            raise RuntimeError("the loop is already running")
        self._ending = False
        self._state[at.LEAVE] = self._state[at.ORIGIN] = 0
        self._offset = time.time_ns() - time.monotonic_ns()
        self._over.clear()
        self._thread = threading.Thread(target=self._run, name="fused loop", daemon=True)
        self._thread.start()
        while not (self._state[at.ORIGIN] or self._over.wait(LOOK)):
            pass

    @property
    def origin(self) -> int:
        """Deadline of sample 0 [ns since 1970]; known after the start."""
        return int(self._state[at.ORIGIN]) + self._offset

    @property
    def running(self) -> bool:
        """Whether the thread runs."""
        return self._thread is not None and self._thread.is_alive()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the last sample, or until the time-out [s] has passed; return whether the thread has ended."""
        if self._thread is not None:
            self._thread.join(timeout)
        return not self.running

    def leave(self) -> bool:
        """End after the present sample; return whether the thread has ended: False if a device blocks it."""
        self._ending = True
        self._state[at.LEAVE] = 1
        while not self.is_blocked:
            if self.join(self.patience):
                return True
        return False

    @property
    def patience(self) -> float:
        """Duration of a sample after which a device counts as blocked [s]."""
        return max(one.plant.patience for one in self.axis.axes)

    @property
    def is_blocked(self) -> bool:
        """Whether a device has not returned from the present sample for :attr:`patience` seconds."""
        begun = int(self._state[at.AT_WORK])
        if not begun or time.monotonic_ns() - begun < 1e9 * self.patience or not self.running:
            return False
        time.sleep(WAKING)  # the process itself may have been suspended
        return int(self._state[at.AT_WORK]) == begun

    @property
    def _realtime(self) -> RealtimeParameters:
        return self.axis.axes[0].parameters.plant_simulator.realtime

    @contextlib.contextmanager
    def _ahead(self):
        """Let the thread poll the clock before deadlines, as the parameters require and the machine permits."""
        state, spin = self._state, self._realtime.spin
        state[at.AHEAD] = state[at.MOST_AHEAD] = 0
        automatic = spin < 0.0 and COMPILED and has_priority()
        claim = claim_of_a_core() if (spin > 0.0 or automatic) and not state[at.UNPACED] else None
        if claim is None:
            yield
            return
        if automatic:
            state[at.MOST_AHEAD] = min(round(SPIN_PART * 1e-6 * state[at.PERIOD]), LONGEST_SPIN)
            state[at.WAKE] = at.FIRST_WAKE
            state[at.AHEAD] = min(at.FIRST_WAKE, int(state[at.MOST_AHEAD]))
        else:
            state[at.AHEAD] = round(1e9 * spin)
        with claim, shallow_sleep():
            yield

    def _run(self) -> None:
        """Run the loop until the end; the thread's main function."""
        try:
            self.warning = ask_for(self._realtime)
            if self.warning and self._warn is not None:
                self._warn(self.warning)
            with self._ahead():
                self._run_loop()
        except Exception as error:
            self.failure = f"the fused loop ended at sample {self.sample}: {type(error).__name__}: {error}"
        finally:
            self._over.set()
            self.axis.sample = self.sample

    def _run_loop(self) -> None:
        """Run the compiled loop, and restart it each time a part has been replaced."""
        state = self._state
        while True:
            run, arguments = machine(self.axis, self._own)
            run(*arguments)
            if not state[at.LEAVE] or self._ending:
                return
            state[at.LEAVE] = 0  # continue with the replaced parts

    # -- requests and changes --------------------------------------------------------------------------------------

    def set(
        self,
        setpoint: float | None = None,
        request: float | None = None,
        speed: float | None = None,
        place: int = 0,
    ) -> None:
        """Request a setpoint [m], a motor's request or speed for the next sample; None: no change.

        Of several requests in one sample, the last is used.
        """
        if not self.axis.kind.motor and (request is not None or speed is not None):
            raise ValueError("request and speed: only the axis of an inchworm motor accepts them")
        places = at.POST_SETPOINT, at.POST_REQUEST, at.POST_SPEED
        self._post({place: dict(zip(places, (setpoint, request, speed), strict=True))})

    def set_together(self, setpoints: Mapping[int, float]) -> None:
        """Request setpoints [m] of several axes, by index, for the same sample."""
        self._post({place: {at.POST_SETPOINT: value} for place, value in setpoints.items()})

    def pulse(self, place: int = 0) -> None:
        """Give the trigger input of an axis a pulse in the next sample."""
        self._post({place: {at.POST_PULSES: None}})

    def halt(self) -> None:
        """Stop all parts in the next sample; the plants stay safe until all stopped parts are started again."""
        self._post({place: {at.POST_HALTS: None} for place in range(len(self._asked))})

    def apply(self, change: Change, places: Sequence[int] = (0,)) -> int:
        """Make a change, wait until it is done, and return the first sample to which it applies."""
        return self.apply_together({place: change for place in places})

    def apply_together(self, changes: Mapping[int, Change]) -> int:
        """Make one change to each of several axes, by index, before the same sample; return its number."""
        with self._changing:
            switches = {place: (change.node, change.action) for place, change in changes.items()}
            sample = None
            if self.running and all(switch in CODES for switch in switches.values()):
                sample = self._switch({place: CODES[switch] for place, switch in switches.items()})
            if sample is None:
                sample = self._change(changes)
        if self.failure:
            raise LoopError(self.failure)
        return sample

    def _post(self, given: Mapping[int, Mapping[int, float | None]]) -> None:
        """Post requests to axes; in a post, each value is followed by the number of times that it has been set."""
        asked = self._asked
        with self._posting:
            for place, values in given.items():
                for column, value in values.items():
                    if column in (at.POST_HALTS, at.POST_PULSES):
                        asked[place, column] += 1
                    elif value is not None:
                        asked[place, column] = value
                        asked[place, column + 1] += 1
            number = int(self._state[at.POSTED]) + 1
            self._own.posts[number % at.POSTS] = asked
            self._state[at.POSTED] = number

    def _switch(self, codes: Mapping[int, int]) -> int | None:
        """Start or stop parts; return the first affected sample, or None if the thread has ended before."""
        self._post({place: {at.POST_SWITCH: code} for place, code in codes.items()})
        counts, places = self._own.counts, list(codes)
        wanted = self._asked[places, at.POST_SWITCHES]
        while np.any(counts[places, at.SWITCHED] != wanted):
            if self.join(LOOK) and np.any(counts[places, at.SWITCHED] != wanted):
                counts[places, at.SWITCHED] = wanted
                return None
            self._refuse_blocked()
        self._read_events()
        found = (
            sample
            for sample, order, place, change in reversed(self._log)
            if order and codes.get(place) == CODES[change[1:3]]
        )
        return next(found)

    def _change(self, changes: Mapping[int, Change]) -> int:
        """Apply changes between two samples; return the first sample to which they apply."""
        parameters = {place: self._rehearse(place, change) for place, change in changes.items()}
        before = self.axis.laws, self.axis.parts
        with self._between_samples():
            sample = self.sample
            for place, change in changes.items():
                if change.action == "retune":
                    self._retune(place, change.node, parameters[place])
                else:
                    self.axis.apply(change, place)
                self._log.append((sample, 0, place, Change(sample, change.node, change.action, change.parameters)))
            if not _same(before, (self.axis.laws, self.axis.parts)):
                self._state[at.LEAVE] = 1
        return sample

    def _retune(self, place: int, node: str, parameters) -> None:
        part = self.axis.axes[place].by_node[node]
        try:
            part.retune(parameters)
        except Exception:
            # the copy already contains the failed change, so its previous parameters are restored
            with contextlib.suppress(ParameterError):
                self._double.axes[place].by_node[node].retune(part.parameters)
            raise

    @contextlib.contextmanager
    def _between_samples(self):
        """Pause the loop between two samples; meanwhile the calling thread runs just below the priority of the loop."""
        state = self._state
        wanted = int(state[at.PAUSE]) + 1
        with boosted(self._realtime), undisturbed():
            hasty = time.monotonic() + HASTE
            state[at.PAUSE] = wanted
            try:
                while state[at.PAUSED] != wanted and self.running:
                    if time.monotonic() > hasty:
                        time.sleep(LOOK)
                        self._refuse_blocked()
                yield
            finally:
                state[at.RESUMED] = wanted

    def _refuse_blocked(self) -> None:
        """Raise a LoopError if a blocked device prevents changes."""
        if self.is_blocked:
            raise LoopError(
                f"the device has not returned from sample {self.sample} for {self.patience:g} s: the change is refused"
            )

    def _rehearse(self, place: int, change: Change | None) -> Parameters | None:
        """Apply a change to a copy of the axis and run the copy, so that errors and compilation occur outside the loop.

        Returns the new, checked parameters of the part.
        """
        double = self._double
        _copy_states(self.axis.parts, double.parts)
        if change is not None:
            double.apply(change, place)
        own = self._double_own
        own.state[at.UNTIL] = own.state[at.SAMPLE] + 1
        own.column[:, signals.SETPOINT] = self._own.column[:, signals.SETPOINT]
        run, arguments = machine(double, own)
        run(*arguments)
        return None if change is None else double.axes[place].by_node[change.node].parameters

    # -- results -------------------------------------------------------------------------------------------------

    @property
    def rate(self) -> float:
        """Samples per second of the wall clock [Hz]."""
        return 1e15 / int(self._state[at.PERIOD])

    @property
    def sample(self) -> int:
        """Number of the next sample."""
        return int(self._state[at.SAMPLE])

    @property
    def missed(self) -> int:
        """Skipped samples so far."""
        return int(self._state[at.MISSED])

    @property
    def changes(self) -> list[Change]:
        """Changes of the first axis so far, in the order of the samples, for :meth:`Axis.run`."""
        return self.changes_of(0)

    def changes_of(self, place: int) -> list[Change]:
        """Return the changes of one axis so far, in the order of the samples."""
        self._read_events()
        return [entry[3] for entry in sorted(self._log, key=lambda entry: entry[:2]) if entry[2] == place]

    def _read_events(self) -> None:
        """Move the starts and stops that the compiled code has executed into the log."""
        with self._posting:
            count = int(self._state[at.EVENT_COUNT])
            for index in range(self._events_read, count):
                sample, code, place = map(int, self._own.events[index % at.EVENTS])
                for node, action in switched(code, self.axis.kind.nodes):
                    self._log.append((sample, 1, place, Change(sample, node, action)))
            self._events_read = count

    def reader(self, place: int = 0) -> Reader:
        """Return a reader of the samples of one axis in the ring, beginning with the next sample."""
        return Reader(self._own, lambda: self._offset, place)

    def take(self) -> Samples:
        """Return all samples of the first axis since the last call."""
        return self._reader.take()

    def latest(self, place: int = 0) -> tuple[int, np.ndarray]:
        """Return number and row of the last sample; -1 and NaN before the first sample."""
        return latest(self._own, place)

    def lateness(self) -> Lateness:
        """Return the lateness of the samples so far."""
        return lateness(self._own)


def _copy_states(source, target) -> None:
    """Copy the contents of all arrays of named tuples."""
    for one, other in zip(source, target, strict=True):
        if isinstance(one, tuple):
            _copy_states(one, other)
        else:
            other[...] = one


def _same(one, other) -> bool:
    """Tell whether two named tuples hold the same objects."""
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return one is other


#: A rate is sustained only if 99 % of the samples begin less than this after the deadline, as a fraction of a period.
LATEST = 0.5
#: A rate is sustained only if the skipped samples are less than this fraction of all samples.
MOST_SKIPPED = 0.005
#: Number of batches that measure the computing time of a sample; the fastest batch is used.
BATCHES = 5
#: Number of samples per batch.
BATCH = 100


class Trial(NamedTuple):
    """Result of a trial of the loop at a rate."""

    rate: float  #: Samples per second [Hz].
    lateness: Lateness  #: Lateness of the samples, and number of skipped samples.
    warning: str  #: Requests that the operating system refused; empty without a refusal.

    @property
    def is_held(self) -> bool:
        """Whether the machine sustains this rate."""
        late = self.lateness
        return late.p99 * self.rate < LATEST and late.missed < MOST_SKIPPED * late.samples


def at_rest(parameters: AxisParameters | StageParameters) -> Axis | Stage:
    """Return a simulated axis or stage at rest."""
    return Stage(parameters) if isinstance(parameters, StageParameters) else Axis(parameters)


def trial(parameters: AxisParameters, seconds: float, priority: int) -> Trial:
    """Run the fused loop of an axis for ``seconds`` [s] in real time, and return its timing."""
    plant = parameters.plant_simulator
    realtime = replace(plant.realtime, priority=priority)
    # lateness on a busy machine must not end the trial
    asked = replace(parameters, plant_simulator=replace(plant, realtime=realtime, late_limit=-1))
    loop = FusedLoop(Axis(asked), samples=max(round(seconds * plant.sample_rate), 1))
    loop.start()
    try:
        loop.join()
    finally:
        loop.leave()  # also after an interrupt
    if loop.failure:
        raise ConfigurationError(loop.failure)
    return Trial(plant.sample_rate, loop.lateness(), loop.warning)


def tick_cost(parameters: AxisParameters | StageParameters) -> float:
    """Return the computing time of a sample [s] with simulated plants on this machine, in the fastest batch."""
    axis = at_rest(parameters)
    found = []
    for _ in range(BATCHES):
        own = pace_arrays(axis)
        own.state[at.UNTIL] = own.state[at.SAMPLE] + BATCH
        run, arguments = machine(axis, own)
        run(*arguments)
        found.append(lateness(own).cost)
    return min(found)


def require_speed(parameters: AxisParameters | StageParameters) -> None:
    """Before anything moves, refuse an axis or a stage whose samples take longer than a period."""
    first = parameters.axes[0] if isinstance(parameters, StageParameters) else parameters
    plant: PlantNodeParameters = first.plant_simulator
    if plant.realtime.force or plant.driver or not COMPILED:
        return  # the response time of a device is not yet known; without Numba, INTERPRETED_RATE is the limit
    rate, cost = plant.sample_rate * plant.real_time_factor, tick_cost(parameters)
    if cost * rate > 1.0:
        raise ConfigurationError(
            f"sample_rate = {plant.sample_rate:g} Hz at real_time_factor {plant.real_time_factor:g}: a sample takes "
            f"{1e6 * cost:.3g} µs on this machine, so the limit is {1.0 / cost:.3g} samples/s; lower sample_rate or "
            "real_time_factor, or run it nevertheless with --force (realtime.force: true)"
        )
