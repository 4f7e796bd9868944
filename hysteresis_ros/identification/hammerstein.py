# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Hammerstein models: joint fits of hysteresis, creep, lag and delay, and comparison of structures on held-out data.

Lag and creep widen every loop. If the hysteresis had to explain this width, predictions at other speeds and amplitudes
would be wrong. Lag and creep are therefore parameters of their own: for each trial of the few parameters of the linear
part, constrained linear least squares gives the many weights of the hysteresis (variable projection), and the trial
with the smallest residual is chosen. Lag, creep and delay are tried one after the other; each is accepted if it reduces
the residual by :data:`.thresholds.LINEAR_PART`. Then outliers are removed, and the residual is computed with the
kernels of the nodes.

Structures with more freedom are compared on held-out data: each part of a recording is predicted from the rest of it. A
part consists of several intervals spread over the recording, because a single interval may be the only one with large
loops; its prediction would be an extrapolation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros.errors import HysteresisError, IdentificationError, ParameterError
from hysteresis_ros.identification.data import clipped_samples
from hysteresis_ros.identification.drift import Drift, drift_beside_creep, drift_threshold
from hysteresis_ros.identification.linear_systems import Known, LinearPart
from hysteresis_ros.identification.plant_model import PlantModel, simulate_chain
from hysteresis_ros.identification.preprocessing import (
    Condensed,
    cleaning_notes,
    condense,
    notable_outliers,
    repeated,
)
from hysteresis_ros.identification.thresholds import (
    DELAY_OR_LAG,
    LINEAR_PART,
    SETTLED_START,
    STANDARD_ERRORS,
    STRUCTURE,
    Threshold,
)
from hysteresis_ros.identification.validation import parameter_covariance
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.recordings.loops import turning_points

#: Largest lag and largest delay, as a fraction of the slow half cycle, or of the mean half cycle if it is longer.
LONGEST_LAG = 0.6
#: Initial lag of a search, as a fraction of the mean half cycle.
FIRST_LAG = 0.12
#: Initial delay of a search, as a fraction of the mean half cycle.
FIRST_DELAY = 0.03
#: This fraction of a voltage's power lies below the frequency of its slow half cycle.
SLOW_PART = 0.1
#: A value lies at an end of its range if its distance from the end is below this fraction of the range.
AT_END = 1e-4
#: Largest creep rate per decade.
LARGEST_RATE = 0.05
MOST_EVALUATIONS = 40
#: Step of the derivatives, as a fraction of the parameter.
RELATIVE_STEP = 1e-3
#: Smallest step of the derivatives, as a fraction of the parameter's range.
SMALLEST_STEP = 1e-6
#: Singular values of the sensitivities below this fraction of the largest one are rounding errors.
SMALLEST_VALUE = 3e-8


@dataclass(frozen=True, eq=False, kw_only=True)
class HammersteinFit(PlantModel):
    """A plant identified together with its linear part, and the figures of the fit."""

    linear_part: LinearPart
    rmse: float  #: RMS residual of the fit [m], including outliers.
    stroke: float  #: Peak-to-peak displacement of the fitted samples [m].
    #: Standard deviations of ``lag`` [s], ``delay`` [s], ``creep_rate`` and the shape parameters of the hysteresis,
    #: including the effect of the correlation of the residual.
    deviations: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    converged: bool = True  #: False: the search reached its limit of evaluations; this is the best point found.
    skipped: int = 0  #: Number of samples at the beginning of the recording that the fit omits.
    drift: float = 0.0  #: Drift of the output that is independent of the voltage [m/s]; not part of the model.
    #: Standard deviation of the drift [m/s], also if no drift is found: a smaller drift cannot be distinguished from
    #: creep.
    drift_deviation: float = math.nan
    numbers: dict[str, float] = field(default_factory=dict)  #: Further figures of the fit, by names with units.
    kept_rmse: float = math.nan  #: RMS residual without outliers [m]; comparable with the held-out error.
    structure: Any = None  #: Structure that was chosen, for use in a repeated fit.

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences about drift and outliers, which are not part of the model."""
        return cleaning_notes(self.drift, int(self.numbers.get("outliers", 0)))


def search_linear_part(search: PartSearch, linear, guess=None):
    """Try lag, creep and delay one after the other, and accept each if it reduces the residual enough.

    ``guess`` holds initial values of the searches, by name.
    """
    known, linear = (linear.part, linear.parts) if isinstance(linear, Known) else (LinearPart(), linear)
    unknown = sorted(set(linear) - {"lag", "delay", "creep"})
    if unknown:
        raise IdentificationError(f"linear part {', '.join(unknown)}: must be any of lag, delay and creep, or empty")
    data = search.data
    # the creep of a remanent actuator had settled before the recording; after rest at 0 V, creep starts at zero
    settled = known.settled or bool(data.history)
    base = replace(known, longest_time=max(1.0, len(data.voltage) * data.sample_time), settled=settled)
    held = replace(base, hold=data.sample_time / data.factor)
    kept: list[str] = []
    guess = guess or {}
    found = search.run(kept, guess, base)
    for part in ("lag", "creep", "delay"):
        if part not in linear:
            continue
        # alternatives must fit clearly better: creep that had settled under the first voltage, instead of a start at
        # rest at 0 V as in the nodes; a held input, instead of an input that is linear between the samples
        bases, threshold = [base], LINEAR_PART
        if part == "lag" and not base.hold:
            bases.append(held)
        if part == "creep" and not base.settled:
            bases, threshold = [base, replace(base, settled=True)], SETTLED_START
        trials = [search.run([*kept, part], {**guess, **found.values}, start) for start in bases]
        better = int(len(trials) == 2 and threshold.improves(trials[1].spread, trials[0].spread))
        if LINEAR_PART.improves(trials[better].spread, found.spread):
            kept.append(part)
            base, found = bases[better], trials[better]
        elif part == "delay" and "lag" in kept:
            found = _less_certain(found, trials[0])
    if "lag" in kept and "delay" in linear:
        kept, found = _told_apart(search, kept, base, found)
    return kept, base, found


def _told_apart(search: PartSearch, kept, base: LinearPart, found: PartTrial):
    """Keep only the lag or only the delay unless both together fit clearly better."""
    others = [part for part in kept if part not in ("lag", "delay")]
    late = split_values(base, found.values)[0].group_delay
    delayed = search.run([*others, "delay"], {**found.values, "delay": late}, base)
    lagging = search.run([*others, "lag"], {**found.values, "lag": late}, base) if "delay" in kept else found
    # positioners usually have a lag: a delay must be clearly visible, and both together must be better than either
    # alone
    as_good = delayed.spread < (1.0 + LINEAR_PART.part) * found.spread
    if DELAY_OR_LAG.improves(delayed.spread, lagging.spread) and as_good:
        return [*others, "delay"], _less_certain(delayed, found)
    if "delay" in kept and lagging.spread < (1.0 + DELAY_OR_LAG.part) * found.spread:
        return [*others, "lag"], _less_certain(lagging, found)
    return kept, found


def _less_certain(found: PartTrial, both: PartTrial) -> PartTrial:
    """Return a trial of lag or delay alone, with deviations that include the difference from the trial with both."""
    deviations = dict(found.deviations or {})
    for name in ("lag", "delay"):
        if name in deviations and name in both.values:
            deviations[name] = float(np.hypot(deviations[name], both.values[name] - found.values[name]))
    return found._replace(deviations=deviations)


class PartTrial(NamedTuple):
    """Best fit with some of the parts: values by name, residual [m], deviations, and whether the search converged."""

    values: dict
    residual: np.ndarray
    deviations: dict | None
    converged: bool

    @property
    def spread(self) -> float:
        """Standard deviation of the residual [m]."""
        return np.std(self.residual)


class PartSearch:
    """Search for the parameters of the linear part and of the shape, each within its range.

    ``solve(part, shape)`` returns the residual [m] with the best weights. ``slopes(part, shape, neighbours)`` returns
    the changes of this residual [m], shape (N, k), from the last solved point to k neighbours, each a pair of part and
    shape. Without ``slopes`` the residual is solved for every neighbour.
    """

    def __init__(self, solve, data: Condensed, extra: tuple, progress, slopes=None):
        self.solve, self.data, self.extra, self.progress, self.slopes = solve, data, extra, progress, slopes
        half_cycle = data.sample_time * len(data.voltage) / max(len(turning_points(data.voltage)) - 1, 1)
        longest = LONGEST_LAG * max(half_cycle, _slow_half_cycle(data))
        #: For each part: name of its parameter, initial value, lower and upper limit.
        self.ranges = {
            "lag": ("lag", FIRST_LAG * half_cycle, 0.0, longest),
            "delay": ("delay", FIRST_DELAY * half_cycle, 0.0, longest),
            "creep": ("creep_rate", 0.01, 0.0, LARGEST_RATE),
        }
        self.calls = 0

    def run(self, parts, start: dict, base: LinearPart) -> PartTrial:
        """Return the best values of the shape and of the given parts; ``start`` contains initial values."""
        from scipy.optimize import least_squares  # imported here because only fits need it

        table = {name: row for name, *row in [*self.extra, *(self.ranges[part] for part in parts)]}
        keys = list(table)
        if not keys:
            return PartTrial({}, self.solve(base, {}), None, True)
        scale = np.array([table[key][2] - table[key][1] for key in keys])
        low = np.array([table[key][1] for key in keys]) / scale
        guess = np.array([start.get(key, table[key][0]) for key in keys]) / scale

        last = np.full(len(keys), np.nan)

        def at(z):
            return split_values(base, dict(zip(keys, z * scale, strict=True)))

        def residual(z):
            self.calls += 1
            last[:] = z
            result = self.solve(*at(z)) / self.data.stroke
            if self.progress is not None:
                self.progress(self.calls, float(np.sqrt(np.mean(result**2))) * self.data.stroke)
            return result

        def jacobian(z):
            if not np.array_equal(z, last):
                self.solve(*at(z))
                last[:] = z
            steps = np.maximum(RELATIVE_STEP * np.abs(z), SMALLEST_STEP)
            steps = np.where(z + steps > low + 1.0, -steps, steps)
            return self.slopes(*at(z), [at(other) for other in z + np.diag(steps)]) / (steps * self.data.stroke)

        inside = np.clip(guess, low + 1e-3, low + 1.0 - 1e-3)
        how: dict[str, Any] = {"diff_step": RELATIVE_STEP} if self.slopes is None else {"jac": jacobian}
        found = least_squares(
            residual, inside, bounds=(low, low + 1.0), xtol=1e-5, ftol=1e-6, max_nfev=MOST_EVALUATIONS, **how
        )
        values = dict(zip(keys, found.x * scale, strict=True))
        # a parameter at its bound has no column in the Jacobian
        covariance = parameter_covariance(found.jac, found.fun, truncated=SMALLEST_VALUE, correlated=True)
        deviations = dict(zip(keys, np.sqrt(np.diag(covariance)) * scale, strict=True))
        return PartTrial(values, found.fun * self.data.stroke, deviations, found.status > 0)

    def at_ends(self, parts, values: dict):
        """Yield a warning for each parameter that lies at an end of its range."""
        for name, _, low, high in [*self.extra, *(self.ranges[part] for part in parts)]:
            if min(values[name] - low, high - values[name]) < AT_END * (high - low) and name != "delay":
                yield (
                    f"{name} = {values[name]:.4g} lies at the end of its range {low:.3g} … {high:.3g}: the data does "
                    "not determine it"
                )


def _slow_half_cycle(data: Condensed) -> float:
    """Return the half cycle [s] of the frequency below which SLOW_PART of the voltage's power lies."""
    power = np.cumsum(np.abs(np.fft.rfft(data.voltage - np.mean(data.voltage))) ** 2)
    line = max(int(np.searchsorted(power, SLOW_PART * power[-1])), 1)
    return 0.5 * data.sample_time * len(data.voltage) / line


def split_values(base: LinearPart, values: dict) -> tuple[LinearPart, dict]:
    """Split fitted values: return the linear part with its values, and the remaining values (of the shape)."""
    own: dict[str, Any] = {name: float(values[name]) for name in ("lag", "delay", "creep_rate") if name in values}
    return replace(base, **own), {name: float(value) for name, value in values.items() if name not in own}


#: Number of samples for the last search of the lag, which uses the blocks of the nodes.
RETIMED_ON = 20000


def finished(fit, voltage, displacement, sample_time, kept=None, clipped=None) -> HammersteinFit:
    """Return the result of a fit; its residual on the recording itself is computed with the kernels of the nodes.

    The residual omits samples at which the sensor was ``clipped``, shape (N,) of bool.

    Units: ``voltage`` [V], ``displacement`` [m], ``sample_time`` [s].
    """
    voltage, displacement = (np.ascontiguousarray(values, dtype=float) for values in (voltage, displacement))
    data = fit.data
    hysteresis: HysteresisParameters = fit.parameters()
    first = data.skipped
    used: Any = slice(first, None) if kept is None else np.flatnonzero(kept[first:]) + first
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
    error = (error if clipped is None else np.where(clipped, constant, error))[first:] - constant
    # constant errors, from the half-sample delay and from the tabulated map, are added to the offset
    chosen: Any = hysteresis.chosen  # the class of the parameters depends on the model
    chosen = replace(chosen, offset=chosen.offset + constant / part.settled_gain)
    own: dict[str, Any] = {hysteresis.type: chosen}
    hysteresis = replace(hysteresis, **own)
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
    """Return the linear part with the lag that fits best if blocks hold their input for a sample."""
    import scipy.optimize  # imported here because only fits need it

    low, high = max(part.lag - sample_time, 0.5 * part.lag), part.lag + sample_time
    found = scipy.optimize.minimize_scalar(
        lambda lag: cost(replace(part, lag=float(lag))), bounds=(low, high), method="bounded", options={"maxiter": 10}
    )
    return replace(part, lag=float(found.x)) if found.fun < cost(part) else part


def robust_fit(
    voltage, displacement, sample_time: float, choose, again=None, *, skip=None, history=(), before=None
) -> tuple[HammersteinFit, Any]:
    """Return the fit without outliers, and the fitted structure.

    ``choose(data)`` finds a structure on blocks of the recording. ``again(before, data, settled)`` fits the same
    structure without the outliers, with a drift if the fit before has one; without ``again`` the structure is chosen
    again. ``settled`` is true from the second repetition on, when few outliers are left; the structure of the dynamics
    is then kept.
    """
    structure, repetitions = before, 0
    clipped = clipped_samples(np.asarray(displacement, dtype=float), np.asarray(voltage, dtype=float))

    def fit(kept, _):
        nonlocal structure, repetitions
        data = condense(voltage, displacement, sample_time, skip, kept=kept, history=history)
        if structure is None or again is None:
            structure = choose(data)
        else:
            structure = again(structure, replace(data, drifts=structure.data.drifts), repetitions > 1)
        repetitions += 1
        return finished(structure, voltage, displacement, sample_time, kept, clipped)

    def look(found: HammersteinFit, kept):
        drift = found.drift * sample_time * np.arange(len(voltage))
        error = np.asarray(displacement, dtype=float) - drift - found.simulate(voltage)
        error[clipped] = np.median(error)
        good = notable_outliers(error, found.skipped, kept)
        return None if good is None else good & ~clipped

    kept, found = repeated(fit, look, ~clipped if clipped.any() else None)
    outliers = 0 if kept is None else int(np.count_nonzero(~kept & ~clipped))
    deviation = seen_drift(structure).deviation
    numbers = (
        found.numbers | {"drift_deviation_m_per_s": deviation} | ({"outliers": float(outliers)} if outliers else {})
    )
    found = replace(found, drift_deviation=deviation, numbers=numbers, kept_rmse=structure.rms)
    return found, structure


#: Number of held-out parts.
PARTS = 5
#: Default number of intervals in each held-out part.
STRETCHES_OF_A_PART = 4


def held_out(fit, stretches: int = STRETCHES_OF_A_PART) -> np.ndarray:
    """Return the errors [m] on held-out samples, shape (number of samples,).

    The first rise from rest is never held out, because no later sample shows the same behaviour.
    """
    data, fit = fit.data, copy(fit)  # the copy caches values common to all parts, and is then released
    places = np.arange((data.erased or data.first) - data.first, len(data.kept))
    errors = np.zeros(len(data.kept))
    for part in _parts(places, stretches):
        left_out = np.zeros(len(errors), dtype=bool)
        left_out[part] = True
        other = fit.refitted(replace(data, kept=data.kept & ~left_out))
        errors[part] = (data.displacement - other.output())[data.first :][part]
    return errors[places][data.kept[places]]


def judged_again(fit, before):
    """Return a fit with the figures of the earlier fit, but with its own held-out error.

    The held-out error is computed again if there are more outliers than before, or if the modes have changed.
    """
    fit.numbers = {**before.numbers, **fit.numbers}
    fewer = np.count_nonzero(~fit.data.kept) > np.count_nonzero(~before.data.kept)
    if "held_out_rmse_m" in fit.numbers and (fewer or fit.part.modes != before.part.modes):
        fit.numbers["held_out_rmse_m"] = float(np.sqrt(np.mean(held_out(fit) ** 2)))
    return fit


def _parts(places, stretches: int) -> list[np.ndarray]:
    """Return the samples of each held-out part."""
    found = np.array_split(places, PARTS * stretches)
    return [np.concatenate(found[part::PARTS]) for part in range(PARTS)]


def survivor(fits, stretches: int = STRETCHES_OF_A_PART, thresholds: Sequence[Threshold] = (STRUCTURE,)):
    """Return the chosen fit, and the RMS error [m] of each fit on held-out parts."""
    chosen, least, sizes = fits[0], None, []
    rows = list(thresholds) * (len(fits) if len(thresholds) == 1 else 1)
    for fit, threshold in zip(fits, rows, strict=True):
        errors = held_out(fit, stretches)
        sizes.append(float(np.sqrt(np.mean(errors**2))))
        if least is None:
            least = errors
            continue
        gain = least**2 - errors**2
        gains = np.array([np.mean(gain[part]) for part in _parts(np.arange(len(gain)), stretches)])
        sure = gains.mean() > STANDARD_ERRORS * gains.std(ddof=1) / np.sqrt(PARTS)
        if threshold.improves(sizes[-1], np.sqrt(np.mean(least**2))) and sure:
            chosen, least = fit, errors
    return chosen, sizes


def invalid(fit) -> HysteresisError | None:
    """Return the reason why the parameters of a fit are not a valid model; None if they are valid."""
    try:
        hysteresis_block(fit.parameters(), fit.data.sample_time)
    except (IdentificationError, ParameterError) as error:
        return error
    return None


def usable(fits: list) -> list:
    """Return the fits whose parameters are a valid model; if no fit is valid, raise the error of the first fit."""
    found = [fit for fit in fits if invalid(fit) is None]
    if not found:
        error = invalid(fits[0])
        raise error if error is not None else IdentificationError("there is no fit")
    return found


def require_rising(scale: float) -> None:
    """Raise IdentificationError if the weights of a fit do not add up to a positive gain."""
    if not scale > 0.0:
        raise IdentificationError("the displacement falls where the voltage rises; check the columns, or use --negate")


def without_drift(fit, data):
    """Return ``fit(data)``, with a drift if it exceeds creep and improves the prediction of held-out blocks."""
    still = fit(data)
    if invalid(still) is None and not seen_drift(still).certain:
        return still
    threshold = drift_threshold(data.counted(data.voltage))
    return survivor(usable([still, fit(replace(data, drifts=True))]), stretches=1, thresholds=(threshold,))[0]


def seen_drift(fit) -> Drift:
    """Return the drift, in addition to creep, that the residual of a fit shows."""
    output, data = fit.output(), fit.data
    moved = output - data.constants @ fit.constants
    return drift_beside_creep(data, moved, data.counted(data.displacement - output), fit.part.settled)
