# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bouc-Wen models from data: the static element by Nelder-Mead, the oscillator by output error.

The static element follows paper B, section 3.2 (B3).

The oscillator of :mod:`hysteresis_ros.models.hysteresis.bouc_wen_mechanical` is simulated by the kernel of the nodes,
on a grid finer than the samples. Trust-region steps, with sensitivities by finite differences, reduce the output error.
The equations contain β, γ and δ only as the products βγ and βδ, so β keeps its initial value. The output error has
local minima if the initial resonance is far from the true one. Trial points around the initial values are therefore
evaluated on a short part of the data first, and only the best of them are refined.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import checked_signals
from hysteresis_ros.identification.linear_systems import METHODS, find_period, upsample
from hysteresis_ros.identification.preprocessing import require_both_directions, split_branches
from hysteresis_ros.identification.restarted_nelder_mead import (
    SimplexSearch,
    SimplexSettings,
    restarted_nelder_mead,
)
from hysteresis_ros.identification.validation import covariance_or_infinite
from hysteresis_ros.models.block import compiled, run_kernel
from hysteresis_ros.models.hysteresis.bouc_wen import STATES, BoucWenParameters, bouc_wen
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import (
    ALPHA,
    BETA_DELTA,
    BETA_GAMMA,
    DAMPING,
    INVERSE_MASS,
    STIFFNESS,
    BoucWenMechanicalParameters,
    BoucWenOscillator,
    bouc_wen_mechanical,
)
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import (
    STATES as bouc_wen_mechanical_STATES,
)

STATIC_FREE = ("d_e", "alpha", "beta", "gamma")
#: The paper's initial guess (table II), SI units.
PUBLISHED_GUESS = BoucWenParameters(d_e=0.127e-6, alpha=7.20e-2 * 1e-6, beta=1.76e-2, gamma=1.66e-2)
#: Relative step of the finite differences for the covariance.
DIFFERENCE = 1e-5


@dataclass(frozen=True)
class BoucWenIdentification:
    """Result of :func:`identify_bouc_wen_static`."""

    parameters: BoucWenParameters  #: Best point found, even if the search did not converge.
    offset: float  #: Constant part of the displacement [m]; 0 unless it was fitted.
    covariance: np.ndarray  #: shape (4, 4); Covariance of d_e, α, β and γ, for white residuals.
    rms: float  #: rms, maximum: Residual [m].
    maximum: float
    search: SimplexSearch  #: Trajectories of the parameters, one for each start.
    converged: bool  #: Whether the simplex converged.
    warnings: tuple[str, ...]  #: Warnings about uncertain results, as sentences.

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors of the four parameters."""
        return dict(zip(STATIC_FREE, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def static_guess(voltage, displacement, exponent: float = 1.0) -> BoucWenParameters:
    """Return a guess from the signal ranges: α ≈ d_e/4, and a memory that decays over half the voltage range."""
    slope = abs(float(np.ptp(displacement) / np.ptp(voltage)))
    d_e, alpha = 1.25 * slope, 0.3 * slope
    rate = 2.0 / float(np.ptp(voltage))
    if exponent != 1.0:  # the same saturation α/(β + γ) for every exponent
        rate = alpha / (alpha / rate) ** exponent
    return BoucWenParameters(d_e=d_e, alpha=alpha, beta=0.6 * rate, gamma=0.4 * rate, exponent=exponent)


def identify_bouc_wen_static(
    voltage,
    displacement,
    *,
    history=(),
    guess: BoucWenParameters | None = None,
    exponent: float = 1.0,
    free_offset: bool = False,
    settings: SimplexSettings | None = None,
    progress=None,
) -> BoucWenIdentification:
    """Fit d_e, α, β and γ of ``x = d_e V - h`` to slow loops by Nelder-Mead.

    Units: ``voltage`` [V], ``displacement`` [m].
    """
    voltage, displacement = checked_signals(voltage, displacement)
    require_both_directions(split_branches(voltage), "Bouc-Wen fit")
    correlated = float(np.dot(voltage - voltage.mean(), displacement - displacement.mean()))
    if correlated <= 0.0:
        raise IdentificationError(
            "the displacement falls with rising voltage; change the sign of one column (d_e must be above 0)"
        )
    settings = settings or SimplexSettings()
    settings = replace(settings, starts=settings.starts or (1 if guess is not None else 4), workers=None)
    guess = guess or static_guess(voltage, displacement, exponent)
    problem = _Normalised(history, voltage, displacement, exponent=guess.exponent, free_offset=free_offset)
    units = problem.units
    start = np.array([getattr(guess, name) for name in STATIC_FREE]) / units
    scale = np.where(start != 0.0, np.abs(start), 1.0)
    search = restarted_nelder_mead(problem.cost, start, scale=scale, settings=settings, progress=progress)
    error = problem.residual(search.x).copy()
    offset = problem.offset * problem.x_unit
    covariance = _covariance(problem.residual, search.x, error, free_offset) * np.outer(units, units)
    parameters = replace(guess, **dict(zip(STATIC_FREE, (search.x * units).tolist(), strict=True)))
    return BoucWenIdentification(
        parameters=parameters,
        offset=offset,
        covariance=covariance,
        rms=problem.x_unit * float(np.sqrt(np.mean(error**2))),
        maximum=problem.x_unit * float(np.max(np.abs(error))),
        search=_in_units(search, units),
        converged=search.converged,
        warnings=_doubts(parameters, search, np.sqrt(np.diag(covariance))),
    )


class _Normalised:
    """A recording scaled by the ranges of its signals (h like the displacement), and the error of the model."""

    def __init__(self, history, voltage, displacement, *, exponent: float, free_offset: bool):
        n, self.free_offset, self.first = exponent, free_offset, len(history)
        x_unit, v_unit = float(np.ptp(displacement)), float(np.ptp(voltage))
        self.x_unit = x_unit
        # β and γ have the unit m^(1-n)/V
        bend = x_unit ** (1.0 - n) / v_unit
        self.units = np.array([x_unit / v_unit, x_unit / v_unit, bend, bend])
        self.v, self.x = np.concatenate([history, voltage]) / v_unit, displacement / x_unit
        self.y, self.state, self.p = np.empty_like(self.v), np.zeros(STATES), np.empty(5)
        self.p[4] = n

    def residual(self, theta):
        """Return the simulated minus the measured displacement, shape (N,)."""
        self.p[:4], self.state[:] = theta, 0.0
        compiled(run_kernel)(bouc_wen, self.p, self.state, self.v, self.y)
        error = self.y[self.first :] - self.x
        return error - error.mean() if self.free_offset else error

    @property
    def offset(self) -> float:
        """Constant that was removed from the last residual; 0 if the offset is not free."""
        return -(float(np.mean(self.y[self.first :] - self.x)) if self.free_offset else 0.0)

    def cost(self, theta) -> float:
        """Return the mean square error."""
        with np.errstate(over="ignore", invalid="ignore"):
            error = self.residual(theta)
            return float(np.dot(error, error)) / self.x.size


def _doubts(parameters: BoucWenParameters, search: SimplexSearch, deviations) -> tuple[str, ...]:
    """Return warnings about parameters outside the valid class, a failed search, and poorly determined parameters."""
    warnings = [problem.remedy for problem in parameters.problems()]
    warnings += parameters.warnings()
    if not search.converged:
        warnings.append(
            f"the search has not converged after {search.runs[search.best].iterations} iterations: "
            "this is the best point so far"
        )
    for name, deviation in zip(STATIC_FREE, deviations.tolist(), strict=True):
        value = getattr(parameters, name)
        if not deviation < 0.5 * abs(value):
            warnings.append(f"{name} = {value:.4g} ± {deviation:.2g} is poorly determined by this recording")
    return tuple(warnings)


def _covariance(residual, theta, error, free_offset) -> np.ndarray:
    """Return the Gauss-Newton covariance in normalised units; all infinite if a parameter is not determined."""
    columns = []
    for i in range(theta.size):
        step = np.zeros(theta.size)
        step[i] = DIFFERENCE * max(abs(theta[i]), 1e-6)
        ahead = residual(theta + step).copy()
        columns.append((ahead - residual(theta - step)) / (2.0 * step[i]))
    jacobian = np.stack(columns, axis=1)
    return covariance_or_infinite(jacobian, error, int(free_offset))


def _in_units(search: SimplexSearch, units) -> SimplexSearch:
    """Return the search with trajectories in SI units; the costs remain relative to the stroke."""
    runs = tuple(replace(run, trajectory=run.trajectory * units) for run in search.runs)
    return replace(search, x=search.x * units, runs=runs)


#: Names of the fitted parameters, in the order of the vectors.
OSCILLATOR_FREE = ("mass", "damping", "stiffness", "alpha", "beta_gamma", "beta_delta")
KERNEL_PLACES = (DAMPING, STIFFNESS, ALPHA, BETA_GAMMA, BETA_DELTA)  # parameters in the kernel, except the mass
#: Number of grid points per sample, during the search and for the result. Between the samples the input is linear, and
#: the kernel takes one Runge-Kutta step per grid point.
SEARCH_GRID = 4
FINE_GRID = 16
#: Number of trial points around the initial values, their spread (factors of 2^±SPREAD), and largest number of trial
#: points that are refined.
TRIALS = 64
SPREAD = 1.0
FOLLOWED = 12
#: Number of samples on which trial points are evaluated and refined; the best point is then refined on all samples.
SHORT_PART = 6000
#: Output errors are limited to this multiple of the stroke, because a diverging oscillation has no useful gradient.
LARGEST_ERROR = 10.0
#: Number of periods after which a simulation with periodic input counts as settled.
SETTLING = 1
#: Two starts agree if both residuals are at most this factor times the smallest residual. The search ends if two starts
#: agree and the smallest residual is below the fraction WELL_DONE of the stroke.
AGREEING = 1.01
MOST_EVALUATIONS = 60
WELL_DONE = 0.05


@dataclass(frozen=True, eq=False)
class BoucWenMechanicalFit:
    """Result of :func:`fit_bouc_wen_mechanical`."""

    parameters: BoucWenMechanicalParameters  #: β is the initial value; γ and δ are calculated from the products.
    rmse: float  #: RMS output error [m].
    #: Standard deviations from the Jacobian and the residual, by the names in :data:`OSCILLATOR_FREE`.
    deviations: dict[str, float]
    covariance: np.ndarray  #: shape (6, 6); Covariance of the parameters :data:`OSCILLATOR_FREE`, in SI units.
    agreeing: int  #: agreeing, starts: Number of refined starts that agree, and of all refined starts.
    starts: int
    intersample: str  #: intersample, initial: Assumed input between samples, and assumed initial state.
    initial: str
    warnings: tuple[str, ...] = field(default=())
    converged: bool = True

    def simulate(self, u, sample_time: float, initial: str | None = None) -> np.ndarray:
        """Return the displacement [m], shape (N,), at the samples of ``u``, see :func:`simulate_oscillator`."""
        return simulate_oscillator(self.parameters, u, sample_time, self.intersample, initial or self.initial)


def simulate_oscillator(
    parameters: BoucWenMechanicalParameters,
    u,
    sample_time: float,
    intersample: str = "bandlimited",
    initial: str = "zero",
    grid: int = FINE_GRID,
) -> np.ndarray:
    """Return the displacement of the oscillator at the samples of its input.

    Units: ``sample_time`` [s].
    """
    settings = replace(parameters, intersample="zoh" if intersample == "zoh" else "linear", substeps=1)
    block = BoucWenOscillator(settings, sample_time / grid)
    periodic = initial == "periodic"
    return _run(block.p, _finer(u, grid, intersample, periodic), grid, intersample, periodic)


def _finer(u, grid, intersample, periodic):
    return upsample(u, grid, intersample, periodic or intersample == "bandlimited" and find_period(u) is not None)


def _run(p, finer, grid, intersample, periodic):
    state, output = np.zeros(bouc_wen_mechanical_STATES), np.empty_like(finer)
    run = compiled(run_kernel)
    if periodic:
        for _ in range(SETTLING):
            run(bouc_wen_mechanical, p, state, finer, output)
    if intersample != "zoh":
        run(bouc_wen_mechanical, p, state, finer, output)
        return output[::grid]
    start = state[1]
    run(bouc_wen_mechanical, p, state, finer, output)  # with a held input, the output at the end of each step is used
    return np.append(start, output[grid - 1 :: grid][:-1])


def fit_bouc_wen_mechanical(
    u,
    y,
    sample_time: float,
    start: BoucWenMechanicalParameters,
    *,
    intersample: str = "bandlimited",
    initial: str = "zero",
    skip: int = 0,
    trials: int = TRIALS,
    seed: int = 0,
    progress=None,
) -> BoucWenMechanicalFit:
    """Fit mass, damping, stiffness and the hysteretic force to input and output.

    Units: ``u`` [m], ``y`` [m], ``sample_time`` [s].
    """
    u, y = checked_signals(u, y, ("input", "output"), fewest=100)
    _check_oscillator(start, intersample, initial)
    if not 0 <= skip < u.size - 100:
        raise IdentificationError(f"skip = {skip}: must leave at least 100 of the {u.size} samples")
    problem = _OscillatorProblem(u, y, sample_time, start, intersample=intersample, initial=initial, skip=skip)
    guesses = problem.guesses(trials, seed)
    results = []
    agreeing = 0
    for number, guess in enumerate(guesses):
        results.append(problem.descend(guess, SEARCH_GRID, SHORT_PART))
        best = min(results, key=lambda result: result.cost)
        agreeing = sum(result.cost <= AGREEING**2 * best.cost for result in results)
        if progress is not None:
            progress(number, problem.rms(best))
        if agreeing > 1 and problem.rms(best) < WELL_DONE * problem.stroke:
            break
    coarse = problem.descend(best.x, SEARCH_GRID)
    return problem.result(problem.descend(coarse.x, FINE_GRID), agreeing, len(results))


def _check_oscillator(start, intersample, initial):
    if initial == "estimate":
        raise IdentificationError(
            "initial = 'estimate': the state of an oscillator is not fitted because it decays within a few cycles; "
            "omit these with --skip, or use zero or periodic"
        )
    if intersample not in METHODS or initial not in ("zero", "periodic"):
        raise IdentificationError(
            f"intersample = {intersample!r}, initial = {initial!r}: intersample must be one of {', '.join(METHODS)}; "
            "initial must be zero or periodic"
        )
    if start.beta == 0.0 or start.alpha == 0.0:
        raise IdentificationError("alpha and beta of the initial values must not be 0: they set the scale of z")


class _OscillatorProblem:
    """Output error as a function of the parameters, which are scaled by their initial values."""

    def __init__(self, u, y, sample_time, start, *, intersample, initial, skip):
        self.skip = skip
        self.u, self.y, self.sample_time, self.start = u, y, sample_time, start
        self.intersample, self.initial = intersample, initial
        products = [start.beta * (value or 0.1) for value in (start.gamma, start.delta)]
        self.scale = np.array([start.mass, start.damping or 1e-3, start.stiffness, start.alpha, *products])
        self.scale[1] = start.damping or 0.02 * np.sqrt(start.mass * (start.stiffness + start.alpha))
        self.stroke = float(np.ptp(y))
        settings = replace(start, intersample="zoh" if intersample == "zoh" else "linear", substeps=1)
        self.packed = {grid: BoucWenOscillator(settings, sample_time / grid).p for grid in (SEARCH_GRID, FINE_GRID)}
        self.finer = {grid: _finer(u, grid, intersample, initial == "periodic") for grid in (SEARCH_GRID, FINE_GRID)}

    def residual(self, z, grid, samples=None):
        """Return the output error minus its mean, divided by the stroke."""
        n = len(self.y) if samples is None else min(samples + self.skip, len(self.y))
        parameters = z * self.scale
        bad = np.full(n - self.skip, LARGEST_ERROR)
        if np.any(parameters[[0, 2]] <= 0.0) or np.any(parameters[[1, 3]] < 0.0):
            return bad
        packed = self.packed[grid].copy()
        packed[INVERSE_MASS] = 1.0 / parameters[0]
        packed[list(KERNEL_PLACES)] = parameters[1:]
        with np.errstate(all="ignore"):
            output = _run(packed, self.finer[grid][: n * grid], grid, self.intersample, self.initial == "periodic")
        if not np.all(np.isfinite(output)):
            return bad
        error = (output - self.y[:n])[self.skip :] / self.stroke
        return np.clip(error - error.mean(), -LARGEST_ERROR, LARGEST_ERROR)

    def guesses(self, trials, seed):
        """Return the initial values, and the best of the trial points around them."""
        random = np.random.default_rng(seed)
        points = 2.0 ** (SPREAD * random.uniform(-1.0, 1.0, (trials, len(OSCILLATOR_FREE))))
        costs = [np.mean(self.residual(point, SEARCH_GRID, SHORT_PART) ** 2) for point in points]
        return [np.ones(len(OSCILLATOR_FREE)), *points[np.argsort(costs)[: FOLLOWED - 1]]]

    def descend(self, guess, grid, samples=None):
        from scipy.optimize import least_squares  # imported here because only fits need it

        return least_squares(
            lambda z: self.residual(z, grid, samples),
            guess,
            x_scale=np.abs(guess),
            diff_step=1e-5,
            xtol=1e-9,
            max_nfev=MOST_EVALUATIONS,
        )

    def rms(self, result) -> float:
        return float(np.sqrt(2.0 * result.cost / len(result.fun))) * self.stroke

    def result(self, found, agreeing, starts) -> BoucWenMechanicalFit:
        values = dict(zip(OSCILLATOR_FREE, (found.x * self.scale).tolist(), strict=True))
        rmse = self.rms(found)
        if not rmse < self.stroke:
            raise IdentificationError(
                f"no initial values lead to a fit: the RMS error is {rmse:.3g} m for a stroke of {self.stroke:.3g} m; "
                "give better initial values"
            )
        beta = self.start.beta
        parameters = replace(
            self.start,
            **{name: values[name] for name in OSCILLATOR_FREE[:4]},
            gamma=values["beta_gamma"] / beta,
            delta=values["beta_delta"] / beta,
            intersample=self.intersample if self.intersample != "bandlimited" else "linear",
        )
        covariance = covariance_or_infinite(found.jac, found.fun) * np.outer(self.scale, self.scale)
        deviations = dict(zip(OSCILLATOR_FREE, np.sqrt(np.diag(covariance)).tolist(), strict=True))
        warnings = list(parameters.warnings())
        if agreeing < 2 <= starts:
            warnings.append(f"only {agreeing} of {starts} starts reached this residual: there may be a better one")
        warnings += [
            f"{name} = {values[name]:.4g} ± {deviations[name]:.2g}: the data does not determine it"
            for name in OSCILLATOR_FREE
            if not deviations[name] < 0.5 * abs(values[name])
        ]
        return BoucWenMechanicalFit(
            parameters=parameters,
            rmse=rmse,
            deviations=deviations,
            covariance=covariance,
            agreeing=agreeing,
            starts=starts,
            intersample=self.intersample,
            initial=self.initial,
            warnings=tuple(warnings),
            converged=found.status > 0,
        )
