# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The contract of a driver: five methods between an axis and a device, its declaration, and helpers for drivers.

The package sets the sample times. In each sample it reads the positions and, at the end of the sample, writes the
voltages; the device holds them until the next write. The package supervises reading and writing
(:mod:`hysteresis_ros.loop.device`), and never calls two methods at the same time. A method must return within a small
fraction of a sample.
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
from hysteresis_ros.signals import Edge


class DriverError(HysteresisError):
    """A device cannot be opened, does not answer, or is not suitable for the axis.

    Parameters
    ----------
    device : str
        Name of the device, for instance with driver and address.
    problem : str
        Problem; follows the name in the message.
    remedy : str
        What to do.
    """

    def __init__(self, device: str, problem: str, remedy: str):
        self.device, self.problem, self.remedy = device, problem, remedy
        super().__init__(f"{device} {problem}; {remedy}")


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a device.

    Parameters
    ----------
    joints : int
        Number of positions that the device reads.
    voltages : int
        Number of voltages that the device outputs; an axis uses the first of them.
    minimum, maximum : float
        Range of the device's output [voltage_unit].
    highest_rate : float
        Highest rate at which the device can be read and written [Hz].
    watchdog : float or None
        Time without :meth:`Driver.write` after which the device goes to its safe state by itself [s]; None: no
        watchdog.
    keeps_time : bool
        Whether the device sets the sample times and :meth:`Driver.read` waits for them. The package refuses such a
        device, because no loop of the package follows a device.
    position_unit, voltage_unit : str
        Units of the readings and of the output. The parameters ``calibration`` of the plant's node convert other units
        than ``m`` and ``V`` and must name them.
    forces : int
        Number of forces [N] that the device reads in addition to the positions; for an axis 0, or 1 (the force in the
        stack).
    clock : bool
        Whether the device outputs the frame, line and pixel clock of a scan (:meth:`Driver.output_clock`).
    trigger_rate : float
        Highest trigger rate of the device [Hz]; 0: no output for triggers.
    compares : bool
        Whether the device outputs triggers by comparing positions itself (:meth:`Driver.compare`); otherwise the loop
        requests each trigger (:meth:`Driver.output_trigger`).
    trigger_input : bool
        Whether the device has a trigger input (:meth:`Driver.pulses`).
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
    clock: bool = False
    trigger_rate: float = 0.0
    compares: bool = False
    trigger_input: bool = False


class Compiled(NamedTuple):
    """Functions of an open device that machine code calls by their addresses, as in ``hysteresis_driver.h``."""

    #: ``int32_t read(void *device, double *positions)``: 0, an error code, or :data:`NOTHING_NEW`. Forces, if any,
    #: follow the positions.
    read: int
    #: ``int32_t write(void *device, const double *voltages)``: 0 or an error code.
    write: int
    #: ``int32_t make_safe(void *device)``: 0 or an error code.
    make_safe: int
    #: The handle of the device.
    device: int
    #: Explains an error code.
    explain: Callable[[int], DriverError]
    #: ``int32_t clock(void *device, int64_t edges)``: 0 or an error code; 0: the device has no outputs for the clock.
    clock: int = 0
    #: ``int32_t trigger(void *device, int64_t number, double delay)``: 0 or an error code; 0: no output for triggers.
    trigger: int = 0
    #: ``int32_t pulses(void *device, int64_t *count)``: 0 or an error code; 0: no trigger input.
    pulses: int = 0
    #: The run ends when a function has not returned after this time [s].
    patience: float = 0.5
    #: Whether the functions call Python methods, and so wait for the interpreter lock.
    calls_python: bool = False


#: Remedy for a device without an output for triggers.
NO_TRIGGERS = "set trigger_output: false; the topic trigger_out has the triggers"

#: Result of ``read`` for a sample without a measurement; not an error.
NOTHING_NEW = -1


class Reading(NamedTuple):
    """Measurements of a device in a sample."""

    #: Position of each joint [position_unit]; NaN without a measurement. An infinite value is an error.
    positions: tuple[float, ...]
    #: Forces [N], as many as in the capabilities; NaN without a measurement.
    forces: tuple[float, ...] = ()


class Driver(ABC):
    """Base class of the drivers, for a device that replaces the plant. Every error is a :class:`DriverError`.

    An instance is opened once. ``close`` is the last call, also after a failure of ``open``.
    """

    @abstractmethod
    def open(self, parameters: Any, sample_rate: float) -> Capabilities:
        """Open the device for exclusive use, and leave it in its safe state.

        Parameters
        ----------
        parameters : Parameters
            Instance of the declared class.
        sample_rate : float
            Rate at which the device will be read and written [Hz].

        Raises
        ------
        DriverError
            The device is absent, or another process uses it.
        """

    @abstractmethod
    def read(self) -> Reading:
        """Return the present positions.

        Raises
        ------
        DriverError
            The device does not answer, or its answer is invalid.
        """

    @abstractmethod
    def write(self, voltages: Sequence[float]) -> None:
        """Output the voltages of the axis; the device holds them until the next call.

        Parameters
        ----------
        voltages : sequence of float
            [voltage_unit], finite and within the range of the capabilities.

        Raises
        ------
        DriverError
            The voltages cannot be written.
        """

    def output_clock(self, edges: Edge) -> None:
        """Output the scan edges of this sample (beginnings of frames, lines, pixels), e.g. as digital pulses; optional.

        This method is called after :meth:`write` of the same sample, only if the capabilities contain ``clock`` and the
        plant's node has ``scan_clock: true``. In nodes that exchange messages it is called when the message on
        ``scan_clock`` arrives. It is also called in skipped samples, in which no voltage is written.

        Parameters
        ----------
        edges : Edge
            One or more of ``Edge.FRAME``, ``Edge.LINE`` and ``Edge.PIXEL``.

        Raises
        ------
        DriverError
            The device does not answer, or (by default) has no such outputs.
        """
        remedy = "set scan_clock: false; the topic scan_clock has the clock"
        raise DriverError(type(self).__name__, "has no outputs for the clock of a scan", remedy)

    def output_trigger(self, number: int, delay: float) -> None:
        """Output a trigger, for instance a pulse on a digital line; optional.

        This method is called after :meth:`write` of the sample after the trigger, only if the capabilities contain a
        ``trigger_rate`` above 0 and the plant's node has ``trigger_output: true``. In nodes that exchange messages it
        is called when the message on ``trigger_out`` arrives.

        Parameters
        ----------
        number : int
            Number of the trigger, from 1; the numbers of triggers that followed others too fast are missing.
        delay : float
            Time from the trigger to the sample [s], for a device that compensates for it.

        Raises
        ------
        DriverError
            The device does not answer, or (by default) has no such output.
        """
        raise DriverError(type(self).__name__, "has no output for triggers", NO_TRIGGERS)

    def compare(self, up: Sequence[float], down: Sequence[float]) -> None:
        """Output a trigger at each of these positions; optional.

        The device measures the position by itself and outputs triggers from the next :meth:`write` until
        :meth:`make_safe`. This method is called once after :meth:`open`, only if the capabilities contain ``compares``.

        Parameters
        ----------
        up, down : sequence of float
            Increasing positions that trigger when passed upwards, and when passed downwards [position_unit].

        Raises
        ------
        DriverError
            The device cannot compare these positions, or (by default) any positions.
        """
        raise DriverError(type(self).__name__, "does not compare positions", NO_TRIGGERS)

    def pulses(self) -> int:
        """Return the number of pulses at the trigger input since the last call; optional.

        This method is called after :meth:`read`, only if the capabilities contain ``trigger_input`` and the plant's
        node has ``trigger_input: true``.

        Raises
        ------
        DriverError
            The device does not answer, or (by default) has no such input.
        """
        remedy = "set trigger_input: false; the topic trigger_in takes messages"
        raise DriverError(type(self).__name__, "has no trigger input", remedy)

    def compiled(self) -> Compiled | None:
        """Return the functions with which compiled code accesses the open device; None: only Python methods.

        The functions stay valid until :meth:`close`. Without them the fused loop calls the Python methods, and waits
        for the interpreter lock in each sample.
        """
        return None

    #: Last voltage sent to the device [voltage_unit], if it can differ from the last argument of :meth:`write`.
    last_output: float | None = None

    @abstractmethod
    def make_safe(self) -> None:
        """Bring the device to its safe state, from any state; idempotent.

        Raises
        ------
        DriverError
            The device does not answer.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the device, which is already in its safe state; idempotent."""


@dataclass(frozen=True, eq=False)
class EmulatedDevice:
    """An emulated device in a separate process (``hysteresis emulate``), for a driver or another program.

    Parameters
    ----------
    parameters : type of Parameters
        Options of the command, besides the plant and its faults.
    start : callable
        ``start(parameters, bench)`` starts the device on a :class:`hysteresis_ros.laboratory.emulation.bench.Bench`. It
        returns a context manager, which yields a :class:`hysteresis_ros.laboratory.emulation.bench.Running`.
    """

    parameters: type[Parameters]
    start: Callable[[Any, Any], AbstractContextManager[Any]]


@dataclass(frozen=True, eq=False)
class HardwareDriver:
    """A driver: its name, class and parameters.

    Parameters
    ----------
    name : str
        Value of ``driver`` of the plant's node.
    title : str
        Short description.
    parameters : type of Parameters
        Class of the parameters for :meth:`Driver.open`, a group with the driver's name. A driver without a group of
        its own uses a class of the plant's node instead, for instance ``ActuatorParameters``.
    driver : type of Driver
        Class of the driver; its constructor has no arguments.
    emulator : callable, optional
        ``emulator()`` returns a context manager that emulates the device and yields the parameters for opening it. The
        contract test and other tests without the device need it. Only a library at a path has no emulator.
        :func:`hysteresis_ros.registry.later` imports the emulator's module only when it is called.
    device : EmulatedDevice or str, optional
        The emulated device in a separate process, or the path ``package.module:DEVICE`` of its declaration.
    package : str
        Additional module that the driver needs; the extra with the driver's name installs it; '': none.
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
        """The emulated device, imported if only its path is given."""
        return resolved(self.device) if isinstance(self.device, str) else self.device


#: Number of steps of a ramp.
STEPS = 20
#: Number of trial samples.
TRIALS = 50
#: Fraction of the trial samples that must be fast enough at the highest rate.
SURE = 0.9
#: Largest fraction of the sample period that a driver may use at the highest rate.
SHARE = 0.5


def claim(path: pathlib.Path, name: str) -> int:
    """Lock the file of a device for this process and return the descriptor; the lock lasts until it is closed.

    Parameters
    ----------
    path : pathlib.Path
    name : str
        Name of the device, for messages.

    Raises
    ------
    DriverError
        The file cannot be opened, or another process holds the lock.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError as error:
        raise DriverError(name, f"cannot be opened ({error})", "check its address and its cable") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        raise DriverError(name, f"is in use by another program at {path.name}", "end the other program first") from None
    return file


def ramp(put_out: Callable[[float], None], start: float, end: float, duration: float) -> None:
    """Ramp a voltage in equal steps.

    Parameters
    ----------
    put_out : callable
        Outputs a voltage [V].
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
    """Return the rate [Hz] at which 90 % of the trial samples leave half of the sample period to the axis.

    Parameters
    ----------
    write, read : callable
        Called once per sample.
    """
    durations = []
    for _ in range(TRIALS):
        begun = time.perf_counter()
        write()
        read()
        durations.append(time.perf_counter() - begun)
    return SHARE / sorted(durations)[int(SURE * TRIALS)]
