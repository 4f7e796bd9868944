# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The end of every fit of hysteresis and linear part together: outliers left out, measured with the nodes' kernels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.identification.cleaning import MOST_OUTLIERS, ROUNDS, matter, near
from hysteresis_ros.identification.hammerstein import HammersteinFit, simulate_chain
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.models.hysteresis import HysteresisParameters

#: Samples on which the lag is settled with the blocks.
RETIMED_ON = 20000


def finished(fit, voltage, displacement, sample_time, kept=None) -> HammersteinFit:
    """Return the result of a fit, its residual measured on the recording itself with the kernels of the nodes.

    Parameters
    ----------
    fit : object
        With ``part``, ``data``, ``constants``, ``parameters()``, ``deviations``, ``warnings``, ``converged`` and
        ``numbers``.
    voltage, displacement : array_like, shape (N,)
        [V] and [m].
    sample_time : float
        [s]
    kept : ndarray of bool, shape (N,), optional
        False for outliers.
    """
    voltage, displacement = (np.ascontiguousarray(values, dtype=float) for values in (voltage, displacement))
    data = fit.data
    hysteresis: HysteresisParameters = fit.parameters()
    first = data.first * data.factor
    used = slice(first, None) if kept is None else np.flatnonzero(kept[first:]) + first
    synchronous = fit.part.synchronous(sample_time)
    drift = float(fit.constants[1]) / (len(data.voltage) * data.sample_time) if data.drifts else 0.0

    def error_of(part, last=None):
        predicted = simulate_chain(
            hysteresis,
            part.creep,
            part.dynamics(sample_time),
            voltage[:last],
            sample_time,
            settled=part.settled,
            synchronous=synchronous,
            history=data.history,
        )
        return displacement[:last] - drift * sample_time * np.arange(len(predicted)) - predicted

    part = fit.part
    if part.lag > 0.0 and not synchronous and not part.hold:
        last = first + RETIMED_ON
        looked = used if kept is None else used[used < last]
        part = _retimed(part, sample_time, lambda other: float(np.std(error_of(other, last)[looked])))
    error = error_of(part)
    constant = float(error[used].mean())
    error = error[first:] - constant
    # what the half sample and the table leave of a constant belongs to the offset
    chosen = hysteresis.chosen
    chosen = replace(chosen, offset=chosen.offset + constant / part.settled_gain)
    hysteresis = replace(hysteresis, **{hysteresis.type: chosen})
    return HammersteinFit(
        hysteresis=hysteresis,
        creep=part.creep,
        dynamics=part.dynamics(sample_time),
        linear_part=part,
        sample_time=sample_time,
        rmse=float(np.sqrt(np.mean(error**2))),
        stroke=data.stroke,
        voltage_low=float(np.min(voltage)),
        voltage_high=float(np.max(voltage)),
        deviations=fit.deviations,
        warnings=fit.warnings,
        converged=fit.converged,
        synchronous=synchronous,
        history=data.history,
        skipped=first,
        drift=drift,
        numbers={**fit.numbers, **({"drift_m_per_s": drift} if data.drifts else {})},
    )


def _retimed(part: LinearPart, sample_time: float, cost) -> LinearPart:
    """Return the linear part with the lag at which the blocks fit best, which hold their input for a sample."""
    import scipy.optimize  # imported here because only fits need it

    low, high = max(part.lag - sample_time, 0.5 * part.lag), part.lag + sample_time
    found = scipy.optimize.minimize_scalar(
        lambda lag: cost(replace(part, lag=float(lag))), bounds=(low, high), method="bounded", options={"maxiter": 10}
    )
    return replace(part, lag=float(found.x)) if found.fun < cost(part) else part


def without_outliers(once, voltage, displacement) -> HammersteinFit:
    """Return the fit after samples far off were left out, and count them.

    Parameters
    ----------
    once : callable
        ``once(kept)`` fits to the samples that are True in ``kept``, None for all.
    voltage, displacement : array_like, shape (N,)
        [V] and [m].
    """
    kept, fit = None, once(None)
    for _ in range(ROUNDS):
        drift = fit.drift * fit.sample_time * np.arange(len(voltage))
        error = np.asarray(displacement, dtype=float) - drift - fit.simulate(voltage)
        good = near(error, fit.skipped)
        error = error - np.median(error[fit.skipped :])
        known = np.ones(len(good), dtype=bool) if kept is None else kept
        added = known & ~good
        used = np.flatnonzero(known)[np.flatnonzero(known) >= fit.skipped]
        many = np.count_nonzero(~good) > MOST_OUTLIERS * (len(error) - fit.skipped)
        if many or not matter(error, added, used):
            break
        kept = good
        fit = once(kept)
    outliers = 0 if kept is None else int(np.count_nonzero(~kept))
    return replace(fit, numbers={**fit.numbers, "outliers": float(outliers)}) if outliers else fit
