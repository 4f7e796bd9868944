# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Weights of many play operators from data: non-negative, and as smooth over the radius as the data allows.

A recording of one large loop determines every weight of a classical Prandtl-Ishlinskii model, but noise and small model
errors make neighbouring weights alternate, which causes errors in minor loops. The roughness (second difference) of the
weights is therefore penalised as strongly as the residual permits.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.identification.thresholds import SMOOTHER_WEIGHTS

#: Added to the normal equations of columns of unit length.
GRAM_FLOOR = 1e-13
#: Tried strengths of the smoothing, from hardly any to nearly linear weights.
STRENGTHS = 10.0 ** np.arange(-4.0, 1.6, 0.5)


def radii(voltage_range: float, count: int, reach: float = 0.0) -> np.ndarray:
    """Return ``count`` radii [V], from 0, in steps of half the range over their number.

    A play whose radius is half the range never moves and is omitted, unless it moves on the path from rest.
    """
    step = 0.5 * voltage_range / count
    return step * np.arange(max(count, int(np.ceil(reach / step - 1e-9))))


def plays(voltage, play_radii, start=None) -> np.ndarray:
    """Return the outputs of the play operators, shape (N, m), all initially centred at 0 V.

    Between reversals the play is a running maximum (minimum) of V - r (V + r), so NumPy can process all samples between
    two reversals at once.

    Units: ``voltage`` [V], ``play_radii`` [V], ``start`` [V].
    """
    voltage = np.asarray(voltage, dtype=float)
    z = np.zeros(len(play_radii)) if start is None else np.array(start, dtype=float)
    result = np.empty((voltage.size, len(play_radii)))
    direction = np.sign(np.diff(voltage, prepend=voltage[0] - 1.0))
    moving = np.flatnonzero(direction)
    turns = moving[1:][np.diff(direction[moving]) != 0.0]
    edges = sorted({0, min(1, voltage.size), *turns.tolist(), voltage.size})
    for first, last in zip(edges, edges[1:], strict=False):  # V moves one way within a stretch; the first is one step
        part = voltage[first:last, None]
        block = np.maximum(part - play_radii, np.minimum(part + play_radii, z))
        result[first:last] = block
        z = block[-1]
    return result


def smooth_weights(regressors, free, target, roughness, strength: float | None = None, ridge=None):
    """Return weights ≥ 0 of ``regressors``, as smooth as the residual allows, and free coefficients of ``free``."""
    solver = WeightSolver(regressors, free, target, roughness, ridge)
    if strength is not None:
        return *solver.solve(strength), strength
    trials = [(strength, *solver.solve(strength)) for strength in STRENGTHS]
    smallest = min(np.std(residual) for *_, residual in trials)
    strength, weights, coefficients, residual = [
        trial for trial in trials if np.std(trial[-1]) <= (1.0 + SMOOTHER_WEIGHTS) * smallest
    ][-1]
    return weights, coefficients, residual, strength


class WeightSolver:
    """Constrained least squares for several penalties, compressed by the Cholesky factor R."""

    def __init__(self, regressors, free, target, roughness, ridge=None):
        self.count = regressors.shape[1]
        self.table = np.column_stack([regressors, free])
        self.target = target
        self.roughness = roughness
        both = np.column_stack([self.table, target])
        sizes = np.linalg.norm(both, axis=0)
        sizes[sizes == 0.0] = 1.0
        gram = (both.T @ both) / np.outer(sizes, sizes)
        # the small diagonal separates equal columns; it is far below any noise
        compressed = np.linalg.cholesky(gram + GRAM_FLOOR * np.eye(len(gram))).T * sizes
        self.r, self.t = compressed[:, :-1], compressed[:, -1]
        self.ridge = np.zeros(free.shape[1]) if ridge is None else np.asarray(ridge, dtype=float)
        self.size = float(np.linalg.norm(self.r[:, : self.count]) / np.sqrt(self.count))

    def solve(self, strength: float):
        """Return weights, free coefficients and residual for one strength of the penalty."""
        from scipy.optimize import nnls  # imported here because only fits need it

        free = self.r[:, self.count :]
        penalty = np.zeros((len(self.roughness), self.table.shape[1] + free.shape[1]))
        penalty[:, : self.count] = strength * self.size * self.roughness
        # a coefficient of any sign is the difference of two non-negative ones
        pull = np.zeros((free.shape[1], penalty.shape[1]))
        pull[:, self.count :] = np.column_stack([np.diag(self.ridge), -np.diag(self.ridge)])
        table = np.vstack([np.column_stack([self.r, -free]), penalty, pull])
        solution, _ = nnls(table, np.append(self.t, np.zeros(len(table) - len(self.t))), maxiter=50 * table.shape[1])
        weights = solution[: self.count]
        split = self.count + free.shape[1]
        coefficients = solution[self.count : split] - solution[split:]
        return weights, coefficients, self.target - self.table @ np.append(weights, coefficients)
