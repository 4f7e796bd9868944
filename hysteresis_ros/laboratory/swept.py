# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hr.sweep``: the command ``hysteresis sweep`` as a function for scripts."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence

from hysteresis_ros.api import Source, configuration_of
from hysteresis_ros.arguments import Seconds, checked
from hysteresis_ros.laboratory.sweeps.plan import RANDOM, Range, make_plan, parse_variations
from hysteresis_ros.laboratory.sweeps.study import Study, require_metrics
from hysteresis_ros.laboratory.sweeps.summary import Summary, lines, parse_bound, require_library
from hysteresis_ros.laboratory.sweeps.sweep import sweep as make_runs
from hysteresis_ros.loop.reach import single_axis

__all__ = ["Swept", "sweep"]


class Swept(Summary):  # numpydoc ignore=PR01
    """Result of a sweep; ``print`` shows the lines of ``hysteresis sweep``.

    ``results.parameters`` and ``results.metrics`` map names to arrays with one value per run [SI]. ``yield_`` is the
    fraction of runs that meet all bounds, and ``met`` states for each run whether it meets them. ``sensitivities``
    contains the requested sensitivities.
    """

    def __str__(self) -> str:
        return "\n".join(lines(self))


@checked
def sweep(
    config: Source,
    vary: Sequence[str] | Mapping[str, str | Range | Sequence[object]],
    path: str | os.PathLike[str] | None = None,
    *,
    runs: int | None = None,
    metrics: str | Sequence[str] = (),
    bounds: str | Sequence[str] = (),
    sensitivity: str | None = None,
    duration: Seconds | None = None,
    seed: int = 1,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] | None = None,
    namespace: str | None = None,
) -> Swept:
    """Run an axis offline many times with varied parameters.

    Parameters
    ----------
    config : path-like, Configuration, Identified, Design or Recording
        The axis, see :func:`.simulate`.
    vary : mapping of str to Within, Normal, Uniform, LogUniform, Levels, sequence or str; or sequence of str
        Varied parameters with their ranges: ``{"plant_simulator": hr.Within(0.05), "motion_controller.pid.Kp": [0.1,
        0.2]}``, or the same in the form of the command: ``["plant_simulator=±5%", "motion_controller.pid.Kp=0.1,0.2"]``
        (``docs/sweeps.md``).
    path : path-like, optional
        File for the results, ``.parquet`` or ``.npz``; an interrupted sweep continues from it.
    runs : int, optional
        Total number of runs; not needed if all ranges are levels.
    metrics : str or sequence of str
        Figures of a report to store; by default ``rms_error_m``, for an inchworm motor ``final_error_rms_m``.
    bounds : str or sequence of str
        Requirements on a run: ``"rms_error_m=10nm"``.
    sensitivity : str, optional
        ``sobol`` or ``morris``: plan the runs for this analysis (needs ``pip install "hysteresis_ros[sweep]"``).
    duration : float or str, optional
        Length of each run [s], or a text with its unit such as ``"10ms"``.
    seed : int
        Seed of the draws; equal seeds give equal runs.
    workers : int, optional
        Processes; by default as many as there are processors.
    scheduler : str, optional
        Address of a Dask scheduler; its workers execute the runs instead of local processes.
    progress : callable, optional
        Called with the number of finished runs.
    namespace : str, optional
        Name of the axis, if the configuration contains several.

    Returns
    -------
    Swept
        With ``results``, ``yield_`` and ``worst(metric)``; ``print`` shows a summary.

    Raises
    ------
    ConfigurationError
        A varied parameter, a metric or a bound does not exist, or the file contains another sweep.
    ParameterError
        A range is out of bounds.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> noise = {"plant_simulator.sensor.noise": hr.Levels([1e-9, 2e-9])}
    >>> found = hr.sweep("kim2009", noise, duration=0.02, workers=1)
    >>> found.results.metrics["rms_error_m"].shape
    (2,)
    """
    if sensitivity:
        require_library()
    axis = single_axis(configuration_of(config), namespace)
    allowed = tuple(parse_bound(bound, axis) for bound in _listed(bounds))
    names = require_metrics([*_listed(metrics), *(bound.metric for bound in allowed)], axis)
    if duration is not None:
        axis = axis.with_duration(duration)
    variations = parse_variations(vary, axis)
    plan = make_plan(variations, runs, seed, sensitivity or RANDOM)
    study, told = Study(axis, variations, names), progress or (lambda done: None)
    found = make_runs(study, plan, path, workers=workers, scheduler=scheduler, progress=told)
    return Swept(found, plan, allowed)


def _listed(texts: str | Sequence[str]) -> Sequence[str]:
    """Return texts as a sequence; a single text is a sequence of one."""
    return [texts] if isinstance(texts, str) else texts
