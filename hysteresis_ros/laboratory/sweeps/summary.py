# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Summary of a sweep: yield, sensitivities and figures, as text and as JSON.

The interval of a yield is the Clopper-Pearson interval (Biometrika 26, 1934): it covers the true fraction with at least
the stated confidence.

SALib computes the sensitivities (Herman and Usher, J. Open Source Software 2 (9), 2017) from runs that are planned for
this analysis: Saltelli's points for Sobol, trajectories for Morris.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from hysteresis_ros.analysis.tables import format_value, shown
from hysteresis_ros.errors import ConfigurationError, shortened
from hysteresis_ros.laboratory.sweeps.plan import MORRIS_LEVELS, RANDOM, SOBOL, Levels, Plan
from hysteresis_ros.laboratory.sweeps.study import BETWEEN, METRICS, require_metrics
from hysteresis_ros.laboratory.sweeps.sweep import Results
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.units import quantity, quantity_in

#: Suffixes of metrics and their SI units; the first suffix that matches is used.
_UNITS = {
    "_m_s": "",
    "_v_s": "",
    "_percent_of_stroke": "%",
    "_percent": "%",
    "_m": "m",
    "_s": "s",
    "_hz": "Hz",
    "_v": "V",
}


@dataclass(frozen=True)
class Bound:
    """Bound of a metric."""

    metric: str
    low: float  #: low, high: Inclusive ends, in the unit of the metric.
    high: float

    def met(self, values: np.ndarray) -> np.ndarray:
        """Return whether each value lies within the bound; NaN does not."""
        return (values >= self.low) & (values <= self.high)

    def __str__(self) -> str:
        _, unit, factor = METRICS[self.metric]
        unit = f" {unit}" if unit else ""
        if self.low == -math.inf:
            return f"{self.metric} ≤ {self.high * factor:.4g}{unit}"
        if self.high == math.inf:
            return f"{self.metric} ≥ {self.low * factor:.4g}{unit}"
        return f"{self.low * factor:.4g} ≤ {self.metric} ≤ {self.high * factor:.4g}{unit}"


@dataclass(frozen=True)
class Yield:
    """Yield: the fraction of the runs that meet all bounds."""

    good: int  #: good, runs: Number of runs that meet the bounds, and of all runs.
    runs: int
    low: float  #: low, high: Interval of the fraction.
    high: float

    @property
    def share(self) -> float:
        """Fraction of the runs that meet all bounds."""
        return self.good / self.runs

    def __str__(self) -> str:
        low, share, high = (f"{100.0 * value:.4g}" for value in (self.low, self.share, self.high))
        return f"{share} % ({self.good} of {self.runs}), {low} … {high} %"


def parse_bound(text: str, axis: AxisParameters | None = None) -> Bound:
    """Return the bound in a text: ``rms_error_m=1nm`` (maximum), ``stroke_m=9um:`` (minimum), ``stroke_m=9um:11um``."""
    if not isinstance(text, str):
        raise ConfigurationError(f"bound = {shortened(text)}: must be a text such as 'rms_error_m=10nm'")
    name, mark, words = text.partition("=")
    (metric,) = require_metrics([name.strip()], axis)
    low, colon, high = words.rpartition(":")
    try:
        ends = [_value(metric, word) if word.strip() else None for word in (low, high)]
    except ValueError as error:
        raise ConfigurationError(f"--bound {text}: {error}") from None
    bound = Bound(
        metric, *(end if end is not None else sign * math.inf for end, sign in zip(ends, (-1, 1), strict=True))
    )
    if not mark or ends == [None, None] or not bound.low <= bound.high:
        raise ConfigurationError(f"--bound {text}: write NAME=MAXIMUM, NAME=MINIMUM:MAXIMUM or NAME=MINIMUM:")
    return bound


def _value(metric: str, text: str) -> float:
    unit = next((unit for ending, unit in _UNITS.items() if metric.endswith(ending)), "")
    if unit != "%":
        return quantity_in(text, unit)
    value, given = quantity(text)
    if given not in ("", "1"):
        raise ValueError(f"{text.strip()} is in {given}, but {metric} is in %")
    return 100.0 * value if given == "1" else value


def interval(good: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval of a fraction."""
    missed = 0.5 * (1.0 - confidence)
    low = float(scipy.special.betaincinv(good, runs - good + 1, missed)) if good else 0.0
    high = float(scipy.special.betaincinv(good + 1, runs - good, 1.0 - missed)) if good < runs else 1.0
    return low, high


def yield_of(met: np.ndarray, confidence: float = 0.95) -> Yield:
    """Return the yield from one flag per run: whether it meets all bounds."""
    good = int(np.count_nonzero(met))
    return Yield(good, len(met), *interval(good, len(met), confidence))


def met(results, bounds: Sequence[Bound]) -> np.ndarray:
    """Return whether each run finished and meets all bounds, shape (runs,)."""
    found = results.good
    for bound in bounds:
        found = found & bound.met(results.metrics[bound.metric])
    return found


EXTRA = 'needs the extra: pip install "hysteresis_ros[sweep]"'


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sensitivity of one metric."""

    metric: str
    labels: tuple[str, ...]  #: Names of the varied parameters.
    #: shape (variations,); For Sobol ``first`` and ``total``, fractions of the variance; for Morris ``mean`` (of the
    #: absolute effects) and ``deviation``, in SI. ``…_interval`` is half the width of each confidence interval.
    columns: dict[str, np.ndarray]
    why: str = ""  #: Reason why there is no sensitivity.


def require_library() -> None:
    """Refuse a sensitivity analysis if SALib is not installed."""
    try:
        import SALib  # noqa: F401
    except ImportError:
        raise ConfigurationError(f"--sensitivity {EXTRA}") from None


def sensitivity(plan: Plan, metric: str, values: np.ndarray, confidence: float = 0.95) -> Sensitivity:
    """Return the sensitivity of a metric to the variations."""
    labels = tuple(one.label for one in plan.variations)
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing:
        return Sensitivity(
            metric, labels, {}, f"{missing} of {len(values)} runs have no value: narrow the ranges of the parameters"
        )
    if not np.ptp(values) > 0.0:
        return Sensitivity(metric, labels, {}, "the same in all runs")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of pandas, which SALib uses
        columns = _sobol(plan, values, confidence) if plan.design == SOBOL else _morris(plan, values, confidence)
    return Sensitivity(metric, labels, {name: np.asarray(found, dtype=float) for name, found in columns.items()})


def _sobol(plan: Plan, values: np.ndarray, confidence: float) -> dict[str, np.ndarray]:
    from SALib.analyze import sobol

    found = sobol.analyze(plan.problem, values, calc_second_order=False, conf_level=confidence, seed=plan.seed)
    names = {"first": "S1", "first_interval": "S1_conf", "total": "ST", "total_interval": "ST_conf"}
    return {name: found[theirs] for name, theirs in names.items()}


def _morris(plan: Plan, values: np.ndarray, confidence: float) -> dict[str, np.ndarray]:
    from SALib.analyze import morris

    options = dict(num_levels=MORRIS_LEVELS, conf_level=confidence, seed=plan.seed)
    found = morris.analyze(plan.problem, plan.designed, values, **options)
    return {"mean": found["mu_star"], "mean_interval": found["mu_star_conf"], "deviation": found["sigma"]}


#: Maximum number of combinations of levels that are listed.
LISTED = 25
#: Fraction of the runs above the printed quantile.
TAIL = 0.05
SIX = 6  # digits of a printed parameter


@dataclass(frozen=True, eq=False)
class Summary:
    """Summary of a sweep."""

    results: Results
    plan: Plan
    bounds: tuple[Bound, ...] = ()
    confidence: float = 0.95  #: Confidence of all intervals.
    #: Sensitivity of each metric, if the plan is one of a sensitivity analysis.
    sensitivities: tuple[Sensitivity, ...] = field(init=False)

    def __post_init__(self):
        """Compute the sensitivities."""
        found: tuple[Sensitivity, ...] = ()
        if self.plan.design != RANDOM:
            metrics = self.results.metrics.items()
            found = tuple(sensitivity(self.plan, name, values, self.confidence) for name, values in metrics)
        object.__setattr__(self, "sensitivities", found)

    @property
    def met(self) -> np.ndarray:
        """Whether each run finished and meets all bounds, shape (runs,)."""
        return met(self.results, self.bounds)

    @property
    def yield_(self) -> Yield:
        """Fraction of all runs that meet all bounds."""
        return yield_of(self.met, self.confidence)

    @property
    def at_levels(self) -> list[tuple[dict, Yield, dict[str, np.ndarray]]]:
        """Levels, yield and metrics of the runs at each combination of levels; empty if there are no draws."""
        plan, found = self.plan, []
        if not plan.counts or plan.design != RANDOM or not plan.spreads:
            return []
        labels = [one.label for one in plan.variations if isinstance(one.over, Levels)]
        passed = self.met
        for place in range(plan.combinations):
            here = slice(place, None, plan.combinations)
            levels = {label: self.results.parameters[label][place] for label in labels}
            metrics = {name: values[here] for name, values in self.results.metrics.items()}
            found.append((levels, yield_of(passed[here], self.confidence), metrics))
        return found

    def worst(self, metric: str) -> int | None:
        """Return the number of the run with the largest absolute metric; None if no run has a value."""
        values = np.abs(self.results.metrics[metric])
        return int(np.nanargmax(values)) if np.any(np.isfinite(values)) else None


def lines(summary: Summary) -> list[str]:
    """Return the summary as text."""
    results, plan = summary.results, summary.plan
    drawn = f", {plan.combinations} levels" if plan.counts else ""
    text = [f"{len(results)} runs, seed {plan.seed}, {plan.design}{drawn}: {', '.join(results.about['labels'])}"]
    text += [_metric_line(summary, name) for name in results.metrics]
    for count, what in ((np.count_nonzero(results.tripped), "tripped (unstable, out of travel)"),):
        text += [f"{count} of {len(results)} runs {what}"] if count else []
    if summary.bounds:
        text += _yield_lines(summary)
    for found in summary.sensitivities:
        text += _sensitivity_lines(found, summary.confidence)
    return [*text, *refusals(results)]


def refusals(results: Results) -> list[str]:
    """Return a line about the runs whose axis could not be built, with the first reason; empty if all were built."""
    numbers = np.flatnonzero(results.refused != "")
    if not numbers.size:
        return []
    first = int(numbers[0])
    return [f"{numbers.size} of {len(results)} runs were refused; run {first}: {results.refused[first]}"]


def _metric_line(summary: Summary, name: str) -> str:
    label, unit, factor = METRICS[name]
    values = summary.results.metrics[name]
    known = values[np.isfinite(values)]
    where = ", between the samples" if name in BETWEEN[:-1] else ""
    largest = summary.worst(name)
    if largest is None:
        return f"{name} ({label}): no run has a value"
    quantiles = [" ".join(shown(float(value), unit, factor)) for value in np.quantile(known, (0.5, 1.0 - TAIL))]
    worst = " ".join(shown(float(values[largest]), unit, factor))
    missing = f"; {values.size - known.size} runs have no value" if known.size < values.size else ""
    return (
        f"{name} ({label}{where}): median {quantiles[0]}, {100.0 * (1.0 - TAIL):g} % below {quantiles[1]}, "
        f"worst {worst} in run {largest} ({_stood_for(summary.results, largest)}){missing}"
    )


def _stood_for(results: Results, run: int) -> str:
    values = ((label, column[run]) for label, column in results.parameters.items())
    return ", ".join(f"{label} = {_shown(value)}" for label, value in values)


def _shown(value) -> str:
    return f"{value:.{SIX}g}" if isinstance(value, float) else str(value)


def _yield_lines(summary: Summary) -> list[str]:
    bounds = " and ".join(map(str, summary.bounds))
    if not summary.plan.spreads or summary.plan.design != RANDOM:
        good = int(np.count_nonzero(summary.met))
        return [f"{good} of {len(summary.results)} points meet {bounds} (no draws: no interval)"]
    how = f"{100.0 * summary.confidence:g} % interval of Clopper and Pearson"
    each = summary.at_levels
    if not each:
        return [f"yield {summary.yield_}, {how}: {bounds}"]
    order = sorted(each, key=lambda one: -one[1].share) if len(each) > LISTED else each
    text = [f"yield, {how}: {bounds}"]
    for levels, found, _ in order[:LISTED]:
        text.append(f"  {', '.join(f'{label} = {_shown(value)}' for label, value in levels.items())}: {found}")
    return [*text, f"  … {len(each) - LISTED} more"] if len(each) > LISTED else text


def _sensitivity_lines(found: Sensitivity, confidence: float) -> list[str]:
    if found.why:
        return [f"{found.metric}: no sensitivity: {found.why}"]
    if "first" in found.columns:
        heading = (
            f"{found.metric}: fraction of its variance by each parameter alone, and including interactions (± "
            f"{confidence:g} interval)"
        )
        pairs, factor = ("first", "total"), 1.0
    else:
        _, unit, factor = METRICS[found.metric]
        heading = f"{found.metric}: mean size and deviation of elementary effects [{unit}]"
        pairs = ("mean", "deviation")
    text = [heading]
    for i, label in enumerate(found.labels):
        words = []
        for name in pairs:
            width = found.columns.get(f"{name}_interval")
            around = f" ± {format_value(float(width[i]), factor)}" if width is not None else ""
            words.append(f"{name} {format_value(float(found.columns[name][i]), factor)}{around}")
        text.append(f"  {label}: {', '.join(words)}")
    return text


def to_json(summary: Summary) -> dict:
    """Return the summary as JSON data, in SI."""
    results = summary.results
    metrics = {}
    for name, values in results.metrics.items():
        known, worst = values[np.isfinite(values)], summary.worst(name)
        metrics[name] = {
            "runs": int(known.size),
            "median": float(np.median(known)) if known.size else None,
            "quantile": float(np.quantile(known, 1.0 - TAIL)) if known.size else None,
            "worst": None if worst is None else float(values[worst]),
            "worst_run": worst,
        }
    found = {
        "runs": len(results),
        "tripped": int(np.count_nonzero(results.tripped)),
        "refused": int(np.count_nonzero(results.refused != "")),
        "about": {name: value for name, value in results.about.items() if name != "configuration"},
        "metrics": metrics,
    }
    if summary.bounds:
        found["bounds"] = list(map(str, summary.bounds))
        found["yield"] = _yield_json(summary.yield_)
        found["levels"] = [
            {"levels": {label: _plain(value) for label, value in levels.items()}, **_yield_json(one)}
            for levels, one, _ in summary.at_levels
        ]
    if summary.sensitivities:
        found["sensitivity"] = {
            one.metric: {
                "why": one.why,
                **{
                    name: dict(zip(one.labels, map(float, values), strict=True)) for name, values in one.columns.items()
                },
            }
            for one in summary.sensitivities
        }
    return found


def _yield_json(found: Yield) -> dict:
    return {"good": found.good, "runs": found.runs, "share": found.share, "low": found.low, "high": found.high}


def _plain(value):
    return value.item() if isinstance(value, np.generic) else value
