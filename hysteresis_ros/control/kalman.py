# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Kalman filter with a steady gain, in predictor or current form, with or without a model of the disturbance.

All signals are in the model's own units. At sample k the filter receives the input actually applied at sample k - 1 and
the measurement y_k = C x_k + D u_(k-1). With the estimated disturbance d̂_k of the input in sample k, the forms are

predictor   x̂_k = A x̂_(k-1) + B (u_(k-1) + d̂_(k-1)) + L ε_(k-1)        (y_k acts from sample k + 1)
current     x̂_k = x̄_k + L ε_k,  x̄_k = A x̂_(k-1) + B (u_(k-1) + d̂_(k-1))    (y_k acts in this sample)

where ε is the innovation, measured minus predicted output. Kim, Kim & Park 2009, eqs 13-15, print the predictor form
and call it the current form.

The disturbance d has its own model, w⁺ = A_d w, d = c_d w (internal model principle; Francis & Wonham 1976):

constant    d⁺ = d
ramp        d⁺ = d + v, v⁺ = v
periodic    a constant and, at the frequency and each of its harmonics, a resonator a⁺ = cos(φ) a + sin(φ) b, b⁺ =
            cos(φ) b - sin(φ) a with the phase advance φ per sample; d is the constant and the sum of all a

At sample k, a controller compensates d̂_k, which is predicted for the sample in which the command acts.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.law import bounded, run_controller
from hysteresis_ros.models.block import Block, compiled, kernel
from hysteresis_ros.models.linear import StateSpace, accumulate
from hysteresis_ros.models.linear_algebra import product

# Parameter array: a head; A (row by row), B, C, L and N_x of the model; A_d (row by row), c_d, gain and feedthrough of
# the disturbance's model.
ORDER = 0
CURRENT = 1
DISTURBED = 2  # number of states of the disturbance's model
FEEDTHROUGH = 3
REST_INPUT = 4
MATRICES = 5

# State array: a head; the estimate x̂ and n entries of scratch; the estimate of w and as many entries of scratch.
RUNNING = 0
INNOVATION = 1
OFFSET = 2
ESTIMATE = 3


@kernel
def input_matrix(p, first):
    """Return the index in ``p`` of the model's B; the filter's part of ``p`` begins at p[first]."""
    n = int(p[first + ORDER])
    return first + MATRICES + n * n


@kernel
def rest_state(p, first):
    """Return the index in ``p`` of N_x, the steady state of the model for an output of 1."""
    return input_matrix(p, first) + 3 * int(p[first + ORDER])


@kernel
def filter_length(p, first):
    """Return the number of entries that the filter has in the state array."""
    return ESTIMATE + 2 * (int(p[first + ORDER]) + int(p[first + DISTURBED]))


@kernel
def kalman_step(p, x, first, start, applied, measured):
    """Update the estimate and return the estimated output; the filter's arrays begin at p[first] and x[start].

    ``applied`` is the input that was actually applied in the previous sample, ``measured`` the measurement of this
    sample.
    """
    n = int(p[first + ORDER])
    m = int(p[first + DISTURBED])
    a = first + MATRICES
    b = input_matrix(p, first)
    c = b + n
    gain = c + n
    rest = rest_state(p, first)
    transition = rest + n
    shown = transition + m * m
    correction = shown + m
    through = correction + m
    now = start + ESTIMATE
    following = now + n
    cause = following + n
    coming = cause + m
    if x[start + RUNNING] == 0.0:
        # assume that the plant is at rest at its measured position, under a constant disturbance
        x[start + RUNNING] = 1.0
        x[start + INNOVATION] = 0.0
        for i in range(n):
            x[now + i] = bounded(p[rest + i] * measured)
        for i in range(m):
            x[cause + i] = 0.0
        x[start + OFFSET] = 0.0
        if m > 0:
            x[cause] = bounded(p[first + REST_INPUT] * measured - applied)
            x[start + OFFSET] = x[cause]
        return measured
    late = 0.0
    if p[first + CURRENT] == 0.0:
        late = x[start + INNOVATION]
    entering = applied + x[start + OFFSET]
    for i in range(n):
        pushed = p[b + i] * entering + p[gain + i] * late
        x[following + i] = bounded(accumulate(pushed, p, a + i * n, x, now, n))
    for i in range(n):
        x[now + i] = x[following + i]
    for i in range(m):
        x[coming + i] = bounded(accumulate(p[correction + i] * late, p, transition + i * m, x, cause, m))
    for i in range(m):
        x[cause + i] = x[coming + i]
    offset = accumulate(0.0, p, shown, x, cause, m)
    output = accumulate(p[first + FEEDTHROUGH] * applied, p, through, x, cause, m)
    output = accumulate(output, p, c, x, now, n)
    innovation = bounded(measured - output)
    x[start + INNOVATION] = innovation
    if p[first + CURRENT] != 0.0:
        for i in range(n):
            change = p[gain + i] * innovation
            x[now + i] = bounded(x[now + i] + change)
            output += p[c + i] * change
        for i in range(m):
            x[cause + i] = bounded(x[cause + i] + p[correction + i] * innovation)
        offset = accumulate(0.0, p, shown, x, cause, m)
    x[start + OFFSET] = bounded(offset)
    return output


@kernel
def kalman(p, x, applied, measured):
    """Return the estimated output after one sample; arguments as in :func:`kalman_step`."""
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
        description="given: gain in the chosen form, one entry per state of the model, then one per state of the "
        "disturbance (constant 1, ramp 2, periodic 1 + 2 harmonics)",
    )
    q: float = parameter(
        1.0, low=0.0, description="Variance of the input noise: process noise Q = q B B^T (input unit squared)"
    )
    Q: tuple[float, ...] = parameter(
        (), description="Full process noise matrix in rows, or its diagonal; replaces q when not empty"
    )
    r: float = parameter(1.0, low=0.0, description="Variance of the measurement noise (output unit squared), above 0")
    disturbance: str = parameter(
        "none",
        choices=("none", "constant", "ramp", "periodic"),
        read_only=True,
        description="Model of the input disturbance that is estimated and compensated: none, constant (offset-free), "
        "ramp (value and increment per sample), periodic (constant and resonators at a frequency and its harmonics)",
    )
    q_disturbance: float = parameter(
        1e-4,
        low=0.0,
        description="Variance of the disturbance's change per sample (input unit squared), above 0",
    )
    q_disturbance_rate: float = parameter(
        1e-6,
        low=0.0,
        description="ramp: variance of the change of the disturbance's increment per sample "
        "(input unit squared), above 0",
    )
    q_disturbance_periodic: float = parameter(
        1e-4,
        low=0.0,
        description="periodic: variance of the change of each resonator per sample (input unit squared), above 0",
    )
    disturbance_frequency: float = parameter(
        1.0, unit="Hz", low=0.0, description="periodic: frequency of the disturbance, usually that of the reference"
    )
    disturbance_harmonics: int = parameter(
        1, low=1, high=10, read_only=True, description="periodic: number of resonators, at 1, 2, … times the frequency"
    )


def disturbance_states(parameters: KalmanParameters) -> int:
    """Return the number of states of the disturbance's model."""
    sizes = {"none": 0, "constant": 1, "ramp": 2}
    return sizes.get(parameters.disturbance, 1 + 2 * parameters.disturbance_harmonics)


def disturbance_model(parameters: KalmanParameters, sample_time: float | None):
    """Return the model w⁺ = A_d w, d = c_d w of the disturbance, and the variances of the noise of w per sample.

    Shapes: A_d (m, m), c_d and variances (m,). The sample time [s] is needed only for a periodic disturbance.
    ParameterError: ``kalman.disturbance_frequency`` is out of range, or a variance is zero.
    """
    m = disturbance_states(parameters)
    A_d, c_d, variances = np.eye(m), np.zeros(m), np.zeros(m)
    if not m:
        return A_d, c_d, variances
    used = ["q_disturbance"]
    c_d[0] = 1.0
    variances[0] = parameters.q_disturbance
    if parameters.disturbance == "ramp":
        used.append("q_disturbance_rate")
        A_d[0, 1] = 1.0
        variances[1] = parameters.q_disturbance_rate
    elif parameters.disturbance == "periodic":
        used.append("q_disturbance_periodic")
        frequency, harmonics = parameters.disturbance_frequency, parameters.disturbance_harmonics
        if sample_time is None or not 0.0 < frequency * harmonics < 0.5 / sample_time:
            half = "half the sample rate" if sample_time is None else f"half the sample rate, {0.5 / sample_time:g} Hz,"
            state_feedback.refuse(
                "kalman.disturbance_frequency",
                frequency,
                f"this frequency and its harmonics must be above 0 and below {half}",
            )
        for harmonic in range(1, harmonics + 1):
            i, phase = 2 * harmonic - 1, 2.0 * pi * frequency * harmonic * sample_time
            A_d[i : i + 2, i : i + 2] = [[cos(phase), sin(phase)], [-sin(phase), cos(phase)]]
            c_d[i] = 1.0
            variances[i : i + 2] = parameters.q_disturbance_periodic
    if parameters.gain == "riccati":
        for name in used:
            if not getattr(parameters, name) > 0.0:
                state_feedback.refuse(
                    f"kalman.{name}", getattr(parameters, name), "must be above 0 to estimate a disturbance"
                )
    return A_d, c_d, variances


def filter_gain(parameters: KalmanParameters, model: StateSpace, sample_time: float | None = None):
    """Return the filter gain in the chosen form, shape (n + m,); the disturbance's model has m states.

    ``model`` has one input and one output and is in its own units. The sample time [s] is needed only for a periodic
    disturbance. ParameterError about a parameter of ``kalman`` or about ``model.dynamics.C``: there is no stable
    filter.
    """
    current = parameters.form == "current"
    if current and model.D.item() != 0.0:
        state_feedback.refuse("kalman.form", "current", "needs a model with D = 0; choose predictor or give D = 0")
    n, A, B, C = model.order, model.A, model.B, model.C
    A_d, c_d, variances = disturbance_model(parameters, sample_time)
    disturbed = state_feedback.disturbance_system(model, A_d, c_d)
    whole, output = disturbed.A, disturbed.C
    if parameters.gain == "given" and len(parameters.L) != len(whole):
        state_feedback.refuse(
            "kalman.L", parameters.L, f"must have {len(whole)} entries with this model and disturbance"
        )
    if not state_feedback.detectable(whole, output):
        if len(A_d) and state_feedback.detectable(A, C):
            state_feedback.refuse(
                "kalman.disturbance",
                parameters.disturbance,
                "is not observable: the model has a zero at the frequency of the disturbance (on the unit circle); "
                "choose none or another frequency",
            )
        state_feedback.refuse(
            "model.dynamics.C",
            tuple(C[0].tolist()),
            "an undamped mode is not observable; give a model in which every such mode is observable",
        )
    if parameters.gain == "given":
        L = np.array(parameters.L, dtype=float)
        late = product(whole, L) if current else L
        state_feedback.require_stable(whole - np.outer(late, output[0]), "kalman.L", parameters.L, "the Kalman filter")
        return L
    if not parameters.r > 0.0:
        state_feedback.refuse("kalman.r", parameters.r, "must be above 0 for the Riccati equation")
    noise = np.diag(np.append(np.zeros(n), variances))
    noise[:n, :n] = (
        state_feedback.square_weight(parameters.Q, n, "kalman.Q") if parameters.Q else product(parameters.q * B, B.T)
    )
    gain, _ = state_feedback.kalman_gain(whole, output, noise, parameters.r)
    return gain if current else product(whole, gain)


def pack_kalman(parameters: KalmanParameters, model: StateSpace, sample_time: float | None = None) -> np.ndarray:
    """Return the filter's parameter array, shape (5 + n² + 4 n + m² + 3 m,)."""
    n = model.order
    A_d, c_d, _ = disturbance_model(parameters, sample_time)
    L = filter_gain(parameters, model, sample_time)
    output = state_feedback.disturbance_system(model, A_d, c_d).C
    rest_state, rest_input = state_feedback.steady_state(model)
    head = [n, parameters.form == "current", len(A_d), model.D.item(), rest_input]
    matrices = [model.A.ravel(), model.B.ravel(), model.C.ravel(), L[:n], rest_state]
    return np.concatenate([head, *matrices, A_d.ravel(), c_d, L[n:], output[0, n:]]).astype(float)


def kalman_state_size(parameters: KalmanParameters, order: int) -> int:
    """Return the length of the filter's state array for a model of ``order`` states."""
    return ESTIMATE + 2 * (order + disturbance_states(parameters))


class KalmanFilter(Block):
    """The filter as a separate block, in the model's units: ``step(applied, measured)`` returns the estimated output.

    Parameters
    ----------
    parameters : KalmanParameters
    sample_time : float
        Sample time [s] of the discrete model.
    dynamics : LinearParameters
        The model.
    """

    kernel = staticmethod(kalman)

    def __init__(self, parameters: KalmanParameters, sample_time: float, dynamics):
        """Check the model, then build the block; the arguments are those of the class."""
        self.dynamics = dynamics.validated("model.dynamics.")
        super().__init__(parameters, sample_time)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array of :func:`pack_kalman`."""
        return pack_kalman(parameters, self.dynamics.state_space, self.sample_time)

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample."""
        return np.zeros(kalman_state_size(self.parameters, self.dynamics.order))

    def step(self, applied: float, measured: float) -> float:
        """Return the estimated output after one sample."""
        return self.kernel(self.p, self.x, float(applied), float(measured))

    def simulate(self, applied, measured) -> np.ndarray:
        """Return the estimated outputs for recorded signals ``applied`` and ``measured``, all of shape (N,)."""
        applied = np.ascontiguousarray(applied, dtype=np.float64)
        measured = np.ascontiguousarray(measured, dtype=np.float64)
        output = np.empty_like(applied)
        compiled(run_controller)(self.kernel, self.p, self.x, applied, measured, output)
        return output

    @property
    def estimate(self) -> np.ndarray:
        """Copy of the estimated state, shape (n,)."""
        return self.x[ESTIMATE : ESTIMATE + self.dynamics.order].copy()
