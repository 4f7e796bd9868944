# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bags in sqlite3 row by row: what is left of a database whose end is missing, up to the first page that is."""

from __future__ import annotations

import contextlib
import os
import pathlib
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from urllib.parse import quote

from rosbags.rosbag2.metadata import parse_qos

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.bag_metadata import FileInformation, TopicInformation

#: Tables of a bag of ``ros2 bag``; older ones have fewer.
TABLES = ("schema", "metadata", "message_definitions", "topics", "messages")


@contextlib.contextmanager
def opened(path: pathlib.Path) -> Iterator[sqlite3.Connection]:
    """Open a database to read it, also one that is shorter than its header says.

    Parameters
    ----------
    path : pathlib.Path
        The file. What waits in a write-ahead log or journal beside it is seen.

    Raises
    ------
    RecordingError
        It is no database of a bag.
    """
    beside = any(path.with_name(f"{path.name}-{end}").exists() for end in ("wal", "journal"))
    with contextlib.ExitStack() as stack:
        try:
            file = path if beside else stack.enter_context(_of_whole_pages(path))
            mode = "mode=ro" if beside else "mode=ro&immutable=1"
            connection = stack.enter_context(
                contextlib.closing(sqlite3.connect(f"file:{quote(str(file))}?{mode}", uri=True))
            )
            # without it a database that has fewer pages than it should is not read at all
            connection.execute("PRAGMA writable_schema=ON")
            names = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
        except sqlite3.Error as error:
            raise RecordingError(f"{path}: not a readable bag: damaged, or no database ({error})") from None
        if not {"topics", "messages"} <= names:
            raise RecordingError(f"{path}: not a readable bag: damaged, or no tables of messages and topics in it")
        yield connection


@contextlib.contextmanager
def _of_whole_pages(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield the file, or a copy without the part of a page at its end, which sqlite would fill up with zeros."""
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
    """The rows of a table in their order, up to the first that cannot be read.

    Parameters
    ----------
    connection : sqlite3.Connection
        The database.
    statement : str
        What selects them.

    Attributes
    ----------
    complete : bool
        Whether the last one was reached.
    """

    def __init__(self, connection: sqlite3.Connection, statement: str):
        self._connection, self._statement = connection, statement
        self.complete = False

    def __iter__(self) -> Iterator[tuple]:
        """Yield the rows."""
        with contextlib.suppress(sqlite3.Error):
            yield from self._connection.execute(self._statement)
            self.complete = True


def read_database(path: pathlib.Path, sink) -> bool:
    """Hand every message that can be read to ``sink(topic, type_name, time_ns, data)``, in the order of writing.

    Returns
    -------
    bool
        Whether all were read.

    Raises
    ------
    RecordingError
        It is no database of a bag.
    """
    with opened(path) as connection:
        topics = {number: words for number, *words in Rows(connection, "SELECT id, name, type FROM topics")}
        rows = Rows(connection, "SELECT topic_id, timestamp, data FROM messages ORDER BY rowid")
        for topic, time_ns, data in rows:
            if topic in topics and isinstance(time_ns, int) and isinstance(data, bytes):
                sink(*topics[topic], time_ns, data)
    return rows.complete


def repair_database(source: pathlib.Path, target: pathlib.Path) -> FileInformation:
    """Write what can be read of a bag in sqlite3 as a whole database.

    Parameters
    ----------
    source : pathlib.Path
        The damaged file; it stays as it is.
    target : pathlib.Path
        File to create.

    Returns
    -------
    FileInformation
        What stands in the new file.

    Raises
    ------
    RecordingError
        Nothing can be saved.
    OSError
        The new file cannot be written.
    """
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
        raise RecordingError(f"{source}: nothing can be saved: no message can be reached")
    return found


def whole_database(path: pathlib.Path) -> FileInformation | None:
    """Return what stands in a database in which every page is there and sound; None otherwise."""
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
        except Exception:  # rosbags lets errors of YAML, of types and of keys through
            qos = []
        words = topic["name"], topic["type"], topic["serialization_format"], topic.get("type_description_hash") or ""
        found.topics.append(TopicInformation(*words, qos, counts.get(topic["id"], 0)))
    return found
