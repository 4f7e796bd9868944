"""Tables of anybody's making: columns of any name, chosen together with their units and brought to SI.

:mod:`hysteresis_ros.recordings.tables` reads and writes the package's own tables, where every header names a unit.
Recordings from elsewhere name their columns ``control_V`` or ``y``; what is missing there, the user gives.
"""

from __future__ import annotations

import pathlib
import re
import zipfile

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.tables import SUBUNITS
from hysteresis_ros.signals import UNITS as SIGNAL_UNITS

#: Units a column may have: name → (SI unit, number of them in one SI unit); ``1`` is dimensionless.
UNITS = {
    **SUBUNITS,
    **{unit: (unit, 1.0) for unit in ("s", "m", "V", "A", "N", "rad", "K", "Pa", "Hz", "1", "m/s", "m/s^2")},
    "min": ("s", 1 / 60),
    "cm": ("m", 1e2),
    "pm": ("m", 1e12),
    "uV": ("V", 1e6),
    "kV": ("V", 1e-3),
    "mA": ("A", 1e3),
    "mN": ("N", 1e3),
    "kN": ("N", 1e-3),
    "mrad": ("rad", 1e3),
    "urad": ("rad", 1e6),
    "µrad": ("rad", 1e6),
    "deg": ("rad", 180 / np.pi),
    "%": ("1", 1e2),
}

#: Kinds of files that are read as text tables.
TEXT_SUFFIXES = (".csv", ".txt", ".dat", ".tsv")

_HEADER = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]+)[\])]$")
_TIME_NAMES = ("time", "t", "Time", "timestamp", "time_s", "t_s", "time_ms", "t_ms", "time_us", "t_us")


def column_unit(name: str, header_unit: str | None = None) -> str | None:
    """Return the unit a column declares: in its header, by a known signal name, or as suffix (``control_V``).

    Parameters
    ----------
    name : str
        Name of the column.
    header_unit : str, optional
        What stood in brackets after the name.

    Returns
    -------
    str or None
        A key of :data:`UNITS`, or whatever stood in the brackets; None where nothing tells the unit.
    """
    suffix = name.rsplit("_", 1)[-1] if "_" in name else ""
    return header_unit or SIGNAL_UNITS.get(name) or (suffix if suffix in UNITS else None)


def split_choice(choice: str) -> tuple[str, str | None]:
    """Split ``name:unit`` into name and unit; the unit is None when there is no colon.

    Raises
    ------
    RecordingError
        The unit is unknown; the message lists the known ones.
    """
    name, colon, unit = choice.rpartition(":")
    if not colon:
        return choice, None
    _conversion(name, unit)
    return name, unit


def read_table(path) -> tuple[dict[str, np.ndarray], dict[str, str | None]]:
    """Read every column of a text table or an NPZ as it stands.

    Text: comma, semicolon, tab or blanks between the columns, ``#`` starts a comment, the first line may name the
    columns (``name`` or ``name [unit]``); without names they are called ``1``, ``2`` … Cells that are no numbers become
    NaN.

    Parameters
    ----------
    path : path-like
        ``.csv``, ``.txt``, ``.dat``, ``.tsv`` or ``.npz``.

    Returns
    -------
    columns : dict of str to ndarray, shape (N,)
        In the file's own units.
    units : dict of str to (str or None)
        What each column declares (:func:`column_unit`).

    Raises
    ------
    RecordingError
        The file is missing or unreadable, or two columns have one name.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; give the path of a recording")
    if path.suffix.lower() == ".npz":
        return _read_arrays(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from None
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise RecordingError(f"{path}: holds no samples")
    delimiter = next((mark for mark in (";", "\t", ",") if mark in lines[0]), None)
    cells = [cell.strip().strip('"') for cell in lines[0].split(delimiter)]
    named = not all(_is_number(cell) for cell in cells)
    if named:
        lines = lines[1:]
    else:
        cells = [str(i + 1) for i in range(len(cells))]
    names, units = [], {}
    for cell in cells:
        match = _HEADER.match(cell)
        name = match["name"] if match else cell
        names.append(name)
        units[name] = column_unit(name, match["unit"].strip() if match else None)
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise RecordingError(f"{path}: column {', '.join(repeated)} appears more than once")
    table = _numbers(path, lines, delimiter, len(names))
    return {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(names)}, units


def find_time(units: dict[str, str | None]) -> str | None:
    """Return the name of the time column among ``units`` (names → declared units), or None.

    Parameters
    ----------
    units : dict of str to (str or None)
        What :func:`read_table` returned.
    """
    known = [name for name in _TIME_NAMES if name in units]
    seconds = [name for name, unit in units.items() if unit in UNITS and UNITS[unit][0] == "s"]
    return known[0] if known else (seconds[0] if len(seconds) == 1 else None)


def choose_columns(path, choices, time: str | None = None, sample_time: float | None = None, table=None) -> Recording:
    """Read chosen columns of a text table or NPZ into a recording in SI units.

    Parameters
    ----------
    path : path-like
        The table.
    choices : iterable of str
        Columns as ``name`` or ``name:unit``; the unit may be left out where the column declares it.
    time : str, optional
        The time column, likewise; by default the one called ``time``, ``t``, ``time_s`` … or the only one in seconds.
    sample_time : float, optional
        Distance of two samples [s] for tables without a time column.
    table : tuple, optional
        What :func:`read_table` returned for the path, where it was read already.

    Raises
    ------
    RecordingError
        A column is missing, has no unit or an unknown one, or there is no time.
    """
    columns, declared = table or read_table(path)
    signals, units = {}, {}
    for choice in choices:
        name, values, unit = _converted(path, choice, columns, declared)
        signals[name], units[name] = values, unit
    metadata = {"source": pathlib.Path(path).name}
    if time is None and sample_time is None:
        time = find_time(declared)
        if time is None:
            there = ", ".join(columns)
            raise RecordingError(f"{path}: no time among {there}; name it like 'time_s:s' or give the sample time")
    if time is None and sample_time is not None:
        size = len(next(iter(columns.values())))
        return Recording(np.arange(size) * float(sample_time), signals, units, metadata)
    # a column called time or t without a unit is in seconds, as everywhere in this package
    declared = {**declared, **{name: declared.get(name) or "s" for name in ("time", "t")}}
    name, instants, unit = _converted(path, time, columns, declared)
    if unit != "s":
        raise RecordingError(f"{path}: time column '{name}' is in '{unit}'; it must be in s, ms, us or min")
    try:
        return Recording(instants, signals, units, metadata)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None


def _converted(path, choice, columns, declared):
    """Return name, values in SI and SI unit of one choice."""
    name, unit = (choice, None) if choice in columns else split_choice(choice)
    if name not in columns:
        raise RecordingError(f"{path}: no column '{name}'; the columns are {', '.join(columns)}")
    unit = unit or declared.get(name)
    if unit is None:
        raise RecordingError(f"{path}: column '{name}' has no unit; give it as '{name}:um' or whatever it is in")
    si, divisor = _conversion(name, unit)
    other = declared.get(name)
    if other in UNITS and UNITS[other] != UNITS[unit]:
        raise RecordingError(f"{path}: column '{name}' is in '{other}' by its header and '{unit}' was asked; which?")
    return name, columns[name] if divisor == 1.0 else columns[name] / divisor, si


def _conversion(name, unit):
    if unit not in UNITS:
        raise RecordingError(f"column '{name}': unknown unit '{unit}'; known are {', '.join(UNITS)}")
    return UNITS[unit]


def _read_arrays(path):
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise RecordingError(f"{path}: not a readable NPZ file: {error}") from None
    columns = {
        name: np.asarray(array, dtype=float)
        for name, array in arrays.items()
        if array.ndim == 1 and array.dtype.kind in "fiu"
    }
    sizes = {len(values) for values in columns.values()}
    if len(sizes) != 1:
        raise RecordingError(f"{path}: needs one-dimensional arrays of one length; it has lengths {sorted(sizes)}")
    return columns, {name: column_unit(name) for name in columns}


def _numbers(path, lines, delimiter, width):
    try:
        return np.loadtxt(lines, delimiter=delimiter, ndmin=2, dtype=np.float64).reshape(len(lines), width)
    except ValueError:
        pass  # some cell is empty or text: read it cell by cell, which is slower but can say where
    table = np.full((len(lines), width), np.nan)
    for k, line in enumerate(lines):
        cells = line.split(delimiter)
        if len(cells) != width:
            raise RecordingError(f"{path}: sample {k} has {len(cells)} cells and the header {width} columns")
        table[k] = [float(cell) if _is_number(cell) else np.nan for cell in cells]
    return table


def _is_number(cell):
    try:
        float(cell)
    except ValueError:
        return False
    return True
