# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Samples of an axis whose nodes exchange messages, put together again out of what each node says of its part."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import JointState

from hysteresis_ros import signals
from hysteresis_ros.nodes.samples import SECOND, Block

#: A sample that lacks a node's part is shown without it when another one is younger by so much [ns].
PATIENCE = 300_000_000
#: Samples that wait for their parts at most.
MOST = 20_000


class Collector:
    """Rows of samples out of the ``~/state`` of the nodes, which belong together by their stamps.

    Parameters
    ----------
    nodes : sequence of str
        Who says something of a sample.
    motor : bool
        An inchworm motor.
    """

    def __init__(self, nodes, motor: bool):
        self._row = len(signals.row_signals(motor))
        self._bits = {node: 1 << index for index, node in enumerate(nodes)}
        self._names = {node: signals.state_signals(node, motor) for node in nodes}
        self._places: dict[tuple, list] = {}
        self._pending: dict[int, tuple[np.ndarray, int]] = {}
        self._done, self._count = -1, 0

    def add(self, node: str, message: JointState) -> None:
        """Take what a node says of a sample.

        Parameters
        ----------
        node : str
        message : JointState
            Of its ``~/state``.
        """
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        if stamp <= self._done:
            if self._done - stamp < PATIENCE:
                return
            self._pending.clear()  # time has begun anew
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
        """Return the samples that are whole, and those before them that will not be."""
        whole = sum(self._bits.values())
        newest = max(self._pending, default=0)
        ready = [stamp for stamp, (_, seen) in self._pending.items() if seen == whole or stamp < newest - PATIENCE]
        until = max(ready, default=-1)
        if len(self._pending) > MOST:
            until = newest
        stamps = np.array(sorted(stamp for stamp in self._pending if stamp <= until), np.int64)
        rows = [self._pending.pop(int(stamp))[0] for stamp in stamps]
        self._done = max(self._done, until)
        table = np.array(rows).T.reshape(self._row, len(rows))
        # counted: a plant that is late moves its schedule, so that stamps do not tell the number
        self._count += len(rows)
        return Block(stamps, np.arange(self._count - len(rows), self._count), table, None)
