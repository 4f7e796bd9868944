# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Tell whether the commands of a controller are carried out, from what comes back as ``applied``."""

from __future__ import annotations

from collections import deque

#: A difference counts above this part of the largest command carried out so far: inverses are approximate.
FRACTION = 0.05
#: And above this [m]: before anything moved, rounding is no shortfall.
SMALLEST = 1e-9
#: Answers may be late by as many samples less one on a busy machine.
LATENESS = 20


class Shortfall:
    """Compares commands with what was carried out, and remembers the worst since the last report."""

    def __init__(self):
        self.count = 0
        self._sent = deque([0.0], maxlen=LATENESS)
        self._largest = 0.0
        self._worst = None

    def sent(self, command: float) -> None:
        """Note a command [m] that was sent."""
        self._sent.append(command)

    def carried_out(self, applied: float) -> None:
        """Compare what was carried out [m] with the nearest of the last commands: an answer may be late."""
        self._largest = max(self._largest, abs(applied))
        allowed = max(FRACTION * self._largest, SMALLEST)
        if abs(self._sent[-1] - applied) <= allowed:
            return  # as it is in nearly every sample
        wanted = min(self._sent, key=lambda command: abs(command - applied))
        difference = abs(wanted - applied)
        if difference <= allowed:
            return
        self.count += 1
        if self._worst is None or difference > abs(self._worst[0] - self._worst[1]):
            self._worst = (wanted, applied)

    def report(self) -> str:
        """Return a sentence about the worst since the last call, empty when all was carried out."""
        if self._worst is None:
            return ""
        (wanted, applied), self._worst = self._worst, None
        return f"command saturated: wanted {1e6 * wanted:.4g} µm, carried out {1e6 * applied:.4g} µm"
