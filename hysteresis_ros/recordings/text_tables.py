# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Text tables of anybody's making: where the numbers begin, what is between them, and how they are written.

The layout is found from the first lines: encoding, lines before the table, names and units of the columns, delimiter,
decimal comma. The numbers are read by NumPy's own reader, block by block, so that only the columns that are wanted
stand in memory; a block with cells that are no numbers is read again cell by cell.
"""

from __future__ import annotations

import csv
import itertools
import pathlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.units import column_unit, named_column
from hysteresis_ros.units import conversion

#: The layout is found from this many bytes.
HEAD = 1 << 18
#: Lines read at a time.
BLOCK = 100_000
#: Rows at the end of the head that tell delimiter and width.
TELLING = 200
#: A table of which a larger part of the rows is damaged is none.
DAMAGED = 0.01
_COMMENTS = ("#", "%", "//")
_DELIMITERS = (";", "\t", ",", None)


@dataclass(frozen=True)
class Layout:
    """How a text table is written.

    Parameters
    ----------
    encoding : str
    delimiter : str or None
        None: blanks.
    comma : bool
        Decimal commas.
    first : int
        Lines before the first row.
    names : tuple of str
        Of the columns, ``1``, ``2`` … where nothing names them.
    units : dict of str to (str or None)
    notes : tuple of str
        What a reader of the table should know.
    """

    encoding: str
    delimiter: str | None
    comma: bool
    first: int
    names: tuple[str, ...]
    units: dict[str, str | None]
    notes: tuple[str, ...]


def find_layout(path: pathlib.Path) -> Layout:
    """Return how a text table is written.

    Parameters
    ----------
    path : Path

    Raises
    ------
    RecordingError
        The file cannot be read, holds no rows of numbers, or two of its columns have one name.
    """
    encoding, lines = _head(path)
    kept = [line for line in lines if _cells_of(line)]
    if not kept:
        raise RecordingError(f"{path}: holds no samples")
    delimiter, comma, width = _how_written(path, kept[-TELLING:])
    rows = [_split(line, delimiter) if _cells_of(line) else [] for line in lines]
    first = next(k for k, row in enumerate(rows) if len(row) == width and _is_row(row, comma))
    names, units, used = _names(lines[:first], delimiter, width)
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise RecordingError(f"{path}: column {', '.join(repeated)} appears more than once")
    notes = []
    before = sum(bool(line.strip()) and not line.lstrip().startswith(_COMMENTS) for line in lines[:first]) - used
    if before > 0:
        notes.append(f"{before} lines before the table passed over")
    if comma:
        notes.append("decimal commas")
    if encoding == "latin-1":
        notes.append("not UTF-8: read as Latin-1")
    return Layout(encoding, delimiter, comma, first, tuple(names), units, tuple(notes))


def read_columns(
    path: pathlib.Path, layout: Layout, names, progress: Callable[[float], None] | None = None
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Read the named columns of a text table; cells that are no numbers become NaN.

    Parameters
    ----------
    path : Path
    layout : Layout
        From :func:`find_layout`.
    names : sequence of str
    progress : callable, optional
        Called with the part of the file that was read.

    Returns
    -------
    columns : dict of str to ndarray, shape (N,)
        In the file's own units.
    warnings : tuple of str
        Damaged rows, with how many there are and where the first is.

    Raises
    ------
    RecordingError
        The file cannot be read, or too many of its rows have another number of cells.
    """
    wanted = [layout.names.index(name) for name in names]
    damaged: list[tuple[int, int]] = []
    blocks, rows, done = [], 0, 0
    size = max(path.stat().st_size, 1)
    try:
        with path.open(encoding=layout.encoding, errors="replace", newline=None) as stream:
            line_number = layout.first
            done += sum(map(len, itertools.islice(stream, layout.first)))
            while lines := list(itertools.islice(stream, BLOCK)):
                done += sum(map(len, lines))
                blocks.append(_numbers(lines, layout, wanted, line_number, damaged))
                line_number += len(lines)
                rows += len(blocks[-1])
                if progress is not None:
                    progress(min(done / size, 1.0))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    if len(damaged) > max(DAMAGED * rows, 1):
        line, cells = damaged[0]
        raise RecordingError(
            f"{path}: {len(damaged)} of {rows} rows have another number of cells than the {len(layout.names)} columns "
            f"(line {line}: {cells}); is the delimiter '{layout.delimiter or ' '}' right?"
        )
    columns = {}
    for k, name in enumerate(names):
        columns[name] = np.concatenate([block[:, k] for block in blocks]) if blocks else np.empty(0)
    warnings: tuple[str, ...] = ()
    if damaged:
        line, cells = damaged[0]
        warnings = (f"{len(damaged)} damaged rows, the first in line {line} ({cells} cells): taken as missing",)
    return columns, warnings


def _head(path):
    """Return encoding and first lines of a file."""
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    encoding = "utf-8-sig"
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    elif b"\0" in head:
        raise RecordingError(f"{path}: not a text table: it holds zero bytes; give CSV, TXT, NPZ or MAT")
    whole = len(head) < HEAD
    cut = head if whole else head[: head.rfind(b"\n") + 1] or head
    try:
        text = cut.decode(encoding, "strict" if encoding != "utf-16" else "ignore")
    except UnicodeDecodeError:
        encoding, text = "latin-1", cut.decode("latin-1")
    return encoding, text.splitlines()


def _how_written(path, lines):
    """Return delimiter, decimal comma and width of the rows: what makes most of the lines rows of numbers."""
    best, found = 0, None
    for delimiter, comma in itertools.product(_DELIMITERS, (False, True)):
        if delimiter == "," and comma:
            continue
        rows = [row for row in (_split(line, delimiter) for line in lines) if _is_row(row, comma, strict=True)]
        several = [len(row) for row in rows if len(row) > 1]
        if len(several) > best:
            best, found = len(several), (delimiter, comma, max(set(several), key=several.count))
    if found is None:
        found = _with_text(lines)
    if found is None and all(_number(line, False) is not None for line in lines[1:] or lines):
        found = None, False, 1
    if found is None:
        raise RecordingError(f"{path}: not a table of numbers: no delimiter makes columns of its last lines")
    return found


def _with_text(lines):
    """Return delimiter, decimal comma and width of rows that hold texts beside numbers, None where there are none."""
    best, found = 0, None
    for delimiter, comma in itertools.product(_DELIMITERS, (False, True)):
        rows = [row for row in (_split(line, delimiter) for line in lines) if len(row) > 1 and _is_row(row, comma)]
        if not (delimiter == "," and comma) and len(rows) > best:
            widths = [len(row) for row in rows]
            best, found = len(rows), (delimiter, comma, max(set(widths), key=widths.count))
    return found


def _is_row(row, comma, strict=False) -> bool:
    """Tell whether the cells are those of a row of numbers; strict: none of them is text."""
    filled = [cell for cell in row if cell]
    numbers = sum(_number(cell, comma) is not None for cell in filled)
    return bool(numbers) and (numbers == len(filled) or (not strict and 2 * numbers >= len(filled) and len(row) > 2))


def _names(before, delimiter, width):
    """Return names and units of the columns, and how many lines gave them, from the lines above the first row."""
    above = [line for line in before if line.strip()]
    units_row: list[str] = []
    for used, line in enumerate(reversed(above[-3:])):
        commented = line.lstrip().startswith(_COMMENTS)
        text = line.lstrip().lstrip("#%/ ") if commented else line
        row = _fitting(text, delimiter, width)
        if row is None:
            continue
        if not units_row and used == 0 and all(not cell or conversion(cell.strip("[](){} ")) for cell in row):
            units_row = [cell.strip("[](){} ") for cell in row]
            continue
        row = [cell or str(k + 1) for k, cell in enumerate(row)]
        parts = [named_column(cell) for cell in row]
        units = dict(parts)
        if units_row:
            units |= {name: unit for (name, _), unit in zip(parts, units_row, strict=True) if unit}
        return [name for name, _ in parts], units, (0 if commented else 1) + bool(units_row)
    names = [str(k + 1) for k in range(width)]
    units = {name: column_unit(name, unit or None) for name, unit in zip(names, units_row or width * [""], strict=True)}
    return names, units, bool(units_row)


def _fitting(text, delimiter, width):
    """Return the cells of a header, None where no delimiter makes as many as there are columns."""
    for mark in (*([] if delimiter is None else [delimiter]), ",", ";", "\t", None):
        row = _split(text, mark)
        if mark == delimiter and width > 1:
            # the rows lack a last column (a comment), or end with a delimiter that the header lacks
            row = (
                row[:width] if len(row) == width + 1 else [*row, ""] if len(row) == width - 1 > 1 and all(row) else row
            )
        if len(row) == width and any(cell and _number(cell, False) is None for cell in row):
            return row
    return None


def _cells_of(line) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(_COMMENTS)


def _split(line, delimiter):
    if delimiter is None:
        return line.replace('"', "").split()
    return [cell.strip() for cell in next(csv.reader([line.strip("\r\n")], delimiter=delimiter), [])]


def _number(cell, comma):
    """Return the number in a cell, None where there is none."""
    try:
        return float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return None


def _numbers(lines, layout, wanted, line_number, damaged):
    """Return the wanted columns of a block of lines, shape (n, m)."""
    text = [line.replace(",", ".") for line in lines] if layout.comma else lines
    try:
        return np.loadtxt(
            text, delimiter=layout.delimiter, usecols=wanted, ndmin=2, dtype=np.float64, comments="#", quotechar='"'
        )
    except ValueError:
        pass  # some cell is empty or text: cell by cell, which is slower but can say where
    table = np.full((len(lines), len(wanted)), np.nan)
    width, k = len(layout.names), 0
    for number, line in enumerate(lines, line_number + 1):
        if not _cells_of(line):
            continue
        cells = _split(line, layout.delimiter) if '"' in line else line.rstrip("\r\n").split(layout.delimiter)
        if len(cells) == width:
            for column, place in enumerate(wanted):
                value = _number(cells[place], layout.comma)
                if value is not None:
                    table[k, column] = value
        else:
            damaged.append((number, len(cells)))
        k += 1
    return table[:k]
