# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""All types of controllers one after the other in a running motion_controller, over DDS."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, compose, until  # noqa: E402

STEP = 2.05e-6
DEPTH = 40000
TYPES = ("sliding_mode", "integral_sliding_mode", "super_twisting", "pid", "super_twisting", "open_loop")


def test_types_change_live_without_a_jump_and_an_impossible_one_changes_nothing(inside, observer):
    """With noise every command differs from the last one, except where a hand-over begins."""
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    overrides = {
        "plant_simulator": {"sensor__noise": 1e-9},
        "hysteresis_compensator": {"hysteresis__polynomial__scale": 1.05},
        "reference_generator": {"initial_setpoint": STEP},
        "motion_controller": {
            "type": "pid",
            "pid__Ki": 20.0,
            "kalman__gain": "riccati",
            "kalman__q": 0.685,
            "kalman__disturbance": "constant",
            "kalman__q_disturbance": 0.01,
            "super_twisting__gains": "given",
            "super_twisting__k1": 0.1,
            "super_twisting__k2": 0.1,
        },
    }
    axis = axis_parameters(overrides=overrides, time_mode="lockstep", queue_depth=DEPTH)
    plant, _, controller, _ = compose(inside, axis)
    heard = observer.listen(JointState, "/motion_controller/state", QoSProfile(depth=DEPTH))
    states = observer.listen(JointState, "/plant_simulator/state", QoSProfile(depth=DEPTH))
    until(lambda: plant.count_subscribers("/plant_simulator/state"))
    until(lambda: controller.count_subscribers("/motion_controller/state"))
    inside.spin()
    until(lambda: controller.sample > 900, what="the axis at rest")
    for kind in TYPES:
        success, reason = observer.set_parameters("/motion_controller", type=kind)
        assert success, reason
        assert controller.controller_type == kind
        running = controller.controller
        success, reason = observer.set_parameters(
            "/motion_controller", type="super_twisting", super_twisting__k1=0.0, handover_time=1.0
        )
        assert not success and "super_twisting.k1" in reason and "above 0" in reason
        assert controller.controller is running and controller.controller_type == kind
        assert controller.get_parameter("type").value == kind
        assert controller.part.handover.parameters.time == 0.05
        since = controller.sample
        until(lambda since=since: controller.sample > since + 300, what=f"the axis under {kind}")
    assert observer.trigger("/plant_simulator/stop").success
    until(lambda: len(heard) == controller.sample and len(states) >= len(heard), what="all that was published")
    assert not any(node.failure for node in inside.nodes)
    command = np.array([message.position[3] for message in heard])
    displacement = np.array([message.position[0] for message in states])
    begun = np.flatnonzero(np.diff(command[700:]) == 0.0) + 701
    assert len(begun) == len(TYPES)
    for first in begun:
        assert abs(command[first + 1] - command[first]) < 0.01 * STEP
    level = displacement[850 : begun[-1]]  # the last type is open loop, whose level has the error of the mismatch
    assert np.max(np.abs(level - STEP)) < 0.03e-6
    assert abs(displacement[-1] - STEP) > 0.05e-6
