# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Quiet hold: the command is constant for a time, so that neither sensor noise nor quantisation moves the actuator.

For ``quiet.average`` the loop continues, and the mean of command minus reference is computed, because a single command
contains the noise of its sample. In a second interval of this length, the deviation of the command from this mean
decays to zero, so that a resonance that the loop damps does not ring when the command becomes constant. The compensator
still computes a voltage for each sample, which compensates the creep that its model predicts. At the end the controller
continues with the states that it had before: its reference moves from the mean of the last measurements to the received
reference, and its command starts at the held command.

The drift of a quiet hold is the creep that the model does not compensate. It is assumed to be a fraction
(``quiet.creep_uncertainty``) of the creep that the model predicts from its present state.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.arguments import checked_value
from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem, shortened
from hysteresis_ros.models.block import interpreted, kernel
from hysteresis_ros.models.creep import DECAYS, OPERATOR, OPERATORS, OUTPUT, Creep, creep_inverse
from hysteresis_ros.units import quantity_in, readable

#: Name of the change, and of the service.
QUIET = "quiet"
#: Name of the duration in a request.
DURATION = "duration"
#: Name of the tolerance in a request.
TOLERANCE = "tolerance"
#: Longest quiet hold, and longest horizon of a forecast [s].
LONGEST = 1e5
#: Number of instants at which a forecast is evaluated.
INSTANTS = 2000

# Own parameters of the controller's part, after the parameters of :mod:`.controller`.
AVERAGED = 8  # number of samples whose commands are averaged; the command moves to the mean in as many samples
ON_PULSE = 9  # length of a hold that a pulse of the trigger input begins [samples]; 0: a pulse begins no hold
OWN_PARAMETERS = 10

# Own state of the controller's part, after the state of :mod:`.controller`.
AHEAD = 10  # samples until the command is constant
LEFT = 11  # samples until the hold ends
SUM = 12  # sum of command minus reference over COUNT samples [m]
COUNT = 13
COMMAND = 14  # the constant command [m]
REFERENCE = 15  # last reference [m]
AT_REST = 16  # 1 while the reference has not moved since the request
CONTINUES = 17  # 1: the controller continues with the states that it had before the hold
SEEN = 18  # mean of the last measurements in the hold [m]
SEEN_COUNT = 19  # number of these measurements, at most AVERAGED
OWN_STATES = 20


@dataclass(frozen=True)
class QuietParameters(Parameters):
    """Quiet hold of a motion controller."""

    average: float = parameter(
        0.05,
        unit="s",
        low=0.0,
        high=60.0,
        description="time over which the command is averaged, at least two samples; it then moves to this mean in the "
        "same time, and is held",
    )
    on_trigger: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=LONGEST,
        read_only=True,
        description="length of the quiet hold that a pulse of the trigger input begins; 0: no quiet hold",
    )
    creep_uncertainty: float = parameter(
        0.3,
        low=0.0,
        high=10.0,
        description="fraction of the predicted creep that is assumed to remain as drift after compensation",
    )


@kernel
def begin_quiet(own_p, own, samples):
    """Begin a quiet hold of ``samples`` samples; 0 ends the present hold."""
    standing = own[LEFT] > 0.0 and own[AHEAD] == 0.0
    own[LEFT] = samples
    if samples == 0.0:
        own[AHEAD] = 0.0
    elif not standing:
        own[AHEAD] = 2.0 * own_p[AVERAGED]
        own[SUM] = own[COUNT] = own[SEEN_COUNT] = 0.0
        own[AT_REST] = 1.0


@kernel
def is_quiet(own):
    """Tell whether the command is held constant."""
    return own[LEFT] > 0.0 and own[AHEAD] == 0.0


@kernel
def quietened(own_p, own, reference, command):
    """Return the command [m] to send; before a quiet hold, average the commands, then move to their mean."""
    if own[AHEAD] == 0.0:
        return command
    if own[COUNT] > 0.0 and reference != own[REFERENCE]:
        own[AT_REST] = 0.0
    own[REFERENCE] = reference
    own[AHEAD] -= 1.0
    if own[COUNT] < own_p[AVERAGED]:
        own[SUM] += command - reference
        own[COUNT] += 1.0
        return command
    own[COMMAND] = reference + own[SUM] / own[COUNT]
    return own[COMMAND] + own[AHEAD] / own_p[AVERAGED] * (command - own[COMMAND])


@kernel
def held_command(own_p, own, measured):
    """Return the command [m] of a sample of the quiet hold, given the measurement [m] of the sample (NaN: missing)."""
    own[LEFT] -= 1.0
    if measured == measured:
        own[SEEN_COUNT] = min(own[SEEN_COUNT] + 1.0, own_p[AVERAGED])
        own[SEEN] += (measured - own[SEEN]) / own[SEEN_COUNT]
        own[CONTINUES] = own[AT_REST]
    return own[COMMAND]


@kernel
def end_quiet(own):
    """End a quiet hold because the axis goes to its safe state; the controller then restarts."""
    own[LEFT] = own[AHEAD] = own[CONTINUES] = 0.0


class Forecast:
    """Drift of an axis in a quiet hold, predicted by the creep model of its compensator in its present state."""

    def __init__(self, creep: Creep, uncertainty: float):
        p, x = creep.p.copy(), creep.x.copy()
        count = int(p[OPERATORS])
        self.uncertainty, self.sample_time = uncertainty, creep.sample_time
        held = float(interpreted(creep_inverse)(p, x, x[OUTPUT]))
        self._weights = p[DECAYS + count : DECAYS + 2 * count] * (held - x[OPERATOR:])
        self._decays = p[DECAYS : DECAYS + count]
        whole = np.rint(np.geomspace(1.0, max(LONGEST / self.sample_time, 2.0), INSTANTS))
        self._samples = np.unique(whole)

    @property
    def is_known(self) -> bool:
        """Whether the compensator has a creep model."""
        return self._decays.size > 0

    def creep(self, duration: float) -> float:
        """Return the largest creep [m] that the model predicts within a time [s] without compensation."""
        samples = self._samples[self._samples * self.sample_time < duration]
        return float(np.max(self._creep(np.append(samples, duration / self.sample_time)), initial=0.0))

    def _creep(self, samples: np.ndarray) -> np.ndarray:
        """Return the predicted creep [m] after each of these numbers of samples."""
        return np.abs((1.0 - self._decays ** samples[:, np.newaxis]) @ self._weights)

    def longest(self, tolerance: float) -> float:
        """Return the time [s] for which the drift stays within a tolerance [m]; infinite if it exceeds LONGEST."""
        outside = np.flatnonzero(self.uncertainty * self._creep(self._samples) > tolerance)
        if not outside.size:
            return math.inf
        first = int(outside[0])
        return float(self._samples[first - 1]) * self.sample_time if first else 0.0

    def require(self, duration: float, tolerance: float = 0.0) -> None:
        """Raise a ParameterError if a hold of ``duration`` [s] drifts by more than ``tolerance`` [m] (0: no limit)."""
        require_numbers(duration, tolerance)
        if not tolerance:
            return
        if not self.is_known:
            remedy = (
                "the permissible duration is unknown, because hysteresis_compensator has no creep model "
                "(creep.type: none); identify one from a step (hysteresis identify --creep), or omit the tolerance"
            )
            raise ParameterError([Problem(f"{QUIET}: {TOLERANCE}", tolerance, remedy, "m")])
        creep, longest = self.creep(duration), self.longest(tolerance)
        if self.uncertainty * creep <= tolerance:
            return
        would = f"allowed now: at most {readable(longest, 's')}" if longest else "allowed now: no quiet hold"
        remedy = (
            f"the displacement would drift by {readable(self.uncertainty * creep, 'm')} ({100 * self.uncertainty:g} % "
            f"of the predicted creep of {readable(creep, 'm')}), the tolerance is {readable(tolerance, 'm')}; {would}; "
            "or wait, because creep becomes slower"
        )
        raise ParameterError([Problem(f"{QUIET}: {DURATION}", duration, remedy, "s")])

    def describe(self, duration: float) -> str:
        """Return a text with the predicted drift of a quiet hold of ``duration`` [s]."""
        if not self.is_known:
            return "the drift is unknown: hysteresis_compensator has no creep model"
        creep = self.creep(duration)
        drift = readable(self.uncertainty * creep, "m")
        return f"predicted drift {drift}, {100 * self.uncertainty:g} % of the creep of {readable(creep, 'm')}"


def require_numbers(duration: float, tolerance: float = 0.0) -> None:
    """Raise a ParameterError if duration [s] or tolerance [m] of a quiet hold is out of range."""
    if not 0.0 <= duration <= LONGEST:
        text = f"must be within 0 … {LONGEST:g} s; 0 ends a quiet hold"
        raise ParameterError([Problem(f"{QUIET}: {DURATION}", duration, text, "s")])
    if not 0.0 <= tolerance < math.inf:
        text = "must be ≥ 0 m; 0: any drift"
        raise ParameterError([Problem(f"{QUIET}: {TOLERANCE}", tolerance, text, "m")])


class Quiet(NamedTuple):
    """A quiet hold of an offline run."""

    start: float  #: Time of the request since the start of the run [s].
    duration: float  #: Length of the hold [s].
    tolerance: float = 0.0  #: Largest drift [m]; 0: unlimited.

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the change."""
        return {DURATION: float(self.duration), TOLERANCE: float(self.tolerance)}


def parse_quiet(text: str) -> Quiet:
    """Return the quiet hold that ``START:DURATION[:TOLERANCE]`` describes; each number with or without a unit."""
    words = text.split(":")
    if len(words) not in (2, 3):
        raise ConfigurationError(f"quiet {text}: write START:DURATION[:TOLERANCE], such as 1s:500ms:5nm")
    values = []
    for word, unit in zip(words, ("s", "s", "m"), strict=False):
        try:
            values.append(quantity_in(word, unit))
        except ValueError as error:
            raise ConfigurationError(f"quiet {text}: {word}: {error}") from None
    return checked(Quiet(*values))


def checked(quiet: Quiet) -> Quiet:
    """Return the quiet hold; raise a ParameterError if one of its numbers is out of range."""
    if not 0.0 <= quiet.start < math.inf:
        raise ParameterError([Problem(f"{QUIET}: start", quiet.start, "must be ≥ 0 s", "s")])
    require_numbers(quiet.duration, quiet.tolerance)
    return quiet


def quiets_of(given: Sequence[str | Sequence[float | str]]) -> list[Quiet]:
    """Return quiet holds that are given as texts, or as numbers in the order of :class:`Quiet`."""
    if isinstance(given, str):
        raise ConfigurationError(f"quiet = {given!r}: must be a list of quiet holds: write [{given!r}]")
    return [parse_quiet(one) if isinstance(one, str) else _quiet_of(one) for one in given]


def _quiet_of(numbers: Sequence[float | str]) -> Quiet:
    """Return the quiet hold of (start, duration) or (start, duration, tolerance); each may be a text with its unit."""
    if not isinstance(numbers, Iterable) or len(tuple(numbers)) not in (2, 3):
        raise ConfigurationError(f"quiet {shortened(numbers)}: give (start, duration) or (start, duration, tolerance)")
    start, duration, tolerance = (*numbers, 0.0)[:3]
    return checked(
        Quiet(
            checked_value(f"{QUIET}: start", start, "Seconds"),
            checked_value(f"{QUIET}: {DURATION}", duration, "Seconds"),
            checked_value(f"{QUIET}: {TOLERANCE}", tolerance, "Metres"),
        )
    )
