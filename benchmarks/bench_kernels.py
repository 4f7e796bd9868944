# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Compiled kernels, compared with the same recursions in C (recursions.c, gcc -O3)."""

from __future__ import annotations

import ctypes
import pathlib
import shutil
import statistics
import subprocess
import tempfile
from functools import partial

import common
import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.laws.sliding_mode import sliding_mode
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.reach import axes
from hysteresis_ros.models.block import COMPILED, kernel
from hysteresis_ros.models.hysteresis.polynomial import STATES, polynomial, polynomial_inverse
from hysteresis_ros.models.limits import Limits, LimitsParameters, limits
from hysteresis_ros.models.linear import linear

TARGET = 1.3
SAMPLES = 100_000

_DOUBLES = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")


@kernel
def run_polynomial(p, x, u, y):
    """Fill ``y`` with the output of the hysteresis."""
    for k in range(u.shape[0]):
        y[k] = polynomial(p, x, u[k])


@kernel
def run_compensation(p, x, scratch, r, voltage):
    """Fill ``voltage`` with the inverse for the displacements ``r``, and advance the model with it."""
    for k in range(r.shape[0]):
        # the closed form does not use its kernel argument; with a number instead, this function can be cached
        voltage[k] = polynomial_inverse(0.0, scratch, scratch, p, x, r[k])
        polynomial(p, x, voltage[k])


@kernel
def run_linear(p, x, u, y):
    """Fill ``y`` with the output of the state space."""
    for k in range(u.shape[0]):
        y[k] = linear(p, x, u[k])


@kernel
def run_limits(p, x, u, y):
    """Fill ``y`` with the limited voltage."""
    for k in range(u.shape[0]):
        y[k] = limits(p, x, u[k])


@kernel
def run_sliding_mode(p, x, r, y, u):
    """Fill ``u`` with the controller's commands."""
    for k in range(r.shape[0]):
        u[k] = sliding_mode(p, x, r[k], y[k])


def c_library(folder: pathlib.Path, name: str = "recursions.c") -> ctypes.CDLL:
    """Compile a C file of this folder into ``folder``, and load it."""
    gcc = shutil.which("gcc")
    if gcc is None:
        raise common.BenchmarkError(
            "gcc is not installed; the compiled kernels are compared with C: install gcc (apt install gcc)"
        )
    source = pathlib.Path(__file__).with_name(name)
    library = (folder / name).with_suffix(".so")
    # the kernels do not contract a*b + c either, so both sides perform the same IEEE operations
    command = [gcc, "-O3", "-ffp-contract=off", "-std=c11", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise common.BenchmarkError(f"gcc could not compile {source.name}: {done.stderr.strip()}")
    return ctypes.CDLL(str(library))


class Case:
    """One recursion, as compiled kernel and in C, with the same parameters, states and signals.

    Parameters
    ----------
    name : str
        Name in the table.
    block : Block
        Block whose ``p`` and ``x`` are used.
    ours, theirs : function
        ``run(p, x, *scratch, *signals, output)``; the function in C has the number of samples as last argument.
    signals : tuple of arrays, shape (N,)
        Inputs.
    scratch : tuple of arrays
        Work arrays of the recursion.
    """

    def __init__(self, name, block, ours, theirs, signals, scratch=()):
        self.name = name
        self.block = block
        self.signals = [np.ascontiguousarray(signal) for signal in signals]
        theirs.argtypes = [_DOUBLES] * (3 + len(scratch) + len(signals)) + [ctypes.c_size_t]
        theirs.restype = None
        self._x = block.initial_state()
        self.outputs = [np.empty(SAMPLES), np.empty(SAMPLES)]
        inputs = (block.p, self._x, *scratch, *self.signals)
        self._calls = [(ours, (*inputs, self.outputs[0])), (theirs, (*inputs, self.outputs[1], SAMPLES))]

    def run(self, side: int) -> None:
        """Run the kernel (``side`` 0) or the C code (1) from the state at rest."""
        function, arguments = self._calls[side]
        self._x[:] = self.block.initial_state()
        function(*arguments)

    def simulate(self) -> None:
        """Run the kernel as the argument of a compiled loop, as in the package."""
        self.block.reset()
        self.block.simulate(*self.signals)

    def difference(self) -> float:
        """Return the largest difference of the two outputs, as a fraction of the range of the output."""
        self.run(0)
        self.run(1)
        difference = float(np.max(np.abs(self.outputs[0] - self.outputs[1])))
        # an output that is NaN or constant counts as different
        return difference / float(np.ptp(self.outputs[1])) if np.ptp(self.outputs[1]) > 0.0 else np.inf


def cases(library) -> list[Case]:
    """Return the cases, with signals of a closed loop over its full range."""
    axis = Axis(axes(load_configuration(common.CONFIGURATION))[0])
    # steps of random height, smoothed: branches, minor loops and the virgin curve all occur
    steps = np.repeat(np.random.default_rng(1).uniform(0.0, 10e-6, SAMPLES // 50), 50)
    reference = np.convolve(steps, np.full(30, 1.0 / 30.0), mode="same")
    signals = axis.run(reference)
    command, voltage, measured = (signals[name] for name in ("command", "voltage", "measured"))
    actuator, controller = axis.plant.actuator, axis.controller.controller
    tight = Limits(LimitsParameters(minimum=-30.0, maximum=80.0, slew_rate=20e3, bits=16), 1.0 / axis.sample_rate)
    scratch = (np.zeros(STATES),)
    return [
        Case("polynomial hysteresis", actuator.hysteresis, run_polynomial, library.run_polynomial, (voltage,)),
        Case(
            "exact inverse and hysteresis",
            actuator.hysteresis,
            run_compensation,
            library.run_compensation,
            (command,),
            scratch,
        ),
        Case("linear state space", actuator.dynamics, run_linear, library.run_linear, (command,)),
        Case("sliding mode, Kalman", controller, run_sliding_mode, library.run_sliding_mode, (reference, measured)),
        Case("limits and quantiser", tight, run_limits, library.run_limits, (voltage,)),
    ]


def main() -> int:
    """Run the benchmark; returns the exit code."""
    options = common.parser(__doc__, repeats=101).parse_args()
    if not COMPILED:
        raise common.BenchmarkError("Numba is missing or switched off: there are no compiled kernels to measure")
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for case in cases(c_library(pathlib.Path(folder))):
            difference = case.difference()
            if not difference <= 1e-12:
                raise common.BenchmarkError(f"{case.name}: kernel and C differ by {difference:.3g} of full scale")
            ratio, *times = common.interleaved(partial(case.run, 0), partial(case.run, 1), options.repeats)
            ours, theirs = (seconds / SAMPLES * 1e9 for seconds in times)
            detail = f"{ours:.1f} ns per sample, C {theirs:.1f} ns, {'same bits' if difference == 0.0 else ''}"
            if "inverse" not in case.name:
                case.simulate()
                passed = statistics.median(common.cpu_seconds(case.simulate) for _ in range(options.repeats))
                detail += f"; as argument of a loop {passed / SAMPLES * 1e9:.1f} ns"
            results.append(common.Result(case.name, ratio, "at most", TARGET, detail))
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
