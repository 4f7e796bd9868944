# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Offline closed loop of Kim's axis: compiled, compared with the same blocks uncompiled."""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys

import common
import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.reach import axes
from hysteresis_ros.models import block

TARGET = 30.0
COMPILED_SAMPLES = 60_000
PLAIN_SAMPLES = 2_000
#: The loop as in a study: with mismatch, noise and limits.
STUDY = {"sensor__noise": 5e-9}


class Loop:
    """The closed loop with steps between random setpoints, and its processor time."""

    def __init__(self, samples: int):
        configuration = load_configuration(str(common.CONFIGURATION)).override("plant_simulator", **STUDY)
        configuration = configuration.override("reference_generator", waveform__type="hold")
        self.axis = Axis(axes(configuration)[0])
        heights = np.random.default_rng(1).uniform(0.0, 10e-6, samples // 100)
        self.setpoints = np.repeat(heights, 100)
        self.run()

    def run(self) -> np.ndarray:
        """Run the loop from rest and return the measured displacements."""
        self.axis.reset()
        return self.axis.run(self.setpoints)["measured"]

    def seconds_per_sample(self) -> float:
        """Return the processor time of one sample [s]."""
        return common.cpu_seconds(self.run) / len(self.setpoints)


class PlainLoop:
    """The same loop in a process without compilation, which answers each line that it receives with one line."""

    def __init__(self):
        command = [sys.executable, __file__, "--answer"]
        environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
        self._process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.measured = np.array(self._line(), dtype=float)

    def __enter__(self):
        return self

    def __exit__(self, *exception) -> None:
        self._process.stdin.close()
        self._process.wait(30.0)
        self._process.stdout.close()

    def _line(self) -> list[str]:
        line = self._process.stdout.readline()
        if not line:
            raise common.BenchmarkError("the process without compilation ended early")
        return line.split()

    def seconds_per_sample(self) -> float:
        """Return the processor time of one sample [s]."""
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return float(self._line()[0])


def answer() -> int:
    """Run as the process without compilation: print the last measurements, then a time [s] for every received line."""
    if block.COMPILED:
        raise common.BenchmarkError("the kernels of this process are compiled although NUMBA_DISABLE_JIT is set")
    loop = Loop(PLAIN_SAMPLES)
    print(*map(repr, loop.run().tolist()), flush=True)
    for _ in sys.stdin:
        print(loop.seconds_per_sample(), flush=True)
    return 0


def main() -> int:
    """Run the benchmark; returns the exit code."""
    parser = common.parser(__doc__, repeats=31)
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.answer:
        return answer()
    if not block.COMPILED:
        raise common.BenchmarkError("Numba is missing or switched off: there is no compiled loop to measure")
    loop = Loop(COMPILED_SAMPLES)
    with PlainLoop() as plain:
        difference = np.max(np.abs(loop.run()[:PLAIN_SAMPLES] - plain.measured)) / 10e-6
        if difference > 1e-12:
            raise common.BenchmarkError(f"compiled and uncompiled loop differ by {difference:.3g} of the full scale")
        pairs = [(plain.seconds_per_sample(), loop.seconds_per_sample()) for _ in range(options.repeats)]
    ratio = statistics.median(slow / fast for slow, fast in pairs)
    slow, fast = (statistics.median(side) for side in zip(*pairs, strict=True))
    detail = f"{1e9 * fast:.0f} ns per sample ({1e-6 / fast:.2f} MHz), uncompiled {1e6 * slow:.1f} us"
    return common.report([common.Result("offline closed loop", ratio, "at least", TARGET, detail)], options)


if __name__ == "__main__":
    common.run(main)
