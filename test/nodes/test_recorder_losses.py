# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Samples that a fused loop overwrote before the recorder read them are named and counted."""

from __future__ import annotations

import itertools
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from rclpy.serialization import serialize_message  # noqa: E402
from std_msgs.msg import Float64, String  # noqa: E402

from hysteresis_ros.errors import RecordingError  # noqa: E402
from hysteresis_ros.loop.pacing import Samples  # noqa: E402
from hysteresis_ros.nodes import recorder as recording  # noqa: E402
from hysteresis_ros.nodes.recorder import STRIDE, RecorderNode  # noqa: E402
from hysteresis_ros.recordings.run_bag import CHUNK_TIME  # noqa: E402
from hysteresis_ros.signals import ENDED  # noqa: E402


class Written:
    """Replaces bag and writer, and stores the numbers of samples."""

    def __init__(self):
        self.samples = []
        self.force = 0.0

    def attempt(self, what):
        what(None)

    def write(self, stamps, table, **given):
        self.samples += stamps.tolist()


@pytest.mark.parametrize(("stopped", "lost"), [(None, False), ("", False), ("the disk is full", True)])
def test_a_recorder_has_lost_something_when_its_recording_ended_before_the_run(stopped, lost):
    recording = None if stopped is None else SimpleNamespace(stopped=stopped)
    assert RecorderNode.has_lost.fget(SimpleNamespace(recording=recording)) is lost


@pytest.mark.parametrize("missing", [None, "/voltage", "/setpoint/taken"])
def test_a_plant_is_told_to_begin_when_every_publisher_is_there_or_patience_has_ended(missing):
    told = []
    recorder = SimpleNamespace(
        take_samples=lambda: None,
        _arrived=False,
        _last_arrival=0.0,
        _opened=SimpleNamespace(tend=lambda space: None, stopped=""),
        parameters=SimpleNamespace(min_space=0),
        _began=False,
        _patience=time.monotonic() + 60.0,
        count_publishers=lambda topic: int(topic != missing),
        _sampled=["/voltage", "/command"],
        _taken="/setpoint/taken",
        _send_acknowledgement=lambda: told.append(1),
        end_of_run=-1,
        runner=SimpleNamespace(exact=True),
    )
    RecorderNode._tend(recorder)
    assert told == ([] if missing else [1]) and recorder._began is not bool(missing)
    recorder._patience = 0.0
    RecorderNode._tend(recorder)
    RecorderNode._tend(recorder)
    assert told == [1], "once"


@pytest.mark.parametrize("lost", [0, 7])
def test_what_was_overwritten_is_an_error_with_its_number_and_missing_in_the_count(lost):
    taken = Samples(10 + lost, np.zeros((3, 5)), np.arange(5), None, lost)
    said, written = [], Written()
    plant = SimpleNamespace(
        stamps=SimpleNamespace(of_all=lambda numbers: numbers),
        parameters=SimpleNamespace(preload=SimpleNamespace(force=2.5)),
    )
    recorder = SimpleNamespace(
        _reader=SimpleNamespace(take=lambda: taken),
        _take_changes=lambda: None,
        _samples=written,
        recording=written,
        _opened=written,
        bag=written,
        _lost=0,
        _fused_plant=plant,
        _topics=("joint_states", "command"),
        warn=lambda key, text, **how: said.append((text, how)),
    )
    RecorderNode.take_samples(recorder)
    assert written.samples == list(range(10 + lost, 15 + lost)) and written.force == 2.5
    # 15 were run before and together with these; the lost samples are not in the bag
    assert recorder._counts == [15, 15]
    assert len(said) == (1 if lost else 0)
    if lost:
        text, how = said[0]
        assert text.startswith("7 samples were overwritten before they were recorded") and how == {"error": True}
        # what is lost later counts in addition
        taken = Samples(20, np.zeros((3, 5)), np.arange(5), None, 3)
        RecorderNode.take_samples(recorder)
        assert recorder._lost == 10 and recorder._counts == [15, 15] and said[1][0].startswith("3 samples")


@pytest.mark.parametrize(("publishers", "recorded"), [(0, [b"given"]), (1, [])])
def test_setpoints_are_recorded_as_sent_where_no_node_reports_those_that_it_has_taken(publishers, recorded):
    written, received = [], []
    bag = SimpleNamespace(add_topic=lambda *given: None, write=lambda topic, kind, data, stamp: written.append(data))
    recorder = SimpleNamespace(
        resolve_topic_name=lambda topic: f"/{topic}",
        subscriber=lambda kind, topic, write, *given, **more: (
            received.append(write) or SimpleNamespace(topic_name=topic)
        ),
        count_publishers=lambda topic: publishers,
        recording=SimpleNamespace(attempt=lambda what: what(bag)),
        active=True,
        running=True,
        _unfinished=bag,
        _taken="/setpoint_taken",
    )
    RecorderNode._record(recorder, "setpoint", Float64, None, "volatile")
    received[0](b"given")
    assert written == recorded
    # what is reported as taken is always written, under the name of the setpoint
    RecorderNode._record(recorder, "setpoint", Float64, None, "volatile", heard="/setpoint_taken")
    received[1](b"taken")
    assert written == [*recorded, b"taken"]


@pytest.mark.parametrize("topic", ["joint_states", "reference", "changes"])
def test_messages_of_a_run_are_recorded_while_it_lasts_and_changes_always(topic):
    for external, ended, active, running in itertools.product((False, True), repeat=4):
        written, received = [], []
        bag = SimpleNamespace(add_topic=lambda *given: None, write=lambda *given, kept=written: kept.append(given))
        recorder = SimpleNamespace(
            resolve_topic_name=lambda topic: f"/{topic}",
            subscriber=lambda kind, topic, write, *given, kept=received, **more: (
                kept.append(write) or SimpleNamespace(topic_name=topic)
            ),
            recording=SimpleNamespace(attempt=lambda what, bag=bag: what(bag)),
            parameters=SimpleNamespace(external_plant=external),
            end_of_run=20 if ended else -1,
            active=active,
            running=running,
            _unfinished=bag,
            _is_taken=lambda data: False,
            _note_change=lambda text: None,
        )
        RecorderNode._record(recorder, topic, String, None, "volatile")
        received[0](serialize_message(String(data="{}")))
        # an external plant continues to measure after the end of the run
        late = topic == "joint_states" and external and ended
        assert bool(written) is (topic == "changes" or (active and running and not late))


def recorder_of(counts, **values):
    """Return a recorder that has received a number of messages of each topic."""
    sent = []
    given = {
        "_counts": list(counts),
        "_acknowledge": SimpleNamespace(publish=lambda message: sent.append(message.data)),
        "_lacking_changes": lambda: set(),
        "end_of_run": 20,
        "sent": sent,
    }
    return SimpleNamespace(**(given | values))


def test_only_samples_of_which_every_topic_is_in_the_bag_are_acknowledged():
    """The plant continues on acknowledgement, so a sample acknowledged too early is lost if the recorder ends."""
    recorder = recorder_of([32, 17, 40])
    RecorderNode._send_acknowledgement(recorder)
    assert recorder.sent == [17] and recorder._acknowledged == 17


@pytest.mark.parametrize(
    ("counts", "lacking", "done"),
    [
        ([20, 20], set(), True),
        ([25, 20], set(), True),
        ([20, 19], set(), False),
        ([20, 20], {"plant_simulator"}, False),
    ],
)
def test_a_recording_is_done_when_every_topic_and_every_log_is_whole(counts, lacking, done):
    assert RecorderNode.is_done(recorder_of(counts, _lacking_changes=lambda: lacking)) == done


def test_a_log_that_has_not_ended_is_waited_for_while_there_is_hope():
    now = time.monotonic()
    values = {
        "_last_arrival": now,
        "parameters": SimpleNamespace(partner_timeout=1e6),
        "count_publishers": lambda topic: 1,
        "resolve_topic_name": lambda topic: topic,
        "_loggers": {"plant_simulator", "motion_controller"},
        "_ended": {"motion_controller"},
    }
    assert RecorderNode._lacking_changes(SimpleNamespace(**values)) == {"plant_simulator"}
    gone = values | {"count_publishers": lambda topic: 0}
    assert RecorderNode._lacking_changes(SimpleNamespace(**gone)) == set()
    late = values | {"_last_arrival": now - 2e6}
    assert RecorderNode._lacking_changes(SimpleNamespace(**late)) == set()


def tending(**values):
    """Let a recorder that has heard nothing for a while look whether it may exit; return whether it did."""
    left = []
    given = {
        "take_samples": lambda: None,
        "_arrived": False,
        "_last_arrival": time.monotonic() - 1e6,
        "_opened": SimpleNamespace(tend=lambda least: None, stopped=""),
        "parameters": SimpleNamespace(min_space=1),
        "_began": True,
        "end_of_run": 20,
        "runner": SimpleNamespace(exact=False),
        "_lacking_changes": lambda: set(),
        "leave_when_done": lambda: left.append(True),
    }
    RecorderNode._tend(SimpleNamespace(**(given | values)))
    return bool(left)


def test_a_recorder_exits_after_the_end_of_the_run_and_a_silence_only():
    assert tending()
    assert not tending(end_of_run=-1), "the axis is only silent"
    assert not tending(_arrived=True)
    assert not tending(_lacking_changes=lambda: {"plant_simulator"})
    assert not tending(runner=SimpleNamespace(exact=True)), "in lockstep is_done decides"


@pytest.mark.parametrize(
    ("exact", "ended", "lacking", "done"),
    [
        (False, {"motion_controller"}, {"plant_simulator"}, False),
        (False, {"motion_controller"}, set(), True),
        (False, set(), {"plant_simulator"}, True),  # the axis continues without its recorder
        (True, set(), {"plant_simulator"}, False),  # in lockstep all nodes are stopped together
    ],
)
def test_a_recorder_that_is_stopped_waits_for_the_logs_that_will_still_end(exact, ended, lacking, done):
    recorder = SimpleNamespace(
        _arrived=False,
        _last_arrival=time.monotonic() - 1e6,
        runner=SimpleNamespace(exact=exact),
        _ended=ended,
        _lacking_changes=lambda: lacking,
    )
    assert RecorderNode.drained(recorder) == done
    recorder._arrived = True
    assert not RecorderNode.drained(recorder), "a message has just arrived"


def test_every_stride_of_samples_is_acknowledged_once():
    sent = []
    recorder = recorder_of(
        [0, 0],
        _arrived=False,
        _began=True,
        _acknowledged=0,
        runner=SimpleNamespace(exact=True, heard=lambda: None),
        pace=SimpleNamespace(tick=lambda: None),
    )
    recorder._send_acknowledgement = lambda: (RecorderNode._send_acknowledgement(recorder), sent.append(recorder))
    for _ in range(4 * STRIDE):
        for index in (0, 1):
            RecorderNode._note(recorder, index)
    assert recorder.sample == 4 * STRIDE - 1, "samples count from 0"
    assert recorder.sent == [STRIDE, 2 * STRIDE, 3 * STRIDE, 4 * STRIDE]


def test_messages_that_the_recording_lacks_are_said_with_their_topic_and_number():
    said = []
    recorder = SimpleNamespace(
        recording=SimpleNamespace(stopped=""),
        bag=None,
        end_of_run=20,
        _topics=(("joint_states",), ("command",), ("voltage",)),
        _counts=[20, 17, 25],
        get_logger=lambda: SimpleNamespace(warning=said.append),
    )
    RecorderNode.release(recorder)
    assert said == ["messages missing from the recording: command 3"]
    recorder._counts = [20, 20, 20]
    RecorderNode.release(recorder)
    assert len(said) == 1


def health(age=0.0, free=1e9, end=-1, stopped="", rate=100.0):
    """Return level and text of the health of a recorder at a rate [Hz] whose last sample is so old [s]."""
    opened = SimpleNamespace(message_count=7, stopped=stopped, free=free, path="bag")
    recorder = SimpleNamespace(
        pace=SimpleNamespace(age=age),
        parameters=SimpleNamespace(sample_rate=rate, min_space=1e6, warn_space=2e6),
        end_of_run=end,
        _opened=opened,
        _acknowledged=3,
        bag=opened,
    )
    return RecorderNode.health(recorder)[:2]


def test_the_health_of_a_recorder_tells_what_is_lost_before_what_may_be():
    assert health() == (0, "")
    assert health(age=1e3) == (2, "joint_states is stale") and health(age=1e3, end=20) == (0, "")
    # at 0.5 Hz three samples last 6 s
    assert health(age=5.9, rate=0.5) == (0, "") and health(age=6.1, rate=0.5) == (2, "joint_states is stale")
    assert health(free=1.5e6) == (1, "only 1.5 MB are free on the disk of bag")
    assert health(age=1e3, free=0.0, stopped="the disk is full") == (2, "recording ended: the disk is full")


def test_a_chunk_is_open_no_longer_than_its_time(tmp_path):
    """The bag is looked at once in a period, so a chunk may be older by one period than the flush time."""
    for chunk_time, period in ((1.0, 0.1), (0.1, 0.05)):
        parameters = SimpleNamespace(
            path=str(tmp_path / f"bag{chunk_time}"),
            min_space=0,
            max_bag_size=0,
            max_bag_duration=0.0,
            chunk_time=chunk_time,
        )
        recorder = SimpleNamespace(parameters=parameters, described=(), _configuration="", _period=period)
        bag = RecorderNode.open_bag(recorder, parameters)
        assert 0.0 < bag._flush_time + period <= chunk_time + 1e-12
        bag.finish()


@pytest.mark.parametrize(("chunk_time", "period"), [(2.0, 0.1), (0.1, 0.05)])
def test_the_bag_is_looked_at_ten_times_a_second_and_twice_in_a_chunk(chunk_time, period):
    recorder = SimpleNamespace(parameters=SimpleNamespace(chunk_time=chunk_time))
    assert RecorderNode._period.fget(recorder) == pytest.approx(period)


def test_a_bag_is_split_by_size_and_duration_and_needs_its_space_before_it_begins(tmp_path, monkeypatch):
    values = {"path": str(tmp_path / "bag"), "min_space": 0, "max_bag_size": 4_000_000, "max_bag_duration": 30.0}
    parameters, made = SimpleNamespace(**values, chunk_time=1.0), []

    def bag(path, **split):
        made.append((path, split))
        return SimpleNamespace(describe=lambda *given: None)

    monkeypatch.setattr(recording, "BagWriter", bag)
    monkeypatch.setattr(recording, "GuardedBag", lambda bag, flush_time: bag)
    recorder = SimpleNamespace(described=(), _configuration="", _period=0.1)
    RecorderNode.open_bag(recorder, parameters)
    assert made == [(parameters.path, {"max_bag_size": 4_000_000, "max_bag_duration": 30.0})]
    parameters.min_space = 10**18
    with pytest.raises(RecordingError, match="less than min_space"):
        RecorderNode.open_bag(recorder, parameters)
    assert len(made) == 1, "nothing was created"


@pytest.mark.parametrize("external", [False, True])
def test_the_logs_that_a_recording_waits_for_are_those_of_nodes_that_write_one(external):
    """An external plant has no change log and need not report its state; every build begins anew."""
    recorder = SimpleNamespace(
        get_namespace=lambda: "/",
        _described=lambda source: None,
        open_bag=lambda parameters: "bag",
        reset_blocks=lambda: None,
        _entries_taken={"motion_controller": 4},
    )
    values = {"configuration": "", "inchworm": False, "external_plant": external, "topics": ()}
    RecorderNode.build(recorder, SimpleNamespace(**values))
    nodes = {"plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator"}
    assert recorder._loggers == nodes - ({"plant_simulator"} if external else set())
    assert ("plant_simulator/state" in [topic for topic, *_ in recorder._topics]) is not external
    assert recorder._entries_taken == {} and recorder.recording == "bag"


def test_a_log_has_ended_with_its_last_entry_only():
    recorder = SimpleNamespace(_arrived=False, _ended=set())
    for text in ('{"node": "plant_simulator", "action": "stop"}', "no JSON", "[1, 2]"):
        RecorderNode._note_change(recorder, text)
    assert recorder._ended == set() and recorder._arrived
    RecorderNode._note_change(recorder, f'{{"node": "plant_simulator", "action": "{ENDED}"}}')
    assert recorder._ended == {"plant_simulator"}


def test_each_change_of_a_loop_in_this_process_is_written_once():
    """It is read from the logs of the nodes, and its message is ignored, unlike that of another process."""
    logs = {"plant_simulator": ["{}"], "motion_controller": []}

    def node(kind):
        changes = SimpleNamespace(since=lambda count: (logs[kind][count:], len(logs[kind])))
        return SimpleNamespace(kind=kind, changes=changes)

    written, noted = [], []
    bag = SimpleNamespace(write_string=lambda topic, text, stamp: written.append((topic, text)))
    recorder = SimpleNamespace(
        _takes_logs=True,
        fused=SimpleNamespace(tell_changes=lambda: None, nodes={name: node(name) for name in logs}),
        resolve_topic_name=lambda topic: f"/{topic}",
        _entries_taken={},
        _opened=SimpleNamespace(attempt=lambda what: what(bag)),
        _note_change=noted.append,
    )
    for _ in range(2):
        RecorderNode._take_changes(recorder)
    assert written == [("/changes", "{}")] and noted == ["{}"]
    logs["motion_controller"].append("[]")
    logs["plant_simulator"].append("{ }")
    RecorderNode._take_changes(recorder)
    assert [text for _, text in written] == ["{}", "{ }", "[]"] == noted

    def is_taken(text):
        return RecorderNode._is_taken(recorder, serialize_message(String(data=text)))

    assert is_taken('{"node": "plant_simulator"}') and not is_taken('{"node": "elsewhere"}') and not is_taken("no JSON")
    received, kept = [], []
    recorder.subscriber = lambda kind, topic, write, *given, **more: (
        received.append(write) or SimpleNamespace(topic_name=topic)
    )
    recorder.recording = SimpleNamespace(attempt=lambda what: kept.append(what))
    recorder._unfinished = SimpleNamespace(add_topic=lambda *given: None)
    recorder._is_taken = lambda data: True
    RecorderNode._record(recorder, "changes", String, None, "transient_local")
    received[0](serialize_message(String(data="{}")))
    assert kept == []


def test_triggers_and_scan_edges_of_a_loop_are_written_while_the_run_lasts():
    for recorded, active, running in itertools.product((False, True), repeat=3):
        written = []
        bag = SimpleNamespace(write_joint_state=lambda *given, kept=written: kept.append(given))
        there = SimpleNamespace(attempt=lambda what, bag=bag: what(bag)) if recorded else None
        recorder = SimpleNamespace(recording=there, active=active, running=running)
        RecorderNode.write_message(recorder, "/triggers", 5, ("x",), [1.0])
        assert written == ([("/triggers", 5, ("x",), [1.0])] if recorded and active and running else [])


@pytest.mark.parametrize(("asked", "used"), [(0.5 * CHUNK_TIME, 0.5 * CHUNK_TIME), (10.0 * CHUNK_TIME, CHUNK_TIME)])
def test_samples_of_a_loop_are_written_in_chunks_and_another_loop_begins_a_new_run(monkeypatch, asked, used):
    begun = []
    monkeypatch.setattr(recording, "AxisTopics", lambda *given: given)
    monkeypatch.setattr(
        recording,
        "SampleWriter",
        lambda bag, topics, chunk_time: SimpleNamespace(chunk_time=chunk_time, restart=lambda: begun.append(1)),
    )
    own = SimpleNamespace(sample_rate=1000.0, resting_effort=0.0, driver="")
    plant = SimpleNamespace(parameters=own, joint_names=("x",), axis_kind=None)
    recorder = SimpleNamespace(
        _samples=None, bag="bag", get_namespace=lambda: "/", parameters=SimpleNamespace(chunk_time=asked)
    )
    for count in (0, 1, 2):
        RecorderNode.record_loop(recorder, SimpleNamespace(plant=plant, reader=lambda count=count: count))
        assert len(begun) == count == recorder._reader and recorder._samples.chunk_time == used


@pytest.mark.parametrize("leaving", [True, False])
def test_a_recording_ends_with_the_last_samples_and_its_failure_is_that_of_a_process_that_exits(leaving):
    steps = []

    def fail():
        steps.append("finish")
        raise RecordingError("the disk is full")

    recorder = SimpleNamespace(
        recording=SimpleNamespace(stopped=""),
        bag="bag",
        leaving=leaving,
        failure="",
        exit_code=0,
        take_samples=lambda: steps.append("samples"),
        finish_bag=fail,
    )
    RecorderNode.release(recorder)
    assert steps == ["samples", "finish"] and recorder.recording.stopped == "the disk is full"
    assert recorder.exit_code == int(leaving) and bool(recorder.failure) is leaving
