# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A manifest: what it says is what is read, and every mistake in it is named before anything is fitted."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from manifest_support import entry, manifest, written

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.benchmark.manifest import (
    load_manifest,
    missing_files,
    read_task,
    shipped_manifest,
)


def test_the_parts_are_the_samples_of_the_file(tmp_path):
    """The fit gets samples 0 … 199; the test leads through them to sample 200, and is judged from sample 210 on."""
    (one,) = load_manifest(manifest(tmp_path, entry(written(tmp_path))))
    task = read_task(one, tmp_path)
    assert (len(task.train), len(task.test), task.first) == (200, 390, 210)
    k = np.arange(390)
    assert task.test.input == pytest.approx(10.0 + 10.0 * np.abs((k / 50.0) % 2.0 - 1.0), abs=1e-5)
    assert np.array_equal(task.train.output, task.test.output[:200])
    assert task.stroke == pytest.approx(np.ptp(task.test.output[210:]))
    assert task.train.sample_time == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"train": None}, "train is missing: part for the fit"),
        ({"inputs": "drive_V"}, "unknown key 'inputs'"),
        ({"input": "drive_V"}, "column of the input, as name:unit"),
        ({"offset": "none"}, "offset kept or free"),
        ({"skip": -1}, "skip must be 0 or more"),
        ({"skip": "many"}, "skip = 'many'"),
        ({"test": {"file": "run.csv", "sha256": "0", "range": "9"}}, "write FIRST:LAST"),
        ({"test": {"file": "run.csv", "sha256": "0", "range": "9:3"}}, "FIRST must be 0 or more and below LAST"),
        ({"test": {"file": "run.csv"}}, "sha256 is missing"),
    ],
)
def test_a_mistake_in_a_manifest_is_named(tmp_path, changes, told):
    """File, recording, key and what is allowed."""
    path = manifest(tmp_path, entry(written(tmp_path), **changes))
    with pytest.raises(HysteresisError, match="shelf") as refused:
        load_manifest(path)
    assert told in str(refused.value) and str(path) in str(refused.value)


@pytest.mark.parametrize("content", ["recordings: {}", "a: 1", "[", "recordings: {x: 3}"])
def test_a_file_that_is_no_manifest_is_refused(tmp_path, content):
    """Also one that is not YAML."""
    (tmp_path / "m.yaml").write_text(content)
    with pytest.raises(HysteresisError, match="m.yaml"):
        load_manifest(tmp_path / "m.yaml")
    with pytest.raises(HysteresisError, match="cannot be read"):
        load_manifest(tmp_path / "none.yaml")


def test_a_test_part_that_the_fit_sees_is_refused(tmp_path):
    """Ranges of one file that overlap by a sample are refused; ranges that touch are not."""
    checksum = written(tmp_path)
    part = {"file": "run.csv", "sha256": checksum}
    load_manifest(manifest(tmp_path, entry(checksum, train={**part, "range": ":200"}, test={**part, "range": "200:"})))
    for first in ({"range": ":201"}, {}):
        overlapping = entry(checksum, train={**part, **first}, test={**part, "range": "200:"})
        with pytest.raises(HysteresisError, match="give ranges without common samples"):
            load_manifest(manifest(tmp_path, overlapping))


def test_a_changed_file_is_refused(tmp_path):
    """One digit changed: the checksum differs, and both checksums and the source are named."""
    checksum = written(tmp_path)
    (one,) = load_manifest(manifest(tmp_path, entry(checksum)))
    path = tmp_path / "run.csv"
    path.write_text(path.read_text().replace("10.000000", "10.000001", 1))
    with pytest.raises(HysteresisError, match="this is another file") as refused:
        read_task(one, tmp_path)
    assert checksum in str(refused.value) and "a shelf" in str(refused.value)
    path.unlink()
    assert missing_files(one, tmp_path) == ["run.csv"]


def test_an_input_that_never_turns_is_refused(tmp_path):
    """A rising input shows no hysteresis."""
    checksum = written(tmp_path)
    part = {"file": "run.csv", "sha256": checksum}
    (one,) = load_manifest(manifest(tmp_path, entry(checksum, train={**part, "range": "50:101"})))
    with pytest.raises(HysteresisError, match="never reverses"):
        read_task(one, tmp_path)


def test_parts_of_different_rates_are_refused(tmp_path):
    """A model is run at the sample time of its fit."""
    checksum = written(tmp_path)
    slow = "t_s,drive_V,gauge_um\n" + "\n".join(f"{2e-3 * i:.3f},{(i * 7) % 20},{(i * 7) % 20}" for i in range(100))
    (tmp_path / "slow.csv").write_text(slow + "\n")
    other = {"file": "slow.csv", "sha256": hashlib.sha256((tmp_path / "slow.csv").read_bytes()).hexdigest()}
    (one,) = load_manifest(manifest(tmp_path, entry(checksum, test=other)))
    with pytest.raises(HysteresisError, match="they must be equal"):
        read_task(one, tmp_path)


def test_the_shipped_manifest_states_source_and_licence():
    """Of each recording, with checksums of 64 hexadecimal digits."""
    entries = load_manifest(shipped_manifest())
    assert entries
    for one in entries:
        assert one.about and one.source.startswith("https://") and one.licence
        assert all(len(part.sha256) == 64 and int(part.sha256, 16) >= 0 for part in (one.train, one.test))
