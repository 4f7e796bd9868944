# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Prandtl-Ishlinskii models with a weight of its own for each play, classical and modified.

The plays' weights are found by linear least squares with weights ≥ 0 (:mod:`.weights`). Dead zones behind them, which
bend both branches alike, make the output bilinear in the two sets of weights: a few Gauss-Newton steps, each of them a
constrained linear problem again.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from hysteresis_ros.identification.condensed import Condensed
from hysteresis_ros.identification.hammerstein import fit_linear_part
from hysteresis_ros.identification.weights import radii, smooth_weights
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiParameters

GAUSS_NEWTON_STEPS = 6
SEARCH_STEPS = 2
#: The slope behind all dead zones stays above this part of the slope at zero.
LOWEST_SLOPE = 0.2
#: The penalty on the slopes that dead zones add, in residual RMS over stroke: keeps unneeded ones near zero.
ZONE_RIDGE = 1e-3
#: Strength of the smoothness while the linear part is searched.
SEARCH_STRENGTH = 1e-2


class FreeWeights:
    """Free weights of plays, and dead zones behind them, on one set of data.

    Parameters
    ----------
    data : Condensed
    play_count : int
        Plays up to half the range of the voltage.
    zone_count : int
        Dead zones; 0 for the classical model.
    """

    def __init__(self, data: Condensed, play_count: int, zone_count: int):
        self.data = data
        self.radii = radii(data.voltage_range, play_count, data.reach)
        self.plays = data.plays(self.radii)
        self.roughness = np.diff(np.eye(len(self.radii)), 2, axis=0)[1:] * play_count**0.5
        self.play_count, self.zone_count = play_count, zone_count
        self.numbers: dict[str, float] = {}

    def behind(self, part):
        """Settle the weights for a linear part that is known.

        Parameters
        ----------
        part : LinearPart
        """
        self.part = part
        self.rms = float(np.std(self._solve(part, None, GAUSS_NEWTON_STEPS)))
        return self

    def fit(self, linear, progress):
        """Search the linear part, then settle the weights.

        Parameters
        ----------
        linear : sequence of str
        progress : callable or None
        """

        def solve(part, _):
            return self._solve(part, SEARCH_STRENGTH, SEARCH_STEPS)

        part, _, self.deviations, self.warnings, self.converged = fit_linear_part(
            solve, self.data, linear=linear, progress=progress
        )
        return self.behind(part)

    def like(self, data: Condensed):
        """Return the same structure for other data, not fitted yet.

        Parameters
        ----------
        data : Condensed
        """
        return FreeWeights(data, self.play_count, self.zone_count)

    def refitted(self, data: Condensed):
        """Return the model with weights for other samples of the recording, behind the same linear part.

        Parameters
        ----------
        data : Condensed
        """
        other = copy(self)
        other.data = data
        other._solve(self.part, self.strength, GAUSS_NEWTON_STEPS)
        return other

    def output(self) -> np.ndarray:
        """Return the modelled displacement [m], shape (N,)."""
        x = self.plays @ self.weights
        if self.zone_count:
            x = x + _zones(x, self.thresholds) @ self.zone_weights
        return self.part.apply(x, self.data.sample_time) + self.data.constants @ self.constants

    def _solve(self, part, strength: float | None, steps: int):
        data = self.data
        target = data.counted(data.displacement)
        moved = data.counted(part.apply(self.plays, data.sample_time))
        constants = data.counted(data.constants)
        weights, free, residual, used = smooth_weights(moved, constants, target, self.roughness, strength)
        self.weights, self.constants, self.strength = weights, free, used
        self.thresholds = self.zone_weights = np.zeros(0)
        if self.zone_count:
            residual = self._bend(part, target, used, residual, steps)
        return residual

    def _bend(self, part, target, strength, residual, steps):
        """Gauss-Newton on plays' and dead zones' weights; each step solves for both at once."""
        data = self.data
        x = self.plays @ self.weights
        thresholds = x.min() + np.ptp(x) * np.arange(1, self.zone_count + 1) / (self.zone_count + 1)
        zone_weights = np.zeros(self.zone_count)
        constants = data.counted(data.constants)
        best = (np.std(residual), self.weights, zone_weights, self.constants, residual)
        ridge = ZONE_RIDGE * data.stroke * np.sqrt(len(target))
        for _ in range(steps):
            zones = _zones(x, thresholds)
            slope = 1.0 + (zones != 0.0) @ zone_weights
            table = data.counted(part.apply(np.column_stack([slope[:, None] * self.plays, zones]), data.sample_time))
            # linearised: S'(x) Z w + d(x) s has to be y - offset - [S(x) - S'(x) x - d(x) s], a term of filtered zones
            kink = data.counted(part.apply((zones - (zones != 0.0) * x[:, None]) @ zone_weights, data.sample_time))
            zone_part = data.counted(part.apply(zones @ zone_weights, data.sample_time))
            free = np.column_stack([table[:, len(self.radii) :], constants])
            weights, coefficients, _, _ = smooth_weights(
                table[:, : len(self.radii)],
                free,
                target - kink + zone_part,
                self.roughness,
                strength,
                ridge=np.append(np.full(self.zone_count, ridge), np.zeros(constants.shape[1])),
            )
            zone_weights = _monotone(coefficients[: self.zone_count], thresholds)
            x = self.plays @ weights
            bent = data.counted(part.apply(x + _zones(x, thresholds) @ zone_weights, data.sample_time))
            still = np.linalg.lstsq(constants, target - bent, rcond=None)[0]
            residual = target - bent - constants @ still
            if np.std(residual) < best[0]:
                best = (np.std(residual), weights, zone_weights, still, residual)
        _, self.weights, self.zone_weights, self.constants, residual = best
        self.thresholds = thresholds
        return residual

    def parameters(self) -> HysteresisParameters:
        """Return the numbers as parameters of the block."""
        moving = self.weights > 1e-9 * self.weights.sum()
        moving[0] = True
        weights = np.maximum(self.weights, 1e-6 * self.weights.sum() * (np.arange(len(moving)) == 0))
        used = self.zone_weights != 0.0
        parameters = PrandtlIshlinskiiParameters(
            radii=tuple(self.radii[moving].tolist()),
            weights=tuple(weights[moving].tolist()),
            thresholds=tuple(self.thresholds[used].tolist()),
            zone_weights=tuple(self.zone_weights[used].tolist()),
            offset=float(self.constants[0]) / self.part.settled_gain,
        )
        return HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=parameters)


def _zones(x, thresholds):
    """Outputs of the dead zones, shape (N, k): zones for t ≥ 0 act above t, the others below."""
    inside = x[:, None] - thresholds
    return np.where(thresholds >= 0.0, np.maximum(inside, 0.0), np.minimum(inside, 0.0))


def _monotone(zone_weights, thresholds):
    """Weaken what makes the slope behind the dead zones fall below the lowest one."""
    result = np.array(zone_weights, dtype=float)
    for side in (np.flatnonzero(thresholds >= 0.0), np.flatnonzero(thresholds < 0.0)[::-1]):
        slope = 1.0
        for i in side:
            result[i] = max(result[i], LOWEST_SLOPE - slope)
            slope += result[i]
    return result
