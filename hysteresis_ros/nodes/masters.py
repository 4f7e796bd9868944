# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One axis, one active publisher: a node runs once in a ROS domain, and each of its inputs is fed by one publisher.

A node claims its name on this machine: discovery would report a second graph only after both have moved. The kernel
releases the claim when the process ends, however it ends.

A node accepts an input from the publisher that sent the first message, known by its identity (GID), which rclpy
leaves out of its callbacks. Silence does not release the input: when the active publisher has been silent for the
time-out of the input, or has left the graph, only a publisher of a node with the same full name replaces it. Any other
publisher needs ``~/reset`` of the node that listens, or a new configuration. What a competing publisher sends has no
effect, and diagnostics name both.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import pathlib
import socket
import struct
import sys
import time
import weakref
from functools import partial

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.type_support import check_for_type_support
from rclpy.utilities import get_rmw_implementation_identifier
from rclpy.waitable import NumberOfEntities, Waitable
from sensor_msgs.msg import JointState

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.nodes.domain import is_name, named, reaches_others

#: Seconds that who is about to leave gets for it.
CLAIM_PATIENCE = 5.0
#: How often is looked whether it has left [s].
CLAIM_LOOK = 0.1


def _address(domain: int, name: str) -> bytes:
    return b"\0hysteresis_ros/" + hashlib.sha256(f"{domain}{name}".encode()).hexdigest().encode()


def holder(domain: int, name: str) -> str:
    """Say which process has claimed a node, by its number and command line; '' when nobody has."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(_address(domain, name))
        except BlockingIOError:
            return "a process of this machine"
        except OSError:
            return ""
        peer = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    process = struct.unpack("3i", peer)[0]
    try:
        words = pathlib.Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        words = []
    return f"process {process} ({' '.join(words).strip()[:120]})" if any(words) else f"process {process}"


def claim(domain: int, name: str, patience: float = CLAIM_PATIENCE) -> socket.socket | None:
    """Claim a node of a domain on this machine, until what is returned is closed or the process ends.

    Units: ``patience`` [s].
    """
    if not sys.platform.startswith("linux"):
        return None
    until = time.monotonic() + patience
    while True:
        made = socket.socket(socket.AF_UNIX)
        try:
            made.bind(_address(domain, name))
            made.listen(8)
            return made
        except OSError:
            made.close()
        if time.monotonic() > until:
            break
        time.sleep(CLAIM_LOOK)
    who = holder(domain, name) or "a process of this machine"
    raise HysteresisError(
        f"{name} runs already in ROS domain {domain}: {who}; one axis has one master: stop that one, or give this axis "
        "another namespace or ROS_DOMAIN_ID"
    )


#: Bytes of an identity (RMW_GID_STORAGE_SIZE of Jazzy).
IDENTITY_BYTES = 16


class _Identity(ctypes.Structure):
    """``rmw_gid_t``."""

    _fields_ = (("implementation", ctypes.c_char_p), ("data", ctypes.c_uint8 * IDENTITY_BYTES))


class _Information(ctypes.Structure):
    """``rmw_message_info_t``."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("publisher", _Identity),
        ("from_intra_process", ctypes.c_bool),
    )


def _function(capsule, result, *arguments):
    """Return what a type support offers as a pointer in a capsule."""
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return ctypes.PYFUNCTYPE(result, *arguments)(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


class IdentifiedSubscription(Waitable):
    """A subscription that tells with each message who sent it, and lives as long as its node.

    rclpy's EventsExecutor ends the process when such a waitable is taken away while messages come.
    """

    def __init__(self, node, message_type, topic: str, callback, qos, events):
        group = node.default_callback_group
        super().__init__(group)
        check_for_type_support(message_type)
        with node.handle:
            self._handle = _rclpy.Subscription(node.handle, message_type, topic, qos.get_c_qos_profile())
        with self._handle:
            self.topic_name = self._handle.get_topic_name()
        self._callback, self._index = callback, 0
        support = message_type.__class__
        self._to_python = _function(support._CONVERT_TO_PY, ctypes.py_object, ctypes.c_void_p)
        self._message = _function(support._CREATE_ROS_MESSAGE, ctypes.c_void_p)()
        weakref.finalize(self, _function(support._DESTROY_ROS_MESSAGE, None, ctypes.c_void_p), self._message)
        self._information = _Information()
        self._implementation = get_rmw_implementation_identifier().encode()
        self._take = ctypes.PyDLL("librcl.so").rcl_take
        self._take.argtypes, self._take.restype = [ctypes.c_void_p] * 4, ctypes.c_int
        for waitable in (self, *events.create_event_handlers(group, self._handle, topic)):
            node.add_waitable(waitable)

    def hand_over_to(self, callback) -> None:
        """Let something else take the messages from now on."""
        self._callback = callback

    def __enter__(self):
        """Keep it while it is waited for."""
        self._handle.__enter__()

    def __exit__(self, *error):
        """It may go again."""
        self._handle.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        """One subscription."""
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set) -> None:
        """Let an executor wait for messages."""
        self._index = wait_set.add_subscription(self._handle)

    def is_ready(self, wait_set) -> bool:
        """Tell whether there may be a message."""
        return wait_set.is_ready("subscription", self._index)

    def take_data(self):
        """Take a message; None when there is none."""
        information = ctypes.addressof(self._information)
        if self._take(self._handle.pointer, self._message, information, None) or self._callback is None:
            return None
        publisher = self._information.publisher
        known = publisher.implementation == self._implementation
        return self._to_python(self._message), bytes(publisher.data) if known else b""

    async def execute(self, taken) -> None:
        """Hand a message over."""
        if taken is not None and self._callback is not None:
            self._callback(*taken)


#: Longest wait for an input whose silence has no time-out of its own [s].
PATIENCE = 1.0

#: Seconds between two looks whether this process stands still itself, and looks that may fail to happen.
LOOK, LATE = 0.01, 3.0

#: Seconds in which nodes of other machines are found, and of a look whether they are.
DISCOVERY, TURN = 2.0, 0.05

#: Seconds between two complaints about refused messages.
TELL = 10.0

#: Seconds between two looks whether a master has left the graph while somebody else sends: a look takes as long as ten
#: messages.
GRAPH_LOOK = 0.02

#: Competing publishers whose last looks are kept.
MOST_RIVALS = 64

#: Seconds between two looks for the name of an active publisher that is not known yet.
FIND = 0.2

#: What to do about two masters.
REMEDY = "stop one of them, or give it another namespace or ROS_DOMAIN_ID"


class Master:
    """Who feeds an input."""

    def __init__(self, masters: Masters, topic: str, callback):
        self._masters, self.topic, self._callback = masters, topic, callback
        self.identity: bytes | None = None
        #: Full name of the node of the active publisher, once the graph has said it.
        self.name = ""
        #: Whether a person has allowed that another node feeds the input once this one is silent or has left.
        self.released = False
        self._rival = b""
        self._was_there = False
        self.heard = self._told = -math.inf
        self._looked: dict[bytes, float] = {}
        self.refused = 0

    def take(self, message, identity: bytes) -> None:
        """Take a message, unless it is somebody else's."""
        if identity != self.identity or not identity:
            if not self._masters.is_of_axis(message):
                if self.identity is None:
                    self._callback(message)
                return
            if not self._admits(identity):
                return
        self.heard, self.released = time.monotonic(), False
        self._callback(message)

    def _admits(self, identity: bytes) -> bool:
        masters, now = self._masters, time.monotonic()
        free = self.identity in (None, identity) or self._follows(identity, now)
        if free and (identity or masters.count(self.topic) < 2):
            if self.identity not in (None, identity):
                masters.tell_of_change(self, identity)
                masters.replaced(self)
            if self.identity != identity:
                self.identity, self._was_there, self.name = identity, False, ""
            self.find()
            return True
        self.refused += 1
        self._rival = identity
        if now - self._told > TELL:  # the graph is asked for names then: not for every message of a flood
            self._told = now
            masters.warn(self)
        return False

    def find(self) -> None:
        """Note that the active publisher is in the graph, and its name: only then can it leave, or be followed."""
        if not self.identity or (self._was_there and self.name):
            return
        masters = self._masters
        self._was_there = self._was_there or masters.is_there(self.topic, self.identity)
        self.name = self.name or masters.full_name(self.topic, self.identity)

    def _follows(self, identity: bytes, now: float) -> bool:
        """Tell whether another publisher takes the place of the active one, which is silent or has left the graph.

        Only the same node, by its full name, does so by itself, and any other one after a person has allowed it.
        """
        masters = self._masters
        if now - self._looked.get(identity, -math.inf) < GRAPH_LOOK:
            return False
        over = masters.is_over(self.heard, now)
        if not over and not self._was_there:
            return False
        if len(self._looked) > MOST_RIVALS:
            self._looked.clear()
        self._looked[identity] = now  # for each: a flood of one must not keep another one from being looked at
        if not over and self.identity is not None and masters.is_there(self.topic, self.identity):
            return False
        return self.released or bool(self.name and masters.full_name(self.topic, identity) == self.name)

    @property
    def refusal(self) -> str:
        """What is refused, and what to do."""
        name, rival = (self._masters.name_of(self.topic, who) for who in (self.identity or b"", self._rival))
        return f"{self.topic} is taken from {name}, and nothing of {rival}: {REMEDY}"


class Masters:
    """Who feeds the inputs of a node, and who else feeds the topics of its loop."""

    def __init__(self, node):
        self._node = node
        self._inputs: list[Master] = []
        self._subscriptions: dict[tuple, IdentifiedSubscription] = {}
        self._names: dict[bytes, str] = {}
        self._since = self._looked = self._found = time.monotonic()

    @property
    def patience(self) -> float:
        """Seconds of silence after which another publisher may be taken, if it may be taken at all."""
        found = self._node.patience
        return found if math.isfinite(found) else PATIENCE

    # -- inputs ----------------------------------------------------------------------------------------------------

    def add(self, message_type, topic: str, callback, qos, events):
        """Subscribe an input; the subscription stays when the node is cleaned up, and is used again."""
        master = Master(self, self._node.resolve_topic_name(topic), callback)
        self._inputs.append(master)
        key = (topic, message_type, qos.depth, qos.reliability, qos.durability)
        if key in self._subscriptions:
            self._subscriptions[key].hand_over_to(master.take)
            return self._subscriptions[key]
        try:
            made = IdentifiedSubscription(self._node, message_type, topic, master.take, qos, events)
        except (AttributeError, OSError):  # another ROS than Jazzy: it cannot be told who sends
            return self._node.subscriber(message_type, topic, partial(master.take, identity=b""), qos)
        self._subscriptions[key] = made
        return made

    def release(self) -> None:
        """Let any publisher take an input whose active one is silent or has left: a person has said so."""
        for master in self._inputs:
            master.released = True

    def publisher_of(self, topic: str) -> str:
        """Return the full name of the node that feeds an input; empty while it is not known."""
        full = self._node.resolve_topic_name(topic)
        return next((master.name for master in self._inputs if master.topic == full), "")

    def clear(self) -> None:
        """Take nothing any more."""
        for subscription in self._subscriptions.values():
            subscription.hand_over_to(None)
        self._inputs.clear()

    def begin(self) -> None:
        """Watch whether this process itself stands still, in which it hears nobody."""
        self._since = self._looked = time.monotonic()
        if self._inputs:
            self._node.timer(LOOK, self.look)

    def look(self) -> None:
        """Timer, and before somebody is taken for silent: note whether this process stood still."""
        now = time.monotonic()
        if now - self._looked > max(LATE * LOOK, 0.5 * self.patience):
            self._since = now
        self._looked = now
        if now - self._found > FIND:
            self._found = now
            for master in self._inputs:
                master.find()

    def is_over(self, heard: float, now: float) -> bool:
        """Tell whether who was last heard then has been silent for too long.

        Units: ``heard`` [s], ``now`` [s].
        """
        self.look()
        return now - max(heard, self._since) > self.patience

    def is_of_axis(self, message) -> bool:
        """Tell whether a message concerns this axis: others publish joint_states of theirs on the same topic."""
        return not isinstance(message, JointState) or self._node.parameters.joint in message.name

    # -- names -----------------------------------------------------------------------------------------------------

    def count(self, topic: str) -> int:
        """Return how many publish a topic."""
        return self._node.count_publishers(topic)

    def is_there(self, topic: str, identity: bytes) -> bool:
        """Tell whether the graph knows a publisher of a topic."""
        found = self._node.get_publishers_info_by_topic(topic)
        return any(bytes(endpoint.endpoint_gid) == identity for endpoint in found)

    def full_name(self, topic: str, identity: bytes) -> str:
        """Return the full name of the node of a publisher, empty while the graph does not say it."""
        found = self._node.get_publishers_info_by_topic(topic)
        names = {named(endpoint) for endpoint in found if bytes(endpoint.endpoint_gid) == identity}
        return next((name for name in names if is_name(name)), "")

    def name_of(self, topic: str, identity: bytes) -> str:
        """Return the full name of the node of a publisher; of one that cannot be told, who it may be."""
        found = self._node.get_publishers_info_by_topic(topic)
        names = {named(endpoint) for endpoint in found if not identity or bytes(endpoint.endpoint_gid) == identity}
        text = " or ".join(sorted(names))
        if is_name(text):  # told already: who has left keeps it
            self._names[identity] = text
        return self._names.get(identity) or text or "a node that has left"

    def tell_of_change(self, master: Master, identity: bytes) -> None:
        """Say that somebody else feeds an input from now on."""
        self._node.get_logger().info(
            f"{master.topic} is taken from {self.name_of(master.topic, identity)} now: the one before has left, or "
            f"nothing has come from it for {self.patience:g} s, and it "
            + ("is the same node" if not master.released else "was allowed by ~/reset")
        )

    def replaced(self, master: Master) -> None:
        """Let the runner know that another process of a node feeds an input, unless a person has allowed it."""
        if not master.released:
            self._node.runner.replaced(master.topic, master.name)

    def warn(self, master: Master) -> None:
        """Say that somebody else's message was refused."""
        self._node.warn(f"master {master.topic}", master.refusal, every=0.0, error=True)

    def complaint(self) -> str:
        """Say who feeds the topics of the loop beside their masters; empty when nobody does."""
        node = self._node
        for master in self._inputs:
            master.find()
        refused = {m.topic: m for m in self._inputs if node.since_report(f"refused {m.topic}", m.refused)}
        found = [master.refusal for master in refused.values()]
        topics = {master.topic for master in self._inputs} | set(node.loop_topics)
        for topic in sorted(topics - set(refused)):
            names = publishers(node, topic)
            if len(names) > 1:
                found.append(f"{topic} is published by {' and '.join(names)}: {REMEDY}")
        return "; ".join(found)


def publishers(node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish a topic of the loop; all may publish joint_states of theirs.

    A node that was killed stands in the graph beside the one that was started in its place, for some seconds: of one
    name there is one. Who has not told a name yet may be anybody.
    """
    if node.count_publishers(topic) < 2:
        return []
    found = node.get_publishers_info_by_topic(topic)
    names = [named(endpoint) for endpoint in found if endpoint.topic_type != "sensor_msgs/msg/JointState"]
    return sorted({name for name in names if is_name(name)}) + [name for name in names if not is_name(name)]


def rivals(node) -> list[str]:
    """Say who would lead the axis beside a node that is about to: who publishes what it does, who has its name.

    Who has no name is no reason to stay away: a node that has just left looks like that, and moves nothing.
    """
    own = node.get_fully_qualified_name()
    found = [
        f"{name} publishes {topic}"
        for topic in node.loop_topics
        for name in publishers(node, topic)
        if is_name(name) and name != own
    ]
    if reaches_others():  # on this machine a name is claimed
        names = [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]
        found += [f"another {own} runs on another machine"] * (names.count(own) > 1)
    return found


def require_alone(node) -> None:
    """Refuse that a node goes to work on an axis that somebody leads already."""
    found = rivals(node)
    if found:
        raise HysteresisError(f"{'; '.join(found)}: one axis has one master; {REMEDY}")


def await_discovery(nodes: list) -> None:
    """Wait until nodes of other machines are known, where there may be some, or one is in the way."""
    until = time.monotonic() + (DISCOVERY if reaches_others() else 0.0)
    while time.monotonic() < until and not any(map(rivals, nodes)):
        time.sleep(TURN)
