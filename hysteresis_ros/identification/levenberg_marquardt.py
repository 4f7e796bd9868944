# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""Levenberg and Marquardt's method with normal equations, for fits whose Jacobian is too large to store [1]_.

References
----------
.. [1] Marquardt, An algorithm for least-squares estimation of nonlinear parameters, J. SIAM 11 (1963) 431-441,
   doi:10.1137/0111030.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

#: Damping before the first step, relative to the diagonal of the normal matrix.
DAMPING = 1e-3
#: Damping from which on no step is tried, relative to the diagonal of the normal matrix.
MOST_DAMPING = 1e8
#: Each step first tries this multiple of the last damping, and uses the best of several dampings, because computing a
#: normal matrix takes far more time than evaluating a trial point.
EASED = 0.02
#: Ratio of each tried damping to the one tried before it.
RAISED = 4.0
LEAST_DAMPING = 1e-10


@dataclass(frozen=True, eq=False)
class Minimum:
    """The end point of a search."""

    parameters: np.ndarray
    cost: float  #: Sum of squares at this point.
    costs: tuple[float, ...]  #: Sums of squares at the start and after each successful step.
    #: Whether no further step reduces the cost; false: the limit of steps was reached, or the search was stopped.
    converged: bool


def minimise(
    parameters,
    cost: Callable[[np.ndarray], float],
    normal: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    *,
    steps: int,
    tolerance: float = 1e-6,
    allowed: Callable[[np.ndarray], np.ndarray] | None = None,
    accepted: Callable[[np.ndarray, float], bool] | None = None,
) -> Minimum:
    """Minimise a sum of squares, given its Gauss-Newton matrix JᵀJ and gradient Jᵀr.

    ``cost`` returns infinity for points that cannot be simulated. ``normal`` returns (JᵀJ, Jᵀr) with the residual r =
    model - data. ``allowed`` moves a point to the nearest allowed point. ``accepted`` is called after each successful
    step and returns whether to continue.
    """
    parameters = np.array(parameters, dtype=float)
    value, damping = cost(parameters), DAMPING
    costs = [value]
    for _ in range(steps):
        matrix, gradient = normal(parameters)
        # the matrix is scaled to a unit diagonal, because the parameters have different units
        size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        size[size < 1e-10 * size.max()] = size.max()
        scaled, slope = matrix / size / size[:, None], gradient / size
        best = None
        damping = max(damping * EASED, LEAST_DAMPING)
        while damping < MOST_DAMPING:
            step = -scipy.linalg.solve(scaled + damping * np.eye(len(slope)), slope, assume_a="sym") / size
            trial = parameters + step if allowed is None else allowed(parameters + step)
            there = cost(trial)
            if there < (value if best is None else best[0]):
                best = there, trial, damping
            elif best is not None:
                break
            damping *= RAISED
        if best is None:
            return Minimum(parameters, value, tuple(costs), True)
        gain = (value - best[0]) / value
        value, parameters, damping = best
        costs.append(value)
        if accepted is not None and not accepted(parameters, value):
            break
        if gain < tolerance:
            return Minimum(parameters, value, tuple(costs), True)
    return Minimum(parameters, value, tuple(costs), False)
