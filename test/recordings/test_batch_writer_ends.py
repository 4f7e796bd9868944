# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Samples written in batches, with an irregular end: a truncated file, a full disk, a kill."""

from __future__ import annotations

import errno
import os
import pathlib
import signal
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples_support import ACTUATOR, BEGIN, MOTOR, make_samples, topics_of, write_batches

from hysteresis_ros import signals
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.align import align, read_recording
from hysteresis_ros.recordings.bag_reader import read_bag
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.run_bag import SampleWriter


@settings(max_examples=40)
@given(data=st.data())
def test_a_file_cut_anywhere_gives_all_whole_messages(cut_source, tmp_path_factory, data):
    content, whole = cut_source
    size = data.draw(st.integers(0, len(content) - 1))
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    path.write_bytes(content[:size])
    bag = read_bag(path)
    counts = [len(topic.data) for topic in bag.topics.values()]
    for name, topic in bag.topics.items():
        assert topic.data == whole[name][1][: len(topic.data)]
    if counts:
        assert max(counts) - min(counts) <= 1
        align(bag)


@pytest.fixture(scope="module")
def cut_source(tmp_path_factory):
    """The bytes of a file of several chunks, and its topics."""
    path = tmp_path_factory.mktemp("source") / "bag"
    with BagWriter(path) as bag:
        write_batches(SampleWriter(bag, ACTUATOR, block_bytes=30_000), make_samples(ACTUATOR, 120))
    return (path / "bag.mcap").read_bytes(), topics_of(path)


@pytest.mark.slow
@settings(max_examples=40)
@given(room=st.integers(0, 400_000))
def test_a_full_disk_is_named_and_what_is_written_stays_readable(tmp_path_factory, room):
    """The file can hold ``room`` bytes; a record that does not fit is removed."""
    folder = tmp_path_factory.mktemp("full")
    stamps, table, joints = make_samples(MOTOR, 150)
    failed = None
    with pytest.MonkeyPatch.context() as patch:
        bag = BagWriter(folder / "bag")
        writer = SampleWriter(bag, MOTOR, block_bytes=25_000)
        file = bag._writer.storage.bio
        patch.setattr(os, "writev", limited(os.writev, room))
        try:
            for k in range(0, 150, 10):
                bag.write_float64("/note", float(k), int(stamps[k]))
                writer.write(stamps[k : k + 10], table[:, k : k + 10], joints=joints[:, k : k + 10])
        except RecordingError as error:
            failed = str(error)
            with pytest.raises(RecordingError) as again:
                bag.write_float64("/note", 0.0, BEGIN)
            assert str(again.value) == failed
        try:
            bag.close()
        except RecordingError as error:
            failed = failed or str(error)
    assert bag.closed and file.closed
    if failed:
        assert str(folder / "bag") in failed and os.strerror(errno.ENOSPC) in failed
    else:
        assert len(read_bag(folder / "bag")) == 150 * len(writer.topics) + 15
    back = read_bag(folder / "bag")
    counts = {name: len(topic.data) for name, topic in back.topics.items() if name != "/note"}
    assert len(set(counts.values())) <= 1
    if room > 100_000:
        recorded = align(back)
        np.testing.assert_array_equal(recorded["command"], table[signals.COMMAND, : len(recorded)])
        assert (folder / "bag" / "bag.mcap").stat().st_size <= 200 + room


def limited(writev, room):
    """Return a writev for a disk with ``room`` free bytes."""

    def write(file, pieces):
        left = room - os.fstat(file).st_size
        if left <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return writev(file, [b"".join(bytes(piece) for piece in pieces)[:left]])

    return write


def test_a_system_that_takes_a_little_at_a_time_gets_everything(tmp_path, monkeypatch):
    samples = make_samples(MOTOR, 40)
    with BagWriter(tmp_path / "whole") as bag:
        write_batches(SampleWriter(bag, MOTOR, block_bytes=30_000), samples)
    writev = os.writev
    monkeypatch.setattr(os, "writev", lambda file, pieces: writev(file, [b"".join(map(bytes, pieces))[:777]]))
    with BagWriter(tmp_path / "piece_by_piece") as bag:
        write_batches(SampleWriter(bag, MOTOR, block_bytes=30_000), samples)
    assert topics_of(tmp_path / "whole") == topics_of(tmp_path / "piece_by_piece")


FULL = """
import resource, sys
import numpy as np
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.run_bag import AxisTopics, SampleWriter
from hysteresis_ros.signals import ACTUATOR_ROW
resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))
bag = BagWriter(sys.argv[1])
writer = SampleWriter(bag, AxisTopics())
table = np.zeros((ACTUATOR_ROW, 500))
try:
    for k in range(1000):
        writer.write(np.arange(500 * k, 500 * (k + 1)) * 1_000_000, table)
except RecordingError as error:
    print(error)
bag.close()
"""


@pytest.mark.slow
def test_a_file_that_may_not_grow_is_closed_with_what_it_has(tmp_path):
    answer = run_child(FULL, tmp_path / "bag")
    assert answer.stdout.strip() == f"{tmp_path / 'bag'}: cannot be written: {os.strerror(errno.EFBIG)}"
    back = read_recording(tmp_path / "bag")
    assert back.metadata["complete"] and back.metadata["missing_samples"] == 0
    assert (tmp_path / "bag" / "bag.mcap").stat().st_size > 2_000_000


KILLED = """
import signal, sys, time
import numpy as np
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.run_bag import AxisTopics, SampleWriter
from hysteresis_ros.signals import ACTUATOR_ROW
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])
bag = BagWriter(sys.argv[1])
writer = SampleWriter(bag, AxisTopics(sample_rate=1000.0), block_bytes=10**9)
signal.setitimer(signal.ITIMER_REAL, 0.02, 0.02)  # what samples come in
begin, count = time.monotonic(), 0
while True:
    until = int((time.monotonic() - begin) * 1000.0) + 1
    writer.write(np.arange(count, until) * 1_000_000, np.zeros((ACTUATOR_ROW, until - count)))
    count = until
    print(count, time.monotonic(), flush=True)
    signal.sigwait([signal.SIGALRM])
"""


@pytest.mark.slow
def test_a_kill_loses_at_most_the_last_half_second(tmp_path):
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path / "bag")], env=environment(), stdout=subprocess.PIPE, text=True
    )
    with child:
        reports = [child.stdout.readline().split() for _ in range(60)]
        child.send_signal(signal.SIGKILL)
        reports += [line.split() for line in child.stdout]
    reports = [(int(report[0]), float(report[1])) for report in reports if len(report) == 2]
    assert reports[-1][1] - reports[0][1] > 1.0
    back = read_recording(tmp_path / "bag")
    assert not back.metadata["complete"] and back.metadata["missing_samples"] == 0
    assert len(back) >= max(count for count, when in reports if when <= reports[-1][1] - 0.5)


def run_child(program, *arguments):
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)


def environment():
    root = str(pathlib.Path(signals.__file__).parents[1])
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))}
