# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification of the polynomial branch model and of the preload curve (Kim, Kim & Park 2009; K2, K3).

K2: triangles with growing peaks are cut into loops. The branches of each loop are fitted by parabolas, and the
coefficients of these parabolas are quadratics of the peak voltage V_max. Two conditions make the branches continuous:

* both branches of a loop start at the same lower corner, D_r = D_f, and meet at the same upper corner (*per loop*);
* the upper corners lie on the virgin curve, for every V_max (*for the quadratics*, as identities of polynomials).

With these conditions nine free parameters remain: the virgin curve (3), D = D_v + D_1 V_max + D_2 V_max² (2 more), and
the bends C_r2 and C_f2 as linear functions of V_max (4); C_r1 and C_f1 follow. For a given voltage, the output of the
model is linear in its coefficients, even in minor loops, because the voltage alone determines the branch. The nine
parameters are therefore fitted to all samples together by linear least squares, with any excitation. The paper rates a
model by its largest error. So if the residual comes from the shape of the loops and not from noise, Lawson's
reweighting increases the weights of the largest residuals. For loops that do not have the shape of the model, this
halves the largest error.

K3, eqs 3-5: the preload curve W(L0) is fitted to displacement against preload.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import checked_signals
from hysteresis_ros.identification.preprocessing import (
    FEWEST_BRANCH_SAMPLES,
    require_both_directions,
    split_branches,
)
from hysteresis_ros.identification.validation import parameter_covariance
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.models.block import compiled, run_kernel
from hysteresis_ros.models.declaration import DISPLACEMENT
from hysteresis_ros.models.hysteresis.polynomial import (
    CHECKED_LOOPS,
    DIRECTION,
    ON_VIRGIN,
    SMALLEST_LOOP,
    STATES,
    TURN_DISPLACEMENT,
    VIRGIN,
    PolynomialParameters,
    polynomial,
)
from hysteresis_ros.recordings.loops import REVERSAL
from hysteresis_ros.units import shown_unit

#: Smallest difference between the peaks of different loops, as a fraction of the largest peak.
DIFFERENT_PEAKS = 0.02


@dataclass(frozen=True)
class LoopCoefficients:
    """Branch parabolas of one loop (eqs 1-2; figure 4 of the paper), SI units."""

    v_max: float  #: Peak [V].
    D: float  #: Lower corner D_r = D_f [m].
    C_r1: float  #: C_r1, C_r2: Rising branch [m/V, m/V²]; NaN if the voltage does not rise again after this peak.
    C_r2: float
    C_f1: float  #: C_f1, C_f2: Falling branch.
    C_f2: float
    rms: float  #: Residual [m].


def loop_table(voltage, displacement, branches):
    """Return the loops (in normalised units), and the samples of the virgin curve as (v, x)."""
    loops, virgin, reached = [], [], 0.0
    for place, branch in enumerate(branches):
        if not branch.rising or branch.high <= reached:
            continue
        rise = slice(branch.start, branch.stop + 1)
        fresh = voltage[rise] >= reached
        virgin.append(np.stack([voltage[rise][fresh], displacement[rise][fresh]]))
        grown = branch.high > (1.0 + DIFFERENT_PEAKS) * reached
        reached = branch.high
        after = branches[place + 1 : place + 3]
        if not grown or not after or len(after[0]) < FEWEST_BRANCH_SAMPLES:
            continue
        fall, again = after[0], after[1] if len(after) == 2 and len(after[1]) >= FEWEST_BRANCH_SAMPLES else None
        loops.append(_one_loop(voltage, displacement, reached, fall, again))
    return loops, np.concatenate(virgin, axis=1) if virgin else np.zeros((2, 0))


def _one_loop(voltage, displacement, v_max, fall, rise) -> LoopCoefficients:
    """Fit D, the upper corner X and the bends: x = D + (X - D) V/V_max + C2 V (V - V_max) on each branch."""
    parts = [(2, fall)] + ([(3, rise)] if rise is not None else [])
    rows, outputs = [], []
    for column, branch in parts:
        v, x = voltage[branch.samples], displacement[branch.samples]
        below = v <= v_max
        v = v[below]
        matrix = np.zeros((v.size, 4))
        matrix[:, 0], matrix[:, 1], matrix[:, column] = 1.0 - v / v_max, v / v_max, v * (v - v_max)
        rows.append(matrix)
        outputs.append(x[below])
    matrix, wanted = np.concatenate(rows), np.concatenate(outputs)
    found = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    corner, top, c_f2, c_r2 = found
    rms = float(np.sqrt(np.mean((matrix @ found - wanted) ** 2)))
    mean = (top - corner) / v_max
    if rise is None:
        c_r2 = np.nan
    return LoopCoefficients(v_max, corner, mean - c_r2 * v_max, c_r2, mean - c_f2 * v_max, c_f2, rms)


def distinct_peaks(v, reversal) -> list[float]:
    """Return the distinct values of V_max."""
    peaks: list[float] = []
    for branch in split_branches(v, reversal):
        if branch.high > (1.0 + DIFFERENT_PEAKS) * (peaks[-1] if peaks else 0.0):
            peaks.append(branch.high)
    return peaks


def in_units(loop, v_unit, x_unit) -> LoopCoefficients:
    """Convert a loop that was fitted in units of ``v_unit`` [V] and ``x_unit`` [m] to SI units."""
    one, two = x_unit / v_unit, x_unit / v_unit**2
    return LoopCoefficients(
        v_max=float(loop.v_max * v_unit),
        D=float(loop.D * x_unit),
        C_r1=float(loop.C_r1 * one),
        C_r2=float(loop.C_r2 * two),
        C_f1=float(loop.C_f1 * one),
        C_f2=float(loop.C_f2 * two),
        rms=float(loop.rms * x_unit),
    )


#: The free parameters θ of a fit, in order; the last three need peaks at several voltages.
FREE = ("D_v", "C_v1", "C_v2", "D_1", "C_r2", "C_f2", "D_2", "C_r2 slope", "C_f2 slope")
SINGLE_PEAK_FREE = 6
#: Parameters that are kept small if the recording does not determine them, and weight of this penalty.
SMALL = ("C_v2", "D_1", "D_2", "C_r2 slope", "C_f2 slope")
SMALL_WEIGHT = 1e-6
#: Points of a branch parabola that are used in the fit of quadratics of V_max, as fractions of V_max.
NODES = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
#: The remainder of the first rise after an omitted beginning is left out too if it covers at most this fraction of the
#: range, because the virgin curve would be extrapolated over the other part of the range.
SHORT_RISE = 0.2
#: Lowest allowed voltage, as a fraction of the highest voltage (negative: below 0 V); below this voltage the model has
#: no branches.
LOWEST_PART = -0.35
#: Smallest slope of a constrained fit, as a fraction of the mean slope.
SMALLEST_SLOPE = 0.02
#: Number of steps of Lawson's reweighting; fraction of the largest residual that is added to every residual in an
#: update, so that no weight vanishes.
REWEIGHTINGS = 30
LEAST_WEIGHT = 0.15
#: If the ratio of residual to noise is larger, the residual comes from the shape of the loops.
STRUCTURE = 2.0

_NAMES = ("virgin", "rising_D", "rising_C1", "rising_C2", "falling_D", "falling_C1", "falling_C2")


@dataclass(frozen=True)
class PolynomialIdentification:
    """Result of :func:`identify_polynomial`."""

    parameters: PolynomialParameters  #: The model.
    loops: tuple[LoopCoefficients, ...]  #: Coefficients of each single loop.
    #: shape (21, 21); Covariance of the coefficients for white residuals, in the order virgin, rising_D, rising_C1,
    #: rising_C2, falling_D, falling_C1, falling_C2, three numbers each.
    covariance: np.ndarray
    rms: float  #: rms, maximum: Residual of all samples [m].
    maximum: float
    criterion: str  #: Error that was minimised: ``rms`` or ``maximum``.
    converged: bool  #: False if no monotone model was found.
    warnings: tuple[str, ...]  #: Warnings about uncertain results, as sentences.

    @property
    def standard_errors(self) -> dict[str, tuple[float, ...]]:
        """Standard errors of the coefficients, by parameter name."""
        errors = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None)).reshape(7, 3)
        return {name: tuple(row.tolist()) for name, row in zip(_NAMES, errors, strict=True)}


def _basis(count: int) -> np.ndarray:
    """Return the matrix from θ to the 21 coefficients, shape (21, count), for which both corner conditions hold."""
    basis = np.zeros((7, 3, len(FREE)))
    d_v, c_v1, c_v2, d_1, c_r2, c_f2, d_2, c_r2_slope, c_f2_slope = range(len(FREE))
    basis[0, [0, 1, 2], [d_v, c_v1, c_v2]] = 1.0
    for first, bend, slope in ((1, c_r2, c_r2_slope), (4, c_f2, c_f2_slope)):
        basis[first, [0, 1, 2], [d_v, d_1, d_2]] = 1.0
        basis[first + 2, [0, 1], [bend, slope]] = 1.0
        # D + C1 V_max + C2 V_max² = x_v(V_max), power by power
        basis[first + 1, [0, 0], [c_v1, d_1]] = 1.0, -1.0
        basis[first + 1, [1, 1, 1], [c_v2, d_2, bend]] = 1.0, -1.0, -1.0
        basis[first + 1, 2, slope] = -1.0
    return basis.reshape(21, len(FREE))[:, :count]


def _simulated(voltage, coefficients) -> np.ndarray:
    """Return the output, shape (N,), of the model with any 21 coefficients, even unphysical ones."""
    p = np.append(coefficients, 1.0)
    x = np.zeros(STATES)
    x[DISPLACEMENT] = x[TURN_DISPLACEMENT] = p[VIRGIN]
    x[DIRECTION] = x[ON_VIRGIN] = 1.0
    y = np.empty_like(voltage)
    compiled(run_kernel)(polynomial, p, x, voltage, y)
    return y


def _slopes(basis, v_low) -> np.ndarray:
    """Return G such that G θ are the slopes that PolynomialParameters requires to be positive."""

    def curve(family, v_max, v, order):
        """Return the row for the value (order 0) or the slope (order 1) of a branch."""
        powers = v_max ** np.arange(3)
        rows = basis.reshape(7, 3, -1)[family : family + 3]
        factors = (1.0, v, v * v) if order == 0 else (0.0, 1.0, 2.0 * v)
        return sum(factor * (powers @ row) for factor, row in zip(factors, rows, strict=True))

    virgin = basis[:3]
    rows = [virgin[1], virgin[1] + 2.0 * virgin[2]]
    for v_max in np.linspace(SMALLEST_LOOP, 1.0, CHECKED_LOOPS):
        for bottom in {0.0, v_low}:
            start = curve(4, v_max, bottom, 0) - curve(1, v_max, bottom, 0)
            # the upper corner lies on the virgin curve and needs no blending
            rows += [curve(1, v_max, v, 1) - start / (v_max - bottom) for v in (bottom, v_max)]
            rows += [curve(4, v_max, v, 1) for v in (bottom, v_max)]
    return np.array(rows)


def _through_loops(loops, virgin, basis) -> np.ndarray:
    """Return the θ whose quadratics of V_max are nearest to the parabolas of the loops (K2 as in the paper)."""
    if not loops:
        raise IdentificationError("no loop starts on the virgin curve; use method samples with this recording")
    rows, wanted = [], []
    blocks = basis.reshape(7, 3, -1)
    for loop in loops:
        powers = loop.v_max ** np.arange(3)
        for first, c1, c2 in ((1, loop.C_r1, loop.C_r2), (4, loop.C_f1, loop.C_f2)):
            if np.isnan(c2):
                continue
            for v in NODES * loop.v_max:
                rows.append(sum(v**i * (powers @ blocks[first + i]) for i in range(3)))
                wanted.append(loop.D + v * (c1 + v * c2))
    v, x = virgin
    weight = np.sqrt(len(wanted) / max(v.size, 1))  # with the same total weight as all loops together
    table = np.concatenate([np.array(rows), weight * (np.vander(v, 3, increasing=True) @ basis[:3])])
    return np.linalg.lstsq(table, np.concatenate([wanted, weight * x]), rcond=None)[0]


def _weights(matrix, wanted, criterion):
    """Return the square roots of the weights, shape (N,), and the criterion, as selected if it was ``automatic``."""
    # with an orthogonal basis the weighted normal equations stay well conditioned
    u, singular, _ = np.linalg.svd(matrix, full_matrices=False)
    u = u[:, singular > 1e-10 * singular[0]]
    weight = np.ones(len(wanted))
    residual = u @ (u.T @ wanted) - wanted
    if criterion == "automatic":
        noise = np.sqrt(0.5 * np.mean(np.diff(residual) ** 2))
        structured = np.sqrt(np.mean(residual**2)) > max(STRUCTURE * noise, 1e-9)
        criterion = "maximum" if structured else "rms"
    if criterion == "maximum":
        for _ in range(REWEIGHTINGS):
            size = np.abs(residual)
            weight *= LEAST_WEIGHT * np.max(size) + size
            weight /= np.max(weight)
            weighted = weight[:, None] * u
            residual = u @ np.linalg.solve(u.T @ weighted, weighted.T @ wanted) - wanted
    return np.sqrt(weight), criterion


def _with_prior(weight, matrix, wanted):
    """Return the weighted problem with additional rows that keep undetermined parameters small."""
    size = SMALL_WEIGHT * np.sqrt(len(wanted))
    prior = size * np.eye(len(FREE))[[FREE.index(name) for name in SMALL], : matrix.shape[1]]
    return np.vstack([weight[:, None] * matrix, prior]), np.append(weight * wanted, np.zeros(len(prior)))


def _monotone(theta, matrix, wanted, slopes, smallest):
    """Return the least-squares θ with slopes of at least ``smallest``, and whether all its slopes are positive."""
    from scipy.optimize import minimize  # imported here because only fits need it

    q, r = np.linalg.qr(matrix)
    target = q.T @ wanted
    solved = minimize(
        lambda t: 0.5 * np.sum((r @ t - target) ** 2) / len(wanted),
        theta,
        jac=lambda t: r.T @ (r @ t - target) / len(wanted),
        constraints={"type": "ineq", "fun": lambda t: slopes @ t - smallest, "jac": lambda t: slopes},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-14},
    )
    return solved.x, bool(np.all(slopes @ solved.x > 0.0))


def identify_polynomial(
    voltage,
    displacement,
    *,
    history=(),
    method: str = "samples",
    criterion: str = "automatic",
    reversal: float = REVERSAL,
) -> PolynomialIdentification:
    """Identify the polynomial branch model from loops between about 0 V and one or several peaks (K2).

    Units: ``voltage`` [V], ``displacement`` [m].
    """
    voltage, displacement = checked_signals(voltage, displacement)
    _check_request(voltage, method, criterion)
    path = np.concatenate([np.asarray(history, dtype=float), voltage])
    v_unit, x_unit = float(path.max()), float(np.ptp(displacement))
    v, x = path / v_unit, displacement / x_unit
    recorded = slice(path.size - voltage.size, None)
    branches = split_branches(voltage / v_unit, reversal)
    require_both_directions(branches, "loop model")

    if len(path) > len(voltage):
        late = _end_of_first_rise(v, path.size - voltage.size)
        recorded, x = slice(late, None), x[late - path.size :]
    loops, virgin = loop_table(v[recorded], x, branches)
    count, warnings = _free_numbers(v, voltage, reversal)
    basis = _basis(count)
    matrix = np.stack([_simulated(v, column)[recorded] for column in basis.T], axis=1)
    if method == "loops":
        theta = _through_loops(loops, virgin, basis)
        weight, criterion = np.ones(x.size), "rms"
    else:
        weight, criterion = _weights(matrix, x, criterion)
        table, wanted = _with_prior(weight, matrix, x)
        theta = np.linalg.lstsq(table, wanted, rcond=None)[0]
    warnings += _undetermined(matrix)
    low = min(float(voltage.min()), 0.0)
    slopes, converged = _slopes(basis, low / v_unit), True
    worst = float(np.min(slopes @ theta))
    if not worst > 0.0:
        mean = np.ptp(x) / np.ptp(v)
        table, wanted = _with_prior(weight, matrix, x)
        theta, converged = _monotone(theta, table, wanted, slopes, SMALLEST_SLOPE * mean)
        warnings.append(_not_monotone(worst * x_unit / v_unit, converged))
    residual, scale = matrix @ theta - x, _scale(v_unit, x_unit)
    covariance = parameter_covariance(matrix, residual, truncated=1e-10)
    parameters = _parameters(scale * (basis @ theta), low, v_unit)
    if converged:
        parameters.validated()
    return PolynomialIdentification(
        parameters=parameters,
        loops=tuple(in_units(loop, v_unit, x_unit) for loop in loops),
        covariance=basis @ covariance @ basis.T * np.outer(scale, scale),
        rms=x_unit * float(np.sqrt(np.mean(residual**2))),
        maximum=x_unit * float(np.max(np.abs(residual))),
        criterion=criterion,
        converged=converged,
        warnings=tuple(warnings),
    )


def _end_of_first_rise(path, first: int) -> int:
    """Return the first sample that counts: ``first``, or the end of a short remainder of the first rise.

    Units: ``path`` [fraction of the highest voltage].
    """
    later = path[first:]
    lower = np.flatnonzero(later < later[0] - DIFFERENT_PEAKS)
    turn = int(np.argmax(later[: lower[0]] if lower.size else later))
    rises = later[0] >= np.max(path[: first + 1])
    return first + turn if rises and later[turn] - later[0] <= SHORT_RISE else first


def _check_request(voltage, method: str, criterion: str) -> None:
    """Refuse unknown choices, and voltages for which the model has no branches."""
    for name, value, allowed in (
        ("method", method, ("samples", "loops")),
        ("criterion", criterion, ("automatic", "rms", "maximum")),
    ):
        if value not in allowed:
            raise IdentificationError(f"{name} = {value!r}: must be one of {', '.join(allowed)}")
    high, low = float(voltage.max()), float(voltage.min())
    if high <= 0.0 or low < LOWEST_PART * high:
        raise IdentificationError(
            f"the voltage runs from {low:g} to {high:g} {shown_unit('V')}; the polynomial model describes only loops "
            "between 0 V and positive peaks: record such loops, or identify another model (prandtl_ishlinskii) for "
            "both polarities"
        )


def _free_numbers(v, voltage, reversal) -> tuple[int, list[str]]:
    """Return how many parameters the path ``v`` (as a fraction of its peak) determines, and warnings."""
    count, warnings = len(FREE), []
    peaks = distinct_peaks(v, reversal)
    if len(peaks) < 3:
        count = SINGLE_PEAK_FREE
        warnings.append(
            f"the recording reaches {len(peaks)} different V_max, but coefficients that are quadratics of V_max need "
            "three or more; the residual displacement is assumed proportional to V_max and the bends constant: "
            "record triangles of growing peak from 0 V"
        )
    high, low = float(voltage.max()), float(voltage.min())
    if low > 0.1 * high:
        warnings.append(
            f"the lowest voltage is {low:g} {shown_unit('V')}; the residual displacement at 0 V is extrapolated"
        )
    return count, warnings


def _undetermined(matrix) -> list[str]:
    """Return the warning about a recording that does not determine every parameter."""
    condition = np.linalg.cond(matrix)
    if not condition > 1e6:
        return []
    return [
        f"the recording does not determine all coefficients (condition number {condition:.1e}); undetermined ones are "
        "set so that the virgin curve is straight and nothing depends on V_max"
    ]


def _not_monotone(slope: float, converged: bool) -> str:
    """Return the warning about a fit with a non-monotone branch; ``slope`` [m/V] is the smallest slope."""
    taken = "the nearest monotone one is used" if converged else "a monotone one was not found: do not use this model"
    smallest = f"{slope:.3g} {shown_unit('m')}/{shown_unit('V')}"
    return f"the best fit has a branch that is not monotone (smallest slope {smallest}); {taken}"


def _scale(v_unit: float, x_unit: float) -> np.ndarray:
    """Return the scale of the 21 coefficients in SI units, shape (21,)."""
    scale = np.array([x_unit / v_unit ** (power + row) for row in (0, 0, 1, 2, 0, 1, 2) for power in range(3)])
    scale[:3] = x_unit / v_unit ** np.arange(3)
    return scale


def _parameters(coefficients, low: float, high: float) -> PolynomialParameters:
    """Return the model with the given 21 coefficients for voltages ``low … high`` [V]."""
    named = zip(_NAMES, coefficients.reshape(7, 3), strict=True)
    rows: dict[str, Any] = {name: tuple(row.tolist()) for name, row in named}
    return PolynomialParameters(**rows, voltage_low=low, voltage_high=high)


#: Least number of points of the preload curve.
FEWEST_POINTS = 4


@dataclass(frozen=True)
class PreloadIdentification:
    """Result of :func:`identify_preload`."""

    parameters: PreloadParameters  #: A1, B1 and B2, and the preload in use (``force``).
    covariance: np.ndarray  #: shape (3, 3); Covariance of A1, B1 and B2.
    rms: float  #: Residual [m].
    stiffness: float  #: -1/(B1 + 2 B2 L0) [N/m], with L0 in the middle of the recorded preloads.
    largest_force: float  #: Largest preload of the data [N].
    warnings: tuple[str, ...]  #: Warnings about uncertain results, as sentences.


def identify_preload(force, displacement, *, in_use: float = 0.0) -> PreloadIdentification:
    """Fit W = A1 + B1 L0 + B2 L0² to displacement against preload.

    Units: ``force`` [N], ``displacement`` [m].
    """
    force, displacement = checked_signals(force, displacement, ("preload", "displacement"), FEWEST_POINTS)
    if force.min() < 0.0:
        raise IdentificationError(f"preload {force.min():g} N is negative; give compressing forces as positive numbers")
    levels = np.unique(np.round(force / np.ptp(force), 6))
    if levels.size < 3:
        raise IdentificationError(f"{levels.size} different preloads; a quadratic needs at least three")
    unit = float(force.max())
    powers = unit ** np.arange(3)
    matrix = np.vander(force / unit, 3, increasing=True)
    found = np.linalg.lstsq(matrix, displacement, rcond=None)[0]
    residual = matrix @ found - displacement
    covariance = parameter_covariance(matrix, residual) / np.outer(powers, powers)
    a1, b1, b2 = (found / powers).tolist()
    warnings = []
    ends = b1 + 2.0 * b2 * np.array([force.min(), force.max()])
    if ends.min() * ends.max() <= 0.0:
        warnings.append(
            f"W(L0) is not monotone between {force.min():g} and {force.max():g} N; a displacement does not "
            "determine a preload"
        )
    if in_use > force.max():
        warnings.append(f"preload {in_use:g} N lies beyond the largest recorded, {force.max():g} N: extrapolated")
    middle = float(np.mean(ends))
    return PreloadIdentification(
        parameters=PreloadParameters(force=float(in_use), A1=a1, B1=b1, B2=b2).validated(),
        covariance=covariance,
        rms=float(np.sqrt(np.mean(residual**2))),
        stiffness=-1.0 / middle if middle != 0.0 else float("inf"),
        largest_force=float(force.max()),
        warnings=tuple(warnings),
    )


def preload_of_offset(preload: PreloadParameters, offset: float) -> float:
    """Return the preload L0 [N] whose W is ``offset`` [m]: the root of eq. 3 nearest to zero preload."""
    rise = offset - preload.A1
    discriminant = preload.B1**2 + 4.0 * preload.B2 * rise
    if discriminant >= 0.0 and preload.B1 != 0.0:
        force = 2.0 * rise / (preload.B1 + np.copysign(np.sqrt(discriminant), preload.B1))
        if force >= 0.0:
            return float(force)
    raise IdentificationError(
        f"offset {offset:g} m is not reached by the preload curve A1 = {preload.A1:g}, B1 = {preload.B1:g}, "
        f"B2 = {preload.B2:g} at any preload ≥ 0; check the sign of the displacement"
    )
