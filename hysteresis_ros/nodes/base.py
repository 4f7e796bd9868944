# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Base of the nodes of an axis: lifecycle, topics, change log, diagnostics; the last class, ``AxisNode``, joins them.

The topic ``changes`` logs the initial parameters of a node and every change at run time. Entries are numbered, so that
a recorder detects missing ones; the last entry marks the end of the run. A recorder in the process of a fused loop
reads entries and samples directly, because messages could arrive later than the samples, or not at all.
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
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, NodeParameters
from hysteresis_ros.nodes.domain import named
from hysteresis_ros.nodes.fused import Fused
from hysteresis_ros.nodes.lockstep import Lockstep, Partners
from hysteresis_ros.nodes.masters import Masters, require_alone
from hysteresis_ros.nodes.parameters import GuardedServices, ParameterInterface, TabledParameters, answered
from hysteresis_ros.nodes.qos import latched_qos, loop_qos
from hysteresis_ros.nodes.realtime import RealTime
from hysteresis_ros.nodes.timing import OVERRUN, Pace
from hysteresis_ros.signals import CONFIGURED, ENDED

#: The method of rclpy that answers ``change_state``.
_CHANGE_STATE = "_LifecycleNodeMixin__on_change_state"


class GuardedLifecycleNode(GuardedServices, LifecycleNode):
    """A lifecycle node that refuses transitions that its state does not allow.

    Up to rclpy 7.1.6 a ``change_state`` request for such a transition raises an exception in the executor. This ends
    the process without moving its outputs to safe values (ros2/rclpy, issue 1209).
    """

    def __init__(self, name: str, **options):
        super().__init__(name, **options)
        self.guard_services()

    # Python prefixes a private name with the name of its class in rclpy, so the service calls the method by this name.
    def _LifecycleNodeMixin__on_change_state(self, request, response):
        wanted = request.transition
        allowed = {number: label for number, label, *_ in self._state_machine.available_transitions}
        if not wanted.label and wanted.id not in allowed:
            now = self._state_machine.current_state[1]
            names = ", ".join(f"{label} ({number})" for number, label in allowed.items())
            self.get_logger().warning(f"transition {wanted.id} refused: the node is {now}, which allows {names}")
            response.success = False
            return response
        return getattr(super(), _CHANGE_STATE)(request, response)

    @property
    def autostart(self) -> bool:
        """Whether the node configures and activates itself."""
        return self.get_parameter("autostart").value is not False

    def configure_now(self) -> bool:
        """Configure the node; return False if that failed."""
        return self.trigger_configure() == TransitionCallbackReturn.SUCCESS

    def activate_now(self) -> bool:
        """Activate the node; return False if that failed."""
        return self.trigger_activate() == TransitionCallbackReturn.SUCCESS


class Endpoints(Node):
    """Mixin that creates publishers, subscriptions and timers; name it before rclpy's node class."""

    parameters: Any  #: Typed parameters of this kind of node; None while it is not configured.
    runner: Any  #: The runner, which decides when a sample is processed; None before the node is configured.
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
        """Quality of service of the change log, which keeps entries for a recorder that starts later."""
        return loop_qos(True, self.parameters.queue_depth)

    def publisher(self, message_type, topic: str, qos, loop: bool = False):
        """Create a publisher that exists until cleanup; with ``loop``, lockstep waits for its subscription."""
        made = self.create_publisher(message_type, topic, qos, event_callbacks=self.compatibility.of_publisher(topic))
        self._topic_handles.append((self.destroy_publisher, made))
        if loop:
            self._loop_publishers.append(made)
        return made

    def subscriber(self, message_type, topic: str, callback, qos, raw: bool = False, partner: str = ""):
        """Create a subscription that exists until cleanup; in lockstep the publishing node ``partner`` is monitored."""
        events = self.compatibility.of_subscription(topic)
        made = self.create_subscription(message_type, topic, callback, qos, raw=raw, event_callbacks=events)
        self._topic_handles.append((self.destroy_subscription, made))
        if partner:
            self.partners.add(made.topic_name, partner)
        return made

    def loop_input(self, message_type, topic: str, callback, qos, partner: str):
        """Create a subscription of the loop; it has one publisher, which must not change during a run in lockstep."""
        if self.runner.exact:
            return self.subscriber(message_type, topic, callback, qos, partner=partner)
        return self.masters.add(message_type, topic, callback, qos, self.compatibility.of_subscription(topic))

    @property
    def loop_topics(self) -> list[str]:
        """Full names of the loop's topics that this node publishes."""
        return [publisher.topic_name for publisher in self._loop_publishers]

    def drop(self, subscription) -> None:
        """Destroy a subscription before cleanup."""
        self._topic_handles.remove((self.destroy_subscription, subscription))
        self.destroy_subscription(subscription)

    def timer(self, period: float, callback):
        """Create a timer on the steady clock that exists until deactivation."""
        made = self.create_timer(period, callback, clock=self.steady)
        self._work_timers.append(made)
        return made

    def all_matched(self) -> bool:
        """Return whether every publisher of the loop has a subscription."""
        return all(publisher.get_subscription_count() > 0 for publisher in self._loop_publishers)

    def publish_state(self, stamp, *values: float) -> None:
        """Publish ``~/state`` with the stamp of its measurement, in a message that is used again."""
        message = self._state
        message.header.stamp = stamp
        position = message.position
        for index, value in enumerate(values):
            position[index] = value
        self._state_publisher.publish(message)

    def warn(self, key: str, text: str, every: float = 1.0, error: bool = False) -> None:
        """Log a warning (or an error), for each ``key`` at most once in ``every`` seconds."""
        now = self.steady.now().nanoseconds
        if now - self._warned.get(key, -(10**18)) >= every * 1e9:
            self._warned[key] = now
            # two calls, because rclpy allows only one severity per line of code
            if error:
                self.get_logger().error(text)
            else:
                self.get_logger().warning(text)

    def wait_acknowledged(self, deadline: float) -> None:
        """Wait until all published messages are acknowledged, or ``time.monotonic()`` reaches ``deadline``."""
        for _, handle in self._topic_handles:
            if hasattr(handle, "wait_for_all_acked"):
                handle.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))


class ChangeLog:
    """Change log of one node on the topic ``changes``; it publishes nothing before :meth:`open`."""

    def __init__(self, node: str):
        self._node = node
        self._entries: deque[str] = deque()
        self._made = 0
        self.close()

    def open(self, publisher, parameters: dict) -> None:
        """Start the log with the parameters of the configured node."""
        self._publisher, self._number, self._is_over = publisher, 0, False
        self._entries = deque(maxlen=publisher.qos_profile.depth)
        self.publish({"sample": 0, "node": self._node, "action": CONFIGURED, "parameters": parameters})

    def close(self) -> None:
        """Stop publishing entries."""
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
        """Return all entries but the first ``made``, as JSON, and the number of entries so far."""
        new = min(self._made - made, len(self._entries))
        return list(self._entries)[len(self._entries) - new :], self._made

    def end(self, sample: int, stopped: bool = False) -> None:
        """Publish the end of the run at a sample, once; later entries do not belong to the run."""
        if not self._is_over:
            self._is_over = True
            extra = {"stopped": True} if stopped else {}
            self.publish({"sample": sample, "node": self._node, "action": ENDED, "parameters": {}, **extra})


#: Topics with configurable reliability, and the parameter that sets it.
CHOSEN = {"joint_states": "measurement_reliability", "setpoint": "setpoint_reliability"}


def unheard(offered, asked, chosen_by: str) -> str:
    """Return why a subscription does not match a publisher, with a remedy; empty if it matches."""
    best_effort, reliable = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
    if offered.reliability == best_effort and asked.reliability == reliable:
        choice = f"set {chosen_by}: best_effort here, or " if chosen_by else ""
        return f"offers best effort, but reliable is requested: {choice}make the publisher reliable"
    latched, volatile = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
    if offered.durability == volatile and asked.durability == latched:
        return "offers volatile, but transient local is requested: make the publisher transient local"
    return ""


class Compatibility:
    """Finds endpoints with incompatible quality of service on the topics of a node."""

    def __init__(self, node):
        self._node = node
        self._suspected: dict[str, str] = {}

    def of_subscription(self, topic: str) -> SubscriptionEventCallbacks:
        """Return the callbacks for events about publishers that are incompatible with a subscription."""
        chosen_by = CHOSEN.get(topic, "")
        return SubscriptionEventCallbacks(incompatible_qos=lambda event: self._suspect(topic, chosen_by))

    def of_publisher(self, topic: str) -> PublisherEventCallbacks:
        """Return the callbacks for events about subscriptions that are incompatible with a publisher."""
        return PublisherEventCallbacks(incompatible_qos=lambda event: self._suspect(topic, ""))

    def _suspect(self, topic: str, chosen_by: str) -> None:
        self._suspected[topic] = chosen_by
        self.complaint()

    def complaint(self) -> str:
        """Return the incompatible endpoints, and log them at intervals; empty if all are connected."""
        found = [text for topic in tuple(self._suspected) for text in self._look(topic)]
        for text in found:
            self._node.warn(f"qos {text}", text, every=10.0)
        return "; ".join(found)

    def _look(self, topic: str) -> list[str]:
        """Return the incompatible endpoints of a topic; a topic without such endpoints is no longer monitored."""
        node, chosen_by = self._node, self._suspected[topic]
        full, own = node.resolve_topic_name(topic), node.get_fully_qualified_name()
        found = set()
        subscriptions = node.get_subscriptions_info_by_topic(full)
        for publisher in node.get_publishers_info_by_topic(full):
            for subscription in subscriptions:
                reason = unheard(publisher.qos_profile, subscription.qos_profile, chosen_by)
                talks, hears = named(publisher), named(subscription)
                if reason and hears == own:
                    found.add(f"{full}: nothing is received from {talks}, which {reason}")
                elif reason and talks == own:
                    found.add(f"{full}: {hears} receives nothing from this node, which {reason}")
        if not found:
            del self._suspected[topic]
        return sorted(found)


#: Diagnostic levels: normal; needs attention; the axis does not follow its commands; the node has exited.
OK, WARN, ERROR, STALE = range(4)

#: Component that a status describes; it follows the node name in the status name, as diagnostic aggregators expect.
ITEM = "axis"

#: Time after activation from which missing inputs are an error [s].
START_UP = 10.0


def diagnostics(node, busy: str = "") -> DiagnosticArray:
    """Return the diagnostics of a node: level, message and values; ``busy``: why it answers nothing at present."""
    level, text, table = (WARN, busy, {}) if busy else _at_work(node) if node.active else _at_rest(node)
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
    """Return level, message and values of a node that is not active."""
    name = node.get_fully_qualified_name()
    if node.failure:
        return ERROR, node.failure, {}
    if node.leaving or node.finished:
        return STALE, "left", {}
    if node.parameters is None:
        return WARN, f"unconfigured: ros2 lifecycle set {name} configure", {}
    return WARN, f"inactive: ros2 lifecycle set {name} activate", {}


def _at_work(node) -> tuple[int, str, dict]:
    """Return level, message and values of an active node."""
    rate, jitter = node.pace.read()
    level, text, values = node.health()
    # only the plant counts late samples; other nodes count their late inputs
    counted = node.kind == "plant_simulator" or node.is_fused
    late = 0 if counted else node.since_report("late_inputs", node.pace.overruns)
    if node.failure:
        level, text = ERROR, node.failure
    elif not node.running:
        level, text = max(level, WARN), text or "stopped"
    elif level == ERROR and not node.sample and time.monotonic() - node.active_since < START_UP:
        level = WARN  # the other nodes are still starting
    elif late and not level:
        level, text = WARN, f"{late} late inputs: each more than {OVERRUN:g} periods after the previous one"
    contested = "" if node.runner.exact else node.masters.complaint()  # in lockstep a second publisher ends the run
    if contested:
        node.warn("others", contested, every=10.0, error=True)
        level, text = ERROR, f"{text}; {contested}" if text else contested
    unconnected = node.compatibility.complaint()
    if unconnected:
        level, text = max(level, WARN), f"{text}; {unconnected}" if text else unconnected
    table = {"rate_hz": f"{rate:.3f}", "jitter_p99_s": f"{jitter:.6f}", "samples": node.pace.total}
    return level, text, table | ({} if counted else {"late_inputs": node.pace.overruns}) | values


def introduction(node) -> str:
    """Return the log message of an activated node: its identity, sample rate and time mode."""
    values = node.parameters.to_mapping()
    words = [f"{name} {values[name]}" for name in node.identity if values.get(name)]
    return ", ".join(["active", *words, f"{node.parameters.sample_rate:g} Hz", node.parameters.time_mode])


class AxisNode(TabledParameters, Endpoints, GuardedLifecycleNode):
    """Base of the nodes of an axis.

    Subclasses implement :meth:`build` (blocks from parameters), :meth:`connect` (publishers and subscriptions),
    :meth:`reset_blocks`, :meth:`retune`, and the processing of a sample; :attr:`runner` decides when a sample is
    processed (lockstep or real time). After wrong input or a failed run, :attr:`failure` is a sentence, and the node's
    process exits with :attr:`exit_code`.
    """

    #: Class of the node's parameters; None: the class in NODE_PARAMETERS under the node's name.
    parameters_class: type[NodeParameters] | None = None
    #: Whether the node has ``~/state``.
    has_state = True
    #: Time without a message [s] after which an input is missing; another publisher may then replace the silent one.
    patience: float = math.inf
    #: Whether the node's result is incomplete, which is possible even after a regular exit.
    has_lost: bool = False
    #: Whether this node can be reset on a running axis without a step of its output.
    rests: bool = True
    #: Fraction of partner_timeout after which this node reports a silent partner in lockstep. The fraction is smaller
    #: for a node that waits directly for the possible cause of the silence, so that the error names the cause and not
    #: another waiting node.
    share = 1.0
    #: Parameters that the log message at activation names.
    identity: tuple[str, ...] = ()
    #: Maximum time for which a node processes pending messages at exit [s].
    listens_for = 0.3
    #: Services std_srvs/Trigger; the method ``_on_NAME`` answers NAME.
    triggers: tuple[str, ...] = ("start", "stop", "reset")

    def __init__(self, name: str, **options):
        super().__init__(name, **options)
        self.kind = name
        self.state_names: tuple[str, ...] = ()
        self.interface = ParameterInterface(self, self.parameters_class or NODE_PARAMETERS[name], self._retune)
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.partners = Partners(self)
        self.masters = Masters(self)
        self.parameters = None
        self.runner = None
        #: In fused mode: the axis in this process to which this node belongs.
        self.fused: Any = None
        self.changes = ChangeLog(name)
        self.active = False
        #: Whether the process is about to exit.
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
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", latched_qos())
        self.create_timer(1.0, self.tell_health, clock=self.steady)
        for service in self.triggers:
            self.create_service(Trigger, f"~/{service}", answered(getattr(self, f"_on_{service}")))

    # -- what subclasses provide -------------------------------------------------------------------------------

    def build(self, parameters) -> None:
        """Create the blocks; raise HysteresisError if the parameters are inconsistent."""

    def unbuild(self) -> None:
        """Release the resources of :meth:`build`; called at cleanup, and if the configuration fails."""

    def connect(self) -> None:
        """Create publishers and subscriptions."""

    def begin(self) -> None:
        """Start work after activation."""

    def make_runner(self):
        """Return the runner, which decides when a sample is processed."""
        if self.parameters.time_mode == "fused":
            return Fused(self)
        return self.lockstep_runner(self) if self.parameters.time_mode == "lockstep" else self.real_time_runner(self)

    #: Classes of the runners for the time modes in which each node computes its part of a sample.
    lockstep_runner: Any = Lockstep
    real_time_runner: Any = RealTime

    @property
    def axis_kind(self) -> signals.AxisKind:
        """Kind of the axis (actuator or inchworm motor), which selects the signals of this node."""
        return signals.ACTUATOR

    def state_signals(self) -> dict[str, str]:
        """Return the content of ``~/state``: name in the message → signal."""
        return self.axis_kind.state(self.kind)

    @property
    def holds_time(self) -> bool:
        """Whether this node itself has stopped the time of the axis."""
        return False

    def go_safe(self) -> None:
        """Move the outputs to their safe values immediately; called on deactivation and at exit."""

    def release(self) -> None:
        """Release threads and files; called on deactivation and at exit, also after the regular end of a run."""

    @property
    def listens_at_exit(self) -> bool:
        """Whether this node processes pending messages before it exits."""
        return False

    def drained(self) -> bool:
        """Return whether a node that processes pending messages at exit has processed all."""
        return True

    def reset_blocks(self) -> None:
        """Reset blocks and counters."""

    def retune(self, parameters) -> None:
        """Apply changed parameters without a step of the output."""

    def on_running(self, running: bool) -> None:
        """Handle a call of ``~/start`` (True) or ``~/stop`` (False)."""

    def hindrance(self) -> str:
        """Return why this node does not run although it was not stopped by the user; empty if it runs."""
        return "" if self.active else "inactive: activate it first"

    def stopped(self) -> str:
        """Return a message about the effect of ``~/stop``."""
        return "stopped"

    def missing_partner(self) -> str:
        """Return the partner whose input for the present sample is missing; empty if all inputs have arrived."""
        return ""

    def log_change(self, action: str, parameters: dict | None = None) -> None:
        """Publish a change and the first sample that it affects, so that a recorded run can be repeated."""
        entry = {"sample": self.sample, "node": self.kind, "action": action, **self.change_details()}
        self.changes.publish({**entry, "parameters": parameters or {}})

    def change_details(self) -> dict:
        """Return further fields of a change entry, which state the steps of the sample that precede the change."""
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
        except Exception as error:  # rclpy would swallow it silently
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
        """Start work."""
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
        except Exception as error:  # rclpy would swallow it silently
            self.fail(f"not activated: {type(error).__name__}: {error}")
            self._stop_working()
            return TransitionCallbackReturn.FAILURE
        self.get_logger().info(introduction(self))
        return super().on_activate(state)

    def on_deactivate(self, state):
        """Stop work and move the outputs to their safe values; the next lockstep run starts at sample 0."""
        self.runner.leave()
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
        """Release topics and blocks; the fused loop of this node ends."""
        if self.is_fused:
            self.fused.lose_a_part()
        self._disconnect()
        self.running = True
        return super().on_cleanup(state)

    def on_shutdown(self, state):
        """Shut down from any state, after the outputs have moved to their safe values."""
        if self.active:
            self.runner.leave()
            self.runner.go_safe()
        self._stop_working()
        self.finished = True
        self.tell_health()
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Remove the node from the graph, and from the axis in this process."""
        if self.fused is not None:
            self.fused.leave(self)
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
            stopped = "; stopped: call ~/start to resume" if not self.running else ""
            still = f"; before the reset it did not run: {before}; it runs only when this is resolved" if before else ""
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
        """Handle changed parameters after :meth:`retune`; :attr:`parameters` still contains the previous ones."""

    @property
    def is_fused(self) -> bool:
        """Whether a fused loop computes the samples of this node now."""
        return self.fused is not None and self.fused.loop is not None

    def take_part(self, part) -> None:
        """Use this part of a fused loop instead of the node's own part."""
        self.part = part

    # -- the run -------------------------------------------------------------------------------------------------

    def subscribe_end(self) -> None:
        """Subscribe to the end mark of the plant, which is the number of samples of the run."""
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
        """Return whether the last sample of the run has been answered."""
        return self.sample >= self.end_of_run

    def leave_when_done(self) -> None:
        """End the change log if the run is over, and exit if the parameter exit_at_end is set."""
        if self.is_done() or not self.runner.exact:
            self.changes.end(self.end_of_run)
            self.finished |= self.parameters.exit_at_end

    def fail(self, text: str, exit_code: int = 1, announce: bool = True) -> None:
        """End the run with an error; the node answers no more samples, and lockstep informs the other nodes."""
        if self.failure:
            return
        self.failure, self.exit_code = text, exit_code
        self.get_logger().error(text)
        if announce and self.runner is not None:
            self.runner.announce(text)

    def since_report(self, key: str, count: int) -> int:
        """Return the increase of a counter since its last report."""
        before, self._reported[key] = self._reported.get(key, 0), count
        return max(count - before, 0)

    def tell_health(self, busy: str = "") -> None:
        """Publish the diagnostics of this node in any lifecycle state; ``busy``: why it answers nothing at present."""
        self._diagnostics.publish(diagnostics(self, busy))
