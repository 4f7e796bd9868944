# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Repair of a truncated or damaged bag, written to a new folder, for ``ros2 bag``, Foxglove and ``rosbags``."""

from __future__ import annotations

import contextlib
import io
import os
import pathlib
import shutil
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, AttachmentIndex, Channel, Metadata, MetadataIndex, Schema
from rosbags.rosbag2 import Reader

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.bag_format import (
    MAGIC,
    MESSAGE,
    RECORD,
    FileInformation,
    McapIndex,
    information,
    mcap_file,
    packed,
    records_in,
    records_of,
    text_of,
    write_metadata,
)
from hysteresis_ros.recordings.bag_reader import chunk_content, files_of, repair_database, salvaged, whole_database
from hysteresis_ros.recordings.bag_writer import ROSBAG2, SERIALISED

#: Opcodes of the records that are copied unchanged; opcodes from 0x80 on are private.
_KEPT = (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA)
_PRIVATE = 0x80

#: Messages outside intact chunks are collected; after this number of bytes a new chunk is written.
CHUNK_BYTES = 1024 * 1024


def whole_mcap(path: pathlib.Path) -> FileInformation | None:
    """Return the description of a file from its summary; None if the summary is missing or damaged."""
    try:
        stream = path.open("rb")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    with stream:
        try:
            summary = SeekingReader(stream, record_size_limit=path.stat().st_size).get_summary()
            if summary is None or summary.statistics is None:
                return None
            # the footer may belong to another file, so each chunk of the index must begin at its place in this file
            for chunk in summary.chunk_indexes:
                stream.seek(chunk.chunk_start_offset)
                if stream.read(1) != bytes([Opcode.CHUNK]):
                    return None
        except Exception:  # a damaged or missing summary may raise any exception
            return None
    told = summary.statistics
    index = McapIndex(summary.schemas, summary.channels, counts=told.channel_message_counts)
    if index.message_count:
        index.start, index.end = told.message_start_time, told.message_end_time
    return mcap_file(path.name, index)


def repair_mcap(source: pathlib.Path, target: pathlib.Path) -> FileInformation:
    """Write the readable part of an MCAP file as an intact file.

    Everything up to the last complete message is kept: schemas, channels, messages, attachments, other metadata.
    Damaged chunks inside the file are omitted.
    """
    with source.open("rb") as stream, target.open("xb") as out:
        size = stream.seek(0, io.SEEK_END)
        stream.seek(0)
        if not MAGIC.startswith(stream.read(len(MAGIC))):
            raise RecordingError(f"{source}: not an MCAP file; nothing can be recovered")
        out.write(MAGIC)
        rescue = _Rescue(out)
        whole = stream.tell()
        for opcode, begin, length in records_of(stream, size):
            if opcode in (Opcode.DATA_END, Opcode.FOOTER) or not opcode:
                break
            stream.seek(begin)
            rescue.take(opcode, stream.read(length))
            whole = begin + length
        else:
            stream.seek(whole)
            rescue.take_messages(salvaged(stream.read()))
        found = rescue.finish(target.name)
        out.flush()
        os.fsync(out.fileno())
    if not found.count:
        raise RecordingError(f"{source}: nothing can be recovered: it contains no complete message")
    return found


class _Rescue:
    """Reads the records of a damaged file in order, and writes an intact file."""

    def __init__(self, out: BinaryIO):
        self.out = out
        self.index = McapIndex()
        self._clear()

    def _clear(self) -> None:
        self.loose = bytearray()
        self.entries: dict[int, list[tuple[int, int]]] = defaultdict(list)

    def take(self, opcode: int, data: bytes) -> None:
        """Copy a complete record; a record with invalid content is omitted."""
        if opcode == Opcode.CHUNK:
            self._take_chunk(data)
        elif opcode == Opcode.MESSAGE:
            self.take_messages(RECORD.pack(opcode, len(data)) + data)
        elif opcode in _KEPT or opcode >= _PRIVATE:
            self._take_other(opcode, data)

    def _take_other(self, opcode: int, data: bytes) -> None:
        begin, size = self.out.tell(), RECORD.size + len(data)
        try:
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._announce(opcode, data)
                return
            if opcode == Opcode.METADATA:
                record = Metadata.read(_stream(data))
                if record.name == ROSBAG2:
                    return  # a new record of this kind is written
                self.index.metadata.append(MetadataIndex(begin, size, record.name))
            elif opcode == Opcode.ATTACHMENT:
                item = Attachment.read(_stream(data))
                place = AttachmentIndex(
                    begin, size, item.log_time, item.create_time, len(item.data), item.name, item.media_type
                )
                self.index.attachments.append(place)
        except Exception:  # a damaged record may raise any exception
            return
        self.out.write(RECORD.pack(opcode, len(data)) + data)

    def _announce(self, opcode: int, data: bytes) -> None:
        """Store a valid schema or channel, and write it if it is new."""
        item: Any = (Schema if opcode == Opcode.SCHEMA else Channel).read(_stream(data))
        known: dict = self.index.schemas if opcode == Opcode.SCHEMA else self.index.channels
        if opcode == Opcode.CHANNEL and item.schema_id and item.schema_id not in self.index.schemas:
            return
        if known.setdefault(item.id, item) is item:
            self.out.write(packed(item))

    def _take_chunk(self, data: bytes) -> None:
        try:
            content = chunk_content(data)
        except Exception:  # see _take_other; the next chunk may be intact
            return
        self.take_messages(content)
        self._write_loose()

    def take_messages(self, content: bytes) -> None:
        """Copy the records of a chunk, up to the last complete record."""
        for opcode, begin, end in records_in(content):
            if opcode == Opcode.MESSAGE and end - begin >= MESSAGE.size:
                channel, _, time_ns, _ = MESSAGE.unpack_from(content, begin)
                if channel in self.index.channels:
                    self.entries[channel].append((time_ns, len(self.loose)))
                    self.loose += content[begin - RECORD.size : end]
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                try:
                    self._announce(opcode, content[begin:end])
                except Exception:  # see _take_other
                    continue
        if len(self.loose) >= CHUNK_BYTES:
            self._write_loose()

    def _write_loose(self) -> None:
        if self.loose:
            entries = {channel: np.array(column, "<u8") for channel, column in self.entries.items()}
            pieces = self.index.chunk(self.out.tell(), [bytes(self.loose)], len(self.loose), entries)
            self.out.writelines(pieces)
        self._clear()

    def finish(self, name: str) -> FileInformation:
        """Write pending messages, and the end of the file."""
        self._write_loose()
        found = mcap_file(name, self.index)
        words = packed(Metadata(ROSBAG2, {SERIALISED: text_of(information([found], "mcap"))}))
        begin = self.out.tell()
        self.index.metadata.append(MetadataIndex(begin, len(words), ROSBAG2))
        self.out.write(words + self.index.tail(begin + len(words)))
        return found


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(data))


@dataclass(frozen=True)
class Storage:
    """Functions that check and repair the files of one kind of bag."""

    name: str  #: Name in metadata.yaml.
    whole: Callable[[pathlib.Path], FileInformation | None]  #: Returns the description of an intact file, else None.
    #: Writes the readable part of a file as an intact file, and returns its description.
    repair: Callable[[pathlib.Path, pathlib.Path], FileInformation]


STORAGES = {
    ".mcap": Storage("mcap", whole_mcap, repair_mcap),
    ".db3": Storage("sqlite3", whole_database, repair_database),
}


@dataclass(frozen=True)
class Repair:
    """Result of the repair of a bag."""

    path: pathlib.Path | None  #: The folder of the repaired bag; None if the bag was intact.
    messages: int  #: Number of messages in the repaired bag.
    mended: tuple[str, ...] = ()  #: Names of the repaired files.
    lost: tuple[str, ...] = ()  #: Reason for each file from which nothing could be recovered.


def repair(path, output=None) -> Repair:
    """Repair a bag: write its readable messages with index, statistics and ``metadata.yaml``.

    The bag itself is not changed. The new bag is complete, or does not exist.
    """
    path = pathlib.Path(path)
    files = files_of(path)
    if not files:
        raise RecordingError(f"{path}: contains metadata.yaml, but no .mcap or .db3 file: nothing to recover")
    for file in files:
        if file.suffix not in STORAGES:
            raise RecordingError(f"{file}: is compressed; decompress it (zstd -d {file.name}), and repair the result")
    storage = STORAGES[files[0].suffix]
    found = {file: storage.whole(file) for file in files}
    if path.is_dir() and None not in found.values() and _opens(path):
        return Repair(None, sum(file.count for file in found.values() if file is not None))
    output = pathlib.Path(output) if output is not None else path.resolve().with_name(f"{path.resolve().stem}_repaired")
    if output.exists():
        raise RecordingError(f"{output}: exists already; choose another name with -o, or remove it")
    draft = output.with_name(f".{output.name}.{os.getpid()}")
    try:
        draft.mkdir(parents=True)
        done = _into(draft, storage, found)
        os.replace(draft, output)
    except OSError as error:
        raise RecordingError(f"{output}: cannot be written: {error.strerror or error}; choose another place") from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return Repair(output, *done)


def _into(draft: pathlib.Path, storage: Storage, found: dict) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
    """Fill the folder of the new bag."""
    kept, mended, lost = [], [], []
    for file, known in found.items():
        target = draft / file.name
        if known is not None:
            shutil.copyfile(file, target)
            kept.append(known)
            continue
        try:
            kept.append(storage.repair(file, target))
            mended.append(file.name)
        except RecordingError as error:
            with contextlib.suppress(FileNotFoundError):
                target.unlink()
            lost.append(str(error))
    if not any(file.count for file in kept):
        raise RecordingError(
            "; ".join(lost) or f"{next(iter(found))}: nothing can be recovered: it contains no message"
        )
    write_metadata(draft, information(kept, storage.name))
    return sum(file.count for file in kept), tuple(mended), tuple(lost)


def _opens(path: pathlib.Path) -> bool:
    """Return whether ``rosbags`` opens a folder and its content agrees with metadata.yaml."""
    try:
        with Reader(path) as reader:
            return reader.message_count == sum(connection.msgcount for connection in reader.connections)
    except Exception:  # rosbags may raise errors of sqlite, YAML, zstd and struct
        return False
