# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The emulated GCS controller: its commands follow the manuals, and no input makes it fail."""

from __future__ import annotations

import numpy as np
import pytest
from gcs_support import CYCLE, Bench
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.hardware.drivers.gcs import (
    BUSY,
    GENERATOR_RUNS,
    NO_WAVE,
    OUT_OF_RANGE,
    POSITION_LIMIT,
    READ_ONLY,
    SERVO_OFF,
    SERVO_ON,
    STOPPED,
    SYNTAX,
    TOO_LONG,
    UNKNOWN_COMMAND,
    UNKNOWN_PARAMETER,
    VOLTAGE_LIMIT,
    WAVE_LENGTH,
    WAVE_TYPE,
    WRONG_AXIS,
    WRONG_COUNT,
    meaning,
)
from hysteresis_ros.laboratory.emulation.gcs import COMMANDS


@pytest.fixture(scope="module")
def shared():
    return Bench("E-727")


words = st.sampled_from(
    [*COMMANDS, "1", "2", "9", "0", "-1", "1e400", "nan", "X", "&", "SIN_P", "PNT", "0x7000000", "=", "?"]
)


@pytest.mark.slow
@settings(max_examples=300)
@given(data=st.one_of(st.binary(max_size=60), st.lists(words, max_size=9).map(lambda w: " ".join(w).encode() + b"\n")))
def test_whatever_comes_is_answered_or_an_error_and_the_next_question_is_answered(shared, data):
    shared.raw(data)
    shared.now += CYCLE
    # the end of an incomplete line, and its error
    shared.raw(b"\n")
    shared.ask("ERR?")
    assert shared.ask("ERR?") == "0"
    assert shared.ask("POS? 1").startswith("1=")


@pytest.mark.slow
@settings(max_examples=50)
@given(cuts=st.lists(st.integers(0, 60), max_size=6))
def test_how_the_bytes_are_cut_into_packets_does_not_matter(cuts):
    text = b"SVA 1 20\nSVA?\r\n*IDN?\n\x05\x09SVO? 1\nFOO\nERR?\nSAI?\n"
    bench, places = Bench(), sorted({min(cut, len(text)) for cut in cuts} | {0, len(text)})
    said = "".join(bench.raw(text[a:b]) for a, b in zip(places[:-1], places[1:], strict=True))
    assert said == Bench().raw(text) == f"1=20.000000\n{bench.controller.model.identification}\n0\n0\n1=0\n2\n1\n"


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("FOO", UNKNOWN_COMMAND),
        ("SVA", WRONG_COUNT),
        ("SVA 1", WRONG_COUNT),
        ("SVA 2 1", WRONG_AXIS),
        ("POS? 7", WRONG_AXIS),
        ("SVA 1 ten", SYNTAX),
        ("SVA 1 nan", SYNTAX),
        ("SVA 1 130.1", VOLTAGE_LIMIT),
        ("SVA 1 -31", VOLTAGE_LIMIT),
        ("MOV 1 10", SERVO_OFF),
        ("SVO 1 2", OUT_OF_RANGE),
        ("SVO 1 1\nSVA 1 10", SERVO_ON),
        ("SVO 1 1\nMOV 1 1000", POSITION_LIMIT),
        ("STP", STOPPED),
        ("HLT 1", STOPPED),
        ("\x18", STOPPED),
        ("SPA? 1 1", UNKNOWN_PARAMETER),
        ("SPA 1 0x07000000 3", READ_ONLY),
        ("WGO 1 1", NO_WAVE),
        ("WAV 1 X FOO 1 2 3", WAVE_TYPE),
        ("WAV 1 X LIN 1 2 3", WRONG_COUNT),
        ("WAV 1 X LIN 1e9 1 1 1e9 0 0", WAVE_LENGTH),
        ("WAV 1 X PNT 1 3 0 0", WRONG_COUNT),
        ("WAV 1 X PNT 1 2 0 1\nWSL 1 1\nWGO 1 1\nSVA 1 3", GENERATOR_RUNS),
        ("WAV 1 X PNT 1 1 200\nWSL 1 1\nWGO 1 1", VOLTAGE_LIMIT),
        ("SVA 1 " + "1" * 5000, TOO_LONG),
    ],
)
def test_what_cannot_be_done_is_an_error_that_is_told_once(command, code):
    bench = Bench()
    before = bench.number("SVA? 1")
    assert bench.ask(command) == ""
    assert bench.error() == code and bench.error() == 0
    assert bench.number("SVA? 1") == before and meaning(code).startswith(f"error {code}: ")


@pytest.mark.parametrize(("model", "inputs"), [("E-709", 2), ("E-727", 7), ("E-754", 3)])
def test_input_signals_are_those_of_the_axes_and_others_that_measure_nothing(model, inputs):
    bench = Bench(model)
    bench.ask("SVA 1 50")
    bench.wait(0.3)
    values = [float(line.partition("=")[2]) for line in bench.ask("TSP?").split(" \n")]
    assert len(values) == inputs and values[0] == bench.number("POS? 1") and values[-1] == 0.0
    assert bench.ask(f"TAD? {inputs + 1}") == "" and bench.error() == OUT_OF_RANGE


def test_open_loop_it_moves_along_the_loop_of_its_stage():
    bench = Bench()
    seen = []
    for voltage in (0.0, 50.0, 100.0, 50.0, 0.0):
        bench.ask(f"SVA 1 {voltage}")
        bench.wait(0.3)
        assert bench.number("VOL? 1") == voltage == bench.number("SVA? 1")
        seen.append(bench.number("POS? 1"))
    # µm; on the way back the position is above that of the way up
    assert seen[0] == pytest.approx(0.0, abs=0.01) and 70.0 < seen[2] < 80.0
    assert 5.0 < seen[3] - seen[1] < 15.0 and seen[4] > 2.0


def test_with_the_servo_on_it_goes_where_it_is_told_and_says_when_it_is_there():
    bench = Bench()
    bench.ask("SVA 1 40")
    bench.wait(0.3)
    there, voltage = bench.number("POS? 1"), bench.number("VOL? 1")
    assert bench.ask("ONT? 1") == "1=0"
    bench.ask("SVO 1 1")
    bench.wait(0.1)
    # it stays where it is
    assert bench.number("MOV? 1") == pytest.approx(there, abs=0.05)
    assert bench.number("VOL? 1") == pytest.approx(voltage, abs=0.5)
    bench.ask("MOV 1 60")
    bench.wait(0.01)
    assert bench.ask("ONT? 1") == "1=0" and bench.raw(b"\x05") == "1\n"
    bench.wait(1.0)
    assert bench.ask("ONT? 1") == "1=1" and bench.raw(b"\x05") == "0\n"
    assert bench.number("POS? 1") == pytest.approx(60.0, abs=0.02)
    held = bench.number("VOL? 1")
    bench.ask("SVO 1 0")
    bench.wait(0.1)
    assert bench.number("VOL? 1") == pytest.approx(held, abs=0.5), "the position was not held"


def test_in_millimetres_it_is_at_the_same_place():
    bench = Bench()
    bench.ask("SVA 1 50")
    bench.wait(0.3)
    before, most = bench.number("POS? 1"), bench.number("TMX? 1")
    bench.ask("SPA 1 0x07000601 MM")
    assert bench.ask("PUN? 1") == "1=MM" and bench.error() == 0
    assert bench.number("POS? 1") == pytest.approx(1e-3 * before, abs=2e-5)
    assert bench.number("TMX? 1") == pytest.approx(1e-3 * most)


def test_in_millimetres_it_is_on_target_as_near_to_it_as_before():
    """20 nm; on the way of 20 µm at 1 mm/s it is not there after a half."""
    bench = Bench()
    bench.ask("SVA 1 40")
    bench.wait(0.3)
    bench.ask("SPA 1 0x07000601 MM")
    bench.ask("SVO 1 1")
    bench.ask(f"MOV 1 {bench.number('POS? 1') + 0.02:.6f}")
    bench.wait(0.01)
    assert bench.ask("ONT? 1") == "1=0"
    bench.wait(1.0)
    assert bench.ask("ONT? 1") == "1=1" and bench.number("SPA? 1 0x07000900") == pytest.approx(2e-5)


def test_each_recording_begins_with_the_first_point_whatever_was_recorded_before():
    bench = Bench()
    points = [float(number) for number in range(1, 13)]
    bench.ask(f"WAV 1 X PNT 1 12 {' '.join(map(str, points))}")
    for command in ("WSL 1 1", "WGC 1 1", "SPA 1 0x16000300 1", "DRC 1 1 16", "RTR 3"):
        bench.ask(command)
    for cycles in (40, 41, 42, 43):
        bench.ask("WGO 1 1")
        bench.wait((cycles + 0.5) * CYCLE)
        found = [float(line) for line in bench.ask("DRR? 1 4").split(" \n")[-4:]]
        assert bench.error() == 0 and found == points[::3], cycles


def test_the_wave_generator_plays_what_was_defined_and_the_recorder_has_it():
    bench = Bench()
    for command in ("WAV 1 X SIN_P 200 40 10 200 0 100", "WSL 1 1", "WGC 1 2", "SPA 1 0x16000300 2", "RTR 2"):
        bench.ask(command)
    bench.ask("DRC 1 1 16 2 1 2")
    bench.ask("WGO 1 1")
    assert bench.error() == 0 and bench.raw(b"\x09") == "1\n"
    bench.wait(400 * CYCLE + 0.05)
    assert bench.raw(b"\x09") == "0\n" and bench.number("DRL? 1") > 200
    lines = bench.ask("DRR? 1 200").split(" \n")
    head = dict(line[2:].split(" = ") for line in lines[: lines.index("# END_HEADER")])
    assert head["DIM"] == "2" and int(head["NDATA"]) == 200 and float(head["SAMPLE_TIME"]) == 2 * CYCLE
    assert head["NAME0"].endswith("chan1") and head["NAME1"].endswith("axis1")
    data = np.array([line.split() for line in lines[lines.index("# END_HEADER") + 1 :]], dtype=float)
    k = 2 * np.arange(200)
    wanted = 10.0 + 20.0 * (1.0 - np.cos(2.0 * np.pi * (k % 200) / 200))
    assert data.shape == (200, 2) and data[:, 0] == pytest.approx(wanted, abs=1e-4)
    assert np.corrcoef(data[:, 0], data[:, 1])[0, 1] > 0.95


def test_stopped_in_a_wave_it_stays_at_its_voltage():
    bench = Bench()
    bench.ask("WAV 1 X LIN 1000 100 0 1000 0 0")
    bench.ask("WSL 1 1")
    bench.ask("WGO 1 1")
    bench.wait(500 * CYCLE)
    bench.ask("STP")
    bench.wait(0.1)
    assert bench.number("VOL? 1") == pytest.approx(50.0, abs=0.3) and bench.raw(b"\x09") == "0\n"
    assert bench.error() == STOPPED


def test_busy_or_with_a_fault_of_the_hardware_it_refuses():
    bench = Bench()
    bench.ask("SVA 1 20")
    bench.faults.add("busy:0:1")
    bench.ask("SVA 1 30")
    assert bench.error() == BUSY and bench.raw(b"\x07") == "\xb0\n" and bench.number("SVA? 1") == 20.0
    bench.now += 1.0
    bench.faults.add("error:0:1:602")
    bench.ask("SVA 1 30")
    assert [bench.error() for _ in range(2)] == [602, 602] and bench.number("SVA? 1") == 20.0
    bench.now += 1.0
    bench.ask("SVA 1 30")
    assert bench.error() == 0 and bench.raw(b"\x07") == "\xb1\n" and bench.number("SVA? 1") == 30.0


def test_it_knows_what_the_makers_own_tools_ask_for():
    """The commands of PIPython 2.11 in ``pitools.startup`` and ``pitools.writewavepoints``, two points per command."""
    bench = Bench("E-727")
    asked = {
        "VER?": "FW_DSP: V1.000 of E-727.3CDA (emulated)",
        "SSN?": "0000000000",
        "FRF? 2": "2=1",
        "TWG?": "3",
        "WGC? 1": "1=0",
        "WSL?": "1=0 \n2=0 \n3=0",
        "\x04": "0x0",
    }
    assert {question: bench.ask(question) for question in asked} == asked
    for line in ("WAV 2 X PNT 1 2 1.0 2.0", "WAV 2 & PNT 3 2 3.0 4.0", "WAV 2 & PNT 5 1 5.0"):
        bench.ask(line)
    assert bench.error() == 0 and bench.ask("WAV? 2") == "2 1=5"
    assert bench.ask("GWD? 1 5 2").split(" \n")[-5:] == ["1", "2", "3", "4", "5"]
    bench.ask("WAV 2 & PNT 2 2 7.0 8.0")
    assert bench.ask("GWD? 1 5 2").split(" \n")[-5:] == ["1", "7", "8", "4", "5"]
    bench.ask("WAV 2 & PNT 1 1 9.0")
    assert bench.ask("GWD? 1 9 2").split(" \n")[-6:] == ["1", "7", "8", "4", "5", "9"]
    for line in ("WSL 2 2", "WGC 2 3", "FRF 1"):
        bench.ask(line)
    assert bench.error() == 0 and (bench.ask("WSL? 2"), bench.ask("WGC? 2")) == ("2=2", "2=3")
    for line in ("WAV 2 & PNT 8 1 0.0", "WAV 3 X PNT 2 1 0.0", "WAV 3 X PNT 0 1 0.0"):
        bench.ask(line)
        assert bench.error() == OUT_OF_RANGE, "points after a gap are refused"
    bench.ask("SVO 3 1")
    bench.wait(1.0)
    assert bench.ask("\x04") == "0x500", "the third axis has its servo on, and is on target"
