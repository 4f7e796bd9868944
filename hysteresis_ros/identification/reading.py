# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Reading of checked data from a file: selection of columns, units and samples."""

from __future__ import annotations

import os
import pathlib
from dataclasses import dataclass, replace
from functools import cached_property

from hysteresis_ros.errors import IdentificationError, RecordingError
from hysteresis_ros.identification.data import (
    DataError,
    DataReport,
    IdentificationData,
    from_recording,
    from_table,
    load_data,
)
from hysteresis_ros.identification.preprocessing import prepared
from hysteresis_ros.identification.recording_summary import RecordingSummary, summarise
from hysteresis_ros.identification.stage_data import is_stage
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run
from hysteresis_ros.recordings.foreign_tables import (
    TABLE_SUFFIXES,
    Selection,
    Table,
    find_time,
    open_table,
    si_unit,
    split_choice,
)

#: Usual column names of voltage and displacement in other recordings; the most specific names come first.
INPUT_NAMES = (
    *("voltage", "control", "command", "drive", "input", "excitation", "u", "v", "volt", "amp", "piezo"),
    *("spannung", "ao0", "ao1", "in", "current", "strom", "temperature", "temp", "field", "pressure", "druck"),
)
OUTPUT_NAMES = (
    *("measured", "displacement", "position", "sensor", "cap", "gauge", "interferometer", "output"),
    *("y", "x", "z", "d", "pos", "disp", "um", "nm", "weg", "ai0", "ai1", "out"),
    *("force", "kraft", "torque", "moment", "stress", "strain", "angle", "rotation", "elongation"),
)


@dataclass(frozen=True)
class Columns:
    """Selection of data in a file.

    Parameters
    ----------
    input, output, time : str, optional
        Columns as ``name`` or ``name:unit`` (``control_V:V``, ``cap_sensor_um:um``); by default chosen by names and
        units.
    sample_time : float, optional
        [s], for tables without a time column.
    namespace : str, optional
        Namespace of the axis in a bag.
    range : (int, int or None), optional
        First sample, and the sample after the last one; by default all samples.
    resample : float or "auto", optional
        Sample time [s] of a uniform grid for the data; ``auto``: the median interval between the samples.
    negate : bool
        Invert the sign of the output.
    all_samples : bool
        Use every sample; by default long data is reduced to the informative samples
        (:func:`~hysteresis_ros.identification.preprocessing.reduced`).
    whole : bool
        Use the whole of long data and only average neighbouring samples, as an evaluation needs it.
    input_unit, output_unit : str, optional
        Units of the two columns, if neither the names of the columns nor ``input`` and ``output`` state them. Units
        other than V and m also appear in files, reports and messages.
    """

    input: str | None = None
    output: str | None = None
    time: str | None = None
    sample_time: float | None = None
    namespace: str | None = None
    range: tuple[int, int | None] | None = None
    resample: float | str | None = None
    negate: bool = False
    all_samples: bool = False
    whole: bool = False
    input_unit: str | None = None
    output_unit: str | None = None


@dataclass(frozen=True, eq=False)
class Reading:
    """Checked data."""

    data: IdentificationData
    report: DataReport  #: Result of the checks.
    guessed: tuple[str, ...] = ()  #: Sentences about columns that were chosen by their names.

    @cached_property
    def summary(self) -> RecordingSummary:
        """Summary of what the recording shows before any fit."""
        return summarise(self.data, self.report)


def read_data(source, columns: Columns | None = None, progress=None) -> Reading:
    """Return checked data in SI units."""
    if isinstance(source, Reading):
        return source
    columns = columns or Columns()
    if not isinstance(columns, Columns):
        kind = type(columns).__name__
        raise IdentificationError(f"columns is of type {kind}: must be Columns, as hr.Columns('ch1:V', 'ch2:um')")
    if isinstance(source, (Recording, IdentificationData)):
        return _read(source, columns, progress)
    if not isinstance(source, (str, os.PathLike)):
        raise IdentificationError(
            f"source is of type {type(source).__name__}: must be one file, or a recording; write arrays as "
            "hr.Run(time, {'voltage': …, 'measured': …}), in s, V and m"
        )
    columns = replace(
        columns,
        input=_with_unit(columns.input, columns.input_unit),
        output=_with_unit(columns.output, columns.output_unit),
    )
    try:
        return _read(pathlib.Path(source), columns, progress)
    except (RecordingError, IdentificationError) as error:
        if str(source) in str(error):
            raise
        text = f"{source}: {error}"
        raise (DataError(error.check, text) if isinstance(error, DataError) else type(error)(text)) from None


def _with_unit(choice: str | None, unit: str | None) -> str | None:
    """Return a chosen column with the given unit appended."""
    if choice is None or unit is None:
        return choice
    name, own = split_choice(choice)
    if own is not None and si_unit(own) != si_unit(unit):
        raise IdentificationError(f"column {choice}: has the unit {own}, not {unit}; give one unit")
    return f"{name}:{unit}"


def _read(source, columns: Columns, progress) -> Reading:
    data, guessed = source, ()
    ranged = columns.range or (0, None)
    if isinstance(source, Recording):
        data = from_recording(source, columns.input, columns.output)
    elif not isinstance(source, IdentificationData):
        data, guessed, ranged = _load(source, columns, progress)
    if data.output_unit == "V" and columns.output_unit is None and not isinstance(source, IdentificationData):
        raise IdentificationError(
            f"output {data.output_name} is in V, as a sensor reads it; give its sensitivity "
            f"({data.output_name}:10um/V), or --output-unit V to keep volts"
        )
    if ranged != (0, None):
        data = data.part(*ranged)
    if columns.negate:
        data = replace(data, output=-data.output, notes=(*data.notes, "sign of the output inverted"))
    return Reading(*prepared(data, columns.resample, columns.all_samples, columns.whole), guessed)


def _load(path: pathlib.Path, columns: Columns, progress):
    """Return the data of a file, sentences about guessed columns, and the range of samples not yet selected."""
    sample_time, ranged = columns.sample_time, columns.range or (0, None)
    if sample_time is not None and not 0.0 < sample_time < float("inf"):
        raise IdentificationError(f"--sample-time {sample_time:g}: must be above 0 s")
    if path.suffix.lower() not in TABLE_SUFFIXES:
        return load_data(path, columns.input, columns.output, namespace=columns.namespace), (), ranged
    if columns.namespace and is_stage(path):
        axis = load_run(path, columns.namespace)
        return from_recording(axis, columns.input, columns.output, path.name), (), ranged
    table = open_table(path)
    selection = Selection((), columns.time, sample_time, ranged)
    try:
        return from_table(table, selection, columns.input, columns.output, progress), (), (0, None)
    except DataError as error:
        if error.check != "columns":
            raise
        chosen, notes = _guess(table, columns, error)
    return from_table(table, selection, chosen["input"], chosen["output"], progress), notes, (0, None)


def _guess(table: Table, columns: Columns, error: DataError) -> tuple[dict[str, str], tuple[str, ...]]:
    """Choose the columns with the clearest names, or raise ``error``."""
    declared = table.units
    given = {"input": columns.input, "output": columns.output}
    taken = {find_time(declared)}
    taken |= {choice if choice in declared else split_choice(choice)[0] for choice in given.values() if choice}
    free = {name: si_unit(unit) for name, unit in declared.items() if name not in taken}
    chosen = {role: choice for role, choice in given.items() if choice}
    notes = []
    stated = {"input": columns.input_unit, "output": columns.output_unit}
    known = {"input": (INPUT_NAMES, "V"), "output": (OUTPUT_NAMES, "m")}
    for role, (names, usual) in known.items():
        if role in chosen:
            continue
        unit = si_unit(stated[role]) or usual
        best = _most_telling(free, names, unit)
        if best is None:  # the other column has a clear name, and this is the only remaining one
            clear = () if "output" in chosen or role == "output" else (_most_telling(free, *known["output"]),)
            left = [name for name in free if name not in clear and free[name] is not None]
            if None in clear or len(left) != 1:
                raise error
            best = left[0]
        if free[best] is None and stated[role] is None:
            raise DataError(
                "unit", f"{table.path}: column '{best}' seems to be the {role} but has no unit; give it as "
                f"--{role} {best}:{'V' if unit == 'V' else 'um'} or with its unit"
            )  # fmt: skip
        if role == "input" and free[best] == "m" and stated[role] is None:
            raise DataError(
                "columns", f"{table.path}: no column is known to be a voltage, and '{best}' is in m, a displacement; "
                f"record the voltage too, or choose the input with --input (--input {best} for this column)"
            )  # fmt: skip
        chosen[role] = _with_unit(best, stated[role]) or best
        del free[best]
        notes.append(f"assumed {role}: column '{best}'; choose another with --{role}")
    return chosen, tuple(notes)


def _most_telling(free: dict[str, str | None], names, unit: str) -> str | None:
    """Return the column with the clearest name, of this unit, or else without unit, or else any; None if unclear."""
    fitting = [name for name in free if free[name] == unit] or [name for name in free if free[name] is None]
    fitting = fitting or list(free)
    ranked = sorted(fitting, key=lambda name: _rank(name, names))
    best = [name for name in ranked if _rank(name, names) == _rank(ranked[0], names)]
    return best[0] if len(best) == 1 and _rank(best[0], names) < len(names) else None


def _rank(name: str, names) -> int:
    """Return the rank in ``names`` of the usual name that a column's name contains."""
    words = name.lower().replace("-", "_").replace(" ", "_").split("_")
    for place, telling in enumerate(names):
        if telling in words or (len(telling) > 3 and telling in name.lower()):
            return place
    return len(names)
