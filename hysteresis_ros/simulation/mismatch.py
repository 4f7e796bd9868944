# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plants that are not what their models say: parameters of the plant drawn around those of the configuration.

Each draw multiplies by independent factors 1 + m u, u uniform in ±1: the gain, the opening of the hysteresis (how, and
by which factors besides, each model declares), the time scale of the linear dynamics and the rate of the creep. The
compensator's and the controller's models stay as they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.uncertainty import slowed
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop.node_parameters import PlantNodeParameters
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.simulation.axes import single_axis

#: Largest mismatch that leaves every drawn parameter its sign with a margin.
LARGEST = 0.5


def mismatched(configuration: Configuration, mismatch: float, seed: int) -> Configuration:
    """Return the configuration with a plant drawn around the configured one.

    Parameters
    ----------
    configuration : Configuration
        One axis.
    mismatch : float
        m, largest relative deviation of each factor, 0 … 0.5.
    seed : int
        Seed of the draw; equal seeds give equal plants.

    Raises
    ------
    ParameterError
        The mismatch is out of range, or the configuration is wrong.
    """
    if not 0.0 <= mismatch <= LARGEST:
        raise ParameterError([Problem("mismatch", mismatch, f"must be within 0 … {LARGEST:g}")])
    plant = single_axis(configuration).plant_simulator
    random = np.random.default_rng(seed)

    def factor(count=None):
        return 1.0 + mismatch * random.uniform(-1.0, 1.0, count)

    # always in this order, so that a seed means the same factors for every model
    gain, opening, slowness, creeping = factor(), factor(), factor(), factor()
    changed = deviating(plant, Deviation(gain, opening, factor), slowness, creeping)
    return configuration.override("plant_simulator", **changed)


def deviating(
    plant: PlantNodeParameters, deviation: Deviation, slowness: float = 1.0, creeping: float = 1.0
) -> dict[str, Any]:
    """Return the parameters of a plant that deviates from a given one, as far as they differ.

    Parameters
    ----------
    plant : PlantNodeParameters
    deviation : Deviation
        Of its hysteresis.
    slowness, creeping : float
        Factors on all times of the linear dynamics, and on the rate of the creep.

    Returns
    -------
    dict
        By dotted names.
    """
    model, configured = plant.hysteresis.model, plant.hysteresis.chosen.to_mapping()
    drawn = model.deviated(plant.hysteresis.chosen, deviation).to_mapping()
    changed = {
        f"hysteresis.{model.name}.{name}": value for name, value in drawn.items() if value != configured.get(name)
    }
    if slowness != 1.0:
        changed |= {f"dynamics.{name}": value for name, value in slowed(plant.dynamics, slowness).items()}
    if plant.creep.type == "logarithmic":
        changed["creep.logarithmic.rate"] = plant.creep.logarithmic.rate * creeping
    elif plant.creep.type == "operators":
        changed["creep.operators.weights"] = (np.array(plant.creep.operators.weights) * creeping).tolist()
    return changed
