# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sliding surface: hyperplane and linear gain, switching function of the estimated state, and command.

With the target state x* and the distance x_e = x̂ - x* from it, s = S x_e and Λ = S B:

rest point  x* = N_x r, u* = N_u r: the model's equilibrium at the reference
trajectory  x*⁺ = A x* + B u_ff, u* = u_ff: the model's state with feedforward ``inverse_dynamics`` or ``velocity``

The trajectory starts at rest on the reference. With a static feedforward the target is still the rest point, because
this feedforward gives the command of the rest point, and the model's response to it would ring.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.kalman import (
    ESTIMATE,
    MATRICES,
    OFFSET,
    RUNNING,
    filter_length,
    input_matrix,
    kalman_state_size,
    kalman_step,
    pack_kalman,
    rest_state,
)
from hysteresis_ros.control.law import (
    APPLIED,
    COMMAND,
    DISTURBANCE,
    ESTIMATED,
    FED,
    FEEDFORWARD,
    HEADER,
    STARTED,
    SWITCHING,
    Controller,
    bounded,
)
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.linear import StateSpace, advance
from hysteresis_ros.models.linear_algebra import product


@dataclass(frozen=True)
class SlidingModeParameters(Parameters):
    """Hyperplane and laws of the three sliding mode controllers; gains are in the units of the model."""

    tracking: str = parameter(
        "target",
        choices=("target", "integral"),
        read_only=True,
        description="target: follow the model's equilibrium at the reference; integral: add an integral of the error",
    )
    hyperplane: str = parameter(
        "lq",
        choices=("given", "lq", "poles"),
        read_only=True,
        description="How S is determined: given, from an LQ problem, or from the poles of the sliding motion",
    )
    S: tuple[float, ...] = parameter(
        (), description="given: hyperplane, one entry per state; with integral tracking one more, for the integral"
    )
    lq_state_weight: tuple[float, ...] = parameter(
        (),
        description="State weight of the LQ problem: diagonal or rows of a matrix (with the integral as last state); "
        "empty: output squared plus 0.0001 of the integral squared",
    )
    lq_input_weight: float = parameter(1.0, low=0.0, description="Input weight of the LQ problem, above 0")
    poles: tuple[float, ...] = parameter(
        (),
        low=-1.0,
        high=1.0,
        description="Real parts of the poles of the sliding motion; their number is that of the states (including the "
        "integral) minus one",
    )
    poles_imaginary: tuple[float, ...] = parameter(
        (),
        low=-1.0,
        high=1.0,
        description="Imaginary parts of the poles, in conjugate pairs; empty: all poles are real",
    )
    phi: float = parameter(
        0.93, low=-1.0, high=1.0, description="Reaching law: s(k+1) = phi s(k) without the nonlinear part"
    )
    rejection_pole: float = parameter(
        0.5,
        low=-1.0,
        high=1.0,
        description="integral_sliding_mode: s(k+1) = rejection_pole s(k), the rejection of disturbances that the "
        "filter does not estimate; 0: within one sample, nearer to 1: slower and smoother",
    )
    eta: float = parameter(0.0, low=0.0, description="Slope of the nonlinear part against the magnitude of s / (S B)")
    beta: float = parameter(0.0, low=0.0, description="Constant level of the nonlinear part (input unit)")
    delta: float = parameter(0.0, low=0.0, description="Width of the boundary layer (unit of s)")
    anti_windup_threshold: float = parameter(
        0.02,
        low=0.0,
        description="The integral is held while command and achieved command differ by more than this "
        "fraction of the largest achieved command so far, if integrating would increase the "
        "difference",
    )


@dataclass(frozen=True, eq=False)
class SlidingModeDesign:
    """Gains of a sliding mode controller, computed from its parameters, in the units of the model.

    Attributes
    ----------
    S, K : ndarray, shape (n,) or (n + 1,) with integral tracking
        Hyperplane and linear gain.
    switching_gain : float
        Λ = S B.
    poles : ndarray, shape like S
        Poles of the model in closed loop.
    """

    S: np.ndarray
    K: np.ndarray
    switching_gain: float
    poles: np.ndarray


def design_sliding_mode(parameters: SlidingModeParameters, model: StateSpace) -> SlidingModeDesign:
    """Return hyperplane and linear gain for a model with one input and one output, in the model's own units.

    ParameterError: there is no stable controller; the message names the parameter of ``sliding_mode`` or
    ``model.dynamics``.
    """
    whole = model
    if parameters.tracking == "integral":
        state_feedback.steady_state(model)  # raises ParameterError if the DC gain is 0: the integral would never settle
        whole = state_feedback.integral_system(model)
    n, order, A, B = model.order, whole.order, whole.A, whole.B
    if parameters.hyperplane == "given":
        if len(parameters.S) != order:
            state_feedback.refuse(
                "sliding_mode.S", parameters.S, f"must have {order} entries with this model and tracking"
            )
        S = np.array(parameters.S, dtype=float)
    elif parameters.hyperplane == "poles":
        S = state_feedback.hyperplane_from_poles(A, B, _poles(parameters, order))
    else:
        if not parameters.lq_input_weight > 0.0:
            state_feedback.refuse("sliding_mode.lq_input_weight", parameters.lq_input_weight, "must be above 0")
        if parameters.lq_state_weight:
            weight = state_feedback.square_weight(parameters.lq_state_weight, order, "sliding_mode.lq_state_weight")
        else:
            weight = np.zeros((order, order))
            weight[:n, :n] = product(model.C.T, model.C)
            weight[n:, n:] = 1e-4
        S = state_feedback.hyperplane_lq(A, B, weight, parameters.lq_input_weight)
    if not abs(parameters.phi) < 1.0:
        state_feedback.refuse(
            "sliding_mode.phi", parameters.phi, "must be above -1 and below 1, or the switching function never decays"
        )
    if not parameters.phi - parameters.eta > -1.0:
        state_feedback.refuse("sliding_mode.eta", parameters.eta, f"must be below 1 + phi = {1.0 + parameters.phi:g}")
    K, switching_gain = state_feedback.sliding_gain(A, B, S, parameters.phi)
    return SlidingModeDesign(S, K, switching_gain, np.linalg.eigvals(A - B @ K[np.newaxis]))


def _poles(parameters: SlidingModeParameters, order: int):
    if len(parameters.poles) != order - 1:
        state_feedback.refuse("sliding_mode.poles", parameters.poles, f"must have {order - 1} entries with this model")
    imaginary = parameters.poles_imaginary or (0.0,) * (order - 1)
    if len(imaginary) != order - 1:
        state_feedback.refuse("sliding_mode.poles_imaginary", imaginary, f"must be empty or have {order - 1} entries")
    poles = [complex(*parts) for parts in zip(parameters.poles, imaginary, strict=True)]
    if sorted(poles, key=_order) != sorted((pole.conjugate() for pole in poles), key=_order):
        state_feedback.refuse("sliding_mode.poles_imaginary", imaginary, "complex poles must come in conjugate pairs")
    if any(abs(pole) >= 1.0 for pole in poles):
        state_feedback.refuse("sliding_mode.poles", parameters.poles, "all poles must be inside the unit circle")
    return poles


def _order(pole: complex):
    return pole.real, pole.imag


# Parameter array: a head (begins with FED), then K and S (n entries each), then the parameters of the Kalman filter.
N = 1
INTEGRATING = 2
INPUT_SCALE = 3
OUTPUT_SCALE = 4
PRELOAD = 5
REST_COMMAND = 6
INTEGRAL_GAIN = 7
INTEGRAL_HYPERPLANE = 8
SLOPE = 9
LEVEL = 10
WIDTH = 11
THRESHOLD = 12
MOVING = 13  # 1.0: the target is the model's trajectory under the feedforward
LAMBDA = 14  # S B
PHI = 15
OWN = 16  # first of the three entries that each law uses for its own parameters
GAINS = 19

# State array after the common part; then the state of the Kalman filter, the trajectory, and n entries of scratch.
INTEGRAL = HEADER  # integral of the error
LARGEST = HEADER + 1  # largest achieved command so far [m]
LINEAR = HEADER + 2  # K x_e
TARGET = HEADER + 3  # u*
MEMORY = HEADER + 4  # first of the two entries that each law uses for its own state
LAST = HEADER + 6  # last command of the law before limits, in the model's units
BEGUN = HEADER + 7  # 0.0: the law has not run yet, or must restart
OBSERVER = HEADER + 8


@kernel
def switching_function(p, x, reference, measured):
    """Update observer, integral and trajectory; store K x_e, u* and the estimates in x, and return s.

    While the measurement is NaN, the observer uses only its model, without an innovation.
    """
    n = int(p[N])
    hyperplane = GAINS + n
    observer = hyperplane + n
    rest = rest_state(p, observer)
    ahead = OBSERVER + filter_length(p, observer)
    applied = bounded(x[APPLIED])
    if abs(applied) > x[LARGEST]:
        x[LARGEST] = abs(applied)
    r = bounded(reference) / p[OUTPUT_SCALE]
    y = measured
    if measured == measured:
        y = (bounded(measured) - p[PRELOAD]) / p[OUTPUT_SCALE]
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        x[OBSERVER + RUNNING] = 0.0
        for i in range(n):
            x[ahead + i] = bounded(p[rest + i] * r)
    estimated = kalman_step(p, x, observer, OBSERVER, applied / p[INPUT_SCALE], y)
    if y != y:
        y = estimated
    s = 0.0
    linear = 0.0
    if p[MOVING] != 0.0:
        fed = bounded(x[FEEDFORWARD]) / p[INPUT_SCALE]
        x[TARGET] = fed
        for i in range(n):
            distance = x[OBSERVER + ESTIMATE + i] - x[ahead + i]
            s += p[hyperplane + i] * distance
            linear += p[GAINS + i] * distance
        advance(p, observer + MATRICES, input_matrix(p, observer), x, ahead, n, fed)
        for i in range(n):
            x[ahead + i] = bounded(x[ahead + i])
    else:
        x[TARGET] = p[REST_COMMAND] * r
        for i in range(n):
            distance = x[OBSERVER + ESTIMATE + i] - p[rest + i] * r
            s += p[hyperplane + i] * distance
            linear += p[GAINS + i] * distance
    if p[INTEGRATING] != 0.0:
        error = r - y
        # integrating changes the command by -INTEGRAL_GAIN * error
        if not widens(p, x, applied, -p[INTEGRAL_GAIN] * error):
            x[INTEGRAL] = bounded(x[INTEGRAL] + error)
        s += p[INTEGRAL_HYPERPLANE] * x[INTEGRAL]
        linear += p[INTEGRAL_GAIN] * x[INTEGRAL]
    x[LINEAR] = linear
    x[ESTIMATED] = bounded(estimated * p[OUTPUT_SCALE] + p[PRELOAD])
    return bounded(s)


@kernel
def widens(p, x, applied, change):
    """Return whether the command is saturated and ``change`` would drive it further into saturation."""
    excess = x[COMMAND] - applied
    return abs(excess) > p[THRESHOLD] * x[LARGEST] and change * (excess / p[INPUT_SCALE]) > 0.0


@kernel
def boundary_layer(p, s):
    """Return (η |Λ|⁻¹ |s| + β) sign(Λ) s / (|s| + δ), the nonlinear part of the law."""
    width = abs(s) + p[WIDTH]
    nonlinear = 0.0
    if width > 0.0:
        nonlinear = (p[SLOPE] * abs(s) + p[LEVEL]) * (s / width)
    return nonlinear


@kernel
def leave(p, x, s, command):
    """Store the ``command``, given in the model's units, and return it in [m]."""
    command = bounded(command)
    x[LAST] = command
    x[BEGUN] = 1.0
    command = bounded(command * p[INPUT_SCALE])
    x[SWITCHING] = s
    x[COMMAND] = command
    x[DISTURBANCE] = bounded(x[OBSERVER + OFFSET] * p[INPUT_SCALE])
    x[APPLIED] = command
    return command


@lru_cache(maxsize=16)
def pack_surface(parameters, sample_time: float | None):
    """Return the design and the parameter array (head, K, S, Kalman filter); both are cached for later calls.

    The array is read-only; its entries from ``OWN`` on are zero. The sample time [s] is needed only for a periodic
    disturbance. ParameterError: the design fails; names are relative to the controller's parameters.
    """
    dynamics, sliding_mode, kalman = parameters.model.dynamics, parameters.sliding_mode, parameters.kalman
    if not dynamics.order:
        state_feedback.refuse(
            "model.dynamics.A", dynamics.A, "sliding mode needs a model; give A, B, C or choose open_loop"
        )
    integral = sliding_mode.tracking == "integral"
    if integral and kalman.disturbance != "none":
        raise ParameterError(
            [
                Problem(
                    "kalman.disturbance",
                    kalman.disturbance,
                    "with sliding_mode.tracking = 'integral': two integrators would act on one offset; set "
                    "kalman.disturbance to none, or sliding_mode.tracking to target",
                )
            ]
        )
    model = dynamics.state_space
    n = model.order
    filtering = pack_kalman(kalman, model, sample_time)
    gains = design_sliding_mode(sliding_mode, model)
    _, rest_input = state_feedback.steady_state(model)
    sign = 1.0 if gains.switching_gain > 0.0 else -1.0
    head = np.zeros(GAINS)
    head[FED] = parameters.feedforward.type != "none"
    head[N] = n
    head[INTEGRATING] = integral
    head[INPUT_SCALE] = dynamics.resolved_input_scale
    head[OUTPUT_SCALE] = dynamics.output_scale
    head[PRELOAD] = parameters.model.preload.offset
    head[REST_COMMAND] = rest_input
    head[INTEGRAL_GAIN] = gains.K[n] if integral else 0.0
    head[INTEGRAL_HYPERPLANE] = gains.S[n] if integral else 0.0
    head[SLOPE] = sign * sliding_mode.eta / abs(gains.switching_gain)
    head[LEVEL] = sign * sliding_mode.beta
    head[WIDTH] = sliding_mode.delta
    head[THRESHOLD] = sliding_mode.anti_windup_threshold
    head[MOVING] = parameters.feedforward.inverts
    head[LAMBDA] = gains.switching_gain
    head[PHI] = sliding_mode.phi
    packed = np.concatenate([head, gains.K[:n], gains.S[:n], filtering])
    packed.flags.writeable = False
    return gains, packed


def require_target(parameters) -> None:
    """Raise ParameterError about ``sliding_mode.tracking`` if a law that already integrates has integral tracking."""
    if parameters.sliding_mode.tracking == "integral":
        state_feedback.refuse(
            "sliding_mode.tracking",
            "integral",
            f"{parameters.type} already integrates: two integrators would act on one offset; set it to target",
        )


def check_with(packed):
    """Return the check of a sliding mode controller: it designs the controller by ``packed(parameters, sample_time)``.

    ``packed`` raises ParameterError if the design fails.
    """

    def check(parameters, sample_time: float | None) -> None:
        if sample_time is not None or parameters.kalman.disturbance != "periodic":
            packed(parameters, sample_time)

    return check


class SlidingController(Controller):
    """Base of the sliding mode controllers.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        Sample time [s] of the discrete model.
    """

    predicts = True
    runs_beside = True

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample; in this sample the observer starts at rest at the measurement."""
        order = self.parameters.model.dynamics.order
        return np.zeros(OBSERVER + kalman_state_size(self.parameters.kalman, order) + 2 * order)

    @property
    def estimate(self) -> np.ndarray:
        """Copy of the estimated state in the model's units, shape (n,)."""
        first = OBSERVER + ESTIMATE
        return self.x[first : first + self.parameters.model.dynamics.order].copy()

    def shares_observer(self, other: Controller) -> bool:
        """Return whether both controllers have the same Kalman filter, the same model and the same feedforward."""
        if not isinstance(other, SlidingController):
            return False
        mine, theirs = self.parameters, other.parameters
        same = mine.model == theirs.model and mine.kalman == theirs.kalman and self.sample_time == other.sample_time
        return same and mine.feedforward == theirs.feedforward

    def continue_from(self, predecessor: Controller) -> None:
        """Take over the states of observer and trajectory from a controller that has the same observer and target."""
        self.x[OBSERVER:] = predecessor.x[OBSERVER:]
        self.x[LARGEST] = predecessor.x[LARGEST]
        self.x[STARTED] = predecessor.x[STARTED]

    def forget(self) -> None:
        """Reset the integrated states: errors during another law's operation do not belong in this law's integral."""
        self.x[INTEGRAL] = 0.0

    def settle(self, applied: float) -> bool:
        """Set the integrated states so that the command continues from ``applied`` [m]; False if impossible."""
        if self.p[INTEGRATING] == 0.0 or self.p[INTEGRAL_GAIN] == 0.0 or self.x[BEGUN] == 0.0:
            return False
        # after a reset, the last command does not contain an integral part
        self.x[INTEGRAL] = (self.x[LAST] - applied / self.p[INPUT_SCALE]) / self.p[INTEGRAL_GAIN]
        return True

    def retune(self, parameters) -> None:
        """Change gains or model while running; with a new model the observer restarts from rest.

        Raises
        ------
        ParameterError
            The parameters are wrong or change the structure; in this case the controller is not changed.
        """
        before = self.parameters.model
        super().retune(parameters)
        if parameters.model != before:
            # the present estimate is in the coordinates of the previous model
            self.x[STARTED] = 0.0
