# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis status``: who is there of each axis, in which state, how well, and where the axis is."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from hysteresis_ros.configuration import NODE_NAMES, node_names
from hysteresis_ros.nodes.discovery import named
from hysteresis_ros.nodes.limited_time import LIMITED
from hysteresis_ros.nodes.qos import diagnostics_qos
from hysteresis_ros.nodes.remote.client import AbsentError, Client, axis_nodes
from hysteresis_ros.nodes.remote.services import lifecycle_states
from hysteresis_ros.signals import MOTOR_SOURCE, PLANT
from hysteresis_ros.units import readable

#: Words of the levels of diagnostics.
LEVELS = ("ok", "warning", "error", "stale")
#: Where the last values are heard: node whose ``~/state`` says them, name there, unit.
LAST = (
    ("reference_generator", "setpoint", "m"),
    ("inchworm_sequencer", "setpoint", "m"),
    ("reference_generator", "reference", "m"),
    ("inchworm_sequencer", "reference", "m"),
    ("hysteresis_compensator", "voltage", "V"),
)
#: Where nodes say how they are.
DIAGNOSTICS = "/diagnostics"
#: What is wrong with a node that is not known to be well.
MISSING = {"absent": "not found", "silent": "found, but did not answer"}
#: Seconds in which every node says something of itself, and more.
REPORTED = 1.6


@dataclass
class NodeStatus:
    """What is known of one node.

    Parameters
    ----------
    name : str
        Full name.
    state : str
        Of its lifecycle; ``absent`` where there is no such node, ``silent`` where it does not answer.
    level, message : str
        Its health, empty where it has said nothing.
    rate : float or None
        Samples per second [Hz].
    """

    name: str
    state: str
    level: str = ""
    message: str = ""
    rate: float | None = None

    @property
    def is_well(self) -> bool:
        """Whether it is active and says nothing bad of itself."""
        return self.state == "active" and self.level in ("ok", "")


@dataclass
class AxisStatus:
    """What is known of one axis.

    Parameters
    ----------
    namespace : str
    nodes : list of NodeStatus
    plant : str
        Who publishes ``joint_states`` in the place of ``plant_simulator``; empty where that is there.
    last : dict of str to float
        Last values in SI.
    """

    namespace: str
    nodes: list[NodeStatus]
    plant: str = ""
    last: dict[str, float] = field(default_factory=dict)


def survey(client: Client) -> list[AxisStatus]:
    """Return what is known of the axes that are there, of all namespaces or of the client's.

    Parameters
    ----------
    client : Client

    Raises
    ------
    AbsentError
        There is none.
    """
    reports: dict[str, tuple] = {}

    def hear(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            reports[status.name.removesuffix(": axis")] = (ord(status.level), status.message, values)

    # the last reports of our nodes come at once, those of others when they are made
    for keeps in (True, False):
        client.node.create_subscription(DiagnosticArray, DIAGNOSTICS, hear, diagnostics_qos(keeps))

    def there() -> dict[str, list[str]]:
        """Return the nodes of each axis: those that discovery has named, and those of which messages have come."""
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
        # the last report of a node that has just been activated is one from before
        told = {name for name, (_, _, values) in reports.items() if "rate_hz" in values}
        places = [(space, node, signal) for space in found for node, signal, _ in LAST if f"{space}/{node}" in active]
        return active <= told and all(signal in last[space] for space, _, signal in places)

    client.until(reported, REPORTED)
    return [_axis(client, space, names, states, reports, last[space]) for space, names in sorted(found.items())]


def _complete(client: Client, there: Callable[[], dict[str, list[str]]]) -> dict[str, list[str]]:
    """Return the nodes of each axis as soon as none is missing and no other one comes; later only what is there.

    Parameters
    ----------
    client : Client
    there : callable
        Returns the nodes that are there now.
    """
    known: dict[str, list[str]] = {}
    since = time.monotonic()

    def lacks(space: str, names: list[str]) -> bool:
        lacking = {*node_names(MOTOR_SOURCE in names)} - {*names}
        if lacking == {PLANT}:  # of somebody else
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
    for name in [*node_names("inchworm_sequencer" in names), *(["recorder"] if "recorder" in names else [])]:
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
        if not message and state in MISSING:
            message = f"{MISSING[state]} within {client.timeout:g} s"
        nodes.append(NodeStatus(full, state, word, message, rate))
    return AxisStatus(space, nodes, plant, last)


def _listen(client: Client, space: str, names: list[str]) -> dict[str, float]:
    """Return a table that is filled with the last values as they come."""
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
    """Print what is known of each axis; return 0 when all is well, 1 when something is not.

    Parameters
    ----------
    client : Client
    as_json : bool
        As JSON, in SI.
    """
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
    return {"nodes": nodes, "plant": axis.plant, "last": axis.last}


def _lines(axis: AxisStatus):
    """Yield what is known of an axis, for people."""
    yield axis.namespace or "/"
    for node in axis.nodes:
        if node.message.startswith(LIMITED):
            yield f"  {node.message} of {node.name.rsplit('/', 1)[-1]}"
    if axis.plant:
        yield f"  {axis.plant} publishes joint_states in the place of plant_simulator"
    width = max(len(node.name.rsplit("/", 1)[-1]) for node in axis.nodes)
    for node in axis.nodes:
        rate = "" if node.rate is None else f"{node.rate:.1f} Hz"
        message = "output limited, see above" if node.message.startswith(LIMITED) else node.message
        health = message if node.level in ("", "ok") else f"{node.level}: {message}"
        yield f"  {node.name.rsplit('/', 1)[-1]:{width}}  {node.state:12} {rate:>11}  {health}".rstrip()
    units = {signal: unit for _, signal, unit in LAST} | {"displacement": "m"}
    order = ("setpoint", "reference", "displacement", "voltage")
    values = [f"{name} {readable(axis.last[name], units[name])}" for name in order if name in axis.last]
    yield f"  {', '.join(values) or 'nothing was said of where it is'}"
