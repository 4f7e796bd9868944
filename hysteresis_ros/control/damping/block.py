# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Damping in the loop: one small filter between the law's output and the command, whatever its kind.

u = γ w + F y, u = γ w + F f or u = F w (:mod:`~hysteresis_ros.control.damping.plant`); w is the law's output, y the
measured displacement without preload offset, f the measured force in the stack. What the compensator cuts off the
command concerns the law's output as

w_applied = w + (u_applied − u) / b

with b the direct gain from w to u: the output of the law that would have led to what was carried out. Where nothing is
cut it is w exactly. The filter of a measurement sees what is there and needs no help with windup; one of the
law's output has unit gain at rest and fades within its own time constants.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.block import Block, called, kernel
from hysteresis_ros.control.base import bounded
from hysteresis_ros.control.damping.kind import FORCE, MEASUREMENT, MOST_STATES, NOTHING
from hysteresis_ros.control.damping.plant import inner_loop
from hysteresis_ros.linear_algebra import solve
from hysteresis_ros.models.state_space import accumulate, advance

# Parameter array: a head, then A (n·n, row by row), B, C and the state at rest under an input of one (n each).
SOURCE = 0
ORDER = 1
PRELOAD = 2  # offset of the measurement [m]
FORWARD = 3  # γ
THROUGH = 4  # feedthrough of the filter
DIRECT = 5  # b
MATRICES = 6
PARAMETERS = MATRICES + MOST_STATES * (MOST_STATES + 3)

# State array: a head, then n states and n numbers of scratch.
STARTED = 0  # 0.0: the next call starts at rest
OUTPUT = 1  # last output of the law, w [m]
COMMAND = 2  # last command, u [m]
FILTERED = 3  # last input of the filter [m] or [N]
STATE = 4
STATES = STATE + 2 * MOST_STATES


@called
def damp(p, x, output, measured, force):
    """Return the command [m] for the law's ``output`` [m], the ``measured`` displacement [m] and ``force`` [N]."""
    if p[SOURCE] == NOTHING:
        return output
    n = int(p[ORDER])
    column = MATRICES + n * n
    filtered = output
    if p[SOURCE] == MEASUREMENT:
        filtered = bounded(measured - p[PRELOAD])
    elif p[SOURCE] == FORCE:
        filtered = force
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        for i in range(n):
            x[STATE + i] = p[column + 2 * n + i] * filtered
    command = accumulate(p[FORWARD] * output + p[THROUGH] * filtered, p, column + n, x, STATE, n)
    advance(p, MATRICES, column, x, STATE, n, filtered)
    x[OUTPUT] = output
    x[COMMAND] = command
    x[FILTERED] = filtered
    return command


@kernel
def as_output(p, x, command):
    """Return the output of the law [m] that would have led to the last ``command`` [m] as it was carried out."""
    if p[SOURCE] == NOTHING:
        return command
    return x[OUTPUT] + (command - x[COMMAND]) / p[DIRECT]


class Damping(Block):
    """The damping of a motion controller.

    Parameters
    ----------
    parameters : ControllerParameters
        Of which ``damping`` and ``model`` are used.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        The filter cannot run at this sample time, or the inner loop is unstable on the model.
    """

    kernel = staticmethod(damp)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array, shape (94,)."""
        damping, p = parameters.damping, np.zeros(PARAMETERS)
        p[SOURCE], p[DIRECT] = damping.source, 1.0
        if damping.source == NOTHING:
            return p
        loop = inner_loop(damping, parameters.model.dynamics, self.sample_time, parameters.model.force)
        found = loop.filter
        p[ORDER], p[PRELOAD], p[FORWARD] = found.order, parameters.model.preload.offset, loop.forward
        p[THROUGH], p[DIRECT] = found.D.item(), loop.direct
        rest = solve(np.eye(found.order) - found.A, found.B[:, 0])
        matrices = np.concatenate([found.A.ravel(), found.B[:, 0], found.C[0], rest])
        p[MATRICES : MATRICES + len(matrices)] = matrices
        return p

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample."""
        return np.zeros(STATES)

    @property
    def direct(self) -> float:
        """Change of the command per change of the law's output in the same sample."""
        return float(self.p[DIRECT])

    def retune(self, parameters) -> None:
        """Take another filter, also of another kind, while running; arm the hand-over behind it.

        States of a filter of the same kind and order go on, moved as far as the rest under the present input moves;
        those of another start at rest.

        Raises
        ------
        ParameterError
            The parameters are wrong or the inner loop would be unstable; nothing is changed then.
        """
        packed = self.pack(parameters.validated())
        same = parameters.damping.type == self.parameters.damping.type and packed[ORDER] == self.p[ORDER]
        n = int(packed[ORDER])
        rest = slice(MATRICES + n * (n + 2), MATRICES + n * (n + 3))
        if same:
            self.x[STATE : STATE + n] += (packed[rest] - self.p[rest]) * self.x[FILTERED]
        else:
            self.x[:] = 0.0
        self.parameters = parameters
        self.p[:] = packed
