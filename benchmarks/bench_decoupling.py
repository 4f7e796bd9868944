# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Dynamic decoupling of setpoints and waveforms on coupled stages of other classes than their models.

    python benchmarks/bench_decoupling.py --plants 0:4 --models FOLDER

The stages are those of ``bench_scan.py``: identified from recordings, with one sample of delay, 5 nm of noise and 16
bits. x steps by 10 µm, or follows a triangle of 16 µm, while y holds its position. The motion of y is the difference
between this run and a run in which x holds its position too, so that noise and creep cancel. The error of x is that of
the displacement from the delayed reference. Both count from 0.1 s on. Compared are: feedback alone; the inverse
of each axis as feedforward; the feedforward of the stage.
"""

from __future__ import annotations

import pathlib
import tempfile
from dataclasses import replace

import bench_scan
import common
import numpy as np

from hysteresis_ros.control.feedforward import FeedforwardParameters
from hysteresis_ros.designs.stage_feedforward import design_stage_feedforward
from hysteresis_ros.loop.stage_parameters import StageFeedforwardParameters, StageParameters
from hysteresis_ros.references.waveforms import WaveformParameters

#: Length of a run, and time from which on motions count [s]; size of the step and amplitude of the triangles [m].
DURATION, COUNTED, STEP, AMPLITUDE = 0.3, 0.1, 10e-6, 8e-6
#: Frequencies of the triangles [Hz].
FREQUENCIES = (10.0, 30.0, 100.0)
WAYS = ("feedback", "inverses", "stage")


def ways_of(parameters: StageParameters) -> dict[str, StageParameters]:
    """Return the stage without feedforward, with the inverse of each axis, and with the feedforward of the stage."""
    found = design_stage_feedforward(parameters)
    print(
        f"  preview {found.preview} samples, coupling of the model {found.before:.3g} -> {found.after:.3g}", flush=True
    )
    alone = replace(found.parameters.stage, feedforward=StageFeedforwardParameters())
    none = tuple(
        replace(axis, motion_controller=replace(axis.motion_controller, feedforward=FeedforwardParameters()))
        for axis in parameters.axes
    )
    stages = replace(parameters, axes=none), replace(found.parameters, stage=alone), found.parameters
    return dict(zip(WAYS, stages, strict=True))


def run(plant, parameters: StageParameters, waveform: WaveformParameters | None, step: float) -> dict[str, np.ndarray]:
    """Return displacements and reference of a run on the plant, counted samples only."""
    parameters = parameters.scanning([]).with_duration(DURATION)
    x = parameters.axes[0]
    if waveform is not None:
        x = replace(x, reference_generator=replace(x.reference_generator, waveform=waveform))
    true, stage = bench_scan.true_stage(plant, replace(parameters, axes=(x, *parameters.axes[1:])))
    samples = round(DURATION * bench_scan.RATE)
    setpoints = stage.default_setpoints(samples)
    first = round(COUNTED * bench_scan.RATE)
    setpoints["x"] = setpoints["x"] + step * (np.arange(samples) >= first + samples // 8)
    signals = stage.run(setpoints)
    late = true.axes[0].motion_controller.feedforward.preview
    reference = signals["x"]["reference"]
    delayed = np.append(np.full(late, reference[0]), reference)[:samples]
    found = {"x": signals["x"]["displacement"], "y": signals["y"]["displacement"], "reference": delayed}
    return {name: values[first:] for name, values in found.items()}


def figures(plant, parameters: StageParameters) -> list[tuple[str, float, float, float]]:
    """Return, for each task, its name, peak and RMS of the motion of y, and the RMS error of x [nm]."""
    held = run(plant, parameters, None, 0.0)["y"]
    tasks = {"step of 10 µm": (None, STEP)}
    for frequency in FREQUENCIES:
        given = {"type": "triangle", "frequency": frequency, "amplitude": AMPLITUDE, "polarity": "symmetric"}
        tasks[f"triangle {frequency:g} Hz"] = (WaveformParameters(cycles=0, **given), 0.0)
    rows = []
    for name, task in tasks.items():
        one = run(plant, parameters, *task)
        moved, error = 1e9 * (one["y"] - held), 1e9 * (one["x"] - one["reference"])
        rows.append((name, float(np.max(np.abs(moved))), *(float(np.sqrt(np.mean(v**2))) for v in (moved, error))))
    return rows


def main() -> int:
    """Run all tasks on all plants, print the worst and return the exit code."""
    parser = common.parser(__doc__.splitlines()[0])
    parser.add_argument("--plants", default="0:4", help="first and last + 1 of the plants (default 0:4)")
    parser.add_argument("--models", metavar="FOLDER", help="identified stages of bench_scan.py")
    arguments = parser.parse_args()
    common.require_compiled()
    found: dict[tuple[str, str], list] = {}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(*map(int, arguments.plants.split(":"))):
            plant = bench_scan.drawn(seed)
            parameters, _ = bench_scan.modelled(plant, seed, pathlib.Path(arguments.models or folder))
            print(f"plant {seed}", flush=True)
            for way, one in ways_of(parameters).items():
                for name, *values in figures(plant, one):
                    found.setdefault((name, way), []).append(values)
                    peak, rms, error = values
                    print(f"  {name}, {way}: y {peak:.1f} nm, {rms:.2f} nm RMS; x {error:.1f} nm RMS", flush=True)
    results = []
    for name in dict.fromkeys(name for name, _ in found):
        worst = {way: np.max(found[name, way], axis=0) for way in WAYS}
        peaks = ", ".join(f"{way} {peak:.3g}" for way, (peak, *_) in worst.items())
        detail = f"largest of {len(found[name, 'stage'])} plants: peak {peaks}, RMS error of x {worst['stage'][2]:.3g}"
        rms, wanted = float(worst["stage"][1]), float(worst["feedback"][1])
        results.append(common.Result(f"{name}: motion of y [nm RMS]", rms, "at most", wanted, detail))
    return common.report(results, arguments)


if __name__ == "__main__":
    common.run(main)
