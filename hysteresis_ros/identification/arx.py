# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""ARX models by linear least squares (W1), with zeros kept inside the unit circle on request (W6).

``A(z) y = B(z) u + e`` with ``A = 1 + a_1 z⁻¹ + …`` and ``B = b_0 z⁻ᵈ + b_1 z⁻ᵈ⁻¹ + …``, d ≥ 1, is fitted by the
regression of y(t) on y(t-1) …, u(t-d) …. If the output is noisy, the estimate is biased, because noise in the
regressors pulls poles towards zero. Therefore compare the simulated output, not the one-step prediction, with other
data.

References
----------
.. [1] Wang, Alici & Tan 2014, eqs 1-6.
.. [2] Ljung, System Identification, 1999, sections 7.3, 9.2 and 16.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from hysteresis_ros.identification.data import checked_signals, refuse_short
from hysteresis_ros.identification.linear_systems import FitError, LinearModel, pole_zero_warnings
from hysteresis_ros.identification.validation import parameter_covariance

#: Largest condition number of the regressors with which the parameters count as determined.
RANK = 1e10


@dataclass(frozen=True, eq=False)
class ArxFit:
    """An ARX model."""

    denominator: np.ndarray  #: shape (n_a + 1,); 1, a_1 … a_na: coefficients of z⁰, z⁻¹ ….
    numerator: np.ndarray  #: shape (n_b,); b_0 …: coefficients of z⁻ᵈ, z⁻ᵈ⁻¹ … [output unit/input unit].
    delay: int  #: d [samples].
    offset: float  #: Constant in the regression, in the output's unit; 0 if it was not fitted.
    #: shape (n_a + n_b, n_a + n_b); Covariance of a_1 …, b_0 … for white residuals; if the constraint on the zeros is
    #: active, the covariance of the unconstrained estimate.
    covariance: np.ndarray
    residual_variance: float  #: Variance of the one-step prediction error, in the output's unit squared.
    samples: int  #: Number of rows of the regression.
    fpe: float  #: Akaike's final prediction error, in the output's unit squared.
    sample_time: float  #: [s]
    constrained: bool  #: Whether the constraint on the zeros changed the solution.
    warnings: tuple[str, ...]  #: Unstable or non-minimum-phase fit, active constraint, weak excitation.
    input_unit: str = "V"  #: input_unit, output_unit: SI units.
    output_unit: str = "m"

    @property
    def poles(self) -> np.ndarray:
        """Poles in the z plane, shape (n_a,)."""
        return np.roots(self.denominator)

    @property
    def zeros(self) -> np.ndarray:
        """Zeros in the z plane, shape (n_b - 1,) or fewer."""
        return np.roots(self.numerator)

    @property
    def standard_deviations(self) -> np.ndarray:
        """Standard deviations of a_1 …, b_0 …, shape (n_a + n_b,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def model(self) -> LinearModel:
        """The state space (observer form) of order max(n_a, n_b + d - 1), without feedthrough."""
        n = max(len(self.denominator) - 1, len(self.numerator) + self.delay - 1)
        a, b = np.zeros(n), np.zeros(n)
        a[: len(self.denominator) - 1] = self.denominator[1:]
        b[self.delay - 1 : self.delay - 1 + len(self.numerator)] = self.numerator
        A = np.eye(n, k=1)
        A[:, 0] = -a
        C = np.zeros((1, n))
        C[0, 0] = 1.0
        return LinearModel(A, b[:, None], C, np.zeros((1, 1)), self.sample_time, self.input_unit, self.output_unit)


class ArxOrders(NamedTuple):
    """Orders of an ARX model."""

    na: int = 2  #: na, nb: Numbers of coefficients a and b; nb ≥ 1.
    nb: int = 2
    delay: int = 1  #: Delay [samples], ≥ 1: an output is measured before the input of the same sample acts.


def fit_arx(
    u,
    y,
    sample_time: float,
    orders: ArxOrders | None = None,
    *,
    offset: bool = False,
    zero_radius: float | None = None,
    units: tuple[str, str] = ("V", "m"),
) -> ArxFit:
    """Fit an ARX model by least squares; model W1 has na = nb = 2 and delay = 1.

    Units: ``sample_time`` [s].
    """
    na, nb, delay = orders = orders or ArxOrders()
    _check_orders(orders, zero_radius)
    records = _records(u, y)
    scale_u = max(float(np.ptp(inputs)) for inputs, _ in records)
    scale_y = max(float(np.ptp(outputs)) for _, outputs in records)
    rows = [_regression(inputs / scale_u, outputs / scale_y, orders, offset) for inputs, outputs in records]
    table, right = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    unknowns = table.shape[1]
    _require_excitation(table)
    solution = np.linalg.lstsq(table, right, rcond=None)[0]
    warnings, constrained = [], False
    zeros = np.roots(solution[na : na + nb])
    if zero_radius is not None and np.any(np.abs(zeros) > zero_radius):
        solution, constrained = _with_zeros_inside(table, right, orders, zero_radius), True
        largest = np.max(np.abs(zeros))
        warnings.append(
            f"without the constraint a zero would lie at radius {largest:.4g}; it was kept within {zero_radius:g}"
        )
    residual = right - table @ solution
    variance = float(residual @ residual / (len(right) - unknowns))
    scales = np.r_[np.ones(na), np.full(nb, scale_y / scale_u)]
    mse = float(residual @ residual / len(right)) * scale_y**2
    denominator, numerator = np.r_[1.0, solution[:na]], solution[na : na + nb] * scale_y / scale_u
    warnings += pole_zero_warnings(np.roots(denominator), np.roots(numerator))
    if np.sum(numerator) / np.sum(denominator) <= 0.0:
        warnings.append("the DC gain is not positive: the output moves against the input")
    return ArxFit(
        denominator=denominator,
        numerator=numerator,
        delay=delay,
        offset=float(solution[-1] * scale_y) if offset else 0.0,
        covariance=parameter_covariance(table, residual)[: na + nb, : na + nb] * np.outer(scales, scales),
        residual_variance=variance * scale_y**2,
        samples=len(right),
        fpe=mse * (1 + unknowns / len(right)) / (1 - unknowns / len(right)),
        sample_time=float(sample_time),
        constrained=constrained,
        warnings=tuple(warnings),
        input_unit=units[0],
        output_unit=units[1],
    )


def _require_excitation(table) -> None:
    """Refuse a regression that has too few rows or does not determine its parameters."""
    unknowns = table.shape[1]
    refuse_short(len(table), 3 * unknowns, f"an ARX model with {unknowns} parameters")
    condition = np.linalg.cond(table / np.linalg.norm(table, axis=0))
    if not condition < RANK:
        raise FitError(
            f"the data does not determine all {unknowns} parameters (condition number {condition:.2g}): "
            "use lower orders or an input with more frequencies"
        )


def suggest_arx_orders(u, y, sample_time: float, maximum: int = 6, delays=(1, 2, 3), offset: bool = False) -> ArxOrders:
    """Return the orders with the lowest Bayesian information criterion.

    Units: ``sample_time`` [s], ``delays`` [samples].
    """
    best, chosen = np.inf, None
    for na in range(1, maximum + 1):
        for nb in range(1, na + 1):
            for delay in delays:
                try:
                    fit = fit_arx(u, y, sample_time, ArxOrders(na, nb, delay), offset=offset)
                except FitError:
                    continue
                floor = np.finfo(float).tiny
                criterion = fit.samples * np.log(max(fit.residual_variance, floor)) + (na + nb) * np.log(fit.samples)
                if criterion < best:
                    best, chosen = criterion, ArxOrders(na, nb, delay)
    if chosen is None:
        raise FitError("no ARX model can be fitted: the input excites too few frequencies")
    return chosen


def _check_orders(orders: ArxOrders, zero_radius: float | None) -> None:
    na, nb, delay = orders
    if na < 0 or nb < 1 or delay < 1:
        raise FitError(f"na = {na}, nb = {nb}, delay = {delay}: na must be ≥ 0, nb and delay ≥ 1")
    if zero_radius is not None and not 0.0 < zero_radius <= 1.0:
        raise FitError(f"zero_radius = {zero_radius}: must be in 0 … 1")
    if zero_radius is not None and nb > 3:
        raise FitError(f"nb = {nb}: zeros can be constrained only for nb ≤ 3; use fewer coefficients or no constraint")


def _records(u, y):
    single = np.ndim(u[0]) == 0
    pairs = [(u, y)] if single else list(zip(u, y, strict=True))
    return [checked_signals(*pair, ("input", "output"), fewest=1) for pair in pairs]


def _regression(u, y, orders: ArxOrders, offset: bool):
    """Return the table with the columns -y(t-1) …, u(t-d) … and 1, and the right-hand side y(t)."""
    na, nb, delay = orders
    first = max(na, nb + delay - 1)
    refuse_short(len(y), first + 1, "an ARX model")
    t = np.arange(first, len(y))
    columns = [-y[t - i] for i in range(1, na + 1)] + [u[t - delay - i] for i in range(nb)]
    if offset:
        columns.append(np.ones(len(t)))
    return np.column_stack(columns), y[t]


def _with_zeros_inside(table, right, orders: ArxOrders, radius: float):
    """Solve the regression with the constraint that all zeros of B lie within ``radius``.

    With up to two zeros, the polynomials with a positive first coefficient and all zeros within the radius form a
    convex cone (with two zeros, over the stability triangle). Polynomials at the corners span this cone, so the problem
    is linear least squares with weights ≥ 0, which is solved exactly for each sign of the gain.
    """
    na, nb, _ = orders
    spanned = {
        1: [np.array([1.0])],
        2: [np.array([1.0, radius]), np.array([1.0, -radius])],
        3: [
            np.array([1.0, 2 * radius, radius**2]),
            np.array([1.0, -2 * radius, radius**2]),
            np.array([1.0, 0.0, -(radius**2)]),
        ],
    }[nb]
    corners = np.column_stack(spanned)
    best, solution = np.inf, None
    for sign in (1.0, -1.0):
        mixed = np.concatenate([table[:, :na], sign * table[:, na : na + nb] @ corners, table[:, na + nb :]], axis=1)
        low = np.r_[np.full(na, -np.inf), np.zeros(nb), np.full(table.shape[1] - na - nb, -np.inf)]
        found = scipy.optimize.lsq_linear(mixed, right, (low, np.inf), method="bvls", tol=1e-14)
        if found.cost < best:
            best, solution = found.cost, found.x.copy()
            solution[na : na + nb] = sign * corners @ found.x[na : na + nb]
    return solution
