# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""MCAP files written in whole chunks: message by message through ``rosbags``, or many samples in one go.

A chunk goes to the operating system in one piece. When that fails (a full disk) the file is cut back to the chunk
before, so that it never ends in the middle of a record, and nothing of the chunk counts as written.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
from collections import defaultdict
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk

from hysteresis_ros.recordings.cdr import MessageForm

# Records of the MCAP format (https://mcap.dev/spec): opcode and length, then the content.
MESSAGE, CHUNK, MESSAGE_INDEX = 0x05, 0x06, 0x07
_RECORD = struct.Struct("<BQ")
#: Of a message: channel, sequence number, log time, publish time.
_MESSAGE = struct.Struct("<HIQQ")
#: Of a chunk: first and last log time, size, checksum (0: none), length of the name of the compression.
_CHUNK = struct.Struct("<QQQII")
#: Of a message index: channel, bytes of entries. An entry is log time and place in the chunk.
_INDEX = struct.Struct("<HI")
_ENTRY = 16

#: Start and end of a chunk without messages, as ``rosbags`` has them.
_NO_TIMES = 2**63 - 1, 0


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
            data = start + _RECORD.size + _MESSAGE.size
            self.starts.append(start)
            frame += _RECORD.pack(MESSAGE, _MESSAGE.size + len(form.data)) + _MESSAGE.pack(channel, 0, 0, 0) + form.data
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


@dataclass(frozen=True)
class _Content:
    """What goes into a chunk: pieces of its data, message indices by channel, first and last time."""

    pieces: list
    entries: dict
    start: int
    end: int


class ChunkStorage(McapWriter):
    """The MCAP storage of ``rosbags``, with whole chunks and message indices made by NumPy."""

    def __init__(self, path, compression):
        """Create the file."""
        super().__init__(path, compression)
        self.bio: Any = self.bio.detach()  # nothing waits in a buffer

    def close_chunk(self) -> None:
        """Write the messages that came one by one."""
        self._write_chunk(self._pending())

    def write_frames(self, frames: Frames) -> None:
        """Write samples, after the messages that came one by one before.

        Raises
        ------
        OSError
            The disk is full; then nothing of it is in the file.
        """
        pending = self._pending()
        base = sum(len(piece) for piece in pending.pieces)
        entries = dict(pending.entries)
        for channel, own in zip(frames.channels, frames.entries(base), strict=True):
            entries[channel] = np.concatenate([entries[channel], own]) if channel in entries else own
        start, end = int(frames.times.min()), int(frames.times.max())
        times = min(start, pending.start), max(end, pending.end)
        self._write_chunk(_Content([*pending.pieces, frames.data], entries, *times))
        for channel in frames.channels:
            self.channel_stats[channel] += frames.count
        self.message_start_time = min(self.message_start_time, start)
        self.message_end_time = max(self.message_end_time, end)

    def _pending(self) -> _Content:
        chunk = self.chunk
        entries = {channel: np.array(messages, "<u8") for channel, messages in chunk.msgs.items()}
        return _Content([chunk.bio.getvalue()], entries, chunk.message_start_time, chunk.message_end_time)

    def _write_chunk(self, content: _Content) -> None:
        size = sum(len(piece) for piece in content.pieces)
        pieces = content.pieces
        if self.compression:
            pieces = [self.compressor(b"".join(pieces))]
        stored = sum(len(piece) for piece in pieces)
        name = self.compression.encode()
        head = _CHUNK.pack(content.start, content.end, size, 0, len(name)) + name + struct.pack("<Q", stored)
        begin = self.bio.tell()
        length = _RECORD.size + len(head) + stored
        indices, places = bytearray(), []
        for channel, entries in content.entries.items():
            places.append((channel, begin + length + len(indices)))
            bytes_ = _ENTRY * len(entries)
            indices += _RECORD.pack(MESSAGE_INDEX, _INDEX.size + bytes_) + _INDEX.pack(channel, bytes_)
            indices += entries.tobytes()
        self._append([_RECORD.pack(CHUNK, len(head) + stored) + head, *pieces, indices])
        # what follows stands in the summary at the end of the file: a chunk index record
        summary = io.BytesIO()
        summary.write(struct.pack("<QQQQ", content.start, content.end, begin, length))
        summary.write(struct.pack("<I", 10 * len(places)))
        summary.write(b"".join(struct.pack("<HQ", *place) for place in places))
        summary.write(struct.pack("<QI", len(indices), len(name)) + name + struct.pack("<QQ", stored, size))
        self.chunks.append(summary)
        self.chunk = PendingChunk(*_NO_TIMES, io.BytesIO(), defaultdict(list))

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

    def close(self, version: int, metadata: str) -> None:
        """Write what waits, and the summary; without room for it the file stays readable in its order."""
        file = self.bio
        try:
            if self.chunk.bio.tell():
                self.close_chunk()
            self.bio = tail = _Tail(file.tell())
            super().close(version, metadata)
            self.bio = file
            self._append([tail.getbuffer()])
        finally:
            file.close()


class _Tail(io.BytesIO):
    """The end of a file, collected in memory; places are those in the file."""

    def __init__(self, origin: int):
        super().__init__()
        self._origin = origin

    def tell(self) -> int:
        return self._origin + super().tell()

    def close(self) -> None:
        """Keep what was collected."""


class ChunkedWriter(Writer):
    """The bag writer of ``rosbags`` with :class:`ChunkStorage`."""

    STORAGE_PLUGINS = MappingProxyType({**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: ChunkStorage})

    def write_frames(self, frames: Frames) -> None:
        """Write samples.

        Raises
        ------
        OSError
            The disk is full; then nothing of it is in the file.
        """
        if not frames.count:
            return
        storage: Any = self.storage
        storage.write_frames(frames)
        for channel in frames.channels:
            self.counts[channel] += frames.count
        self.min_timestamp = min(self.min_timestamp, int(frames.times.min()))
        self.max_timestamp = max(self.max_timestamp, int(frames.times.max()))
