"""What the sources of references have in common: people ask them for something, and hear why they do not get it."""

from __future__ import annotations

from std_msgs.msg import String

from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.responder import Responder


class ReferenceSource(Responder):
    """A node that takes setpoints, and says on ``~/refused`` why it refuses one: a topic has no answer."""

    #: Number of refusals so far.
    refused = 0

    def connect(self) -> None:
        """Make the topics."""
        super().connect()
        self._refusals = self.publisher(String, "~/refused", setpoint_qos())

    def refuse(self, key: str, reason: str) -> None:
        """Count, log and publish that something was refused.

        Parameters
        ----------
        key : str
            What is logged at most once a second.
        reason : str
            A sentence.
        """
        self.refused += 1
        self.warn(key, reason)
        self._refusals.publish(String(data=reason))
