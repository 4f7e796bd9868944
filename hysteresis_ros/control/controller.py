"""The motion controller's parameters, and the block they describe."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.block import COMPILED, signature
from hysteresis_ros.control.feedforward import Feedforward, FeedforwardParameters
from hysteresis_ros.control.handover import Handover, HandoverParameters
from hysteresis_ros.control.integral_sliding_mode import IntegralSlidingMode, packed_integral_sliding_mode
from hysteresis_ros.control.inversion import inverse_filter, preview_warning
from hysteresis_ros.control.kalman import KalmanParameters
from hysteresis_ros.control.open_loop import Controller, OpenLoop
from hysteresis_ros.control.pid import Pid, PidParameters, require_stable_pid
from hysteresis_ros.control.sliding_design import SlidingModeParameters
from hysteresis_ros.control.sliding_mode import SlidingMode, packed_sliding_mode
from hysteresis_ros.control.super_twisting import SuperTwisting, SuperTwistingParameters, packed_super_twisting
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
        choices=("open_loop", "pid", "sliding_mode", "integral_sliding_mode", "super_twisting"),
        description="Pass the reference through (open_loop), PID, or one of the sliding mode controllers, which have a "
        "Kalman filter",
    )
    model: ModelParameters = group(ModelParameters)
    feedforward: FeedforwardParameters = group(FeedforwardParameters)
    pid: PidParameters = group(PidParameters, variant_of="type")
    sliding_mode: SlidingModeParameters = group(SlidingModeParameters)
    super_twisting: SuperTwistingParameters = group(SuperTwistingParameters, variant_of="type")
    kalman: KalmanParameters = group(KalmanParameters)
    handover_time: float = parameter(
        0.05,
        unit="s",
        low=0.0,
        description="Time constant with which a change of controller or gains fades in; 0: at once",
    )

    def check(self):
        """Yield what keeps the chosen controller from being designed."""
        if self.feedforward.type == "inverse_dynamics":
            try:
                inverse_filter(self.model.dynamics, self.feedforward.preview)
            except ParameterError as error:
                yield from error.problems
        rate = getattr(self, "sample_rate", None)  # the node's parameters, which contain these, know it
        if self.type == "pid" and rate:
            try:
                require_stable_pid(self, 1.0 / rate)
            except ParameterError as error:
                yield from error.problems
        if self.type in SLIDING and (rate or self.kalman.disturbance != "periodic"):
            try:
                SLIDING[self.type](self, 1.0 / rate if rate else None)
            except ParameterError as error:
                yield from error.problems

    def warnings(self, prefix: str = "") -> tuple[str, ...]:
        """Return doubts about the parameters: a preview that cuts much of the inverse dynamics off, and its groups'."""
        found = super().warnings(prefix)
        if self.feedforward.type == "inverse_dynamics":
            found += preview_warning(self.model.dynamics, self.feedforward.preview, prefix)
        if self.type in INTEGRATING and self.kalman.disturbance == "none":
            found += (
                f"{prefix}kalman.disturbance = none: a disturbance shows to {self.type} only through the innovation, "
                "and a part of it stays; choose constant",
            )
        return found


#: Designs of the sliding mode controllers, by type.
SLIDING = {
    "sliding_mode": packed_sliding_mode,
    "integral_sliding_mode": packed_integral_sliding_mode,
    "super_twisting": packed_super_twisting,
}

#: Laws that integrate what the Kalman filter's model does not explain.
INTEGRATING = ("integral_sliding_mode", "super_twisting")

CONTROLLERS = {
    "open_loop": OpenLoop,
    "pid": Pid,
    "sliding_mode": SlidingMode,
    "integral_sliding_mode": IntegralSlidingMode,
    "super_twisting": SuperTwisting,
}


def controller_block(parameters: ControllerParameters, sample_time: float) -> Controller:
    """Return the controller that ``parameters`` describe.

    Raises
    ------
    ParameterError
        A parameter is out of range, no stable controller follows from the parameters, or the model is for another
        sample time.
    """
    parameters.validated().model.dynamics.require_sample_time(sample_time, "model.dynamics.sample_time")
    return CONTROLLERS[parameters.type](parameters, sample_time)


def prepare_controllers() -> None:
    """Compile the kernels of all controllers, so that any of them can take over within a sample."""
    if COMPILED:
        for controller in CONTROLLERS.values():
            controller.kernel.compile(signature("scalar", "array", "array", "scalar", "scalar").args)


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
