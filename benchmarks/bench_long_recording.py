# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis identify`` on half an hour at 10 kHz, as CSV and as NPZ: time, memory, and the identified lag."""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

import common
import numpy as np

from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiParameters

RATE = 10_000.0
#: The recorded actuator: plays, a lag [s], noise [m].
RADII = tuple(np.linspace(0.0, 1.6, 9).tolist())
WEIGHTS = (8e-6, *[0.5e-6] * 8)
LAG = 0.004
NOISE = 5e-9
#: Number of rows that are generated and written at a time.
BLOCK = 1_000_000
SECONDS = 60.0
GIGABYTES = 2.0
#: Relative error of the fitted lag.
LAG_ERROR = 0.05


def record(rows: int) -> dict[str, np.ndarray]:
    """Return the columns of a recording: a 1 Hz sine with slowly varying amplitude; hysteresis, lag and noise."""
    time_axis = np.arange(rows) / RATE
    amplitude = 1.8 * (0.75 + 0.25 * np.cos(2 * np.pi * time_axis / 60.0))
    voltage = 1.8 - amplitude * np.cos(2 * np.pi * time_axis)
    parameters = PrandtlIshlinskiiParameters(radii=RADII, weights=WEIGHTS)
    block = hysteresis_block(HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=parameters), 1.0 / RATE)
    displacement = LinearPart(lag=LAG).apply(block.simulate(voltage), 1.0 / RATE)
    displacement += NOISE * np.random.default_rng(1).standard_normal(rows)
    return {"t_s": time_axis, "control_V": voltage, "gauge_um": 1e6 * displacement}


def write_csv(columns: dict[str, np.ndarray], path: pathlib.Path) -> None:
    """Write the columns as a data logger does, with six decimals."""
    with path.open("w") as stream:
        stream.write(",".join(columns) + "\n")
        for first in range(0, len(columns["t_s"]), BLOCK):
            rows = zip(*(values[first : first + BLOCK].tolist() for values in columns.values()), strict=True)
            stream.writelines("%.4f,%.6f,%.6f\n" % row for row in rows)  # noqa: UP031 (twice as fast)


def identify(path: pathlib.Path) -> tuple[float, float, dict]:
    """Return the time [s], the memory [GB] and the figures of the command for one file."""
    words = [sys.executable, "-m", "hysteresis_ros.cli.entry", "identify", str(path), "--json", "-"]
    began = time.monotonic()
    process = subprocess.Popen([*words, "-o", str(path.with_suffix(".yaml"))], stdout=subprocess.PIPE)
    text = process.stdout.read() if process.stdout else b""
    _, status, usage = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 3):
        raise common.BenchmarkError(f"identify ended with exit code {os.waitstatus_to_exitcode(status)}")
    return time.monotonic() - began, usage.ru_maxrss / 1e6, json.loads(text)


def main() -> int:
    """Run the benchmark; returns the exit code."""
    parser = common.parser(__doc__)
    parser.add_argument("--rows", type=int, default=18_000_000, help="rows of the recording (default 18 million)")
    options = parser.parse_args()
    folder = pathlib.Path(tempfile.mkdtemp())
    results = []
    try:
        columns = record(options.rows)
        write_csv(columns, folder / "recording.csv")
        np.savez(folder / "recording.npz", **columns)
        del columns
        for suffix in ("csv", "npz"):
            seconds, gigabytes, figures = identify(folder / f"recording.{suffix}")
            detail = f"{figures['samples']} samples fitted, rmse {1e9 * figures['rmse_m']:.3g} nm"
            results += [
                common.Result(f"{suffix}: seconds", seconds, "at most", SECONDS, detail),
                common.Result(f"{suffix}: gigabytes", gigabytes, "at most", GIGABYTES),
                common.Result(
                    f"{suffix}: relative error of the lag",
                    abs((figures.get("lag_s") or 0.0) + (figures.get("delay_s") or 0.0) - LAG) / LAG,
                    "at most",
                    LAG_ERROR,
                    f"lag {1e3 * (figures.get('lag_s') or 0.0):.4g} ms, delay {figures.get('delay_s')}",
                ),
            ]
    finally:
        shutil.rmtree(folder)
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
