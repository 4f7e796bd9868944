# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Partners that ROS does not connect because their qualities of service do not fit: who, on which topic, what to do."""

from __future__ import annotations

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from hysteresis_ros.nodes.discovery import named

#: Topics whose reliability a parameter chooses, and that parameter.
CHOSEN = {"joint_states": "measurement_reliability", "setpoint": "setpoint_reliability"}


def unheard(offered, asked, chosen_by: str) -> str:
    """Say why a subscription hears nothing of a publisher, and what to do; empty when it does.

    Parameters
    ----------
    offered, asked : QoSProfile
        Of the publisher and of the subscription.
    chosen_by : str
        Parameter that chooses the reliability of the subscription; empty where none does.
    """
    best_effort, reliable = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
    if offered.reliability == best_effort and asked.reliability == reliable:
        choice = f"set {chosen_by}: best_effort here, or " if chosen_by else ""
        return f"offers best effort, reliable is asked for: {choice}let the publisher be reliable"
    latched, volatile = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
    if offered.durability == volatile and asked.durability == latched:
        return "offers volatile, transient local is asked for: let the publisher be transient local"
    return ""


class Compatibility:
    """Watches the topics of a node for partners with which it is not connected.

    Parameters
    ----------
    node : AxisNode
    """

    def __init__(self, node):
        self._node = node
        self._suspected: dict[str, str] = {}

    def of_subscription(self, topic: str) -> SubscriptionEventCallbacks:
        """Return what hears of publishers that do not fit a subscription."""
        chosen_by = CHOSEN.get(topic, "")
        return SubscriptionEventCallbacks(incompatible_qos=lambda event: self._suspect(topic, chosen_by))

    def of_publisher(self, topic: str) -> PublisherEventCallbacks:
        """Return what hears of subscriptions that do not fit a publisher."""
        return PublisherEventCallbacks(incompatible_qos=lambda event: self._suspect(topic, ""))

    def _suspect(self, topic: str, chosen_by: str) -> None:
        self._suspected[topic] = chosen_by
        self.complaint()

    def complaint(self) -> str:
        """Say who is not connected now, log it now and then, and return it; empty when all are."""
        found = [text for topic in tuple(self._suspected) for text in self._look(topic)]
        for text in found:
            self._node.warn(f"qos {text}", text, every=10.0)
        return "; ".join(found)

    def _look(self, topic: str) -> list[str]:
        """Return what does not fit on a topic; one on which everybody has found each other is forgotten."""
        node, chosen_by = self._node, self._suspected[topic]
        full, own = node.resolve_topic_name(topic), node.get_fully_qualified_name()
        found = set()
        subscriptions = node.get_subscriptions_info_by_topic(full)
        for publisher in node.get_publishers_info_by_topic(full):
            for subscription in subscriptions:
                reason = unheard(publisher.qos_profile, subscription.qos_profile, chosen_by)
                talks, hears = named(publisher), named(subscription)
                if reason and hears == own:
                    found.add(f"{full}: nothing is heard from {talks}, which {reason}")
                elif reason and talks == own:
                    found.add(f"{full}: {hears} hears nothing of this node, which {reason}")
        if not found:
            del self._suspected[topic]
        return sorted(found)
