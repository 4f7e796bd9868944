# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Many axes in one call, compared with single steps from Python and with C (axis_array.c); one and two threads."""

from __future__ import annotations

import ctypes
import pathlib
import tempfile
import time
from functools import partial

import common
import numpy as np
from bench_kernels import c_library

from hysteresis_ros import signals
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.axis_array import AxisArray, parameters_of_each
from hysteresis_ros.loop.compensator import compensate
from hysteresis_ros.loop.controller import carried_out, control
from hysteresis_ros.loop.plant import actuate, sense
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.source import refer

AXES, SAMPLES, WARM = 1024, 50, 11
SINGLE, IN_C, TWO_THREADS = 20.0, 1.3, 1.7

_NUMBERS = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
_PLACES = np.ctypeslib.ndpointer(dtype=np.int64, flags="C_CONTIGUOUS")


def axes(threads: int = 1) -> AxisArray:
    """Return axes like Kim's, each with a different offset of its sensor."""
    configuration = load_configuration(common.CONFIGURATION).override("reference_generator", waveform__type="hold")
    offsets = np.random.default_rng(2).uniform(-1e-7, 1e-7, AXES)
    each = {"plant_simulator.sensor.offset": offsets}
    return AxisArray(parameters_of_each(single_axis(configuration), AXES, each), threads)


class InC:
    """The same axes in C, with their own memory."""

    def __init__(self, folder: pathlib.Path):
        self.array = axes()
        self._run = c_library(folder, "axis_array.c").run_kim2009
        count = 3 * (ctypes.c_int64,)
        self._run.argtypes = [_NUMBERS, _PLACES, *count, _NUMBERS, _NUMBERS]
        self._run.restype = ctypes.c_int64
        self._places = np.array(self.array.places, dtype=np.int64)

    def run(self, setpoints: np.ndarray) -> None:
        """Compute one sample for each column of ``setpoints``, shape (n, N) [m]."""
        array = self.array
        fixed = array.memory, self._places, array.stride, *setpoints.shape
        if self._run(*fixed, array.rows, setpoints):
            raise common.BenchmarkError("the axis uses functions that axis_array.c does not contain")


class Singles:
    """The same axes one by one, as a node steps its part: Python calls the compiled kernels of a sample."""

    def __init__(self, parameters):
        self._axes = [Axis(one) for one in parameters]
        # a list, because kernels read numbers faster from a list than from an array
        self._calls = [(axis.laws, axis.parts, signals.ACTUATOR_ROW * [0.0]) for axis in self._axes]

    def step(self, setpoints: np.ndarray) -> None:
        """Advance every axis by one sample."""
        for (laws, parts, row), setpoint in zip(self._calls, setpoints.tolist(), strict=True):
            row[signals.SETPOINT] = setpoint
            sense(laws, parts.plant, row)
            refer(laws, parts.source, row)
            control(laws, parts.controller, row)
            compensate(laws, parts.compensator, row)
            actuate(laws, parts.plant, row)
            carried_out(parts.controller, row[signals.APPLIED])

    def voltages(self) -> np.ndarray:
        """Return the voltage of each axis [V]."""
        return np.array([row[signals.VOLTAGE] for _, _, row in self._calls])


def seconds(function) -> float:
    """Return the wall time of ``function()`` [s], because threads share the work."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def require_same(ours: np.ndarray, theirs: np.ndarray, which: str) -> None:
    """Refuse results that differ in a bit."""
    if not np.array_equal(ours.view(np.int64), theirs.view(np.int64)):
        raise common.BenchmarkError(f"the results of the array and of {which} differ; they must agree bit for bit")


def main() -> int:
    """Run the benchmark; returns the exit code."""
    options = common.parser(__doc__, repeats=31).parse_args()
    common.require_compiled()
    random = np.random.default_rng(1)
    one = random.uniform(0.0, 10e-6, AXES)
    many = np.repeat(random.uniform(0.0, 10e-6, (AXES, SAMPLES // 10)), 10, axis=1)
    results = []
    with tempfile.TemporaryDirectory() as folder:
        array, in_c = axes(), InC(pathlib.Path(folder))
        singles = Singles(array.parameters)
        # first the same samples on all sides, to compare the bits and to exclude first calls from the timing
        for setpoints in (one, np.roll(one, 1), one):
            array.step(setpoints)
            in_c.run(setpoints.reshape(-1, 1))
            singles.step(setpoints)
            require_same(array["voltage"], singles.voltages(), "the single axes")
        # until all data of a sample, including the history of 500 samples, are in memory
        for _ in range(WARM):
            array.run(many, signals=())
            in_c.run(many)
        require_same(array.memory, in_c.array.memory, "the loops in C")
        ratio, *times = common.interleaved(partial(singles.step, one), partial(array.step, one), options.repeats)
        detail = f"{1e6 * times[0]:.0f} us one by one, {1e6 * times[1]:.0f} us in one call"
        results.append(common.Result(f"one sample of {AXES} axes", ratio, "at least", SINGLE, detail))
        for name, ours, theirs, samples in (
            ("the same, ratio to C", partial(array.step, one), partial(in_c.run, one.reshape(-1, 1)), 1),
            (
                f"{SAMPLES} samples in one call, ratio to C",
                partial(array.run, many, signals=()),
                partial(in_c.run, many),
                SAMPLES,
            ),
        ):
            ratio, *times = common.interleaved(ours, theirs, options.repeats)
            per_axis = [1e9 * value / AXES / samples for value in times]
            detail = "{:.0f} ns per sample and axis, C {:.0f} ns, same bits".format(*per_axis)
            results.append(common.Result(name, ratio, "at most", IN_C, detail))
        both = axes(2)
        for name, run in (
            ("two threads, one sample", lambda given: partial(given.step, one)),
            (f"two threads, {SAMPLES} samples", lambda given: partial(given.run, many, signals=())),
        ):
            for _ in range(WARM):
                run(both)()
            ratio, *times = common.interleaved(run(array), run(both), options.repeats, seconds)
            detail = f"{1e6 * times[0]:.0f} us with one thread, {1e6 * times[1]:.0f} us with two"
            results.append(common.Result(name, ratio, "at least", TWO_THREADS, detail))
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
