"""The motion controller's parameters, and the block they describe."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.control.feedforward import Feedforward, FeedforwardParameters
from hysteresis_ros.control.handover import Handover, HandoverParameters
from hysteresis_ros.control.kalman import KalmanParameters
from hysteresis_ros.control.open_loop import Controller, OpenLoop
from hysteresis_ros.control.sliding_mode import SlidingMode, SlidingModeParameters, packed_sliding_mode
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.preload import PreloadParameters
from hysteresis_ros.parameters import Parameters, group, parameter


@dataclass(frozen=True)
class ModelParameters(Parameters):
    """What the controller believes of the plant: a model of its own, never the plant's."""

    dynamics: LinearParameters = group(LinearParameters)
    preload: PreloadParameters = group(PreloadParameters)


@dataclass(frozen=True)
class ControllerParameters(Parameters):
    """Motion controller: what kind, its model, its gains, and how it takes over."""

    type: str = parameter(
        "open_loop",
        choices=("open_loop", "sliding_mode"),
        description="Pass the reference through (open_loop) or sliding mode control with a Kalman filter",
    )
    model: ModelParameters = group(ModelParameters)
    feedforward: FeedforwardParameters = group(FeedforwardParameters)
    sliding_mode: SlidingModeParameters = group(SlidingModeParameters, variant_of="type")
    kalman: KalmanParameters = group(KalmanParameters)
    handover_time: float = parameter(
        0.05,
        unit="s",
        low=0.0,
        description="Time constant with which a change of controller or gains fades in; 0: at once",
    )

    def check(self):
        """Yield what keeps the chosen controller from being designed."""
        if self.type == "sliding_mode":
            try:
                packed_sliding_mode(self)
            except ParameterError as error:
                yield from error.problems


CONTROLLERS = {"open_loop": OpenLoop, "sliding_mode": SlidingMode}


def controller_block(parameters: ControllerParameters, sample_time: float) -> Controller:
    """Return the controller that ``parameters`` describe.

    Raises
    ------
    ParameterError
        A parameter is out of range, or no stable controller follows from the parameters.
    """
    return CONTROLLERS[parameters.validated().type](parameters, sample_time)


def feedforward_block(parameters: ControllerParameters, sample_time: float) -> Feedforward:
    """Return the feedforward in front of the controller.

    Raises
    ------
    ParameterError
        The model cannot be inverted as the parameters ask for.
    """
    return Feedforward(parameters, sample_time)


def handover_block(parameters: ControllerParameters, sample_time: float) -> Handover:
    """Return the hand-over with the controller's ``handover_time``."""
    return Handover(HandoverParameters(time=parameters.handover_time), sample_time)
