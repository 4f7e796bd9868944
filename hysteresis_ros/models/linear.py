# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Linear dynamics of an actuator: discrete state-space systems, their kernels, delay and units (K4, K7).

Every linear system of the package is a :class:`StateSpace`. A plant is measured before the input changes in the same
sample: y_k = C x_k + D u_(k-1). :meth:`StateSpace.held` returns the system from u_k to this y_k.

Matrices keep the units in which they were published; ``input_scale`` and ``output_scale`` (SI per model unit) convert
to SI signals. In a Hammerstein model the dynamics have unit DC gain, which ``input_scale = 0`` sets.

A delay τ = (m + f) T of amplifier, converter and transport (m samples and a fraction f of a sample) is added to the
matrices. The input that acts in sample k is w_k = (1 − f) u_(k−m) + f u_(k−m−1), which is the mean of the delayed held
input over the sample. This is accurate for dynamics that are slow compared with a sample; the delayed inputs are
states. A rate-independent hysteresis and a delay commute, so the delay may be on either side of it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import Block, interpreted, kernel
from hysteresis_ros.models.linear_algebra import exponential, product, solve

#: A state nearer to 0 than this becomes 0. Otherwise a decaying state would become a subnormal number and remain one
#: (0.9 · 2.5e-323 rounds to itself); with subnormal numbers, processors compute up to thirty times more slowly. The
#: mode in which a processor itself replaces them by 0 is not used, because it may differ between threads and processes.
NOTHING = 1e-290
#: A pole or zero nearer to the unit circle than this counts as being on the circle.
BOUNDARY = 1e-9


@kernel
def accumulate(total, p, row, x, first, n):
    """Return ``total`` + Σ p[row + j] x[first + j] for j = 0 … n - 1, added in this order."""
    for j in range(n):
        total += p[row + j] * x[first + j]
    return total


@kernel
def advance(p, matrix, column, x, state, n, u):
    """Compute x⁺ = A x + B u with A (row by row) from p[matrix] and B from p[column]; n entries of scratch follow x.

    States nearer to 0 than :data:`NOTHING` become 0.
    """
    for i in range(n):
        x[state + n + i] = accumulate(p[column + i] * u, p, matrix + i * n, x, state, n)
    for i in range(n):
        value = x[state + n + i]
        # this form of the comparison keeps NaN
        x[state + i] = 0.0 if -NOTHING < value < NOTHING else value


@dataclass(frozen=True, eq=False)
class StateSpace:
    """Discrete state space x⁺ = A x + B u, y = C x + D u of n states, m inputs and q outputs.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n, m)
    C : ndarray, shape (q, n)
    D : ndarray, shape (q, m)
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray

    @property
    def order(self) -> int:
        """Number of states n."""
        return len(self.A)

    @property
    def poles(self) -> np.ndarray:
        """Poles in the z plane, complex or real, shape (n,)."""
        return np.linalg.eigvals(self.A)

    @property
    def stable(self) -> bool:
        """Whether all poles are inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0 - BOUNDARY))

    @property
    def dc_gain(self):
        """Gain C (I - A)⁻¹ B + D at frequency zero: a float for one input and one output, else shape (q, m)."""
        gain = product(self.C, solve(np.eye(self.order) - self.A, self.B)) + self.D
        return float(gain[0, 0]) if gain.size == 1 else gain

    def response(self, z) -> np.ndarray:
        """Return the transfer function C (z I - A)⁻¹ B + D.

        Parameters
        ----------
        z : array_like, shape (N,)
            Points in the z plane; exp(2π i f T) for the frequency f and the sample time T.

        Returns
        -------
        ndarray of complex, shape (N, q, m)
        """
        z = np.asarray(z, dtype=complex)
        if not self.order:
            return np.broadcast_to(self.D, (len(z), *self.D.shape)).astype(complex)
        resolvent = z[:, None, None] * np.eye(self.order) - self.A
        return self.C @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(z), *self.B.shape))) + self.D

    def held(self) -> StateSpace:
        """Return the system from u_k to y_k = C x_k + D u_(k-1); its last states are the previous inputs.

        Returns
        -------
        StateSpace
            System with n + m states and without feedthrough.
        """
        n, m, q = self.order, self.B.shape[1], len(self.C)
        A = np.block([[self.A, np.zeros((n, m))], [np.zeros((m, n + m))]])
        return StateSpace(A, np.vstack([self.B, np.eye(m)]), np.hstack([self.C, self.D]), np.zeros((q, m)))

    def scaled(self, gain: float) -> StateSpace:
        """Return the system with its output multiplied by ``gain``."""
        return StateSpace(self.A, self.B, gain * self.C, gain * self.D)

    @property
    def shown(self) -> StateSpace:
        """The system with only its first output."""
        return StateSpace(self.A, self.B, self.C[:1], self.D[:1])

    def part(self, states, inputs=None) -> StateSpace:
        """Return the system restricted to some states and inputs.

        Parameters
        ----------
        states : array_like of int
            States to keep; they must not depend on the other states.
        inputs : array_like of int, optional
            Inputs to keep; all by default.
        """
        chosen = slice(None) if inputs is None else inputs
        return StateSpace(
            self.A[np.ix_(states, states)], self.B[states][:, chosen], self.C[:, states], self.D[:, chosen]
        )


#: Sample times count as equal up to this relative difference, because a file may state them with fewer digits.
SAMPLE_TIME_TOLERANCE = 1e-6
#: Tolerance with which a delay counts as whole samples [samples].
DELAY_TOLERANCE = 1e-6
#: Longest delay [samples].
LONGEST_DELAY = 64

# Layout of p, followed by A (n·n, row by row), B (n) and C (n).
ORDER = 0
FEEDTHROUGH = 1
INPUT_SCALE = 2
OUTPUT_SCALE = 3
MATRICES = 4

# Layout of x, followed by the n states, and n entries of scratch for the next states.
HELD_INPUT = 0  # input of the last advance [SI]
STATE = 1


def zero_order_hold(A, B, sample_time: float):
    """Return the discrete (A, B) of the continuous ``x' = A x + B u`` for an input held over ``sample_time`` [s]."""
    A, B = np.atleast_2d(np.asarray(A, dtype=float)), np.asarray(B, dtype=float)
    B = B.reshape(len(A), -1)
    n, m = B.shape
    both = exponential(sample_time * np.block([[A, B], [np.zeros((m, n + m))]]))
    return both[:n, :n], both[:n, n:]


@dataclass(frozen=True)
class LinearParameters(Parameters):
    """Discrete state space x⁺ = A x + B u, y = C x + D u in model units; without A, y = u."""

    A: tuple[float, ...] = parameter((), description="state matrix, n·n numbers row by row; empty: no dynamics")
    B: tuple[float, ...] = parameter((), description="input matrix, n numbers")
    C: tuple[float, ...] = parameter((), description="output matrix, n numbers")
    D: tuple[float, ...] = parameter((), description="feedthrough, one number; empty: none")
    input_scale: float = parameter(
        0.0, description="SI units per model unit of the input; 0: the value for a DC gain of 1 in SI units", low=0.0
    )
    output_scale: float = parameter(1.0, description="SI units per model unit of the output", low=1e-15)
    sample_time: float = parameter(0.0, description="sample time of the matrices; 0: not stated", unit="s", low=0.0)
    delay: float = parameter(
        0.0,
        description="delay of amplifier, converter and transport, which the matrices do not include; may be a "
        "fractional number of samples; needs sample_time",
        unit="s",
        low=0.0,
    )

    @property
    def order(self) -> int:
        """Number of states, including the states of the delay."""
        whole, part = self.delayed_samples
        if not whole and not part:
            return self._rows
        return self._rows + whole + (part > 0.0) + (self.matrices.D.item() != 0.0)

    @property
    def _rows(self) -> int:
        return round(len(self.A) ** 0.5)

    @property
    def delayed_samples(self) -> tuple[int, float]:
        """The delay as m whole samples and a fraction f, 0 ≤ f < 1."""
        if not self.delay or not self.sample_time:
            return 0, 0.0
        samples = self.delay / self.sample_time
        whole = math.floor(samples + DELAY_TOLERANCE)
        part = samples - whole
        return whole, part if part > DELAY_TOLERANCE else 0.0

    @functools.cached_property
    def dc_gain(self) -> float:
        """DC gain of :attr:`state_space`, in model units."""
        return self.state_space.dc_gain

    @property
    def state_space(self) -> StateSpace:
        """The dynamics in model units, one input and one output; with a delay, the last states are the last inputs."""
        model, (whole, part) = self.matrices, self.delayed_samples
        if not whole and not part:
            return model
        n, order, through = model.order, self.order, model.D.item()
        inputs = np.zeros(order - n + 1)  # weights of u_k, u_(k-1), … in the input that acts
        inputs[whole] = 1.0 - part
        if part:
            inputs[whole + 1] = part
        A, B, C = np.zeros((order, order)), np.zeros((order, 1)), np.zeros((1, order))
        A[:n, :n], B[:n] = model.A, model.B * inputs[0]
        A[:n, n:] = model.B * inputs[1:]
        A[n + 1 :, n : order - 1] = np.eye(order - n - 1)
        B[n] = 1.0
        C[0, :n] = model.C[0]
        # the measurement contains the previous input u_(k-1) as feedthrough, and earlier inputs as states
        C[0, n + 1 :] = through * inputs[1:-1]
        return StateSpace(A, B, C, np.array([[through * inputs[0]]]))

    @property
    def acting(self) -> tuple[np.ndarray, float]:
        """The input that acts in a sample, as (row, through): row · x + through · u for the state x and the input u."""
        whole, part = self.delayed_samples
        n, row = self._rows, np.zeros(self.order)
        # after the states of the matrices, the states contain the last inputs, u_(k-1) first
        if whole:
            row[n + whole - 1] = 1.0 - part
        if part:
            row[n + whole] = part
        return row, 0.0 if whole else 1.0 - part

    @property
    def matrices(self) -> StateSpace:
        """The dynamics in model units without the delay."""
        n = self._rows
        D = self.D[0] if self.D else (0.0 if n else 1.0)
        A, B, C = (np.array(values, dtype=float) for values in (self.A, self.B, self.C))
        return StateSpace(A.reshape(n, n), B[:, np.newaxis], C[np.newaxis], np.array([[D]]))

    @functools.cached_property
    def resolved_input_scale(self) -> float:
        """``input_scale``; if it is 0, the value with which the DC gain in SI units is 1."""
        return self.input_scale or self.output_scale * self.matrices.dc_gain

    def require_sample_time(self, sample_time: float, name: str = "sample_time") -> None:
        """Raise ParameterError about ``name`` if a sample time [s] differs from that of the matrices."""
        if not self.order or not self.sample_time:
            return
        if abs(self.sample_time - sample_time) > SAMPLE_TIME_TOLERANCE * sample_time:
            remedy = (
                f"the matrices are for this sample time, but the axis runs at {sample_time:.9g} s (sample_rate "
                f"{1.0 / sample_time:.9g} Hz): set sample_rate to {1.0 / self.sample_time:.9g} Hz, or give matrices "
                "for the sample time of the axis"
            )
            raise ParameterError([Problem(name, self.sample_time, remedy)])

    def check(self):
        """Yield a Problem for wrong sizes, an unstable A, an unusable DC gain, or a delay without a sample time."""
        n = self._rows
        if self.delay and not self.sample_time:
            yield Problem(
                "delay", self.delay, "needs sample_time, because the delay is counted in samples; give sample_time"
            )
        elif self.delay > LONGEST_DELAY * self.sample_time:
            remedy = f"must be at most {LONGEST_DELAY} samples, {LONGEST_DELAY * self.sample_time:g} s"
            yield Problem("delay", self.delay, remedy)
        if n * n != len(self.A):
            yield Problem("A", self.A, "must be n·n numbers, the rows of a square matrix one after the other")
            return
        sizes = [(name, getattr(self, name)) for name in ("B", "C") if len(getattr(self, name)) != n]
        for name, value in sizes:
            yield Problem(name, value, f"must be {n} numbers, as many as A has rows")
        if len(self.D) > 1:
            yield Problem("D", self.D, "must be one number, or empty for no feedthrough")
        if sizes or len(self.D) > 1:
            return
        model = self.matrices
        radius = max(np.abs(model.poles), default=0.0)
        if radius >= 1.0:
            yield Problem(
                "A",
                self.A,
                f"is unstable: its largest pole has modulus {radius:.6g}, which must be below 1 (discrete time)",
            )
        elif self.input_scale == 0.0 and not model.dc_gain > 0.0:
            yield Problem(
                "input_scale",
                0.0,
                f"cannot be derived from the DC gain, which is {model.dc_gain:.3g}; give input_scale",
            )


@kernel
def linear_output(p, x):
    """Return the output [SI] at the present state; the feedthrough acts on the last held input."""
    n = int(p[ORDER])
    c = MATRICES + n * n + n
    y = p[FEEDTHROUGH] * (x[HELD_INPUT] / p[INPUT_SCALE])
    return accumulate(y, p, c, x, STATE, n) * p[OUTPUT_SCALE]


@kernel
def linear_advance(p, x, u):
    """Hold the input ``u`` [SI] for one sample and advance the state."""
    n = int(p[ORDER])
    b = MATRICES + n * n
    x[HELD_INPUT] = u
    advance(p, MATRICES, b, x, STATE, n, u / p[INPUT_SCALE])
    return u


@kernel
def linear(p, x, u):
    """Return the output [SI] one sample after the input ``u`` [SI] was applied: advance, then output."""
    linear_advance(p, x, u)
    return linear_output(p, x)


class LinearDynamics(Block):
    """Linear dynamics from displacement [m] to displacement [m].

    Parameters
    ----------
    parameters : LinearParameters
        Matrices in discrete time.
    sample_time : float
        Sample time of the matrices [s].

    Raises
    ------
    ParameterError
        The parameters are wrong, or are meant for another sample time.
    """

    kernel = staticmethod(linear)

    def pack(self, parameters: LinearParameters) -> np.ndarray:
        """Return p, shape (4 + n² + 2 n,)."""
        parameters.require_sample_time(self.sample_time, "dynamics.sample_time")
        model = parameters.state_space
        head = [parameters.order, model.D.item(), parameters.resolved_input_scale, parameters.output_scale]
        return np.concatenate([head, model.A.ravel(), model.B[:, 0], model.C[0]])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (1 + 2 n,), at rest with zero input."""
        return np.zeros(STATE + 2 * self.parameters.order)

    def output(self) -> float:
        """Return the output [SI] at the present state."""
        return interpreted(linear_output)(self.p, self.x)

    def settle(self, u: float) -> None:
        """Set the state to the steady state for the constant input ``u`` [SI]."""
        model, n = self.parameters.state_space, self.parameters.order
        self.x[:] = 0.0
        self.x[HELD_INPUT] = u
        if n:
            self.x[STATE : STATE + n] = solve(np.eye(n) - model.A, model.B[:, 0] * (u / self.p[INPUT_SCALE]))

    def retune(self, parameters: LinearParameters) -> None:
        """Change to matrices of the same order while running; the state is kept.

        Raises
        ------
        ParameterError
            The order differs, or the parameters are wrong.
        """
        given, present = parameters.validated(), self.parameters
        if len(given.A) != len(present.A):
            remedy = f"must have {len(present.B)} rows as before; another order needs a new configuration"
            raise ParameterError([Problem("A", parameters.A, remedy)])
        if given.order != present.order:
            remedy = (
                f"must be as many samples as the present delay, {present.delay:g} s; another delay needs "
                "a new configuration"
            )
            raise ParameterError([Problem("delay", given.delay, remedy)])
        super().retune(parameters)
