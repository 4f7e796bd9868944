# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The published axis (Kim, Kim & Park 2009) on its assumed realisation, and a closed loop around it without nodes."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.control import law
from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters

SAMPLE_TIME = 1.0 / 3000.0

DYNAMICS = {
    "A": (0.5856, 1.3305, -0.9172, -1.3085, 0.0475, -0.1471, -0.7609, 0.0803, -0.0809),
    "B": (-0.7318, -0.3533, 0.2288),
    "C": (-0.8674, 0.7907, 0.3855),
    "input_scale": 0.0,
    "output_scale": 1e-6,
}
CONTROLLER = {
    "type": "sliding_mode",
    "sliding_mode.hyperplane": "given",
    "sliding_mode.S": (-1.0744, -0.0904, 0.0781),
    "sliding_mode.phi": 0.93,
    "sliding_mode.eta": 0.002,
    "sliding_mode.beta": 0.0002,
    "sliding_mode.delta": 0.01,
    "kalman.q": 0.685,
    "kalman.r": 1.0,
} | {f"model.dynamics.{name}": value for name, value in DYNAMICS.items()}


class Loop:
    """Plant (linear model, SI) and controller in the order of the nodes.

    ``carry`` limits a command, ``disturbance`` is added after the limits, ``noise`` and ``offset`` to the
    measurement.
    """

    def __init__(self, controller, plant, disturbance=0.0, carry=None, noise=None, offset=0.0):
        self.controller, self.plant = controller, plant
        self.disturbance, self.carry, self.noise, self.offset = disturbance, carry, noise, offset

    def run(self, reference):
        """Return commands, shape (N,), and measured displacements, shape (N,), for ``reference``, shape (N,)."""
        commands, measured = np.empty(len(reference)), np.empty(len(reference))
        for k, r in enumerate(reference):
            y = self.plant.output() + self.offset
            if self.noise is not None:
                y += self.noise[k]
            u = self.controller.step(r, y)
            applied = u if self.carry is None else self.carry(u)
            self.controller.x[law.APPLIED] = applied
            self.plant.step(applied + self.disturbance)
            commands[k], measured[k] = u, y
        return commands, measured


@pytest.fixture(scope="session")
def parameters():
    """Build the published controller's parameters with changed entries; None removes an entry."""

    def build(changes=None):
        entries = CONTROLLER | (changes or {})
        return ControllerParameters.from_mapping({k: v for k, v in entries.items() if v is not None})

    return build


@pytest.fixture(scope="session")
def controller(parameters):
    """Build the published controller with entries changed."""
    return lambda changes=None: controller_block(parameters(changes), SAMPLE_TIME)


@pytest.fixture(scope="session")
def plant():
    """Build the plant: the published linear model."""
    return lambda changes=None: LinearDynamics(LinearParameters(**(DYNAMICS | (changes or {}))), SAMPLE_TIME)


@pytest.fixture(scope="session")
def loop(controller, plant):
    """Build a closed loop; ``changes`` are entries of the controller's parameters."""
    return lambda changes=None, **options: Loop(controller(changes), plant(), **options)


@pytest.fixture(scope="session")
def model():
    """Return the published realisation."""
    return LinearParameters(**DYNAMICS).state_space


@pytest.fixture(scope="session")
def settling_time():
    """Return the time [s] after which ``y`` stays within 2 % of ``final``."""

    def measure(y, final):
        outside = np.flatnonzero(np.abs(y - final) > 0.02 * abs(final))
        return (outside[-1] + 1) * SAMPLE_TIME if len(outside) else 0.0

    return measure
