# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Quiet hold: noise of the true displacement with and without the loop, and drift by creep with and without the model.

    python benchmarks/bench_quiet.py

Two axes stand still after a step: the measured stage ``picma_stage`` (20 um, 200 Hz), and ``kim2009`` (5 um, 3 kHz), a
resonance with 3 % of damping, to which the creep of the measured stage is added. Assumed: noise of the sensor of 3 nm
RMS, converters of 18 bits. Figures are the RMS over SEEDS realisations of the noise.

noise: RMS of the true displacement about its mean and its slow drift (a line), in a window of this length.
drift: true displacement at the end of the window minus at its beginning; with the compensator's creep model, without
one, and on plants that differ from the model: 30 % more creep, or creep of another law (two relaxations, 0.5 s and
20 s), both with a gain and a loop width of the hysteresis that differ by up to 20 %.
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.quiet import Quiet
from hysteresis_ros.loop.simulation import mismatched, simulate
from hysteresis_ros.loop.watch import QUIET
from hysteresis_ros.recordings.dataset import Recording

#: Lengths of the windows [s].
WINDOWS = (0.01, 0.1, 1.0, 10.0, 60.0)
#: Realisations of the noise; time of the request after the step [s]; tolerances of the drift [m].
SEEDS, START, TOLERANCES = 5, 3.0, (1e-9, 5e-9, 20e-9, 100e-9)
#: Largest ratio of the noise in a quiet hold to that of the loop; largest ratio of the largest step of the voltage in
#: the 0.2 s after a hold to the largest one of the loop.
QUIETER, STEP = 0.5, 2.0
CREEP = {"creep__type": "logarithmic", "creep__logarithmic__rate": 0.014638681}
OTHER_LAW = {"creep__type": "operators", "creep__operators__weights": (0.01, 0.015)}
OTHER_LAW |= {"creep__operators__time_constants": (0.5, 20.0)}
AXES = {"picma_stage": 20e-6, "kim2009": 5e-6}


def given(name: str, model: bool, plant: dict[str, Any], mismatch: float) -> Configuration:
    """Return an axis that stands still after a step, its compensator with or without a model of the creep."""
    found = load_configuration(name)
    noisy = {"sensor__noise": 3e-9, "limits__bits": 18}
    found = found.override("plant_simulator", **noisy, **CREEP)
    found = found.override("hysteresis_compensator", limits__bits=18, **(CREEP if model else {"creep__type": "none"}))
    found = found.override("reference_generator", waveform__type="hold", initial_setpoint=AXES[name])
    # before the creep, of which the mismatch is given here and not drawn
    found = mismatched(found, mismatch, 1) if mismatch else found
    return found.override("plant_simulator", **plant)


def run_of(configuration: Configuration, seed: int, quiet: bool) -> tuple[Recording, int]:
    """Return a run of 60 s after the beginning of the quiet hold, and the sample in which the command stands still."""
    parameters = AxisParameters.from_configuration(configuration.override("plant_simulator", sensor__seed=seed))
    holds = (Quiet(START, WINDOWS[-1]),) if quiet else ()
    run = simulate(parameters, duration=START + WINDOWS[-1] + 2.0, quiet=holds, describe=False)
    begins = START + 2.0 * parameters.motion_controller.quiet.average
    first = round(begins * parameters.plant_simulator.sample_rate)
    if quiet and int(np.flatnonzero(run["controller_mode"] == QUIET)[0]) != first:
        raise common.BenchmarkError("the command did not stand still when it should")
    return run, first


def noise(values: np.ndarray) -> float:
    """Return the RMS of a displacement [m] about a line."""
    if values.size < 3:
        return float(np.std(values))
    time = np.arange(values.size)
    return float(np.std(values - np.polyval(np.polyfit(time, values, 1), time)))


def figures(configuration: Configuration, quiet: bool) -> dict[str, list[float]]:
    """Return noise and drift [m] in each window, and the offset that remains [m], as RMS over the realisations."""
    found: dict[str, list[list[float]]] = {"noise": [], "drift": [], "step": []}
    for seed in range(SEEDS):
        run, first = run_of(configuration, seed, quiet)
        rate = 1.0 / run.sample_time
        pieces = [run["displacement"][first : first + max(round(window * rate), 2)] for window in WINDOWS]
        found["noise"].append([noise(piece) for piece in pieces])
        found["drift"].append([piece[-1] - piece[0] for piece in pieces])
        end, steps = first + round(WINDOWS[-1] * rate), np.abs(np.diff(run["voltage"]))
        usual = np.max(steps[round((START - 1.0) * rate) : round(START * rate)])
        found["step"].append([np.max(steps[end - 1 : end + round(0.2 * rate)]) / usual])
    return {name: np.sqrt(np.mean(np.square(values), axis=0)).tolist() for name, values in found.items()}


def row(name: str, values: list[float], scale: float = 1e9) -> str:
    """Return a line of a table [nm]."""
    return f"  {name:34s}" + "".join(f"{scale * value:10.3g}" for value in values)


def longest(configuration: Configuration) -> str:
    """Return how long the axis may be quiet for some tolerances, by the forecast of its model."""
    parameters = AxisParameters.from_configuration(configuration)
    axis = Axis(parameters)
    axis.run(np.full(round(START * axis.sample_rate), parameters.reference_generator.initial_setpoint))
    forecast = axis.forecast()
    return ", ".join(f"{1e9 * tolerance:g} nm: {forecast.longest(tolerance):.3g} s" for tolerance in TOLERANCES)


def main() -> int:
    """Measure both axes; return the exit code."""
    options = common.parser(__doc__.splitlines()[0]).parse_args()
    results = []
    for name in AXES:
        exact = given(name, True, {}, 0.0)
        loop, quiet = figures(exact, False), figures(exact, True)
        drifts = {
            "drift, without creep model": figures(given(name, False, {}, 0.0), True),
            "drift, with model": quiet,
            "drift, 30 % more creep than model": figures(
                given(name, True, {"creep__logarithmic__rate": 1.3 * 0.014638681}, 0.2), True
            ),
            "drift, creep of another law": figures(given(name, True, OTHER_LAW, 0.2), True),
        }
        print(f"{name}\n  {'nm, in a window of':34s}" + "".join(f"{window:8g} s" for window in WINDOWS))
        print(row("noise, loop", loop["noise"]), row("noise, quiet hold", quiet["noise"]), sep="\n")
        for title, found in drifts.items():
            print(row(title, found["drift"]))
        print(f"  longest quiet hold by the forecast: {longest(exact)}")
        ratio, detail = quiet["noise"][2] / loop["noise"][2], f"{1e9 * loop['noise'][2]:.3g} nm with the loop"
        results.append(common.Result(f"{name}: noise in 1 s, quiet / loop", ratio, "at most", QUIETER, detail))
        detail = "largest in 0.2 s after the hold / largest of the loop in 1 s"
        results.append(common.Result(f"{name}: step of the voltage", quiet["step"][0], "at most", STEP, detail))
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
