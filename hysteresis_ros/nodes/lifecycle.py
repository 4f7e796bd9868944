# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Lifecycle nodes that start by themselves, and survive a transition that does not fit their state."""

from __future__ import annotations

from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from hysteresis_ros.nodes.services import GuardedServices


class GuardedLifecycleNode(GuardedServices, LifecycleNode):
    """A lifecycle node that refuses a transition its state does not have.

    rclpy up to 7.1.6 answers ``change_state`` with such an ``id`` by an exception in the executor, which ends the
    process with its outputs where they are (ros2/rclpy, issue 1209).
    """

    def __init__(self, name: str, **options):
        super().__init__(name, **options)
        self.guard_services()

    # The service calls the method by this name, Python's for a private one of the class that rclpy declares it in.
    def _LifecycleNodeMixin__on_change_state(self, request, response):
        wanted = request.transition
        allowed = {number: label for number, label, *_ in self._state_machine.available_transitions}
        if not wanted.label and wanted.id not in allowed:
            now = self._state_machine.current_state[1]
            names = ", ".join(f"{label} ({number})" for number, label in allowed.items())
            self.get_logger().warning(f"transition {wanted.id} refused: {now} now, which allows {names}")
            response.success = False
            return response
        return super()._LifecycleNodeMixin__on_change_state(request, response)

    @property
    def autostart(self) -> bool:
        """Whether the node configures and activates by itself."""
        return self.get_parameter("autostart").value is not False

    def configure_now(self) -> bool:
        """Configure; False when that failed."""
        return self.trigger_configure() == TransitionCallbackReturn.SUCCESS

    def activate_now(self) -> bool:
        """Activate; False when that failed."""
        return self.trigger_activate() == TransitionCallbackReturn.SUCCESS
