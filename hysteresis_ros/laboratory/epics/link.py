# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The link of a motor record to the nodes of its axis: it sends setpoints and stops, and receives measurements."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from hysteresis_ros import signals
from hysteresis_ros.laboratory.epics.record import (
    SILENT,
    STOPPED,
    UNMEASURED,
    Alarm,
    MotorSettings,
    RecordOptions,
    Seen,
    motor_settings,
)
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.nodes.qos import latched_qos, sensor_qos, setpoint_qos
from hysteresis_ros.nodes.security.policy import RECORDS, Profile

#: Time without a measurement, or without a message of the reference generator, after which an axis counts as lost [s].
SILENCE = 1.0


class AxisLink:
    """The ROS node of a record; its methods may be called from any thread."""

    def __init__(self, node: Node, settings: MotorSettings):
        self._settings = settings
        space = settings.namespace
        self._lock = threading.Lock()
        self._measured = self._setpoint = math.nan
        self._heard = self._told = -math.inf
        self._tripped = self._stopped = self._ready = False
        self._ready_in = math.nan
        self._setpoints = node.create_publisher(Float64, f"{space}/setpoint", setpoint_qos())
        self._holds = node.create_publisher(JointTrajectory, f"{space}/joint_trajectory", setpoint_qos())
        source = f"{space}/{settings.source}"
        self._motor = {name: node.create_client(Trigger, f"{source}/{name}") for name in ("stop", "start")}
        node.create_subscription(JointState, f"{space}/joint_states", self._on_measurement, sensor_qos())
        node.create_subscription(JointState, f"{source}/state", self._on_state, 10)
        if settings.source == signals.SOURCE:
            node.create_subscription(Bool, f"{space}/ready", self._on_ready, latched_qos())
            node.create_subscription(Float64, f"{space}/ready_in", self._on_ready_in, latched_qos())

    def _on_measurement(self, message) -> None:
        joint = self._settings.joint
        position = math.nan
        if joint in message.name:
            index = list(message.name).index(joint)
            position = message.position[index] if index < len(message.position) else math.nan
        with self._lock:
            self._measured, self._heard = position, time.monotonic()
            self._tripped = message.header.frame_id == signals.TRIPPED_FRAME

    def _on_state(self, message) -> None:
        values = dict(zip(message.name, message.position, strict=False))
        with self._lock:
            self._setpoint, self._told = values.get("setpoint", math.nan), time.monotonic()

    def _on_ready(self, message) -> None:
        with self._lock:
            self._ready = message.data

    def _on_ready_in(self, message) -> None:
        with self._lock:
            self._ready_in = message.data

    def look(self, now: float) -> Seen:
        """Return the state of the axis at a time [s] of the monotonic clock."""
        # a setpoint published before the axis is discovered would be lost
        discovered = self._setpoints.get_subscription_count() > 0
        with self._lock:
            alarm = Alarm()
            if now - min(self._heard, self._told) > SILENCE or not discovered:
                alarm = SILENT
            elif self._tripped:
                alarm = STOPPED
            elif not math.isfinite(self._measured):
                alarm = UNMEASURED
            # a stopped motor keeps its setpoint without moving to it
            setpoint = self._measured if self._stopped else self._setpoint
            ready = self._ready and alarm == Alarm()
            return Seen(self._measured, setpoint, alarm, ready, self._ready_in)

    def move(self, setpoint: float) -> None:
        """Publish a setpoint [m]."""
        if self._stopped:
            self._motor["start"].call_async(Trigger.Request())
            self._stopped = False
        self._setpoints.publish(Float64(data=setpoint))

    def stop(self) -> None:
        """Stop any motion: at the next sample, or with the deceleration of the approach."""
        if self._settings.source == signals.MOTOR_SOURCE:
            self._motor["stop"].call_async(Trigger.Request())
            self._stopped = True
        else:
            self._holds.publish(JointTrajectory(joint_names=[self._settings.joint]))


def profile(axes: list[AxisParameters], context: Context, used_by: Callable[[Any], Profile]) -> Profile:
    """Return the topics and services that the server of motor records uses."""
    node = rclpy.create_node(RECORDS, context=context, start_parameter_services=False)
    try:
        for axis in axes:
            AxisLink(node, motor_settings(axis, RecordOptions("", "um", 4, 10.0)))
        return used_by(node)
    finally:
        node.destroy_node()
