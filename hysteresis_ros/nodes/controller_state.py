# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a motion controller shows to tools of ros2_control: messages of the package control_msgs, if it is there."""

from __future__ import annotations

import importlib
import math

from builtin_interfaces.msg import Duration

from hysteresis_ros import signals
from hysteresis_ros.control.laws.pid.law import INTEGRAL
from hysteresis_ros.nodes.qos import setpoint_qos

#: What is said where the package is missing.
MISSING = (
    "~/controller_state and ~/pid_state are not published: the package control_msgs is not installed "
    "(sudo apt install ros-jazzy-control-msgs; it is not among the wheels; controller_state_rate: 0 does without them)"
)


def message_types() -> tuple[type, type] | None:
    """Return the types SingleDOFStateStamped and PidState, None where the package control_msgs is not installed."""
    try:
        found = importlib.import_module("control_msgs.msg")
    except ImportError:
        return None
    return found.SingleDOFStateStamped, found.PidState


class ControllerState:
    """Publishes ``~/controller_state``, and ``~/pid_state`` while a PID controller works.

    Parameters
    ----------
    node : MotionControllerNode
    state_type, pid_type : type
        SingleDOFStateStamped and PidState.
    """

    def __init__(self, node, state_type: type, pid_type: type):
        self._node = node
        self._state, self._pid = state_type(), pid_type()
        self._state_publisher = node.publisher(state_type, "~/controller_state", setpoint_qos())
        self._pid_publisher = node.publisher(pid_type, "~/pid_state", setpoint_qos())
        self._shown, self._before = -1, (math.nan, math.nan)

    def tell(self, stamp) -> None:
        """Publish the present sample, ``controller_state_rate`` times a second of the axis.

        Parameters
        ----------
        stamp : builtin_interfaces.msg.Time
            Of the measurement.
        """
        node, row = self._node, self._node.row
        rate, since = node.parameters.sample_rate, node.sample - self._shown
        if self._shown >= 0 and 0 <= since < rate / node.parameters.controller_state_rate:
            return
        reference, measured, command = row[signals.REFERENCE], row[signals.SEEN], row[signals.COMMAND]
        elapsed = max(since, 1) / rate
        error = reference - measured
        velocity, drift = (measured - self._before[0]) / elapsed, (error - self._before[1]) / elapsed
        self._shown, self._before = node.sample, (measured, error)
        state = self._state.dof_state
        self._state.header.stamp = stamp
        state.name, state.time_step = node.parameters.joint, 1.0 / rate
        state.reference, state.feedback, state.feedback_dot = reference, measured, velocity
        state.error, state.error_dot, state.output = error, drift, command
        self._state_publisher.publish(self._state)
        if node.controller_type == "pid":
            self._tell_pid(stamp, error, drift, command)

    def _tell_pid(self, stamp, error: float, drift: float, command: float) -> None:
        """Publish what a PID controller is made of; the names of its gains have changed between versions."""
        gains, message = self._node.parameters.pid, self._pid
        given = {"Kp": gains.Kp, "Ki": gains.Ki, "Kd": gains.Kd, "integral": float(self._node.controller.x[INTEGRAL])}
        renamed = hasattr(message, "p_gain")
        names = ("p_gain", "i_gain", "d_gain", "i_term") if renamed else ("p_term", "i_term", "d_term", "i_error")
        for name, value in zip(names, given.values(), strict=True):
            setattr(message, name, value)
        if not renamed:
            message.p_error, message.d_error, message.i_max, message.i_min = error, drift, math.inf, -math.inf
        message.header.stamp = stamp
        nanoseconds = round(1e9 / self._node.parameters.sample_rate)
        message.timestep = Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        message.error, message.error_dot, message.output = error, drift, command
        self._pid_publisher.publish(message)
