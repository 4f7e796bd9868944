# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bumpless hand-over: after a change of controller or gains the command goes on from where it was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import Block, kernel
from hysteresis_ros.parameters import Parameters, parameter

#: p[DECAY]: factor of the bias from one sample to the next.
DECAY = 0
#: x[BIAS]: what is added to the input.
BIAS = 0
#: x[LAST]: last output.
LAST = 1
#: x[ARMED]: 1.0 when the next output shall equal the last one; 2.0 when x[BIAS] already says how much of that lasts.
ARMED = 2
#: x[QUICK]: what is added besides the bias, and halved from sample to sample.
QUICK = 3

#: Below this the bias is dropped, before it becomes a slow subnormal number.
SMALLEST = 1e-300


@kernel
def handover(p, x, u):
    """Return ``u + bias`` and let the bias decay; when armed, choose the bias such that the output does not move."""
    if x[ARMED] != 0.0:
        lasting = x[ARMED] == 2.0
        x[ARMED] = 0.0
        if p[DECAY] > 0.0:
            x[QUICK] = 0.0
            if lasting:
                x[QUICK] = x[LAST] - u - x[BIAS]
            else:
                x[BIAS] = x[LAST] - u
            # Exactly the last output, not u + (last - u) with its rounding.
            return x[LAST]
        x[BIAS] = 0.0
    bias = x[BIAS] * p[DECAY]
    quick = 0.5 * x[QUICK]
    y = u + bias
    if abs(bias) < SMALLEST or y == u:
        bias = 0.0
    if abs(quick) < SMALLEST or y + quick == y:
        quick = 0.0
    y += quick
    x[BIAS] = bias
    x[QUICK] = quick
    x[LAST] = y
    return y


@kernel
def go_on_from(x, last):
    """Make the next output equal ``last`` and fade from there to the input."""
    x[LAST] = last
    x[ARMED] = 1.0


@dataclass(frozen=True)
class HandoverParameters(Parameters):
    """How a change of controller is smoothed."""

    time: float = parameter(
        0.05,
        unit="s",
        low=0.0,
        description="Time constant with which the difference between old and new command fades; 0: at once",
    )


class Handover(Block):
    """Adds a decaying bias to its input after :func:`arm`.

    Parameters
    ----------
    parameters : HandoverParameters
    sample_time : float
        Sample time [s].
    """

    kernel = staticmethod(handover)

    def pack(self, parameters) -> np.ndarray:
        """Return [decay], decay = exp(-sample time / time), 0 when the time is 0."""
        return np.array([elementary.exp(-self.sample_time / parameters.time) if parameters.time > 0.0 else 0.0])

    def initial_state(self) -> np.ndarray:
        """Return the state without bias."""
        return np.zeros(4)


def arm(block: Handover, last: float | None = None, lasting: float | None = None) -> None:
    """Make the next output of ``block`` equal its last one and fade from there to the input.

    Used after a change of controller type, live gains, a stale measurement, and at start after stop.

    Parameters
    ----------
    block : Handover
    last : float, optional
        Where to go on from, when something else (a safe output) was sent since the block's last output.
    lasting : float, optional
        How far the output was from what the input would have been lately, on average. Only this part fades with the
        time constant; what the present sample deviates from it, noise mostly, is halved from sample to sample. A
        feedback that gets noise as a bias for long would be led away by it.
    """
    if last is not None:
        block.x[LAST] = float(last)
    block.x[ARMED] = 1.0
    if lasting is not None:
        block.x[ARMED] = 2.0
        block.x[BIAS] = float(lasting)
