# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis whose inverse adapts: the measured stage under a triangle; gain and loop width of its plant are 15 % off."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import single_axis

LAG = {"A": [0.686131723], "B": [0.313868277], "C": [1.0], "sample_time": 0.005}
ADAPTATION = {"adaptation__type": "recursive", "adaptation__memory": 8.0, "adaptation__rate": 0.2}
ADAPTATION |= {f"adaptation__dynamics__{name}": value for name, value in LAG.items()}
#: Ratio of the plant's weights to the identified ones, and the parameters to which this ratio applies.
TRUE = np.where(np.arange(20) > 0, 0.85, 1.0) * 0.85
CHANGED = ("weights", "thresholds")
TRIANGLE = {
    "initial_setpoint": 20e-6,
    "waveform__type": "triangle",
    "waveform__amplitude": 12e-6,
    "waveform__frequency": 1.0,
}


def adapting(adaptation=None, **overrides) -> AxisParameters:
    """Return the parameters of the axis; ``overrides`` by node, with double underscores for dots."""
    configuration = load_configuration("picma_stage")
    hysteresis = single_axis(configuration).plant_simulator.hysteresis
    chosen = hysteresis.model.weighted(hysteresis.chosen, TRUE)
    plant = {f"hysteresis__prandtl_ishlinskii__{name}": list(getattr(chosen, name)) for name in CHANGED}
    given = {
        "plant_simulator": plant | {"sensor__noise": 5e-9},
        "hysteresis_compensator": ADAPTATION | (adaptation or {}),
        "reference_generator": TRIANGLE,
        "motion_controller": {"type": "open_loop"},
    }
    for node, values in overrides.items():
        given[node] = given.get(node, {}) | values
    for node, values in given.items():
        configuration = configuration.override(node, **values)
    return single_axis(configuration)


def adapted_run(samples=300, **words) -> np.ndarray:
    """Return voltage, gain and state of a run, shape (3, N)."""
    axis = Axis(adapting(**words))
    made = axis.run(axis.default_setpoints(samples))
    return np.array([made[name] for name in ("voltage", "adapted_gain", "adaptation")])
