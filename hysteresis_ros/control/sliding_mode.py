"""Sliding mode controller with boundary layer on the state estimated by a Kalman filter (K5, K6).

With x_e = x̂ − N_x r the distance from the rest point of the reference, hyperplane s = S x_e and Λ = S B:

u   = N_u r − d̂ + u_l + u_n
u_l = −Λ⁻¹ (S A − Φ S) x_e                                        (reaching law s⁺ = Φ s)
u_n = −(η |Λ|⁻¹ |s| + β) sign(Λ) s / (|s| + δ)                    (boundary layer of width δ)

Kim, Kim & Park 2009, eqs 6-12; eq. 9 prints S B where S A is meant, and sign(Λ) is one for their Λ > 0. As printed the
law regulates to zero; the rest point makes it follow a reference. With ``tracking: integral`` the state is x_e extended
by z_k = z_(k-1) + r_k − y_k (in the model's output unit), and S, K have one entry more.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hysteresis_ros.block import kernel
from hysteresis_ros.control import design
from hysteresis_ros.control.kalman import ESTIMATE, MATRICES, OFFSET, RUNNING, kalman_step, pack_kalman
from hysteresis_ros.control.open_loop import (
    APPLIED,
    COMMAND,
    DISTURBANCE,
    ESTIMATED,
    FED,
    HEADER,
    STARTED,
    SWITCHING,
    Controller,
    bounded,
)
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.parameters import Parameters, parameter

# Parameter array: a head (FED first), then K and S (n entries each), then the Kalman filter's.
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
GAINS = 13

# State array after the common part: integral of the error, largest applied command so far, then the Kalman filter's.
INTEGRAL = HEADER
LARGEST = HEADER + 1
OBSERVER = HEADER + 2


@kernel
def sliding_mode(p, x, reference, measured):
    """Return the command [m] for ``reference`` [m, without preload offset] and ``measured`` [m]."""
    n = int(p[N])
    hyperplane = GAINS + n
    observer = hyperplane + n
    rest = observer + MATRICES + n * n + 3 * n
    applied = bounded(x[APPLIED])
    if abs(applied) > x[LARGEST]:
        x[LARGEST] = abs(applied)
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        x[OBSERVER + RUNNING] = 0.0
    r = bounded(reference) / p[OUTPUT_SCALE]
    y = (bounded(measured) - p[PRELOAD]) / p[OUTPUT_SCALE]
    estimated = kalman_step(p, x, observer, OBSERVER, applied / p[INPUT_SCALE], y)
    s = 0.0
    linear = 0.0
    for i in range(n):
        distance = x[OBSERVER + ESTIMATE + i] - p[rest + i] * r
        s += p[hyperplane + i] * distance
        linear += p[GAINS + i] * distance
    if p[INTEGRATING] != 0.0:
        error = r - y
        excess = x[COMMAND] - applied
        # Integrating moves the command by -INTEGRAL_GAIN * error; hold while that leads further beyond the limits.
        outward = -p[INTEGRAL_GAIN] * error * (excess / p[INPUT_SCALE])
        if not (abs(excess) > p[THRESHOLD] * x[LARGEST] and outward > 0.0):
            x[INTEGRAL] = bounded(x[INTEGRAL] + error)
        s += p[INTEGRAL_HYPERPLANE] * x[INTEGRAL]
        linear += p[INTEGRAL_GAIN] * x[INTEGRAL]
    s = bounded(s)
    width = abs(s) + p[WIDTH]
    nonlinear = 0.0
    if width > 0.0:
        nonlinear = (p[SLOPE] * abs(s) + p[LEVEL]) * (s / width)
    disturbance = x[OBSERVER + OFFSET]
    command = bounded((p[REST_COMMAND] * r - disturbance - linear - nonlinear) * p[INPUT_SCALE])
    x[ESTIMATED] = bounded(estimated * p[OUTPUT_SCALE] + p[PRELOAD])
    x[SWITCHING] = s
    x[COMMAND] = command
    x[DISTURBANCE] = bounded(disturbance * p[INPUT_SCALE])
    x[APPLIED] = command
    return command


@dataclass(frozen=True)
class SlidingModeParameters(Parameters):
    """Sliding mode controller; gains are in the model's units."""

    tracking: str = parameter(
        "target",
        choices=("target", "integral"),
        read_only=True,
        description="Follow the reference by its rest point alone (target), or with an integral of the error as well",
    )
    hyperplane: str = parameter(
        "lq",
        choices=("given", "lq", "poles"),
        read_only=True,
        description="Whether S is given, follows from an LQ problem, or from the poles of the sliding motion",
    )
    S: tuple[float, ...] = parameter(
        (), description="Hyperplane when given: one entry a state, and one for the integral with integral tracking"
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
        description="Real parts of the poles of the sliding motion: one fewer than states (the integral counts as one)",
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
    eta: float = parameter(0.0, low=0.0, description="Slope of the nonlinear part over |s| / |S B|")
    beta: float = parameter(0.0, low=0.0, description="Constant level of the nonlinear part (input unit)")
    delta: float = parameter(0.0, low=0.0, description="Width of the boundary layer (unit of s)")
    anti_windup_threshold: float = parameter(
        0.1,
        low=0.0,
        description="The integral holds while command and applied differ by more than this fraction of the largest "
        "applied command so far and integrating would widen the difference",
    )


@dataclass(frozen=True, eq=False)
class SlidingModeDesign:
    """Gains that follow from the parameters, in the model's units.

    Attributes
    ----------
    S, K : ndarray, shape (n,) or (n + 1,) with integral tracking
        Hyperplane and linear gain.
    switching_gain : float
        Λ = S B.
    poles : ndarray, shape like S
        Poles of the controlled model.
    """

    S: np.ndarray
    K: np.ndarray
    switching_gain: float
    poles: np.ndarray


def design_sliding_mode(parameters: SlidingModeParameters, A, B, C, D) -> SlidingModeDesign:
    """Return hyperplane and linear gain for the model (A, B, C, D).

    Raises
    ------
    ParameterError
        Names the parameter of ``sliding_mode`` or ``model.dynamics`` from which no stable controller follows.
    """
    n = len(A)
    integral = parameters.tracking == "integral"
    if integral:
        design.steady_state(A, B, C, D)  # without DC gain the integral never settles
        A, B = design.integral_system(A, B, C, D)
    order = len(A)
    if parameters.hyperplane == "given":
        if len(parameters.S) != order:
            design.refuse("sliding_mode.S", parameters.S, f"must have {order} entries with this model and tracking")
        S = np.array(parameters.S, dtype=float)
    elif parameters.hyperplane == "poles":
        S = design.hyperplane_from_poles(A, B, _poles(parameters, order))
    else:
        if not parameters.lq_input_weight > 0.0:
            design.refuse("sliding_mode.lq_input_weight", parameters.lq_input_weight, "must be above 0")
        if parameters.lq_state_weight:
            weight = design.square_weight(parameters.lq_state_weight, order, "sliding_mode.lq_state_weight")
        else:
            weight = np.zeros((order, order))
            weight[:n, :n] = C.T @ C
            weight[n:, n:] = 1e-4
        S = design.hyperplane_lq(A, B, weight, parameters.lq_input_weight)
    if not abs(parameters.phi) < 1.0:
        design.refuse(
            "sliding_mode.phi", parameters.phi, "must be inside -1 … 1, or the switching function never decays"
        )
    if not parameters.phi - parameters.eta > -1.0:
        design.refuse("sliding_mode.eta", parameters.eta, f"must be below 1 + phi = {1.0 + parameters.phi:g}")
    K, switching_gain = design.sliding_gain(A, B, S, parameters.phi)
    return SlidingModeDesign(S, K, switching_gain, np.linalg.eigvals(A - B @ K[np.newaxis]))


def _poles(parameters: SlidingModeParameters, order: int):
    if len(parameters.poles) != order - 1:
        design.refuse("sliding_mode.poles", parameters.poles, f"must have {order - 1} entries with this model")
    imaginary = parameters.poles_imaginary or (0.0,) * (order - 1)
    if len(imaginary) != order - 1:
        design.refuse("sliding_mode.poles_imaginary", imaginary, f"must be empty or have {order - 1} entries")
    poles = [complex(*parts) for parts in zip(parameters.poles, imaginary, strict=True)]
    if sorted(poles, key=_order) != sorted((pole.conjugate() for pole in poles), key=_order):
        design.refuse("sliding_mode.poles_imaginary", imaginary, "complex poles must come in conjugate pairs")
    if any(abs(pole) >= 1.0 for pole in poles):
        design.refuse("sliding_mode.poles", parameters.poles, "all poles must be inside the unit circle")
    return poles


def _order(pole: complex):
    return pole.real, pole.imag


@lru_cache(maxsize=16)
def packed_sliding_mode(parameters) -> np.ndarray:
    """Return the whole parameter array of ControllerParameters (read only): checks and packing design only once.

    Raises
    ------
    ParameterError
        The design fails; names are relative to the controller's parameters.
    """
    dynamics, smc, kalman = parameters.model.dynamics, parameters.sliding_mode, parameters.kalman
    if not dynamics.order:
        design.refuse("model.dynamics.A", dynamics.A, "sliding mode needs a model; give A, B, C or choose open_loop")
    if smc.tracking == "integral" and kalman.disturbance == "constant":
        raise ParameterError(
            [
                Problem(
                    "kalman.disturbance",
                    "constant",
                    "together with sliding_mode.tracking = 'integral' are two integrators for one offset; "
                    "set kalman.disturbance to none or sliding_mode.tracking to target",
                )
            ]
        )
    A, B, C, D = design.matrices(dynamics)
    n = len(A)
    filtering = pack_kalman(kalman, A, B, C, D)
    gains = design_sliding_mode(smc, A, B, C, D)
    _, rest_input = design.steady_state(A, B, C, D)
    integral = smc.tracking == "integral"
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
    head[SLOPE] = sign * smc.eta / abs(gains.switching_gain)
    head[LEVEL] = sign * smc.beta
    head[WIDTH] = smc.delta
    head[THRESHOLD] = smc.anti_windup_threshold
    packed = np.concatenate([head, gains.K[:n], gains.S[:n], filtering])
    packed.flags.writeable = False
    return packed


class SlidingMode(Controller):
    """Sliding mode controller with Kalman filter.

    Parameters
    ----------
    parameters : ControllerParameters
        With ``type`` sliding_mode.
    sample_time : float
        Sample time [s]; the model is discrete at this time.
    """

    kernel = staticmethod(sliding_mode)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array: head, K, S, Kalman filter."""
        return packed_sliding_mode(parameters).copy()

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample; the observer then starts from rest at the measurement."""
        return np.zeros(OBSERVER + ESTIMATE + 2 * self.parameters.model.dynamics.order)

    @property
    def estimate(self) -> np.ndarray:
        """The estimated state in the model's units, shape (n,); a copy."""
        first = OBSERVER + ESTIMATE
        return self.x[first : first + self.parameters.model.dynamics.order].copy()

    def retune(self, parameters) -> None:
        """Take new gains or a new model while running; a new model makes the observer start again from rest.

        Raises
        ------
        ParameterError
            The parameters are wrong or change the structure; the controller is unchanged then.
        """
        before = self.parameters.model
        super().retune(parameters)
        if parameters.model != before:
            # The old estimate is in the coordinates of the old model.
            self.x[STARTED] = 0.0
