"""Converters of the Linux subsystem *industrial I/O*, through sysfs."""

from __future__ import annotations

import contextlib
import pathlib
import tempfile
from collections.abc import Iterator

from hysteresis_ros.hardware.declaration import EmulatedDevice, HardwareDriver
from hysteresis_ros.hardware.drivers.iio.driver import IioDriver, IioParameters
from hysteresis_ros.hardware.drivers.iio.emulator import EmulatedConvertersParameters, start
from hysteresis_ros.hardware.emulation.bench import Bench
from hysteresis_ros.parameters import Parameters


@contextlib.contextmanager
def emulator() -> Iterator[Parameters]:
    """Give the parameters of emulated converters in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        given = EmulatedConvertersParameters(directory=str(pathlib.Path(folder) / "iio"))
        with start(given, Bench()) as running:
            yield running.driver


DRIVER = HardwareDriver(
    name="iio",
    title="a DAC and an ADC of Linux industrial I/O, through sysfs",
    parameters=IioParameters,
    driver=IioDriver,
    emulator=emulator,
    device=EmulatedDevice(EmulatedConvertersParameters, start),
)
