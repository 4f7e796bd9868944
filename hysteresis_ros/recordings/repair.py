# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A bag that was cut off or is damaged, made whole in a new folder: for ``ros2 bag``, Foxglove, ``rosbags`` and us."""

from __future__ import annotations

import contextlib
import os
import pathlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass

from rosbags.rosbag2 import Reader

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.bag_metadata import FileInformation, information, write_metadata
from hysteresis_ros.recordings.bag_reader import files_of
from hysteresis_ros.recordings.mcap_repair import repair_mcap, whole_mcap
from hysteresis_ros.recordings.sqlite_stream import repair_database, whole_database


@dataclass(frozen=True)
class Storage:
    """How the files of a kind of bag are looked at and repaired.

    Parameters
    ----------
    name : str
        In metadata.yaml.
    whole : callable
        Returns what stands in a file that is whole, else None.
    repair : callable
        Writes what is left of a file as a whole one and returns what stands in it.
    """

    name: str
    whole: Callable[[pathlib.Path], FileInformation | None]
    repair: Callable[[pathlib.Path, pathlib.Path], FileInformation]


STORAGES = {
    ".mcap": Storage("mcap", whole_mcap, repair_mcap),
    ".db3": Storage("sqlite3", whole_database, repair_database),
}


@dataclass(frozen=True)
class Repair:
    """What became of a bag.

    Parameters
    ----------
    path : pathlib.Path or None
        The folder of the repaired bag; None where the bag was whole.
    messages : int
        Messages in it.
    mended : tuple of str
        Names of the files that were not whole.
    lost : tuple of str
        Why nothing of a file could be saved, for each such file.
    """

    path: pathlib.Path | None
    messages: int
    mended: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


def repair(path, output=None) -> Repair:
    """Make a bag whole: index, statistics and ``metadata.yaml`` of all that is left up to its last whole message.

    The bag itself stays as it is. The new one is there with all that belongs to it, or not at all.

    Parameters
    ----------
    path : path-like
        Folder of the bag, or its one file (``.mcap``, ``.db3``).
    output : path-like, optional
        Folder to create; by default the bag's name with ``_repaired`` beside it.

    Raises
    ------
    RecordingError
        There is no bag, nothing of it can be saved, or the new folder exists or cannot be written.
    """
    path = pathlib.Path(path)
    files = files_of(path)
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
        raise RecordingError("; ".join(lost) or f"{next(iter(found))}: nothing can be saved: no message is in it")
    write_metadata(draft, information(kept, storage.name))
    return sum(file.count for file in kept), tuple(mended), tuple(lost)


def _opens(path: pathlib.Path) -> bool:
    """Tell whether ``rosbags`` opens a folder and finds what its metadata.yaml promises."""
    try:
        with Reader(path) as reader:
            return reader.message_count == sum(connection.msgcount for connection in reader.connections)
    except Exception:  # rosbags lets errors of sqlite, YAML, zstd and struct through
        return False
