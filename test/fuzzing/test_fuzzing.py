# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A part of the inputs of ``run.py``, and the inputs that once revealed a fault."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from judging import Fault, Target, judged, limited
from targets import TARGETS

from hysteresis_ros.errors import RecordingError

CRASHERS = sorted((Path(__file__).parent / "crashers").glob("*/*"))
BY_FOLDER = {re.sub(r"\W+", "_", name): target for name, target in TARGETS.items()}


@pytest.mark.parametrize("name", TARGETS)
def test_every_input_is_read_or_refused_in_one_line(name, tmp_path):
    target = TARGETS[name]
    with limited():
        taken = sum(judged(target, data, tmp_path) for data in target.inputs(0, target.suite))
    # a reader that refuses or accepts every input is not tested beyond its first check
    assert taken > 0


@pytest.mark.parametrize("path", CRASHERS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_once_was_at_fault_is_not_any_more(path, tmp_path):
    with limited():
        judged(BY_FOLDER[path.parent.name], path.read_bytes(), tmp_path)


def _reader(read) -> Target:
    return Target("a reader", read, lambda: [b""], file="a.csv")


def _loops(data, folder):
    while True:
        pass


def _lies(data, folder):
    raise RecordingError("something is wrong")


def _leaves(data, folder):
    (folder / "a.csv.partial").touch()
    raise RecordingError("a.csv: cannot be read")


@pytest.mark.parametrize(
    "read, found",
    [
        (lambda data, folder: {}["a"], "KeyError"),
        (lambda data, folder: bytearray(2 << 30), "MemoryError"),
        (_loops, "longer than"),
        (_lies, "does not name the file"),
        (_leaves, "left a.csv.partial behind"),
    ],
)
def test_a_reader_with_a_fault_is_found(read, found, tmp_path, monkeypatch):
    monkeypatch.setattr("judging.LONGEST", 0.05)
    with limited(), pytest.raises(Fault, match=found):
        judged(_reader(read), b"", tmp_path)
