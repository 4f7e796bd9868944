# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""State of a watched axis: the samples of the last minute, figures computed from them, and the state of a motor.

Samples of an axis whose nodes exchange messages are assembled from the ``~/state`` of each node. :class:`Plane` keeps
the path of two axes of a stage; all axes of a stage have the same stamps, so samples are matched by stamp.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque

import numpy as np
from sensor_msgs.msg import JointState

from hysteresis_ros import signals
from hysteresis_ros.laboratory.watch.views import MEMORY, MOTOR_SHOWN, SHOWN, History, View, amplitude_density
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.nodes.samples import SECOND, Block
from hysteresis_ros.references.inchworm_layout import ERROR_NAMES, PHASE_NAMES

#: An incomplete sample is shown once a sample is newer by more than this time [ns].
PART_PATIENCE = 300_000_000
#: Maximum number of incomplete samples that are kept.
MOST_PENDING = 20_000
#: Duration of the path of two axes in their plane [s].
PLANE_WINDOW = 4.0
#: Maximum number of points of the path of two axes in their plane.
PLANE_POINTS = 1500


class Collector:
    """Assembles samples from the ``~/state`` messages of the nodes by their stamps."""

    def __init__(self, kind: signals.AxisKind):
        self._row = len(kind.row)
        self._bits = {node: 1 << index for index, node in enumerate(kind.nodes)}
        self._names = {node: kind.state(node) for node in kind.nodes}
        self._places: dict[tuple, list] = {}
        self._pending: dict[int, tuple[np.ndarray, int]] = {}
        self._done, self._count = -1, 0

    def add(self, node: str, message: JointState) -> None:
        """Add the ``~/state`` message of a node."""
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        if stamp <= self._done:
            if self._done - stamp < PART_PATIENCE:
                return
            self._pending.clear()  # the stamps went back: the axis has restarted
            self._done, self._count = -1, 0
        places = self._places_of(node, tuple(message.name))
        row, seen = self._pending.get(stamp) or (np.full(self._row, np.nan), 0)
        for index, place in places:
            row[place] = message.position[index]
        self._pending[stamp] = (row, seen | self._bits[node])

    def _places_of(self, node: str, names: tuple) -> list:
        key = (node, names)
        if key not in self._places:
            known = self._names[node]
            self._places[key] = [(i, signals.place(known[name])) for i, name in enumerate(names) if name in known]
        return self._places[key]

    def take(self) -> Block:
        """Return the complete samples, and older samples that will remain incomplete."""
        whole = sum(self._bits.values())
        newest = max(self._pending, default=0)
        ready = [stamp for stamp, (_, seen) in self._pending.items() if seen == whole or stamp < newest - PART_PATIENCE]
        until = max(ready, default=-1)
        if len(self._pending) > MOST_PENDING:
            until = newest
        stamps = np.array(sorted(stamp for stamp in self._pending if stamp <= until), np.int64)
        rows = [self._pending.pop(int(stamp))[0] for stamp in stamps]
        self._done = max(self._done, until)
        table = np.array(rows).T.reshape(self._row, len(rows))
        # samples are counted, because a late plant shifts its schedule and the stamp does not give the sample number
        self._count += len(rows)
        return Block(stamps, np.arange(self._count - len(rows), self._count), table, None)


#: Window of the figures [s].
FIGURES = 2.0
#: Window of the spectrum [s].
SPECTRUM = 8.0
#: Window of the measured rate [s].
COUNTED = 2.0
#: Time without samples after which an axis counts as silent [s].
SILENT = 1.5


class Memory:
    """The last samples, at ``rate`` [Hz]; written by one thread, read by another."""

    def __init__(self, rate: float = 1000.0, preview: int = 0):
        self.lock = threading.Lock()
        self.epoch = -1
        self.restart(rate, preview)

    def restart(self, rate: float, preview: int = 0, motor: bool = False) -> None:
        """Clear all samples for a new run."""
        with self.lock:
            self.epoch += 1
            self.rate, self.motor = rate, motor
            self._names = MOTOR_SHOWN if motor else SHOWN
            self.history = History(len(self._names), max(round(MEMORY * rate), 2))
            self.lost = self.skipped = 0
            self.row: np.ndarray | None = None
            self._coming = np.full(preview, np.nan)
            self._next = -1
            self._arrivals: list[tuple[float, int]] = []

    def add(self, block: Block) -> bool:
        """Append samples and return True; if the sample numbers went back, change nothing and return False."""
        count = block.numbers.size
        if not count:
            return True
        first = int(block.numbers[0])
        with self.lock:
            if self._next >= 0 and first < self._next:
                return False
            missing = first - self._next if self._next >= 0 else 0
            self.lost += missing
            if missing:
                gap = min(missing, round(MEMORY * self.rate))
                self.history.append(np.full((len(self._names), gap), np.nan))
            self._next = int(block.numbers[-1]) + 1
            self.history.append(self._shown(block.table))
            self.skipped += int(np.nansum(block.table[signals.SKIPPED]))
            self.row = block.table[:, -1].copy()
            now = time.monotonic()
            self._arrivals = [*((t, n) for t, n in self._arrivals if now - t < COUNTED), (now, count)]
        return True

    def _shown(self, table: np.ndarray) -> np.ndarray:
        published = np.concatenate([self._coming, table[signals.REFERENCE]])
        reference, self._coming = published[: table.shape[1]], published[table.shape[1] :]
        # a motor's controller measures slider position minus origin; while the motor walks, this is the extender's
        # extension
        origin = table[signals.ORIGIN] if self.motor else 0.0
        own = {"reference": reference, "error": table[signals.MEASURED] - origin - reference}
        return np.array([own[name] if name in own else table[signals.place(name)] for name in self._names])

    @property
    def age(self) -> float:
        """Time since the last samples [s]; infinite before the first."""
        return time.monotonic() - self._arrivals[-1][0] if self._arrivals else np.inf

    @property
    def is_live(self) -> bool:
        """Whether samples arrive."""
        return self.age < SILENT

    def value(self, place: int) -> float:
        """Return a signal of the last sample, NaN before the first."""
        row = self.row
        return float("nan") if row is None or place >= row.size else float(row[place])

    def rate_seen(self) -> float:
        """Return the rate at which samples arrive by the wall clock [Hz]."""
        arrivals = self._arrivals
        if len(arrivals) < 2 or not self.is_live:
            return 0.0
        return sum(count for _, count in arrivals[1:]) / max(arrivals[-1][0] - arrivals[0][0], 1e-9)

    def last(self, name: str, seconds: float) -> np.ndarray:
        """Return the last values of a signal."""
        with self.lock:
            begin = max(self.history.begin, self.history.end - round(seconds * self.rate))
            return self.history.part(begin, self.history.end)[self._names.index(name)].copy()

    def frame(self, view: View) -> bytes | None:
        """Return the next frame of a page."""
        with self.lock:
            return view.frame(self.history)

    def view(self, window: float, columns: int) -> View:
        """Return a new view of the last ``window`` [s]."""
        return View(window, columns, self.rate, self.epoch, self.motor)

    def figures(self) -> dict[str, float | None]:
        """Return RMS and largest error of the last seconds [m], and the last values of the signals."""
        error = self.last("error", FIGURES)
        known = error[np.isfinite(error)]
        values = {"rms": float("nan"), "largest": float("nan")}
        if known.size:
            values = {"rms": float(np.sqrt(np.mean(known**2))), "largest": float(np.abs(known).max())}
        places = {"setpoint": signals.SETPOINT, "measured": signals.MEASURED, "voltage": signals.VOLTAGE}
        values |= {name: self.value(place) for name, place in places.items()}
        return {name: value if np.isfinite(value) else None for name, value in values.items()}

    def spectrum(self) -> dict:
        """Return the amplitude density of the error [m/√Hz] versus frequency [Hz]."""
        frequency, density = amplitude_density(self.last("error", SPECTRUM), self.rate)
        return {"frequency": frequency.tolist(), "density": density.tolist()}


#: Signals of a motor whose last values are shown as numbers.
MOTOR_VALUES = (
    "phase",
    "direction",
    "speed",
    "arrived",
    "error",
    "steps",
    "total_steps",
    "missed",
    "step_commanded",
    "step_achieved",
    "slip",
    "load_deflection",
    "forward_gain",
    "backward_gain",
)


def motor_facts(axis: AxisParameters) -> dict | None:
    """Return the constants of a motor; None when the axis is not a motor."""
    sequencer = axis.inchworm_sequencer
    if sequencer is None:
        return None
    gait, walk = sequencer.gait, sequencer.walk
    fastest = max(gait.speed, walk.fastest(gait)) if walk.continuous else gait.speed
    return {
        "phases": [name.replace("_", " ") for name in PHASE_NAMES],
        "errors": [name.replace("_", " ") for name in ERROR_NAMES],
        "fastest": fastest,
        "learns": walk.continuous,
    }


def motor_values(memory: Memory) -> dict[str, float | None] | None:
    """Return the last values of :data:`MOTOR_VALUES` (SI, None when unknown); None when the axis is not a motor."""
    if not memory.motor:
        return None
    values = {name: memory.value(signals.place(name)) for name in MOTOR_VALUES}
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


class Track:
    """Reference and measured displacement of one axis over the last seconds."""

    def __init__(self, preview: int = 0):
        self._preview = preview
        self._coming = np.full(preview, np.nan)
        self._pieces: deque[tuple[np.ndarray, np.ndarray, np.ndarray]] = deque()

    def add(self, block: Block) -> None:
        """Append samples; if the stamps went back, discard the earlier samples first."""
        if not block.stamps.size:
            return
        if self._pieces and block.stamps[0] <= self._pieces[-1][0][-1]:
            self._pieces.clear()
            self._coming = np.full(self._preview, np.nan)
        published = np.concatenate([self._coming, block.table[signals.REFERENCE]])
        reference, self._coming = published[: block.stamps.size], published[block.stamps.size :]
        self._pieces.append((block.stamps, reference, block.table[signals.MEASURED].copy()))
        while self._pieces[0][0][-1] < block.stamps[-1] - PLANE_WINDOW * SECOND:
            self._pieces.popleft()

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps, shape (N,), and reference and measured displacement, shape (2, N) [m]."""
        if not self._pieces:
            return np.zeros(0, np.int64), np.zeros((2, 0))
        stamps, reference, measured = map(np.concatenate, zip(*self._pieces, strict=True))
        return stamps, np.array([reference, measured])


class Plane:
    """The tracks of two axes of a stage, written by one thread, read by another."""

    def __init__(self):
        self._lock = threading.Lock()
        self._tracks: dict[str, Track] = {}

    @property
    def axes(self) -> tuple[str, ...]:
        """Namespaces of the two axes, x first; empty if there is no stage."""
        return tuple(self._tracks)

    def choose(self, axes: dict[str, int]) -> None:
        """Select the two axes of the plane, as namespace → preview [samples]; empty: no plane."""
        with self._lock:
            self._tracks = {namespace: Track(preview) for namespace, preview in axes.items()}

    def add(self, namespace: str, block: Block) -> None:
        """Append samples of an axis."""
        with self._lock:
            if namespace in self._tracks:
                self._tracks[namespace].add(block)

    def told(self) -> dict | None:
        """Return names, reference and path [m] of both axes, and the error of each point [m]; None if no plane exists.

        A point represents several consecutive samples; its error is their largest error.
        """
        with self._lock:
            names = [namespace.rpartition("/")[2] for namespace in self._tracks]
            found = [track.samples() for track in self._tracks.values()]
        if len(found) != 2:
            return None
        (first, one), (second, other) = found
        _, at_one, at_other = np.intersect1d(first, second, assume_unique=True, return_indices=True)
        both = np.stack([one[:, at_one], other[:, at_other]], axis=1)
        both = both[:, :, np.all(np.isfinite(both), axis=(0, 1))]
        reference, measured = both
        size = np.hypot(*(reference - measured))
        starts = np.arange(0, size.size, max(-(-size.size // PLANE_POINTS), 1))
        error = np.maximum.reduceat(size, starts) if size.size else size
        return {
            "names": names,
            "reference": reference[:, starts].tolist(),
            "path": measured[:, starts].tolist(),
            "error": error.tolist(),
            "rms": float(np.sqrt(np.mean(size**2))) if size.size else None,
            "largest": float(size.max()) if size.size else None,
        }
