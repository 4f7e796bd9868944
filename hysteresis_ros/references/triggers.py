# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Triggers of an axis: events at positions, times, or beginnings of frames, lines or pixels of a scan; trigger input.

A position is passed between two samples. The instant is computed from a cubic through the last four measurements, so
that no later measurement is needed. After an event, a position is *armed* again when the measurement has moved away
from it by a certain distance, on the side from which it is approached, so that noise does not repeat an event. The two
directions of motion are armed separately.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models.block import kernel, nested
from hysteresis_ros.references.approach import ApproachParameters, effective_limits
from hysteresis_ros.references.scan_clock import LEVELS, ScanClock
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters

#: Largest number of positions or times.
MOST = 100_000
#: Distance after which a position is armed again, as a fraction of the smallest distance between two positions.
ARMED_PART = 0.25
#: Distance after which a single position is armed again, as a fraction of the range.
ARMED_RANGE = 0.01
#: Largest number of samples of a waveform that are searched for its longest path in a sample.
SEARCHED = 2**18
#: Actions of the trigger input.
ACTIONS = ("none", "start", "hold", "step")
NOTHING, START, HOLD, STEP_SETPOINT = range(4)


@dataclass(frozen=True)
class TriggerInputParameters(Parameters):
    """Action that a pulse at the trigger input causes."""

    action: str = parameter(
        "none",
        choices=ACTIONS,
        read_only=True,
        description="start: start the waveform, which waits for this; hold: hold the reference, as ~/stop does; "
        "step: add `distance` to the setpoint",
    )
    distance: float = parameter(
        0.0, unit="m", low=-1.0, high=1.0, read_only=True, description="step of the setpoint for the action step"
    )

    def check(self) -> Iterator[Problem]:
        """Yield a Problem for each inconsistency."""
        if (self.action == "step") != (self.distance != 0.0):
            remedy = "must differ from 0" if self.action == "step" else "is only for action: step; give 0"
            yield Problem("distance", self.distance, remedy, "m")


@dataclass(frozen=True)
class TriggerParameters(Parameters):
    """Where or when an axis triggers: only one of positions, start/step/stop, times, and each may be given."""

    positions: tuple[float, ...] = parameter((), unit="m", description="positions that trigger, increasing")
    start: float = parameter(0.0, unit="m", low=-1.0, high=1.0, description="first position of a grid")
    step: float = parameter(0.0, unit="m", low=0.0, high=1.0, description="spacing of the grid; 0: no grid")
    stop: float = parameter(0.0, unit="m", low=-1.0, high=1.0, description="end of the grid, inclusive")
    direction: str = parameter(
        "both", choices=("both", "up", "down"), description="directions of motion in which positions trigger"
    )
    down_positions: tuple[float, ...] = parameter(
        (), unit="m", description="positions that trigger in the motion down, if they differ from those up; increasing"
    )
    rearm: float = parameter(
        0.0,
        unit="m",
        low=0.0,
        high=1.0,
        description="distance beyond a position that arms it again, at least 6 times the RMS noise of the sensor; 0: a "
        "quarter of the smallest distance between positions, or 1 % of the range for a single position",
    )
    times: tuple[float, ...] = parameter(
        (), unit="s", description="times since the beginning of the waveform, increasing"
    )
    each: str = parameter("none", choices=LEVELS, description="trigger at each frame, line or pixel of a scan")
    rate: float = parameter(
        0.0,
        unit="Hz",
        low=0.0,
        high=1.0e6,
        description="highest rate of triggers that the receiver or the output accepts; 0: at most one per sample",
    )
    input: TriggerInputParameters = group(TriggerInputParameters)

    @property
    def up(self) -> tuple[float, ...]:
        """Positions that trigger when the axis moves up [m]."""
        return self._given if self.direction != "down" else ()

    @property
    def down(self) -> tuple[float, ...]:
        """Positions that trigger when the axis moves down [m]."""
        return self.down_positions or (self._given if self.direction != "up" else ())

    @property
    def _given(self) -> tuple[float, ...]:
        if not self.step:
            return self.positions
        count = min(math.floor((self.stop - self.start) / self.step * (1.0 + 1e-12) + 1e-9), MOST)
        return tuple(self.start + k * self.step for k in range(count + 1))

    @property
    def compares(self) -> bool:
        """Whether there are positions that trigger."""
        return bool(self.positions or self.step or self.down_positions)

    @property
    def asked(self) -> bool:
        """Whether the axis has trigger events, or the trigger input has an action."""
        return self.makes_events or self.input.action != "none"

    @property
    def makes_events(self) -> bool:
        """Whether the axis has trigger events."""
        return self.compares or bool(self.times) or self.each != "none"

    @property
    def gap(self) -> float:
        """Smallest distance between two positions for the same direction [m]; infinite for fewer than two positions."""
        return min(float(np.min(np.diff(some), initial=math.inf)) for some in (self.up, self.down))

    def rearmed(self, low: float, high: float) -> float:
        """Return the distance after which a position is armed again [m], for the axis' range ``low`` … ``high`` [m]."""
        gap = self.gap
        return self.rearm or (ARMED_PART * gap if math.isfinite(gap) else ARMED_RANGE * (high - low))

    def check(self) -> Iterator[Problem]:
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        kinds = {"positions": self.positions, "step": self.step, "times": self.times}
        kinds |= {"each": self.each if self.each != "none" else ()}
        there = [name for name, value in kinds.items() if value]
        if len(there) > 1:
            yield Problem(there[1], kinds[there[1]], f"cannot be combined with {there[0]}: give only one of them")
        if self.step and not self.start < self.stop:
            yield Problem("stop", self.stop, f"must be above start = {self.start:g} m", "m")
        elif self.step and (self.stop - self.start) / self.step > MOST:
            yield Problem(
                "step", self.step, f"gives more than {MOST} positions: give a larger step or a shorter grid", "m"
            )
        for name, unit in (("positions", "m"), ("down_positions", "m"), ("times", "s")):
            yield from _order_problems(name, getattr(self, name), unit)
        if self.times and not self.times[0] >= 0.0:
            yield Problem("times", self.times[0], "must not be negative: they count from the waveform's beginning", "s")
        if self.down_positions and self.direction != "both":
            yield Problem("direction", self.direction, "must be both with down_positions")


def makes_triggers(node: Mapping[str, Any]) -> bool:
    """Return whether the parameters of a source, given by dotted names, define a trigger."""
    given = {name: value for name, value in node.items() if name.startswith("triggers.")}
    names = ("positions", "step", "down_positions", "times")
    return any(given.get(f"triggers.{name}") for name in names) or given.get("triggers.each", "none") != "none"


def _order_problems(name: str, values: tuple[float, ...], unit: str) -> Iterator[Problem]:
    """Yield a Problem if values are not finite, do not increase, or are too many."""
    if len(values) > MOST:
        yield Problem(
            name, len(values), f"are more than {MOST}: give fewer, or for positions a grid (start, step, stop)"
        )
    wrong = next((b for a, b in zip(values, values[1:], strict=False) if not b > a), None)
    wrong = next((value for value in values if not math.isfinite(value)), wrong)
    if wrong is not None:
        yield Problem(name, wrong, "must be finite and increase from one to the next", unit)


def longest_path(
    waveform: WaveformParameters, approach: ApproachParameters, span: float, sample_time: float
) -> tuple[float, str]:
    """Return the longest path of the reference within a sample [m], and its cause; 0 if it is not known in advance.

    Units: ``span`` of the reference [m], ``sample_time`` [s].
    """
    velocity = 0.0 if approach.unlimited else effective_limits(approach, span)[0]
    moves = velocity * sample_time if math.isfinite(velocity) else 0.0
    if waveform.type == "hold":
        return moves, "the approach"
    if waveform.shape.jumps and approach.steps:
        return moves, "the approach"
    shape = Waveform(waveform, sample_time)
    count = min(shape.period or shape.duration_samples or SEARCHED, SEARCHED)
    path = shape.simulate(np.zeros(count + 1))
    return float(np.max(np.abs(np.diff(path)))), f"the waveform {waveform.type}"


def trigger_problems(
    given: TriggerParameters,
    low: float,
    high: float,
    sample_rate: float,
    longest: Callable[[], tuple[float, str]],
    waveform: WaveformParameters | None = None,
) -> Iterator[Problem]:
    """Yield a Problem for each impossible trigger: outside the axis' range, or faster than the sample rate allows.

    ``given`` has no inconsistencies; ``low`` and ``high`` are the ends of the range of the reference [m]. ``longest()``
    returns the longest path within a sample [m] and its cause; it is called only if there are positions. ``waveform``
    is None for an axis without waveforms. Units: ``sample_rate`` [Hz].
    """
    step = 1.0 / sample_rate
    for position in (*given.up, *given.down):
        if not low - 1e-12 * (high - low) <= position <= high + 1e-12 * (high - low):
            name, value = "down_positions" if position in given.down_positions else "positions", position
            if given.step and position in given._given:
                name, value = ("start", given.start) if position == given.start else ("stop", given.stop)
            remedy = (
                f"reaches {position:g} m; allowed: {low:g} … {high:g} m (minimum … maximum): trigger within this "
                "range, or widen it"
            )
            yield Problem(f"triggers.{name}", value, remedy, "m")
            return
    least = max(step, 1.0 / given.rate if given.rate else 0.0)
    limit = "a sample" if least == step else f"1/triggers.rate = {least:g} s"
    if given.compares:
        path, mover = longest()
        if given.gap < path * (least / step) * (1.0 - 1e-9):
            name, value = ("step", given.step) if given.step else ("positions", given.gap)
            remedy = (
                f"positions {given.gap:.4g} m apart are closer than the path of {limit}, {path * least / step:.4g} m "
                f"({mover} moves at {path * sample_rate:.4g} m/s): give a larger distance, or move slower"
            )
            yield Problem(f"triggers.{name}", value, remedy, "m")
        rearm = given.rearmed(low, high)
        if math.isfinite(given.gap) and rearm >= given.gap:
            remedy = f"must be below the smallest distance between positions, {given.gap:g} m"
            yield Problem("triggers.rearm", rearm, remedy, "m")
    apart = float(np.min(np.diff(given.times), initial=math.inf))
    if apart < least * (1.0 - 1e-9):
        yield Problem(
            "triggers.times",
            float(f"{apart:.6g}"),
            f"are closer than {limit}: give times at least {least:g} s apart",
            "s",
        )
    if waveform is None and given.times:
        yield Problem(
            "triggers.times",
            given.times[0],
            "count from the beginning of a waveform, but the axis has none: give positions",
            "s",
        )
    if given.each != "none":
        yield from _scan_problems(given.each, waveform, least, limit, step)


def _scan_problems(
    each: str, waveform: WaveformParameters | None, least: float, limit: str, step: float
) -> Iterator[Problem]:
    """Yield a Problem unless the axis follows a scan that is slow enough, and its clock contains the level ``each``."""
    if waveform is None or waveform.type != "scan":
        remedy = "needs a scan: waveform.type: scan; other waveforms have positions and times"
        yield Problem("triggers.each", each, remedy)
    elif LEVELS.index(waveform.scan.clock) < LEVELS.index(each):
        yield Problem("waveform.scan.clock", waveform.scan.clock, f"must be {each} or finer for triggers.each: {each}")
    else:
        from hysteresis_ros.references.waveforms.scan import clock_of

        marks = clock_of(waveform, step).of_level(at.Edge(2 ** (LEVELS.index(each) - 1)))
        apart = float(np.min(np.diff(marks), initial=math.inf)) * step
        if apart < least * (1.0 - 1e-9):
            remedy = f"begin {apart:.4g} s apart, less than {limit}: give fewer {each}s, or a slower scan"
            yield Problem("triggers.each", each, remedy)


# Parameters: distance after which a position is armed again [m], sample time [s], smallest number of samples between
# two events, bit of the scan's edges, action of the trigger input, distance of its step [m], range of the setpoint [m].
REARM, SAMPLE_TIME, SPACING, BIT, ACTION, DISTANCE, LOWEST, HIGHEST = range(8)
# State: number of positions that are not armed for the motion up, and number of positions that are armed for the motion
# down; the last three measurements [m], number of consecutive ones (0 … 3), and number of samples since the last
# measurement; number of events, and of samples since the last event; index of the next time, last sample of the
# waveform; setpoint in force, as given, and as reached by steps (NaN: no steps) [m]; number of refused pulses of the
# trigger input.
ABOVE, BELOW, LAST, BEFORE, OLDER, KNOWN, AGE, NUMBER, SINCE, NEXT, PASSED = range(11)
IN_FORCE, GIVEN, TARGET, REFUSED = range(11, 15)
STATES = 15
#: Largest number of iterations for the instant of an event.
ITERATIONS = 50
#: Change of the instant below which the iterations end, as a fraction of a sample.
CLOSE = 1e-14


class TriggerArrays(NamedTuple):
    """All arrays for the triggers of an axis."""

    p: np.ndarray
    x: np.ndarray
    up: np.ndarray  #: Positions for the motion up [m].
    down: np.ndarray  #: Positions for the motion down [m].
    times: np.ndarray  #: First sample of the waveform at or after each time, and the delay until it [s], shape (N, 2).
    delays: np.ndarray  #: Delay from the exact scan edge to each sample of a period [s]; a single 0: no scan.


def trigger_arrays(
    given: TriggerParameters, rearm: float, initial: float, sample_time: float, clock: ScanClock | None
) -> TriggerArrays:
    """Return the arrays for the triggers of an axis at rest; the caller then sets the range of the setpoint.

    ``rearm`` is the distance after which a position is armed again, ``initial`` the setpoint at the beginning [m], and
    ``clock`` the clock of the scan that the axis follows, or None. Units: ``sample_time`` [s].
    """
    p, x = np.zeros(8), np.zeros(STATES)
    spacing = math.ceil(1.0 / (given.rate * sample_time) - 1e-9) if given.rate else 1
    level = LEVELS.index(given.each)
    bit = 2 ** (level - 1) if level else 0
    action, distance = ACTIONS.index(given.input.action), given.input.distance
    p[:] = rearm, sample_time, spacing, bit, action, distance, -math.inf, math.inf
    samples = np.ceil(np.array(given.times, dtype=float) / sample_time - 1e-6)
    delays = np.maximum(samples * sample_time - np.array(given.times, dtype=float), 0.0)
    times = np.ascontiguousarray(np.column_stack([samples, delays]))
    scan = clock.delays(at.Edge(bit)) if clock is not None and bit else np.zeros(1)
    arrays = TriggerArrays(p, x, np.array(given.up, dtype=float), np.array(given.down, dtype=float), times, scan)
    rest_triggers(arrays, initial)
    return arrays


def rest_triggers(arrays: TriggerArrays, initial: float) -> None:
    """Set triggers to their state at the beginning; ``initial`` is the setpoint [m]."""
    arrays.x[:] = 0.0
    arrays.x[IN_FORCE] = arrays.x[GIVEN] = initial
    arrays.x[TARGET], arrays.x[SINCE] = math.nan, math.inf


@kernel
def crossing(first, last, second, third, position):
    """Return the fraction of a sample at which a cubic from ``first`` to ``last`` [m] reaches a position between them.

    ``second`` and ``third`` are the second and third differences of the last measurements [m]; 0 lowers the
    degree of the polynomial.
    """
    path = last - first
    low, high = 0.0, 1.0
    part = (position - first) / path
    for _ in range(ITERATIONS):  # Newton's method, with bisection where it would leave the interval
        value = first + part * (path + 0.5 * (part - 1.0) * (second + (part + 1.0) * third / 3.0)) - position
        if (value > 0.0) == (path > 0.0):
            high = part
        else:
            low = part
        slope = path + (part - 0.5) * second + (0.5 * part * part - 1.0 / 6.0) * third
        after = part - value / slope if slope != 0.0 else low
        if not low < after < high:
            after = 0.5 * (low + high)
        change, part = abs(after - part), after
        if change < CLOSE:
            break
    return part


@nested
def fire(p, x, row, position, direction, delay):
    """Count an event; write it to the row if it is the sample's first event and the output is ready again."""
    x[NUMBER] += 1.0
    if row[at.TRIGGER] == 0.0 and x[SINCE] >= p[SPACING]:
        row[at.TRIGGER] = x[NUMBER]
        row[at.TRIGGER_POSITION], row[at.TRIGGER_DIRECTION], row[at.TRIGGER_DELAY] = position, direction, delay
        x[SINCE] = 0.0


@nested
def pass_positions(arrays, row, measured):
    """Trigger at positions passed since the last measurement; arm a position again at the distance ``rearm``."""
    p, x, up, down = arrays.p, arrays.x, arrays.up, arrays.down
    i, j = int(x[ABOVE]), int(x[BELOW])
    if x[KNOWN] == 0.0:
        i = j = 0
        while i < up.shape[0] and up[i] <= measured:
            i += 1
        while j < down.shape[0] and down[j] < measured:
            j += 1
    else:
        last, age, rearm = x[LAST], x[AGE], p[REARM]
        second = measured - 2.0 * last + x[BEFORE] if x[KNOWN] >= 2.0 and age == 1.0 else 0.0
        third = measured - 3.0 * last + 3.0 * x[BEFORE] - x[OLDER] if x[KNOWN] >= 3.0 and age == 1.0 else 0.0
        while i < up.shape[0] and measured >= up[i]:
            part = crossing(last, measured, second, third, up[i])
            fire(p, x, row, up[i], 1.0, (1.0 - part) * age * p[SAMPLE_TIME])
            i += 1
        while i > 0 and measured < up[i - 1] - rearm:
            i -= 1
        while j > 0 and measured <= down[j - 1]:
            part = crossing(last, measured, second, third, down[j - 1])
            fire(p, x, row, down[j - 1], -1.0, (1.0 - part) * age * p[SAMPLE_TIME])
            j -= 1
        while j < down.shape[0] and measured > down[j] + rearm:
            j += 1
    x[ABOVE], x[BELOW] = i, j


@nested
def pass_instant(p, x, row, measured, delay):
    """Trigger at an instant ``delay`` [s] before the sample; the position is interpolated between two measurements."""
    position, moved = math.nan, 0.0
    if measured == measured and x[KNOWN] > 0.0:
        moved = measured - x[LAST]
        position = measured - moved * min(delay / (x[AGE] * p[SAMPLE_TIME]), 1.0)
    elif measured == measured:
        position = measured
    direction = 1.0 if moved > 0.0 else -1.0 if moved < 0.0 else 0.0
    fire(p, x, row, position, direction, delay)


@nested
def compare(arrays, row):
    """Detect the trigger of a sample from the measurement and the waveform's sample number, and write it to ``row``.

    While the plant has stopped the axis, there are no triggers. Afterwards, the position of the axis determines which
    positions are armed.
    """
    p, x = arrays.p, arrays.x
    x[SINCE] += 1.0
    x[AGE] += 1.0
    measured = row[at.MEASURED]
    known = measured - measured == 0.0 and row[at.SKIPPED] == 0.0
    if row[at.TRIPPED] != 0.0:
        x[KNOWN] = 0.0
        return
    if known:
        pass_positions(arrays, row, measured)
    k = row[at.WAVEFORM_SAMPLE]
    if k < x[PASSED]:
        x[NEXT] = 0.0
    x[PASSED] = k
    while x[NEXT] < arrays.times.shape[0] and k >= 0.0 and arrays.times[int(x[NEXT]), 0] <= k:
        late = k - arrays.times[int(x[NEXT]), 0]
        delay = arrays.times[int(x[NEXT]), 1] + late * p[SAMPLE_TIME]
        pass_instant(p, x, row, measured if known else math.nan, delay)
        x[NEXT] += 1.0
    if p[BIT] != 0.0 and (int(row[at.SCAN_EDGES]) & int(p[BIT])) != 0:
        delay = arrays.delays[int(k % arrays.delays.shape[0])]
        pass_instant(p, x, row, measured if known else math.nan, delay)
    if known:
        x[KNOWN] = min(x[KNOWN] + 1.0, 3.0) if x[AGE] == 1.0 else 1.0
        x[OLDER], x[BEFORE], x[LAST], x[AGE] = x[BEFORE], x[LAST], measured, 0.0


@nested
def step_setpoint(arrays, row):
    """Add a step to the setpoint at a pulse of the trigger input; the user's next setpoint replaces the result."""
    p, x = arrays.p, arrays.x
    if row[at.SETPOINT] != x[GIVEN]:
        x[GIVEN] = row[at.SETPOINT]
        x[TARGET] = math.nan
    if row[at.TRIGGER_IN] > 0.0 and row[at.TRIPPED] == 0.0:
        target = x[IN_FORCE] + row[at.TRIGGER_IN] * p[DISTANCE]
        if p[LOWEST] <= target <= p[HIGHEST]:
            x[TARGET] = target
        else:
            x[REFUSED] += row[at.TRIGGER_IN]
    if x[TARGET] == x[TARGET]:
        row[at.SETPOINT] = x[TARGET]
