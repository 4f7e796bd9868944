# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Continuous transfer functions by output error (B2), and their reduction to second order.

``G(s) = (b_m sᵐ + … + b_0)/(sⁿ + a_(n-1) sⁿ⁻¹ + … + a_0)``. The simulated output is fitted, not a one-step prediction.
For given poles the output is linear in the numerator, the initial state and an offset; these are solved for exactly in
every step (variable projection), and only the n coefficients of the denominator are searched. The denominator is a
product of factors ``s² + α s + β`` and ``s + α`` with positive coefficients. All stable denominators have this form,
and no unstable ones, so every step of the search is stable. A reduction to second order matches the step response (B2)
and gives mass, damping and stiffness.

References
----------
.. [1] Auwal et al., section 2.2, eqs 1-3 and table I.
.. [2] Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973 (variable projection).
.. [3] Van Loan, IEEE Trans. Autom. Control 23, 1978 (matrix exponentials for discretisation).
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from hysteresis_ros.executors import Job, shared
from hysteresis_ros.identification.arx import ArxOrders, fit_arx
from hysteresis_ros.identification.data import CONSTANT, DataError, checked_signals, refuse_short
from hysteresis_ros.identification.linear_systems import (
    INTERSAMPLE,
    CanonicalSimulation,
    FitError,
    LinearModel,
    simulate_transfer_function,
)
from hysteresis_ros.identification.validation import final_prediction_error, fit_percent, parameter_covariance

#: Possible initial states of a fit.
INITIAL = ("zero", "rest", "periodic", "estimate")


@dataclass(frozen=True)
class Structure:
    """Structure of the fit, and conditions of its simulation."""

    poles: int = 2  #: poles, zeros: n ≥ 1 and m ≤ n.
    zeros: int = 0
    intersample: str = "zoh"  #: ``zoh``, ``foh`` (or ``linear``) or ``bandlimited``.
    #: Initial state: ``zero``, ``rest`` (at the first input), ``periodic`` (needs whole periods of data) or
    #: ``estimate``.
    initial: str = "zero"
    offset: bool = False  #: Whether a constant is also fitted.
    delay: float = 0.0  #: Known dead time of the input [s].

    @property
    def columns(self) -> int:
        """Number of parameters in which the output is linear: numerator, offset, initial state."""
        return self.zeros + 1 + bool(self.offset) + (self.poles if self.initial == "estimate" else 0)

    def check(self) -> None:
        """Raise FitError for invalid settings."""
        if self.poles < 1 or not 0 <= self.zeros <= self.poles:
            raise FitError(
                f"poles = {self.poles}, zeros = {self.zeros}: there must be at least one pole and no more zeros than "
                "poles"
            )
        if self.intersample not in INTERSAMPLE:
            raise FitError(f"intersample = {self.intersample!r}: must be one of {', '.join(INTERSAMPLE)}")
        if self.initial not in INITIAL:
            raise FitError(f"initial = {self.initial!r}: must be one of {', '.join(INITIAL)}")


@dataclass(frozen=True)
class Search:
    """Starts of the search for the poles."""

    #: Number of starts: an ARX fit, the start given by the user, and frequencies and dampings spread over the band of
    #: the data.
    starts: int = 6
    start_poles: Sequence[complex] | np.ndarray | None = None  #: shape (n,); Start given by the user [rad/s].
    seed: int = 0  #: Seed of the random starts.


@dataclass(frozen=True)
class Start:
    """One start of the search."""

    poles: tuple[complex, ...]  #: [rad/s]
    first_rmse: float  #: first_rmse, rmse: RMS error before and after the search, in the output's unit.
    rmse: float
    converged: bool


@dataclass(frozen=True, eq=False)
class TransferFunctionFit:
    """A continuous transfer function from sampled data."""

    numerator: np.ndarray  #: shape (m + 1,); b_m … b_0, highest power first.
    denominator: np.ndarray  #: shape (n + 1,); 1, a_(n-1) … a_0.
    #: shape (m + 1 + n, m + 1 + n); Covariance of b_m … b_0, a_(n-1) … a_0 for white residuals; NaN for coefficients
    #: that the data does not determine.
    covariance: np.ndarray
    offset: float  #: Constant of the output, in its unit; 0 when it was not fitted.
    delay: float  #: Dead time of the input [s], as given.
    predicted: np.ndarray  #: shape (N,); Simulated output.
    fit_percent: float  #: [%]
    mse: float  #: mse, fpe: In the output's unit squared.
    fpe: float
    sample_time: float  #: Sample time of the data [s].
    intersample: str  #: Assumed input between samples.
    starts: tuple[Start, ...]  #: All starts of the search, best first.
    converged: bool  #: Whether the best start converged.
    warnings: tuple[str, ...]  #: Not converged, pole at a bound, non-minimum-phase, weakly determined.
    input_unit: str = "V"  #: input_unit, output_unit: SI units.
    output_unit: str = "m"

    @property
    def poles(self) -> np.ndarray:
        """Poles [rad/s], shape (n,)."""
        return np.roots(self.denominator)

    @property
    def zeros(self) -> np.ndarray:
        """Zeros [rad/s]."""
        return np.roots(self.numerator)

    @property
    def dc_gain(self) -> float:
        """DC gain b_0/a_0, output unit per input unit."""
        return float(self.numerator[-1] / self.denominator[-1])

    @property
    def standard_deviations(self) -> np.ndarray:
        """Standard deviations of b_m … b_0, a_(n-1) … a_0."""
        return np.sqrt(np.diag(self.covariance))

    def simulate(self, u, sample_time: float | None = None, initial: str = "zero") -> np.ndarray:
        """Return the output for another input, without the offset, shape (N,).

        Units: ``sample_time`` [s].
        """
        return simulate_transfer_function(
            self.numerator,
            self.denominator,
            u,
            sample_time or self.sample_time,
            self.intersample,
            initial,
            self.delay,
        )

    def discrete(self, sample_time: float | None = None) -> LinearModel:
        """Return the state space for an input held over each sample, without the delay.

        Units: ``sample_time`` [s].
        """
        step = sample_time or self.sample_time
        return CanonicalSimulation(self.denominator, step, "zoh").model(
            self.numerator, self.input_unit, self.output_unit
        )


#: Largest number of evaluations of each start; after that, only the best start continues.
EVALUATIONS = 40


def fit_transfer_function(
    u,
    y,
    sample_time: float,
    structure: Structure | None = None,
    *,
    skip: int = 0,
    search: Search | None = None,
    units: tuple[str, str] = ("V", "m"),
) -> TransferFunctionFit:
    """Fit a stable continuous transfer function to input and output, from several starts.

    Units: ``sample_time`` [s].
    """
    structure, search = structure or Structure(), search or Search()
    u, y = checked_signals(u, y, ("input", "output"), fewest=1)
    _check(y, structure, skip)
    scale_u, scale_y = float(np.ptp(u)), float(np.ptp(y[skip:]))
    problem = _Problem(u / scale_u, y / scale_y, sample_time, structure, skip)
    candidates = _starts(problem, u, y, search)
    ranked = sorted(candidates, key=problem.cost)[: max(1, search.starts)]
    if search.start_poles is not None and not any(np.array_equal(candidates[0], item) for item in ranked):
        ranked[-1] = candidates[0]
    begun = time.perf_counter()
    problem.cost(ranked[0])
    # the derivatives need one more evaluation for each parameter
    seconds = (time.perf_counter() - begun) * EVALUATIONS * (1 + len(ranked[0])) * len(ranked)
    solved = shared([Job(problem.solve, (start, EVALUATIONS)) for start in ranked], seconds)
    results = list(zip(ranked, solved, strict=True))
    results.sort(key=lambda pair: pair[1].cost)
    best = problem.solve(results[0][1].x, 400)
    starts = tuple(
        Start(
            tuple(map(complex, np.roots(problem.denominator(start)))),
            problem.rmse(problem.cost(start)) * scale_y,
            problem.rmse(result.cost) * scale_y,
            bool(result.status > 0),
        )
        for start, result in results
    )
    return _result(problem, best, (scale_u, scale_y), starts, units)


class _Problem:
    """Residual of the fit in scaled units, as a function of the logarithms of the coefficients α and β."""

    def __init__(self, u, y, sample_time: float, structure: Structure, skip: int):
        self.u, self.y, self.sample_time, self.structure, self.skip = u, y, sample_time, structure, skip
        self.poles, self.zeros = structure.poles, structure.zeros
        self.slowest, self.fastest = 0.05 / (sample_time * len(y)), 50.0 / sample_time
        pairs, odd = divmod(self.poles, 2)
        low, high = np.log(self.slowest), np.log(self.fastest)
        # s² + α s + β: α from nearly undamped to the sum of two fast real poles
        self.low = np.array([low + np.log(1e-4), 2 * low] * pairs + [low] * odd)
        self.high = np.array([high + np.log(2.0), 2 * high] * pairs + [high] * odd)

    def denominator(self, theta):
        """Return 1, a_(n-1) … a_0."""
        result = np.ones(1)
        values = np.exp(theta)
        for i in range(0, self.poles - 1, 2):
            result = np.polymul(result, [1.0, values[i], values[i + 1]])
        return np.polymul(result, [1.0, values[-1]]) if self.poles % 2 else result

    def theta(self, poles):
        """Return the logarithms for given poles, which are mirrored to the stable side and clipped to the bounds."""
        poles = -np.abs(np.real(poles)) + 1j * np.imag(poles)
        pairs = [p for p in poles if p.imag > 0.0]
        real = sorted((p.real for p in poles if p.imag == 0.0), reverse=True)
        factors = [(-2 * p.real, abs(p) ** 2) for p in pairs]
        factors += [(-(real[i] + real[i + 1]), real[i] * real[i + 1]) for i in range(0, len(real) - 1, 2)]
        flat = [x for factor in factors for x in factor] + ([-real[-1]] if len(real) % 2 else [])
        values = np.log(np.maximum(flat, 1e-300))
        return np.clip(values, self.low + 1e-6, self.high - 1e-6)

    def table(self, denominator):
        """Return the columns whose linear combination is the output, shape (N, …): numerator, offset, free response."""
        model = self.structure
        simulation = CanonicalSimulation(denominator, self.sample_time, model.intersample)
        start = "zero" if model.initial == "estimate" else model.initial
        columns = [simulation.bases(self.u, self.zeros, start, model.delay)]
        if model.offset:
            columns.append(np.ones((len(self.y), 1)))
        if model.initial == "estimate":
            columns.append(simulation.free_responses(len(self.y)))
        return np.concatenate(columns, axis=1)

    def fitted(self, theta):
        """Return the table, its coefficients and the residual."""
        table = self.table(self.denominator(theta))
        used = table[self.skip :]
        length = np.linalg.norm(used, axis=0)
        length[~(length > 0.0)] = 1.0
        solution = np.linalg.lstsq(used / length, self.y[self.skip :], rcond=1e-13)[0] / length
        return table, solution, used @ solution - self.y[self.skip :]

    def residual(self, theta):
        residual = self.fitted(theta)[2]
        return residual if np.all(np.isfinite(residual)) else np.full(residual.shape, 1e6)

    def cost(self, theta):
        residual = self.residual(theta)
        return 0.5 * float(residual @ residual)

    def rmse(self, cost):
        return float(np.sqrt(2 * cost / (len(self.y) - self.skip)))

    def solve(self, theta, evaluations):
        theta = np.clip(theta, self.low + 1e-6, self.high - 1e-6)
        return scipy.optimize.least_squares(
            self.residual, theta, bounds=(self.low, self.high), max_nfev=evaluations, xtol=1e-12, ftol=1e-12, gtol=1e-14
        )


def _starts(problem: _Problem, u, y, search: Search) -> list[np.ndarray]:
    """Return logarithms of initial values: from the user, an ARX fit, a grid over the band, and random numbers."""
    poles, sample_time, given = problem.poles, problem.sample_time, search.start_poles
    found = [] if given is None else [problem.theta(np.asarray(given, dtype=complex))]
    if given is not None and len(found[0]) != poles:
        raise FitError(f"start_poles has {len(given)} poles; {poles} are needed, real or in conjugate pairs")
    try:
        arx = fit_arx(u, y, sample_time, ArxOrders(poles, poles), offset=True).poles.astype(complex)
        arx[np.abs(arx) < 1e-6] = 1e-6
        arx[(arx.imag == 0.0) & (arx.real < 0.0)] = 0.05  # a negative real pole has no continuous equivalent
        found.append(problem.theta(np.log(arx) / sample_time))
    except (FitError, DataError):
        pass  # an ARX fit may fail, because it needs more excitation than an output-error fit; the other starts remain
    random = np.random.default_rng(search.seed)
    # observable frequencies: from one period in the whole data to half the sample rate
    band = np.log([2 * np.pi / (sample_time * len(y)), np.pi / sample_time])
    grid = np.exp(np.linspace(band[0], band[1], 6))
    for frequency, damping in itertools.product(grid, (0.05, 0.7)):
        pairs = [_pair(min(frequency * 4.0**i, problem.fastest / 4), damping) for i in range(poles // 2)]
        found.append(problem.theta(np.array([*itertools.chain(*pairs), *[-frequency] * (poles % 2)], dtype=complex)))
    while len(found) < 6 * search.starts:
        pairs = [
            _pair(np.exp(random.uniform(*band)), np.exp(random.uniform(np.log(0.01), 0.0))) for _ in range(poles // 2)
        ]
        real = [-np.exp(random.uniform(*band)) for _ in range(poles % 2)]
        found.append(problem.theta(np.array([*itertools.chain(*pairs), *real], dtype=complex)))
    return found


def _pair(frequency, damping):
    pole = frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
    return pole, np.conj(pole)


def _result(problem: _Problem, best, scales: tuple[float, float], starts, units) -> TransferFunctionFit:
    scale_u, scale_y = scales
    table, solution, residual = problem.fitted(best.x)
    denominator = problem.denominator(best.x)
    numerator = solution[: problem.zeros + 1][::-1] * scale_y / scale_u
    predicted = table @ solution
    covariance, warnings = _covariance(problem, denominator, table, solution, residual, scale_y / scale_u)
    mse = float(np.mean(residual**2)) * scale_y**2
    structure = problem.structure
    return TransferFunctionFit(
        numerator=numerator,
        denominator=denominator,
        covariance=covariance,
        offset=float(solution[problem.zeros + 1] * scale_y) if structure.offset else 0.0,
        delay=float(structure.delay),
        predicted=predicted * scale_y,
        fit_percent=fit_percent(problem.y[problem.skip :], predicted[problem.skip :]),
        mse=mse,
        fpe=final_prediction_error(mse, len(residual), table.shape[1] + problem.poles),
        sample_time=problem.sample_time,
        intersample=structure.intersample,
        starts=starts,
        converged=bool(best.status > 0),
        warnings=(*warnings, *_warnings(problem, best, numerator, denominator)),
        input_unit=units[0],
        output_unit=units[1],
    )


def _covariance(problem: _Problem, denominator, table, solution, residual, gain: float):
    """Return the covariance of the coefficients (NaN where the data cannot distinguish them) and warnings."""
    predicted = table @ solution
    # derivatives with respect to the coefficients of the denominator, with fixed linear parameters
    derivatives = []
    for j in range(1, problem.poles + 1):
        moved = denominator.copy()
        step = 1e-6 * max(abs(moved[j]), 1e-30)
        moved[j] += step
        derivatives.append((problem.table(moved) @ solution - predicted) / step)
    units = np.r_[np.full(problem.zeros + 1, gain), np.ones(problem.poles)]
    ordered = np.column_stack([table[:, problem.zeros :: -1], *derivatives, table[:, problem.zeros + 1 :]])
    count = problem.zeros + 1 + problem.poles
    try:
        covariance = parameter_covariance(ordered[problem.skip :], residual)[:count, :count] * np.outer(units, units)
    except DataError:
        return np.full((count, count), np.nan), ["the data does not determine all coefficients: lower the order"]
    weak = np.sqrt(np.diag(covariance))[problem.zeros + 1 :] > np.abs(denominator[1:])
    warnings = ["the denominator is weakly determined (deviations above 100 %): lower the order"] if weak.any() else []
    return covariance, warnings


def _warnings(problem: _Problem, best, numerator, denominator):
    """Yield warnings about the search and about the transfer function that was found."""
    at_bound = (best.x - problem.low < 1e-3) | (problem.high - best.x < 1e-3)
    if at_bound.any():
        yield "a pole is at its bound, slower or faster than the data can resolve: lower the order"
    if not best.status > 0:
        yield "the search did not converge: the result is the best point found"
    right = [z for z in np.roots(numerator) if z.real >= 0.0]
    if right:
        listed = ", ".join(f"{z:.4g}" for z in right)
        yield f"non-minimum-phase linear fit: zero(s) {listed} rad/s in the right half plane"
    if numerator[-1] / denominator[-1] <= 0.0:
        yield "the DC gain is not positive: the output moves against the input"


def _check(y, structure: Structure, skip: int) -> None:
    """Refuse unusable settings, and an output that is constant after the skipped samples."""
    structure.check()
    if not 0 <= skip < len(y):
        raise DataError("range", f"skip = {skip}: must be in 0 … {len(y) - 1}")
    if np.ptp(y[skip:]) <= CONSTANT * np.max(np.abs(y[skip:])):
        raise DataError("constant", "the output is constant; excite the actuator and record again")
    poles, zeros = structure.poles, structure.zeros
    needed = 3 * (poles + structure.columns)
    refuse_short(len(y) - skip, needed, f"a transfer function with {poles} poles and {zeros} zeros")


@dataclass(frozen=True)
class SecondOrder:
    """``G(s) = gain ω²/(s² + 2 ζ ω s + ω²)``."""

    gain: float  #: DC gain, output unit per input unit.
    frequency: float  #: ω [rad/s].
    damping: float  #: ζ [1].
    rms: float  #: RMS difference of the step responses of both models, relative to the DC gain.

    @property
    def numerator(self) -> np.ndarray:
        """b_0, shape (1,)."""
        return np.array([self.gain * self.frequency**2])

    @property
    def denominator(self) -> np.ndarray:
        """1, 2 ζ ω, ω²."""
        return np.array([1.0, 2.0 * self.damping * self.frequency, self.frequency**2])


@dataclass(frozen=True)
class MassSpringDamper:
    """``G(s) = 1/(m s² + b s + K)`` (B2, eq. 3).

    If the input is in V and the output in m, the units are not those of mechanics (m is in V s²/m, and so on). If the
    input is a force in N, the units are kg, N s/m and N/m.
    """

    mass: float  #: m [input unit · s²/output unit].
    damping: float  #: b [input unit · s/output unit].
    stiffness: float  #: K [input unit/output unit].


def dominant_second_order(numerator, denominator, horizon: float | None = None, samples: int = 2000) -> SecondOrder:
    """Reduce to second order: keep dominant frequency and DC gain, fit the damping to the step response (B2).

    The dominant pole pair is the slowest one, whose transient decays last.

    Units: ``horizon`` [s].
    """
    denominator = np.atleast_1d(np.asarray(denominator, dtype=float))
    numerator = np.atleast_1d(np.asarray(numerator, dtype=float)) / denominator[0]
    denominator = denominator / denominator[0]
    poles = np.roots(denominator)
    if len(poles) < 2:
        raise FitError(f"a model with {len(poles)} poles has no dominant pair")
    _refuse_unstable(poles)
    slow = poles[np.argsort(-poles.real)]
    second = np.conj(slow[0]) if slow[0].imag else next(p for p in slow[1:] if p.imag == 0.0 or p is slow[-1])
    frequency = float(np.sqrt(abs(slow[0] * second)))
    gain = float(numerator[-1] / denominator[-1])
    duration = horizon or 10.0 / abs(slow[0].real)
    step = duration / samples
    u = np.ones(samples)
    full = simulate_transfer_function(numerator, denominator, u, step) / gain

    def difference(logarithm):
        zeta = np.exp(logarithm[0])
        return simulate_transfer_function([frequency**2], [1.0, 2 * zeta * frequency, frequency**2], u, step) - full

    start = np.log(max(-(slow[0] + second).real / (2 * frequency), 1e-6))
    found = scipy.optimize.least_squares(difference, [start], xtol=1e-14, ftol=1e-14)
    return SecondOrder(gain, frequency, float(np.exp(found.x[0])), float(np.sqrt(np.mean(found.fun**2))))


def mass_spring_damper(numerator, denominator) -> MassSpringDamper:
    """Return m, b and K of ``1/(m s² + b s + K)`` from ``b_0/(a_2 s² + a_1 s + a_0)`` (B2, eq. 3)."""
    numerator = np.trim_zeros(np.atleast_1d(np.asarray(numerator, dtype=float)), "f")
    denominator = np.trim_zeros(np.atleast_1d(np.asarray(denominator, dtype=float)), "f")
    if len(numerator) != 1 or len(denominator) != 3:
        raise FitError(
            f"{len(denominator) - 1} poles and {len(numerator) - 1} zeros: a mass with spring and damper has 2 and 0; "
            "reduce the model first"
        )
    m, b, K = (float(a / numerator[0]) for a in denominator)
    if not (m > 0.0 and b >= 0.0 and K > 0.0):
        raise FitError(
            f"m = {m:.6g}, b = {b:.6g}, K = {K:.6g}: must be positive; the model is not a mass-spring-damper"
        )
    return MassSpringDamper(m, b, K)


def _refuse_unstable(poles):
    unstable = [p for p in poles if p.real >= 0.0]
    if unstable:
        listed = ", ".join(f"{p:.4g}" for p in unstable)
        raise FitError(f"pole(s) {listed} rad/s are not in the left half plane: there is no settled step response")
