# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A candidate on a set of plants: designed on what is known, run on each of them, judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hysteresis_ros.comparison.candidates import Candidate, Known, candidates
from hysteresis_ros.comparison.judging import Followed, Result, best_delay, followed, judged, merged
from hysteresis_ros.comparison.plants import DrawnPlant
from hysteresis_ros.comparison.tasks import LEARNING_PERIODS, SETTLING_PERIODS, Conditions, Task
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.axis_parameters import AxisParameters


@dataclass(frozen=True)
class Row:
    """One candidate: its results, or why it was refused.

    Parameters
    ----------
    controller, compensator : str
        Names in the table.
    results : dict of str to Result
        By name of the task; empty for a refused candidate.
    delays : tuple of float
        The constant delay that it is judged with [s], one for each design.
    refused : str
        Why there are no results.
    marked : str
        What its own margins miss: it is run and shown, not ranked.
    better : dict of str to float
        By name of the task: how many times as large the yardstick's error is, on the plants where that is least.
    errors : dict of str to (array, array)
        Time [s] and error [part of the stroke] on the plant on which the candidate did worst, by name of the task.
    candidate : Candidate or None
        Its parameters, where there is one design.
    """

    controller: str
    compensator: str
    results: dict[str, Result] = field(default_factory=dict)
    delays: tuple[float, ...] = ()
    refused: str = ""
    marked: str = ""
    better: dict[str, float] = field(default_factory=dict)
    errors: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    candidate: Candidate | None = None

    @property
    def name(self) -> tuple[str, str]:
        """Names of controller and compensator."""
        return self.controller, self.compensator

    @property
    def unstable(self) -> int:
        """Plants that it made unstable on one of the references."""
        return max((result.unstable for result in self.results.values()), default=0)

    @property
    def ranked(self) -> bool:
        """Whether it has a rank: it has the margins that every design is held to, and was stable on all plants."""
        return bool(self.results) and not (self.refused or self.marked or self.unstable)

    @property
    def score(self) -> float:
        """Geometric mean over the tasks of the RMS error on the worst plant; the ranking goes by it."""
        if not self.results:
            return float("inf")
        worst = [result.worst for result in self.results.values()]
        return float(np.exp(np.mean(np.log(worst)))) if np.all(np.isfinite(worst)) else float("inf")

    @property
    def order(self) -> tuple[bool, bool, float]:
        """What rows are sorted by: ranked ones first, refused ones last."""
        return bool(self.refused), not self.ranked, self.score


@dataclass(frozen=True)
class Trial:
    """What a set of candidates is tried on.

    Parameters
    ----------
    given : Known
        All that their designs get, with conditions and tasks.
    conditions : Conditions
    tasks : tuple of Task
    stroke : float
        What errors are parts of [m].
    plants : tuple of DrawnPlant
        What they run on.
    """

    given: Known
    conditions: Conditions
    tasks: tuple[Task, ...]
    stroke: float
    plants: tuple[DrawnPlant, ...]

    def rows(self, only=None) -> list[Row]:
        """Return a row for each candidate, in the order of their design.

        Parameters
        ----------
        only : collection of (str, str), optional
            Names of the combinations to try; all by default.
        """
        return [self.row(candidate) for candidate in candidates(self.given, self.conditions, self.tasks, only)]

    def row(self, candidate: Candidate) -> Row:
        """Return what a candidate is worth.

        Parameters
        ----------
        candidate : Candidate
        """
        row = Row(candidate.controller, candidate.compensator, candidate=candidate, marked=candidate.marked)
        if candidate.refused:
            return replace(row, refused=candidate.refused)
        try:
            periods = LEARNING_PERIODS if candidate.learning else SETTLING_PERIODS
            tasks = [replace(task, periods=periods) for task in self.tasks]
            axes = {task: self.given.designed(candidate, task) for task in tasks}
        except (ConfigurationError, ParameterError) as error:
            return replace(row, refused=" ".join(str(error).split()))
        return self.judged(
            row, {task: [run(axis, plant, task) for plant in self.plants] for task, axis in axes.items()}
        )

    def judged(self, row: Row, runs: dict[Task, list[Followed]]) -> Row:
        """Return a row with what its runs are worth.

        Parameters
        ----------
        row : Row
        runs : dict of Task to list of Followed
            On each of the plants.
        """
        delay = best_delay(runs, self.conditions.longest_delay)
        results, errors = judged(runs, delay, self.stroke), {}
        for task, found in runs.items():
            worst = found[int(np.argmax(results[task.name].rms))]
            shown = worst.time <= task.settling + 2.0 / task.frequency
            errors[task.name] = worst.time[shown], worst.error(task, delay)[shown] / self.stroke
        return replace(row, results=results, delays=(delay,), errors=errors)


def run(axis: AxisParameters, plant: DrawnPlant, task: Task) -> Followed:
    """Return how an axis follows a reference on a plant.

    Parameters
    ----------
    axis : AxisParameters
        With the task's reference; nothing of its own plant is used but the sample rate.
    plant : DrawnPlant
    task : Task
    """
    loop = Axis(axis, plant.in_loop())
    return followed(loop.run(loop.default_setpoints(round(task.duration * plant.sample_rate))), plant, task)


def compared_with(rows: Sequence[Row], yardstick: Row) -> list[Row]:
    """Return the rows with how much better they are than the yardstick on the worst plant of each.

    Parameters
    ----------
    rows : sequence of Row
    yardstick : Row
        Of the same plants.
    """
    return [
        replace(
            row, better={name: yardstick.results[name].worst / result.worst for name, result in row.results.items()}
        )
        for row in rows
    ]


def joined(rows: Sequence[Row], plants: Sequence[str], name: tuple[str, str]) -> Row:
    """Return the rows of one combination, each designed on one plant's recording, as one.

    Parameters
    ----------
    rows : sequence of Row
    plants : sequence of str
        What the plants are called.
    name : (str, str)
        What controller and compensator are called.
    """
    pairs = list(zip(rows, plants, strict=True))
    refused = "; ".join(f"{plant}: {row.refused}" for row, plant in pairs if row.refused)
    if refused:
        return Row(*name, refused=refused)
    scores = [row.score for row in rows]
    return Row(
        *name,
        merged([row.results for row in rows]),
        tuple(row.delays[0] for row in rows),
        marked="; ".join(f"{plant}: {row.marked}" for row, plant in pairs if row.marked),
        better={task: min(row.better[task] for row in rows) for task in rows[0].better},
        errors=rows[int(np.argmax(scores))].errors,
    )
