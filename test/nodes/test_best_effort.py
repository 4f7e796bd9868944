# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Best-effort publishers, as of sensors: received if a parameter says so, otherwise named in diagnostics."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, until  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64, String  # noqa: E402

from hysteresis_ros.errors import ParameterError  # noqa: E402
from hysteresis_ros.nodes.base import (  # noqa: E402
    WARN,
    diagnostics,
    unheard,  # noqa: E402
)
from hysteresis_ros.nodes.domain import named  # noqa: E402
from hysteresis_ros.nodes.motion_controller import MotionControllerNode  # noqa: E402
from hysteresis_ros.nodes.qos import chosen_qos  # noqa: E402
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode  # noqa: E402

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def controller(inside, **more) -> MotionControllerNode:
    overrides = {"motion_controller": {"type": "open_loop", **more}}
    return inside.add(MotionControllerNode, axis_parameters(sample_rate=200.0, overrides=overrides).motion_controller)


def test_a_driver_that_publishes_best_effort_is_named_with_what_to_set_and_heard_with_it(inside, observer):
    deaf = controller(inside)
    driver = observer.talk(JointState, "/joint_states", BEST_EFFORT)
    inside.spin()
    said = (
        f"/joint_states: nothing is received from /{observer.node.get_name()}, which offers best effort, but "
        "reliable is requested: set measurement_reliability: best_effort here, or make the publisher reliable"
    )
    # the name of the publisher may be known later than its quality of service
    until(lambda: deaf.compatibility.complaint() == said, what="that the driver is not heard")
    status = diagnostics(deaf).status[0]
    assert status.level[0] >= WARN and "measurement_reliability" in status.message
    hears = controller(inside, measurement_reliability="best_effort")
    until(lambda: driver.get_subscription_count() == 1, what="who hears it")

    def heard() -> bool:
        driver.publish(JointState(name=["extender"], position=[1e-6]))
        return hears.pace.total > 2

    until(heard, what="measurements")
    assert not hears.compatibility.complaint() and not deaf.pace.total
    observer.node.destroy_publisher(driver)
    until(lambda: not deaf.compatibility.complaint(), what="that nobody is unheard any more")


def test_setpoints_that_are_published_best_effort_are_named_with_what_to_set_and_heard_with_it(inside, observer):
    axis = axis_parameters(sample_rate=200.0)
    deaf = inside.add(ReferenceGeneratorNode, axis.reference_generator)
    person = observer.talk(Float64, "/setpoint", BEST_EFFORT)
    inside.spin()
    until(lambda: "set setpoint_reliability: best_effort" in deaf.compatibility.complaint(), what="what to set")
    axis = axis_parameters(sample_rate=200.0, setpoint_reliability="best_effort")
    hears = inside.add(ReferenceGeneratorNode, axis.reference_generator)
    until(lambda: person.get_subscription_count() == 1, what="the node that hears it")

    def refused() -> bool:
        person.publish(Float64(data=math.nan))
        return bool(heard)

    heard = observer.listen(String, f"{hears.get_fully_qualified_name()}/refused")
    until(refused, what="the answer to a setpoint")


def test_in_lockstep_no_sample_may_be_lost():
    with pytest.raises(ParameterError, match="measurement_reliability.*lockstep"):
        axis_parameters(time_mode="lockstep", measurement_reliability="best_effort")
    assert axis_parameters(measurement_reliability="best_effort").recorder.measurement_reliability == "best_effort"


def test_who_has_not_told_a_name_is_no_node_of_that_name():
    assert named(SimpleNamespace(node_namespace="/", node_name="stage")) == "/stage"
    assert named(SimpleNamespace(node_namespace="/left", node_name="stage")) == "/left/stage"
    unknown = SimpleNamespace(node_namespace="_NODE_NAMESPACE_UNKNOWN_", node_name="_NODE_NAME_UNKNOWN_")
    assert named(unknown) == "a node without a known name"


def test_what_does_not_fit_and_what_to_do():
    assert unheard(RELIABLE, RELIABLE, "a") == unheard(RELIABLE, BEST_EFFORT, "a") == ""
    assert unheard(LATCHED, RELIABLE, "") == ""
    assert "set setpoint_reliability: best_effort" in unheard(BEST_EFFORT, RELIABLE, "setpoint_reliability")
    assert "set " not in unheard(BEST_EFFORT, RELIABLE, "")
    assert "transient local" in unheard(RELIABLE, LATCHED, "")
    assert chosen_qos(RELIABLE, "reliable") is RELIABLE
    chosen = chosen_qos(RELIABLE, "best_effort")
    assert chosen.reliability == ReliabilityPolicy.BEST_EFFORT and chosen.depth == 10
