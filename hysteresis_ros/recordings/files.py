# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Reading and writing of recordings; the path selects the format, and CSV and NPZ are read back bit for bit.

The modules for bags are imported only when a bag is opened.
"""

from __future__ import annotations

import json
import pathlib
import re
import warnings
import zipfile

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import read_arrays, read_json, replacing
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.foreign_tables import column_unit, find_time, known_conversion
from hysteresis_ros.signals import UNITS as SIGNAL_UNITS
from hysteresis_ros.units import SUBUNITS, bare_name

_HEADER = re.compile(r"^\s*(?P<name>[^\[\]]+?)\s*\[(?P<unit>[^\[\]]*)\]\s*$")


def write_csv(recording: Recording, path) -> None:
    """Write ``time`` and all signals as CSV: one header line such as ``time [s],displacement [m]``, then numbers.

    Numbers have enough digits to read back as the same float64. A CSV table has no metadata, so configuration and notes
    are not written.
    """
    names = ["time", *recording.signals]
    units = {"time": "s", **recording.units}
    columns = [recording[name].tolist() for name in names]
    with replacing(path, RecordingError) as beside, beside.open("w", encoding="utf-8") as stream:
        stream.write(",".join(f"{name} [{units[name]}]" for name in names) + "\n")
        stream.writelines(",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True))


def read_csv(path) -> Recording:
    """Read a CSV table whose header gives each column as ``name [unit]`` or ``name_unit``; ``#`` starts a comment.

    SI units and their usual submultiples (µm, mm, nm, ms, µs, mV) are converted to SI.
    """
    path = _existing(path)
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            header = next((line for line in stream if line.strip() and not line.startswith("#")), "")
            cells = [cell.strip().strip('"') for cell in header.split(",")]
            parts = [_named_column(path, cell) for cell in cells]
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "loadtxt: input contained no data", UserWarning)
                table = np.loadtxt(stream, delimiter=",", ndmin=2, dtype=np.float64)
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: cannot be read: {_reason(error)}") from None
    except RecordingError:
        raise
    except ValueError as error:
        raise RecordingError(f"{path}: not a table of numbers: {error}") from None
    if not table.size:
        table = np.empty((0, len(parts)))
    if table.shape[1] != len(parts):
        raise RecordingError(f"{path}: rows have {table.shape[1]} numbers, but the header has {len(parts)} columns")
    names = [name for name, _, _ in parts]
    repeated = {name for name in names if names.count(name) > 1}
    if repeated:
        raise RecordingError(f"{path}: column {', '.join(sorted(repeated))} appears more than once; rename one of them")
    columns = {
        name: table[:, i].copy() if divisor == 1.0 else table[:, i] / divisor
        for i, (name, _, divisor) in enumerate(parts)
    }
    return _assemble(path, columns, {name: unit for name, unit, _ in parts}, {})


def write_npz(recording: Recording, path) -> None:
    """Write a compressed NPZ: one array per column, and ``units`` and ``metadata`` as JSON text.

    ``numpy.load(path)["displacement"]`` gives a column without this package.
    """
    units = json.dumps({"time": "s", **recording.units}, ensure_ascii=False)
    metadata = json.dumps(recording.metadata, ensure_ascii=False)
    reserved = {"units", "metadata"} & set(recording.signals)
    if reserved:
        raise RecordingError(f"a signal may not be called {', '.join(sorted(reserved))} in an NPZ file; rename it")

    arrays = {"time": recording.time, **recording.signals, "units": np.array(units), "metadata": np.array(metadata)}
    with (
        replacing(path, RecordingError) as beside,
        # a low level: that of numpy.savez_compressed takes longer than a simulation, and the file is hardly smaller
        zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
    ):
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)


def read_npz(path) -> Recording:
    """Read an NPZ written by :func:`write_npz`, or an NPZ of one-dimensional arrays with known column names."""
    path = _existing(path)
    try:
        arrays = read_arrays(path)
        units = _mapping(arrays.pop("units", "{}"), "units")
        metadata = _mapping(arrays.pop("metadata", "{}"), "metadata")
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: not a readable NPZ file: {_reason(error)}") from None
    return _assemble(path, arrays, units, metadata)


def _mapping(text, name: str) -> dict:
    """Return the mapping that an array contains as JSON text."""
    found = read_json(str(text))
    if not isinstance(found, dict):
        raise ValueError(f"its {name} is not a mapping")
    return found


def _assemble(path, columns, units, metadata) -> Recording:
    if "time" not in columns:
        raise RecordingError(f"{path}: no column 'time'; the columns are {', '.join(columns) or 'none'}")
    time = columns.pop("time")
    if units.pop("time", "s") != "s":
        raise RecordingError(f"{path}: the column 'time' must be in seconds; write 'time [s]'")
    try:
        return Recording(time, columns, units, metadata)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None


def _named_column(path, cell):
    match = _HEADER.match(cell)
    if match is None:
        name, unit = bare_name(cell), column_unit(cell)
        if unit is not None and name != cell:  # voltage_V
            return name, *known_conversion(cell, unit)
        known = "s" if find_time({cell: None}) else SIGNAL_UNITS.get(cell, "m")
        example = f"{cell or 'displacement'} [{known}]"
        raise RecordingError(f"{path}: column '{cell}' has no unit in the header; write it like '{example}'")
    unit, divisor = SUBUNITS.get(match["unit"].strip(), (match["unit"].strip(), 1.0))
    return match["name"], unit, divisor


def _existing(path) -> pathlib.Path:
    path = pathlib.Path(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; give the path of a recording")
    return path


def _reason(error) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def load_run(path, namespace: str | None = None, *, further: bool = False) -> Recording:
    """Read a run from ``.npz``, ``.csv``, a bag folder, a bare ``.mcap`` or a bare ``.db3`` file.

    In the table of a stage, ``namespace`` selects one axis; without a namespace all axes are returned.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() in (".npz", ".csv"):
        table = read_npz(path) if path.suffix.lower() == ".npz" else read_csv(path)
        return table.axis(namespace) if namespace and table.axes else table
    # rosbags and mcap take 0.1 s to import, so they are imported only for a bag
    from hysteresis_ros.recordings.align import read_recording

    return read_recording(path, namespace, further=further)


def require_run_file(path) -> pathlib.Path:
    """Return the path of a run to be written; refuse a suffix that belongs to no format of :func:`save_run`."""
    path = pathlib.Path(path)
    if path.suffix.lower() not in (".npz", ".csv", ".mcap"):
        raise RecordingError(f"{path}: unknown kind of file '{path.suffix}'; write .npz, .csv or .mcap")
    return path


def save_run(recording: Recording, path, configuration: str | None = None) -> None:
    """Write a run as ``.npz``, ``.csv`` or ``.mcap``, by the suffix."""
    path = require_run_file(path)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        write_npz(recording, path)
    elif suffix == ".csv":
        write_csv(recording, path)
    else:
        from hysteresis_ros.recordings.run_bag import write_recording

        write_recording(recording, path, configuration)
