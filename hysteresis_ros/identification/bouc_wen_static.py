# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification of the static Bouc-Wen element by the Nelder-Mead simplex (paper B, section 3.2; B3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.block import compiled, run_kernel
from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.branches import checked_signals, require_both_directions, split_branches
from hysteresis_ros.identification.restarted_nelder_mead import (
    SimplexSearch,
    SimplexSettings,
    restarted_nelder_mead,
)
from hysteresis_ros.models.hysteresis.bouc_wen import STATES, BoucWenParameters, bouc_wen

NAMES = ("d_e", "alpha", "beta", "gamma")
#: The paper's initial guess (table II), SI units.
PUBLISHED_GUESS = BoucWenParameters(d_e=0.127e-6, alpha=7.20e-2 * 1e-6, beta=1.76e-2, gamma=1.66e-2)
#: Step of the differences behind the covariance, in parts of a parameter.
DIFFERENCE = 1e-5


@dataclass(frozen=True)
class BoucWenIdentification:
    """Result of :func:`identify_bouc_wen_static`.

    Parameters
    ----------
    parameters : BoucWenParameters
        The model: the best point found, converged or not.
    offset : float
        Constant part of the displacement [m], 0 unless it was free.
    covariance : ndarray, shape (4, 4)
        Of d_e, α, β and γ, for white residuals.
    rms, maximum : float
        Residual [m].
    search : SimplexSearch
        Trajectories of the parameters, one run for each start.
    converged : bool
        The simplex converged.
    warnings : tuple of str
        What to doubt.
    """

    parameters: BoucWenParameters
    offset: float
    covariance: np.ndarray
    rms: float
    maximum: float
    search: SimplexSearch
    converged: bool
    warnings: tuple[str, ...]

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors of the four parameters."""
        return dict(zip(NAMES, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def default_guess(voltage, displacement, exponent: float = 1.0) -> BoucWenParameters:
    """Return a guess from the ranges alone: α a quarter of d_e, memory fading over half the voltage range."""
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

    Parameters
    ----------
    voltage : array_like, shape (N,)
        Voltage [V].
    displacement : array_like, shape (N,)
        Displacement [m].
    history : array_like, shape (K,)
        Voltages [V] the actuator went through before, from rest at 0 V; empty: it is at rest before the first sample.
    guess : BoucWenParameters, optional
        First start, :data:`PUBLISHED_GUESS` for instance; without it one is made from the ranges. Its exponent is
        used.
    exponent : float
        n when there is no guess; it is not fitted.
    free_offset : bool
        Remove the constant that fits best (a sensor has no zero).
    settings : SimplexSettings, optional
        Without a number of starts: 1 with a guess, 4 without.
    progress : callable, optional
        See :func:`~hysteresis_ros.identification.restarted_nelder_mead.restarted_nelder_mead`.

    Raises
    ------
    IdentificationError
        Too short, constant, not finite, or a single branch, from which α and β, γ do not follow.
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
    guess = guess or default_guess(voltage, displacement, exponent)
    problem = _Normalised(history, voltage, displacement, exponent=guess.exponent, free_offset=free_offset)
    units = problem.units
    start = np.array([getattr(guess, name) for name in NAMES]) / units
    scale = np.where(start != 0.0, np.abs(start), 1.0)
    search = restarted_nelder_mead(problem.cost, start, scale=scale, settings=settings, progress=progress)
    error = problem.residual(search.x).copy()
    offset = problem.offset * problem.x_unit
    covariance = _covariance(problem.residual, search.x, error, free_offset) * np.outer(units, units)
    parameters = replace(guess, **dict(zip(NAMES, (search.x * units).tolist(), strict=True)))
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
    """A recording in parts of its ranges, h in that of the displacement, and the element's error on it."""

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
        """Return the simulated less the measured displacement, shape (N,)."""
        self.p[:4], self.state[:] = theta, 0.0
        compiled(run_kernel)(bouc_wen, self.p, self.state, self.v, self.y)
        error = self.y[self.first :] - self.x
        return error - error.mean() if self.free_offset else error

    @property
    def offset(self) -> float:
        """The constant of the measurement that the last simulation left, 0 when it is not free."""
        return -(float(np.mean(self.y[self.first :] - self.x)) if self.free_offset else 0.0)

    def cost(self, theta) -> float:
        """Return the mean square error."""
        with np.errstate(over="ignore", invalid="ignore"):
            error = self.residual(theta)
            return float(np.dot(error, error)) / self.x.size


def _doubts(parameters: BoucWenParameters, search: SimplexSearch, deviations) -> tuple[str, ...]:
    """Return what to doubt: outside the valid class, a search that was cut off, numbers without support."""
    warnings = [problem.allowed for problem in parameters.problems()]
    warnings += parameters.warnings()
    if not search.converged:
        warnings.append(f"not converged after {search.runs[search.best].iterations} iterations: the best point so far")
    for name, deviation in zip(NAMES, deviations.tolist(), strict=True):
        value = getattr(parameters, name)
        if not deviation < 0.5 * abs(value):
            warnings.append(f"{name} = {value:.4g} ± {deviation:.2g} is hardly determined by this recording")
    return tuple(warnings)


def _covariance(residual, theta, error, free_offset) -> np.ndarray:
    """Return the Gauss-Newton covariance in normalised units; infinite where nothing is determined."""
    columns = []
    for i in range(theta.size):
        step = np.zeros(theta.size)
        step[i] = DIFFERENCE * max(abs(theta[i]), 1e-6)
        ahead = residual(theta + step).copy()
        columns.append((ahead - residual(theta - step)) / (2.0 * step[i]))
    jacobian = np.stack(columns, axis=1)
    variance = float(error @ error) / max(error.size - theta.size - int(free_offset), 1)
    try:
        return variance * np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return np.full((theta.size, theta.size), np.inf)


def _in_units(search: SimplexSearch, units) -> SimplexSearch:
    """Return the search with trajectories in SI units; costs stay normalised by the range of the displacement."""
    runs = tuple(replace(run, trajectory=run.trajectory * units) for run in search.runs)
    return replace(search, x=search.x * units, runs=runs)
