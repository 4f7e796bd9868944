# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The manifest of a benchmark: recordings, where to get them, and which samples are for the fit and for the test.

A manifest is a YAML file; the files of its recordings are found below a folder that the user gives, and nothing is
fetched. Each file is checked with its SHA-256 before anything is fitted.
"""

from __future__ import annotations

import hashlib
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any

import numpy as np

from hysteresis_ros.errors import ConfigurationError, IdentificationError, RecordingError, did_you_mean
from hysteresis_ros.files import read_text, read_yaml
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.reading import Columns, read_data

#: Name of the manifest that comes with the package, in this folder.
SHIPPED = "recordings.yaml"
#: Keys of a recording and of a part, and the meaning of their values.
RECORDING = {
    "about": "what was recorded",
    "source": "where to get the files",
    "licence": "licence of the files",
    "input": "column of the input, as name:unit",
    "output": "column of the output, as name:unit",
    "sample_time": "sample time [s] of files without a time column",
    "negate": "whether the sign of the output is inverted",
    "offset": "kept, or free: a constant is removed from the error",
    "skip": "number of samples at the beginning of the test that are not judged",
    "train": "part for the fit",
    "test": "part for the test",
}
PART = {"file": "name below the folder of the recordings", "sha256": "checksum of the file", "range": "FIRST:LAST"}
#: Largest relative difference between the sample times of both parts.
SAME_RATE = 1e-3
#: Minimum number of turning points of an input.
TURNS = 2


@dataclass(frozen=True)
class Part:
    """Samples ``first … last - 1`` of a file; ``last`` None: up to its end."""

    file: str
    sha256: str
    first: int = 0
    last: int | None = None


@dataclass(frozen=True)
class Entry:
    """A recording of a manifest; the fields are described in :data:`RECORDING`."""

    name: str
    train: Part
    test: Part
    input: str
    output: str
    about: str = ""
    source: str = "its authors"
    licence: str = "not stated"
    sample_time: float | None = None
    negate: bool = False
    offset: str = "kept"
    skip: int = 0


@dataclass(frozen=True, eq=False)
class Task:
    """One recording, ready for the benchmark: data for the fit and for the test; a model gets only the test's input.

    The test begins at sample ``first`` of ``test``; the samples before ``first`` determine the state at this sample and
    are not judged.
    """

    name: str
    train: IdentificationData
    test: IdentificationData
    first: int
    offset: str = "kept"
    about: str = ""
    truth: Mapping[str, Any] | None = None  #: Parameters of a synthetic plant.

    def __post_init__(self):
        """Refuse recordings on which a model cannot be evaluated."""
        for part, data in (("train", self.train), ("test", self.test)):
            if not np.all(np.isfinite(data.input)) or not np.all(np.isfinite(data.output)):
                raise IdentificationError(f"{self.name}: the {part} part has missing samples; choose another range")
            moves = np.diff(data.input)
            moves = np.sign(moves[moves != 0.0])
            if np.count_nonzero(moves[1:] != moves[:-1]) < TURNS:
                raise IdentificationError(
                    f"{self.name}: the input of the {part} part never reverses, or only once; hysteresis is visible "
                    "only after a turning point: choose another range"
                )
        if abs(self.test.sample_time / self.train.sample_time - 1.0) > SAME_RATE:
            raise IdentificationError(
                f"{self.name}: the train part has a sample time of {self.train.sample_time:g} s and the test part of "
                f"{self.test.sample_time:g} s; they must be equal"
            )
        if not 0 <= self.first < len(self.test) - 1:
            raise IdentificationError(
                f"{self.name}: the test part has no samples after the first {self.first} (skip): lower skip"
            )

    @property
    def stroke(self) -> float:
        """Peak-to-peak output of the judged samples [unit of the output]."""
        return float(np.ptp(self.test.output[self.first :]))


def shipped_manifest() -> pathlib.Path:
    """Return the path of the manifest that comes with the package."""
    return pathlib.Path(str(resources.files(__package__) / SHIPPED))


def load_manifest(path) -> tuple[Entry, ...]:
    """Return the recordings of a manifest; the message about a wrong key or value names it."""
    path = pathlib.Path(path)
    try:
        content = read_yaml(read_text(path))
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}; give the path of a manifest") from None
    except ValueError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    recordings = content.get("recordings") if isinstance(content, dict) else None
    if not isinstance(recordings, dict) or not recordings:
        raise ConfigurationError(f"{path}: no section 'recordings' with one entry per recording; see docs/benchmark.md")
    return tuple(_entry(f"{path}: {name}", str(name), given) for name, given in recordings.items())


def _entry(where: str, name: str, given) -> Entry:
    _require_keys(where, given, RECORDING, ("train", "test", "input", "output"))
    values: dict[str, Any] = {key: given[key] for key in given if key not in ("train", "test")}
    for key, kind in (("negate", bool), ("skip", int), ("sample_time", (int, float))):
        if key in values and (not isinstance(values[key], kind) or (kind is not bool and values[key] is True)):
            raise ConfigurationError(f"{where}: {key} = {values[key]!r}: {RECORDING[key]}")
    if values.get("skip", 0) < 0 or values.get("offset", "kept") not in ("kept", "free"):
        raise ConfigurationError(f"{where}: skip must be 0 or more, and offset kept or free")
    for key in ("input", "output"):
        if ":" not in str(values[key]):
            raise ConfigurationError(
                f"{where}: {key} = {values[key]!r}: must be the {RECORDING[key]}, such as control_V:V"
            )
    train, test = (_part(f"{where}: {key}", given[key]) for key in ("train", "test"))
    return _apart(where, Entry(name, train, test, **values))


def _part(where: str, given) -> Part:
    _require_keys(where, given, PART, ("file", "sha256"))
    first, mark, last = str(given.get("range", ":")).partition(":")
    try:
        if not mark:
            raise ValueError
        ends = int(first or 0), int(last) if last else None
    except ValueError:
        raise ConfigurationError(f"{where}: range = {given['range']!r}: write FIRST:LAST, e.g. '0:6000'") from None
    if ends[0] < 0 or (ends[1] is not None and ends[1] <= ends[0]):
        raise ConfigurationError(f"{where}: range = {given['range']!r}: FIRST must be 0 or more and below LAST")
    return Part(str(given["file"]), str(given["sha256"]).lower(), *ends)


def _require_keys(where: str, given, known: Mapping[str, str], needed: tuple[str, ...]) -> None:
    if not isinstance(given, dict):
        raise ConfigurationError(f"{where}: must be a mapping with the keys {', '.join(known)}")
    for key in given:
        if key not in known:
            raise ConfigurationError(
                f"{where}: unknown key {key!r}; there are {', '.join(known)}" + did_you_mean(key, known)
            )
    missing = [key for key in needed if key not in given]
    if missing:
        raise ConfigurationError(f"{where}: {missing[0]} is missing: {known[missing[0]]}")


def _apart(where: str, entry: Entry) -> Entry:
    """Return the entry; refuse a test part that overlaps the part for the fit."""
    train, test = entry.train, entry.test
    end = float("inf")
    if train.sha256 == test.sha256 and train.first < (test.last or end) and test.first < (train.last or end):
        raise ConfigurationError(
            f"{where}: train and test share samples of {train.file}: give ranges without common samples"
        )
    return entry


def missing_files(entry: Entry, folder: pathlib.Path) -> list[str]:
    """Return the files of a recording that are not below the folder."""
    return sorted({part.file for part in (entry.train, entry.test) if not (folder / part.file).is_file()})


def read_task(entry: Entry, folder: pathlib.Path) -> Task:
    """Return a recording from its files below a folder, after a check of their checksums."""
    for part in (entry.train, entry.test):
        path = folder / part.file
        try:
            found = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror}; get it from {entry.source}") from None
        if found != part.sha256:
            raise RecordingError(
                f"{path}: its SHA-256 is {found}, but the manifest has {part.sha256}: this is another file, or it has "
                f"changed; get it from {entry.source}, or correct the manifest"
            )
    columns = Columns(
        entry.input, entry.output, sample_time=entry.sample_time, negate=entry.negate, all_samples=True, whole=True
    )
    train = read_data(folder / entry.train.file, replace(columns, range=(entry.train.first, entry.train.last))).data
    # the samples before the test part determine its initial state
    test = read_data(folder / entry.test.file, replace(columns, range=(0, entry.test.last))).data
    return Task(entry.name, train, test, entry.test.first + entry.skip, entry.offset, entry.about)
