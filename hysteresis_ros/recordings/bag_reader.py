# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Messages by topic from any bag: rosbags, ``ros2 bag record`` (MCAP, sqlite3), bare and cut-off files."""

from __future__ import annotations

import contextlib
import io
import os
import pathlib
import re
import shutil
import sqlite3
import tempfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from urllib.parse import quote

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import parse_qos

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings.bag_format import (
    CHUNK,
    MAGIC,
    MESSAGE,
    RECORD,
    FileInformation,
    TopicInformation,
    records_in,
)

#: Unpacked size that is always allowed for a chunk [bytes].
SMALL = 1 << 24
#: Largest compression ratio of larger chunks.
RATIO = 200
#: Largest number of bytes that are unpacked at a time.
PART = 1 << 20


@dataclass
class StreamResult:
    """Result of reading a file."""

    complete: bool = False  #: Whether the end of the data section was reached.
    size: int = 0  #: size, whole: Bytes of the file, and bytes up to the last complete record.
    whole: int = 0
    salvaged: int = 0  #: Number of messages recovered from a chunk that was cut off.
    damaged_chunks: int = 0  #: Chunks inside the file that could not be unpacked.
    words: dict[str, dict[str, str]] = field(default_factory=dict)  #: Content of metadata records, by their names.


@dataclass
class _Records:
    """Keeps track of schemas and channels, and passes every message on."""

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
        """Process the records of a chunk, up to the last complete record."""
        for opcode, begin, end in records_in(data):
            if opcode == Opcode.MESSAGE and end - begin >= MESSAGE.size:
                channel_id, _, time_ns, _ = MESSAGE.unpack_from(data, begin)
                self.message(channel_id, time_ns, data[begin + MESSAGE.size : end])
            elif opcode == Opcode.SCHEMA:
                self.schema(Schema.read(ReadDataStream(io.BytesIO(data[begin:end]))))
            elif opcode == Opcode.CHANNEL:
                self.channel(Channel.read(ReadDataStream(io.BytesIO(data[begin:end]))))


def read_stream(path, sink) -> StreamResult:
    """Pass every complete message of an MCAP file to ``sink(topic, type_name, time_ns, data)``, in file order.

    The file needs neither index nor footer. All complete messages before the cut of a truncated file are read, also
    those in the truncated chunk.
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
        # reading a damaged file may raise any exception (struct, UTF-8, decompression …): the readable part ends here
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
    """Return the metadata records of an MCAP file with an index, by their names; empty for other files."""
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
        except Exception:  # see read_stream; the next chunk may be intact
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
    """Return the unpacked content of a chunk."""
    return _content(Chunk.read(ReadDataStream(io.BytesIO(record))))


def _content(chunk: Chunk) -> bytes:
    """Return the unpacked content of a chunk; raises an exception of any type if the chunk is damaged."""
    data = _unpacked(chunk.data, chunk.compression.encode(), most(len(chunk.data)))
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a damaged chunk")
    return data


def most(size: int) -> int:
    """Return the largest plausible unpacked size of a chunk [bytes]."""
    return max(SMALL, RATIO * size)


def salvaged(tail: bytes) -> bytes:
    """Return the records of a truncated chunk, as far as they can be unpacked."""
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
    """Return the unpacked bytes, up to a limit or to the first error."""
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


#: Tables in a bag of ``ros2 bag``; older versions have fewer tables.
TABLES = ("schema", "metadata", "message_definitions", "topics", "messages")


@contextlib.contextmanager
def opened(path: pathlib.Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading, even if it is truncated."""
    beside = any(path.with_name(f"{path.name}-{end}").exists() for end in ("wal", "journal"))
    with contextlib.ExitStack() as stack:
        try:
            file = path if beside else stack.enter_context(_of_whole_pages(path))
            mode = "mode=ro" if beside else "mode=ro&immutable=1"
            connection = stack.enter_context(
                contextlib.closing(sqlite3.connect(f"file:{quote(str(file))}?{mode}", uri=True))
            )
            # otherwise sqlite refuses a database with missing pages
            connection.execute("PRAGMA writable_schema=ON")
            names = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
        except sqlite3.Error as error:
            raise RecordingError(f"{path}: not a readable bag: damaged, or not a database ({error})") from None
        if not {"topics", "messages"} <= names:
            raise RecordingError(f"{path}: not a readable bag: damaged, or without tables of messages and topics")
        yield connection


@contextlib.contextmanager
def _of_whole_pages(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield the file, or a copy without a partial last page, which sqlite would fill with zeros."""
    with path.open("rb") as stream:
        head = stream.read(18)
        size = stream.seek(0, os.SEEK_END)
    page = int.from_bytes(head[16:18], "big") if len(head) == 18 else 0
    page = 65536 if page == 1 else page
    if page < 512 or size % page == 0:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
        copy = pathlib.Path(shutil.copyfile(path, pathlib.Path(folder) / "whole_pages.db3"))
        os.truncate(copy, size - size % page)
        yield copy


class Rows:
    """The rows of a table, in order, up to the first unreadable row."""

    def __init__(self, connection: sqlite3.Connection, statement: str):
        self._connection, self._statement = connection, statement
        self.complete = False

    def __iter__(self) -> Iterator[tuple]:
        """Yield the rows."""
        with contextlib.suppress(sqlite3.Error):
            yield from self._connection.execute(self._statement)
            self.complete = True


def read_database(path: pathlib.Path, sink) -> bool:
    """Pass every readable message to ``sink(topic, type_name, time_ns, data)``, in the order of recording."""
    with opened(path) as connection:
        topics = {number: words for number, *words in Rows(connection, "SELECT id, name, type FROM topics")}
        rows = Rows(connection, "SELECT topic_id, timestamp, data FROM messages ORDER BY rowid")
        for topic, time_ns, data in rows:
            if topic in topics and isinstance(time_ns, int) and isinstance(data, bytes):
                sink(*topics[topic], time_ns, data)
    return rows.complete


def repair_database(source: pathlib.Path, target: pathlib.Path) -> FileInformation:
    """Write the readable part of an sqlite3 bag as an intact database."""
    with opened(source) as old, contextlib.closing(sqlite3.connect(target)) as new:
        try:
            with new:
                _copy(old, new)
        except sqlite3.Error as error:
            raise OSError(error.sqlite_errorcode, str(error)) from None
        found = _described(target.name, new)
    with target.open("rb") as stream:
        os.fsync(stream.fileno())
    if not found.count:
        raise RecordingError(f"{source}: nothing can be recovered: no message is readable")
    return found


def whole_database(path: pathlib.Path) -> FileInformation | None:
    """Return the description of an intact database; None for a damaged database."""
    try:
        with opened(path) as connection:
            if next(connection.execute("PRAGMA quick_check(1)")) != ("ok",):
                return None
            return _described(path.name, connection)
    except (RecordingError, sqlite3.Error):
        return None


def _copy(old: sqlite3.Connection, new: sqlite3.Connection) -> None:
    made: dict[str, str] = dict(Rows(old, "SELECT name, sql FROM sqlite_master WHERE type = 'table'"))
    for name in TABLES:
        if name not in made:
            continue
        new.execute(made[name])
        rows = Rows(old, f"SELECT * FROM {name} ORDER BY rowid")
        for row in rows:
            new.execute(f"INSERT INTO {name} VALUES ({', '.join('?' * len(row))})", row)
    for (statement,) in Rows(old, "SELECT sql FROM sqlite_master WHERE type = 'index' AND tbl_name = 'messages'"):
        if statement:
            new.execute(statement)


def _described(name: str, connection: sqlite3.Connection) -> FileInformation:
    columns = [row[1] for row in connection.execute("PRAGMA table_info(topics)")]
    counts = dict(connection.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
    (times,) = connection.execute("SELECT min(timestamp), max(timestamp) FROM messages")
    found = FileInformation(name) if times[0] is None else FileInformation(name, *times)
    for row in connection.execute("SELECT * FROM topics ORDER BY id"):
        topic = dict(zip(columns, row, strict=True))
        try:
            qos = parse_qos(topic.get("offered_qos_profiles", ""))
        except Exception:  # rosbags may raise errors of YAML, of types and of keys
            qos = []
        words = topic["name"], topic["type"], topic["serialization_format"], topic.get("type_description_hash") or ""
        found.topics.append(TopicInformation(*words, qos, counts.get(topic["id"], 0)))
    return found


#: Suffixes of bag files.
ENDINGS = (".mcap", ".db3")
#: Suffix that ``ros2 bag record`` adds to compressed files.
COMPRESSED = ".zstd"
#: Number of bytes that are decompressed at a time.
PIECE = 1 << 20

#: Message types whose messages are read; of topics with other types (images …) only the names are listed.
KEPT_TYPES = frozenset({cdr.FLOAT64, cdr.STRING, cdr.JOINT_STATE, cdr.DIAGNOSTICS})


@dataclass
class Topic:
    """The messages of one topic in the order of the bag."""

    type_name: str  #: Message type.
    data: list[bytes] = field(default_factory=list)  #: Serialised messages.
    times: list[int] = field(default_factory=list)  #: Times of reception [ns].
    order: list[int] = field(default_factory=list)  #: Index of each message among all messages of the bag.

    def received(self) -> np.ndarray:
        """Return the times of reception [ns], shape (N,), int64."""
        try:
            return np.array(self.times, dtype=np.int64)
        except OverflowError:
            raise RecordingError("a message has an impossible time of reception; the bag is damaged") from None


@dataclass
class Bag:
    """The content of a bag that this package can use."""

    path: pathlib.Path  #: Path of the bag.
    topics: dict[str, Topic] = field(default_factory=dict)  #: Topics by full name.
    complete: bool = True  #: Whether the bag is neither cut off nor damaged.
    notes: list[str] = field(default_factory=list)  #: Notes for the user.
    words: dict[str, dict[str, str]] = field(default_factory=dict)  #: Content of metadata records, by their names.
    _count: int = 0

    def add(self, name: str, type_name: str, time_ns: int, data: bytes) -> None:
        """Append one message."""
        if not (isinstance(time_ns, int) and isinstance(data, (bytes, bytearray, memoryview))):
            raise RecordingError(f"{self.path}: a message on {name} is invalid or has no time; the bag is damaged")
        topic = self.topics.get(name)
        if topic is None:
            topic = self.topics[name] = Topic(type_name)
        if topic.type_name == type_name and type_name in KEPT_TYPES:
            topic.data.append(bytes(data))
            topic.times.append(time_ns)
            topic.order.append(self._count)
        self._count += 1

    def __len__(self) -> int:
        """Return the number of messages that were read."""
        return self._count

    def of_type(self, name: str, type_name: str) -> Topic | None:
        """Return a topic with messages of the given type, or None."""
        topic = self.topics.get(name)
        return topic if topic is not None and topic.type_name == type_name and topic.data else None


def read_bag(path) -> Bag:
    """Read a bag."""
    path = pathlib.Path(path)
    files = files_of(path)
    notes = []
    if not path.is_dir() or (path / "metadata.yaml").exists():
        if path.suffix in (".mcap", COMPRESSED):
            return _read_files(path, files, [])
        try:
            bag = Bag(path)
            _read_with_rosbags(bag, path)
            bag.words = words_of(files[0]) if files and files[0].suffix == ".mcap" else {}
            return bag
        except RecordingError as error:
            notes.append(f"the index cannot be used, so the file was read in order ({error})")
    else:
        notes.append("metadata.yaml is missing, so the files were read in order")
    return _read_files(path, files, notes)


def files_of(path: pathlib.Path) -> list[pathlib.Path]:
    """Return the files with the messages of a bag, in order."""
    if path.is_dir():
        files = _files_in(path, ".mcap") or _files_in(path, ".db3")
        within = _recordings_within(path, files)
        if within:
            listed = ", ".join(map(str, within))
            raise RecordingError(f"{path}: not a bag; give one of the recordings in this folder: {listed}")
        if not files and not (path / "metadata.yaml").exists():
            raise RecordingError(f"{path}: not a bag: it contains neither metadata.yaml nor .mcap or .db3 files")
        return files
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder; give the path of a recorded bag")
    if pathlib.Path(path.name.removesuffix(COMPRESSED)).suffix not in ENDINGS:
        raise RecordingError(f"{path}: unknown kind of recording; give a bag folder, a .mcap, .db3, .npz or .csv file")
    return [path]


def _files_in(folder: pathlib.Path, ending: str) -> list[pathlib.Path]:
    """Return the files in a folder with a suffix; an uncompressed file takes precedence over a compressed copy."""
    plain = list(folder.glob(f"*{ending}"))
    packed = [file for file in folder.glob(f"*{ending}{COMPRESSED}") if file.with_suffix("") not in plain]
    return sorted(plain + packed, key=_natural)


def _recordings_within(path: pathlib.Path, files: list[pathlib.Path]) -> list[pathlib.Path]:
    """Return the recordings in a folder that is not itself a bag; empty if its files form one bag (run_0, run_1)."""
    if (path / "metadata.yaml").exists() or len({re.sub(r"_\d+$", "", file.stem) for file in files}) == 1:
        return []
    bags = [child for child in path.iterdir() if (child / "metadata.yaml").exists() or any(child.glob("*.mcap"))]
    return sorted([*bags, *files, *path.glob("*.npz")])


def _read_with_rosbags(bag: Bag, path: pathlib.Path) -> None:
    try:
        with Reader(path) as reader:
            for connection in reader.connections:
                if not (isinstance(connection.topic, str) and isinstance(connection.msgtype, str)):
                    raise ValueError(
                        f"topic {connection.topic!r} of type {connection.msgtype!r}: name and type must be text"
                    )
                bag.topics.setdefault(connection.topic, Topic(connection.msgtype))
            wanted = [connection for connection in reader.connections if connection.msgtype in KEPT_TYPES]
            if not wanted:
                return
            for connection, time_ns, data in reader.messages(wanted):
                bag.add(connection.topic, connection.msgtype, time_ns, data)
    except Exception as error:  # rosbags raises errors of sqlite, YAML, zstd and struct
        detail = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: not a readable bag: {detail}") from None


def _read_files(path: pathlib.Path, files: list[pathlib.Path], notes: list[str]) -> Bag:
    """Read files one after the other, each as far as possible."""
    if not files:
        raise RecordingError(f"{path}: not a readable bag: {'; '.join(notes)}")
    bag = Bag(path, notes=notes)
    for file in files:
        with _decompressed(file) as (plain, whole):
            if not whole:
                bag.complete = False
                bag.notes.append(
                    f"{file.name} was cut off or is damaged: read up to the end of its decompressible part"
                )
            if plain.suffix == ".mcap":
                result = read_stream(plain, bag.add)
                bag.complete &= result.complete and not result.damaged_chunks
                bag.notes += _stream_notes(plain, result)
                bag.words = result.words | bag.words
            elif not read_database(plain, bag.add):
                bag.complete = False
                bag.notes.append(f"{plain.name} was cut off or is damaged: read up to the first missing page")
    return bag


@contextlib.contextmanager
def _decompressed(file: pathlib.Path) -> Iterator[tuple[pathlib.Path, bool]]:
    """Yield the decompressed file, and whether it could be decompressed completely."""
    if file.suffix != COMPRESSED:
        yield file, True
        return
    import zstandard

    with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
        plain, whole = pathlib.Path(folder) / file.name.removesuffix(COMPRESSED), True
        with file.open("rb") as source, plain.open("wb") as target:
            try:
                reader = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
                while piece := reader.read(PIECE):
                    target.write(piece)
            except zstandard.ZstdError:
                whole = False
            except OSError as error:
                raise RecordingError(f"{file}: cannot be decompressed: {error.strerror}") from None
        yield plain, whole


def _stream_notes(file: pathlib.Path, result: StreamResult) -> list[str]:
    notes = []
    if result.damaged_chunks:
        notes.append(f"{file.name}: {result.damaged_chunks} chunks are damaged and omitted")
    if file.stat().st_size > result.size:
        notes.append(f"{file.name} is still being written: it was read up to byte {result.whole}")
    elif not result.complete:
        notes.append(
            f"{file.name} was cut off: {result.whole} of {result.size} bytes are whole records; {result.salvaged} "
            "messages were recovered from the open chunk"
        )
    return notes


def _natural(path: pathlib.Path):
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]
