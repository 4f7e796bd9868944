# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bags truncated at any point are read up to their last complete message, and repaired for all other readers."""

import errno
import os
import shutil

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Attachment
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from samples_support import ACTUATOR, make_samples, write_batches

from hysteresis_ros.cli.main import main
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings import repair as mcap_repair
from hysteresis_ros.recordings.align import align
from hysteresis_ros.recordings.bag_reader import read_bag
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.repair import repair, whole_mcap
from hysteresis_ros.recordings.run_bag import SampleWriter

BEGIN = 1_700_000_000_000_000_000
WORDS = {"hysteresis_ros": "1.2.3"}


def write_plain(path):
    """Write batches of samples, single messages and texts, with an attachment between them."""
    with BagWriter(path, chunk_bytes=900) as bag:
        bag.describe("hysteresis_ros", WORDS)
        for k in range(20):
            bag.write_string("/note", "x" * k, BEGIN + k)
        bag.flush()
        builder = RecordBuilder()
        Attachment(BEGIN, BEGIN, "plan.txt", "text/plain", b"as planned").write(builder)
        bag._writer.file._append([builder.end()])
        write_batches(SampleWriter(bag, ACTUATOR, block_bytes=12_000), make_samples(ACTUATOR, 40))


def write_packed(path):
    """Write a bag like ``ros2 bag record`` with compressed chunks."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/voltage", cdr.FLOAT64, typestore=cdr.typestore())
        for k in range(120):
            writer.write(connection, BEGIN + k, cdr.encode_float64(k / 7))
            if k % 10 == 9:
                writer.storage.close_chunk()


def write_split(path):
    with BagWriter(path, chunk_bytes=500, max_bag_duration=50e-9) as bag:
        for k in range(120):
            bag.write_float64("/voltage", float(k), BEGIN + k)


def write_database(path):
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/voltage", cdr.FLOAT64, typestore=cdr.typestore())
        for k in range(400):
            writer.write(connection, BEGIN + k, cdr.encode_float64(float(k)))


@pytest.fixture(scope="module", params=[write_plain, write_packed, write_split, write_database])
def source(request, tmp_path_factory):
    """A bag, and its last file."""
    folder = tmp_path_factory.mktemp("source") / "run"
    request.param(folder)
    files = sorted(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
    assert len(files) == (3 if request.param is write_split else 1)
    return folder, files[-1]


def cut_bag(source, folder, size):
    """Copy a bag as after a kill: its last file is truncated, and there is no metadata.yaml."""
    shutil.copytree(source[0], folder)
    os.truncate(folder / source[1].name, size)
    (folder / "metadata.yaml").unlink()
    return folder


def messages_of(bag):
    return {name: (topic.data, topic.times) for name, topic in bag.topics.items() if topic.data}


@pytest.mark.slow
@settings(max_examples=8)
@given(part=st.floats(0.0, 1.0, exclude_max=True))
def test_a_bag_cut_anywhere_is_whole_again_for_every_reader(source, tmp_path_factory, part):
    place = tmp_path_factory.mktemp("cut")
    size = int(part * source[1].stat().st_size)
    cut = cut_bag(source, place / "run", size)
    left = {path.name: path.read_bytes() for path in cut.iterdir()}
    try:
        ours = read_bag(cut)
    except RecordingError:
        ours = None
    whole = messages_of(read_bag(source[0]))
    for name, (data, times) in messages_of(ours).items() if ours else ():
        assert whole[name][0][: len(data)] == data and whole[name][1][: len(times)] == times
    try:
        done = repair(cut)
    except RecordingError as error:
        assert "nothing can be recovered" in str(error) or "not a readable bag" in str(error)
        assert not ours
        assert sorted(place.iterdir()) == [cut]
        return
    assert {path.name: path.read_bytes() for path in cut.iterdir()} == left
    assert sorted(place.iterdir()) == [cut, done.path] and done.path.name == "run_repaired"
    with Reader(done.path) as reader:
        assert reader.message_count == done.messages == sum(1 for _ in reader.messages()) == len(ours)
    assert indexed_messages(done.path) == done.messages or source[1].suffix == ".db3"
    again = read_bag(done.path)
    assert again.complete and not again.notes
    assert messages_of(again) == messages_of(ours)
    assert repair(done.path).path is None


def indexed_messages(folder):
    """Return the number of messages of a bag that the ``mcap`` package finds by index."""
    found = 0
    for path in folder.glob("*.mcap"):
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            assert summary.chunk_indexes or not summary.statistics.message_count
            for topic in {channel.topic for channel in summary.channels.values()}:
                found += sum(1 for _ in reader.iter_messages([topic]))
    return found


def test_all_but_the_torn_chunk_survives_with_what_else_stands_in_the_file(tmp_path):
    write_plain(tmp_path / "whole")
    size = (tmp_path / "whole" / "whole.mcap").stat().st_size
    cut = cut_bag((tmp_path / "whole", tmp_path / "whole" / "whole.mcap"), tmp_path / "cut", size - 1)
    repair(cut, tmp_path / "mended")
    assert messages_of(read_bag(tmp_path / "mended")) == messages_of(read_bag(tmp_path / "whole"))
    with (tmp_path / "mended" / "whole.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert {item.name: item.metadata for item in reader.iter_metadata()}["hysteresis_ros"] == WORDS
        assert [item.data for item in reader.iter_attachments()] == [b"as planned"]
    with Reader(tmp_path / "mended") as mended, Reader(tmp_path / "whole") as whole:
        told = [
            {item.topic: (item.msgtype, item.ext, item.msgcount) for item in bag.connections} for bag in (mended, whole)
        ]
        assert told[0] == told[1] and mended.duration == whole.duration and mended.start_time == whole.start_time


def test_a_report_of_what_was_saved_aligns(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        write_batches(SampleWriter(bag, ACTUATOR, block_bytes=12_000), make_samples(ACTUATOR, 90))
    content = (tmp_path / "run" / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(content[: len(content) // 2])
    repair(tmp_path / "run.mcap", tmp_path / "mended")
    before, after = align(read_bag(tmp_path / "run.mcap")), align(read_bag(tmp_path / "mended"))
    assert len(after) == len(before) > 20
    np.testing.assert_array_equal(after["command"], before["command"])


def test_a_damaged_chunk_is_left_out_and_the_rest_is_kept(tmp_path):
    write_packed(tmp_path / "run")
    content = bytearray((tmp_path / "run" / "run.mcap").read_bytes())
    with (tmp_path / "run" / "run.mcap").open("rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[5]
    moved = bytearray(content)
    moved[chunk.chunk_start_offset] = 0
    content[chunk.chunk_start_offset + 60] ^= 0xFF
    # the end of a file says nothing of what is before it
    (tmp_path / "moved.mcap").write_bytes(moved)
    assert whole_mcap(tmp_path / "run" / "run.mcap").count == 120 and whole_mcap(tmp_path / "moved.mcap") is None
    (tmp_path / "inside.mcap").write_bytes(content)
    found = read_bag(tmp_path / "inside.mcap")
    assert not found.complete and "inside.mcap: 1 chunks are damaged and omitted" in found.notes
    (tmp_path / "run.mcap").write_bytes(content[:-20])
    assert repair(tmp_path / "run.mcap").messages == 110
    values = cdr.decode_float64s(read_bag(tmp_path / "run_repaired").topics["/voltage"].data, "/voltage")
    np.testing.assert_array_equal(values, np.delete(np.arange(120), np.arange(50, 60)) / 7)


def test_a_whole_bag_is_left_alone_and_a_whole_file_gets_its_metadata(tmp_path):
    write_split(tmp_path / "run")
    assert repair(tmp_path / "run").path is None and list(tmp_path.iterdir()) == [tmp_path / "run"]
    (tmp_path / "run" / "metadata.yaml").unlink()
    done = repair(tmp_path / "run")
    assert done.mended == () and messages_of(read_bag(done.path)) == messages_of(read_bag(tmp_path / "run"))


def test_a_file_of_a_bag_that_cannot_be_repaired_is_named_on_the_error_stream(tmp_path):
    write_split(tmp_path / "run")
    first = min((tmp_path / "run").glob("*.mcap"))
    first.write_bytes(b"no bag")
    result = CliRunner().invoke(main, ["repair", str(tmp_path / "run")])
    assert result.exit_code == 0 and result.stdout.count("\n") == 1
    assert result.stderr.startswith("left out: ") and first.name in result.stderr


def refusal(*words):
    """Return the one line with which a repair is refused."""
    result = CliRunner().invoke(main, ["repair", *map(str, words)])
    assert result.exit_code == 2 and "Traceback" not in result.output
    (line,) = result.output.splitlines()
    return line


def test_wrong_input_ends_in_a_line_and_leaves_nothing(tmp_path):
    assert "no such file or folder" in refusal(tmp_path / "absent")
    (tmp_path / "garbage.mcap").write_bytes(b"\x00" * 100)
    assert "not an MCAP file; nothing can be recovered" in refusal(tmp_path / "garbage.mcap")
    (tmp_path / "garbage.db3").write_bytes(b"\x00" * 100)
    assert "not a readable bag" in refusal(tmp_path / "garbage.db3")
    for size in (0, 1, 12):
        (tmp_path / "short.mcap").write_bytes(b"\x89MCAP0\r\n\x01\x00\x00\x00"[:size])
        assert "nothing can be recovered" in refusal(tmp_path / "short.mcap")
    (tmp_path / "folder").mkdir()
    assert "not a bag" in refusal(tmp_path / "folder")
    (tmp_path / "folder" / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 5}\n")
    assert "no .mcap or .db3 file" in refusal(tmp_path / "folder")
    (tmp_path / "folder" / "run_0.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd")
    assert "decompress it (zstd -d run_0.mcap.zstd)" in refusal(tmp_path / "folder")
    (tmp_path / "run.csv").write_text("time\n")
    assert "unknown kind of recording" in refusal(tmp_path / "run.csv")
    write_plain(tmp_path / "run")
    (tmp_path / "run" / "metadata.yaml").unlink()
    before = sorted(tmp_path.iterdir())
    assert "exists already" in refusal(tmp_path / "run", "-o", tmp_path / "folder")
    assert "cannot be written" in refusal(tmp_path / "run", "-o", tmp_path / "run.csv" / "mended")
    assert sorted(tmp_path.iterdir()) == before


def test_a_full_disk_leaves_no_half_bag(tmp_path, monkeypatch):
    write_plain(tmp_path / "run")
    os.truncate(tmp_path / "run" / "run.mcap", 40_000)

    def full(*_):
        assert not (tmp_path / "run_repaired").exists()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(mcap_repair.McapIndex, "tail", full)
    assert f"cannot be written: {os.strerror(errno.ENOSPC)}" in refusal(tmp_path / "run")
    assert list(tmp_path.iterdir()) == [tmp_path / "run"]
    monkeypatch.undo()
    assert CliRunner().invoke(main, ["repair", str(tmp_path / "run")]).output.endswith("run.mcap repaired\n")
    with Reader(tmp_path / "run_repaired") as reader:
        assert reader.message_count > 0
