# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A device that replaces the simulated plant, accessed from Python or by functions that machine code calls.

The functions of a driver in C do not need Python's lock and allocate no memory; for a driver in Python, they call its
methods. The voltages are monitored as for the simulated plant. If a device returns an error, or a position that is not
a number, the axis stops in that sample: the device is made safe immediately, and is not used until the axis is started
again.

The limits come from the parameter file and must lie within the device's range.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import NO_TRIGGERS, NOTHING_NEW, Capabilities, Compiled, DriverError
from hysteresis_ros.hardware.library import nonsense
from hysteresis_ros.hardware.registry import driver_of
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.parameters import PlantNodeParameters
from hysteresis_ros.loop.plant import (
    DEVICE_FAILED,
    FINDING_HOME,
    NOT_TRIPPED,
    PLANTS,
    TRIP,
    Plant,
    PlantWatchArrays,
    actuate,
    no_joints,
    sense,
    tell_joints,
    told_force,
    watched_voltage,
)
from hysteresis_ros.loop.watch import FOLLOWS, GIVEN, HELD, HELD_AGE, HELD_BEGUN, SAFE, hold_state, hold_voltage
from hysteresis_ros.models.block import COMPILED, interpreted, kernel, nested
from hysteresis_ros.models.calibration import (
    HOMING,
    AmplifierCalibration,
    SensorCalibration,
    amplifier_value,
    sensor_displacement,
)
from hysteresis_ros.models.limits import FLAGS, LIMITED_SAMPLES, OUTPUT, UNQUANTISED, Limits, LimitsParameters, limits

# Link to the device, int64: the addresses of its functions, of the device and of this array itself. The addresses of
# the functions for clock, triggers and trigger input are 0 if these are not used. In a copy of the arrays, SELF differs
# from the address of the copy, so a copy never accesses the device.
READ, WRITE, MAKE_SAFE, DEVICE, SELF, CLOCK, TRIGGER, PULSES = range(8)
LINKS = 8

# Failure, int64: the function that failed, its error code, and the error code of the attempt to make the device safe.
FAILED, CODE, SAFE_CODE = range(3)
ANSWERS = 3
#: Values of ``FAILED``: nothing, reading, writing, a position that is not a number, the clock of a scan, a trigger, the
#: trigger input.
NOTHING, READING, WRITING, NONSENSE, CLOCKING, TRIGGERING, PULSING = range(7)
#: Text for messages: what the device could not do, after "cannot".
_DEEDS = {READING: "be read", WRITING: "be written", NONSENSE: "be read", CLOCKING: "output the clock of the scan"}
_DEEDS |= {TRIGGERING: "output a trigger", PULSING: "read its trigger input"}


class DevicePlantArrays(NamedTuple):
    """All arrays of a device in the loop."""

    link: np.ndarray
    answer: np.ndarray
    #: Buffers of the device's positions, followed by forces, and of its voltages, all in the units of the device.
    positions: np.ndarray
    voltages: np.ndarray
    #: Buffer of the number of pulses at the trigger input, int64.
    pulses: np.ndarray
    #: Last voltage [V] of a device that could not be made safe.
    left: np.ndarray
    limits_p: np.ndarray
    limits_x: np.ndarray
    sensor_p: np.ndarray
    sensor_x: np.ndarray
    amplifier_p: np.ndarray
    watch_p: PlantWatchArrays
    watch_x: PlantWatchArrays


def link_to(
    compiled: Compiled | None, clock: bool = False, trigger_output: bool = False, trigger_input: bool = False
) -> np.ndarray:
    """Return the link array of a device, with the addresses of the functions that are used; zeros without a device."""
    link = np.zeros(LINKS, dtype=np.int64)
    if compiled is not None:
        link[CLOCK] = compiled.clock if clock else 0
        link[TRIGGER] = compiled.trigger if trigger_output else 0
        link[PULSES] = compiled.pulses if trigger_input else 0
        link[:SELF] = compiled.read, compiled.write, compiled.make_safe, compiled.device
        link[SELF] = link.ctypes.data
    return link


if COMPILED:
    from llvmlite import ir
    from numba import extending, types

    #: Decorator of functions whose first argument, the typing context, is passed by Numba and not by the caller.
    intrinsic: Any = extending.intrinsic

    def _caller(count: int, numbers: int = 0, reals: int = 0) -> Any:
        """Return a caller of ``int32_t`` functions with ``count`` pointers, then int64_t numbers, then doubles.

        Addresses are data, so that the code can be cached.
        """

        def generate(context, builder, signature, arguments):
            pointer = ir.IntType(8).as_pointer()
            given = [pointer] * count + [ir.IntType(64)] * numbers + [ir.DoubleType()] * reals
            kind = ir.FunctionType(ir.IntType(32), given)
            function = builder.inttoptr(arguments[0], kind.as_pointer())
            pointers = [builder.inttoptr(item, pointer) for item in arguments[1 : count + 1]]
            code = builder.call(function, [*pointers, *arguments[count + 1 :]])
            return builder.sext(code, ir.IntType(64))

        return types.int64(*(types.int64,) * (count + numbers + 1), *(types.float64,) * reals), generate

    @intrinsic
    def _call_with(typing_context: Any, address, device, values):
        return _caller(2)

    @intrinsic
    def _call_alone(typing_context: Any, address, device):
        return _caller(1)

    @intrinsic
    def _call_number(typing_context: Any, address, device, number):
        return _caller(1, numbers=1)

    @intrinsic
    def _call_event(typing_context: Any, address, device, number, real):
        return _caller(1, numbers=1, reals=1)

    @kernel
    def call_with(link, which, values):
        """Call a function of the device that takes an array; return its code."""
        return _call_with(link[which], link[DEVICE], values.ctypes.data)

    @kernel
    def call_alone(link, which):
        """Call a function of the device without further arguments; return its code."""
        return _call_alone(link[which], link[DEVICE])

    @kernel
    def call_number(link, which, number):
        """Call a function of the device that takes a whole number; return its code."""
        return _call_number(link[which], link[DEVICE], int(number))

    @kernel
    def call_event(link, which, number, real):
        """Call a function of the device with a whole and a real argument; return its code."""
        return _call_event(link[which], link[DEVICE], int(number), real)

else:
    _NUMBER = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int64)
    _EVENT = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int64, ctypes.c_double)
    _WITH = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)
    _ALONE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)

    def call_with(link, which, values):
        """Call a function of the device that takes an array; return its code."""
        return _WITH(int(link[which]))(int(link[DEVICE]), values.ctypes.data)

    def call_alone(link, which):
        """Call a function of the device without further arguments; return its code."""
        return _ALONE(int(link[which]))(int(link[DEVICE]))

    def call_number(link, which, number):
        """Call a function of the device that takes a whole number; return its code."""
        return _NUMBER(int(link[which]))(int(link[DEVICE]), int(number))

    def call_event(link, which, number, real):
        """Call a function of the device with a whole and a real argument; return its code."""
        return _EVENT(int(link[which]))(int(link[DEVICE]), int(number), float(real))


@nested
def is_linked(link):
    """Tell whether a link array belongs to a device and is not a copy."""
    return link[SELF] != 0 and link[SELF] == link.ctypes.data


@nested
def rest_device(limits_x, watch_p, watch_x):
    """Continue from the safe voltage."""
    safe, hold = watch_p.hold[SAFE], watch_x.hold
    hold[HELD] = hold[GIVEN] = limits_x[OUTPUT] = limits_x[UNQUANTISED] = safe
    hold[HELD_AGE] = hold[HELD_BEGUN] = hold[FOLLOWS] = 0.0


@nested
def fail_device(arrays, failed, code):
    """Stop the axis and make the device safe, if it still responds."""
    arrays.watch_x.trip[TRIP] = DEVICE_FAILED
    arrays.left[0] = arrays.limits_x[OUTPUT]
    rest_device(arrays.limits_x, arrays.watch_p, arrays.watch_x)
    if is_linked(arrays.link):
        arrays.answer[FAILED], arrays.answer[CODE] = failed, code
        arrays.answer[SAFE_CODE] = call_alone(arrays.link, MAKE_SAFE)


@nested
def output_of_device(arrays):
    """Return the output voltage [V], which is not the safe voltage if the device could not be made safe."""
    left = arrays.watch_x.trip[TRIP] == DEVICE_FAILED and arrays.answer[SAFE_CODE] != 0
    return arrays.left[0] if left else arrays.limits_x[OUTPUT]


@nested
def read_device(arrays):
    """Return the measurement [m] of the device; NaN if there is no new measurement."""
    code = call_with(arrays.link, READ, arrays.positions)
    reading = arrays.positions[0]
    if code == NOTHING_NEW:
        return math.nan
    if code != 0:
        fail_device(arrays, READING, code)
        return math.nan
    if not math.isfinite(reading):
        fail_device(arrays, NONSENSE, 0)
        return math.nan
    return sensor_displacement(arrays.sensor_p, arrays.sensor_x, reading)


@nested
def take_pulses(arrays, row):
    """Add the pulses at the device's trigger input to the pulses of the sample."""
    if arrays.link[PULSES] != 0 and arrays.watch_x.trip[TRIP] != DEVICE_FAILED:
        code = call_with(arrays.link, PULSES, arrays.pulses)
        if code != 0:
            fail_device(arrays, PULSING, code)
        else:
            row[at.TRIGGER_IN] += arrays.pulses[0]


@nested
def stop_for_homing(trip, homing):
    """Keep the axis at its safe voltage while its sensor is homed, then let it continue."""
    if homing and trip[TRIP] == NOT_TRIPPED:
        trip[TRIP] = FINDING_HOME
    elif not homing and trip[TRIP] == FINDING_HOME:
        trip[TRIP] = NOT_TRIPPED


@nested
def sense_device(laws, arrays, row):
    """Read the device; in the repetition of a recorded run, the row already contains readings and output voltage."""
    faulty.begin_sample(arrays.watch_x.faults)
    trip = arrays.watch_x.trip
    recorded = row[at.PLANT_VOLTAGE]
    if is_linked(arrays.link):
        asked = trip[TRIP] != DEVICE_FAILED and row[at.SKIPPED] == 0.0
        row[at.MEASURED] = read_device(arrays) if asked else math.nan
        if asked:
            take_pulses(arrays, row)
        there = row[at.MEASURED] == row[at.MEASURED] and arrays.positions.shape[0] > 1
        row[at.FORCE] = told_force(arrays.watch_p, arrays.watch_x, arrays.positions[1] if there else math.nan)
        stop_for_homing(trip, arrays.sensor_x[HOMING] > 0.0)
    elif row[at.TRIPPED] == DEVICE_FAILED and trip[TRIP] != DEVICE_FAILED:
        fail_device(arrays, READING, 0)
    else:
        stop_for_homing(trip, row[at.TRIPPED] == FINDING_HOME)
    if not is_linked(arrays.link) and trip[TRIP] == DEVICE_FAILED:
        arrays.answer[SAFE_CODE] = 1 if recorded == arrays.left[0] else 0
    row[at.DISPLACEMENT] = math.nan
    row[at.PLANT_VOLTAGE] = output_of_device(arrays)
    row[at.TRIPPED] = trip[TRIP]


@nested
def output_events(arrays, row):
    """Output the scan edges and the trigger of this sample, if the device must output them."""
    if row[at.SCAN_EDGES] != 0.0 and arrays.link[CLOCK] != 0 and is_linked(arrays.link):
        code = call_number(arrays.link, CLOCK, row[at.SCAN_EDGES])
        if code != 0:
            fail_device(arrays, CLOCKING, code)
            return
    if row[at.TRIGGER] != 0.0 and arrays.link[TRIGGER] != 0 and is_linked(arrays.link):
        code = call_event(arrays.link, TRIGGER, row[at.TRIGGER], row[at.TRIGGER_DELAY])
        if code != 0:
            fail_device(arrays, TRIGGERING, code)


@nested
def actuate_device(laws, arrays, row):
    """Output the voltage of the row after monitoring.

    In a skipped sample no voltage is written: the device holds the last voltage, even on the way to or from the safe
    voltage. Scan edges and triggers are still output, so that their number stays correct.
    """
    trip, hold = arrays.watch_x.trip, arrays.watch_x.hold
    failed = trip[TRIP] == DEVICE_FAILED
    before = hold[HELD]
    held = watched_voltage(arrays.watch_p, arrays.watch_x, row)
    if failed:
        trip[TRIP] = DEVICE_FAILED
        rest_device(arrays.limits_x, arrays.watch_p, arrays.watch_x)
        row[at.PLANT_VOLTAGE] = output_of_device(arrays)
        return
    if row[at.SKIPPED] != 0.0:
        hold[HELD] = before
        row[at.PLANT_VOLTAGE] = arrays.limits_x[OUTPUT]
        output_events(arrays, row)
        return
    arrays.voltages[0] = amplifier_value(arrays.amplifier_p, limits(arrays.limits_p, arrays.limits_x, held))
    row[at.PLANT_VOLTAGE] = arrays.limits_x[OUTPUT]
    if is_linked(arrays.link):
        code = call_with(arrays.link, WRITE, arrays.voltages)
        if code != 0:
            fail_device(arrays, WRITING, code)
            return
    output_events(arrays, row)


sense.kinds[DevicePlantArrays], actuate.kinds[DevicePlantArrays] = sense_device, actuate_device
tell_joints.kinds[DevicePlantArrays] = no_joints


_TOLD = interpreted(told_force)

#: Seconds between two attempts to make a device safe after a failed attempt.
INSIST = 1.0


class DrivenPlant(Plant):
    """A device with one actuator, driven from Python.

    After opening and after :meth:`make_safe` the device is assumed to be at ``safe_voltage``. ``travel`` [m] is the
    allowed range of the measurement; by default the range of a single axis, computed from the model in the parameter
    file.
    """

    #: Samples of this plant are not compiled.
    kernels = None, None, None
    #: Seconds between two attempts to make the device safe.
    insists_every = INSIST

    _failure = ""
    #: Reason why the device could not be made safe, and the voltage [V] that it still outputs.
    _left, _left_at = "", math.nan

    def __init__(self, parameters: PlantNodeParameters, travel: Sequence[float] | None = None):
        low, high = parameters.allowed_travel if travel is None else travel
        self._travel = float(low), float(high)
        self.limits = Limits(_without_grid(parameters.limits), 1.0 / parameters.sample_rate)
        self.sensor = SensorCalibration(parameters.calibration.sensor, 1.0 / parameters.sample_rate)
        self.amplifier = AmplifierCalibration(parameters.calibration.amplifier)
        super().__init__(parameters)
        self.arrays = self
        self._device: Device | None = None
        for voltage in (0.0, math.nan):  # compile now, not at the first sample
            row = {at.VOLTAGE: voltage, at.MEASURED: 0.0, at.SKIPPED: 0.0}
            self.amplifier.value(self.limits.step(watched_voltage(self._watch_p, self._watch_x, row)))
        self.sensor.step(math.nan)
        self.reset()
        self._at_rest()
        self._open(parameters)

    def _open(self, parameters: PlantNodeParameters) -> None:
        declared = driver_of(parameters.driver)
        self._device = Device(declared, parameters.driver_parameters, parameters.sample_rate, self._require)
        if parameters.trigger_output and self.capabilities.compares:
            try:
                self._device.compare(*self._compared())
            except DriverError:
                self._device.close()
                raise

    def _compared(self) -> tuple[list[float], list[float]]:
        """Return the trigger positions for upward and downward motion, in the units and the direction of the device."""
        given, sensor = self.parameters.triggers, self.parameters.calibration.sensor
        up, down = (sorted(map(self.sensor.reading, positions)) for positions in (given.up, given.down))
        return (up, down) if sensor.sign > 0 else (down, up)

    @property
    def failure(self) -> str:
        """Error of a device that has stopped the axis, and the voltage that it may still output."""
        left = self._left  # read once, because another thread may clear it meanwhile
        return f"{self._failure}; the device {left}" if left else self._failure

    def _require(self, can: Capabilities) -> None:
        """Raise a DriverError if the device does not meet the requirements of the axis."""
        parameters, device = self.parameters, f"driver {self.parameters.driver}:"
        low, high, rate = parameters.limits.minimum, parameters.limits.maximum, parameters.sample_rate
        if can.keeps_time:
            remedy = "the loop must set them: let the driver sample the device, or write a node (docs/hardware.md)"
            raise DriverError(device, "the device sets the sample times itself", remedy)
        units, given = (can.position_unit, can.voltage_unit), parameters.calibration
        if units != (given.sensor.unit, given.amplifier.unit):
            remedy = f"calibration.sensor.unit is {given.sensor.unit!r} and calibration.amplifier.unit "
            remedy += f"{given.amplifier.unit!r}: give the device's units there, with scale, offset and sign"
            raise DriverError(device, f"the device reads {units[0]!r} and outputs {units[1]!r}", remedy)
        if parameters.scan_clock and not can.clock:
            remedy = "set scan_clock: false; the topic scan_clock has the clock"
            raise DriverError(device, "the device has no outputs for the clock of a scan", remedy)
        self._require_triggers(can, device)
        if can.joints != 1:
            raise DriverError(device, f"the device has {can.joints} joints", "an axis has 1: choose another device")
        if not 0 <= can.forces <= 1:
            raise DriverError(device, f"the device has {can.forces} forces", "an axis has 0 or 1")
        if can.voltages < 1:
            raise DriverError(device, "the device has no voltage output", "an axis needs 1: choose another device")
        least, most = sorted(map(self.amplifier.value, (low, high)))
        if not (can.minimum <= least and most <= can.maximum):
            problem = f"the device's range of {can.minimum:g} … {can.maximum:g} {units[1]} does not contain "
            problem += f"limits.minimum … limits.maximum = {low:g} … {high:g} V"
            problem += "" if (least, most) == (low, high) else f", which are {least:g} … {most:g} {units[1]}"
            remedy = "narrow the limits of plant_simulator and hysteresis_compensator; a commissioning has them from "
            raise DriverError(device, problem, f"{remedy}minimum and maximum of /commissioning")
        if not rate <= can.highest_rate:
            raise DriverError(device, f"the device supports at most {can.highest_rate:g} Hz", "lower sample_rate")
        if can.watchdog is not None and not can.watchdog * rate > 1.0:
            problem = f"the device's watchdog of {can.watchdog:g} s is not longer than a sample of {1.0 / rate:g} s"
            raise DriverError(device, problem, "raise sample_rate, or set a longer watchdog")

    def _require_triggers(self, can: Capabilities, device: str) -> None:
        """Raise a DriverError if the device lacks a trigger output or a trigger input that the axis needs."""
        parameters = self.parameters
        given = parameters.triggers
        if parameters.trigger_input and not can.trigger_input:
            remedy = "set trigger_input: false; the topic trigger_in takes messages"
            raise DriverError(device, "the device has no trigger input", remedy)
        if not parameters.trigger_output:
            return
        if not given.makes_events:
            remedy = "give plant_simulator the triggers of the reference generator too, or start it with hysteresis up"
            raise DriverError(device, "trigger_output is true, but the node has no triggers", remedy)
        if not can.trigger_rate > 0.0:
            raise DriverError(device, "the device has no output for triggers", NO_TRIGGERS)
        wanted = given.rate or parameters.sample_rate
        if wanted > can.trigger_rate:
            asked = f"triggers.rate = {given.rate:g}" if given.rate else "triggers.rate = 0 (at most one per sample)"
            problem = f"the device outputs at most {can.trigger_rate:.6g} triggers/s, but {asked} allows {wanted:g}"
            raise DriverError(device, problem, f"set triggers.rate: {math.floor(can.trigger_rate):d}")
        if can.compares and not given.compares:
            remedy = "give positions, or trigger_output: false; the topic trigger_out has the triggers"
            raise DriverError(device, "the device compares positions itself: triggers.positions is empty", remedy)
        if can.compares and parameters.calibration.sensor.reference == "relative":
            remedy = "set trigger_output: false; the topic trigger_out has the triggers"
            raise DriverError(device, "the device compares positions, which are unknown until it is homed", remedy)

    @property
    def _opened(self) -> Device:
        """The device; available after :meth:`_open`."""
        if self._device is None:
            raise RuntimeError(f"driver {self.parameters.driver} is not open")
        return self._device

    @property
    def called_at(self) -> float | None:
        """Time at which a running call of the driver began [s]; None: no call runs."""
        return self._opened.called_at

    @property
    def capabilities(self) -> Capabilities:
        """Properties of the device, as its driver reports them."""
        return self._opened.capabilities

    @property
    def measures_force(self) -> bool:
        """Whether the device has a force sensor."""
        return self.capabilities.forces > 0

    @property
    def description(self) -> str:
        """One line about the device."""
        can = self.capabilities
        text = f"driver {self.parameters.driver}: {can.minimum:g} … {can.maximum:g} {can.voltage_unit}, "
        text += f"up to {can.highest_rate:g} Hz; " if math.isfinite(can.highest_rate) else "any rate; "
        if can.watchdog is None:
            return f"{text}no watchdog of its own: if this node is killed, the last voltage stays on the device"
        return f"{text}its watchdog acts after {can.watchdog:g} s"

    @property
    def _range(self) -> tuple[float, float]:
        return self.capabilities.minimum, self.capabilities.maximum

    @property
    def resting_voltages(self) -> tuple[float, float, float]:
        """Output voltages [V] before the first voltage is received."""
        return self.parameters.safe_voltage, 0.0, 0.0

    @property
    def travel(self) -> tuple[float, float]:
        """Allowed range of the measurement [m], from the models in the parameter file."""
        return self._travel

    @property
    def saturated(self) -> bool:
        """Whether range or slew rate limited the last voltage."""
        return self.limits.saturated

    @property
    def limited_samples(self) -> int:
        """Samples so far in which range or slew rate limited the voltage."""
        return self.limits.limited_samples

    # -- samples -------------------------------------------------------------------------------------------------

    def sense(self, row) -> None:
        """Read the position and write it into the row; NaN if there is no new position."""
        interpreted(faulty.begin_sample)(self._watch_x.faults)
        row[at.MEASURED] = row[at.FORCE] = math.nan
        if not self._failure:
            try:
                position, *forces = self._opened.read()
                row[at.MEASURED] = self.sensor.step(position)
                row[at.FORCE] = _TOLD(self._watch_p, self._watch_x, forces[0] if forces else math.nan)
                if self.parameters.trigger_input:
                    row[at.TRIGGER_IN] += self._opened.pulses()
            except DriverError as error:
                self._fail(error)
        stop_for_homing(self._watch_x.trip, self.sensor.homing)
        row[at.DISPLACEMENT] = math.nan
        row[at.TRIPPED] = self._watch_x.trip[TRIP]

    def actuate(self, row) -> None:
        """Output the voltage of the row after monitoring."""
        self._put_out(watched_voltage(self._watch_p, self._watch_x, row))
        row[at.PLANT_VOLTAGE] = self._output

    @property
    def _output(self) -> float:
        """Output voltage [V], which is not the safe voltage if the device could not be made safe."""
        return self._left_at if self._left else float(self.limits.x[OUTPUT])

    def output_clock(self, edges: at.Edge) -> None:
        """Output the scan edges of this sample, if ``scan_clock`` is set and the device works."""
        if self.parameters.scan_clock and not self._failure:
            try:
                self._opened.output_clock(edges)
            except DriverError as error:
                self._fail(error)

    def output_trigger(self, number: int, delay: float) -> None:
        """Output a trigger that occurred ``delay`` [s] before a sample, unless the device itself triggers."""
        if self.parameters.trigger_output and not self._failure and not self.capabilities.compares:
            try:
                self._opened.output_trigger(number, delay)
            except DriverError as error:
                self._fail(error)

    def _put_out(self, voltage: float) -> None:
        if not self._failure:
            try:
                self._opened.write((self.amplifier.value(self.limits.step(voltage)),))
            except DriverError as error:
                self._fail(error)

    def _fail(self, error: DriverError) -> None:
        """Stop the axis and make the device safe, on a new connection if necessary."""
        self._failure = str(error)
        self._watch_x.trip[TRIP] = DEVICE_FAILED
        with contextlib.suppress(DriverError):  # reported with the failure
            self.make_safe()

    def _at_rest(self) -> None:
        """Continue from the safe voltage."""
        safe, x = self.parameters.safe_voltage, self.limits.x
        self._watch_x.hold[:] = hold_state(safe)
        x[OUTPUT] = x[UNQUANTISED] = safe

    # -- beginning and end ---------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the axis; if the device has failed, access it again, and home a relative sensor again."""
        failed, left = bool(self.failure), self._is_left()
        if failed:
            self.sensor.begin_homing()
        super().start()
        self._acknowledge()
        if failed:
            self._try_device(left)

    def _acknowledge(self) -> None:
        """Clear the error on request of a user; if it persists, the next sample reports it again."""
        if self._device is not None:
            self._device.desist()
        self._failure = self._left = ""

    def _try_device(self, left: bool) -> None:
        """Read the device once, and write its safe voltage, so that a start reports a device that still fails.

        A device that could not be made safe is made safe first; otherwise its output would step.
        """
        try:
            if left:
                self._opened.make_safe()
            self._opened.read()
            self._opened.write((self.amplifier.value(self.limits.x[OUTPUT]),))
        except DriverError as error:
            self._fail(error)

    def reset(self) -> None:
        """Restart at the device's present voltage; slew to the safe voltage, then to the received voltage."""
        self._acknowledge()
        held = self.held()
        super().reset()
        self._watch_x.hold[HELD], self._watch_x.hold[FOLLOWS] = held, 0.0
        self.limits.x[FLAGS] = self.limits.x[LIMITED_SAMPLES] = 0.0

    def home(self) -> None:
        """Define the present position of the actuator as home."""
        sensor, safe = self.parameters.calibration.sensor, self.parameters.safe_voltage
        if sensor.reference != "relative":
            remedy = "is an absolute sensor; only a relative sensor is homed"
            raise ParameterError([Problem("calibration.sensor.reference", sensor.reference, remedy)])
        if not self.tripped or self.held() != safe:
            remedy = (
                f"home is the position at safe_voltage = {safe:g} V: stop the axis (publish true on estop), wait until "
                "the voltage is there, then home the sensor"
            )
            raise ParameterError([Problem("voltage", self.held(), remedy)])
        self.sensor.begin_homing()

    @property
    def complaint(self) -> str:
        """Error of the last reading of the sensor; empty: none."""
        return self.sensor.complaint

    @property
    def finding_home(self) -> bool:
        """Whether the axis is stopped because its sensor is being homed."""
        return bool(self._watch_x.trip[TRIP] == FINDING_HOME)

    def retune(self, parameters: PlantNodeParameters) -> None:
        """Apply new limits, time-outs and safe voltages while the axis runs."""
        before, after = self.parameters.driver_parameters, parameters.driver_parameters
        for name, value in after.to_mapping().items():
            if not name.startswith("limits.") and value != before.to_mapping().get(name):
                remedy = f"the driver {parameters.driver} is open: deactivate and clean up the node first"
                raise ParameterError([Problem(name, value, remedy)])
        low, high = self._range
        for name in ("minimum", "maximum"):
            if not low <= self.amplifier.value(getattr(parameters.limits, name)) <= high:
                unit = parameters.calibration.amplifier.unit
                remedy = f"must lie within the device's range of {low:g} … {high:g} {unit}"
                raise ParameterError([Problem(f"limits.{name}", getattr(parameters.limits, name), remedy)])
        self.limits.retune(_without_grid(parameters.limits))
        super().retune(parameters)

    def step_to_safe(self) -> bool:
        """Move the voltage one step towards the safe voltage; False if it is reached, or the device has failed."""
        p, x, safe = self._watch_p.hold, self._watch_x.hold, self.parameters.safe_voltage
        if self._failure or (x[HELD] == safe and self.limits.x[OUTPUT] == safe):
            return False
        self._put_out(hold_voltage(p, x, math.nan, 1.0, -math.inf))
        return True

    def refresh(self) -> None:
        """Output the voltage again, so that the device's watchdog does not act."""
        if not self._failure:
            try:
                self._opened.write((self.amplifier.value(self.limits.x[OUTPUT]),))
            except DriverError as error:
                self._fail(error)

    def held(self, input_: int = 0) -> float:
        """Return the output voltage [V], even if the device could not be made safe."""
        return self._output if self._is_left() else super().held(input_)

    def make_safe(self) -> None:
        """Bring the device to its safe state."""
        left_at = self._output
        self._at_rest()
        try:
            self._opened.make_safe()
        except DriverError as error:
            self._left, self._left_at = error.problem, left_at
            self._opened.insist(self.insists_every, self._is_left, self._made_safe)
            raise
        self._left = ""

    def _is_left(self) -> bool:
        return bool(self._left)

    def _made_safe(self) -> None:
        self._left = ""

    def close(self) -> str:
        """Release the device; return the problem that remains, or an empty text."""
        return self._opened.close()


def _without_grid(limits: LimitsParameters) -> LimitsParameters:
    """Return the limits without quantisation, because the device has its own converter."""
    return replace(limits, bits=0)


def _sense_device(laws, plant, row):
    plant.sense(row)


def _actuate_device(laws, plant, row):
    plant.actuate(row)


sense.kinds[DrivenPlant], actuate.kinds[DrivenPlant] = _sense_device, _actuate_device


def plant_of(parameters: PlantNodeParameters, travel: Sequence[float] | None = None) -> Plant:
    """Return the plant of a node: the device of its driver, or the simulated plant of its type."""
    return DrivenPlant(parameters, travel) if parameters.driver else PLANTS[parameters.type](parameters)


class CompiledPlant(DrivenPlant):
    """A device with one actuator, which machine code reads and writes."""

    # placeholders for the kernels of a simulated plant
    kernels = limits, limits, limits

    given = (at.MEASURED, at.TRIPPED, at.FORCE, at.PLANT_VOLTAGE)

    rounding, begins_safe = 0.0, True

    def __init__(self, parameters: PlantNodeParameters, linked: bool = True, travel: Sequence[float] | None = None):
        self._linked = linked
        super().__init__(parameters, travel)
        compiled = joints = None
        if linked:
            compiled, joints = self._opened.compiled(), self.capabilities
            self.patience, self.calls_python = compiled.patience, compiled.calls_python
        sizes = (joints.joints + joints.forces, joints.voltages) if joints is not None else (1, 1)
        positions, voltages = map(np.zeros, sizes)
        self.arrays = DevicePlantArrays(
            link_to(compiled, parameters.scan_clock, parameters.trigger_output, parameters.trigger_input),
            np.zeros(ANSWERS, dtype=np.int64),
            positions,
            voltages,
            np.zeros(1, dtype=np.int64),
            np.zeros(1),
            self.limits.p,
            self.limits.x,
            self.sensor.p,
            self.sensor.x,
            self.amplifier.p,
            self._watch_p,
            self._watch_x,
        )
        self.reset()

    def _open(self, parameters: PlantNodeParameters) -> None:
        if self._linked:
            super()._open(parameters)

    @property
    def _range(self) -> tuple[float, float]:
        return super()._range if self._linked else (-math.inf, math.inf)

    @property
    def failure(self) -> str:
        """Error of a device that has stopped the axis."""
        if self._watch_x.trip[TRIP] != DEVICE_FAILED or self._failure or not self._linked:
            return self._failure
        failed, code, safe_code = (int(self.arrays.answer[place]) for place in (FAILED, CODE, SAFE_CODE))
        explain = self._opened.compiled().explain
        error = nonsense(self.parameters.driver) if failed == NONSENSE else explain(code)
        text = f"driver {self.parameters.driver}: cannot {_DEEDS.get(failed, 'be written')}: {error}"
        if not safe_code:
            return text
        self._opened.insist(self.insists_every, self._is_left, self._made_safe)
        left = f"the output is still at {self.arrays.voltages[0]:.6g} {self.capabilities.voltage_unit}"
        return f"{text}; the device cannot be made safe: {explain(safe_code).problem}: {left}"

    def _is_left(self) -> bool:
        if super()._is_left() or self.arrays is self:  # self.arrays is self until the device is open
            return bool(self._left)
        return bool(self._watch_x.trip[TRIP] == DEVICE_FAILED and self.arrays.answer[SAFE_CODE])

    @property
    def _output(self) -> float:
        return super()._output if self._left or not self._is_left() else float(self.arrays.left[0])

    def _made_safe(self) -> None:
        super()._made_safe()
        self.arrays.answer[SAFE_CODE] = 0

    def recover(self) -> bool:
        """Make safe a device that could not be made safe before, so that its output does not step at the next start.

        Returns whether the device had not been safe. Any thread may call this method, because the loop does
        not call a device that has failed.

        Raises
        ------
        DriverError
            The device still cannot be made safe.
        """
        if not self._linked or not self._is_left():
            return False
        self._opened.desist()
        self.make_safe()
        self._made_safe()
        return True

    def step_to_safe(self) -> bool:
        """Move the voltage one step towards the safe voltage; False if it is reached, or the device has failed."""
        moved = super().step_to_safe()
        if moved:
            self.arrays.voltages[0] = self.amplifier.value(self.limits.x[OUTPUT])
        return moved

    def make_safe(self) -> None:
        """Bring the device to its safe state."""
        if self._linked:
            self._opened.note(float(self.arrays.voltages[0]))
            super().make_safe()

    def close(self) -> str:
        """Release the device; return the problem that remains, or an empty text."""
        return super().close() if self._linked else ""


def fused_plant_of(
    parameters: PlantNodeParameters, linked: bool = True, travel: Sequence[float] | None = None
) -> Plant:
    """Return the plant of a fused axis: the device of its driver, or the simulated plant of its type."""
    if not parameters.driver:
        return PLANTS[parameters.type](parameters)
    return CompiledPlant(parameters, linked, travel)
