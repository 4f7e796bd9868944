# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Controllers close to rest, as linear systems, and their margins on their own models.

Any controller kernel is linear close to rest (inside the boundary layer, without saturation). The state-space matrices
are computed with the kernel itself. At rest all values are zero, so the kernel's response to one tiny entry *is* a
column of a matrix, and no digits cancel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.control.damping.inner_loop import inner_loop
from hysteresis_ros.control.damping.kind import FORCE, NOTHING
from hysteresis_ros.control.feedforward import FeedforwardParameters
from hysteresis_ros.control.law import APPLIED, COMMAND, FEEDFORWARD
from hysteresis_ros.control.margins import Margins, margins_of, plant_state_space
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.models.linear import StateSpace

#: Size of an entry in the linearisation of a kernel: far below every boundary layer, far above subnormal numbers.
TINY = 1e-24
#: Number of samples at rest before the linearisation, in which flags and counters of the start reach their final
#: values.
WARM_UP = 3


def at_rest(parameters):
    """Return parameters for which the controller is linear close to rest: without feedforward and preload offset."""
    model = replace(parameters.model, preload=PreloadParameters())
    return parameters.law.near_rest(replace(parameters, model=model, feedforward=FeedforwardParameters()))


def linearise(controller) -> StateSpace:
    """Return a controller block close to rest as a system from (reference, measured) to the command, in SI units.

    The block must have parameters of :func:`at_rest`; its state is not changed.
    """
    kernel, p = controller.kernel, controller.p
    rest = np.ascontiguousarray(controller.initial_state(), dtype=float)
    for _ in range(WARM_UP):
        kernel(p, rest, 0.0, 0.0)
    # the last command is stored in two entries but is one state; the feedforward is not a state
    groups = [[APPLIED, COMMAND]] + [[i] for i in range(len(rest)) if i not in (APPLIED, COMMAND, FEEDFORWARD)]
    count = len(groups)
    A, C = np.zeros((count, count)), np.zeros((1, count))
    B, D = np.zeros((count, 2)), np.zeros((1, 2))

    def respond(places, reference, measured):
        x = rest.copy()
        x[places] += TINY
        command = kernel(p, x, reference, measured)
        after = np.array([x[group[0]] - rest[group[0]] for group in groups])
        return after / TINY, command / TINY

    for j, places in enumerate(groups):
        A[:, j], C[0, j] = respond(places, 0.0, 0.0)
    for j, inputs in enumerate(((TINY, 0.0), (0.0, TINY))):
        B[:, j], D[0, j] = respond([], *inputs)
    return _connected(StateSpace(A, B, C, D))


def _connected(system: StateSpace) -> StateSpace:
    """Remove states that no input changes (flags, constants) or that never affect the output (records)."""
    reached, seen = (system.B != 0.0).any(axis=1), system.C[0] != 0.0
    for _ in range(len(system.A)):
        reached = reached | ((system.A != 0.0) @ reached)
        seen = seen | (seen @ (system.A != 0.0))
    kept = np.flatnonzero(reached & seen)
    return system.part(kept)


def linear_loop(parameters, sample_time: float) -> tuple[StateSpace, StateSpace]:
    """Return the controller and its model as linear systems close to rest; damping is part of this model.

    ParameterError: no controller can be built from the parameters.
    """
    own = parameters.before_damping(sample_time)
    resting = at_rest(own).validated()
    resting.model.dynamics.require_sample_time(sample_time, "model.dynamics.sample_time")
    return linearise(resting.law.block(resting, sample_time)), plant_state_space(own.model.dynamics)


def whole_loop(parameters, sample_time: float) -> tuple[StateSpace, StateSpace]:
    """Return controller and damping as one system, and the undamped model, for studies with other plants.

    ParameterError: no controller can be built from the parameters.
    """
    return behind_damping(parameters, sample_time, *linear_loop(parameters, sample_time))


def behind_damping(parameters, sample_time: float, controller: StateSpace, plant: StateSpace):
    """Return a law and the damping of the parameters as one system, and the undamped model.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        [s]
    controller, plant : StateSpace
        The law and its model, as :func:`linear_loop` returns them.
    """
    if parameters.damping.source == NOTHING:
        return controller, plant
    dynamics, damping = parameters.model.dynamics, parameters.damping
    loop = inner_loop(damping, dynamics, sample_time, parameters.model.force)
    return loop.behind(controller), plant_state_space(dynamics, acting=damping.source == FORCE)


def margins(parameters, sample_time: float) -> Margins:
    """Return margins, bandwidth and poles of a controller with its own model.

    Raises
    ------
    ParameterError
        No controller can be built from the parameters.
    """
    return margins_of(*linear_loop(parameters, sample_time), sample_time)
