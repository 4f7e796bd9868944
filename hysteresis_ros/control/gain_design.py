"""Gains of any controller from the model in its own parameters, for a bandwidth that is asked.

==================  ==========================  =====================================================================
name                type                        what sets the bandwidth
==================  ==========================  =====================================================================
``pid``             pid                         gain of the integral, zeros on the slowest poles of the model
``smc``             sliding_mode                Φ of the reaching law; hyperplane from an LQ problem
``offset_free``     sliding_mode                the same, with a disturbance estimated by the Kalman filter, as the next
``integral_smc``    integral_sliding_mode       Φ of the nominal controller
``super_twisting``  super_twisting              the slowest pole of the sliding motion
==================  ==========================  =====================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.control import design
from hysteresis_ros.control.kalman import filter_gain
from hysteresis_ros.control.margins import Margins, bandwidth_and_sensitivity, linear_loop, margins
from hysteresis_ros.control.pid_design import design_pid
from hysteresis_ros.control.sliding_design import design_sliding_mode
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import dc_gain

#: Type of each controller that can be designed.
TYPES = {
    "pid": "pid",
    "smc": "sliding_mode",
    "integral_smc": "integral_sliding_mode",
    "super_twisting": "super_twisting",
    "offset_free": "sliding_mode",
}
#: Input weight of the LQ problem as a part of the squared DC gain.
INPUT_WEIGHT = 0.025
#: Largest pole that sets a bandwidth, and how closely the bandwidth is met.
SLOWEST = 0.99999
PRECISION = 1e-5
#: Part of the bandwidth asked by which the slowest pole may be too fast.
TOLERANCE = 0.01


@dataclass(frozen=True, eq=False)
class Designed:
    """A design: parameters with gains, and what they are worth on the model.

    Parameters
    ----------
    parameters : ControllerParameters
    margins : Margins
    """

    parameters: object
    margins: Margins


def require_minimal(dynamics) -> None:
    """Refuse a model with a state that the input does not move or the output does not show.

    Parameters
    ----------
    dynamics : LinearParameters

    Raises
    ------
    ParameterError
        ``model.dynamics.B`` (uncontrollable), ``model.dynamics.C`` (unobservable) or ``model.dynamics.A`` (unstable).
    """
    problems = [replace(problem, name=f"model.dynamics.{problem.name}") for problem in dynamics.check()]
    if problems:
        raise ParameterError(problems)
    A, B, C, _ = design.matrices(dynamics)
    for value in np.linalg.eigvals(A):
        text = f"(pole {value:.6g}); identify a model of lower order, or cancel that pole"
        if not design.full_rank(np.hstack([A - value * np.eye(len(A)), B]).T):
            design.refuse("model.dynamics.B", dynamics.B, f"the model is not controllable {text}")
        if not design.full_rank(np.vstack([A - value * np.eye(len(A)), C])):
            design.refuse("model.dynamics.C", dynamics.C, f"the model is not observable {text}")


def design_gains(
    parameters, controller: str, sample_time: float, bandwidth: float | None = None, q: float | None = None
) -> Designed:
    """Return the controller of the given name for the model in ``parameters``.

    Parameters
    ----------
    parameters : ControllerParameters
        Its model is used; what the design does not decide is kept.
    controller : str
        A name of :data:`TYPES`.
    sample_time : float
        [s]
    bandwidth : float, optional
        Frequency at which the response to the reference, without feedforward, falls by 3 dB [Hz].
    q : float, optional
        Variance of the input's noise over that of the measurement in the Kalman filter.

    Raises
    ------
    ParameterError
        The model is unstable, not observable or not controllable, or the bandwidth cannot be reached.
    """
    dynamics = parameters.model.dynamics
    require_minimal(dynamics)
    dynamics.require_sample_time(sample_time, "model.dynamics.sample_time")
    if bandwidth is not None and not 0.0 < bandwidth < 0.5 / sample_time:
        design.refuse(
            "bandwidth", bandwidth, f"must be above 0 and below half the sample rate, {0.5 / sample_time:g} Hz"
        )
    if controller == "pid":
        gains = design_pid(parameters.pid, dynamics, sample_time, bandwidth)
        found = replace(parameters, type="pid", pid=gains)
        return Designed(found, margins(found, sample_time))
    if not dynamics.order:
        design.refuse("model.dynamics.A", dynamics.A, f"{controller} needs a model with a state; choose pid")
    if controller == "super_twisting" and bandwidth is not None and dynamics.order < 2:
        allowed = (
            "a model of one state leaves super_twisting no pole to place; leave it out, or take another controller"
        )
        design.refuse("bandwidth", bandwidth, allowed)
    found = replace(
        parameters,
        type=TYPES[controller],
        kalman=_kalman(parameters.kalman, controller, q, dynamics.order),
        sliding_mode=replace(
            parameters.sliding_mode,
            tracking="target",
            hyperplane="lq",
            S=(),
            poles=(),
            poles_imaginary=(),
            lq_state_weight=(),
            lq_input_weight=INPUT_WEIGHT * dc_gain(*dynamics.matrices) ** 2,
        ),
    )
    if bandwidth is not None:
        place = _sliding_pole if controller == "super_twisting" else _reaching_law
        solved = _solved(found, sample_time)
        found = place(found, _pole_for(lambda pole: place(solved, pole), sample_time, bandwidth))
    return Designed(found, margins(found, sample_time))


def _kalman(given, controller: str, q: float | None, order: int):
    """Return the filter: a given gain only survives where it fits and no q is asked."""
    kept = given.disturbance if given.disturbance != "none" else "constant"
    # the published law has none; the others need it to reject what the model does not explain
    disturbance = "none" if controller == "smc" else kept
    fits = given.gain == "given" and disturbance == given.disturbance and q is None
    if fits:
        return given
    noise = given.q if q is None else q * given.r
    Q = given.Q if q is None else ()
    return replace(given, gain="riccati", L=(), disturbance=disturbance, q=noise, Q=Q)


def _reaching_law(parameters, pole: float):
    return replace(parameters, sliding_mode=replace(parameters.sliding_mode, phi=pole))


def _sliding_pole(parameters, pole: float):
    """Return the parameters with the sliding motion's slowest pole; its others are the fastest of the LQ problem."""
    A, B, C, D = design.matrices(parameters.model.dynamics)
    n = len(A)
    S = design_sliding_mode(parameters.sliding_mode, A, B, C, D).S
    sliding = np.linalg.eigvals(A - B @ (S @ A)[np.newaxis] / (S @ B).item())
    fastest = sorted(np.abs(sliding))[1 : n - 1]  # without the pole at 0 that is not of the sliding motion
    poles = (pole, *map(float, fastest))
    chosen = replace(parameters.sliding_mode, hyperplane="poles", S=(), poles=poles, poles_imaginary=())
    return replace(parameters, sliding_mode=chosen)


def _solved(parameters, sample_time: float):
    """Return the same design with hyperplane and filter gain as numbers: a search solves no Riccati equation."""
    matrices = design.matrices(parameters.model.dynamics)
    S = design_sliding_mode(parameters.sliding_mode, *matrices).S
    L = filter_gain(parameters.kalman, *matrices, sample_time)
    return replace(
        parameters,
        sliding_mode=replace(parameters.sliding_mode, hyperplane="given", S=tuple(S.tolist())),
        kalman=replace(parameters.kalman, gain="given", L=tuple(L.tolist())),
    )


def _pole_for(with_pole, sample_time: float, bandwidth: float) -> float:
    """Return the pole that gives the bandwidth, which grows as the pole goes from one to zero."""

    def reached(pole):
        return bandwidth_and_sensitivity(*linear_loop(with_pole(pole), sample_time), sample_time)[0]

    fast, slow = 0.0, SLOWEST
    if not bandwidth <= reached(fast):
        design.refuse("bandwidth", bandwidth, f"this controller reaches at most {reached(fast):.4g} Hz on its model")
    least = reached(slow)
    if bandwidth < least * (1.0 - TOLERANCE):
        allowed = (
            f"this controller reaches no less than {least:.4g} Hz on its model: inside the boundary layer eta and "
            "beta/delta add to the reaching law; lower them, or ask for more"
        )
        design.refuse("bandwidth", bandwidth, allowed)
    while slow - fast > PRECISION * (1.0 - slow):
        middle = 0.5 * (fast + slow)
        if reached(middle) < bandwidth:
            slow = middle
        else:
            fast = middle
    return fast
