# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Serialised messages of bags (CDR), encoded and decoded with the Jazzy types of ``rosbags``.

A run of a minute at 3 kHz has two million messages; decoding them individually takes a minute. All messages of a topic
usually share the layout of the first message. If all its significant bytes agree in all messages, the numbers are
extracted in one operation; otherwise the messages are decoded one by one.
"""

from __future__ import annotations

import functools
import struct
from dataclasses import dataclass

import numpy as np
from rosbags.typesys import Stores, get_typestore

from hysteresis_ros.errors import RecordingError

FLOAT64 = "std_msgs/msg/Float64"
STRING = "std_msgs/msg/String"
JOINT_STATE = "sensor_msgs/msg/JointState"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")


@functools.cache
def typestore():
    """Return the message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def encode_float64(value: float) -> bytes:
    """Return a std_msgs/Float64."""
    return _LITTLE_ENDIAN + struct.pack("<d", value)


def encode_string(text: str) -> bytes:
    """Return a std_msgs/String."""
    types = typestore()
    return bytes(types.serialize_cdr(types.types[STRING](data=text), STRING))


@dataclass(frozen=True)
class MessageForm:
    """A message of fixed size, the template for messages that differ only in stamp and numbers."""

    data: bytes  #: CDR including the four-byte header; stamp and numbers are zero.
    stamp: int  #: Position of the stamp in ``data`` (int32 seconds, uint32 nanoseconds); -1: no stamp.
    values: tuple[tuple[int, int], ...]  #: Position and length of each group of float64 numbers.


def float64_form() -> MessageForm:
    """Return the template of std_msgs/Float64."""
    return MessageForm(encode_float64(0.0), -1, ((4, 1),))


def joint_state_form(names, frame_id: str = "", *, moving: bool = False) -> MessageForm:
    """Return the template of sensor_msgs/JointState."""
    types = typestore()
    kinds = types.types
    count = len(names)
    further = np.zeros(count if moving else 0)
    stamp = kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    message = kinds[JOINT_STATE](
        header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id),
        name=list(names),
        position=np.zeros(count),
        velocity=further,
        effort=further,
    )
    data = bytes(types.serialize_cdr(message, JOINT_STATE))
    places = [_joint_state_layout(data).offset]
    while moving and len(places) < 3:
        # a length precedes the numbers; eight-byte numbers are aligned relative to the end of the header
        place = places[-1] + 8 * count + 4
        places.append(place + (4 - place) % 8)
    return MessageForm(data, 4, tuple((place, count) for place in places))


class JointStateEncoder:
    """Encodes JointState messages with fixed names, and varying stamp and positions."""

    def __init__(self, names, frame_id: str = ""):
        """Serialise one message as a template for all."""
        form = joint_state_form(names, frame_id)
        self._buffer = bytearray(form.data)
        self._stamp = form.stamp
        ((self._offset, count),) = form.values
        self._positions = struct.Struct(f"<{count}d")

    def encode(self, stamp_ns: int, positions) -> bytes:
        """Return the message of one sample."""
        _STAMP.pack_into(self._buffer, self._stamp, *divmod(int(stamp_ns), 1_000_000_000))
        self._positions.pack_into(self._buffer, self._offset, *positions)
        return bytes(self._buffer)


@dataclass(frozen=True)
class JointStates:
    """All JointState messages of a topic."""

    stamps: np.ndarray  #: shape (N,); Header stamps [ns], int64.
    names: tuple[str, ...]  #: Names of the columns of ``positions``.
    positions: np.ndarray  #: shape (N, n); Values; NaN where a message lacks a name.

    def take(self, rows) -> JointStates:
        """Return the messages of the given rows."""
        return JointStates(self.stamps[rows], self.names, self.positions[rows])

    def signal(self, name: str) -> np.ndarray | None:
        """Return one signal, shape (N,), or None for an unknown name."""
        return self.positions[:, self.names.index(name)] if name in self.names else None


def decode_float64s(raws, topic: str) -> np.ndarray:
    """Return the values of Float64 messages, shape (N,)."""
    if raws and all(len(raw) == 12 for raw in raws):
        table = np.frombuffer(b"".join(raws), dtype=np.uint8).reshape(len(raws), 12)
        if np.all(table[:, 1] == 1):
            return table[:, 4:].copy().view("<f8")[:, 0].astype(np.float64)
    return np.array([_decode(raw, FLOAT64, topic).data for raw in raws], dtype=np.float64)


def decode_strings(raws, topic: str) -> list[str]:
    """Return the texts of String messages."""
    return [_decode(raw, STRING, topic).data for raw in raws]


def decode_diagnostics(raws, topic: str) -> list[tuple[int, str, int, str, dict[str, str]]]:
    """Return (stamp [ns], name, level, message, values) of every status in DiagnosticArray messages."""
    rows = []
    for raw in raws:
        array = _decode(raw, DIAGNOSTICS, topic)
        stamp = array.header.stamp.sec * 1_000_000_000 + array.header.stamp.nanosec
        for status in array.status:
            values = {item.key: item.value for item in status.values}
            rows.append((stamp, status.name, int(status.level), status.message, values))
    return rows


def decode_joint_states(raws, topic: str) -> JointStates:
    """Return all JointState messages of a topic as arrays."""
    if not raws:
        return JointStates(np.zeros(0, dtype=np.int64), (), np.zeros((0, 0)))
    first = _decode(raws[0], JOINT_STATE, topic)
    layout = _joint_state_layout(raws[0]) if raws[0][:2] == _LITTLE_ENDIAN[:2] else None
    if layout is not None and layout.count == len(first.name) and all(len(raw) == layout.size for raw in raws):
        table = np.frombuffer(b"".join(raws), dtype=np.uint8).reshape(len(raws), layout.size)
        if np.all(table[:, layout.significant] == table[0, layout.significant]):
            stamps = table[:, 4:12].copy()
            seconds, nanoseconds = stamps.view("<i4")[:, 0], stamps.view("<u4")[:, 1]
            end = layout.offset + 8 * layout.count
            positions = table[:, layout.offset : end].copy().view("<f8").astype(np.float64)
            return JointStates(seconds.astype(np.int64) * 1_000_000_000 + nanoseconds, tuple(first.name), positions)
    return _decode_one_by_one(raws, topic)


def _decode_one_by_one(raws, topic: str) -> JointStates:
    messages = [_decode(raw, JOINT_STATE, topic) for raw in raws]
    names = tuple(dict.fromkeys(name for message in messages for name in message.name))
    index = {name: i for i, name in enumerate(names)}
    stamps = np.zeros(len(messages), dtype=np.int64)
    positions = np.full((len(messages), len(names)), np.nan)
    for k, message in enumerate(messages):
        stamps[k] = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        for name, value in zip(message.name, message.position, strict=False):
            positions[k, index[name]] = value
    return JointStates(stamps, names, positions)


def _decode(raw, kind: str, topic: str):
    try:
        return typestore().deserialize_cdr(raw, kind)
    except Exception as error:  # for damaged bytes the type store may raise any exception
        raise RecordingError(f"a message on {topic} is not a {kind}: {type(error).__name__}: {error}") from None


@dataclass(frozen=True)
class _Layout:
    size: int
    offset: int
    count: int
    significant: np.ndarray


def _joint_state_layout(raw: bytes) -> _Layout:
    """Return the layout of a little-endian JointState; padding, which writers leave undefined, is ignored."""
    significant = np.zeros(len(raw), dtype=bool)
    significant[:2] = True
    cursor = 12

    def length():
        nonlocal cursor
        cursor += -(cursor - 4) % 4
        (value,) = _LENGTH.unpack_from(raw, cursor)
        significant[cursor : cursor + 4] = True
        cursor += 4
        return value

    def text():
        nonlocal cursor
        size = length()
        significant[cursor : cursor + size] = True
        cursor += size

    text()
    for _ in range(length()):
        text()
    count = length()
    if count:
        cursor += -(cursor - 4) % 8
    offset = cursor
    cursor += 8 * count
    # equal sizes of the message and equal lengths of velocity imply equal lengths of effort, and so equal layouts
    length()
    return _Layout(len(raw), offset, count, significant)
