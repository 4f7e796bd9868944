# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""For how long the output of a node was limited lately, and by what: what its diagnostics say first."""

from __future__ import annotations

import time
from collections import deque

from hysteresis_ros.analysis.limited import MOMENT

#: Seconds of the past of which a node speaks.
LATELY = 60.0
#: What the words of such a report begin with.
LIMITED = "output limited for"
#: What limits a voltage besides the way back to a path.
AMPLIFIER = "limits (range or slew rate)"


class LimitedTime:
    """Remembers how counters of limited samples stood at each report of the last minute."""

    def __init__(self) -> None:
        """Begin without a report."""
        self._counts: deque[tuple[float, dict[str, int]]] = deque()

    def report(self, counts: dict[str, int], sample_rate: float, now: float | None = None) -> str:
        """Return for how long of the last minute limits kept the output from what was asked, longest first.

        Parameters
        ----------
        counts : dict of str to int
            By what limits the samples so far were limited; counters that went back were reset, and count from 0.
        sample_rate : float
            [Hz]
        now : float, optional
            Time of the report [s], never going back; that of the machine by default.

        Returns
        -------
        str
            Empty: for no more than a moment.
        """
        now = time.monotonic() if now is None else now
        if self._counts and any(count < self._counts[-1][1].get(name, 0) for name, count in counts.items()):
            self._counts.clear()
        if not self._counts:
            self._counts.append((now, dict.fromkeys(counts, 0)))
        self._counts.append((now, dict(counts)))
        # the last report from before the minute is where the minute begins
        while len(self._counts) > 2 and now - self._counts[1][0] >= LATELY:
            self._counts.popleft()
        began, before = self._counts[0]
        seconds = {name: (count - before.get(name, 0)) / sample_rate for name, count in counts.items()}
        total = sum(seconds.values())
        if total <= MOMENT:
            return ""
        by = " and ".join(name for name, part in sorted(seconds.items(), key=lambda item: -item[1]) if part > 0.0)
        whole = f" of the last {now - began:.3g} s" if now - began >= total else ""
        return f"{LIMITED} {total:.3g} s{whole}, by {by}"
