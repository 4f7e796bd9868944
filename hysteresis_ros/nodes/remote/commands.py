# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The commands ``hysteresis status|get|set|call|echo|setpoint|move|quiet``, executed by a node of the graph."""

from __future__ import annotations

import importlib
import json
import math
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import yaml
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from hysteresis_ros import signals
from hysteresis_ros.configuration import ARRAY_TYPES, NODE_NAMES, ParameterRow, parse_value
from hysteresis_ros.errors import HysteresisError, ParameterError, Problem, did_you_mean
from hysteresis_ros.nodes.domain import named
from hysteresis_ros.nodes.qos import diagnostics_qos, setpoint_qos
from hysteresis_ros.nodes.remote.client import DIAGNOSTICS, AbsentError, Client, axis_nodes
from hysteresis_ros.nodes.timing import LIMITED
from hysteresis_ros.signals import MOTOR_SOURCE, PLANT, kind_of
from hysteresis_ros.units import quantity_in, readable

#: Lifecycle transitions that the user can request.
TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "shutdown")
#: Time to wait for the log message that gives the reason of a refusal [s].
WORDS = 0.5


def call(client: Client, node: str, action: str) -> None:
    """Call a service or a lifecycle transition of a node, and print its answer."""
    full = client.find(node)
    if action in TRANSITIONS:
        _change(client, full, action)
        return
    offered = client.until(lambda: _triggers(client, full))
    if action not in offered:
        known = (*offered, *TRANSITIONS)
        raise HysteresisError(
            f"{full} has no service '{action}'; it has {', '.join(offered) or 'none'}, and the transitions "
            f"{', '.join(TRANSITIONS)}{did_you_mean(action, known)}"
        )
    answer = client.ask(Trigger, f"{full}/{action}")
    if not answer.success:
        raise HysteresisError(f"{full} refuses to {action}: {answer.message}")
    print(f"{full}: {answer.message or 'done'}", flush=True)


def lifecycle_states(client: Client, names: list[str]) -> dict[str, str]:
    """Request the lifecycle states of nodes in parallel, and return them; ``silent`` if a node does not answer."""
    asked = {name: client.node.create_client(GetState, f"{name}/get_state") for name in names}
    client.until(lambda: all(one.service_is_ready() for one in asked.values()))
    ready = {name: one for name, one in asked.items() if one.service_is_ready()}
    futures = {name: one.call_async(GetState.Request()) for name, one in ready.items()}
    client.until(lambda: all(future.done() for future in futures.values()))
    answers = {name: future.result().current_state.label for name, future in futures.items() if future.done()}
    return {name: answers.get(name, "silent") for name in names}


def _triggers(client: Client, full: str) -> list[str]:
    """Return the short names of a node's services without arguments."""
    namespace, _, name = full.rpartition("/")
    found = client.node.get_service_names_and_types_by_node(name, namespace or "/")
    own = [(service.removeprefix(f"{full}/"), kinds) for service, kinds in found]
    return sorted(service for service, kinds in own if kinds == ["std_srvs/srv/Trigger"])


def _change(client: Client, full: str, action: str) -> None:
    before = lifecycle_states(client, [full])[full]
    answer = client.ask(GetAvailableTransitions, f"{full}/get_available_transitions")
    possible = [described.transition.label for described in answer.available_transitions]
    if action not in possible:
        raise HysteresisError(f"{full} is {before}: {action} is not possible; possible: {' and '.join(possible)}")
    said: list[str] = []

    def listen(message: Log) -> None:
        if message.name == full.strip("/").replace("/", ".") and message.level >= 30:
            said.append(message.msg)

    ear = client.node.create_subscription(Log, "/rosout", listen, 100)
    request = ChangeState.Request()
    request.transition.label = action
    try:
        done = client.ask(ChangeState, f"{full}/change_state", request).success
        if not done:
            client.until(lambda: said, WORDS)
            why = "; ".join(said) or "see its log"
            raise HysteresisError(f"{full} is {before} and refuses to {action}: {why}")
    finally:
        client.node.destroy_subscription(ear)
    # a node that shuts down may exit before it answers
    after = "finalized" if action == "shutdown" else lifecycle_states(client, [full])[full]
    print(f"{full}: {before} → {after}", flush=True)


#: Names of the diagnostic levels.
LEVELS = ("ok", "warning", "error", "stale")
#: Sources of the last values: node whose ``~/state`` contains the value, name of the value there, unit.
LAST = (
    ("reference_generator", "setpoint", "m"),
    ("inchworm_sequencer", "setpoint", "m"),
    ("reference_generator", "reference", "m"),
    ("inchworm_sequencer", "reference", "m"),
    ("hysteresis_compensator", "voltage", "V"),
)
#: Messages for nodes without diagnostics.
MISSING = {"absent": "not found", "silent": "found, but did not answer"}
#: Time within which every node publishes its diagnostics at least once, with a margin [s].
REPORTED = 1.6


@dataclass
class NodeStatus:
    """Status of one node."""

    name: str  #: Full name.
    state: str  #: Lifecycle state; ``absent``: the node does not exist; ``silent``: it does not answer.
    level: str = ""  #: level, message: Last diagnostics; empty before the first.
    message: str = ""
    rate: float | None = None  #: Samples per second [Hz].

    @property
    def is_well(self) -> bool:
        """Whether the node is active and its diagnostics report no problem."""
        return self.state == "active" and self.level in ("ok", "")


@dataclass
class AxisStatus:
    """Status of one axis."""

    namespace: str
    nodes: list[NodeStatus]
    plant: str = ""  #: External node that publishes ``joint_states``; empty if ``plant_simulator`` publishes them.
    #: Last values in SI units; ``offset``: part of the displacement that the controller subtracts.
    last: dict[str, float] = field(default_factory=dict)
    #: Time before a deadline from which a fused loop polls the clock [µs], and the share of a core that polling takes
    #: [%].
    spin: tuple[float, float] = (0.0, 0.0)


def survey(client: Client) -> list[AxisStatus]:
    """Return the status of the running axes in all namespaces, or in the client's namespace if it has one."""
    reports: dict[str, tuple] = {}

    def hear(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            reports[status.name.removesuffix(": axis")] = (ord(status.level), status.message, values)

    # nodes of this package repeat their last report for a new subscriber; the first report of other nodes is their next
    # one
    for keeps in (True, False):
        client.node.create_subscription(DiagnosticArray, DIAGNOSTICS, hear, diagnostics_qos(keeps))

    def there() -> dict[str, list[str]]:
        """Return the nodes of each axis: those found by discovery, and senders of diagnostics that have arrived."""
        named_or_heard = sorted({*client.nodes(), *reports})
        return {
            space: names
            for space, names in axis_nodes(named_or_heard).items()
            if (not client.namespace or space == client.namespace) and {*names} & {*NODE_NAMES, MOTOR_SOURCE}
        }

    found = _complete(client, there)
    if not found:
        where = f" in {client.namespace}" if client.namespace else ""
        raise AbsentError(f"no axis{where} within {client.timeout:g} s; {client.who_is_there()}")
    last = {space: _listen(client, space, names) for space, names in sorted(found.items())}
    states = lifecycle_states(client, [f"{space}/{name}" for space, names in found.items() for name in names])
    active = {name for name, state in states.items() if state == "active"}

    def reported() -> bool:
        # the last report of a node may be older than its activation
        told = {name for name, (_, _, values) in reports.items() if "rate_hz" in values}
        places = [(space, node, signal) for space in found for node, signal, _ in LAST if f"{space}/{node}" in active]
        moved = all("displacement" in last[space] for space in found if f"{space}/{PLANT}" in active)
        return active <= told and moved and all(signal in last[space] for space, _, signal in places)

    client.until(reported, REPORTED)
    return [_axis(client, space, names, states, reports, last[space]) for space, names in sorted(found.items())]


def _complete(client: Client, there: Callable[[], dict[str, list[str]]]) -> dict[str, list[str]]:
    """Wait until all nodes of each axis are present and no more appear, or for the time-out; return the nodes."""
    known: dict[str, list[str]] = {}
    since = time.monotonic()

    def lacks(space: str, names: list[str]) -> bool:
        lacking = {*kind_of(names).nodes} - {*names}
        if lacking == {PLANT}:  # an external plant
            return not client.node.count_publishers(f"{space}/joint_states")
        return bool(lacking)

    def complete() -> bool:
        nonlocal known, since
        found = there()
        if found != known:
            known, since = found, time.monotonic()
        settled = time.monotonic() - since >= client.settles
        return bool(found) and settled and not any(lacks(space, names) for space, names in found.items())

    client.until(complete)
    return known


def _axis(client: Client, space: str, names: list[str], states: dict, reports: dict, last: dict) -> AxisStatus:
    nodes = []
    plant = ""
    for name in [*kind_of(names).nodes, *(["recorder"] if "recorder" in names else [])]:
        full = f"{space}/{name}"
        level, message, values = reports.get(full, (None, "", {}))
        word = "" if level is None else LEVELS[min(level, 3)]
        rate = float(values["rate_hz"]) if "rate_hz" in values else None
        if name == "plant_simulator" and name not in names:
            publishers = client.node.get_publishers_info_by_topic(f"{space}/joint_states")
            plant = ", ".join(map(named, publishers))
            if plant:
                continue
        state = states.get(full, "absent")
        if state in MISSING and (not message or word == "ok"):
            word, message = "", f"{MISSING[state]} within {client.timeout:g} s"
        nodes.append(NodeStatus(full, state, word, message, rate))
    timing = reports.get(f"{space}/plant_simulator", (None, "", {}))[2]
    spin = float(timing.get("spin_us", 0.0)), float(timing.get("spin_percent_of_a_core", 0.0))
    controlled = reports.get(f"{space}/motion_controller", (None, "", {}))[2]
    if "offset_m" in controlled:
        last = {**last, "offset": float(controlled["offset_m"])}
    return AxisStatus(space, nodes, plant, last, spin)


def _listen(client: Client, space: str, names: list[str]) -> dict[str, float]:
    """Return a table that is updated with the last values."""
    last: dict[str, float] = {}
    newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

    def of_joints(message: JointState) -> None:
        if message.position:
            last["displacement"] = message.position[0]

    client.node.create_subscription(JointState, f"{space}/joint_states", of_joints, newest)
    for name in {node for node, _, _ in LAST} & set(names):
        wanted = [signal for node, signal, _ in LAST if node == name]

        def of_state(message: JointState, wanted=wanted) -> None:
            said = dict(zip(message.name, message.position, strict=False))
            last.update({signal: said[signal] for signal in wanted if signal in said})

        client.node.create_subscription(JointState, f"{space}/{name}/state", of_state, newest)
    return last


def status(client: Client, as_json: bool) -> int:
    """Print the status of each axis; return 0 if all nodes are healthy, otherwise 1."""
    found = survey(client)
    if as_json:
        table = {axis.namespace or "/": _figures(axis) for axis in found}
        print(json.dumps(table, indent=2, ensure_ascii=False), flush=True)
    else:
        print("\n\n".join("\n".join(_lines(axis)) for axis in found), flush=True)
    return 0 if all(node.is_well for axis in found for node in axis.nodes) else 1


def _figures(axis: AxisStatus) -> dict:
    nodes = {
        node.name: {"state": node.state, "level": node.level, "message": node.message, "rate_hz": node.rate}
        for node in axis.nodes
    }
    spin = dict(zip(("ahead_us", "percent_of_a_core"), axis.spin, strict=True))
    return {"nodes": nodes, "plant": axis.plant, "last": axis.last, "spin": spin}


def _lines(axis: AxisStatus):
    """Yield the readable status of an axis, line by line."""
    yield axis.namespace or "/"
    for node in axis.nodes:
        if node.message.startswith(LIMITED):
            yield f"  {node.message} of {node.name.rsplit('/', 1)[-1]}"
    if axis.plant:
        yield f"  {axis.plant} publishes joint_states instead of plant_simulator"
    if axis.spin[0]:
        ahead, part = axis.spin
        yield f"  the loop polls the clock from {ahead:.3g} µs before each deadline: {part:.2g} % of a core"
    width = max(len(node.name.rsplit("/", 1)[-1]) for node in axis.nodes)
    for node in axis.nodes:
        rate = "" if node.rate is None else f"{node.rate:.1f} Hz"
        message = "output limited, see above" if node.message.startswith(LIMITED) else node.message
        health = message if node.level in ("", "ok") else f"{node.level}: {message}"
        yield f"  {node.name.rsplit('/', 1)[-1]:{width}}  {node.state:12} {rate:>11}  {health}".rstrip()
    units = {signal: unit for _, signal, unit in LAST} | {"displacement": "m"}
    order = ("setpoint", "reference", "displacement", "voltage")
    values = {name: readable(axis.last[name], units[name]) for name in order if name in axis.last}
    if "displacement" in values and axis.last.get("offset"):
        offset = readable(axis.last["offset"], "m")
        values["displacement"] += f" including an offset of {offset}, which setpoints do not include"
    said = ", ".join(f"{name} {value}" for name, value in values.items())
    yield f"  {said or 'no position was reported'}"


def get(client: Client, node: str, names: list[str]) -> None:
    """Print parameters of a node as YAML; without names, print all parameters."""
    full = client.find(node)
    known = _names(client, full)
    _refuse_unknown(full, names, known)
    asked = names or known
    for name, plain in values_of(client, full, asked).items():
        text = yaml.safe_dump(plain, default_flow_style=True, allow_unicode=True, width=10**6)
        print(f"{name}: {text.removesuffix(chr(10) + '...' + chr(10)).strip()}", flush=True)


def values_of(client: Client, full: str, names: list[str] | None = None) -> dict:
    """Return parameters of a node as plain values."""
    asked = _names(client, full) if names is None else names
    answer = client.ask(GetParameters, f"{full}/get_parameters", GetParameters.Request(names=asked))
    found = [plain_value(value) for value in answer.values]
    return dict(zip(asked, found, strict=True))


def plain_value(value):
    """Return a parameter's value as plain Python; arrays are lists."""
    plain = parameter_value_to_python(value)
    return plain if plain is None or isinstance(plain, (str, bool, int, float)) else list(plain)


def set_(client: Client, node: str, values: dict[str, str]) -> None:
    """Set parameters of a node atomically, and print the result."""
    full = client.find(node)
    _refuse_unknown(full, list(values), _names(client, full))
    change(client, full, values)
    print(f"{full}: {', '.join(values)} set", flush=True)


def change(client: Client, full: str, values: dict[str, str]) -> None:
    """Set parameters of a node: all of them, or none if one is refused."""
    from hysteresis_ros.loop.parameters import NODE_PARAMETERS  # imported here, because this takes half a second

    table = NODE_PARAMETERS.get(full.rsplit("/", 1)[-1])
    rows = {row.name: row for row in table.table()} if table else {}
    request = SetParametersAtomically.Request()
    for name, text in values.items():
        value = _value(rows.get(name), name, text)
        request.parameters.append(Parameter(name, value=value).to_parameter_msg())
    result = client.ask(SetParametersAtomically, f"{full}/set_parameters_atomically", request).result
    if not result.successful:
        raise HysteresisError(f"{full} refuses: {result.reason}; nothing was changed")


def _names(client: Client, full: str) -> list[str]:
    request = ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
    return sorted(client.ask(ListParameters, f"{full}/list_parameters", request).result.names)


def _refuse_unknown(full: str, names: list[str], known: list[str]) -> None:
    for name in names:
        if name not in known:
            below = [other for other in known if other.startswith(f"{name}.")]
            hint = f"; below it there are {', '.join(below)}" if below else did_you_mean(name, known)
            raise HysteresisError(f"{full} has no parameter '{name}'{hint or f'; `hysteresis get {full}` lists them'}")


def _value(row: ParameterRow | None, name: str, text: str):
    """Return the value of a parameter from its text, in the type of the parameter if known."""
    value = parse_value(text)
    if row is None:
        return value
    if row.type is str:
        value = text
    if row.type is float and (isinstance(value, str) or row.unit == "m"):
        try:
            value = quantity_in(text, row.unit)
        except ValueError as error:
            raise ParameterError([Problem(name, text, f"{error}; allowed: {row.allowed()}")]) from None
    value = row.convert(value)
    return list(value) if row.type in ARRAY_TYPES else value


def echo(client: Client, topic: str, count: int | None) -> None:
    """Print the messages of a topic, short ones as one line each."""
    name = client.full_name(topic)
    publishers = client.until(lambda: client.node.get_publishers_info_by_topic(name))
    if not publishers:
        raise AbsentError(_nobody(client, name))
    heard: deque = deque()
    kind = _message_type(publishers[0].topic_type)
    client.node.create_subscription(kind, name, lambda message: heard.append(message), _matching(publishers))
    said, quiet = 0, time.monotonic()
    while count is None or said < count:
        if client.until(lambda: heard, 0.5):
            print(formatted(heard.popleft()), flush=True)
            said, quiet = said + 1, time.monotonic()
        elif not client.node.count_publishers(name):
            if count is None:
                print(f"hysteresis: {name} has no publisher any more", flush=True)
                return
            raise AbsentError(f"{said} of {count} messages arrived on {name}, then its publisher exited")
        elif time.monotonic() - quiet > client.timeout and (count is not None or not said):
            names = ", ".join(map(named, publishers))
            raise AbsentError(f"no message arrived on {name} for {client.timeout:g} s; its publisher is {names}")


def _nobody(client: Client, name: str) -> str:
    """Return the error message for a topic without a publisher, with the published topics."""
    topics = [topic for topic, _ in client.node.get_topic_names_and_types() if client.node.count_publishers(topic)]
    topics = [topic for topic in topics if topic not in ("/rosout", "/parameter_events")]
    there = f"there are {', '.join(topics)}{did_you_mean(name, topics)}" if topics else client.who_is_there()
    return f"{name} has no publisher within {client.timeout:g} s; {there}"


def _message_type(name: str):
    """Return the class of a message type ``package/msg/Type``."""
    package, _, kind = name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        raise HysteresisError(f"messages of type {name} are not installed here") from None


def _matching(publishers) -> QoSProfile:
    """Return a quality of service that is compatible with all publishers."""
    offered = [info.qos_profile for info in publishers]
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        depth=1000,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def formatted(message) -> str:
    """Return a message as readable text."""
    if isinstance(message, JointState):
        return _joints(message)
    if isinstance(message, DiagnosticArray):
        return "\n".join(
            f"{status.name}: {status.message}; {', '.join(f'{pair.key} {pair.value}' for pair in status.values)}"
            for status in message.status
        )
    plain = _plain(message)
    if isinstance(plain, dict) and list(plain) == ["data"]:
        return str(plain["data"])
    return "---\n" + yaml.safe_dump(plain, sort_keys=False, allow_unicode=True).rstrip()


def _joints(message: JointState) -> str:
    """Return a line with the time of a sample, and the value of each joint or signal in SI units."""
    stamp = message.header.stamp
    parts = [f"{stamp.sec}.{stamp.nanosec:09d} s"]
    units = ((message.velocity, "m/s"), (message.effort, "N"))
    for index, name in enumerate(message.name):
        words = [f"{name} {message.position[index]:.9g}"] if index < len(message.position) else [name]
        words += [f"{values[index]:.6g} {unit}" for values, unit in units if index < len(values)]
        parts.append(" ".join(words))
    return "  ".join([*parts, *filter(None, [message.header.frame_id])])


def _plain(value):
    """Return a message as dictionaries and lists."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return int.from_bytes(value, "big")
    if isinstance(value, (str, bool, int, float)):
        return value
    return [_plain(item) for item in value]


#: Nodes that take setpoints and reply, by the service ``~/set_setpoint``.
SOURCES = (signals.SOURCE, signals.MOTOR_SOURCE)
#: Time after which the command prints the reason for waiting [s].
PATIENCE = 2.0
#: Time-out for a new sample [s].
ANSWER = 5.0


def setpoint(client: Client, value: float) -> None:
    """Send a setpoint [m] to the reference source, and print whether it was accepted.

    In contrast to a setpoint on a topic, this setpoint cannot be lost without notice, because the source replies.
    """
    source = _source(client)
    state: dict[str, float] = {}

    def hear(message: JointState) -> None:
        state.update(zip(message.name, message.position, strict=False))

    client.node.create_subscription(JointState, f"{source}/state", hear, 10)
    modes = _followers(client, source)
    _require_active(client, source)
    argument = Parameter("setpoint", Parameter.Type.DOUBLE, value).to_parameter_msg()
    request = SetParametersAtomically.Request(parameters=[argument])
    result = client.ask(SetParametersAtomically, f"{source}/set_setpoint", request).result
    if not result.successful:
        raise HysteresisError(f"{source}: {result.reason}")
    _require_moving(client, source, value, state)
    _require_followed(client, source, modes)
    print(f"setpoint {readable(value, 'm')} taken by {source}", flush=True)


def move(client: Client, value: float, tolerance: float | None, dwell: float | None) -> int:
    """Send a setpoint [m] with a tolerance [m]; print when the axis will be ready, and later when it was ready.

    Exit code 1: the move was replaced or stopped, or the axis was not ready within the time-out.
    """
    source = _source(client)
    if source.endswith(signals.MOTOR_SOURCE):
        raise HysteresisError(f"{source}: moves of an inchworm motor are not predicted; use `hysteresis setpoint`")
    entries: list[dict[str, Any]] = []

    def told(number: int) -> dict[str, Any]:
        """Return the contents of all messages about a move."""
        return {name: value for entry in entries if entry["move"] == number for name, value in entry.items()}

    def hear(message: String) -> None:
        entries.append(json.loads(message.data))

    topic = f"{source}/moves"
    client.node.create_subscription(String, topic, hear, setpoint_qos())
    client.until(lambda: client.node.count_publishers(topic))
    modes = _followers(client, source)
    _require_active(client, source)
    given = {"setpoint": value, "tolerance": tolerance, "dwell": dwell}
    asked = [Parameter(name, Parameter.Type.DOUBLE, one) for name, one in given.items() if one is not None]
    request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in asked])
    result = client.ask(SetParametersAtomically, f"{source}/move", request).result
    if not result.successful:
        raise HysteresisError(f"{source}: {result.reason}")
    answer = json.loads(result.reason)
    if answer["move"] is None:
        band = readable(answer["deadband"], "m")
        print(f"{readable(value, 'm')} is within ready.deadband = {band} of the setpoint: the axis does not move")
        return 0
    number = answer["move"]
    _require_followed(client, source, modes)
    if not client.until(lambda: {"predicted", "ended"} & told(number).keys()):
        raise AbsentError(f"{source} has accepted the move but has not predicted it; see `hysteresis status`")
    heard = told(number)
    predicted, why = heard.get("predicted"), heard.get("why") or heard.get("ended")
    words = f"not predicted: {why}" if predicted is None else f"ready in {readable(predicted, 's')}, predicted"
    if tolerance is None:
        words += f"; tolerance {readable(heard['tolerance'], 'm')}"
    print(f"setpoint {readable(value, 'm')} taken by {source}: {words}", flush=True)
    if not client.until(lambda: {"ready", "ended"} & told(number).keys()):
        print(f"not ready within {client.timeout:g} s (--timeout)", flush=True)
        return 1
    heard = told(number)
    if "ended" in heard:
        print(f"not ready: {heard['ended']}", flush=True)
        return 1
    since = heard["ready"]
    difference = f", {100.0 * (since / predicted - 1.0):+.0f} % from the prediction" if predicted and since else ""
    skipped = f"; {heard['missing']} samples were skipped or had no measurement" if heard["missing"] else ""
    print(f"ready after {readable(since, 's')}, measured{difference}{skipped}", flush=True)
    return 0


def quiet(client: Client, duration: float, tolerance: float | None) -> None:
    """Hold the command of an axis for ``duration`` [s] if it drifts by at most ``tolerance`` [m]; print the answer."""
    controller = client.find(signals.CONTROLLER)
    given = {"duration": duration, "tolerance": tolerance}
    asked = [Parameter(name, Parameter.Type.DOUBLE, one) for name, one in given.items() if one is not None]
    request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in asked])
    result = client.ask(SetParametersAtomically, f"{controller}/quiet", request).result
    if not result.successful:
        raise HysteresisError(f"{controller}: {result.reason}")
    print(f"{controller}: {result.reason}", flush=True)


def _source(client: Client) -> str:
    """Find the node that takes the setpoints of an axis; by its name, because the topic may have other subscribers."""
    wanted = [client.full_name(name) for name in SOURCES]

    def there() -> list[str]:
        return [name for name in client.nodes() if name in wanted]

    if client.timeout > PATIENCE and not client.until(there, PATIENCE):
        if not client.namespace:
            _require_one_axis(client)
        print(f"waiting for {' or '.join(wanted)} …", file=sys.stderr, flush=True)
    found = client.until(there)
    if found:
        return found[0]
    topic = client.full_name("setpoint")
    others = sorted({named(one) for one in client.node.get_subscriptions_info_by_topic(topic)})
    heard = f"; {', '.join(others)} on {topic} does not answer setpoints" if others else ""
    raise AbsentError(f"no {' or '.join(wanted)} within {client.timeout:g} s{heard}; {client.who_is_there()}")


def _require_one_axis(client: Client) -> None:
    """Refuse to wait for an axis without a namespace if other axes run, such as the axes of a stage."""
    spaces = sorted({space for space, _, name in (one.rpartition("/") for one in client.nodes()) if name in SOURCES})
    if spaces:
        raise HysteresisError(f"no axis is chosen, and there are {', '.join(spaces)}: give --namespace {spaces[0]}")


def _require_active(client: Client, source: str) -> None:
    """Raise an error if the axis cannot move because one of its nodes is not active."""
    space = source.rpartition("/")[0]
    names = [f"{space}/{name}" for name in axis_nodes(client.nodes())[space] if name != "recorder"]
    for name, state in lifecycle_states(client, names).items():
        if state == "silent":
            why = client.why_silent(name)
            raise AbsentError(f"{name} did not answer within {client.timeout:g} s, and nothing was sent: {why}")
        if state != "active":
            to_do = {"unconfigured": "configure", "inactive": "activate"}.get(state)
            hint = f": `hysteresis call {name} {to_do}`" if to_do else ""
            raise HysteresisError(f"{name} is {state}, so the axis would not move{hint}")


def stands(source: str, state: dict[str, float]) -> str:
    """Return why a source that has taken the setpoint does not move, with a remedy; empty if it moves."""
    from hysteresis_ros.loop.watch import STOPPED, TRIPPED
    from hysteresis_ros.references import inchworm_layout as at

    mode, error = round(state.get("mode", 0.0)), round(state.get("error", 0.0))
    start = f"`hysteresis call {source} start`"
    if mode == TRIPPED:
        plant = f"{source.rpartition('/')[0]}/plant_simulator"
        return f"does not move, because the plant has stopped the axis: `hysteresis call {plant} start` resumes it"
    if mode == STOPPED:
        return f"is stopped: {start}"
    if error > at.SENSOR_ERROR:  # a sensor error clears itself
        return f"has stopped with the error {at.ERROR_NAMES[error]}: {start} after repair"
    if round(state.get("phase", 0.0)) == at.RELEASED:
        return f"has released the slider: {start}"
    return ""


def _require_moving(client: Client, source: str, value: float, state: dict[str, float]) -> None:
    """Wait for a sample with the setpoint; raise an error if the axis does not move."""

    state.clear()

    def made() -> bool:
        # the sequencer of a motor changes the last digit of a setpoint that equals the previous one
        return math.isclose(state.get("setpoint", math.nan), value, rel_tol=1e-12, abs_tol=1e-15)

    if not client.until(made, min(ANSWER, client.timeout)):
        if state:
            now = readable(state.get("setpoint", math.nan), "m")
            raise AbsentError(f"{source} accepted the setpoint, but another setpoint replaced it: it is now {now}")
        joints = f"{source.rsplit('/', 1)[0]}/joint_states"
        why = f"{joints} has no publisher" if not client.node.count_publishers(joints) else "the axis' time is paused"
        raise AbsentError(
            f"{source} has the setpoint but has computed no sample with it: {why}; see `hysteresis status`"
        )
    if any(round(state.get(name, 0.0)) for name in ("mode", "error", "phase")):
        why = stands(source, state)
        if why:
            raise HysteresisError(f"{source} has the setpoint but {why}{_cause(client, source, state)}")


def _followers(client: Client, source: str) -> dict[str, float]:
    """Return a table that is updated with the modes of controller and compensator, by full name; empty for a motor."""
    modes: dict[str, float] = {}
    for name in () if source.endswith(signals.MOTOR_SOURCE) else (signals.CONTROLLER, signals.COMPENSATOR):
        full = f"{source.rpartition('/')[0]}/{name}"

        def hear(message: JointState, full=full) -> None:
            modes[full] = dict(zip(message.name, message.position, strict=False)).get("mode", math.nan)

        if client.node.count_publishers(f"{full}/state"):
            modes[full] = math.nan
            client.node.create_subscription(JointState, f"{full}/state", hear, 10)
    return modes


def _require_followed(client: Client, source: str, modes: dict[str, float]) -> None:
    """Raise an error if controller or compensator is stopped, because then the setpoint does not move the axis."""
    from hysteresis_ros.loop.watch import STOPPED

    client.until(lambda: not any(map(math.isnan, modes.values())), min(ANSWER, client.timeout))
    for name, mode in modes.items():
        if mode == STOPPED:
            raise HysteresisError(f"{source} has the setpoint but {name} is stopped: `hysteresis call {name} start`")


def _cause(client: Client, source: str, state: dict[str, float]) -> str:
    """Return "; " and the reason of the plant for stopping the axis; empty if it has not stopped the axis."""
    from hysteresis_ros.loop.watch import TRIPPED

    if round(state.get("mode", 0.0)) != TRIPPED:
        return ""
    plant = f"{source.rpartition('/')[0]}/{signals.PLANT}"
    said = client.last_report(plant, ANSWER, lambda text: "stopped" in text)
    return f"; {said}" if said else ""
