# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Feedforward: the command that makes the model follow the reference, from a reference known some samples ahead (W6).

With ``preview: N`` the reference received at sample k is r(k + N); the controller follows, and a report judges, the
delayed one r(k).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.block import Block, kernel
from hysteresis_ros.control.base import bounded
from hysteresis_ros.control.inversion import InverseFilter, inverse_filter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.state_space import accumulate, advance
from hysteresis_ros.parameters import Parameters, parameter

# Parameter array: a head, the weights of the references (as many places as the ring has), those that drive the causal
# part, then of that A (n·n, row by row), B, C and its state at rest under a reference of one (n each).
PREVIEW = 0
ORDER = 1
FIRST = 2  # how far the first weight stands behind the oldest reference in the ring
TAPS = 3  # weights in use
PAST = 4  # references before the delayed one
DRIVES = 5  # weights that drive the causal part
WEIGHTS = 6

# State array: a head, then the references r(k - past) … r(k + N) in a ring, n states and n numbers of scratch.
COMMAND = 0  # command of the feedforward for the delayed reference [m]
STARTED = 1  # 0.0 makes the next call take the reference for one that has always been there
NEXT = 2  # place of the ring for the next reference
RING = 3


@kernel
def feedforward(p, x, reference):
    """Return the delayed reference [m] for ``reference`` [m]; the feedforward's command [m] is left in ``x[0]``."""
    length = int(p[PREVIEW]) + 1 + int(p[PAST])
    n = int(p[ORDER])
    drive = WEIGHTS + length
    drives = int(p[DRIVES])
    matrix = drive + drives
    inputs = matrix + n * n
    outputs = inputs + n
    rest = outputs + n
    state = RING + length
    reference = bounded(reference)
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        for i in range(length):
            x[RING + i] = reference
        for i in range(n):
            x[state + i] = p[rest + i] * reference
    newest = int(x[NEXT])
    x[RING + newest] = reference
    oldest = newest + 1
    if oldest == length:
        oldest = 0
    x[NEXT] = float(oldest)
    place = oldest + int(p[FIRST])
    if place >= length:
        place -= length
    ahead = p[drive] * x[RING + place]
    driving = place
    for i in range(1, drives):
        driving += 1
        if driving == length:
            driving = 0
        ahead += p[drive + i] * x[RING + driving]
    command = 0.0
    for i in range(int(p[TAPS])):
        command += p[WEIGHTS + i] * x[RING + place]
        place += 1
        if place == length:
            place = 0
    x[COMMAND] = accumulate(command, p, outputs, x, state, n)
    advance(p, matrix, inputs, x, state, n, ahead)
    present = oldest + int(p[PAST])
    if present >= length:
        present -= length
    return x[RING + present]


@dataclass(frozen=True)
class FeedforwardParameters(Parameters):
    """Feedforward of the motion controller."""

    type: str = parameter(
        "none",
        choices=("none", "static", "inverse_dynamics"),
        read_only=True,
        description="none, static (the delayed reference itself: the model has unit DC gain), or inverse_dynamics "
        "(stable inversion of model.dynamics; needs preview)",
    )
    preview: int = parameter(
        0,
        low=0,
        high=10000,
        read_only=True,
        description="samples the received reference is ahead; errors are judged against the delayed reference",
    )


class Feedforward(Block):
    """The feedforward of a motion controller: from the received to the delayed reference and a command.

    It begins at rest on the first reference it gets.

    Parameters
    ----------
    parameters : ControllerParameters
        Of which ``feedforward`` and ``model.dynamics`` are used.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        The preview does not reach as far as the dynamics delay, the dynamics have no stable inverse, or are for
        another sample time.
    """

    kernel = staticmethod(feedforward)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array."""
        given = parameters.feedforward
        parameters.model.dynamics.require_sample_time(self.sample_time, "model.dynamics.sample_time")
        chosen = _filter(given, parameters.model.dynamics)
        past = max(-chosen.first, 0)
        taps = np.zeros(given.preview + 1 + past)
        taps[: len(chosen.weights)] = chosen.weights
        head = [given.preview, len(chosen.B), chosen.first + past, len(chosen.weights), past, len(chosen.drive)]
        return np.concatenate([head, taps, chosen.drive, chosen.A.ravel(), chosen.B, chosen.C, chosen.rest])

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample."""
        return np.zeros(RING + _ring_length(self.p) + 2 * int(self.p[ORDER]))

    @property
    def command(self) -> float:
        """Command [m] of the feedforward at the last sample."""
        return float(self.x[COMMAND])

    def retune(self, parameters) -> None:
        """Take another model of the same order while running.

        References and states go on, so nothing jumps while the reference rests; arm the hand-over behind the
        controller for a reference that moves.

        Raises
        ------
        ParameterError
            Type, preview or the order of the model differ, or the new model cannot be inverted; nothing is changed
            then.
        """
        parameters = parameters.validated()
        for name in ("type", "preview"):
            value, present = getattr(parameters.feedforward, name), getattr(self.parameters.feedforward, name)
            if value != present:
                raise ParameterError([Problem(f"feedforward.{name}", value, f"is fixed while running: keep {present}")])
        packed = np.ascontiguousarray(self.pack(parameters), dtype=np.float64)
        if packed.shape != self.p.shape:
            raise ParameterError(
                [Problem("model.dynamics.A", parameters.model.dynamics.A, "the order of the model cannot change live")]
            )
        self.parameters = parameters
        # what rests stays at rest under the new model too
        length, order = _ring_length(packed), int(packed[ORDER])
        ahead = self.x[RING + (int(self.x[NEXT]) + int(packed[FIRST])) % length]
        rest = len(packed) - order
        self.x[RING + length : RING + length + order] += (packed[rest:] - self.p[rest:]) * ahead
        self.p[:] = packed


def _ring_length(p) -> int:
    return int(p[PREVIEW]) + 1 + int(p[PAST])


def _filter(given: FeedforwardParameters, dynamics) -> InverseFilter:
    if given.type == "inverse_dynamics":
        return inverse_filter(dynamics, given.preview)
    nothing = np.zeros(0)
    weights = np.ones(1) if given.type == "static" else nothing
    return InverseFilter(0, weights, np.ones(1), np.zeros((0, 0)), nothing, nothing, nothing, nothing, 0.0)
