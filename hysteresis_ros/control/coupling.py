# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Coupled loops: interaction through a static gain, its decoupling, and the margins of several loops together.

Loops are square, with n commands and n measurements. The loop transfer L is cut at the commands. It contains the plant
followed by the controllers, for negative feedback: S = (I + L)⁻¹.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.control.margins import _grid
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.linear import BOUNDARY, StateSpace
from hysteresis_ros.models.linear_algebra import inverse

#: A gain counts as singular if the ratio of its smallest to its largest singular value is at most this.
SINGULAR = 1e-6
#: Number of frequencies on each scale of the grid for margins (linear, logarithmic), without those around the poles.
GRID = 1500
#: Number of balancing sweeps for the initial scalings.
SWEEPS = 20
#: Number of steps of the search for the peak between two points of the grid.
STEPS = 40
#: Relative accuracy of the scalings during the search for the worst frequency.
SOUGHT = 1e-4
#: Relative accuracy of the scalings at the worst frequency.
KEPT = 1e-9


def lost_direction(gain, names: Sequence[str]) -> str:
    """Return the combination of inputs that a singular gain maps to zero, such as ``+0.71 x, -0.71 y``.

    For a regular gain, whose smallest singular value exceeds :data:`SINGULAR` times the largest, the text is empty.
    """
    _, sizes, rows = np.linalg.svd(np.asarray(gain, dtype=float))
    if sizes[-1] > SINGULAR * sizes[0]:
        return ""
    # the sign makes the first of the largest entries positive
    row = rows[-1] * np.sign(rows[-1][np.argmax(np.round(np.abs(rows[-1]), 6))])
    return ", ".join(f"{value:+.2f} {name}" for value, name in zip(row, names, strict=True))


def static_decoupling(gain, names: Sequence[str] = ()) -> np.ndarray:
    """Return the matrix that decouples a static gain: its inverse.

    The commands of the actuators are this matrix times the commands of the degrees of freedom. Only motions that are
    slow compared with the modes are decoupled; at higher frequencies, the modes couple the loops again.

    Parameters
    ----------
    gain : array_like, shape (n, n)
        Gain from the commands of the actuators to the degrees of freedom, for example ``plant.dc_gain`` of a
        :class:`.StateSpace`.
    names : sequence of str, optional
        Names of the actuators, for the message.

    Returns
    -------
    ndarray, shape (n, n)

    Raises
    ------
    ParameterError
        The gain is not square or is singular; the message states the direction that it maps to zero.

    Examples
    --------
    >>> static_decoupling([[2.0, 0.0], [0.0, 4.0]])
    array([[0.5 , 0.  ],
           [0.  , 0.25]])
    """
    gain = np.asarray(gain, dtype=float)
    if gain.ndim != 2 or gain.shape[0] != gain.shape[1]:
        raise ParameterError([Problem("gain", gain.shape, "must have shape (n, n), a row for each degree of freedom")])
    lost = lost_direction(gain, names or [f"input {i}" for i in range(len(gain))])
    if lost:
        raise ParameterError([Problem("gain", gain.tolist(), f"is singular: the direction {lost} causes no motion")])
    return inverse(gain)


def relative_gain_array(gain) -> np.ndarray:
    """Return the relative gain array Λ = G ∘ (G⁻¹)ᵀ of Bristol [1]_.

    Λ_ij is the gain from input j to output i with all other loops open, divided by the same gain with all other loops
    closed and ideal. Each row and each column sums to 1. Pairs with entries near 1 interact little. If the entry of a
    pair is negative, the gain of this pair changes sign when the other loops open.

    Parameters
    ----------
    gain : array_like, shape (..., n, n)
        Static gains, or complex responses at several frequencies.

    Returns
    -------
    ndarray, shape (..., n, n)

    References
    ----------
    .. [1] Bristol, On a new measure of interaction for multivariable process control, IEEE Trans. Autom. Control
       11(1), 1966.

    Examples
    --------
    >>> relative_gain_array([[1.0, 0.5], [0.0, 1.0]])
    array([[1., 0.],
           [0., 1.]])
    """
    gain = np.asarray(gain)
    # adding zero converts -0, which the inverse of a triangular gain contains, to 0
    return gain * np.swapaxes(np.linalg.inv(gain), -1, -2) + 0.0


def singular_values(response) -> np.ndarray:
    """Return the singular values of a response, the largest first.

    Parameters
    ----------
    response : array_like, shape (F, q, m)
        Complex response at F frequencies, as :meth:`.StateSpace.response` returns it.

    Returns
    -------
    ndarray, shape (F, min(q, m))
    """
    return np.linalg.svd(np.asarray(response), compute_uv=False)


@dataclass(frozen=True)
class DiskMargin:
    """Disk margin of one loop, or of all loops together."""

    alpha: float  #: Size α of the disk; 0: unstable.
    frequency: float  #: Frequency at which the margin is reached [Hz]; NaN for an unstable loop.
    skew: float = 0.0  #: Skew σ of the disk; 0: the gain may rise and fall by the same factor.

    @property
    def gains(self) -> tuple[float, float]:
        """Smallest and largest factor on the gain that the loop tolerates without a change of phase."""
        low, high = 0.5 * self.alpha * (1.0 - self.skew), 0.5 * self.alpha * (1.0 + self.skew)
        return (1.0 - low) / (1.0 + high), ((1.0 + low) / (1.0 - high) if high < 1.0 else math.inf)

    @property
    def gain_margin(self) -> float:
        """Factor by which the gain may increase [dB]."""
        return 20.0 * math.log10(self.gains[1])

    @property
    def phase_margin(self) -> float:
        """Change of phase in either direction that the loop tolerates without a change of gain [degrees]."""
        low, high = self.gains
        cosine = low if math.isinf(high) else (1.0 + low * high) / (low + high)
        return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))


@dataclass(frozen=True)
class DiskMargins:
    """Disk margins of coupled loops, the result of :func:`disk_margins`."""

    loops: tuple[DiskMargin, ...]  #: Margin of each loop alone; the other loops are closed and do not change.
    together: DiskMargin  #: Margin for independent simultaneous changes in all loops.


def disk_margins(loop: StateSpace, sample_time: float, skew: float = 0.0) -> DiskMargins:
    """Return the disk margins of coupled loops: of each loop alone, and of all loops together.

    Each loop is multiplied by its own complex factor

        f = (1 + (1 - σ)/2 δ) / (1 - (1 + σ)/2 δ),  abs(δ) < α,

    which represents any change of gain and phase within a disk around 1. The margin is the largest α for which the
    loops stay stable [1]_. For a single loop, 1/α is the maximum of abs(S_ii + (σ - 1)/2) over frequency. For
    independent factors in all loops, 1/α is the largest structured singular value of S + (σ - 1)/2 I. The structured
    singular value is at most the largest singular value of D (S + (σ - 1)/2 I) D⁻¹, minimised over diagonal D. This
    bound is exact for up to three loops; for more loops the returned margin is conservative.

    Parameters
    ----------
    loop : StateSpace
        Loop transfer L with n inputs and n outputs, cut where the changes act, for negative feedback.
    sample_time : float
        [s]
    skew : float
        Skew σ; 0 gives the symmetric margin, 1 the margin of S, -1 the margin of T.

    Returns
    -------
    DiskMargins
        All margins are zero if the closed loop is unstable.

    Raises
    ------
    ParameterError
        The loop is not square, or has an algebraic loop: ``loop.D`` has the eigenvalue -1.

    References
    ----------
    .. [1] Seiler, Packard & Gahinet, An introduction to disk margins, IEEE Control Systems 40(5), 2020, equations for
       the SISO margin (theorem 1) and the multiple-loop margin.

    Examples
    --------
    >>> integrator = StateSpace(np.eye(1), 0.1 * np.eye(1), np.eye(1), np.zeros((1, 1)))
    >>> round(disk_margins(integrator, 1.0).together.alpha, 3)
    1.81
    """
    count = loop.B.shape[1]
    if len(loop.C) != count:
        allowed = "must have as many outputs as inputs"
        raise ParameterError([Problem("loop", (len(loop.C), count), allowed)])
    opened = np.eye(count) + loop.D
    if np.linalg.cond(opened) > 1.0 / BOUNDARY:
        raise ParameterError([Problem("loop.D", loop.D.tolist(), "must not have the eigenvalue -1 (algebraic loop)")])
    poles = np.linalg.eigvals(loop.A - loop.B @ np.linalg.solve(opened, loop.C))
    if np.max(np.abs(poles), initial=0.0) >= 1.0 - BOUNDARY:
        none = DiskMargin(0.0, math.nan, skew)
        return DiskMargins((none,) * count, none)
    angles = _grid([*poles, *loop.poles], GRID)

    def shifted(angle):
        """Return S + (σ - 1)/2 I at angles in the z plane, shape (F, n, n)."""
        response = loop.response(np.exp(1j * np.atleast_1d(angle)))
        return np.linalg.inv(np.eye(count) + response) + 0.5 * (skew - 1.0) * np.eye(count)

    grid = shifted(angles)
    hertz = 1.0 / (2.0 * math.pi * sample_time)
    found = []
    for i in range(count):
        place = int(np.argmax(np.abs(grid[:, i, i])))
        angle, value = _peak(lambda angle, i=i: abs(shifted(angle)[0, i, i]), angles, place)
        found.append(DiskMargin(1.0 / value, float(angle * hertz), skew))
    angle, value = _peak(lambda angle: _structured(shifted(angle)[0]), angles, _worst(grid))
    return DiskMargins(tuple(found), DiskMargin(1.0 / value, float(angle * hertz), skew))


def _peak(function, angles, place: int) -> tuple[float, float]:
    """Return angle and value of the maximum near a point of the grid, by golden-section search."""
    low, high = angles[max(place - 1, 0)], angles[min(place + 1, len(angles) - 1)]
    part = 0.5 * (math.sqrt(5.0) - 1.0)

    def at(angle) -> tuple[float, float]:
        return float(angle), float(function(angle))

    best, first, second = at(angles[place]), at(high - part * (high - low)), at(low + part * (high - low))
    for _ in range(STEPS):
        best = max(best, first, second, key=lambda item: item[1])
        # one of the two inner points is also an inner point of the next interval
        if second[1] > first[1]:
            low, first = first[0], second
            second = at(low + part * (high - low))
        else:
            high, second = second[0], first
            first = at(high - part * (high - low))
    return best


def _balanced(matrices) -> tuple[np.ndarray, np.ndarray]:
    """Return logarithmic scalings that balance rows and columns (Osborne), and the resulting largest singular values.

    Shapes: ``matrices`` (F, n, n), scalings (F, n), singular values (F,).
    """
    size, count = np.abs(matrices), matrices.shape[1]
    size[:, range(count), range(count)] = 0.0
    logs = np.zeros(size.shape[:2])
    for _ in range(SWEEPS):
        for i in range(count):
            scales = np.exp(logs)
            into = np.linalg.norm(size[:, i] / scales, axis=1) * scales[:, i]
            out = np.linalg.norm(size[:, :, i] * scales, axis=1) / scales[:, i]
            both = (into > 0.0) & (out > 0.0)
            logs[both, i] += 0.5 * np.log(out[both] / into[both])
    scales = np.exp(logs)
    return logs, np.linalg.norm(matrices * scales[:, :, None] / scales[:, None, :], 2, axis=(1, 2))


def _scaled(matrix, logs) -> float:
    """Return the largest singular value of D M D⁻¹ with D = exp(diag(logs))."""
    scales = np.exp(logs)
    return float(np.linalg.norm(matrix * scales[:, None] / scales, 2))


def _up_to_two(matrices) -> np.ndarray:
    """Return the structured singular values of complex matrices, shape (F, n, n) with n ≤ 2, without a search.

    A scaling keeps the product of both singular values. Therefore the larger one is smallest where the sum of their
    squares is smallest: where the two off-diagonal entries have the same magnitude.
    """
    equal = np.array(matrices)
    if equal.shape[1] == 2:
        equal[:, 0, 1] = equal[:, 1, 0] = np.sqrt(equal[:, 0, 1] * equal[:, 1, 0])
    return np.linalg.norm(equal, 2, axis=(1, 2))


def _structured(matrix, accuracy: float = KEPT) -> float:
    """Return the bound on the structured singular value of a matrix for independent complex factors."""
    if len(matrix) <= 2:
        return float(_up_to_two(matrix[None])[0])
    (logs,), (size,) = _balanced(matrix[None])
    from scipy.optimize import minimize

    options = {"xatol": math.sqrt(accuracy), "fatol": accuracy * size, "maxiter": 400 * len(matrix)}
    free = minimize(
        lambda some: _scaled(matrix, np.append(some, 0.0)), logs[:-1] - logs[-1], method="Nelder-Mead", options=options
    )
    return min(float(size), float(free.fun))


def _worst(grid) -> int:
    """Return the index of the largest structured singular value; the balanced bounds exclude most matrices."""
    if grid.shape[1] <= 2:
        return int(np.argmax(_up_to_two(grid)))
    _, sizes = _balanced(grid)
    best, found = -1.0, 0
    for place in np.argsort(-sizes):
        if sizes[place] <= best * (1.0 + SOUGHT):
            break
        value = _structured(grid[place], SOUGHT)
        if value > best:
            best, found = value, int(place)
    return found
