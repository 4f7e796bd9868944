# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The NV200 amplifier: the protocol of the emulated one, and the driver with the manufacturer's package."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from waiting import until

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.hardware import device as devices
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.drivers.nv200 import Nv200Driver, Nv200Parameters
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.laboratory.emulation.bench import Bench, DeviceFaults, EmulatedPlant, assumed_stage
from hysteresis_ros.laboratory.emulation.nv200 import SETTINGS, Amplifier, EmulatedAmplifierParameters, start

CYCLE = 5.0e-4


class Line:
    """An amplifier without a link, with a clock controlled by the test."""

    def __init__(self):
        self.now = 0.0
        clock = lambda: self.now  # noqa: E731
        self.faults = DeviceFaults(clock)
        self.amplifier = Amplifier(EmulatedPlant(assumed_stage(CYCLE), CYCLE, clock), self.faults)
        self.session = self.amplifier.session()

    def ask(self, line: str, wait: float = 0.0) -> str:
        answer = self.session.feed(line.encode("latin-1") + b"\r\n").decode("latin-1")
        assert answer[0] == "\x13" and answer[-1] == "\x11"
        self.now += wait
        return answer[1:-1].removesuffix("\r\n")

    def number(self, name: str) -> float:
        return float(self.ask(name).removeprefix(f"{name},"))


@pytest.fixture(scope="module")
def shared():
    return Line()


words = st.sampled_from(
    ["set", "meas", "cl", "stat", *SETTINGS, ",", "1", "-3", "1e999", "nan", "x", "\r", "\n", "\xff", "\xfb"]
)


@pytest.mark.slow
@settings(max_examples=300)
@given(data=st.one_of(st.binary(max_size=60), st.lists(words, max_size=9).map(lambda w: "".join(w).encode("latin-1"))))
def test_whatever_comes_is_answered_and_the_next_question_too(shared, data):
    answers = shared.session.feed(data)
    assert answers.count(b"\x13") == answers.count(b"\x11") <= data.count(b"\r") + 1
    shared.session.feed(b"\xf0\r")  # the end of an incomplete line, and of telnet commands
    assert shared.ask("cl") in ("cl,0", "cl,1")


def test_it_says_who_it_is_and_telnet_does_not_disturb_it():
    line = Line()
    assert line.ask("") == "NV200/D_NET>"
    assert line.session.feed(b"\xff\xfb\x18\xff\xfa\x18\x00xterm\xff\xf0me\xff\xfd\x01as\r\n").startswith(b"\x13meas,")


@pytest.mark.parametrize(
    ("said", "code"),
    [
        ("foo", 2),
        ("foo,1", 2),
        ("meas,1", 6),
        ("set,", 3),
        ("set,x", 3),
        ("set,nan", 9),
        ("set,-31", 9),
        ("set,131", 10),
        ("set,1,2", 5),
        ("cl,2", 10),
        ("kp,10001", 10),
    ],
)
def test_what_cannot_be_done_is_an_error_and_changes_nothing(said, code):
    line = Line()
    before = line.ask("set"), line.ask("cl"), line.ask("kp")
    assert line.ask(said) == f"error,{code}"
    assert (line.ask("set"), line.ask("cl"), line.ask("kp")) == before


def test_open_and_closed_it_goes_where_it_is_told():
    line = Line()
    assert line.ask("set,50", 0.3) == ""
    assert line.number("set") == 50.0 and 30.0 < line.number("meas") < 45.0
    there = line.number("meas")
    line.ask("cl,1", 0.2)
    assert line.number("meas") == pytest.approx(there, abs=0.1), "the output jumped"
    line.ask("set,60", 1.0)
    assert line.number("meas") == pytest.approx(60.0, abs=0.02) and int(line.number("stat")) & 8
    line.ask("cl,0", 0.2)
    assert line.number("meas") == pytest.approx(60.0, abs=0.5), "the voltage was not held"
    line.faults.add("busy:0:1")
    assert line.ask("set,3") == "error,1"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "NV200 has no address; give nv200.host or nv200.serial_port"),
        ({"serial_port": "/dev/ttyNOWHERE"}, "NV200 at /dev/ttyNOWHERE cannot be opened"),
    ],
)
def test_an_amplifier_that_is_nowhere_is_named(changes, said, monkeypatch):
    monkeypatch.setattr(devices.importlib.util, "find_spec", lambda name: True)
    with pytest.raises(DriverError, match=f"driver nv200: cannot be opened: {said}"):
        Device(DRIVERS["nv200"], Nv200Parameters(**changes), 10.0)


def test_without_the_makers_package_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(devices.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DriverError, match=r"needs the package nv200, .*; pip install 'hysteresis_ros\[nv200\]'"):
        Device(DRIVERS["nv200"], Nv200Parameters(host="localhost"), 10.0)


def test_two_addresses_are_one_too_many():
    with pytest.raises(ParameterError, match="give either host or serial_port"):
        Nv200Parameters(host="a", serial_port="b").validated()


# -- the driver in front of the amplifier, without link and package --------------------------------------------------


class Made:
    """What the maker's package gives: asynchronous calls, which here ask an amplifier without a link."""

    def __init__(self):
        self.line, self.pid, self.sent = Line(), self, []
        self.units, self.status = ["µm", "V"], None

    async def connect(self, configure):
        self.line.now += 1.0

    async def close(self):
        pass

    async def get_actuator_name(self):
        return self.line.ask("desc").removeprefix("desc,")

    async def has_position_sensor(self):
        return True

    async def get_position_unit(self):
        return self.units[0]

    async def get_voltage_unit(self):
        return self.units[1]

    async def get_voltage_range(self):
        return self.line.number("avmin"), self.line.number("avmax")

    async def read_int_value(self, name):
        return int(self.line.number(name)) if self.status is None else self.status

    async def set_closed_loop(self, closed):
        await self.write(f"cl,{int(closed)}")

    async def get_setpoint(self):
        return self.line.number("set")

    async def get_current_position(self):
        return self.line.number("meas")

    async def write(self, text):
        self.sent.append(text)
        return self.line.ask(text, CYCLE)


@pytest.fixture
def made(monkeypatch):
    made = Made()
    monkeypatch.setattr(devices.importlib.util, "find_spec", lambda name: True)
    monkeypatch.setattr(Nv200Driver, "_made", lambda driver: made)
    return made


def in_front_of(made, **changes) -> Device:
    given = {"host": "amplifier", "safe_time": 0.01, "check_period": 1e-3} | changes
    return Device(DRIVERS["nv200"], Nv200Parameters(**given).validated(), 10.0)


def test_it_takes_the_amplifier_from_whoever_had_it_and_goes_to_its_safe_voltage_in_steps(made):
    """Before, the loop is closed and an analog input is the source of the setpoint."""
    for line in ("cl,1", "modsrc,1", "set,40"):
        made.line.ask(line, 0.2)
    device = in_front_of(made, safe_voltage=10.0)
    amplifier = made.line.amplifier
    assert not amplifier.closed and amplifier.settings["modsrc"] == 0 and amplifier.voltage == 10.0
    # the source is taken before anything is put out
    assert made.sent.index("modsrc,0") < next(place for place, text in enumerate(made.sent) if text[:3] == "set")
    device.write([60.0])
    made.line.now += 0.3
    assert device.read()[0] == pytest.approx(1e-6 * made.line.number("meas"), rel=1e-9) and device.read()[0] > 3e-5
    made.line.ask("modsrc,2")
    made.sent.clear()
    device.make_safe()
    way = [float(text[4:]) for text in made.sent if text.startswith("set,")]
    assert way == pytest.approx([60.0 - 2.5 * step for step in range(1, 21)], abs=2e-3)
    assert amplifier.settings["modsrc"] == 0
    device.close()


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (1 << 2, "no actuator is connected"),
        (1 | 1 << 10, "it is too hot"),
        (1 | 1 << 11, "the actuator has an error"),
        (1 | 1 << 12, "its hardware has an error"),
        (1 | 1 << 3, "another program has closed its loop"),
    ],
)
def test_each_bit_of_the_status_that_matters_stops_it_at_the_start_and_in_motion(made, status, said):
    device = in_front_of(made)
    device.write([20.0])
    made.status = status
    with pytest.raises(DriverError, match=f"cannot be read: NV200 at .* is not ready: {said}; remove the cause"):
        until(lambda: device.read() is None)
    with pytest.raises(DriverError, match=f"cannot be opened: NV200 at .* is not ready: {said}; remove the cause"):
        in_front_of(made)
    made.status = 1 | 1 << 2
    device.read()
    device.close()


@pytest.mark.parametrize(("unit", "metres"), [("µm", 1e-6), ("μm", 1e-6), ("um", 1e-6), ("nm", 1e-9), ("mm", 1e-3)])
def test_readings_are_metres_whatever_the_unit_of_the_sensor(made, unit, metres):
    made.units[0] = unit
    device = in_front_of(made)
    device.write([50.0])
    made.line.now += 0.3
    assert device.read()[0] == pytest.approx(metres * made.line.number("meas"), rel=1e-9)
    device.close()


@pytest.mark.parametrize(("units", "said"), [(["mrad", "V"], "measures in mrad"), (["µm", "mV"], "outputs mV")])
def test_an_amplifier_of_other_units_is_refused(made, units, said):
    made.units = units
    with pytest.raises(DriverError, match=f"{said}.*; an axis needs V and one of"):
        in_front_of(made)


# -- through the makers' package -------------------------------------------------------------------------------------


@pytest.fixture(params=["serial", "tcp"])
def running(request):
    pytest.importorskip("nv200", reason="nv200 is not installed (it needs Python 3.12): no driver")
    with start(EmulatedAmplifierParameters(link=request.param, port=0), Bench()) as running:
        yield running


def opened(running, **changes) -> Device:
    given = running.driver.to_mapping() | {"safe_time": 0.02, "check_period": 0.01, "timeout": 0.3} | changes
    return Device(DRIVERS["nv200"], Nv200Parameters(**given).validated(), 10.0)


def test_the_makers_package_moves_the_emulated_amplifier(running):
    device = opened(running, actuator="emu")
    can = device.capabilities
    assert (can.minimum, can.maximum) == (-30.0, 130.0)
    assert can.highest_rate > 0.5  # measured, on a possibly busy machine
    device.write([50.0])
    until(lambda: 30.0e-6 < device.read()[0] < 45.0e-6)
    device.make_safe()
    until(lambda: device.read()[0] < 10.0e-6)
    device.close()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"actuator": "TRITOR"}, "has the actuator 'EMULATED', which does not contain nv200.actuator = 'TRITOR'"),
        ({"safe_voltage": 200.0}, "range of -30 … 130 V, which does not contain nv200.safe_voltage = 200 V"),
        ({"fault": "error:0:9:8"}, "fails when it opens its loop .*Error 8: Overload"),
        ({"fault": "silent:0:9"}, "is connected"),
        ({"fault": "cut:0:9"}, "is connected|hung up"),
    ],
)
def test_what_it_cannot_work_with_is_named(running, changes, said):
    changes = dict(changes)
    if fault := changes.pop("fault", None):
        running.faults.add(fault)
    with pytest.raises(DriverError) as caught:
        opened(running, **changes).close()
    assert re.search(said, str(caught.value)), caught.value
    assert str(caught.value).startswith("driver nv200: cannot be opened: NV200 at ")


def test_a_second_master_is_refused_and_the_first_goes_on(running):
    first = opened(running)
    with pytest.raises(DriverError, match="cannot be opened: NV200 at .*(another program|is connected)"):
        opened(running)
    first.write([20.0])
    until(lambda: first.read()[0] > 5.0e-6)
    first.close()


@pytest.mark.parametrize("fault", ["silent:0:0.5", "error:0:0.5:8"])
def test_what_goes_wrong_is_an_error_until_it_is_over(running, fault):
    device = opened(running)
    device.write([20.0])
    running.faults.add(fault)
    with pytest.raises(
        DriverError, match="driver nv200: cannot be read: NV200 at .*(does not answer|hardware has an error)"
    ):
        until(lambda: device.read() is None)
    until(lambda: fault.partition(":")[0] not in running.faults)
    device.write([20.0])
    until(lambda: device.read()[0] > 5.0e-6)
    device.close()
