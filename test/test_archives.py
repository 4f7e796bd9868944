# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Archives of arrays with false sizes take no memory, and are reported as such."""

from __future__ import annotations

import io
import pathlib
import zipfile

import numpy as np
import pytest

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import ArchiveError, BoundsError, read_array, read_arrays, read_heads, read_json
from hysteresis_ros.recordings.bag_reader import Bag
from hysteresis_ros.recordings.cdr import FLOAT64


def archive(path, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return path


def npy(array) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def test_arrays_come_back_as_numpy_reads_them(tmp_path):
    arrays = {"a": np.arange(3.0), "b": np.array("text µ"), "c": np.ones((2, 2), "i4").T, "d": np.array([1j])}
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", **arrays)
        found = read_arrays(tmp_path / "a.npz")
        assert list(found) == list(arrays)
        for name, array in arrays.items():
            assert np.array_equal(found[name], array) and found[name].dtype == array.dtype
        assert list(read_arrays(tmp_path / "a.npz", "b".__eq__)) == ["b"]
        assert {name: head.length for name, head in read_heads(tmp_path / "a.npz").items()} == {
            **{"a": 3, "b": None, "c": None, "d": None}
        }


@pytest.mark.parametrize("shape", [(10**12,), (10**6, 10**6), (-1,)])
def test_a_head_is_not_believed_without_content(shape, tmp_path):
    content = npy(np.zeros(3)).replace(b"(3,), }".ljust(len(str(shape)) + 3), f"{shape}, }}".encode())
    assert str(shape).encode() in content
    with pytest.raises(ArchiveError, match="declares an array of shape"):
        read_arrays(archive(tmp_path / "a.npz", {"a.npy": content}))
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ArchiveError, match="declares an array of shape"):
        read_array(tmp_path / "a.npy")


@pytest.mark.slow
def test_an_archive_that_unpacks_to_far_more_than_its_size_is_refused(tmp_path):
    path = archive(tmp_path / "a.npz", {"a.npy": npy(np.zeros(9 << 20))}, zipfile.ZIP_DEFLATED)
    with pytest.raises(ArchiveError, match="would unpack to 75497600 bytes"):
        read_arrays(path)


@pytest.mark.parametrize(
    "content, compression, found",
    [
        (npy(np.array([None])), zipfile.ZIP_STORED, "only numbers and texts are read"),
        (npy(np.zeros(2, "M8[s]")), zipfile.ZIP_STORED, "only numbers and texts are read"),
        (npy(np.array("a")).replace(b"a\0\0\0", b"\0\0\x11\0"), zipfile.ZIP_STORED, "invalid code points"),
        (npy(np.array("a")).replace(b"a\0\0\0", b"\0\xd8\0\0"), zipfile.ZIP_STORED, "invalid code points"),
        (npy(np.zeros(2)), zipfile.ZIP_BZIP2, "NumPy does not write"),
        (b"no array", zipfile.ZIP_STORED, "is damaged"),
    ],
)
def test_what_is_no_array_of_numbers_or_texts_is_refused(content, compression, found, tmp_path):
    with pytest.raises(ArchiveError, match=found):
        read_arrays(archive(tmp_path / "a.npz", {"a.npy": content}, compression))


def test_what_is_left_of_a_chunk_is_unpacked_within_bounds():
    import struct

    zstandard = pytest.importorskip("zstandard")
    from hysteresis_ros.recordings.bag_reader import SMALL, salvaged

    packed = zstandard.ZstdCompressor().compress(bytes(4 * SMALL))
    head = struct.pack("<QQQII", 0, 1, 4 * SMALL, 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    whole = salvaged(b"\x06" + struct.pack("<Q", len(head) + len(packed)) + head + packed[:-10])
    assert 0 < len(whole) <= SMALL


@pytest.mark.parametrize("time, data", [(None, b""), (1.5, b""), (1, 10**10), (1, "text"), (1, None)])
def test_what_is_no_message_costs_no_memory(time, data):
    with pytest.raises(RecordingError, match="a message on /voltage is invalid or has no time"):
        Bag(pathlib.Path("bag")).add("/voltage", FLOAT64, time, data)


def test_json_that_is_too_deep_is_refused():
    with pytest.raises(BoundsError, match="not readable as JSON"):
        read_json("[" * 100_000)


def test_a_file_that_is_missing_is_no_damaged_one(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_arrays(tmp_path / "a.npz")
    (tmp_path / "a.npz").write_bytes(b"")
    with pytest.raises(ArchiveError):
        read_heads(tmp_path / "a.npz")
