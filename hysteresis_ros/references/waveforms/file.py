# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""File: samples from CSV, NPZ or NPY."""

from __future__ import annotations

import csv
import pathlib
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.files import read_array, read_arrays
from hysteresis_ros.models.block import kernel
from hysteresis_ros.references.declaration import COUNTER, END, FINAL, OFFSET, OWN, PREFIX, Packed, WaveformShape, head

#: Metres per unit, by the names allowed in a header.
LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9}
#: Seconds per unit, by the names allowed in a header.
TIME_UNITS = {"s": 1.0, "ms": 1e-3}
#: Largest deviation of the samples from a uniform grid, and of this grid from the generator's grid, in sample times.
GRID_TOLERANCE = 0.01
LARGEST_TABLE = 10_000_000


def read_samples(path: str, column: str, file_sample_time: float, sample_time: float, prefix: str) -> np.ndarray:
    """Return the samples [m], shape (N,), at the generator's sample time.

    Parameters
    ----------
    path : str
        A ``.csv`` with a header that states columns and units (``time [s], reference [m]``), an ``.npz`` with arrays
        ``column`` [m] and optionally ``time`` [s], or an ``.npy`` with one array in metres.
    column : str
        Name of the column without unit.
    file_sample_time : float
        Sample time of the file [s], from which the samples are interpolated linearly. 0: the file has a column
        ``time``, with the generator's sample time.
    sample_time : float
        Sample time of the generator [s].
    prefix : str
        Name prefix of the parameters in errors.

    Raises
    ------
    ParameterError
        The file is missing or unreadable, lacks the column or its unit, contains values that are not finite, or has
        another sample time than the generator.
    """

    def refused(name, value, text):
        return ParameterError([Problem(prefix + name, value, text)])

    source = pathlib.Path(path).expanduser()
    if not source.is_file():
        raise refused("path", path, "no such file; give the path of a CSV, NPZ or NPY file")
    readers = {".csv": _read_csv, ".npz": _read_npz, ".npy": _read_npy}
    reader = readers.get(source.suffix.lower())
    if reader is None:
        raise refused("path", path, "unknown kind of file; allowed: .csv, .npz, .npy")
    try:
        time, (values,) = reader(source, [column])
    except KeyError as error:
        raise refused("column", column, str(error.args[0])) from None
    except (OSError, ValueError, csv.Error) as error:
        raise refused("path", path, f"cannot be read: {error}") from None
    if values.ndim != 1 or not 1 <= values.size <= LARGEST_TABLE:
        raise refused("path", path, f"must have one column of 1 … {LARGEST_TABLE} samples; its shape is {values.shape}")
    if not np.all(np.isfinite(values)):
        row = int(np.flatnonzero(~np.isfinite(values))[0])
        raise refused("path", path, f"sample {row} is {values[row]}; all samples must be finite metres")
    measured = None if time is None else _uniform_sample_time(time, lambda text: refused("path", path, text))
    if file_sample_time == 0.0:
        if measured is None and values.size > 1:
            raise refused("sample_time", 0.0, f"{path} does not state its sample time; give it [s]")
        if measured is not None and _differs(measured, sample_time, values.size):
            raise refused(
                "sample_time",
                0.0,
                f"the sample time of {path}, {measured:g} s, is not the generator's {sample_time:g} s; "
                f"give {measured:g} to interpolate linearly",
            )
        return values
    if measured is not None and _differs(measured, file_sample_time, values.size):
        raise refused(
            "sample_time", file_sample_time, f"the time column of {path} states {measured:g} s; give this value, or 0"
        )
    if not _differs(file_sample_time, sample_time, values.size):
        return values
    count = int(np.floor((values.size - 1) * file_sample_time / sample_time + 1e-6)) + 1
    if count > LARGEST_TABLE:
        raise refused(
            "sample_time",
            file_sample_time,
            f"interpolation of {path} would give {count} samples; allowed: ≤ {LARGEST_TABLE}",
        )
    grid = np.arange(count) * (sample_time / file_sample_time)
    return np.interp(grid, np.arange(values.size), values)


def _differs(first: float, second: float, count: int) -> bool:
    """Return whether two sample times drift apart by more than the tolerance over ``count`` samples."""
    return abs(first - second) * max(count - 1, 1) > GRID_TOLERANCE * second


def _uniform_sample_time(time: np.ndarray, refused) -> float | None:
    if time.size < 2:
        return None
    mean = float(time[-1] - time[0]) / (time.size - 1)
    deviation = np.abs(time - (time[0] + np.arange(time.size) * mean))
    if not mean > 0.0 or not np.max(deviation) <= GRID_TOLERANCE * mean:
        raise refused("its time column must grow in equal steps")
    return mean


def _name_and_unit(text: str) -> tuple[str, str | None]:
    """Split ``reference [m]``, ``reference (m)`` or ``reference_m`` into name and unit."""
    match = re.fullmatch(r"\s*(.*?)\s*[\[(]\s*(\S+?)\s*[\])]\s*", text)
    if match is None:
        units = "|".join([*LENGTH_UNITS, *TIME_UNITS])
        match = re.fullmatch(rf"\s*(.*?)_({units})\s*", text)
    return (match[1], match[2]) if match else (text.strip(), None)


def read_columns(source: pathlib.Path, columns: Sequence[str]) -> tuple[np.ndarray | None, list[np.ndarray]]:
    """Return the column ``time`` [s] of a CSV or NPZ (None if there is no such column), and the columns of lengths [m].

    The suffix determines the format; ``columns`` contains names without units, and the header of a CSV states the
    units. KeyError: a column or its unit is missing. ValueError: the columns are not numbers of equal length.
    """
    return (_read_npz if source.suffix.lower() == ".npz" else _read_csv)(source, columns)


def _read_csv(source: pathlib.Path, columns: Sequence[str]):
    with source.open(newline="", encoding="utf-8-sig") as stream:
        rows = csv.reader(line for line in stream if line.strip() and not line.startswith("#"))
        header = [_name_and_unit(text) for text in next(rows, [])]
        names = [name for name, _ in header]
        wanted = []
        for column in columns:
            if column not in names:
                named = "such column" if len(columns) == 1 else f"column {column}"
                raise KeyError(f"{source} has no {named}; its header has {', '.join(names) or 'nothing'}")
            unit = header[names.index(column)][1]
            if unit not in LENGTH_UNITS:
                raise KeyError(
                    f"its header in {source} must name the unit, e.g. {column} [m]; allowed: {', '.join(LENGTH_UNITS)}"
                )
            wanted.append((names.index(column), LENGTH_UNITS[unit]))
        if "time" in names:
            unit = header[names.index("time")][1]
            if unit not in TIME_UNITS:
                raise ValueError("the header of column time must name its unit: time [s] or time [ms]")
            wanted.append((names.index("time"), TIME_UNITS[unit]))
        data: list[list[float]] = [[] for _ in wanted]
        for number, row in enumerate(rows):
            if len(row) != len(header):
                raise ValueError(f"data row {number} has {len(row)} fields, the header {len(header)}")
            for target, (index, factor) in zip(data, wanted, strict=True):
                target.append(float(row[index]) * factor)
    found = [np.array(values, dtype=float) for values in data]
    return (found.pop() if "time" in names else None), found


def _read_npz(source: pathlib.Path, columns: Sequence[str]):
    arrays = read_arrays(source)
    for column in columns:
        if column not in arrays:
            named = "such array" if len(columns) == 1 else f"array {column}"
            raise KeyError(f"{source} has no {named}; it has {', '.join(arrays) or 'nothing'}")
    time = _real(arrays["time"]) if "time" in arrays else None
    found = [_real(arrays[column]) for column in columns]
    for column, values in zip(columns, found, strict=True):
        if time is not None and time.shape != values.shape:
            raise ValueError(f"time has shape {time.shape} and {column} {values.shape}; they must be equal")
    return time, found


def _read_npy(source: pathlib.Path, columns: Sequence[str]):
    return None, [_real(read_array(source))]


def _real(array: np.ndarray) -> np.ndarray:
    """Return an array of numbers as float64; refuse texts and complex numbers."""
    if array.dtype.kind not in "biuf":
        raise ValueError(f"holds an array of {array.dtype}, not of real numbers")
    return array.astype(float)


COUNT, REPEAT, TABLE = OWN, OWN + 1, OWN + 2  # number of entries, period [samples], samples


@dataclass(frozen=True)
class FileParameters(Parameters):
    """Samples from CSV, NPZ or NPY, repeated in every cycle."""

    path: str = parameter(
        description="CSV (header names units), NPZ or NPY file",
        place="files",
    )
    column: str = parameter("reference", description="column of the CSV (without unit) or array of the NPZ")
    sample_time: float = parameter(
        0.0,
        description="sample time of the file (linear interpolation); 0: the file has the generator's sample time",
        unit="s",
        low=0.0,
    )


@kernel
def file(p, x, u):
    """Return the sample of the table, which repeats."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[TABLE + int(k % p[REPEAT])]


def pack(parameters, sample_time: float) -> Packed:
    """Return the waveform with the samples of the file.

    Raises
    ------
    ParameterError
        The file is missing or does not fit.
    """
    own, p = parameters.file, head(parameters)
    table = read_samples(own.path, own.column, own.sample_time, sample_time, f"{PREFIX}file.")
    p[END] = parameters.cycles * table.size
    p[FINAL] = parameters.offset + table[-1]
    return Packed(
        np.concatenate([p, [table.size, table.size], table]),
        file,
        parameters.offset + float(np.min(table)),
        parameters.offset + float(np.max(table)),
        None if parameters.cycles else table.size,
    )


WAVEFORM = WaveformShape(
    name="file",
    pack=pack,
    parameters=FileParameters,
    takes_frequency=False,
    takes_phase=False,
    extent="file.path",
)
