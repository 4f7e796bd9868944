# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""SciPy's Nelder-Mead search with scaling, restarts, several starts and recorded trajectories (B3).

Parameters of a model differ by orders of magnitude, so the simplex works on parameters divided by their scales. A
simplex may collapse before it reaches a minimum. Each search is therefore repeated from its best point with a new
simplex, until there is no further improvement.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.executors import Job, shared

#: Size of the first simplex, and spread of further starts, in units of the scales.
FIRST_STEP = 0.1
SPREAD = 0.5
#: Smallest relative reduction of the cost that counts as an improvement.
NO_BETTER = 1e-6
MOST_RESTARTS = 10
#: Assumed number of evaluations of the search from one start, for an estimate of its duration.
EVALUATIONS = 500
#: Cost of a perfect fit, relative to the cost of the guess; smaller costs are rounding errors.
PERFECT = 1e-18


@dataclass(frozen=True)
class SimplexSettings:
    """Budget and starts of the search."""

    #: Number of starts; all but the first are normally distributed around the guess, with a standard deviation of half
    #: a scale. None: the default of the problem, usually 1.
    starts: int | None = None
    iterations: int = 2000  #: Largest number of iterations of one start.
    tolerance: float = 1e-8  #: Size of the simplex, in scales, and relative spread of its costs, at which a run ends.
    seed: int = 0  #: Seed of the further starts.
    #: Number of processes that share the starts; several processes need a picklable cost. None: chosen automatically.
    workers: int | None = 1


@dataclass(frozen=True)
class SimplexRun:
    """Course of the search from one start."""

    #: shape (iterations + 1, n); Best vertex after each iteration, preceded by the start (figure 10 of paper B).
    trajectory: np.ndarray
    costs: np.ndarray  #: shape (iterations + 1,); Cost of this best vertex.
    evaluations: int  #: Calls of the cost function.
    converged: bool  #: Whether the simplex became smaller than the tolerance within the budget.

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.costs) - 1


@dataclass(frozen=True)
class SimplexSearch:
    """Result of :func:`restarted_nelder_mead`."""

    x: np.ndarray  #: shape (n,); Best point of all starts.
    cost: float  #: Cost at this point.
    runs: tuple[SimplexRun, ...]  #: One run for each start, in order.
    best: int  #: Index of the run that found ``x``.
    converged: bool  #: Whether the best run converged; if not, ``x`` is still the best point found.

    @property
    def agreeing(self) -> int:
        """Number of starts that end within 1 % of the lowest cost; one of several suggests local minima."""
        return sum(run.costs[-1] <= 1.01 * self.cost for run in self.runs)


def restarted_nelder_mead(
    cost,
    start,
    *,
    scale=None,
    settings: SimplexSettings | None = None,
    progress=None,
) -> SimplexSearch:
    """Minimise ``cost`` with Nelder-Mead simplices, restarted until there is no further improvement."""
    start = np.atleast_1d(np.asarray(start, dtype=float))
    scale = np.abs(start) if scale is None else np.broadcast_to(np.asarray(scale, dtype=float), start.shape)
    if not np.all(np.isfinite(start)) or not np.all(scale > 0.0):
        raise IdentificationError(f"initial guess {start.tolist()}: must be finite, and zeros need a scale above 0")
    settings = settings or SimplexSettings()
    starts = 1 if settings.starts is None else settings.starts
    if starts < 1 or settings.iterations < 1:
        raise IdentificationError(f"starts = {starts}, iterations = {settings.iterations}: must be at least 1")
    random = np.random.default_rng(settings.seed)
    guesses = [start] + [start + SPREAD * scale * random.standard_normal(start.size) for _ in range(starts - 1)]
    runs = _runs(_FiniteCost(cost, scale), [guess / scale for guess in guesses], settings, progress)
    best = int(np.argmin([run.costs[-1] for run in runs]))
    if not np.isfinite(runs[best].costs[-1]):
        raise IdentificationError("the cost is not finite at any start; change the initial guess")
    return SimplexSearch(
        x=runs[best].trajectory[-1].copy(),
        cost=float(runs[best].costs[-1]),
        runs=tuple(runs),
        best=best,
        converged=runs[best].converged,
    )


class _FiniteCost:
    """A cost of scaled parameters; NaN counts as infinite."""

    def __init__(self, cost, scale: np.ndarray):
        self.cost, self.scale = cost, scale

    def __call__(self, z) -> float:
        value = float(self.cost(z * self.scale))
        return value if np.isfinite(value) else np.inf


def _runs(cost: _FiniteCost, guesses: list[np.ndarray], settings: SimplexSettings, progress) -> list[SimplexRun]:
    """Return the runs from all starts."""
    if settings.workers == 1 or len(guesses) == 1:
        runs = []
        for number, guess in enumerate(guesses):
            note = None if progress is None else lambda i, value, number=number: progress(number, i, value)
            runs.append(_run(cost, guess, settings, note))
        return runs
    cost(guesses[0])  # the first call compiles the cost before the processes start
    begun = time.perf_counter()
    cost(guesses[0])
    seconds = (time.perf_counter() - begun) * EVALUATIONS * len(guesses)
    runs = shared([Job(_run, (cost, guess, settings)) for guess in guesses], seconds, settings.workers)
    for number, run in enumerate(runs if progress is not None else ()):
        progress(number, run.iterations, float(run.costs[-1]))
    return runs


def _run(cost: _FiniteCost, z, settings: SimplexSettings, note=None) -> SimplexRun:
    from scipy.optimize import minimize  # imported here because only fits need it

    iterations, tolerance = settings.iterations, settings.tolerance
    values = [cost(z)]
    points, evaluations, converged = [z], 1, False
    nothing = PERFECT * values[0] if np.isfinite(values[0]) else np.finfo(float).tiny
    for _ in range(MOST_RESTARTS + 1):
        before = values[-1]

        def record(intermediate_result):
            points.append(intermediate_result.x.copy())
            values.append(float(intermediate_result.fun))
            if note is not None:
                note(len(values) - 1, values[-1])

        simplex = np.concatenate([[points[-1]], points[-1] + FIRST_STEP * np.eye(z.size)])
        with np.errstate(invalid="ignore"):  # infinite costs may be subtracted from each other
            found = minimize(
                cost,
                points[-1],
                method="Nelder-Mead",
                callback=record,
                options={
                    "initial_simplex": simplex,
                    "maxiter": iterations - len(values) + 2,
                    "maxfev": 10 * iterations * (z.size + 1),
                    "xatol": tolerance,
                    # SciPy needs an absolute tolerance; rounding errors limit a perfect fit
                    "fatol": max(tolerance * before, nothing) if np.isfinite(before) else tolerance,
                },
            )
        evaluations += found.nfev
        if found.fun < values[-1]:
            points.append(found.x)
            values.append(float(found.fun))
        if not found.success or len(values) - 1 >= iterations:
            break
        if values[-1] <= nothing or not values[-1] < (1.0 - NO_BETTER) * before:
            converged = True
            break
    return SimplexRun(np.array(points) * cost.scale, np.array(values), evaluations, converged)
