# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Origin of a recording: configuration of its nodes, files that they read, software and machine."""

from __future__ import annotations

import base64
import binascii
import contextlib
import functools
import hashlib
import importlib.metadata
import os
import pathlib
import platform
import sys
import time
from collections.abc import Iterable, Iterator, Mapping

from hysteresis_ros.configuration import STAGE, Configuration, dump_configuration, parse_configuration
from hysteresis_ros.errors import ConfigurationError, HysteresisError, RecordingError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.signals import COMPENSATOR, CONTROLLER, PLANT

#: Nodes that define an axis and are in its change log; and an optional node without a change log.
LOGGED = {PLANT, CONTROLLER, COMPENSATOR}
OPTIONAL = ("displacement_camera",)


def described(text: str, node: str, namespace: str = "") -> bool:
    """Return whether the configuration in a recording has a section for ``node`` itself, not only for all nodes."""
    configuration = _parsed(text)
    return configuration is not None and configuration.describes(node, namespace)


def stage_of(text: str) -> tuple[str, tuple[str, ...]] | None:
    """Return the namespace of the stage that a configuration in a recording describes, and the names of its axes."""
    configuration = _parsed(text)
    with contextlib.suppress(ConfigurationError):
        if configuration is not None and configuration.stage is not None:
            names = configuration.node(STAGE, configuration.stage).get("axes", ())
            return configuration.stage, tuple(map(str, names))
    return None


def configured(text: str, node: str, namespace: str = "") -> dict:
    """Return the flat dotted parameters of ``node``; empty if the text is empty or not a ROS 2 parameter file.

    No error is raised, because a recording must stay readable with any text on the topic ``configuration``.
    """
    configuration = _parsed(text)
    return {} if configuration is None else configuration.node(node, namespace)


def in_force(recording: Recording) -> str:
    """Return the parameter file with the actual parameters of the nodes of a recording.

    These parameters are from the change log of the nodes, which also contains values from the command line and changes
    before the first sample.
    """
    text = recording.configuration
    found: dict[str, dict] = {}
    for one in [recording.axis(name) for name in recording.axes] or [recording]:
        known = one.metadata.get("parameters", {})
        if not known.keys() >= LOGGED:
            return text
        namespace = one.metadata.get("namespace", "")
        # only nodes with a section of their own: values for all nodes (/**) would add an optional node to any axis
        optional = [node for node in OPTIONAL if described(text, node, namespace)]
        nodes = {node: configured(text, node, namespace) for node in optional} | known
        found |= {f"{namespace}/{node}": values for node, values in nodes.items()}
    if recording.axes:
        namespace = recording.metadata.get("namespace", "")
        found[f"{namespace}/{STAGE}"] = configured(text, STAGE, namespace)
    given = {node: {name: value for name, value in values.items() if value != []} for node, values in found.items()}
    return dump_configuration({node: values for node, values in given.items() if values})


@functools.lru_cache(maxsize=4)
def _parsed(text: str) -> Configuration | None:
    # cached, because a page parses the same text a few dozen times
    if not text:
        return None
    try:
        return parse_configuration(text, "configuration of the recording")
    except HysteresisError:
        return None


#: Name of the metadata record with files.
FILES = "hysteresis_ros files"
#: File size above which this record contains only a digest [bytes].
LARGEST = 2**20

#: Prefix of an entry with the whole content.
WHOLE = "base64:"
#: Prefix of an entry with the SHA-256 of the content.
DIGEST = "sha256:"


def packed_files(paths: Iterable[pathlib.Path]) -> dict[str, str]:
    """Return the entries of files in the metadata record, by path."""
    words = {}
    for path in paths:
        with contextlib.suppress(OSError):
            content = path.read_bytes()
            whole = WHOLE + base64.b64encode(content).decode()
            words[str(path)] = whole if len(content) <= LARGEST else DIGEST + hashlib.sha256(content).hexdigest()
    return words


def whole(words: Mapping[str, str]) -> dict[str, bytes]:
    """Return the contents of the files that the recording contains, by their original paths."""
    found = {}
    for name, text in words.items():
        if text.startswith(WHOLE):
            with contextlib.suppress(binascii.Error, ValueError):
                found[name] = base64.b64decode(text.removeprefix(WHOLE), validate=True)
    return found


def note_on_disk(name: str, content: bytes) -> str:
    """Return a line if the file on this disk differs from the recorded file; empty if it is equal or missing."""
    with contextlib.suppress(OSError, ValueError):
        path = pathlib.Path(name)
        if path.is_file() and (path.stat().st_size != len(content) or path.read_bytes() != content):
            return f"{name} on this disk differs from the file of the run; the copy in the recording is used"
    return ""


def require_same(name: str, text: str) -> None:
    """Refuse to repeat a run if a file differs from the recorded digest, or is missing on this disk."""
    try:
        with pathlib.Path(name).open("rb") as stream:
            same = DIGEST + hashlib.file_digest(stream, "sha256").hexdigest() == text
        now = "has changed on this disk since"
    except (OSError, ValueError):
        same, now = False, "is no longer on this disk"
    if not same:
        raise RecordingError(
            f"{name}: the run used this file, which is too large for the recording and {now} ({text}); restore it to "
            "repeat the run"
        )


def available(words: Mapping[str, str]) -> Iterator[bytes]:
    """Yield the contents of a run's files: those stored in the recording, and large ones unchanged on this disk."""
    yield from whole(words).values()
    for name, text in words.items():
        with contextlib.suppress(RecordingError, OSError):
            if text.startswith(DIGEST):
                require_same(name, text)
                yield pathlib.Path(name).read_bytes()


#: Name of the metadata record of MCAP with the provenance.
RECORD = "hysteresis_ros"

#: Packages that affect the bits of a run, or its recording.
_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "rosbags", "mcap")

#: Environment variables of ROS.
_VARIABLES = ("ROS_DISTRO", "RMW_IMPLEMENTATION")


def provenance() -> dict[str, str]:
    """Return versions, machine and time, by name."""
    words = {
        "hysteresis_ros": sys.modules[__name__.partition(".")[0]].__version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        "machine": platform.machine(),
        "recorded": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    for name in _PACKAGES:
        try:
            words[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return words | {name: os.environ[name] for name in _VARIABLES if name in os.environ}
