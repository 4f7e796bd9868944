# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

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
