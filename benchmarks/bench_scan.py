# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Scans of coupled stages that differ from their models: identification from recordings, design, run, evaluation.

    python benchmarks/bench_scan.py --plants 0:12

Each plant has two actuators with hysteresis and creep of other classes than the model
(:mod:`hysteresis_ros.laboratory.foreign`), a structure with modes drawn around those of ``xy_scanner``, two modes that
the model of an axis does not contain, cross-talk, one sample of delay, 5 nm of noise and 16-bit converters. The stage
is excited, identified, controlled and scanned as the commands do it with their defaults: ``excite`` with the recipes
multisine and decaying, ``identify --loops --into`` a stage of devices, ``design --controller pid --scan`` for the slow
axis of the raster, ``design --learning``. All that the design knows is in these two recordings, and in the recorded
runs of the scan. Errors are those of the true displacement, also
between the samples, against the undelayed path.
"""

from __future__ import annotations

import json
import pathlib
import tempfile
import time
from dataclasses import dataclass, replace

import common
import numpy as np

from hysteresis_ros.analysis.scan_report import ScanRun, scan_figures
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.learning import LearningParameters, write_learned
from hysteresis_ros.designs.controller import DesignRequest
from hysteresis_ros.designs.coupled import (
    Uncertainties,
    calm_bandwidth,
    design_controllers,
    design_stage_learning,
    response_uncertainties,
    with_designs,
)
from hysteresis_ros.designs.coupled_learning import FEWEST, CoupledLearning, Trial, trial
from hysteresis_ros.designs.learning import LearningRequest
from hysteresis_ros.designs.stage_excitation import StageExcitation, excited_stage
from hysteresis_ros.designs.stage_identification import IdentifiedStage, StageRequest, identify_stage
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.identification.stage_data import StageReading, realisations
from hysteresis_ros.laboratory.comparison.rows import Bench
from hysteresis_ros.laboratory.foreign import HYSTERESES, Foreign, ForeignParameters
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters, StageScanParameters
from hysteresis_ros.loop.stage_simulation import displacements_between
from hysteresis_ros.models.limits import Limits
from hysteresis_ros.models.linear import zero_order_hold
from hysteresis_ros.models.sensor import Sensor
from hysteresis_ros.models.structure import Structure, StructureParameters
from hysteresis_ros.recordings.dataset import Recording

RATE, NAMES = 10e3, ("x", "y")
T = 1.0 / RATE
BENCH = Bench(sample_rate=RATE)
#: Recordings of ``hysteresis excite``: recipes with their defaults.
RECIPES = ("multisine", "decaying")
#: Entry ``driver`` of the file of a stage of devices.
DEVICE = "nv200"
#: Largest correction [m], ``--maximum``.
MAXIMUM = 15e-6
#: Ways of control: feedback alone; feedback with the inverse of the coupled loop; learning of each axis during the run;
#: joint learning of all axes from run to run.
WAYS = ("feedback", "inverse", "learning", "together")
#: Number of runs of :data:`FEWEST` periods from which the axes learn jointly before the evaluated run.
RUNS = 4
#: Part of the range of the identified stage over which the scans go.
PART = 0.8
#: Scans: kind and values, numbers of run and of evaluated periods, and targets for the error in the plane and for the
#: coupling [% of the size]. With 6 dB of gain margin and a mode at 700 Hz with damping 0.01, the bandwidth of a PI is
#: 0.01 · 700 Hz = 7 Hz; the fastest scan has ten times this frequency.
SCANS = {
    "raster, 5 Hz": (
        "raster",
        ("width={size}um", "depth={size}um", "lines=32", "flyback=8", "line_rate=5Hz", "slow=ramped"),
        (2, 1),
        (0.05, 0.01),
    ),
    "spiral, 20 Hz": (
        "spiral",
        ("diameter={size}um", "turns=20", "rim=2", "frame_rate=" + f"{20.0 / 20.25!r}Hz"),
        (9, 1),
        (0.1, None),
    ),
    "spiral, 70 Hz": (
        "spiral",
        ("diameter={size}um", "turns=40", "rim=2", "frame_rate=" + f"{70.0 / 40.25!r}Hz"),
        (14, 1),
        (0.3, None),
    ),
}


@dataclass(frozen=True)
class Plant:
    """A stage whose actuators are of other classes than the models."""

    actuators: tuple[ForeignParameters, ...]
    structure: StructureParameters

    def installed(self, stage: Stage) -> Stage:
        """Return a stage whose actuators are those of the plant."""
        for plant, given in zip(stage.plants, self.actuators, strict=True):
            chain, block = plant.actuator, Foreign(given, T)
            chain.hysteresis, chain.hysteresis_kernel = block, block.kernel
            chain.ps, chain.xs = chain.ps._replace(hysteresis=block.p), chain.xs._replace(hysteresis=block.x)
            chain.reset()
            plant.arrays = plant.arrays._replace(p=chain.ps, x=chain.xs)
        stage.reset()
        return stage


def drawn(seed: int) -> Plant:
    """Return a plant; the seed also selects the classes of its hystereses."""
    random = np.random.default_rng((seed, 25))

    def between(low, high):
        return float(random.uniform(low, high))

    actuators = tuple(
        ForeignParameters(
            hysteresis=HYSTERESES[(seed + place) % len(HYSTERESES)],
            stroke=between(52e-6, 56e-6),
            opening=between(0.1, 0.15),
            asymmetry=between(0.1, 0.2),
            rate=between(0.2, 0.5),
            creep=between(0.015, 0.03),
            exponent=between(0.12, 0.25),
            lag=0.0,
            # the actuator is faster than the structure, which contains all slower dynamics
            frequencies=(8e3, 9e3),
            dampings=(1.0, 1.0),
        )
        for place in range(2)
    )
    frequencies = [between(650, 750), between(750, 850), between(1800, 2300), between(2500, 3200)]
    dampings = [between(0.008, 0.015), between(0.008, 0.015), between(0.01, 0.03), between(0.01, 0.03)]
    A, B, C = np.zeros((8, 8)), np.zeros((8, 2)), np.zeros((2, 8))
    shapes = np.array([[1.0, between(0.02, 0.05)], [between(-0.05, -0.02), 1.0], [1.0, between(-0.3, 0.3)], [0.2, 1.0]])
    seen = np.array([[1.0, between(0.02, 0.05)], [between(0.02, 0.05), 1.0], [1.0, 0.2], [between(-0.3, 0.3), 1.0]])
    shares = (1.0, 1.0, between(0.02, 0.05), between(0.02, 0.05))
    for i, (frequency, damping) in enumerate(zip(frequencies, dampings, strict=True)):
        w, own = 2.0 * np.pi * frequency, slice(2 * i, 2 * i + 2)
        A[own, own], held = zero_order_hold([[0.0, w], [-w, -2.0 * damping * w]], [[0.0], [w]], T)
        B[own] = held * shapes[i] * shares[i]
        C[:, 2 * i] = seen[i]
    blocks = np.concatenate([A[i : i + 2, i : i + 2].ravel() for i in range(0, 8, 2)])
    values = {"A": blocks, "B": B.ravel(), "C": C.ravel()}
    matrices = {name: tuple(map(float, value)) for name, value in values.items()}
    return Plant(actuators, StructureParameters(inputs=2, outputs=2, sample_time=T, **matrices))


def recorded(plant: Plant, voltages: np.ndarray, seed: int) -> StageReading:
    """Return a recording of the plant under voltages [V], shape (N, 2), with its sensors and converters."""
    node = BENCH.node(seed)
    given = np.column_stack([Limits(node.limits, T).simulate(np.ascontiguousarray(one)) for one in voltages.T])
    drives = np.zeros_like(given)
    for place, actuator in enumerate(plant.actuators):
        # a sample of delay
        drives[1:, place] = Foreign(actuator, T).simulate(np.ascontiguousarray(given[:, place]))[:-1]
    moved = Structure(plant.structure, T).simulate(drives)
    seeds = [replace(node.sensor, seed=seed + 10 * i) for i in range(2)]
    measured = [Sensor(one, T).simulate(np.ascontiguousarray(moved[:, i])) for i, one in enumerate(seeds)]
    return StageReading(("ux", "uy"), NAMES, ((given, np.column_stack(measured)),), T, "the plant")


def identified(plant: Plant, seed: int) -> IdentifiedStage:
    """Return what ``hysteresis identify multisine --loops decaying --into STAGE`` gives for a stage of devices."""
    bare = load_configuration("xy_scanner")
    readings = []
    with tempfile.TemporaryDirectory() as folder:
        for place, name in enumerate(RECIPES):
            made = excited_stage(bare, StageExcitation(name), pathlib.Path(folder) / name)
            readings.append(recorded(plant, made.voltages, 100 * seed + place))
    # the plant takes the place of the devices, which are never opened
    devices = bare.override("plant_simulator", driver=DEVICE)
    return identify_stage(readings[0], realisations(readings[0]), StageRequest(), readings[1], devices)


def modelled(plant: Plant, seed: int, folder: pathlib.Path) -> tuple[StageParameters, Uncertainties]:
    """Return the identified stage with its controllers, from the file of an earlier run if it exists."""
    path = folder / f"identified_{seed}.yaml"
    if not path.exists():
        found = identified(plant, seed)
        found.save(path)
        for name, design in found.designs.items():
            kind = design.parameters.damping.type
            print(f"  {name}: bandwidth {design.margins.bandwidth:.4g} Hz, damping {kind}", flush=True)
        for warning in found.warnings:
            print(f"  warning: {warning}", flush=True)
    configuration = load_configuration(str(path)).override("plant_simulator", driver="")
    parameters = StageParameters.from_configuration(configuration)
    return parameters, response_uncertainties(configuration, parameters)


def calmed(parameters: StageParameters, known: Uncertainties) -> StageParameters:
    """Return the stage with the controller that ``design --controller pid --scan`` gives the slow axis of a raster."""
    calm = calm_bandwidth(parameters)
    if calm is None:
        return parameters
    designs = design_controllers(parameters, DesignRequest("pid"), known, calm[0])
    print(f"  {calm[0]}: bandwidth {designs[calm[0]].margins.bandwidth:.4g} Hz for its part of the raster", flush=True)
    return with_designs(parameters, designs)


def with_learning(parameters: StageParameters, learned: dict[str, LearningParameters]) -> StageParameters:
    """Return the stage with the given learning of its axes; inactive learning keeps its initial correction."""
    axes = [
        replace(axis, motion_controller=replace(axis.motion_controller, learning=learned[name]))
        if name in learned
        else axis
        for name, axis in zip(parameters.names, parameters.axes, strict=True)
    ]
    return replace(parameters, axes=tuple(axes))


def true_stage(plant: Plant, parameters: StageParameters) -> tuple[StageParameters, Stage]:
    """Return the stage with a plant instead of its models, and its parts at rest."""
    true = replace(parameters, stage=replace(parameters.stage, structure=plant.structure))
    sensors = [replace(BENCH.node(0).sensor, seed=1 + place) for place in range(len(NAMES))]
    # one sample of delay between command and structure, independent of the identified delay
    axes = tuple(
        replace(
            axis,
            plant_simulator=replace(
                axis.plant_simulator,
                dynamics=replace(axis.plant_simulator.dynamics, delay=T, sample_time=T),
                preload=type(axis.plant_simulator.preload)(),
                creep=replace(axis.plant_simulator.creep, type="none"),
                sensor=sensor,
            ),
        )
        for axis, sensor in zip(true.axes, sensors, strict=True)
    )
    true = replace(true, axes=axes)
    return true, plant.installed(Stage(true))


def run_on(plant: Plant, parameters: StageParameters) -> tuple[StageParameters, Recording]:
    """Return the stage with a plant instead of its models, and the recording of its run."""
    true, stage = true_stage(plant, parameters)
    signals = stage.run(stage.default_setpoints(stage.default_samples()))
    units = {"displacement": "m", "plant_voltage": "V", "saturated": "1", "measured": "m", "reference": "m"}
    columns = {f"{name}/{key}": signals[name][key] for name in NAMES for key in units}
    return true, Recording(
        signals["x"]["time"], columns, {f"{name}/{key}": unit for name in NAMES for key, unit in units.items()}, {}
    )


def judged(plant: Plant, parameters: StageParameters, periods: tuple[int, int]) -> dict:
    """Return the figures of a scan on the plant."""
    true, run = run_on(plant, parameters)
    instants, displacement = displacements_between(true, run, plant.installed(Stage(true)))
    scan = parameters.scan
    counts = (instants >= (periods[0] - periods[1]) * scan.period) & (instants < periods[0] * scan.period)
    # the references of a file count from the zero that its identification found
    middle = [a.generator.initial_setpoint + a.motion_controller.model.preload.offset for a in parameters.axes]
    reference = scan.position(instants[counts]) + np.array(middle)[:, None]
    figures = scan_figures(ScanRun(scan, instants[counts], reference, displacement[:, counts]))
    return {
        "rms": figures["rms_error_percent"],
        "coupling": figures["coupling_error_percent"],
        "max": figures["max_error_percent"],
        "saturated": float(np.mean(run["x/saturated"] + run["y/saturated"])),
    }


def learned_together(plant: Plant, parameters: StageParameters, folder: pathlib.Path) -> StageParameters:
    """Return the stage with the corrections learned jointly in :data:`RUNS` runs, from measurements alone."""
    learning = CoupledLearning.of(parameters, LearningRequest("coupled", maximum=MAXIMUM))
    trials: list[Trial] = []
    now = parameters
    while True:
        corrections = learning.after(trials)
        files = {name: str(folder / f"{name}_{len(trials)}.yaml") for name in NAMES}
        for name, correction in learning.learned(corrections).items():
            write_learned(files[name], correction)
        try:
            now = with_learning(parameters, learning.chosen(corrections, files))
        except ConfigurationError as error:
            print(f"  after {len(trials)} runs: {error}; the previous corrections are kept", flush=True)
            return now
        if len(trials) == RUNS:
            return now
        trials.append(trial(parameters, run_on(plant, now)[1], corrections))


def measured(seed: int, folder: pathlib.Path, models: pathlib.Path, ways: tuple[str, ...]) -> list[dict]:
    """Return the figures of all scans on one plant, for these ways of control."""
    begun = time.perf_counter()
    plant = drawn(seed)
    parameters, known = modelled(plant, seed, models)
    kinds = "/".join(actuator.hysteresis for actuator in plant.actuators)
    print(f"plant {seed} ({kinds}): identified and designed, {time.perf_counter() - begun:.0f} s", flush=True)
    rows = []
    size = round(
        PART * 1e6 * min(a.reference_generator.maximum - a.reference_generator.minimum for a in parameters.axes)
    )
    for name, (kind, texts, periods, _) in SCANS.items():
        values = tuple(text.format(size=size) for text in texts)
        following = calmed(parameters.following(StageScanParameters(kind, values, periods=periods[0])), known)
        chosen, left = {"feedback": {}}, {}
        if {"inverse", "learning"} & set(ways):
            found = design_stage_learning(following, LearningRequest("inversion", maximum=MAXIMUM), known)
            files = {}
            for axis, correction in found.corrections.items():
                files[axis] = str(folder / f"{seed}_{axis}.yaml")
                write_learned(files[axis], correction)
            learned = {axis: replace(design.parameters, file=files[axis]) for axis, design in found.designs.items()}
            frozen = {axis: replace(given, active=False) for axis, given in learned.items()}
            reached = {axis: round(design.filters.bandwidth * RATE) for axis, design in found.designs.items()}
            print(f"  learning up to {reached} Hz", flush=True)
            chosen, left = chosen | {"inverse": frozen, "learning": learned}, found.left
        for way in ways:
            # without learning the third period is the same as any later one
            lasts = periods if way == "learning" else (min(periods[0], 3), 1)
            if way == "together":
                lasts = (FEWEST, 1)
            shorter = following.following(replace(following.stage.scan, periods=lasts[0]))
            if way == "together":
                controlled_by = learned_together(plant, shorter, folder)
            else:
                controlled_by = with_learning(shorter, chosen[way])
            figures = judged(plant, controlled_by, lasts)
            rows.append({"plant": seed, "scan": name, "way": way, **figures, "left": left})
            shown = {key: f"{value:.4g}" for key, value in figures.items() if value is not None}
            print(f"  {name}, {way}: {shown}, {time.perf_counter() - begun:.0f} s", flush=True)
    return rows


def main() -> int:
    """Run the scans on all plants, print the worst results, and return the exit code."""
    parser = common.parser(__doc__.splitlines()[0])
    parser.add_argument("--plants", default="0:12", help="seeds of the plants, FIRST:LAST+1 (default 0:12)")
    parser.add_argument("--ways", default=",".join(WAYS), help="ways of control, separated by commas (default: all)")
    parser.add_argument("--rows", metavar="F", help="append the figures of each plant to this file, as lines of JSON")
    parser.add_argument("--models", metavar="FOLDER", help="folder of identified stages, to reuse and to add to")
    parser.add_argument("--from-rows", metavar="F", help="evaluate a file of --rows instead of running the scans")
    arguments = parser.parse_args()
    ways = tuple(arguments.ways.split(","))
    if set(ways) - set(WAYS):
        parser.error(f"--ways {arguments.ways}: there are {', '.join(WAYS)}")
    rows: list[dict] = []
    if arguments.from_rows:
        rows = [json.loads(line) for line in pathlib.Path(arguments.from_rows).read_text().splitlines()]
    else:
        common.require_compiled()
        with tempfile.TemporaryDirectory() as folder:
            for seed in range(*map(int, arguments.plants.split(":"))):
                models = pathlib.Path(arguments.models or folder)
                models.mkdir(parents=True, exist_ok=True)
                new = measured(seed, pathlib.Path(folder), models, ways)
                rows += new
                if arguments.rows:
                    with pathlib.Path(arguments.rows).open("a", encoding="utf-8") as stream:
                        stream.writelines(json.dumps(row) + "\n" for row in new)
    results = []
    plants = len({row["plant"] for row in rows})
    for name, (*_, (wanted, coupling)) in SCANS.items():
        for way in dict.fromkeys(row["way"] for row in rows):
            own = [row for row in rows if row["scan"] == name and row["way"] == way]
            each = [row["rms"] for row in own]
            largest = max(row["max"] for row in own)
            detail = f"worst of {plants} plants, median {np.median(each):.3g}, largest error {largest:.3g}"
            results.append(common.Result(f"{name}, {way} [% of size]", max(each), "at most", wanted, detail))
            if coupling is not None:
                crossed = [row["coupling"] for row in own]
                detail = f"median {np.median(crossed):.3g}"
                results.append(common.Result(f"{name}, {way}, coupling [%]", max(crossed), "at most", coupling, detail))
    return common.report(results, arguments)


if __name__ == "__main__":
    common.run(main)
