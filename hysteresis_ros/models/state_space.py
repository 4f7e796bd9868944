# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Discrete state spaces x⁺ = A x + B u, y = C x + D u: their matrices, and their recursion in the kernels.

The package holds every linear system in a :class:`StateSpace`. What is measured of a plant is taken before the input of
its sample changes, y_k = C x_k + D u_(k-1); :meth:`StateSpace.held` is the system from u_k to that y_k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.block import kernel
from hysteresis_ros.linear_algebra import product, solve

#: A state nearer to 0 than this becomes 0. What dies out would end as a denormal number, with which processors reckon
#: up to thirty times more slowly, and stay there: 0.9 · 2.5e-323 rounds to itself. The kernels see to it because a mode
#: of the processor would not be the same in all threads and processes.
NOTHING = 1e-290
#: A pole or zero nearer to the unit circle than this counts as on it.
BOUNDARY = 1e-9


@kernel
def accumulate(total, p, row, x, first, n):
    """Return ``total`` + Σ p[row + j] x[first + j] over j = 0 … n - 1, added up in this order."""
    for j in range(n):
        total += p[row + j] * x[first + j]
    return total


@kernel
def advance(p, matrix, column, x, state, n, u):
    """x⁺ = A x + B u with A (row by row) from p[matrix] and B from p[column]; behind x stand n places of scratch.

    States nearer to 0 than :data:`NOTHING` become 0.
    """
    for i in range(n):
        x[state + n + i] = accumulate(p[column + i] * u, p, matrix + i * n, x, state, n)
    for i in range(n):
        value = x[state + n + i]
        # so asked, what is no number stays as it is
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
        """Gain C (I - A)⁻¹ B + D at frequency zero: a float for one input and output, else shape (q, m)."""
        gain = product(self.C, solve(np.eye(self.order) - self.A, self.B)) + self.D
        return float(gain[0, 0]) if gain.size == 1 else gain

    def response(self, z) -> np.ndarray:
        """Return the transfer C (z I - A)⁻¹ B + D.

        Parameters
        ----------
        z : array_like, shape (N,)
            Points of the z plane; exp(2π i f T) for the frequency f and the sample time T.

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
        """Return the system from u_k to y_k = C x_k + D u_(k-1), with the input held last as its last states.

        Returns
        -------
        StateSpace
            Of n + m states and without feedthrough.
        """
        n, m, q = self.order, self.B.shape[1], len(self.C)
        A = np.block([[self.A, np.zeros((n, m))], [np.zeros((m, n + m))]])
        return StateSpace(A, np.vstack([self.B, np.eye(m)]), np.hstack([self.C, self.D]), np.zeros((q, m)))

    def scaled(self, gain: float) -> StateSpace:
        """Return the system with its output multiplied by ``gain``."""
        return StateSpace(self.A, self.B, gain * self.C, gain * self.D)

    @property
    def shown(self) -> StateSpace:
        """The system with its first output alone."""
        return StateSpace(self.A, self.B, self.C[:1], self.D[:1])

    def part(self, states, inputs=None) -> StateSpace:
        """Return the system of some of its states alone, and of some of its inputs.

        Parameters
        ----------
        states : array_like of int
            States that are kept; the others must not matter to them.
        inputs : array_like of int, optional
            Inputs that are kept; all by default.
        """
        chosen = slice(None) if inputs is None else inputs
        return StateSpace(
            self.A[np.ix_(states, states)], self.B[states][:, chosen], self.C[:, states], self.D[:, chosen]
        )
