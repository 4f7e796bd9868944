# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Check that the loops of a stage are stable and robust together; otherwise the message states a remedy.

The design of an axis does not consider the other loops. Together, the loops must meet the requirements that each loop
meets alone: M_s ≤ 2, and stability with one more sample of delay. M_s of all loops is the structured singular value of
S = (I + L)⁻¹ for an independent factor in each loop; it is the inverse of the disk margin of skew 1. Without coupling,
it equals the largest M_s of the single loops. If it is at most 2, all loops tolerate up to 6 dB more gain at the same
time, in any combination.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.configuration import STAGE
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.coupling import disk_margins, static_decoupling
from hysteresis_ros.control.margins import REQUIRED, ROUNDING, plant_state_space
from hysteresis_ros.control.uncertainty import slowed
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.stage_parameters import HAMMERSTEIN, StageParameters
from hysteresis_ros.loop.stage_response import GRID, in_series, stage_loop, stage_plant
from hysteresis_ros.models.linear import BOUNDARY, LinearParameters, StateSpace
from hysteresis_ros.models.linear_algebra import product
from hysteresis_ros.references.scan import rounded_down

#: If the stage's gain at rest differs from the gains of the axis models by more than this fraction, the decoupling is
#: the remedy, instead of a lower bandwidth.
WRONG_GAIN = 0.5
#: Factor by which the gain decreases in each step of the search for the largest stable gain.
STEP = 0.95
#: The search for the largest stable gain takes fewer steps than this number.
STEPS = 150
#: Fraction of the largest stable gain that the proposed bandwidth uses.
USED = 0.5
#: Resonances of a structure are varied if the condition number of its eigenvectors is below this.
DEFECTIVE = 1e8


def gain_at_rest(parameters: StageParameters) -> np.ndarray:
    """Return the gain from the commands of the degrees of freedom to their displacements, shape (n, n)."""
    return np.reshape(stage_plant(parameters).dc_gain, (len(parameters.names), -1))


def right_decoupling(parameters: StageParameters) -> str:
    """Return the parameter file entry of the decoupling with which no axis moves another axis at rest."""
    right = product(parameters.stage.matrix("decoupling"), static_decoupling(gain_at_rest(parameters)))
    return f"decoupling: [{', '.join(f'{value:.6g}' for value in right.ravel())}]"


def require_stable(parameters: StageParameters, source: str) -> None:
    """Refuse a stage whose loops are unstable together; the message states a remedy.

    Raises
    ------
    ConfigurationError
        The message gives the decoupling if the stage's gain at rest differs from the gains of the axis models.
        Otherwise it gives the bandwidth of controllers that tolerate 6 dB more gain.
    """
    loop = stage_loop(parameters)
    if _stable(loop, 1.0):
        return
    names = ", ".join(parameters.names)
    cause = f"{source}: the loops of {names} together are unstable on the model of the stage"
    models = [part(axis.motion_controller, ControllerParameters).model.dynamics for axis in parameters.axes]
    wanted = np.diag([np.ravel(plant_state_space(model).dc_gain)[0] for model in models])
    wrong = np.max(np.abs(gain_at_rest(parameters) - wanted)) > WRONG_GAIN * np.max(wanted)
    # the plant is stable, so small gains give stable loops unless a sign at rest is wrong
    factor = next((STEP**k for k in range(1, STEPS) if _stable(loop, STEP**k)), None)
    if wrong or factor is None:
        raise ConfigurationError(
            f"{cause}, because the gain at rest differs from the gains of the axis models: give "
            f"{right_decoupling(parameters)} in {parameters.namespace}/{STAGE}"
        )
    sizes = np.abs(np.diagonal(loop.response(np.exp(2j * np.pi * GRID)), axis1=1, axis2=2))
    # use the lowest crossover: above it, modes may raise the gain above 1 again
    crossing = [float(GRID[np.argmax(size < 1.0)]) for size in sizes.T if size[0] > 1.0 and np.any(size < 1.0)]
    band = rounded_down(USED * factor * min(crossing, default=GRID[-1]) * parameters.sample_rate, 2)
    raise ConfigurationError(
        f"{cause}; they are stable with at most {factor:.2g} times their gain: design slower controllers, "
        f"hysteresis design {source} --controller pid --bandwidth {band:g}Hz -o FILE, or a model for each axis "
        "(motion_controller: model.dynamics) that contains its modes"
    )


def _stable(loop, factor: float) -> bool:
    """Return whether the closed loop is stable with the gain of all loops multiplied by a factor."""
    opened = np.eye(loop.B.shape[1]) + factor * loop.D
    poles = np.linalg.eigvals(loop.A - factor * loop.B @ np.linalg.solve(opened, loop.C))
    return bool(np.max(np.abs(poles), initial=0.0) < 1.0 - BOUNDARY)


def slower_structure(parameters: StageParameters, slowness: float) -> StageParameters:
    """Return a stage with all times of its structure multiplied by a factor and the same gain at rest."""
    given = parameters.stage.structure
    n, m = given.order, given.inputs
    # the file may contain only the diagonal blocks of the state matrix
    A, B, outputs = tuple(given.state_matrix.ravel().tolist()), np.reshape(given.B, (n, m)), (0.0,) * n
    changed = [slowed(LinearParameters(A=A, B=tuple(column), C=outputs), slowness) for column in B.T]
    B = np.column_stack([one["B"] for one in changed])
    slower = replace(given, A=tuple(changed[0]["A"]), B=tuple(B.ravel().tolist()))
    return replace(parameters, stage=replace(parameters.stage, structure=slower))


def unmet_together(parameters: StageParameters, resonance: float = 0.0) -> str:
    """Return the first requirement that all loops together do not meet; empty if they meet all.

    If ``resonance`` is above 0, the loops are also checked with resonances that are lower and higher by this fraction.
    """
    stage, count = parameters.stage, len(parameters.names)
    # a structure that contains the hysteresis has no separate resonances that could be varied
    varied = resonance > 0.0 and stage.type == HAMMERSTEIN and stage.structure.order > 0
    if varied:
        _, vectors = np.linalg.eig(stage.structure.state_matrix)
        varied = bool(np.linalg.cond(vectors) < DEFECTIVE)
    sample = StateSpace(np.zeros((count, count)), np.eye(count), np.eye(count), np.zeros((count, count)))
    for slowness in (1.0, 1.0 - resonance, 1.0 + resonance) if varied else (1.0,):
        where = "" if slowness == 1.0 else f" with resonances off by {100.0 * resonance:g} %"
        loop = stage_loop(parameters if slowness == 1.0 else slower_structure(parameters, slowness))
        if not _stable(loop, 1.0):
            return f"all loops together are unstable{where}"
        if not _stable(in_series(loop, sample), 1.0):
            return f"all loops together are unstable with one more sample of delay{where}"
        peak = 1.0 / disk_margins(loop, 1.0 / parameters.sample_rate, skew=1.0).together.alpha
        if peak > REQUIRED.sensitivity_peak * (1.0 + ROUNDING):
            return f"M_s {peak:.3g} of all loops together above {REQUIRED.sensitivity_peak:g}{where}"
    return ""
