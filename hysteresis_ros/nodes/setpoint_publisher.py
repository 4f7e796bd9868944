# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Publish setpoints like ``ros2 topic pub``, for machines without the command ``ros2``."""

from __future__ import annotations

import argparse
import sys
import time

import rclpy
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from hysteresis_ros.configuration import normalised_namespace
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.parameters import GuardedServices
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.security.policy import OPERATOR, enclave_of

#: Time until publisher and subscription are matched on both sides [s]; volatile messages sent earlier are lost.
ACQUAINTANCE = 0.5


class SetpointPublisher(GuardedServices):
    """Publishes each setpoint at its time on the clock of the axis, that is, the stamp of ``joint_states``."""

    def __init__(self, schedule, **options):
        super().__init__("setpoint_publisher", **options)
        self.guard_services()
        self.schedule = list(schedule)
        self._first = None
        self._found: float | None = None
        self._matched = 0
        self._setpoint = self.create_publisher(Float64, "setpoint", setpoint_qos())
        if any(due > 0.0 for due, _ in self.schedule):
            self.create_subscription(JointState, "joint_states", self._on_sample, QoSProfile(depth=100))

    @property
    def heard(self) -> bool:
        """Whether all subscribers have been matched for some time, because the other side may match later."""
        matched, known = self._setpoint.get_subscription_count(), self.count_subscribers("setpoint")
        if matched == 0 or matched < known or matched != self._matched:
            # a recorder also subscribes, and may start before the generator
            self._matched, self._found = matched, None
        elif self._found is None:
            self._found = time.monotonic()
        return self._found is not None and time.monotonic() - self._found > ACQUAINTANCE

    def _on_sample(self, message) -> None:
        now = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        if self._first is None and self.heard:
            self._first = now
        if self._first is not None:
            self.publish_until(now - self._first)

    def publish_until(self, now: float) -> None:
        """Publish the setpoints due at ``now`` [s], if there is a subscriber."""
        while self.heard and self.schedule and self.schedule[0][0] <= now:
            self._setpoint.publish(Float64(data=self.schedule.pop(0)[1]))

    def flush(self) -> bool:
        """Wait until all setpoints are acknowledged."""
        return self._setpoint.wait_for_all_acked(Duration(seconds=5.0))


def main(arguments=None) -> int:
    """Publish the setpoints of the command line; return 0, or 1 if there was no subscriber within the time-out."""
    parser = argparse.ArgumentParser(prog="setpoint_publisher", description=__doc__)
    parser.add_argument("--setpoint", type=float, nargs="+", required=True, help="setpoints [m]")
    parser.add_argument("--at", type=float, nargs="+", default=[0.0], help="axis time of each setpoint [s]")
    parser.add_argument("--namespace", default="", help="namespace of the axis")
    parser.add_argument("--timeout", type=float, default=30.0, help="longest wait for a reference generator [s]")
    options = parser.parse_args(arguments)
    if len(options.at) != len(options.setpoint):
        parser.error(f"{len(options.setpoint)} setpoints but {len(options.at)} times: give as many times (--at)")
    stay_on_this_machine()
    namespace = normalised_namespace(options.namespace)
    arguments = ["--ros-args", "--enclave", enclave_of(namespace, OPERATOR)]
    rclpy.init(args=arguments + (["-r", f"__ns:={namespace}"] if namespace else []))
    node = SetpointPublisher(sorted(zip(options.at, options.setpoint, strict=True)))
    give_up = node.get_clock().now() + Duration(seconds=options.timeout)
    try:
        while node.schedule:
            rclpy.spin_once(node, timeout_sec=0.05)
            if node._first is None:
                node.publish_until(0.0)
                if node.get_clock().now() > give_up:
                    where = f"{node.get_namespace().rstrip('/')}/setpoint"
                    print(
                        f"{where} has no subscriber: is a reference_generator or inchworm_sequencer running?",
                        file=sys.stderr,
                    )
                    return 1
        node.flush()
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
