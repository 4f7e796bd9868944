"""A voltage that the plant holds from one message to the next, and in real time watches."""

from __future__ import annotations

import math
import time


class HeldVoltage:
    """One input of the plant.

    Parameters
    ----------
    topic : str
        Name of its topic, for messages.
    partner : str
        Who publishes it.
    """

    def __init__(self, topic: str, partner: str):
        self.topic, self.partner = topic, partner
        self.reset(0.0)

    def reset(self, voltage: float) -> None:
        """Begin anew with a voltage [V] that nobody has published."""
        self.value = self.held = voltage
        self.count = 0
        self.received = 0.0
        self.silent = False
        self.there = False
        self._following = True
        self._count_before = 0

    def take(self, voltage: float) -> bool:
        """Take what was published [V]; False, and the last one is kept, when it is not finite."""
        if not math.isfinite(voltage):
            return False
        self.value = voltage
        self.count += 1
        self.received = time.monotonic()
        return True

    def late(self) -> bool:
        """Tell whether no voltage came since this was asked before."""
        before, self._count_before = self._count_before, self.count
        return self.count > 0 and self.count == before

    def stopped(self, timeout: float) -> bool:
        """Tell whether a voltage that came before has not come for longer than ``timeout`` [s]."""
        return self.count > 0 and time.monotonic() - self.received > timeout

    def follow(self, silent: bool, safe: float, step: float) -> float:
        """Return the voltage to hold [V].

        It is the last one received; while ``silent`` the voltage goes to ``safe`` in steps of at most ``step``, and
        afterwards back in the same way.
        """
        if silent:
            self._following = False
        self.silent = silent
        if self._following:
            self.held = self.value
            return self.held
        target = safe if silent else self.value
        self.held += min(max(target - self.held, -step), step)
        self._following = not silent and self.held == target
        return self.held
