# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The loop of a stage, for its margins: the controllers of all axes with the plant that they share."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.stage_parameters import HAMMERSTEIN, StageParameters
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.models.linear_algebra import product


def diagonal(systems) -> StateSpace:
    """Return systems of one input and one output as one, without coupling."""
    sizes = [system.order for system in systems]
    places = np.cumsum([0, *sizes])
    A, B = np.zeros((places[-1], places[-1])), np.zeros((places[-1], len(systems)))
    C, D = np.zeros((len(systems), places[-1])), np.zeros((len(systems), len(systems)))
    for i, system in enumerate(systems):
        own = slice(places[i], places[i + 1])
        A[own, own], B[own, i], C[i, own], D[i, i] = system.A, system.B[:, 0], system.C[0], system.D[0, 0]
    return StateSpace(A, B, C, D)


def in_series(first: StateSpace, second: StateSpace) -> StateSpace:
    """Return what ``second`` makes of the outputs of ``first``."""
    A = np.block([[first.A, np.zeros((first.order, second.order))], [product(second.B, first.C), second.A]])
    B = np.vstack([first.B, product(second.B, first.D)])
    return StateSpace(A, B, np.hstack([product(second.D, first.C), second.C]), product(second.D, first.D))


def stage_plant(parameters: StageParameters) -> StateSpace:
    """Return the plant from the commands of the degrees of freedom to their measurements, the hysteresis compensated.

    It has the delays of the actuators, and each measurement is taken before the commands of its sample act.
    """
    stage = parameters.stage
    if stage.type != HAMMERSTEIN:
        raise ConfigurationError(
            f"type = {stage.type}: the loop of a stage is known for {HAMMERSTEIN}, whose compensators invert the "
            "hysteresis"
        )
    late = []
    for axis in parameters.axes:
        model = axis.plant_simulator.dynamics.state_space
        row, through = axis.plant_simulator.dynamics.acting
        late.append(StateSpace(model.A, model.B, row[np.newaxis], np.array([[through]])))
    plant = in_series(diagonal(late), stage.structure.linear.held())
    into, out = stage.matrix("decoupling"), stage.matrix("sensor_matrix")
    return StateSpace(plant.A, product(plant.B, into), product(out, plant.C), product(out, product(plant.D, into)))


def stage_loop(parameters: StageParameters) -> StateSpace:
    """Return the loop transfer of a stage, cut at the commands of the degrees of freedom, negative feedback.

    Controllers and dampings are linear about rest, as for the margins of a single axis.
    """
    sample_time = 1.0 / parameters.sample_rate
    feedbacks = []
    for axis in parameters.axes:
        controller = whole_loop(part(axis.motion_controller, ControllerParameters), sample_time)[0]
        if controller.B.shape[1] != 2:
            raise ConfigurationError(f"{axis.namespace}/motion_controller: a damping by force has no loop in a stage")
        feedbacks.append(StateSpace(controller.A, controller.B[:, 1:], -controller.C, -controller.D[:, 1:]))
    return in_series(stage_plant(parameters), diagonal(feedbacks))
