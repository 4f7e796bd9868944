# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Files of loggers, scopes and spreadsheets: read, or questioned in one line with the figure."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.preprocessing import resample
from hysteresis_ros.identification.reading import Columns, read_data
from hysteresis_ros.recordings.foreign_tables import named_column
from hysteresis_ros.units import conversion, readable

RATE = 200.0
TIME = np.arange(1000) / RATE
VOLTAGE = 1.8 + 1.8 * np.sin(2 * np.pi * TIME)
DISPLACEMENT = 12e-6 * VOLTAGE


def lines(time=TIME, voltage=VOLTAGE, micrometres=1e6 * DISPLACEMENT, mark=","):
    return [mark.join(f"{value:.6f}" for value in row) for row in zip(time, voltage, micrometres, strict=True)]


def table(path, rows, header="t_s,control_V,gauge_um", encoding="utf-8"):
    path.write_bytes("\n".join([header, *rows, ""]).encode(encoding))
    return path


def agrees(data, rtol=1e-5):
    np.testing.assert_allclose(data.time, TIME, atol=1e-9)
    np.testing.assert_allclose(data.input, VOLTAGE, rtol=rtol, atol=1e-6)
    np.testing.assert_allclose(data.output, DISPLACEMENT, rtol=rtol, atol=1e-11)


def comma(rows):
    return [row.replace(".", ",") for row in rows]


@pytest.mark.parametrize(
    ("header", "rows", "encoding", "said"),
    [
        ("t_s;control_V;gauge_um", comma(lines(mark=";")), "utf-8", "decimal commas"),
        ("t_s\tcontrol_V\tgauge_um", comma(lines(mark="\t")), "utf-16", "decimal commas"),
        ("Zeit [s];Spannung [V];Weg [µm]", comma(lines(mark=";")), "latin-1", "Latin-1"),
        ("Time [sec],Drive [Volt],Sensor [microns]", lines(), "utf-8", ""),
        ("Time / s,ao0 / V,Sensor in µm", lines(), "utf-8", ""),
        ("Scope 7\nDate,2024\nRate,200\n\nt_s,control_V,gauge_um", lines(), "utf-8", "3 lines before"),
        ("t,u,y\ns,V,um", lines(), "utf-8", ""),
        (
            "LabVIEW Measurement\t\n***End_of_Header***\t\n\nX_Value\tVoltage [V]\tPosition [um]\tComment",
            lines(mark="\t"),
            "utf-8",
            "2 lines before",
        ),
        ("# made by hand\n# t_s, control_V, gauge_um", lines(mark=" "), "utf-8", ""),
        ("t_s,control_V,gauge_um,", [f"{row}," for row in lines()], "utf-8", ""),
        (",t_s,control_V,gauge_um", [f"{k},{row}" for k, row in enumerate(lines())], "utf-8", ""),
        ('"t_s","control_V","gauge_um"', [f'"{row}"'.replace(",", '","') for row in lines()], "utf-8", ""),
        ("t_s,when,control_V,gauge_um", [row.replace(",", ",12:30:01,", 1) for row in lines()], "utf-8", ""),
        (
            "t_s,control_V,ai0:10um/V",
            lines(micrometres=1e5 * DISPLACEMENT),
            "utf-8",
            "",
        ),
    ],
)
def test_tables_are_read_however_they_are_written(tmp_path, header, rows, encoding, said):
    data = read_data(table(tmp_path / "a.csv", rows, header, encoding)).data
    agrees(data, 1e-4)
    assert said in " ".join(data.notes)


def test_a_sensitivity_may_be_asked_of_a_column_in_volts(tmp_path):
    path = table(tmp_path / "a.csv", lines(micrometres=1e8 * DISPLACEMENT), "t_s,control_V,sensor_mV")
    agrees(read_data(path, Columns(output="sensor_mV:10um/V")).data, 1e-4)


@pytest.mark.parametrize(
    "content",
    [
        {"t": TIME, "control_V": VOLTAGE, "gauge_um": 1e6 * DISPLACEMENT, "Ts": 1 / RATE, "poles": TIME[:7]},
        {"run": {"time": TIME[:, None], "data": {"control_V": VOLTAGE, "gauge_um": 1e6 * DISPLACEMENT}}},
    ],
)
@pytest.mark.parametrize("compressed", [False, True])
def test_matlab_files_are_read_with_their_structures(tmp_path, content, compressed):
    scipy.io.savemat(tmp_path / "a.mat", content, do_compression=compressed)
    names = [name for name in ("gauge_um", "run.data.gauge_um") if name.split(".")[0] in content]
    time = None if "t" in content else "run.time:s"
    agrees(read_data(tmp_path / "a.mat", Columns(output=names[0], time=time)).data)


def test_columns_of_a_matrix_have_numbers(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"X": np.column_stack([TIME, VOLTAGE, 1e6 * DISPLACEMENT])})
    agrees(read_data(tmp_path / "a.mat", Columns("X_2:V", "X_3:um", "X_1:s")).data)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.mat", b"MATLAB 7.3 MAT-file" + bytes(105) + b"\0\2IM" + bytes(400), "'-v7'"),
        ("a.mat", b"no such thing" * 30, "MATLAB"),
        ("a.csv", b"\0\1\2" * 50, "not a text table"),
        ("a.csv", b"only words here\nand here\n", "not a table of numbers"),
        (
            "a.csv",
            "\n".join(["t,u_V,y_um", *[row[: -20 * (not k % 50)] or row for k, row in enumerate(lines())]]).encode(),
            "19 of 999 rows",
        ),
        ("a.csv", "\n".join(["t_s,u_V,y_um", *lines()[500:], *lines()[:500]]).encode(), "after row 499"),
        ("a.csv", "\n".join(["t_s,u_V,y_um", *lines(time=0 * TIME)]).encode(), "give the sample time"),
        (
            "a.csv",
            "\n".join(["t_s,u_V,y_um", *(row for k, row in enumerate(lines()) if k % 90 > 8)]).encode(),
            "longest gap, 0.05 s, begins at",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(HysteresisError, match=words) as caught:
        read_data(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_column_of_dates_is_no_time(tmp_path):
    rows = [f"2024-05-01T10:00:{k / 10:04.1f},{k % 7},{k % 7}" for k in range(100)]
    (tmp_path / "log.csv").write_text("time,voltage_V,measured_um\n" + "\n".join(rows))
    with pytest.raises(HysteresisError, match="time column 'time' contains no numbers, as with dates; write seconds"):
        read_data(tmp_path / "log.csv")


def test_an_empty_first_cell_costs_one_sample_and_no_header(tmp_path):
    for header in ("t_s,control_V,gauge_um", None):
        rows = ["," + lines()[0].split(",", 1)[1], *lines()[1:]]
        path = tmp_path / "a.csv"
        path.write_text("\n".join(rows if header is None else [header, *rows]))
        columns = Columns("2:V", "3:um", "1:s") if header is None else Columns()
        reading = read_data(path, columns)
        assert len(reading.data) == 999 and reading.data.time[0] == pytest.approx(0.005)
        assert "1 rows without a time omitted" in reading.report.warnings[0]


def test_damaged_rows_and_texts_in_cells_are_counted(tmp_path):
    rows = lines()
    rows[400], rows[401] = "2.0,OVER,12.0", rows[401][:6]
    path = table(tmp_path / "a.csv", rows)
    warnings = read_data(path).report.warnings
    assert "1 damaged rows, the first in line 403" in warnings[0]
    assert any("1 gaps (2 samples) interpolated" in text for text in warnings)


def test_rows_written_twice_are_left_out_and_rounded_instants_are_spread(tmp_path):
    rows = lines()
    path = table(tmp_path / "a.csv", rows[:300] + rows[299:700] + [rows[700].replace(",", ",9", 1)] + rows[700:])
    reading = read_data(path)
    assert len(reading.data) == 1000
    assert "1 rows that repeat the previous one and 1 rows with the time" in reading.report.warnings[0]
    assert "the first at 1.495 s (row 300)" in reading.report.warnings[0]
    reading = read_data(table(tmp_path / "b.csv", lines(time=np.round(TIME, 2))))
    np.testing.assert_allclose(reading.data.time, TIME, atol=0.011)
    assert "time is rounded to 10 ms" in reading.data.notes[0] and reading.report.jitter < 1e-9


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"micrometres": 1e9 * DISPLACEMENT}, "moves by 43.2 mm, 12 mm/V: is its unit um instead of mm"),
        ({"micrometres": 1e3 * DISPLACEMENT}, "um instead of nm"),
        ({"voltage": 1e-3 * VOLTAGE}, "spans 3.6 mV: is its unit V instead of mV"),
        ({"voltage": 1e3 * VOLTAGE}, "spans 3600 V: is its unit mV instead of V"),
        ({"time": 1e3 * TIME}, "5 s apart and a cycle takes 999 s: is the unit of time ms instead of s"),
        ({"time": 1e-3 * TIME}, "within 4.995 ms: is the unit of time s instead of ms"),
    ],
)
def test_units_that_make_no_sense_are_asked_about(changes, words):
    columns = {"time": TIME, "voltage": VOLTAGE, "micrometres": 1e6 * DISPLACEMENT, **changes}
    reading = read_data(IdentificationData(columns["time"], columns["voltage"], 1e-6 * columns["micrometres"]))
    asked = [item.message for item in reading.report.findings if item.check == "unit"]
    if changes.get("micrometres") is not None and changes["micrometres"][0] < 1.0:
        assert asked == []  # 43 nm at 3.6 V: plausible for a small stack
    else:
        assert any(words in text for text in asked), asked
    if changes.get("voltage") is not None and changes["voltage"][0] < 1.0:
        assert any("12 mm/V" in text for text in asked), "no actuator has this gain"


def test_too_few_samples_a_cycle_are_warned_of():
    def warned(each):
        sine = 1.8 + 1.8 * np.sin(2 * np.pi * np.arange(1000) / each + 0.1)
        return [
            text for text in read_data(IdentificationData(TIME, sine, 1e-5 * sine)).report.warnings if "cycle" in text
        ]

    assert "7.99 samples per cycle" in warned(8.0)[0] and "3.8 % of its range" in warned(8.0)[0]
    assert warned(25.0) == []


def test_a_gap_that_is_bridged_is_warned_of_with_its_length():
    kept = np.ones(1000, dtype=bool)
    kept[300:600] = False
    data = resample(IdentificationData(TIME[kept], VOLTAGE[kept], DISPLACEMENT[kept]))
    assert "1 gaps (300 samples) interpolated linearly, the longest 1.505 s at 1.495 s" in data.warnings[0]
    assert "longest part without a gap: --range 300:700" in data.warnings[0]
    assert resample(IdentificationData(TIME, VOLTAGE, DISPLACEMENT)).warnings == ()


def gappy(*missing) -> IdentificationData:
    kept = np.ones(1000, dtype=bool)
    for first, count in missing:
        kept[first : first + count] = False
    return IdentificationData(TIME[kept], VOLTAGE[kept], DISPLACEMENT[kept])


def test_short_gaps_are_bridged_and_of_long_ones_the_longest_part_is_taken():
    short = read_data(gappy((100, 1), (700, 3)))
    assert len(short.data) == 1000 and "2 gaps (4 samples) interpolated" in short.report.warnings[0]
    there = [99, 101, 699, 703]
    np.testing.assert_allclose(short.data.output[there], DISPLACEMENT[there], rtol=1e-9)
    long = read_data(gappy((100, 1), (300, 40)))
    assert long.data.first == 299 and len(long.data) == 660
    np.testing.assert_array_equal(long.data.input, VOLTAGE[340:])
    assert "2 gaps, the longest 0.205 s at 1.495 s" in long.report.warnings[0]
    assert "samples 299 to 958 (69 %)" in long.report.warnings[0]
    asked = read_data(gappy((300, 40)), Columns(resample="auto"))
    assert len(asked.data) == 1000 and "interpolated" in asked.report.warnings[0]
    with pytest.raises(HysteresisError, match="not uniformly sampled"):
        read_data(gappy(*((start, 9) for start in range(50, 1000, 90))))


def test_a_sample_that_is_missing_is_a_gap():
    spoilt = DISPLACEMENT.copy()
    spoilt[500] = np.nan
    found = read_data(IdentificationData(TIME, VOLTAGE, spoilt))
    assert len(found.data) == 1000 and "1 gaps (1 samples) interpolated" in found.report.warnings[0]
    assert np.all(np.isfinite(found.data.output))


def test_stamps_that_jitter_are_told_from_samples_that_do():
    late = TIME + np.random.default_rng(5).uniform(-2e-3, 2e-3, TIME.size)
    noise = np.random.default_rng(6).standard_normal((2, TIME.size))
    steady = read_data(IdentificationData(late, VOLTAGE + 5e-3 * noise[0], DISPLACEMENT + 20e-9 * noise[1]))
    assert "stamps jitter by up to 2" in steady.report.warnings[0] and steady.report.jitter < 1e-9
    voltage = 1.8 + 1.8 * np.sin(2 * np.pi * late)
    with pytest.raises(HysteresisError, match="not uniformly sampled"):
        read_data(IdentificationData(late, voltage, 12e-6 * voltage))
    resampled = read_data(IdentificationData(late, voltage, 12e-6 * voltage), Columns(resample="auto"))
    assert "samples jitter by" in resampled.report.warnings[0] and "at 5" in resampled.report.warnings[0]
    np.testing.assert_allclose(resampled.data.input, 1.8 + 1.8 * np.sin(2 * np.pi * resampled.data.time), atol=5e-3)


def test_stamps_out_of_order_are_put_on_a_grid(tmp_path):
    jitter = np.random.default_rng(5).uniform(-4e-3, 4e-3, TIME.size) * (TIME > 0.01) * (TIME < 4.98)
    reading = read_data(table(tmp_path / "a.csv", lines(time=TIME + jitter)))
    assert "time goes back" in reading.report.warnings[0] and "assumed to be uniform" in reading.report.warnings[0]
    agrees(reading.data)


def test_units_of_all_spellings_and_numbers_for_people():
    assert conversion("Volts") == conversion("V") == ("V", 1.0)
    assert conversion("10um/V") == ("m", pytest.approx(1e5)) and conversion("2 nm/mV") == ("m", pytest.approx(5e5))
    assert conversion("furlong") is None and conversion("um/h") is None
    assert conversion("um/s") == ("m/s", 1e6) and conversion("nm/s") == ("m/s", 1e9)
    assert named_column("ai0:10um/V") == ("ai0", "10um/V") and named_column("Position (µm)") == ("Position", "µm")
    assert [readable(value, "m") for value in (2.1484e-7, 4.32e-2, 3.3e-10)] == ["0.2148 µm", "43.2 mm", "0.33 nm"]
    assert [readable(value, "s") for value in (0.0175, 2e-5, 3.0)] == ["17.5 ms", "20 µs", "3 s"]
