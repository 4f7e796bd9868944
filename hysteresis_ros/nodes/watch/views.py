# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What of the history each page has still to get, and the frames it gets it in; knows no ROS and no web server.

A frame is a header in JSON, with its length in front (4 bytes) and filled up with spaces to a multiple of 4, and then
numbers, float32, little-endian: of each signal that the header names, and each column of the screen, the least and the
greatest value in the order in which they came, and after them the points of the loops. Numbers are SI.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.analysis.live import History, extremes, outline

#: Signals over time, of a row or made here, and those of the loops: displacement over voltage and over the command.
SHOWN = ("reference", "measured", "error", "command", "voltage", "estimated", "saturated", "skipped")
LOOP = ("voltage", "command", "measured")
#: The same of an inchworm motor, whose command and voltage are its extender's.
MOTOR_SHOWN = (*SHOWN, "setpoint", "extender", "front_voltage", "rear_voltage", "phase")
MOTOR_LOOP = ("voltage", "command", "extender")
#: Seconds of the loops at most, and columns that they are cut into.
LOOP_TIME, LOOP_COLUMNS = 4.0, 1000
#: Seconds that are kept.
MEMORY = 60.0


@dataclass
class Part:
    """How far a page has got, in whole bins of samples.

    Parameters
    ----------
    length : int
        Samples of a bin.
    bins : int
        How many the page shows.
    next : int
        Bin that it has to get next; -1: it has none.
    """

    length: int
    bins: int
    next: int = -1

    def due(self, history: History) -> tuple[bool, int, np.ndarray]:
        """Return whether the page begins anew, the first bin that is due, and the samples of all that are due.

        Parameters
        ----------
        history : History
        """
        end = history.end // self.length
        begin = max(-(-history.begin // self.length), end - self.bins)
        fresh = not begin <= self.next <= end
        first = begin if fresh else self.next
        self.next = end
        return fresh, first, history.part(first * self.length, end * self.length)


class View:
    """What one page looks at.

    Parameters
    ----------
    window : float
        Seconds over time.
    columns : int
        Of the screen.
    rate : float
        Samples per second [Hz].
    epoch : int
        Of the history.
    motor : bool
        Of an inchworm motor.
    """

    def __init__(self, window: float, columns: int, rate: float, epoch: int, motor: bool = False):
        self.window, self.columns, self.rate, self.epoch = window, columns, rate, epoch
        self._shown, loop = (MOTOR_SHOWN, MOTOR_LOOP) if motor else (SHOWN, LOOP)
        self._loop_rows = [self._shown.index(name) for name in loop]
        samples = max(round(window * rate), 1)
        length = max(-(-samples // columns), 1)
        self._time = Part(length, -(-samples // length))
        samples = max(round(min(window, LOOP_TIME) * rate), 1)
        length = max(-(-samples // LOOP_COLUMNS), 1)
        self._loop = Part(length, -(-samples // length))

    def frame(self, history: History) -> bytes | None:
        """Return the next frame, None when there is nothing new.

        Parameters
        ----------
        history : History
            With the rows :data:`SHOWN`, or :data:`MOTOR_SHOWN`.
        """
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
