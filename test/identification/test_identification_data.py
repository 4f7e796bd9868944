# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recordings as data for identification: columns with units become SI, and bad data are named before any fit."""

from __future__ import annotations

import numpy as np
import pytest

import hysteresis_ros as hr
from hysteresis_ros.errors import HysteresisError, RecordingError
from hysteresis_ros.identification.data import (
    DataError,
    IdentificationData,
    check_data,
    check_uniform,
    clipped_share,
    count_reversals,
    estimate_delay,
    from_recording,
    load_data,
)
from hysteresis_ros.identification.preprocessing import resample
from hysteresis_ros.identification.reading import Columns, read_data
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import save_run

RATE = 200.0
TIME = np.arange(1000) / RATE
VOLTAGE = 1.8 + 1.8 * np.sin(2 * np.pi * TIME)
DISPLACEMENT = 12e-6 * VOLTAGE + 1e-9 * np.random.default_rng(1).standard_normal(TIME.size)


def sine(**changes):
    return IdentificationData(**{"time": TIME, "input": VOLTAGE, "output": DISPLACEMENT, **changes})


def write(path, header, *columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.12g")
    return path


def checks(report, severity):
    return [item.check for item in report.findings if item.severity == severity]


def test_a_foreign_table_becomes_si(tmp_path):
    path = write(tmp_path / "a.csv", "t_ms,control_V,sensor,unused", 1e3 * TIME, VOLTAGE, 1e6 * DISPLACEMENT, TIME)
    data = load_data(path, input="control_V:V", output="sensor:um", time="t_ms:ms")
    assert (data.input_unit, data.output_unit, data.source) == ("V", "m", "a.csv")
    np.testing.assert_allclose(data.time, TIME, rtol=1e-12)
    np.testing.assert_allclose(data.output, DISPLACEMENT, rtol=1e-10)
    assert data.sample_time == pytest.approx(1 / RATE)
    assert data.stroke == pytest.approx(43.2e-6, rel=1e-3)


@pytest.mark.parametrize("header", ["t_s,control_V,cap_sensor_um", "time [s],drive [V],gauge [um]", "t,a (V),b (µm)"])
def test_columns_that_declare_their_units_need_not_be_chosen(tmp_path, header):
    data = load_data(write(tmp_path / "a.csv", header, TIME, VOLTAGE, 1e6 * DISPLACEMENT))
    np.testing.assert_allclose(data.input, VOLTAGE, rtol=1e-10)
    np.testing.assert_allclose(data.output, DISPLACEMENT, rtol=1e-10)


def test_tables_without_names_or_time_and_with_other_delimiters(tmp_path):
    np.savetxt(tmp_path / "a.txt", np.column_stack([VOLTAGE, 1e9 * DISPLACEMENT]), delimiter="\t")
    data = load_data(tmp_path / "a.txt", input="1:V", output="2:nm", sample_time=1 / RATE)
    np.testing.assert_allclose(data.time, TIME, atol=1e-12)
    np.testing.assert_allclose(data.output, DISPLACEMENT, rtol=1e-10)


def test_own_recordings_and_arrays_are_read_alike(tmp_path):
    run = Recording(TIME, {"voltage": VOLTAGE, "measured": DISPLACEMENT, "displacement": 0 * TIME})
    save_run(run, tmp_path / "run.npz")
    for data in (
        from_recording(run),
        load_data(tmp_path / "run.npz"),
        load_data(tmp_path / "run.npz", input="voltage:V"),
    ):
        np.testing.assert_array_equal(data.output, DISPLACEMENT)
        assert (data.input_name, data.output_name) == ("voltage", "measured")


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"input": "drive"}, ["'drive' has no unit", "drive:um"]),
        ({"input": "drive:furlong"}, ["unknown unit 'furlong'"]),
        ({"input": "nothing:V"}, ["no column 'nothing'", "gauge_um"]),
        ({"input": "drive:V", "output": "gauge_um:V"}, ["unit 'um' in its header", "not 'V'"]),
        ({}, ["the column of the input", "name:unit"]),
        ({"input": "drive:V", "output": "gauge_um", "time": "gauge_um"}, ["must be in s"]),
    ],
)
def test_what_is_unclear_is_asked_for(tmp_path, choices, words):
    path = write(tmp_path / "a.csv", "t,drive,gauge_um", TIME, VOLTAGE, 1e6 * DISPLACEMENT)
    with pytest.raises(HysteresisError) as caught:
        load_data(path, **choices)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_swapped_columns_are_refused():
    with pytest.raises(DataError, match=r"seem swapped: the voltage spans .* exchange --input and --output") as error:
        IdentificationData(TIME, DISPLACEMENT, VOLTAGE).checked()
    assert error.value.check == "swapped"
    # a wrong unit of one column is a question, not a refusal
    for input_, output in ((1e-4 * VOLTAGE, DISPLACEMENT), (VOLTAGE, 1e6 * DISPLACEMENT)):
        assert IdentificationData(TIME, input_, output).checked()[1].errors == ()


def test_a_displacement_is_not_assumed_to_be_the_voltage(tmp_path):
    path = write(tmp_path / "a.csv", "t,command_um,measured_um", TIME, 1e6 * DISPLACEMENT, 1e6 * DISPLACEMENT)
    with pytest.raises(DataError, match=r"no column is known to be a voltage, and 'command_um' is in m.*--input"):
        read_data(path)
    assert read_data(path, Columns(input="command_um")).data.input_unit == "m"


def test_missing_files_and_times_are_named(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        load_data(tmp_path / "gone.csv")
    path = write(tmp_path / "a.csv", "drive,gauge_um", VOLTAGE, 1e6 * DISPLACEMENT)
    with pytest.raises(RecordingError, match="sample time"):
        load_data(path, input="drive:V")
    with pytest.raises(DataError, match="data without units"):
        sine(output_unit="")


def test_good_data_passes_without_a_warning():
    data, report = sine().checked()
    assert len(data) == report.samples == 1000
    assert report.warnings == () and report.errors == ()
    assert report.reversals == 10
    assert report.delay == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("short", lambda: sine().part(0, 20)),
        ("constant", lambda: sine(input=0 * TIME + 3.0)),
        ("constant", lambda: sine(output=0 * TIME)),
        ("nan", lambda: sine(output=np.where(np.arange(1000) == 500, np.nan, DISPLACEMENT))),
        ("uniform", lambda: sine(time=TIME + 1e-3 * np.sin(7 * np.arange(1000)))),
        ("uniform", lambda: sine(time=TIME + (np.arange(1000) > 400) / RATE)),
    ],
)
def test_unusable_data_is_refused_by_name(name, data):
    with pytest.raises(DataError) as caught:
        data().checked()
    assert caught.value.check == name


def test_missing_samples_at_the_ends_are_left_out_and_said():
    output = DISPLACEMENT.copy()
    output[:5] = output[-3:] = np.nan
    data, _ = sine(output=output).checked()
    assert (len(data), data.first) == (992, 5)
    assert "5 samples at the start and 3 at the end" in data.notes[-1]


def test_rounded_times_are_uniform_and_lost_samples_counted():
    times = np.round(np.arange(5000) / 3000.0, 4)
    assert [item.severity for item in check_uniform(times)[2]] == ["note"]
    assert "3 samples" in check_uniform(np.delete(TIME, [10, 500, 501]))[2][0].message


def test_clipping_is_repetition_of_the_extreme_while_the_input_moves():
    clipped = np.minimum(DISPLACEMENT, 38e-6)
    report = check_data(TIME, VOLTAGE, clipped)
    assert checks(report, "warning") == ["clipping"]
    assert report.clipped_output == pytest.approx(np.mean(DISPLACEMENT >= 38e-6), abs=1e-3)
    assert checks(check_data(TIME, np.clip(VOLTAGE, 0.3, 3.3), DISPLACEMENT), "warning")[0] == "clipping"


def test_steps_holds_and_coarse_sensors_are_not_clipped():
    steps = np.repeat([0.0, 1.0, 2.0, 3.0, 2.0, 1.0], 50)
    assert clipped_share(steps) == 0.0
    assert clipped_share(2e-6 * steps, steps) == 0.0
    assert clipped_share(np.round(DISPLACEMENT / 0.2e-6) * 0.2e-6, VOLTAGE) == 0.0
    assert clipped_share(np.append(bursts(100, 80, 60), np.zeros(300))) == 0.0


@pytest.mark.parametrize("delay", [0.0, 0.012, 0.05, 0.2])
def test_delay_of_a_periodic_signal_is_found_between_the_samples(delay):
    assert estimate_delay(VOLTAGE, np.sin(2 * np.pi * (TIME - delay)), 1 / RATE) == pytest.approx(delay, abs=5e-4)


def test_an_output_ahead_of_its_input_is_suspicious():
    report = check_data(TIME, VOLTAGE, np.roll(DISPLACEMENT, -20))
    assert "delay" in checks(report, "warning")
    assert report.delay == pytest.approx(-0.1, abs=2e-3)


def test_drift_is_told_from_the_input():
    report = check_data(TIME, VOLTAGE, DISPLACEMENT + 2e-6 * TIME / TIME[-1])
    assert checks(report, "warning") == ["drift"]
    assert report.drift == pytest.approx(2e-6, rel=0.02)


def bursts(*heights: float, samples: int = 500) -> np.ndarray:
    """Bursts from 0 V to each height, after a rest."""
    one = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(samples) / samples)
    return np.concatenate([np.zeros(200), *(height * one for height in heights)])


@pytest.mark.parametrize("model", ["PrandtlIshlinskii", "BoucWen", "Preisach", "Duhem", "GeneralisedPlay"])
def test_hysteresis_is_no_drift(model):
    """Loops of all sizes, and loops whose size changes all the time: there a drift cannot be told from them."""
    rng = np.random.default_rng(1)
    for heights, known in (((100, 50, 100, 20, 80, 60, 30, 100), True), ((20, 40, 60, 80, 100, 100), False)):
        v = bursts(*heights)
        y = getattr(hr.models, model).example().simulate(v)
        stroke, time = np.ptp(y), 1e-3 * np.arange(v.size)
        y += rng.normal(0.0, 5e-4 * stroke, v.size)
        still, moving = (check_data(time, v, y + part * stroke * time / time[-1]) for part in (0.0, 0.05))
        assert "drift" not in checks(still, "warning")
        if known:
            assert "drift" in checks(moving, "warning")
            assert moving.drift == pytest.approx(0.05 * stroke, rel=0.2)
        else:
            assert np.isnan(still.drift) and np.isnan(moving.drift)


def test_reversals_of_noise_do_not_count():
    triangle = np.abs((TIME * 2) % 2 - 1)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(TIME.size)
    assert count_reversals(triangle + noise) == count_reversals(triangle) == 9


def test_resampling_bridges_gaps_and_keeps_slow_signals():
    keep = np.random.default_rng(2).random(1000) > 0.1
    keep[[0, -1]] = True
    ragged = IdentificationData(TIME[keep], VOLTAGE[keep], DISPLACEMENT[keep])
    data, report = resample(ragged).checked()
    assert report.jitter < 1e-9 and data.notes[-1] == "resampled at equal intervals of 5 ms"
    np.testing.assert_allclose(data.input, VOLTAGE, atol=1e-2)
    coarse = resample(sine(), 0.02)
    assert coarse.notes[-1] == "resampled from 5 ms to 20 ms"
    np.testing.assert_allclose(coarse.input[5:-5], VOLTAGE[::4][5:-5], atol=1e-3)
    with pytest.raises(DataError, match="sample time"):
        resample(sine(), 1e3)


def test_coarser_resampling_does_not_fold_noise_down():
    fast = sine(output=np.cos(np.pi * np.arange(1000)) * 1e-6 + DISPLACEMENT)
    kept = resample(fast, 0.02).output - DISPLACEMENT[::4]
    assert np.std(kept[10:-10]) < 0.02e-6
