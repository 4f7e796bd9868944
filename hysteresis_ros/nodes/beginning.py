# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What an axis is doing when a reference generator comes to it in real time.

A generator that is started with its axis begins as configured: at ``initial_setpoint``, with its waveform. One that
comes to an axis that was led before, because it was restarted, begins where that axis is and stays there until somebody
asks for something. Who knows is the controller: it says in its ``~/state`` which reference it follows. Measurements
alone do not tell: they are those of a preloaded actuator, and off by the error of the loop.
"""

from __future__ import annotations

import math
import time

from sensor_msgs.msg import JointState

from hysteresis_ros.loop.watch import FOLLOWING, HOLDING, RUNNING

#: Seconds after the first measurement for which a controller is looked for, and for which one that is there but says
#: nothing (it is not active) is waited for.
LOOK, PATIENCE = 1.0, 5.0

#: Modes of a controller that follows its reference.
LED = (RUNNING, HOLDING, FOLLOWING)


def place_of(state: dict[str, float]) -> float:
    """Return where an axis is kept [m], by the signals of its controller's ``~/state``; NaN: nobody has led it yet.

    Under a controller that has been stopped that is the command, on its way to ``safe_command``.

    Parameters
    ----------
    state : dict of str to float
        ``reference``, ``command`` and ``mode`` among others.
    """
    if math.isnan(state["reference"]):
        return math.nan
    return state["reference"] if int(state["mode"]) in LED else state["command"]


class Beginning:
    """Whether a reference generator begins as configured or where the axis is.

    Parameters
    ----------
    node : ReferenceGeneratorNode
        In real time, apart from the controller.
    """

    def __init__(self, node):
        self._node = node
        self._known = False
        self._since = math.nan
        self._heard = node.subscriber(JointState, "motion_controller/state", self._on_state, node.qos())

    def _on_state(self, message) -> None:
        node = self._node
        if self._known or not node.active:
            return
        self._known = True
        place = place_of(dict(zip(message.name, message.position, strict=True)))
        if math.isfinite(place):
            node.begin_at(place)
            node.get_logger().info(f"the axis is at work: beginning at {place:.6g} m, until a setpoint or ~/start")

    def take(self, message) -> bool:
        """Tell whether this measurement may be answered: whether it is known how to begin."""
        node = self._node
        if not self._known and node.active:
            now = time.monotonic()
            if math.isnan(self._since):
                self._since = now
            there = node.count_publishers(self._heard.topic_name)
            self._known = now - self._since > (PATIENCE if there else LOOK)
        if self._known and self._heard is not None:
            node.drop(self._heard)
            self._heard = None
        return self._known
