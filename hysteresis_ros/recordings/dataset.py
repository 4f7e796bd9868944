# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The dataset type that every recording, simulation and analysis shares, and what follows from its columns.

The output voltage that left for the device, and what was asked of an inchworm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.signals import ASKED_VOLTAGE, COLUMNS, LEAST_DIFFERENCE, MODE_HOLDING, REQUESTS, UNITS

#: Sample times over which a recording may extend in any case, and else in numbers of its samples.
SMALL, RATIO = 1_000_000, 100
#: Figures of the lateness of samples, and in % the part of the samples that are no later.
LATENESS = {"lateness_p50_s": 50.0, "lateness_p99_s": 99.0, "lateness_p999_s": 99.9, "lateness_max_s": 100.0}


@dataclass(frozen=True, eq=False)
class Recording:
    """Signals sampled at common instants."""

    time: np.ndarray  #: shape (N,); Instants [s], finite and strictly increasing.
    signals: dict[str, np.ndarray]  #: shape (N,); Named signals in SI units; NaN where a sample of a signal is missing.
    #: Unit of each signal; those of :data:`hysteresis_ros.signals.UNITS` need not be given.
    units: dict[str, str] = field(default_factory=dict)
    #: Whatever JSON can hold. Known keys: ``configuration`` (YAML text of the axis), ``notes`` (list of str),
    #: ``missing_samples`` (int), ``timing`` (dict with ``rate_hz``, ``jitter_p99_s`` and, fused, ``lateness_…_s``),
    #: ``namespace``, ``source``.
    metadata: dict = field(default_factory=dict)

    def __post_init__(self):
        """Check and convert all columns."""
        time = _column("time", self.time)
        if not np.all(np.isfinite(time)):
            raise RecordingError(
                f"time[{_first(~np.isfinite(time))}] is not finite; every sample needs its instant [s]"
            )
        backwards = np.diff(time) <= 0.0
        if np.any(backwards):
            k = _first(backwards) + 1
            raise RecordingError(
                f"time[{k}] = {time[k]!r} s does not come after time[{k - 1}] = {time[k - 1]!r} s; "
                "time must increase strictly"
            )
        signals, units = {}, {}
        for name, values in self.signals.items():
            if name == "time":
                raise RecordingError("'time' is the time axis and cannot be a signal as well; give it as `time`")
            column = _column(name, values)
            if column.shape != time.shape:
                raise RecordingError(
                    f"signal '{name}' has {column.size} samples and time has {time.size}; both must agree"
                )
            unit = self.units.get(name, UNITS.get(name))
            if unit is None:
                raise RecordingError(f"signal '{name}' has no unit; give units={{'{name}': 'm'}} or whatever it is in")
            known = UNITS.get(name, unit)
            if unit != known:
                raise RecordingError(f"signal '{name}' is given in '{unit}'; it must be in '{known}' (SI)")
            signals[name], units[name] = column, unit
        unused = sorted(set(self.units) - set(signals) - {"time"})
        if unused:
            raise RecordingError(f"units are given for {', '.join(unused)}, which is no signal of the recording")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "signals", signals)
        object.__setattr__(self, "units", units)

    @classmethod
    def from_columns(cls, columns, metadata=None) -> Recording:
        """Build a recording from a mapping that holds ``time`` among the columns, all of known names."""
        signals = dict(columns)
        if "time" not in signals:
            raise RecordingError(f"no column 'time'; the columns are {', '.join(signals) or 'none'}")
        return cls(signals.pop("time"), signals, {}, dict(metadata or {}))

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.time.size

    def __contains__(self, name: str) -> bool:
        """Tell whether there is such a signal (or ``time``)."""
        return name == "time" or name in self.signals

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the signal ``name`` (or ``time``), shape (N,)."""
        if name == "time":
            return self.time
        try:
            return self.signals[name]
        except KeyError:
            there = ", ".join(["time", *self.signals])
            raise RecordingError(f"the recording has no signal '{name}'; it has {there}") from None

    def has(self, name: str) -> bool:
        """Tell whether the signal is there with at least one finite value."""
        return name in self and bool(np.any(np.isfinite(self[name])))

    @property
    def sample_time(self) -> float:
        """Distance of two samples [s], missing ones counted; NaN with fewer than two samples.

        The whole duration is divided: stamps are whole nanoseconds, and over 10⁶ samples the rounding of a single
        distance would add up to a sample.
        """
        if len(self) < 2:
            return float("nan")
        distances = np.diff(self.time)
        return float(np.sum(distances) / np.sum(np.maximum(np.rint(distances / np.median(distances)), 1.0)))

    def sample_numbers(self) -> np.ndarray:
        """Return the number of each sample, missing ones counted, shape (N,), int64; the first is 0."""
        if len(self) < 2:
            return np.zeros(len(self), dtype=np.int64)
        numbers = np.rint((self.time - self.time[0]) / self.sample_time)
        if not numbers[-1] < SMALL + RATIO * len(self):
            raise RecordingError(
                f"{len(self)} samples lie within {numbers[-1]:.4g} sample times: a time among them is wrong"
            )
        return numbers.astype(np.int64)

    @property
    def notes(self) -> list[str]:
        """What a reader of the recording must know (displacement not true, samples missing, bag cut off …)."""
        return list(self.metadata.get("notes", ()))

    @property
    def configuration(self) -> str:
        """YAML text of the axis; empty when the recording does not hold it."""
        return str(self.metadata.get("configuration", ""))

    def run_columns(self) -> dict[str, np.ndarray]:
        """Return ``time`` and the seven columns of a run, all NaN where the recording lacks one."""
        absent = np.full(len(self), np.nan)
        return {"time": self.time, **{name: self.signals.get(name, absent) for name in COLUMNS}}


def _column(name: str, values) -> np.ndarray:
    try:
        column = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise RecordingError(f"signal '{name}' does not hold numbers") from None
    if np.ndim(values) != 1:
        raise RecordingError(f"signal '{name}' has shape {np.shape(values)}; it must be one-dimensional")
    return column


def _first(mask) -> int:
    return int(np.argmax(mask))


def output_tolerance(plant: Mapping, compensator: Mapping) -> float:
    """Return by how much [V] converters make differ what was asked and what was put out; infinite: nobody knows."""
    try:
        # a device rounds by itself, and says what it was given
        own = 0.0 if plant.get("driver") else _step(plant)
        return own + _step(compensator) + LEAST_DIFFERENCE
    except (ArithmeticError, KeyError, TypeError, ValueError):
        return np.inf


def note_output(signals: dict[str, np.ndarray], plant_voltage, plant_mode, tolerance: float) -> None:
    """Let the signals of a run say what has left for the actuator where that is not what was asked.

    Row k of the plant's state holds what it put out for the voltage of sample k. Where that differs by more than the
    converters do, ``voltage`` becomes what left, ``saturated`` 1, and what was asked for is kept as ``asked_voltage``,
    which a run without such samples does not have. A voltage that did not come in time is no limit: what left is the
    one before, and ``saturated`` stays.
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
    """Return the grid [V] of a converter over its range; 0: there is none."""
    low, high = float(parameters["limits.minimum"]), float(parameters["limits.maximum"])
    bits = int(parameters.get("limits.bits", 0))
    return (high - low) / (2**bits - 1) if bits else 0.0


def requests_per_sample(recording: Recording) -> dict[str, np.ndarray]:
    """Return what was asked of an inchworm beside setpoints, for replay by the simulation."""
    if not all(recording.has(name) for name in REQUESTS):
        return {}
    index = recording.sample_numbers()
    requests, speeds = np.zeros(index[-1] + 1), np.full(index[-1] + 1, np.nan)
    requests[index] = np.nan_to_num(recording["request"])
    speeds[index] = recording["speed"]
    return {"requests": requests, "speeds": speeds}
