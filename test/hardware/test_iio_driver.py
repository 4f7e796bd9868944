# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The driver of Linux IIO converters: on a synthetic device tree, and with emulated converters and a plant."""

from __future__ import annotations

import os

import pytest
from waiting import until

from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.drivers.iio import IioParameters
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.laboratory.emulation.bench import Bench
from hysteresis_ros.laboratory.emulation.iio import EmulatedConvertersParameters, start

RATE = 100.0
#: A 12-bit DAC around zero with its own scale and offset, and an ADC with one scale for all channels.
DAC = {"name": "ad5592r", "out_voltage3_raw": "2048", "out_voltage3_scale": "2.5", "out_voltage3_offset": "-2048"}
ADC = {
    "name": "ad7606",
    "in_voltage0_raw": "7",
    "in_voltage1_raw": "-1000",
    "in_voltage_scale": "0.1",
    "in_temp_raw": "1",
}


class Tree:
    """A folder like /sys/bus/iio/devices."""

    def __init__(self, root):
        self.root = root
        for number, files in enumerate((ADC, DAC)):
            (root / f"iio:device{number}").mkdir()
            for name, text in files.items():
                (root / f"iio:device{number}" / name).write_text(text + "\n")

    def file(self, device: int, name: str):
        return self.root / f"iio:device{device}" / name

    @property
    def raw(self) -> int:
        return int(self.file(1, "out_voltage3_raw").read_text().split()[0])

    def given(self, **changes) -> IioParameters:
        own = dict(output_device="ad5592r", output_channel="voltage3", output_raw_range=(0.0, 4095.0), safe_time=0.0)
        own |= dict(input_device="ad7606", input_channel="voltage1", directory=str(self.root))
        return IioParameters(**own | changes).validated()

    def open(self, **changes) -> Device:
        return Device(DRIVERS["iio"], self.given(**changes), RATE)


@pytest.fixture
def tree(tmp_path):
    return Tree(tmp_path)


def test_raw_numbers_are_those_of_scale_and_offset(tree):
    device = tree.open()
    # (0 - 2048) * 2.5 mV … (4095 - 2048) * 2.5 mV
    assert (device.capabilities.minimum, device.capabilities.maximum) == pytest.approx((-5.12, 5.1175))
    assert device.capabilities.position_unit == "V" and device.capabilities.highest_rate > RATE
    assert device.read() == pytest.approx((-0.1,))
    for voltage, raw in ((0.0, 2048), (1.0, 2448), (-5.12, 0), (5.1175, 4095), (0.0013, 2049), (0.0012, 2048)):
        device.write([voltage])
        assert tree.raw == raw
    # in an ordinary file the end of an older, longer content may follow
    tree.file(0, "in_voltage1_raw").write_text("2500\n00\n")
    assert device.read() == pytest.approx((0.25,))
    device.make_safe()
    assert tree.raw == 2048
    device.close()


def test_an_attribute_of_a_channel_goes_before_that_of_all_channels(tree):
    tree.file(0, "in_voltage1_scale").write_text("0.4\n")
    device = tree.open()
    assert device.read() == pytest.approx((-0.4,))
    device.close()


def test_it_begins_where_the_converter_is_and_switches_it_on_when_it_is_safe(tree, monkeypatch):
    tree.file(1, "out_voltage3_raw").write_text("4000\n")
    tree.file(1, "out_voltage3_powerdown").write_text("1\n")
    heard = []
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, data: heard.append(data) or write(file, data))
    tree.open(safe_voltage=1.0).close()
    way = [int(data) for data in heard]
    switched = way.index(0)
    assert way[:switched] == sorted(way[:switched], reverse=True) and 3900 < way[0] < 4000 and way[switched - 1] == 2448
    assert set(way[switched + 1 :]) == {2448} and tree.file(1, "out_voltage3_powerdown").read_text().startswith("0\n")


def test_a_converter_that_counts_downwards_has_its_range_in_order(tree):
    tree.file(1, "out_voltage3_scale").write_text("-2.5\n")
    device = tree.open()
    assert (device.capabilities.minimum, device.capabilities.maximum) == pytest.approx((-5.1175, 5.12))
    device.write([1.0])
    assert tree.raw == 1648
    device.close()


def test_a_range_that_the_device_says_is_taken(tree):
    tree.file(1, "out_voltage3_raw_available").write_text("[1024 1 3072]\n")
    device = tree.open()
    assert (device.capabilities.minimum, device.capabilities.maximum) == pytest.approx((-2.56, 2.56))
    device.close()


@pytest.mark.parametrize(
    ("changes", "broken", "said"),
    [
        (
            {"output_device": "ad5686"},
            None,
            r"'ad5686' .*is absent; there are iio:device0 \(ad7606\), iio:device1 \(ad5592r\)",
        ),
        ({"directory": "/nowhere"}, None, "is absent; there are none"),
        ({"output_channel": "voltage0"}, None, "has no channel out_voltage0, it has voltage3"),
        ({"input_channel": "voltage9"}, None, "has no channel in_voltage9, it has temp, voltage0, voltage1"),
        ({"output_raw_range": ()}, None, "has no range for out_voltage3_raw; give iio.output_raw_range"),
        ({"safe_voltage": 9.0}, None, "range of -5.12 … 5.1175 V, which does not contain iio.safe_voltage = 9 V"),
        ({"safe_voltage": -9.0}, None, "range of -5.12 … 5.1175 V, which does not contain iio.safe_voltage = -9 V"),
        ({}, (1, "out_voltage3_scale", None), "has no scale for out_voltage3_raw"),
        ({}, (1, "out_voltage3_scale", "big"), "has 'big' in out_voltage3_scale, which is not a number"),
        ({}, (0, "in_voltage1_raw", "?"), r"has '\?' in in_voltage1_raw, which is not a number"),
        (
            {"input_device": "iio:device0"},
            (0, "name", "ad5592r"),
            "exists more than once: give its folder",
        ),
    ],
)
def test_what_it_cannot_work_with_is_named_and_the_output_stays(tree, changes, broken, said):
    if broken:
        device, name, text = broken
        tree.file(device, name).unlink()
        if text is not None:
            tree.file(device, name).write_text(text + "\n")
    with pytest.raises(DriverError, match=rf"driver iio: cannot be opened: IIO device .*{said}"):
        tree.open(**changes)
    assert tree.raw == 2048


def test_a_device_may_be_named_by_its_folder(tree):
    tree.open(output_device="iio:device1", input_device="iio:device0").close()


def test_a_second_master_is_refused_until_the_first_has_gone(tree):
    first = tree.open()
    with pytest.raises(
        DriverError, match="is in use by another program at out_voltage3_raw; end the other program first"
    ):
        tree.open()
    first.close()
    tree.open().close()


@pytest.mark.parametrize(
    "changes", [{"input_channel": "current0"}, {"output_channel": "../x"}, {"output_raw_range": (4.0,)}]
)
def test_parameters_that_make_no_sense_are_refused(tree, changes):
    with pytest.raises(ParameterError, match="must be a voltage channel|give the least and the greatest"):
        tree.given(**changes)


@pytest.mark.slow
def test_between_emulated_converters_a_stage_moves_and_what_has_gone_comes_back(tmp_path):
    given = EmulatedConvertersParameters(directory=str(tmp_path / "iio"), amplifier=10.0, sensor=1.0e5)
    with start(given, Bench()) as running:
        device = Device(DRIVERS["iio"], running.driver, RATE)
        assert (device.capabilities.minimum, device.capabilities.maximum) == pytest.approx((0.0, 10.0), abs=1e-3)
        device.write([5.0])
        # 50 V at the actuator, about 36 µm, 3.6 V at the ADC
        until(lambda: 3.0 < device.read()[0] < 4.5)
        running.faults.add("cut:0:0.1")
        with pytest.raises(DriverError, match="has lost in_voltage0_raw|is absent"):
            until(lambda: device.read() is None)
        until(lambda: "cut" not in running.faults)
        # from the safe voltage
        assert until(lambda: tried(device))[0] < 3.0
        running.faults.add("error:0:0.1")
        with pytest.raises(DriverError, match="in_voltage0_raw"):
            until(lambda: device.read() is None)
        until(lambda: "error" not in running.faults)
        until(lambda: tried(device))
        device.close()
    assert not (tmp_path / "iio").exists()


def tried(device):
    """Read, or return None if the device cannot be read yet."""
    try:
        return device.read()
    except DriverError:
        return None


def test_emulated_converters_take_no_folder_that_is_there(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot be created .*give a folder that does not exist yet"):
        start(EmulatedConvertersParameters(directory=str(tmp_path)), Bench()).__enter__()
