# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Topics, timers and warnings of a node of an axis: made and destroyed with its lifecycle."""

from __future__ import annotations

import time

from rclpy.duration import Duration

from hysteresis_ros.nodes.qos import loop_qos


class Endpoints:
    """What a node of an axis makes publishers, subscriptions and timers with."""

    def qos(self):
        """Quality of service of the topics between the nodes."""
        return loop_qos(self.runner.keeps, self.parameters.queue_depth)

    def changes_qos(self):
        """Quality of service of what people have changed: kept for a recorder that comes later."""
        return loop_qos(True, self.parameters.queue_depth)

    def publisher(self, message_type, topic: str, qos, loop: bool = False):
        """Make a publisher that goes with cleanup; ``loop``: lockstep needs its partner before the first answer."""
        made = self.create_publisher(message_type, topic, qos, event_callbacks=self.compatibility.of_publisher(topic))
        self._topic_handles.append((self.destroy_publisher, made))
        if loop:
            self._loop_publishers.append(made)
        return made

    def subscriber(self, message_type, topic: str, callback, qos, raw: bool = False, partner: str = ""):
        """Make a subscription that goes with cleanup; ``partner``: who publishes it in lockstep, and is watched."""
        events = self.compatibility.of_subscription(topic)
        made = self.create_subscription(message_type, topic, callback, qos, raw=raw, event_callbacks=events)
        self._topic_handles.append((self.destroy_subscription, made))
        if partner:
            self.partners.add(made.topic_name, partner)
        return made

    def loop_input(self, message_type, topic: str, callback, qos, partner: str):
        """Make a subscription of the loop: one publisher feeds it, in lockstep from the beginning to the end."""
        if self.runner.exact:
            return self.subscriber(message_type, topic, callback, qos, partner=partner)
        return self.masters.add(message_type, topic, callback, qos, self.compatibility.of_subscription(topic))

    @property
    def loop_topics(self) -> list[str]:
        """Full names of the topics of the loop that this node publishes."""
        return [publisher.topic_name for publisher in self._loop_publishers]

    def drop(self, subscription) -> None:
        """Destroy a subscription before cleanup does."""
        self._topic_handles.remove((self.destroy_subscription, subscription))
        self.destroy_subscription(subscription)

    def timer(self, period: float, callback):
        """Make a timer on the steady clock that goes with deactivation."""
        made = self.create_timer(period, callback, clock=self.steady)
        self._work_timers.append(made)
        return made

    def all_matched(self) -> bool:
        """Tell whether every publisher of the loop has a subscription."""
        return all(publisher.get_subscription_count() > 0 for publisher in self._loop_publishers)

    def publish_state(self, stamp, *values: float) -> None:
        """Publish ``~/state`` with the stamp of the measurement it belongs to; the message is reused."""
        message = self._state
        message.header.stamp = stamp
        position = message.position
        for index, value in enumerate(values):
            position[index] = value
        self._state_publisher.publish(message)

    def warn(self, key: str, text: str, every: float = 1.0, error: bool = False) -> None:
        """Log a warning (or error), at most one per ``key`` and ``every`` seconds."""
        now = self.steady.now().nanoseconds
        if now - self._warned.get(key, -(10**18)) >= every * 1e9:
            self._warned[key] = now
            # two lines, because rclpy ties a place in the source to one severity
            if error:
                self.get_logger().error(text)
            else:
                self.get_logger().warning(text)

    def wait_acknowledged(self, deadline: float) -> None:
        """Wait until all that was published has been received, at most until ``time.monotonic()`` is ``deadline``."""
        for _, handle in self._topic_handles:
            if hasattr(handle, "wait_for_all_acked"):
                handle.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))
