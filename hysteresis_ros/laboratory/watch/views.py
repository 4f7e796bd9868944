# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Data of a page: history and frames of the samples, and a table of the parameters in use; no ROS, no web server.

At sample rates of kilohertz, one column of the screen covers many samples. The column shows their minimum and maximum
in the order in which they occurred, so even the shortest peak is shown.

A frame is a header in JSON, preceded by its length (4 bytes) and padded with spaces to a multiple of 4, and then
numbers (float32, little-endian, SI). The numbers are, for each signal in the header and each column of the screen, the
minimum and the maximum in the order in which they occurred. The points of the loops follow.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields

import numpy as np
from scipy import signal

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.control.controller import LAWS
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, AxisParameters, NodeParameters, RecorderNodeParameters
from hysteresis_ros.references.waveforms import Waveform
from hysteresis_ros.signals import CONTROLLER, MOTOR_SOURCE

#: Maximum number of stored samples: one minute at 20 kHz, less at higher rates.
MOST_SAMPLES = 1_200_000
#: Largest segment length of the spectrum [samples].
LONGEST = 16384
#: Smallest segment length of the spectrum [samples].
SHORTEST = 64
#: Minimum number of segments of the spectrum, counted without overlap.
SEGMENTS = 4
#: Maximum number of points of a spectrum, logarithmically spaced in frequency.
POINTS = 320


class History:
    """The last samples of some signals."""

    def __init__(self, rows: int, samples: int):
        self._keeps = int(min(samples, MOST_SAMPLES))
        self._table = np.empty((rows, 2 * self._keeps))
        self._filled = 0
        self.end = 0

    @property
    def begin(self) -> int:
        """Number of the oldest sample that is kept."""
        return self.end - min(self._filled, self._keeps)

    def append(self, table: np.ndarray) -> None:
        """Append samples."""
        self.end += table.shape[1]
        table = table[:, -self._keeps :]
        if self._filled + table.shape[1] > self._table.shape[1]:
            kept = self._keeps - table.shape[1]
            self._table[:, :kept] = self._table[:, self._filled - kept : self._filled]
            self._filled = kept
        self._table[:, self._filled : self._filled + table.shape[1]] = table
        self._filled += table.shape[1]

    def part(self, first: int, last: int) -> np.ndarray:
        """Return samples, shape (rows, last − first), as a view."""
        behind = self.end - self._filled
        return self._table[:, first - behind : last - behind]


def places_of_extremes(table: np.ndarray, length: int) -> np.ndarray:
    """Return the indices of the minimum and the maximum in each bin, in the order in which they occurred."""
    rows = table.shape[0]
    bins = table.reshape(rows, -1, length)
    missing = np.isnan(bins)
    low = np.where(missing, np.inf, bins).argmin(axis=2)
    high = np.where(missing, -np.inf, bins).argmax(axis=2)
    begins = length * np.arange(bins.shape[1])
    return np.sort(np.stack([low, high], axis=2), axis=2) + begins[:, None]


def extremes(table: np.ndarray, length: int) -> np.ndarray:
    """Return the minimum and the maximum of each bin, in the order in which they occurred, shape (rows, bins, 2)."""
    places = places_of_extremes(table, length)
    return np.take_along_axis(table, places.reshape(len(table), -1), axis=1).reshape(places.shape)


def outline(table: np.ndarray, length: int) -> np.ndarray:
    """Return those points of a curve at which any of its signals has its minimum or maximum in a bin."""
    rows = len(table)
    if length <= 2 * rows:
        return table
    places = places_of_extremes(table, length)
    return table[:, np.sort(np.concatenate(list(places), axis=1), axis=1).ravel()]


def amplitude_density(values: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies [Hz] and amplitude density of a signal by Welch's method, thinned without losing a peak.

    ``rate`` is the sample rate [Hz].
    """
    segment = min(LONGEST, 2 ** int(np.log2(max(values.size // SEGMENTS, 1))))
    known = np.isfinite(values)
    if segment < SHORTEST or not known.any():
        return np.empty(0), np.empty(0)
    filled = np.where(known, values, values[known].mean())
    frequency, power = signal.welch(filled, rate, nperseg=segment)
    frequency, density = frequency[1:], np.sqrt(power[1:])
    edges = np.geomspace(frequency[0], frequency[-1] * (1.0 + 1e-9), POINTS + 1)
    begins = np.unique(np.searchsorted(frequency, edges[:-1]))
    return frequency[begins], np.maximum.reduceat(density, begins)


#: Signals shown versus time (taken from the row, or calculated here), and signals of the loops: displacement versus
#: voltage and command.
SHOWN = ("reference", "measured", "error", "command", "voltage", "estimated", "saturated", "skipped")
LOOP = ("voltage", "command", "measured")
#: The same for an inchworm motor, with command and voltage of its extender.
MOTOR_SHOWN = (*SHOWN, "setpoint", "extender", "front_voltage", "rear_voltage", "phase")
MOTOR_LOOP = ("voltage", "command", "extender")
#: Longest window of the loops [s].
LOOP_TIME = 4.0
#: Maximum number of bins in the window of the loops.
LOOP_COLUMNS = 1000
#: Length of the stored history [s].
MEMORY = 60.0


@dataclass
class Part:
    """Progress of a page, in whole bins of samples."""

    length: int  #: Samples per bin.
    bins: int  #: Bins that the page shows.
    next: int = -1  #: Next bin to send; -1: none sent yet.

    def due(self, history: History) -> tuple[bool, int, np.ndarray]:
        """Return whether the page restarts, the number of the first due bin, and the samples of all due bins."""
        end = history.end // self.length
        begin = max(-(-history.begin // self.length), end - self.bins)
        fresh = not begin <= self.next <= end
        first = begin if fresh else self.next
        self.next = end
        return fresh, first, history.part(first * self.length, end * self.length)


class View:
    """The display of one page, for samples at ``rate`` [Hz]."""

    def __init__(self, window: float, columns: int, rate: float, epoch: int, motor: bool = False):
        self.window, self.columns, self.rate, self.epoch = window, columns, rate, epoch
        self._shown: tuple[str, ...] = MOTOR_SHOWN if motor else SHOWN
        loop = MOTOR_LOOP if motor else LOOP
        self._loop_rows = [self._shown.index(name) for name in loop]
        samples = max(round(window * rate), 1)
        length = max(-(-samples // columns), 1)
        self._time = Part(length, -(-samples // length))
        samples = max(round(min(window, LOOP_TIME) * rate), 1)
        length = max(-(-samples // LOOP_COLUMNS), 1)
        self._loop = Part(length, -(-samples // length))

    def frame(self, history: History) -> bytes | None:
        """Return the next frame; None when there is nothing new."""
        fresh, first, table = self._time.due(history)
        loop_fresh, _, loop = self._loop.due(history)
        if not table.shape[1] and not loop.shape[1] and not fresh:
            return None
        bins = extremes(table, self._time.length)
        points = outline(loop[self._loop_rows], self._loop.length)
        header = {
            "shown": self._shown,
            "rate": self.rate,
            "epoch": self.epoch,
            "end": history.end,
            "first": first,
            "length": self._time.length,
            "columns": self._time.bins,
            "bins": bins.shape[1],
            "fresh": fresh,
            "points": points.shape[1],
            "loop": round(min(self.window, LOOP_TIME) * self.rate),
            "kept": self._loop.bins * min(self._loop.length, 2 * len(LOOP)),
            "loop_fresh": loop_fresh,
        }
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        numbers = np.concatenate([bins.ravel(), points.ravel()]).astype("<f4")
        return struct.pack("<I", len(text)) + text + numbers.tobytes()


def names_in_use(cls: type[Parameters], values: Mapping, prefix: str = "") -> Iterator[str]:
    """Yield the names of the parameters in use; for models and laws, only parameters of the selected type."""
    for item in fields(cls):
        nested, chooser = item.metadata.get("group"), item.metadata.get("variant_of")
        if nested is None:
            yield prefix + item.name
        elif chooser is None or values.get(prefix + chooser) == item.name:
            yield from names_in_use(nested, values, f"{prefix}{item.name}.")


def _hangs_on_nothing(node: str, name: str, values: Mapping) -> bool:
    """Return whether a parameter has no effect: its control law is not selected, or its block is absent."""
    group, _, own = name.partition(".")
    if own and own != "type" and values.get(f"{group}.type") == "none":
        return True
    of_laws = {group for law in LAWS.values() for group in law.groups} if node == CONTROLLER else set()
    return group in of_laws and group not in LAWS[values["type"]].groups


def table_of(node: str, values: Mapping) -> list[dict]:
    """Return the rows of those parameters of a node that may change while the node runs."""
    shared = {row.name for row in NodeParameters.table()}
    used = {
        name
        for name in names_in_use(NODE_PARAMETERS[node], values)
        if name not in shared and not _hangs_on_nothing(node, name, values)
    }
    return [
        {
            "name": row.name,
            "value": list(values[row.name]) if isinstance(values[row.name], (list, tuple)) else values[row.name],
            "type": row.type_name,
            "unit": row.unit,
            "low": row.low,
            "high": row.high,
            "choices": row.choices,
            "allowed": row.allowed(),
            "about": row.description,
        }
        for row in NODE_PARAMETERS[node].table()
        if row.name in used and row.name in values and not row.read_only
    ]


def axis_of(namespace: str, values: Mapping[str, Mapping]) -> AxisParameters:
    """Return the parameters of an axis from the parameters of its nodes."""
    typed = {
        node: NODE_PARAMETERS[node].from_mapping({name: value for name, value in own.items() if _is_ours(node, name)})
        for node, own in values.items()
    }
    return AxisParameters.of_nodes(namespace, {**typed, "recorder": RecorderNodeParameters()})


def _is_ours(node: str, name: str) -> bool:
    return name in {row.name for row in NODE_PARAMETERS[node].table()}


def limits_of(values: Mapping[str, Mapping]) -> dict[str, list[float]]:
    """Return the ranges that a page draws: of the reference [m], of the voltage [V] and of setpoints [m].

    The range of setpoints leaves room for the waveform, as in the reference generator.
    """
    source = values.get(MOTOR_SOURCE) or values.get("reference_generator", {})
    compensator = values.get("hysteresis_compensator", {})
    found = {
        "setpoint": [source.get("minimum"), source.get("maximum")],
        "voltage": [compensator.get("limits.minimum"), compensator.get("limits.maximum")],
    }
    found["slider"] = _setpoints(values.get("reference_generator", {}), *found["setpoint"])
    return {name: [low, high] for name, (low, high) in found.items() if low is not None and high is not None}


def _setpoints(source: Mapping, low: float | None, high: float | None) -> list[float | None]:
    """Return the range of accepted setpoints; the whole range when the waveform is unknown."""
    if None in (low, high) or not source.get("sample_rate"):
        return [low, high]
    own = {name: value for name, value in source.items() if _is_ours("reference_generator", name)}
    try:
        parameters = NODE_PARAMETERS["reference_generator"].from_mapping(own)
        waveform = Waveform(parameters.waveform, 1.0 / source["sample_rate"])
    except HysteresisError:
        return [low, high]
    return [low - waveform.lowest, high - waveform.highest]
