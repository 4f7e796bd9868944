# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sample timing of a node and its statistics: rate, jitter, overruns, time in limitation.

It imports no ROS. ``Runner`` is the base of the time modes (lockstep, real time, fused).
"""

from __future__ import annotations

import time
from array import array
from collections import deque

from hysteresis_ros.analysis.metrics import MOMENT

#: An interval is an overrun if it is longer than this many periods.
OVERRUN = 1.5

#: Least time without a measurement after which the input is stale [s]; longer at low sample rates.
STALE = 1.0

#: Report of nodes while their loop is being compiled, when they answer no request.
COMPILING_TEXT = (
    "compiling the loop, which takes 10 to 60 s once, longer on a busy machine; until then the nodes do not answer; "
    "the next start loads it from the cache"
)

#: Interval for counting a rate [s], long enough for messages that a busy machine delivers together.
WINDOW = 1.0


class CountedRate:
    """Sample rate, counted over at least the last second."""

    def __init__(self):
        self._marks: deque[tuple[float, int]] = deque()
        self._rate = 0.0

    def restart(self) -> None:
        """Reset the count, because a pause must not affect the rate."""
        self._marks.clear()
        self._rate = 0.0

    def begin(self, now: float, total: int) -> None:
        """Start counting at this time [s] and number of samples, unless the count is running."""
        if not self._marks:
            self._marks.append((now, total))

    def read(self, now: float, total: int) -> float:
        """Return the present rate [Hz]; 0 in the first second, when it is not known yet."""
        self.begin(now, total)
        while len(self._marks) > 1 and now - self._marks[1][0] >= WINDOW:
            self._marks.popleft()
        then, before = self._marks[0]
        if now - then >= WINDOW:
            self._rate = max(total - before, 0) / (now - then)
        self._marks.append((now, total))
        return self._rate


class Pace:
    """Statistics of the arrival times of samples between two readings, in bounded memory."""

    def __init__(self, period: float = float("inf"), keeps_time: bool = True, capacity: int = 20000):
        self._intervals = array("d", bytes(8 * capacity))
        self._count = 0
        self._last = 0
        self._limit = OVERRUN * period
        self._keeps_time = keeps_time
        self.total = 0
        self.overruns = 0
        self._rate = CountedRate()

    def tick(self) -> None:
        """Record one sample at the present time."""
        now = time.monotonic_ns()
        self.total += 1
        if self._last:
            interval = (now - self._last) * 1e-9
            if self._keeps_time and interval > self._limit:
                self.overruns += 1
            if self._count < len(self._intervals):
                self._intervals[self._count] = interval
                self._count += 1
        else:
            self._rate.begin(1e-9 * now, self.total)
        self._last = now

    @property
    def age(self) -> float:
        """Time since the last sample [s]; infinite before the first."""
        return (time.monotonic_ns() - self._last) * 1e-9 if self._last else float("inf")

    def restart(self) -> None:
        """Discard the last sample, so that a pause does not count as an interval."""
        self._last = 0
        self._rate.restart()

    def read(self) -> tuple[float, float]:
        """Return the rate [Hz] of the last second, and the 99th percentile of the jitter [s] since the last reading.

        Jitter is the deviation from the median interval.
        """
        rate = self._rate.read(1e-9 * time.monotonic_ns(), self.total)
        intervals = sorted(self._intervals[: self._count])
        self._count = 0
        if not intervals:
            return rate, 0.0
        median = intervals[len(intervals) // 2]
        if not self._keeps_time:
            self.overruns += sum(interval > max(self._limit, OVERRUN * median) for interval in intervals)
        deviations = sorted(abs(value - median) for value in intervals)
        return rate, deviations[int(0.99 * (len(deviations) - 1))]


class Pairing:
    """Matches answers to measurements in real time; answers and measurements arrive on different topics in any order.

    Every measurement is answered once, so the n-th answer belongs to the n-th measurement; the first of the two to
    arrive waits for the other. An answer precedes its measurement only by chance and only by a short time; a
    measurement may wait as long as a busy machine takes to answer. Two rules prevent a loss from shifting all later
    pairs. First, an entry that waits too long is discarded, for instance the command of a watchdog, which answers no
    measurement. Second, if several measurements wait at many consecutive answers, the oldest was rejected and never
    answered, so it is dropped. An answer that waits at many consecutive measurements is dropped as well, because
    answers follow their measurements.
    """

    #: Maximum number of waiting answers and of waiting measurements, and their maximum ages [s].
    ANSWERS, ANSWER_PATIENCE = 2, 0.05
    MEASUREMENTS, MEASUREMENT_PATIENCE = 256, 1.0
    #: If several measurements wait at more than this number of consecutive answers, the oldest measurement is dropped.
    SUSPICION = 50

    def __init__(self):
        self._measurements: deque = deque(maxlen=self.MEASUREMENTS)
        self._answers: deque = deque(maxlen=self.ANSWERS)
        self._crowded = 0
        self._ahead = 0

    def begin(self) -> None:
        """Assign the next answer to the last measurement, because earlier ones arrived while no node answered."""
        self._answers.clear()
        while len(self._measurements) > 1:
            self._measurements.popleft()

    def measurement(self, stamp, now: float):
        """Take a measurement and return its answer; if that has not arrived, store the measurement and return None."""
        self._ahead = self._ahead + 1 if self._answers else 0
        if self._ahead > self.SUSPICION:
            self._answers.popleft()
            self._ahead = 0
        return self._meet(stamp, now, self._measurements, self._answers, self.ANSWER_PATIENCE)

    def answer(self, answer, now: float):
        """Assign an answer to its measurement and return the stamp of the measurement; None: the answer waits."""
        self._crowded = self._crowded + 1 if len(self._measurements) > 1 else 0
        if self._crowded > self.SUSPICION:
            self._measurements.popleft()
            self._crowded = 0
        return self._meet(answer, now, self._answers, self._measurements, self.MEASUREMENT_PATIENCE)

    @staticmethod
    def _meet(item, now, own, other, patience):
        while other and now - other[0][0] > patience:
            other.popleft()
        if other:
            return other.popleft()[1]
        own.append((now, item))
        return None


#: Length of the reported interval [s].
LATELY = 60.0
#: Beginning of the text that reports how long the output was limited.
LIMITED = "output limited for"
#: Name in reports for the limits of the voltage, in contrast to the slew rate of a return from the safe voltage.
AMPLIFIER = "limits (range or slew rate)"


class LimitedTime:
    """Counters of limited samples, stored at each report of the last minute."""

    def __init__(self) -> None:
        """Begin without stored counters."""
        self._counts: deque[tuple[float, dict[str, int]]] = deque()

    def report(self, counts: dict[str, int], sample_rate: float, now: float | None = None) -> str:
        """Return how long limits restricted the output in the last minute, and the causes, the longest first.

        ``sample_rate`` is in Hz, ``now`` in s.
        """
        now = time.monotonic() if now is None else now
        if self._counts and any(count < self._counts[-1][1].get(name, 0) for name, count in counts.items()):
            self._counts.clear()
        if not self._counts:
            self._counts.append((now, dict.fromkeys(counts, 0)))
        self._counts.append((now, dict(counts)))
        # the reported interval begins at the last report that is at least a minute old
        while len(self._counts) > 2 and now - self._counts[1][0] >= LATELY:
            self._counts.popleft()
        began, before = self._counts[0]
        lately = {name: count - before.get(name, 0) for name, count in counts.items()}
        total = sum(lately.values()) / sample_rate
        if total <= MOMENT:
            return ""
        by = _causes(lately)
        whole = f" of the last {now - began:.3g} s" if now - began >= total else ""
        return f"{LIMITED} {total:.3g} s{whole}, by {by}"


def limited_in_all(counts: dict[str, int], samples: int, sample_rate: float) -> str:
    """Return how long limits kept the output from its requested value in a run; empty if only for a moment.

    Units: ``sample_rate`` [Hz].
    """
    limited = sum(counts.values())
    if limited <= MOMENT * sample_rate:
        return ""
    whole = f"{LIMITED} {limited / sample_rate:.3g} s of {samples / sample_rate:.3g} s, by {_causes(counts)}"
    return f"{whole}: during this time the actuator did not receive the requested output"


def _causes(counts: dict[str, int]) -> str:
    """Return the limits that acted on the output, the most frequent first."""
    return " and ".join(name for name, count in sorted(counts.items(), key=lambda item: -item[1]) if count > 0)


class Runner:
    """Base of the runners, which decide when a node processes its samples."""

    #: Sample time for the statistics of the sample times [s].
    period = float("inf")
    #: Whether the node computes its part of a sample when messages arrive.
    by_message = True
    #: Inputs of the node that have stopped, by topic.
    absent: tuple[str, ...] = ()
    #: Lost partner because of which this node keeps its part safe until the user resumes it; empty: no loss.
    latched = ""
    #: Whether the plant has announced that the axis resumes, but no measurement has confirmed this yet.
    goes_on = False

    def __init__(self, node):
        self.node = node

    def require_rest(self) -> None:
        """Raise an error if the node cannot be reset now."""

    def make_pace(self) -> Pace:
        """Return the statistics of the sample times."""
        return Pace(self.period)

    def missing_partners(self) -> str:
        """Return the lost nodes without which the axis cannot continue; empty if all are present."""
        return ""

    def follow_trip(self, tripped: bool) -> None:
        """Record whether the plant has stopped the axis."""

    def unlatch(self) -> str:
        """Resume the part after the loss of a partner; return why it cannot resume, or an empty text if it can."""
        return ""

    def timeliness(self) -> dict:
        """Return the diagnostics of the lateness of samples, if known."""
        return {}

    def go_safe(self) -> None:
        """Move the outputs of the node to their safe values."""
        self.node.go_safe()
