# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Files are written completely or not at all: an old file is replaced only by a complete new one."""

from __future__ import annotations

import os

import pytest

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import replacing, write_text


def test_a_file_takes_the_place_of_another_and_nothing_is_left_beside_it(tmp_path):
    path = tmp_path / "found.yaml"
    path.write_text("old")
    write_text(path, "µm", RecordingError)
    assert path.read_bytes() == "µm".encode() and os.listdir(tmp_path) == ["found.yaml"]


@pytest.mark.parametrize(
    ("failure", "seen"), [(OSError(28, "No space left on device"), RecordingError), (KeyError("cell"), KeyError)]
)
def test_what_fails_half_way_leaves_what_was_there(tmp_path, failure, seen):
    path = tmp_path / "found.yaml"
    path.write_text("old")
    with pytest.raises(seen) as raised, replacing(path, RecordingError) as beside:
        beside.write_text("half of it")
        assert path.read_text() == "old"
        raise failure
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["found.yaml"]
    if seen is RecordingError:
        assert str(raised.value) == f"{path}: cannot be written: No space left on device; choose another place"


def test_a_place_that_is_none_is_named_with_what_to_do(tmp_path):
    path = tmp_path / "nowhere" / "found.yaml"
    missing = pytest.raises(RecordingError, match=r"found.yaml: cannot be written: No such file .*; make the folder")
    with missing, replacing(path, RecordingError, "make the folder") as beside:
        beside.write_text("")
    (tmp_path / "folder").mkdir()
    with pytest.raises(RecordingError, match="folder: cannot be written: Is a directory"):
        write_text(tmp_path / "folder", "", RecordingError)
    assert os.listdir(tmp_path) == ["folder"]
