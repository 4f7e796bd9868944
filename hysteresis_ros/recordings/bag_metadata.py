# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``metadata.yaml``: what stands in the files of a bag, as ``ros2 bag`` writes it (version 9)."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import yaml
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from hysteresis_ros.recordings.mcap_index import NEVER, McapIndex

METADATA = "metadata.yaml"

#: Key under which everything stands.
INFORMATION = "rosbag2_bagfile_information"

VERSION = 9


@dataclass
class TopicInformation:
    """What a bag says about a topic.

    Parameters
    ----------
    name, type_name, encoding, digest : str
        Topic, message type, how messages are serialised, and the hash of the type; empty where it is not known.
    qos : sequence of Qos
        What its publishers offer.
    count : int
        Messages.
    """

    name: str
    type_name: str
    encoding: str = "cdr"
    digest: str = ""
    qos: Sequence[Qos] = ()
    count: int = 0


@dataclass
class FileInformation:
    """What stands in one file of a bag.

    Parameters
    ----------
    name : str
        Its name in the folder.
    start, end : int
        Times of the first and the last message [ns].
    topics : list of TopicInformation
        Its topics.
    """

    name: str
    start: int = NEVER
    end: int = 0
    topics: list[TopicInformation] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Messages in the file."""
        return sum(topic.count for topic in self.topics)


def mcap_file(name: str, index: McapIndex) -> FileInformation:
    """Return what stands in an MCAP file, by its index.

    Parameters
    ----------
    name : str
        Of the file.
    index : McapIndex
        Of the whole file.
    """
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
    """Return what ``metadata.yaml`` says about a bag.

    Parameters
    ----------
    files : sequence of FileInformation
        In the order of time.
    storage : str
        ``mcap`` or ``sqlite3``.
    custom : dict of str to str, optional
        Further pairs of words.
    """
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
    """Return what :func:`information` gave as YAML."""
    return yaml.safe_dump(described, sort_keys=False, allow_unicode=True)


def write_metadata(folder: pathlib.Path, described: dict) -> None:
    """Write ``metadata.yaml``: the whole file or none."""
    path = folder / METADATA
    draft = path.with_suffix(".yaml.tmp")
    with draft.open("w", encoding="utf-8") as stream:
        stream.write(text_of({INFORMATION: described}))
        stream.flush()
        os.fsync(stream.fileno())
    draft.replace(path)


def _qos(text: str) -> list[Qos]:
    """Return what the publishers of a topic offer; nothing where it is not written as ``ros2 bag`` does."""
    try:
        return parse_qos(text)
    except Exception:  # rosbags lets errors of YAML, of types and of keys through
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
