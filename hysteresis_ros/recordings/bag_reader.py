# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bags of every make as messages by topic: rosbags, ``ros2 bag record`` (MCAP, sqlite3), bare and cut-off files."""

from __future__ import annotations

import contextlib
import pathlib
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from rosbags.rosbag2 import Reader

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings.mcap_stream import StreamResult, read_stream, words_of
from hysteresis_ros.recordings.sqlite_stream import read_database

#: How the files of a bag end, and what ``ros2 bag record`` puts behind that where it compresses whole files.
ENDINGS, COMPRESSED = (".mcap", ".db3"), ".zstd"
#: Bytes that are decompressed at a time.
PIECE = 1 << 20

#: Types whose messages are kept; of others (images …) only the topic is remembered.
KEPT_TYPES = frozenset({cdr.FLOAT64, cdr.STRING, cdr.JOINT_STATE, cdr.DIAGNOSTICS})


@dataclass
class Topic:
    """The messages of one topic in the order of the bag.

    Parameters
    ----------
    type_name : str
        Message type.
    data : list of bytes
        Serialised messages.
    times : list of int
        Times of reception [ns].
    order : list of int
        Place of each message among all messages of the bag.
    """

    type_name: str
    data: list[bytes] = field(default_factory=list)
    times: list[int] = field(default_factory=list)
    order: list[int] = field(default_factory=list)

    def received(self) -> np.ndarray:
        """Return the times of reception [ns], shape (N,), int64."""
        try:
            return np.array(self.times, dtype=np.int64)
        except OverflowError:
            raise RecordingError("a message was received at a time that no clock says; the bag is damaged") from None


@dataclass
class Bag:
    """Everything this package can use of a bag.

    Parameters
    ----------
    path : pathlib.Path
        Where it was read from.
    topics : dict of str to Topic
        By full topic name.
    complete : bool
        False when the bag was cut off or is damaged.
    notes : list of str
        What a reader must know about it.
    words : dict of str to dict
        What its metadata records say, by their names.
    """

    path: pathlib.Path
    topics: dict[str, Topic] = field(default_factory=dict)
    complete: bool = True
    notes: list[str] = field(default_factory=list)
    words: dict[str, dict[str, str]] = field(default_factory=dict)
    _count: int = 0

    def add(self, name: str, type_name: str, time_ns: int, data: bytes) -> None:
        """Append one message.

        Raises
        ------
        RecordingError
            Its time is none or its data are no bytes: in a database anything may stand in the place of anything.
        """
        if not (isinstance(time_ns, int) and isinstance(data, (bytes, bytearray, memoryview))):
            raise RecordingError(f"{self.path}: a message on {name} is none, or has no time; the bag is damaged")
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
        """Return a topic that holds messages of the given type, or None."""
        topic = self.topics.get(name)
        return topic if topic is not None and topic.type_name == type_name and topic.data else None


def read_bag(path) -> Bag:
    """Read a bag.

    Parameters
    ----------
    path : path-like
        A folder with ``metadata.yaml`` (MCAP or sqlite3, also split and compressed), a folder without it (its
        ``.mcap`` or ``.db3`` files are read), or one such file; a whole file may be compressed (``.db3.zstd``).

    Raises
    ------
    RecordingError
        There is no such path, it holds no bag, or nothing in it can be read.
    """
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
            notes.append(f"read in file order because the index cannot be used ({error})")
    else:
        notes.append("metadata.yaml is missing: read in file order")
    return _read_files(path, files, notes)


def files_of(path: pathlib.Path) -> list[pathlib.Path]:
    """Return the files in which the messages of a bag stand, in their order.

    Parameters
    ----------
    path : pathlib.Path
        A folder, or one file.

    Raises
    ------
    RecordingError
        There is no such path, or it is no bag.
    """
    if path.is_dir():
        files = _files_in(path, ".mcap") or _files_in(path, ".db3")
        within = _recordings_within(path, files)
        if within:
            listed = ", ".join(map(str, within))
            raise RecordingError(f"{path}: no bag itself, give one of the recordings in it: {listed}")
        if not files and not (path / "metadata.yaml").exists():
            raise RecordingError(f"{path}: not a bag: neither metadata.yaml nor .mcap or .db3 files in it")
        return files
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder; give the path of a recorded bag")
    if pathlib.Path(path.name.removesuffix(COMPRESSED)).suffix not in ENDINGS:
        raise RecordingError(f"{path}: unknown kind of recording; give a bag folder, a .mcap, .db3, .npz or .csv file")
    return [path]


def _files_in(folder: pathlib.Path, ending: str) -> list[pathlib.Path]:
    """Return the files of a folder that end so; of one that is there twice, the one that is not compressed."""
    plain = list(folder.glob(f"*{ending}"))
    packed = [file for file in folder.glob(f"*{ending}{COMPRESSED}") if file.with_suffix("") not in plain]
    return sorted(plain + packed, key=_natural)


def _recordings_within(path: pathlib.Path, files: list[pathlib.Path]) -> list[pathlib.Path]:
    """Return the recordings in a folder that is no bag itself; none where its files are parts of one (run_0, run_1)."""
    if (path / "metadata.yaml").exists() or len({re.sub(r"_\d+$", "", file.stem) for file in files}) == 1:
        return []
    bags = [child for child in path.iterdir() if (child / "metadata.yaml").exists() or any(child.glob("*.mcap"))]
    return sorted([*bags, *files, *path.glob("*.npz")])


def _read_with_rosbags(bag: Bag, path: pathlib.Path) -> None:
    try:
        with Reader(path) as reader:
            for connection in reader.connections:
                if not (isinstance(connection.topic, str) and isinstance(connection.msgtype, str)):
                    raise ValueError(f"a topic called {connection.topic!r} of type {connection.msgtype!r}")
                bag.topics.setdefault(connection.topic, Topic(connection.msgtype))
            wanted = [connection for connection in reader.connections if connection.msgtype in KEPT_TYPES]
            if not wanted:
                return
            for connection, time_ns, data in reader.messages(wanted):
                bag.add(connection.topic, connection.msgtype, time_ns, data)
    except Exception as error:  # rosbags lets errors of sqlite, YAML, zstd and struct through
        detail = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: not a readable bag: {detail}") from None


def _read_files(path: pathlib.Path, files: list[pathlib.Path], notes: list[str]) -> Bag:
    """Read files one after the other, as far as each goes."""
    if not files:
        raise RecordingError(f"{path}: not a readable bag: {'; '.join(notes)}")
    bag = Bag(path, notes=notes)
    for file in files:
        with _decompressed(file) as (plain, whole):
            if not whole:
                bag.complete = False
                bag.notes.append(f"{file.name} was cut off or is damaged: read as far as it can be decompressed")
            if plain.suffix == ".mcap":
                result = read_stream(plain, bag.add)
                bag.complete &= result.complete and not result.damaged_chunks
                bag.notes += _stream_notes(plain, result)
                bag.words = result.words | bag.words
            elif not read_database(plain, bag.add):
                bag.complete = False
                bag.notes.append(f"{plain.name} was cut off or is damaged: read up to the first page that is missing")
    return bag


@contextlib.contextmanager
def _decompressed(file: pathlib.Path) -> Iterator[tuple[pathlib.Path, bool]]:
    """Yield a file without its compression, and whether all of it could be decompressed."""
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
        notes.append(f"{file.name}: {result.damaged_chunks} chunks are damaged and left out")
    if not result.complete:
        notes.append(
            f"{file.name} was cut off: {result.whole} of {result.size} bytes are whole records, "
            f"{result.salvaged} messages were taken from the chunk that was open"
        )
    return notes


def _natural(path: pathlib.Path):
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]
