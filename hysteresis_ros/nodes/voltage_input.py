# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The voltages of a plant, as they come over their topics."""

from __future__ import annotations

import math

from hysteresis_ros import signals

#: Voltages of an axis, and who publishes them; an actuator has the first only.
VOLTAGES = (
    ("voltage", signals.VOLTAGE, "hysteresis_compensator"),
    ("front_clamp/voltage", signals.FRONT_VOLTAGE, "inchworm_sequencer"),
    ("rear_clamp/voltage", signals.REAR_VOLTAGE, "inchworm_sequencer"),
)


class VoltageInput:
    """One voltage of the plant, as it comes over its topic.

    Parameters
    ----------
    topic : str
    signal : int
        Place in the row.
    partner : str
        Who publishes it.
    """

    def __init__(self, topic: str, signal: int, partner: str):
        self.topic, self.signal, self.partner = topic, signal, partner
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self.value = math.nan
        self.received = 0.0
        #: Voltages so far, and when the first of them came [s].
        self.count, self.first = 0, 0.0
        self.full_name = self.topic
