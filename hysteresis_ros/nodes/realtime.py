# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Real time: the plant or a driver keeps the time, everybody else answers its measurements as they come.

Within a sample the order is that of lockstep: a measurement is answered when the other inputs of its sample are there.
Float64 messages carry no number, so they belong to measurements by count. What has not come when the next measurement
does is late: the sample is answered without it, and its message, when it comes, is not taken for the next one's. Who is
late again and again is not waited for until he is back.
"""

from __future__ import annotations

import math
import time
from collections import deque

from std_msgs.msg import String

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.runner import Runner
from hysteresis_ros.nodes.timing import Pace, Pairing

#: Seconds between two looks at an input that may have stopped.
WATCHDOG_PERIOD = 0.01

#: What nodes say about themselves: at work, or not any more.
HERE, GONE = "here", "gone"

#: Samples in a row that an input may miss before nobody waits for it.
GIVE_UP = 3

#: Measurements in a row that may find a message waiting before its first one is dropped as being too many.
SUSPICION = 50

#: Measurements that may wait; of more the oldest are answered.
BACKLOG = 2

#: Looks at the inputs that may fail to happen before the process itself was stopped or starved.
SUSPENDED = 10

#: What comes within this part of a period of the last one has waited.
WAITED = 0.5

#: Most samples that are counted in one look at an input that has stopped.
MOST_MISSED = 20000


class Follower:
    """One Float64 input in real time: its messages wait for their measurements.

    Parameters
    ----------
    strict : bool
        Whether a message that does not come in time leaves nothing in its place; otherwise the last one serves.
    """

    def __init__(self, strict: bool):
        self.strict = strict
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self.waiting: deque = deque(maxlen=2)
        self.last = math.nan
        self.present = False
        self._owed = 0
        self._missed = 0
        self._ahead = 0

    def take(self, data: float) -> None:
        """Note a message."""
        self.last = data
        if not self.present:
            # whichever measurement it belongs to has been answered; the next one is waited for
            self.present, self._owed, self._missed = True, 0, 0
            self.waiting.clear()
        elif self._owed:
            self._owed -= 1
        else:
            self.waiting.append(data)

    def expect(self) -> None:
        """A measurement has come."""
        self._ahead = self._ahead + 1 if self.waiting else 0
        if self._ahead > SUSPICION:
            self.waiting.popleft()
            self._ahead = 0

    @property
    def ready(self) -> bool:
        """Whether the oldest measurement need not wait for it."""
        return bool(self.waiting) or not self.present

    def give(self) -> float:
        """Return what belongs to the oldest measurement, as far as it is there."""
        if self.waiting:
            self._missed = 0
            return self.waiting.popleft()
        if self.present:
            self._owed += 1
            self._missed += 1
            if self._missed > GIVE_UP:
                self.present, self._owed = False, 0
        return math.nan if self.strict else self.last


class RealTime(Runner):
    """What a node does about time: nothing is exact, inputs may stop, and samples go by without them.

    Parameters
    ----------
    node : AxisNode
    """

    exact = False
    keeps = False
    paused = False

    def __init__(self, node):
        super().__init__(node)
        self.clear()

    @property
    def period(self) -> float:
        """Seconds of the wall clock between two samples."""
        parameters = self.node.parameters
        return 1.0 / (parameters.sample_rate * getattr(parameters, "real_time_factor", 1.0))

    is_live = False

    def require_rest(self) -> None:
        """Refuse that one part begins again amid an axis in motion: that would be a step of its output."""
        node = self.node
        if node.active and not node.rests and self.is_live:
            raise HysteresisError(
                f"refused: the axis is live, and {node.kind} alone would make it jump; call ~/stop and wait until it "
                "is safe, deactivate it, or reset the plant"
            )

    def make_pace(self) -> Pace:
        """Return what tells how regularly samples come; only the plant knows how fast that is to be."""
        return Pace(self.period, keeps_time=hasattr(self.node.parameters, "real_time_factor"))

    def connect(self) -> None:
        """Make the topic on which nodes say that they come and go."""
        self._presence = self.node.publisher(String, "run_state", latched_qos())

    def begin(self) -> None:
        """Say that this node is at work."""
        self._presence.publish(String(data=f"{HERE} {self.node.kind}"))

    def begin_again(self) -> None:
        """Say so after a reset: what was under way at it will not be answered."""
        if self.node.active:
            RealTime.begin(self)

    def part(self) -> None:
        """Say that this node stops working: what it does not send any more is not late."""
        self._presence.publish(String(data=f"{GONE} {self.node.kind}"))

    def end(self) -> None:
        """What was learned stays."""

    def clear(self) -> None:
        """Begin anew with the next measurement."""
        self.node.sample = 0
        self.node.end_of_run = -1
        self.node.finished = False

    def advance(self) -> None:
        """Nothing waits for anybody."""

    def say(self, state: str) -> None:
        """Nobody listens."""

    def announce(self, failure: str) -> None:
        """Everybody goes on without this node, as long as their time-outs let them."""

    def matched(self) -> bool:
        """Tell whether every publisher of the loop has found its partner."""
        return self.node.all_matched()

    def is_old_end(self, count: int) -> bool:
        """An end mark is always that of this run."""
        return False


class RealTimeResponder(RealTime):
    """Answers measurements as they come, with what belongs to them.

    Parameters
    ----------
    node : Responder
    """

    def clear(self) -> None:
        """Begin anew with the next measurement."""
        super().clear()
        self._forget()
        self._pairing = Pairing()
        self._last_stamp = -1
        self._counted = self._last = self._looked = self._heard = time.monotonic()
        self._backlog = 0
        self.silent = False

    def _forget(self) -> None:
        """Wait for nothing that belongs to an earlier measurement."""
        self._followers = [Follower(input_.strict) for input_ in self.node.inputs]
        self._pending: deque = deque()

    def begin(self) -> None:
        """Look after measurements that stop."""
        super().begin()
        self._forget()
        self._counted = self._last = self._looked = time.monotonic()
        self.node.timer(WATCHDOG_PERIOD, self.watch)

    @property
    def is_live(self) -> bool:
        """Whether what triggers answers has come within its time-out."""
        return self.age <= self.node.patience

    @property
    def absent(self) -> tuple[str, ...]:
        """Inputs for which nobody waits any more, by topic."""
        inputs = zip(self.node.inputs, self._followers, strict=True)
        return tuple(
            input_.topic
            for input_, follower in inputs
            if not (input_.previous or follower.present or math.isnan(follower.last))
        )

    @property
    def age(self) -> float:
        """Seconds since the last trigger; infinite before the first."""
        return time.monotonic() - self._last if self.node.sample else math.inf

    def _stood_still(self, now: float) -> bool:
        """Tell whether nobody has looked at the inputs for longer than a measurement may be old."""
        return now - self._looked > max(self.node.patience, SUSPENDED * WATCHDOG_PERIOD) + WATCHDOG_PERIOD

    def _has_waited(self) -> bool:
        """Tell whether what comes now is too old to be answered: this process stood still, and it waited meanwhile."""
        now = time.monotonic()
        before, self._heard = self._heard, now
        if self._stood_still(now):
            self._looked = now
            self._backlog = self.node.parameters.queue_depth
            return True
        self._backlog = self._backlog - 1 if now - before < WAITED * self.period else 0
        return self._backlog > 0

    def measurement(self, message) -> None:
        """Take ``joint_states``."""
        node = self.node
        if not node.active or (node.triggered_by_measurement and self._has_waited()):
            return
        if not node.triggered_by_measurement:
            self._lend(message)
            return
        node.pace.tick()
        reading = list(node.row)
        if not node.read(message, reading):
            return
        stamp = message.header.stamp
        nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec
        if nanoseconds <= self._last_stamp and not node.is_stale:
            text = f"measurement rejected: stamp {nanoseconds} ns does not follow {self._last_stamp} ns"
            node.warn("stamp", text)
            node.reject(reading)
        else:
            self._last_stamp = nanoseconds
        self._arrived()
        for follower in self._followers:
            follower.expect()
        self._pending.append((stamp, reading))
        self._answer_waiting()

    def _arrived(self) -> None:
        self._counted = self._last = time.monotonic()
        if self.silent:
            self.silent = False
            self.node.get_logger().info(f"{self.node.trigger} is back")

    def value(self, place: int, data: float) -> None:
        """Take what came on the input in this place."""
        node = self.node
        input_ = node.inputs[place]
        if input_.previous:
            node.take(input_, data)
            return
        if not node.active:
            return
        if not node.triggered_by_measurement:
            self._command(input_, data)
            return
        if not math.isfinite(data):
            node.refuse_value(input_, data)
        self._followers[place].take(data)
        self._answer_waiting()

    def _lend(self, message) -> None:
        """Keep a measurement that triggers nothing: its stamp belongs to the state of its answer."""
        node = self.node
        if not node.read(message, node.row):
            return
        waiting = self._pairing.measurement(message.header.stamp, time.monotonic())
        if waiting is not None:
            node.publish_state(message.header.stamp, *waiting)

    def _command(self, input_, data: float) -> None:
        """Answer a message that needs no measurement."""
        node = self.node
        if self._has_waited():
            return
        if not math.isfinite(data):
            node.refuse_value(input_, data)
            return  # as if it had not come
        node.pace.tick()
        self._arrived()
        node.take(input_, data)
        node.respond()
        # one message from the plant and one from the controller: which of them comes first is chance
        values = node.state_values()
        stamp = self._pairing.answer(values, self._last)
        if stamp is not None:
            node.publish_state(stamp, *values)

    def _answer_waiting(self) -> None:
        node = self.node
        while self._pending:
            ready = all(follower.ready for follower in self._followers)
            if not ready and len(self._pending) < BACKLOG:
                return
            stamp, reading = self._pending.popleft()
            node.row[:] = reading
            for follower, input_ in zip(self._followers, node.inputs, strict=True):
                if not input_.previous:
                    node.take(input_, follower.give())
            node.answer(stamp)

    def watch(self) -> None:
        """Timer: count the samples that go by while nothing comes, once that has lasted for the time-out."""
        node = self.node
        now = time.monotonic()
        if self._stood_still(now):
            self._backlog, self._heard = node.parameters.queue_depth, now
        self._looked = now
        if not node.active or node.sample == 0:
            return
        if now - self._last < node.patience:
            return
        samples = int((now - self._counted) / self.period)
        if not self.silent:
            self.silent = True
            node.say_silent()
            for _ in range(min(samples, MOST_MISSED)):
                if node.is_stale:
                    break
                node.miss_sample()
            node.miss(0)
            self._counted = now
        elif samples:
            # a look that comes late must not make up for it in one step
            node.miss(min(samples, max(round(WATCHDOG_PERIOD / self.period), 1)))
            self._counted = now
