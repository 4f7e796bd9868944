# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Predicted and true times until random moves are ready, on plants that differ from their models.

    python benchmarks/bench_ready.py --moves 50 --tolerance 5

The axis is ``stage700`` (20 kHz, a mode at 700 Hz, one sample of delay) with creep, its sensor has 3 nm of noise.
Plants of the class of the model deviate from it by 5 % in gain, loop width, all times and creep, each up or down, and
in each weight of the hysteresis. Plants of other classes (:mod:`hysteresis_ros.laboratory.foreign`) have mechanics that
deviate likewise; the model of their hysteresis is a Prandtl-Ishlinskii operator that is fitted to decaying loops.

The truth is the displacement also between the samples, ten points each. A prediction is right within 10 % of the true
time, or within two samples. ``outside`` is the largest fraction of the time of a run after ``ready`` became true, until
the next move, for which the displacement is outside the tolerance.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

import common
import numpy as np
from scipy.optimize import nnls

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.laboratory.between_samples import INSTANTS
from hysteresis_ros.laboratory.comparison.tasks import DrawnPlant, ForeignPlant, ModelledPlant
from hysteresis_ros.laboratory.foreign import HYSTERESES, Foreign, ForeignParameters
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters, PlantNodeParameters
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.ready import Predictor, entry, model_of
from hysteresis_ros.loop.simulation import deviating
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiParameters
from hysteresis_ros.references.moves import NoiseMeter, Readiness
from hysteresis_ros.references.recipes import recipe

MISMATCH, NOISE, DWELL = 0.05, 3e-9, 2e-3
CREEP = CreepParameters.from_mapping(
    {"type": "logarithmic", "logarithmic.rate": 0.015, "logarithmic.longest_time": 10.0}
)
#: Pauses between two moves [s].
PAUSES = 0.04, 0.08
#: Samples before a move that the models have not followed when its setpoint arrives.
UNFOLLOWED = 200
#: Radii of the fitted operators [V].
RADII = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 27.0, 35.0, 45.0)


def stage(hysteresis: HysteresisParameters | None = None) -> AxisParameters:
    """Return the axis; with a hysteresis in place of its own."""
    axis = single_axis(load_configuration("stage700"))
    plant, compensator = replace(axis.plant_simulator, creep=CREEP), replace(axis.hysteresis_compensator, creep=CREEP)
    if hysteresis is not None:
        plant, compensator = (replace(node, hysteresis=hysteresis) for node in (plant, compensator))
    plant = replace(plant, sensor=replace(plant.sensor, noise=NOISE))
    return replace(axis, plant_simulator=plant, hysteresis_compensator=compensator)


def modelled(seed: int) -> tuple[AxisParameters, DrawnPlant]:
    """Return the axis and a plant of the class of its model."""
    axis, random = stage(), np.random.default_rng((seed, 26))

    def factor(count=None):
        return 1.0 + MISMATCH * random.choice((-1.0, 1.0), count)

    gain, opening, slowness, creep = (float(factor()) for _ in range(4))
    plant = replace(axis.plant_simulator, sensor=replace(axis.plant_simulator.sensor, seed=seed + 1))
    changed = deviating(plant, Deviation(gain, opening, factor), slowness, creep)
    return axis, ModelledPlant(PlantNodeParameters.from_mapping({**plant.to_mapping(), **changed}))


def foreign(seed: int) -> tuple[AxisParameters, DrawnPlant]:
    """Return a plant of another class and the axis whose model was fitted to it."""
    random, rate = np.random.default_rng((seed, 27)), single_axis(load_configuration("stage700")).source.sample_rate

    def near(value: float) -> float:
        return value * (1.0 + MISMATCH * float(random.choice((-1.0, 1.0))))

    actuator = ForeignParameters(
        hysteresis=HYSTERESES[seed % len(HYSTERESES)],
        stroke=20e-6,
        opening=0.15,
        asymmetry=0.1,
        rate=0.1,
        creep=0.03,  # from 0.1 to 10 s: 0.015 a decade
        exponent=0.05,
        lag=0.0,
        delay=1.0 / rate,
        frequencies=(near(700.0), 8e3),
        dampings=(near(0.01), 0.5),
        share=0.0,
        steps=INSTANTS,
    )
    axis = stage(HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=_fitted(actuator)))
    plant = replace(axis.plant_simulator, sensor=replace(axis.plant_simulator.sensor, seed=seed + 1))
    return axis, ForeignPlant(plant, replace(actuator, stroke=near(actuator.stroke)))


def _fitted(actuator: ForeignParameters) -> PrandtlIshlinskiiParameters:
    """Return play operators fitted to slow decaying loops, by non-negative least squares."""
    rate = 2000.0
    voltage = recipe("decaying", 0.0, actuator.voltage, rate, frequency=2.0).samples
    displacement = Foreign(replace(actuator, delay=0.0), 1.0 / rate).between(voltage)[:, -1]
    plays = np.zeros((len(RADII) + 1, len(voltage)))
    plays[-1] = 1.0
    for radius, play in zip(RADII, plays[:-1], strict=True):
        last = 0.0
        for k, value in enumerate(voltage):
            play[k] = last = max(value - radius, min(value + radius, last))
    found, _ = nnls(plays.T * 1e7, displacement * 1e7 / 1e-7)
    weights = tuple((1e-7 * found[:-1]).tolist())
    return PrandtlIshlinskiiParameters(radii=RADII, weights=weights, offset=float(1e-7 * found[-1]))


def judge(axis: AxisParameters, plant: DrawnPlant, moves: int, tolerance: float, seed: int) -> dict[str, float]:
    """Run random moves and return the figures of their predictions."""
    rate, own = plant.sample_rate, axis.generator
    random = np.random.default_rng((seed, 28))
    low, high = own.minimum + 0.1 * (own.maximum - own.minimum), own.maximum - 0.1 * (own.maximum - own.minimum)
    setpoints, begins = [own.initial_setpoint] * round(0.2 * rate), []
    for _ in range(moves):
        begins.append(len(setpoints))
        setpoints += [float(random.uniform(low, high))] * round(rate * random.uniform(*PAUSES))
    begins.append(len(setpoints))
    run = Axis(axis, plant.in_loop()).run(np.array(setpoints))
    between = plant.between(run["plant_voltage"])
    # voltages act from the next sample on
    true = np.concatenate([np.full(INSTANTS, run["displacement"][0]), between[:-1].ravel()])
    true += np.median(run["displacement"][1:] - between[:-1, -1])
    predictor = Predictor(model_of(own, axis.motion_controller, axis.hysteresis_compensator))
    meter = NoiseMeter(20e-3, 1.0 / rate)
    meter.take(run["reference"][: begins[0]], run["measured"][: begins[0]])
    rows, last, costs = [], 0, []
    for first, end in zip(begins[:-1], begins[1:], strict=True):
        noise = meter.noise(predictor.resting.displacement, predictor.resting.error)
        begun, target = time.thread_time(), setpoints[first]
        predicted = predictor.predict(target, first - last, tolerance, DWELL, noise)
        costs.append(time.thread_time() - begun)
        ready, told = Readiness(tolerance, DWELL, noise, 1.0 / rate), end
        for k in range(first, end):
            if ready.look(target, run["measured"][k]) and told == end:
                told = k
        meter.take(run["reference"][first:end], run["measured"][first:end])
        predictor.learn(run["measured"][first:end], noise)
        predictor.follow(end - first - UNFOLLOWED)
        error = true[INSTANTS * first : INSTANTS * end] - target
        # the first of the points of a sample follows it by a part of the sample time
        truth = (entry(error, tolerance, round(DWELL * rate * INSTANTS)) + 1.0) / INSTANTS / rate
        left = np.abs(true[INSTANTS * told : INSTANTS * end] - target) > tolerance
        due = np.abs(error[round(predicted * rate) * INSTANTS :]) > tolerance if math.isfinite(predicted) else []
        rows.append((predicted, truth, ready.since, np.sum(left), len(left), np.sum(due), len(due)))
        last = first
    predicted, truth, since, *counts = np.array(rows).T
    missed = np.abs(predicted - truth)
    right = missed <= np.maximum(0.1 * truth, 2.0 / rate)
    seen = np.abs(since - truth) <= np.maximum(0.1 * truth, 2.0 / rate)
    return {
        "right": float(np.mean(right)),
        "right later": float(np.mean(right[1:])),
        "seen": float(np.mean(seen)),
        "outside": float(np.sum(counts[0]) / max(np.sum(counts[1]), 1)),
        "outside predicted": float(np.sum(counts[2]) / max(np.sum(counts[3]), 1)),
        "never": float(np.mean(np.isnan(since))),
        "time": float(np.median(truth)),
        "error": float(np.median(missed)),
        "noise": noise.sensor,
        "moves by": noise.displacement,
        "cost": float(np.median(costs)),
    }


def main() -> int:
    """Print a table of all plants and the targets."""
    parser = common.parser(__doc__)
    parser.add_argument("--moves", type=int, default=50, help="number of moves of each plant (default 50)")
    parser.add_argument("--tolerance", type=float, default=5.0, help="[nm] (default 5)")
    parser.add_argument("--plants", type=int, default=4, help="number of plants of each kind (default 4)")
    options = parser.parse_args()
    common.require_compiled()
    right, outside = [], []
    for kind in (modelled, foreign):
        for seed in range(options.plants):
            axis, plant = kind(seed)
            found = judge(axis, plant, options.moves, 1e-9 * options.tolerance, seed)
            name = HYSTERESES[seed % len(HYSTERESES)] if kind is foreign else "model's class"
            print(
                f"{name:13} predicted within 10 % {100 * found['right']:5.1f} %, from the second move on"
                f" {100 * found['right later']:5.1f} %; measured {100 * found['seen']:5.1f} %; true"
                f" {1e3 * found['time']:6.2f} ms, error {1e3 * found['error']:5.2f} ms; outside after ready"
                f" {100 * found['outside']:.3f} %, after the predicted time {100 * found['outside predicted']:.2f} %;"
                f" never ready {100 * found['never']:.1f} %; noise {1e9 * found['noise']:.2f} nm, of the displacement"
                f" {1e9 * found['moves by']:.2f} nm; {1e3 * found['cost']:.1f} ms of a core",
                flush=True,
            )
            outside.append(found["outside"])
            right += [found["right"]] if kind is modelled else []
    detail = f"{options.plants} plants, {options.moves} moves each, tolerance {options.tolerance:g} nm"
    results = [
        common.Result(
            "predicted within 10 %, model's class: %", 100.0 * sum(right) / len(right), "at least", 90.0, detail
        ),
        common.Result("outside after ready, worst plant: %", 100.0 * max(outside), "at most", 1.0, "all plants"),
    ]
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
