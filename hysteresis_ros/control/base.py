# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What all controllers have in common: the beginning of their arrays, the loop over a recording, the base class.

A controller is a kernel ``u = kernel(p, x, r, y)``: reference displacement r without preload offset [m], measured
displacement y [m], command u [m] to the hysteresis compensator. The first entries of every state array are the same.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.block import Block, compiled, composite, kernel
from hysteresis_ros.errors import ParameterError, Problem

#: x[APPLIED]: command really carried out for the previous sample [m]. The kernel writes its own command there; whoever
#: runs the loop replaces it by what the limits left of it before the next call.
APPLIED = 0
#: x[ESTIMATED]: displacement as the observer sees it [m], comparable with the measured one (preload offset included).
ESTIMATED = 1
#: x[SWITCHING]: switching function s, in the model's units.
SWITCHING = 2
#: x[COMMAND]: last command [m].
COMMAND = 3
#: x[DISTURBANCE]: estimated constant disturbance of the command [m].
DISTURBANCE = 4
#: x[STARTED]: 0.0 makes the next call start the observer from rest at the measured displacement.
STARTED = 5
#: x[FEEDFORWARD]: command of the feedforward for this sample [m]; whoever runs the loop writes it before the call.
FEEDFORWARD = 6
#: Number of entries of the common part of x.
HEADER = 7
#: p[FED]: 1.0 when there is a feedforward, the first entry of the parameters of every controller.
FED = 0

#: Signals beyond this are cut, so that no input ever makes a product or a sum infinite.
BOUND = 1e60


@kernel
def bounded(value):
    """Return ``value`` cut to ±1e60; what is not a number, which nodes refuse before, counts as 0."""
    if value != value:
        return 0.0
    if value > BOUND:
        return BOUND
    if value < -BOUND:
        return -BOUND
    return value


@composite("void", "controller", "array", "array", "array", "array", "array")
def run_controller(step, p, x, r, y, u):
    """Fill ``u[k] = step(p, x, r[k], y[k])`` for all k: a controller fed with a recording."""
    for k in range(u.shape[0]):
        u[k] = step(p, x, r[k], y[k])


class Controller(Block):
    """Base of the controllers: a block with two inputs.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        Sample time [s].
    """

    #: Whether it goes on by what its observer foresees while the measurement is NaN.
    predicts = False

    #: Whether it can be taken through samples of another controller, as if it had run beside it all the time.
    runs_beside = False

    def shares_observer(self, other: Controller) -> bool:
        """Tell whether the observer of another controller is the same, so that its state can go on."""
        return False

    def continue_from(self, predecessor: Controller) -> None:
        """Take over the observer of a controller that shares it.

        Raises
        ------
        TypeError
            The law has no observer.
        """
        raise TypeError(f"{type(self).__name__} has no observer to take over")

    def forget(self) -> None:
        """Drop what the law has integrated while another one is in charge, whose errors these are."""

    def settle(self, applied: float) -> bool:
        """Set what the law integrates so that the command goes on from ``applied`` [m]; False when it cannot."""
        return False

    def step(self, reference: float, measured: float) -> float:
        """Return the command [m] for one sample of reference and measured displacement [m]."""
        return self.kernel(self.p, self.x, float(reference), float(measured))

    def simulate(self, reference, measured) -> np.ndarray:
        """Return the commands, shape (N,) [m], for recorded ``reference`` and ``measured``, shape (N,) [m]."""
        reference = np.ascontiguousarray(reference, dtype=np.float64)
        measured = np.ascontiguousarray(measured, dtype=np.float64)
        command = np.empty_like(reference)
        compiled(run_controller)(self.kernel, self.p, self.x, reference, measured, command)
        return command

    def retune(self, parameters) -> None:
        """Take new gains while running; arm the hand-over beside it, so that the command does not jump.

        Raises
        ------
        ParameterError
            The parameters are wrong or change the structure; the controller is unchanged then.
        """
        parameters = parameters.validated()
        if parameters.type != self.parameters.type:
            raise ParameterError([Problem("type", parameters.type, "changes the controller; build a new block of it")])
        packed = np.ascontiguousarray(self.pack(parameters), dtype=np.float64)
        if packed.shape != self.p.shape:
            raise ParameterError(
                [Problem("model.dynamics.B", parameters.model.dynamics.B, "the order of the model cannot change live")]
            )
        self.parameters = parameters
        self.p[:] = packed
