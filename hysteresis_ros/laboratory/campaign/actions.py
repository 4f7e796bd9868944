# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The actions of the fault cases: they disturb processes, the machine or the measurement, or imitate users."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace

from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from hysteresis_ros.configuration import NODE_NAMES
from hysteresis_ros.laboratory.campaign.judging import SLACK, Bounds
from hysteresis_ros.laboratory.campaign.mishaps import FUSED, Mishap
from hysteresis_ros.laboratory.campaign.rig import AXIS, RECORDER, ROOM, START, Clock, Device, Group, Rig
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.plant import PARTNER_LOST
from hysteresis_ros.nodes.launcher import node_environment, started
from hysteresis_ros.nodes.masters import RUNS_ONCE
from hysteresis_ros.nodes.realtime import STARTING
from hysteresis_ros.recordings.align import read_recording

#: Fraction of the stroke by which an axis may creep without a new setpoint.
UNASKED = 0.03
#: Names of processes that may contain the plant.
WITH_PLANT = ("plant_simulator", AXIS)
#: All processes of an axis.
ALL = "all"


def kill(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Kill processes (SIGKILL), and restart them."""
    victims = rig.group.names if mishap.victim == ALL else (mishap.victim,)
    for victim in victims:
        rig.group.send(victim, signal.SIGKILL)
    time.sleep(amount or rig.bounds.timeouts[mishap.safe] + SLACK)
    place = rig.witness.displacement
    _again(rig, victims)
    if mishap.victim == "reference_generator":
        time.sleep(SLACK)
        moved = rig.witness.displacement - place
        if abs(moved) > UNASKED * rig.bounds.stroke and not rig.witness.tripped:
            rig.broken.append(f"the restarted node moves the axis by {1e6 * moved:.2g} µm without a setpoint")


def lose(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Kill a process (SIGKILL): the axis must stop, and must stay stopped when the process is restarted."""
    witness, patience = rig.witness, rig.bounds.timeouts[mishap.safe] + STARTING
    rig.group.send(mishap.victim, signal.SIGKILL)
    time.sleep(rig.bounds.timeouts[mishap.safe] + SLACK)
    if not witness.until(lambda: witness.tripped == PARTNER_LOST, patience):
        rig.broken.append(f"the axis is not latched {patience:.2g} s after the time at which its voltage must be safe")
    _again(rig, (mishap.victim,))
    time.sleep(SLACK)
    if witness.tripped != PARTNER_LOST:
        rig.broken.append("the axis continued without ~/start when the node was restarted")


def stop(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Suspend processes for some time (SIGSTOP, SIGCONT).

    Units: ``amount`` [s].
    """
    victims = rig.group.names if mishap.victim == ALL else (mishap.victim,)
    for victim in victims:
        rig.group.send(victim, signal.SIGSTOP)
    time.sleep(amount)
    for victim in victims:
        rig.group.send(victim, signal.SIGCONT)


def _again(rig: Rig, victims) -> None:
    """Restart ended processes, and wait until they are active."""
    if any(victim in WITH_PLANT for victim in victims):
        rig.witness.life += 1
    begun, rows = time.monotonic(), len(rig.witness.rows)
    for victim in victims:
        rig.group.start(victim)
    seen = rig.witness.until(lambda: len(rig.witness.rows) > rows, START)
    if not seen or not rig.runs(None if AXIS in victims else victims):
        rig.broken.append(f"the restarted nodes are not active after {START:g} s")
    rig.notes.append(f"active {time.monotonic() - begun:.1f} s after its restart")


#: Program that keeps one core busy.
BURN = "while True: sum(range(100000))"
#: A small disk counts as full when the recording uses more than this fraction of it.
FILLED = 0.75
#: Time for which the axis is observed after the disk is full [s].
AFTERWARDS = 3.0
#: Maximum time until a small disk is full [s].
FULL = 60.0
#: Longest part that may be missing at the end of an interrupted recording [s].
LOST = 1.5
#: Length of a recording of separate nodes before its interruption [s].
RECORDED = 2.0
#: Jumps of the time of day [s].
OFFSETS = (3600, -3600, 0)
#: Time after each jump of the time of day [s].
APART = 1.5


@contextlib.contextmanager
def busy() -> Iterator[None]:
    """Keep all cores busy as long as the block runs."""
    environment = node_environment()
    command = [sys.executable, "-c", BURN]
    burning = [started(command, environment, stderr=subprocess.DEVNULL) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in burning:
            process.kill()
            process.wait()


def load(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Keep all cores busy while the axis moves back and forth.

    Units: ``amount`` [s].
    """
    until = time.monotonic() + amount
    with busy():
        while time.monotonic() < until:
            rig.ask(rig.anywhere())
            time.sleep(0.25)


def fill(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Wait until the disk of a fused axis, which records all samples, is full."""

    def is_full() -> bool:
        sizes = [path.stat().st_size for path in rig.group.bags[-1].glob("*.mcap")]
        return sum(sizes) > FILLED * ROOM * 1024 or bool(rig.group.died())

    if not rig.witness.until(is_full, FULL):
        rig.broken.append(f"the disk is not full after {FULL:g} s")
    time.sleep(AFTERWARDS)


def cut_recording(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Kill a recording process, read its recording, and restart the process."""
    if rig.way != FUSED:
        rig.group.start(RECORDER)
        rig.witness.until(lambda: rig.witness.is_active(RECORDER), START)
        time.sleep(RECORDED)
    bag = rig.group.bags[-1]
    killed = time.time()
    kill(rig, replace(mishap, victim=AXIS if rig.way == FUSED else RECORDER), amount)
    run = read_recording(bag, rig.axis.namespace, further=True)
    lost = killed - (run.time[-1] + 1e-9 * run.metadata["start_time_ns"])
    rig.notes.append(f"the recording lacks its last {lost:.2f} s")
    # separate nodes exchange messages, which a busy machine may deliver too late for the recording
    missing = run.metadata["missing_samples"] if rig.way == FUSED else 0
    if lost > LOST or missing:
        rig.broken.append(f"the recording lacks its last {lost:.2f} s, and {missing} samples before them")


def set_clock(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Make the time of day jump while the axis moves."""
    assert isinstance(rig.beside, Clock)
    for offset in OFFSETS:
        rig.beside.set(offset)
        rig.ask(rig.anywhere())
        time.sleep(APART)


def misbehave(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Inject a fault into a device, and wait until the fault ends.

    Units: ``amount`` [s].
    """
    assert isinstance(rig.beside, Device)
    rig.beside.go_wrong(mishap.victim, amount)
    time.sleep(amount + 0.5)


#: Time of the axis at which the faults of a fused loop begin [s]; by then the axis has started and made its first move.
SCHEDULE = 12.0
#: Duration of a measurement fault after which the voltage need not become safe [s].
LASTING = 3.0
#: If the voltage must become safe, the fault lasts longer than the time-out by this time [s].
FURTHER = 0.5


def _lasts(mishap: Mishap, bounds: Bounds) -> float:
    """Return the duration of a fault [s]; if the voltage must become safe, the fault exceeds the time-out."""
    return bounds.timeouts[mishap.safe] + FURTHER if mishap.safe else LASTING


def scheduled(axis: AxisParameters, mishap: Mishap, amount: float, bounds: Bounds) -> AxisParameters:
    """Return a fused axis that injects the fault into its own measurement."""
    rate = axis.plant_simulator.sample_rate
    value = {"late": max(round(amount * rate), 1), "spike": amount * bounds.stroke, "drop": amount}.get(mishap.fault)
    end = "" if value is None else f":{value:.9g}"
    return axis.with_faults((f"{mishap.fault}:{SCHEDULE:g}:{_lasts(mishap, bounds):g}{end}",))


def measure(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Inject a fault into the measurement for some time."""
    lasts = _lasts(mishap, rig.bounds)
    if rig.relay is not None:
        rig.relay.set(mishap.victim, amount)
        _move(rig, mishap, lasts)
        rig.relay.set("")
        return
    rate = rig.axis.plant_simulator.sample_rate
    if not rig.witness.until(lambda: rig.witness.sample(rate) >= SCHEDULE * rate, SCHEDULE + LASTING):
        rig.broken.append("the time of the axis does not advance")
    rig.begun = time.time()
    _move(rig, mishap, lasts)


def _move(rig: Rig, mishap: Mishap, lasts: float) -> None:
    """Move the axis during the fault, unless the fault must make the voltage safe."""
    until = time.monotonic() + lasts
    while (left := until - time.monotonic()) > 0.0:
        if not mishap.safe:
            rig.ask(rig.anywhere())
        time.sleep(min(left, 0.5))


#: Duration of a repeated action [s].
LONG = 3.0
#: Pause between two bursts of published setpoints [s].
TURN = 1e-3
#: Repetitions between two moves of the axis.
STEADY = 50
#: Largest command of a second sender, in strokes.
COMMANDED = 3.0
#: Exit code of nodes that find other nodes with the same names; their message contains RUNS_ONCE.
REFUSED = 2
#: Values that are invalid for every numerical parameter.
NONSENSE = (math.nan, -1e300, math.inf)
#: Requested lifecycle transitions: all except shutdown, and some unknown ones.
TRANSITIONS = (0, 1, 2, 3, 4, 8, 60, 99, 255)
#: Invalid setpoints.
GARBAGE = (math.nan, math.inf, -math.inf, 1e300, -1.0)
#: One of this number of published setpoints is invalid.
GARBAGE_EVERY = 7


def flood(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Publish setpoints, some of them invalid, at a high rate while all cores are busy."""
    rig.asked += [rig.bounds.low, rig.bounds.high]
    message, sent, begun = Float64(), 0, time.monotonic()
    with busy():
        while (passed := time.monotonic() - begun) < LONG:
            while sent < passed * amount:
                sent += 1
                message.data = rig.anywhere() if sent % GARBAGE_EVERY else GARBAGE[sent % len(GARBAGE)]
                rig.witness.setpoints.publish(message)
            time.sleep(TURN)
    rig.notes.append(f"{sent / LONG:.0f} per second")


def second_sender(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Publish on a topic of the axis, as a competing publisher."""
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
    """Return a message of another sender, within the range of the axis."""
    bounds, random = rig.bounds, rig.random
    if topic == "voltage":
        return Float64(data=float(random.uniform(bounds.minimum, bounds.maximum)))
    if topic == "command":
        return Float64(data=float(random.uniform(-1.0, 1.0) * COMMANDED * bounds.stroke))
    message = JointState(name=[rig.axis.plant_simulator.joint], position=[rig.anywhere()])
    message.header.stamp = rig.witness.node.get_clock().now().to_msg()
    return message


def second_graph(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Start a second copy of the running axis."""
    folder = rig.group.log.parent / f"second{len(list(rig.group.log.parent.glob('second*')))}"
    folder.mkdir()
    second = Group(rig.axis, rig.way, folder)
    try:
        rig.witness.until(lambda: None not in second.codes(), START)
        refused, said = second.codes(), second.printed()
    finally:
        second.close()
    if set(refused) != {REFUSED} or said.count(RUNS_ONCE) != len(refused):
        rig.broken.append(f"a second graph ended with exit codes {refused}: {' '.join(said.split())[-200:]}")


def storm(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Change parameters slightly or to invalid values while the axis moves; restore all of them at the end."""
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
    """Return the numerical parameters of a node that are not zero and accept a change."""
    listed = rig.witness.call(ListParameters, f"{node}/list_parameters")
    names = list(listed.result.names) if listed is not None else []
    values = rig.witness.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names))
    found = {}
    for name, value in zip(names, values.values if values is not None else [], strict=False):
        if value.type == ParameterType.PARAMETER_DOUBLE and value.double_value:
            found[name] = value.double_value
    return {name: value for name, value in found.items() if _set(rig, node, {name: value})}


def _set(rig: Rig, node: str, values: dict[str, float]) -> bool | None:
    """Set parameters together; return whether the node accepted them, or None if it did not answer."""
    request = SetParametersAtomically.Request()
    request.parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    answer = rig.witness.call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)
    return None if answer is None else answer.result.successful


def anything(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Call transitions and services of nodes in random order; finally activate and start all nodes."""
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


#: The actions by name; each is called with the fixture, the fault case and the amount.
ACTIONS = {
    "kill": kill,
    "lose": lose,
    "stop": stop,
    "flood": flood,
    "second sender": second_sender,
    "storm": storm,
    "anything": anything,
    "measure": measure,
    "load": load,
    "fill": fill,
    "misbehave": misbehave,
    "cut recording": cut_recording,
    "set clock": set_clock,
    "second graph": second_graph,
}
