# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recorded fused axes in real time, in turns with a C loop that sleeps until each deadline; one core is kept busy.

`hysteresis up FILE --fused --record BAG --verify` runs Kim's axis, the inchworm, and the stage of examples/c_stage,
a separate process with its own clock that is operated by a driver in C.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass

import bench_realtime
import common
import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration, parse_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.recordings.align import read_recording

ROOT = pathlib.Path(__file__).resolve().parents[1]
#: A stage at 5 kHz; its watchdog is longer than the bursts in which a busy machine misses deadlines.
STAGE = """
/**:
  ros__parameters: {{sample_rate: 5000.0, time_mode: realtime}}
/**/plant_simulator:
  ros__parameters:
    driver: {library}
    driver_options: ['name={name}', 'standstill=2.0']
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
/**/reference_generator:
  ros__parameters:
    minimum: 0.0
    maximum: 10.0e-6
    initial_setpoint: 4.0e-6
    waveform: {{type: sine, amplitude: 3.0e-6, frequency: 5.0, cycles: 0}}
/**/motion_controller:
  ros__parameters: {{type: open_loop}}
/**/hysteresis_compensator:
  ros__parameters:
    inverse: {{type: none}}
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
"""
#: Reference of Kim's axis: a triangle; the inchworm repeats the setpoints of its file.
KIM = {"waveform__type": "triangle", "waveform__amplitude": 5e-6, "waveform__frequency": 5.0, "waveform__cycles": 0}
#: Largest p99 lateness and largest number of missed deadlines, as a ratio to the C loop.
RATIO = 1.5
#: Longest time for starting, compiling and verifying a run [s].
PATIENCE = 600.0


@dataclass(frozen=True)
class Turn:
    """Lateness [s] of a run (p99) and of the C loop (each sample), and numbers of skipped and of lost samples."""

    samples: int
    p99: float
    skipped: int
    bursts: int
    yardstick: np.ndarray
    lost: int
    verified: bool


@contextlib.contextmanager
def stage(folder: pathlib.Path) -> Iterator[Configuration]:
    """Build the example, start the stage, and yield the configuration of its axis."""
    example, headers = ROOT / "examples" / "c_stage", ROOT / "hysteresis_ros" / "hardware"
    command = ["gcc", "-std=c11", "-O2", f"-I{headers}", f"-I{example}"]
    program, library = folder / "stage_device", folder / "libstage.so"
    subprocess.run([*command, str(example / "stage_device.c"), "-o", str(program), "-lm", "-lrt"], check=True)
    shared = ["-fPIC", "-shared", str(example / "stage_driver.c"), "-o", str(library), "-lm", "-lrt"]
    subprocess.run([*command, *shared], check=True)
    name = f"/bench_{os.getpid()}"
    options = [str(program), name, "--watchdog", "2", "--rate", "20000"]
    with subprocess.Popen(options, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield parse_configuration(STAGE.format(library=library, name=name), "c_stage")
        finally:
            process.kill()
            pathlib.Path(f"/dev/shm{name}").unlink(missing_ok=True)


def configurations(folder: pathlib.Path, stack: contextlib.ExitStack) -> dict[str, Configuration]:
    """Return the configurations by name."""
    kim = load_configuration("kim2009").override("reference_generator", **KIM)
    return {
        "kim2009": kim,
        "inchworm_travel": load_configuration("inchworm_travel"),
        "c_stage": stack.enter_context(stage(folder)),
    }


def prepared(configuration: Configuration, folder: pathlib.Path, options) -> pathlib.Path:
    """Write the parameter file of a run, and return its path."""
    realtime = {"realtime.priority": options.priority, "realtime.cpu": options.cpu, "late_limit": -1}
    axis = single_axis(configuration.override("plant_simulator", **realtime))
    path = folder / "axis.yaml"
    path.write_text(axis.configuration_text(), encoding="utf-8")
    return path


def run(path: pathlib.Path, bag: pathlib.Path, options) -> bool:
    """Run and record an axis; return whether its repetition offline is the same and no sample is missing."""
    command = [sys.executable, "-m", "hysteresis_ros.cli.entry", "up", str(path), "--fused", "--record", str(bag)]
    command += ["--duration", repr(options.seconds), "--verify"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=options.seconds + PATIENCE)
    verified = done.returncode == 0 and "bit for bit, none missing" in done.stdout
    if not verified:
        print(done.stdout, done.stderr, sep="\n", file=sys.stderr)
    return verified


def one_turn(program, configuration: Configuration, folder: pathlib.Path, index: int, options) -> Turn:
    """Run the C loop and the axis one after the other, in alternating order."""
    rate = single_axis(configuration).plant_simulator.sample_rate
    samples = round(options.seconds * rate)
    first = bench_realtime.yardstick(program, rate, samples, options) if index % 2 == 0 else None
    bag = folder / f"bag{index}"
    verified = run(prepared(configuration, folder, options), bag, options)
    late = first if first is not None else bench_realtime.yardstick(program, rate, samples, options)
    recorded = read_recording(bag, further=True)
    timing = recorded.metadata["timing"]
    skipped = recorded["skipped"] if recorded.has("skipped") else np.zeros(len(recorded))
    lost = samples - len(recorded) + recorded.metadata["missing_samples"]
    shutil.rmtree(bag)
    return Turn(
        samples, timing["lateness_p99_s"], int(np.sum(skipped)), bursts(skipped > 0.0), late * 1e-9, lost, verified
    )


def bursts(skipped: np.ndarray) -> int:
    """Return the number of groups of consecutive skipped samples."""
    return int(np.count_nonzero(np.diff(np.concatenate([[0], skipped.astype(int)])) > 0))


def judged(program, name: str, configuration: Configuration, folder: pathlib.Path, options) -> list[common.Result]:
    """Return the figures of one axis."""
    rate = single_axis(configuration).plant_simulator.sample_rate
    turns = [one_turn(program, configuration, folder, index, options) for index in range(options.turns)]
    for turn in turns:
        missed = turn.yardstick >= 1.0 / rate
        print(
            f"{name}: p99 {1e6 * turn.p99:.1f} µs, missed {turn.skipped} in {turn.bursts} groups of {turn.samples}; "
            f"C {1e6 * np.quantile(turn.yardstick, 0.99):.1f} µs, {np.count_nonzero(missed)} in {bursts(missed)}",
            flush=True,
        )
    ratio = statistics.median(turn.p99 / np.quantile(turn.yardstick, 0.99) for turn in turns)
    ours = sum(turn.skipped for turn in turns)
    theirs = sum(int(np.count_nonzero(turn.yardstick >= 1.0 / rate)) for turn in turns)
    title = f"{name}, {rate:g} Hz, recorded"
    at_most = "at most"
    limit = RATIO
    detail = f"{ours}, C {theirs} of {sum(turn.samples for turn in turns)}"
    return [
        common.Result(f"{title}: p99 lateness, ratio to C", float(ratio), at_most, limit),
        common.Result(f"{title}: missed + 1, ratio to C", (ours + 1) / (theirs + 1), at_most, limit, detail),
        common.Result(f"{title}: samples lost", sum(turn.lost for turn in turns), at_most, 0),
        common.Result(f"{title}: runs unlike offline", sum(not turn.verified for turn in turns), at_most, 0),
    ]


def main() -> int:
    """Run the benchmark; returns the exit code."""
    options = common.realtime_parser(__doc__, seconds=10.0, turns=2).parse_args()
    common.require_compiled()
    results = []
    with tempfile.TemporaryDirectory() as made, contextlib.ExitStack() as stack, common.busy_core():
        folder = pathlib.Path(made)
        program = bench_realtime.built(folder)
        for name, configuration in configurations(folder, stack).items():
            results += judged(program, name, configuration, folder, options)
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
