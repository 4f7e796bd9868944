# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Topic ``trigger_out``: a message for each trigger of an axis, with the stamp of the sample that follows it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from hysteresis_ros import signals
from hysteresis_ros.nodes.qos import loop_qos

#: Topic of the triggers of an axis.
TOPIC = "trigger_out"
#: Queue depth of the topic of the triggers.
KEPT = 1000
#: Topic of the pulses of the axis' trigger input.
INPUT = "trigger_in"
#: Contents of ``position``: number of the trigger (from 1), position of the axis [m], direction of motion (1: up, -1:
#: down), time from the trigger to the stamp [s], and number of triggers since the previous message that were lost
#: because they followed each other too fast.
NAMES = ("number", "position", "direction", "delay", "lost")
_PLACES = (signals.TRIGGER, signals.TRIGGER_POSITION, signals.TRIGGER_DIRECTION, signals.TRIGGER_DELAY)


class TriggerTopic:
    """Publishes the triggers of one axis."""

    def __init__(self, node):
        self._publisher = node.publisher(JointState, TOPIC, loop_qos(node.runner.keeps, KEPT))
        self.name = self._publisher.topic_name
        self._message = JointState(name=list(NAMES))
        #: Function that also receives stamp [ns] and contents of each message, for a recorder that reads no messages.
        self.record: Callable[[int, list[float]], object] = lambda stamp, values: None
        self._last = 0.0
        #: Number of triggers so far that were lost because they followed each other too fast.
        self.lost = 0

    def take(self, stamp: int, row) -> None:
        """Take the row of a sample with its stamp [ns]."""
        if row[signals.TRIGGER] == 0.0:
            return
        values = [float(row[place]) for place in _PLACES]
        lost = max(values[0] - self._last - 1.0, 0.0)
        self._last = values[0]
        self.lost += int(lost)
        values.append(lost)
        message = self._message
        message.header.stamp = Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
        message.position = values
        self._publisher.publish(message)
        self.record(stamp, values)

    def take_all(self, first: int, table: np.ndarray, stamps) -> None:
        """Take consecutive samples, beginning with number ``first``, shape (row length, N).

        ``stamps`` is a function that returns the stamps [ns] of given sample numbers.
        """
        places = np.flatnonzero(table[signals.TRIGGER])
        for place, stamp in zip(places, stamps(first + places).tolist(), strict=True):
            self.take(stamp, table[:, place])

    def restart(self) -> None:
        """Count from 1 again, after a reset of the axis."""
        self._last = 0.0
