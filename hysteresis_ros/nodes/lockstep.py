"""The lockstep protocol as every node of an axis keeps it: samples in order, partners present, one end for all."""

from __future__ import annotations

from std_msgs.msg import String, UInt64

from hysteresis_ros.nodes.qos import latched_qos

#: Seconds a first sample may take: discovery, and compilation of the kernels on a machine that has no cache yet.
STARTUP_TIMEOUT = 120.0

#: Seconds between two looks at the partners, and between two looks at who publishes the inputs.
WATCH_PERIOD = 0.02
PARTNER_PERIOD = 0.25

_FAILED = "failed: "

#: Everybody waits for it, and it for everybody: who only waits for the plant complains last.
PLANT = "plant_simulator"

#: What helps when the nodes of a run do not agree about it.
TOGETHER = "start or reset all nodes together"


class Partners:
    """Who publishes the inputs of a node; a run has one publisher of each, the same from its beginning to its end.

    Parameters
    ----------
    node : rclpy.node.Node
        The node.
    """

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
                return f"{topic} has {len(present)} publishers at sample {sample}: {who}; {TOGETHER}"
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


class LockstepProtocol:
    """What the nodes share of the protocol; mixed into AxisNode, whose attributes it uses."""

    #: Part of partner_timeout after which this node complains. Who waits directly for the culprit complains first, so
    #: that the error names the culprit and not a node that waits itself.
    share = 1.0

    def begin_protocol(self) -> None:
        """Make the topics of the protocol; called while configuring."""
        self.clear_protocol()
        self.reset_pending = False
        self._state_of_run = None
        if self.lockstep:
            self._state_of_run = self.publisher(String, "run_state", latched_qos())
            self.subscriber(String, "run_state", self._on_run_state, latched_qos())

    def clear_protocol(self) -> None:
        """Forget the run: the next sample is number 0."""
        self.sample = 0
        self.end_of_run = -1
        self.finished = False
        self.paused = False
        self.reset_pending = True
        self._matched = False
        self._heard_new = True
        self._looks = 0
        self.partners.forget()

    def subscribe_end(self) -> None:
        """Listen for the end mark of the plant: the number of samples of the run."""
        self.subscriber(UInt64, "end_of_run", self._on_end, latched_qos())

    # -- samples -----------------------------------------------------------------------------------------------

    def expected(self, index: int) -> bool:
        """Tell whether sample ``index`` is the next one; a restart or gap ends the run."""
        if index == self.sample:
            self.reset_pending = False
            return True
        if self.reset_pending:
            return False  # was under way at the reset; sample 0 is still to come
        if index == 0:
            who = f"{self.get_name()} is at {self.sample}"
            self.fail(f"plant_simulator began again at sample 0 while {who}; {TOGETHER}")
        elif index < self.sample:
            self.warn("repeat", f"sample {index} came again and was rejected; sample {self.sample} is awaited")
        else:
            who = f"{self.get_name()} awaits {self.sample}"
            self.fail(f"sample {index} came while {who}: it joined late or samples were lost; {TOGETHER}")
        return False

    def surplus(self, count: int, allowed: int, topic: str, partner: str) -> bool:
        """Tell whether more messages came than samples ask for, which ends the run: they would be taken for others."""
        if count <= allowed:
            return False
        what = f"{topic} has {count} messages at sample {self.sample}"
        self.fail(f"{what}: {partner} was restarted, or there are two; {TOGETHER}")
        return True

    def matched(self) -> bool:
        """Tell whether every publisher of the loop has found its partner."""
        if not self._matched:
            self._matched = all(publisher.get_subscription_count() > 0 for publisher in self._loop_publishers)
            self._heard_new |= self._matched
        return self._matched

    def heard(self) -> None:
        """Note that something awaited has come; the patience with partners starts anew."""
        self._heard_new = True

    # -- partners ----------------------------------------------------------------------------------------------

    def watch_partners(self) -> None:
        """Timer on the steady clock: answer late, notice partners that are silent or gone, leave at the end."""
        if not self.active or self.failure or self.finished:
            return
        self.advance()
        if self.end_of_run >= 0:
            self.leave_when_done()
            return
        now = self.steady.now().nanoseconds
        if self._heard_new or self.paused or not self.running:
            self._heard_new = False
            self._heard_at = now
        self._looks += 1
        if self._looks % round(PARTNER_PERIOD / WATCH_PERIOD) == 0:
            complaint = self.partners.complaint(self.sample)
            if complaint:
                self.fail(complaint)
                return
        limit = self.parameters.partner_timeout
        waited = (now - self._heard_at) * 1e-9
        if waited < (limit * self.share if self.sample > 0 else max(limit, STARTUP_TIMEOUT)):
            return
        partner = self.missing_partner()
        if partner and (waited > limit or partner != PLANT):
            where = f"at sample {self.sample} (partner_timeout {limit:g} s)"
            self.fail(f"{partner} has been silent for {waited:.1f} s {where}")

    def say(self, state: str) -> None:
        """Tell all nodes of the axis about the run: paused, running."""
        if self._state_of_run is not None:
            self._state_of_run.publish(String(data=state))

    def _on_run_state(self, message) -> None:
        if message.data.startswith(_FAILED):
            self.fail(message.data[len(_FAILED) :], announce=False)
        else:
            self.paused = message.data == "paused"

    # -- end ---------------------------------------------------------------------------------------------------

    def _on_end(self, message) -> None:
        if self.reset_pending and self.lockstep and message.data > 0:
            return  # of the run before the reset
        self.end_of_run = message.data
        if self.active and not self.lockstep:
            self.leave_when_done()

    def is_done(self) -> bool:
        """Tell whether the last sample of the run has been answered."""
        return self.sample >= self.end_of_run

    def leave_when_done(self) -> None:
        """Leave, if the run is over and the parameter exit_at_end says so."""
        if self.parameters.exit_at_end and (self.is_done() or not self.lockstep):
            self.finished = True

    def fail(self, text: str, exit_code: int = 1, announce: bool = True) -> None:
        """End the run with an error; the node answers no more samples, and the other nodes are told the same."""
        if self.failure:
            return
        self.failure, self.exit_code = text, exit_code
        self.get_logger().error(text)
        if announce:
            self.say(_FAILED + text)
