# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Samples written in batches equal the messages of the nodes one by one, for any batches and any end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader
from samples_support import ACTUATOR, AXES, MOTOR, RATE, make_samples, topics_of, write_batches

from hysteresis_ros import signals
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings.align import read_recording
from hysteresis_ros.recordings.bag_reader import read_bag
from hysteresis_ros.recordings.bag_writer import BagWriter, ChunkedWriter, Frames
from hysteresis_ros.recordings.run_bag import AxisTopics, SampleWriter


def decoded(path, topic):
    type_name, messages = topics_of(path)[topic]
    return [cdr.typestore().deserialize_cdr(data, type_name) for data in messages]


@pytest.mark.slow
@pytest.mark.parametrize("axis", AXES)
def test_every_topic_has_the_signals_of_the_table(tmp_path, axis):
    stamps, table, joints = samples = make_samples(axis, 60)
    with BagWriter(tmp_path / "bag") as bag:
        writer = SampleWriter(bag, axis)
        write_batches(writer, samples)
    assert set(topics_of(tmp_path / "bag")) == set(writer.topics)
    for topic, name in signals.float_topics().items():
        if name in {signal.name for signal in axis.kind.row}:
            values = [message.data for message in decoded(tmp_path / "bag", f"{axis.prefix}/{topic}")]
            np.testing.assert_array_equal(values, table[signals.place(name)], err_msg=topic)
    for node in signals.WRITERS:
        topic = f"{axis.prefix}/{node}/state"
        if topic not in writer.topics:
            assert node == (signals.SOURCE if axis.kind.motor else signals.MOTOR_SOURCE)
            continue
        names = axis.kind.state(node)
        for k, message in enumerate(decoded(tmp_path / "bag", topic)):
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamps[k]
            assert message.name == list(names) and not message.velocity.size and not message.effort.size
            np.testing.assert_array_equal(message.position, [table[signals.place(n), k] for n in names.values()])


@pytest.mark.parametrize("axis", [*AXES, replace(ACTUATOR, joints=(*ACTUATOR.joints, "force"))])
def test_joint_states_have_position_velocity_and_effort(tmp_path, axis):
    _, table, joints = samples = make_samples(axis, 200)
    with BagWriter(tmp_path / "bag") as bag:
        writer = SampleWriter(bag, axis)
        write_batches(writer, samples, cuts=(1, 77, 78))
    before = 0.0
    for k, message in enumerate(decoded(tmp_path / "bag", f"{axis.prefix}/joint_states")):
        assert message.name == list(axis.joints)
        assert message.header.frame_id == ("tripped" if table[signals.TRIPPED, k] else "")
        if axis.kind.motor:
            found = np.concatenate([message.position, message.velocity, message.effort])
            np.testing.assert_array_equal(found, joints[:, k])
        else:
            measured = table[signals.MEASURED, k]
            velocity = (measured - before) * RATE if k else 0.0
            expected = np.array([[measured, 0.0], [velocity, 0.0], [5.88, table[signals.FORCE, k]]])
            found = np.array([message.position, message.velocity, message.effort])
            np.testing.assert_array_equal(found, expected[:, : len(axis.joints)])
            before = measured


def test_a_run_that_begins_anew_has_no_velocity_first_and_a_preload_may_change(tmp_path):
    stamps, table, _ = make_samples(ACTUATOR, 4)
    with BagWriter(tmp_path / "bag") as bag:
        writer = SampleWriter(bag, ACTUATOR)
        writer.write(stamps[:2], table[:, :2])
        writer.restart()
        writer.force = 2.0
        writer.write(stamps[2:], table[:, 2:])
    messages = decoded(tmp_path / "bag", "/left/joint_states")
    assert [message.velocity[0] == 0.0 for message in messages] == [True, False, True, False]
    assert [message.effort[0] for message in messages] == [5.88, 5.88, 2.0, 2.0]


def test_nobody_knows_the_true_displacement_of_a_device(tmp_path):
    axis = AxisTopics(simulated=False)
    with BagWriter(tmp_path / "bag") as bag:
        write_batches(SampleWriter(bag, axis), make_samples(axis, 3))
    names = decoded(tmp_path / "bag", "/plant_simulator/state")[0].name
    assert names == [name for name in signals.ACTUATOR.state(signals.PLANT) if name != "displacement"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Messages of 300 samples that were written at once, actuator and motor."""
    found = []
    for axis in (ACTUATOR, MOTOR):
        folder = tmp_path_factory.mktemp("whole")
        with BagWriter(folder / "bag") as bag:
            write_batches(SampleWriter(bag, axis), make_samples(axis, 300))
        found.append(topics_of(folder / "bag"))
    return found


@pytest.mark.slow
@settings(max_examples=20)
@given(motor=st.booleans(), cuts=st.sets(st.integers(0, 300)), block=st.integers(1, 60_000))
def test_batches_and_chunks_change_nothing(tmp_path_factory, whole, motor, cuts, block):
    folder, axis = tmp_path_factory.mktemp("batches"), MOTOR if motor else ACTUATOR
    with BagWriter(folder / "cut") as bag:
        write_batches(SampleWriter(bag, axis, block_bytes=block), make_samples(axis, 300), cuts)
    assert whole[motor] == topics_of(folder / "cut")


@pytest.mark.slow
@pytest.mark.parametrize("axis", AXES)
def test_the_index_leads_to_every_message(tmp_path, axis):
    """Reading by the index, by time and topic, finds the same as reading the file in its order."""
    samples = make_samples(axis, 500)
    times = samples[0] + np.random.default_rng(2).integers(0, 900_000, 500)  # not in order
    with BagWriter(tmp_path / "bag") as bag:
        writer = SampleWriter(bag, axis, block_bytes=100_000)
        # times different from those of the neighbouring samples
        notes = {text: int(time_ns) for text, time_ns in (("late", times.max() - 1), ("early", times.min() + 1))}
        bag.write_string("/note", "late", notes["late"])
        bag.add_topic("/silent", "std_msgs/msg/String")
        write_batches(writer, [part[..., :250] if part is not None else None for part in samples], times=times[:250])
        bag.flush()
        bag.write_string("/note", "early", notes["early"])
        rest = [part[..., 250:] if part is not None else None for part in samples]
        write_batches(writer, rest, cuts=range(0, 250, 30), times=times[250:])
    path = tmp_path / "bag" / "bag.mcap"
    in_order = read_bag(path).topics
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 500 * len(writer.topics) + 2
        found = {summary.channels[k].topic: count for k, count in summary.statistics.channel_message_counts.items()}
        counts = {**dict.fromkeys(writer.topics, 500), "/note": 2, "/silent": 0}
        assert found == counts
        assert summary.statistics.message_start_time == times.min()
        assert summary.statistics.message_end_time == times.max() > times[-1]
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 5
        for topic in writer.topics:
            some = [(m.log_time, m.data) for _, _, m in reader.iter_messages([topic], ending_before=int(times[250]))]
            pairs = zip(in_order[topic].times, in_order[topic].data, strict=True)
            expected = sorted((pair for pair in pairs if pair[0] < times[250]), key=lambda pair: pair[0])
            assert some == expected
        # every entry of every message index, checked by hand
        for chunk in summary.chunk_indexes:
            check_chunk(path.read_bytes(), chunk)
    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == summary.statistics.message_count
        assert (bag.start_time, bag.end_time) == (times.min(), times.max() + 1)  # of metadata.yaml
        assert {c.topic: c.msgcount for c in bag.connections} == counts
        for connection, time_ns, data in bag.messages():
            if connection.topic == "/note":
                text = cdr.decode_strings([data], "/note")[0]
                assert time_ns == notes.pop(text)
    assert not notes


def test_single_messages_share_a_topic_with_samples(tmp_path):
    """The order in the file is the order of writing, and the index contains both."""
    stamps, table, _ = make_samples(ACTUATOR, 20)
    table[signals.TRIPPED] = 0.0
    table[signals.COMMAND] = np.arange(20.0)
    with BagWriter(tmp_path / "bag") as bag:
        writer = SampleWriter(bag, ACTUATOR)
        bag.write_float64("/left/command", -1.0, int(stamps[0]) - 1)
        writer.write(stamps, table)
        bag.flush()
        bag.write_float64("/left/command", 20.0, int(stamps[-1]) + 1)
    content = (tmp_path / "bag" / "bag.mcap").read_bytes()
    with open(tmp_path / "bag" / "bag.mcap", "rb") as stream:
        reader = make_reader(stream)
        for chunk in reader.get_summary().chunk_indexes:
            check_chunk(content, chunk)
        values = cdr.decode_float64s([m.data for _, _, m in reader.iter_messages(["/left/command"])], "/left/command")
    np.testing.assert_array_equal(values, np.arange(-1.0, 21.0))


def test_compressed_chunks_hold_the_same(tmp_path):
    samples = make_samples(ACTUATOR, 100)
    with BagWriter(tmp_path / "plain") as bag:
        write_batches(SampleWriter(bag, ACTUATOR), samples)
    writer = ChunkedWriter(tmp_path / "packed")
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    form = cdr.float64_form()
    with writer:
        channel = writer.add_connection("/left/command", cdr.FLOAT64, typestore=cdr.typestore()).id
        frames = Frames([(channel, form)], 100)
        frames.add(samples[0], samples[0], [[samples[1][[signals.COMMAND]]]])
        writer.write_frames(frames)
    assert topics_of(tmp_path / "packed")["/left/command"] == topics_of(tmp_path / "plain")["/left/command"]
    with open(tmp_path / "packed" / "packed.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert [chunk.compression for chunk in reader.get_summary().chunk_indexes] == ["zstd"]
        assert sum(1 for _ in reader.iter_messages()) == 100


def check_chunk(content: bytes, chunk):
    """Follow the message indices of a chunk to its messages."""

    def number(place, size):
        return int.from_bytes(content[place : place + size], "little")

    data = chunk.chunk_start_offset + 9 + 8 + 8 + 8 + 4 + 4 + 8
    end = chunk.chunk_start_offset + chunk.chunk_length
    found = 0
    for channel, place in chunk.message_index_offsets.items():
        assert content[place] == 0x07 and number(place + 9, 2) == channel
        size = number(place + 11, 4)
        for entry in range(place + 15, place + 15 + size, 16):
            log_time, message = number(entry, 8), data + number(entry + 8, 8)
            assert content[message] == 0x05 and number(message + 9, 2) == channel
            assert number(message + 15, 8) == log_time
            assert chunk.message_start_time <= log_time <= chunk.message_end_time
            found += 1
        end += 15 + size
    assert end == chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length
    messages, place = 0, data
    while place < data + chunk.uncompressed_size:
        messages += content[place] == 0x05
        place += 9 + number(place + 1, 8)
    assert place == data + chunk.uncompressed_size and messages == found > 0


@pytest.mark.slow
def test_a_run_is_read_back_and_its_timing_comes_from_the_times(tmp_path):
    stamps, table, _ = make_samples(ACTUATOR, 3000)
    table[np.isnan(table)] = 0.0
    with BagWriter(tmp_path / "bag") as bag:
        SampleWriter(bag, ACTUATOR).write(stamps, table, times=stamps + 40_000 * (np.arange(3000) % 2))
    back = read_recording(tmp_path / "bag", further=True)
    for place, one in enumerate(signals.ACTUATOR.row):
        np.testing.assert_array_equal(back[one.name], table[place], err_msg=one.name)
    assert back.metadata["missing_samples"] == 0 and back.metadata["complete"]
    assert back.metadata["timing"]["rate_hz"] == pytest.approx(RATE, rel=1e-3)
    assert back.metadata["timing"]["jitter_p99_s"] == pytest.approx(80e-6, abs=41e-6)


def test_samples_wait_no_longer_than_told(tmp_path):
    stamps, table, _ = make_samples(ACTUATOR, 10)
    table[signals.TRIPPED] = 0.0
    bag = BagWriter(tmp_path / "bag")
    patient = SampleWriter(bag, ACTUATOR, chunk_time=1e9)
    patient.write(stamps[:5], table[:, :5])
    assert bag.message_count == 0
    bag.flush()
    assert bag.message_count == 5 * len(patient.topics)
    hasty = SampleWriter(bag, AxisTopics(namespace="right"), chunk_time=-1.0)
    hasty.write(stamps[:5], table[:, :5])
    assert bag.message_count == 10 * len(patient.topics)
    assert len(read_bag(tmp_path / "bag" / "bag.mcap")) == 10 * len(patient.topics)
    bag.close()


# -- wrong input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("axis", "change", "says"),
    [
        (ACTUATOR, {"table": np.zeros((18, 5))}, rf"table: shape \(18, 5\): must be \({signals.ACTUATOR_ROW}, 5\)"),
        (
            ACTUATOR,
            {"table": np.zeros((signals.ACTUATOR_ROW, 4))},
            rf"table: shape \({signals.ACTUATOR_ROW}, 4\): must be",
        ),
        (ACTUATOR, {"stamps": np.zeros(5)}, r"stamps: shape \(5,\), float64: must be one whole number of nanoseconds"),
        (ACTUATOR, {"times": np.zeros(4, int)}, r"times: shape \(4,\), int64: must be one whole number"),
        (ACTUATOR, {"joints": np.zeros((12, 5))}, "joints: given for an actuator"),
        (MOTOR, {"joints": None}, "joints: missing"),
        (MOTOR, {"joints": np.zeros((4, 5))}, r"joints: shape \(4, 5\): must be \(12, 5\)"),
    ],
)
def test_wrong_samples_are_named(tmp_path, axis, change, says):
    stamps, table, joints = make_samples(axis, 5)
    with BagWriter(tmp_path / "bag") as bag:
        writer = SampleWriter(bag, axis)
        with pytest.raises(RecordingError, match=says):
            writer.write(**({"stamps": stamps, "table": table, "joints": joints} | change))
        writer.write([], np.zeros((len(table), 0)), joints=None if joints is None else np.zeros((12, 0)))
    assert writer.sample_count == 0


def test_an_actuator_has_one_joint(tmp_path):
    with BagWriter(tmp_path / "bag") as bag, pytest.raises(RecordingError, match="an actuator has one joint"):
        SampleWriter(bag, AxisTopics(joints=("one", "two", "three")))


def test_a_closed_bag_takes_no_samples(tmp_path):
    stamps, table, _ = make_samples(ACTUATOR, 5)
    bag = BagWriter(tmp_path / "bag")
    writer = SampleWriter(bag, ACTUATOR, block_bytes=1)
    bag.close()
    with pytest.raises(RecordingError, match="already closed"):
        writer.write(stamps, table)
    with pytest.raises(RecordingError, match="already closed"):
        SampleWriter(bag, AxisTopics(namespace="other"))
