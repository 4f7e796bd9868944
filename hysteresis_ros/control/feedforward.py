"""Feedforward: the command that makes the model follow the reference, from a reference known some samples ahead (W6).

With ``preview: N`` the reference received at sample k is r(k + N); the controller follows, and a report judges, the
delayed one r(k).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.block import Block, kernel
from hysteresis_ros.control.open_loop import bounded
from hysteresis_ros.parameters import Parameters, parameter

# Parameter array: a head.
PREVIEW = 0
STATIC = 1
TAPS = 2

# State array: a head, then the last references, the oldest at NEXT.
COMMAND = 0  # command of the feedforward for the delayed reference [m]
STARTED = 1  # 0.0 makes the next call take the reference for one that has always been there
NEXT = 2
PAST = 3


@kernel
def feedforward(p, x, reference):
    """Return the delayed reference [m] for ``reference`` [m]; the feedforward's command [m] is left in ``x[0]``."""
    preview = int(p[PREVIEW])
    reference = bounded(reference)
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        for i in range(preview):
            x[PAST + i] = reference
    delayed = reference
    if preview > 0:
        place = PAST + int(x[NEXT])
        delayed = x[place]
        x[place] = reference
        x[NEXT] = (x[NEXT] + 1.0) % p[PREVIEW]
    x[COMMAND] = p[STATIC] * delayed
    return delayed


@dataclass(frozen=True)
class FeedforwardParameters(Parameters):
    """Feedforward of the motion controller."""

    type: str = parameter(
        "none",
        choices=("none", "static"),
        read_only=True,
        description="none, or static (the delayed reference itself: the model has unit DC gain)",
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

    Parameters
    ----------
    parameters : ControllerParameters
        Of which ``feedforward`` and ``model.dynamics`` are used.
    sample_time : float
        Sample time [s].
    """

    kernel = staticmethod(feedforward)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array."""
        given = parameters.feedforward
        return np.array([given.preview, given.type == "static"], dtype=float)

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample."""
        return np.zeros(PAST + self.parameters.feedforward.preview)

    @property
    def command(self) -> float:
        """Command [m] of the feedforward at the last sample."""
        return float(self.x[COMMAND])
