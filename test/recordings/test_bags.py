# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bags: the topics of the nodes become the columns of a run, for any writer and any end of the bag."""

import contextlib
import json
import sqlite3
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import COLUMNS, Recording, bag_reader, cdr
from hysteresis_ros.recordings.align import _within_run, align, read_recording, setpoints_per_sample
from hysteresis_ros.recordings.bag_reader import SMALL, _of_whole_pages, most, read_bag
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.run_bag import write_recording

RATE = 3000.0
CONFIGURATION = "/**:\n  ros__parameters: {joint: extender}\n"


def make_run(samples=300, seed=1):
    random = np.random.default_rng(seed)
    time = np.rint(np.arange(samples) * 1e9 / RATE) / 1e9
    columns = {name: random.normal(size=samples) * 1e-6 for name in (*COLUMNS, "applied", "switching", "saturated")}
    columns["setpoint"] = np.repeat([0.0, 5e-6, 2e-6], samples // 3 + 1)[:samples]
    return Recording.from_columns({"time": time, **columns}, {"configuration": CONFIGURATION})


def assert_same_run(back, original, samples=None):
    count = len(original) if samples is None else samples
    assert len(back) == count
    assert list(back.signals) == list(COLUMNS)
    for name in ("time", *COLUMNS):
        assert back[name].tobytes() == original[name][:count].tobytes(), name


def copy_bag(source, target, plugin, compression=CompressionMode.NONE):
    with Reader(source) as reader:
        writer = Writer(target, version=9, storage_plugin=plugin)
        writer.set_compression(compression, CompressionFormat.ZSTD)
        with writer:
            connections = {
                connection.topic: writer.add_connection(connection.topic, connection.msgtype, typestore=cdr.typestore())
                for connection in reader.connections
            }
            for connection, time_ns, data in reader.messages():
                writer.write(connections[connection.topic], time_ns, data)


@pytest.mark.parametrize("name", ["bag", "bag.mcap"])
def test_a_run_survives_a_bag_bit_for_bit(tmp_path, name):
    original = make_run()
    write_recording(original, tmp_path / name, namespace="left", start_time_ns=1_700_000_000_123_456_789)
    back = read_recording(tmp_path / name)
    assert_same_run(back, original)
    assert back.configuration == CONFIGURATION
    assert back.metadata["namespace"] == "/left"
    assert back.metadata["missing_samples"] == 0
    assert back.metadata["messages"]["/left/applied"] == len(original)
    assert back.metadata["complete"]
    assert sorted(tmp_path.iterdir()) == [tmp_path / name]


def test_a_bag_has_the_topics_of_the_nodes(tmp_path):
    write_recording(make_run(), tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        topics = {connection.topic: connection.msgtype.split("/")[-1] for connection in reader.connections}
        messages = {
            connection.topic: cdr.typestore().deserialize_cdr(data, connection.msgtype)
            for connection, _, data in reader.messages()
        }
    floats = {f"/{name}": "Float64" for name in ("setpoint", "reference", "command", "applied", "voltage")}
    nodes = ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")
    states = {f"/{node}/state": "JointState" for node in nodes}
    assert topics == {**floats, **states, "/joint_states": "JointState", "/configuration": "String"}
    assert messages["/joint_states"].name == ["extender"]
    assert messages["/plant_simulator/state"].name == ["displacement", "measured", "voltage"]
    assert messages["/joint_states"].header.stamp.nanosec == round(299e9 / RATE)


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("compression", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_bags_of_ros2_bag_record_are_read(tmp_path, plugin, compression):
    original = make_run()
    write_recording(original, tmp_path / "bag")
    copy_bag(tmp_path / "bag", tmp_path / "copy", plugin, compression)
    assert_same_run(read_recording(tmp_path / "copy"), original)


def test_a_database_without_metadata_is_read(tmp_path):
    original = make_run()
    write_recording(original, tmp_path / "bag")
    copy_bag(tmp_path / "bag", tmp_path / "copy", StoragePlugin.SQLITE3)
    (tmp_path / "copy" / "metadata.yaml").unlink()
    assert_same_run(read_recording(tmp_path / "copy"), original)
    assert_same_run(read_recording(tmp_path / "copy" / "copy.db3"), original)


def test_what_was_flushed_survives_a_kill(tmp_path):
    """A writer that is not closed leaves the same as a killed process: neither index nor metadata.yaml."""
    writer = BagWriter(tmp_path / "bag", chunk_bytes=1000)
    for k in range(200):
        writer.write_float64("/setpoint", float(k), k)
    on_disk = (tmp_path / "bag" / "bag.mcap").read_bytes()
    (tmp_path / "killed.mcap").write_bytes(on_disk)
    values = cdr.decode_float64s(read_bag(tmp_path / "killed.mcap").topics["/setpoint"].data, "/setpoint")
    per_chunk = -(-1000 // 43)
    assert values.tolist() == list(range(200 // per_chunk * per_chunk))
    writer.flush()
    (tmp_path / "killed.mcap").write_bytes((tmp_path / "bag" / "bag.mcap").read_bytes())
    assert len(read_bag(tmp_path / "killed.mcap")) == 200
    writer.close()
    assert len(read_bag(tmp_path / "bag")) == 200


@pytest.fixture(scope="module", params=["", "zstd"])
def stream(request, tmp_path_factory):
    """An MCAP of many chunks, as bytes, with the end of each chunk and the messages until there."""
    folder = tmp_path_factory.mktemp("stream")
    writer = Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    if request.param:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    ends = [(0, 0)]
    with writer:
        connection = writer.add_connection("/voltage", cdr.FLOAT64, typestore=cdr.typestore())
        for k in range(120):
            writer.write(connection, k, cdr.encode_float64(k / 7))
            if k % 10 == 9:
                writer.storage.close_chunk()
                ends.append((writer.storage.bio.tell(), k + 1))
    return (folder / "bag" / "bag.mcap").read_bytes(), ends


@pytest.mark.slow
@settings(max_examples=150)
@given(data=st.data())
def test_a_file_cut_anywhere_gives_all_its_whole_chunks(stream, tmp_path_factory, data):
    content, ends = stream
    cut = data.draw(st.integers(0, len(content) - 1))
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    path.write_bytes(content[:cut])
    bag = read_bag(path)
    topic = bag.topics.get("/voltage")
    values = cdr.decode_float64s(topic.data, "/voltage").tolist() if topic else []
    whole = max(count for end, count in ends if end <= cut)
    assert whole <= len(values) <= whole + 10
    assert values == [k / 7 for k in range(len(values))]
    if len(values) < 120:
        assert not bag.complete and "cut off" in bag.notes[0]


def test_a_file_that_is_still_being_written_is_not_called_cut_off(stream, tmp_path, monkeypatch):
    content, ends = stream
    path = tmp_path / "growing.mcap"
    path.write_bytes(content[: ends[5][0]])
    read = bag_reader.read_stream

    def read_while_it_grows(*arguments):
        result = read(*arguments)
        path.write_bytes(content)
        return result

    monkeypatch.setattr(bag_reader, "read_stream", read_while_it_grows)
    bag = read_bag(path)
    assert bag.notes == [f"growing.mcap is still being written: it was read up to byte {ends[5][0]}"]
    assert len(bag.topics["/voltage"].data) == ends[5][1]


def test_an_uncompressed_chunk_gives_its_messages_up_to_the_last_whole_one(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for k in range(100):
            writer.write_float64("/voltage", float(k), k)
    content = (tmp_path / "bag" / "bag.mcap").read_bytes()
    record = cdr.encode_float64(57.0)
    place = content.index(record) + len(record)
    for cut, count in ((place, 58), (place - 1, 57), (place + 1, 58)):
        (tmp_path / "cut.mcap").write_bytes(content[:cut])
        assert len(read_bag(tmp_path / "cut.mcap")) == count


def test_a_chunk_of_any_size_that_did_not_get_smaller_by_packing_is_unpacked_as_a_whole():
    for size in (0, 1, SMALL // 200, SMALL, 10 * SMALL):
        assert most(size) >= max(size, 2**20)
    assert most(10 * SMALL) < 1000 * 10 * SMALL, "a few bytes must not fill the memory"


@pytest.mark.slow
@settings(max_examples=100)
@given(data=st.data())
def test_damage_inside_a_file_is_never_a_traceback(stream, tmp_path_factory, data):
    content, _ = stream
    place = data.draw(st.integers(8, len(content) - 1))
    damage = data.draw(st.binary(min_size=1, max_size=20))
    path = tmp_path_factory.mktemp("damaged") / "damaged.mcap"
    path.write_bytes(content[:place] + damage + content[place + len(damage) :])
    try:
        read_bag(path)
    except RecordingError as error:
        assert str(path) in str(error)


@pytest.mark.parametrize("part", [0.3, 0.5, 0.9, 0.999])
def test_a_run_cut_off_is_a_shorter_run(tmp_path, part):
    original = make_run()
    write_recording(original, tmp_path / "bag")
    file = tmp_path / "bag" / "bag.mcap"
    file.write_bytes(file.read_bytes()[: int(part * file.stat().st_size)])
    with_metadata = read_recording(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    back = read_recording(tmp_path / "bag")
    assert_same_run(back, original, len(back))
    assert_same_run(with_metadata, original, len(back))
    assert len(back) > 0.9 * part * len(original) - 2
    assert back.metadata["missing_samples"] == 0
    if part < 0.9:
        assert not back.metadata["complete"]


def axis(bag, prefix, samples=50, nodes=True, lost=(), received=lambda k: k * 1_000_000):
    for k in range(samples):
        stamp, time = k * 1_000_000, received(k)
        if k == 10:
            bag.write_float64(f"{prefix}/setpoint", 5e-6, time)
        if k not in lost:
            bag.write_joint_state(f"{prefix}/joint_states", stamp, ("stage", "other"), (1e-6 * k, 9.0), time)
        bag.write_float64(f"{prefix}/reference", 2e-6 * k, time)
        bag.write_float64(f"{prefix}/voltage", 3.0 * k, time)
        if nodes:
            bag.write_joint_state(
                f"{prefix}/reference_generator/state",
                stamp,
                ("reference", "setpoint"),
                (2e-6 * k, 5e-6 if k >= 10 else 0.0),
                time,
            )


def test_several_axes_need_a_choice(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        axis(bag, "/left")
        axis(bag, "")
        axis(bag, "/lab/right", samples=20)
    with pytest.raises(RecordingError, match=r"several axes \(/, /lab/right, /left\); choose one with --namespace"):
        read_recording(tmp_path / "bag")
    for spelling in ("lab/right", "/lab/right/"):
        assert len(read_recording(tmp_path / "bag", spelling)) == 20
    assert len(read_recording(tmp_path / "bag", "/")) == 50
    with pytest.raises(RecordingError, match="no axis in namespace '/up'; there is /, /lab/right, /left"):
        read_recording(tmp_path / "bag", "up")


def test_hardware_without_state_topics_is_aligned_by_order(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        axis(bag, "", nodes=False)
    run = read_recording(tmp_path / "bag")
    assert run["reference"].tolist() == [2e-6 * k for k in range(50)]
    assert run["voltage"].tolist() == [3.0 * k for k in range(50)]
    assert run["measured"].tolist() == run["displacement"].tolist() == [1e-6 * k for k in range(50)]
    assert np.isnan(run["setpoint"][:10]).all() and (run["setpoint"][10:] == 5e-6).all()
    assert any("no true displacement" in note for note in run.notes)
    assert any("not in the bag: command, estimated" in note for note in run.notes)


def test_lost_samples_are_counted_and_the_rest_stays_aligned(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        axis(bag, "", lost=(7, 20, 21))
    run = read_recording(tmp_path / "bag")
    there = [k for k in range(50) if k not in (7, 20, 21)]
    assert run.metadata["missing_samples"] == 3
    assert np.rint(run.time * 1000).tolist() == there
    assert run["reference"].tolist() == [2e-6 * k for k in there]


def test_a_lost_state_message_is_a_missing_sample(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(30):
            bag.write_joint_state("/joint_states", k * 1000, ("piezo",), (0.0,))
            if k != 11:
                bag.write_joint_state("/motion_controller/state", k * 1000, ("command", "estimated"), (k, -k))
    run = read_recording(tmp_path / "bag")
    assert run.metadata["missing_samples"] == 1
    assert run.metadata["missing"] == {"command": 1, "estimated": 1}
    assert np.flatnonzero(np.isnan(run["command"])).tolist() == [11]
    assert np.nansum(run["estimated"]) == -(29 * 30 / 2 - 11)


def test_an_incomplete_end_is_left_out_and_counts_only_in_a_bag_that_was_closed(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(30):
            bag.write_joint_state("/joint_states", k * 1000, ("piezo",), (0.0,))
            if k < 28:
                bag.write_joint_state("/motion_controller/state", k * 1000, ("command",), (k,))
    run = read_recording(tmp_path / "bag")
    assert len(run) == 28 and run.metadata["missing_samples"] == 2
    assert any("last 2 samples are incomplete" in note for note in run.notes)
    file = tmp_path / "bag" / "bag.mcap"
    (tmp_path / "killed.mcap").write_bytes(file.read_bytes()[:-3000])
    killed = read_recording(tmp_path / "killed.mcap")
    assert not killed.metadata["complete"] and killed.metadata["missing_samples"] == 0


@pytest.mark.parametrize(
    ("ending", "whole", "missing"),
    [({}, 29, 1), (None, 29, 0), (None, 28, 1), ({}, 30, 0), ({"stopped": True}, 29, 0), ({"stopped": True}, 28, 1)],
)
def test_the_sample_in_which_a_run_was_stopped_is_not_missing(tmp_path, ending, whole, missing):
    node = {"node": "motion_controller"}
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_string("/changes", json.dumps(node | {"action": "configure", "number": 1, "parameters": {}}), 0)
        for k in range(30):
            bag.write_joint_state("/joint_states", k * 1000, ("piezo",), (0.0,))
            if k < whole:
                bag.write_joint_state("/motion_controller/state", k * 1000, ("command",), (k,))
        if ending is not None:
            end = node | {"action": "end", "number": 2, "sample": 30} | ending
            bag.write_string("/changes", json.dumps(end), 30000)
    run = read_recording(tmp_path / "bag")
    assert len(run) == whole and run.metadata["missing_samples"] == missing


def test_rate_and_jitter_come_from_the_times_of_reception(tmp_path):
    late = {25: 400_000}
    with BagWriter(tmp_path / "bag") as bag:
        axis(bag, "", received=lambda k: 5_000 + 2_000_000 * k + late.get(k, 0))
    metadata = read_recording(tmp_path / "bag").metadata
    assert metadata["recorded_ns"] == 0, "no clock of the day began 5 µs ago"
    timing = metadata["timing"]
    assert timing["rate_hz"] == pytest.approx(500.0)
    assert timing["jitter_p99_s"] == pytest.approx(400e-6)


@pytest.mark.parametrize(("factor", "paced"), [(1.0, True), (0.5, False)])
def test_how_late_samples_of_a_fused_run_began_is_reception_less_stamp(tmp_path, factor, paced):
    configuration = (
        f"/**:\n  ros__parameters: {{time_mode: fused}}\n"
        f"/**/plant_simulator:\n  ros__parameters: {{real_time_factor: {factor}}}\n"
    )
    start, lateness = 10**18 + 1, np.linspace(0.0, 99e-6, 100)
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_string("/configuration", configuration, start)
        for k, late in enumerate(lateness):
            stamp = start + 1_000_000 * k
            bag.write_joint_state("/joint_states", stamp, ("piezo",), (0.0,), time_ns=stamp + round(1e9 * late))
            bag.write_joint_state("/plant_simulator/state", stamp, ("displacement", "skipped"), (0.0, float(k == 5)))
    run = read_recording(tmp_path / "bag")
    assert run.metadata["recorded_ns"] == start
    timing = run.metadata["timing"]
    if paced:
        found = [timing[f"lateness_{name}_s"] for name in ("p50", "p99", "p999", "max")]
        assert found == pytest.approx([49.5e-6, 98.01e-6, 98.901e-6, 99e-6], abs=1e-9)
    else:
        assert not any(name.startswith("lateness") for name in timing)


def test_setpoints_are_given_for_every_sample_of_a_replay(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        axis(bag, "", lost=(7, 20, 21))
    setpoints = setpoints_per_sample(read_recording(tmp_path / "bag"))
    assert setpoints.tolist() == [0.0] * 10 + [5e-6] * 40


@pytest.mark.parametrize(("first", "second"), [(20, 40), (40, 20)])
def test_of_several_runs_the_longest_is_shown(tmp_path, first, second):
    with BagWriter(tmp_path / "bag") as bag:
        axis(bag, "", samples=first)
        axis(bag, "", samples=second, received=lambda k: (k + first) * 1_000_000)
    run = read_recording(tmp_path / "bag")
    assert len(run) == 40
    assert run["reference"].tolist() == [2e-6 * k for k in range(40)]
    assert any("decreased 1 times" in note for note in run.notes)


def test_what_an_external_plant_measured_before_and_after_the_run_is_left_out():
    notes, reference = [], np.array([np.nan, 1.0, np.nan, 3.0, np.nan, np.nan])
    stamps, columns = _within_run(np.arange(6), {"reference": reference, "measured": np.arange(6.0)}, notes)
    assert stamps.tolist() == [1, 2, 3] == columns["measured"].tolist()
    assert notes == ["3 measurements before or after the run are omitted"]


def test_a_wrong_joint_is_named(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_string("/configuration", CONFIGURATION, 0)
        axis(bag, "")
    with pytest.raises(RecordingError, match="joint 'extender' .* it has stage, other"):
        read_recording(tmp_path / "bag")


def test_a_configuration_that_is_no_configuration_does_no_harm(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_string("/configuration", "{ not yaml", 0)
        axis(bag, "")
    assert read_recording(tmp_path / "bag").configuration == "{ not yaml"


def test_damaged_messages_are_named(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/joint_states", cdr.JOINT_STATE, b"\x00\x01\x00\x00\x05", 0)
    with pytest.raises(RecordingError, match="/joint_states is not a sensor_msgs/msg/JointState"):
        read_recording(tmp_path / "bag")


def test_names_that_change_are_followed():
    first = cdr.JointStateEncoder(("a", "b")).encode(1, (1.0, 2.0))
    second = cdr.JointStateEncoder(("b", "long name"), frame_id="map").encode(-1_500_000_000, (3.0, 4.0))
    states = cdr.decode_joint_states([first, second], "/joint_states")
    assert states.names == ("a", "b", "long name")
    assert states.stamps.tolist() == [1, -1_500_000_000]
    assert np.array_equal(states.positions, [[1.0, 2.0, np.nan], [np.nan, 3.0, 4.0]], equal_nan=True)
    # names of one length, which differ in any one letter
    for other in ("xbc", "axc", "abx"):
        raws = [cdr.JointStateEncoder((name,)).encode(k, (float(k),)) for k, name in enumerate(("abc", other))]
        assert cdr.decode_joint_states(raws, "/joint_states").names == ("abc", other)


def test_a_setpoint_is_written_when_it_changes(tmp_path):
    setpoint = np.array([np.nan, 1e-6, 1e-6, np.nan, 2e-6, 2e-6, 1e-6])
    signals = {"setpoint": setpoint, "voltage": np.zeros(7), "measured": np.zeros(7)}
    write_recording(Recording(np.arange(7) / RATE, signals), tmp_path / "bag")
    found = read_bag(tmp_path / "bag").topics["/setpoint"]
    assert cdr.decode_float64s(found.data, "/setpoint").tolist() == [1e-6, 2e-6, 1e-6]


@pytest.mark.slow
@given(
    names=st.lists(st.text(max_size=9), min_size=1, max_size=5, unique=True),
    stamp=st.integers(-(2**60), 2**60),
    value=st.floats(allow_nan=False),
)
def test_messages_are_what_the_type_store_makes_of_them(names, stamp, value):
    names = [name.replace("\x00", "0") for name in names]
    raw = cdr.JointStateEncoder(names).encode(stamp, [value] * len(names))
    message = cdr.typestore().deserialize_cdr(raw, cdr.JOINT_STATE)
    assert message.name == names and message.position.tolist() == [value] * len(names)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
    both = cdr.decode_joint_states([raw, raw], "/joint_states")
    assert both.stamps.tolist() == [stamp, stamp] and (both.positions == value).all()


def test_numbers_are_read_in_both_byte_orders_and_none_of_another_length():
    swapped = b"\0\0\0\0" + struct.pack(">d", 2.5)
    for raws, values in (
        ([cdr.encode_float64(1.5), cdr.encode_float64(-3.0)], [1.5, -3.0]),
        ([cdr.encode_float64(1.5), swapped], [1.5, 2.5]),
        ([], []),
    ):
        assert cdr.decode_float64s(raws, "/voltage").tolist() == values
    with pytest.raises(RecordingError, match="a message on /voltage is not a std_msgs/msg/Float64"):
        cdr.decode_float64s([cdr.encode_float64(1.5), cdr.encode_float64(-3.0) + bytes(4)], "/voltage")


def test_diagnostics_are_read(tmp_path):
    kinds = cdr.typestore().types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=3, nanosec=5)
    status = kinds["diagnostic_msgs/msg/DiagnosticStatus"](
        level=1,
        name="motion_controller",
        message="stale",
        hardware_id="",
        values=[kinds["diagnostic_msgs/msg/KeyValue"](key="rate", value="999.8")],
    )
    message = kinds[cdr.DIAGNOSTICS](header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=""), status=[status])
    raw = bytes(cdr.typestore().serialize_cdr(message, cdr.DIAGNOSTICS))
    rows = cdr.decode_diagnostics([raw], "/diagnostics")
    assert rows == [(3_000_000_005, "motion_controller", 1, "stale", {"rate": "999.8"})]


def test_writer_refuses_what_it_cannot_do(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_float64("/voltage", 1.0, 0)
        with pytest.raises(RecordingError, match=r"has the type std_msgs/msg/Float64 and cannot take"):
            bag.write_string("/voltage", "a", 0)
        with pytest.raises(RecordingError, match="is not known"):
            bag.write("/other", "my_msgs/msg/Unknown", b"", 0)
    with pytest.raises(RecordingError, match="already closed"):
        bag.write_float64("/voltage", 1.0, 0)
    with pytest.raises(RecordingError, match="exists already"):
        BagWriter(tmp_path / "bag")
    with pytest.raises(RecordingError, match="exists already"):
        write_recording(make_run(), tmp_path / "bag")
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be created"):
        BagWriter(tmp_path / "file" / "bag")


def test_paths_that_are_no_bags_are_named(tmp_path):
    with pytest.raises(RecordingError, match="not a bag"):
        read_bag(tmp_path)
    (tmp_path / "text.mcap").write_text("hello world")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        read_bag(tmp_path / "text.mcap")
    with pytest.raises(RecordingError, match="not a readable bag"):
        read_bag((tmp_path / "text.mcap").rename(tmp_path / "text.db3"))
    (tmp_path / "metadata.yaml").write_text("[")
    with pytest.raises(RecordingError, match="not a readable bag"):
        read_bag(tmp_path)
    with BagWriter(tmp_path / "empty") as bag:
        bag.write_string("/chatter", "hello", 0)
    with pytest.raises(RecordingError, match=r"no axis in it.*topics: /chatter"):
        align(read_bag(tmp_path / "empty"))


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_compressed_file_is_read_without_metadata_bare_and_as_far_as_it_goes(tmp_path, plugin):
    original = make_run()
    write_recording(original, tmp_path / "bag")
    copy_bag(tmp_path / "bag", tmp_path / "copy", plugin, CompressionMode.FILE)
    (packed,) = (tmp_path / "copy").glob("*.zstd")
    (tmp_path / "copy" / "metadata.yaml").unlink()
    assert_same_run(read_recording(tmp_path / "copy"), original)
    assert_same_run(read_recording(packed), original)
    assert sorted((tmp_path / "copy").iterdir()) == [packed], "another file was left in the folder"
    damaged = packed.with_name(f"damaged{''.join(packed.suffixes)}")
    damaged.write_bytes(b"\x00" * 100)
    with pytest.raises(RecordingError, match="damaged"):
        read_recording(damaged)


@pytest.mark.parametrize("bad", [b"", b"\x00\x01", b"\x00\x01\x00\x00\xff\xff\xff\x7fx"])
def test_a_configuration_that_cannot_be_decoded_does_not_cost_the_recording(tmp_path, bad):
    for name, texts in (("only", [None]), ("second", ["/**:\n  ros__parameters: {sample_rate: 500.0}\n", None])):
        with BagWriter(tmp_path / name) as bag:
            for text in texts:
                if text is None:
                    bag.write("/configuration", cdr.STRING, bad, 0)
                else:
                    bag.write_string("/configuration", text, 0)
            axis(bag, "")
        run = read_recording(tmp_path / name)
        assert len(run) == 50 and any("/configuration" in note for note in run.notes)
        assert run.configuration == (texts[0] or "")


def test_a_recording_of_which_nothing_is_left_is_called_damaged(tmp_path):
    original = make_run()
    write_recording(original, tmp_path / "bag")
    copy_bag(tmp_path / "bag", tmp_path / "copy", StoragePlugin.SQLITE3)
    database = (tmp_path / "copy" / "copy.db3").read_bytes()
    said = "damaged"
    # of pages of any size the partial one at the end is left out, for sqlite would fill it with zeros
    for page in (4096, 65536):
        with contextlib.closing(sqlite3.connect(tmp_path / "copy" / "copy.db3")) as connection:
            connection.execute(f"PRAGMA page_size = {page}")
            connection.execute("VACUUM")
        whole = (tmp_path / "copy" / "copy.db3").read_bytes()
        (tmp_path / "part.db3").write_bytes(whole[:-100])
        with _of_whole_pages(tmp_path / "part.db3") as file:
            assert file.read_bytes() == whole[:-page]
    for size in (0, 10, 100, 4096, 8192, 20000):
        (tmp_path / "cut.db3").write_bytes(database[:size])
        with pytest.raises(RecordingError, match=said):
            read_recording(tmp_path / "cut.db3")
    stream = (tmp_path / "bag" / "bag.mcap").read_bytes()
    for size in (0, 8, 100):
        (tmp_path / "cut.mcap").write_bytes(stream[:size])
        with pytest.raises(RecordingError, match=said):
            read_recording(tmp_path / "cut.mcap")
    with BagWriter(tmp_path / "empty"):
        pass
    with pytest.raises(RecordingError, match="nothing was recorded"):
        read_recording(tmp_path / "empty")
