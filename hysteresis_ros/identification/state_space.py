# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Discrete linear models as identification finds them, and exact fast simulation of their states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.state_space import BOUNDARY, StateSpace


class FitError(IdentificationError):
    """A fit cannot be made from this data with these settings; the message says what to change."""


@dataclass(frozen=True)
class Mode:
    """One pole (or conjugate pair) of a model.

    Parameters
    ----------
    frequency : float
        Natural frequency [Hz].
    damping : float
        Damping ratio [1]; 1 for a real pole, negative when unstable.
    """

    frequency: float
    damping: float


def propagate(A, inputs, initial=None) -> np.ndarray:
    """Return the states of ``x_(k+1) = A x_k + w_k``.

    The recursion runs in the Schur form of A, one filter of first order a state: as exact for poles close to one
    another or to the unit circle as the plain recursion, and without a loop over the samples.

    Parameters
    ----------
    A : array_like, shape (n, n)
        State matrix, real.
    inputs : array_like, shape (N, n)
        The sequence w_k.
    initial : array_like, shape (n,), optional
        x_0; zero by default.

    Returns
    -------
    ndarray, shape (N, n)
        x_0 … x_(N-1).
    """
    return _run(A, inputs, initial)[:-1]


def _run(A, inputs, initial):
    A, inputs = np.atleast_2d(np.asarray(A, dtype=float)), np.asarray(inputs, dtype=float)
    N, n = inputs.shape
    triangular, basis = scipy.linalg.schur(A, output="complex")
    driven = inputs @ basis.conj()
    start = np.zeros(n, dtype=complex) if initial is None else basis.conj().T @ np.asarray(initial, dtype=complex)
    states = np.empty((N + 1, n), dtype=complex)
    states[0] = start
    for i in range(n - 1, -1, -1):
        force = driven[:, i] + states[:-1, i + 1 :] @ triangular[i, i + 1 :]
        states[1:, i], _ = scipy.signal.lfilter(
            [1.0], [1.0, -triangular[i, i]], force, zi=[triangular[i, i] * states[0, i]]
        )
    return np.real(states @ basis.T)


def final_state(A, inputs, initial=None) -> np.ndarray:
    """Return x_N of the recursion of :func:`propagate`, shape (n,).

    Parameters
    ----------
    A : array_like, shape (n, n)
    inputs : array_like, shape (N, n)
    initial : array_like, shape (n,), optional
    """
    return _run(A, inputs, initial)[-1]


@dataclass(frozen=True, eq=False)
class LinearModel(StateSpace):
    """Discrete state space of n_u inputs and n_y outputs in SI units, with its sample time.

    Parameters
    ----------
    sample_time : float
        [s]
    input_unit : str
        SI unit of u.
    output_unit : str
        SI unit of y.
    """

    sample_time: float
    input_unit: str = "V"
    output_unit: str = "m"

    @property
    def zeros(self) -> np.ndarray:
        """Finite transmission zeros in the z plane of a model with as many inputs as outputs."""
        n, m = self.order, self.D.shape[1]
        if self.D.shape[0] != m:
            return np.empty(0, dtype=complex)
        # scaled, so that "finite" means the same in metres and in micrometres
        b, c = np.linalg.norm(self.B) or 1.0, np.linalg.norm(self.C) or 1.0
        pencil = np.block([[self.A, self.B / b], [self.C / c, self.D / (b * c)]])
        shift = scipy.linalg.block_diag(np.eye(n), np.zeros((m, m)))
        alpha, beta = scipy.linalg.eig(pencil, shift, right=False, homogeneous_eigvals=True)
        finite = np.abs(beta) > 1e-10 * np.maximum(np.abs(alpha), 1e-300)
        zeros = alpha[finite] / beta[finite]
        return zeros[np.abs(zeros) < 1e8]

    @property
    def minimum_phase(self) -> bool:
        """Whether all zeros are inside the unit circle: the inverse is stable then."""
        return bool(np.all(np.abs(self.zeros) < 1.0 - BOUNDARY))

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Natural frequencies and damping ratios of the poles, slowest first, a pair once."""
        poles = self.poles
        poles = poles[(poles.imag >= 0.0) & (np.abs(poles) > 1e-12)]
        s = np.log(poles.astype(complex)) / self.sample_time
        found = [Mode(float(abs(p) / (2 * np.pi)), float(-p.real / abs(p)) if p != 0 else 1.0) for p in s]
        return tuple(sorted(found, key=lambda mode: mode.frequency))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the model: unstable poles, zeros outside the unit circle, a gain that is not positive."""
        found = list(pole_zero_warnings(self.poles, self.zeros))
        gain = self.dc_gain
        if isinstance(gain, float) and not gain > 0.0:
            found.append(f"the DC gain is {gain:.4g} {self.output_unit}/{self.input_unit}: the output moves against u")
        return tuple(found)

    def frequency_response(self, frequency) -> np.ndarray:
        """Return the response at ``frequency`` [Hz], shape (F, n_y, n_u), complex."""
        return self.response(np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * self.sample_time))

    def simulate(self, u, initial=None) -> np.ndarray:
        """Return the output for the input ``u`` of shape (N,) or (N, n_u), in the same form.

        Parameters
        ----------
        u : array_like, shape (N,) or (N, n_u)
            Input [SI].
        initial : array_like, shape (n,), optional
            State at the first sample; zero by default.
        """
        columns = np.asarray(u, dtype=float).reshape(len(u), -1)
        y = propagate(self.A, columns @ self.B.T, initial) @ self.C.T + columns @ self.D.T
        return y[:, 0] if np.ndim(u) == 1 else y

    def linear_parameters(self) -> LinearParameters:
        """Return the parameters of the linear block with unit DC gain (Hammerstein: the gain is the hysteresis').

        Raises
        ------
        FitError
            The model is unstable, has a zero DC gain, several inputs or outputs, or a feedthrough: a measurement taken
            before the input of its sample changes cannot depend on it.
        """
        if self.D.size != 1:
            raise FitError(f"a linear block has one input and one output; this model has {self.D.shape[::-1]}")
        if not self.stable:
            radius = np.max(np.abs(self.poles))
            raise FitError(f"the linear model is unstable (pole of modulus {radius:.6g}) and cannot run")
        gain = self.dc_gain
        if gain == 0.0 or not np.isfinite(gain):
            raise FitError(f"the DC gain of the linear model is {gain}; it cannot be scaled to one")
        if abs(self.D[0, 0]) > 1e-9 * abs(gain):
            raise FitError(f"the linear model has a feedthrough of {self.D[0, 0]:.3g}; fit it without one")
        return LinearParameters(
            A=tuple(map(float, self.A.ravel())),
            B=tuple(map(float, self.B.ravel())),
            C=tuple(map(float, self.C.ravel() / gain)),
        ).validated()


def pole_zero_warnings(poles, zeros, radius: float = 1.0) -> tuple[str, ...]:
    """Return warnings about unstable poles and zeros outside the unit circle of a discrete model.

    Parameters
    ----------
    poles, zeros : array_like of complex
        In the z plane.
    radius : float, optional
        Radius of the circle that zeros must stay in.
    """
    found = []
    outside = [p for p in np.ravel(poles) if abs(p) >= 1.0 - BOUNDARY]
    if outside:
        found.append(f"unstable linear fit: pole(s) {_list(outside)} on or outside the unit circle")
    outside = [z for z in np.ravel(zeros) if abs(z) >= radius - BOUNDARY]
    if outside:
        found.append(
            f"non-minimum-phase linear fit: zero(s) {_list(outside)} on or outside the circle of radius {radius:g}; "
            "the linear part has no stable inverse"
        )
    return tuple(found)


def _list(values):
    return ", ".join(f"{v.real:.4g}" if abs(v.imag) < 1e-12 else f"{v.real:.4g}{v.imag:+.4g}j" for v in values)
