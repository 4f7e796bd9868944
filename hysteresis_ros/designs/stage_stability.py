# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Whether the loops of a stage are stable together, and what makes them stable if they are not."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import STAGE
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.coupling import static_decoupling
from hysteresis_ros.control.margins import plant_state_space
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_response import GRID, stage_loop, stage_plant
from hysteresis_ros.models.linear import BOUNDARY
from hysteresis_ros.models.linear_algebra import product
from hysteresis_ros.references.scan import rounded_down

#: Difference between the gain of the stage at rest and that of the models of its axes which no bandwidth allows.
WRONG_GAIN = 0.5
#: Factor of a step of the search for the largest stable gain, its number of steps, and the part of that gain to use.
STEP, STEPS, USED = 0.95, 150, 0.5


def gain_at_rest(parameters: StageParameters) -> np.ndarray:
    """Return the gain from the commands of the degrees of freedom to their displacements, shape (n, n)."""
    return np.reshape(stage_plant(parameters).dc_gain, (len(parameters.names), -1))


def right_decoupling(parameters: StageParameters) -> str:
    """Return the entry of the parameter file with which no axis moves another at rest."""
    right = product(parameters.stage.matrix("decoupling"), static_decoupling(gain_at_rest(parameters)))
    return f"decoupling: [{', '.join(f'{value:.6g}' for value in right.ravel())}]"


def require_stable(parameters: StageParameters, source: str) -> None:
    """Refuse a stage whose loops are unstable together; the message has the remedy.

    Raises
    ------
    ConfigurationError
        It gives the decoupling if the stage has another gain at rest than the models of its axes, or else the
        bandwidth of controllers that tolerate 6 dB more gain.
    """
    loop = stage_loop(parameters)
    if _stable(loop, 1.0):
        return
    names = ", ".join(parameters.names)
    cause = f"{source}: the loops of {names} together are unstable on the model of the stage"
    models = [part(axis.motion_controller, ControllerParameters).model.dynamics for axis in parameters.axes]
    wanted = np.diag([np.ravel(plant_state_space(model).dc_gain)[0] for model in models])
    wrong = np.max(np.abs(gain_at_rest(parameters) - wanted)) > WRONG_GAIN * np.max(wanted)
    # the plant is stable, so small gains are stable too, except for a wrong sign at rest
    factor = next((STEP**k for k in range(1, STEPS) if _stable(loop, STEP**k)), None)
    if wrong or factor is None:
        raise ConfigurationError(
            f"{cause}, because its gain at rest differs from that of the models of its axes: give "
            f"{right_decoupling(parameters)} in {parameters.namespace}/{STAGE}"
        )
    sizes = np.abs(np.diagonal(loop.response(np.exp(2j * np.pi * GRID)), axis1=1, axis2=2))
    # the lowest crossover: above it, modes may raise the gain above 1 again
    crossing = [float(GRID[np.argmax(size < 1.0)]) for size in sizes.T if size[0] > 1.0 and np.any(size < 1.0)]
    band = rounded_down(USED * factor * min(crossing, default=GRID[-1]) * parameters.sample_rate, 2)
    raise ConfigurationError(
        f"{cause}; they are stable with at most {factor:.2g} times their gain: design slower controllers, "
        f"hysteresis design {source} --controller pid --bandwidth {band:g}Hz -o FILE, or a model for each axis "
        "(motion_controller: model.dynamics) that contains its modes"
    )


def _stable(loop, factor: float) -> bool:
    """Return whether the closed loop is stable with a factor on the gain of all loops."""
    opened = np.eye(loop.B.shape[1]) + factor * loop.D
    poles = np.linalg.eigvals(loop.A - factor * loop.B @ np.linalg.solve(opened, loop.C))
    return bool(np.max(np.abs(poles), initial=0.0) < 1.0 - BOUNDARY)
