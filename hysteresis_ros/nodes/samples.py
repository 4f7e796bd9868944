# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bulk data of the plant: all samples of a fused axis in blocks, and the frames of a plant with a camera.

The other topics of a fused axis contain only the last sample, at ``publish_rate``, and can miss a peak between two
messages. A block is a table with a row for each quantity and a column for each sample; the label of the first dimension
contains the names of the quantities.
"""

from __future__ import annotations

import time
from array import array
from typing import NamedTuple

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError

#: Name of the topic, relative to the name of the plant's node.
TOPIC = "samples"
#: Interval between two blocks [s]: 30 per second, the redraw rate of a page.
PERIOD = 1.0 / 30.0
#: Number of blocks queued for a slow subscriber, enough for two seconds.
DEPTH = 60
#: Maximum number of samples of a block, above the ring size of the fastest axis.
MOST = 1_000_000
#: Rows before the signals: stamp [s and ns since 1970], and number of the sample.
STAMPED = ("stamp_s", "stamp_ns", "sample")
#: Quantities in ``joint_states`` for each joint of a motor.
OF_JOINTS = ("position", "velocity", "effort")

SECOND = 1_000_000_000


class Block(NamedTuple):
    """Consecutive samples."""

    stamps: np.ndarray  #: shape (N,) [ns since 1970], int64.
    numbers: np.ndarray  #: shape (N,); Numbers of the samples, int64.
    table: np.ndarray  #: shape (signals, N); A row for each signal (:class:`hysteresis_ros.signals.AxisKind`).
    #: shape (3 × joints, N); For a motor: positions [m], velocities [m/s] and efforts [N] of its joints.
    joints: np.ndarray | None


def samples_qos() -> QoSProfile:
    """Quality of service of the blocks: reliable, volatile, a queue of two seconds."""
    return QoSProfile(depth=DEPTH)


def labels(kind: signals.AxisKind, joints) -> tuple[str, ...]:
    """Return the names of the rows of a block."""
    row = tuple(signal.name for signal in kind.row)
    return (*STAMPED, *row, *(f"{what} {name}" for what in OF_JOINTS for name in (joints if kind.motor else ())))


def message_of(names: tuple[str, ...], block: Block) -> Float64MultiArray:
    """Return the message of a block."""
    stamped = np.vstack([block.stamps // SECOND, block.stamps % SECOND, block.numbers]).astype(float)
    parts = [stamped, block.table] if block.joints is None else [stamped, block.table, block.joints]
    table = np.ascontiguousarray(np.vstack(parts))
    rows, count = table.shape
    layout = MultiArrayLayout(
        dim=[
            MultiArrayDimension(label=",".join(names), size=rows, stride=rows * count),
            MultiArrayDimension(label="samples", size=count, stride=count),
        ]
    )
    return Float64MultiArray(layout=layout, data=array("d", table.tobytes()))


def block_of(message: Float64MultiArray) -> Block:
    """Return the block of a message."""
    names = tuple(message.layout.dim[0].label.split(",")) if message.layout.dim else ()
    kind = signals.INCHWORM if len(names) > len(STAMPED) + len(signals.ACTUATOR.row) else signals.ACTUATOR
    row = len(kind.row)
    begin = len(STAMPED)
    count = len(message.data) // max(len(names), 1)
    if names[: begin + row] != labels(kind, ())[: begin + row] or count * len(names) != len(message.data):
        raise HysteresisError("samples: the rows are from another version; use the same version for page and axis")
    table = np.frombuffer(message.data, float).reshape(len(names), count)
    if count > MOST or not np.isfinite(table[:begin]).all():
        raise HysteresisError(f"samples: a block must have at most {MOST} samples with finite times and numbers")
    stamps = table[0].astype(np.int64) * SECOND + table[1].astype(np.int64)
    joints = table[begin + row :] if kind.motor else None
    return Block(stamps, table[2].astype(np.int64), table[begin : begin + row], joints)


class SampleStream:
    """Publishes the samples of a fused loop while there is a subscriber."""

    def __init__(self, plant):
        self._plant = plant
        self._publisher = plant.publisher(Float64MultiArray, f"~/{TOPIC}", samples_qos())
        self._loop = self._reader = None
        self._last = 0.0

    def show(self, fused, ended: bool) -> None:
        """Publish new samples of an axis when a block is due."""
        if not self._publisher.get_subscription_count():
            self._reader = None
            return
        if self._reader is None or fused.loop is not self._loop:
            self._loop, self._reader = fused.loop, fused.reader()
        now = time.monotonic()
        if now - self._last < PERIOD and not ended:
            return
        self._last, taken = now, self._reader.take()
        numbers = np.arange(taken.first, taken.first + taken.table.shape[1])
        if numbers.size:
            block = Block(self._plant.stamps.of_all(numbers), numbers, taken.table, taken.joints)
            self._publisher.publish(message_of(labels(self._plant.axis_kind, self._plant.joint_names), block))


#: Topic of the frames.
FRAMES = "image"


def camera_qos() -> QoSProfile:
    """Quality of service of frames in real time: best effort, which matches any camera, and only the last frame."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


class FramePublisher:
    """Publishes the frames of a plant with the header of its joint_states."""

    def __init__(self, node):
        self._node = node
        self._publisher = node.publisher(Image, FRAMES, node.qos(), loop=True)
        self._message = Image(encoding="mono8", is_bigendian=0)

    def publish(self, joint_states) -> None:
        """Publish the frame of the present sample."""
        frame, message = self._node.part.eye.frame, self._message
        message.header = joint_states.header
        message.height, message.width = frame.shape
        message.step = message.width
        message.data = array("B", frame.tobytes())
        self._publisher.publish(message)

    def get_subscription_count(self) -> int:
        """Return the number of subscribers of the measurement made from the frames; 0 if no node reads them."""
        node = self._node
        seen = self._publisher.get_subscription_count()
        return node.count_subscribers(node.resolve_topic_name("joint_states")) if seen else 0


def output_of(node):
    """Return the publisher of a plant's samples, which are joint_states or frames."""
    return FramePublisher(node) if node.is_seen else node.publisher(JointState, "joint_states", node.qos(), loop=True)
