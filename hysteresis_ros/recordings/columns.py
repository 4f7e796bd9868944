# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Tables of anybody's making: columns of any name, chosen together with their units and brought to SI.

:mod:`hysteresis_ros.recordings.tables` reads and writes the package's own tables, where every header names a unit.
Recordings from elsewhere name their columns ``control_V`` or ``y``; what is missing there, the user gives.
"""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.archives import ArchiveError, read_arrays, read_heads
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.clock import Clock, mend_clock
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.matlab_files import read_matlab
from hysteresis_ros.recordings.text_tables import find_layout, read_columns
from hysteresis_ros.recordings.units import column_unit, known_conversion, si_unit, split_choice
from hysteresis_ros.units import conversion

#: Kinds of files that are read as tables: text, NPZ and MATLAB.
TABLE_SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".asc", ".lvm", ".npz", ".mat")

_TIME_NAMES = ("time", "t", "timestamp", "time_s", "t_s", "time_ms", "t_ms", "time_us", "t_us", "zeit", "x_value")


@dataclass(frozen=True, eq=False)
class Table:
    """A table that was opened: its columns' names and units; the numbers are read when they are asked for.

    Parameters
    ----------
    path : Path
    units : dict of str to (str or None)
        Of each column what it declares (:func:`~hysteresis_ros.recordings.units.column_unit`).
    load : callable
        ``load(names, progress)`` returns the columns, in the file's own units, and warnings.
    notes : tuple of str
        How the table is written.
    """

    path: pathlib.Path
    units: dict[str, str | None]
    load: Callable
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Selection:
    """What is taken of a table.

    Parameters
    ----------
    choices : tuple of str
        Columns as ``name`` or ``name:unit``; the unit may be left out where the column declares it.
    time : str, optional
        The time column, likewise; by default the one called ``time``, ``t``, ``time_s`` … or the only one in seconds.
    sample_time : float, optional
        Distance of two samples [s] for tables without a time column.
    rows : (int, int or None)
        First row and the one after the last; None: all from there, negative: from the end.
    """

    choices: tuple[str, ...]
    time: str | None = None
    sample_time: float | None = None
    rows: tuple[int, int | None] = (0, None)


def open_table(path) -> Table:
    """Open a text table, an NPZ or a MATLAB file.

    Text: comma, semicolon, tab or blanks between the columns, decimal points or commas, ``#`` starts a comment; lines
    before the table are passed over, the last of them may name the columns (``name`` or ``name [unit]``); without names
    they are called ``1``, ``2`` … Cells that are no numbers become NaN.

    Parameters
    ----------
    path : path-like
        ``.csv``, ``.txt``, ``.dat``, ``.tsv``, ``.asc``, ``.lvm``, ``.npz`` or ``.mat``.

    Raises
    ------
    RecordingError
        The file is missing or unreadable, or two columns have one name.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; give the path of a recording")
    if path.suffix.lower() == ".npz":
        return _open_arrays(path)
    if path.suffix.lower() == ".mat":
        arrays = read_matlab(path)
        return Table(path, _declared(arrays), lambda names, progress: ({name: arrays[name] for name in names}, ()))
    layout = find_layout(path)
    return Table(path, layout.units, lambda names, progress: read_columns(path, layout, names, progress), layout.notes)


def find_time(units: dict[str, str | None]) -> str | None:
    """Return the name of the time column among ``units`` (names → declared units), or None.

    Parameters
    ----------
    units : dict of str to (str or None)
        Those of a :class:`Table`.
    """
    known = [name for telling in _TIME_NAMES for name in units if name.lower() == telling]
    seconds = [name for name, unit in units.items() if si_unit(unit) == "s"]
    return known[0] if known else (seconds[0] if len(seconds) == 1 else None)


def choose_columns(table: Table, selection: Selection, progress=None) -> Recording:
    """Read chosen columns of a table into a recording in SI units.

    Parameters
    ----------
    table : Table
    selection : Selection
    progress : callable, optional
        Called with the part of the file that was read.

    Returns
    -------
    Recording
        Its metadata hold ``notes`` and ``warnings``: what was found odd and what was done about it.

    Raises
    ------
    RecordingError
        A column is missing, has no unit or an unknown one, or there is no time.
    """
    # a column called time or t without a unit is in seconds, as everywhere in this package
    declared = {name: unit or ("s" if name.lower() in _TIME_NAMES else None) for name, unit in table.units.items()}
    chosen = {name: (divisor, unit) for name, divisor, unit in (_chosen(table, c, declared) for c in selection.choices)}
    time = selection.time
    if time is None and selection.sample_time is None:
        time = find_time(declared)
        if time is None:
            there = ", ".join(declared)
            raise RecordingError(
                f"{table.path}: no time among {there}; name it like 'time_s:s' or give the sample time"
            )
    clock_name, divisor = None, 1.0
    if time is not None:
        clock_name, divisor, unit = _chosen(table, time, declared)
        if unit != "s":
            raise RecordingError(
                f"{table.path}: time column '{clock_name}' is in '{unit}'; it must be in s, ms, us or min"
            )
    wanted = list(dict.fromkeys([*chosen, *([clock_name] if clock_name is not None else [])]))
    columns, warnings = table.load(wanted, progress)
    columns = _rows(columns, selection.rows)
    if clock_name is None:
        size = len(next(iter(columns.values())))
        clock = Clock(np.arange(size) * float(selection.sample_time or 0.0))
    else:
        seconds = columns[clock_name] / divisor
        clock = mend_clock(seconds, [values for name, values in columns.items() if name != clock_name])
    signals = {}
    for name, (scale, _) in chosen.items():
        values = columns.pop(name)
        values = values if clock.kept is None else values[clock.kept]
        signals[name] = values if scale == 1.0 else values / scale
    metadata = {
        "source": table.path.name,
        "notes": [*table.notes, *clock.notes],
        "warnings": [*warnings, *clock.warnings],
    }
    try:
        return Recording(clock.time, signals, {name: unit for name, (_, unit) in chosen.items()}, metadata)
    except RecordingError as error:
        raise RecordingError(f"{table.path}: {error}") from None


def _rows(columns, rows):
    """Return the rows that are wanted of all columns."""
    size = len(next(iter(columns.values())))
    start, stop, _ = slice(*rows).indices(size)
    if rows == (0, None):
        return columns
    if rows[0] < 0 or stop <= start or (rows[1] is not None and rows[1] > size):
        last = "" if rows[1] is None else rows[1]
        raise RecordingError(f"samples {rows[0]}:{last} of {size}: choose a range inside the recording")
    return {name: values[start:stop] for name, values in columns.items()}


def _chosen(table, choice, declared):
    """Return name, divisor and SI unit of one choice."""
    name, unit = (choice, None) if choice in declared else split_choice(choice)
    if name not in declared:
        raise RecordingError(f"{table.path}: no column '{name}'; the columns are {', '.join(declared)}")
    other = declared[name]
    unit = unit or other
    if unit is None:
        raise RecordingError(f"{table.path}: column '{name}' has no unit; give it as '{name}:um' or whatever it is in")
    si, divisor = known_conversion(name, unit)
    stands = conversion(other) if other is not None and other != unit else None
    if stands is not None and stands[0] == "V" and "/" in unit:
        divisor *= stands[1]  # a sensor's sensitivity beside what its converter read
    elif stands not in (None, (si, divisor)):
        raise RecordingError(
            f"{table.path}: column '{name}' is in '{other}' by its header and '{unit}' was asked; which?"
        )
    return name, divisor, si


def _declared(names) -> dict[str, str | None]:
    """Return the units that names tell, also those of fields of structures."""
    return {name: column_unit(name) or column_unit(name.rpartition(".")[2]) for name in names}


def _open_arrays(path) -> Table:
    try:
        heads = read_heads(path)
    except (OSError, ArchiveError) as error:
        raise RecordingError(f"{path}: not a readable NPZ file: {error}") from None
    sizes = {name: head.length for name, head in heads.items() if head.length is not None}
    lengths = list(sizes.values())
    size = max(lengths, key=lambda length: (lengths.count(length), length), default=0)
    if lengths.count(size) < min(2, max(len(lengths), 1)):
        raise RecordingError(f"{path}: needs one-dimensional arrays of one length; it has lengths {sorted(lengths)}")
    declared = _declared(name for name, length in sizes.items() if length == size)

    def load(names, progress):
        try:
            arrays = read_arrays(path, names.__contains__)
        except (OSError, ArchiveError) as error:
            raise RecordingError(f"{path}: not a readable NPZ file: {error}") from None
        return {name: np.asarray(arrays[name], dtype=float) for name in names}, ()

    return Table(path, declared, load)
