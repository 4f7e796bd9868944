# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The inputs of nodes in a bag, played to new nodes, cause the same outputs as in the recording."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import REAL, SINE, InProcess, RecordedRun, axis_parameters, shortened, until  # noqa: E402

SAMPLES = 150
INPUTS, OUTPUTS = ("/joint_states", "/reference"), ("/command", "/applied", "/voltage")


def recorded(axis, path):
    """Record an axis; return the messages of each topic, and its offered quality of service by metadata.yaml."""
    from rosbags.rosbag2 import Reader

    from hysteresis_ros.nodes.domain import Domain

    with Domain() as domain:
        inside = InProcess(domain.number)
        run = RecordedRun(inside, axis, path)
        inside.spin()
        run.result()
        inside.close()
    with Reader(path) as reader:
        offered = {item.topic: item.ext.offered_qos_profiles for item in reader.connections}
        messages: dict[str, list[bytes]] = {topic: [] for topic in offered}
        for connection, _, data in reader.messages():
            messages[connection.topic].append(bytes(data))
    return messages, offered


def profile(offered):
    """Return the quality of service with which a player publishes a recorded topic."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    (found,) = offered
    return QoSProfile(
        history=HistoryPolicy[found.history.name],
        depth=found.depth,
        reliability=ReliabilityPolicy[found.reliability.name],
        durability=DurabilityPolicy[found.durability.name],
    )


def test_inputs_of_a_recording_drive_fresh_nodes_to_its_outputs(tmp_path, inside, observer):
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode

    overrides = {node: dict(values) for node, values in REAL.items()}
    overrides["reference_generator"] |= SINE
    axis = shortened(axis_parameters(overrides=overrides, time_mode="lockstep"), SAMPLES)
    messages, offered = recorded(axis, tmp_path / "bag")
    heard = {topic: observer.listen(Float64, topic, profile(offered[topic])) for topic in OUTPUTS}
    kinds = zip(INPUTS, (JointState, Float64), strict=True)
    players = [observer.talk(kind, topic, profile(offered[topic])) for topic, kind in kinds]
    controller = inside.add(MotionControllerNode, axis.motion_controller)
    compensator = inside.add(HysteresisCompensatorNode, axis.hysteresis_compensator)
    inside.spin()
    for k in range(SAMPLES):
        for player, topic in zip(players, INPUTS, strict=True):
            player.publish(messages[topic][k])
        until(lambda k=k: min(map(len, heard.values())) > k, what=f"the answers to sample {k}", every=0.001)
    assert not controller.failure and not compensator.failure
    for topic in OUTPUTS:
        wanted = [deserialize_message(data, Float64).data for data in messages[topic]]
        assert np.array([message.data for message in heard[topic]]).tobytes() == np.array(wanted).tobytes(), topic
    assert np.ptp(wanted) > 1.0
