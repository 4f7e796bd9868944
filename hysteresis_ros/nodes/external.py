# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A run whose plant is a node of somebody else: what ``plant_simulator`` does for a run beside measuring.

That node publishes ``joint_states`` whether anybody answers or not. The run begins when the loop is complete and a
recorder that is awaited is there, and ends after its samples: ``reference_generator``, in which this works, answers the
measurements between.
"""

from __future__ import annotations

import math
import time

from std_msgs.msg import Float64, UInt64

from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.timing import WINDOW, Pairing

#: How long a run of given length waits for its beginning [s], and how often it is said what for [s].
PATIENCE, EVERY = 30.0, 5.0

#: Measurements between a loop that is complete and the first sample: others find out which answers belong to which.
SETTLE = Pairing.SUSPICION + 20

#: Between the last sample and the end [s]: on a busy machine others answer later than the source.
GRACE = 0.5

#: Measurements whose stamps say at what rate they come, and how far that may be from ``sample_rate``.
STAMPS, TOLERANCE = 50, 0.1


class ExternalRun:
    """Beginning and end of a run.

    Parameters
    ----------
    node : AxisNode
        Answers the measurements.
    """

    def __init__(self, node):
        self._node = node
        self._begun = self._recorded = self._answered = False
        self._stamps: list[int] = []
        self._noted = False
        self._further = self._settled = 0
        self._end = node.publisher(UInt64, "end_of_run", latched_qos())
        topics = ("command", "applied", "voltage", "joint_states")
        self._command, self._applied, self._voltage, self._joint_states = map(node.resolve_topic_name, topics)
        node.subscriber(Float64, "voltage", self._on_voltage, node.qos(), partner="hysteresis_compensator")
        if node.parameters.wait_for_recorder:
            node.subscriber(UInt64, "recorder/acknowledged", self._on_recorder, latched_qos(), partner="recorder")

    def _on_recorder(self, message) -> None:
        self._recorded = True

    def _on_voltage(self, message) -> None:
        """Note that controller and compensator have found each other: they answer before the first reference."""
        self._answered = True

    def begin(self) -> None:
        """Begin to wait."""
        self._since = time.monotonic()
        self._node.timer(0.5, self._look)

    def _absent(self) -> str:
        """Name who is missing for the run to begin; nobody: ''."""
        node = self._node
        who = {
            "motion_controller": node.count_publishers(self._command),
            "hysteresis_compensator": node.count_publishers(self._applied),
            "who publishes joint_states (the node in the plant's place)": node.count_publishers(self._joint_states),
            # beside this node and the recorder
            "who hears voltage (the node in the plant's place)": node.count_subscribers(self._voltage)
            > 1 + node.parameters.wait_for_recorder,
            "recorder": self._recorded or not node.parameters.wait_for_recorder,
            "a voltage": self._answered,
            "who hears reference": node.runner.matched(),
        }
        return ", ".join(name for name, there in who.items() if not there)

    def take(self, message) -> bool:
        """Take a measurement; tell whether it belongs to the run.

        Parameters
        ----------
        message : JointState
        """
        node = self._node
        if node.finished or node.failure:
            return False
        if not self._begun:
            self._settled = 0 if self._absent() else self._settled + 1
            self._begun = self._settled > SETTLE
            return self._begun
        if not node.sample:
            self._further = 0  # after a reset too
        self._note(message.header.stamp)
        samples = node.parameters.samples
        if not samples or node.sample < samples:
            return True
        self._further += 1
        if self._further == math.ceil(GRACE * node.parameters.sample_rate):
            node.end_of_run = node.sample
            self._end.publish(UInt64(data=node.sample))
            node.get_logger().info(f"{node.sample} samples: the run ends")
            node.leave_when_done()
        return False

    def _note(self, stamp) -> None:
        """Look once at what rate measurements come."""
        if self._noted:
            return
        self._stamps.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        span = 1e-9 * (self._stamps[-1] - self._stamps[0])
        if len(self._stamps) < STAMPS or span < WINDOW:
            return
        self._noted = True
        steps = sorted(later - earlier for earlier, later in zip(self._stamps[:-1], self._stamps[1:], strict=True))
        wanted, rate = self._node.parameters.sample_rate, len(steps) / span
        # a burst deceives the usual step and a gap the count, a wrong rate is wrong in both
        usual = 1e9 / max(steps[len(steps) // 2], 1)
        self._stamps.clear()
        if min(abs(rate - wanted), abs(usual - wanted)) > TOLERANCE * wanted:
            text = f"joint_states come at {rate:.6g} Hz, sample_rate is {wanted:g} Hz: models and controllers are made "
            self._node.warn("rate", f"{text}for that; give both the same", error=True, every=0.0)

    def _look(self) -> None:
        """Timer: say what the run waits for; one of given length does not do so for ever."""
        node, waited = self._node, time.monotonic() - self._since
        absent = "" if self._begun else self._absent()
        if self._begun or waited < EVERY:
            return
        text = f"the run waits for {absent or 'a measurement of the node in the plant’s place'}"
        if node.parameters.samples and waited > PATIENCE:
            node.fail(f"{text} since {waited:.0f} s; start it and begin again")
        else:
            node.warn("waiting", text, every=EVERY)
