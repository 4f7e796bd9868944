# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Tables of any origin (text, MATLAB, NumPy): columns of any name are selected, and converted to SI.

The layout of a text table is determined from its first lines: encoding, lines before the table, names and units of the
columns, delimiter, decimal comma. NumPy reads the numbers block by block, so that only the selected columns are in
memory; a block with cells that are not numbers is read again cell by cell.

MATLAB files are checked before SciPy reads them, because SciPy does not check types, sizes and dimensions: a damaged
file can crash the process by an access to invalid memory. Source: The MathWorks, MAT-File Format, "Level 5 MAT-Files",
tables 1-1 and 1-3.

:mod:`hysteresis_ros.recordings.files` reads and writes the package's own tables, in which every header names a unit.
Other tables may name their columns ``control_V`` or ``y``; the user gives the missing units.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
import pathlib
import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import ArchiveError, read_arrays, read_heads
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.signals import UNITS as SIGNAL_UNITS
from hysteresis_ros.units import UNITS, conversion, readable

_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({<](?P<unit>[^\[\](){}<>]+)[\])}>]$")
_AFTER = re.compile(r"^(?P<name>.+?)(?:\s*/\s*|\s+in\s+|\s*:\s*|,\s*|\s+)(?P<unit>\S+)$")


def named_column(cell: str) -> tuple[str, str | None]:
    """Split a cell of a header into the column's name and its declared unit; the unit is None if not declared."""
    cell = cell.strip()
    for pattern in (_BRACKETS, _AFTER):
        found = pattern.match(cell)
        if found and (pattern is _BRACKETS or conversion(found["unit"])):
            return found["name"].strip(), column_unit(found["name"].strip(), found["unit"].strip())
    return cell, column_unit(cell)


def column_unit(name: str, header_unit: str | None = None) -> str | None:
    """Return the unit of a column that its header, a known signal name, or a suffix (``control_V``) declares."""
    suffix = name.rsplit("_", 1)[-1] if "_" in name else ""
    return header_unit or SIGNAL_UNITS.get(name) or (suffix if suffix[:1].isalpha() and conversion(suffix) else None)


def si_unit(unit: str | None) -> str | None:
    """Return the SI unit of a declared unit; an unknown unit is returned unchanged."""
    return unit if unit in (None, "%") else (conversion(unit) or (unit,))[0]


def split_choice(choice: str) -> tuple[str, str | None]:
    """Split ``name:unit`` into name and unit; the unit is None without a colon."""
    name, colon, unit = choice.rpartition(":")
    if not colon:
        return choice, None
    known_conversion(name, unit)
    return name, unit


def known_conversion(name: str, unit: str) -> tuple[str, float]:
    """Return the result of :func:`conversion`; raise RecordingError for an unknown unit."""
    found = ("%", 1.0) if unit.strip() == "%" else conversion(unit)  # a column in % stays in %
    if found is None:
        raise RecordingError(f"column '{name}': unknown unit '{unit}'; known are {', '.join(UNITS)}, and 10um/V")
    return found


#: Largest deviation of rounded times from a uniform grid, as a multiple of the rounding.
ROUNDED = 1.01
#: Times count as rounded if more than this fraction of the rows has the time of the previous row; :data:`WRITTEN_TWICE`
#: applies instead if all these rows also repeat the values of the previous row, as duplicates do.
SHARED = 0.05
#: Decreasing times count as jitter if no time deviates from a uniform grid by more than this fraction of the duration.
DISORDERED = 0.005
WRITTEN_TWICE = 0.4


@dataclass(frozen=True, eq=False)
class Clock:
    """A time axis."""

    time: np.ndarray  #: shape (N,) [s], finite and strictly increasing.
    kept: np.ndarray | None = None  #: shape (M,); Rows of the table that are samples; None: all.
    notes: tuple[str, ...] = ()  #: notes, warnings: Descriptions of corrections of the times.
    warnings: tuple[str, ...] = ()


def mend_clock(time: np.ndarray, signals) -> Clock:
    """Return the corrected time axis from a column of times.

    Rows without a time are omitted. Rounded times that several rows share are spread over a uniform grid. If times are
    not rounded, a row with the time of the previous row is omitted, whatever its values are.

    Units: ``time`` [s].
    """
    warnings = []
    finite = np.isfinite(time)
    kept = None if finite.all() else finite
    if kept is not None:
        count = int(np.count_nonzero(~finite))
        warnings.append(f"{count} rows without a time omitted; the first is row {int(np.argmin(finite))}")
    instants = time if kept is None else time[kept]
    distances = np.diff(instants)
    if np.all(distances > 0.0):
        return Clock(instants, kept, (), tuple(warnings))
    if np.any(distances < 0.0):
        grid = np.linspace(instants[0], instants[-1], len(instants))
        beside = float(np.max(np.abs(instants - grid)))
        if not beside <= DISORDERED * (grid[-1] - grid[0]):
            k = int(np.argmax(distances < 0.0))
            raise RecordingError(
                f"time goes back from {instants[k]:.9g} s to {instants[k + 1]:.9g} s after row {k}; give a range of "
                "one run"
            )
        warnings.append(
            f"time goes back {np.count_nonzero(distances < 0.0)} times, by up to {readable(-distances.min(), 's')}: "
            f"the rows are assumed to be uniform, {readable(grid[1] - grid[0], 's')} apart (times deviate by up to "
            f"{readable(beside, 's')}); shorter lags cannot be identified"
        )
        return Clock(grid, kept, (), tuple(warnings))
    if len(instants) < 2 or instants[-1] == instants[0]:
        raise RecordingError(f"all {len(instants)} times are {instants[0]:.9g} s; give the sample time instead")
    again = np.append(False, distances == 0.0)
    columns = [values if kept is None else values[kept] for values in signals]
    same = again.copy()
    for values in columns:
        same[1:] &= (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    rounding = float(np.min(distances[distances > 0.0]))
    grid = np.linspace(instants[0], instants[-1], len(instants))
    beside = np.max(np.abs(instants - grid))
    if beside <= ROUNDED * rounding and np.mean(again) > (WRITTEN_TWICE if np.all(same == again) else SHARED):
        share = len(instants) / np.count_nonzero(~again)
        note = f"time is rounded to {readable(rounding, 's')}, so {share:.3g} samples share a time: assumed uniform, "
        return Clock(grid, kept, (note + f"{readable(grid[1] - grid[0], 's')} apart",), tuple(warnings))
    twice, other = int(np.count_nonzero(same)), int(np.count_nonzero(again & ~same))
    at = int(np.argmax(again))
    words = [f"{twice} rows that repeat the previous one"] if twice else []
    words += [f"{other} rows with the time of the previous one and other values"] if other else []
    warnings.append(f"{' and '.join(words)} omitted; the first at {instants[at]:.9g} s (row {at})")
    if kept is None:
        kept = ~again
    else:
        kept[np.flatnonzero(kept)[again]] = False
    return Clock(instants[~again], kept, (), tuple(warnings))


#: Number of bytes used to detect the layout.
HEAD = 1 << 18
#: Number of lines that are read at a time.
BLOCK = 100_000
#: Delimiter and width are detected from this number of rows at the end of the first HEAD bytes.
TELLING = 200
#: Largest fraction of damaged rows in a table.
DAMAGED = 0.01
_COMMENTS = ("#", "%", "//")
_DELIMITERS = (";", "\t", ",", None)


@dataclass(frozen=True)
class Layout:
    """Layout of a text table."""

    encoding: str
    delimiter: str | None  #: None: blanks.
    comma: bool  #: Decimal commas.
    first: int  #: Number of lines before the first row.
    names: tuple[str, ...]  #: Names of the columns; ``1``, ``2`` … if the table has no names.
    units: dict[str, str | None]
    notes: tuple[str, ...]  #: Notes for the user.


def find_layout(path: pathlib.Path) -> Layout:
    """Return the layout of a text table."""
    encoding, lines = _head(path)
    kept = [line for line in lines if _cells_of(line)]
    if not kept:
        raise RecordingError(f"{path}: contains no samples")
    delimiter, comma, width = _how_written(path, kept[-TELLING:])
    rows = [_split(line, delimiter) if _cells_of(line) else [] for line in lines]
    first = next(k for k, row in enumerate(rows) if len(row) == width and _is_row(row, comma))
    names, units, used = _names(lines[:first], delimiter, width)
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise RecordingError(f"{path}: column {', '.join(repeated)} appears more than once; rename one of them")
    notes = []
    before = sum(bool(line.strip()) and not line.lstrip().startswith(_COMMENTS) for line in lines[:first]) - used
    if before > 0:
        notes.append(f"{before} lines before the table skipped")
    if comma:
        notes.append("decimal commas")
    if encoding == "latin-1":
        notes.append("not UTF-8: read as Latin-1")
    return Layout(encoding, delimiter, comma, first, tuple(names), units, tuple(notes))


def read_columns(
    path: pathlib.Path, layout: Layout, names, progress: Callable[[float], None] | None = None
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Read the named columns of a text table; cells that are not numbers become NaN."""
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
            f"{path}: {len(damaged)} of {rows} rows have a different number of cells than the {len(layout.names)} "
            "columns "
            f"(line {line}: {cells}); is the delimiter '{layout.delimiter or ' '}' right?"
        )
    columns = {}
    for k, name in enumerate(names):
        columns[name] = np.concatenate([block[:, k] for block in blocks]) if blocks else np.empty(0)
    warnings: tuple[str, ...] = ()
    if damaged:
        line, cells = damaged[0]
        warnings = (f"{len(damaged)} damaged rows, the first in line {line} ({cells} cells): treated as missing",)
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
        raise RecordingError(f"{path}: not a text table: it contains zero bytes; give CSV, TXT, NPZ or MAT")
    whole = len(head) < HEAD
    cut = head if whole else head[: head.rfind(b"\n") + 1] or head
    try:
        text = cut.decode(encoding, "strict" if encoding != "utf-16" else "ignore")
    except UnicodeDecodeError:
        encoding, text = "latin-1", cut.decode("latin-1")
    return encoding, text.splitlines()


def _how_written(path, lines):
    """Return delimiter, whether the comma is decimal, and number of columns that fit most lines as rows of numbers."""
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
        raise RecordingError(f"{path}: not a table of numbers: no delimiter splits its last lines into columns")
    return found


def _with_text(lines):
    """Return delimiter, whether the comma is decimal, and number of columns of rows with numbers and texts, or None."""
    best, found = 0, None
    for delimiter, comma in itertools.product(_DELIMITERS, (False, True)):
        rows = [row for row in (_split(line, delimiter) for line in lines) if len(row) > 1 and _is_row(row, comma)]
        if not (delimiter == "," and comma) and len(rows) > best:
            widths = [len(row) for row in rows]
            best, found = len(rows), (delimiter, comma, max(set(widths), key=widths.count))
    return found


def _is_row(row, comma, strict=False) -> bool:
    """Return whether the cells form a row of numbers; with ``strict``, texts are not allowed."""
    filled = [cell for cell in row if cell]
    numbers = sum(_number(cell, comma) is not None for cell in filled)
    return bool(numbers) and (numbers == len(filled) or (not strict and 2 * numbers >= len(filled) and len(row) > 2))


def _names(before, delimiter, width):
    """Return names and units of the columns from the lines above the first row, and the number of lines used."""
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
    """Return the cells of a header; None if no delimiter gives as many cells as there are columns."""
    for mark in (*([] if delimiter is None else [delimiter]), ",", ";", "\t", None):
        row = _split(text, mark)
        if mark == delimiter and width > 1:
            # rows may lack the last column (a comment), or may end with a delimiter while the header does not
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
    """Return the number in a cell, or None."""
    try:
        return float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return None


def _numbers(lines, layout, wanted, line_number, damaged):
    """Return the selected columns of a block of lines, shape (n, m)."""
    text = [line.replace(",", ".") for line in lines] if layout.comma else lines
    try:
        return np.loadtxt(
            text, delimiter=layout.delimiter, usecols=wanted, ndmin=2, dtype=np.float64, comments="#", quotechar='"'
        )
    except ValueError:
        pass  # a cell is empty or text: reading cell by cell is slower, but only this cell becomes NaN
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


#: Length of the header before the first element [bytes]; the last four bytes are version and byte order.
HEADER = 128
#: Byte order by the last four bytes of the header.
ORDERS = {b"\0\1IM": "<", b"\1\0MI": ">"}
#: Last four bytes of the header of HDF5 files (since MATLAB 7.3).
HDF5 = (b"\0\2IM", b"\2\0MI")
#: Types of elements that are treated separately.
INT32, UINT32, MATRIX, COMPRESSED = 5, 6, 14, 15
#: All valid types of elements.
TYPES = (*range(1, 8), 9, *range(12, 19))
#: Classes of arrays: cells, structures, objects, texts, sparse, functions, opaque; all others are numerical.
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
#: Largest depth of nested elements.
DEEPEST = 20
#: Unpacked size that is always allowed [bytes].
SMALL = 1 << 26
#: Largest compression ratio of larger content.
RATIO = 100


def is_hdf5(content: bytes) -> bool:
    """Return whether the content is HDF5 with a MATLAB header, the format since version 7.3."""
    return 0 not in content[:4] and content[HEADER - 4 : HEADER] in HDF5


def require_sound(content: bytes) -> None:
    """Refuse an inconsistent file of level 5; level 4 is not checked."""
    mark = content[HEADER - 4 : HEADER]
    if 0 in content[:4]:
        return
    if mark not in ORDERS:
        raise ValueError("no header of a MATLAB file")
    order = ORDERS[mark]
    for kind, data in _elements(content[HEADER:], order, padded=False):
        if kind == COMPRESSED:
            unpacker = zlib.decompressobj()
            data = unpacker.decompress(data, max(SMALL, RATIO * len(data)))
            if unpacker.unconsumed_tail:
                raise ValueError("an element unpacks to an implausible size")
            inner = list(_elements(data, order, padded=False))
            kind, data = inner[0] if len(inner) == 1 else (0, b"")
        if kind != MATRIX:
            raise ValueError("contains something other than arrays")
        _require_array(data, order, 0)


def _elements(data: bytes, order: str, padded: bool = True):
    """Yield type and content of consecutive elements."""
    place = 0
    while place < len(data):
        (first,) = struct.unpack_from(order + "I", data, place)
        small = first >> 16
        size = small or struct.unpack_from(order + "I", data, place + 4)[0]
        kind, begin = first & 0xFFFF, place + (4 if small else 8)
        if kind not in TYPES or size > (4 if small else len(data) - begin):
            raise ValueError(f"an element of type {kind} and {size} bytes at byte {place} of {len(data)}")
        yield kind, data[begin : begin + size]
        place = begin + (4 if small else size + (-size % 8 if padded else 0))


def _require_array(data: bytes, order: str, depth: int) -> None:
    """Refuse an array whose class and dimensions do not fit its elements."""
    parts = list(_elements(data, order))
    if not parts and depth:
        return  # an empty cell
    (flags_kind, flags), (dimensions_kind, dimensions) = parts[:2] if len(parts) > 2 else ((0, b""), (0, b""))
    if flags_kind != UINT32 or len(flags) != 8 or depth > DEEPEST:
        raise ValueError("an array without class, or too deeply nested")
    array_class, is_complex = flags[0 if order == "<" else 3], flags[1 if order == "<" else 2] & 8
    if not 1 <= array_class <= OPAQUE:
        raise ValueError(f"an array of unknown class {array_class}")
    if array_class == OPAQUE:  # an opaque array has three names instead of dimensions
        _require_content(CELL, 1, parts[4:], False, (order, depth))
        return
    if dimensions_kind != INT32 or not dimensions or len(dimensions) % 4 or len(dimensions) > 4 * 32:
        raise ValueError("an array without dimensions")
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    if min(shape) < 0:
        raise ValueError(f"an array of dimensions {shape}")
    _require_content(array_class, math.prod(shape), parts[3:], bool(is_complex), (order, depth))


def _require_content(array_class: int, count: int, parts: list, is_complex: bool, where: tuple[str, int]) -> None:
    """Refuse content that does not match the number of elements of an array."""
    order, depth = where
    if array_class in (CELL, STRUCT, OBJECT, FUNCTION):
        if array_class == FUNCTION:
            count = 1
        elif array_class != CELL:
            count, parts = _fields(count, parts[array_class == OBJECT :], order)
        if len(parts) != count or any(kind != MATRIX for kind, _ in parts):
            raise ValueError(f"{len(parts)} arrays instead of {count}")
        for _, inner in parts:
            _require_array(inner, order, depth + 1)
        return
    if not count:
        return
    numbers = (3 if array_class == SPARSE else 1) + is_complex
    if len(parts) != numbers or any(kind in (MATRIX, COMPRESSED) for kind, _ in parts):
        raise ValueError(f"{len(parts)} parts of an array, which must have {numbers}")
    if array_class != SPARSE and any(len(content) < count for _, content in parts):
        raise ValueError(f"too few bytes for {count} elements")


def _fields(count: int, parts: list, order: str) -> tuple[int, list]:
    """Return how many arrays the fields of structures contain, and the parts with these arrays."""
    if len(parts) < 2 or parts[0][0] != INT32 or len(parts[0][1]) != 4:
        raise ValueError("a structure without names")
    (length,) = struct.unpack(order + "i", parts[0][1])
    if not 0 < length <= len(parts[1][1]) or len(parts[1][1]) % length:
        raise ValueError(f"names of {length} characters in {len(parts[1][1])}")
    return count * (len(parts[1][1]) // length), parts[2:]


def read_matlab(path: pathlib.Path) -> dict[str, np.ndarray]:
    """Return the vectors of the most frequent length in a ``.mat`` file."""
    import scipy.io  # imported here because it takes 0.1 s

    try:
        data = path.read_bytes()
        if is_hdf5(data):
            raise RecordingError(f"{path}: a MATLAB file of version 7.3; save it with save(…, '-v7')")
        require_sound(data)
        content = scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
    except RecordingError:
        raise
    except Exception as error:  # for damaged bytes SciPy may raise any exception
        raise RecordingError(f"{path}: not a readable MATLAB file: {error or type(error).__name__}") from None
    vectors = dict(_vectors("", {name: value for name, value in content.items() if not name.startswith("__")}))
    sizes = [values.size for values in vectors.values()]
    if not sizes:
        raise RecordingError(f"{path}: contains no vectors of numbers")
    size = max(set(sizes), key=lambda length: (sizes.count(length), length))
    return {name: values for name, values in vectors.items() if values.size == size}


def _vectors(name, value):
    """Yield name and values of every vector within ``value``."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _vectors(f"{name}.{key}" if name else key, part)
        return
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.size < 2 or array.ndim > 2:
        return
    array = np.squeeze(array).astype(float)
    if array.ndim == 1:
        yield name, array
        return
    table = array if array.shape[0] >= array.shape[1] else array.T
    for k in range(table.shape[1]):
        yield f"{name}_{k + 1}", np.ascontiguousarray(table[:, k])


#: Suffixes of tables: text, NPZ and MATLAB.
TABLE_SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".asc", ".lvm", ".npz", ".mat")

_TIME_NAMES = ("time", "t", "timestamp", "time_s", "t_s", "time_ms", "t_ms", "time_us", "t_us", "zeit", "x_value")


@dataclass(frozen=True, eq=False)
class Table:
    """An open table with names and units of its columns; the numbers are read on request."""

    path: pathlib.Path
    #: Declared unit of each column (:func:`~hysteresis_ros.recordings.foreign_tables.column_unit`).
    units: dict[str, str | None]
    load: Callable  #: ``load(names, progress)`` returns the columns in the units of the file, and warnings.
    notes: tuple[str, ...] = ()  #: Notes about the layout.


@dataclass(frozen=True)
class Selection:
    """Selection of data in a table."""

    #: Columns as ``name`` or ``name:unit``; the unit may be omitted if the column declares it.
    choices: tuple[str, ...]
    #: The time column in the same form; by default the column called ``time``, ``t``, ``time_s`` … or the only column
    #: in seconds.
    time: str | None = None
    sample_time: float | None = None  #: Sample time [s] for tables without a time column.
    #: First row, and the row after the last one (None: up to the end; negative: counted from the end).
    rows: tuple[int, int | None] = (0, None)


def open_table(path) -> Table:
    """Open a text table, an NPZ or a MATLAB file.

    Text: comma, semicolon, tab or blanks between the columns, decimal points or commas, ``#`` starts a comment; lines
    before the table are skipped, but the last such line may name the columns (``name`` or ``name [unit]``). Columns
    without names are called ``1``, ``2`` … Cells that are not numbers become NaN.
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
    """Return the name of the time column among ``units`` (names → declared units), or None."""
    known = [name for telling in _TIME_NAMES for name in units if name.lower() == telling]
    seconds = [name for name, unit in units.items() if si_unit(unit) == "s"]
    return known[0] if known else (seconds[0] if len(seconds) == 1 else None)


def choose_columns(table: Table, selection: Selection, progress=None) -> Recording:
    """Read chosen columns of a table into a recording in SI units."""
    # a column called time or t without a unit is in seconds, as in all tables of this package
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
        if seconds.size and not np.isfinite(seconds).any():
            raise RecordingError(
                f"{table.path}: time column '{clock_name}' contains no numbers, as with dates; write seconds since the "
                "start, or give another column or the sample time"
            )
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
    """Return the selected rows of all columns."""
    size = len(next(iter(columns.values())))
    start, stop, _ = slice(*rows).indices(size)
    if rows == (0, None):
        return columns
    if rows[0] < 0 or stop <= start or (rows[1] is not None and rows[1] > size):
        last = "" if rows[1] is None else rows[1]
        raise RecordingError(f"samples {rows[0]}:{last} of {size}: choose a range inside the recording")
    return {name: values[start:stop] for name, values in columns.items()}


def _chosen(table, choice, declared):
    """Return name, divisor and SI unit of a chosen column."""
    name, unit = (choice, None) if choice in declared else split_choice(choice)
    if name not in declared:
        raise RecordingError(f"{table.path}: no column '{name}'; the columns are {', '.join(declared)}")
    other = declared[name]
    unit = unit or other
    if unit is None:
        raise RecordingError(f"{table.path}: column '{name}' has no unit; give it, for instance '{name}:um'")
    si, divisor = known_conversion(name, unit)
    stands = known_conversion(name, other) if other is not None and other != unit and conversion(other) else None
    if stands is not None and stands[0] == "V" and "/" in unit:
        divisor *= stands[1]  # a sensitivity (10um/V) converts a sensor's voltage
    elif stands not in (None, (si, divisor)):
        raise RecordingError(
            f"{table.path}: column '{name}' has the unit '{other}' in its header, not '{unit}'; give the right unit"
        )
    return name, divisor, si


def _declared(names) -> dict[str, str | None]:
    """Return the units that the names declare; a name may include the structure of a field (``scan.time_s``)."""
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
        raise RecordingError(
            f"{path}: the arrays must be one-dimensional and of equal length; their lengths are {sorted(lengths)}"
        )
    declared = _declared(name for name, length in sizes.items() if length == size)

    def load(names, progress):
        try:
            arrays = read_arrays(path, names.__contains__)
        except (OSError, ArchiveError) as error:
            raise RecordingError(f"{path}: not a readable NPZ file: {error}") from None
        return {name: np.asarray(arrays[name], dtype=float) for name in names}, ()

    return Table(path, declared, load)
