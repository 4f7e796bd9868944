# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An open device, guarded against errors of its driver; the rest of the package accesses devices only through it."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.hardware.driver import NOTHING_NEW, Capabilities, Compiled, DriverError, HardwareDriver
from hysteresis_ros.signals import Edge


class Device:
    """An open device. Every error of the driver becomes a DriverError that names the device.

    Parameters
    ----------
    declared : HardwareDriver
    parameters : Parameters
        Instance of the declared class.
    sample_rate : float
        [Hz]
    suits : callable, optional
        ``suits(capabilities)`` raises an error when the device is not suitable for the axis; the device is then
        released.

    Attributes
    ----------
    name : str
        For messages.
    capabilities : Capabilities

    Raises
    ------
    DriverError
        The device cannot be opened, or is not suitable.
    ParameterError
        The driver refuses its parameters.
    """

    def __init__(
        self,
        declared: HardwareDriver,
        parameters: Parameters,
        sample_rate: float,
        suits: Callable[[Capabilities], None] = lambda capabilities: None,
    ):
        self.name = f"driver {declared.name}:"
        if declared.package and importlib.util.find_spec(declared.package) is None:
            remedy = f"pip install 'hysteresis_ros[{declared.name}]'; docs/hardware.md states the version of Python"
            raise DriverError(self.name, f"needs the package {declared.package}, which is not installed", remedy)
        self._driver = declared.driver()
        self._open = True
        self._written: float | None = None
        #: Time at which a running call of ``read`` or ``write`` began [s]; None: no such call runs.
        self.called_at: float | None = None
        self._functions: _MethodFunctions | None = None
        #: The lock protects the attempts to make the device safe; the event ends the attempts in the background.
        self._calling, self._over = threading.RLock(), threading.Event()
        self._over.set()
        try:
            with self._named("cannot be opened", ParameterError):
                self.capabilities = self._driver.open(parameters, sample_rate)
            suits(self.capabilities)
        except BaseException:
            self.close()
            raise

    def __deepcopy__(self, memo) -> Device:
        """Return the object itself, because a copy of an axis shares the device."""
        return self

    @contextlib.contextmanager
    def _named(self, what: str, *passed: type[Exception], exits: bool = False) -> Iterator[None]:
        """Turn errors of the driver into a DriverError; ``exits``: in the main thread also SystemExit is an error."""
        if not self._open:
            raise DriverError(self.name, f"{what}: it is closed", "configure the node again")
        try:
            yield
        except passed:
            raise
        except BaseException as error:  # any error of a driver must make the axis safe, also SystemExit
            if not (exits or isinstance(error, Exception) or threading.current_thread() != threading.main_thread()):
                raise  # a signal during the start
            cause = _as_driver_error(error)
            raise DriverError(self.name, f"{what}: {cause.device} {cause.problem}", cause.remedy) from error

    @contextlib.contextmanager
    def _timed(self) -> Iterator[None]:
        self.called_at = time.monotonic()
        try:
            yield
        finally:
            self.called_at = None

    def read(self) -> tuple[float, ...]:
        """Return the position of each joint [position_unit], then the forces [N]; NaN without a measurement.

        Raises
        ------
        DriverError
            The device does not answer, or the answer has a wrong number of positions or forces, or an infinite
            position.
        """
        with self._named("cannot be read"), self._timed():
            return self._checked_reading()

    def _checked_reading(self) -> tuple[float, ...]:
        reading = self._driver.read()
        positions, forces = tuple(map(float, reading.positions)), tuple(map(float, reading.forces))
        if len(positions) != self.capabilities.joints:
            raise ValueError(f"{len(positions)} positions for {self.capabilities.joints} joints")
        if len(forces) != self.capabilities.forces:
            raise ValueError(f"{len(forces)} forces, but Capabilities.forces is {self.capabilities.forces}")
        if any(map(math.isinf, positions)):
            raise ValueError("an infinite position")
        return positions + forces

    def write(self, voltages: Sequence[float]) -> None:
        """Output voltages.

        Parameters
        ----------
        voltages : sequence of float
            [voltage_unit]

        Raises
        ------
        DriverError
            There are too many voltages, or one is not finite or out of the device's range (no voltage is sent in these
            cases), or the device refuses them.
        """
        with self._named("cannot be written"), self._timed():
            self._write_checked(voltages)

    def _write_checked(self, voltages: Sequence[float]) -> None:
        low, high = self.capabilities.minimum, self.capabilities.maximum
        if len(voltages) > self.capabilities.voltages:
            raise ValueError(f"{len(voltages)} voltages for {self.capabilities.voltages} outputs")
        for voltage in voltages:
            if not (math.isfinite(voltage) and low <= voltage <= high):
                unit = self.capabilities.voltage_unit
                raise ValueError(f"{voltage:g} {unit} is not within {low:g} … {high:g} {unit}")
        self.note(float(voltages[0]))
        self._driver.write(voltages)

    def output_clock(self, edges: Edge) -> None:
        """Output the scan edges of this sample: the beginnings of frames, lines and pixels.

        Parameters
        ----------
        edges : Edge

        Raises
        ------
        DriverError
            The device has no such outputs, or does not answer.
        """
        with self._named("cannot output the clock of the scan"):
            self._driver.output_clock(edges)

    def output_trigger(self, number: int, delay: float) -> None:
        """Output a trigger.

        Parameters
        ----------
        number : int
        delay : float
            Time from the trigger to the sample [s].

        Raises
        ------
        DriverError
            The device has no such output, or does not answer.
        """
        with self._named("cannot output a trigger"):
            self._driver.output_trigger(number, delay)

    def compare(self, up: Sequence[float], down: Sequence[float]) -> None:
        """Let the device output triggers at these positions.

        Parameters
        ----------
        up, down : sequence of float
            [position_unit]

        Raises
        ------
        DriverError
            The device cannot compare these positions, or does not answer.
        """
        with self._named("cannot compare the positions of its triggers"):
            self._driver.compare(up, down)

    def pulses(self) -> int:
        """Return the number of pulses at the trigger input since the last call.

        Raises
        ------
        DriverError
            The device has no such input, or does not answer.
        """
        with self._named("cannot read its trigger input"):
            return int(self._driver.pulses())

    def note(self, voltage: float) -> None:
        """Store a voltage that machine code has written to the device.

        Parameters
        ----------
        voltage : float
            Voltage of the first output [voltage_unit].
        """
        self._written = voltage

    def compiled(self) -> Compiled:
        """Return the functions by which machine code reads and writes the device.

        If the driver has no compiled form, these functions call its Python methods, with the interpreter lock.

        Raises
        ------
        DriverError
            The driver fails.
        """
        with self._named("has no compiled form"):
            found = self._driver.compiled()
        if found is not None:
            return found
        if self._functions is None:
            self._functions = _MethodFunctions(self)
        return self._functions.compiled

    @property
    def left_at(self) -> float | None:
        """Last voltage that was sent [voltage_unit]; None in the safe state, and before the first voltage."""
        if self._written is None or self._driver.last_output is None:
            return self._written
        return self._driver.last_output

    def make_safe(self) -> None:
        """Bring the device to its safe state; do nothing once it is closed.

        Raises
        ------
        DriverError
            The device does not answer; the message states the voltage that is still at the device's output.
        """
        if not self._open:
            return
        try:
            with self._named("cannot be made safe", exits=True):
                self._make_safe()
        except DriverError as error:
            if self.left_at is None:
                raise
            unit = self.capabilities.voltage_unit
            problem = f"{error.problem}: the output is still at {self.left_at:.6g} {unit}"
            remedy = f"switch the voltage off at the device itself; {error.remedy}"
            raise DriverError(error.device, problem, remedy) from error

    def _make_safe(self) -> None:
        with self._calling:
            self._driver.make_safe()
        self._written = None

    def insist(self, every: float, wanted: Callable[[], bool], done: Callable[[], None]) -> None:
        """Attempt to make the device safe, in the background, until it is safe; other calls wait for a running attempt.

        Parameters
        ----------
        every : float
            Time between two attempts [s].
        wanted : callable
            Returns whether the device must still be made safe; the attempts end otherwise.
        done : callable
            Called when the device is safe.
        """
        if self._over.is_set():
            over = self._over = threading.Event()
            threading.Thread(target=self._insist, args=(over, every, wanted, done), daemon=True).start()

    def _insist(self, over: threading.Event, every: float, wanted: Callable[[], bool], done: Callable[[], None]):
        while not over.wait(every):
            with self._calling:
                if over.is_set():
                    return
                with contextlib.suppress(DriverError):  # the first attempt has already reported the error
                    if wanted():
                        self.make_safe()
                        done()
                    over.set()

    def desist(self) -> None:
        """Stop the background attempts to make the device safe; wait for the end of a running attempt."""
        self._over.set()
        with self._calling:
            pass

    def close(self) -> str:
        """Make the device safe if a voltage was written, and release it; do nothing once it is closed.

        Returns
        -------
        str
            Problem that remains, for instance a voltage at the output; empty without a problem.
        """
        self.desist()
        if not self._open:
            return ""
        wrong = ""
        if self._written is not None:
            try:
                self.make_safe()
            except DriverError as error:
                wrong = str(error)
        # no caller can handle the error any more
        with contextlib.suppress(DriverError), self._named("cannot be closed", exits=True):
            self._driver.close()
        self._open = False
        return wrong


#: A fused run ends if a Python method has not returned after this time [s]; drivers have time-outs of their own.
METHOD_PATIENCE = 5.0

_NUMBERS = ctypes.POINTER(ctypes.c_double)
_COUNT = ctypes.POINTER(ctypes.c_int64)


class _MethodFunctions:
    """The Python methods of a driver as functions that machine code calls by their addresses.

    An exception becomes an error code: the number of the function that raised it. ``explain`` returns the exception of
    a code.
    """

    def __init__(self, device: Device):
        self._device = device
        self._errors: dict[int, DriverError] = {}
        can = device.capabilities
        #: kept here, because the address of a function does not keep the function alive
        self._kept = [
            self._function(1, self._read, _NUMBERS),
            self._function(2, self._write, _NUMBERS),
            self._function(3, device._make_safe),
            self._function(4, self._clock, ctypes.c_int64),
            self._function(5, device._driver.output_trigger, ctypes.c_int64, ctypes.c_double),
            self._function(6, self._pulses, _COUNT),
        ]
        read, write, make_safe, clock, trigger, pulses = (
            ctypes.cast(function, ctypes.c_void_p).value or 0 for function in self._kept
        )
        self.compiled = Compiled(
            read,
            write,
            make_safe,
            0,
            self._errors.__getitem__,
            clock if can.clock else 0,
            trigger if can.trigger_rate and not can.compares else 0,
            pulses if can.trigger_input else 0,
            METHOD_PATIENCE,
            calls_python=True,
        )

    def _function(self, number: int, method: Callable[..., int | None], *arguments: Any) -> Any:
        def call(handle, *given) -> int:
            try:
                if not self._device._open:
                    raise ValueError("it is closed")
                return method(*given) or 0
            except BaseException as error:  # any error of a driver must make the axis safe, also SystemExit
                self._errors[number] = _as_driver_error(error)
                return number

        return ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, *arguments)(call)

    def _read(self, positions) -> int:
        values = self._device._checked_reading()
        if math.isnan(values[0]):
            return NOTHING_NEW
        for place, value in enumerate(values):
            positions[place] = value
        return 0

    def _write(self, voltages) -> None:
        self._device._write_checked((voltages[0],))

    def _clock(self, edges: int) -> None:
        self._device._driver.output_clock(Edge(edges))

    def _pulses(self, count) -> None:
        count[0] = int(self._device._driver.pulses())


def _as_driver_error(error: BaseException) -> DriverError:
    """Return the error of a driver as a DriverError with a remedy."""
    if isinstance(error, DriverError):
        return error
    return DriverError(f"{type(error).__name__}:", str(error), "check the device, its connection and its driver")
