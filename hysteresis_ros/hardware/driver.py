# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a driver is: five methods between an axis and a device, its declaration, and the steps of taking a device.

The package keeps the time. Once a sample it reads the positions and, when the sample is over, writes the voltages that
are held until the next one. It watches over them (:mod:`hysteresis_ros.loop.device`) and never calls two methods at a
time; a method returns within a small part of a sample.
"""

from __future__ import annotations

import fcntl
import os
import pathlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, NamedTuple

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.registry import resolved


class DriverError(HysteresisError):
    """A device cannot be opened, does not answer, or is not what the axis needs.

    Parameters
    ----------
    device : str
        Which one, for instance driver and address.
    problem : str
        What is wrong, following the name.
    remedy : str
        What to do.
    """

    def __init__(self, device: str, problem: str, remedy: str):
        self.device, self.problem, self.remedy = device, problem, remedy
        super().__init__(f"{device} {problem}; {remedy}")


@dataclass(frozen=True)
class Capabilities:
    """What a device is able to do.

    Parameters
    ----------
    joints : int
        Positions that it reads.
    voltages : int
        Voltages that it puts out; an axis uses the first ones.
    minimum, maximum : float
        Range of what it can be told to put out [voltage_unit].
    highest_rate : float
        Samples per second that it can be read and written [Hz].
    watchdog : float or None
        Time without :meth:`Driver.write` after which the device goes to its safe state by itself [s], if it does.
    keeps_time : bool
        Whether the device decides when a sample is, and :meth:`Driver.read` waits for it. The package has no loop that
        follows a device: one that insists is refused.
    position_unit, voltage_unit : str
        Units of what is read and put out. Others than ``m`` and ``V`` are those of a device that knows nothing of what
        stands behind it: the parameters ``calibration`` of the plant's node, which have to name them, make m and V.
    forces : int
        Forces that it reads besides the positions [N]: of an axis that in the stack, or none.
    """

    joints: int
    voltages: int
    minimum: float
    maximum: float
    highest_rate: float
    watchdog: float | None = None
    keeps_time: bool = False
    position_unit: str = "m"
    voltage_unit: str = "V"
    forces: int = 0


class Compiled(NamedTuple):
    """Functions of an open device that machine code calls by their addresses, as in ``hysteresis_driver.h``."""

    #: ``int32_t read(void *device, double *positions)``: 0, an error code, or :data:`NOTHING_NEW`. Forces, if there are
    #: any, stand behind the positions.
    read: int
    #: ``int32_t write(void *device, const double *voltages)``: 0 or an error code.
    write: int
    #: ``int32_t make_safe(void *device)``: 0 or an error code.
    make_safe: int
    #: The device.
    device: int
    #: What an error code means.
    explain: Callable[[int], DriverError]


#: Result of reading: there is no measurement in this sample, and nothing is wrong.
NOTHING_NEW = -1


class Reading(NamedTuple):
    """What a device measures at a sample."""

    #: Position of each joint [position_unit]; NaN where there is none. What is not finite is not used.
    positions: tuple[float, ...]
    #: Forces [N], as many as the capabilities say; NaN where there is none.
    forces: tuple[float, ...] = ()


class Driver(ABC):
    """A device in the plant's place. Whatever goes wrong is a :class:`DriverError`.

    An instance is opened once. ``close`` is the last call, also after an ``open`` that failed.
    """

    @abstractmethod
    def open(self, parameters: Any, sample_rate: float) -> Capabilities:
        """Take the device, which nobody else may use from now on, and leave it in its safe state.

        Parameters
        ----------
        parameters : Parameters
            Of the class that is declared.
        sample_rate : float
            Rate at which it will be read and written [Hz].

        Raises
        ------
        DriverError
            It is not there, or somebody else uses it.
        """

    @abstractmethod
    def read(self) -> Reading:
        """Return the positions now.

        Raises
        ------
        DriverError
            The device does not answer, or not sensibly.
        """

    @abstractmethod
    def write(self, voltages: Sequence[float]) -> None:
        """Put out the voltages of the axis, and hold them.

        Parameters
        ----------
        voltages : sequence of float
            [voltage_unit], finite and within the range of the capabilities.

        Raises
        ------
        DriverError
            They cannot be put out.
        """

    def compiled(self) -> Compiled | None:
        """Return the functions by which machine code reads and writes the open device; None: only Python can.

        They are there until :meth:`close`.
        Without them the fused loop does not take the driver: Python would have to wait for its lock in each sample.
        """
        return None

    #: Voltage that the device was told last [voltage_unit], where the driver knows more than what was written.
    last_output: float | None = None

    @abstractmethod
    def make_safe(self) -> None:
        """Bring the device to its safe state, from any state; doing so twice changes nothing.

        Raises
        ------
        DriverError
            The device does not answer.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of the device, which is safe by then; doing so twice changes nothing."""


@dataclass(frozen=True, eq=False)
class EmulatedDevice:
    """A device that runs by itself, for ``hysteresis emulate``: the driver, or a program of others, is its master.

    Parameters
    ----------
    parameters : type of Parameters
        Options of the command besides the plant and its faults.
    start : callable
        ``start(parameters, bench)``, with a :class:`hysteresis_ros.laboratory.emulation.bench.Bench`, returns a context
        manager that gives the running device, a :class:`hysteresis_ros.laboratory.emulation.bench.Running`.
    """

    parameters: type[Parameters]
    start: Callable[[Any, Any], AbstractContextManager[Any]]


@dataclass(frozen=True, eq=False)
class HardwareDriver:
    """A driver: its name, class and parameters.

    Parameters
    ----------
    name : str
        ``driver`` of the plant's node.
    title : str
        A few words.
    parameters : type of Parameters
        What it is opened with: a group of the driver's name. One that wants nothing but what the plant's node has
        anyway names that class, for instance ``ActuatorParameters``, and has no group.
    driver : type of Driver
        Made without arguments.
    emulator : callable, optional
        ``emulator()`` returns a context manager that stands in for the device, or for its like, and gives the
        parameters to open it with: to try the driver without the device, and for the contract test. Only a library
        that is named by its path has none. :func:`hysteresis_ros.registry.later` imports its module only when it is
        called.
    device : EmulatedDevice or str, optional
        The like as a device of its own, or the dotted path ``package.module:DEVICE`` of it.
    package : str
        Module that it needs beyond those of the package, which the extra of the driver's name installs; '': none.
    """

    name: str
    title: str
    parameters: type[Parameters]
    driver: type[Driver]
    emulator: Callable[[], AbstractContextManager[Parameters]] | None = None
    device: EmulatedDevice | str | None = None
    package: str = ""

    @property
    def emulated(self) -> EmulatedDevice | None:
        """The device, imported where only its path is named."""
        return resolved(self.device) if isinstance(self.device, str) else self.device


#: Steps of a ramp.
STEPS = 20
#: Samples that are tried, the part of them that the highest rate is for, and how much of a sample a driver may take.
TRIALS, SURE, SHARE = 50, 0.9, 0.5


def claim(path: pathlib.Path, name: str) -> int:
    """Take the file of a device for this process and return what holds it, until that is closed.

    Parameters
    ----------
    path : pathlib.Path
    name : str
        Of the device, for messages.

    Raises
    ------
    DriverError
        It cannot be opened, or another process has it.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError as error:
        raise DriverError(name, f"cannot be opened ({error})", "look at its address and its cable") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        raise DriverError(name, f"has another master at {path.name}", "end the other program first") from None
    return file


def ramp(put_out: Callable[[float], None], start: float, end: float, duration: float) -> None:
    """Take a voltage to another one in equal steps.

    Parameters
    ----------
    put_out : callable
        Puts a voltage out [V].
    start, end : float
        [V]
    duration : float
        [s]
    """
    for step in range(1, STEPS) if start != end else ():
        put_out(start + (end - start) * step / STEPS)
        time.sleep(duration / STEPS)
    put_out(end)


def highest_rate(write: Callable[[], None], read: Callable[[], object]) -> float:
    """Return at which rate nearly all samples leave time for the rest of an axis [Hz].

    Parameters
    ----------
    write, read : callable
        What is done once a sample.
    """
    durations = []
    for _ in range(TRIALS):
        begun = time.perf_counter()
        write()
        read()
        durations.append(time.perf_counter() - begun)
    return SHARE / sorted(durations)[int(SURE * TRIALS)]
