# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recordings in several files, with a disk that becomes full, and with their origin: always one dataset."""

import errno
import hashlib
import os
import time

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from samples_support import ACTUATOR, make_samples

from hysteresis_ros.configuration import dump_configuration, load_configuration
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.loop.repeated import named_files
from hysteresis_ros.recordings import Recording, bag_writer, cdr
from hysteresis_ros.recordings.align import ChangeLog, read_recording
from hysteresis_ros.recordings.bag_reader import read_bag
from hysteresis_ros.recordings.bag_writer import BagWriter, GuardedBag, require_space
from hysteresis_ros.recordings.provenance import (
    FILES,
    LARGEST,
    RECORD,
    described,
    in_force,
    packed_files,
    provenance,
    require_same,
    whole,
)
from hysteresis_ros.recordings.run_bag import SampleWriter

SAMPLES = 400
STEP = 100_000  # ns between two samples


def write_run(path, **split):
    """Write batches, single messages between them, and texts."""
    stamps, table, _ = make_samples(ACTUATOR, SAMPLES)
    with BagWriter(path, **split) as bag:
        bag.describe(RECORD, provenance())
        writer = SampleWriter(bag, ACTUATOR, block_bytes=15_000)
        for k in range(0, SAMPLES, 10):
            bag.write_string("/left/note", str(k), int(stamps[k]))
            writer.write(stamps[k : k + 10], table[:, k : k + 10])
    return path


@pytest.mark.slow
@pytest.mark.parametrize("split", [{"max_bag_size": 60_000}, {"max_bag_duration": 9e-3}])
def test_a_split_recording_is_one_dataset_of_whole_files(tmp_path, split):
    whole, parts = write_run(tmp_path / "whole"), write_run(tmp_path / "run", **split)
    files = sorted(parts.glob("*.mcap"), key=lambda path: int(path.stem.split("_")[1]))
    assert [path.name for path in files] == [f"run_{k}.mcap" for k in range(len(files))] and len(files) > 3
    counted = 0
    for path in files:
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            times = [message.log_time for _, _, message in reader.iter_messages()]
            assert reader.get_summary().statistics.message_count == len(times) > 0
            assert {item.name: item.metadata for item in reader.iter_metadata()}[RECORD]["python"]
        counted += len(times)
        if "max_bag_size" in split:
            assert path.stat().st_size < split["max_bag_size"] + 16_000  # the records at its end
        else:
            assert max(times) - min(times) <= 1e9 * split["max_bag_duration"] + 10 * STEP
    with Reader(parts) as reader, Reader(whole) as one:
        assert reader.message_count == one.message_count == counted
        assert (reader.start_time, reader.duration) == (one.start_time, one.duration)
    one, several = read_recording(whole, further=True), read_recording(parts, further=True)
    assert several.metadata["complete"] and several.notes == one.notes
    for name, values in {"time": one.time, **one.signals}.items():
        np.testing.assert_array_equal(several[name], values)


def test_a_bag_says_what_made_it(tmp_path):
    from hysteresis_ros import __version__

    made = read_recording(write_run(tmp_path / "run")).metadata["provenance"]
    assert made["hysteresis_ros"] == __version__ and made["numpy"] == np.__version__ and made["recorded"]
    content = (tmp_path / "run" / "run.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    assert read_recording(tmp_path / "cut.mcap").metadata["provenance"] == made


def test_a_simulated_run_says_what_made_it_too(tmp_path):
    from hysteresis_ros.loop.reach import axes
    from hysteresis_ros.loop.simulation import simulate
    from hysteresis_ros.recordings.run_bag import write_recording

    write_recording(simulate(axes(load_configuration("kim2009"))[0], duration=0.01), tmp_path / "run.mcap")
    made = read_recording(tmp_path / "run.mcap").metadata["provenance"]
    assert made.keys() >= {"hysteresis_ros", "numpy", "python"}


def test_a_node_is_described_by_a_section_of_its_own():
    own = "/**:\n  ros__parameters: {sample_rate: 1.0}\n/left/plant_simulator:\n  ros__parameters: {gain: 2.0}\n"
    assert described(own, "plant_simulator", "/left") and not described(own, "plant_simulator", "/right")
    assert not any(described(text, "motion_controller", "/left") for text in (own, "", "no: [parameters"))


def test_a_damaged_copy_of_a_file_is_no_file():
    assert whole({"a": "base64:YQ==", "b": "base64:Y!Q==", "c": "base64:YQ", "d": "sha256:00"}) == {"a": b"a"}


def test_files_that_parameters_name_to_be_read_are_in_the_bag(tmp_path):
    read, written, large = tmp_path / "learned.yaml", tmp_path / "next.yaml", tmp_path / "waveform.csv"
    for path, content in ((read, b"a: 1\n"), (written, b"b"), (large, b"0\n" * LARGEST)):
        path.write_bytes(content)
    learning = {"learning.file": str(read), "learning.save_file": str(written)}
    configuration = dump_configuration(
        {
            "/left/motion_controller": learning,
            "/left/reference_generator": {"waveform.file.path": str(large)},
            "/right/motion_controller": {"learning.file": str(written)},
            "/left/recorder": {"configuration": str(written)},
        }
    )
    named = named_files(configuration, "/left")
    assert named == sorted([read, large]) and named_files("no: [yaml", "/left") == []
    words = packed_files([*named, tmp_path / "gone"])
    with BagWriter(tmp_path / "bag") as bag:
        bag.describe(FILES, words)
        bag.write_float64("/voltage", 1.0, 1)
    assert whole(read_bag(tmp_path / "bag").words[FILES]) == {str(read): b"a: 1\n"}
    assert words[str(large)] == "sha256:" + hashlib.sha256(large.read_bytes()).hexdigest()


def guarded(path, flush_time=0.0):
    made = GuardedBag(BagWriter(path), flush_time)
    made.attempt(lambda bag: [bag.write_float64("/voltage", float(k), k + 1) for k in range(50)])
    return made


def test_a_run_with_a_large_file_says_whether_the_file_has_changed_or_left(tmp_path):
    path = tmp_path / "waveform.csv"
    path.write_bytes(b"0\n" * LARGEST)
    [text] = packed_files([path]).values()
    require_same(str(path), text)
    path.write_bytes(b"1\n" * LARGEST)
    with pytest.raises(RecordingError, match="too large for the recording and has changed on this disk since"):
        require_same(str(path), text)
    path.unlink()
    with pytest.raises(RecordingError, match="too large for the recording and is no longer on this disk"):
        require_same(str(path), text)


def test_a_disk_that_is_nearly_full_ends_the_recording_in_order(tmp_path, monkeypatch):
    recording = guarded(tmp_path / "run")
    monkeypatch.setattr(bag_writer, "LOOK", 0.0)
    monkeypatch.setattr(bag_writer, "free_space", lambda path: 5_000_000)
    recording.tend(5_000_000)
    assert recording.bag is not None and recording.free == 5_000_000
    recording.tend(5_000_001)
    assert recording.bag is None and "5 MB are free" in recording.stopped
    recording.attempt(lambda bag: pytest.fail("the recording is over"))
    recording.tend(5_000_001)
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == recording.message_count == 50
    with pytest.raises(RecordingError, match="5 MB are free on the disk, less than min_space = 6 MB"):
        require_space(tmp_path / "absent" / "run", 6_000_000)
    assert not (tmp_path / "absent").exists()


@pytest.mark.parametrize("room", [0, 40_000])
def test_a_full_disk_ends_the_recording_and_what_was_written_stays(tmp_path, monkeypatch, room):
    recording = guarded(tmp_path / "run")
    recording.attempt(BagWriter.flush)
    writev, limit = os.writev, (tmp_path / "run" / "run.mcap").stat().st_size + room

    def full(file, pieces):
        if os.fstat(file).st_size + sum(map(len, pieces)) > limit:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return writev(file, pieces)

    monkeypatch.setattr(os, "writev", full)
    recording.attempt(lambda bag: [bag.write_string("/note", "x" * 1000, k) for k in range(1000)])
    assert recording.bag is None and os.strerror(errno.ENOSPC) in recording.stopped
    # without space for the end of the file the message contains the remedy
    assert ("hysteresis repair" in recording.stopped) == (room == 0), recording.stopped
    assert (tmp_path / "run" / "metadata.yaml").exists() == (room > 0)
    values = cdr.decode_float64s(read_bag(tmp_path / "run").topics["/voltage"].data, "/voltage")
    np.testing.assert_array_equal(values, np.arange(50))


def test_what_was_written_is_handed_on_in_time(tmp_path):
    recording = guarded(tmp_path / "run", 0.05)
    recording._flushed = time.monotonic() + 60.0
    recording.tend(0)
    assert len(read_bag(tmp_path / "run")) == 0
    recording._flushed = time.monotonic() - 0.051
    recording.tend(0)
    assert len(read_bag(tmp_path / "run")) == 50
    recording.finish()


def entry(node, number, action="retune", sample=0, **parameters):
    return {"node": node, "number": number, "action": action, "sample": sample, "parameters": parameters}


def test_a_log_with_a_gap_says_how_many_entries_are_missing():
    log = ChangeLog()
    for given in (entry("a", 1, "configure"), entry("b", 1), entry("a", 2), entry("a", 5, "end"), entry("b", 2)):
        log.take(given)
    assert log.lacking == 2 and [item["node"] for item in log.changes] == ["b", "a", "b"]
    log.take(entry("b", 1, "configure"))
    assert log.lacking == 2
    old = ChangeLog()
    for _ in range(3):
        old.take({"node": "a", "action": "stop", "sample": 3, "parameters": {}})
    assert old.lacking == 0 and len(old.changes) == 3


def test_what_the_nodes_were_configured_with_wins_over_the_file():
    nodes = ("plant_simulator", "motion_controller", "hysteresis_compensator")
    log = ChangeLog()
    for node in nodes:
        log.take(entry(node, 1, "configure", sample_rate=500.0, joint="old"))
    log.take(entry("plant_simulator", 2, sample=0, joint="other"))
    log.take(entry("plant_simulator", 1, "configure", sample_rate=500.0, joint="new", faults=[]))
    log.take(entry("motion_controller", 2, sample=7, joint="x"))
    log.take(entry("motion_controller", 1, "configure", joint="too late"))
    file = "/**:\n  ros__parameters: {sample_rate: 1000.0}\n"
    run = Recording(np.zeros(1), {}, {}, {"configuration": file, "parameters": log.parameters, "namespace": "/left"})
    from hysteresis_ros.configuration import parse_configuration

    found = parse_configuration(in_force(run), "test")
    assert found.node("plant_simulator", "/left") == {"sample_rate": 500.0, "joint": "new"}
    assert found.node("motion_controller", "/left")["joint"] == "old"
    assert not found.describes("displacement_camera", "/left"), "a value for all nodes makes no camera"
    camera = file + "/left/displacement_camera:\n  ros__parameters: {rotation: 0.1}\n"
    run.metadata["configuration"] = camera
    seen = parse_configuration(in_force(run), "test").node("displacement_camera", "/left")
    assert seen == {"sample_rate": 1000.0, "rotation": 0.1}
    run.metadata["configuration"] = file
    assert [item["node"] for item in log.changes] == ["motion_controller"]
    del log.parameters["plant_simulator"]
    assert in_force(run) == file
