"""Nelder-Mead simplex with several starts and recorded trajectories (B3).

Parameters of a model differ by orders of magnitude, so the simplex works on parameters divided by their scales. A
simplex may collapse before it has reached a minimum: each start is therefore repeated from its best point with a fresh
simplex until that brings nothing more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError

#: Size of the first simplex and spread of further starts, in scales.
FIRST_STEP = 0.1
SPREAD = 0.5
#: A restart counts as no better when it lowers the cost by less than this part.
NO_BETTER = 1e-6
MOST_RESTARTS = 10
#: A cost that has fallen to this part of the guess's is that of a perfect fit; below there are rounding errors only.
PERFECT = 1e-18


@dataclass(frozen=True)
class NelderMeadRun:
    """Path of one start.

    Parameters
    ----------
    trajectory : ndarray, shape (iterations + 1, n)
        Best vertex after each iteration, the start first (figure 10 of paper B).
    costs : ndarray, shape (iterations + 1,)
        Its cost.
    evaluations : int
        Calls of the cost function.
    converged : bool
        The simplex became smaller than the tolerance, not the budget.
    """

    trajectory: np.ndarray
    costs: np.ndarray
    evaluations: int
    converged: bool

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.costs) - 1


@dataclass(frozen=True)
class NelderMeadResult:
    """Result of :func:`nelder_mead`.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Best point of all starts.
    cost : float
        Its cost.
    runs : tuple of NelderMeadRun
        One for each start, in order.
    best : int
        Which run found ``x``.
    converged : bool
        That run converged. Without it ``x`` is still the best point found.
    """

    x: np.ndarray
    cost: float
    runs: tuple[NelderMeadRun, ...]
    best: int
    converged: bool

    @property
    def agreeing(self) -> int:
        """How many starts came within 1 % of the lowest cost: one of several hints at further local minima."""
        return sum(run.costs[-1] <= 1.01 * self.cost for run in self.runs)


def nelder_mead(
    cost,
    start,
    *,
    scale=None,
    starts: int = 1,
    iterations: int = 2000,
    tolerance: float = 1e-8,
    seed: int = 0,
    progress=None,
) -> NelderMeadResult:
    """Minimise ``cost`` with Nelder-Mead simplices.

    Parameters
    ----------
    cost : callable
        From parameters, shape (n,), to a float; not-a-number counts as infinite.
    start : array_like, shape (n,)
        Initial guess, the first start.
    scale : array_like, shape (n,), optional
        Scales of the parameters; by default the sizes of the initial guess.
    starts : int
        Starts in all; further ones are spread around the guess by half a scale (normally distributed).
    iterations : int
        Most iterations of one start.
    tolerance : float
        Size of the simplex, in scales, and relative spread of its costs at which a run ends.
    seed : int
        Of the further starts.
    progress : callable, optional
        Called as ``progress(run, iteration, best cost)`` after each iteration.

    Raises
    ------
    IdentificationError
        The guess is not finite or has a zero without a scale, or the cost is not finite at every start.
    """
    start = np.atleast_1d(np.asarray(start, dtype=float))
    scale = np.abs(start) if scale is None else np.broadcast_to(np.asarray(scale, dtype=float), start.shape)
    if not np.all(np.isfinite(start)) or not np.all(scale > 0.0):
        raise IdentificationError(f"initial guess {start.tolist()}: must be finite, and zeros need a scale above 0")
    if starts < 1 or iterations < 1:
        raise IdentificationError(f"starts = {starts}, iterations = {iterations}: must be at least 1")
    random = np.random.default_rng(seed)
    guesses = [start] + [start + SPREAD * scale * random.standard_normal(start.size) for _ in range(starts - 1)]

    def finite_cost(z):
        value = float(cost(z * scale))
        return value if np.isfinite(value) else np.inf

    runs = []
    for number, guess in enumerate(guesses):
        note = None if progress is None else lambda i, value, number=number: progress(number, i, value)
        runs.append(_run(finite_cost, guess / scale, iterations, tolerance, note, scale))
    best = int(np.argmin([run.costs[-1] for run in runs]))
    if not np.isfinite(runs[best].costs[-1]):
        raise IdentificationError("the cost is not finite at any start; change the initial guess")
    return NelderMeadResult(
        x=runs[best].trajectory[-1].copy(),
        cost=float(runs[best].costs[-1]),
        runs=tuple(runs),
        best=best,
        converged=runs[best].converged,
    )


def _run(cost, z, iterations, tolerance, note, scale) -> NelderMeadRun:
    from scipy.optimize import minimize  # imported here because only fits need it

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
        with np.errstate(invalid="ignore"):  # differences of infinite costs
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
                    # scipy wants an absolute bound; costs of a perfect fit end at rounding errors
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
    return NelderMeadRun(np.array(points) * scale, np.array(values), evaluations, converged)
