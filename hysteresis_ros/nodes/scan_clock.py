# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Topic ``scan_clock``: a message when a frame, line or pixel of a scan begins, with the stamp of the sample.

The messages are computed from the samples of the waveform in the reference generators (``waveform_sample``). So the
clock stays correct when the scan is stopped, restarted or ends, when samples are skipped, and after a change of the
waveform.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from hysteresis_ros.nodes.qos import loop_qos
from hysteresis_ros.references.scan import Marks
from hysteresis_ros.references.scan_clock import ScanClock
from hysteresis_ros.signals import WAVEFORM_SAMPLE

#: Name of the topic, in the namespace of the axis or of the stage.
TOPIC = "scan_clock"
#: Queue depth of the topic.
KEPT = 1000
#: Contents of ``position``: numbers of the frame, line and pixel that begin (-1: none begins), direction (1:
#: trace, -1: retrace, 0: a frame), and the time from the exact beginning to the stamp [s].
NAMES = ("frame", "line", "pixel", "direction", "delay")
#: Number of samples for which the clock waits for the answers of other axes.
AWAITED = 100


class ScanClockTopic:
    """Publishes the clock of a scan that one axis follows, or that several axes of a stage follow together.

    If the axes are not at the same sample of their waveforms, no message is published, because then they do not follow
    the path of the scan.
    """

    def __init__(self, node, topic: str, axes: int = 1):
        self._axes = axes
        self._publisher = node.publisher(JointState, topic, loop_qos(node.runner.keeps, KEPT))
        self.name = self._publisher.topic_name
        self._message = JointState(name=list(NAMES))
        #: Function that also receives stamp [ns] and contents of each message, for a recorder that reads no messages.
        self.record: Callable[[int, list[float]], object] = lambda stamp, values: None
        self._waiting: dict[int, dict[int, float]] = {}
        self._tables: dict[int, tuple[int, np.ndarray]] = {}
        self.follow(None)

    def follow(self, clock: ScanClock | None) -> None:
        """Use another scan, beginning with the next sample; None: no scan."""
        self._clock = clock
        self._last, self._due = -2, math.inf

    def take(self, stamp: int, sample: float, axis: int = 0) -> None:
        """Take the waveform sample of one axis at a stamp [ns]."""
        if self._axes > 1:
            together = self._waiting.setdefault(stamp, {})
            together[axis] = sample
            if len(together) < self._axes:
                if len(self._waiting) > AWAITED:
                    del self._waiting[next(iter(self._waiting))]
                return
            del self._waiting[stamp]
            sample = sample if len(set(together.values())) == 1 else -1.0
        if self._clock is None or sample < 0.0:
            self._last = -2
            return
        k = int(sample)
        if k == self._last + 1 and k < self._due:
            self._last = k
            return
        marks = self._clock.between(k - 1, k)
        self._publish(marks, np.full(marks.sample.size, stamp))
        self._last, self._due = k, self._clock.next_after(k)

    def take_all(self, first: int, table: np.ndarray, stamps, axis: int = 0) -> None:
        """Take consecutive samples of one axis of a fused loop, beginning with number ``first``, shape (row length, N).

        ``stamps`` is a function that returns the stamps [ns] of given sample numbers.
        """
        self._tables[axis] = first, table[WAVEFORM_SAMPLE]
        if len(self._tables) < self._axes:
            return
        begin = max(start for start, _ in self._tables.values())
        until = min(start + samples.size for start, samples in self._tables.values())
        found = [samples[begin - start : max(until - start, 0)] for start, samples in self._tables.values()]
        self._tables.clear()
        if self._clock is None or until <= begin:
            return
        runs = np.all(np.equal(found, found[0]), axis=0) & (found[0] >= 0.0)
        # where the waveform restarts, the difference between sample number and waveform sample changes
        offset = np.where(runs, np.arange(begin, until) - found[0], -1.0)
        for piece in np.split(np.arange(offset.size), np.flatnonzero(np.diff(offset)) + 1):
            if runs[piece[0]]:
                own, shift = found[0][piece[[0, -1]]].astype(np.int64), int(offset[piece[0]])
                marks = self._clock.between(int(own[0]) - 1, int(own[1]))
                self._publish(marks, stamps(marks.sample + shift))

    def _publish(self, marks: Marks, stamps: np.ndarray) -> None:
        """Publish marks with the stamps [ns] of their samples."""
        if self._clock is None or not stamps.size:
            return
        delays = np.maximum(marks.sample - marks.place, 0.0) * self._clock.sample_time
        columns = marks.frame, marks.line, marks.pixel, marks.direction, delays
        message = self._message
        for stamp, values in zip(stamps.tolist(), np.column_stack(columns).astype(float).tolist(), strict=True):
            message.header.stamp = Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
            message.position = values
            self._publisher.publish(message)
            self.record(stamp, values)
