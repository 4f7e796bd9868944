# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""MCAP read in file order: what is left of a bag whose writer was killed, up to its last whole message."""

from __future__ import annotations

import contextlib
import io
import pathlib
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.mcap_index import CHUNK, MAGIC, MESSAGE, RECORD, records_in

#: What a chunk may unpack to in any case [bytes], and else in parts of its own size; how much is unpacked at a time.
SMALL, RATIO, PART = 1 << 24, 200, 1 << 20


@dataclass
class StreamResult:
    """How reading ended.

    Parameters
    ----------
    complete : bool
        The end of the data section was reached.
    size, whole : int
        Bytes of the file, and bytes up to the last whole record.
    salvaged : int
        Messages taken from a chunk that was cut off.
    damaged_chunks : int
        Chunks inside the file that could not be unpacked.
    words : dict of str to dict
        What metadata records say, by their names.
    """

    complete: bool = False
    size: int = 0
    whole: int = 0
    salvaged: int = 0
    damaged_chunks: int = 0
    words: dict[str, dict[str, str]] = field(default_factory=dict)


@dataclass
class _Records:
    """Follows schemas and channels and hands every message on."""

    sink: Callable[..., object]
    schemas: dict = field(default_factory=dict)
    channels: dict = field(default_factory=dict)
    count: int = 0

    def schema(self, record: Schema) -> None:
        self.schemas[record.id] = record.name

    def channel(self, record: Channel) -> None:
        if record.message_encoding == "cdr":
            self.channels[record.id] = (record.topic, self.schemas.get(record.schema_id, ""))

    def message(self, channel_id: int, time_ns: int, data: bytes) -> None:
        channel = self.channels.get(channel_id)
        if channel is not None:
            self.sink(*channel, time_ns, data)
            self.count += 1

    def walk(self, data: bytes) -> None:
        """Go through the records of a chunk, up to the last whole one."""
        for opcode, begin, end in records_in(data):
            if opcode == Opcode.MESSAGE and end - begin >= MESSAGE.size:
                channel_id, _, time_ns, _ = MESSAGE.unpack_from(data, begin)
                self.message(channel_id, time_ns, data[begin + MESSAGE.size : end])
            elif opcode == Opcode.SCHEMA:
                self.schema(Schema.read(ReadDataStream(io.BytesIO(data[begin:end]))))
            elif opcode == Opcode.CHANNEL:
                self.channel(Channel.read(ReadDataStream(io.BytesIO(data[begin:end]))))


def read_stream(path, sink) -> StreamResult:
    """Hand every whole message of an MCAP file to ``sink(topic, type_name, time_ns, data)``, in file order.

    Neither index nor footer is needed. A file that ends anywhere gives everything before that point, messages inside
    a chunk that was cut off included.

    Raises
    ------
    RecordingError
        The file cannot be opened or is no MCAP.
    """
    path = pathlib.Path(path)
    result, records = StreamResult(), _Records(sink)
    try:
        stream = path.open("rb")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    with stream:
        result.size = stream.seek(0, io.SEEK_END)
        stream.seek(0)
        head = stream.read(len(MAGIC))
        if not MAGIC.startswith(head):
            raise RecordingError(f"{path}: not an MCAP file (it begins with {head!r}); give a recorded bag")
        stream.seek(0)
        result.whole = len(head)
        # A damaged file makes the parser fail in any way (struct, UTF-8, decompression …); all of them mean "ends here"
        try:
            for record in StreamReader(stream, emit_chunks=True, record_size_limit=result.size).records:
                _take(record, records, result)
                result.whole = stream.tell()
        except Exception:
            if not result.complete:
                before = records.count
                stream.seek(result.whole)
                with contextlib.suppress(Exception):
                    records.walk(salvaged(stream.read()))
                result.salvaged = records.count - before
    return result


def words_of(path: pathlib.Path) -> dict[str, dict[str, str]]:
    """Return what the metadata records of an MCAP file with an index say, by their names; nothing of other files.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    """
    try:
        with path.open("rb") as stream:
            reader = SeekingReader(stream, record_size_limit=path.stat().st_size)
            return {record.name: record.metadata for record in reader.iter_metadata()}
    except Exception:  # see read_stream
        return {}


def _take(record, records: _Records, result: StreamResult) -> None:
    if isinstance(record, Chunk):
        try:
            records.walk(_content(record))
        except Exception:  # see read_stream; the next chunk may be sound
            result.damaged_chunks += 1
    elif isinstance(record, Schema):
        records.schema(record)
    elif isinstance(record, Channel):
        records.channel(record)
    elif isinstance(record, Message):
        records.message(record.channel_id, record.log_time, record.data)
    elif isinstance(record, Metadata):
        result.words[record.name] = record.metadata
    elif isinstance(record, DataEnd):
        result.complete = True


def chunk_content(record: bytes) -> bytes:
    """Return what stands in a chunk, unpacked.

    Parameters
    ----------
    record : bytes
        Its record, without opcode and length.

    Raises
    ------
    Exception
        Of any kind: it is damaged.
    """
    return _content(Chunk.read(ReadDataStream(io.BytesIO(record))))


def _content(chunk: Chunk) -> bytes:
    """Return what stands in a chunk, unpacked; any exception when it is damaged."""
    data = _unpacked(chunk.data, chunk.compression.encode(), most(len(chunk.data)))
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a damaged chunk")
    return data


def most(size: int) -> int:
    """Return to how many bytes a chunk of so many may unpack; what says more is no recording.

    Parameters
    ----------
    size : int
    """
    return max(SMALL, RATIO * size)


def salvaged(tail: bytes) -> bytes:
    """Return the records of a chunk whose end is missing, as far as they can be unpacked.

    Parameters
    ----------
    tail : bytes
        What follows the last whole record of a file.
    """
    if len(tail) < RECORD.size + CHUNK.size or tail[0] != Opcode.CHUNK:
        return b""
    name_length = CHUNK.unpack_from(tail, RECORD.size)[4]
    name_start = RECORD.size + CHUNK.size
    compression = tail[name_start : name_start + name_length]
    data = tail[name_start + name_length + 8 :]
    try:
        return _unpacked(data, compression, most(len(data)))
    except Exception:  # see read_stream
        return b""


def _unpacked(data: bytes, compression: bytes, most: int) -> bytes:
    """Return what was packed, at most so much of it, as far as it goes."""
    if compression == b"zstd":
        import zstandard

        found = []
        with zstandard.ZstdDecompressor().stream_reader(data) as reader, contextlib.suppress(zstandard.ZstdError):
            while most > 0 and (part := reader.read(min(PART, most))):
                found.append(part)
                most -= len(part)
        return b"".join(found)
    if compression == b"lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
    return data if compression == b"" else b""
