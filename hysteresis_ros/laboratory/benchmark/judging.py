# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fit of one model to one recording, in a separate process, and evaluation of the model on the test part."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.executors import InProcess, Job, processes
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.laboratory.benchmark.manifest import Task
from hysteresis_ros.laboratory.benchmark.models import load_model

#: Number of bootstrap samples for a confidence interval.
RESAMPLINGS = 1000
#: Seed of the bootstrap samples, and of NumPy's global generator before each fit.
SEED = 1
#: Quantiles at the ends of a confidence interval.
ENDS = (0.025, 0.975)
#: Fraction of the test input that the model gets in the test of causality.
SHOWN = 0.6
#: Largest change of the prediction for this part, as a fraction of the stroke, that the rest of the input may cause.
SAME = 1e-6


@dataclass(frozen=True)
class Row:
    """Result of one model on one recording, in the unit of the output."""

    recording: str
    model: str
    unit: str = "m"
    stroke: float = math.nan  #: Peak-to-peak output of the judged samples.
    error: float = math.nan  #: RMS error over the judged samples.
    low: float = math.nan  #: low, high: 95 % interval of the RMS error.
    high: float = math.nan
    maximum: float = math.nan  #: Largest absolute error.
    parameters: int | None = None  #: Number of fitted parameters, if the model reports it.
    fit_seconds: float = math.nan  #: Processor time of the fit [s].
    predict_seconds: float = math.nan  #: Processor time of the prediction [s].
    problem: str = ""  #: Reason why the row has no error, or why it is not ranked.

    @property
    def percent(self) -> float:
        """RMS error [% of the stroke]."""
        return 100.0 * self.error / self.stroke


@dataclass(frozen=True, eq=False)
class Answer:
    """Result of a model: predictions for the whole test input and its first part, number of parameters, durations."""

    whole: np.ndarray
    shown: np.ndarray
    parameters: int | None
    fit_seconds: float
    predict_seconds: float


def answer(spec: str, train: IdentificationData, test_input: np.ndarray) -> Answer | str:
    """Fit a model and predict the test output from the test input; return the reason as text if this fails."""
    np.random.seed(SEED)  # for models that use the global generator
    begun = time.process_time()
    try:
        fitted = load_model(spec).fit(train)
        between = time.process_time()
        whole = np.array(fitted.predict(test_input.copy()), dtype=float)
        ended = time.process_time()
        shown = np.array(fitted.predict(test_input[: round(SHOWN * len(test_input))].copy()), dtype=float)
    except Exception as error:  # a user's model may raise anything
        return f"{type(error).__name__}: {error}"
    count = getattr(fitted, "parameter_count", None)
    return Answer(whole, shown, None if count is None else int(count), between - begun, ended - between)


def judge(spec: str, task: Task, returned: Answer | str) -> Row:
    """Return the row of a model on a recording."""
    row = Row(task.name, spec, task.test.output_unit, task.stroke)
    if isinstance(returned, str):
        return replace(row, problem=f"failed: {returned}")
    row = replace(
        row,
        parameters=returned.parameters,
        fit_seconds=returned.fit_seconds,
        predict_seconds=returned.predict_seconds,
    )
    expected = (len(task.test), round(SHOWN * len(task.test)))
    for found, length in zip((returned.whole, returned.shown), expected, strict=True):
        if found.shape != (length,):
            return replace(row, problem=f"predicts an array of shape {found.shape}; it must be ({length},)")
        bad = np.flatnonzero(~np.isfinite(found))
        if bad.size:
            return replace(row, problem=f"predicts {found[bad[0]]} at sample {bad[0]} of the test")
    error = (task.test.output - returned.whole)[task.first :]
    if task.offset == "free":
        error = error - np.mean(error)
    low, high = interval(error)
    row = replace(
        row,
        error=float(np.sqrt(np.mean(error**2))),
        low=low,
        high=high,
        maximum=float(np.max(np.abs(error))),
    )
    changed = float(np.max(np.abs(returned.shown - returned.whole[: len(returned.shown)])))
    if changed > SAME * row.stroke:
        problem = f"uses later inputs: without the last {100 * (1 - SHOWN):.0f} % of the input, the first part changes"
        return replace(row, problem=f"{problem} by {100 * changed / row.stroke:.3g} % of the stroke")
    return row


def interval(error: np.ndarray) -> tuple[float, float]:
    """Return the 95 % interval of an RMS error by resampling blocks of its squares.

    A block lasts twice the integrated correlation time of the squares, but at most a tenth of the samples (Künsch,
    Annals of Statistics 17(3), 1989, on blocks; Sokal, 1997, on the correlation time).
    """
    squares = np.asarray(error, dtype=float) ** 2
    count = len(squares)
    centred = squares - np.mean(squares)
    spectrum = np.abs(np.fft.rfft(centred, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[:count]
    if correlation[0] <= 0.0:
        return float(np.sqrt(squares[0])), float(np.sqrt(squares[0]))
    times = 1.0 + 2.0 * np.cumsum(correlation[1:] / correlation[0])
    window = np.flatnonzero(np.arange(1, count) >= 5.0 * times)
    scale = max(float(times[window[0]]) if window.size else float(count), 1.0)
    block = int(np.clip(math.ceil(2.0 * scale), 1, max(count // 10, 1)))
    random = np.random.default_rng(SEED)
    sums = np.concatenate([[0.0], np.cumsum(np.concatenate([squares, squares[:block]]))])
    of_blocks = sums[block:][:count] - sums[:count]
    blocks = math.ceil(count / block)
    means = np.empty(RESAMPLINGS)
    for number in range(RESAMPLINGS):
        means[number] = np.sum(of_blocks[random.integers(0, count, blocks)]) / (blocks * block)
    return tuple(float(np.sqrt(value)) for value in np.quantile(means, ENDS))  # type: ignore[return-value]


def run(
    tasks: Sequence[Task],
    specs: Sequence[str],
    workers: int | None = None,
    progress: Callable[[Row], None] | None = None,
) -> list[Row]:
    """Return the rows of all models on all recordings, sorted by recording and error; rows with a problem are last."""
    for spec in specs:
        load_model(spec)
    pairs = [(task, spec) for task in tasks for spec in specs]
    rows = []
    for number, returned in _answers(pairs, workers):
        task, spec = pairs[number]
        row = judge(spec, task, returned)
        rows.append(row)
        if progress:
            progress(row)
    order = {task.name: number for number, task in enumerate(tasks)}
    return sorted(rows, key=lambda row: (order[row.recording], bool(row.problem), row.error, row.model))


def _answers(pairs, workers: int | None) -> Iterator[tuple[int, Answer | str]]:
    jobs = [Job(answer, (spec, task.train, task.test.input)) for task, spec in pairs]
    count = min(workers or multiprocessing.cpu_count(), len(jobs))
    if count <= 1:
        yield from InProcess().results(jobs)
        return
    with processes(count) as pool:
        yield from pool.results(jobs)


def require_rows(rows: Sequence[Row]) -> None:
    """Raise HysteresisError when no model has a result."""
    if rows and all(math.isnan(row.error) for row in rows):
        raise HysteresisError(
            f"no model has a result; the first reason: {rows[0].model} on {rows[0].recording} {rows[0].problem}"
        )
