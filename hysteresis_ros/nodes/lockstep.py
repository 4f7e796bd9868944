# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Lockstep mode: every sample is answered exactly once, in order, independent of any clock."""

from __future__ import annotations

import math

from std_msgs.msg import String

from hysteresis_ros.nodes.domain import named
from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.timing import Runner

#: Time-out of the first two samples [s], long enough for discovery, and for compiling the kernels without a cache. It
#: also applies to sample 1, because a recorder's subscription can make a node answer sample 0 before its partner is
#: present.
STARTUP_TIMEOUT = 120.0

#: Interval between checks for silent partners, and between checks of the publishers of the inputs [s].
WATCH_PERIOD = 0.02
PARTNER_PERIOD = 0.25

_FAILED = "failed: "
#: Maximum length of another node's failure message that is passed on [characters].
LONGEST_REASON = 1000

#: All nodes wait for the plant, and the plant waits for all nodes, so a node that waits only for the plant reports
#: last.
PLANT = "plant_simulator"

#: Remedy if the nodes of a run are inconsistent.
TOGETHER = "start or reset all nodes together"


class Partners:
    """Publishers of a node's inputs; during a run the publisher of an input must not change."""

    def __init__(self, node):
        self._node = node
        self._inputs: list[tuple[str, str]] = []
        self.forget()

    def add(self, topic: str, partner: str) -> None:
        """Monitor the publisher of ``topic`` (full name); messages call it ``partner``."""
        self._inputs.append((topic, partner))

    def clear(self) -> None:
        """Stop monitoring."""
        self._inputs.clear()
        self.forget()

    def forget(self) -> None:
        """Forget the publishers, after a reset of all nodes."""
        self._known: dict[str, frozenset] = {}
        self._absent: set[str] = set()

    def complaint(self, sample: int) -> str:
        """Return the problem with the publishers of the inputs; empty without a problem."""
        for topic, partner in self._inputs:
            found = self._node.get_publishers_info_by_topic(topic)
            present = frozenset(bytes(info.endpoint_gid) for info in found)
            known = self._known.get(topic)
            if len(present) > 1:
                cause = f"{partner} was restarted, or there are two" if known else "exactly one is allowed"
                names = " and ".join(sorted(map(named, found)))
                return f"{topic} has {len(present)} publishers at sample {sample}, {names}: {cause}; {TOGETHER}"
            if known is None or sample == 0:
                if present:
                    self._known[topic] = present
                continue
            if present == known:
                self._absent.discard(topic)
            elif present:
                return f"{partner} was restarted at sample {sample} (topic {topic}); {TOGETHER}"
            elif topic in self._absent:
                return f"{partner} vanished at sample {sample} (topic {topic})"
            else:
                # the end mark may still be in the queue, so a publisher counts as lost only if two checks do not find
                # it
                self._absent.add(topic)
        return ""


class Lockstep(Runner):
    """Base of the lockstep runners: samples in order, partners monitored, one common end."""

    #: Whether every sample is answered exactly once.
    exact = True
    #: Whether publishers keep messages for subscriptions that match later.
    keeps = True

    def __init__(self, node):
        super().__init__(node)
        self.run_state = None
        self.clear()
        self.reset_pending = False

    def connect(self) -> None:
        """Create the topics of the protocol; called while configuring."""
        node = self.node
        self.run_state = node.publisher(String, "run_state", latched_qos())
        node.subscriber(String, "run_state", self._on_run_state, latched_qos())

    def begin(self) -> None:
        """Begin to monitor the partners."""
        self._heard_at = self.node.steady.now().nanoseconds
        self.node.timer(WATCH_PERIOD, self.watch_partners)

    def begin_again(self) -> None:
        """Do nothing after a reset: all nodes are reset together."""

    def leave(self) -> None:
        """Do nothing: the other nodes notice from its silence that this node has stopped."""

    def end(self) -> None:
        """End the run at deactivation; the next run starts at sample 0."""
        self.clear()
        self.node.reset_blocks()

    def clear(self) -> None:
        """Reset the run: the next sample is number 0."""
        self.node.sample = 0
        self.node.end_of_run = -1
        self.node.finished = False
        self.paused = False
        self.reset_pending = True
        self._matched = False
        self._heard_new = True
        self._looks = 0
        self.node.partners.forget()

    # -- samples -----------------------------------------------------------------------------------------------

    def expected(self, index: int) -> bool:
        """Return whether sample ``index`` is the next one; a restart or gap ends the run."""
        node = self.node
        if index == node.sample:
            self.reset_pending = False
            return True
        if self.reset_pending:
            return False  # sent before the reset; sample 0 has not arrived yet
        if index == 0:
            place = f"{node.get_name()} is at {node.sample}"
            node.fail(f"plant_simulator restarted at sample 0 while {place}; {TOGETHER}")
        elif index < node.sample:
            node.warn("repeat", f"sample {index} arrived again and was rejected; the next sample is {node.sample}")
        else:
            place = f"{node.get_name()} awaits {node.sample}"
            node.fail(f"sample {index} arrived while {place}: it joined late or samples were lost; {TOGETHER}")
        return False

    def surplus(self, count: int, allowed: int, topic: str, partner: str) -> bool:
        """Return whether more messages arrived than samples need; the run then ends, because they fit no sample."""
        if count <= allowed:
            return False
        what = f"{topic} has {count} messages at sample {self.node.sample}"
        self.node.fail(f"{what}: {partner} was restarted, or there are two; {TOGETHER}")
        return True

    def matched(self) -> bool:
        """Return whether every publisher of the loop is matched with its partner."""
        if not self._matched:
            self._matched = self.node.all_matched()
            self._heard_new |= self._matched
        return self._matched

    def heard(self) -> None:
        """Record that an expected message has arrived, which restarts the time-out of the partners."""
        self._heard_new = True

    def advance(self) -> None:
        """Process complete samples; runners that answer samples override this."""

    def missing_partner(self) -> str:
        """Return the partner whose input for the present sample is missing; empty if all inputs have arrived."""
        return self.node.missing_partner()

    # -- partners ----------------------------------------------------------------------------------------------

    def watch_partners(self) -> None:
        """Answer pending samples, detect silent or lost partners, and exit at the end (timer callback)."""
        node = self.node
        if not node.active or node.failure or node.finished:
            return
        self.advance()
        if node.end_of_run >= 0:
            node.leave_when_done()
            return
        now = node.steady.now().nanoseconds
        if self._heard_new or self.paused or node.holds_time:
            self._heard_new = False
            self._heard_at = now
        self._looks += 1
        if self._looks % round(PARTNER_PERIOD / WATCH_PERIOD) == 0:
            complaint = node.partners.complaint(node.sample)
            if complaint:
                node.fail(complaint)
                return
        limit = node.parameters.partner_timeout
        waited = (now - self._heard_at) * 1e-9
        if waited < (limit * node.share if node.sample > 1 else max(limit, STARTUP_TIMEOUT)):
            return
        partner = self.missing_partner()
        if partner and (waited > limit or partner != PLANT):
            where = f"at sample {node.sample} (partner_timeout {limit:g} s)"
            node.fail(f"{partner} has been silent for {waited:.1f} s {where}")

    def say(self, state: str) -> None:
        """Publish the state of the run to all nodes of the axis: paused, running."""
        if self.run_state is not None:
            self.run_state.publish(String(data=state))

    def announce(self, failure: str) -> None:
        """Publish to all nodes of the axis that the run has failed."""
        self.say(_FAILED + failure)

    def _on_run_state(self, message) -> None:
        if message.data.startswith(_FAILED):
            self.node.fail(message.data[len(_FAILED) :][:LONGEST_REASON], announce=False)
        else:
            self.paused = message.data == "paused"

    def is_old_end(self, count: int) -> bool:
        """Return whether an end mark belongs to the run before a reset."""
        return self.reset_pending and count > 0


class LockstepResponder(Lockstep):
    """Answers sample k when its measurement and all its other inputs have arrived."""

    def clear(self) -> None:
        """Reset the run: the next sample is number 0."""
        super().clear()
        inputs = self.node.inputs
        self._counts = [0] * len(inputs)
        # number of messages of each input that sample 0 needs; each later sample needs one more
        self._ahead = [0 if input_.previous else 1 for input_ in inputs]
        self._stamp = None

    def measurement(self, message) -> None:
        """Receive ``joint_states``; its stamp identifies the sample."""
        node = self.node
        if self.expected(node.sample_of(message.header.stamp)):
            self.heard()
            if not node.read(message, node.row):
                return
            self._stamp = message.header.stamp
            self.advance()

    def value(self, place: int, data: float) -> None:
        """Receive a message for input number ``place``; the count of messages assigns it to a sample."""
        node = self.node
        input_ = node.inputs[place]
        count = self._counts[place] = self._counts[place] + 1
        allowed = node.sample + self._ahead[place]
        if count > allowed and self.surplus(count, allowed, input_.topic, input_.partner):
            return
        self._heard_new = True
        if not math.isfinite(data):
            node.refuse_value(input_, data)
        node.take(input_, data)
        self.advance()

    def _lacks(self):
        """Return the first input that is missing for the present sample; None if all have arrived."""
        sample, ahead = self.node.sample, self._ahead
        for place, count in enumerate(self._counts):
            if count < sample + ahead[place]:
                return self.node.inputs[place]
        return None

    @property
    def confirmed(self) -> bool:
        """Whether all messages of the last answered sample have arrived."""
        pairs = zip(self._counts, self.node.inputs, strict=True)
        return all(count >= self.node.sample for count, input_ in pairs if input_.previous)

    def advance(self) -> None:
        """Answer the present sample if all its inputs have arrived."""
        if self.may_answer():
            self.node.answer(self.take_stamp())

    def may_answer(self) -> bool:
        """Return whether all inputs of the present sample have arrived."""
        node = self.node
        if self._stamp is None or self._lacks() is not None:
            return False
        return node.active and not node.failure and (self._matched or self.matched())

    def take_stamp(self):
        """Return the stamp of the present sample, which is answered now."""
        self.node.pace.tick()
        stamp, self._stamp = self._stamp, None
        return stamp

    def missing_partner(self) -> str:
        """Return the partner whose input for the present sample is missing."""
        if self._stamp is None:
            return PLANT
        lacking = self._lacks()
        return "" if lacking is None else lacking.partner
