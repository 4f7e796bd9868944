# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Studies of more than one run: ``hr.compare`` and ``hr.reproduce``, the commands of the same names."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection
from dataclasses import fields
from typing import Any

from hysteresis_ros.api import Source, configuration_of
from hysteresis_ros.arguments import checked
from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.laboratory.comparison.compare import compare as compare_candidates
from hysteresis_ros.laboratory.comparison.table import Ranking
from hysteresis_ros.laboratory.comparison.tasks import Conditions
from hysteresis_ros.laboratory.papers import EXPERIMENTS
from hysteresis_ros.laboratory.papers.claims import Reproduction

__all__ = ["Ranking", "Reproduction", "compare", "reproduce"]


@checked
def compare(
    config: Source,
    *,
    only: Collection[tuple[str, str]] | None = None,
    workers: int | None = None,
    progress: Callable[[str], None] | None = None,
    namespace: str | None = None,
    **conditions: Any,
) -> Ranking:
    """Rank controllers and compensators on random plants close to the configured plant, and on plants of other classes.

    Parameters
    ----------
    config : path-like, Configuration, Identified, Design or Recording
        The axis, see :func:`.simulate`.
    only : collection of (str, str), optional
        Names of the combinations (controller, compensator) to run, such as ``{("PID", "exact inverse")}``; all by
        default, which takes minutes.
    workers : int, optional
        Processes that share the work; by default as many as there are processors.
    progress : callable, optional
        Called with a text after each finished part of the work.
    namespace : str, optional
        Name of the axis, if the configuration contains several.
    **conditions
        ``mismatch``, ``noise`` [m rms], ``bits``, ``draws``, ``others``, ``seed``, ``robust``, ``sine_frequency`` and
        ``triangle_frequency`` [Hz] …: see :class:`hysteresis_ros.laboratory.comparison.tasks.Conditions`.

    Returns
    -------
    Ranking
        With ``tables``, ``best`` and ``save(path)``; ``print`` shows the tables.

    Raises
    ------
    ConfigurationError
        The axis is an inchworm motor, or a condition, controller or compensator does not exist; the message lists the
        existing ones.
    ParameterError
        A condition or parameter is out of range.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> found = hr.compare("kim2009", draws=2, others=0)  # doctest: +SKIP
    >>> print(found)  # doctest: +SKIP
    """
    known = {field.name for field in fields(Conditions)}
    for name in conditions:
        if name not in known:
            raise ConfigurationError(f"unknown condition {name}{did_you_mean(name, known)}")
    found = compare_candidates(
        configuration_of(config),
        Conditions(**conditions),
        namespace=namespace,
        only=only,
        workers=workers,
        progress=progress or (lambda text: None),
    )
    return Ranking(**vars(found))


@checked
def reproduce(paper: str) -> Reproduction:
    """Repeat the experiments of a paper, and compare each claim with its reproduction.

    Parameters
    ----------
    paper : str
        ``kim2009``, ``auwal2017``, ``wang2014`` or ``fleming2010``.

    Returns
    -------
    Reproduction
        With ``claims``, ``runs`` and ``summary()``; ``print`` shows the table of ``hysteresis reproduce``.

    Raises
    ------
    ConfigurationError
        There is no such paper.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> hr.reproduce("auwal2017").summary()  # doctest: +SKIP
    """
    if paper not in EXPERIMENTS:
        there = ", ".join(EXPERIMENTS)
        raise ConfigurationError(f"no paper '{paper}'; there are: {there}{did_you_mean(paper, EXPERIMENTS)}")
    found: Reproduction = importlib.import_module(EXPERIMENTS[paper]).reproduce()
    return found
