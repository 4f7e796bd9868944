# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The dataset type and its tables: data are preserved bit for bit, and errors are named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings import COLUMNS, Recording, load_run, save_run
from hysteresis_ros.recordings.dataset import requests_per_sample

FLOATS = arrays(np.float64, 5, elements=st.floats(allow_nan=True, allow_infinity=True, width=64))


def run(**columns):
    time = np.arange(5) / 3000.0
    return Recording.from_columns({"time": time, **columns}, {"configuration": "/**: {}", "notes": ["µ"]})


def same_bits(a, b):
    return a.tobytes() == b.tobytes() or np.array_equal(a, b, equal_nan=True)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".npz"])
@settings(max_examples=40)
@given(voltage=FLOATS, displacement=FLOATS)
def test_every_float_survives_a_table(tmp_path_factory, suffix, voltage, displacement):
    path = tmp_path_factory.mktemp("table") / f"run{suffix}"
    original = run(voltage=voltage, displacement=displacement)
    save_run(original, path)
    back = load_run(path)
    assert list(back.signals) == ["voltage", "displacement"]
    assert back.units == {"voltage": "V", "displacement": "m"}
    for name in ("time", "voltage", "displacement"):
        assert same_bits(back[name], original[name]), name


def test_npz_keeps_metadata_and_opens_without_this_package(tmp_path):
    original = run(displacement=np.linspace(0.0, 1e-6, 5))
    save_run(original, tmp_path / "run.npz")
    assert load_run(tmp_path / "run.npz").metadata == original.metadata
    with np.load(tmp_path / "run.npz") as archive:
        assert np.array_equal(archive["displacement"], original["displacement"])


def test_csv_header_says_the_units(tmp_path):
    save_run(run(displacement=np.zeros(5), voltage=np.ones(5)), tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text().splitlines()[0] == "time [s],displacement [m],voltage [V]"


def test_micrometres_and_milliseconds_become_si(tmp_path):
    path = tmp_path / "scope.csv"
    path.write_text(
        "# oscilloscope\ntime [ms], displacement [µm],\tvoltage [mV]\n0,1,500\n1,2.5,1000\n", encoding="utf-8"
    )
    recording = load_run(path)
    assert recording.time.tolist() == [0.0, 1e-3]
    assert recording["displacement"].tolist() == [1e-6, 2.5e-6]
    assert recording["voltage"].tolist() == [0.5, 1.0]


def test_units_may_be_the_ends_of_the_names(tmp_path):
    path = tmp_path / "scope.csv"
    path.write_text("time_ms,voltage_V,measured_um\n0,1,500\n1,2.5,1000\n", encoding="utf-8")
    recording = load_run(path)
    assert recording.time.tolist() == [0.0, 1e-3] and recording.units == {"voltage": "V", "measured": "m"}
    np.testing.assert_allclose(recording["measured"], [5e-4, 1e-3], rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "has no unit"),
        ("time,displacement\n0,1\n", "column 'time' has no unit in the header; write it like 'time [s]'"),
        ("t,displacement\n0,1\n", "column 't' has no unit in the header; write it like 't [s]'"),
        ("displacement [m]\n1\n", "no column 'time'"),
        ("time [s],voltage [m]\n0,1\n", "must be in 'V'"),
        ("time [s],voltage [V]\n0,abc\n", "not a table of numbers"),
        ("time [s],voltage [V]\n0\n", "rows have 1 numbers, but the header has 2"),
        ("time [s],voltage [V]\n0,1\n0,2\n", "time[1] = 0.0 s does not come after time[0] = 0.0 s; time must increase"),
        ("time [s],voltage [V],voltage [V]\n0,1,2\n", "more than once"),
        ("time [s],voltage [V]\nnan,1\n", "not finite"),
    ],
)
def test_a_wrong_csv_is_named(tmp_path, text, says):
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=says.replace("[", r"\[").replace("]", r"\]")) as caught:
        load_run(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 broken"])
def test_a_wrong_npz_is_named(tmp_path, content):
    (tmp_path / "wrong.npz").write_bytes(content)
    with pytest.raises(RecordingError, match="not a readable NPZ"):
        load_run(tmp_path / "wrong.npz")


@pytest.mark.parametrize("cut", [1, 40, 200, 500, -30, -1])
def test_a_cut_npz_is_named(tmp_path, cut):
    save_run(run(displacement=np.zeros(5)), tmp_path / "run.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "run.npz").read_bytes()[:cut])
    with pytest.raises(RecordingError, match="NPZ"):
        load_run(tmp_path / "cut.npz")


@pytest.mark.parametrize("name", ["none.npz", "none.csv", "none.mcap", "none"])
def test_a_missing_file_is_named(tmp_path, name):
    with pytest.raises(RecordingError, match="no such file"):
        load_run(tmp_path / name)


def test_a_failed_write_leaves_no_file(tmp_path):
    with pytest.raises(RecordingError, match="cannot be written"):
        save_run(run(voltage=np.zeros(5)), tmp_path / "absent" / "run.csv")
    with pytest.raises(RecordingError, match=r"write \.npz, \.csv or \.mcap"):
        save_run(run(voltage=np.zeros(5)), tmp_path / "run.xlsx")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((np.arange(3.0), {"voltage": np.zeros(2)}), "2 samples and time has 3"),
        ((np.arange(3.0), {"voltage": np.zeros((3, 1))}), "one-dimensional"),
        ((np.arange(3.0), {"voltage": ["a", "b", "c"]}), "must consist of real numbers"),
        ((np.arange(3.0), {"current": np.zeros(3)}), "has no unit"),
        ((np.arange(3.0), {"voltage": np.zeros(3)}, {"voltage": "mV"}), "must be in 'V'"),
        ((np.arange(3.0), {"voltage": np.zeros(3)}, {"force": "N"}), "not a signal of the recording"),
        ((np.array([0.0, 1.0, 1.0]), {}), "increase strictly"),
    ],
)
def test_a_wrong_recording_is_refused(arguments, says):
    with pytest.raises(RecordingError, match=says):
        Recording(*arguments)


def test_an_unknown_signal_is_named_with_those_there_are():
    recording = run(voltage=np.zeros(5))
    with pytest.raises(RecordingError, match="no signal 'force'; it has time, voltage"):
        recording["force"]
    assert list(recording.run_columns()) == ["time", *COLUMNS]
    assert np.all(np.isnan(recording.run_columns()["displacement"]))


@pytest.mark.slow
def test_the_sample_time_holds_over_a_million_stamps_of_whole_nanoseconds():
    time = np.array([round(k * 1e9 / 3000.0) for k in range(1_000_000)]) / 1e9
    gaps = np.delete(time, [5, 6, 7, 400_000])
    for stamps in (time, gaps):
        run = Recording(stamps, {"reference": np.zeros(stamps.size)})
        assert run.sample_time == pytest.approx(1.0 / 3000.0, rel=1e-9)


def test_in_missing_samples_a_motor_is_asked_for_nothing():
    """Samples 3 and 4 are missing: no request, and no speed, which would stop the motor if it were 0."""
    time, speed = np.array([0.0, 1.0, 2.0, 5.0]) * 1e-3, [np.nan, 2e-6, np.nan, 1e-6]
    run = Recording(time, {"request": np.array([0.0, 1.0, np.nan, 2.0]), "speed": np.array(speed)}, {}, {})
    found = requests_per_sample(run)
    np.testing.assert_array_equal(found["requests"], [0.0, 1.0, 0.0, 0.0, 0.0, 2.0])
    np.testing.assert_array_equal(found["speeds"], [np.nan, 2e-6, np.nan, np.nan, np.nan, 1e-6])
    assert requests_per_sample(Recording(time, {"request": np.zeros(4)}, {}, {})) == {}
