"""What identification sees of a recording: time, one input and one output in SI units, checked before any fit."""

from __future__ import annotations

import math
import pathlib
from dataclasses import dataclass, replace

import numpy as np
import scipy.signal

from hysteresis_ros.identification.data_checks import DataError, DataReport, check_data
from hysteresis_ros.recordings.columns import (
    TEXT_SUFFIXES,
    UNITS,
    choose_columns,
    column_unit,
    find_time,
    read_table,
    split_choice,
)
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run

__all__ = ["DataError", "DataReport", "IdentificationData", "check_data", "from_recording", "load_data", "resample"]


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
        return data, report

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
    if path.suffix.lower() not in (*TEXT_SUFFIXES, ".npz"):
        recording = load_run(path, namespace)
        _refuse_inchworm(path, recording.signals, input, output)
        names = [choice and _same_unit(recording, choice) for choice in (input, output)]
        return from_recording(recording, names[0], names[1], path.name)
    table = read_table(path)
    declared = table[1]
    _refuse_inchworm(path, declared, input, output)
    taken = {split_choice(time)[0] if time and time not in declared else time or find_time(declared)}
    taken |= {choice if choice in declared else split_choice(choice)[0] for choice in (input, output) if choice}
    free = {name: unit for name, unit in declared.items() if name not in taken}
    input = input or _default(free, ("voltage",), "V", "input")
    output = output or _default(free, ("measured", "displacement"), "m", "output")
    recording = choose_columns(path, (input, output), time, sample_time, table)
    names = list(recording.signals)
    if len(names) < 2:
        raise DataError("columns", f"{path}: input and output are the same column '{names[0]}'")
    return from_recording(recording, names[0], names[1], path.name)


def resample(data: IdentificationData, sample_time: float | None = None) -> IdentificationData:
    """Return the data on a uniform grid: linear between the samples there are, low-passed where it becomes coarser.

    Parameters
    ----------
    data : IdentificationData
        Missing values are bridged.
    sample_time : float, optional
        [s]; the median distance of the data by default.

    Raises
    ------
    DataError
        Fewer than two samples are there, or the sample time is not positive or longer than the data.
    """
    finite = np.isfinite(data.input) & np.isfinite(data.output)
    if np.count_nonzero(finite) < 2:
        raise DataError("short", f"{np.count_nonzero(finite)} samples are there; resampling needs two")
    time = data.time[finite]
    median = float(np.median(np.diff(time)))
    target = median if sample_time is None else float(sample_time)
    if not 0.0 < target < time[-1] - time[0]:
        raise DataError("resample", f"sample time {target:g} s: must be in 0 … {time[-1] - time[0]:g} s")
    factor = max(1, math.ceil(target / median - 1e-6)) if target > 1.5 * median else 1
    grid = time[0] + np.arange(int((time[-1] - time[0]) / (target / factor) + 1e-6) + 1) * (target / factor)
    columns = [np.interp(grid, time, values[finite]) for values in (data.input, data.output)]
    if factor > 1:
        columns = [_decimated(values, factor) for values in columns]
    note = f"resampled from {median:.6g} s (median) to {target:.6g} s, {np.count_nonzero(~finite)} missing bridged"
    grid = grid[::factor]
    return replace(data, time=grid, input=columns[0], output=columns[1], first=0, notes=(*data.notes, note))


def _decimated(values, factor):
    taps = scipy.signal.firwin(20 * factor + 1, 0.8 / factor, window=("kaiser", 8.0))
    half = 10 * factor
    # mirrored about the ends, so that a level or a slope there stays what it is
    head, tail = 2 * values[0] - values[half:0:-1], 2 * values[-1] - values[-2 : -half - 2 : -1]
    if len(head) < half or len(tail) < half:
        raise DataError("resample", f"{len(values)} samples are too few to be made {factor} times coarser")
    return np.convolve(np.concatenate([head, values, tail]), taps, mode="valid")[::factor]


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
    return UNITS.get(column_unit(name, unit), (unit,))[0]


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
