# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What is known of an axis while it is watched: the last minute of its samples, and figures of them."""

from __future__ import annotations

import threading
import time

import numpy as np

from hysteresis_ros import signals
from hysteresis_ros.analysis.live import History, amplitude_density
from hysteresis_ros.nodes.samples import Block
from hysteresis_ros.nodes.watch.views import MEMORY, MOTOR_SHOWN, SHOWN, View

#: Seconds over which figures and the spectrum are taken, and within which a rate is counted.
FIGURES, SPECTRUM, COUNTED = 2.0, 8.0, 2.0
#: Seconds without samples after which an axis is called silent.
SILENT = 1.5


class Memory:
    """The last samples; filled by one thread, read by another.

    Parameters
    ----------
    rate : float
        Samples per second [Hz].
    preview : int
        Samples by which the controller's feedforward gets the reference before it is followed.
    """

    def __init__(self, rate: float = 1000.0, preview: int = 0):
        self.lock = threading.Lock()
        self.epoch = -1
        self.restart(rate, preview)

    def restart(self, rate: float, preview: int = 0, motor: bool = False) -> None:
        """Forget everything: another run begins.

        Parameters
        ----------
        rate : float
        preview : int
        motor : bool
            Of an inchworm motor.
        """
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
        """Put samples in; tell whether they follow the last ones. Where not, nothing is done: begin anew.

        Parameters
        ----------
        block : Block
        """
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
        # what a motor's controller follows is the slider less an origin, which is the extender while it walks
        origin = table[signals.ORIGIN] if self.motor else 0.0
        own = {"reference": reference, "error": table[signals.MEASURED] - origin - reference}
        return np.array([own[name] if name in own else table[signals.place(name)] for name in self._names])

    @property
    def age(self) -> float:
        """Seconds since the last samples came; infinite before the first."""
        return time.monotonic() - self._arrivals[-1][0] if self._arrivals else np.inf

    @property
    def is_live(self) -> bool:
        """Whether samples come."""
        return self.age < SILENT

    def value(self, place: int) -> float:
        """Return a signal of the last sample, NaN before the first."""
        row = self.row
        return float("nan") if row is None or place >= row.size else float(row[place])

    def rate_seen(self) -> float:
        """Return how many samples come in a second of the wall clock [Hz]."""
        arrivals = self._arrivals
        if len(arrivals) < 2 or not self.is_live:
            return 0.0
        return sum(count for _, count in arrivals[1:]) / max(arrivals[-1][0] - arrivals[0][0], 1e-9)

    def last(self, name: str, seconds: float) -> np.ndarray:
        """Return the last values of a signal.

        Parameters
        ----------
        name : str
            Of :data:`hysteresis_ros.nodes.watch.views.SHOWN`.
        seconds : float
        """
        with self.lock:
            begin = max(self.history.begin, self.history.end - round(seconds * self.rate))
            return self.history.part(begin, self.history.end)[self._names.index(name)].copy()

    def frame(self, view: View) -> bytes | None:
        """Return the next frame of a page.

        Parameters
        ----------
        view : View
        """
        with self.lock:
            return view.frame(self.history)

    def view(self, window: float, columns: int) -> View:
        """Return a new view.

        Parameters
        ----------
        window : float
            [s]
        columns : int
        """
        return View(window, columns, self.rate, self.epoch, self.motor)

    def figures(self) -> dict[str, float | None]:
        """Return the error of the last seconds [m]: root of its mean square, its largest, and the last values."""
        error = self.last("error", FIGURES)
        known = error[np.isfinite(error)]
        values = {"rms": float("nan"), "largest": float("nan")}
        if known.size:
            values = {"rms": float(np.sqrt(np.mean(known**2))), "largest": float(np.abs(known).max())}
        places = {"setpoint": signals.SETPOINT, "measured": signals.MEASURED, "voltage": signals.VOLTAGE}
        values |= {name: self.value(place) for name, place in places.items()}
        return {name: value if np.isfinite(value) else None for name, value in values.items()}

    def spectrum(self) -> dict:
        """Return the amplitude density of the error [m/√Hz] over the frequency [Hz]."""
        frequency, density = amplitude_density(self.last("error", SPECTRUM), self.rate)
        return {"frequency": frequency.tolist(), "density": density.tolist()}
