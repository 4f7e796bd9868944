# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The guard around a driver: every exception becomes an error that names the driver, and invalid devices are closed."""

from __future__ import annotations

import contextlib
import math
import threading

import pytest

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import (
    Capabilities,
    Compiled,
    Driver,
    DriverError,
    Edge,
    HardwareDriver,
    Reading,
    highest_rate,
    ramp,
)


class Stage(Driver):
    """A stage that raises given exceptions at given points."""

    raised: dict[str, Exception] = {}
    calls: list[str] = []
    positions = (0.0,)

    def _call(self, name: str) -> None:
        self.calls.append(name)
        if name in self.raised:
            raise self.raised[name]

    def open(self, parameters, sample_rate):
        self._call("open")
        return Capabilities(1, 1, -10.0, 100.0, 1000.0)

    def read(self):
        self._call("read")
        return Reading(self.positions)

    def write(self, voltages):
        self._call("write")

    def make_safe(self):
        self._call("make_safe")

    def close(self):
        self._call("close")


@pytest.fixture
def declared(monkeypatch):
    monkeypatch.setattr(Stage, "raised", {})
    monkeypatch.setattr(Stage, "calls", [])
    return HardwareDriver("stage", "a stage of a test", Parameters, Stage, contextlib.nullcontext)


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (OSError("no such bus"), "driver stage: cannot be read: OSError: no such bus; check the device"),
        (
            DriverError("stage 7", "is not homed", "home it"),
            "driver stage: cannot be read: stage 7 is not homed; home it",
        ),
        (
            ParameterError([Problem("a", 1, "no")]),
            "driver stage: cannot be read: ParameterError: a = 1: no; check the device",
        ),
    ],
)
def test_whatever_a_driver_raises_names_it_and_says_what_to_do(declared, raised, said):
    device = Device(declared, Parameters(), 100.0)
    assert device.read() == (0.0,)
    Stage.raised["read"] = raised
    with pytest.raises(DriverError) as caught:
        device.read()
    assert str(caught.value).startswith(said)


def test_another_number_of_positions_than_said_is_refused(declared, monkeypatch):
    device = Device(declared, Parameters(), 100.0)
    monkeypatch.setattr(Stage, "positions", (0.0, 1.0))
    with pytest.raises(DriverError, match="driver stage: cannot be read: ValueError: 2 positions for 1 joints"):
        device.read()


@pytest.mark.parametrize("raised", [OSError("not there"), ParameterError([Problem("a", 1, "no")])])
def test_what_cannot_be_opened_is_closed(declared, raised):
    Stage.raised["open"] = raised
    with pytest.raises(ParameterError if isinstance(raised, ParameterError) else DriverError):
        Device(declared, Parameters(), 100.0)
    assert Stage.calls == ["open", "close"]


def test_what_does_not_suit_is_closed(declared):
    def refuse(capabilities):
        assert capabilities.maximum == 100.0
        raise DriverError("stage", "is too small", "take another one")

    with pytest.raises(DriverError, match="stage is too small; take another one"):
        Device(declared, Parameters(), 100.0, refuse)
    assert Stage.calls == ["open", "close"]


def test_closing_never_fails_and_happens_once(declared):
    device = Device(declared, Parameters(), 100.0)
    Stage.raised["close"] = OSError("it has gone")
    device.close()
    device.close()
    assert Stage.calls == ["open", "close"]


def test_a_device_that_has_refused_a_voltage_is_made_safe_all_the_same(declared):
    """It may have put the voltage out before the error."""
    device = Device(declared, Parameters(), 100.0)
    Stage.raised["write"] = OSError("no answer")
    with pytest.raises(DriverError, match="cannot be written"):
        device.write([5.0])
    assert device.left_at == 5.0
    assert device.close() == "" and Stage.calls == ["open", "write", "make_safe", "close"]


def test_a_device_that_is_safe_has_no_voltage_left_and_is_not_made_safe_again(declared):
    device = Device(declared, Parameters(), 100.0)
    device.write([5.0])
    device.make_safe()
    assert device.left_at is None
    device.close()
    assert Stage.calls == ["open", "write", "make_safe", "close"]


def test_attempts_in_the_background_end_with_the_device(declared):
    device, asked = Device(declared, Parameters(), 100.0), threading.Event()
    device.write([5.0])
    Stage.raised["make_safe"] = OSError("no answer")
    before = set(threading.enumerate())
    device.insist(1e-3, lambda: asked.set() or True, lambda: pytest.fail("it was never safe"))
    assert asked.wait(60.0)
    assert [thread.daemon for thread in set(threading.enumerate()) - before] == [True], "it would keep the process"
    assert "the output is still at 5 V" in device.close()
    attempts = Stage.calls.count("make_safe")
    over = device._over
    assert over.is_set() and Stage.calls[-1] == "close"
    Stage.raised.clear()
    device._insist(over, 0.0, lambda: pytest.fail("after the end"), lambda: pytest.fail("after the end"))
    assert Stage.calls.count("make_safe") == attempts


def test_an_attempt_that_waits_for_the_device_while_attempts_end_does_not_begin(declared):
    """It has waited its time, and then for a call that is still running; meanwhile the attempts were ended."""

    class EndedMeanwhile(threading.Event):
        def wait(self, timeout=None):
            self.set()
            return False

    device = Device(declared, Parameters(), 100.0)
    device.write([5.0])
    device._insist(EndedMeanwhile(), 0.0, lambda: True, lambda: pytest.fail("after the end"))
    assert "make_safe" not in Stage.calls and device.left_at == 5.0


def test_attempts_go_on_until_the_device_is_safe_and_then_end(declared):
    class Mended(threading.Event):
        """The time between two attempts; before the third one the device is mended."""

        waits = 0

        def wait(self, timeout=None):
            self.waits += 1
            if self.waits == 3:
                Stage.raised.clear()
            return self.is_set() or self.waits > 9

    device, done, over = Device(declared, Parameters(), 100.0), [], Mended()
    device.write([5.0])
    Stage.raised["make_safe"] = OSError("no answer")
    device._insist(over, 0.0, lambda: True, lambda: done.append(device.left_at))
    assert Stage.calls.count("make_safe") == 3 and done == [None] and over.waits == 4


def test_a_driver_that_knows_its_output_says_what_is_left(declared, monkeypatch):
    """It stops halfway on the way from 80 V to its safe voltage."""
    device = Device(declared, Parameters(), 100.0)
    monkeypatch.setattr(Stage, "last_output", 40.0)
    assert device.left_at is None, "no voltage was sent"
    device.write([80.0])
    Stage.raised["make_safe"] = OSError("no answer")
    assert device.left_at == 40.0
    assert "the output is still at 40 V" in device.close()


def test_a_device_that_is_no_longer_to_be_made_safe_is_left_alone(declared):
    device = Device(declared, Parameters(), 100.0)
    device.write([5.0])
    device._insist(threading.Event(), 0.0, lambda: False, lambda: pytest.fail("it is not safe"))
    assert "make_safe" not in Stage.calls and device.left_at == 5.0


@pytest.mark.parametrize("forces", [(), (1.0, 2.0)])
def test_another_number_of_forces_than_said_is_refused(forces):
    class Pushed(Stage):
        def open(self, parameters, sample_rate):
            return Capabilities(1, 1, -10.0, 100.0, 1000.0, forces=1)

        def read(self):
            return Reading((0.0,), forces)

    device = Device(HardwareDriver("a", "of a test", Parameters, Pushed, contextlib.nullcontext), Parameters(), 100.0)
    with pytest.raises(DriverError, match=rf"{len(forces)} forces, but Capabilities\.forces is 1"):
        device.read()


def test_one_infinite_position_of_several_is_no_reading(monkeypatch):
    class Two(Stage):
        def open(self, parameters, sample_rate):
            return Capabilities(2, 1, -10.0, 100.0, 1000.0)

    device = Device(HardwareDriver("two", "of a test", Parameters, Two, contextlib.nullcontext), Parameters(), 100.0)
    monkeypatch.setattr(Stage, "positions", (0.0, math.inf))
    with pytest.raises(DriverError, match="an infinite position"):
        device.read()
    monkeypatch.setattr(Stage, "positions", (0.0, math.nan))
    assert device.read()[0] == 0.0


@pytest.mark.parametrize(("slow", "rate"), [(0, 500.0), (4, 500.0), (6, 5.0)])
def test_the_highest_rate_leaves_half_of_a_period_in_nine_of_ten_samples(monkeypatch, slow, rate):
    """Fifty samples of 1 ms, of which some take 100 ms: up to five of them may be missed."""
    now, number = [0.0], [0]
    monkeypatch.setattr("hysteresis_ros.hardware.driver.time.perf_counter", lambda: now[0])

    def read() -> None:
        now[0] += 0.1 if number[0] % 8 == 0 and number[0] < 8 * slow else 1e-3
        number[0] += 1

    assert highest_rate(lambda: None, read) == pytest.approx(rate)


def test_a_ramp_has_equal_steps_and_ends_where_it_should(monkeypatch):
    waited, way = [], []
    monkeypatch.setattr("hysteresis_ros.hardware.driver.time.sleep", waited.append)
    ramp(way.append, 80.0, 20.0, 0.4)
    assert way == pytest.approx([80.0 - 3.0 * step for step in range(1, 21)])
    assert sum(waited) == pytest.approx(0.4, rel=0.06)
    way.clear()
    ramp(way.append, 20.0, 20.0, 0.4)
    assert way == [20.0]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda stage: stage.output_clock(Edge.LINE), "has no outputs for the clock of a scan; set scan_clock: false"),
        (lambda stage: stage.output_trigger(1, 0.0), "has no output for triggers; set trigger_output: false"),
        (lambda stage: stage.compare([1e-6], []), "does not compare positions; set trigger_output: false"),
    ],
)
def test_what_a_driver_does_not_offer_is_refused_with_the_remedy(call, words):
    with pytest.raises(DriverError, match=f"Stage {words}"):
        call(Stage())


def test_compiled_code_offers_no_clock_no_trigger_and_no_pulses_by_default():
    code = Compiled(read=1, write=2, make_safe=3, device=4, explain=lambda number: DriverError("stage", "", ""))
    assert (code.clock, code.trigger, code.pulses) == (0, 0, 0)
