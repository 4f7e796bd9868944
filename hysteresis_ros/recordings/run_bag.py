# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A simulated run as a bag: the topics, stamps and order of messages that the nodes would have published."""

from __future__ import annotations

import pathlib
import shutil
import tempfile
from typing import Any

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.configured import configured
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.provenance import RECORD, provenance
from hysteresis_ros.signals import ASKED_VOLTAGE, MOTOR_SOURCE, SOURCE, WRITERS, float_topics, state_signals


def write_recording(
    recording: Recording,
    path,
    configuration: str | None = None,
    *,
    namespace: str = "",
    joint: str | None = None,
    start_time_ns: int = 0,
) -> None:
    """Write a run as the bag the nodes would have left.

    Parameters
    ----------
    recording : Recording
        The run; signals it lacks (``applied``, ``switching`` …) are left out of the topics.
    path : path-like
        ``NAME.mcap`` gives that one file, anything else a bag folder. It must not exist.
    configuration : str, optional
        YAML text of the axis for ``configuration``; the recording's own by default.
    namespace : str
        Namespace of the axis.
    joint : str, optional
        Name of the joint in ``joint_states``; by default the one in the configuration, or ``piezo``.
    start_time_ns : int
        Stamp of the sample at time 0 [ns].

    Raises
    ------
    RecordingError
        The path exists or cannot be written.
    """
    path = pathlib.Path(path)
    text = recording.configuration if configuration is None else configuration
    joint = joint or str(configured(text, "plant_simulator", namespace).get("joint", "piezo"))
    if path.suffix.lower() != ".mcap":
        with BagWriter(path) as bag:
            _write_topics(bag, recording, text, _prefix(namespace), joint, start_time_ns)
        return
    if path.exists():
        raise RecordingError(f"{path}: exists already; choose another name or remove it")
    try:
        folder = pathlib.Path(tempfile.mkdtemp(prefix=f".{path.stem}-", dir=path.parent))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
    try:
        with BagWriter(folder / path.stem) as bag:
            _write_topics(bag, recording, text, _prefix(namespace), joint, start_time_ns)
        (folder / path.stem / f"{path.stem}.mcap").rename(path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _prefix(namespace: str) -> str:
    stripped = namespace.strip("/")
    return f"/{stripped}" if stripped else ""


def _write_topics(bag, recording, configuration, prefix, joint, start_time_ns) -> None:
    bag.describe(RECORD, provenance())
    stamps = (np.rint(recording.time * 1e9).astype(np.int64) + int(start_time_ns)).tolist()
    bag.add_topic(f"{prefix}/configuration", "std_msgs/msg/String", "transient_local")
    if configuration:
        bag.write_string(f"{prefix}/configuration", configuration, stamps[0] if stamps else int(start_time_ns))
    values = {name: column.tolist() for name, column in recording.signals.items()}
    values.setdefault("plant_voltage", values.get("voltage"))
    # the topics of the compensator hold what it asked for
    if ASKED_VOLTAGE in values:
        values["voltage"] = values[ASKED_VOLTAGE]
    states = []
    absent = SOURCE if "phase" in values else MOTOR_SOURCE
    for node in WRITERS:
        if node == absent:
            continue
        names = state_signals(node)
        there = {name: values[signal] for name, signal in names.items() if values.get(signal) is not None}
        if there:
            columns = list(zip(*there.values(), strict=True))
            states.append((f"{prefix}/{node}/state", tuple(there), columns))
    floats = [(f"{prefix}/{name}", values[signal]) for name, signal in float_topics().items() if signal in values]
    measured = values.get("measured", values.get("displacement"))
    positions: list[Any]
    joints, positions = [joint], [measured]
    if "extender" in values:
        joints, positions = [joint, "extender"], [measured, values["extender"]]
    setpoint, last = values.get("setpoint"), None
    for k, stamp in enumerate(stamps):
        if setpoint is not None and setpoint[k] != last and setpoint[k] == setpoint[k]:
            last = setpoint[k]
            bag.write_float64(f"{prefix}/setpoint", last, stamp)
        if measured is not None:
            bag.write_joint_state(f"{prefix}/joint_states", stamp, joints, [column[k] for column in positions])
        for topic, column in floats:
            bag.write_float64(topic, column[k], stamp)
        for topic, written, columns in states:
            bag.write_joint_state(topic, stamp, written, columns[k])
