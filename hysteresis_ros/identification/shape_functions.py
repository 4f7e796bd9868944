# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Shape functions f and g of the Duhem equation from the branches of a major loop (W3), as networks or splines.

W3 gives f and g from the branches *and their slopes*, and slopes of measured branches are mostly noise. As the output
of the Duhem equation is linear in f and g along a known path of the input, the equation is used in its integrated form
instead: f and g are sought with which the equation runs along the measured branches. For exact branches both are the
same; with noise the integral needs no differentiation.

Everything here is normalised: input and output of the major loop run from -1 to +1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

#: Substeps of the integration are at most this long, in 1/α.
SUBSTEP_ALPHA = 0.25
#: Beyond this α (normalised) exponentials would overflow; branches switch within 1 % of the range long before.
LARGEST_ALPHA = 300.0
#: Weight of roughness (splines) and of size (networks) against the residual: only ties are broken by it.
ROUGHNESS = 1e-5
SIZE = 1e-5
#: Numbers of units and of knots that are tried, until the residual is small or stops falling.
UNITS = (4, 8, 12, 18, 24)
KNOTS = (8, 12, 18, 26, 38, 56)
#: Residual (rms, of half the range) that is small enough, and the part by which a larger model must be better.
SMALL_RESIDUAL = 4e-5
WORTH_IT = 0.8
TRAINING_STARTS = 2
TRAINING_STEPS = 150
#: Networks with this residual are trained, whether or not a further step would still lower it a little.
TRAINED = 2e-4

# Gauss-Legendre rule of three points on 0 … 1, which the model's own kernel uses too.
_POINTS = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


@dataclass(frozen=True)
class Shapes:
    """f and g of one loop.

    Parameters
    ----------
    kind : str
        ``network`` or ``spline``.
    f, g : ndarray
        Numbers as in :class:`~hysteresis_ros.models.hysteresis.duhem.DuhemParameters`.
    rms, maximum : float
        Residual of the loop that runs with them, in parts of half the range.
    converged : bool
        The training ended by itself or came below :data:`TRAINED` (splines need none).
    """

    kind: str
    f: np.ndarray
    g: np.ndarray
    rms: float
    maximum: float
    converged: bool


class LoopOperator:
    """The Duhem equation run once up and down a grid: ``w = constant + on_f f(nodes) + on_g g(nodes)``.

    Parameters
    ----------
    grid : ndarray, shape (n,)
        Inputs, rising from -1 to +1.
    alpha : float
        α for the normalised input, up to :data:`LARGEST_ALPHA`.
    start : float
        Output at -1.

    Attributes
    ----------
    nodes : ndarray, shape (m,)
        Inputs at which f and g are needed.
    constant : ndarray, shape (2 n,)
        What the start contributes: first upwards along the grid, then downwards from its last to its first point.
    """

    def __init__(self, grid, alpha, start):
        longest = float(np.max(np.diff(grid)))
        parts = max(1, math.ceil(alpha * longest / SUBSTEP_ALPHA))
        n = len(grid)
        edges = np.interp(np.arange((n - 1) * parts + 1) / parts, np.arange(n), grid)
        lengths = np.diff(edges)
        self.alpha = alpha
        self.nodes = (edges[:-1, None] + lengths[:, None] * _POINTS).ravel()
        weights = (lengths[:, None] * _WEIGHTS).ravel()
        # exp(-α (v - node)) = exp(-α (v + 1)) exp(α (node + 1)): integrals become running sums
        self._group = 3 * parts
        self._up = (weights * np.exp(alpha * (self.nodes - grid[0])))[:, None]
        self._down = (weights * np.exp(alpha * (grid[-1] - self.nodes)))[:, None]
        self._decay_up = np.exp(-alpha * (grid - grid[0]))
        self._decay_down = np.exp(-alpha * (grid[-1] - grid[::-1]))
        # the way down starts where the way up has ended
        self.constant = start * np.concatenate([self._decay_up, self._decay_down * self._decay_up[-1]])

    def _apply(self, values, sign) -> np.ndarray:
        columns = np.reshape(values, (self.nodes.size, -1))
        up = self._running(columns * self._up, self._decay_up)
        down = sign * self._running((columns * self._down)[::-1], self._decay_down)
        down += self._decay_down[:, None] * up[-1]
        return np.concatenate([up, down]).reshape((-1, *np.shape(values)[1:]))

    def _running(self, columns, decay) -> np.ndarray:
        pieces = columns.reshape(-1, self._group, columns.shape[1]).sum(axis=1)
        sums = np.zeros((len(pieces) + 1, columns.shape[1]))
        np.cumsum(pieces, axis=0, out=sums[1:])
        return decay[:, None] * sums

    def on_f(self, values) -> np.ndarray:
        """Return what values of f at the nodes, shape (m,) or (m, k), do to the output, shape (2 n,) or (2 n, k)."""
        return self.alpha * self._apply(values, 1.0)

    def on_g(self, values) -> np.ndarray:
        """Return what values of g at the nodes do, like :meth:`on_f`."""
        return self._apply(values, -1.0)

    def output(self, f, g) -> np.ndarray:
        """Return w, shape (2 n,), for values f and g at the nodes, shape (m,)."""
        return self.constant + self.on_f(f) + self.on_g(g)


def _least_squares(rows, wanted) -> np.ndarray:
    """Solve a well-conditioned problem by its normal equations: no multithreaded routine for such small matrices."""
    normal = np.einsum("ij,ik->jk", rows, rows)
    return np.linalg.solve(normal, np.einsum("ij,i->j", rows, wanted))


def fit_splines(operator: LoopOperator, target, knots: int) -> Shapes:
    """Return the splines of ``knots`` values with which the loop runs nearest to ``target``, shape (2 n,)."""
    from scipy.interpolate import CubicSpline  # imported here because only fits need it

    basis = CubicSpline(np.linspace(-1.0, 1.0, knots), np.eye(knots))(operator.nodes)
    matrix = np.hstack([operator.on_f(basis), operator.on_g(basis)])
    bend = np.diff(np.eye(knots), 2, axis=0) * ROUGHNESS * knots**1.5
    rows = np.vstack([matrix, np.kron(np.eye(2), bend)])
    wanted = np.concatenate([target - operator.constant, np.zeros(2 * len(bend))])
    found = _least_squares(rows, wanted)
    residual = matrix @ found + operator.constant - target
    return _shapes("spline", found[:knots], found[knots:], residual, True)


def fit_networks(operator: LoopOperator, target, units: int, random, noise: float = 0.0) -> Shapes:
    """Return trained networks of ``units`` tanh units each, the best of a few seeded starts.

    Parameters
    ----------
    operator : LoopOperator
    target : ndarray, shape (2 n,)
        Outputs along the loop.
    units : int
        Hidden units of each network.
    random : numpy.random.Generator
        For the starts.
    noise : float
        Standard error of the targets.
    """
    from scipy.optimize import least_squares  # imported here because only fits need it

    v = operator.nodes[:, None]
    size = 3 * units + 1
    best = None

    def network(numbers):
        a, b, c, d = numbers[:units], numbers[units : 2 * units], numbers[2 * units : -1], numbers[-1]
        hidden = np.tanh(a * v + b)
        return hidden, c, hidden @ c + d

    def residual(numbers):
        _, _, f = network(numbers[:size])
        _, _, g = network(numbers[size:])
        return np.concatenate([operator.output(f, g) - target, SIZE * numbers])

    def jacobian(numbers):
        blocks = []
        for apply, part in ((operator.on_f, numbers[:size]), (operator.on_g, numbers[size:])):
            hidden, c, _ = network(part)
            slope = (1.0 - hidden**2) * c
            blocks.append(apply(np.hstack([slope * v, slope, hidden, np.ones_like(v)])))
        return np.vstack([np.hstack(blocks), SIZE * np.eye(2 * size)])

    for _ in range(TRAINING_STARTS):
        numbers = _first_networks(operator, target, units, random)
        found = least_squares(residual, numbers, jacobian, method="lm", x_scale="jac", max_nfev=TRAINING_STEPS)
        errors = residual(found.x)[: len(target)]
        trained = found.status > 0 or np.sqrt(np.mean(errors**2)) <= max(TRAINED, noise)
        shapes = _shapes("network", found.x[:size], found.x[size:], errors, trained)
        if best is None or shapes.rms < best.rms:
            best = shapes
        if best.rms <= max(SMALL_RESIDUAL, noise):
            break
    return best


def _first_networks(operator, target, units, random) -> np.ndarray:
    """Return starting numbers: units spread over the range, output weights by least squares."""
    parts = []
    for _ in range(2):
        centres = np.linspace(-1.0, 1.0, units) + 0.5 / units * random.standard_normal(units)
        a = 0.5 * units * (0.5 + random.random(units)) + 0.5
        parts.append((a, -a * centres))
    hidden = [
        np.hstack([np.tanh(operator.nodes[:, None] * a + b), np.ones((operator.nodes.size, 1))]) for a, b in parts
    ]
    matrix = np.hstack([operator.on_f(hidden[0]), operator.on_g(hidden[1])])
    rows = np.vstack([matrix, 1e-3 * np.eye(matrix.shape[1])])
    wanted = np.concatenate([target - operator.constant, np.zeros(matrix.shape[1])])
    out = _least_squares(rows, wanted).reshape(2, units + 1)
    return np.concatenate([np.concatenate([*part, weights]) for part, weights in zip(parts, out, strict=True)])


def fit_shapes(operator: LoopOperator, target, kind: str, size: int | None, random, noise: float = 0.0) -> Shapes:
    """Return f and g of the given kind.

    Parameters
    ----------
    operator : LoopOperator
    target : ndarray, shape (2 n,)
    kind : str
        ``network`` or ``spline``.
    size : int or None
        Units or knots; None tries growing ones until the residual is small or a larger model hardly helps.
    random : numpy.random.Generator
    noise : float
        Standard error of the targets; a residual below it is small enough.
    """

    def fit(number):
        if kind == "spline":
            return fit_splines(operator, target, number)
        return fit_networks(operator, target, number, random, noise)

    if size is not None:
        return fit(size)
    best, enough = None, max(SMALL_RESIDUAL, noise)
    for number in KNOTS if kind == "spline" else UNITS:
        if 6 * number > len(target):
            break
        shapes = fit(number)
        if best is not None and shapes.rms > WORTH_IT * best.rms and best.rms < 1e-3:
            break
        if best is None or shapes.rms < best.rms:
            best = shapes
        if best.rms <= enough:
            break
    return best


def _shapes(kind, f, g, residual, converged) -> Shapes:
    rms, maximum = float(np.sqrt(np.mean(residual**2))), float(np.max(np.abs(residual)))
    return Shapes(kind, np.asarray(f), np.asarray(g), rms, maximum, bool(converged))
