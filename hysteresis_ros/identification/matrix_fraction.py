# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""State space of lowest order from a frequency response, by a matrix fraction, without iteration (K4).

The equation of the left matrix fraction ``G(z) = Q(z)⁻¹ R(z)``, ``Q = I + Q_1 z⁻¹ + …``, ``R = R_0 + R_1 z⁻¹ + …``, is
linear in the coefficients after multiplication by Q. A single linear least-squares solution therefore fits the
coefficients to all lines together. The degree is higher than necessary, so the realisation has pole-zero pairs that
nearly cancel; truncation of the balanced realisation removes them.

References
----------
.. [1] Juang, Applied System Identification, 1994, chapter 7 (matrix-fraction description, linear least squares).
.. [2] Kim, Kim & Park 2009, section 2.4.
.. [3] Laub et al., IEEE Trans. Autom. Control 32, 1987 (balancing by square roots).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from hysteresis_ros.identification.data import refuse_short
from hysteresis_ros.identification.frequency_response import FrequencyResponse
from hysteresis_ros.identification.linear_systems import FitError, LinearModel
from hysteresis_ros.models.linear import BOUNDARY

#: A relative misfit below this value is attributed to rounding errors, not to an order that is too low.
ROUNDING = 1e-7


@dataclass(frozen=True, eq=False)
class MatrixFraction:
    """A left matrix fraction in z⁻¹."""

    denominator: np.ndarray  #: shape (p + 1, n_y, n_y); Q_0 = I … Q_p.
    numerator: np.ndarray  #: shape (p + 1, n_y, n_u); R_0 … R_p; R_0 = 0 without feedthrough.
    sample_time: float  #: [s]

    @property
    def degree(self) -> int:
        """The degree p."""
        return len(self.denominator) - 1

    def realisation(self, input_unit: str = "V", output_unit: str = "m") -> LinearModel:
        """Return the state space in observer form, of order p · n_y, before any cancellation."""
        Q, R = self.denominator, self.numerator
        p, ny = self.degree, Q.shape[1]
        A = np.zeros((p * ny, p * ny))
        A[:, :ny] = -Q[1:].reshape(p * ny, ny)
        A[: (p - 1) * ny, ny:] = np.eye((p - 1) * ny)
        B = (R[1:] - Q[1:] @ R[0]).reshape(p * ny, -1)
        C = np.zeros((ny, p * ny))
        C[:, :ny] = np.eye(ny)
        return LinearModel(A, B, C, R[0].copy(), self.sample_time, input_unit, output_unit)


@dataclass(frozen=True, eq=False)
class MatrixFractionFit:
    """A linear model from a frequency response."""

    model: LinearModel  #: Model of the chosen order.
    order: int  #: Chosen order: requested or suggested.
    suggested_order: int  #: Lowest order whose misfit is within the tolerance of the smallest misfit.
    hankel_values: (
        np.ndarray
    )  #: shape (n,); Hankel singular values of the full fit, relative to the largest, in descending order.
    orders: np.ndarray  #: shape (m,); Tried orders.
    #: shape (m,); Misfit of each order: rms of |Ĝ - G| over the lines, in standard deviations of the response, or, if
    #: the variance is unknown, relative to rms |G|.
    misfit: np.ndarray
    fraction: MatrixFraction  #: The full fit.
    #: Unstable poles of the full fit, usually caused by noise, that were removed; the misfit includes the effect of the
    #: removal.
    dropped: tuple[complex, ...]
    warnings: tuple[str, ...]  #: Non-minimum-phase fit, large misfit, order at its bound and others.


def fit_matrix_fraction(
    data: FrequencyResponse, degree: int, feedthrough: bool = False, iterations: int = 0, weights=None
) -> MatrixFraction:
    """Fit a left matrix fraction of ``degree`` by linear least squares (Juang, K4)."""
    if degree < 1:
        raise FitError(f"degree = {degree}: a matrix fraction has at least degree 1")
    G = data.response
    F, ny, nu = G.shape
    unknowns = degree * ny + (degree + bool(feedthrough)) * nu
    what = f"a matrix fraction of degree {degree} (the real and imaginary parts of the response count as samples)"
    refuse_short(2 * F * nu, unknowns, what)
    # scaled so that the units do not affect the rank
    scale = np.sqrt(np.mean(np.abs(G) ** 2))
    G = G / scale
    z = np.exp(2j * np.pi * data.frequency * data.sample_time)
    powers = z[:, None] ** -np.arange(degree + 1)
    base = np.ones(F) if weights is None else np.asarray(weights, dtype=float)
    weight = base
    first = 0 if feedthrough else 1
    for _ in range(iterations + 1):
        # for each line and input, in transposed form: -Σ z⁻ⁱ Gᵀ Q_iᵀ + Σ z⁻ⁱ R_iᵀ = Gᵀ
        output_part = -np.einsum("fi,fyu->fuiy", powers[:, 1:], G).reshape(F, nu, degree * ny)
        input_part = np.einsum("fi,uv->fuiv", powers[:, first:], np.eye(nu)).reshape(F, nu, -1)
        table = np.concatenate([output_part, input_part], axis=2) * weight[:, None, None]
        right = G.transpose(0, 2, 1) * weight[:, None, None]
        table, right = table.reshape(F * nu, -1), right.reshape(F * nu, ny)
        solution, *_ = np.linalg.lstsq(
            np.concatenate([table.real, table.imag]), np.concatenate([right.real, right.imag]), rcond=None
        )
        Q = np.concatenate([np.eye(ny)[None], solution[: degree * ny].reshape(degree, ny, ny).transpose(0, 2, 1)])
        R = np.zeros((degree + 1, ny, nu))
        R[first:] = solution[degree * ny :].reshape(-1, nu, ny).transpose(0, 2, 1)
        determinant = np.abs(np.linalg.det(np.einsum("fi,iab->fab", powers, Q)))
        weight = base / np.maximum(determinant, 1e-12)
    return MatrixFraction(Q, R * scale, data.sample_time)


def identify_matrix_fraction(
    data: FrequencyResponse,
    order: int | None = None,
    degree: int | None = None,
    tolerance: float = 0.05,
    maximum_order: int = 10,
    feedthrough: bool = False,
    iterations: int = 0,
) -> MatrixFractionFit:
    """Fit a matrix fraction to a frequency response, and realise it with the lowest order (K4)."""
    deviation = _deviation(data)
    most = max(maximum_order, order or 0)
    candidates = _candidates(
        data, deviation, _degrees(data.response.shape, degree, most, feedthrough), most, feedthrough, iterations
    )
    if not candidates:
        raise FitError(
            "the fit has no stable part; check that the system is stable, and that the response is not only noise"
        )
    highest = max(len(item.models) for item in candidates)
    if order is not None and not 1 <= order <= highest:
        raise FitError(f"order = {order}: must be within 1 … {highest}, the limit for this degree and number of lines")
    orders = np.arange(1, highest + 1)
    best = [min((c for c in candidates if len(c.models) >= n), key=_misfit_with(int(n))) for n in orders]
    misfit = np.array([candidate.misfits[int(n) - 1] for n, candidate in zip(orders, best, strict=True)])
    size = response_misfit(None, data, deviation)
    enough = misfit <= max((1.0 + tolerance) * misfit.min(), ROUNDING * size)
    suggested = int(orders[np.argmax(enough)])
    chosen = suggested if order is None else order
    winner = best[chosen - 1]
    model = winner.models[chosen - 1]
    warnings = [*data.warnings, *model.warnings, *_missed(winner, misfit[chosen - 1], data, deviation, size)]
    if suggested == maximum_order and order is None:
        warnings.append(f"the suggested order {suggested} is the highest one tried; a higher order may fit better")
    if order is not None and order < suggested:
        warnings.append(f"order {order} was requested; {suggested} is suggested (misfit {misfit[order - 1]:.3g})")
    return MatrixFractionFit(
        model=model,
        order=chosen,
        suggested_order=suggested,
        hankel_values=winner.values,
        orders=orders,
        misfit=misfit,
        fraction=winner.fraction,
        dropped=tuple(winner.dropped),
        warnings=tuple(dict.fromkeys(warnings)),
    )


class _Candidate(NamedTuple):
    """Result of a fit with one degree of the matrix fraction."""

    fraction: MatrixFraction
    dropped: list[complex]
    values: np.ndarray
    models: list[LinearModel]
    misfits: list[float]


def _misfit_with(order: int) -> Callable[[_Candidate], float]:
    """Return the function that computes the misfit of a candidate with its model of a given order."""
    return lambda candidate: candidate.misfits[order - 1]


def _candidates(data, deviation, degrees, most: int, feedthrough: bool, iterations: int) -> list[_Candidate]:
    """Return, for each degree whose fit has a stable part, the models of the orders 1 … ``most``."""
    weights = None if deviation is None else 1.0 / np.maximum(deviation.max(axis=(1, 2)), 1e-3 * deviation.max())
    found = []
    for degree in degrees:
        fraction = fit_matrix_fraction(data, degree, feedthrough, iterations, weights)
        full, dropped = stable_part(fraction.realisation(data.input_unit, data.output_unit))
        if not full.order:
            continue
        balanced, values = balanced_realisation(full)
        models = [
            refit_input(truncate(balanced, n), data, deviation, feedthrough)
            for n in range(1, min(most, len(values)) + 1)
        ]
        misfits = [response_misfit(model, data, deviation) for model in models]
        found.append(_Candidate(fraction, dropped, values / values[0], models, misfits))
    return found


def _missed(winner: _Candidate, misfit: float, data, deviation, size: float):
    """Yield warnings about the misfit of the chosen model; ``size`` is the rms magnitude of the response."""
    if winner.dropped:
        # unstable poles caused by noise do not contribute to the response; poles of an unstable system do
        whole = winner.fraction.realisation(data.input_unit, data.output_unit)
        if misfit > 1.5 * max(response_misfit(whole, data, deviation), ROUNDING * size):
            poles = ", ".join(f"{pole:.4g}" for pole in winner.dropped)
            yield (
                f"unstable linear fit: pole(s) {poles} outside the unit circle were removed; their response is missing"
            )
    if misfit > 0.5 * size:
        yield f"the misfit of the model is {100 * misfit / size:.0f} % of the response: the model is not usable"


def _degrees(shape, degree, maximum_order, feedthrough):
    """Return the degrees to try, because noise biases a fit of low degree and adds poles to a fit of high degree."""
    if degree is not None:
        return [degree]
    F, ny, nu = shape
    possible = max(1, (F * nu - feedthrough * nu) // (ny + nu))
    wanted = [maximum_order * share / (4 * ny) for share in (8, 6, 4, 3, 2, 1)]
    return sorted({max(1, min(possible, math.ceil(p))) for p in wanted}, reverse=True)


def stable_part(model: LinearModel) -> tuple[LinearModel, list[complex]]:
    """Return the stable part of ``model`` (poles inside the unit circle), and the removed poles.

    The two parts are separated by a block-diagonal form (ordered Schur form and a Sylvester equation), so that the
    stable part contributes to the response as before.
    """
    for margin in (BOUNDARY, 1e-6, 1e-4, 1e-3, 1e-2):
        stable, dropped = _separated(model, 1.0 - margin)
        if stable.stable:  # reordering moves the poles of a cluster by more than rounding errors
            break
    return stable, dropped


def _separated(model, radius):
    def inside(real, imaginary=0.0):  # named arguments, because SciPy inspects the signature of this function
        return abs(real + 1j * imaginary) < radius

    A, basis, count = scipy.linalg.schur(model.A, output="real", sort=inside)
    dropped = [complex(pole) for pole in np.linalg.eigvals(A[count:, count:])] if count < len(A) else []
    B, C = basis.T @ model.B, model.C @ basis
    if dropped and count:
        X = scipy.linalg.solve_sylvester(A[:count, :count], -A[count:, count:], -A[:count, count:])
        B[:count] -= X @ B[count:]
    return replace(model, A=A[:count, :count], B=B[:count], C=C[:, :count]), dropped


def balanced_realisation(model: LinearModel) -> tuple[LinearModel, np.ndarray]:
    """Return the balanced realisation of a stable model and its Hankel singular values, in descending order.

    Directions below the rounding error (1e-14 of the largest) are removed: they are not controllable or not observable.
    """
    if not model.stable:
        raise FitError(f"an unstable model (poles {model.poles}) has no balanced realisation; take its stable part")
    reach = _root(_gramian(model.A, model.B))
    seen = _root(_gramian(model.A.T, model.C.T))
    U, values, Vt = np.linalg.svd(seen.T @ reach)
    keep = values > 1e-14 * values[0]
    root = 1.0 / np.sqrt(values[keep])
    into, out = reach @ Vt[keep].T * root, (seen @ U[:, keep] * root).T
    return replace(model, A=out @ model.A @ into, B=out @ model.B, C=model.C @ into), values[keep]


def truncate(balanced: LinearModel, order: int) -> LinearModel:
    """Return the first ``order`` states of a balanced model."""
    return replace(balanced, A=balanced.A[:order, :order], B=balanced.B[:order], C=balanced.C[:, :order])


def refit_input(model: LinearModel, data: FrequencyResponse, deviation=None, feedthrough: bool = False) -> LinearModel:
    """Refit B (and D) to the lines by linear least squares with fixed A and C, to correct for the truncation."""
    F, ny, nu = data.response.shape
    n = model.order
    z = np.exp(2j * np.pi * data.frequency * data.sample_time)
    rows = model.C @ np.linalg.inv(z[:, None, None] * np.eye(n) - model.A)
    if feedthrough:
        rows = np.concatenate([rows, np.broadcast_to(np.eye(ny), (F, ny, ny))], axis=2)
    B, D = np.empty((n, nu)), np.zeros((ny, nu))
    for i in range(nu):
        weight = np.ones((F, ny)) if deviation is None else 1.0 / np.maximum(deviation[:, :, i], 1e-300)
        table = (rows * weight[:, :, None]).reshape(F * ny, -1)
        right = (data.response[:, :, i] * weight).ravel()
        table, right = np.concatenate([table.real, table.imag]), np.concatenate([right.real, right.imag])
        length = np.linalg.norm(table, axis=0)
        length[length == 0.0] = 1.0
        solution = np.linalg.lstsq(table / length, right, rcond=None)[0] / length
        B[:, i] = solution[:n]
        if feedthrough:
            D[:, i] = solution[n:]
    return replace(model, B=B, D=D)


def response_misfit(model: LinearModel | None, data: FrequencyResponse, deviation=None) -> float:
    """Return the rms misfit of a model over the lines; None: a model with zero response."""
    predicted = 0.0 if model is None else model.frequency_response(data.frequency)
    scale = np.sqrt(np.mean(np.abs(data.response) ** 2)) if deviation is None else np.maximum(deviation, 1e-300)
    return float(np.sqrt(np.mean(np.abs((predicted - data.response) / scale) ** 2)))


def _deviation(data):
    variance = data.total_variance if data.total_variance is not None else data.noise_variance
    if variance is None or not np.all(np.isfinite(variance)) or not np.any(variance > 0.0):
        return None
    # a variance from few averages scatters; a lower limit prevents single lines from dominating
    floor = 0.1 * np.median(variance[variance > 0.0])
    return np.sqrt(np.maximum(variance, floor))


def _gramian(A, B):
    # not the direct method: it solves n² simultaneous equations, and is ill-conditioned for poles near the unit circle
    return scipy.linalg.solve_discrete_lyapunov(A, B @ B.T, method="bilinear")


def _root(gramian):
    """Return a factor L with L Lᵀ = gramian; rounding may have made the gramian slightly indefinite."""
    values, vectors = np.linalg.eigh((gramian + gramian.T) / 2)
    return vectors * np.sqrt(np.maximum(values, 0.0))
