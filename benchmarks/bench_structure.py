# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""Identification of a coupled structure: the measured fast steering mirror (Floren et al. 2024), official split.

    python benchmarks/bench_structure.py FOLDER

FOLDER holds ``u_100mV_train.npy`` … ``y_300mV_test.npy`` of github.com/merijnfloren/fsm-benchmark-data (CC BY 4.0).
Orders and the ends of the searches are chosen on held-out realisations of the training data; the test data are used
once, at the end. Figures are the mean over outputs, realisations and periods of the RMS error after the first 100
samples [µm].
"""

from __future__ import annotations

import pathlib
import time

import common
import numpy as np

from hysteresis_ros.identification.coupled import IdentifiedStructure, StructureData, StructureEstimator

LEVELS = (100, 200, 300)  # [mV]
SAMPLE_TIME, PERIOD = 1.0 / 6400.0, 8192
#: Number of samples that are not evaluated, by the rule of the data set.
SKIP = 100
#: Highest excited frequency [Hz].
BAND = (0.5, 2999.9)
#: Orders that are tried for the linear models, and order of the structure. The errors of these orders on held-out
#: realisations of the training data differ by little more than 1 % at 200 mV.
ORDERS, STRUCTURE_ORDER = (36, 40, 44), 40
#: Largest errors of a linear model for each level and of one structure for all levels [µm]; largest time of
#: the identification of the structure [s].
WANTED_LINEAR = (0.066, 0.116, 0.165)
WANTED_STRUCTURE = (0.080, 0.131, 0.169)
WANTED_SECONDS = 600.0
#: Time after which no step begins [s] (a step may take 30 s on a busy machine), and maximum number of steps.
SEARCH, STEPS = 560.0, 40


def recordings(folder: pathlib.Path, split: str, levels=LEVELS) -> StructureData:
    """Return the realisations of some levels from arrays of shape (samples, channels, realisations, periods)."""

    def read(name: str) -> np.ndarray:
        parts = [
            np.load(folder / f"{name}_{level}mV_{split}.npy", allow_pickle=False).transpose(2, 3, 0, 1)
            for level in levels
        ]
        whole = np.concatenate(parts)
        return whole.reshape(len(whole), -1, whole.shape[3])

    return StructureData(read("u"), read("y"), SAMPLE_TIME, PERIOD)


def errors(found: IdentifiedStructure, data: StructureData) -> np.ndarray:
    """Return the error of a structure at each level [µm]."""
    return 1e6 * found.score(data, SKIP).mean(axis=1)


def main() -> int:
    """Identify, print the figures and return the exit code."""
    parser = common.parser(__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", help="folder of the recordings")
    parser.add_argument("--only", choices=("linear", "structure"), help="run only this part")
    parser.add_argument("--save", metavar="F", help="write the structure to this parameter file")
    parser.add_argument("--verbose", action="store_true", help="print each step")
    arguments = parser.parse_args()
    folder = pathlib.Path(arguments.folder or "")
    if arguments.folder is None or not (folder / "u_100mV_train.npy").exists():
        print("bench_structure: skipped, because there are no recordings; give the folder of the mirror's recordings")
        return 0
    progress = (lambda text: print(f"  {text}", flush=True)) if arguments.verbose else None
    results = []
    if arguments.only != "structure":
        for level, target in zip(LEVELS, WANTED_LINEAR, strict=True):
            begun = time.perf_counter()
            estimator = StructureEstimator(order=ORDERS, plays=0, band=BAND, progress=progress)
            found = estimator.fit(recordings(folder, "train", (level,)))
            seconds = time.perf_counter() - begun
            value = float(errors(found, recordings(folder, "test", (level,)))[0])
            detail = f"order {found.parameters.order}, {seconds:.0f} s"
            results.append(common.Result(f"linear, {level} mV [µm]", value, "at most", target, detail))
    if arguments.only != "linear":
        begun = time.perf_counter()
        estimator = StructureEstimator(order=STRUCTURE_ORDER, seconds=SEARCH, steps=STEPS, band=BAND, progress=progress)
        found = estimator.fit(recordings(folder, "train"))
        seconds = time.perf_counter() - begun
        held = ", ".join(f"{1e6 * value:.4f}" for value in found.figures["held_out_rmse_m"])
        detail = f"order {found.parameters.order}, {found.figures['plays']} plays, held out {held}"
        for level, target, value in zip(
            LEVELS, WANTED_STRUCTURE, errors(found, recordings(folder, "test")), strict=True
        ):
            results.append(common.Result(f"one structure, {level} mV [µm]", float(value), "at most", target, detail))
        results.append(common.Result("identification of the structure [s]", seconds, "at most", WANTED_SECONDS))
        if arguments.save:
            found.save(arguments.save)
    return common.report(results, arguments)


if __name__ == "__main__":
    common.run(main)
