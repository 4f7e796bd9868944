# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The fused loop in real time, in turns with a C loop that only sleeps until each deadline; one core is kept busy.

The loop polls the clock ahead of each deadline (``realtime.spin``), as it does by default.
"""

from __future__ import annotations

import gc
import itertools
import math
import os
import pathlib
import shutil
import statistics
import subprocess
import tempfile
import time
from dataclasses import dataclass

import common
import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop import fused as runner
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.fused import FusedLoop, at_rest
from hysteresis_ros.loop.pacing import Lateness, Samples
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters

#: Axes and stages in real time, and the range of the setpoints that are sent during the run [m].
RUN = {
    "kim2009": (0.0, 5e-6),
    "inchworm_travel": (0.0, 2e-4),
    "xy_scanner": (10e-6, 30e-6),
    "steering_mirror": (-2e-7, 2e-7),
}
#: Sample rates at which the stages run [Hz].
STAGE_RATES = {"xy_scanner": 5000.0, "steering_mirror": 10000.0}
#: Sample rate of an additional row [Hz]; its period is about as long as the wake-up time.
FASTEST = 50e3
#: Limits of: lateness p50 and p90 [µs]; p99 and missed deadlines as a ratio to the C loop; computing time [µs].
EDGE, LATE, RATIO, COST = 1.0, 2.0, 1.0, 2.0
#: Interval at which samples are read and a setpoint is sent [s].
LOOK = 0.1
#: Exit code of the C loop when its priority or core is not permitted.
REFUSED = 3


@dataclass(frozen=True)
class Turn:
    """One turn: lateness of the C loop [ns] and of the fused loop, used fraction of a core, load, and wrong samples."""

    yardstick: np.ndarray
    lateness: Lateness
    core: float
    load: float
    lost: int
    different: int


def built(folder: pathlib.Path) -> pathlib.Path:
    """Compile the C loop."""
    if not shutil.which("gcc"):
        raise common.BenchmarkError("gcc is missing; the loop is compared with a loop in C: install gcc")
    program = folder / "pace"
    source = pathlib.Path(__file__).with_name("pace.c")
    subprocess.run(["gcc", "-O2", "-Wall", "-o", str(program), str(source)], check=True)
    return program


def yardstick(program, rate: float, samples: int, options) -> np.ndarray:
    """Return the lateness [ns] of each sample of the C loop."""
    command = [str(program), repr(rate), str(samples), str(options.priority), str(options.cpu)]
    done = subprocess.run(command, stdout=subprocess.PIPE)
    if done.returncode == REFUSED:
        asked = f"--priority {options.priority} --cpu {options.cpu}"
        raise common.BenchmarkError(f"{asked} is not permitted: give --priority 0, or run with CAP_SYS_NICE")
    if done.returncode:
        raise common.BenchmarkError(f"the C loop ended with exit code {done.returncode}")
    return np.frombuffer(done.stdout, dtype=np.int64)


#: Blocks of samples that the reader of each axis received.
Taken = list[list[Samples]]


def fused(axis: Axis | Stage, rate: float, samples: int, low: float, high: float) -> tuple[FusedLoop, Taken, float]:
    """Run an axis or a stage in real time, with a setpoint every :data:`LOOK` seconds.

    Return the loop, the samples that the readers of its axes received, and the fraction of a core that its thread used.
    """
    loop = FusedLoop(axis, rate / axis.sample_rate, samples, warn=print)
    readers = [loop.reader(place) for place in range(len(axis.axes))]
    taken: Taken = [[] for _ in readers]
    random = np.random.default_rng(1)
    gc.collect()
    gc.disable()
    begun, whole, own = time.monotonic(), time.process_time(), time.thread_time()
    loop.start()
    while not loop.join(LOOK):
        for reader, pieces in zip(readers, taken, strict=True):
            pieces.append(reader.take())
        loop.set_together({place: random.uniform(low, high) for place in range(len(readers))})
    took = time.process_time() - whole - (time.thread_time() - own)
    core = took / (time.monotonic() - begun)
    gc.enable()
    if loop.failure:
        raise common.BenchmarkError(loop.failure)
    for reader, pieces in zip(readers, taken, strict=True):
        pieces.append(reader.take())
    return loop, taken, core


def different_samples(loop: FusedLoop, taken: Taken, twin: Axis | Stage) -> int:
    """Return the number of samples in which the run and its repetition offline differ in a bit."""
    names = [signal.name for signal in loop.axis.kind.row]
    made = [
        dict(zip(names, np.concatenate([piece.table for piece in pieces], axis=1), strict=True)) for pieces in taken
    ]
    if isinstance(twin, Stage):
        setpoints = {name: one["setpoint"] for name, one in zip(twin.names, made, strict=True)}
        changes = {name: loop.changes_of(place) for place, name in enumerate(twin.names)}
        found = list(twin.run(setpoints, changes, made[0]["skipped"]).values())
    else:
        (own,) = made
        asked = {"requests": own["request"], "speeds": own["speed"]} if twin.kind.motor else {}
        found = [twin.run(own["setpoint"], changes=loop.changes, skipped=own["skipped"], **asked)]
    unlike = [
        np.ascontiguousarray(ours[name]).view(np.int64) != np.ascontiguousarray(theirs[name]).view(np.int64)
        for ours, theirs in zip(made, found, strict=True)
        for name in names
    ]
    return int(np.count_nonzero(np.any(unlike, axis=0)))


def one_turn(program, name: str, given: AxisParameters | StageParameters, rate: float, index: int, options) -> Turn:
    """Run the C loop and the fused loop one after the other, in alternating order."""
    samples = round(options.seconds * rate)
    first = yardstick(program, rate, samples, options) if index % 2 == 0 else None
    loop, taken, core = fused(at_rest(given), rate, samples, *RUN[name])
    late = first if first is not None else yardstick(program, rate, samples, options)
    lost = sum(piece.lost for pieces in taken for piece in pieces)
    different = 0 if lost else different_samples(loop, taken, at_rest(given))
    return Turn(late, loop.lateness(), core, os.getloadavg()[0], lost, different)


def parameters_of(name: str, options, rate: float = 0.0) -> AxisParameters | StageParameters:
    """Return an axis or a stage of the benchmark; at another sample rate [Hz], without dynamics."""
    realtime = {"realtime.priority": options.priority, "realtime.cpu": options.cpu, "late_limit": -1}
    configuration = load_configuration(name).override("plant_simulator", **realtime)
    if rate:
        configuration = configuration.override("", sample_rate=rate)
        configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0)
        configuration = configuration.override("motion_controller", model__dynamics__sample_time=0.0)
    if configuration.stage is not None:
        return StageParameters.from_configuration(configuration.override("", time_mode="fused"))
    return single_axis(configuration)


def missed_of(turn: Turn, rate: float) -> int:
    """Return the number of samples that the C loop missed in a turn."""
    return int(np.count_nonzero(turn.yardstick >= 1e9 / rate))


def paced(program, name: str, given: AxisParameters | StageParameters, options) -> list[common.Result]:
    """Return the figures of one axis or stage in real time."""
    axis = at_rest(given)
    rate, axes = STAGE_RATES.get(name, axis.sample_rate), len(axis.axes)
    title = f"{name}, {rate:g} Hz"
    turns = [one_turn(program, name, given, rate, index, options) for index in range(options.turns)]
    for turn in turns:
        c, late = np.quantile(turn.yardstick, [0.5, 0.9, 0.99, 0.999, 1.0]) * 1e-3, turn.lateness
        print(
            f"{title}: p50 {late.p50 * 1e6:.1f}, p90 {late.p90 * 1e6:.1f}, p99 {late.p99 * 1e6:.1f}, p99.9 "
            f"{late.p999 * 1e6:.1f}, max {late.max * 1e6:.0f} µs, missed {late.missed} of {late.samples}, polls from "
            f"{late.ahead * 1e6:.0f} µs before, {100.0 * turn.core:.0f} % of a core; C {c[0]:.1f}, {c[1]:.1f}, "
            f"{c[2]:.1f}, {c[3]:.1f}, {c[4]:.0f} µs, {missed_of(turn, rate)}; load {turn.load:.1f}"
        )
    p50, p90 = (1e6 * statistics.median(getattr(turn.lateness, name) for turn in turns) for name in ("p50", "p90"))
    ours, theirs = [[turn.lateness.p99 for turn in turns], [np.quantile(t.yardstick, 0.99) * 1e-9 for t in turns]]
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    missed, beside = sum(turn.lateness.missed for turn in turns), sum(missed_of(turn, rate) for turn in turns)
    cost = statistics.median(turn.lateness.cost for turn in turns) * 1e6
    core = 100.0 * statistics.median(turn.core for turn in turns)
    c50, c90 = (1e-3 * statistics.median(np.quantile(t.yardstick, part) for t in turns) for part in (0.5, 0.9))
    total = sum(turn.lateness.samples for turn in turns)
    text = f"{1e6 * statistics.median(ours):.1f} µs, C {1e6 * statistics.median(theirs):.1f}"
    count = f"{missed}, C {beside} of {total}"
    return [
        common.Result(f"{title}: p50 lateness [µs]", p50, "at most", EDGE, f"C {c50:.1f}"),
        common.Result(
            f"{title}: p90 lateness [µs]", p90, "at most", LATE, f"C {c90:.1f}; {core:.0f} % of a core in total"
        ),
        common.Result(f"{title}: p99 lateness, ratio to C", ratio, "at most", RATIO, text),
        common.Result(f"{title}: missed + 1, ratio to C", (missed + 1) / (beside + 1), "at most", RATIO, count),
        common.Result(f"{title}: computing time per axis [µs]", cost / axes, "at most", COST),
        common.Result(f"{title}: samples lost by the reader", sum(turn.lost for turn in turns), "at most", 0),
        common.Result(f"{title}: samples unlike offline", sum(turn.different for turn in turns), "at most", 0),
    ]


def resident_bytes() -> int:
    """Return the exact resident memory of this process [B]; other counts of Linux lag behind by some pages."""
    for line in pathlib.Path("/proc/self/smaps_rollup").read_text().splitlines():
        if line.startswith("Rss:"):
            return int(line.split()[1]) * 1024
    raise common.BenchmarkError("/proc/self/smaps_rollup has no Rss")


def growth(ticks: int) -> common.Result:
    """Return the growth of the process [B] while a loop runs ``ticks`` samples without waiting.

    As in bench_memory.py, it is nine times the median growth of the nine tenths after the first.
    """
    loop = FusedLoop(Axis(single_axis(load_configuration("kim2009"))), math.inf, ticks)
    loop.start()
    found = []
    for tenth in range(1, 11):
        while loop.sample < tenth * ticks // 10:
            time.sleep(0.01)
        found.append(resident_bytes())
    loop.join()
    steps = [later - before for before, later in itertools.pairwise(found)]
    detail = f"{found[0]} B after a tenth, {found[-1]} B at the end; {loop.lateness().cost * 1e6:.2f} µs per tick"
    grown = len(steps) * statistics.median(steps)
    return common.Result(f"growth in {ticks} ticks [B]", grown, "at most", 0, detail)


def main() -> int:
    """Run the benchmark; returns the exit code."""
    parser = common.realtime_parser(__doc__, seconds=4.0, turns=3)
    parser.add_argument("--ticks", type=int, default=10**7, help="number of ticks without waiting (default 10^7)")
    parser.add_argument("--only", action="append", choices=tuple(RUN), help="only this axis or stage; may be repeated")
    options = parser.parse_args()
    common.require_compiled()
    runner.CLAIM = f"hysteresis_ros/benchmark/{os.getpid()}"  # so that loops of other programs have no influence
    results = [growth(options.ticks)]
    with tempfile.TemporaryDirectory() as folder, common.busy_core():
        program = built(pathlib.Path(folder))
        for name in options.only or RUN:
            results += paced(program, name, parameters_of(name, options), options)
        if not options.only:
            results += paced(program, "kim2009", parameters_of("kim2009", options, FASTEST), options)
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
