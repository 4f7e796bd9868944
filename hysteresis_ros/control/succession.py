"""Another type of controller takes over while the axis runs, with an observer that already knows the plant's motion.

A controller is taken through the last samples of the run first, as if it had run beside its predecessor all the time:
an observer that began from rest instead would move the command while it settles. Two sliding mode controllers with one
model and one Kalman filter share the observer: its state goes on as it is. What a law has integrated is set such that
it goes on from the present command, or to zero; the hand-over behind the controller fades the rest.
"""

from __future__ import annotations

from collections import deque

from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.control.open_loop import APPLIED, COMMAND, FEEDFORWARD, HEADER, STARTED, Controller, OpenLoop
from hysteresis_ros.control.sliding_surface import SlidingController

#: Samples that are kept: long enough for an observer to settle.
SAMPLES = 500
#: Samples at their end over which two controllers are compared.
AVERAGED = 50


class History:
    """The last samples of a run: what every controller would have been given."""

    def __init__(self):
        self.samples: deque = deque(maxlen=SAMPLES)

    def note(self, applied: float, reference: float, fed: float, measured: float) -> None:
        """Keep one sample.

        Parameters
        ----------
        applied : float
            Command carried out for the sample before [m].
        reference, fed, measured : float
            Delayed reference, command of the feedforward and measured displacement of this sample [m].
        """
        self.samples.append((applied, reference, fed, measured))

    def clear(self) -> None:
        """Forget everything: the next sample does not follow the last one."""
        self.samples.clear()


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
    if isinstance(made, (SlidingController, OpenLoop)) and history.samples:
        wanted = _beside(made, history)
        # what was carried out for a sample is known one sample later
        carried_out = [sample[0] for sample in history.samples][1:] + [predecessor.x[APPLIED]]
        recent = list(zip(carried_out, wanted, strict=True))[-AVERAGED:]
        lasting = sum(one - other for one, other in recent) / len(recent)
    if shares_observer(made, predecessor):
        made.continue_from(predecessor)
    if isinstance(made, SlidingController) and made.x[STARTED] != 0.0 and made.settle(predecessor.x[APPLIED]):
        lasting = None
    started = made.x[STARTED]
    made.x[:HEADER] = predecessor.x[:HEADER]
    made.x[STARTED] = started
    return made, lasting


def _beside(controller: Controller, history: History) -> list[float]:
    """Take a controller through the last samples and return what it would have wanted."""
    wanted = []
    for applied, reference, fed, measured in history.samples:
        controller.x[APPLIED] = controller.x[COMMAND] = applied
        controller.x[FEEDFORWARD] = fed
        wanted.append(controller.kernel(controller.p, controller.x, reference, measured))
        if isinstance(controller, SlidingController):
            controller.forget()
    return wanted


def shares_observer(one: Controller, other: Controller) -> bool:
    """Tell whether both have the same Kalman filter of the same model, and the same kind of target."""
    if not isinstance(one, SlidingController) or not isinstance(other, SlidingController):
        return False
    mine, theirs = one.parameters, other.parameters
    same = mine.model == theirs.model and mine.kalman == theirs.kalman and one.sample_time == other.sample_time
    return same and mine.feedforward == theirs.feedforward
