# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Waveforms from files: units, sample time, and messages for wrong files."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.references import Waveform, WaveformParameters

VALUES = np.array([0.0, 1e-6, 3e-6, 2e-6])


def waveform(path, sample_time=1e-3, **own):
    mapping = {"type": "file", "file.path": str(path), **own}
    return Waveform(WaveformParameters.from_mapping(mapping), sample_time)


def csv(tmp_path, text):
    path = tmp_path / "trajectory.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "factor"), [("reference [m]", 1.0), ("reference (µm)", 1e6), ("reference_um", 1e6), ("reference_m", 1.0)]
)
def test_csv_in_the_unit_of_its_header(tmp_path, header, factor):
    rows = "\n".join(f"{k * 1e-3},{value * factor}" for k, value in enumerate(VALUES))
    w = waveform(csv(tmp_path, f"# made by hand\ntime [s],{header}\n{rows}\n"))
    assert w.simulate(np.zeros(8)) == pytest.approx(np.tile(VALUES, 2), abs=1e-20)
    assert w.period == 4


def test_npz_and_npy(tmp_path):
    np.savez(tmp_path / "a.npz", reference=VALUES, time=np.arange(4) * 1e-3)
    np.save(tmp_path / "a.npy", VALUES)
    expected = 1e-6 + np.append(VALUES, np.full(3, VALUES[-1]))
    for w in (
        waveform(tmp_path / "a.npz", cycles=1, offset=1e-6),
        waveform(tmp_path / "a.npy", cycles=1, offset=1e-6, **{"file.sample_time": 1e-3}),
    ):
        assert np.array_equal(w.simulate(np.zeros(7)), expected)


def test_interpolation_is_linear_and_asked_for(tmp_path):
    rows = "\n".join(f"{k * 1e-2},{value}" for k, value in enumerate(VALUES))
    path = csv(tmp_path, f"time [s],reference [m]\n{rows}\n")
    with pytest.raises(ParameterError, match=r"waveform\.file\.sample_time.*0\.01 s.*0\.001 s"):
        waveform(path)
    w = waveform(path, **{"file.sample_time": 1e-2})
    t = np.arange(31) * 1e-3
    assert w.simulate(np.zeros(31)) == pytest.approx(np.interp(t, np.arange(4) * 1e-2, VALUES), abs=1e-18)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("time [s],reference\n0,0\n", "unit"),
        ("time [s],position [m]\n0,0\n", "no such column.*position"),
        ("time,reference [m]\n0,0\n", "time"),
        ("time [s],reference [m]\n0,0\n0.001,nan\n", "sample 1 is nan"),
        ("time [s],reference [m]\n0,0\n0.001,abc\n", "abc"),
        ("time [s],reference [m]\n0,0\n0.001\n", "data row 1"),
        ("time [s],reference [m]\n0,0\n0.001,1\n0.005,1\n", "equal steps"),
        ("time [s],reference [m]\n", "samples"),
        ("reference [m]\n0\n1\n", "does not state its sample time"),
        ("", "no such column"),
    ],
)
def test_wrong_csv_says_what_is_wrong(tmp_path, text, match):
    with pytest.raises(ParameterError, match=match):
        waveform(csv(tmp_path, text))


def test_missing_damaged_and_unknown_files_are_named(tmp_path):
    with pytest.raises(ParameterError, match=r"waveform\.file\.path = .*nowhere\.csv.*no such file"):
        waveform(tmp_path / "nowhere.csv")
    for name in ("damaged.npz", "damaged.npy", "what.txt"):
        (tmp_path / name).write_bytes(b"PK\x03\x04 not an archive")
        with pytest.raises(ParameterError, match=r"waveform\.file\.path"):
            waveform(tmp_path / name)
