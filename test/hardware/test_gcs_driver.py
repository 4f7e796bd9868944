# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The driver of GCS controllers with an emulated one over TCP: its requirements, its commands, and faults."""

from __future__ import annotations

import contextlib
import re
import socket
import threading
from dataclasses import replace

import numpy as np
import pytest
from gcs_support import CYCLE, RATE, serving_stand
from waiting import until

from hysteresis_ros import signals as at
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.hardware import driver as bringup
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.drivers import gcs as driving
from hysteresis_ros.hardware.drivers.gcs import GcsParameters
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.loop.device import DrivenPlant
from hysteresis_ros.loop.parameters import PlantNodeParameters

#: Time [s] after which an answer counts as lost, in tests that lose answers.
LOST = 0.5


@pytest.fixture
def stand(request):
    with serving_stand(getattr(request, "param", "E-754")) as stand:
        yield stand


@pytest.fixture
def device(stand):
    device = stand.open()
    yield device
    with contextlib.suppress(DriverError):
        device.make_safe()
    device.close()


def test_volts_go_out_and_metres_come_back(stand, device):
    assert (device.capabilities.minimum, device.capabilities.maximum) == (-30.0, 130.0)
    assert device.capabilities.highest_rate > RATE
    device.write([50.0])
    until(lambda: device.read()[0] > 30.0e-6)
    axis = stand.controller.axes["1"]
    assert axis.plant.voltage == 50.0
    until(
        lambda: device.read()[0] == pytest.approx(axis.plant.measured, abs=2e-8), what="the measurement of the device"
    )


def test_units_and_scales_are_converted(stand):
    stand.say("SPA 1 0x07000601 MM")
    device = stand.open(open_loop_scale=0.5, voltage_tolerance=100.0)
    device.write([20.0])
    # a unit of SVA is declared as half a volt
    until(lambda: stand.controller.axes["1"].plant.voltage == 40.0)
    until(lambda: device.read()[0] > 25.0e-6)
    device.close()


def test_with_the_servo_a_volt_is_a_place(stand):
    device = stand.open(mode="servo", servo_scale=2.0e-6, safe_voltage=5.0)
    axis = stand.controller.axes["1"]
    assert axis.servo and axis.target == pytest.approx(10.0e-6)
    can = device.capabilities
    assert (can.minimum, can.maximum) == pytest.approx((-30.0 * axis.plant.gain / 2e-6, 130.0 * axis.plant.gain / 2e-6))
    device.write([20.0])
    until(lambda: device.read()[0] == pytest.approx(40.0e-6, abs=1e-7))
    device.make_safe()
    until(lambda: device.read()[0] == pytest.approx(10.0e-6, abs=1e-7))
    device.close()


def test_at_the_beginning_and_for_safety_it_does_not_jump(stand):
    stand.say("SVA 1 80")
    stand.heard.clear()
    device = stand.open(safe_voltage=10.0)
    way = [float(line.split()[2]) for line in stand.heard if line.startswith("SVA 1")]
    assert way[0] < 80.0 and np.all(np.abs(np.diff(way)) <= 70.0 / 20 + 1e-6) and way[-1] == 10.0
    device.write([60.0])
    until(lambda: stand.controller.axes["1"].open_value == 60.0)
    stand.heard.clear()
    device.make_safe()
    way = [float(line.split()[2]) for line in stand.heard if line.startswith("SVA 1")]
    assert len(way) == 20 and np.all(np.abs(np.diff(way, prepend=60.0)) <= 50.0 / 20 + 1e-6)
    device.close()


def test_the_output_may_be_at_any_of_the_last_voltages_and_not_at_an_older_one(stand):
    """An amplifier that stays at 0 V: as long as 0 V is one of the last four voltages, it may just be slow."""
    device = stand.open(voltage_tolerance=1.0, check_period=0.001)
    stand.controller.axes["1"].plant.advance = lambda: None
    for voltage in (10.0, 20.0, 30.0):
        device.write([voltage])
        for _ in range(20):
            device.read()
    device.write([40.0])
    with pytest.raises(DriverError, match="outputs 0 V, but 40 V are commanded"):
        until(lambda: device.read() is None)
    device.close()


@pytest.fixture
def driver(stand):
    """The driver itself, for tests of more than one sample."""
    driver = driving.GcsDriver()
    driver.open(stand.given(safe_voltage=10.0), RATE)
    yield driver
    driver.close()


@pytest.mark.slow
def test_the_controller_plays_and_records_by_itself(stand, driver):
    k = np.arange(351)  # it ends at 50 V, far from where it begins
    wanted = 30.0 - 20.0 * np.cos(2.0 * np.pi * k / 100.0)
    played = driver.play(wanted, 1.7 * CYCLE)
    assert played.time == pytest.approx(2.0 * CYCLE * k) and played.voltage == pytest.approx(wanted, abs=1e-3)
    # µm and a lag of the stage; the rest is the width of its hysteresis loop
    assert np.ptp(played.position) > 20.0e-6
    assert np.corrcoef(played.voltage[10:], played.position[10:])[0, 1] > 0.9
    # the voltage at which it ends is the commanded one, and the change before and after is not a jump
    assert driver.last_output == pytest.approx(50.0)
    until(lambda: driver.read().positions[0] > 30.0e-6)
    stand.heard.clear()
    driver.make_safe()
    way = [float(line.split()[2]) for line in stand.heard if line.startswith("SVA 1")]
    assert np.all(np.abs(np.diff(way, prepend=50.0)) <= 40.0 / 20 + 1e-6)
    assert stand.controller.axes["1"].open_value == 10.0
    with_servo = stand.given(mode="servo", servo_scale=1.0e-6)
    driver.close()
    other = driving.GcsDriver()
    other.open(with_servo, RATE)
    played = other.play(np.linspace(0.0, 20.0, 100), 10.0 * CYCLE)
    assert played.position[-1] == pytest.approx(20.0e-6, abs=2.0e-6)
    other.close()


@pytest.mark.parametrize("voltages", [[], [0.0, 131.0], [0.0] * 70000])
def test_what_the_controller_cannot_play_is_refused(driver, voltages):
    with pytest.raises(DriverError, match="plays up to 65536 voltages within -30 … 130 V"):
        driver.play(voltages, CYCLE)


@pytest.mark.parametrize("missing", ["WAV", "WGO", "DRC", "DRR?"])
def test_a_controller_without_generator_or_recorder_is_not_asked_to_play(stand, driver, missing):
    driver._commands -= {missing}
    stand.heard.clear()
    with pytest.raises(DriverError, match=rf"does not know {re.escape(missing)}; send the voltages one by one"):
        driver.play([10.0, 20.0], CYCLE)
    assert not stand.heard


@pytest.mark.parametrize("stand", ["E-727"], indirect=True)
def test_each_axis_is_its_own(stand):
    device = stand.open(axis="3", identification="e-727")
    device.write([30.0])
    until(lambda: device.read()[0] > 15.0e-6)
    assert [axis.open_value for axis in stand.controller.axes.values()] == [0.0, 0.0, 30.0]
    device.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "changes", "said"),
    [
        (
            "",
            {"identification": "E-709"},
            r"identifies as '.*E-754.*', which does not contain gcs.identification = 'E-709'",
        ),
        ("", {"axis": "2"}, "has no axis '2', it has 1; give one of them as gcs.axis"),
        ("", {"position_unit": "mm"}, "measures axis 1 in UM, but gcs.position_unit is mm; make them equal"),
        ("", {"position_unit": "nm"}, "measures axis 1 in UM, but gcs.position_unit is nm; make them equal"),
        ("", {"safe_voltage": 200.0}, r"range of -30 … 130 V, which does not contain gcs.safe_voltage = 200 V"),
        ("", {"channel": "4"}, r"does not answer 'VMI\? 4'"),
        ("WAV 1 X PNT 1 2 0 1\nWSL 1 1\nWGO 1 1", {}, r"is in motion \(#9\); end the program"),
        ("SVO 1 1\nMOV 1 90", {}, r"is in motion \(#5\)"),
        ("fault busy:0:9", {}, "is busy with another task; wait"),
        ("fault error:0:9:602", {}, "error 602: a fault in the high-voltage supply; remove the cause"),
        ("fault silent:0:9", {"timeout": LOST}, r"does not answer '\*IDN\?' \(timed out\)"),
        ("fault cut:0:9", {}, r"has closed the connection at '\*IDN\?': it is off, or in use by another program"),
    ],
)
def test_what_it_cannot_work_with_is_named_and_nothing_is_commanded(stand, before, changes, said):
    if before.startswith("fault "):
        stand.faults.add(before.removeprefix("fault "))
    elif before:
        stand.say(before)
    stand.controller.tick()
    stand.heard.clear()
    with pytest.raises(
        DriverError, match=rf"driver gcs: cannot be opened: controller at 127.0.0.1:{stand.port} .*{said}"
    ):
        stand.open(**changes).close()
    # a missing range is reported before any voltage is put out
    assert not any(line.startswith("SVA ") and float(line.split()[2]) != 0.0 for line in stand.heard)


@pytest.mark.slow
def test_a_second_master_is_refused_until_the_first_has_gone(stand, device):
    with pytest.raises(DriverError, match="cannot be opened: .* in use by another program"):
        stand.open(timeout=5.0)
    device.write([20.0])
    until(lambda: device.read()[0] > 5.0e-6)
    device.close()
    stand.open(timeout=5.0).close()


def test_a_controller_that_is_not_there_or_is_no_controller_is_named():
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        port = nobody.getsockname()[1]
    with pytest.raises(DriverError, match=rf"controller at 127.0.0.1:{port} cannot be reached .*switch it on"):
        Device(DRIVERS["gcs"], GcsParameters(port=port), RATE)
    with socket.create_server(("127.0.0.1", 0)) as other:

        def greet():
            with other.accept()[0] as link:
                link.sendall(b"SSH-2.0\nHello\n")
                link.recv(100)

        threading.Thread(target=greet, daemon=True).start()
        with pytest.raises(
            DriverError, match="(sends 'SSH-2.0.*an unexpected line|answers 'ERR.' with 'Hello').*; give the address"
        ):
            Device(DRIVERS["gcs"], GcsParameters(port=other.getsockname()[1], timeout=0.2), RATE)


@pytest.mark.slow
def test_a_slow_link_has_a_low_rate(stand, monkeypatch):
    monkeypatch.setattr(bringup, "TRIALS", 5)
    stand.faults.add("slow:0:60:0.02")
    device = stand.open()
    assert 5.0 < device.capabilities.highest_rate < 25.0
    device.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("happens", "said"),
    [
        ("SVO 1 1", "has its servo switched on by another program; end the program that does so"),
        ("SVA 1 90", "outputs 90 V, but 20 V are commanded; check gcs.open_loop_scale"),
        ("fault error:0:0.3:603", "has an error: error 603: the temperature is out of range"),
        ("fault busy:0:0.3", "has an error: error 1005: the controller is busy"),
        ("fault silent:0:0.3", r"does not answer '(POS\? 1|ERR\?)' \(timed out\)"),
        ("fault cut:0:0.3", "it is off, or in use by another program"),
    ],
)
def test_what_goes_wrong_in_motion_stops_the_axis_until_it_is_started(stand, happens, said):
    plant = DrivenPlant(plant_parameters(stand))
    row = [0.0] * 64
    step(plant, row, 20.0, 30)
    assert stand.controller.axes["1"].open_value == pytest.approx(20.0)
    if happens.startswith("fault "):
        stand.faults.add(happens.removeprefix("fault "))

    def failed():
        if not happens.startswith("fault "):
            stand.say(happens)
        step(plant, row, 20.0, 1)
        return plant.failure

    assert re.search(said, until(failed)) and plant.tripped, plant.failure
    until(lambda: not any(name in stand.faults for name in ("error", "busy", "silent", "cut")))
    heard = len(stand.heard)
    step(plant, row, 20.0, 3)
    assert len(stand.heard) == heard, "the driver continued without ~/start"
    plant.start()
    step(plant, row, 20.0, 60)
    axis = stand.controller.axes["1"]
    assert plant.failure == "" and not axis.servo and axis.open_value == pytest.approx(20.0)
    plant.make_safe()
    assert axis.open_value == 0.0
    plant.close()


def plant_parameters(stand) -> PlantNodeParameters:
    own = {f"gcs.{name}": value for name, value in stand.given(timeout=LOST).to_mapping().items() if value != ()}
    return PlantNodeParameters.from_mapping(
        {"driver": "gcs", "sample_rate": RATE, "late_limit": -1, "safe_slew_rate": 1.0e4, "overtravel": -1.0}
        | {"hysteresis.type": "proportional", "hysteresis.proportional.gain": 8e-7}
        | {"limits.minimum": 0.0, "limits.maximum": 100.0}
        | own
    )


def step(plant, row, voltage: float, samples: int) -> None:
    for _ in range(samples):
        plant.sense(row)
        row[at.VOLTAGE] = voltage
        plant.actuate(row)


def test_a_range_that_the_controller_does_not_have_is_refused(stand):
    given = plant_parameters(stand)
    with pytest.raises(DriverError, match=r"range of -30 … 130 V does not contain limits.minimum … limits.maximum"):
        DrivenPlant(replace(given, limits=replace(given.limits, maximum=150.0)))


def test_a_range_of_voltages_is_two_numbers_in_order():
    with pytest.raises(ParameterError, match=r"voltage_range = \(3.0, 1.0\): give the least and the greatest"):
        GcsParameters(voltage_range=(3.0, 1.0)).validated()


#: Faults of a single line, or of two lines.
WRONG_LINES = ("repeat", "stale", "echo", "drop", "garbage", "half", "close")


def assert_every_reading_is_of_now(stand, device, readings: int) -> int:
    """Read while the stage moves; each reading is a position between request and answer, or an error."""
    errors, voltage = 0, 0.0
    for _ in range(readings):
        voltage = 5.0 - voltage
        before = stand.places()
        try:
            device.write([voltage])
            measured = device.read()[0]
        except DriverError:
            errors += 1
            continue
        assert any(abs(measured - place) < 1e-12 for place in stand.places()[len(before) :]), "an old reading"
    return errors


@pytest.mark.slow
@pytest.mark.parametrize("lines", [1, 2])
@pytest.mark.parametrize("happens", WRONG_LINES)
@pytest.mark.parametrize("looks", ["each time", "seldom"])
def test_a_line_that_is_wrong_or_too_many_gives_an_error_and_never_another_reading(stand, happens, lines, looks):
    stand.number_readings()
    device = stand.open(check_period=0.001 if looks == "each time" else 60.0, timeout=LOST)
    # for any line of an answer: those of the next reading, and of the following one
    for ask_before in range(3):
        assert_every_reading_is_of_now(stand, device, ask_before)
        stand.faults.add(f"{happens}:0:60:{lines}")
        errors = assert_every_reading_is_of_now(stand, device, 12)
        assert 1 <= errors <= 2 * lines, "a faulty line was accepted, or reading did not recover"
        stand.faults.add("none")
    device.close()


@pytest.mark.slow
@pytest.mark.parametrize("lines", [1, 2])
@pytest.mark.parametrize("happens", WRONG_LINES)
@pytest.mark.parametrize("first", ["read", "make_safe"])
def test_a_device_is_made_safe_whatever_line_goes_wrong(stand, happens, lines, first):
    device = stand.open(timeout=LOST)
    device.write([24.0])
    until(lambda: device.read()[0] > 5.0e-6)
    stand.faults.add(f"{happens}:0:60:{lines}")
    if first == "read":
        with pytest.raises(DriverError):
            until(device.read)
    device.make_safe()
    assert stand.controller.axes["1"].open_value == 0.0
    stand.faults.add("none")
    device.close()
    until(lambda: stand.controller.axes["1"].plant.voltage == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("happens", [*WRONG_LINES, "none"])
def test_a_device_that_is_closed_is_safe_and_says_nothing(stand, happens):
    device = stand.open(timeout=LOST)
    device.write([24.0])
    until(lambda: stand.controller.axes["1"].open_value == 24.0)
    if happens != "none":
        stand.faults.add(f"{happens}:0:60:1")
    assert device.close() == "" and stand.controller.axes["1"].open_value == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("happens", ["cut:0:60", "silent:0:60", "garbage:0:60:100000", "close:0:60:100000"])
def test_a_device_that_cannot_be_made_safe_says_the_voltage_that_is_left_until_a_person_has_seen_it(stand, happens):
    plant = DrivenPlant(plant_parameters(stand))
    axis, row = stand.controller.axes["1"], [0.0] * 64
    step(plant, row, 24.0, 60)
    assert axis.open_value == pytest.approx(24.0)
    stand.faults.add(happens)
    until(lambda: step(plant, row, 24.0, 1) or plant.failure)
    left = float(re.search(r"cannot be made safe: .*: the output is still at (\S+) V", plant.failure).group(1))
    assert left == axis.open_value == plant.held() == pytest.approx(24.0)
    step(plant, row, 24.0, 3)
    assert row[at.PLANT_VOLTAGE] == left, "the row must contain the voltage that is put out"
    plant.reset()
    step(plant, row, 24.0, 1)
    assert f"the output is still at {left:g} V" in plant.failure, "a reset does not make it safe"
    with pytest.raises(DriverError, match=f"the output is still at {left:g} V; switch the voltage off at the device"):
        plant.make_safe()
    assert axis.open_value == left
    stand.faults.add("none")
    plant.make_safe()
    assert axis.open_value == 0.0 == plant.held() and "still" not in plant.failure and plant.tripped
    assert plant.close() == "", "the device was safe"


@pytest.mark.slow
@pytest.mark.parametrize("happens", WRONG_LINES)
def test_an_axis_that_a_wrong_line_has_stopped_is_safe_and_names_the_line(stand, happens):
    plant = DrivenPlant(plant_parameters(stand))
    axis, row = stand.controller.axes["1"], [0.0] * 64
    step(plant, row, 24.0, 60)
    stand.faults.add(f"{happens}:0:60:1")
    until(lambda: step(plant, row, 24.0, 1) or plant.failure)
    said = "(before .*, an unexpected line|answers '.*' with|does not answer '.*timed out|has closed the connection at)"
    assert (
        re.search(said, plant.failure)
        and "has its servo switched" not in plant.failure
        and "are commanded" not in plant.failure
    )
    assert plant.tripped and axis.open_value == 0.0 == row[at.PLANT_VOLTAGE]
    stand.faults.add("none")
    plant.start()
    step(plant, row, 24.0, 60)
    assert plant.failure == "" and axis.open_value == pytest.approx(24.0)
    assert plant.close() == "" and axis.open_value == 0.0


def test_after_an_error_the_next_reading_takes_the_controller_anew_and_begins_in_the_safe_state(stand, device):
    device.write([24.0])
    until(lambda: device.read()[0] > 5.0e-6)
    stand.say("SVO 1 1")
    with pytest.raises(DriverError, match="has its servo switched on by another program"):
        until(lambda: device.read() and False)
    axis = stand.controller.axes["1"]
    assert axis.servo
    device.read()
    assert not axis.servo and axis.open_value == 0.0


def test_a_device_that_is_left_with_a_voltage_says_so_at_the_end(stand):
    device = stand.open()
    device.write([24.0])
    until(lambda: stand.controller.axes["1"].open_value == 24.0)
    stand.faults.add("cut:0:60")
    assert "the output is still at 24 V; switch the voltage off" in device.close()
    assert device.close() == ""


@pytest.mark.parametrize(("safe", "reported"), [(60.0, 60.054), (60.0, 59.946), (60.0, 60.066), (0.0, 9e-4)])
def test_a_report_rounded_by_a_part_in_a_thousand_is_the_safe_voltage(stand, safe, reported):
    device = stand.open(safe_voltage=safe)
    device.read()
    stand.deaf = True
    stand.controller.axes["1"].open_value = reported
    if reported < 1.001 * safe + 1e-3:
        device.make_safe()
    else:
        with pytest.raises(DriverError, match="was commanded to make it safe"):
            device.make_safe()
    stand.deaf = False
    device.close()


def test_a_controller_that_does_not_do_what_it_takes_is_not_called_safe(stand):
    device = stand.open()
    device.write([24.0])
    until(lambda: stand.controller.axes["1"].open_value == 24.0)
    stand.deaf = True
    with pytest.raises(DriverError, match=r"reports 24 for 'SVA\?', but 0 was commanded to make it safe: the output"):
        device.make_safe()
    stand.deaf = False
    device.make_safe()
    assert stand.controller.axes["1"].open_value == 0.0
    device.close()
