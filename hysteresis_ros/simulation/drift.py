# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A plant that drifts while it runs: gain and opening of its hysteresis change in many small steps."""

from __future__ import annotations

import math

import numpy as np

from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.simulation.mismatch import LARGEST

#: Largest change of a factor in one step.
STEP = 1e-3


def drifting(parameters: AxisParameters, samples: int, gain: float = 0.0, opening: float = 0.0) -> list[Change]:
    """Return the changes that let the plant of an axis drift evenly over a run.

    The displacement does not jump at a step, so a drift of the gain turns about where the axis is just then.

    Parameters
    ----------
    parameters : AxisParameters
        Of an actuator.
    samples : int
        Length of the run.
    gain, opening : float
        By which part gain and opening have changed at the end, -0.5 ... 0.5.

    Raises
    ------
    ParameterError
        A drift is out of range, or the plant is none that can drift so.
    """
    plant = parameters.plant_simulator
    for name, value in (("gain", gain), ("opening", opening)):
        if not abs(value) <= LARGEST:
            raise ParameterError([Problem(f"drift {name}", value, f"must be within -{LARGEST:g} ... {LARGEST:g}")])
    if plant.type == "inchworm" or plant.driver:
        what = "a device" if plant.driver else "an inchworm motor"
        raise ParameterError([Problem("drift", what, "is for a simulated actuator")])
    model, chosen = plant.hysteresis.model, plant.hysteresis.chosen
    steps = math.ceil(round(max(abs(gain), abs(opening)) / STEP, 9))
    changes = []
    for number in range(1, steps + 1):
        share = number / steps
        deviation = Deviation(1.0 + share * gain, 1.0 + share * opening, lambda count=None: np.ones(count or ()))
        drifted = model.deviated(chosen, deviation).to_mapping()
        changed = {
            f"hysteresis.{model.name}.{name}": value
            for name, value in drifted.items()
            if value != getattr(chosen, name, value)
        }
        changes.append(Change(round(share * samples) - 1, "plant_simulator", "retune", changed))
    return changes
