# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Read and write files safely: writes are atomic, reads are bounded, and archives may contain only numbers and texts.

The size that the header of an array states must fit its content, and an archive may unpack to at most 64 MiB or 100
times its own size (whichever is larger), so a file that states a wrong size cannot exhaust the memory.

YAML is read by safe loaders only, which create plain values and nothing else. Aliases are refused: a file of one
kilobyte with aliases can expand to gigabytes, and the parser of ROS 2 does not support them.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import pathlib
import zipfile
from collections.abc import Callable, Iterator
from typing import IO, Any

import numpy as np
import yaml

from hysteresis_ros.errors import HysteresisError

#: What to do about a file that cannot be written.
REMEDY = "choose another place"


@contextlib.contextmanager
def replacing(path, error: type[HysteresisError], remedy: str = REMEDY) -> Iterator[pathlib.Path]:
    """Yield the path of a temporary file that replaces ``path`` when the block ends without an error."""
    path = pathlib.Path(path)
    beside = path.with_name(f".{path.name}.partial")
    try:
        yield beside
        os.replace(beside, path)
    except OSError as failed:
        reason = failed.strerror or str(failed) or type(failed).__name__
        raise error(f"{path}: cannot be written: {reason}; {remedy}") from None
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def write_text(path, text: str, error: type[HysteresisError]) -> None:
    """Write a text in UTF-8, atomically."""
    with replacing(path, error) as beside:
        beside.write_text(text, encoding="utf-8")


#: Unpacked size that is always allowed for an archive [bytes].
SMALL = 1 << 26
#: Largest ratio of the unpacked size of a larger archive to its own size.
RATIO = 100
#: NumPy kinds of numbers and texts.
KINDS = "biufcUS"


class ArchiveError(ValueError):
    """A file is not an archive of arrays; the caller adds its name to the message."""


class Head:
    """Header of a stored array: its shape and type."""

    def __init__(self, stream: IO[bytes]):
        version = np.lib.format.read_magic(stream)
        reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        self.shape, _, self.dtype = reader(stream)

    @property
    def length(self) -> int | None:
        """Length of a vector of real numbers; None for anything else."""
        return self.shape[0] if len(self.shape) == 1 and self.dtype.kind in "fiu" else None

    def require(self, size: int) -> None:
        """Refuse an array that is larger than its content of ``size`` bytes, or does not contain numbers or texts."""
        if self.dtype.kind not in KINDS:
            raise ArchiveError(f"contains an array of {self.dtype}: only numbers and texts are read")
        count = math.prod(self.shape)
        if min(self.shape, default=0) < 0 or max(count, count * self.dtype.itemsize) > size:
            raise ArchiveError(f"declares an array of shape {self.shape}, which does not fit in its {size} bytes")


def read_arrays(path, wanted: Callable[[str], bool] = lambda name: True) -> dict[str, np.ndarray]:
    """Return the arrays of an NPZ file by name; ``path`` is its path, or its content in memory."""
    with _opened(path) as (file, members):
        found = {}
        for name, member in members.items():
            if wanted(name):
                with file.open(member) as stream:
                    Head(stream).require(member.file_size)
                with file.open(member) as stream:
                    found[name] = _sound(np.lib.format.read_array(stream, allow_pickle=False))
        return found


def read_heads(path) -> dict[str, Head]:
    """Return the headers of the arrays of an NPZ file by name, without reading their content."""
    with _opened(path) as (file, members):
        found = {}
        for name, member in members.items():
            with file.open(member) as stream:
                found[name] = Head(stream)
        return found


def read_array(path) -> np.ndarray:
    """Return the array of an NPY file."""
    with _named(), pathlib.Path(path).open("rb") as stream:
        Head(stream).require(pathlib.Path(path).stat().st_size)
        stream.seek(0)
        return _sound(np.lib.format.read_array(stream, allow_pickle=False))


@contextlib.contextmanager
def _opened(path) -> Iterator[tuple[zipfile.ZipFile, dict[str, zipfile.ZipInfo]]]:
    """Open an archive; yield it and its members by array name."""
    with _named(), contextlib.ExitStack() as stack:
        stream = path if isinstance(path, io.BytesIO) else stack.enter_context(pathlib.Path(path).open("rb"))
        file = stack.enter_context(zipfile.ZipFile(stream))
        members = {member.filename.removesuffix(".npy"): member for member in file.infolist()}
        kinds = {member.compress_type for member in members.values()}
        if kinds - {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
            raise ArchiveError("uses a compression that NumPy does not write")
        size = sum(member.file_size for member in members.values())
        if size > max(SMALL, RATIO * stream.seek(0, os.SEEK_END)):
            raise ArchiveError(f"would unpack to {size} bytes, more than {RATIO} times its size")
        yield file, members


@contextlib.contextmanager
def _named() -> Iterator[None]:
    """Convert every error that damaged bytes cause to an ArchiveError."""
    try:
        yield
    except (OSError, ArchiveError):
        raise
    except Exception as error:  # zipfile, zlib, NumPy and Python's parser raise many types
        raise ArchiveError(f"is damaged, or not a file of arrays ({error or type(error).__name__})") from None


def _sound(array: np.ndarray) -> np.ndarray:
    """Return an array; refuse texts with invalid code points, which would crash the process later."""
    if array.dtype.kind == "U":
        points = np.ascontiguousarray(array).view(np.dtype("u4").newbyteorder(array.dtype.byteorder))
        if np.any((points > 0x10FFFF) | (points >> 11 == 0xD800 >> 11)):
            raise ArchiveError("contains texts with invalid code points")
    return array


#: Maximum size of a text [bytes in a file, characters in memory].
LARGEST = 16 * 2**20
#: Maximum number of values in a text, unless the caller gives another number.
MOST_VALUES = 50_000
#: Maximum nesting depth of the mappings and lists in a text.
DEEPEST = 50

#: libyaml, which is six times as fast, if PyYAML was built with it.
FAST_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
FAST_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

#: Errors of YAML and of its constructors, e.g. for 2001-99-99, !!int x, an integer of 5000 digits.
_UNFIT = (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError)


class BoundsError(HysteresisError):
    """A text is too large, has too many values, or is not YAML or JSON; the caller adds the file's name."""


def read_text(path) -> str:
    """Return the text of a file in UTF-8."""
    with pathlib.Path(path).expanduser().open("rb") as stream:
        content = stream.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise BoundsError(f"is larger than {LARGEST // 2**20} MiB, the limit for files of this kind")
    return content.decode()


def read_yaml(text: str, loader: Any = FAST_LOADER, most: int = MOST_VALUES):
    """Return the content of a YAML text as plain values."""
    if len(text) > LARGEST:
        raise BoundsError(f"is larger than {LARGEST // 2**20} MiB, the limit for files of this kind")
    try:
        _look_through(text, most)
        return yaml.load(text, Loader=loader)  # a safe loader, see above
    except _UNFIT as error:
        if isinstance(error, BoundsError):
            raise
        raise BoundsError(f"not readable as YAML: {' '.join(str(error).split())}") from None


def read_json(text: str):
    """Return the content of a JSON text as plain values."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BoundsError(f"not readable as JSON: {error}") from None


def _look_through(text: str, most: int) -> None:
    """Refuse a text with aliases, too many values or too deep nesting, before any value is created."""
    values = depth = 0
    for event in yaml.parse(text, Loader=FAST_LOADER):
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1
            raise BoundsError(f"line {line}: ROS 2 does not read YAML aliases (*{event.anchor}); write the values out")
        values += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            line = event.start_mark.line + 1
            raise BoundsError(f"line {line}: mappings or lists are nested more than {DEEPEST} deep")
        if values > most:
            raise BoundsError(f"contains more than {most} values, the limit for files of this kind")
