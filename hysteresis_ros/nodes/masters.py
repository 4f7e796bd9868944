# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One active publisher: a node runs only once in a ROS domain, and each of its inputs accepts only one publisher.

A node claims its name on this machine, because discovery would report a second graph only when both graphs already move
the axis. The kernel releases the claim however the process ends.

A node accepts an input only from the publisher that sent the first message. It recognises this publisher by its
identity (GID), which rclpy does not pass to callbacks. If the active publisher has been silent for the time-out of the
input, or has left the graph, a publisher of a node with the same full name can replace it. Any other publisher can do
so only after ``~/reset`` of the receiving node, or after a new configuration. Messages of a competing publisher have no
effect, and diagnostics name both publishers.
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

#: Time to wait until a process that is about to exit releases its claim [s].
CLAIM_PATIENCE = 5.0
#: Interval between two attempts to claim a node [s].
CLAIM_LOOK = 0.1
#: Part of the message about a refused claim; the fault campaign recognises the message by it.
RUNS_ONCE = "an axis runs each node once"


def _address(domain: int, name: str) -> bytes:
    return b"\0hysteresis_ros/" + hashlib.sha256(f"{domain}{name}".encode()).hexdigest().encode()


def holder(domain: int, name: str) -> str:
    """Return number and command line of the process that has claimed a node; empty without a claim."""
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
    """Claim a node of a domain on this machine; the claim ends when the returned socket is closed or the process ends.

    ``patience`` is the time to wait for another process that is about to exit [s].
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
    owner = holder(domain, name) or "a process of this machine"
    raise HysteresisError(
        f"{name} already runs in ROS domain {domain}: {owner}; {RUNS_ONCE}: stop the other one, or give this "
        "axis another namespace or ROS_DOMAIN_ID"
    )


#: Length of an identity [bytes] (RMW_GID_STORAGE_SIZE of Jazzy).
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
    """Return the C function to which a capsule of a type support points."""
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return ctypes.PYFUNCTYPE(result, *arguments)(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


class IdentifiedSubscription(Waitable):
    """A subscription that passes the publisher's identity with each message; it exists as long as its node.

    It is never removed, because rclpy's EventsExecutor ends the process if a waitable is removed while messages arrive.
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
        """Pass all later messages to another callback; None: discard them."""
        self._callback = callback

    def __enter__(self):
        """Keep the handle valid while an executor waits on it."""
        self._handle.__enter__()

    def __exit__(self, *error):
        """Release the handle."""
        self._handle.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        """Return the number of entities: one subscription."""
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set) -> None:
        """Add the subscription to the wait set of an executor."""
        self._index = wait_set.add_subscription(self._handle)

    def is_ready(self, wait_set) -> bool:
        """Return whether there may be a message."""
        return wait_set.is_ready("subscription", self._index)

    def take_data(self):
        """Take a message; None if no message waits."""
        information = ctypes.addressof(self._information)
        if self._take(self._handle.pointer, self._message, information, None) or self._callback is None:
            return None
        publisher = self._information.publisher
        known = publisher.implementation == self._implementation
        return self._to_python(self._message), bytes(publisher.data) if known else b""

    async def execute(self, taken) -> None:
        """Pass a message to the callback."""
        if taken is not None and self._callback is not None:
            self._callback(*taken)


#: Default time-out of an input [s].
PATIENCE = 1.0

#: Interval between checks whether this process was halted [s].
LOOK = 0.01
#: Time between two checks beyond which this process was halted, if half of the patience is not longer [intervals].
LATE = 3.0

#: Time to discover nodes of other machines [s].
DISCOVERY = 2.0
#: Interval between checks for competing nodes [s].
TURN = 0.05

#: Interval between two reports of refused messages [s].
TELL = 10.0

#: While a competing publisher sends: interval between checks whether the active publisher has left the graph [s]. A
#: check takes as long as processing ten messages.
GRAPH_LOOK = 0.02

#: Number of competing publishers for which the time of the last check is stored.
MOST_RIVALS = 64

#: Interval between searches for the name of an active publisher while it is unknown [s].
FIND = 0.2

#: Remedy for two publishers of one input.
REMEDY = "stop one of them, or give it another namespace or ROS_DOMAIN_ID"


class Master:
    """The active publisher of an input."""

    def __init__(self, masters: Masters, topic: str, callback):
        self._masters, self.topic, self._callback = masters, topic, callback
        self.identity: bytes | None = None
        #: Full name of the node of the active publisher, once it is known.
        self.name = ""
        #: Whether the user has allowed another node to replace an active publisher that is silent or has left.
        self.released = False
        self._rival = b""
        self._was_there = False
        self.heard = self._told = -math.inf
        self._looked: dict[bytes, float] = {}
        self.refused = 0

    def take(self, message, identity: bytes) -> None:
        """Pass on a message, unless it is from a competing publisher."""
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
        if now - self._told > TELL:  # looking up the names for every message is too slow in a flood
            self._told = now
            masters.warn(self)
        return False

    def find(self) -> None:
        """Store the active publisher's name and presence in the graph, which are needed to detect its replacement."""
        if not self.identity or (self._was_there and self.name):
            return
        masters = self._masters
        self._was_there = self._was_there or masters.is_there(self.topic, self.identity)
        self.name = self.name or masters.full_name(self.topic, self.identity)

    def _follows(self, identity: bytes, now: float) -> bool:
        """Return whether another publisher may replace the active publisher, which is silent or has left the graph.

        A node with the same full name replaces it automatically; any other node needs the user's permission.
        """
        masters = self._masters
        if now - self._looked.get(identity, -math.inf) < GRAPH_LOOK:
            return False
        over = masters.is_over(self.heard, now)
        if not over and not self._was_there:
            return False
        if len(self._looked) > MOST_RIVALS:
            self._looked.clear()
        self._looked[identity] = now  # stored for each publisher: a flood from one must not delay the check of another
        if not over and self.identity is not None and masters.is_there(self.topic, self.identity):
            return False
        return self.released or bool(self.name and masters.full_name(self.topic, identity) == self.name)

    @property
    def refusal(self) -> str:
        """Message about the refused publisher, with a remedy."""
        name, rival = (self._masters.name_of(self.topic, one) for one in (self.identity or b"", self._rival))
        return f"{self.topic} is accepted from {name} and refused from {rival}: {REMEDY}"


class Masters:
    """Active publishers of the inputs of a node, and competing publishers of the topics of its loop."""

    def __init__(self, node):
        self._node = node
        self._inputs: list[Master] = []
        self._subscriptions: dict[tuple, IdentifiedSubscription] = {}
        self._names: dict[bytes, str] = {}
        self._since = self._looked = self._found = time.monotonic()

    @property
    def patience(self) -> float:
        """Time of silence after which another publisher may replace the active one [s]."""
        found = self._node.patience
        return found if math.isfinite(found) else PATIENCE

    # -- inputs ----------------------------------------------------------------------------------------------------

    def add(self, message_type, topic: str, callback, qos, events):
        """Subscribe to an input; the subscription is kept at cleanup and used again."""
        master = Master(self, self._node.resolve_topic_name(topic), callback)
        self._inputs.append(master)
        key = (topic, message_type, qos.depth, qos.reliability, qos.durability)
        if key in self._subscriptions:
            self._subscriptions[key].hand_over_to(master.take)
            return self._subscriptions[key]
        try:
            made = IdentifiedSubscription(self._node, message_type, topic, master.take, qos, events)
        except (AttributeError, OSError):  # a ROS distribution other than Jazzy: no identity of the publisher
            return self._node.subscriber(message_type, topic, partial(master.take, identity=b""), qos)
        self._subscriptions[key] = made
        return made

    def release(self) -> None:
        """Allow any publisher to replace an active one that is silent or has left, at the user's request."""
        for master in self._inputs:
            master.released = True

    def publisher_of(self, topic: str) -> str:
        """Return the full name of the node that publishes an input; empty while it is unknown."""
        full = self._node.resolve_topic_name(topic)
        return next((master.name for master in self._inputs if master.topic == full), "")

    def clear(self) -> None:
        """Stop accepting messages."""
        for subscription in self._subscriptions.values():
            subscription.hand_over_to(None)
        self._inputs.clear()

    def begin(self) -> None:
        """Start to monitor whether this process is halted, because a halted process cannot detect silence."""
        self._since = self._looked = time.monotonic()
        if self._inputs:
            self._node.timer(LOOK, self.look)

    def look(self) -> None:
        """Check whether this process was halted; called by a timer, and before a publisher counts as silent."""
        now = time.monotonic()
        if now - self._looked > max(LATE * LOOK, 0.5 * self.patience):
            self._since = now
        self._looked = now
        if now - self._found > FIND:
            self._found = now
            for master in self._inputs:
                master.find()

    def is_over(self, heard: float, now: float) -> bool:
        """Return whether a publisher has been silent for longer than its time-out.

        ``heard`` is the time of its last message, ``now`` the present time [s].
        """
        self.look()
        return now - max(heard, self._since) > self.patience

    def is_of_axis(self, message) -> bool:
        """Return whether a message concerns this axis: other devices may publish on the same joint_states topic."""
        return not isinstance(message, JointState) or self._node.parameters.joint in message.name

    # -- names -----------------------------------------------------------------------------------------------------

    def count(self, topic: str) -> int:
        """Return the number of publishers of a topic."""
        return self._node.count_publishers(topic)

    def is_there(self, topic: str, identity: bytes) -> bool:
        """Return whether a publisher of a topic is in the graph."""
        found = self._node.get_publishers_info_by_topic(topic)
        return any(bytes(endpoint.endpoint_gid) == identity for endpoint in found)

    def full_name(self, topic: str, identity: bytes) -> str:
        """Return the full name of the node of a publisher; empty while it is unknown."""
        found = self._node.get_publishers_info_by_topic(topic)
        names = {named(endpoint) for endpoint in found if bytes(endpoint.endpoint_gid) == identity}
        return next((name for name in names if is_name(name)), "")

    def name_of(self, topic: str, identity: bytes) -> str:
        """Return the full name of the node of a publisher, or the possible names if the publisher is unknown."""
        found = self._node.get_publishers_info_by_topic(topic)
        names = {named(endpoint) for endpoint in found if not identity or bytes(endpoint.endpoint_gid) == identity}
        text = " or ".join(sorted(names))
        if is_name(text):  # keep the name for messages after the node has left
            self._names[identity] = text
        return self._names.get(identity) or text or "a node that has left the graph"

    def tell_of_change(self, master: Master, identity: bytes) -> None:
        """Log that another publisher is now the active publisher."""
        self._node.get_logger().info(
            f"{master.topic} is now accepted from {self.name_of(master.topic, identity)}: the previous publisher has "
            f"left, or has been silent for {self.patience:g} s, and the new one "
            + ("has the same node name" if not master.released else "was allowed by ~/reset")
        )

    def replaced(self, master: Master) -> None:
        """Inform the runner that another process of the same node publishes an input, unless the user allowed it."""
        if not master.released:
            self._node.runner.replaced(master.topic, master.name)

    def warn(self, master: Master) -> None:
        """Log that a competing publisher's message was refused."""
        self._node.warn(f"master {master.topic}", master.refusal, every=0.0, error=True)

    def complaint(self) -> str:
        """Return the competing publishers of the loop's topics; empty if each topic has only one publisher."""
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
    """Return the full names of the nodes that publish a topic of the loop, except joint_states, which may have many.

    Equal names count once, because a killed node stays in the graph for some seconds together with its replacement.
    Publishers without a known name are all counted.
    """
    if node.count_publishers(topic) < 2:
        return []
    found = node.get_publishers_info_by_topic(topic)
    names = [named(endpoint) for endpoint in found if endpoint.topic_type != "sensor_msgs/msg/JointState"]
    return sorted({name for name in names if is_name(name)}) + [name for name in names if not is_name(name)]


def rivals(node) -> list[str]:
    """Return the nodes that compete with a node before its activation: they publish the same topics or have its name.

    A publisher without a known name is ignored: it may belong to a node that has just left the graph and has no effect.
    """
    own = node.get_fully_qualified_name()
    found = [
        f"{name} publishes {topic}"
        for topic in node.loop_topics
        for name in publishers(node, topic)
        if is_name(name) and name != own
    ]
    if reaches_others():  # on this machine the claim ensures unique names
        names = [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]
        found += [f"another {own} runs on another machine"] * (names.count(own) > 1)
    return found


def require_alone(node) -> None:
    """Refuse to activate a node on an axis that another node already commands."""
    found = rivals(node)
    if found:
        raise HysteresisError(f"{'; '.join(found)}: an axis has one active publisher; {REMEDY}")


def await_discovery(nodes: list) -> None:
    """If other machines are reachable, wait until their nodes are discovered, or until a competing node is found."""
    until = time.monotonic() + (DISCOVERY if reaches_others() else 0.0)
    while time.monotonic() < until and not any(map(rivals, nodes)):
        time.sleep(TURN)
