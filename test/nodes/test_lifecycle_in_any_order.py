# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Transitions of the lifecycle and services in any order and number: impossible ones are refused."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from hypothesis import HealthCheck, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
from hypothesis.stateful import (  # noqa: E402
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,  # noqa: E402
)
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from nodes_support import InProcess, axis_parameters  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

#: Allowed transitions of each state, and their target states (design of the managed nodes of ROS 2).
ALLOWED = {
    "unconfigured": {Transition.TRANSITION_CONFIGURE: "inactive"},
    "inactive": {Transition.TRANSITION_ACTIVATE: "active", Transition.TRANSITION_CLEANUP: "unconfigured"},
    "active": {Transition.TRANSITION_DEACTIVATE: "inactive"},
}
NODES = ("plant_simulator", "motion_controller")


def classes():
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode
    from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode

    return dict(zip(NODES, (PlantSimulatorNode, MotionControllerNode), strict=True))


def in_any_order(inside):
    """Return a state machine for nodes in the process ``inside``."""

    class InAnyOrder(RuleBasedStateMachine):
        @initialize()
        def begin(self):
            axis = axis_parameters(time_mode="realtime", sample_rate=200.0)
            self.nodes = {n: inside.add(c, getattr(axis, n), autostart=False) for n, c in classes().items()}
            self.states = dict.fromkeys(NODES, "unconfigured")

        @rule(name=st.sampled_from(NODES), number=st.sampled_from((0, 1, 2, 3, 4, 8, 60, 255)))
        def transition(self, name, number):
            request, response = ChangeState.Request(), ChangeState.Response()
            request.transition.id = number
            # as the service calls it; the method of rclpy is private
            answer = self.nodes[name]._LifecycleNodeMixin__on_change_state(request, response)
            wanted = ALLOWED[self.states[name]].get(number)
            assert answer.success == (wanted is not None)
            self.states[name] = wanted or self.states[name]

        @rule(name=st.sampled_from(NODES), action=st.sampled_from(("start", "stop", "reset")))
        def service(self, name, action):
            answer = getattr(self.nodes[name], f"_on_{action}")(Trigger.Request(), Trigger.Response())
            assert answer.message

        @invariant()
        def each_is_where_it_was_sent(self):
            for name, node in getattr(self, "nodes", {}).items():
                assert node._state_machine.current_state[1] == self.states[name]
                assert node.active == (self.states[name] == "active")
                assert not node.failure

        def teardown(self):
            for node in getattr(self, "nodes", {}).values():
                node.active = False
                node.release()
                inside.executor.remove_node(node)
                inside.nodes.remove(node)
                node.destroy_node()

    return InAnyOrder


def test_transitions_and_services_in_any_order_are_answered_and_break_nothing(domain):
    inside = InProcess(domain)
    checks = [HealthCheck.too_slow]
    try:
        run_state_machine_as_test(
            in_any_order(inside),
            settings=settings(max_examples=6, stateful_step_count=25, deadline=None, suppress_health_check=checks),
        )
    finally:
        inside.close()
