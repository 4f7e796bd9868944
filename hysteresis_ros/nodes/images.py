# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Frames as ``sensor_msgs/Image``: what a plant that is seen by a camera publishes in the place of joint_states."""

from __future__ import annotations

from array import array

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, JointState

#: Topic of the frames.
TOPIC = "image"


def camera_qos() -> QoSProfile:
    """Quality of service for frames in real time: of any camera, and only the last one."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


class FramePublisher:
    """Publishes the frames of a plant with the header of what it would say itself.

    Parameters
    ----------
    node : PlantSimulatorNode
        Its part has an eye.
    """

    def __init__(self, node):
        self._node = node
        self._publisher = node.publisher(Image, TOPIC, node.qos(), loop=True)
        self._message = Image(encoding="mono8", is_bigendian=0)

    def publish(self, joint_states) -> None:
        """Publish the frame of the present sample.

        Parameters
        ----------
        joint_states : JointState
            Its header is that of the frame.
        """
        frame, message = self._node.part.eye.frame, self._message
        message.header = joint_states.header
        message.height, message.width = frame.shape
        message.step = message.width
        message.data = array("B", frame.tobytes())
        self._publisher.publish(message)

    def get_subscription_count(self) -> int:
        """Return how many hear what somebody makes of the frames; 0 while nobody looks at them."""
        node = self._node
        seen = self._publisher.get_subscription_count()
        return node.count_subscribers(node.resolve_topic_name("joint_states")) if seen else 0


def output_of(node):
    """Return what publishes the samples of a plant: its joint_states, or its frames.

    Parameters
    ----------
    node : PlantSimulatorNode
    """
    return FramePublisher(node) if node.is_seen else node.publisher(JointState, "joint_states", node.qos(), loop=True)
