# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A device in the plant's place that machine code reads and writes: two functions of a shared library, by address.

Nothing here takes Python's lock, waits for it or allocates. What watches over the voltages is that of the simulated
plant. A device that answers with an error, or a position that is no number, stops the axis in that sample: it is made
safe at once and left alone until the axis is started again.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.block import COMPILED, kernel, nested
from hysteresis_ros.hardware.driver import NOTHING_NEW, Compiled
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.plant import (
    DEVICE_FAILED,
    FINDING_HOME,
    NOT_TRIPPED,
    TRIP,
    PlantWatchArrays,
    actuate,
    no_joints,
    sense,
    tell_joints,
    told_force,
    watched_voltage,
)
from hysteresis_ros.loop.watch import FOLLOWS, GIVEN, HELD, HELD_AGE, HELD_BEGUN, SAFE
from hysteresis_ros.models.calibration import HOMING, amplifier_value, sensor_displacement
from hysteresis_ros.models.limits import OUTPUT, UNQUANTISED, limits

# What leads to the device, int64: the addresses of its functions and of itself, and that of this very array. In a copy
# of the arrays the last one is another one's, so no copy ever reaches the device.
READ, WRITE, MAKE_SAFE, DEVICE, SELF = range(5)
LINKS = 5

# What it answered when it failed, int64: which of its functions, and its code; what making it safe gave then.
FAILED, CODE, SAFE_CODE = range(3)
ANSWERS = 3
#: Values of ``FAILED``: nothing, reading, writing, a position that is no number.
NOTHING, READING, WRITING, NONSENSE = range(4)


class DevicePlantArrays(NamedTuple):
    """All arrays of a device in the loop."""

    link: np.ndarray
    answer: np.ndarray
    #: Where the device finds all its voltages and leaves all its positions, both in its own units, and then its forces.
    positions: np.ndarray
    voltages: np.ndarray
    limits_p: np.ndarray
    limits_x: np.ndarray
    sensor_p: np.ndarray
    sensor_x: np.ndarray
    amplifier_p: np.ndarray
    watch_p: PlantWatchArrays
    watch_x: PlantWatchArrays


def link_to(compiled: Compiled | None) -> np.ndarray:
    """Return the array that leads to a device, or to none.

    Parameters
    ----------
    compiled : Compiled or None
    """
    link = np.zeros(LINKS, dtype=np.int64)
    if compiled is not None:
        link[:SELF] = compiled[:SELF]
        link[SELF] = link.ctypes.data
    return link


if COMPILED:
    from llvmlite import ir
    from numba import types
    from numba.extending import intrinsic

    def _caller(count: int) -> Any:
        """Return what calls ``int32_t function(void *, …)`` of so many pointers.

        Addresses are data to it, so that the code can be cached.
        """

        def generate(context, builder, signature, arguments):
            pointer = ir.IntType(8).as_pointer()
            kind = ir.FunctionType(ir.IntType(32), [pointer] * count)
            function = builder.inttoptr(arguments[0], kind.as_pointer())
            code = builder.call(function, [builder.inttoptr(item, pointer) for item in arguments[1:]])
            return builder.sext(code, ir.IntType(64))

        return types.int64(*(types.int64,) * (count + 1)), generate

    @intrinsic
    def _call_with(typing_context: Any, address, device, values):
        return _caller(2)

    @intrinsic
    def _call_alone(typing_context: Any, address, device):
        return _caller(1)

    @kernel
    def call_with(link, which, values):
        """Call a function of the device that takes an array; return its code."""
        return _call_with(link[which], link[DEVICE], values.ctypes.data)

    @kernel
    def call_alone(link, which):
        """Call a function of the device that takes nothing else; return its code."""
        return _call_alone(link[which], link[DEVICE])

else:
    _WITH = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)
    _ALONE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)

    def call_with(link, which, values):
        """Call a function of the device that takes an array; return its code."""
        return _WITH(int(link[which]))(int(link[DEVICE]), values.ctypes.data)

    def call_alone(link, which):
        """Call a function of the device that takes nothing else; return its code."""
        return _ALONE(int(link[which]))(int(link[DEVICE]))


@nested
def is_linked(link):
    """Tell whether these arrays lead to a device."""
    return link[SELF] != 0 and link[SELF] == link.ctypes.data


@nested
def rest_device(limits_x, watch_p, watch_x):
    """Go on from the safe voltage."""
    safe, hold = watch_p.hold[SAFE], watch_x.hold
    hold[HELD] = hold[GIVEN] = limits_x[OUTPUT] = limits_x[UNQUANTISED] = safe
    hold[HELD_AGE] = hold[HELD_BEGUN] = hold[FOLLOWS] = 0.0


@nested
def fail_device(arrays, failed, code):
    """Stop the axis: the device is made safe, as far as it still listens."""
    arrays.watch_x.trip[TRIP] = DEVICE_FAILED
    rest_device(arrays.limits_x, arrays.watch_p, arrays.watch_x)
    if is_linked(arrays.link):
        arrays.answer[FAILED], arrays.answer[CODE] = failed, code
        arrays.answer[SAFE_CODE] = call_alone(arrays.link, MAKE_SAFE)


@nested
def read_device(arrays):
    """Return the measurement [m] of the device, NaN when there is none."""
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
def stop_for_homing(trip, homing):
    """Keep the axis at its safe voltage while its sensor is homed, and let it go on afterwards."""
    if homing and trip[TRIP] == NOT_TRIPPED:
        trip[TRIP] = FINDING_HOME
    elif not homing and trip[TRIP] == FINDING_HOME:
        trip[TRIP] = NOT_TRIPPED


@nested
def sense_device(laws, arrays, row):
    """Read a device; without one, what the row was given stands for what it answered."""
    faulty.begin_sample(arrays.watch_x.faults)
    trip = arrays.watch_x.trip
    if is_linked(arrays.link):
        asked = trip[TRIP] != DEVICE_FAILED and row[at.SKIPPED] == 0.0
        row[at.MEASURED] = read_device(arrays) if asked else math.nan
        there = row[at.MEASURED] == row[at.MEASURED] and arrays.positions.shape[0] > 1
        row[at.FORCE] = told_force(arrays.watch_p, arrays.watch_x, arrays.positions[1] if there else math.nan)
        stop_for_homing(trip, arrays.sensor_x[HOMING] > 0.0)
    elif row[at.TRIPPED] == DEVICE_FAILED and trip[TRIP] != DEVICE_FAILED:
        fail_device(arrays, READING, 0)
    else:
        stop_for_homing(trip, row[at.TRIPPED] == FINDING_HOME)
    row[at.DISPLACEMENT] = math.nan
    row[at.PLANT_VOLTAGE] = arrays.limits_x[OUTPUT]
    row[at.TRIPPED] = trip[TRIP]


@nested
def actuate_device(laws, arrays, row):
    """Put out the voltage of the row, or what the watch makes of it.

    In a sample that was skipped nothing is written: the voltage stays, though it may be on its way to safe or back.
    """
    trip, hold = arrays.watch_x.trip, arrays.watch_x.hold
    failed = trip[TRIP] == DEVICE_FAILED
    before = hold[HELD]
    held = watched_voltage(arrays.watch_p, arrays.watch_x, row)
    if failed:
        trip[TRIP] = DEVICE_FAILED
        rest_device(arrays.limits_x, arrays.watch_p, arrays.watch_x)
        row[at.PLANT_VOLTAGE] = arrays.limits_x[OUTPUT]
        return
    if row[at.SKIPPED] != 0.0:
        hold[HELD] = before
        row[at.PLANT_VOLTAGE] = arrays.limits_x[OUTPUT]
        return
    arrays.voltages[0] = amplifier_value(arrays.amplifier_p, limits(arrays.limits_p, arrays.limits_x, held))
    row[at.PLANT_VOLTAGE] = arrays.limits_x[OUTPUT]
    if is_linked(arrays.link):
        code = call_with(arrays.link, WRITE, arrays.voltages)
        if code != 0:
            fail_device(arrays, WRITING, code)


sense.kinds[DevicePlantArrays], actuate.kinds[DevicePlantArrays] = sense_device, actuate_device
tell_joints.kinds[DevicePlantArrays] = no_joints
