# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fits of models whose output is linear in the weights of plays: one search and one solver for many models.

A model gives the columns of its plays for a shape (:meth:`PlayFit.columns`), the searched parameters of the shape
(:attr:`PlayFit.extra`) and the block's parameters for the weights (:meth:`PlayFit.parameters`). The linear part and the
shape are searched; for each trial the weights ≥ 0 and the constants follow by linear least squares.

The weights are as smooth over the radius as the data allows: a recording of one large loop determines every weight of a
classical Prandtl-Ishlinskii model, but noise and small model errors make neighbouring weights alternate, which causes
errors in minor loops. The roughness (second difference) of the weights is therefore penalised as strongly as the
residual permits.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from copy import copy
from dataclasses import replace

import numpy as np

from hysteresis_ros.identification.hammerstein import PartSearch, PartTrial, search_linear_part, split_values
from hysteresis_ros.identification.linear_systems import SMALLEST_RATE
from hysteresis_ros.identification.preprocessing import Condensed
from hysteresis_ros.identification.thresholds import SMOOTHER_WEIGHTS
from hysteresis_ros.models.hysteresis import HysteresisParameters

#: Weight of the smoothness penalty during the search of the linear part and the shape.
SEARCH_STRENGTH = 1e-2

#: Small diagonals to add to the normal equations of columns of unit length; the first that suffices is used.
GRAM_FLOORS = (1e-13, 1e-12, 1e-11, 1e-10)
#: Tried weights of the smoothness penalty, from almost none to one that makes the weights almost linear.
STRENGTHS = 10.0 ** np.arange(-4.0, 1.6, 0.5)


class PlayFit(ABC):
    """A model of plays, fitted to one set of data."""

    #: Searched parameters of the shape: name, initial value, and ends of the range.
    extra: tuple[tuple[str, float, float, float], ...] = ()
    #: Penalised differences of neighbouring weights, one row for each.
    roughness: np.ndarray

    def __init__(self, data: Condensed):
        self.data = data
        self.numbers: dict[str, float] = {}
        #: Shape and case of creep of the columns that :meth:`moved` keeps, the columns, and their response to creep.
        self.crept: tuple[tuple, np.ndarray, np.ndarray, np.ndarray] | None = None

    @abstractmethod
    def columns(self, shape: dict[str, float]) -> np.ndarray:
        """Return the regressors for a shape, shape (N, m), in the order of the weights, zero at rest."""

    @abstractmethod
    def parameters(self) -> HysteresisParameters:
        """Return the fit as parameters of the block."""

    def solve(self, part, shape) -> np.ndarray:
        """Return the residual [m] of the weights for one trial of the search."""
        return self.solve_weights(part, shape, SEARCH_STRENGTH)

    def solve_weights(self, part, shape, strength: float | None = None) -> np.ndarray:
        """Solve for the weights and return the residual [m].

        ``strength`` is the penalty on rough weights; None: as large as the residual allows.
        """
        data = self.data
        moved = data.counted(self.moved(part, shape))
        target = data.counted(data.displacement)
        self.weights, self.constants, residual, self.strength = smooth_weights(
            moved, data.counted(data.constants), target, self.roughness, strength
        )
        return residual

    def moved(self, part, shape) -> np.ndarray:
        """Return the columns behind the linear part, shape (N, m).

        Creep is most of the work, and it is linear in its rate: the response for the rate 1 is kept until the shape
        changes.
        """
        step = self.data.sample_time
        case = shape, part.longest_time, part.settled, part.creep_rate >= SMALLEST_RATE
        if self.crept is None or self.crept[0] != case:
            columns = self.columns(shape)
            still, full = (replace(part, creep_rate=rate).crept(columns, step) for rate in (0.0, float(case[-1])))
            self.crept = case, columns, still, full - still
        _, columns, still, growth = self.crept
        return part.behind_creep(still + part.creep_rate * growth, columns, step)

    def fit(self, linear, progress):
        """Search the linear part and the shape, then compute the weights."""
        search = PartSearch(self.solve, self.data, self.extra, progress)
        self.kept, self.base, found = search_linear_part(search, linear)
        return self._finish(search, found)

    def settle(self, before, progress):
        """Search the shape, and the parameters of a linear part with known structure."""
        self.kept, self.base = before.kept, before.base
        search = PartSearch(self.solve, self.data, self.extra, progress)
        return self._finish(search, search.run(self.kept, before.found.values, self.base))

    def behind(self, part):
        """Compute the weights for the initial shape and a known linear part."""
        self.part, self.shape = part, {name: start for name, start, *_ in self.extra}
        self.rms = float(np.std(self.solve_weights(self.part, self.shape)))
        return self

    def _finish(self, search: PartSearch, found: PartTrial):
        self.found = found
        self.part, self.shape = split_values(self.base, found.values)
        self.deviations, self.converged = found.deviations or {}, found.converged
        self.warnings = tuple(search.at_ends(self.kept, found.values))
        self.rms = float(np.std(self.solve_weights(self.part, self.shape)))
        return self

    def refitted(self, data: Condensed):
        """Return the model with the same shape and linear part, and weights for other samples of the recording."""
        other = copy(self)
        other.data = data
        other.solve_weights(self.part, self.shape, self.strength)
        return other

    def output(self) -> np.ndarray:
        """Return the modelled displacement [m], shape (N,)."""
        moved = self.part.apply(self.columns(self.shape), self.data.sample_time)
        return moved @ self.weights + self.data.constants @ self.constants


def radii(voltage_range: float, count: int, reach: float = 0.0) -> np.ndarray:
    """Return ``count`` radii [V] from 0, in steps of half the range divided by ``count``.

    A play whose radius is half the range never moves and is omitted, unless the path from rest moves it.
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
    """Return the Cholesky factor of a Gram matrix of columns of unit length, of which some may be equal.

    The diagonal that is added is as small as rounding errors allow, far below any noise.
    """
    for floor in GRAM_FLOORS[:-1]:
        with contextlib.suppress(np.linalg.LinAlgError):
            return np.linalg.cholesky(gram + floor * np.eye(len(gram)))
    return np.linalg.cholesky(gram + GRAM_FLOORS[-1] * np.eye(len(gram)))


class WeightSolver:
    """Constrained least squares for several penalties, compressed by the Cholesky factor R."""

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

    def solve(self, strength: float):
        """Return weights, free coefficients and residual for one strength of the penalty."""
        from scipy.optimize import nnls  # imported here because only fits need it

        free = self.r[:, self.count :]
        penalty = np.zeros((len(self.roughness), self.table.shape[1] + free.shape[1]))
        penalty[:, : self.count] = strength * self.size * self.roughness
        # an unconstrained coefficient is represented as the difference of two non-negative ones
        pull = np.zeros((free.shape[1], penalty.shape[1]))
        pull[:, self.count :] = np.column_stack([np.diag(self.ridge), -np.diag(self.ridge)])
        table = np.vstack([np.column_stack([self.r, -free]), penalty, pull])
        solution, _ = nnls(table, np.append(self.t, np.zeros(len(table) - len(self.t))), maxiter=50 * table.shape[1])
        weights = solution[: self.count]
        split = self.count + free.shape[1]
        coefficients = solution[self.count : split] - solution[split:]
        return weights, coefficients, self.target - self.table @ np.append(weights, coefficients)
