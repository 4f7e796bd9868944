# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""MCAP files written in whole chunks: message by message through ``rosbags``, or many samples in one go; bags of them.

A chunk goes to the operating system in one piece. When that fails (a full disk) the file is cut back to the chunk
before, so that it never ends in the middle of a record, and nothing of the chunk counts as written.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections import defaultdict
from types import MappingProxyType
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk

from hysteresis_ros.recordings.bag_metadata import FileInformation, information, mcap_file, text_of, write_metadata
from hysteresis_ros.recordings.cdr import MessageForm
from hysteresis_ros.recordings.mcap_index import MESSAGE, NEVER, RECORD, McapIndex, packed

#: Metadata record of an MCAP file in which ``ros2 bag`` keeps what else stands in metadata.yaml, and its key.
ROSBAG2, SERIALISED = "rosbag2", "serialized_metadata"


class Frames:
    """The messages of one sample after another: a *frame* a sample, all of one size, as the bytes of a chunk.

    Parameters
    ----------
    messages : sequence of (int, MessageForm)
        The messages of a sample in order: channel and form.
    rows : int
        Most samples that are held.
    """

    def __init__(self, messages: list[tuple[int, MessageForm]], rows: int):
        """Write what is the same in all frames."""
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
        """Append samples, as many as there is room for at most.

        Parameters
        ----------
        stamps : ndarray, shape (n,)
            Stamps of the samples [ns].
        times : ndarray, shape (n,)
            When they were made [ns].
        values : sequence of sequences of ndarray, shape (m, n)
            For each message its groups of numbers.
        """
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
        """Begin anew."""
        self.count = 0

    @property
    def data(self) -> memoryview:
        """The records of the samples."""
        return self._bytes[: self.count].reshape(-1).data

    @property
    def times(self) -> np.ndarray:
        """When the samples were made [ns], shape (n,)."""
        return self._times[: self.count]

    def entries(self, base: int) -> np.ndarray:
        """Return the entries of the message indices, shape (channels, n, 2), of records that begin at ``base``."""
        found = np.empty((len(self.channels), self.count, 2), "<u8")
        found[..., 0] = self.times
        found[..., 1] = np.array(self.starts)[:, None] + (base + self.size * np.arange(self.count))
        return found


class ChunkStorage(McapWriter):
    """The MCAP storage of ``rosbags``, with whole chunks and message indices made by NumPy.

    Parameters
    ----------
    path : pathlib.Path
        Folder of the bag.
    compression : CompressionMode
        Of its chunks.
    """

    def __init__(self, path, compression):
        """Create the file."""
        super().__init__(path, compression)
        self.bio: Any = self.bio.detach()  # nothing waits in a buffer
        self.index = McapIndex()

    def rename(self, name: str) -> None:
        """Give the file another name in its folder."""
        self.path = self.path.rename(self.path.with_name(name))

    @property
    def size(self) -> int:
        """Bytes that the file will have when the messages that came one by one are written."""
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
        """Announce the topics of the file before, and take over the messages that it has not written yet."""
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
        """Write the messages that came one by one."""
        self._write_chunk([self.chunk.bio.getvalue()], self._pending())

    def write_frames(self, frames: Frames) -> None:
        """Write samples, after the messages that came one by one before.

        Raises
        ------
        OSError
            The disk is full; then nothing of it is in the file.
        """
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
        """Forget the messages that came one by one and are not in the file."""
        self.chunk = PendingChunk(NEVER, 0, io.BytesIO(), defaultdict(list))

    def _append(self, pieces) -> None:
        """Write pieces at the end of the file, all or none."""
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
            # a record that breaks off would hide all that is written later
            with contextlib.suppress(OSError):
                self.bio.seek(whole)
                self.bio.truncate()
            raise

    def information(self) -> FileInformation:
        """Return what stands in the file."""
        return mcap_file(self.path.name, self.index)

    def close(self, version: int, metadata: str) -> None:
        """Write what waits, and the summary; without room for it the file stays readable in its order."""
        with self.bio:
            if self.chunk.msgs:
                self.close_chunk()
            words = packed(Metadata(ROSBAG2, {SERIALISED: metadata}))
            begin = self.bio.tell()
            self.index.metadata.append(MetadataIndex(begin, len(words), ROSBAG2))
            self._append([words, self.index.tail(begin + len(words))])


class ChunkedWriter(Writer):
    """The bag writer of ``rosbags`` with :class:`ChunkStorage`, in one file or, one after the other, in several.

    Parameters
    ----------
    path : path-like
        Folder to create.
    numbered : bool
        Name the files ``NAME_0.mcap``, ``NAME_1.mcap`` …, not ``NAME.mcap``.
    """

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
        """Finish the file; what is not written yet comes into the next one.

        Raises
        ------
        OSError
            The disk is full.
        """
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
        """Write what waits, the index and ``metadata.yaml``.

        Raises
        ------
        OSError
            The disk is full.
        """
        file, self.storage = self.file, None
        try:
            self._finish(file)
        finally:
            file.bio.close()
        write_metadata(self.path, information(self.files, "mcap", self.custom_data))

    def write_frames(self, frames: Frames) -> None:
        """Write samples.

        Raises
        ------
        OSError
            The disk is full; then nothing of it is in the file.
        """
        if frames.count:
            self.file.write_frames(frames)
