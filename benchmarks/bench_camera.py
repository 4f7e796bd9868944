# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Positions measured in rendered frames of 640 x 480 with known motion: processor time and error per frame."""

from __future__ import annotations

import math
import statistics

import common
import numpy as np

from hysteresis_ros.hardware.simulated_camera import Scene, SceneParameters
from hysteresis_ros.hardware.tracker import CameraParameters, Tracker

FRAMES = 100
#: Largest processor time of a frame [ms], and largest rms error of the positions [px].
TIME, ERROR = 10.0, 0.02
REGION = (60.0, 112.0, 200.0, 256.0)
#: Conditions of the frames: name, parameters of the scene, parameters of the tracking.
CONDITIONS = (
    ("edge", {}, {}),
    ("edge, no noise, steady light", {"noise": 0.0, "light_drift": 0.0}, {}),
    ("edge, noise 5", {"noise": 5.0}, {}),
    ("edge, blur 3 px", {"blur": 3.0}, {}),
    ("edge, light ± 30 %", {"light_drift": 0.3}, {}),
    ("edge, noise 5, blur 2.5 px, light ± 30 %", {"noise": 5.0, "blur": 2.5, "light_drift": 0.3}, {}),
    ("pattern", {"texture": 0.1}, {"tracking.method": "pattern", "tracking.region": REGION}),
    (
        "pattern, noise 5, light ± 30 %",
        {"texture": 0.1, "noise": 5.0, "light_drift": 0.3},
        {"tracking.method": "pattern", "tracking.region": REGION},
    ),
)


def measured(scene: Scene, tracking: dict) -> tuple[float, float]:
    """Return the processor time of a frame [ms] and the error of the positions [px rms]."""
    given = scene.parameters
    eye = Tracker(CameraParameters.from_mapping({"calibration.scale": given.scale, **tracking}))
    pixels = np.concatenate([[0.0], np.random.default_rng(1).uniform(-50.0, 50.0, FRAMES)])
    places, times = [], []
    for number, place in enumerate(pixels):
        frame = scene.frame(place * given.scale, number, 0.04 * number)
        times.append(common.cpu_seconds(lambda frame=frame: places.append(eye.see(frame)[1].pixels)))
    origin = 0.0 if tracking else given.zero
    error = np.array(places) - origin - pixels
    return 1e3 * statistics.median(times), math.sqrt(np.mean(error**2))


def main() -> int:
    """Run the benchmark; returns the exit code."""
    options = common.parser(__doc__).parse_args()
    results = []
    for name, conditions, tracking in CONDITIONS:
        time, error = measured(Scene(SceneParameters(**conditions)), tracking)
        results.append(common.Result(f"{name}: ms per frame", time, "at most", TIME))
        results.append(common.Result(f"{name}: px rms", error, "at most", ERROR))
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
