# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``recorder``: records every topic of an axis in one bag, and acknowledges samples to the plant."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String, UInt64

from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import ConfigurationError, RecordingError
from hysteresis_ros.files import BoundsError, read_json, read_text
from hysteresis_ros.loop.parameters import RecorderNodeParameters
from hysteresis_ros.loop.repeated import named_files
from hysteresis_ros.nodes.base import AxisNode
from hysteresis_ros.nodes.qos import chosen_qos, diagnostics_qos, latched_qos, loop_qos, setpoint_qos
from hysteresis_ros.nodes.reference_source import KEPT
from hysteresis_ros.nodes.scan_clock import KEPT as KEPT_MARKS
from hysteresis_ros.nodes.scan_clock import TOPIC as SCAN_CLOCK
from hysteresis_ros.nodes.spin import QUIET, run
from hysteresis_ros.nodes.timing import STALE
from hysteresis_ros.nodes.triggers import KEPT as KEPT_TRIGGERS
from hysteresis_ros.nodes.triggers import TOPIC as TRIGGERS
from hysteresis_ros.recordings.bag_writer import BagWriter, GuardedBag, require_space
from hysteresis_ros.recordings.provenance import FILES, RECORD, packed_files, provenance
from hysteresis_ros.recordings.run_bag import CHUNK_TIME, AxisTopics, SampleWriter
from hysteresis_ros.references.triggers import makes_triggers
from hysteresis_ros.signals import ACTUATOR, ENDED, INCHWORM, PLANT, AxisKind

#: Topic of the change log.
CHANGES = "changes"

#: Samples between two acknowledgements to the plant.
STRIDE = 16

#: Time after which a recording in real time releases the plant although publishers of the axis are missing [s].
PATIENCE_AT_START = 20.0

#: Silence after the end mark that ends a recording in real time [s].
SILENCE = 0.3


def sampled_topics(kind: AxisKind, external: bool = False):
    """Return the topics with exactly one message per sample, with their types and publishers.

    An external plant need not publish its state.
    """
    source = kind.source
    return (
        ("joint_states", JointState, "plant_simulator"),
        ("reference", Float64, source),
        ("command", Float64, "motion_controller"),
        ("applied", Float64, "hysteresis_compensator"),
        ("voltage", Float64, "hysteresis_compensator"),
        *(() if external else (("plant_simulator/state", JointState, ""),)),
        (f"{source}/state", JointState, ""),
        ("motion_controller/state", JointState, ""),
        ("hysteresis_compensator/state", JointState, ""),
        *((topic, Float64, source) for topic in kind.own_topics),
    )


class RecorderNode(AxisNode):
    """Writes MCAP in chunks: exit, Ctrl-C and SIGTERM lose nothing, SIGKILL loses at most the open chunk."""

    identity = ("path",)
    has_state = False
    #: Whether this node records the diagnostics of all nodes.
    hears_diagnostics = True
    parameters: RecorderNodeParameters

    def __init__(self, **options):
        super().__init__("recorder", **options)
        self.recording: GuardedBag | None = None
        self._arrived = False
        self._samples: SampleWriter | None = None
        self._reader: Any = None
        self._fused_plant: Any = None
        self._lost = 0
        #: Number of entries read so far from each change log in this process.
        self._entries_taken: dict[str, int] = {}

    def build(self, parameters) -> None:
        """Open the bag."""
        self._configuration = ""
        if parameters.configuration:
            try:
                self._configuration = read_text(parameters.configuration)
            except (OSError, UnicodeDecodeError, BoundsError) as error:
                raise ConfigurationError(
                    f"configuration = '{parameters.configuration}' cannot be read: {error}"
                ) from None
        described = self._described(parameters.configuration)
        space = self.get_namespace()
        motor = described is not None and described.describes("inchworm_sequencer", space)
        motor = motor or parameters.inchworm
        scans = described is not None and described.node("reference_generator", space).get("waveform.type") == "scan"
        self._scan_clock = SCAN_CLOCK if scans else ""
        self._axis_kind = INCHWORM if motor else ACTUATOR
        source = self._axis_kind.source
        self._triggers = described is not None and makes_triggers(described.node(source, space))
        self._topics = sampled_topics(self._axis_kind, parameters.external_plant)
        loggers = {*self._axis_kind.nodes}
        self._loggers = loggers - {PLANT} if parameters.external_plant else loggers
        self._further = [_topic_and_type(entry) for entry in parameters.topics]
        self.recording = self.open_bag(parameters)
        self._entries_taken.clear()
        self.reset_blocks()

    def open_bag(self, parameters) -> GuardedBag:
        """Return a new bag that contains the origin of the run and the files that the configuration names."""
        require_space(parameters.path, parameters.min_space)
        split = {"max_bag_size": parameters.max_bag_size, "max_bag_duration": parameters.max_bag_duration}
        bag = BagWriter(parameters.path, **split)
        bag.describe(RECORD, provenance())
        named = [path for space in self.described for path in named_files(self._configuration, space)]
        files = packed_files(named)
        if files:
            bag.describe(FILES, files)
        return GuardedBag(bag, parameters.chunk_time - self._period)

    @property
    def described(self) -> tuple[str, ...]:
        """Namespaces of the axes whose files are in the bag."""
        return (self.get_namespace(),)

    @property
    def _period(self) -> float:
        """Interval of the check for unwritten data [s]."""
        return min(0.1, 0.5 * self.parameters.chunk_time)

    @property
    def _opened(self) -> GuardedBag:
        """The bag that :meth:`build` has opened."""
        if self.recording is None:
            raise RuntimeError("the recorder is not configured")
        return self.recording

    @property
    def bag(self) -> BagWriter | None:
        """The bag; None before it is created, after it is finished, and after it has failed."""
        return None if self.recording is None else self.recording.bag

    @property
    def _unfinished(self) -> BagWriter:
        """The bag; raises RecordingError if it is finished."""
        bag = self.bag
        if bag is None:
            raise RecordingError(f"{self._opened.path} is finished; start another recorder with another path")
        return bag

    @property
    def is_fused(self) -> bool:
        """Always False, because a recorder computes no samples."""
        return False

    def _described(self, source: str):
        """Return the configuration in the recorded text; None if the text is not one (it is recorded nevertheless)."""
        try:
            return parse_configuration(self._configuration, source)
        except ConfigurationError:
            return None

    @property
    def scan_clock(self) -> str:
        """Topic of the clock of a scan; empty: this node records no such topic."""
        return self._scan_clock

    def reset_blocks(self) -> None:
        """Restart the count at sample 0; the bag continues, and its readers use the longest run in it."""
        self._counts = [0] * len(self._topics)
        self._acknowledged = 0
        self._ended: set[str] = set()
        self._last_arrival = time.monotonic()

    def connect(self) -> None:
        """Subscribe to all recorded topics, as raw CDR."""
        qos = self.qos()
        self._sampled: list[str] = []
        durability = "transient_local" if self.runner.exact else "volatile"
        for index, (topic, message_type, partner) in enumerate(self._topics if self.runner.by_message else ()):
            heard = chosen_qos(qos, self.parameters.measurement_reliability) if topic == "joint_states" else qos
            self._record(topic, message_type, heard, durability, index=index, partner=partner)
        if self.parameters.external_plant and self.runner.by_message:
            # an external plant may publish its outputs here
            self._record(f"{PLANT}/state", JointState, qos, durability)
        self.subscribe_end()
        # setpoints are recorded from the node that accepts them, because the recorder may discover a publisher that
        # exits soon too late
        heard = f"{self._axis_kind.source}/taken"
        self._taken = self._record("setpoint", Float64, loop_qos(self.runner.keeps, KEPT), "volatile", heard=heard)
        self._record("setpoint", Float64, chosen_qos(setpoint_qos(), self.parameters.setpoint_reliability), "volatile")
        self._record(CHANGES, String, self.changes_qos(), "transient_local")
        if self.scan_clock and self.runner.by_message:
            self._record(self.scan_clock, JointState, loop_qos(self.runner.keeps, KEPT_MARKS), durability)
        if self._triggers and self.runner.by_message:
            self._record(TRIGGERS, JointState, loop_qos(self.runner.keeps, KEPT_TRIGGERS), durability)
        if self._axis_kind.motor:
            self._record("speed", Float64, setpoint_qos(), "volatile")
        if self.hears_diagnostics:
            self._record("/diagnostics", DiagnosticArray, diagnostics_qos(), "volatile")
        for topic, message_type in self._further:
            self._record(topic, message_type, setpoint_qos(), "volatile")
        self._acknowledge = self.publisher(UInt64, "~/acknowledged", latched_qos())
        # a parallel `ros2 bag record` also records the parameters from here
        self._announce = self.publisher(String, "configuration", latched_qos())

    def begin(self) -> None:
        """Write the configuration first, then allow the plant to begin."""
        bag = self._unfinished
        if self._configuration:
            self._announce.publish(String(data=self._configuration))
            bag.add_topic(self._announce.topic_name, "std_msgs/msg/String", "transient_local")
            bag.write_string(self._announce.topic_name, self._configuration, time.time_ns())
            bag.flush()
        self._began = self.runner.exact or not self.runner.by_message
        self._patience = time.monotonic() + PATIENCE_AT_START
        if self._began:
            self._send_acknowledgement()
        self.timer(self._period, self._tend)

    def _record(self, topic: str, message_type, qos, durability: str, *, index=-1, partner="", heard="") -> str:
        """Record a topic, or under its name the topic ``heard``; return the full name of the received topic."""
        type_name = f"{message_type.__module__.split('.')[0]}/msg/{message_type.__name__}"

        def write(data: bytes) -> None:
            if self.recording is None or not (topic == CHANGES or (self.active and self.running)):
                return
            if topic == CHANGES and self._is_taken(data):
                return
            if topic == "joint_states" and self.end_of_run >= 0 and self.parameters.external_plant:
                return  # an external plant continues to measure
            if topic == "setpoint" and not heard and self.count_publishers(self._taken):
                return  # written when the setpoint is accepted
            self.recording.attempt(lambda bag: bag.write(written, type_name, data, time.time_ns()))
            if index >= 0:
                self._note(index)
            elif topic == CHANGES:
                self._note_change(deserialize_message(data, String).data)

        written = self.resolve_topic_name(topic)
        subscription = self.subscriber(message_type, heard or topic, write, qos, raw=True, partner=partner)
        self._unfinished.add_topic(written, type_name, durability)
        if index >= 0:
            self._sampled.append(written)
        return subscription.topic_name

    @property
    def _takes_logs(self) -> bool:
        """Whether a loop in this process computes the samples, so that change logs are read directly."""
        return self.fused is not None and self.runner is not None and not self.runner.by_message

    def _is_taken(self, data: bytes) -> bool:
        """Return whether an entry belongs to a change log of this process, which is read directly."""
        with contextlib.suppress(ValueError, AttributeError):
            logs = self.fused.nodes if self._takes_logs else ()
            return read_json(deserialize_message(data, String).data).get("node") in logs
        return False

    def _note_change(self, text: str) -> None:
        """Store that the change log of a node has ended."""
        self._arrived = True
        with contextlib.suppress(ValueError, AttributeError):
            entry = read_json(text)
            if entry.get("action") == ENDED:
                self._ended.add(entry.get("node"))

    def _lacking_changes(self) -> set[str]:
        """Return the nodes whose change log has not ended; after the time-out for lost messages, an empty set."""
        waited = time.monotonic() - self._last_arrival
        if waited > self.parameters.partner_timeout or not self.count_publishers(self.resolve_topic_name(CHANGES)):
            return set()
        return self._loggers - self._ended

    def _note(self, index: int) -> None:
        counts = self._counts
        counts[index] += 1
        self._arrived = True
        if self.runner.exact:
            self.runner.heard()
        if index == 0:
            self.pace.tick()
            self.sample = counts[0] - 1  # the present sample; sample 0 lasts until all nodes have started
        if self._began and counts[index] % STRIDE == 0 and min(counts) >= self._acknowledged + STRIDE:
            self._send_acknowledgement()

    # -- samples of a loop in this process -----------------------------------------------------------------------

    def record_loop(self, fused) -> None:
        """Read all samples from the ring of a loop instead of messages, beginning with its next sample."""
        plant = fused.plant
        parameters = plant.parameters
        if self._samples is None and self.bag is not None:
            topics = AxisTopics(
                self.get_namespace().rstrip("/"),
                plant.joint_names,
                parameters.sample_rate,
                plant.axis_kind,
                parameters.resting_effort,
                not parameters.driver,
            )
            self._samples = SampleWriter(self.bag, topics, chunk_time=min(CHUNK_TIME, self.parameters.chunk_time))
        elif self._samples is not None:
            self._samples.restart()
        self._reader, self._fused_plant = fused.reader(), plant

    def take_samples(self) -> None:
        """Write the new samples of the loop after the changes that affect them."""
        taken = self._reader.take() if self._reader is not None else None
        self._take_changes()
        if taken is None or self._samples is None or self.bag is None:
            return
        count = taken.table.shape[1]
        self._lost += taken.lost
        if taken.lost:
            text = f"{taken.lost} samples were overwritten before they were recorded: disk or processor is too slow"
            self.warn("lost", text, error=True)
        if not count:
            return
        stamps = self._fused_plant.stamps.of_all(np.arange(taken.first, taken.first + count))
        self._samples.force = self._fused_plant.parameters.preload.force
        given = {"joints": taken.joints, "times": taken.times}
        self._opened.attempt(lambda _: self._samples.write(stamps, taken.table, **given))
        self._counts = [taken.first + count - self._lost] * len(self._topics)
        self._arrived = True

    def write_message(self, topic: str, stamp: int, names: tuple[str, ...], values: list[float]) -> None:
        """Write the scan edges or a trigger of a loop in this process."""
        if self.recording is not None and self.active and self.running:
            self.recording.attempt(lambda bag: bag.write_joint_state(topic, stamp, names, values))

    def _take_changes(self) -> None:
        """Write the change logs of this process, so that in the bag they precede the samples that need them."""
        if not self._takes_logs:
            return
        self.fused.tell_changes()
        topic, new = self.resolve_topic_name(CHANGES), []
        for node in self.fused.nodes.values():
            texts, self._entries_taken[node.kind] = node.changes.since(self._entries_taken.get(node.kind, 0))
            new += texts
        for text in new:
            self._opened.attempt(lambda bag, text=text: bag.write_string(topic, text, time.time_ns()))
            self._note_change(text)

    def _send_acknowledgement(self) -> None:
        self._acknowledged = min(self._counts)
        self._acknowledge.publish(UInt64(data=self._acknowledged))

    def _tend(self) -> None:
        now = time.monotonic()
        self.take_samples()
        if self._arrived:
            self._last_arrival, self._arrived = now, False
        recording = self._opened
        recording.tend(self.parameters.min_space)
        if recording.stopped:
            self.warn("stopped", f"recording ended: {recording.stopped}", every=60.0, error=True)
        if not self._began:
            # in real time, topics keep no messages for a late subscriber, so the plant waits until all publishers are
            # present
            self._began = now > self._patience or all(map(self.count_publishers, (*self._sampled, self._taken)))
            if self._began:
                self._send_acknowledgement()
        over = self.end_of_run >= 0 and not self.runner.exact and now - self._last_arrival > SILENCE
        if over and not self._lacking_changes():
            self.leave_when_done()

    def _on_end(self, message) -> None:
        self.end_of_run = message.data
        self._last_arrival = time.monotonic()

    def missing_partner(self) -> str:
        """Return the plant, because all recorded messages depend on it."""
        return "plant_simulator"

    def is_done(self) -> bool:
        """Return whether every message of the run is in the bag."""
        return min(self._counts) >= self.end_of_run and not self._lacking_changes()

    #: Longest delay of messages on a busy machine [s], so that the last motion to the safe values is recorded.
    listens_for = 3.0

    @property
    def listens_at_exit(self) -> bool:
        """Whether messages sent before the exit of this node are still written."""
        return True

    def drained(self) -> bool:
        """Return whether no message is pending."""
        if self._arrived:
            self._last_arrival, self._arrived = time.monotonic(), False
        silent = time.monotonic() - self._last_arrival > QUIET
        # in lockstep all nodes are stopped together; otherwise the axis may continue
        return silent and not ((self.runner.exact or self._ended) and self._lacking_changes())

    @property
    def has_lost(self) -> bool:
        """Whether the recording ended before the run."""
        return self.recording is not None and bool(self.recording.stopped)

    def release(self) -> None:
        """Finish the bag with its index and metadata."""
        if self.recording is None:
            return
        if self.bag is not None:
            self.take_samples()
            self._samples = self._reader = None
            try:
                self.finish_bag()
            except RecordingError as error:
                self.recording.stopped = str(error)
        if self.recording.stopped:
            if self.leaving:
                self.failure, self.exit_code = f"recording ended: {self.recording.stopped}", 1
            return
        pairs = zip(self._topics, self._counts, strict=True)
        missing = [f"{topic} {self.end_of_run - count}" for (topic, *_), count in pairs if count < self.end_of_run]
        if missing:
            self.get_logger().warning(f"messages missing from the recording: {', '.join(missing)}")

    def finish_bag(self) -> None:
        """Finish the bag."""
        self._opened.finish()

    def health(self):
        """Report the recorded data, free space, and missing messages."""
        stale = self.pace.age > max(STALE, 3.0 / self.parameters.sample_rate) and self.end_of_run < 0
        recording = self._opened
        values: dict[str, Any] = {
            "messages": recording.message_count,
            "acknowledged": self._acknowledged,
            "stale": stale,
        }
        values |= {"recording": self.bag is not None, "free_space_mb": f"{recording.free / 1e6:.0f}"}
        if recording.stopped:
            return 2, f"recording ended: {recording.stopped}", values
        if stale:
            return 2, "joint_states is stale", values
        if recording.free < self.parameters.warn_space:
            return 1, f"only {recording.free / 1e6:.4g} MB are free on the disk of {recording.path}", values
        return 0, "", values


def _topic_and_type(entry: str):
    """Return topic and message class of ``name:package/msg/Type``."""
    topic, _, type_name = entry.partition(":")
    try:
        from rosidl_runtime_py.utilities import get_message
    except ImportError:
        get_message = _get_message
    try:
        return topic, get_message(type_name)
    except (AttributeError, ModuleNotFoundError, ValueError, TypeError):
        raise ConfigurationError(f"topics: '{entry}' names no known message; write 'name:package/msg/Type'") from None


def _get_message(type_name: str):
    import importlib

    package, kind, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def main(arguments=None) -> int:
    """Run the node; return the exit code."""
    return run([RecorderNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
