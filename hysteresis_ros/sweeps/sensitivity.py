# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which of the varied parameters a metric hangs on: variance shares after Sobol, elementary effects after Morris.

Both are SALib's (Herman and Usher, J. Open Source Software 2 (9), 2017), on the runs of a plan that was made for them:
Saltelli's for Sobol, trajectories for Morris.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.sweeps.plan import MORRIS_LEVELS, SOBOL, Plan

EXTRA = 'needs the extra: pip install "hysteresis_ros[sweep]"'


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sensitivity of one metric.

    Parameters
    ----------
    metric : str
    labels : tuple of str
        What varies.
    columns : dict of str to ndarray, shape (variations,)
        Of Sobol ``first`` and ``total``, parts of the variance; of Morris ``mean`` (of the sizes of the effects) and
        ``deviation``, in SI. With ``…_interval`` half the width of each interval.
    why : str
        Why there is none.
    """

    metric: str
    labels: tuple[str, ...]
    columns: dict[str, np.ndarray]
    why: str = ""


def require_library() -> None:
    """Refuse a sensitivity where SALib is not installed.

    Raises
    ------
    ConfigurationError
        It is not.
    """
    try:
        import SALib  # noqa: F401
    except ImportError:
        raise ConfigurationError(f"--sensitivity {EXTRA}") from None


def sensitivity(plan: Plan, metric: str, values: np.ndarray, confidence: float = 0.95) -> Sensitivity:
    """Return on which variations a metric hangs.

    Parameters
    ----------
    plan : Plan
        Of that design.
    metric : str
    values : ndarray, shape (runs,)
    confidence : float
        Of the intervals.
    """
    labels = tuple(one.label for one in plan.variations)
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing:
        return Sensitivity(metric, labels, {}, f"{missing} of {len(values)} runs have no value: narrow the ranges")
    if not np.ptp(values) > 0.0:
        return Sensitivity(metric, labels, {}, "the same in all runs")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pandas, which SALib uses
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
