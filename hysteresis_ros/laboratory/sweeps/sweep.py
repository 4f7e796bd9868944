# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Execution of a sweep: the runs of a plan in parallel, stored as they finish, and resumed after an interruption.

The first line of the journal defines the sweep; each further line contains some runs. Reading a written number gives
the same double. An incomplete last line is ignored, and its runs are repeated.
"""

from __future__ import annotations

import fcntl
import json
import os
import pathlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.executors import Job, executor
from hysteresis_ros.files import read_arrays, replacing
from hysteresis_ros.laboratory.sweeps.plan import RANDOM, Plan, settings
from hysteresis_ros.laboratory.sweeps.study import Runs, Study, make_runs

#: Suffix of the journal, appended to the name of the results.
SUFFIX = ".part"
#: Beginning of the first line of a journal.
KIND = "hysteresis sweep 1"


class Journal:
    """The file of an unfinished sweep."""

    def __init__(self, path, about: dict[str, Any]):
        self.path = pathlib.Path(f"{path}{SUFFIX}")
        try:
            self._file = open(self.path, "a+b", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise ConfigurationError(f"{self.path}: cannot be written: {error.strerror}; choose another -o") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise ConfigurationError(
                f"{self.path}: another sweep is writing this file; choose another -o, or wait"
            ) from None
        try:
            self.found = self._read(about)
        except BaseException:
            self._file.close()
            raise

    def _read(self, about: dict[str, Any]) -> list[Runs]:
        self._file.seek(0)
        whole, _, cut = self._file.read().rpartition(b"\n")
        size = len(whole) + 1 if whole else 0
        if cut:
            if not whole and not (KIND.encode() in cut or len(cut) < len(KIND) + 2):
                raise ConfigurationError(f"{self.path}: is not the journal of a sweep; remove it, or choose another -o")
            self._file.truncate(size)
        if not whole:
            self._write({"kind": KIND, **about})
            return []
        try:
            first, *lines = (json.loads(line) for line in whole.split(b"\n"))
            if first.pop("kind") != KIND:
                raise ValueError
            found = [
                Runs(line["first"], line["rows"], {int(number): why for number, why in line["refused"].items()})
                for line in lines
            ]
        except (ValueError, KeyError, TypeError, AttributeError):
            raise ConfigurationError(
                f"{self.path}: is not the journal of a sweep; remove it, or choose another -o"
            ) from None
        require_same(self.path, first, about)
        return found

    def add(self, runs: Runs) -> None:
        """Append some runs."""
        self._write(runs._asdict())

    def _write(self, content: dict[str, Any]) -> None:
        line, begin = json.dumps(content).encode() + b"\n", os.fstat(self._file.fileno()).st_size
        try:
            written = 0
            while written < len(line):
                written += self._file.write(line[written:])
        except OSError as error:
            self._file.truncate(begin)
            raise ConfigurationError(
                f"{self.path}: cannot be written: {error.strerror}; the finished runs are stored there: free some "
                "space, and repeat the command"
            ) from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def remove(self) -> None:
        """Remove the file once the results are written."""
        self.path.unlink(missing_ok=True)
        self.close()


def require_same(path, found: dict[str, Any], asked: dict[str, Any]) -> None:
    """Refuse a file of another sweep."""
    for name, value in asked.items():
        if found.get(name) != value:
            here, there = (str(text) if len(str(text)) < 100 else "another" for text in (value, found.get(name)))
            raise ConfigurationError(
                f"{path}: contains another sweep, with {name} {there} instead of {here}; choose another -o, or remove "
                "it"
            )


PARQUET, NPZ = ".parquet", ".npz"
#: Key of the sweep's definition in a file of results.
ABOUT = "hysteresis_sweep"
EXTRA = 'needs the extra: pip install "hysteresis_ros[sweep]"'


@dataclass(frozen=True, eq=False)
class Results:
    """The runs of a sweep."""

    about: dict[str, Any]  #: Definition of the sweep: configuration, variations, seed, design, metrics, version.
    parameters: dict[str, np.ndarray]  #: shape (runs,); Varied values of each run, by labels.
    metrics: dict[str, np.ndarray]  #: shape (runs,); Metrics in SI; an undefined metric is NaN.
    tripped: np.ndarray  #: shape (runs,); Whether the axis tripped.
    refused: np.ndarray  #: shape (runs,); Reason why an axis could not be built; empty if it could.

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.tripped)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns of the table, by name."""
        own = {"run": np.arange(len(self)), "tripped": self.tripped, "refused": self.refused}
        return {"run": own.pop("run"), **self.parameters, **self.metrics, **own}

    @property
    def good(self) -> np.ndarray:
        """Whether each run finished, shape (runs,)."""
        return ~self.tripped & (self.refused == "")


def require_kind(path) -> None:
    """Refuse a file format that cannot be written; called before any run."""
    suffix = pathlib.Path(path).suffix
    if suffix not in (PARQUET, NPZ):
        raise ConfigurationError(f"{path}: the name of the results must end in .parquet or .npz")
    if suffix == PARQUET:
        try:
            import pyarrow  # noqa: F401
        except ImportError:
            raise ConfigurationError(f"{path}: Parquet {EXTRA}; or choose a name that ends in .npz") from None


def save(results: Results, path) -> None:
    """Write results atomically."""
    path = pathlib.Path(path)
    text = json.dumps(results.about)
    remedy = "all runs are stored in its journal: free some space, and repeat the command"
    with replacing(path, ConfigurationError, remedy) as beside, beside.open("wb") as stream:
        if path.suffix == NPZ:
            arrays: dict[str, Any] = {ABOUT: np.array(text), **results.columns}
            np.savez(stream, **arrays)
        else:
            import pyarrow
            import pyarrow.parquet

            table = pyarrow.table(results.columns).replace_schema_metadata({ABOUT: text})
            pyarrow.parquet.write_table(table, stream)


def load(path) -> Results:
    """Read results."""
    require_kind(path)
    try:
        columns, text = (_npz if pathlib.Path(path).suffix == NPZ else _parquet)(path)
        about = json.loads(text)
        parameters = {name: columns[name] for name in about["labels"]}
        metrics = {name: columns[name] for name in about["metrics"]}
        return Results(about, parameters, metrics, columns["tripped"].astype(bool), columns["refused"].astype(str))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: does not contain results of a sweep ({error}); choose another -o") from None


def _npz(path) -> tuple[dict[str, np.ndarray], str]:
    columns = read_arrays(path)
    return columns, str(columns.pop(ABOUT))


def _parquet(path) -> tuple[dict[str, np.ndarray], str]:
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(path)
    text = (table.schema.metadata or {})[ABOUT.encode()].decode()
    return {name: table[name].to_numpy() for name in table.column_names}, text


#: Number of samples of a job, about half a second of computing.
JOB_SAMPLES = 600_000
#: Maximum number of runs per job.
JOB_RUNS = 250
#: A job grows by the factor workers / CROWD, rounded down, so that the distribution of jobs keeps up with many workers.
CROWD = 64
#: Number of samples below which parallel processes are not faster.
FEW = 3_000_000


def about(study: Study, plan: Plan) -> dict:
    """Return the definition of a sweep for its files."""
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
    """Execute the unfinished runs of a sweep."""
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
    """Execute the missing runs, and store them as they finish."""
    study, missing = table.study, table.missing
    progress(table.done)
    if not missing:
        return
    # the first run is executed in this process, so that the kernels compile once for all processes
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
    """Table of all runs."""

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
        """Numbers of the missing runs, in contiguous ranges."""
        numbers = np.flatnonzero(~self.made)
        return np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if numbers.size else []

    def jobs(self, size: int) -> Iterator[Job]:
        """Yield jobs for the missing runs."""
        for piece in self.missing:
            for begin in range(0, len(piece), size):
                part = piece[begin : begin + size]
                yield Job(make_runs, (self.study, int(part[0]), self.plan.points(part)))

    def put(self, runs: Runs) -> None:
        """Store the results of some runs that belong to this sweep."""
        rows = np.array(runs.rows)[: max(self.plan.runs - runs.first, 0)]
        self.values[runs.first : runs.first + len(rows)] = rows
        self.made[runs.first : runs.first + len(rows)] = True
        self.refused |= runs.refused

    def take(self, known: Results) -> None:
        """Store the runs of a shorter sweep."""
        rows = np.column_stack([*known.metrics.values(), np.where(known.refused == "", known.tripped, np.nan)])
        why = {int(number): str(known.refused[number]) for number in np.flatnonzero(known.refused != "")}
        self.put(Runs(0, rows.tolist(), why))

    def results(self) -> Results:
        """Return the complete table."""
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
