# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Yield: the share of axes that meet bounds, with the interval that its number of runs leaves it.

The interval is that of Clopper and Pearson (Biometrika 26, 1934): of all shares under which what was seen is not too
unlikely. It covers the true share with at least the stated confidence, whatever that share is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.sweeps.judging import METRICS, require_metrics
from hysteresis_ros.units import quantity, quantity_in

#: Endings of the names of metrics and their SI units; the first that fits counts.
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
    """What a metric may be.

    Parameters
    ----------
    metric : str
    low, high : float
        Ends, included, in the unit of the metric.
    """

    metric: str
    low: float
    high: float

    def met(self, values: np.ndarray) -> np.ndarray:
        """Return whether each value lies within; NaN does not.

        Parameters
        ----------
        values : ndarray
        """
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
    """How many runs meet all bounds.

    Parameters
    ----------
    good, runs : int
        How many meet them, and of how many.
    low, high : float
        Interval of the share.
    """

    good: int
    runs: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Part of the runs that meet all bounds."""
        return self.good / self.runs

    def __str__(self) -> str:
        low, share, high = (f"{100.0 * value:.4g}" for value in (self.low, self.share, self.high))
        return f"{share} % ({self.good} of {self.runs}), {low} … {high} %"


def parse_bound(text: str) -> Bound:
    """Return a bound in words: ``rms_error_m=10nm`` at most, ``stroke_m=9um:11um`` between, ``stroke_m=9um:`` at least.

    Parameters
    ----------
    text : str

    Raises
    ------
    ConfigurationError
        There is no such metric, or it is no bound.
    """
    name, mark, words = text.partition("=")
    (metric,) = require_metrics([name.strip()])
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
        raise ValueError(f"{text.strip()} is in {given}, {metric} in %")
    return 100.0 * value if given == "1" else value


def interval(good: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval of a share.

    Parameters
    ----------
    good, runs : int
        How many were seen, and of how many.
    confidence : float
        Probability with which it covers the true share at least.
    """
    missed = 0.5 * (1.0 - confidence)
    low = float(scipy.special.betaincinv(good, runs - good + 1, missed)) if good else 0.0
    high = float(scipy.special.betaincinv(good + 1, runs - good, 1.0 - missed)) if good < runs else 1.0
    return low, high


def yield_of(met: np.ndarray, confidence: float = 0.95) -> Yield:
    """Return a yield.

    Parameters
    ----------
    met : ndarray of bool, shape (runs,)
        Whether each run meets all bounds.
    confidence : float
    """
    good = int(np.count_nonzero(met))
    return Yield(good, len(met), *interval(good, len(met), confidence))


def met(results, bounds: Sequence[Bound]) -> np.ndarray:
    """Return whether each run came to its end and meets all bounds, shape (runs,).

    Parameters
    ----------
    results : Results
    bounds : sequence of Bound
    """
    found = results.good
    for bound in bounds:
        found = found & bound.met(results.metrics[bound.metric])
    return found
