# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What identification sees of a recording: time, one input and one output in SI units, checked before any fit."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.identification.data_checks import DataError, DataReport, check_data
from hysteresis_ros.recordings.columns import TABLE_SUFFIXES, Selection, Table, choose_columns, find_time, open_table
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run
from hysteresis_ros.recordings.units import column_unit, si_unit, split_choice

__all__ = ["DataError", "DataReport", "IdentificationData", "check_data", "from_recording", "from_table", "load_data"]


@dataclass(frozen=True, eq=False)
class IdentificationData:
    """One input and one output sampled at common instants.

    Parameters
    ----------
    time : ndarray, shape (N,)
        [s], strictly increasing.
    input : ndarray, shape (N,)
        SI.
    output : ndarray, shape (N,)
        SI.
    input_unit : str
        SI unit of the input.
    output_unit : str
        SI unit of the output.
    input_name : str
        Column the input comes from.
    output_name : str
        Column the output comes from.
    source : str
        Name of the file.
    first : int
        Index of the first sample in the source.
    notes : tuple of str
        What was done to the data (samples left out, resampled …).
    warnings : tuple of str
        What makes them doubtful (gaps bridged, rows damaged …).
    factor : int
        How many samples of the source were averaged in each.
    """

    time: np.ndarray
    input: np.ndarray
    output: np.ndarray
    input_unit: str = "V"
    output_unit: str = "m"
    input_name: str = "input"
    output_name: str = "output"
    source: str = ""
    first: int = 0
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    factor: int = 1

    def __post_init__(self):
        """Check shapes and units.

        Raises
        ------
        DataError
            A column has another shape, or no unit is given.
        """
        for name in ("time", "input", "output"):
            values = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if values.ndim != 1 or values.shape != np.shape(self.time):
                raise DataError("shape", f"{name} has shape {values.shape}; it must be ({np.size(self.time)},)")
            object.__setattr__(self, name, values)
        for name in ("input_unit", "output_unit"):
            if not getattr(self, name):
                raise DataError("unit", f"{name} is empty: unit-less data cannot be identified; give V, m …")

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.time.size

    @property
    def sample_time(self) -> float:
        """Distance of two samples [s]; NaN with fewer than two."""
        if len(self) < 2:
            return float("nan")
        return float((self.time[-1] - self.time[0]) / (len(self) - 1))

    @property
    def stroke(self) -> float:
        """Peak-to-peak output in its SI unit, missing samples left out; NaN when there is none."""
        finite = self.output[np.isfinite(self.output)]
        return float(np.ptp(finite)) if finite.size else float("nan")

    @property
    def input_range(self) -> tuple[float, float]:
        """Lowest and highest input in its SI unit."""
        return float(np.nanmin(self.input)), float(np.nanmax(self.input))

    def part(self, first: int = 0, last: int | None = None) -> IdentificationData:
        """Return the samples ``first … last - 1``; ``last`` may be None (all) or negative (from the end).

        Parameters
        ----------
        first : int
        last : int, optional

        Raises
        ------
        DataError
            The range is empty or outside the data.
        """
        start, stop, _ = slice(first, last).indices(len(self))
        if first < 0 or stop <= start or (last is not None and last > len(self)):
            raise DataError("range", f"samples {first}:{last} of {len(self)}: choose a range inside the recording")
        columns = {name: getattr(self, name)[start:stop] for name in ("time", "input", "output")}
        return replace(self, **columns, first=self.first + start)

    def checked(self, minimum_samples: int = 50) -> tuple[IdentificationData, DataReport]:
        """Leave out missing samples at both ends, check, and return the data with its report.

        Parameters
        ----------
        minimum_samples : int
            Fewer samples than this are too short.

        Raises
        ------
        DataError
            The data cannot be used: too short, constant, missing values inside, not uniformly sampled.
        """
        data = self.trimmed()
        report = check_data(
            data.time, data.input, data.output, data.input_unit, data.output_unit, minimum_samples=minimum_samples
        )
        report.raise_errors()
        return data, report.warned(data.warnings)

    def trimmed(self) -> IdentificationData:
        """Return the data without the samples at both ends at which the input or output is missing."""
        finite = np.isfinite(self.input) & np.isfinite(self.output)
        if not finite.any() or (finite[0] and finite[-1]):
            return self
        first, last = int(np.argmax(finite)), len(self) - int(np.argmax(finite[::-1]))
        note = f"{first} samples at the start and {len(self) - last} at the end left out: input or output missing"
        return replace(self.part(first, last), notes=(*self.notes, note))


def from_recording(
    recording: Recording, input: str | None = None, output: str | None = None, source: str | None = None
) -> IdentificationData:
    """Take input and output out of a recording.

    Parameters
    ----------
    recording : Recording
        The dataset every file is read into.
    input : str, optional
        Signal of the input; by default ``voltage``, else the only one in V.
    output : str, optional
        Signal of the output; by default ``measured``, else ``displacement``, else the only one in m.
    source : str, optional
        Name of the file.

    Raises
    ------
    DataError
        The default cannot tell which signal is meant.
    RecordingError
        There is no such signal.
    """
    chosen_input = input or _default(recording.units, ("voltage",), "V", "input", recording)
    chosen_output = output or _default(recording.units, ("measured", "displacement"), "m", "output", recording)
    return IdentificationData(
        recording.time,
        recording[chosen_input],
        recording[chosen_output],
        recording.units.get(chosen_input, ""),
        recording.units.get(chosen_output, ""),
        chosen_input,
        chosen_output,
        source if source is not None else str(recording.metadata.get("source", "")),
        notes=tuple(recording.notes),
        warnings=tuple(recording.metadata.get("warnings", ())),
    )


def _refuse_inchworm(path, columns, input, output) -> None:
    """Raise DataError for an inchworm's run of which nobody says what to take: a slider that walks is no actuator."""
    if "front_voltage" in columns and "rear_voltage" in columns and not (input and output):
        raise DataError(
            "inchworm",
            f"{path}: a run of an inchworm: its displacement is that of the slider, which walks, and no answer to the "
            "voltage; excite the extender alone, or choose the columns with --input and --output",
        )


def load_data(
    path,
    input: str | None = None,
    output: str | None = None,
    time: str | None = None,
    sample_time: float | None = None,
    namespace: str | None = None,
) -> IdentificationData:
    """Read a bag, a text table or an NPZ and take one input and one output out of it.

    Parameters
    ----------
    path : path-like
        The recording.
    input, output, time : str, optional
        Columns as ``name`` or ``name:unit`` (``control_V:V``, ``cap_sensor_um:um``); by default what the names and
        units of the columns tell without doubt.
    sample_time : float, optional
        [s], for tables without a time column.
    namespace : str, optional
        Which axis of a bag.

    Raises
    ------
    DataError
        The columns or their units are not clear.
    RecordingError
        The file is missing or unreadable, or lacks the columns.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() in TABLE_SUFFIXES:
        return from_table(open_table(path), Selection((), time, sample_time), input, output)
    recording = load_run(path, namespace)
    _refuse_inchworm(path, recording.signals, input, output)
    names = [choice and _same_unit(recording, choice) for choice in (input, output)]
    return from_recording(recording, names[0], names[1], path.name)


def from_table(
    table: Table, selection: Selection, input: str | None = None, output: str | None = None, progress=None
) -> IdentificationData:
    """Take one input and one output out of a table.

    Parameters
    ----------
    table : Table
    selection : Selection
        Time and rows; its columns are the two named here.
    input, output : str, optional
        See :func:`load_data`.
    progress : callable, optional
        Called with the part of the file that was read.

    Raises
    ------
    DataError
        The columns or their units are not clear.
    RecordingError
        The file lacks the columns, or its numbers are no recording.
    """
    declared, time = table.units, selection.time
    _refuse_inchworm(table.path, declared, input, output)
    taken = {split_choice(time)[0] if time and time not in declared else time or find_time(declared)}
    taken |= {choice if choice in declared else split_choice(choice)[0] for choice in (input, output) if choice}
    free = {name: unit for name, unit in declared.items() if name not in taken}
    input = input or _default(free, ("voltage",), "V", "input")
    output = output or _default(free, ("measured", "displacement"), "m", "output")
    recording = choose_columns(table, replace(selection, choices=(input, output)), progress)
    names = list(recording.signals)
    if len(names) < 2:
        raise DataError("columns", f"{table.path}: input and output are the same column '{names[0]}'")
    data = from_recording(recording, names[0], names[1], table.path.name)
    return replace(data, first=selection.rows[0])


def _same_unit(recording, choice):
    """Return the name of a bag's signal; its unit is SI already and may only be confirmed."""
    name, unit = (choice, None) if choice in recording else split_choice(choice)
    there = recording.units.get(name)
    if unit is not None and there is not None and unit != there:
        raise DataError("unit", f"signal '{name}' of the recording is in '{there}', not in '{unit}'")
    return name


def _default(units, preferred, unit, role, recording=None):
    for name in preferred:
        if name in units and (recording is None or recording.has(name)):
            return name
    fitting = [name for name, declared in units.items() if declared and _si(name, declared) == unit]
    if len(fitting) == 1:
        return fitting[0]
    found = f"{', '.join(fitting)} are all in {unit}" if fitting else f"no column is in {unit}"
    columns = ", ".join(f"{name} [{declared or '?'}]" for name, declared in units.items())
    raise DataError("columns", f"which column is the {role}? {found}; columns: {columns}. Choose it as name:unit")


def _si(name, unit):
    return si_unit(column_unit(name, unit))


def refuse_short(samples: int, needed: int, what: str) -> None:
    """Raise the error of data that is too short for a fit.

    Parameters
    ----------
    samples : int
        How many there are.
    needed : int
        How many the fit needs.
    what : str
        What needs them.

    Raises
    ------
    DataError
        There are fewer than needed.
    """
    if samples < needed:
        raise DataError("short", f"{samples} samples are too few for {what}; at least {needed} are needed")


def finite_array(name: str, values) -> np.ndarray:
    """Return ``values`` as float64 array, or refuse what is not finite.

    Parameters
    ----------
    name : str
        For the message.
    values : array_like

    Raises
    ------
    DataError
        A value is NaN or infinite.
    """
    array = np.ascontiguousarray(values, dtype=np.float64)
    bad = ~np.isfinite(array)
    if bad.any():
        index = tuple(map(int, np.argwhere(bad)[0]))
        raise DataError(
            "nan", f"{name}{list(index)} is not finite ({np.count_nonzero(bad)} such values); leave them out"
        )
    return array
