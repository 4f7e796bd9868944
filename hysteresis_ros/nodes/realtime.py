# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Real-time mode: the plant or a driver sets the sample times; all other nodes answer measurements on arrival.

Within a sample the order is the same as in lockstep: a measurement is answered when the other inputs of its sample have
arrived. Float64 messages carry no number, so they are assigned to measurements by count. An input that has not arrived
by the next measurement is late: the sample is answered without this input, and the late message is not assigned to the
next sample. If an input is late in several samples in a row, the node stops waiting for it until a message arrives
again.

A partner is *lost* if it has been silent for longer than the time-out of the node that needs it and for more than a few
samples, and has not announced that it stops. Time in which the node's own process was halted does not count as silence
(:class:`AwakeTime`). When a partner is lost, the node keeps its own part safe and informs the plant, which stops the
axis. The stop is latched: the axis resumes when the partner is back and a person calls ``~/start``. This applies to the
loss of any node and at any sample rate. A partner that has just started may be silent for longer, because on a busy
machine its first messages have gaps. A partner that another process replaces always counts as lost if it has not
announced that it stops.
"""

from __future__ import annotations

import math
import time
from collections import deque

from std_msgs.msg import String

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.timing import Pace, Pairing, Runner

#: Interval between checks for stopped inputs [s].
WATCHDOG_PERIOD = 0.01

#: Longest interval between two checks that counts fully as silence of a partner [s].
LONGEST_CHECK = 2.0 * WATCHDOG_PERIOD

#: Presence messages: a node reports that it is active or stopped (``here NODE``, ``gone NODE``), and that a partner is
#: lost or back (``lost PARTNER NODE NAME``, ``heard PARTNER NODE NAME``; NAME is the partner's full name).
HERE, GONE, LOST, HEARD = "here", "gone", "lost", "heard"
#: Presence message of the plant after a person has started a stopped axis: ``started NODE``.
STARTED = "started"
#: Number of measurements that may still report a stopped axis after the plant has announced the start.
UNDER_WAY = 2

#: Queue depth of the presence messages.
PRESENCES = 20

#: Number of messages from which on a partner that has sent no presence message can be lost.
AT_WORK = 10
#: Allowed silence [s] of a partner whose messages span less than this time, because the nodes of an axis are still
#: starting.
STARTING = 2.0
#: Silence that is always allowed [samples].
LEAST_MISSED = 3

#: Reason for the loss of a partner that has been replaced.
ANOTHER_PROCESS = "a new process has replaced it, and the previous one had not announced that it stops"

#: The node that sets the sample times; without its measurements the other nodes have nothing to send.
PLANT = "plant_simulator"

#: Fraction of the loss time after which measurements count as paused; after a pause, the silence of the other nodes is
#: counted anew.
PAUSED = 0.5

#: Number of consecutive samples that an input may miss; the node then no longer waits for it.
GIVE_UP = 3

#: If a message is already waiting at more than this number of consecutive measurements, the oldest message is dropped.
SUSPICION = 50

#: Number of waiting measurements from which the oldest is answered without its missing inputs.
BACKLOG = 2

#: Number of missed checks of the inputs above which the process counts as halted or short of processor time.
SUSPENDED = 10

#: A message has waited in the queue if it arrives within this fraction of a period after the previous message.
WAITED = 0.5

#: Maximum number of missed samples that one check of a stopped input counts.
MOST_MISSED = 20000


class AwakeTime:
    """Time [s] in which this process ran; only this time counts as silence of a partner.

    :meth:`look` is called at each check of the inputs. An interval between two checks counts as at most ``longest``
    [s], so a partner whose messages still wait in a queue is not lost.
    """

    def __init__(self, longest: float):
        self._longest = longest
        self._looked = (0.0, time.monotonic())  # one tuple, because two threads read it

    def at(self, moment: float) -> float:
        """Return the awake time at an instant of the monotonic clock after the last check."""
        awake, looked = self._looked
        return awake + min(moment - looked, self._longest)

    def look(self, now: float) -> float:
        """Count the time since the last check, and return the awake time."""
        self._looked = (self.at(now), now)
        return self._looked[0]


class Follower:
    """One Float64 input in real time; each message waits for the measurement of its sample."""

    def __init__(self, strict: bool):
        self.strict = strict
        self.clear()

    def clear(self) -> None:
        """Reset to the initial state."""
        self.waiting: deque = deque(maxlen=2)
        self.last = math.nan
        self.present = False
        self._owed = 0
        self._missed = 0
        self._ahead = 0

    def take(self, data: float) -> None:
        """Store a message."""
        self.last = data
        if not self.present:
            # the measurement of this message has already been answered; the next measurement waits for its message
            self.present, self._owed, self._missed = True, 0, 0
            self.waiting.clear()
        elif self._owed:
            self._owed -= 1
        else:
            self.waiting.append(data)

    def expect(self) -> None:
        """Count a measurement."""
        self._ahead = self._ahead + 1 if self.waiting else 0
        if self._ahead > SUSPICION:
            self.waiting.popleft()
            self._ahead = 0

    @property
    def ready(self) -> bool:
        """Whether the oldest measurement does not have to wait for this input."""
        return bool(self.waiting) or not self.present

    def give(self) -> float:
        """Return the message for the oldest measurement; if it is missing, the last message, or NaN if ``strict``."""
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
    """Base of the real-time runners: inputs may stop, and samples continue without them."""

    exact = False
    keeps = False
    paused = False

    def __init__(self, node):
        super().__init__(node)
        self.clear()

    @property
    def period(self) -> float:
        """Time between two samples on the wall clock [s]."""
        parameters = self.node.parameters
        return 1.0 / (parameters.sample_rate * getattr(parameters, "real_time_factor", 1.0))

    is_live = False

    def require_rest(self) -> None:
        """Refuse to reset one part of a moving axis, because the output of the part would step."""
        node = self.node
        if node.active and not node.rests and self.is_live:
            raise HysteresisError(
                f"refused: the axis is running, and a reset of {node.kind} alone would make it jump; call ~/stop and "
                "wait until the axis is safe, deactivate the node, or reset the plant"
            )

    def make_pace(self) -> Pace:
        """Return the statistics of the sample times; only the plant has a rate to keep."""
        return Pace(self.period, keeps_time=hasattr(self.node.parameters, "real_time_factor"))

    def connect(self) -> None:
        """Create the presence topic."""
        self._presence = self.node.publisher(String, "run_state", latched_qos())

    def begin(self) -> None:
        """Announce that this node is active."""
        self._presence.publish(String(data=f"{HERE} {self.node.kind}"))

    def begin_again(self) -> None:
        """Announce the node again after a reset, because pending messages will not be answered."""
        if self.node.active:
            RealTime.begin(self)

    def leave(self) -> None:
        """Announce that this node stops, so that its missing messages do not count as late."""
        self._presence.publish(String(data=f"{GONE} {self.node.kind}"))

    def end(self) -> None:
        """Do nothing at deactivation: learned values are kept."""

    def clear(self) -> None:
        """Restart with the next measurement."""
        self.node.sample = 0
        self.node.end_of_run = -1
        self.node.finished = False

    def advance(self) -> None:
        """Do nothing: samples do not wait for inputs."""

    def say(self, state: str) -> None:
        """Do nothing: in real time no node uses the state of a run."""

    def say_of(self, what: str, partner: str, name: str = "") -> None:
        """Announce that a partner is lost or back."""
        self._presence.publish(String(data=f"{what} {partner} {self.node.kind} {name or partner}"))

    def announce(self, failure: str) -> None:
        """Do nothing: the other nodes continue until their time-outs."""

    def replaced(self, topic: str, name: str) -> None:
        """Do nothing if another process of a node publishes an input; runners that monitor inputs override this."""

    def matched(self) -> bool:
        """Return whether every publisher of the loop is matched with its partner."""
        return self.node.all_matched()

    def is_old_end(self, count: int) -> bool:
        """Return False: an end mark always belongs to this run."""
        return False


class RealTimeResponder(RealTime):
    """Answers measurements on arrival, with their inputs."""

    def __init__(self, node):
        #: Kinds of the partners that are known, that have stopped, and that are returning.
        self._known: set[str] = set()
        self._gone: set[str] = set()
        self._coming: set[str] = set()
        super().__init__(node)

    def clear(self) -> None:
        """Restart with the next measurement."""
        super().clear()
        self._forget()
        self._forget_losses()
        self._pairing = Pairing()
        self._last_stamp = -1
        self._counted = self._last = self._looked = self._heard = time.monotonic()
        self._awake_time = AwakeTime(min(LONGEST_CHECK, 0.5 * self.loss_time))
        self._backlog = 0
        self.silent = False

    def _forget(self) -> None:
        """Discard inputs of earlier measurements."""
        self._followers = [Follower(input_.strict) for input_ in self.node.inputs]
        self._pending: deque = deque()

    def connect(self) -> None:
        """Subscribe to the presence of the partners."""
        super().connect()
        for partners in (self._known, self._gone, self._coming):
            partners.clear()
        self.node.subscriber(String, "run_state", self._on_presence, latched_qos(PRESENCES))

    def _on_presence(self, message) -> None:
        state, partner, reporter, _ = (*message.data.split(" "), "", "", "", "")[:4]
        if state == GONE:
            self._gone.add(partner)
        elif state == HERE and partner in self._gone:
            self._gone.discard(partner)
            self._coming.add(partner)
        if state == STARTED and partner == PLANT:
            self._going = UNDER_WAY
            # if the plant stops and is started within one sample, no measurement reports the stop
            self._has_tripped = bool(self.latched)
        if state in (HERE, LOST, HEARD):
            self._known.add(partner if state == HERE else reporter)

    def _forget_losses(self) -> None:
        """Restart the detection of lost partners."""
        count = 1 + len(self.node.inputs)
        self._heard_at, self._heard_count, self._first_at = [0.0] * count, [0] * count, [0.0] * count
        self._awake = self._flowing = 0.0
        self._lost: dict[str, str] = {}
        self._returned: set[str] = set()
        self.latched, self._has_tripped, self._stopped = "", False, False
        self._going = 0

    def begin(self) -> None:
        """Start the check for missing measurements."""
        super().begin()
        self._forget()
        self._forget_losses()
        self._counted = self._last = self._looked = time.monotonic()
        self.node.timer(WATCHDOG_PERIOD, self.watch)

    @property
    def is_live(self) -> bool:
        """Whether the trigger has arrived within its time-out."""
        return self.age <= self.node.patience

    @property
    def absent(self) -> tuple[str, ...]:
        """Topics of the inputs for which this node no longer waits."""
        inputs = zip(self.node.inputs, self._followers, strict=True)
        return tuple(
            input_.topic
            for input_, follower in inputs
            if not (input_.previous or follower.present or math.isnan(follower.last))
        )

    @property
    def age(self) -> float:
        """Time since the last trigger [s]; infinite before the first."""
        return time.monotonic() - self._last if self.node.sample else math.inf

    def _stood_still(self, now: float) -> bool:
        """Return whether the last check of the inputs was so long ago that a measurement may have waited too long."""
        return now - self._looked > max(self.node.patience, SUSPENDED * WATCHDOG_PERIOD) + WATCHDOG_PERIOD

    def _has_waited(self) -> bool:
        """Return whether a message is too old to be answered, because it waited while this process was halted."""
        now = time.monotonic()
        before, self._heard = self._heard, now
        if self._stood_still(now):
            self._looked = now
            self._backlog = self.node.parameters.queue_depth
            return True
        self._backlog = self._backlog - 1 if now - before < WAITED * self.period else 0
        return self._backlog > 0

    def measurement(self, message) -> None:
        """Receive ``joint_states``."""
        node = self.node
        if node.active:
            self._note_measurement()
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
        if nanoseconds <= self._last_stamp and not (node.is_stale or self.latched):
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
        """Receive a message for input number ``place``."""
        node = self.node
        input_ = node.inputs[place]
        if input_.previous:
            node.take(input_, data)
            return
        if not node.active:
            return
        if math.isfinite(data):
            self._note(1 + place, input_.partner)
        if not node.triggered_by_measurement:
            self._command(input_, data)
            return
        if not math.isfinite(data):
            node.refuse_value(input_, data)
        self._followers[place].take(data)
        self._answer_waiting()

    def _lend(self, message) -> None:
        """Store a measurement that triggers no answer; publish the state of the answer that waits for its stamp."""
        node = self.node
        if not node.read(message, node.row):
            return
        waiting = self._pairing.measurement(message.header.stamp, time.monotonic())
        if waiting is not None:
            node.publish_state(message.header.stamp, *waiting)

    def _command(self, input_, data: float) -> None:
        """Answer a message that needs no measurement."""
        if self.take_command(input_, data):
            self.node.respond()
            self.pair_answer()

    def take_command(self, input_, data: float) -> bool:
        """Put a message that needs no measurement into the row; return False if it must not be answered."""
        node = self.node
        if self._has_waited():
            return False
        if not math.isfinite(data):
            node.refuse_value(input_, data)
            return False  # counts as missing
        node.pace.tick()
        self._arrived()
        node.take(input_, data)
        return True

    def pair_answer(self) -> None:
        """Publish ``~/state`` of the last answer if its measurement has arrived."""
        node = self.node
        # measurement and command come from different nodes, so their order is random
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

    # -- partners that are lost --------------------------------------------------------------------------------

    @property
    def loss_time(self) -> float:
        """Time of silence after which a partner is lost [s]."""
        return max(self.node.patience, LEAST_MISSED * self.period)

    def _note(self, place: int, partner: str) -> None:
        """Record the arrival of the measurement (0) or of an input (1 + its index)."""
        now = self._heard_at[place] = self._awake_time.at(time.monotonic())
        self._first_at[place] = self._first_at[place] or now
        self._heard_count[place] += 1
        if partner in self._lost:
            self._returned.add(partner)
        self._coming.discard(partner)

    def _note_measurement(self) -> None:
        now = self._awake_time.at(time.monotonic())
        if now - self._heard_at[0] > PAUSED * self.loss_time:
            self._flowing = now
        self._note(0, PLANT)

    def _missing(self, now: float) -> dict[str, str]:
        """Return the lost partners: kind → full name, or kind if unknown. ``now`` [s] is from :class:`AwakeTime`."""
        node, excused = self.node, self._gone | self._coming
        heard, counts = self._heard_at, self._heard_count

        def silent(place: int, partner: str, since: float) -> bool:
            lasts = heard[place] - self._first_at[place] >= STARTING
            limit = self.loss_time if lasts else max(self.loss_time, STARTING)
            at_work = counts[place] >= (1 if partner in self._known else AT_WORK)
            return at_work and now - max(heard[place], since) > limit

        if silent(0, PLANT, self._awake):
            name = node.masters.publisher_of("joint_states")
            return {} if PLANT in excused else {PLANT: name or PLANT}
        if counts[0] and now - heard[0] > PAUSED * self.loss_time:
            return {}  # without measurements the other nodes have nothing to answer
        since = max(self._awake, self._flowing)
        return {
            input_.partner: node.masters.publisher_of(input_.topic) or input_.partner
            for place, input_ in enumerate(node.inputs)
            if not input_.previous
            and (input_.topic == node.trigger or input_.partner in self._known)
            and input_.partner not in excused
            and silent(1 + place, input_.partner, since)
        }

    def _look_for_losses(self, now: float) -> None:
        """Keep the part safe while a partner is lost; report loss and return of the partner to the plant."""
        missing = self._missing(now)
        for partner, name in missing.items():
            if partner not in self._lost or not self.latched:
                self._lose(partner, name, f"it has sent nothing for {self.loss_time:.3g} s")
        for partner in self._returned.difference(missing):
            self._returned.discard(partner)
            self.say_of(HEARD, partner, self._lost.pop(partner))

    def _lose(self, partner: str, name: str, why: str) -> None:
        node = self.node
        self._lost[partner] = self.latched = name
        self._has_tripped = False
        self._returned.discard(partner)
        node.row[signals.TRIPPED] = 1.0
        text = f"{name} is lost: {why}; this node stays safe until ~/start of plant_simulator"
        node.warn("lost", text, every=0.0, error=True)
        self.say_of(LOST, partner, name)

    def replaced(self, topic: str, name: str) -> None:
        """Mark a partner as lost if a new process replaces one that has not announced that it stops."""
        node = self.node
        partners = {node.resolve_topic_name("joint_states"): (0, PLANT)}
        for place, input_ in enumerate(node.inputs):
            if not input_.previous:
                partners[node.resolve_topic_name(input_.topic)] = (1 + place, input_.partner)
        place, partner = partners.get(topic, (0, ""))
        excused = not partner or partner in self._gone or partner in self._coming or partner in self._lost
        if node.active and not excused and self._heard_count[place]:
            self._lose(partner, name or partner, ANOTHER_PROCESS)

    def follow_trip(self, tripped: bool) -> None:
        """Resume when the plant is started again after its stop because of a loss."""
        self._stopped = tripped
        self._going = max(self._going - 1, 0) if tripped else 0
        if self.latched and tripped:
            self._has_tripped = True
        elif self.latched and self._has_tripped and self.unlatch():
            self._has_tripped = False
            for partner, name in self._lost.items():  # a reset of the plant has cleared the loss there
                self.say_of(LOST, partner, name)

    @property
    def goes_on(self) -> bool:
        """Whether the plant has announced that the axis resumes, but no measurement has confirmed it yet."""
        return self._going > 0

    def missing_partners(self) -> str:
        """Return the names of the lost nodes; empty if all are present."""
        return " and ".join(self._lost.values())

    def unlatch(self) -> str:
        """Resume the part after the loss of a partner; return why it cannot resume, or an empty text if it can."""
        if not self.latched:
            return ""
        if self._lost:
            return f"{' and '.join(self._lost.values())} is lost and has not returned: restart it first"
        self.latched, self._has_tripped = "", False
        self.node.row[signals.TRIPPED] = 1.0 if self._stopped else 0.0
        RealTime.begin(self)
        return ""

    def watch(self) -> None:
        """Check the inputs: count missed samples, and detect lost partners (timer callback)."""
        node = self.node
        now = time.monotonic()
        if self._stood_still(now):
            self._backlog, self._heard = node.parameters.queue_depth, now
        awake = self._awake_time.look(now)
        if now - self._looked > SUSPENDED * WATCHDOG_PERIOD:
            self._awake = awake
        self._looked = now
        if not node.active or node.sample == 0:
            return
        self._count_missed(now)
        self._look_for_losses(awake)

    def _count_missed(self, now: float) -> None:
        """Count the samples without a trigger, once its time-out has passed."""
        node = self.node
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
            # a late check must not process all missed samples in one step
            node.miss(min(samples, max(round(WATCHDOG_PERIOD / self.period), 1)))
            self._counted = now
