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
        self.full_name = self.topic
