# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Index and footer of an MCAP file, and ``metadata.yaml`` (version 9) of a bag."""

from __future__ import annotations

import os
import pathlib
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
import yaml
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from hysteresis_ros.files import FAST_DUMPER

MAGIC = b"\x89MCAP0\r\n"

#: Header of a record: opcode and length; the content follows (https://mcap.dev/spec).
RECORD = struct.Struct("<BQ")
#: Header of a message: channel, sequence number, log time, publish time.
MESSAGE = struct.Struct("<HIQQ")
#: Header of a chunk: first and last log time, unpacked size, checksum (0: none), length of the compression's name.
CHUNK = struct.Struct("<QQQII")
#: Header of a message index: channel, length of the entries in bytes. An entry is a log time and a position in the
#: chunk.
INDEX = struct.Struct("<HI")
ENTRY = 16

#: Log time later than all others: the first log time of a chunk without messages.
NEVER = 2**63 - 1


def packed(*records: McapRecord) -> bytes:
    """Return the bytes of records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def records_in(data) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of the content of each complete record in ``data``."""
    cursor, size = 0, len(data)
    while cursor + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(data, cursor)
        begin = cursor + RECORD.size
        cursor = begin + length
        if cursor > size:
            return
        yield opcode, begin, cursor


def records_of(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and length of the content of each complete record, from the stream's position on."""
    cursor = stream.tell()
    while cursor + RECORD.size <= size:
        stream.seek(cursor)
        opcode, length = RECORD.unpack(stream.read(RECORD.size))
        begin = cursor + RECORD.size
        cursor = begin + length
        if cursor > size:
            return
        yield opcode, begin, length


@dataclass
class McapIndex:
    """The summary of a file that is being written."""

    schemas: dict[int, Schema] = field(default_factory=dict)  #: schemas, channels: Records by their number.
    channels: dict[int, Channel] = field(default_factory=dict)
    #: Chunk index records, packed because a long recording has very many.
    chunks: list[bytes] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)  #: attachments, metadata: Index records.
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)  #: Number of messages by channel.
    start: int = NEVER  #: start, end: First and last log time [ns].
    end: int = 0

    @property
    def message_count(self) -> int:
        """Messages in the file."""
        return sum(self.counts.values())

    def chunk(self, begin: int, pieces: list, size: int, entries: dict[int, np.ndarray], compression: str = "") -> list:
        """Add a chunk to the index, and return the pieces to write: the chunk's record and its message indices."""
        times = [column[:, 0] for column in entries.values()]
        start = min((int(column.min()) for column in times), default=0)
        end = max((int(column.max()) for column in times), default=0)
        stored = sum(len(piece) for piece in pieces)
        name = compression.encode()
        head = CHUNK.pack(start, end, size, 0, len(name)) + name + struct.pack("<Q", stored)
        length = RECORD.size + len(head) + stored
        places, index = self._message_indices(begin + length, entries)
        self.chunks.append(packed(ChunkIndex(length, begin, compression, stored, end, len(index), places, start, size)))
        for channel, column in entries.items():
            self.counts[channel] = self.counts.get(channel, 0) + len(column)
        if times:
            self.start, self.end = min(start, self.start), max(end, self.end)
        return [RECORD.pack(Opcode.CHUNK, len(head) + stored) + head, *pieces, index]

    def noted(self) -> tuple:
        """Return the present state of the index, for :meth:`forget`."""
        return dict(self.counts), len(self.chunks), self.start, self.end

    def forget(self, noted: tuple) -> None:
        """Restore an earlier state, after later entries could not be written to the file."""
        self.counts, chunks, self.start, self.end = noted
        del self.chunks[chunks:]

    @staticmethod
    def _message_indices(begin: int, entries: dict) -> tuple[dict[int, int], bytes]:
        places, index = {}, bytearray()
        for channel, column in entries.items():
            places[channel] = begin + len(index)
            size = ENTRY * len(column)
            index += RECORD.pack(Opcode.MESSAGE_INDEX, INDEX.size + size) + INDEX.pack(channel, size)
            index += column.astype("<u8", copy=False).tobytes()
        return places, bytes(index)

    def tail(self, begin: int) -> bytes:
        """Return the bytes after the data: end of data, summary and footer; the data end at offset ``begin``."""
        head = packed(DataEnd(0))
        groups = [
            (Opcode.SCHEMA, [packed(record) for record in self.schemas.values()]),
            (Opcode.CHANNEL, [packed(record) for record in self.channels.values()]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.ATTACHMENT_INDEX, [packed(record) for record in self.attachments]),
            (Opcode.METADATA_INDEX, [packed(record) for record in self.metadata]),
            (Opcode.STATISTICS, [packed(self._statistics())]),
        ]
        start = place = begin + len(head)
        summary, offsets = [], []
        for opcode, records in groups:
            content = b"".join(records)
            if content:
                offsets.append(SummaryOffset(opcode, place, len(content)))
                summary.append(content)
                place += len(content)
        whole = b"".join(summary) + packed(*offsets)
        footer = packed(Footer(start, place, 0))[:-4]
        checksum = zlib.crc32(whole + footer)
        return head + whole + footer + struct.pack("<I", checksum) + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts={channel: self.counts.get(channel, 0) for channel in self.channels},
            chunk_count=len(self.chunks),
            message_count=self.message_count,
            message_end_time=self.end,
            message_start_time=self.start if self.message_count else 0,
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


METADATA = "metadata.yaml"

#: Top-level key of ``metadata.yaml``.
INFORMATION = "rosbag2_bagfile_information"

VERSION = 9


@dataclass
class TopicInformation:
    """Description of a topic in a bag."""

    #: name, type_name, encoding, digest: Topic, message type, serialisation, and hash of the type (empty if unknown).
    name: str
    type_name: str
    encoding: str = "cdr"
    digest: str = ""
    qos: Sequence[Qos] = ()  #: QoS that the publishers of the topic offer.
    count: int = 0  #: Number of messages.


@dataclass
class FileInformation:
    """Description of one file of a bag."""

    name: str  #: Name of the file in the folder.
    start: int = NEVER  #: start, end: Times of the first and the last message [ns].
    end: int = 0
    topics: list[TopicInformation] = field(default_factory=list)  #: Topics in the file.

    @property
    def count(self) -> int:
        """Messages in the file."""
        return sum(topic.count for topic in self.topics)


def mcap_file(name: str, index: McapIndex) -> FileInformation:
    """Return the description of an MCAP file from its index."""
    found = FileInformation(name, index.start, index.end)
    for number, channel in index.channels.items():
        schema = index.schemas.get(channel.schema_id)
        found.topics.append(
            TopicInformation(
                channel.topic,
                schema.name if schema else "",
                channel.message_encoding,
                channel.metadata.get("topic_type_hash", ""),
                _qos(channel.metadata.get("offered_qos_profiles", "")),
                index.counts.get(number, 0),
            )
        )
    return found


def information(files: Sequence[FileInformation], storage: str, custom: dict[str, str] | None = None) -> dict:
    """Return the content of ``metadata.yaml`` of a bag."""
    return {
        "version": VERSION,
        "storage_identifier": storage,
        "duration": _duration(files),
        "starting_time": _starting_time(files),
        "message_count": sum(file.count for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": topic.encoding,
                    "offered_qos_profiles": dump_qos_v9(list(topic.qos)),
                    "type_description_hash": topic.digest,
                },
                "message_count": topic.count,
            }
            for topic in _merged(files)
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": _starting_time([file]),
                "duration": _duration([file]),
                "message_count": file.count,
            }
            for file in files
        ],
        "custom_data": custom or None,
        "ros_distro": "rosbags",
    }


def text_of(described: dict) -> str:
    """Return the content of :func:`information` as YAML."""
    return yaml.dump(described, Dumper=FAST_DUMPER, sort_keys=False, allow_unicode=True)


def write_metadata(folder: pathlib.Path, described: dict) -> None:
    """Write ``metadata.yaml`` atomically."""
    path = folder / METADATA
    draft = path.with_suffix(".yaml.tmp")
    with draft.open("w", encoding="utf-8") as stream:
        stream.write(text_of({INFORMATION: described}))
        stream.flush()
        os.fsync(stream.fileno())
    draft.replace(path)


def _qos(text: str) -> list[Qos]:
    """Return the QoS of a topic's publishers; empty if it is not in the format of ``ros2 bag``."""
    try:
        return parse_qos(text)
    except Exception:  # rosbags raises errors of YAML, of types and of keys
        return []


def _merged(files: Sequence[FileInformation]) -> list[TopicInformation]:
    """Return the topics of all files, each once."""
    found: dict[tuple, TopicInformation] = {}
    for file in files:
        for topic in file.topics:
            key = topic.name, topic.type_name, topic.encoding, tuple(topic.qos)
            if key not in found:
                found[key] = TopicInformation(*key[:3], topic.digest, topic.qos)
            found[key].count += topic.count
    return list(found.values())


def _starting_time(files: Sequence[FileInformation]) -> dict[str, int]:
    return {"nanoseconds_since_epoch": min((file.start for file in files if file.count), default=NEVER)}


def _duration(files: Sequence[FileInformation]) -> dict[str, int]:
    there = [file for file in files if file.count]
    if not there:
        return {"nanoseconds": 0}
    return {"nanoseconds": max(file.end for file in there) - min(file.start for file in there)}
