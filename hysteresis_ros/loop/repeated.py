# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Repetition of a recorded run: the input files of an axis, and the axis with their recorded contents."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
from collections.abc import Iterator

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, AxisParameters
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.provenance import configured, in_force, note_on_disk, require_same, whole

#: Suffix of the parameters that name output files.
WRITTEN = "save_file"


def file_parameters(text: str, namespace: str = "") -> Iterator[tuple[str, str, pathlib.Path]]:
    """Yield node, parameter and path for each input file; arguments as in :func:`named_files`."""
    for node, kind in NODE_PARAMETERS.items():
        values = configured(text, node, namespace) if node != "recorder" else {}
        for row in kind.table():
            if row.place == "files" and not row.name.endswith(WRITTEN) and values.get(row.name):
                yield node, row.name, pathlib.Path(str(values[row.name])).expanduser()


def named_files(text: str, namespace: str = "") -> list[pathlib.Path]:
    """Return the existing input files that a configuration names for its nodes."""
    return sorted({path for *_, path in file_parameters(text, namespace) if path.is_file()})


@contextlib.contextmanager
def recorded_axis(recorded: Recording, name: str) -> Iterator[tuple[AxisParameters, list[str]]]:
    """Yield the axis of a recording, and a line for each file on this disk that has changed since the recording.

    The axis uses copies of the recorded files, which exist until the context ends.
    """
    with _recorded_configuration(recorded, name) as (configuration, notes):
        yield single_axis(configuration, recorded.metadata.get("namespace")), notes


@contextlib.contextmanager
def recorded_stage(recorded: Recording, name: str) -> Iterator[tuple[StageParameters, list[str]]]:
    """Yield the stage of a recording, and lines as in :func:`recorded_axis`."""
    with _recorded_configuration(recorded, name) as (configuration, notes):
        yield StageParameters.from_configuration(configuration), notes


@contextlib.contextmanager
def _recorded_configuration(recorded: Recording, name: str) -> Iterator[tuple[Configuration, list[str]]]:
    """Yield the configuration of a recording, with its files as recorded, and lines about changed files."""
    text = in_force(recorded)
    if not text:
        raise RecordingError(
            f"{name}: contains no configuration, so its axis is unknown; verify the bag of 'up --record', or the .npz "
            "of 'simulate -o'"
        )
    of_axes = [f"{axis}/" for axis in recorded.axes] or [""]
    needed = [f"{axis}{signal}" for axis in of_axes for signal in ("setpoint", "voltage")]
    lacking = [signal for signal in needed if signal not in recorded]
    if lacking:
        raise RecordingError(
            f"{name}: has no {' and no '.join(lacking)}: it contains only some of the signals, like the recordings of "
            "'commission' do, and cannot be repeated; verify the bag of 'up --record', or the .npz of 'simulate -o'"
        )
    configuration = parse_configuration(text, name)
    notes: list[str] = []
    words = recorded.metadata.get("files", {})
    contents = whole(words)
    space = str(recorded.metadata.get("namespace") or "")
    spaces = [f"{space}/{axis}" for axis in recorded.axes] or [space]
    named = [(one, *found) for one in spaces for found in file_parameters(text, one)]
    with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
        for index, (one, node, parameter, path) in enumerate(named):
            if str(path) in contents:
                content = contents[str(path)]
                notes += filter(None, [note_on_disk(str(path), content)])
                # the copy keeps the suffix, which determines how a table is read
                copy = pathlib.Path(folder) / f"{index}{path.suffix.lower()[:8]}"
                copy.write_bytes(content)
                configuration = configuration.override(f"{one}/{node}".lstrip("/"), **{parameter: str(copy)})
            elif str(path) in words:
                require_same(str(path), words[str(path)])
        yield configuration, notes
