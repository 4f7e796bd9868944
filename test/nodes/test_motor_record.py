# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The motor record of an axis: what its fields do, without Channel Access and without ROS."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from record_support import SETTINGS

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.epics import server_process
from hysteresis_ros.laboratory.epics.record import (
    MISSED,
    SILENT,
    STOPPED,
    TOO_HIGH,
    TOO_LOW,
    Alarm,
    MotorRecord,
    RecordOptions,
    Seen,
    at_rest,
    motor_settings,
)
from hysteresis_ros.loop.reach import single_axis


class Axis:
    """An axis that moves at 2 µm/s to the active setpoint; received setpoints are in ``asked``."""

    def __init__(self):
        self.position = self.setpoint = 0.0
        self.alarm, self.deaf, self.error, self.asked = Alarm(), False, 0.0, []
        self._time = 0.0

    def look(self, now):
        step = 2e-6 * (now - self._time)
        self._time = now
        self.position += min(max(self.setpoint - self.position, -step), step)
        return Seen(self.position + self.error, self.setpoint, self.alarm)

    def move(self, setpoint):
        self.asked.append(setpoint)
        if not self.deaf:
            self.setpoint = setpoint

    def stop(self):
        self.asked.append("stop")
        self.setpoint = self.position


class Bench:
    """A record and its axis, with a clock controlled by the test."""

    def __init__(self, **settings):
        self.axis, self.now = Axis(), 0.0
        self.record = MotorRecord(replace(SETTINGS, **settings), self.axis)
        self.wait(0.02)

    def __getitem__(self, field):
        return self.record.fields[field]

    def put(self, field, value):
        return self.record.put(field, value, self.now)

    def wait(self, seconds):
        for _ in range(round(seconds / 0.02)):
            self.now += 0.02
            self.record.tick(self.now)

    def done(self):
        """Return the seconds until DMOV is 1."""
        begun = self.now
        while not self["DMOV"]:
            self.wait(0.02)
            assert self.now < begun + 60.0, "the move does not end"
        return self.now - begun


def test_a_move_is_over_when_the_axis_has_stayed_near_and_not_before():
    bench = Bench()
    assert bench.put("VAL", 4.0) == 4.0 and bench.axis.asked == [pytest.approx(4e-6)]
    assert (bench["DMOV"], bench["MOVN"], bench["TDIR"]) == (0, 1, 1)
    assert bench.done() == pytest.approx((4.0 - 0.02) / 2.0 + 0.1, abs=0.041)
    assert bench["RBV"] == pytest.approx(4.0) and (bench["MOVN"], bench["MISS"]) == (0, 0)
    assert bench.record.alarm == Alarm()
    bench.put("VAL", 4.0)  # a move to the current position is a move, too
    assert bench["DMOV"] == 0 and bench.done() == pytest.approx(0.12, abs=0.03)


@pytest.mark.parametrize(("value", "alarm"), [(12.1, TOO_HIGH), (-0.1, TOO_LOW), (math.nan, TOO_HIGH)])
def test_beyond_the_limits_nothing_moves_and_the_record_is_in_alarm_until_the_next_move(value, alarm):
    bench = Bench()
    bench.put("VAL", 3.0)
    bench.done()
    asked = list(bench.axis.asked)
    assert bench.put("VAL", value) == 3.0
    assert (bench["LVIO"], bench["DMOV"], bench.record.alarm) == (1, 0, alarm)
    bench.wait(0.02)
    assert bench["DMOV"] == 1 and bench.record.alarm == alarm and bench.axis.asked == asked
    bench.put("VAL", 2.0)
    assert bench["LVIO"] == 0 and bench.record.alarm == Alarm() and bench.axis.asked == [*asked, pytest.approx(2e-6)]


def test_limits_may_be_narrowed_but_not_beyond_the_axis():
    bench = Bench()
    assert bench.put("HLM", 5.0) == 5.0 and bench["DHLM"] == 5.0
    bench.put("VAL", 6.0)
    assert bench["LVIO"] == 1 and bench.axis.asked == []
    assert bench.put("HLM", 1e3) == 12.0 and bench.put("LLM", -5.0) == 0.0
    bench.put("DIR", "Neg")
    assert (bench["LLM"], bench["HLM"]) == (-12.0, 0.0)
    bench.put("LLM", -7.0)
    assert (bench["DHLM"], bench["DLLM"]) == (7.0, 0.0)


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(("Pos", "Neg")), st.floats(-100.0, 100.0), st.floats(0.0, 12.0))
def test_user_and_dial_positions_agree_and_offset_and_direction_move_nothing(direction, offset, dial):
    bench = Bench(timeout=50.0)
    bench.put("DVAL", dial)
    bench.done()
    bench.put("DIR", direction)
    bench.put("OFF", offset)
    sign = 1.0 if direction == "Pos" else -1.0
    assert len(bench.axis.asked) == 1 and bench["DRBV"] == pytest.approx(dial, abs=0.03)
    assert bench["RBV"] == pytest.approx(sign * bench["DRBV"] + offset)
    bench.put("VAL", sign * 5.0 + offset)
    assert bench.axis.asked[-1] == pytest.approx(5e-6) and bench["DVAL"] == pytest.approx(5.0)


def test_in_set_mode_a_position_is_given_a_name_instead_of_moving():
    bench = Bench()
    bench.put("VAL", 4.0)
    bench.done()
    bench.put("SET", "Set")
    bench.put("VAL", 100.0)
    assert bench["OFF"] == 96.0 and bench["RBV"] == pytest.approx(100.0, abs=0.03)
    assert (bench["LLM"], bench["HLM"]) == (96.0, 108.0)
    bench.put("FOFF", "Frozen")
    bench.put("VAL", 50.0)
    bench.put("DVAL", 7.0)
    assert bench["OFF"] == 96.0 and len(bench.axis.asked) == 1
    bench.put("SUSE", 1)
    bench.put("VAL", 101.0)
    assert bench.axis.asked[-1] == pytest.approx(5e-6)


def test_stop_ends_the_move_where_it_is_and_the_next_one_goes_on():
    bench = Bench()
    bench.put("VAL", 10.0)
    bench.wait(1.0)
    bench.put("STOP", 1)
    assert bench.axis.asked[-1] == "stop" and bench.done() < 0.2
    assert bench["VAL"] == bench["RBV"] == pytest.approx(2.0, abs=0.05) and bench.record.alarm == Alarm()
    bench.put("VAL", 3.0)
    bench.done()
    assert bench["RBV"] == pytest.approx(3.0)


def test_stop_pause_move_go():
    bench = Bench()
    bench.put("VAL", 10.0)
    bench.wait(1.0)
    bench.put("SPMG", "Pause")
    bench.done()
    assert bench["RBV"] == pytest.approx(2.0, abs=0.05)
    bench.put("VAL", 3.0)
    bench.wait(1.0)
    assert bench["RBV"] == pytest.approx(2.0, abs=0.05) and bench["VAL"] == 3.0
    bench.put("SPMG", "Move")
    bench.done()
    assert bench["RBV"] == pytest.approx(3.0) and bench["SPMG"] == "Pause"
    bench.put("SPMG", "Go")
    bench.put("VAL", 10.0)
    bench.put("SPMG", "Stop")
    bench.done()
    bench.put("SPMG", "Go")
    bench.wait(0.5)
    assert bench["DMOV"] == 1 and bench["RBV"] < 4.5


def test_tweaks_and_relative_moves():
    bench = Bench()
    bench.put("TWV", 0.5)
    for field, value, wanted in (("TWF", 1, 0.5), ("TWF", 1, 1.0), ("TWR", 1, 0.5), ("RLV", 2.0, 2.5), ("TWF", 0, 2.5)):
        bench.put(field, value)
        bench.done()
        assert bench["VAL"] == pytest.approx(wanted) and bench["TWF"] == 0


@pytest.mark.parametrize("alarm", [SILENT, STOPPED])
def test_an_axis_in_trouble_ends_its_move_in_alarm_and_takes_none(alarm):
    bench = Bench()
    bench.put("VAL", 10.0)
    bench.wait(0.5)
    bench.axis.alarm = alarm
    bench.wait(0.02)
    assert (bench["DMOV"], bench["MISS"], bench.record.alarm) == (1, 1, alarm)
    assert bool(bench["MSTA"] & 1 << 12) == (alarm == SILENT)
    bench.put("VAL", 1.0)
    assert len(bench.axis.asked) == 1 and bench["DMOV"] == 0
    bench.wait(0.02)
    assert bench["DMOV"] == 1 and bench.record.alarm == alarm
    bench.axis.alarm = Alarm()
    bench.put("VAL", 1.0)
    bench.done()
    assert bench.record.alarm == Alarm() and bench["RBV"] == pytest.approx(1.0)


def test_a_move_that_somebody_replaces_or_nobody_takes_or_that_never_settles_is_missed():
    bench = Bench()
    bench.put("VAL", 10.0)
    bench.wait(0.5)
    bench.axis.setpoint = 2e-6
    bench.wait(0.02)
    assert (bench["DMOV"], bench["MISS"], bench.record.alarm) == (1, 1, MISSED) and bench["VAL"] == pytest.approx(2.0)
    bench.axis.deaf = True
    bench.put("VAL", 5.0)
    assert bench.done() == pytest.approx(2.0, abs=0.05) and bench.record.alarm == MISSED
    bench.put("VAL", 2.01)  # near enough, but the setpoint was not accepted
    assert bench.done() == pytest.approx(2.0, abs=0.05) and bench.record.alarm == MISSED
    bench.axis.deaf, bench.axis.error = False, 1e-7
    bench.put("VAL", 2.0)
    assert bench.done() == pytest.approx(5.1, abs=0.05) and bench.record.alarm == MISSED


def test_a_setpoint_of_somebody_else_is_the_value():
    bench = Bench()
    bench.axis.setpoint = 3e-6
    bench.wait(2.0)
    assert bench["VAL"] == pytest.approx(3.0) and bench["DMOV"] == 1


def test_what_the_axis_itself_says_stays():
    bench = Bench(velocity=2e-4, acceleration=4e-3)
    assert (bench["VELO"], bench["ACCL"]) == (pytest.approx(200.0), pytest.approx(0.05))
    assert bench.put("VELO", 5.0) == pytest.approx(200.0) and bench.put("JOGF", 1) == 0 and not bench.axis.asked


def axis_of(name):
    """Return the parameters of an axis shipped with the package."""
    return single_axis(load_configuration(name))


def test_settings_follow_from_the_axis():
    found = motor_settings(axis_of("picma_stage"), RecordOptions("x:", "nm", 2, 3.0))
    own = axis_of("picma_stage").reference_generator
    assert (found.name, found.source, found.velocity) == ("x:m1", "reference_generator", own.approach.maximum_velocity)
    assert found.tolerance == pytest.approx(0.01 * (own.maximum - own.minimum)) and found.metres == pytest.approx(1e-9)
    still = motor_settings(at_rest(axis_of("picma_stage")), RecordOptions("x:", "um", 4, 3.0))
    assert (still.low, still.high) == (own.minimum, own.maximum) != (found.low, found.high)
    motor = motor_settings(at_rest(axis_of("inchworm_travel")), RecordOptions("x:", "mm", 4, 3.0, tolerance=1e-4))
    assert (motor.source, motor.low, motor.tolerance) == ("inchworm_sequencer", -9e-3, pytest.approx(1e-7))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--egu", "V"], "not a unit of length"),
        (["--precision", "-1"], "0 … 15"),
        (["--timeout", "0"], "positive number"),
        (["--tolerance", "nan"], "positive number"),
        (["--port", "80"], "1024"),
    ],
)
def test_wrong_options_are_one_line_and_exit_code_2(words, said):
    result = CliRunner().invoke(main, ["ioc", "kim2009", *words])
    assert result.exit_code == 2 and said in result.output and len(result.output.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "names", "together"),
    [([], ["x", "y"], True), (["--namespace", "y"], ["y"], True), (["--attach"], ["x", "y"], False)],
)
def test_the_axes_of_a_stage_are_motors_and_all_of_them_are_started(monkeypatch, words, names, together):
    served = []
    monkeypatch.setattr(server_process, "serve", lambda *given: served.append(given) or 0)
    result = CliRunner().invoke(main, ["ioc", "xy_scanner", "--prefix", "s:", *words])
    assert result.exit_code == 0, result.output
    ((motors, started, _, _, _, stage),) = served
    assert [(motor.name, motor.namespace, motor.joint) for motor in motors] == [(f"s:{a}", f"/{a}", a) for a in names]
    assert [axis.namespace for axis in started] == (["/x", "/y"] if together else [])
    assert (stage is not None) == together
    assert all(axis.generator.waveform.type == "hold" for axis in started)
    assert stage is None or not stage.stage.scan.kind


def test_an_axis_that_a_stage_does_not_have_is_no_motor():
    result = CliRunner().invoke(main, ["ioc", "xy_scanner", "--namespace", "z"])
    assert result.exit_code == 2 and "it has x, y" in result.output


def test_without_caproto_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(server_process.importlib.util, "find_spec", lambda name: None if name == "caproto" else True)
    result = CliRunner().invoke(main, ["ioc", "kim2009", "--attach"])
    assert result.exit_code == 2 and 'pip install "hysteresis_ros[epics]"' in result.output


def test_it_listens_on_this_machine_only_unless_told_otherwise(monkeypatch):
    monkeypatch.delenv("EPICS_CAS_INTF_ADDR_LIST", raising=False)
    monkeypatch.delenv("EPICS_CAS_AUTO_BEACON_ADDR_LIST", raising=False)
    assert server_process.interfaces(None) == ["127.0.0.1"]
    assert server_process.interfaces("10.0.0.1,10.0.0.2") == ["10.0.0.1", "10.0.0.2"]
    assert server_process.server_environment(["127.0.0.1"], 5070)["EPICS_CAS_AUTO_BEACON_ADDR_LIST"] == "NO"
    assert "EPICS_CAS_AUTO_BEACON_ADDR_LIST" not in server_process.server_environment(["10.0.0.1"], None)
    monkeypatch.setenv("EPICS_CAS_INTF_ADDR_LIST", "10.0.0.3")
    assert server_process.interfaces(None) == ["10.0.0.3"]
    with pytest.raises(ConfigurationError):
        RecordOptions("x:", "um", 99, 1.0)


def test_a_position_within_the_deadband_ends_at_once_without_motion():
    bench = Bench(deadband=0.05e-6)
    bench.put("VAL", 4.0)
    bench.done()
    asked = list(bench.axis.asked)
    bench.put("VAL", 4.04)
    assert bench["DMOV"] == 0 and bench.record.alarm == Alarm()
    bench.wait(0.02)
    assert bench["DMOV"] == 1 and bench["VAL"] == pytest.approx(4.0) and bench.axis.asked == asked
    bench.put("VAL", 4.06)
    assert bench.axis.asked[-1] == pytest.approx(4.06e-6)
    bench.done()
    bench.put("SPDB", 0.0)
    bench.put("VAL", 4.061)
    assert bench.axis.asked[-1] == pytest.approx(4.061e-6)


def test_the_record_shows_whether_and_when_the_axis_is_ready():
    bench = Bench()
    bench.wait(0.02)
    assert (bench["READY"], bench["READYIN"]) == (0, -1.0)
    seen = bench.axis.look(bench.now)
    for ready, ready_in in ((False, 0.0063), (True, 0.0)):
        bench.axis.look = lambda now, told=(ready, ready_in): seen._replace(ready=told[0], ready_in=told[1])
        bench.wait(0.02)
        assert (bench["READY"], bench["READYIN"]) == (int(ready), ready_in)
