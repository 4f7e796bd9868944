# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A sweep: the runs of a plan on as many processes as there are, kept as they end, and resumed where they were left."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.executors.executor import executor
from hysteresis_ros.executors.jobs import Job
from hysteresis_ros.sweeps.journal import Journal, require_same
from hysteresis_ros.sweeps.outcome import Results, load, require_kind, save
from hysteresis_ros.sweeps.plan import RANDOM, Plan
from hysteresis_ros.sweeps.study import Runs, Study, make_runs
from hysteresis_ros.sweeps.variations import settings

#: Samples of one job, about a third of a second of work, and its most runs.
JOB_SAMPLES, JOB_RUNS = 600_000, 250
#: Of so many workers on jobs get longer, so that who hands them out keeps up.
CROWD = 64
#: Samples for which other processes are not worth their start.
FEW = 3_000_000


def about(study: Study, plan: Plan) -> dict:
    """Return what sweep it is, as its files say.

    Parameters
    ----------
    study : Study
    plan : Plan
    """
    return {
        "version": study.version,
        "configuration": study.axis.configuration_text(),
        "vary": [f"{one.label} {one.over}" for one in plan.variations],
        "labels": [one.label for one in plan.variations],
        "metrics": list(study.metrics),
        "design": plan.design,
        "seed": plan.seed,
        **({} if plan.design == RANDOM and plan.spreads else {"runs": plan.runs}),
    }


def sweep(
    study: Study,
    plan: Plan,
    path=None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Results:
    """Make the runs of a sweep that are not made yet.

    Parameters
    ----------
    study : Study
    plan : Plan
    path : path-like, optional
        Where the results go, ``.parquet`` or ``.npz``; until all are there a journal stands beside it, from which the
        same sweep goes on.
    workers : int, optional
        Processes; by default as many as there are processors, where there is enough to do.
    scheduler : str, optional
        Address of a Dask scheduler whose workers make the runs instead.
    progress : callable
        Called with how many runs are made.

    Raises
    ------
    ConfigurationError
        The results are of another sweep or cannot be written, or the runs have no end.
    HysteresisError
        Who made the runs has ended, or there is nobody.
    """
    if not study.samples:
        raise ConfigurationError("the configuration has no end (samples: 0, endless waveform): give --duration S")
    table = _Table(study, plan)
    if path is None:
        _fill(table, lambda runs: None, workers, scheduler, progress)
        return table.results()
    require_kind(path)
    path, what = pathlib.Path(path), about(study, plan)
    if path.exists():
        known = load(path)
        require_same(path, known.about, what)
        table.take(known)
        if table.is_full:
            return known
    journal = Journal(path, what)
    try:
        for runs in journal.found:
            table.put(runs)
        _fill(table, journal.add, workers, scheduler, progress)
        found = table.results()
        save(found, path)
        journal.remove()
    finally:
        journal.close()
    return found


def _fill(table: _Table, keep: Callable[[Runs], None], workers, scheduler, progress) -> None:
    """Make the runs that are missing, and keep them as they end."""
    study, missing = table.study, table.missing
    progress(table.done)
    if not missing:
        return
    # one run here first: what compiles does so once, and all others find it
    first = study.runs(int(missing[0][0]), table.plan.points(missing[0][:1]))
    table.put(first)
    keep(first)
    left = table.plan.runs - table.done
    if workers is None and scheduler is None and left * study.samples < FEW:
        workers = 1
    with executor(workers, scheduler, jobs=left) as shared:
        crowd = max(shared.workers // CROWD, 1)
        size = min(max(crowd * JOB_SAMPLES // study.samples, 1), crowd * JOB_RUNS)
        size = min(size, -(-max(left, 1) // (4 * shared.workers)))
        for _, runs in shared.results(table.jobs(size)):
            table.put(runs)
            keep(runs)
            progress(table.done)


class _Table:
    """What is known of all runs."""

    def __init__(self, study: Study, plan: Plan):
        self.study, self.plan = study, plan
        self.values = np.full((plan.runs, len(study.metrics) + 1), np.nan)
        self.made = np.zeros(plan.runs, dtype=bool)
        self.refused: dict[int, str] = {}

    @property
    def done(self) -> int:
        return int(np.count_nonzero(self.made))

    @property
    def is_full(self) -> bool:
        return bool(np.all(self.made))

    @property
    def missing(self) -> list[np.ndarray]:
        """Numbers of the runs that are not made, in pieces without gaps."""
        numbers = np.flatnonzero(~self.made)
        return np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if numbers.size else []

    def jobs(self, size: int) -> Iterator[Job]:
        """Yield a job for each few of the runs that are not made."""
        for piece in self.missing:
            for begin in range(0, len(piece), size):
                part = piece[begin : begin + size]
                yield Job(make_runs, (self.study, int(part[0]), self.plan.points(part)))

    def put(self, runs: Runs) -> None:
        """Take what has become of some runs; of a shorter sweep not all are asked for."""
        rows = np.array(runs.rows)[: max(self.plan.runs - runs.first, 0)]
        self.values[runs.first : runs.first + len(rows)] = rows
        self.made[runs.first : runs.first + len(rows)] = True
        self.refused |= runs.refused

    def take(self, known: Results) -> None:
        """Take the runs of a sweep that was shorter."""
        rows = np.column_stack([*known.metrics.values(), np.where(known.refused == "", known.tripped, np.nan)])
        why = {int(number): str(known.refused[number]) for number in np.flatnonzero(known.refused != "")}
        self.put(Runs(0, rows.tolist(), why))

    def results(self) -> Results:
        """Return the whole table."""
        plan, study, count = self.plan, self.study, self.plan.runs
        numbers: list[list] = []
        for begin in range(0, count, JOB_RUNS):
            points = plan.points(range(begin, min(begin + JOB_RUNS, count)))
            numbers += [settings(study.axis, plan.variations, point)[1] for point in points]
        columns: Sequence = list(zip(*numbers, strict=True))
        refused = np.array([self.refused.get(number, "") for number in range(count)], dtype=str)
        return Results(
            {**about(study, plan), "runs": count},
            {one.label: np.array(column) for one, column in zip(plan.variations, columns, strict=True)},
            {name: self.values[:, i].copy() for i, name in enumerate(study.metrics)},
            self.values[:, -1] == 1.0,
            refused,
        )
