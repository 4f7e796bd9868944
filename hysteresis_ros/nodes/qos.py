# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Quality of service of every topic of an axis; ``docs/topics.md`` states the same for users."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


def loop_qos(keeps: bool, depth: int) -> QoSProfile:
    """Topics between the nodes of an axis.

    In lockstep (``keeps``) a publisher keeps the last ``depth`` messages for subscriptions that match later (transient
    local), because on volatile topics sample 0 could be lost, and the loop would wait forever. In real time old samples
    are useless.
    """
    return _reliable(depth, DurabilityPolicy.TRANSIENT_LOCAL if keeps else DurabilityPolicy.VOLATILE)


def setpoint_qos() -> QoSProfile:
    """Setpoints from the user: reliable and volatile, so that a default ``ros2 topic pub`` matches."""
    return _reliable(10, DurabilityPolicy.VOLATILE)


def chosen_qos(qos: QoSProfile, reliability: str) -> QoSProfile:
    """An external input: ``qos``, or best effort if that is the chosen ``reliability``."""
    if reliability == "best_effort":
        qos = QoSProfile(depth=qos.depth, reliability=ReliabilityPolicy.BEST_EFFORT, durability=qos.durability)
    return qos


def sensor_qos() -> QoSProfile:
    """Measurements for monitoring: matches any driver, reliable or not."""
    return QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


def latched_qos(depth: int = 1) -> QoSProfile:
    """Latched messages for late subscribers: the end of a run, the configuration of a recording."""
    return _reliable(depth, DurabilityPolicy.TRANSIENT_LOCAL)


def diagnostics_qos(keeps: bool = False) -> QoSProfile:
    """Subscription to ``/diagnostics`` as in ROS tools; with ``keeps`` it also gets the last report of each node."""
    return _reliable(10, DurabilityPolicy.TRANSIENT_LOCAL if keeps else DurabilityPolicy.VOLATILE)
