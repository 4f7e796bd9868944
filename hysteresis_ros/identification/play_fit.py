# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fits of models whose output is linear in the weights of plays: one search and one solver for many models.

A model defines the columns of its plays for a given shape (:meth:`PlayFit.columns`), the shape parameters to search
(:attr:`PlayFit.extra`), and the parameters of the block for given weights (:meth:`PlayFit.parameters`). The parameters
of the linear part and of the shape are searched; for each trial, linear least squares gives the weights ≥ 0 and the
constants.

A recording of one large loop determines every weight of a classical Prandtl-Ishlinskii model, but noise and small model
errors make neighbouring weights alternate, which causes errors in minor loops. The roughness of the weights (second
difference over the radius) is therefore penalised as strongly as the residual permits.

References
----------
.. [1] Golub & Pereyra, SIAM Journal on Numerical Analysis 10, 413-432, 1973, doi 10.1137/0710036.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros.identification.hammerstein import PartSearch, PartTrial, search_linear_part, split_values
from hysteresis_ros.identification.linear_systems import SMALLEST_RATE, LinearPart
from hysteresis_ros.identification.preprocessing import Condensed
from hysteresis_ros.identification.thresholds import SMOOTHER_WEIGHTS
from hysteresis_ros.models.hysteresis import HysteresisParameters

#: Weight of the smoothness penalty during the search of the linear part and the shape.
SEARCH_STRENGTH = 1e-2

#: Numbers added to the diagonal of the normal equations (columns of unit length); the first that suffices is used.
GRAM_FLOORS = (1e-13, 1e-12, 1e-11, 1e-10)
#: Tried weights of the smoothness penalty, from almost no effect to almost linear weights.
STRENGTHS = 10.0 ** np.arange(-4.0, 1.6, 0.5)


class Crept(NamedTuple):
    """Response of columns to creep."""

    case: tuple[float, bool]  #: Longest time of the creep [s], and whether it had settled at the first sample.
    still: np.ndarray | None = None  #: shape (N, m); Response without creep; None until needed a second time.
    growth: np.ndarray | None = None  #: shape (N, m); Additional response for a creep rate of 1.


class PlayFit(ABC):
    """A model of plays, fitted to one set of data."""

    #: Searched parameters of the shape: name, initial value, lower and upper limit.
    extra: tuple[tuple[str, float, float, float], ...] = ()
    #: Matrix of differences of neighbouring weights; these differences are penalised.
    roughness: np.ndarray

    def __init__(self, data: Condensed):
        self.data = data
        self.numbers: dict[str, float] = {}
        #: Initial values of a search, by name.
        self.guess: dict[str, float] = {}
        #: Shape and columns of the last trial, and their response to creep.
        self.kept_columns: tuple[dict[str, float], np.ndarray] | None = None
        self.crept: Crept | None = None
        #: Linear part, shape and filtered columns of the finished fit; set only while held-out samples are predicted.
        self.reply: tuple[LinearPart, dict[str, float], np.ndarray] | None = None
        #: Least-squares solver of the last trial of a search.
        self.solver: WeightSolver | None = None
        self.residual = np.zeros(0)

    @abstractmethod
    def columns(self, shape: dict[str, float]) -> np.ndarray:
        """Return the regressors for a shape, shape (N, m), in the order of the weights; they are zero at rest."""

    @abstractmethod
    def parameters(self) -> HysteresisParameters:
        """Return the fit as parameters of the block."""

    def search(self, progress) -> PartSearch:
        """Return the search for the linear part and the shape."""
        return PartSearch(self.solve, self.data, self.extra, progress, self.slopes)

    def solve(self, part, shape) -> np.ndarray:
        """Return the residual [m] with the best weights for one trial of the search."""
        data = self.data
        self.solver = WeightSolver(
            data.counted(self.moved(part, shape)),
            data.counted(data.constants),
            data.counted(data.displacement),
            self.roughness,
        )
        self.weights, self.constants, self.residual = self.solver.solve(SEARCH_STRENGTH)
        self.strength = SEARCH_STRENGTH
        return self.residual

    def slopes(self, part, shape, neighbours) -> np.ndarray:
        """Return the changes of the residual of :meth:`solve`, from the last trial to k neighbours, shape (N, k).

        Each neighbour is a pair (linear part, shape parameters).

        The weights are solved again for each neighbour (variable projection [1]_). For a change dΦ of the filtered
        columns Φ this requires only dΦ w and dΦᵀ e, with the weights w and the residual e. Filtering a single signal
        gives each of them: the weighted sum of the columns for dΦ w, the residual, backwards in time, for dΦᵀ e.
        """
        if self.solver is None:
            raise RuntimeError("there is no solved trial")
        data, step = self.data, self.data.sample_time
        error = np.zeros(len(data.voltage))
        error[data.first :][data.kept] = self.residual
        columns = self.columns(shape) if self.kept_columns is None else self.kept_columns[1]
        here = columns @ self.weights
        shaped = [k for k, (other, _) in enumerate(neighbours) if other == part]
        changed = [self.columns(neighbours[k][1]) - columns for k in shaped]
        replies = part.apply(np.column_stack([here, *(change @ self.weights for change in changed)]), step)
        back = _backwards(part, error, step)
        moved, leaning = np.empty((len(here), len(neighbours))), np.empty((columns.shape[1], len(neighbours)))
        for place, k in enumerate(shaped):
            moved[:, k], leaning[:, k] = replies[:, 1 + place], _leaning(part, changed[place], error, back)
        before = _leaning(part, columns, error, back)
        for k, (other, _) in enumerate(neighbours):
            if k not in shaped:
                moved[:, k] = other.apply(here, step) - replies[:, 0]
                leaning[:, k] = _leaning(other, columns, error, _backwards(other, error, step)) - before
        return self.solver.followed(data.counted(moved), leaning, self.weights, SEARCH_STRENGTH)

    def summed(self, shape) -> np.ndarray:
        """Return the sum of the columns for a shape, multiplied by the present weights, shape (N,)."""
        kept = self.kept_columns
        return (kept[1] if kept is not None and kept[0] == shape else self.columns(shape)) @ self.weights

    def solve_weights(self, part, shape, strength: float | None = None) -> np.ndarray:
        """Solve for the weights and return the residual [m].

        ``strength`` is the weight of the smoothness penalty; None: as large as the residual allows.
        """
        data = self.data
        known = self.reply is not None and self.reply[:2] == (part, shape)
        moved = data.counted(self.reply[2] if known and self.reply else self.moved(part, shape))
        target = data.counted(data.displacement)
        self.weights, self.constants, residual, self.strength = smooth_weights(
            moved, data.counted(data.constants), target, self.roughness, strength
        )
        return residual

    def moved(self, part, shape) -> np.ndarray:
        """Return the columns filtered by the linear part, shape (N, m).

        Creep takes most of the time, and its response is linear in the creep rate. If the same shape is used again, for
        example in a search of the linear part alone, the response for a rate of 1 is cached until the shape changes.
        """
        step = self.data.sample_time
        if self.kept_columns is None or self.kept_columns[0] != shape:
            self.kept_columns, self.crept = (shape, self.columns(shape)), None
        columns = self.kept_columns[1]
        if part.creep_rate < SMALLEST_RATE:
            return part.apply(columns, step)
        case = part.longest_time, part.settled
        if self.crept is None or self.crept.case != case:
            self.crept = Crept(case)
            return part.apply(columns, step)
        if self.crept.growth is None:
            still, full = (replace(part, creep_rate=rate).crept(columns, step) for rate in (0.0, 1.0))
            self.crept = Crept(case, still, full - still)
        return part.behind_creep(self.crept.still + part.creep_rate * self.crept.growth, columns, step)

    def fit(self, linear, progress):
        """Search the linear part and the shape, then compute the weights."""
        search = self.search(progress)
        self.kept, self.base, found = search_linear_part(search, linear, self.guess)
        return self._finish(search, found)

    def settle(self, before, progress):
        """Search the shape, and the parameters of a linear part with known structure."""
        self.kept, self.base = before.kept, before.base
        search = self.search(progress)
        return self._finish(search, search.run(self.kept, before.found.values, self.base))

    def behind(self, part):
        """Compute only the weights, for the initial shape and a known linear part."""
        self.part, self.shape = part, {name: start for name, start, *_ in self.extra}
        self.rms = float(np.std(self.solve_weights(self.part, self.shape)))
        return self

    def _finish(self, search: PartSearch, found: PartTrial):
        self.found, self.solver, self.residual = found, None, np.zeros(0)
        self.part, self.shape = split_values(self.base, found.values)
        self.deviations, self.converged = found.deviations or {}, found.converged
        self.warnings = tuple(search.at_ends(self.kept, found.values))
        self.rms = float(np.std(self.solve_weights(self.part, self.shape)))
        return self

    def refitted(self, data: Condensed):
        """Return the model with the same shape and linear part, with weights fitted to other recorded samples."""
        if self.reply is None:
            self.reply = self.part, self.shape, self.moved(self.part, self.shape)
        other = copy(self)
        other.data = data
        other.solve_weights(self.part, self.shape, self.strength)
        return other

    def output(self) -> np.ndarray:
        """Return the modelled displacement [m], shape (N,)."""
        if self.reply is not None and self.reply[:2] == (self.part, self.shape):
            moved = self.reply[2] @ self.weights
        else:
            moved = self.part.apply(self.summed(self.shape), self.data.sample_time)
        return moved + self.data.constants @ self.constants


def _backwards(part, error, sample_time: float) -> np.ndarray:
    """Return an error, shape (N,), filtered by the linear part backwards in time.

    Units: ``sample_time`` [s].
    """
    return replace(part, settled=False).apply(error[::-1], sample_time)[::-1]


def _leaning(part, columns, error, back) -> np.ndarray:
    """Return the products of the filtered columns with an error, shape (m,); ``back``: the error filtered backwards."""
    found = columns.T @ back
    return found + columns[0] * (part.settled_gain * error.sum() - back.sum()) if part.settled else found


def differences(part, shape, neighbours, summed, sample_time: float) -> np.ndarray:
    """Return the changes of the output of ``part``, shape (N, k), from this point to k neighbours.

    ``summed(shape)`` is the input of ``part``, shape (N,); each neighbour differs in the linear part or in the shape.
    Units: ``sample_time`` [s].
    """
    here = summed(shape)
    shaped = [k for k, (other, _) in enumerate(neighbours) if other == part]
    columns = np.column_stack([here, *(summed(neighbours[k][1]) for k in shaped)])
    replies = part.apply(columns, sample_time)
    found = np.empty((len(here), len(neighbours)))
    for k, (other, _) in enumerate(neighbours):
        found[:, k] = replies[:, 1 + shaped.index(k)] if k in shaped else other.apply(here, sample_time)
    return found - replies[:, :1]


def radii(voltage_range: float, count: int, reach: float = 0.0) -> np.ndarray:
    """Return ``count`` radii [V] from 0, in steps of half the range divided by ``count``.

    A play with a radius of half the range or more never moves; it is omitted, unless the path from rest moves it.
    """
    step = 0.5 * voltage_range / count
    return step * np.arange(max(count, int(np.ceil(reach / step - 1e-9))))


def smooth_weights(regressors, free, target, roughness, strength: float | None = None, ridge=None):
    """Return weights ≥ 0 of ``regressors``, as smooth as the residual allows, and signed coefficients of ``free``."""
    solver = WeightSolver(regressors, free, target, roughness, ridge)
    if strength is not None:
        return *solver.solve(strength), strength
    trials = [(strength, *solver.solve(strength)) for strength in STRENGTHS]
    smallest = min(np.std(residual) for *_, residual in trials)
    strength, weights, coefficients, residual = [
        trial for trial in trials if np.std(trial[-1]) <= (1.0 + SMOOTHER_WEIGHTS) * smallest
    ][-1]
    return weights, coefficients, residual, strength


def cholesky_factor(gram) -> np.ndarray:
    """Return the Cholesky factor of a Gram matrix of columns of unit length; columns may be equal.

    The number added to the diagonal is the smallest that suffices against rounding errors, far below any noise.
    """
    for floor in GRAM_FLOORS[:-1]:
        with contextlib.suppress(np.linalg.LinAlgError):
            return np.linalg.cholesky(gram + floor * np.eye(len(gram)))
    return np.linalg.cholesky(gram + GRAM_FLOORS[-1] * np.eye(len(gram)))


class WeightSolver:
    """Constrained least squares with any penalty; the data is compressed into the Cholesky factor R."""

    def __init__(self, regressors, free, target, roughness, ridge=None):
        self.count = regressors.shape[1]
        both = np.column_stack([regressors, free, target])
        self.table, self.target = both[:, :-1], target
        self.roughness = roughness
        gram = both.T @ both
        sizes = np.sqrt(np.diag(gram))
        sizes[sizes == 0.0] = 1.0
        gram /= np.outer(sizes, sizes)
        compressed = cholesky_factor(gram).T * sizes
        self.r, self.t = compressed[:, :-1], compressed[:, -1]
        self.ridge = np.zeros(free.shape[1]) if ridge is None else np.asarray(ridge, dtype=float)
        self.size = float(np.linalg.norm(self.r[:, : self.count]) / np.sqrt(self.count))

    def penalty(self, strength: float) -> np.ndarray:
        """Return the rows that penalise rough weights."""
        return strength * self.size * self.roughness

    def followed(self, moved, leaning, weights, strength: float) -> np.ndarray:
        """Return the changes of the residual, shape (N, k), for k changes dΦ of the regressors.

        ``moved`` is dΦ w, shape (N, k), and ``leaning`` is dΦᵀ e with the residual e, shape (count, k). Weights of 0
        remain 0; the other weights and the free coefficients are solved again.
        """
        follows = np.append(weights > 0.0, np.ones(self.table.shape[1] - self.count, dtype=bool))
        penalty = np.zeros((len(self.roughness), self.table.shape[1]))
        penalty[:, : self.count] = self.penalty(strength)
        right = -self.table.T @ moved
        right[: self.count] += leaning
        r, penalty, right = self.r[:, follows], penalty[:, follows], right[follows]
        gram = r.T @ r + penalty.T @ penalty
        sizes = np.sqrt(np.diag(gram))
        sizes[sizes == 0.0] = 1.0
        gram = gram / np.outer(sizes, sizes) + GRAM_FLOORS[-1] * np.eye(len(sizes))
        change = np.zeros((self.table.shape[1], moved.shape[1]))
        change[follows] = np.linalg.solve(gram, right / sizes[:, None]) / sizes[:, None]
        return -moved - self.table @ change

    def solve(self, strength: float):
        """Return weights, free coefficients and residual for one strength of the penalty."""
        from scipy.optimize import nnls  # imported here because only fits need it

        free = self.r[:, self.count :]
        penalty = np.zeros((len(self.roughness), self.table.shape[1] + free.shape[1]))
        penalty[:, : self.count] = self.penalty(strength)
        # an unconstrained coefficient is the difference of two non-negative ones
        pull = np.zeros((free.shape[1], penalty.shape[1]))
        pull[:, self.count :] = np.column_stack([np.diag(self.ridge), -np.diag(self.ridge)])
        table = np.vstack([np.column_stack([self.r, -free]), penalty, pull])
        solution, _ = nnls(table, np.append(self.t, np.zeros(len(table) - len(self.t))), maxiter=50 * table.shape[1])
        weights = solution[: self.count]
        split = self.count + free.shape[1]
        coefficients = solution[self.count : split] - solution[split:]
        return weights, coefficients, self.target - self.table @ np.append(weights, coefficients)
