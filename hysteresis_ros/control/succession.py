# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Another type of controller takes over while the axis runs, with an observer that already knows the plant's motion.

A controller is taken through the last samples of the run first, as if it had run beside its predecessor all the time:
an observer that began from rest instead would move the command while it settles. Two controllers with one model and
one Kalman filter share the observer: its state goes on as it is. What a law has integrated is set such that
it goes on from the present command, or to zero; the hand-over behind the controller fades the rest.
"""

from __future__ import annotations

import math

import numpy as np

from hysteresis_ros.block import called
from hysteresis_ros.control.base import APPLIED, COMMAND, FEEDFORWARD, HEADER, STARTED, Controller
from hysteresis_ros.control.controller import ControllerParameters, controller_block

#: Samples that are kept: long enough for an observer to settle.
SAMPLES = 500
#: Samples at their end over which two controllers are compared.
AVERAGED = 50


# State of a history: entries so far, then a ring of the last samples, four numbers each.
ENTRIES = 0
APPLIED_THEN, REFERENCE_THEN, FED_THEN, MEASURED_THEN = range(4)
ENTRY = 4


@called
def note(x, applied, reference, fed, measured):
    """Keep one sample in the history ``x``.

    Parameters
    ----------
    x : ndarray
        State of a :class:`History`.
    applied : float
        Command carried out for the sample before [m].
    reference, fed, measured : float
        Delayed reference, command of the feedforward and measured displacement of this sample [m].
    """
    length = (x.shape[0] - 1) // ENTRY
    place = 1 + ENTRY * (int(x[ENTRIES]) % length)
    x[place + APPLIED_THEN] = applied
    x[place + REFERENCE_THEN] = reference
    x[place + FED_THEN] = fed
    x[place + MEASURED_THEN] = measured
    x[ENTRIES] += 1.0


class History:
    """The last samples of a run, as many as ``SAMPLES``: what every controller would have been given.

    Attributes
    ----------
    p, x : ndarray
        Empty parameters, and the state for :func:`note`.
    """

    def __init__(self):
        self.p = np.zeros(0)
        self.x = np.zeros(1 + ENTRY * SAMPLES)

    def reset(self) -> None:
        """Forget everything: the next sample does not follow the last one."""
        self.x[ENTRIES] = 0.0

    @property
    def samples(self) -> np.ndarray:
        """The samples in order, shape (n, 4): applied, reference, fed, measured [m]."""
        count = int(self.x[ENTRIES])
        ring = self.x[1:].reshape(SAMPLES, ENTRY)
        if count <= SAMPLES:
            return ring[:count].copy()
        return np.roll(ring, -(count % SAMPLES), axis=0)


def successor(
    parameters: ControllerParameters, sample_time: float, predecessor: Controller, history: History
) -> tuple[Controller, float | None]:
    """Return the controller of ``parameters``, ready for the sample after the last one of ``predecessor``.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        Sample time [s].
    predecessor : Controller
        It is not changed.
    history : History
        The last samples; without any the observer starts from rest at the next measurement.

    Returns
    -------
    controller : Controller
    lasting : float or None
        How far what was carried out lately is from what the controller would have wanted, on average [m]; for
        :func:`hysteresis_ros.control.handover.arm`. None when it is not known, or begins from the present command.

    Raises
    ------
    ParameterError
        No controller follows from the parameters.
    """
    made = controller_block(parameters, sample_time)
    lasting = None
    if made.runs_beside and len(history.samples):
        wanted = _beside(made, history)
        # what was carried out for a sample is known one sample later
        carried_out = history.samples[1:, APPLIED_THEN].tolist() + [predecessor.x[APPLIED]]
        recent = list(zip(carried_out, wanted, strict=True))[-AVERAGED:]
        lasting = math.fsum(one - other for one, other in recent) / len(recent)
    if made.shares_observer(predecessor):
        made.continue_from(predecessor)
    if made.x[STARTED] != 0.0 and made.settle(predecessor.x[APPLIED]):
        lasting = None
    started = made.x[STARTED]
    made.x[:HEADER] = predecessor.x[:HEADER]
    made.x[STARTED] = started
    return made, lasting


def _beside(controller: Controller, history: History) -> list[float]:
    """Take a controller through the last samples and return what it would have wanted."""
    wanted = []
    for applied, reference, fed, measured in history.samples.tolist():
        controller.x[APPLIED] = controller.x[COMMAND] = applied
        controller.x[FEEDFORWARD] = fed
        wanted.append(controller.kernel(controller.p, controller.x, reference, measured))
        controller.forget()
    return wanted
