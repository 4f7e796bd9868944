# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The page of a sweep: what was found, and pictures of it."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.sweep_plots import (
    Column,
    influence_figure,
    levels_figure,
    scatter_figure,
    share_figure,
    write_sweep_page,
)
from hysteresis_ros.sweeps.judging import METRICS
from hysteresis_ros.sweeps.plan import RANDOM
from hysteresis_ros.sweeps.summary import Summary, lines

#: Parameters against which a metric is drawn.
MOST_DRAWN = 6


def write(summary: Summary, path, title: str) -> None:
    """Write the page of a sweep.

    Parameters
    ----------
    summary : Summary
    path : path-like
        HTML file.
    title : str
        What was swept.

    Raises
    ------
    MissingExtraError
        Matplotlib or Jinja2 is not installed.
    RecordingError
        The file cannot be written.
    """
    results = summary.results
    write_sweep_page(
        path,
        f"Sweep of {title}",
        lines=lines(summary),
        asked=results.about["vary"],
        figures=figures(summary),
        configuration=results.about["configuration"],
    )


def figures(summary: Summary) -> list[tuple[str, object]]:
    """Return captions and figures of a sweep.

    Parameters
    ----------
    summary : Summary
    """
    results, found = summary.results, []
    drawn = {label: values for label, values in results.parameters.items() if values.dtype.kind in "if"}
    chosen = dict(list(drawn.items())[:MOST_DRAWN])
    bounds = {bound.metric: bound for bound in summary.bounds}
    for name, values in results.metrics.items():
        column, bound = _column(name, values), bounds.get(name)
        ends = () if bound is None else tuple(end for end in (bound.low, bound.high) if np.isfinite(end))
        if not np.any(np.isfinite(values)):
            continue
        found.append((f"{column.label}: share of the runs below", share_figure(column, ends)))
        if chosen:
            found.append((f"{column.label} over what varied", scatter_figure(column, chosen, ends)))
        at_levels = summary.at_levels
        if at_levels and len(summary.plan.counts) == 1:
            label = next(iter(at_levels[0][0]))
            levels = [levels[label] for levels, *_ in at_levels]
            spread = [metrics[name] for *_, metrics in at_levels]
            shares = [(one.share, one.low, one.high) for _, one, _ in at_levels] if summary.bounds else []
            found.append((f"{column.label} at each level", levels_figure(column, label, levels, spread, shares)))
    if summary.plan.design != RANDOM:
        known = {METRICS[one.metric][0]: (one.labels, one.columns) for one in summary.sensitivities if one.columns}
        if known:
            found.append(("What the metrics hang on", influence_figure(known)))
    return found


def _column(name: str, values: np.ndarray) -> Column:
    label, unit, factor = METRICS[name]
    return Column(f"{label} [{unit}]" if unit else label, np.asarray(values), factor)
