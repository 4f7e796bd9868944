# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Linear dynamics of an actuator: a discrete state space of one input and one output (K4, K7).

Matrices stay in the units in which they were published; ``input_scale`` and ``output_scale`` (SI per model unit) join
them to the SI signals. In a Hammerstein model the dynamics have unit DC gain, which ``input_scale = 0`` arranges.

A delay τ = (m + f) T of amplifier, converter and transport, of m samples and a part f of one, comes on top of the
matrices: the input that acts in sample k is w_k = (1 − f) u_(k−m) + f u_(k−m−1), the mean over the sample of the input
held τ later. For dynamics slow against a sample that is the delayed input exactly; the inputs on their way are states.
A rate-independent hysteresis and a delay commute, so the delay may stand on either side of it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.block import Block, interpreted, kernel
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.linear_algebra import exponential, solve
from hysteresis_ros.models.state_space import StateSpace, accumulate, advance
from hysteresis_ros.parameters import Parameters, parameter

#: Sample times that differ by less than this part are the same one, written with fewer digits.
SAMPLE_TIME_TOLERANCE = 1e-6
#: A delay this close to whole samples, in samples, is one of whole samples.
DELAY_TOLERANCE = 1e-6
#: Longest delay [samples].
LONGEST_DELAY = 64

# Layout of p, followed by A (n·n, row by row), B (n) and C (n).
ORDER = 0
FEEDTHROUGH = 1
INPUT_SCALE = 2
OUTPUT_SCALE = 3
MATRICES = 4

# Layout of x, followed by the n states and n numbers of scratch for the next ones.
HELD_INPUT = 0  # [SI], the input of the last advance
STATE = 1


def zero_order_hold(A, B, sample_time: float):
    """Return the discrete (A, B) of continuous ``x' = A x + B u`` whose input is held over ``sample_time`` [s].

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, m)
    sample_time : float

    Returns
    -------
    tuple of ndarray, shapes (n, n) and (n, m)
    """
    A, B = np.atleast_2d(np.asarray(A, dtype=float)), np.asarray(B, dtype=float)
    B = B.reshape(len(A), -1)
    n, m = B.shape
    both = exponential(sample_time * np.block([[A, B], [np.zeros((m, n + m))]]))
    return both[:n, :n], both[:n, n:]


@dataclass(frozen=True)
class LinearParameters(Parameters):
    """Discrete state space x⁺ = A x + B u, y = C x + D u in model units; without A the dynamics are y = u."""

    A: tuple[float, ...] = parameter((), description="state matrix, n·n numbers row by row; empty: no dynamics")
    B: tuple[float, ...] = parameter((), description="input matrix, n numbers")
    C: tuple[float, ...] = parameter((), description="output matrix, n numbers")
    D: tuple[float, ...] = parameter((), description="feedthrough, one number or empty for none")
    input_scale: float = parameter(
        0.0, description="SI units per model unit of the input; 0: such that the DC gain in SI is one", low=0.0
    )
    output_scale: float = parameter(1.0, description="SI units per model unit of the output", low=1e-15)
    sample_time: float = parameter(
        0.0, description="sample time the matrices are for; 0: not stated", unit="s", low=0.0
    )
    delay: float = parameter(
        0.0,
        description="delay of amplifier, converter and transport beyond the matrices, also of parts of a sample; needs "
        "sample_time",
        unit="s",
        low=0.0,
    )

    @property
    def order(self) -> int:
        """Number of states, those of the delay included."""
        whole, part = self.delayed_samples
        if not whole and not part:
            return self._rows
        return self._rows + whole + (part > 0.0) + (self.matrices.D.item() != 0.0)

    @property
    def _rows(self) -> int:
        return round(len(self.A) ** 0.5)

    @property
    def delayed_samples(self) -> tuple[int, float]:
        """The delay as m whole samples and a part f of one, 0 ≤ f < 1."""
        if not self.delay or not self.sample_time:
            return 0, 0.0
        samples = self.delay / self.sample_time
        whole = math.floor(samples + DELAY_TOLERANCE)
        part = samples - whole
        return whole, part if part > DELAY_TOLERANCE else 0.0

    @functools.cached_property
    def dc_gain(self) -> float:
        """DC gain in model units, of :attr:`state_space`."""
        return self.state_space.dc_gain

    @property
    def state_space(self) -> StateSpace:
        """The dynamics in model units, one input and one output; the last inputs are its last states under a delay."""
        model, (whole, part) = self.matrices, self.delayed_samples
        if not whole and not part:
            return model
        n, order, through = model.order, self.order, model.D.item()
        inputs = np.zeros(order - n + 1)  # parts of u_k, u_(k-1), … in the input that acts
        inputs[whole] = 1.0 - part
        if part:
            inputs[whole + 1] = part
        A, B, C = np.zeros((order, order)), np.zeros((order, 1)), np.zeros((1, order))
        A[:n, :n], B[:n] = model.A, model.B * inputs[0]
        A[:n, n:] = model.B * inputs[1:]
        A[n + 1 :, n : order - 1] = np.eye(order - n - 1)
        B[n] = 1.0
        C[0, :n] = model.C[0]
        # what is measured sees the input of the sample before, u_(k-1), as its feedthrough, and those before as states
        C[0, n + 1 :] = through * inputs[1:-1]
        return StateSpace(A, B, C, np.array([[through * inputs[0]]]))

    @property
    def acting(self) -> tuple[np.ndarray, float]:
        """Input that acts in a sample, (row, through): row · x + through · u of the state and the input before it."""
        whole, part = self.delayed_samples
        n, row = self._rows, np.zeros(self.order)
        # the last inputs, u_(k-1) first, are the states behind those of the matrices
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
        """``input_scale``, or the one that makes the DC gain in SI one where it is 0."""
        return self.input_scale or self.output_scale * self.matrices.dc_gain

    def require_sample_time(self, sample_time: float, name: str = "sample_time") -> None:
        """Refuse to run the matrices at another sample time than the one they state.

        Parameters
        ----------
        sample_time : float
            Of the axis [s].
        name : str
            Full name of the parameter, for the message.

        Raises
        ------
        ParameterError
            The matrices are for another sample time.
        """
        if not self.order or not self.sample_time:
            return
        if abs(self.sample_time - sample_time) > SAMPLE_TIME_TOLERANCE * sample_time:
            allowed = (
                f"the matrices are for this sample time, the axis runs at {sample_time:.9g} s (sample_rate "
                f"{1.0 / sample_time:.9g} Hz): set sample_rate to {1.0 / self.sample_time:.9g} Hz, or give matrices "
                "for the sample time of the axis"
            )
            raise ParameterError([Problem(name, self.sample_time, allowed)])

    def check(self):
        """Yield what is wrong: sizes, an unstable A, a DC gain not to be normalised, a delay without sample time."""
        n = self._rows
        if self.delay and not self.sample_time:
            yield Problem("delay", self.delay, "needs sample_time, in whose samples it is counted; state it")
        elif self.delay > LONGEST_DELAY * self.sample_time:
            allowed = f"must be at most {LONGEST_DELAY} samples, {LONGEST_DELAY * self.sample_time:g} s"
            yield Problem("delay", self.delay, allowed)
        if n * n != len(self.A):
            yield Problem("A", self.A, "must be n·n numbers, the rows of a square matrix one after the other")
            return
        sizes = [(name, getattr(self, name)) for name in ("B", "C") if len(getattr(self, name)) != n]
        for name, value in sizes:
            yield Problem(name, value, f"must be {n} numbers, as many as A has rows")
        if len(self.D) > 1:
            yield Problem("D", self.D, "must be one number, or empty for none")
        if sizes or len(self.D) > 1:
            return
        model = self.matrices
        radius = max(np.abs(model.poles), default=0.0)
        if radius >= 1.0:
            yield Problem(
                "A",
                self.A,
                f"is unstable: its largest pole has modulus {radius:.6g}; all must be below 1 (discrete time)",
            )
        elif self.input_scale == 0.0 and not model.dc_gain > 0.0:
            yield Problem(
                "input_scale",
                0.0,
                f"cannot be derived: the DC gain is {model.dc_gain:.3g}; give input_scale",
            )


@kernel
def linear_output(p, x):
    """Output [SI] at the present state; the feedthrough acts on the input held last."""
    n = int(p[ORDER])
    c = MATRICES + n * n + n
    y = p[FEEDTHROUGH] * (x[HELD_INPUT] / p[INPUT_SCALE])
    return accumulate(y, p, c, x, STATE, n) * p[OUTPUT_SCALE]


@kernel
def linear_advance(p, x, u):
    """Hold the input ``u`` [SI] for one sample: the state goes on to the next one."""
    n = int(p[ORDER])
    b = MATRICES + n * n
    x[HELD_INPUT] = u
    advance(p, MATRICES, b, x, STATE, n, u / p[INPUT_SCALE])
    return u


@kernel
def linear(p, x, u):
    """Output [SI] one sample after the input ``u`` [SI] was put on: advance, then output."""
    linear_advance(p, x, u)
    return linear_output(p, x)


class LinearDynamics(Block):
    """Linear dynamics from displacement [m] to displacement [m].

    Parameters
    ----------
    parameters : LinearParameters
        Matrices in discrete time.
    sample_time : float
        The sample time they are for [s].

    Raises
    ------
    ParameterError
        The parameters are wrong, or state another sample time.
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
        """Put the state to rest under the constant input ``u`` [SI]."""
        model, n = self.parameters.state_space, self.parameters.order
        self.x[:] = 0.0
        self.x[HELD_INPUT] = u
        if n:
            self.x[STATE : STATE + n] = solve(np.eye(n) - model.A, model.B[:, 0] * (u / self.p[INPUT_SCALE]))

    def retune(self, parameters: LinearParameters) -> None:
        """Take new matrices of the same order while running; the state is kept.

        Raises
        ------
        ParameterError
            The order differs, or the parameters are wrong.
        """
        given, present = parameters.validated(), self.parameters
        if len(given.A) != len(present.A):
            allowed = f"must have {len(present.B)} rows as before; another order needs a new configuration"
            raise ParameterError([Problem("A", parameters.A, allowed)])
        if given.order != present.order:
            allowed = f"must take as many samples as {present.delay:g} s before; another needs a new configuration"
            raise ParameterError([Problem("delay", given.delay, allowed)])
        super().retune(parameters)
