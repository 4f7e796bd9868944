# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Messages together with who sent them: rclpy's callbacks do not tell, ROS does.

Each message comes with the identity (GID) of its publisher, which rclpy leaves out of what it hands over. The C library
below it is asked here, for the same kind of subscription; the graph knows publishers by the same identity.
"""

from __future__ import annotations

import ctypes
import weakref

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.type_support import check_for_type_support
from rclpy.utilities import get_rmw_implementation_identifier
from rclpy.waitable import NumberOfEntities, Waitable

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

    Parameters
    ----------
    node : rclpy.node.Node
        Holds it as a waitable.
    message_type : type
        Of the messages.
    topic : str
        As the node names it.
    callback : callable
        Takes a message and the identity of its publisher (``bytes``), which is empty where the identity is not where
        Jazzy has it.
    qos : rclpy.qos.QoSProfile
        Quality of service.
    events : rclpy.event_handler.SubscriptionEventCallbacks
        What hears of publishers that do not fit.
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
        """Let something else take the messages from now on.

        Parameters
        ----------
        callback : callable or None
            None: they are thrown away.
        """
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
