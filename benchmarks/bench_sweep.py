# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sweeps of Kim's axis: wall time of many runs including the start, and speedup by a second process.

On a busy machine only the processor time of the runs is meaningful.
"""

from __future__ import annotations

import os
import resource
import statistics
import time

import common

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.laboratory.sweeps.plan import make_plan, parse_variations
from hysteresis_ros.laboratory.sweeps.study import Study
from hysteresis_ros.laboratory.sweeps.sweep import sweep
from hysteresis_ros.loop.reach import single_axis

#: Largest wall time of 10 000 runs of 1 s on two cores [s], and smallest ratio of the rates of two and of one process.
TARGET, GAIN = 15.0, 1.8
ASKED = 10_000
VARIED = ("plant_simulator.gain=±5%",)


def processor_seconds() -> float:
    """Return the processor time of this process and of its ended child processes [s]."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def seconds(study: Study, runs: int, workers: int) -> float:
    """Return the wall time of a sweep [s]."""
    plan = make_plan(study.variations, runs)
    begun = time.perf_counter()
    found = sweep(study, plan, workers=workers)
    taken = time.perf_counter() - begun
    if not found.good.all():
        raise common.BenchmarkError("some of the runs did not finish")
    return taken


def main() -> int:
    """Measure, print and compare with the targets."""
    parser = common.parser(__doc__, repeats=3)
    parser.add_argument("--runs", type=int, default=ASKED, help=f"number of runs per turn (default {ASKED})")
    options = parser.parse_args()
    common.require_compiled()
    axis = single_axis(load_configuration(str(common.CONFIGURATION))).with_duration(1.0)
    study = Study(axis, parse_variations(VARIED, axis), ("rms_error_m", "max_error_m"))
    seconds(study, 10, 1)  # compiles the kernels
    before, turns, spent = os.getloadavg()[0], [], []
    for turn in range(options.repeats):
        order = (1, 2) if turn % 2 == 0 else (2, 1)
        taken = {}
        for workers in order:
            begun = processor_seconds()
            taken[workers] = seconds(study, options.runs, workers)
            if workers == 2:
                spent.append((processor_seconds() - begun) * ASKED / options.runs)
        turns.append((taken[1], taken[2]))
    gain = statistics.median(one / two for one, two in turns)
    one, two = (min(times) * ASKED / options.runs for times in zip(*turns, strict=True))
    load = f"load {before:.1f} before, {os.getloadavg()[0]:.1f} at the end, including 1 to 2 of the sweep"
    results = [
        common.Result("rate of two processes, ratio to one", gain, "at least", GAIN, load),
        common.Result(f"seconds for {ASKED} runs of 1 s, two processes", two, "at most", TARGET, f"one: {one:.1f} s"),
        common.Result("seconds of processor time in total", min(spent), "at most", 2.0 * TARGET, "two processors"),
    ]
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
