# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Lockstep: every sample is answered exactly once, in order; no clock decides anything."""

from __future__ import annotations

import math

from std_msgs.msg import String

from hysteresis_ros.nodes.domain import named
from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.timing import Runner

#: Seconds a first sample may take: discovery, and compilation of the kernels on a machine that has no cache yet. Who
#: has done its part of sample 0 waits so long too: with a recorder it counts as matched before its partner is there.
STARTUP_TIMEOUT = 120.0

#: Seconds between two looks at the partners, and between two looks at who publishes the inputs.
WATCH_PERIOD = 0.02
PARTNER_PERIOD = 0.25

_FAILED = "failed: "
#: Most characters of what is handed on of somebody else's failure.
LONGEST_REASON = 1000

#: Everybody waits for it, and it for everybody: who only waits for the plant complains last.
PLANT = "plant_simulator"

#: What helps when the nodes of a run do not agree about it.
TOGETHER = "start or reset all nodes together"


class Partners:
    """Who publishes the inputs of a node; a run has one publisher of each, the same from its beginning to its end."""

    def __init__(self, node):
        self._node = node
        self._inputs: list[tuple[str, str]] = []
        self.forget()

    def add(self, topic: str, partner: str) -> None:
        """Watch the publisher of ``topic`` (full name), which messages call ``partner``."""
        self._inputs.append((topic, partner))

    def clear(self) -> None:
        """Watch nothing any more."""
        self._inputs.clear()
        self.forget()

    def forget(self) -> None:
        """Let everybody begin anew: after a reset of all nodes."""
        self._known: dict[str, frozenset] = {}
        self._absent: set[str] = set()

    def complaint(self, sample: int) -> str:
        """Say what is wrong with the publishers of the inputs; empty when nothing is."""
        for topic, partner in self._inputs:
            found = self._node.get_publishers_info_by_topic(topic)
            present = frozenset(bytes(info.endpoint_gid) for info in found)
            known = self._known.get(topic)
            if len(present) > 1:
                who = f"{partner} was restarted, or there are two" if known else "there must be one"
                names = " and ".join(sorted(map(named, found)))
                return f"{topic} has {len(present)} publishers at sample {sample}, {names}: {who}; {TOGETHER}"
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
                # the mark of a regular end may still wait in the queue: believe it at the second look
                self._absent.add(topic)
        return ""


class Lockstep(Runner):
    """What a node of a lockstep run keeps to: samples in order, partners present, one end for all."""

    #: Whether every sample is answered exactly once, whatever happens.
    exact = True
    #: Whether messages are kept for whoever is matched a little later.
    keeps = True

    def __init__(self, node):
        super().__init__(node)
        self.run_state = None
        self.clear()
        self.reset_pending = False

    def connect(self) -> None:
        """Make the topics of the protocol; called while configuring."""
        node = self.node
        self.run_state = node.publisher(String, "run_state", latched_qos())
        node.subscriber(String, "run_state", self._on_run_state, latched_qos())

    def begin(self) -> None:
        """Watch the partners from activation on."""
        self._heard_at = self.node.steady.now().nanoseconds
        self.node.timer(WATCH_PERIOD, self.watch_partners)

    def begin_again(self) -> None:
        """After a reset the others are not told: all are reset together."""

    def part(self) -> None:
        """A partner that stops is noticed by its silence."""

    def end(self) -> None:
        """A run is over when its node is deactivated: the next one starts at sample 0."""
        self.clear()
        self.node.reset_blocks()

    def clear(self) -> None:
        """Forget the run: the next sample is number 0."""
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
        """Tell whether sample ``index`` is the next one; a restart or gap ends the run."""
        node = self.node
        if index == node.sample:
            self.reset_pending = False
            return True
        if self.reset_pending:
            return False  # was under way at the reset; sample 0 is still to come
        if index == 0:
            who = f"{node.get_name()} is at {node.sample}"
            node.fail(f"plant_simulator began again at sample 0 while {who}; {TOGETHER}")
        elif index < node.sample:
            node.warn("repeat", f"sample {index} came again and was rejected; sample {node.sample} is awaited")
        else:
            who = f"{node.get_name()} awaits {node.sample}"
            node.fail(f"sample {index} came while {who}: it joined late or samples were lost; {TOGETHER}")
        return False

    def surplus(self, count: int, allowed: int, topic: str, partner: str) -> bool:
        """Tell whether more messages came than samples ask for, which ends the run: they would be taken for others."""
        if count <= allowed:
            return False
        what = f"{topic} has {count} messages at sample {self.node.sample}"
        self.node.fail(f"{what}: {partner} was restarted, or there are two; {TOGETHER}")
        return True

    def matched(self) -> bool:
        """Tell whether every publisher of the loop has found its partner."""
        if not self._matched:
            self._matched = self.node.all_matched()
            self._heard_new |= self._matched
        return self._matched

    def heard(self) -> None:
        """Note that something awaited has come; the patience with partners starts anew."""
        self._heard_new = True

    def advance(self) -> None:
        """Do what can be done now: overridden by who answers samples."""

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs; empty when nobody is awaited."""
        return self.node.missing_partner()

    # -- partners ----------------------------------------------------------------------------------------------

    def watch_partners(self) -> None:
        """Timer on the steady clock: answer late, notice partners that are silent or gone, leave at the end."""
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
        """Tell all nodes of the axis about the run: paused, running."""
        if self.run_state is not None:
            self.run_state.publish(String(data=state))

    def announce(self, failure: str) -> None:
        """Tell all nodes of the axis that the run is broken."""
        self.say(_FAILED + failure)

    def _on_run_state(self, message) -> None:
        if message.data.startswith(_FAILED):
            self.node.fail(message.data[len(_FAILED) :][:LONGEST_REASON], announce=False)
        else:
            self.paused = message.data == "paused"

    def is_old_end(self, count: int) -> bool:
        """Tell whether an end mark is that of the run before a reset."""
        return self.reset_pending and count > 0


class LockstepResponder(Lockstep):
    """Answers sample k when its measurement and all other inputs of it are there."""

    def clear(self) -> None:
        """Forget the run: the next sample is number 0."""
        super().clear()
        inputs = self.node.inputs
        self._counts = [0] * len(inputs)
        # how many messages of each input the sample of number 0 needs; each sample one more
        self._ahead = [0 if input_.previous else 1 for input_ in inputs]
        self._stamp = None

    def measurement(self, message) -> None:
        """Take ``joint_states``: its stamp is the key of the sample."""
        node = self.node
        if self.expected(node.sample_of(message.header.stamp)):
            self.heard()
            if not node.read(message, node.row):
                return
            self._stamp = message.header.stamp
            self.advance()

    def value(self, place: int, data: float) -> None:
        """Take what came on the input in this place; it belongs to the sample by its count."""
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
        """Return the first input that has not delivered what the present sample needs, None when all have."""
        sample, ahead = self.node.sample, self._ahead
        for place, count in enumerate(self._counts):
            if count < sample + ahead[place]:
                return self.node.inputs[place]
        return None

    @property
    def confirmed(self) -> bool:
        """Whether all has come that belongs to the last sample that was answered."""
        pairs = zip(self._counts, self.node.inputs, strict=True)
        return all(count >= self.node.sample for count, input_ in pairs if input_.previous)

    def advance(self) -> None:
        """Answer the present sample if everything it needs has come."""
        node = self.node
        if self._stamp is None or self._lacks() is not None:
            return
        if not node.active or node.failure or not (self._matched or self.matched()):
            return
        node.pace.tick()
        stamp, self._stamp = self._stamp, None
        node.answer(stamp)

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs."""
        if self._stamp is None:
            return PLANT
        lacking = self._lacks()
        return "" if lacking is None else lacking.partner
