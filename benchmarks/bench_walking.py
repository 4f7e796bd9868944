# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Continuous walking of an inchworm at speeds that were not learned: distance from the path before and after learning.

    python benchmarks/bench_walking.py

The correction is learned at 50 um/s and used at 10 to 200 um/s. The motors differ at random from their models, and the
errors are those of the true displacement, also between the samples.
"""

from __future__ import annotations

import common
import numpy as np

from hysteresis_ros.laboratory.papers.kim2009.walking import PARTS, SPEED, compared
from hysteresis_ros.models.block import COMPILED

#: Kick of the clamps [m/N] and least factor between the distances before and after learning.
CASES = {"rigid contacts": (0.0, 5.0), "clamps that kick by 1 nm/N": (1.0e-9, 4.0)}
#: Highest speed at which this also holds for the motor that improves least, as a multiple of the speed of learning.
FASTEST = 2.0


def main() -> int:
    """Run the benchmark; returns the exit code."""
    made = common.parser(__doc__)
    made.add_argument("--plants", type=int, default=3, help="number of random motors (default 3)")
    options = made.parse_args()
    if not COMPILED:
        raise common.BenchmarkError("Numba is missing or switched off: walking would take hours")
    results = []
    for name, (kick, target) in CASES.items():
        runs = [compared(seed, kick=kick) for seed in range(1, options.plants + 1)]
        for part in PARTS:
            before, after = (np.array([run[part][i].off_path for run in runs]) for i in (0, 1))
            pairs = "; ".join(
                f"{1e9 * one:.1f} -> {1e9 * other:.1f} nm" for one, other in zip(before, after, strict=True)
            )
            at_speed = f"{name}, {1e6 * part * SPEED:g} um/s"
            together = float(np.sqrt(np.sum(before**2) / np.sum(after**2)))
            results.append(common.Result(f"{at_speed}, all motors", together, "at least", target, pairs))
            if part <= FASTEST:
                least = float(np.min(before / after))
                results.append(common.Result(f"{at_speed}, least factor", least, "at least", target))
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
