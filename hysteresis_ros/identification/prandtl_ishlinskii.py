"""Prandtl-Ishlinskii models, classical and modified, from data, together with lag, delay and creep.

The plays' weights are found by linear least squares with weights ≥ 0 (:mod:`.weights`). Dead zones behind them, which
bend both branches alike, make the output bilinear in the two sets of weights: a few Gauss-Newton steps, each of them a
constrained linear problem again. The dead zones are kept only where they lower the residual.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.identification.hammerstein import (
    Condensed,
    HammersteinFit,
    condense,
    fit_linear_part,
    simulate_chain,
)
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.weights import plays, radii, smooth_weights
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiParameters

PLAYS = 20
ZONES = 5
GAUSS_NEWTON_STEPS = 6
SEARCH_STEPS = 2
#: Dead zones are kept when they lower the RMS residual by this part.
ZONES_WORTH_IT = 0.03
#: The slope behind all dead zones stays above this part of the slope at zero.
LOWEST_SLOPE = 0.2
#: The penalty on the slopes that dead zones add, in residual RMS over stroke: keeps unneeded ones near zero.
ZONE_RIDGE = 1e-3
#: Strength of the smoothness while the linear part is searched.
SEARCH_STRENGTH = 1e-2


def fit_prandtl_ishlinskii(
    voltage,
    displacement,
    sample_time: float,
    *,
    play_count: int = PLAYS,
    zone_count: int | None = None,
    linear=("lag", "delay", "creep"),
    skip: int | None = None,
    progress=None,
) -> HammersteinFit:
    """Fit voltage → plays → dead zones → creep → lag and delay.

    Parameters
    ----------
    voltage, displacement : array_like, shape (N,)
        [V] and [m], uniformly sampled.
    sample_time : float
        [s]
    play_count : int
        Plays, with radii from 0 in equal steps up to half the range of the voltage.
    zone_count : int, optional
        Dead zones; 0 for the classical model. By default five, if they lower the residual.
    linear : sequence of str
        Which of ``lag``, ``delay`` and ``creep`` may be there; each is kept only if it lowers the residual.
    skip : int, optional
        Samples left out of the fit at the start, see :func:`.hammerstein.condense`.
    progress : callable, optional
        Called as ``progress(evaluations, rmse)``.

    Raises
    ------
    IdentificationError
        The data or the settings cannot be used; the message says why.
    """
    data = condense(voltage, displacement, sample_time, skip)
    counts = (0, ZONES) if zone_count is None else (zone_count,)
    fits = [_Plays(data, play_count, count).fit(linear, progress) for count in counts]
    chosen = fits[-1]
    if len(fits) == 2 and not fits[1].rms < (1.0 - ZONES_WORTH_IT) * fits[0].rms:
        chosen = fits[0]
    return chosen.result(voltage, displacement, sample_time)


class _Plays:
    """One structure (number of plays and dead zones) on one set of data."""

    def __init__(self, data: Condensed, play_count: int, zone_count: int):
        self.data = data
        self.radii = radii(data.voltage_range, play_count)
        self.plays = plays(data.voltage, self.radii)
        self.roughness = np.diff(np.eye(play_count), 2, axis=0)[1:] * play_count**1.5 / play_count
        self.zone_count = zone_count
        self.weights = None

    def fit(self, linear, progress):
        """Search the linear part, then settle the weights."""

        def solve(part, _):
            return self._solve(part, SEARCH_STRENGTH)

        part, _, self.deviations, self.warnings, self.converged = fit_linear_part(
            solve, self.data, linear=linear, progress=progress
        )
        residual = self._solve(part, None)
        self.part = part
        self.rms = float(np.std(residual))
        return self

    def _solve(self, part: LinearPart, strength: float | None):
        data = self.data
        target = data.displacement[data.first :]
        moved = part.apply(self.plays, data.sample_time)[data.first :]
        one = np.ones((len(target), 1))
        weights, free, residual, used = smooth_weights(moved, one, target, self.roughness, strength)
        self.weights, self.offset = weights, float(free[0])
        self.thresholds = self.zone_weights = np.zeros(0)
        if self.zone_count:
            steps = GAUSS_NEWTON_STEPS if strength is None else SEARCH_STEPS
            residual = self._bend(part, target, used, residual, steps)
        return residual

    def _bend(self, part, target, strength, residual, steps):
        """Gauss-Newton on plays' and dead zones' weights; each step solves for both at once."""
        data = self.data
        x = self.plays @ self.weights
        thresholds = x.min() + np.ptp(x) * np.arange(1, self.zone_count + 1) / (self.zone_count + 1)
        zone_weights = np.zeros(self.zone_count)
        best = (np.std(residual), self.weights, zone_weights, self.offset, residual)
        ridge = ZONE_RIDGE * data.stroke * np.sqrt(len(target))
        for _ in range(steps):
            zones = _zones(x, thresholds)
            slope = 1.0 + (zones != 0.0) @ zone_weights
            table = part.apply(np.column_stack([slope[:, None] * self.plays, zones]), data.sample_time)[data.first :]
            # linearised: S'(x) Z w + d(x) s has to be y - offset - [S(x) - S'(x) x - d(x) s], a term of filtered zones
            kink = part.apply((zones - (zones != 0.0) * x[:, None]) @ zone_weights, data.sample_time)[data.first :]
            zone_part = part.apply(zones @ zone_weights, data.sample_time)[data.first :]
            free = np.column_stack([table[:, len(self.radii) :], np.ones(len(target))])
            weights, coefficients, _, _ = smooth_weights(
                table[:, : len(self.radii)],
                free,
                target - kink + zone_part,
                self.roughness,
                strength,
                ridge=np.append(np.full(self.zone_count, ridge), 0.0),
            )
            zone_weights = _monotone(coefficients[:-1], thresholds)
            x = self.plays @ weights
            bent = part.apply(x + _zones(x, thresholds) @ zone_weights, data.sample_time)[data.first :]
            offset = float(np.mean(target - bent))
            residual = target - bent - offset
            if np.std(residual) < best[0]:
                best = (np.std(residual), weights, zone_weights, offset, residual)
        _, self.weights, self.zone_weights, self.offset, residual = best
        self.thresholds = thresholds
        return residual

    def result(self, voltage, displacement, sample_time) -> HammersteinFit:
        """Put the numbers into parameter objects and measure them with the nodes' kernels."""
        moving = self.weights > 1e-9 * self.weights.sum()
        moving[0] = True
        weights = np.maximum(self.weights, 1e-6 * self.weights.sum() * (np.arange(len(moving)) == 0))
        used = self.zone_weights != 0.0
        gain = self.part.settled_gain
        parameters = PrandtlIshlinskiiParameters(
            radii=tuple(self.radii[moving].tolist()),
            weights=tuple(weights[moving].tolist()),
            thresholds=tuple(self.thresholds[used].tolist()),
            zone_weights=tuple(self.zone_weights[used].tolist()),
            offset=self.offset / gain,
        )
        hysteresis = HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=parameters)
        return finished(self, hysteresis, voltage, displacement, sample_time)


def finished(fit, hysteresis: HysteresisParameters, voltage, displacement, sample_time) -> HammersteinFit:
    """Return the result of a fit, its residual measured on the recording itself with the kernels of the nodes.

    Parameters
    ----------
    fit : object
        With ``part``, ``data``, ``deviations``, ``warnings`` and ``converged``.
    hysteresis : HysteresisParameters
    voltage, displacement : array_like, shape (N,)
        [V] and [m].
    sample_time : float
        [s]
    """
    part, data = fit.part, fit.data
    creep, dynamics = part.creep, part.dynamics(sample_time)
    synchronous = part.lag + part.delay < 0.5 * sample_time
    predicted = simulate_chain(hysteresis, creep, dynamics, voltage, sample_time, part.settled, synchronous)
    first = data.first * data.factor
    error = (np.asarray(displacement, dtype=float) - predicted)[first:]
    # what the half sample and the table leave of a constant belongs to the offset
    chosen = hysteresis.chosen
    chosen = replace(chosen, offset=chosen.offset + float(error.mean()) / part.settled_gain)
    hysteresis = replace(hysteresis, **{hysteresis.type: chosen})
    return HammersteinFit(
        hysteresis=hysteresis,
        creep=creep,
        dynamics=dynamics,
        linear_part=part,
        sample_time=sample_time,
        rmse=float(np.std(error)),
        stroke=data.stroke,
        voltage_low=float(np.min(voltage)),
        voltage_high=float(np.max(voltage)),
        deviations=fit.deviations,
        warnings=fit.warnings,
        converged=fit.converged,
        synchronous=synchronous,
    )


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
