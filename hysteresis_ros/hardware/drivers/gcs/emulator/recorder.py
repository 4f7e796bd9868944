# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The data recorder of the emulated controller."""

from __future__ import annotations

from hysteresis_ros.hardware.drivers.gcs.protocol import (
    CONTROL_VOLTAGE,
    OPEN_LOOP,
    POSITION,
    POSITION_ERROR,
    TARGET,
    VOLTAGE,
)

#: Points that all tables share.
POINTS = 65536
#: What can be recorded, in the words of the answer.
OPTIONS = {
    0: "Nothing",
    TARGET: "Target Position of axis",
    POSITION: "Current Position of axis",
    POSITION_ERROR: "Position Error of axis",
    CONTROL_VOLTAGE: "Control Voltage of output chan",
    OPEN_LOOP: "Open-Loop Control of axis",
    VOLTAGE: "Voltage of output chan",
}
#: Triggers: the wave generator, any move too, none is waited for.
BY_WAVE, BY_MOTION, AT_ONCE = 0, 1, 4


class Recorder:
    """Tables of what an axis did in each sample, or in each so many of them.

    Parameters
    ----------
    axes : list of str
        Names of the axes; a table of the position of each stands there at the beginning.
    """

    def __init__(self, axes: list[str]):
        self.configuration = [(name, POSITION) for name in axes]
        self.rate, self.trigger, self.running = 1, BY_WAVE, False
        self.tables: list[list[float]] = [[] for _ in axes]
        self._seen = dict.fromkeys(axes, 0)

    @property
    def points(self) -> int:
        """Points of each table."""
        return POINTS // len(self.tables)

    def resize(self, count: int) -> None:
        """Have so many tables.

        Parameters
        ----------
        count : int
        """
        first = self.configuration[0][0]
        self.configuration = (self.configuration + [(first, 0)] * count)[:count]
        self.tables, self.running = [[] for _ in range(count)], False

    def start(self) -> None:
        """Begin anew."""
        self.tables = [[] for _ in self.configuration]
        self._seen = dict.fromkeys(self._seen, 0)
        self.running = any(option for _, option in self.configuration)

    def record(self, axis: str, signals: dict[int, float]) -> None:
        """Take a sample of an axis.

        Parameters
        ----------
        axis : str
        signals : dict of int to float
            What can be recorded.
        """
        if self._seen[axis] % self.rate == 0:
            for (name, option), table in zip(self.configuration, self.tables, strict=True):
                if name == axis and option and len(table) < self.points:
                    table.append(signals[option])
        self._seen[axis] += 1
        self.running = any(
            option and len(table) < self.points
            for (_, option), table in zip(self.configuration, self.tables, strict=True)
        )

    def lines(self, start: int, count: int, tables: list[int], cycle: float) -> list[str]:
        """Return recorded points as a GCS array.

        Parameters
        ----------
        start : int
            First point, from 1.
        count : int
        tables : list of int
            Numbers of the tables, from 1.
        cycle : float
            Time between two samples [s].
        """
        columns = [self.tables[number - 1][start - 1 : start - 1 + count] for number in tables]
        length = min(map(len, columns))
        head = {
            "TYPE": 1,
            "SEPARATOR": 32,
            "DIM": len(tables),
            "SAMPLE_TIME": f"{cycle * self.rate:.9g}",
            "NDATA": length,
        }
        for place, number in enumerate(tables):
            name, option = self.configuration[number - 1]
            head[f"NAME{place}"] = f"{OPTIONS[option]}{name}"
        lines = [f"# {name} = {value}" for name, value in head.items()] + ["# END_HEADER"]
        return lines + [" ".join(f"{column[row]:.7g}" for column in columns) for row in range(length)]
