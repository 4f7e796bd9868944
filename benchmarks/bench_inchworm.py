# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A 5 mm move of the inchworm offline: simulated seconds per second of processor time."""

from __future__ import annotations

import pathlib
import statistics

import common

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.block import COMPILED

TARGET = 20.0
CONFIGURATION = pathlib.Path(__file__).resolve().parents[1] / "config" / "inchworm_travel.yaml"


def main() -> int:
    """Run the benchmark; returns the exit code."""
    options = common.parser(__doc__, repeats=7).parse_args()
    if not COMPILED:
        raise common.BenchmarkError("Numba is missing or switched off: there are no compiled kernels to measure")
    axis = single_axis(load_configuration(str(CONFIGURATION)))
    run = simulate(axis)  # compiles
    length = run.time.size * run.sample_time
    seconds = statistics.median(common.cpu_seconds(lambda: simulate(axis)) for _ in range(options.repeats))
    detail = f"{length:g} s at {1.0 / run.sample_time:g} Hz in {seconds:.3f} s, including the description of the run"
    moved = run["displacement"][-1] - run["displacement"][0]
    detail += f"; {moved * 1e3:.3f} mm"
    return common.report(
        [common.Result("5 mm move, ratio to real time", length / seconds, "at least", TARGET, detail)], options
    )


if __name__ == "__main__":
    common.run(main)
