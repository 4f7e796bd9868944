# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The node of the page: it subscribes to an axis, calls its services, and records it on request."""

from __future__ import annotations

import math
import os
import pathlib
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.qos import qos_profile_parameter_events
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger

from hysteresis_ros import signals
from hysteresis_ros.analysis.metrics import reference_delay
from hysteresis_ros.errors import HysteresisError, RecordingError
from hysteresis_ros.laboratory.watch.access import SERVICES
from hysteresis_ros.laboratory.watch.memory import Collector, Memory, Plane, motor_facts
from hysteresis_ros.laboratory.watch.views import axis_of, limits_of, table_of
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.nodes.qos import diagnostics_qos, latched_qos, loop_qos, sensor_qos, setpoint_qos
from hysteresis_ros.nodes.remote.client import AbsentError, Client, axis_nodes
from hysteresis_ros.nodes.remote.commands import change, plain_value, values_of
from hysteresis_ros.nodes.samples import TOPIC, Block, block_of, samples_qos
from hysteresis_ros.nodes.security.policy import PAGE, Profile
from hysteresis_ros.nodes.spin import make_executor
from hysteresis_ros.recordings.bag_writer import BagWriter, GuardedBag, require_space
from hysteresis_ros.recordings.provenance import RECORD, provenance
from hysteresis_ros.recordings.run_bag import AxisTopics, SampleWriter

#: Topic of markers.
MARKER = "marker"
#: Interval at which the recording is flushed to the operating system [s].
FLUSH = 0.25


class PageRecording:
    """One bag, from one press of the record button to the next."""

    def __init__(self, folder: pathlib.Path, axis: AxisParameters, joints: tuple[str, ...]):
        plant, prefix = axis.plant_simulator, axis.namespace
        path = _unused(folder / time.strftime("watch_%Y%m%d_%H%M%S"))
        require_space(path, axis.recorder.min_space)
        bag = BagWriter(path)
        bag.describe(RECORD, provenance())
        self._bag = GuardedBag(bag, FLUSH)
        self._space = axis.recorder.min_space
        for topic in ("configuration", "changes", MARKER):
            bag.add_topic(f"{prefix}/{topic}", "std_msgs/msg/String", "transient_local")
        bag.write_string(f"{prefix}/configuration", axis.configuration_text(), time.time_ns())
        topics = AxisTopics(prefix, joints, plant.sample_rate, axis.kind, plant.resting_effort, not plant.driver)
        self._samples = SampleWriter(bag, topics, chunk_time=FLUSH)
        self._prefix = prefix

    @property
    def path(self) -> pathlib.Path:
        """Path of the bag."""
        return self._bag.path

    @property
    def stopped(self) -> str:
        """Why the recording has stopped; empty while it runs."""
        return self._bag.stopped

    @property
    def samples(self) -> int:
        """Samples recorded so far."""
        return self._samples.sample_count

    def write(self, block: Block) -> None:
        """Write samples."""
        self._bag.attempt(lambda bag: self._samples.write(block.stamps, block.table, joints=block.joints))
        self._bag.tend(self._space)

    def say(self, topic: str, text: str) -> None:
        """Write a text message to the bag."""
        self._bag.attempt(lambda bag: bag.write_string(f"{self._prefix}/{topic}", text, time.time_ns()))

    def finish(self) -> None:
        """Close the bag; an error is reported in :attr:`stopped`."""
        try:
            self._bag.finish()
        except RecordingError as error:
            self._bag.stopped = str(error)


def _unused(path: pathlib.Path) -> pathlib.Path:
    """Return a path that does not exist yet."""
    found, number = path, 1
    while found.exists():
        number += 1
        found = path.with_name(f"{path.name}_{number}")
    return found


#: Interval at which the nodes of the graph are checked [s].
LOOK = 1.0
#: Time-out of an answer [s].
ANSWER = 5.0
#: Names of the diagnostic levels.
LEVELS = ("ok", "warning", "error", "stale")
#: Nodes to start, in this order; nodes to stop if the plant does not belong to this package.
STARTED = (signals.PLANT, signals.COMPENSATOR, signals.CONTROLLER, signals.SOURCE, signals.MOTOR_SOURCE)
STOPPED = (signals.COMPENSATOR, signals.CONTROLLER, signals.SOURCE, signals.MOTOR_SOURCE)
#: Time in which the nodes must notice the start of the plant [s].
HEARS = 3.0
#: Polling interval during this time [s].
AGAIN = 0.05
#: Parameter services that are called.
PARAMETER_SERVICES = {
    "list_parameters": ListParameters,
    "get_parameters": GetParameters,
    "set_parameters_atomically": SetParametersAtomically,
}
#: Queue depth of the topics with one message per sample.
DEPTH = 1000


class AxisLink:
    """Connection to the nodes of an axis; :meth:`run` is its thread, in which :meth:`ask` executes jobs."""

    def __init__(self, namespace: str, folder: pathlib.Path, context: Context | None = None):
        self.namespace, self.folder = namespace, folder
        self.memory = Memory()
        self.values: dict[str, dict] = {}
        self.health: dict[str, dict] = {}
        self.refusals: list[str] = []
        self.recording: PageRecording | None = None
        #: Whether the axis is ready after its last move, and the predicted time until then [s]; NaN: not predicted.
        self.ready, self.ready_in = False, math.nan
        #: Namespaces of other axes.
        self.elsewhere: list[str] = []
        #: Increases whenever the parameters or the set of nodes change.
        self.version = 0
        self._axis: AxisParameters | None = None
        self._collector: Collector | None = None
        self._states: list = []
        self._changes: list[str] = []
        #: The plane of this axis and another axis of its stage.
        self.plane = Plane()
        self._neighbour = ""
        self._beside: list = []
        self._beside_collector: Collector | None = None
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Future]] = queue.SimpleQueue()
        executor = make_executor if context is None else None
        self._client = Client(namespace, ANSWER, context or rclpy.get_default_context(), executor)
        self._client.__enter__()
        self._connect()

    # -- the thread ------------------------------------------------------------------------------------------------

    def run(self, over: threading.Event) -> None:
        """Process messages and requests until ``over`` is set; the main function of a thread."""
        try:
            looked = -math.inf
            while not over.is_set():
                self._client.hear()
                if self._collector is not None:
                    self._take(self._collector.take())
                if self._beside_collector is not None:
                    self.plane.add(self._neighbour, self._beside_collector.take())
                while not self._jobs.empty():
                    self._do(*self._jobs.get())
                if time.monotonic() - looked > LOOK:
                    self._look()
                    looked = time.monotonic()
        finally:
            if self.recording is not None:
                self.recording.finish()
            self.close()

    @property
    def node(self):
        """The ROS node of the page."""
        return self._client.node

    def close(self) -> None:
        """Leave the graph; :meth:`run` does so at its end."""
        self._client.__exit__()

    def _connect(self) -> None:
        node, name = self._client.node, self._client.full_name
        self._setpoints = node.create_publisher(Float64, name("setpoint"), setpoint_qos())
        self._speeds = node.create_publisher(Float64, name("speed"), setpoint_qos())
        self._stops = node.create_publisher(Bool, name("estop"), setpoint_qos())
        self._markers = node.create_publisher(String, name(MARKER), setpoint_qos())
        self._triggers = {kind: self._client.make_client(Trigger, name(f"{kind}/stop")) for kind in STOPPED}
        hear = node.create_subscription
        hear(Float64MultiArray, name(f"{signals.PLANT}/{TOPIC}"), self._on_block, samples_qos())
        hear(DiagnosticArray, "/diagnostics", self._on_health, diagnostics_qos())
        hear(ParameterEvent, "/parameter_events", self._on_parameters, qos_profile_parameter_events)
        hear(String, name("changes"), self._on_change, loop_qos(True, DEPTH))
        hear(Bool, name("ready"), self._on_ready, latched_qos())
        hear(Float64, name("ready_in"), self._on_ready_in, latched_qos())
        for source in (signals.SOURCE, signals.MOTOR_SOURCE):
            hear(String, name(f"{source}/refused"), self._on_refused, setpoint_qos())

    def _on_ready(self, message: Bool) -> None:
        self.ready = message.data

    def _on_ready_in(self, message: Float64) -> None:
        self.ready_in = message.data

    def _on_refused(self, message: Any) -> None:
        self._refused(message.data)

    @staticmethod
    def _do(job: Callable[[], Any], answer: Future) -> None:
        """Execute a job for a page, unless its request was cancelled; an error becomes the answer."""
        if not answer.set_running_or_notify_cancel():
            return
        try:
            answer.set_result(job())
        except HysteresisError as error:
            answer.set_exception(error)
        except Exception as error:  # one request must not end the server for all pages
            answer.set_exception(HysteresisError(f"{type(error).__name__}: {error}"))

    def ask(self, job: Callable[[], Any]) -> Future:
        """Run ``job`` in the thread; return the future of its result or error."""
        answer: Future = Future()
        self._jobs.put((job, answer))
        return answer

    # -- nodes of the axis -----------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Check which nodes have appeared and disappeared; request the parameters of new nodes."""
        found = axis_nodes(self._client.nodes())
        there = found.pop(self.namespace, [])
        self.elsewhere = sorted(found)
        for node in [node for node in self.values if node not in there]:
            del self.values[node]
            self.health.pop(node, None)
            self._axis, self.version = None, self.version + 1
        for node in [node for node in there if node not in self.values and node in STARTED]:
            try:
                self.values[node] = values_of(self._client, self._client.full_name(node))
            except AbsentError:
                return  # the node is starting or exiting; the next check will show which
            self.version += 1
        if self._axis is None and len(self.values) >= len(signals.kind_of(self.values).nodes):
            self._introduce()
        self._look_beside(found)

    def _look_beside(self, others: dict[str, list[str]]) -> None:
        """Check whether the axis belongs to a stage, and choose the other axis for the plane that the page shows."""
        parent = self.namespace.rpartition("/")[0]
        secured = os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true"  # the page may read only its own axis
        is_stage = self._axis is not None and not secured and self.node.count_subscribers(f"{parent}/setpoints")
        whole = {
            space
            for space, nodes in others.items()
            if space.rpartition("/")[0] == parent and set(signals.ACTUATOR.nodes) <= set(nodes)
        }
        first = sorted(whole | {self.namespace})
        shown = [self.namespace, first[0] if first[0] != self.namespace else first[-1]] if is_stage and whole else []
        neighbour = shown[1] if shown else ""
        if neighbour == self._neighbour:
            return
        for subscription in self._beside:
            self.node.destroy_subscription(subscription)
        self._beside, self._beside_collector, self._neighbour = [], None, ""
        self.plane.choose({})
        if not neighbour:
            return
        try:
            given = values_of(self._client, f"{neighbour}/{signals.CONTROLLER}")
        except AbsentError:
            return  # the node is starting or exiting; the next check will show which
        self._neighbour = neighbour
        other = reference_delay(int(given.get("feedforward.preview", 0)), given.get("learning.type", "none"))
        previews = {self.namespace: self._reference_delay(), neighbour: other}
        self.plane.choose({space: previews[space] for space in sorted(shown)})
        if given.get("time_mode") == "fused":
            hear, topic = self.node.create_subscription, f"{neighbour}/{signals.PLANT}/{TOPIC}"
            self._beside = [hear(Float64MultiArray, topic, self._on_block_beside, samples_qos())]
        else:
            self._beside_collector = Collector(signals.ACTUATOR)
            self._beside = [self._hear_beside(neighbour, node) for node in signals.ACTUATOR.nodes]

    def _hear_beside(self, namespace: str, node: str):
        def take(message: JointState) -> None:
            if self._beside_collector is not None:
                self._beside_collector.add(node, message)

        return self.node.create_subscription(JointState, f"{namespace}/{node}/state", take, DEPTH)

    def _on_block_beside(self, message: Float64MultiArray) -> None:
        try:
            self.plane.add(self._neighbour, block_of(message))
        except HysteresisError as error:
            self._refused(str(error))

    def _introduce(self) -> None:
        """Read the parameters of the axis, and how it publishes its samples, once all nodes are present."""
        try:
            self._axis = axis_of(self.namespace, self.values)
        except HysteresisError as error:
            self._refused(f"the parameters of the nodes are inconsistent: {error}")
            return
        self._begin_anew()
        self.connect_to(self._axis)

    def connect_to(self, axis: AxisParameters) -> None:
        """Create all subscriptions, publishers and clients of an axis."""
        nodes = axis.kind.nodes
        for subscription in self._states:
            self.node.destroy_subscription(subscription)
        self._states, self._collector = [], None
        if axis.plant_simulator.time_mode != "fused":
            self._collector = Collector(axis.kind)
            self._states = [self._hear_state(node) for node in nodes]
        for full in map(self._client.full_name, nodes):
            for kind, service in PARAMETER_SERVICES.items():
                self._client.make_client(service, f"{full}/{kind}")
            self._client.make_client(Trigger, f"{full}/start")
        for service in SERVICES if axis.kind.motor else ():
            self._client.make_client(Trigger, self._client.full_name(f"{signals.MOTOR_SOURCE}/{service}"))

    def _hear_state(self, node: str):
        def take(message: JointState) -> None:
            if self._collector is not None:
                self._collector.add(node, message)

        return self._client.node.create_subscription(JointState, self._client.full_name(f"{node}/state"), take, DEPTH)

    def _reference_delay(self) -> int:
        """Return the delay of the axis behind its reference [samples]."""
        if self._axis is None:
            return 0
        controller = self._axis.motion_controller
        return reference_delay(controller.feedforward.preview, controller.learning.type)

    def _begin_anew(self) -> None:
        axis = self._axis
        if axis is not None:
            self.memory.restart(axis.plant_simulator.sample_rate, self._reference_delay(), axis.kind.motor)

    # -- subscriptions ---------------------------------------------------------------------------------------------

    def _on_block(self, message: Float64MultiArray) -> None:
        try:
            self._take(block_of(message))
        except HysteresisError as error:
            self._refused(str(error))

    def _take(self, block: Block) -> None:
        if self._axis is None or not block.numbers.size:
            return
        if not self.memory.add(block):
            # the sample numbers went back: the axis has restarted, perhaps with other parameters
            self.values.clear()
            self._axis, self.version = None, self.version + 1
            return
        self.plane.add(self.namespace, block)
        if self.recording is not None:
            self.recording.write(block)

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            space, _, node = status.name.partition(":")[0].rpartition("/")
            if space == self.namespace:
                values = {pair.key: pair.value for pair in status.values}
                level = LEVELS[min(ord(status.level), 3)]
                self.health[node] = {
                    "level": level,
                    "message": status.message,
                    "values": values,
                    "at": time.monotonic(),
                }

    def _on_parameters(self, message: ParameterEvent) -> None:
        space, _, node = message.node.rpartition("/")
        if space == self.namespace and node in self.values:
            new = {one.name: plain_value(one.value) for one in message.changed_parameters}
            self.values[node] = {**self.values[node], **new}
            self.version += 1

    def _on_change(self, message: String) -> None:
        self._write("changes", message.data)

    def _write(self, topic: str, text: str) -> None:
        if self.recording is not None:
            self.recording.say(topic, text)

    def _refused(self, text: str) -> None:
        self.refusals = [*self.refusals[-20:], text]

    # -- state for the page ----------------------------------------------------------------------------------------

    def tables(self) -> dict:
        """Return the data of a page except signals: parameters with units and ranges, and limits."""
        values = dict(self.values)
        axis = self._axis
        return {
            "namespace": self.namespace or "/",
            "nodes": {node: table_of(node, values[node]) for node in STARTED if node in values},
            "limits": limits_of(values),
            "mode": axis.plant_simulator.time_mode if axis else "",
            "rate": axis.plant_simulator.sample_rate if axis else None,
            "motor": motor_facts(axis) if axis else None,
        }

    def state(self) -> dict[str, float]:
        """Return the known fields of the reference source's ``~/state`` that show whether it moves, by name."""
        places = {"mode": signals.SOURCE_MODE, "error": signals.ERROR, "phase": signals.PHASE}
        known = {name: self.memory.value(place) for name, place in places.items()}
        return {name: value for name, value in known.items() if not math.isnan(value)}

    @property
    def source(self) -> str:
        """Full name of the node that takes setpoints."""
        return self._client.full_name(signals.kind_of(self.values).source)

    # -- requests, in the thread -------------------------------------------------------------------------------------

    def change(self, node: str, values: dict[str, str]) -> str:
        """Set parameters of a node, all or none; return the text of the answer."""
        known = self.values.get(node)
        if known is None:
            raise AbsentError(f"no node {node}; there are {', '.join(self.values) or 'none'}")
        for name in values:
            if name not in known:
                raise HysteresisError(f"{node} has no parameter {name}")
        change(self._client, self._client.full_name(node), values)
        return f"{', '.join(f'{name} = {value}' for name, value in values.items())}"

    def start(self) -> str:
        """Start all stopped nodes and the waveform; return the text of the answer."""
        said: list[str] = []
        deadline = time.monotonic() + HEARS
        for node in [node for node in STARTED if node in self.values]:
            answer = self._client.ask(Trigger, self._client.full_name(f"{node}/start"))
            # the other nodes notice the start of the plant with their next sample
            while not answer.success and said and time.monotonic() < deadline:
                time.sleep(AGAIN)
                answer = self._client.ask(Trigger, self._client.full_name(f"{node}/start"))
            if not answer.success:
                raise HysteresisError(f"{node} refuses to start: {answer.message}")
            said.append(node)
        if not said:
            raise AbsentError("no node of an axis is running; start the axis with `hysteresis up`")
        return "started"

    def hold(self) -> str:
        """Hold the reference at its present value; return the text of the answer."""
        self.call("stop")
        return "the reference is held; start resumes it"

    def call(self, service: str) -> str:
        """Call a service of the reference source; return its message."""
        answer = self._client.ask(Trigger, f"{self.source}/{service}")
        if not answer.success:
            raise HysteresisError(f"{self.source} refuses to {service}: {answer.message}")
        return answer.message

    def record(self, on: bool) -> str:
        """Begin or end a recording; return the text of the answer."""
        if not on:
            if self.recording is None:
                return "no recording is running"
            done, self.recording = self.recording, None
            done.finish()
            return f"recorded: {done.path}, {done.samples} samples{'; ' if done.stopped else ''}{done.stopped}"
        if self.recording is not None and not self.recording.stopped:
            return f"already recording into {self.recording.path}"
        if self._axis is None:
            raise AbsentError("nodes of the axis are missing: nothing to record")
        axis = axis_of(self.namespace, self.values)
        if axis.kind.motor and self._collector is not None:
            raise HysteresisError(
                "this page records a motor only if the axis is fused; record this axis with `up --record`"
            )
        self.recording = PageRecording(self.folder, axis, self._joints())
        return f"recording into {self.recording.path}"

    # -- requests, from any thread -----------------------------------------------------------------------------------

    def move(self, metres: float) -> None:
        """Publish a setpoint [m]."""
        self._setpoints.publish(Float64(data=metres))

    def walk(self, speed: float) -> None:
        """Publish the walking speed of a motor [m/s]."""
        self._speeds.publish(Float64(data=speed))

    def mark(self, text: str) -> None:
        """Publish a marker, and write it into the recording; must be called through :meth:`ask`."""
        self._markers.publish(String(data=text))
        self._write(MARKER, text)

    def stop(self) -> None:
        """Publish a stop for the plant; if the plant does not belong to this package, also stop all other nodes."""
        self._stops.publish(Bool(data=True))
        if signals.PLANT not in self.values:
            for client in self._triggers.values():
                if client.service_is_ready():
                    client.call_async(Trigger.Request())

    def _joints(self) -> tuple[str, ...]:
        """Return the names of the joints, in the order in which ``joint_states`` contains them."""
        heard: list[JointState] = []
        topic = self._client.full_name("joint_states")
        subscription = self._client.node.create_subscription(JointState, topic, heard.append, sensor_qos())
        try:
            if not self._client.until(lambda: heard):
                raise AbsentError(f"no message on {topic}: nothing to record")
            return tuple(heard[0].name)
        finally:
            self._client.node.destroy_subscription(subscription)


def profile(axes: list[AxisParameters], context: Context, used_by: Callable[[Any], Profile]) -> Profile:
    """Return the topics and services that the page of an axis uses, with ``*`` in place of the process id."""
    (axis,) = axes
    link = AxisLink(axis.namespace, pathlib.Path(), context)
    try:
        link.connect_to(axis)
        own = used_by(link.node)
    finally:
        link.close()
    numbered = f"_hysteresis_{os.getpid()}"
    serves = tuple(sorted(name.replace(numbered, "_hysteresis_*") for name in own.serves))
    # subscribed only while a recording begins
    hears = tuple(sorted({*own.hears, f"{axis.namespace}/joint_states"}))
    return replace(own, node=PAGE, serves=serves, hears=hears)
