# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Writer of the samples of an axis into a bag, with topics, types and stamps as its nodes have them.

In batches, the constant part of the messages (nearly everything) is written once, and stamps and numbers are filled in
for many samples at a time.
"""

from __future__ import annotations

import pathlib
import shutil
import tempfile
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros import signals
from hysteresis_ros.configuration import normalised_namespace
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings.bag_writer import BagWriter, Frames
from hysteresis_ros.recordings.dataset import SIMULATED, Recording
from hysteresis_ros.recordings.provenance import RECORD, configured, provenance
from hysteresis_ros.signals import ASKED_VOLTAGE, float_topics, state_signals

#: Size [bytes] of samples at which a chunk is written.
BLOCK_BYTES = 1024 * 1024

#: Longest time that a sample waits for further samples of its chunk, while samples arrive [s].
CHUNK_TIME = 0.25

#: Number of values of each joint in ``joint_states``: position, velocity, effort.
NUMBERS = 3


@dataclass(frozen=True)
class AxisTopics:
    """Names and properties of the topics of an axis, because the samples do not contain them."""

    namespace: str = ""  #: Namespace of the axis.
    #: Names in ``joint_states``: one, two with a measured force, or four for a motor.
    joints: tuple[str, ...] = ("piezo",)
    sample_rate: float = 1000.0  #: Sample rate [Hz], for velocities.
    kind: signals.AxisKind = signals.ACTUATOR  #: Kind of the axis: its nodes and their signals.
    force: float = 0.0  #: Preload of an actuator [N], published as the effort of the joint.
    #: Whether the plant is simulated; for a device the true displacement is unknown, and missing in the plant's state.
    simulated: bool = True
    durability: str = (
        "volatile"  #: Durability of the topics: ``volatile`` in real time, ``transient_local`` in lockstep.
    )

    @property
    def prefix(self) -> str:
        """Prefix of the topics."""
        stripped = self.namespace.strip("/")
        return f"/{stripped}" if stripped else ""

    def floats(self) -> dict[str, int]:
        """Return the Float64 topics in the order of a sample, and the rows of their signals."""
        row = {signal.name for signal in self.kind.row}
        found = signals.float_topics().items()
        return {f"{self.prefix}/{topic}": signals.place(name) for topic, name in found if name in row}

    def states(self) -> dict[str, dict[str, int]]:
        """Return the names in ``~/state`` of each node with the rows of their signals, by topic."""
        found = {}
        for node in self.kind.nodes:
            names = self.kind.state(node)
            if node == signals.PLANT and not self.simulated:
                del names["displacement"]
            found[f"{self.prefix}/{node}/state"] = {name: signals.place(own) for name, own in names.items()}
        return found


class SampleWriter:
    """Writes all samples of an axis into a bag.

    Samples are collected until there are enough for a chunk, or the oldest sample has waited for ``chunk_time``, or the
    bag is flushed (:meth:`BagWriter.flush <hysteresis_ros.recordings.bag_writer.BagWriter.flush>`). The owner of the
    bag flushes it regularly, so that the last samples before a pause also go to the disk. Other messages go into the
    same bag one by one, from the same thread.
    """

    def __init__(
        self, bag: BagWriter, axis: AxisTopics, *, block_bytes: int = BLOCK_BYTES, chunk_time: float = CHUNK_TIME
    ):
        """Add the topics."""
        if len(axis.joints) == 0 or (len(axis.joints) > 2 and not axis.kind.motor):
            allowed = "an actuator has one joint (two with a force joint), a motor at least one"
            raise RecordingError(f"joints = {axis.joints}: {allowed}")
        self.bag = bag
        self.axis = axis
        #: Effort [N] of an actuator's joint; the preload may change while the axis runs.
        self.force = axis.force
        self.sample_count = 0
        self._block_bytes, self._chunk_time = int(block_bytes), float(chunk_time)
        self._rows = len(axis.kind.row)
        bag.add_topic(self._joint_topic, cdr.JOINT_STATE, axis.durability)
        for topic in axis.floats():
            bag.add_topic(topic, cdr.FLOAT64, axis.durability)
        for topic in axis.states():
            bag.add_topic(topic, cdr.JOINT_STATE, axis.durability)
        self._places: list[list[int]] = [[place] for place in axis.floats().values()]
        self._places += [list(names.values()) for names in axis.states().values()]
        self._frames = {False: self._make_frames(False)}
        self._tripped = False
        self._since = 0.0
        self.restart()
        bag.on_flush(self.flush)

    @property
    def _joint_topic(self) -> str:
        return f"{self.axis.prefix}/joint_states"

    def _make_frames(self, tripped: bool) -> Frames:
        axis, channel = self.axis, self.bag.channel
        joints = cdr.joint_state_form(axis.joints, signals.TRIPPED_FRAME if tripped else "", moving=True)
        messages = [(channel(self._joint_topic), joints)]
        messages += [(channel(topic), cdr.float64_form()) for topic in axis.floats()]
        messages += [(channel(topic), cdr.joint_state_form(list(names))) for topic, names in axis.states().items()]
        size = sum(len(form.data) + 31 for _, form in messages)  # 31 bytes of record header around every message
        return Frames(messages, max(self._block_bytes // size, 1))

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics with one message per sample, in the order of a sample."""
        return (self._joint_topic, *self.axis.floats(), *self.axis.states())

    @property
    def sample_bytes(self) -> int:
        """Bytes per sample in the file, index included."""
        return self._frames[False].size + 16 * len(self.topics)

    def restart(self) -> None:
        """Begin a new run; its first sample has no velocity."""
        self._measured = np.nan
        self._started = False

    def write(self, stamps, table, *, joints=None, times=None) -> None:
        """Write samples."""
        stamps, table, joints, times = self._checked(stamps, table, joints, times)
        if not stamps.size:
            return
        groups = self._joint_groups(table, joints)
        tripped = table[signals.TRIPPED] != 0.0
        cuts = (np.flatnonzero(tripped[1:] != tripped[:-1]) + 1).tolist()
        values = [groups, *([table[places]] for places in self._places)]
        for begin, end in zip((0, *cuts), (*cuts, stamps.size), strict=True):
            self._fill(self._frames_of(bool(tripped[begin])), stamps, times, values, slice(begin, end))
        self.sample_count += stamps.size
        if time.monotonic() - self._since > self._chunk_time:
            self.flush()

    def flush(self) -> None:
        """Pass pending samples to the operating system, so that a kill of this process does not lose them."""
        frames = self._frames[self._tripped]
        if frames.count:
            self.bag.write_frames(frames)
            frames.clear()
        self._since = time.monotonic()

    def _fill(self, frames: Frames, stamps, times, values, samples: slice) -> None:
        """Write samples into frames; ``values``: for each topic, groups of numbers of shape (numbers, n)."""
        begin = samples.start
        while begin < samples.stop:
            if not frames.count:
                self._since = time.monotonic()
            until = min(samples.stop, begin + frames.rows - frames.count)
            chosen = [[group[:, begin:until] for group in groups] for groups in values]
            frames.add(stamps[begin:until], times[begin:until], chosen)
            begin = until
            if frames.count == frames.rows:
                self.flush()

    def _frames_of(self, tripped: bool) -> Frames:
        """Return the frames for samples with a stopped or a running axis."""
        if tripped != self._tripped:
            self.flush()
            self._tripped = tripped
        if tripped not in self._frames:
            self._frames[tripped] = self._make_frames(tripped)
        return self._frames[tripped]

    def _joint_groups(self, table: np.ndarray, joints: np.ndarray) -> list[np.ndarray]:
        """Return positions, velocities and efforts of the joints."""
        if self.axis.kind.motor:
            return np.split(joints, NUMBERS)
        measured = table[signals.MEASURED]
        before = np.concatenate([[self._measured], measured[:-1]])
        with np.errstate(invalid="ignore"):
            velocity = (measured - before) * self.axis.sample_rate
        if not self._started:
            velocity[0] = 0.0
        self._started, self._measured = True, measured[-1]
        groups = [measured[None], velocity[None], np.full((1, measured.size), self.force)]
        if len(self.axis.joints) == 1:
            return groups
        further = np.zeros(measured.size), np.zeros(measured.size), table[signals.FORCE]
        return [np.vstack([group, row]) for group, row in zip(groups, further, strict=True)]

    def _checked(self, stamps, table, joints, times):
        stamps = _instants("stamps", stamps, None)
        times = stamps if times is None else _instants("times", times, stamps.size)
        table = _table("table", table, (self._rows, stamps.size), "a row for each signal and a column for each sample")
        if self.axis.kind.motor:
            if joints is None:
                raise RecordingError("joints: missing; a motor needs positions, velocities and efforts")
            shape = NUMBERS * len(self.axis.joints), stamps.size
            joints = _table("joints", joints, shape, "positions, velocities and efforts of all joints")
        elif joints is not None:
            raise RecordingError("joints: given for an actuator, whose joint is in the table; omit them")
        return stamps, table, joints, times


def _instants(name: str, given, count: int | None) -> np.ndarray:
    """Return times [ns] as int64."""
    instants = np.asarray(given)
    wrong = instants.ndim != 1 or (count is not None and instants.size != count)
    if wrong or (instants.size and instants.dtype.kind not in "iu"):
        allowed = "one whole number of nanoseconds for each sample"
        raise RecordingError(f"{name}: shape {instants.shape}, {instants.dtype}: must be {allowed}")
    return instants.astype(np.int64, copy=False)


def _table(name: str, given, shape: tuple[int, int], meaning: str) -> np.ndarray:
    """Return a table of numbers."""
    table = np.asarray(given, np.float64)
    if table.shape != shape:
        raise RecordingError(f"{name}: shape {table.shape}: must be {shape}, {meaning}")
    return table


def write_recording(
    recording: Recording,
    path,
    configuration: str | None = None,
    *,
    namespace: str = "",
    joint: str | None = None,
    start_time_ns: int = 0,
) -> None:
    """Write a run as a bag in the form that nodes record; the bag of a stage contains the topics of all its axes."""
    path = pathlib.Path(path)
    text = recording.configuration if configuration is None else configuration
    axes = {namespace: recording}
    if recording.axes:
        each = [recording.axis(name) for name in recording.axes]
        axes = {str(one.metadata["namespace"]): one for one in each}

    def write(bag: BagWriter) -> None:
        simulated = {"source": SIMULATED} if recording.is_simulated else {}
        bag.describe(RECORD, provenance() | simulated)
        for space, one in axes.items():
            own = joint or str(configured(text, "plant_simulator", space).get("joint", "piezo"))
            _write_topics(bag, one, text, normalised_namespace(space), own, start_time_ns)

    if path.suffix.lower() != ".mcap":
        with BagWriter(path) as bag:
            write(bag)
        return
    if path.exists():
        raise RecordingError(f"{path}: exists already; choose another name or remove it")
    try:
        folder = pathlib.Path(tempfile.mkdtemp(prefix=f".{path.stem}-", dir=path.parent))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
    try:
        with BagWriter(folder / path.stem) as bag:
            write(bag)
        (folder / path.stem / f"{path.stem}.mcap").rename(path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write_topics(bag, recording, configuration, prefix, joint, start_time_ns) -> None:
    stamps = (np.rint(recording.time * 1e9).astype(np.int64) + int(start_time_ns)).tolist()
    bag.add_topic(f"{prefix}/configuration", "std_msgs/msg/String", "transient_local")
    if configuration:
        bag.write_string(f"{prefix}/configuration", configuration, stamps[0] if stamps else int(start_time_ns))
    values = {name: column.tolist() for name, column in recording.signals.items()}
    values.setdefault("plant_voltage", values.get("voltage"))
    # the topics of the compensator contain the requested voltage
    if ASKED_VOLTAGE in values:
        values["voltage"] = values[ASKED_VOLTAGE]
    states = []
    for node in (signals.INCHWORM if "phase" in values else signals.ACTUATOR).nodes:
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
