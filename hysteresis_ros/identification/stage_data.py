# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recordings of several inputs and outputs: columns, units, periods and realisations.

A realisation is a span in which all inputs repeat. If every realisation has more than two periods, the first period of
each is discarded as run-in. One file may contain several realisations, one after the other, as `hysteresis excite`
records them, or each realisation may have its own file.
"""

from __future__ import annotations

import pathlib
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.arguments import Seconds, check_fields
from hysteresis_ros.errors import IdentificationError, Problem, did_you_mean
from hysteresis_ros.files import read_heads
from hysteresis_ros.identification.coupled import MOST_CHANGED, StructureData, changed_samples
from hysteresis_ros.identification.data import CONSTANT, DataError, check_uniform
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run
from hysteresis_ros.recordings.foreign_tables import TABLE_SUFFIXES, Selection, choose_columns, open_table, split_choice
from hysteresis_ros.units import conversion

#: Names of the signals that are the input and the output of an axis of a stage.
INPUT, OUTPUT = "voltage", "measured"
#: Sample times of files count as different if they differ by more than this fraction.
SAME_RATE = 1e-6
#: Largest number of candidate periods.
CANDIDATES = 50
#: Smallest number of samples of a period, and of samples in which an input moves alone.
SHORTEST = 16
#: A span contains no realisation if the RMS motion of the inputs in it is at most this fraction of their overall RMS
#: motion.
STILL = 0.02
#: Name of the signal with the reference of an axis in the recording of a stage.
ASKED = "reference"
#: Name of the signal that states whether the sample was skipped.
SKIPPED = "skipped"


@dataclass(frozen=True)
class StageColumns:
    """Selection of several inputs and outputs in files.

    Parameters
    ----------
    inputs, outputs : tuple of str
        Columns as ``name`` or ``name:unit``. For the recording of a stage, by default the voltages and measurements of
        all its axes.
    time : str, optional
        Time column.
    sample_time : float or str, optional
        [s], or a text with its unit, for files without a time column.
    period : float or str, optional
        Period of the inputs [s]; by default it is determined from the inputs.
    settle : int, optional
        Number of periods discarded at the beginning of each realisation; by default one, or none if a realisation has
        only two periods.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    time: str | None = None
    sample_time: Seconds | None = None
    period: Seconds | None = None
    settle: int | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("inputs", "outputs"):
            given = tuple(getattr(self, name))
            object.__setattr__(self, name, given)
            twice = sorted({one for one in given if given.count(one) > 1})
            if twice:
                allowed = f"'{twice[0]}' occurs more than once: name each column once"
                raise IdentificationError(str(Problem(name, given, allowed)))


@dataclass(frozen=True, eq=False)
class StageReading:
    """Recorded inputs [V] and outputs [m] of a stage, at one sample rate."""

    inputs: tuple[str, ...]  #: Names of the inputs.
    outputs: tuple[str, ...]  #: Names of the outputs.
    runs: tuple[tuple[np.ndarray, np.ndarray], ...]  #: Input, shape (N, m), and output, shape (N, q), of each run.
    sample_time: float  #: [s]
    source: str  #: Names of the files.
    axes: tuple[str, ...] = ()  #: Names of the axes of a recorded stage.
    #: References [m] of each run, shape (N, m), if samples were skipped: they repeat even where the inputs do not.
    asked: tuple[np.ndarray, ...] = ()
    skipped: int = 0  #: Number of skipped samples, in which a busy computer held the previous inputs.

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the inputs and outputs of the only run; raise DataError if there are several runs."""
        if len(self.runs) != 1:
            raise DataError("shape", f"there are {len(self.runs)} runs, but one is needed here: give one file")
        return self.runs[0]


def is_stage(path) -> bool:
    """Return whether a file is the recording of a stage, with signals of several axes."""
    path = pathlib.Path(path)
    if path.suffix.lower() == ".npz" and path.is_file():
        try:
            return any("/" in name for name in read_heads(path))
        except (OSError, ValueError):
            return False
    if path.suffix.lower() == ".csv" and path.is_file():
        with path.open(encoding="utf-8", errors="replace") as stream:
            return "/measured" in stream.readline()
    if path.is_dir() or path.suffix.lower() in (".mcap", ".db3"):
        return bool(load_run(path).axes)
    return False


def read_stage(sources, columns: StageColumns | None = None) -> StageReading:
    """Return the recordings of one or several files, or of recordings in memory."""
    columns = columns or StageColumns()
    if isinstance(sources, StageReading):
        return sources
    if isinstance(sources, (str, pathlib.Path, Recording)):
        sources = [sources]
    found = [_read(source, columns) for source in sources]
    if not found:
        raise DataError("short", "no recording is given; give at least one file")
    first = found[0]
    for other in found:
        if (other.inputs, other.outputs) != (first.inputs, first.outputs):
            raise DataError("columns", f"{other.source}: has other inputs or outputs than {first.source}")
        if abs(other.sample_time / first.sample_time - 1.0) > SAME_RATE:
            raise DataError(
                "uniform",
                f"{other.source}: has a sample time of {other.sample_time:.9g} s, but it is "
                f"{first.sample_time:.9g} s in {first.source}: all files must have the same sample time",
            )
    names = ", ".join(dict.fromkeys(one.source for one in found))
    runs = tuple(run for one in found for run in one.runs)
    skipped = sum(one.skipped for one in found)
    # files without skipped samples have no references
    asked = tuple(u for one in found for u in one.asked or (u for u, _ in one.runs)) if skipped else ()
    return StageReading(first.inputs, first.outputs, runs, first.sample_time, names, first.axes, asked, skipped)


def _read(source, columns: StageColumns) -> StageReading:
    axes: tuple[str, ...] = ()
    inputs, outputs = columns.inputs, columns.outputs
    if isinstance(source, Recording):
        recording, name = source, str(source.metadata.get("source", "recording"))
    else:
        path = pathlib.Path(source)
        name = path.name
        if path.suffix.lower() == ".npy":
            return _arrays(path, columns)
        if not path.exists():
            raise DataError("columns", f"{path}: no such file; give the path of a recording")
        if path.suffix.lower() in TABLE_SUFFIXES and not is_stage(path):
            _require(path, inputs, outputs)
            selection = Selection((*inputs, *outputs), columns.time, columns.sample_time)
            recording = choose_columns(open_table(path), selection)
            taken = list(recording.signals)
            if len(taken) != len(inputs) + len(outputs):
                raise DataError("columns", f"{path}: a column is named as input and as output; name each once")
            inputs, outputs = tuple(taken[: len(inputs)]), tuple(taken[len(inputs) :])
        else:
            recording = load_run(path)
    if recording.axes:
        axes = recording.axes
        inputs = inputs or tuple(f"{axis}/{INPUT}" for axis in axes)
        outputs = outputs or tuple(f"{axis}/{OUTPUT}" for axis in axes)
    _require(name, inputs, outputs)
    inputs, outputs = (tuple(_signal(recording, name, one) for one in names) for names in (inputs, outputs))
    for role, names, unit in (("input", inputs, "V"), ("output", outputs, "m")):
        for one in names:
            if recording.units[one] != unit:
                wanted = "a voltage" if unit == "V" else "a length"
                text = f"{role} {one} is in '{recording.units[one]}', but must be {wanted}: give it as {one}:{unit}"
                raise DataError("unit", f"{name}: {text}")
    u, y = (np.column_stack([recording[one] for one in names]) for names in (inputs, outputs))
    sample_time, _, findings = check_uniform(recording.time)
    wrong = [finding.message for finding in findings if finding.severity == "error"]
    if wrong:
        raise DataError("uniform", f"{name}: {wrong[0]}")
    asked, skipped = _asked(recording)
    return _trimmed(StageReading(inputs, outputs, ((u, y),), sample_time, name, axes, asked, skipped))


def _asked(recording: Recording) -> tuple[tuple[np.ndarray, ...], int]:
    """Return the references of a stage's run if samples were skipped, and the number of skipped samples."""
    wanted = [f"{axis}/{signal}" for axis in recording.axes for signal in (ASKED, SKIPPED)]
    if not wanted or not all(name in recording.signals for name in wanted):
        return (), 0
    skipped = np.column_stack([recording[name] for name in wanted[1::2]]) > 0.0
    asked = np.column_stack([recording[name] for name in wanted[::2]])
    count = int(np.count_nonzero(skipped.any(axis=1)))
    return (asked,) if count and np.isfinite(asked).all() else (), count


def _trimmed(reading: StageReading) -> StageReading:
    """Return a reading of one run without the missing samples at its ends."""
    (u, y), name = reading.runs[0], reading.source
    finite = np.isfinite(u).all(axis=1) & np.isfinite(y).all(axis=1)
    if not finite.any():
        raise DataError("nan", f"{name}: no sample has all inputs and outputs")
    kept = slice(int(np.argmax(finite)), len(finite) - int(np.argmax(finite[::-1])))
    if not finite[kept].all():
        place = kept.start + int(np.argmin(finite[kept]))
        raise DataError("nan", f"{name}: sample {place} lacks an input or an output; leave it out or record again")
    return replace(reading, runs=((u[kept], y[kept]),), asked=tuple(one[kept] for one in reading.asked))


def _require(name, inputs, outputs) -> None:
    for role, names in (("--input", inputs), ("--output", outputs)):
        if not names:
            raise DataError(
                "columns", f"{name}: which columns are the {role[2:]}s? Name each, as {role} NAME:UNIT {role} NAME:UNIT"
            )


def _signal(recording: Recording, source: str, choice: str) -> str:
    """Return the name of the chosen signal; a given unit must be the SI unit of the signal."""
    name, unit = (choice, None) if choice in recording else split_choice(choice)
    if name not in recording.signals:
        near = did_you_mean(name, recording.signals)
        raise DataError("columns", f"{source}: no signal '{name}'{near}; there are {', '.join(recording.signals)}")
    if unit is not None and recording.units[name] != unit:
        text = f"{source}: signal '{name}' is in '{recording.units[name]}', not in '{unit}'"
        raise DataError("unit", f"{text}; leave the unit out")
    return name


def _arrays(path: pathlib.Path, columns: StageColumns) -> StageReading:
    """Return the runs in an array of shape (samples, columns) or (realisations, samples, columns)."""
    _require(path, columns.inputs, columns.outputs)
    try:
        array = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise DataError("columns", f"{path}: not a readable array: {error}") from None
    if array.ndim not in (2, 3) or array.dtype.kind not in "iuf":
        raise DataError(
            "shape", f"{path}: must be numbers of shape (samples, columns), or (realisations, samples, columns)"
        )
    if columns.sample_time is None:
        raise DataError("uniform", f"{path}: an array has no times; give --sample-time")
    table = np.asarray(array, dtype=float).reshape(-1, *array.shape[-2:])
    groups, names = [], []
    for role, chosen, wanted in (("input", columns.inputs, "V"), ("output", columns.outputs, "m")):
        picked = []
        for choice in chosen:
            name, unit = split_choice(choice)
            known = conversion(unit) if unit else None
            if known is None or known[0] != wanted:
                raise DataError(
                    "unit", f"{path}: {role} {choice}: give its unit, such as {name}:{'V' if wanted == 'V' else 'um'}"
                )
            if not name.isdigit() or not 1 <= int(name) <= table.shape[2]:
                raise DataError("columns", f"{path}: no column '{name}'; the columns are 1 … {table.shape[2]}")
            picked.append(table[:, :, int(name) - 1] / known[1])
        groups.append(np.stack(picked, axis=2))
        names.append(tuple(split_choice(choice)[0] for choice in chosen))
    u, y = groups
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise DataError("nan", f"{path}: has values that are not finite; leave them out or record again")
    runs = tuple(zip(u, y, strict=True))
    return StageReading(names[0], names[1], runs, float(columns.sample_time), path.name)


def find_period(u: np.ndarray) -> int | None:
    """Return the period [samples] with which most samples of ``u``, shape (N, m), repeat; None without repetition."""
    moved = u - u.mean(axis=0)
    size = 2 * len(u)
    correlation = np.fft.irfft((np.abs(np.fft.rfft(moved, size, axis=0)) ** 2).sum(axis=1))[: len(u) // 2 + 2]
    inner = correlation[1:-1]
    peaks = 1 + np.flatnonzero((inner >= correlation[:-2]) & (inner > correlation[2:]) & (inner > 0.0))
    peaks = peaks[peaks >= SHORTEST]
    best, covered = None, 0.0
    for period in sorted(peaks[np.argsort(-correlation[peaks])][:CANDIDATES]):
        share = float(sum(last - first for first, last in periodic_spans(u, int(period))))
        # a multiple of the period covers hardly more samples than the period
        if share > 1.02 * covered:
            best, covered = int(period), share
    return best


def periodic_spans(u: np.ndarray, period: int) -> list[tuple[int, int]]:
    """Return the spans (first sample, last sample + 1) in which the inputs move and repeat for at least two periods."""
    size = float(np.sqrt(np.mean(np.var(u, axis=0))))
    apart = changed_samples(u, period)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], apart, [True]]).astype(np.int8)))
    found = []
    for first, behind in zip(edges[::2], edges[1::2], strict=True):
        if behind - first < period:
            continue
        span = u[first : behind + period]
        if np.sqrt(np.mean(np.var(span[:period], axis=0))) > STILL * size:
            found.append((int(first), int(behind) + period))
    return found


def realisations(reading: StageReading, columns: StageColumns | None = None) -> StructureData | None:
    """Return the realisations in recordings as whole periods; None if the inputs do not repeat.

    A stated period is refused if the inputs do not repeat with it.
    """
    columns = columns or StageColumns()
    step = reading.sample_time
    stated = columns.period
    asked = reading.asked or tuple(u for u, _ in reading.runs)
    if stated is None:
        found = next((one for one in map(find_period, asked) if one is not None), None)
        if found is None:
            return None
        period = found
    else:
        period = round(stated / step)
        if period < SHORTEST or abs(period * step / stated - 1.0) > 1e-6:
            allowed = f"must be a whole number of at least {SHORTEST} samples of {step:g} s"
            raise DataError("shape", f"--period {stated:g} s: {allowed}")
    spans = [
        (u[first:last], y[first:last])
        for repeated, (u, y) in zip(asked, reading.runs, strict=True)
        for first, last in _split(repeated, period)
        if repeated is u or np.mean(changed_samples(u[first:last], period)) <= MOST_CHANGED
    ]
    if not spans and stated is None:
        return None
    if not spans:
        raise DataError("shape", f"the inputs do not repeat with a period of {period * step:g} s; leave --period out")
    counts = [len(u) // period for u, _ in spans]
    fewest = min(counts)
    settle = (1 if fewest > 2 else 0) if columns.settle is None else columns.settle
    if not 0 <= settle < fewest:
        raise DataError("short", f"--settle {settle}: a realisation has {fewest} periods; at least one must remain")
    kept = slice(settle * period, fewest * period)
    u, y = (np.array([span[place][kept] for span in spans]) for place in (0, 1))
    return StructureData(u, without_drift(y, period), step, period)


def planned_realisations(
    reading: StageReading, first: int, period: int, settle: int, periods: int, count: int
) -> StructureData:
    """Return ``count`` realisations of an excitation with a known plan, beginning at sample ``first``."""
    u, y = reading.whole()
    length = (settle + periods) * period
    if len(u) < first + count * length:
        text = f"{reading.source}: has {len(u)} samples, the excitation needs {first + count * length}: it is cut off"
        raise DataError("short", text)
    kept = slice(settle * period, length)
    u, y = (one[first : first + count * length].reshape(count, length, -1)[:, kept] for one in (u, y))
    return StructureData(u, without_drift(y, period), reading.sample_time, period)


def without_drift(y: np.ndarray, period: int) -> np.ndarray:
    """Return the outputs without the drift from period to period, caused for example by creep."""
    R, count, q = y.shape
    if count < 2 * period:
        return y
    means = y.reshape(R, -1, period, q).mean(axis=2)
    number = np.arange(means.shape[1]) - 0.5 * (means.shape[1] - 1)
    slope = np.einsum("p,rpq->rq", number, means) / (number @ number) / period
    time = np.arange(count) - 0.5 * (count - 1)
    return y - time[None, :, None] * slope[:, None, :]


def _split(u: np.ndarray, period: int) -> list[tuple[int, int]]:
    """Return spans of whole periods; a span ends where the inputs stop repeating."""
    found = periodic_spans(u, period)
    return [(last - (last - first) // period * period, last) for first, last in found]


def loops_of(reading: StageReading) -> list[tuple[int, int]]:
    """Return for each input the interval in which no other input moves (first sample, last sample + 1).

    Raises
    ------
    DataError
        An input has no interval in which only this input moves; the message names the input.
    """
    u, _ = reading.whole()
    reach = np.ptp(u, axis=0)
    found = []
    for i, name in enumerate(reading.inputs):
        # an input rests at its first value before and after its motion
        moving = np.abs(u - u[0]) > 1e-3 * np.maximum(reach, CONSTANT)
        alone = np.flatnonzero(moving[:, i] & ~np.delete(moving, i, axis=1).any(axis=1))
        others = np.flatnonzero(moving[:, i] & np.delete(moving, i, axis=1).any(axis=1))
        if alone.size < SHORTEST or others.size > 0.01 * alone.size:
            raise DataError(
                "columns",
                f"{reading.source}: input {name} is not excited alone; excite one axis after the other "
                "(hysteresis excite STAGE --recipe triangles)",
            )
        found.append((int(alone[0]), int(alone[-1]) + 1))
    return found
