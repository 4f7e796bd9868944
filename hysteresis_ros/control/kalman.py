"""Kalman filter with steady gain, in predictor or current form, with or without a constant disturbance (K6).

All signals are in the model's own units. At sample k the filter receives the input really applied at sample k - 1 and
the measurement y_k = C x_k + D u_(k-1). With d̂ the estimated disturbance of the input:

predictor   x̂_k = A x̂_(k-1) + B (u_(k-1) + d̂) + L ε_(k-1)             (y_k acts from sample k + 1)
current     x̂_k = x̄_k + L ε_k,  x̄_k = A x̂_(k-1) + B (u_(k-1) + d̂)    (y_k acts at once)

where ε is the innovation, measured minus predicted output. Kim, Kim & Park 2009, eqs 13-15, print the predictor form
(and call it current).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.block import Block, compiled, kernel
from hysteresis_ros.control import design
from hysteresis_ros.control.open_loop import bounded, run_controller
from hysteresis_ros.parameters import Parameters, parameter

# Parameter array: a head, then A (rows), B, C, L, N_x.
ORDER = 0
CURRENT = 1
DISTURBED = 2
FEEDTHROUGH = 3
DISTURBANCE_GAIN = 4
REST_INPUT = 5
MATRICES = 6

# State array: a head, then the estimate x̂ and n places to compute the next one in.
RUNNING = 0
INNOVATION = 1
OFFSET = 2
ESTIMATE = 3


@kernel
def kalman_step(p, x, first, start, applied, measured):
    """Update the estimate and return the estimated output; the filter's arrays begin at p[first] and x[start].

    Parameters
    ----------
    p, x : ndarray
        Arrays of the filter, or of a block that contains one.
    first, start : int
        Where the filter's part begins.
    applied : float
        Input really applied at the previous sample.
    measured : float
        Measurement of this sample.
    """
    n = int(p[first + ORDER])
    a = first + MATRICES
    b = a + n * n
    c = b + n
    gain = c + n
    rest = gain + n
    now = start + ESTIMATE
    following = now + n
    if x[start + RUNNING] == 0.0:
        # The plant is taken to be at rest where it is measured.
        x[start + RUNNING] = 1.0
        x[start + INNOVATION] = 0.0
        for i in range(n):
            x[now + i] = bounded(p[rest + i] * measured)
        x[start + OFFSET] = p[first + DISTURBED] * bounded(p[first + REST_INPUT] * measured - applied)
        return measured
    late = 0.0
    if p[first + CURRENT] == 0.0:
        late = x[start + INNOVATION]
    entering = applied + x[start + OFFSET]
    for i in range(n):
        value = p[b + i] * entering + p[gain + i] * late
        for j in range(n):
            value += p[a + i * n + j] * x[now + j]
        x[following + i] = bounded(value)
    for i in range(n):
        x[now + i] = x[following + i]
    x[start + OFFSET] = bounded(x[start + OFFSET] + p[first + DISTURBANCE_GAIN] * late)
    output = p[first + FEEDTHROUGH] * (applied + x[start + OFFSET])
    for i in range(n):
        output += p[c + i] * x[now + i]
    innovation = bounded(measured - output)
    x[start + INNOVATION] = innovation
    if p[first + CURRENT] != 0.0:
        for i in range(n):
            correction = p[gain + i] * innovation
            x[now + i] = bounded(x[now + i] + correction)
            output += p[c + i] * correction
        x[start + OFFSET] = bounded(x[start + OFFSET] + p[first + DISTURBANCE_GAIN] * innovation)
    return output


@kernel
def kalman(p, x, applied, measured):
    """Return the estimated output after one sample; arguments like :func:`kalman_step`."""
    return kalman_step(p, x, 0, 0, applied, measured)


@dataclass(frozen=True)
class KalmanParameters(Parameters):
    """Kalman filter of the controller's model, in the model's units."""

    form: str = parameter(
        "predictor",
        choices=("predictor", "current"),
        read_only=True,
        description="Whether a measurement acts on the command of the next sample (predictor) or of this one (current)",
    )
    gain: str = parameter(
        "riccati",
        choices=("given", "riccati"),
        read_only=True,
        description="Whether L is given or follows from the noise through the Riccati equation",
    )
    L: tuple[float, ...] = parameter(
        (),
        description="Gain when given, in the chosen form: one entry a state, and one for the disturbance if estimated",
    )
    q: float = parameter(
        1.0, low=0.0, description="Variance of the noise of the input: process noise Q = q B B^T (input unit squared)"
    )
    Q: tuple[float, ...] = parameter(
        (), description="Full process noise matrix in rows, or its diagonal; replaces q when not empty"
    )
    r: float = parameter(1.0, low=0.0, description="Variance of the measurement noise (output unit squared), above 0")
    disturbance: str = parameter(
        "none",
        choices=("none", "constant"),
        read_only=True,
        description="Whether a constant disturbance of the input is estimated and compensated: offset-free tracking",
    )
    q_disturbance: float = parameter(
        1e-4,
        low=0.0,
        description="Variance by which the disturbance may wander each sample (input unit squared), above 0",
    )


def filter_gain(parameters: KalmanParameters, A, B, C, D):
    """Return the gain in the chosen form, shape (n,) or (n + 1,) with a disturbance.

    Raises
    ------
    ParameterError
        ``kalman.form``, ``kalman.L``, ``kalman.q``, ``kalman.Q``, ``kalman.r``, ``kalman.q_disturbance`` or
        ``model.dynamics.C``: no stable filter follows from these.
    """
    current = parameters.form == "current"
    disturbed = parameters.disturbance == "constant"
    if current and D != 0.0:
        design.refuse("kalman.form", "current", "needs a model with D = 0; choose predictor or give D = 0")
    n = len(A)
    whole, output = design.disturbance_system(A, B, C, D) if disturbed else (A, C)
    if parameters.gain == "given":
        if len(parameters.L) != len(whole):
            design.refuse("kalman.L", parameters.L, f"must have {len(whole)} entries with this model and disturbance")
        L = np.array(parameters.L, dtype=float)
        if not design.detectable(whole, output):
            design.refuse("model.dynamics.C", tuple(C[0].tolist()), "a mode that does not decay cannot be seen in it")
        late = whole @ L if current else L
        design.require_stable(whole - np.outer(late, output[0]), "kalman.L", parameters.L, "the Kalman filter")
        return L
    if not parameters.r > 0.0:
        design.refuse("kalman.r", parameters.r, "must be above 0 for the Riccati equation")
    noise = np.zeros((len(whole), len(whole)))
    noise[:n, :n] = design.square_weight(parameters.Q, n, "kalman.Q") if parameters.Q else parameters.q * B @ B.T
    if disturbed:
        if not parameters.q_disturbance > 0.0:
            design.refuse("kalman.q_disturbance", parameters.q_disturbance, "must be above 0 to estimate a disturbance")
        noise[n, n] = parameters.q_disturbance
    gain, _ = design.kalman_gain(whole, output, noise, parameters.r)
    return gain if current else whole @ gain


def pack_kalman(parameters: KalmanParameters, A, B, C, D) -> np.ndarray:
    """Return the filter's parameter array, shape (6 + n² + 4 n,)."""
    n = len(A)
    disturbed = parameters.disturbance == "constant"
    L = filter_gain(parameters, A, B, C, D)
    rest_state, rest_input = design.steady_state(A, B, C, D)
    head = [n, parameters.form == "current", disturbed, D, L[n] if disturbed else 0.0, rest_input]
    return np.concatenate([head, A.ravel(), B.ravel(), C.ravel(), L[:n], rest_state]).astype(float)


class KalmanFilter(Block):
    """The filter on its own, in the model's units: ``step(applied, measured)`` returns the estimated output.

    Parameters
    ----------
    parameters : KalmanParameters
    sample_time : float
        Sample time [s]; the model is discrete, so it only documents the rate.
    dynamics : LinearParameters
        The model.
    """

    kernel = staticmethod(kalman)

    def __init__(self, parameters: KalmanParameters, sample_time: float, dynamics):
        """Check the model, then build the block; arguments as in the class."""
        self.dynamics = dynamics.validated("model.dynamics.")
        super().__init__(parameters, sample_time)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array of :func:`pack_kalman`."""
        return pack_kalman(parameters, *design.matrices(self.dynamics))

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample."""
        return np.zeros(ESTIMATE + 2 * self.dynamics.order)

    def step(self, applied: float, measured: float) -> float:
        """Return the estimated output after one sample."""
        return self.kernel(self.p, self.x, float(applied), float(measured))

    def simulate(self, applied, measured) -> np.ndarray:
        """Return the estimated outputs, shape (N,), for recorded ``applied`` and ``measured``, shape (N,)."""
        applied = np.ascontiguousarray(applied, dtype=np.float64)
        measured = np.ascontiguousarray(measured, dtype=np.float64)
        output = np.empty_like(applied)
        compiled(run_controller)(self.kernel, self.p, self.x, applied, measured, output)
        return output

    @property
    def estimate(self) -> np.ndarray:
        """The estimated state, shape (n,); a copy."""
        return self.x[ESTIMATE : ESTIMATE + self.dynamics.order].copy()
