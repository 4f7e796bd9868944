# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Position error at the triggers of a 10 Hz scan, with noise and resolution of the sensor off.

    python benchmarks/bench_triggers.py

At the instant of each trigger the true displacement, also between the samples (held inputs, exact), is compared with
the position of the trigger. The error is given in % of the path of that sample. For comparison: the error when the
instant is that of a straight line between two measurements.
"""

from __future__ import annotations

import common
import numpy as np
from scipy.interpolate import CubicSpline

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import continued, displacements_between, simulate_stage, with_scan
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.triggers import triggers_of

#: A sensor without noise and without steps of its converter.
NOISELESS = {"sensor__noise": 0.0, "sensor__resolution": 0.0}
#: Rate of the scans [Hz], duration of the runs [s], parts of a sample at which displacements are computed, and largest
#: error [% of a sample's path].
RATE, DURATION, PARTS, TARGET = 10.0, 0.25, 20, 1.0


def position_errors(run: Recording, time: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the error at each trigger [% of the sample's path], and that of a straight line.

    ``time`` [s] and ``truth`` [m] are the true displacement, also between the samples.
    """
    found, measured, step = triggers_of(run), run["measured"], run.sample_time
    true_at = CubicSpline(time, truth)
    before, after = measured[found.sample - 1], measured[found.sample]
    path = np.abs(after - before)
    line = run.time[found.sample - 1] + (found.position - before) / (after - before) * step
    return tuple(100.0 * np.abs(true_at(instant) - found.position) / path for instant in (found.time, line))


def of_axis(name: str, waveform: str, low: float, high: float, grid: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of a shipped axis that follows a waveform between two positions [m], with a grid [m]."""
    triggers = {"triggers__start": low + grid, "triggers__step": grid, "triggers__stop": high - grid}
    shape = {"type": waveform, "frequency": RATE, "amplitude": high - low, "offset": low, "polarity": "unipolar"}
    if waveform == "sine":
        shape |= {"amplitude": 0.5 * (high - low), "offset": 0.5 * (high + low)}
        del shape["polarity"]
    configuration = load_configuration(name).override("plant_simulator", **NOISELESS)
    given = triggers | {f"waveform__{key}": value for key, value in shape.items()}
    parameters = AxisParameters.from_configuration(configuration.override("reference_generator", **given))
    run, plant = simulate(parameters, duration=DURATION), parameters.plant_simulator
    one = Axis(parameters).plant.actuator
    # a voltage is held after its sample; before the first one, the axis rests (the dynamics have unit DC gain)
    drive = one.creep.simulate(one.hysteresis.simulate(run["plant_voltage"]))
    rest = run["displacement"][:1] - plant.preload.offset
    late = round(plant.dynamics.delay * plant.sample_rate)
    drive = np.concatenate([np.repeat(rest, late), drive])[: len(run)]
    places = np.arange(PARTS) / PARTS
    found = continued(plant.dynamics.matrices, rest, drive[None], places)
    if found is None:
        raise common.BenchmarkError(f"{name}: its dynamics have no continuous equivalent")
    truth = found[0] + plant.preload.offset
    error = float(np.max(np.abs(truth[:, 0] - run["displacement"])))
    if error > 1e-12:
        raise common.BenchmarkError(f"{name}: the truth differs from the displacement by {error:g} m")
    time = run.time[:, None] + places / plant.sample_rate
    return position_errors(run, time.ravel(), truth.ravel())


def of_stage(name: str, width: float, grid: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of the fast axis of a raster on a shipped stage, with a grid [m]."""
    words = (f"width={width}m", "depth=5um", "lines=4", f"line_rate={RATE}Hz")
    configuration = with_scan(load_configuration(name), "raster", words).override("plant_simulator", **NOISELESS)
    middle = StageParameters.from_configuration(configuration).axes[0].reference_generator.initial_setpoint
    low, high = middle - 0.5 * width, middle + 0.5 * width
    triggers = {"triggers__start": low + grid, "triggers__step": grid, "triggers__stop": high - grid}
    parameters = StageParameters.from_configuration(configuration.override("x/reference_generator", **triggers))
    run = simulate_stage(parameters, duration=DURATION)
    time, truth = displacements_between(parameters, run)
    return position_errors(run.axis("x"), time, truth[0])


def main() -> int:
    """Measure the error on three axes; return the exit code."""
    options = common.parser(__doc__.splitlines()[0]).parse_args()
    rows = {
        "stage700, triangle of 10 um": of_axis("stage700", "triangle", 5e-6, 15e-6, 0.5e-6),
        "stage700, sine of 10 um": of_axis("stage700", "sine", 5e-6, 15e-6, 0.5e-6),
        "xy_scanner, raster of 20 um": of_stage("xy_scanner", 20e-6, 1e-6),
    }
    results = []
    for name, (error, line) in rows.items():
        detail = (
            f"{error.size} triggers, RMS {np.sqrt(np.mean(error**2)):.3g} %; by a line: largest {np.max(line):.3g} %"
        )
        results.append(common.Result(f"{name}: largest error", float(np.max(error)), "at most", TARGET, detail))
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
