# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bags written through ``rosbags`` as MCAP, in chunks that survive a kill."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import Any

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.errors import WriterError

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings.mcap_storage import ChunkedWriter, Frames

#: Bytes of messages after which a chunk is closed and handed to the operating system.
CHUNK_BYTES = 256 * 1024

#: No limit, as ROS 2 Jazzy writes it.
_FOREVER = QosTime(9223372036, 854775807)


def offered_qos(durability: str = "volatile", depth: int = 1000) -> tuple[Qos, ...]:
    """Return what a bag says about a topic's publisher: reliable, keep last ``depth``, volatile or transient_local."""
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

    Messages collect in a chunk; a full chunk goes to the file at once, so a SIGKILL loses at most the open one. Call
    :meth:`flush` now and then (the recorder does, every ``chunk_time``) so that a slow axis does not fill a chunk for
    minutes. Once a write has failed (a full disk) nothing more is taken; what was written before stays readable.

    With ``max_bag_size`` or ``max_bag_duration`` the folder holds ``NAME_0.mcap``, ``NAME_1.mcap`` …, as ``ros2 bag
    record`` splits: each is a whole file by itself, and the folder is read as one recording.

    Parameters
    ----------
    path : path-like
        Folder to create; it must not exist.
    chunk_bytes : int
        Size of a chunk before it is closed.
    max_bag_size : int
        Bytes that a file holds at most, as far as its chunks allow, before the next one begins; 0: any.
    max_bag_duration : float
        Seconds from the first message of a file to the first one of the next; 0: any.

    Raises
    ------
    RecordingError
        The folder exists or cannot be created.

    Examples
    --------
    >>> with BagWriter("run") as bag:                                                        # doctest: +SKIP
    ...     bag.write_float64("/setpoint", 5e-6, time_ns=0)
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
        """Close the bag, also after an error: what was recorded is kept."""
        self.close()

    @property
    def closed(self) -> bool:
        """True after :meth:`close`."""
        return self._writer is None

    def add_topic(self, topic: str, type_name: str, durability: str = "volatile") -> None:
        """Announce a topic; :meth:`write` does it by itself where volatile is right. A second time does nothing.

        Raises
        ------
        RecordingError
            The type is not known, or the topic has another one already.
        """
        if topic in self._connections:
            known = self._connections[topic][0]
            if known != type_name:
                raise RecordingError(f"topic {topic} holds {known} and cannot take {type_name}")
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
        """Write words about the recording into each of its files, as a metadata record of MCAP.

        Parameters
        ----------
        name : str
            Of the record.
        words : dict of str to str
            What is said.

        Raises
        ------
        RecordingError
            The bag is closed or the disk is full.
        """
        self._words[name] = words
        try:
            self._alive().file.write_words(name, words)
        except OSError as error:
            raise self._failed(error) from None

    def write(self, topic: str, type_name: str, data: bytes, time_ns: int) -> None:
        """Write one message that is serialised already.

        Parameters
        ----------
        topic, type_name : str
            Full topic name and type, such as ``/setpoint`` and ``std_msgs/msg/Float64``.
        data : bytes
            CDR with its four-byte header, as a raw subscription gives it.
        time_ns : int
            Time of reception [ns].

        Raises
        ------
        RecordingError
            The bag is closed, the disk is full, or see :meth:`add_topic`.
        """
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
        """Return the channel of a topic that was added."""
        return self._connections[topic][1].id

    def on_flush(self, write: Callable[[], None]) -> None:
        """Let ``write`` put what waits elsewhere into the bag at each flush and at the end."""
        self._waiting.append(write)

    def write_frames(self, frames: Frames) -> None:
        """Write the messages of many samples, and those that came one by one before, as a chunk of its own.

        Raises
        ------
        RecordingError
            The bag is closed or the disk is full.
        """
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
        """Write a sensor_msgs/JointState with ``names`` and ``position``; received at its stamp unless told."""
        key = (topic, tuple(names))
        encoder = self._encoders.get(key)
        if encoder is None:
            encoder = self._encoders[key] = cdr.JointStateEncoder(names)
        received = stamp_ns if time_ns is None else time_ns
        self.write(topic, cdr.JOINT_STATE, encoder.encode(stamp_ns, positions), received)

    def flush(self) -> None:
        """Close the open chunk and hand it to the operating system: a kill of this process no longer loses it.

        Raises
        ------
        RecordingError
            The bag is closed or the disk is full.
        """
        for write in self._waiting:
            write()
        writer = self._alive()
        try:
            # an empty chunk would carry no times and confuse readers
            if self._open_bytes:
                if self._is_full(0):
                    self._next_file()
                writer.file.close_chunk()
        except OSError as error:
            raise self._failed(error) from None
        self._open_bytes = 0

    def close(self) -> None:
        """Write everything, the index and ``metadata.yaml``; doing it twice does nothing.

        Raises
        ------
        RecordingError
            The disk is full; what was flushed before stays readable.
        """
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
        """Tell whether a message of this time belongs into the next file."""
        if self._first_ns < 0:
            self._first_ns = time_ns
        return 0 < self._max_nanoseconds <= time_ns - self._first_ns

    def _is_full(self, more: int) -> bool:
        """Tell whether a chunk of what waits, and of so many bytes more, makes the file too large."""
        file = self._alive().file
        return self._max_bytes > 0 and bool(file.index.chunks) and file.size + more > self._max_bytes

    def _next_file(self) -> None:
        writer = self._alive()
        writer.next_file()
        self._first_ns = -1
        for name, words in self._words.items():
            writer.file.write_words(name, words)

    def _failed(self, error: OSError) -> RecordingError:
        """Return the error that says so, now and at every later write."""
        self._failure = f"{self.path}: cannot be written: {error.strerror}"
        if self._writer is not None:
            self._writer.file.drop()  # without it there may be room for the end of the file
        return RecordingError(self._failure)

    def _alive(self) -> ChunkedWriter:
        if self._failure:
            raise RecordingError(self._failure)
        if self._writer is None:
            raise RecordingError(f"{self.path}: the bag is closed already; open a new one")
        return self._writer
