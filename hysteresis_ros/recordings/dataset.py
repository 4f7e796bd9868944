# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The dataset type of all recordings, simulations and analyses, and quantities derived from its columns.

The derived quantities are the voltage that the device received, and the requests of an inchworm motor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hysteresis_ros.arguments import real_array
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.signals import ASKED_VOLTAGE, COLUMNS, LEAST_DIFFERENCE, MODE_HOLDING, REQUESTS, UNITS

#: A recording must last less than this number of sample times, plus RATIO sample times for each of its samples.
SMALL = 1_000_000
#: Number of sample times that each sample adds to the allowed duration of a recording.
RATIO = 100
#: Source of the recording of an offline run, in its metadata.
SIMULATED = "offline simulation"
#: Names of the figures for the lateness of samples, with their percentiles [%].
LATENESS = {"lateness_p50_s": 50.0, "lateness_p99_s": 99.0, "lateness_p999_s": 99.9, "lateness_max_s": 100.0}


@dataclass(frozen=True, eq=False)
class Recording:
    """Signals sampled at common times."""

    time: np.ndarray  #: shape (N,); Times [s], finite and strictly increasing.
    signals: dict[str, np.ndarray]  #: shape (N,); Named signals in SI units; NaN where a sample of a signal is missing.
    #: Unit of each signal; optional for signals in :data:`hysteresis_ros.signals.UNITS`.
    units: dict[str, str] = field(default_factory=dict)
    #: Any JSON values. Known keys: ``configuration`` (YAML text of the axis), ``notes`` (list of str),
    #: ``missing_samples`` (int), ``timing`` (dict with ``rate_hz``, ``jitter_p99_s`` and, in fused mode,
    #: ``lateness_…_s``), ``namespace``, ``source``; for a stage ``axes``: the metadata of each axis by its name.
    metadata: dict = field(default_factory=dict)

    def __post_init__(self):
        """Check and convert all columns."""
        time = _column("time", self.time)
        if not np.all(np.isfinite(time)):
            raise RecordingError(f"time[{_first(~np.isfinite(time))}] is not finite; every sample needs its time [s]")
        backwards = np.diff(time) <= 0.0
        if np.any(backwards):
            k = _first(backwards) + 1
            raise RecordingError(
                f"time[{k}] = {time[k].item()!r} s does not come after time[{k - 1}] = {time[k - 1].item()!r} s; "
                "time must increase strictly"
            )
        signals, units = {}, {}
        for name, values in self.signals.items():
            if name == "time":
                raise RecordingError("'time' is the time axis and cannot be a signal; give it as `time`")
            column = _column(name, values)
            if column.shape != time.shape:
                raise RecordingError(
                    f"signal '{name}' has {column.size} samples and time has {time.size}; both must agree"
                )
            unit = self.units.get(name, UNITS.get(name))
            if unit is None:
                raise RecordingError(f"signal '{name}' has no unit; give it, for instance units={{'{name}': 'm'}}")
            known = UNITS.get(name, unit)
            if unit != known:
                raise RecordingError(f"signal '{name}' is given in '{unit}'; it must be in '{known}' (SI)")
            signals[name], units[name] = column, unit
        unused = sorted(set(self.units) - set(signals) - {"time"})
        if unused:
            raise RecordingError(f"units are given for {', '.join(unused)}, which is not a signal of the recording")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "signals", signals)
        object.__setattr__(self, "units", units)

    @classmethod
    def from_columns(cls, columns, metadata=None) -> Recording:
        """Build a recording from a mapping of known column names, which includes ``time``."""
        signals = dict(columns)
        if "time" not in signals:
            raise RecordingError(f"no column 'time'; the columns are {', '.join(signals) or 'none'}")
        return cls(signals.pop("time"), signals, {}, dict(metadata or {}))

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.time.size

    def __contains__(self, name: str) -> bool:
        """Return whether the recording has the signal ``name`` (or ``time``)."""
        return name == "time" or name in self.signals

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the signal ``name`` (or ``time``), shape (N,)."""
        if name == "time":
            return self.time
        try:
            return self.signals[name]
        except KeyError:
            if self.axes:
                raise RecordingError(
                    f"the recording of a stage has no signal '{name}': choose one of its axes "
                    f"({', '.join(self.axes)}) with --namespace, or a signal such as '{self.axes[0]}/displacement'"
                ) from None
            there = ", ".join(["time", *self.signals])
            raise RecordingError(f"the recording has no signal '{name}'; it has {there}") from None

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes of a stage, whose signals are ``x/displacement`` …; empty for a single axis."""
        return tuple(dict.fromkeys(name.rpartition("/")[0] for name in self.signals if "/" in name))

    def axis(self, name: str) -> Recording:
        """Return the recording of one axis of a stage; it shares the arrays of this recording.

        Raises
        ------
        RecordingError
            The recording is not of a stage, or its stage has no such axis.
        """
        name = name.strip("/")
        if name not in self.axes:
            there = f"it has {', '.join(self.axes)}" if self.axes else "it is the recording of a single axis"
            raise RecordingError(f"the recording has no axis '{name}'; {there}")
        names = {key: key.removeprefix(f"{name}/") for key in self.signals if key.startswith(f"{name}/")}
        space = f"{self.metadata.get('namespace', '').rstrip('/')}/{name}"
        return Recording(
            self.time,
            {short: self.signals[key] for key, short in names.items()},
            {short: self.units[key] for key, short in names.items()},
            {**self.metadata, "namespace": space, **self.metadata.get("axes", {}).get(name, {})},
        )

    @classmethod
    def of_axes(cls, axes: Mapping[str, Recording], metadata: dict) -> Recording:
        """Combine the axes' recordings, which have the same instants, into the recording of the stage."""
        signals = {f"{name}/{key}": values for name, one in axes.items() for key, values in one.signals.items()}
        units = {f"{name}/{key}": unit for name, one in axes.items() for key, unit in one.units.items()}
        return cls(next(iter(axes.values())).time, signals, units, metadata)

    def has(self, name: str) -> bool:
        """Return whether the signal has at least one finite value."""
        return name in self and bool(np.any(np.isfinite(self[name])))

    @property
    def sample_time(self) -> float:
        """Sample time [s], missing samples included; NaN with fewer than two samples.

        It is the duration divided by the number of intervals, because stamps are whole nanoseconds: the rounding error
        of a single interval would accumulate to one sample over 10⁶ samples.
        """
        if len(self) < 2:
            return float("nan")
        distances = np.diff(self.time)
        return float(np.sum(distances) / np.sum(np.maximum(np.rint(distances / np.median(distances)), 1.0)))

    def sample_numbers(self) -> np.ndarray:
        """Return the number of each sample, shape (N,), int64, from 0 on; missing samples are counted."""
        if len(self) < 2:
            return np.zeros(len(self), dtype=np.int64)
        numbers = np.rint((self.time - self.time[0]) / self.sample_time)
        if not numbers[-1] < SMALL + RATIO * len(self):
            raise RecordingError(
                f"only {len(self)} samples, but the times span {numbers[-1]:.4g} sample times: a time is wrong"
            )
        return numbers.astype(np.int64)

    @property
    def notes(self) -> list[str]:
        """Notes for the user (true displacement unknown, samples missing, bag truncated …)."""
        return list(self.metadata.get("notes", ()))

    @property
    def is_simulated(self) -> bool:
        """Whether the run was simulated offline, even if the configuration names a device."""
        return self.metadata.get("source") == SIMULATED

    @property
    def configuration(self) -> str:
        """YAML text of the axis; empty if the recording does not contain it."""
        return str(self.metadata.get("configuration", ""))

    def run_columns(self) -> dict[str, np.ndarray]:
        """Return ``time`` and the seven columns of a run; a missing column is all NaN."""
        absent = np.full(len(self), np.nan)
        return {"time": self.time, **{name: self.signals.get(name, absent) for name in COLUMNS}}


def _column(name: str, values) -> np.ndarray:
    try:
        column = real_array(values)
    except (TypeError, ValueError):
        raise RecordingError(f"signal '{name}' must consist of real numbers") from None
    if np.ndim(values) != 1:
        raise RecordingError(f"signal '{name}' has shape {np.shape(values)}; it must be one-dimensional")
    return column


def _first(mask) -> int:
    return int(np.argmax(mask))


def output_tolerance(plant: Mapping, compensator: Mapping) -> float:
    """Return the largest difference between requested and output voltage due to rounding [V]; infinite if unknown."""
    try:
        # a device rounds internally, and reports the voltage before rounding
        own = 0.0 if plant.get("driver") else _step(plant)
        return own + _step(compensator) + LEAST_DIFFERENCE
    except (ArithmeticError, KeyError, TypeError, ValueError):
        return np.inf


def note_output(signals: dict[str, np.ndarray], plant_voltage, plant_mode, tolerance: float) -> None:
    """Replace the requested voltage in the signals of a run by the voltage that the actuator received.

    Row k of the plant's state contains the output voltage for the requested voltage of sample k. Where the two differ
    by more than the converters' rounding, ``voltage`` becomes the output voltage, ``saturated`` becomes 1, and
    ``asked_voltage`` keeps the requested voltage; a run without such samples has no ``asked_voltage``. A late voltage
    does not count as saturation: the plant holds the previous voltage, and ``saturated`` does not change.
    """
    if "voltage" not in signals:
        return
    asked, left = signals["voltage"], np.asarray(plant_voltage, dtype=float)
    with np.errstate(invalid="ignore"):
        differs = np.abs(left - asked) > tolerance
    if not np.any(differs):
        return
    signals[ASKED_VOLTAGE] = asked
    signals["voltage"] = np.where(differs, left, asked)
    if "saturated" in signals:
        limited = differs & (np.asarray(plant_mode) != MODE_HOLDING)
        signals["saturated"] = np.where(limited, 1.0, signals["saturated"])


def _step(parameters: Mapping) -> float:
    """Return the resolution of a converter [V]; 0: unlimited."""
    low, high = float(parameters["limits.minimum"]), float(parameters["limits.maximum"])
    bits = int(parameters.get("limits.bits", 0))
    return (high - low) / (2**bits - 1) if bits else 0.0


def requests_per_sample(recording: Recording) -> dict[str, np.ndarray]:
    """Return the requests to an inchworm motor other than setpoints, for replay by the simulation."""
    if not all(recording.has(name) for name in REQUESTS):
        return {}
    index = recording.sample_numbers()
    requests, speeds = np.zeros(index[-1] + 1), np.full(index[-1] + 1, np.nan)
    requests[index] = np.nan_to_num(recording["request"])
    speeds[index] = recording["speed"]
    return {"requests": requests, "speeds": speeds}
