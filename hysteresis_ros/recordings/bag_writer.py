# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Writer of MCAP bags, based on ``rosbags``: chunks survive a kill, and a file on a full disk stays valid.

A chunk is passed to the operating system in one piece. If this fails (full disk), the chunk counts as not written, and
the file is truncated to the end of the previous chunk, so that it never ends inside a record.
"""

from __future__ import annotations

import contextlib
import io
import os
import pathlib
import time
from collections import defaultdict
from collections.abc import Callable
from types import MappingProxyType
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema
from rosbags.interfaces import (
    Connection,
    MessageDefinitionFormat,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings.bag_format import (
    MESSAGE,
    NEVER,
    RECORD,
    FileInformation,
    McapIndex,
    information,
    mcap_file,
    packed,
    text_of,
    write_metadata,
)
from hysteresis_ros.recordings.cdr import MessageForm

#: Name of the MCAP metadata record with a copy of metadata.yaml, as ``ros2 bag`` writes it.
ROSBAG2 = "rosbag2"
#: Key of the copy in this record.
SERIALISED = "serialized_metadata"


class Frames:
    """The bytes of a chunk with the messages of consecutive samples; each sample is a *frame* of constant size."""

    def __init__(self, messages: list[tuple[int, MessageForm]], rows: int):
        """Write the constant part of all frames."""
        frame, self.starts = bytearray(), []
        layout: list[tuple[str, Any, int]] = []
        self._values: list[list[str]] = []
        self._stamps: list[str] = []
        for number, (channel, form) in enumerate(messages):
            start = len(frame)
            data = start + RECORD.size + MESSAGE.size
            self.starts.append(start)
            frame += RECORD.pack(Opcode.MESSAGE, MESSAGE.size + len(form.data)) + MESSAGE.pack(channel, 0, 0, 0)
            frame += form.data
            layout += [(f"log{number}", "<u8", data - 16), (f"publish{number}", "<u8", data - 8)]
            if form.stamp >= 0:
                self._stamps.append(str(number))
                layout.append((f"seconds{number}", "<i4", data + form.stamp))
                layout.append((f"nanoseconds{number}", "<u4", data + form.stamp + 4))
            groups = [(f"values{number}.{i}", *group) for i, group in enumerate(form.values)]
            self._values.append([name for name, *_ in groups])
            layout += [(name, ("<f8", (count,)), data + place) for name, place, count in groups]
        self.channels = [channel for channel, _ in messages]
        self.size = len(frame)
        self.rows = rows
        self.count = 0
        names, formats, offsets = (list(column) for column in zip(*layout, strict=True))
        kind = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size})
        self._bytes = np.tile(np.frombuffer(bytes(frame), np.uint8), (rows, 1))
        self._fields = self._bytes.reshape(-1).view(kind)
        self._times = np.zeros(rows, np.uint64)

    def add(self, stamps, times, values) -> None:
        """Append as many samples as fit."""
        rows = slice(self.count, self.count + len(stamps))
        fields = self._fields[rows]
        self._times[rows] = times
        for number in range(len(self.channels)):
            fields[f"log{number}"] = fields[f"publish{number}"] = times
        seconds, nanoseconds = np.divmod(stamps, 1_000_000_000)
        for message in self._stamps:
            fields[f"seconds{message}"] = seconds
            fields[f"nanoseconds{message}"] = nanoseconds
        for names, groups in zip(self._values, values, strict=True):
            for name, group in zip(names, groups, strict=True):
                fields[name] = np.transpose(group)
        self.count = rows.stop

    def clear(self) -> None:
        """Remove all samples."""
        self.count = 0

    @property
    def data(self) -> memoryview:
        """The records of the samples."""
        return self._bytes[: self.count].reshape(-1).data

    @property
    def times(self) -> np.ndarray:
        """Log times of the samples [ns], shape (n,)."""
        return self._times[: self.count]

    def entries(self, base: int) -> np.ndarray:
        """Return the entries of the message indices for records that begin at ``base``, shape (channels, n, 2)."""
        found = np.empty((len(self.channels), self.count, 2), "<u8")
        found[..., 0] = self.times
        found[..., 1] = np.array(self.starts)[:, None] + (base + self.size * np.arange(self.count))
        return found


class ChunkStorage(McapWriter):
    """The MCAP storage of ``rosbags``, with complete chunks and message indices computed by NumPy."""

    def __init__(self, path, compression):
        """Create the file."""
        super().__init__(path, compression)
        self.bio: Any = self.bio.detach()  # unbuffered
        self.index = McapIndex()

    def rename(self, name: str) -> None:
        """Rename the file in its folder."""
        self.path = self.path.rename(self.path.with_name(name))

    @property
    def size(self) -> int:
        """Size of the file including the pending single messages [bytes]."""
        return self.bio.tell() + self.chunk.bio.tell()

    def add_msgtype(self, connection: Connection) -> None:
        """Write a message type."""
        name = "ros2msg" if connection.msgdef.format == MessageDefinitionFormat.MSG else "ros2idl"
        schema = Schema(len(self.index.schemas) + 1, connection.msgdef.data.encode(), name, connection.msgtype)
        self._append([packed(schema)])
        self.index.schemas[schema.id] = schema

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Write a channel."""
        schema = next(number for number, item in self.index.schemas.items() if item.name == connection.msgtype)
        words = {"offered_qos_profiles": offered_qos_profiles, "topic_type_hash": connection.digest}
        encoding = getattr(connection.ext, "serialization_format", "cdr")
        channel = Channel(connection.id, connection.topic, encoding, words, schema)
        self._append([packed(channel)])
        self.index.channels[channel.id] = channel
        self.channel_stats[channel.id] = 0

    def continue_from(self, before: ChunkStorage) -> None:
        """Add the topics of the previous file, and take over its pending messages."""
        schemas, channels = before.index.schemas, before.index.channels
        self._append([packed(*schemas.values(), *channels.values())])
        self.index.schemas, self.index.channels = dict(schemas), dict(channels)
        self.channel_stats = dict.fromkeys(channels, 0)
        self.chunk, before.chunk = before.chunk, self.chunk

    def write_words(self, name: str, words: dict[str, str]) -> None:
        """Write a metadata record."""
        record = packed(Metadata(name, words))
        place = MetadataIndex(self.bio.tell(), len(record), name)
        self._append([record])
        self.index.metadata.append(place)

    def close_chunk(self) -> None:
        """Write the pending single messages."""
        self._write_chunk([self.chunk.bio.getvalue()], self._pending())

    def write_frames(self, frames: Frames) -> None:
        """Write samples, after the pending single messages."""
        before = self.chunk.bio.getvalue()
        entries = self._pending()
        for channel, own in zip(frames.channels, frames.entries(len(before)), strict=True):
            entries[channel] = np.concatenate([entries[channel], own]) if channel in entries else own
        self._write_chunk([before, frames.data], entries)

    def _pending(self) -> dict:
        return {channel: np.array(messages, "<u8") for channel, messages in self.chunk.msgs.items()}

    def _write_chunk(self, pieces: list, entries: dict) -> None:
        size = sum(len(piece) for piece in pieces)
        if self.compression:
            pieces = [self.compressor(b"".join(pieces))]
        noted = self.index.noted()
        try:
            self._append(self.index.chunk(self.bio.tell(), pieces, size, entries, self.compression))
        except BaseException:
            self.index.forget(noted)
            raise
        self.drop()

    def drop(self) -> None:
        """Discard the pending single messages."""
        self.chunk = PendingChunk(NEVER, 0, io.BytesIO(), defaultdict(list))

    def _append(self, pieces) -> None:
        """Append all pieces to the file, or none."""
        whole = self.bio.tell()
        left = [memoryview(piece) for piece in pieces if len(piece)]
        try:
            while left:
                written = os.writev(self.bio.fileno(), left)
                while left and written >= len(left[0]):
                    written -= len(left.pop(0))
                if left:
                    left[0] = left[0][written:]
        except BaseException:
            # a truncated record would hide all later records
            with contextlib.suppress(OSError):
                self.bio.seek(whole)
                self.bio.truncate()
            raise

    def information(self) -> FileInformation:
        """Return the description of the file."""
        return mcap_file(self.path.name, self.index)

    def close(self, version: int, metadata: str) -> None:
        """Write pending messages and the summary; if the disk is too full, the file stays readable sequentially."""
        with self.bio:
            if self.chunk.msgs:
                self.close_chunk()
            words = packed(Metadata(ROSBAG2, {SERIALISED: metadata}))
            begin = self.bio.tell()
            self.index.metadata.append(MetadataIndex(begin, len(words), ROSBAG2))
            self._append([words, self.index.tail(begin + len(words))])


class ChunkedWriter(Writer):
    """The bag writer of ``rosbags`` with :class:`ChunkStorage`, with one file or several consecutive files."""

    STORAGE_PLUGINS = MappingProxyType({**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: ChunkStorage})

    def __init__(self, path, numbered: bool = False):
        super().__init__(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self.numbered = numbered
        self.files: list[FileInformation] = []

    def open(self) -> None:
        """Create the folder and its first file."""
        super().open()
        if self.numbered:
            self.file.rename(f"{self.path.name}_0.mcap")

    @property
    def file(self) -> ChunkStorage:
        """The file that is being written."""
        storage: Any = self.storage
        return storage

    def next_file(self) -> None:
        """Finish the file; pending messages go to the next file."""
        before = self.file
        after = ChunkStorage(self.path, CompressionMode.NONE)
        try:
            after.rename(f"{self.path.name}_{len(self.files) + 1}.mcap")
            after.continue_from(before)
        except OSError:
            after.bio.close()
            after.path.unlink()
            raise
        self.storage = after
        self._finish(before)

    def _finish(self, file: ChunkStorage) -> None:
        if file.chunk.msgs:
            file.close_chunk()
        self.files.append(file.information())
        file.close(self.version, text_of(information(self.files[-1:], "mcap", self.custom_data)))

    def close(self) -> None:
        """Write pending messages, the index and ``metadata.yaml``."""
        file, self.storage = self.file, None
        try:
            self._finish(file)
        finally:
            file.bio.close()
        write_metadata(self.path, information(self.files, "mcap", self.custom_data))

    def write_frames(self, frames: Frames) -> None:
        """Write samples."""
        if frames.count:
            self.file.write_frames(frames)


#: Size [bytes] of messages at which a chunk is closed and passed to the operating system.
CHUNK_BYTES = 256 * 1024

#: Infinite duration in the format of ROS 2 Jazzy.
_FOREVER = QosTime(9223372036, 854775807)


def offered_qos(durability: str = "volatile", depth: int = 1000) -> tuple[Qos, ...]:
    """Return the QoS of a topic's publisher for a bag: reliable, keep last ``depth``, volatile or transient_local."""
    kinds = {"volatile": QosDurability.VOLATILE, "transient_local": QosDurability.TRANSIENT_LOCAL}
    if durability not in kinds:
        raise RecordingError(f"durability = {durability!r}: must be one of {', '.join(kinds)}")
    return (
        Qos(
            history=QosHistory.KEEP_LAST,
            depth=depth,
            reliability=QosReliability.RELIABLE,
            durability=kinds[durability],
            deadline=_FOREVER,
            lifespan=_FOREVER,
            liveliness=QosLiveliness.AUTOMATIC,
            liveliness_lease_duration=_FOREVER,
            avoid_ros_namespace_conventions=False,
        ),
    )


class BagWriter:
    """Writes one bag folder (``NAME/NAME.mcap`` and ``NAME/metadata.yaml``) that ``ros2 bag`` and MCAP tools open.

    Messages are collected in a chunk. A full chunk is written to the file immediately, so a SIGKILL loses at most the
    open chunk. Call :meth:`flush` regularly (the recorder does, every ``chunk_time``), because a slow axis would take
    minutes to fill a chunk. After a failed write (full disk) the writer accepts nothing more; the earlier messages stay
    readable.

    With ``max_bag_size`` or ``max_bag_duration`` the folder contains ``NAME_0.mcap``, ``NAME_1.mcap`` …, as with ``ros2
    bag record``: each file is complete by itself, and the folder is read as one recording.
    """

    def __init__(self, path, *, chunk_bytes: int = CHUNK_BYTES, max_bag_size: int = 0, max_bag_duration: float = 0.0):
        """Create the folder and open the file."""
        self.path = pathlib.Path(path)
        self.chunk_bytes = int(chunk_bytes)
        self._max_bytes, self._max_nanoseconds = int(max_bag_size), round(1e9 * max_bag_duration)
        self._first_ns = -1
        self._words: dict[str, dict[str, str]] = {}
        self.message_count = 0
        self._connections: dict[str, tuple[str, Any]] = {}
        self._encoders: dict[tuple[str, tuple[str, ...]], cdr.JointStateEncoder] = {}
        self._open_bytes = 0
        self._failure = ""
        self._waiting: list[Callable[[], None]] = []
        try:
            self._writer: ChunkedWriter | None = ChunkedWriter(
                self.path, numbered=self._max_bytes > 0 or self._max_nanoseconds > 0
            )
            self._writer.open()
        except WriterError:
            raise RecordingError(f"{self.path}: exists already; choose another name or remove it") from None
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be created: {error.strerror}; choose another place") from None

    def __enter__(self) -> BagWriter:
        """Return the writer."""
        return self

    def __exit__(self, *exception) -> None:
        """Close the bag, also after an error, and keep the recorded messages."""
        self.close()

    @property
    def closed(self) -> bool:
        """True after :meth:`close`."""
        return self._writer is None

    def add_topic(self, topic: str, type_name: str, durability: str = "volatile") -> None:
        """Add a topic, unless it exists; :meth:`write` adds topics with volatile durability automatically."""
        if topic in self._connections:
            known = self._connections[topic][0]
            if known != type_name:
                raise RecordingError(
                    f"topic {topic} has the type {known} and cannot take {type_name}; use another topic"
                )
            return
        if type_name not in cdr.typestore().types:
            raise RecordingError(
                f"topic {topic}: message type {type_name!r} is not known; use the types of ROS 2 Jazzy"
            )
        qos = offered_qos(durability)
        try:
            made = self._alive().add_connection(topic, type_name, typestore=cdr.typestore(), offered_qos_profiles=qos)
        except OSError as error:
            raise self._failed(error) from None
        self._connections[topic] = type_name, made

    def describe(self, name: str, words: dict[str, str]) -> None:
        """Write texts about the recording into each file of the bag, as a metadata record of MCAP."""
        self._words[name] = words
        try:
            self._alive().file.write_words(name, words)
        except OSError as error:
            raise self._failed(error) from None

    def write(self, topic: str, type_name: str, data: bytes, time_ns: int) -> None:
        """Write one serialised message."""
        connection = self._connections.get(topic)
        if connection is None or connection[0] != type_name:
            self.add_topic(topic, type_name)
            connection = self._connections[topic]
        try:
            writer = self._alive()
            if self._is_over(time_ns):
                self._next_file()
            writer.write(connection[1], int(time_ns), data)
        except OSError as error:
            raise self._failed(error) from None
        self.message_count += 1
        self._open_bytes += len(data) + 31  # 31 bytes of record header around every message
        if self._open_bytes >= self.chunk_bytes:
            self.flush()

    def channel(self, topic: str) -> int:
        """Return the channel of an added topic."""
        return self._connections[topic][1].id

    def on_flush(self, write: Callable[[], None]) -> None:
        """Register ``write`` for each flush and the end; it writes messages that its owner has collected."""
        self._waiting.append(write)

    def write_frames(self, frames: Frames) -> None:
        """Write the messages of many samples as one chunk, after the pending single messages."""
        try:
            writer = self._alive()
            if self._is_over(int(frames.times[0])) or self._is_full(frames.size * frames.count):
                self._next_file()
            writer.write_frames(frames)
        except OSError as error:
            raise self._failed(error) from None
        self.message_count += frames.count * len(frames.channels)
        self._open_bytes = 0

    def write_float64(self, topic: str, value: float, time_ns: int) -> None:
        """Write a std_msgs/Float64."""
        self.write(topic, cdr.FLOAT64, cdr.encode_float64(value), time_ns)

    def write_string(self, topic: str, text: str, time_ns: int) -> None:
        """Write a std_msgs/String."""
        self.write(topic, cdr.STRING, cdr.encode_string(text), time_ns)

    def write_joint_state(self, topic: str, stamp_ns: int, names, positions, time_ns: int | None = None) -> None:
        """Write a sensor_msgs/JointState with ``names`` and ``position``; ``time_ns`` is by default its stamp."""
        key = (topic, tuple(names))
        encoder = self._encoders.get(key)
        if encoder is None:
            encoder = self._encoders[key] = cdr.JointStateEncoder(names)
        received = stamp_ns if time_ns is None else time_ns
        self.write(topic, cdr.JOINT_STATE, encoder.encode(stamp_ns, positions), received)

    def flush(self) -> None:
        """Close the open chunk and pass it to the operating system, so that it survives a kill of this process."""
        for write in self._waiting:
            write()
        writer = self._alive()
        try:
            # an empty chunk has no times and would confuse readers
            if self._open_bytes:
                if self._is_full(0):
                    self._next_file()
                writer.file.close_chunk()
        except OSError as error:
            raise self._failed(error) from None
        self._open_bytes = 0

    def close(self) -> None:
        """Write pending messages, the index and ``metadata.yaml``; idempotent."""
        if self._writer is None:
            return
        try:
            if not self._failure:
                for write in self._waiting:
                    write()
        finally:
            writer, self._writer = self._writer, None
            try:
                writer.close()
            except OSError as error:
                raise RecordingError(f"{self.path}: cannot be finished: {error.strerror}") from None

    def _is_over(self, time_ns: int) -> bool:
        """Return whether a message of this time belongs to the next file."""
        if self._first_ns < 0:
            self._first_ns = time_ns
        return 0 < self._max_nanoseconds <= time_ns - self._first_ns

    def _is_full(self, more: int) -> bool:
        """Return whether a chunk of pending messages and ``more`` bytes would make the file too large."""
        file = self._alive().file
        return self._max_bytes > 0 and bool(file.index.chunks) and file.size + more > self._max_bytes

    def _next_file(self) -> None:
        writer = self._alive()
        writer.next_file()
        self._first_ns = -1
        for name, words in self._words.items():
            writer.file.write_words(name, words)

    def _failed(self, error: OSError) -> RecordingError:
        """Return the error of a failed write; every later write raises the same error."""
        self._failure = f"{self.path}: cannot be written: {error.strerror}"
        if self._writer is not None:
            self._writer.file.drop()  # leaves more space for the end of the file
        return RecordingError(self._failure)

    def _alive(self) -> ChunkedWriter:
        if self._failure:
            raise RecordingError(self._failure)
        if self._writer is None:
            raise RecordingError(f"{self.path}: the bag is already closed; open a new one")
        return self._writer


#: Interval between checks of the disk [s].
LOOK = 1.0


class GuardedBag:
    """Writes to a bag until a write fails or the disk is nearly full; flushes the bag regularly."""

    def __init__(self, bag: BagWriter, flush_time: float):
        self.bag: BagWriter | None = bag
        self.path: pathlib.Path = bag.path
        self.stopped = ""
        self.messages = 0
        self._flush_time = flush_time
        self._flushed = self._looked = time.monotonic()
        self.free = free_space(self.path)

    def attempt(self, write) -> None:
        """Call ``write(bag)`` unless the recording has ended; a failed write ends it."""
        if self.bag is None:
            return
        try:
            write(self.bag)
        except RecordingError as error:
            self.stop(str(error))

    def tend(self, min_space: int) -> None:
        """Flush the bag and check the disk when their intervals have passed."""
        now = time.monotonic()
        if now - self._flushed >= self._flush_time:
            self._flushed = now
            self.attempt(BagWriter.flush)
        if self.bag is not None and now - self._looked >= LOOK:
            self._looked, self.free = now, free_space(self.path)
            if self.free < min_space:
                self.stop(
                    f"{self.path}: {self.free / 1e6:.4g} MB are free on the disk, less than min_space = "
                    f"{min_space / 1e6:.4g} MB; free some space and record into another folder"
                )

    def stop(self, reason: str) -> None:
        """End the recording for a reason; the bag is complete up to here if the disk has space for the index."""
        self.stopped = reason
        try:
            self.finish()
        except RecordingError:
            self.stopped += f"; its index is missing: hysteresis repair {self.path}"

    def finish(self) -> None:
        """Close the bag."""
        bag, self.bag = self.bag, None
        if bag is not None:
            try:
                bag.close()
            finally:
                self.messages = bag.message_count

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return self.messages if self.bag is None else self.bag.message_count


def free_space(path: pathlib.Path) -> int:
    """Return how many bytes an unprivileged process can write to the disk of a file or folder."""
    found = os.statvfs(path)
    return found.f_bavail * found.f_frsize


def require_space(path, least: int) -> None:
    """Refuse to begin a recording without enough space."""
    path = pathlib.Path(path).absolute()
    there = next(parent for parent in path.parents if parent.exists())
    free = free_space(there)
    if free < least:
        raise RecordingError(
            f"{path}: {free / 1e6:.4g} MB are free on the disk, less than min_space = {least / 1e6:.4g} MB; free "
            "some space, record elsewhere, or lower min_space of the recorder"
        )
