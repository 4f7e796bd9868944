# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What every node of an axis has in common: lifecycle, topics, log of changes, diagnostics; the node itself is last.

``changes`` logs what a node is set to and what is changed while it runs. Its entries are numbered, so that a recorder
knows which are missing, and the last one says that the run is over. A recorder in the process of a fused loop takes
entries where they are made, as it takes the samples: by message they would come after the samples, or not at all.
"""

from __future__ import annotations

import json
import math
import time
from array import array
from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt64
from std_srvs.srv import Trigger

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError, ParameterError
from hysteresis_ros.loop.parameters import NODE_PARAMETERS
from hysteresis_ros.nodes.domain import named
from hysteresis_ros.nodes.fused import Fused
from hysteresis_ros.nodes.lockstep import Lockstep, Partners
from hysteresis_ros.nodes.masters import Masters, require_alone
from hysteresis_ros.nodes.parameters import GuardedServices, ParameterInterface, TabledParameters, answered
from hysteresis_ros.nodes.qos import diagnostics_qos, latched_qos, loop_qos
from hysteresis_ros.nodes.realtime import RealTime
from hysteresis_ros.nodes.timing import OVERRUN, Pace
from hysteresis_ros.signals import CONFIGURED, ENDED

#: The method of rclpy that answers ``change_state``.
_CHANGE_STATE = "_LifecycleNodeMixin__on_change_state"


class GuardedLifecycleNode(GuardedServices, LifecycleNode):
    """A lifecycle node that refuses a transition its state does not have.

    rclpy up to 7.1.6 answers ``change_state`` with such an ``id`` by an exception in the executor, which ends the
    process with its outputs where they are (ros2/rclpy, issue 1209).
    """

    def __init__(self, name: str, **options):
        super().__init__(name, **options)
        self.guard_services()

    # The service calls the method by this name, Python's for a private one of the class that rclpy declares it in.
    def _LifecycleNodeMixin__on_change_state(self, request, response):
        wanted = request.transition
        allowed = {number: label for number, label, *_ in self._state_machine.available_transitions}
        if not wanted.label and wanted.id not in allowed:
            now = self._state_machine.current_state[1]
            names = ", ".join(f"{label} ({number})" for number, label in allowed.items())
            self.get_logger().warning(f"transition {wanted.id} refused: {now} now, which allows {names}")
            response.success = False
            return response
        return getattr(super(), _CHANGE_STATE)(request, response)

    @property
    def autostart(self) -> bool:
        """Whether the node configures and activates by itself."""
        return self.get_parameter("autostart").value is not False

    def configure_now(self) -> bool:
        """Configure; False when that failed."""
        return self.trigger_configure() == TransitionCallbackReturn.SUCCESS

    def activate_now(self) -> bool:
        """Activate; False when that failed."""
        return self.trigger_activate() == TransitionCallbackReturn.SUCCESS


class Endpoints(Node):
    """What a node makes publishers, subscriptions and timers with; stands before rclpy's class of the node."""

    parameters: Any  #: Typed parameters of this kind of node; None while it is not configured.
    runner: Any  #: What decides when a sample is dealt with; None before the node is configured.
    steady: Clock
    partners: Partners
    masters: Masters
    compatibility: Compatibility
    _topic_handles: list
    _loop_publishers: list
    _work_timers: list
    _warned: dict[str, int]
    _state: JointState
    _state_publisher: Any

    def qos(self):
        """Quality of service of the topics between the nodes."""
        return loop_qos(self.runner.keeps, self.parameters.queue_depth)

    def changes_qos(self):
        """Quality of service of what people have changed: kept for a recorder that comes later."""
        return loop_qos(True, self.parameters.queue_depth)

    def publisher(self, message_type, topic: str, qos, loop: bool = False):
        """Make a publisher that goes with cleanup; ``loop``: lockstep needs its partner before the first answer."""
        made = self.create_publisher(message_type, topic, qos, event_callbacks=self.compatibility.of_publisher(topic))
        self._topic_handles.append((self.destroy_publisher, made))
        if loop:
            self._loop_publishers.append(made)
        return made

    def subscriber(self, message_type, topic: str, callback, qos, raw: bool = False, partner: str = ""):
        """Make a subscription that goes with cleanup; ``partner``: who publishes it in lockstep, and is watched."""
        events = self.compatibility.of_subscription(topic)
        made = self.create_subscription(message_type, topic, callback, qos, raw=raw, event_callbacks=events)
        self._topic_handles.append((self.destroy_subscription, made))
        if partner:
            self.partners.add(made.topic_name, partner)
        return made

    def loop_input(self, message_type, topic: str, callback, qos, partner: str):
        """Make a subscription of the loop: one publisher feeds it, in lockstep from the beginning to the end."""
        if self.runner.exact:
            return self.subscriber(message_type, topic, callback, qos, partner=partner)
        return self.masters.add(message_type, topic, callback, qos, self.compatibility.of_subscription(topic))

    @property
    def loop_topics(self) -> list[str]:
        """Full names of the topics of the loop that this node publishes."""
        return [publisher.topic_name for publisher in self._loop_publishers]

    def drop(self, subscription) -> None:
        """Destroy a subscription before cleanup does."""
        self._topic_handles.remove((self.destroy_subscription, subscription))
        self.destroy_subscription(subscription)

    def timer(self, period: float, callback):
        """Make a timer on the steady clock that goes with deactivation."""
        made = self.create_timer(period, callback, clock=self.steady)
        self._work_timers.append(made)
        return made

    def all_matched(self) -> bool:
        """Tell whether every publisher of the loop has a subscription."""
        return all(publisher.get_subscription_count() > 0 for publisher in self._loop_publishers)

    def publish_state(self, stamp, *values: float) -> None:
        """Publish ``~/state`` with the stamp of the measurement it belongs to; the message is reused."""
        message = self._state
        message.header.stamp = stamp
        position = message.position
        for index, value in enumerate(values):
            position[index] = value
        self._state_publisher.publish(message)

    def warn(self, key: str, text: str, every: float = 1.0, error: bool = False) -> None:
        """Log a warning (or error), at most one per ``key`` and ``every`` seconds."""
        now = self.steady.now().nanoseconds
        if now - self._warned.get(key, -(10**18)) >= every * 1e9:
            self._warned[key] = now
            # two lines, because rclpy ties a place in the source to one severity
            if error:
                self.get_logger().error(text)
            else:
                self.get_logger().warning(text)

    def wait_acknowledged(self, deadline: float) -> None:
        """Wait until all that was published has been received, at most until ``time.monotonic()`` is ``deadline``."""
        for _, handle in self._topic_handles:
            if hasattr(handle, "wait_for_all_acked"):
                handle.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))


class ChangeLog:
    """What one node says on ``changes``; nothing before :meth:`open`."""

    def __init__(self, node: str):
        self._node = node
        self._entries: deque[str] = deque()
        self._made = 0
        self.close()

    def open(self, publisher, parameters: dict) -> None:
        """Begin with the parameters that the node is configured with."""
        self._publisher, self._number, self._is_over = publisher, 0, False
        self._entries = deque(maxlen=publisher.qos_profile.depth)
        self.publish({"sample": 0, "node": self._node, "action": CONFIGURED, "parameters": parameters})

    def close(self) -> None:
        """Say nothing any more."""
        self._publisher, self._number, self._is_over = None, 0, False

    def publish(self, entry: dict) -> None:
        """Publish an entry."""
        if self._publisher is not None:
            self._number += 1
            text = json.dumps({**entry, "number": self._number})
            self._entries.append(text)
            self._made += 1
            self._publisher.publish(String(data=text))

    def since(self, made: int) -> tuple[list[str], int]:
        """Return the entries after the first so many, as JSON, and how many there are by now."""
        new = min(self._made - made, len(self._entries))
        return list(self._entries)[len(self._entries) - new :], self._made

    def end(self, sample: int, stopped: bool = False) -> None:
        """Say, once, that the run is over at a sample: no entry follows that belongs to it."""
        if not self._is_over:
            self._is_over = True
            told = {"stopped": True} if stopped else {}
            self.publish({"sample": sample, "node": self._node, "action": ENDED, "parameters": {}, **told})


#: Topics whose reliability a parameter chooses, and that parameter.
CHOSEN = {"joint_states": "measurement_reliability", "setpoint": "setpoint_reliability"}


def unheard(offered, asked, chosen_by: str) -> str:
    """Say why a subscription hears nothing of a publisher, and what to do; empty when it does."""
    best_effort, reliable = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
    if offered.reliability == best_effort and asked.reliability == reliable:
        choice = f"set {chosen_by}: best_effort here, or " if chosen_by else ""
        return f"offers best effort, reliable is asked for: {choice}let the publisher be reliable"
    latched, volatile = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
    if offered.durability == volatile and asked.durability == latched:
        return "offers volatile, transient local is asked for: let the publisher be transient local"
    return ""


class Compatibility:
    """Watches the topics of a node for partners with which it is not connected."""

    def __init__(self, node):
        self._node = node
        self._suspected: dict[str, str] = {}

    def of_subscription(self, topic: str) -> SubscriptionEventCallbacks:
        """Return what hears of publishers that do not fit a subscription."""
        chosen_by = CHOSEN.get(topic, "")
        return SubscriptionEventCallbacks(incompatible_qos=lambda event: self._suspect(topic, chosen_by))

    def of_publisher(self, topic: str) -> PublisherEventCallbacks:
        """Return what hears of subscriptions that do not fit a publisher."""
        return PublisherEventCallbacks(incompatible_qos=lambda event: self._suspect(topic, ""))

    def _suspect(self, topic: str, chosen_by: str) -> None:
        self._suspected[topic] = chosen_by
        self.complaint()

    def complaint(self) -> str:
        """Say who is not connected now, log it now and then, and return it; empty when all are."""
        found = [text for topic in tuple(self._suspected) for text in self._look(topic)]
        for text in found:
            self._node.warn(f"qos {text}", text, every=10.0)
        return "; ".join(found)

    def _look(self, topic: str) -> list[str]:
        """Return what does not fit on a topic; one on which everybody has found each other is forgotten."""
        node, chosen_by = self._node, self._suspected[topic]
        full, own = node.resolve_topic_name(topic), node.get_fully_qualified_name()
        found = set()
        subscriptions = node.get_subscriptions_info_by_topic(full)
        for publisher in node.get_publishers_info_by_topic(full):
            for subscription in subscriptions:
                reason = unheard(publisher.qos_profile, subscription.qos_profile, chosen_by)
                talks, hears = named(publisher), named(subscription)
                if reason and hears == own:
                    found.add(f"{full}: nothing is heard from {talks}, which {reason}")
                elif reason and talks == own:
                    found.add(f"{full}: {hears} hears nothing of this node, which {reason}")
        if not found:
            del self._suspected[topic]
        return sorted(found)


#: Levels: as it should be; somebody ought to look at it; the axis does not do what is asked; nobody says anything.
OK, WARN, ERROR, STALE = range(4)

#: What of a node a status is about; stands behind its name, as tools that gather diagnostics expect.
ITEM = "axis"

#: Seconds after which it is an error that a node still has nothing to work on.
START_UP = 10.0


def diagnostics(node) -> DiagnosticArray:
    """Return what a node says of itself: level, words and numbers."""
    level, text, table = _at_work(node) if node.active else _at_rest(node)
    status = DiagnosticStatus()
    status.name = f"{node.get_fully_qualified_name()}: {ITEM}"
    status.hardware_id = f"{node.get_namespace()}/{node.get_parameter('joint').value}".strip("/")
    status.level = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE)[level]
    status.message = text or "OK"
    status.values = [KeyValue(key=key, value=str(value)) for key, value in table.items()]
    message = DiagnosticArray()
    message.header.stamp = node.get_clock().now().to_msg()
    message.status = [status]
    return message


def _at_rest(node) -> tuple[int, str, dict]:
    """Return level, words and numbers of a node that is not active."""
    name = node.get_fully_qualified_name()
    if node.failure:
        return ERROR, node.failure, {}
    if node.leaving or node.finished:
        return STALE, "left", {}
    if node.parameters is None:
        return WARN, f"unconfigured: ros2 lifecycle set {name} configure", {}
    return WARN, f"inactive: ros2 lifecycle set {name} activate", {}


def _at_work(node) -> tuple[int, str, dict]:
    """Return level, words and numbers of a node that is active."""
    rate, jitter = node.pace.read()
    level, text, values = node.health()
    # late samples are counted once, by the plant; other nodes say what of their input came late
    counted = node.kind == "plant_simulator" or node.is_fused
    late = 0 if counted else node.since_report("late_inputs", node.pace.overruns)
    if node.failure:
        level, text = ERROR, node.failure
    elif not node.running:
        level, text = max(level, WARN), text or "stopped"
    elif level == ERROR and not node.sample and time.monotonic() - node.active_since < START_UP:
        level = WARN  # the others are only coming
    elif late and not level:
        level, text = WARN, f"{late} late inputs: more than {OVERRUN:g} periods after the one before"
    contested = "" if node.runner.exact else node.masters.complaint()  # in lockstep that ends the run
    if contested:
        node.warn("others", contested, every=10.0, error=True)
        level, text = ERROR, f"{text}; {contested}" if text else contested
    unconnected = node.compatibility.complaint()
    if unconnected:
        level, text = max(level, WARN), f"{text}; {unconnected}" if text else unconnected
    table = {"rate_hz": f"{rate:.3f}", "jitter_p99_s": f"{jitter:.6f}", "samples": node.pace.total}
    return level, text, table | ({} if counted else {"late_inputs": node.pace.overruns}) | values


def introduction(node) -> str:
    """Return what a node says when it begins to work: what it is, at what rate, and in which time mode."""
    values = node.parameters.to_mapping()
    words = [f"{name} {values[name]}" for name in node.identity if values.get(name)]
    return ", ".join(["active", *words, f"{node.parameters.sample_rate:g} Hz", node.parameters.time_mode])


class AxisNode(TabledParameters, Endpoints, GuardedLifecycleNode):
    """Base of the nodes of an axis.

    Subclasses implement :meth:`build` (blocks from parameters), :meth:`connect` (publishers and subscriptions),
    :meth:`reset_blocks`, :meth:`retune`, and what happens on a sample. When that happens is decided by :attr:`runner`,
    lockstep or real time. A mistake of the user or a broken run ends in :attr:`failure`, a sentence; the process that
    runs the node then leaves with :attr:`exit_code`.
    """

    #: Whether the node has ``~/state``.
    has_state = True
    #: Seconds without an input after which it is missed, and after which somebody else may feed it.
    patience: float = math.inf
    #: Whether something is missing of what this node is there for, however it leaves.
    has_lost: bool = False
    #: Whether the part may begin again amid an axis that runs, without a step of its output.
    rests: bool = True
    #: Part of partner_timeout after which this node complains in lockstep. Who waits directly for the culprit complains
    #: first, so that the error names the culprit and not a node that waits itself.
    share = 1.0
    #: Parameters that say what the node is at work as.
    identity: tuple[str, ...] = ()
    #: Seconds at most for which a node that listens at exit does.
    listens_for = 0.3
    #: Services std_srvs/Trigger, each answered by the method of its name with ``_on_`` before it.
    triggers: tuple[str, ...] = ("start", "stop", "reset")

    def __init__(self, name: str, **options):
        super().__init__(name, **options)
        self.kind = name
        self.state_names: tuple[str, ...] = ()
        self.interface = ParameterInterface(self, NODE_PARAMETERS[name], self._retune)
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.partners = Partners(self)
        self.masters = Masters(self)
        self.parameters = None
        self.runner = None
        #: With time_mode fused: the axis of which this node is one, in this process.
        self.fused: Any = None
        self.changes = ChangeLog(name)
        self.active = False
        #: Whether the process is about to end.
        self.leaving = False
        self.running = True
        self.finished = False
        self.failure = ""
        self.exit_code = 0
        self.pace = Pace()
        self.sample = 0
        self.end_of_run = -1
        self._topic_handles = []
        self._loop_publishers = []
        self._work_timers = []
        self._warned = {}
        self._reported: dict[str, int] = {}
        self.active_since = 0.0
        self.compatibility = Compatibility(self)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", diagnostics_qos(keeps=True))
        self.create_timer(1.0, self.tell_health, clock=self.steady)
        for service in self.triggers:
            self.create_service(Trigger, f"~/{service}", answered(getattr(self, f"_on_{service}")))

    # -- what subclasses provide -------------------------------------------------------------------------------

    def build(self, parameters) -> None:
        """Make the blocks. Raises HysteresisError when the parameters do not fit together."""

    def unbuild(self) -> None:
        """Let go of what :meth:`build` has taken from outside; called at cleanup, and when configuring has failed."""

    def connect(self) -> None:
        """Make publishers and subscriptions."""

    def begin(self) -> None:
        """Go to work after activation."""

    def make_runner(self):
        """Return what decides when a sample is dealt with."""
        if self.parameters.time_mode == "fused":
            return Fused(self)
        return self.lockstep_runner(self) if self.parameters.time_mode == "lockstep" else self.real_time_runner(self)

    #: Runners of the time modes in which every node makes its part of a sample.
    lockstep_runner: Any = Lockstep
    real_time_runner: Any = RealTime

    @property
    def is_motor(self) -> bool:
        """Whether the axis is an inchworm motor's."""
        return False

    def state_signals(self) -> dict[str, str]:
        """Return what stands in ``~/state``: name in the message → signal."""
        return signals.state_signals(self.kind, self.is_motor)

    @property
    def holds_time(self) -> bool:
        """Whether this node has stopped the time of the axis itself."""
        return False

    def go_safe(self) -> None:
        """Bring the outputs to their safe values at once; called on deactivation and at exit."""

    def release(self) -> None:
        """Let go of threads and files; called on deactivation and at exit, also after the regular end of a run."""

    @property
    def listens_at_exit(self) -> bool:
        """Whether this node still takes what is under way to it before it leaves."""
        return False

    def drained(self) -> bool:
        """Tell whether nothing is under way any more to a node that listens at exit."""
        return True

    def reset_blocks(self) -> None:
        """Return blocks and counters to the beginning."""

    def retune(self, parameters) -> None:
        """Take changed parameters without a jump."""

    def on_running(self, running: bool) -> None:
        """``~/start`` (True) or ``~/stop`` (False) was called."""

    def hindrance(self) -> str:
        """Say why this node does not work though nobody has stopped it; empty when it does."""
        return "" if self.active else "inactive: activate it first"

    def stopped(self) -> str:
        """Say what ``~/stop`` has done."""
        return "stopped"

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs; empty when nobody is awaited."""
        return ""

    def log_change(self, action: str, parameters: dict | None = None) -> None:
        """Publish what was changed and from which sample on, so that a recorded run can be repeated."""
        entry = {"sample": self.sample, "node": self.kind, "action": action, **self.change_details()}
        self.changes.publish({**entry, "parameters": parameters or {}})

    def change_details(self) -> dict:
        """Return what else a change's log says: what of the sample has been done before."""
        return {}

    def health(self) -> tuple[int, str, dict]:
        """Return diagnostic level (0 OK, 1 warning, 2 error), message and further values."""
        return 0, "", {}

    # -- lifecycle ---------------------------------------------------------------------------------------------

    def on_configure(self, state):
        """Read and check the parameters, build the blocks, connect the topics."""
        try:
            self.parameters = self.interface.read()
            self.build(self.parameters)
            self.runner = self.make_runner()
            self._connect()
        except HysteresisError as error:
            problems = error.problems if isinstance(error, ParameterError) else (error,)
            return self._not_configured(problems, 2)
        except Exception as error:  # rclpy would swallow it without a word
            return self._not_configured((f"{type(error).__name__}: {error}",), 1)
        self.failure, self.exit_code = "", 0
        return super().on_configure(state)

    def _not_configured(self, problems, exit_code: int):
        lines = [" ".join(str(problem).split()) for problem in problems]
        for line in lines:
            self.get_logger().error(f"not configured: {line}")
        self.failure, self.exit_code = f"not configured: {'; '.join(lines)}", exit_code
        self._disconnect()
        return TransitionCallbackReturn.FAILURE

    def _connect(self) -> None:
        self.pace = self.runner.make_pace()
        names = self.state_names = tuple(self.state_signals()) if self.has_state else ()
        self._state = JointState(name=list(names), position=array("d", bytes(8 * len(names))))
        self._state_publisher = self.publisher(JointState, "~/state", self.qos()) if names else None
        if names:
            self.changes.open(self.publisher(String, "changes", self.changes_qos()), self.parameters.to_mapping())
        self.runner.connect()
        self.connect()

    def _disconnect(self) -> None:
        self.unbuild()
        for destroy, handle in self._topic_handles:
            destroy(handle)
        self._topic_handles.clear()
        self._loop_publishers.clear()
        self.partners.clear()
        self.masters.clear()
        self.interface.typed = None
        self.parameters = None
        self.changes.close()

    def on_activate(self, state):
        """Start working."""
        try:
            require_alone(self)
            self.active, self.active_since = True, time.monotonic()
            self.pace.restart()
            self.runner.begin()
            self.begin()
            self.masters.begin()
        except HysteresisError as error:
            self.get_logger().error(f"not activated: {error}")
            self.exit_code = 2
            self._stop_working()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # rclpy would swallow it without a word
            self.fail(f"not activated: {type(error).__name__}: {error}")
            self._stop_working()
            return TransitionCallbackReturn.FAILURE
        self.get_logger().info(introduction(self))
        return super().on_activate(state)

    def on_deactivate(self, state):
        """Stop working; outputs go to their safe values. A lockstep run is over: the next one starts at sample 0."""
        self.runner.part()
        self.runner.go_safe()
        self._stop_working()
        self.runner.end()
        self.tell_health()
        return super().on_deactivate(state)

    def _stop_working(self) -> None:
        self.active = False
        self.release()
        for timer in self._work_timers:
            self.destroy_timer(timer)
        self._work_timers.clear()

    def on_cleanup(self, state):
        """Let go of topics and blocks; a loop that has this node's part ends with them."""
        if self.is_fused:
            self.fused.lose_a_part()
        self._disconnect()
        self.running = True
        return super().on_cleanup(state)

    def on_shutdown(self, state):
        """Leave from any state: outputs go to their safe values first."""
        if self.active:
            self.runner.part()
            self.runner.go_safe()
        self._stop_working()
        self.finished = True
        self.tell_health()
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Leave the graph, and the axis in this process."""
        if self.fused is not None:
            self.fused.part(self)
        super().destroy_node()

    # -- services and parameters -------------------------------------------------------------------------------

    def _on_start(self, request, response):
        return self._set_running(response, True)

    def _on_stop(self, request, response):
        return self._set_running(response, False)

    def _set_running(self, response, running: bool):
        if self.parameters is not None and self.running != running:
            self.running = running
            self.pace.restart()
            self.on_running(running)
        response = self._answer_service(response, "running" if running else "stopped")
        if response.success and not running:
            response.message = self.stopped()
        hindrance = self.hindrance() if running and response.success else ""
        if hindrance:
            response.success, response.message = False, f"not running: {hindrance}"
        return response

    def _on_reset(self, request, response):
        before = ""
        if self.parameters is not None:
            self.runner.require_rest()
            before = self.hindrance()
            lost = self.runner.missing_partners()
            before = f"{lost} is lost" if lost else before
            self.failure, self.exit_code = "", 0
            self.masters.release()
            self.pace.restart()
            self.runner.clear()
            if self.runner.by_message:
                self.reset_blocks()
            self.runner.begin_again()
        answer = self._answer_service(response, "reset")
        if answer.success:
            stopped = "; stopped: ~/start lets it go on" if not self.running else ""
            still = f"; before it did not work: {before}; if that is still so, it does not now" if before else ""
            answer.message = f"reset{stopped}{still}"
        return answer

    def _answer_service(self, response, done: str):
        response.success = self.parameters is not None
        response.message = done if response.success else "not configured yet"
        return response

    def _retune(self, parameters) -> None:
        before, after = self.parameters.to_mapping(), parameters.to_mapping()
        changed = {name: value for name, value in after.items() if value != before.get(name)}
        if self.is_fused:
            self.fused.apply(self.kind, "retune", changed)
            self.retuned(parameters)
            self.parameters = parameters
        else:
            self.retune(parameters)
            self.retuned(parameters)
            self.parameters = parameters
            self.log_change("retune", changed)

    def retuned(self, parameters) -> None:
        """The part has taken changed parameters; those of before are still in :attr:`parameters`."""

    @property
    def is_fused(self) -> bool:
        """Whether a loop makes the samples of this node now."""
        return self.fused is not None and self.fused.loop is not None

    def take_part(self, part) -> None:
        """Show this part of a loop from now on, in the place of the node's own."""
        self.part = part

    # -- the run -------------------------------------------------------------------------------------------------

    def subscribe_end(self) -> None:
        """Listen for the end mark of the plant: the number of samples of the run."""
        self.subscriber(UInt64, "end_of_run", self._on_end, latched_qos())

    def _on_end(self, message) -> None:
        if self.runner.is_old_end(message.data):
            return
        self.end_of_run = message.data
        if self.active and not self.runner.exact:
            self.leave_when_done()

    def sample_of(self, stamp) -> int:
        """Return the number of the sample with this stamp."""
        return round((stamp.sec + stamp.nanosec * 1e-9) * self.parameters.sample_rate)

    def is_done(self) -> bool:
        """Tell whether the last sample of the run has been answered."""
        return self.sample >= self.end_of_run

    def leave_when_done(self) -> None:
        """End the log of changes if the run is over, and leave if the parameter exit_at_end says so."""
        if self.is_done() or not self.runner.exact:
            self.changes.end(self.end_of_run)
            self.finished |= self.parameters.exit_at_end

    def fail(self, text: str, exit_code: int = 1, announce: bool = True) -> None:
        """End the run with an error; the node answers no more samples, and in lockstep the others are told the same."""
        if self.failure:
            return
        self.failure, self.exit_code = text, exit_code
        self.get_logger().error(text)
        if announce and self.runner is not None:
            self.runner.announce(text)

    def since_report(self, key: str, count: int) -> int:
        """Return by how much a counter has grown since it was last reported."""
        before, self._reported[key] = self._reported.get(key, 0), count
        return max(count - before, 0)

    def tell_health(self) -> None:
        """Publish how this node is, whatever the state of its life."""
        self._diagnostics.publish(diagnostics(self))
