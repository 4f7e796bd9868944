# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Alignment of bag messages by their stamps into the columns of a run, and its change log."""

from __future__ import annotations

import contextlib
import functools
from dataclasses import dataclass, field

import numpy as np

from hysteresis_ros.configuration import STAGE
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import read_json
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings.bag_reader import Bag, Topic, read_bag
from hysteresis_ros.recordings.dataset import LATENESS, Recording, note_output, output_tolerance
from hysteresis_ros.recordings.provenance import FILES, RECORD, configured, stage_of
from hysteresis_ros.signals import (
    COLUMNS,
    COMPENSATOR,
    CONFIGURED,
    ENDED,
    MOTOR_COLUMNS,
    MOTOR_SOURCE,
    PLANT,
    REQUESTS,
    SOURCE,
    TRIGGER_SIGNALS,
    WRITERS,
    sources,
    state_signals,
)


@dataclass
class ChangeLog:
    """Content of the change log of an axis."""

    changes: list[dict] = field(default_factory=list)  #: Changes in order: sample, node, action, parameters.
    #: Flat dotted parameters with which each node was configured, by the name of the node.
    parameters: dict[str, dict] = field(default_factory=dict)
    lacking: int = 0  #: Number of missing entries, from the gaps in their numbers.
    #: Whether the log lacks the end of the run, because the nodes were stopped.
    stopped: bool = False
    _last: dict[str, int] = field(default_factory=dict)

    def take(self, entry: dict) -> None:
        """Add an entry."""
        node, action, number = str(entry.get("node")), entry.get("action"), entry.get("number")
        if isinstance(number, int):
            # the entries of a newly configured node are numbered from 1 again
            self.lacking += max(number - self._last.get(node, number - 1) - 1, 0)
            self._last[node] = number
        self.stopped = action != ENDED or entry.get("stopped") is True
        if action == CONFIGURED:
            self._configure(node, entry.get("parameters"))
        elif action != ENDED:
            self.changes.append(entry)

    def _configure(self, node: str, parameters) -> None:
        """Store the parameters with which a node was configured before its first sample."""
        own = [entry for entry in self.changes if entry.get("node") == node]
        if isinstance(parameters, dict) and not any(entry.get("sample") for entry in own):
            self.parameters[node] = parameters
            # earlier changes are part of these parameters
            self.changes = [entry for entry in self.changes if entry.get("node") != node]


def read_log(bag: Bag, prefix: str) -> ChangeLog:
    """Return the change log of an axis, without unreadable entries."""
    topic = bag.of_type(f"{prefix}/changes", cdr.STRING)
    log = ChangeLog()
    for text in cdr.decode_strings(topic.data, f"{prefix}/changes") if topic else ():
        with contextlib.suppress(ValueError):
            entry = read_json(text)
            if isinstance(entry, dict):
                log.take(entry)
    return log


#: Times [ns] above this (September 2001) are wall-clock times; smaller ones have an arbitrary origin.
CLOCK = 10**18
#: Largest number of samples at the end that may lack messages, because the recorder stopped before these arrived.
TAIL = 100


def read_recording(path, namespace: str | None = None, *, further: bool = False) -> Recording:
    """Read a bag and align it; see :func:`align`."""
    bag = read_bag(path)
    try:
        stage = _stage(bag) if namespace is None else None
        return align(bag, namespace, further=further) if stage is None else _align_stage(bag, *stage, further)
    except RecordingError as error:
        raise error if str(path) in str(error) else RecordingError(f"{path}: {error}") from None


def namespaces(bag: Bag) -> tuple[str, ...]:
    """Return the sorted namespaces of the axes in the bag; the root namespace is the empty string."""
    endings = ["/joint_states", *(f"/{node}/state" for node in WRITERS)]
    found = set()
    for name in bag.topics:
        if bag.of_type(name, cdr.JOINT_STATE) is None:
            continue
        ending = next((ending for ending in endings if name.endswith(ending)), None)
        if ending is not None:
            found.add(name[: -len(ending)])
    return tuple(sorted(found))


def choose_namespace(bag: Bag, namespace: str | None) -> str:
    """Return the namespace of the axis to read."""
    found = namespaces(bag)
    listed = ", ".join(name or "/" for name in found)
    if not found and (not bag.complete or not len(bag)):
        reasons = "; ".join(bag.notes) or "it contains no messages"
        raise RecordingError(
            f"{bag.path}: damaged, or nothing was recorded ({reasons}): no joint_states and no ~/state messages "
            "are left; use an undamaged copy, or record again"
        )
    if not found:
        topics = ", ".join(sorted(bag.topics)[:8]) or "none"
        raise RecordingError(
            f"{bag.path}: no axis in it: neither joint_states nor ~/state messages (topics: {topics}); "
            "record the topics of an axis"
        )
    if namespace is not None:
        wanted = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
        if wanted not in found:
            raise RecordingError(f"{bag.path}: no axis in namespace '{wanted or '/'}'; there is {listed}")
        return wanted
    if len(found) > 1:
        raise RecordingError(f"{bag.path}: several axes ({listed}); choose one with --namespace")
    return found[0]


#: Metadata that all axes of a stage have in common.
OF_ALL = ("configuration", "provenance", "files", "source")


def _stage(bag: Bag) -> tuple[str, tuple[str, ...]] | None:
    """Return namespace and axes of the recorded stage; None for independent axes."""
    for prefix in namespaces(bag):
        found = stage_of(_configuration(bag, prefix, []))
        if found is not None:
            return found
    return None


def _align_stage(bag: Bag, namespace: str, names: tuple[str, ...], further: bool) -> Recording:
    """Return the recording of a stage, with the samples that all axes have in common."""
    axes = {name: align(bag, f"{namespace}/{name}", further=further) for name in names}
    stamps = {
        name: one.metadata["start_time_ns"] + np.rint(1e9 * one.time).astype(np.int64) for name, one in axes.items()
    }
    common = functools.reduce(np.intersect1d, stamps.values())
    if not common.size:
        raise RecordingError(f"{bag.path}: the axes {', '.join(names)} of the stage have no samples in common")
    first = axes[names[0]].metadata
    whole = {key: first[key] for key in (*OF_ALL, "complete", "recorded_ns", "timing")}
    missing, own = 0, {}
    for name, one in axes.items():
        rows = np.isin(stamps[name], common)
        within = (stamps[name] >= common[0]) & (stamps[name] <= common[-1])
        missing += one.metadata["missing_samples"] + int(np.count_nonzero(within & ~rows))
        own[name] = {key: value for key, value in one.metadata.items() if key not in OF_ALL}
        signals = {key: values[rows] for key, values in one.signals.items()}
        axes[name] = Recording((common - common[0]) / 1e9, signals, one.units)
    metadata = {
        **whole,
        "namespace": namespace,
        "stage": f"{namespace}/{STAGE}",
        "missing_samples": missing,
        "missing_changes": sum(one["missing_changes"] for one in own.values()),
        "start_time_ns": int(common[0]),
        "notes": list(dict.fromkeys(note for one in own.values() for note in one["notes"])),
        "axes": own,
    }
    return Recording.of_axes(axes, metadata)


def align(bag: Bag, namespace: str | None = None, *, further: bool = False) -> Recording:
    """Return all signals of one axis as the columns of a run.

    The stamp of ``joint_states`` identifies a sample; ``~/state`` messages with the same stamp belong to it. Without
    ``~/state``, ``joint_states`` and the Float64 topics are used: a sample gets the last ``setpoint`` before it. Any
    other topic is matched by count if it has one message per sample; otherwise a sample gets the last message before
    the next sample. Without a simulated plant the true displacement is unknown, so the column ``displacement`` contains
    the measured one, and a note states this.
    """
    prefix = choose_namespace(bag, namespace)
    notes = list(bag.notes)
    configuration = _configuration(bag, prefix, notes)
    joints, rows = _one_run(bag, f"{prefix}/joint_states", notes)
    states = {node: _one_run(bag, f"{prefix}/{node}/state", [])[0] for node in WRITERS}
    key = joints or next(state for state in states.values() if state is not None)
    stamps = np.unique(key.stamps)

    columns = _state_columns(states, stamps)
    if joints is not None:
        joint = configured(configuration, "plant_simulator", prefix).get("joint")
        measured = _joint(bag, joints, joint)
        if "measured" not in columns:
            columns["measured"] = _by_stamp(stamps, joints.stamps, measured)
        _add_float_topics(bag, prefix, columns, joints, rows)
    if configured(configuration, "plant_simulator", prefix).get("external_plant"):
        stamps, columns = _within_run(stamps, columns, notes)
    motor = _motor_columns(states, joints, stamps)
    present = [*_completed(columns, stamps.size, notes), *motor]
    columns |= motor
    recorded = stamps.size
    stamps, columns = _without_tail(stamps, columns, present, notes)
    # a sample without a measurement, or with a failed device, does not count as missing
    device = configured(configuration, "plant_simulator", prefix).get("driver")
    wanted = [name for name in present if not (device and name in ("measured", "displacement"))]
    missing, per_signal = _missing(stamps, columns, wanted, notes)
    log = read_log(bag, prefix)
    if bag.complete:
        # a properly closed bag is complete, except for the sample that was interrupted when the nodes were stopped
        missing += max(recorded - stamps.size - log.stopped, 0)
    metadata = {"configuration": configuration, "missing_samples": missing, "missing": per_signal}
    metadata |= _told(bag, prefix, log, notes)
    metadata["start_time_ns"] = int(stamps[0]) if stamps.size else 0
    received = _received(bag, prefix, joints, rows)
    paced = received is not None and _is_paced(configuration, prefix)
    late = (received - joints.stamps) / 1e9 if paced else np.zeros(0)
    metadata["timing"] = _timing(received, late)
    time = (stamps - stamps[0]) / 1e9 if stamps.size else np.zeros(0)
    signals = {name: columns[name] for name in (*COLUMNS, *motor)}
    signals |= _more(states, stamps, set(signals), further)
    left, mode = (_of_plant(states[PLANT], stamps, name) for name in ("voltage", "mode"))
    note_output(signals, left, mode, _tolerance(configuration, log, prefix))
    if further and late.size:
        signals["lateness"] = _by_stamp(stamps, joints.stamps, late)
    return Recording(time, signals, {"lateness": "s"} if "lateness" in signals else {}, metadata)


def _tolerance(configuration: str, log: ChangeLog, prefix: str) -> float:
    """Return the largest difference between requested and output voltage due to rounding [V]; infinite if unknown."""
    given = [log.parameters.get(node) or configured(configuration, node, prefix) for node in (PLANT, COMPENSATOR)]
    return output_tolerance(*given)


def _told(bag: Bag, prefix: str, log: ChangeLog, notes: list[str]) -> dict:
    """Return the metadata of an axis, and add notes about the axis to ``notes``."""
    late = _late_commands(bag, prefix)
    if late:
        notes.append(
            f"{late} voltages were late, and the plant held the previous one: this machine or the driver was too slow "
            "for the rate"
        )
    if log.lacking:
        notes.append(f"{log.lacking} entries of the change log are missing: the run cannot be repeated")
    return {
        "source": str(bag.words.get(RECORD, {}).get("source", bag.path.name)),
        "late_commands": late,
        "namespace": prefix,
        "complete": bag.complete,
        "changes": log.changes,
        "parameters": log.parameters,
        "provenance": bag.words.get(RECORD, {}),
        "files": bag.words.get(FILES, {}),
        "recorded_ns": _recorded(bag, prefix),
        "missing_changes": log.lacking,
        "messages": {name: len(bag.topics[name].data) for name in sorted(bag.topics) if name.startswith(f"{prefix}/")},
        "notes": notes,
    }


def _more(states: dict, stamps: np.ndarray, present: set[str], further: bool) -> dict[str, np.ndarray]:
    """Return further signals: all with ``further``, otherwise only late voltages, stops, force and triggers, if any."""
    more = {}
    if further:
        more = {name: values for name, values in _further(states, stamps).items() if name not in present}
    for name in ("skipped", "tripped"):  # a replay of a device's run needs them
        values = np.nan_to_num(_of_plant(states[PLANT], stamps, name))
        if np.any(values):
            more[name] = values
    force = _of_plant(states[PLANT], stamps, "force")
    if np.any(np.isfinite(force)):
        more["force"] = force
    source = states[MOTOR_SOURCE] if states[SOURCE] is None else states[SOURCE]
    if np.any(np.nan_to_num(_of_plant(source, stamps, "trigger"))):
        more |= {name: _of_plant(source, stamps, name) for name in TRIGGER_SIGNALS}
    return more


def _within_run(stamps, columns: dict, notes: list[str]):
    """Return the samples from the first to the last reference; an external plant also measures outside the run."""
    there = np.flatnonzero(np.isfinite(columns["reference"])) if "reference" in columns else np.zeros(0, dtype=int)
    if not there.size:
        return stamps, columns
    run = slice(there[0], there[-1] + 1)
    if run.stop - run.start < stamps.size:
        notes.append(f"{stamps.size - run.stop + run.start} measurements before or after the run are omitted")
    return stamps[run], {name: values[run] for name, values in columns.items()}


def _state_columns(states: dict, stamps) -> dict[str, np.ndarray]:
    """Return the columns of a run in ``~/state`` messages, each column from the first node that contains it."""
    columns = {}
    for name in COLUMNS:
        for node, signal in sources(name):
            values = states[node].signal(signal) if states[node] is not None else None
            if values is not None:
                columns[name] = _by_stamp(stamps, states[node].stamps, values)
                break
    return columns


def _completed(columns: dict, samples: int, notes: list[str]) -> list[str]:
    """Fill in the columns that were not recorded, with a note, and return the names of the recorded columns."""
    if "displacement" not in columns and "measured" in columns:
        columns["displacement"] = columns["measured"].copy()
        notes.append("no true displacement in the bag: the column displacement is the measured one")
    absent = [name for name in COLUMNS if name not in columns]
    if absent:
        notes.append(f"not in the bag: {', '.join(absent)}")
    for name in absent:
        columns[name] = np.full(samples, np.nan)
    return [name for name in COLUMNS if name not in absent]


def setpoints_per_sample(recording: Recording) -> np.ndarray:
    """Return the setpoint applied at each sample from the first on, shape (M,), for replay by the simulation.

    Samples that are missing in the recording get the previous setpoint, which is valid until the next setpoint.
    """
    setpoint = recording["setpoint"]
    if not recording.has("setpoint"):
        raise RecordingError("the recording has no setpoints; record reference_generator/state or setpoint")
    if not np.isfinite(setpoint[0]):
        raise RecordingError("the setpoint of the first sample is not in the recording; a replay needs it")
    index = recording.sample_numbers()
    rows = np.where(np.isfinite(setpoint), np.arange(len(recording)), 0)
    held = setpoint[np.maximum.accumulate(rows)]
    return held[np.searchsorted(index, np.arange(index[-1] + 1), side="right") - 1]


def _motor_columns(states: dict, joints, stamps) -> dict[str, np.ndarray]:
    """Return the additional columns of an inchworm motor's run, as far as they were recorded."""
    if states[MOTOR_SOURCE] is None:
        return {}
    found = _further(states, stamps)
    if "extender" not in found and joints is not None and "extender" in joints.names:
        found["extender"] = _by_stamp(stamps, joints.stamps, joints.signal("extender"))
    return {name: found[name] for name in (*MOTOR_COLUMNS, *REQUESTS) if name in found}


def _of_plant(plant, stamps, name: str) -> np.ndarray:
    """Return an optional signal of the plant's state, NaN where it was not recorded."""
    values = plant.signal(name) if plant is not None else None
    return np.full(stamps.size, np.nan) if values is None else _by_stamp(stamps, plant.stamps, values)


def _further(states: dict, stamps) -> dict[str, np.ndarray]:
    """Return the signals of ``~/state`` messages that are not columns of every run."""
    found = {}
    for node in WRITERS:
        for name, signal in state_signals(node).items():
            values = states[node].signal(name) if states[node] is not None else None
            if signal not in COLUMNS and values is not None:
                found[signal] = _by_stamp(stamps, states[node].stamps, values)
    return found


def _configuration(bag: Bag, prefix: str, notes: list[str]) -> str:
    """Return the last readable configuration; other messages are skipped, because any node may publish on the topic."""
    name = f"{prefix}/configuration"
    topic = bag.of_type(name, cdr.STRING)
    messages = topic.data if topic else ()
    for number, data in enumerate(reversed(messages)):
        try:
            text = cdr.decode_strings([data], name)[0]
        except RecordingError as error:
            notes.append(f"a message is ignored: {error}")
            continue
        if number:
            notes.append(
                f"{name}: the last {number} of {len(messages)} messages cannot be decoded; an earlier one is used"
            )
        return text
    return ""


def _one_run(bag: Bag, name: str, notes: list[str]):
    """Return the messages of a topic and their rows; of several runs (decreasing stamps), only the longest."""
    topic = bag.of_type(name, cdr.JOINT_STATE)
    if topic is None:
        return None, np.zeros(0, dtype=np.int64)
    messages = cdr.decode_joint_states(topic.data, name)
    cuts = np.flatnonzero(np.diff(messages.stamps) < 0) + 1
    runs = np.split(np.arange(messages.stamps.size), cuts)
    rows = max(runs, key=len)
    if len(runs) > 1:
        notes.append(f"the time of the samples decreased {len(runs) - 1} times (reset): the longest run is used")
    return messages.take(rows), rows


def _by_stamp(stamps, source_stamps, values) -> np.ndarray:
    """Return ``values`` on the grid ``stamps``: NaN where no message exists, the last one of repeated messages."""
    found = np.full(stamps.size, np.nan)
    place = np.searchsorted(stamps, source_stamps)
    inside = place < stamps.size
    inside[inside] = stamps[place[inside]] == source_stamps[inside]
    found[place[inside]] = values[inside]
    return found


def _joint(bag: Bag, joints: cdr.JointStates, joint) -> np.ndarray | None:
    if not joints.names:
        raise RecordingError(f"{bag.path}: joint_states contains no joint; the driver must fill name and position")
    if joint is not None and joint not in joints.names:
        raise RecordingError(
            f"{bag.path}: joint '{joint}' of the configuration is not in joint_states; it has {', '.join(joints.names)}"
        )
    return joints.signal(joint or joints.names[0])


def _add_float_topics(bag: Bag, prefix: str, columns: dict, joints: cdr.JointStates, rows: np.ndarray) -> None:
    order = np.array(bag.topics[f"{prefix}/joint_states"].order, dtype=np.int64)[rows]
    stamps, first = np.unique(joints.stamps, return_index=True)
    order = order[first]
    for name in ("setpoint", "reference", "command", "voltage"):
        topic = bag.of_type(f"{prefix}/{name}", cdr.FLOAT64)
        if name in columns or topic is None:
            continue
        values = cdr.decode_float64s(topic.data, f"{prefix}/{name}")
        if name == "setpoint":
            columns[name] = _held(values, topic, order)
        elif values.size == stamps.size == len(bag.topics[f"{prefix}/joint_states"].data):
            columns[name] = values
        else:
            columns[name] = _held(values, topic, np.append(order[1:], np.iinfo(np.int64).max))


def _held(values: np.ndarray, topic: Topic, until: np.ndarray) -> np.ndarray:
    """Return for each sample the last value before the position ``until`` in the bag; NaN before the first value."""
    place = np.searchsorted(np.array(topic.order, dtype=np.int64), until) - 1
    return np.where(place >= 0, values[np.maximum(place, 0)], np.nan)


def _without_tail(stamps, columns, present, notes):
    """Remove the last samples if the recorder has not received all of their messages."""
    whole = np.ones(stamps.size, dtype=bool)
    for name in present:
        if np.any(np.isfinite(columns[name])):
            whole &= ~np.isnan(columns[name])
    if not stamps.size or whole[-1] or not np.any(whole):
        return stamps, columns
    last = int(np.flatnonzero(whole)[-1]) + 1
    if stamps.size - last > TAIL:
        return stamps, columns
    notes.append(f"the last {stamps.size - last} samples are incomplete and omitted")
    return stamps[:last], {name: values[:last] for name, values in columns.items()}


def _missing(stamps, columns, present, notes):
    """Count samples that are absent, or that lack a signal between the first and the last value of that signal."""
    gaps = 0
    if stamps.size > 2:
        steps = np.diff(stamps)
        gaps = int(np.sum(np.maximum(np.rint(steps / np.median(steps)) - 1, 0)))
    if gaps:
        notes.append(f"{gaps} samples are missing in the bag")
    per_signal, holes = {}, np.zeros(stamps.size, dtype=bool)
    for name in present:
        there = np.flatnonzero(~np.isnan(columns[name]))
        if there.size == 0:
            continue
        hole = np.isnan(columns[name])
        hole[: there[0]] = False
        hole[there[-1] + 1 :] = False
        holes |= hole
        if np.any(hole):
            per_signal[name] = int(np.sum(hole))
        outside = int(there[0]) + stamps.size - 1 - int(there[-1])
        if outside:
            notes.append(f"{name} was recorded for only {stamps.size - outside} of {stamps.size} samples")
    if per_signal:
        notes.append("samples without a value: " + ", ".join(f"{name} {count}" for name, count in per_signal.items()))
    return gaps + int(np.sum(holes)), per_signal


def _recorded(bag: Bag, prefix: str) -> int:
    """Return the time of reception of the first sample [ns, wall clock]; 0 if no clock was recorded."""
    topic = bag.of_type(f"{prefix}/joint_states", cdr.JOINT_STATE)
    first = topic.times[0] if topic and topic.times else 0
    return first if first > CLOCK else 0


def _late_commands(bag: Bag, prefix: str) -> int:
    """Return the number of late voltages from the plant's last diagnostics; 0 if unknown."""
    topic = bag.of_type("/diagnostics", cdr.DIAGNOSTICS)
    count = 0
    for _, name, _, _, values in cdr.decode_diagnostics(topic.data, "/diagnostics") if topic else ():
        if name.startswith(f"{prefix}/plant_simulator:"):
            with contextlib.suppress(ValueError):
                count = int(values.get("late_samples", values.get("late_commands", count)))
    return count


def _is_paced(configuration: str, prefix: str) -> bool:
    """Return whether samples began at wall-clock deadlines: fused, real-time factor 1, no ``publish_clock``."""
    plant = configured(configuration, "plant_simulator", prefix)
    slowed = plant.get("real_time_factor", 1.0) != 1.0 or plant.get("publish_clock", False)
    return plant.get("time_mode") == "fused" and not slowed


def _received(bag: Bag, prefix: str, joints, rows: np.ndarray) -> np.ndarray | None:
    """Return the times of reception of ``joint_states`` [ns]; None if no clock was recorded."""
    if joints is None or rows.size < 3:
        return None
    received = bag.topics[f"{prefix}/joint_states"].received()[rows]
    # in a simulated run, the times of reception equal the stamps
    simulated = np.array_equal(received - received[0], joints.stamps - joints.stamps[0])
    return None if received[-1] <= received[0] or simulated else received


def _timing(received: np.ndarray | None, late: np.ndarray) -> dict:
    """Return rate and jitter of ``joint_states`` from the times of reception; with ``late``, also the lateness."""
    if received is None:
        return {}
    steps = np.diff(received) / 1e9
    parts = LATENESS if late.size else {}
    return {
        **{name: float(np.percentile(late, part)) for name, part in parts.items()},
        "rate_hz": float((received.size - 1) / (received[-1] - received[0]) * 1e9),
        "jitter_p99_s": float(np.percentile(np.abs(steps - np.median(steps)), 99)),
    }
