# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Done by people and programs: floods of setpoints, storms of parameters, calls in any order, a second sender."""

from __future__ import annotations

import math
import time

from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from hysteresis_ros.configuration import NODE_NAMES
from hysteresis_ros.nodes.campaign.group import Group
from hysteresis_ros.nodes.campaign.machine import busy
from hysteresis_ros.nodes.campaign.rig import START, Rig
from hysteresis_ros.reliability.mishaps import Mishap

#: Seconds for which something is done again and again, and the distance of two turns of it.
LONG, TURN = 3.0, 1e-3
#: The axis is sent elsewhere once in so many turns.
STEADY = 50
#: A second sender's commands are within so many strokes.
COMMANDED = 3.0
#: Exit code and words of nodes that find others of their names at work.
REFUSED, ONE_MASTER = 2, "one axis has one master"
#: Values that no parameter may have.
NONSENSE = (math.nan, -1e300, math.inf)
#: Transitions of the lifecycle that are asked for: all but the end, and some that there are not.
TRANSITIONS = (0, 1, 2, 3, 4, 8, 60, 99, 255)
#: Setpoints that are none; one in so many is such a one.
GARBAGE, GARBAGE_EVERY = (math.nan, math.inf, -math.inf, 1e300, -1.0), 7


def flood(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Publish setpoints as fast as that, garbage among them, while all cores are busy.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
        Setpoints per second.
    """
    rig.asked += [rig.bounds.low, rig.bounds.high]
    message, sent, begun = Float64(), 0, time.monotonic()
    with busy():
        while (passed := time.monotonic() - begun) < LONG:
            while sent < passed * amount:
                sent += 1
                message.data = rig.anywhere() if sent % GARBAGE_EVERY else GARBAGE[sent % len(GARBAGE)]
                rig.witness.setpoints.publish(message)
            time.sleep(TURN)
    rig.notes.append(f"{sent / LONG:.0f} a second")


def second_sender(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Publish anything on a topic of the axis, as another graph or a tool would.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
        Its victim is the topic.
    amount : float
        Messages per second.
    """
    kind = JointState if mishap.victim == "joint_states" else Float64
    publisher = rig.witness.node.create_publisher(kind, mishap.victim, 10)
    until, count = time.monotonic() + LONG, 0
    while time.monotonic() < until:
        count += 1
        if count % STEADY == 0:
            rig.ask(rig.anywhere())
        publisher.publish(_other(rig, mishap.victim))
        time.sleep(1.0 / amount)
    rig.witness.node.destroy_publisher(publisher)


def _other(rig: Rig, topic: str):
    """Return a message of somebody else, within what the axis can do."""
    bounds, random = rig.bounds, rig.random
    if topic == "voltage":
        return Float64(data=float(random.uniform(bounds.minimum, bounds.maximum)))
    if topic == "command":
        return Float64(data=float(random.uniform(-1.0, 1.0) * COMMANDED * bounds.stroke))
    message = JointState(name=[rig.axis.plant_simulator.joint], position=[rig.anywhere()])
    message.header.stamp = rig.witness.node.get_clock().now().to_msg()
    return message


def second_graph(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Start the same axis again beside the one that runs.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
    """
    folder = rig.group.log.parent / f"second{len(list(rig.group.log.parent.glob('second*')))}"
    folder.mkdir()
    second = Group(rig.axis, rig.way, folder)
    try:
        rig.witness.until(lambda: None not in second.codes(), START)
        refused, said = second.codes(), second.printed()
    finally:
        second.close()
    if set(refused) != {REFUSED} or said.count(ONE_MASTER) != len(refused):
        rig.broken.append(f"a second graph ended with {refused}: {' '.join(said.split())[-200:]}")


def storm(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Change parameters while the axis moves: numbers a little, and to nonsense; all as they were in the end.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
        How often.
    """
    nodes = ("motion_controller", "hysteresis_compensator", "plant_simulator")
    before = {node: _numbers(rig, node) for node in nodes}
    refused = unanswered = 0
    for count in range(int(amount)):
        if count % STEADY == 0:
            rig.ask(rig.anywhere())
        node = str(rig.random.choice(nodes))
        name = str(rig.random.choice(list(before[node])))
        nonsense = NONSENSE[count % len(NONSENSE)] if count % 3 == 0 else None
        value = before[node][name] * rig.random.uniform(0.98, 1.02) if nonsense is None else nonsense
        answer = _set(rig, node, {name: value})
        unanswered += answer is None
        refused += answer is False
    unanswered += sum(_set(rig, node, values) is None for node, values in before.items())
    rig.notes.append(f"{int(amount)} changes, {refused} refused")
    if unanswered:
        rig.broken.append(f"{unanswered} changes of parameters were not answered")


def _numbers(rig: Rig, node: str) -> dict[str, float]:
    """Return the numbers among the parameters of a node that may change."""
    listed = rig.witness.call(ListParameters, f"{node}/list_parameters")
    names = list(listed.result.names) if listed is not None else []
    values = rig.witness.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names))
    found = {}
    for name, value in zip(names, values.values if values is not None else [], strict=False):
        if value.type == ParameterType.PARAMETER_DOUBLE and value.double_value:
            found[name] = value.double_value
    return {name: value for name, value in found.items() if _set(rig, node, {name: value})}


def _set(rig: Rig, node: str, values: dict[str, float]) -> bool | None:
    """Set parameters together; tell whether they were taken, None without an answer."""
    request = SetParametersAtomically.Request()
    request.parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    answer = rig.witness.call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)
    return None if answer is None else answer.result.successful


def anything(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Ask nodes for transitions and services in any order; in the end all are active and started.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
        How often.
    """
    unanswered = 0
    for _ in range(int(amount)):
        node = str(rig.random.choice(NODE_NAMES[:4]))
        if rig.random.random() < 0.5:
            unanswered += not rig.witness.trigger(node, str(rig.random.choice(("start", "stop", "reset"))))
        else:
            unanswered += not rig.witness.transition(node, int(rig.random.choice(TRANSITIONS)))
    for wanted in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        for node in NODE_NAMES[:4]:
            unanswered += not rig.witness.transition(node, wanted)
    unanswered += sum(not rig.witness.trigger(node, "start") for node in NODE_NAMES[:4])
    if unanswered:
        rig.broken.append(f"{unanswered} of {int(amount)} calls were not answered")
