# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fault injection: replaces the inputs of the parts of the loop.

A fault is written ``NAME:START:DURATION[:VALUE]``; start and duration are in seconds of the axis' own time, and some
kinds have a value. Faults are parameters of the axis (``faults``, under ``/**``), so the nodes, the offline twin and
the recording contain them. A run with faults can be repeated bit for bit like any other run.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.models.block import called, kernel, nested
from hysteresis_ros.models.sensor import generator_state, uniform

# Targets of a fault.
MEASUREMENT, APPLIED, COMMAND, VOLTAGE, GRIP, STOP, FORCE = range(7)

# Actions of a fault on its target.
LOST, SPIKE, FREEZE, DELAY, DROP, ADD, DISORDER, SCALE, SET = range(9)

#: Interval of the spikes [samples].
SPIKE_PERIOD = 10
#: Longest delay [samples].
LONGEST_DELAY = 10000


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault."""

    target: int  #: target, action: affected signal, and effect on it.
    action: int
    description: str
    value: float | None = None  #: Default of the value; None: the fault has no value.
    unit: str = ""  #: Unit of the value.
    low: float = -math.inf  #: low, high: Range of the value.
    high: float = math.inf
    motor: bool = False  #: Whether only an inchworm motor can have this fault.


FAULTS = {
    "stale": FaultKind(MEASUREMENT, LOST, "no measurement arrives"),
    "nan": FaultKind(MEASUREMENT, LOST, "the measurement is not a number"),
    "spike": FaultKind(MEASUREMENT, SPIKE, f"the value is added to one measurement in {SPIKE_PERIOD}", 1e-6, "m"),
    "frozen": FaultKind(MEASUREMENT, FREEZE, "the measurement stays at its first value during the fault"),
    "late": FaultKind(
        MEASUREMENT, DELAY, "the measurement is delayed by VALUE samples", 1.0, "samples", 1, LONGEST_DELAY
    ),
    "drop": FaultKind(
        MEASUREMENT, DROP, "the fraction VALUE of the measurements is missing, at random", 0.3, "1", 0.0, 1.0
    ),
    "offset": FaultKind(MEASUREMENT, ADD, "the value is added to the measurement", 1e-6, "m"),
    "disorder": FaultKind(
        MEASUREMENT, DISORDER, "every second measurement repeats the previous measurement, with its old stamp"
    ),
    "unanswered": FaultKind(APPLIED, LOST, "the controller does not receive the achieved command"),
    "lost_command": FaultKind(COMMAND, LOST, "no command reaches the compensator"),
    "lost_voltage": FaultKind(VOLTAGE, LOST, "no voltage reaches the plant"),
    "late_voltage": FaultKind(
        VOLTAGE, DROP, "the fraction VALUE of the voltages is late, at random", 0.5, "1", 0.0, 1.0
    ),
    "lost_grip": FaultKind(
        GRIP, SCALE, "the front clamp grips with the fraction VALUE of its force", 0.0, "1", 0.0, 1.0, motor=True
    ),
    "lost_force": FaultKind(FORCE, LOST, "the force sensor gives no value"),
    "stop": FaultKind(STOP, SET, "the controller is stopped, and started again at the end"),
}


@dataclass(frozen=True)
class Fault:
    """One fault of a run; ``str`` returns its form in commands and parameter files, ``NAME:START:DURATION[:VALUE]``.

    Parameters
    ----------
    name : str
        Name of the fault, such as ``stale`` or ``offset``; ``docs/topics.md`` lists them.
    start : float
        Start [s], in the time of the axis; at least 0.
    duration : float
        Duration [s], more than 0.
    value : float, optional
        Value in the unit of the fault (``offset`` and ``spike`` [m], ``late`` [samples], for other faults a fraction);
        the default depends on the kind of fault. Some kinds have no value.

    Raises
    ------
    ConfigurationError
        The fault does not exist, or a number is out of range; the message states what is allowed.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> str(hr.Fault("offset", 0.01, 0.005, 2e-7))
    'offset:0.01:0.005:2e-07'
    >>> run = hr.simulate("kim2009", duration=0.02, faults=[hr.Fault("stale", 0.01, 0.005)])
    """

    name: str
    start: float
    duration: float
    value: float | None = None

    def __post_init__(self):
        """Check the numbers and fill in the default value of the kind."""
        given = {"start": self.start, "duration": self.duration}
        if self.value is not None:
            given["value"] = self.value
        for name, number in given.items():
            if isinstance(number, bool) or not isinstance(number, (int, float, np.integer, np.floating)):
                raise ConfigurationError(f"fault '{self.name}': {name} = {number!r}: must be a number")
            object.__setattr__(self, name, float(number))
        object.__setattr__(self, "value", checked_value(str(self), self.name, self.start, self.duration, self.value))

    @property
    def kind(self) -> FaultKind:
        """Kind of the fault."""
        return FAULTS[self.name]

    @property
    def amount(self) -> float:
        """Value in the unit of the fault; 0 if the fault has no value."""
        return self.value or 0.0

    def __str__(self) -> str:
        numbers = [self.start, self.duration] + ([] if self.value is None else [self.value])
        return ":".join([str(self.name), *(repr(number).removesuffix(".0") for number in numbers)])


def checked_value(text: str, name: str, start: float, duration: float, value: float | None) -> float | None:
    """Return the value of a fault, by default that of its kind; None if the kind has no value."""
    if name not in FAULTS:
        close = difflib.get_close_matches(str(name), FAULTS, n=1, cutoff=0.5)
        hint = f"did you mean {close[0]}? " if close else ""
        raise ConfigurationError(f"fault '{text}': there is no fault '{name}'; {hint}there are: {', '.join(FAULTS)}")
    kind = FAULTS[name]
    if not all(math.isfinite(number) for number in (start, duration, value or 0.0)):
        raise ConfigurationError(f"fault '{text}': {FORM}")
    if start < 0.0 or duration <= 0.0:
        raise ConfigurationError(f"fault '{text}': START must be ≥ 0 and DURATION > 0 s")
    if kind.value is None:
        if value is not None:
            raise ConfigurationError(f"fault '{text}': {name} has no VALUE; write {name}:START:DURATION")
        return None
    value = kind.value if value is None else value
    if not kind.low <= value <= kind.high or (kind.action == DELAY and value != int(value)):
        allowed = f"{kind.low:g} … {kind.high:g} {kind.unit if kind.unit != '1' else ''}".strip()
        raise ConfigurationError(f"fault '{text}': VALUE must be within {allowed}")
    return value


#: Form of a fault, for messages.
FORM = "write NAME:START:DURATION[:VALUE], times in seconds, for instance stale:0.1:0.05"


def parse_fault(text: str, sample_rate: float | None = None, motor: bool = True) -> Fault:
    """Read ``NAME:START:DURATION[:VALUE]``.

    Units: ``sample_rate`` [Hz].
    """
    name, *words = text.split(":")
    if name in FAULTS:
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            raise ConfigurationError(f"fault '{text}': {FORM}") from None
        if not 2 <= len(numbers) <= 3:
            raise ConfigurationError(f"fault '{text}': {FORM}")
    else:
        numbers = [0.0, 1.0]
    value = numbers[2] if len(numbers) == 3 else None
    value = checked_value(text, name, numbers[0], numbers[1], value)
    kind = FAULTS[name]
    if sample_rate is not None and numbers[1] * sample_rate < 0.5:
        raise ConfigurationError(
            f"fault '{text}': DURATION is shorter than a sample; give at least {1.0 / sample_rate:.6g} s"
        )
    if kind.motor and not motor:
        raise ConfigurationError(f"fault '{text}': only an inchworm motor can have this fault")
    return Fault(name, numbers[0], numbers[1], value)


def unreached(faults: Iterable[str], samples: int, sample_rate: float) -> list[str]:
    """Return a warning for each fault that begins after the end of a run, at ``sample_rate`` [Hz]."""
    end = samples / sample_rate
    return [
        f"fault '{text}': begins after the end of the run, {end:.6g} s, and has no effect; begin it earlier, or give a "
        "longer duration"
        for text in faults
        if round(parse_fault(text).start * sample_rate) >= samples
    ]


# Parameter array: number of faults, length of the ring; then five numbers for each fault.
COUNT, RING_LENGTH = 0, 1
ENTRIES = 2
TARGET, KIND, FIRST, BEYOND, VALUE = range(5)  # target, action, first sample, first sample after the fault, value
ENTRY = 5

# State array: number of samples so far, sample number of the measurement, frozen value, state of the random generator;
# then a ring of the last measurements.
SAMPLES, STAMP, FROZEN_AT = range(3)
GENERATOR = 3
RING = 9


def fault_parameters(faults: tuple[str, ...], targets: tuple[int, ...], sample_rate: float) -> np.ndarray:
    """Return the parameter array of the faults that act on one of the ``targets``, at ``sample_rate`` [Hz]."""
    chosen = [entry for entry in map(parse_fault, faults) if entry.kind.target in targets]
    longest = max((entry.amount for entry in chosen if entry.kind.action == DELAY), default=1.0)
    p = [float(len(chosen)), longest + 1.0]
    for entry in chosen:
        first = round(entry.start * sample_rate)
        beyond = first + max(round(entry.duration * sample_rate), 1)
        p += [float(entry.kind.target), float(entry.kind.action), float(first), float(beyond), entry.amount]
    return np.array(p)


def fault_state(p: np.ndarray) -> np.ndarray:
    """Return the state before the first sample for the parameter array of :func:`fault_parameters`."""
    x = np.zeros(RING + int(p[RING_LENGTH]))
    x[GENERATOR : GENERATOR + 6] = generator_state(1)
    return x


@kernel
def draw(x):
    """Return the next random number in (0, 1)."""
    return uniform(x[GENERATOR:RING])


@kernel
def begin_sample(x):
    """Count a sample and set the stamp of its measurement, unless a fault changes the stamp."""
    x[STAMP] = x[SAMPLES]
    x[SAMPLES] += 1.0


@called
def corrupt(p, x, target, value):
    """Return ``value`` with the faults of the present sample applied; call it once per target and sample."""
    count = int(p[COUNT])
    if count == 0:
        return value
    k = x[SAMPLES] - 1.0
    length = p[RING_LENGTH]
    if target == MEASUREMENT:
        x[RING + int(k % length)] = value
    given = value
    for i in range(count):
        entry = ENTRIES + ENTRY * i
        first = p[entry + FIRST]
        if p[entry + TARGET] != target or k < first or k >= p[entry + BEYOND]:
            continue
        action, amount = int(p[entry + KIND]), p[entry + VALUE]
        if action == LOST:
            given = math.nan
        elif action == SPIKE:
            if (k - first) % SPIKE_PERIOD == 0.0:
                given += amount
        elif action == FREEZE:
            if k == first:
                x[FROZEN_AT] = value
            given = x[FROZEN_AT]
        elif action == DELAY:
            given = x[RING + int((k - amount) % length)] if k >= amount else math.nan
        elif action == DROP:
            if draw(x) < amount:
                given = math.nan
        elif action == ADD:
            given += amount
        elif action == DISORDER:
            if (k - first) % 2.0 == 1.0:
                given = x[RING + int((k - 1.0) % length)]
                x[STAMP] = k - 1.0
        elif action == SCALE:
            given *= amount
        elif action == SET:
            given = 1.0
    return given


@nested
def given_instead(p, x, target, value):
    """Return the result of :func:`corrupt`; without faults return the value itself, which saves a call from Python."""
    return value if p[COUNT] == 0.0 else corrupt(p, x, target, value)
