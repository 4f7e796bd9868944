# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Linear loops put together: what the controller sees of the plant, the loop cut at the command, the loop closed.

Conventions are those of :mod:`hysteresis_ros.control.margins`, which judges what is made here.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.models.state_space import StateSpace


def with_acting(dynamics, plant: StateSpace) -> StateSpace:
    """Return a plant with the displacement at which what acts on it would rest as its second output.

    Of that only the gain and the delay are in it, nothing of poles and zeros: a force in the stack is a sum of both.

    Parameters
    ----------
    dynamics : LinearParameters
    plant : StateSpace
        Their own states first, without feedthrough.
    """
    row, through = dynamics.acting
    n = plant.order
    A, C = np.zeros((n + 1, n + 1)), np.zeros((2, n + 1))
    A[:n, :n], A[n, : len(row)] = plant.A, row
    C[0, :n], C[1, n] = plant.C[0], dynamics.matrices.dc_gain
    return StateSpace(A, np.vstack([plant.B, [[through]]]), C, np.zeros((2, 1)))


def plant_state_space(dynamics, scaled: bool = True, acting: bool = False) -> StateSpace:
    """Return the model from command to measured displacement, the input held last as its last state.

    Parameters
    ----------
    dynamics : LinearParameters
    scaled : bool
        In SI units; otherwise in the model's.
    acting : bool
        With the second output of :func:`with_acting`.
    """
    held = dynamics.state_space.held()
    if acting:
        held = with_acting(dynamics, held)
    return held.scaled(dynamics.output_scale / dynamics.resolved_input_scale) if scaled else held


def close(controller: StateSpace, plant: StateSpace) -> StateSpace:
    """Return the closed loop from reference to measured displacement.

    Parameters
    ----------
    controller, plant : StateSpace
        Of :func:`~hysteresis_ros.control.linearisation.linear_loop`.
    """
    n, m = len(controller.A), len(plant.A)
    reference, measured = controller.B[:, :1], controller.B[:, 1:]
    A = np.block(
        [
            [controller.A, measured @ plant.C],
            [plant.B @ controller.C, plant.A + plant.B @ controller.D[:, 1:] @ plant.C],
        ]
    )
    B = np.vstack([reference, controller.D[0, 0] * plant.B])
    return StateSpace(A, B, np.hstack([np.zeros((1, n)), plant.C[:1]]).reshape(1, n + m), np.zeros((1, 1)))


def loop_transfer(controller: StateSpace, plant: StateSpace, z) -> np.ndarray:
    """Return L at the points ``z``, complex, shape (N,).

    Parameters
    ----------
    controller, plant : StateSpace
        Of :func:`~hysteresis_ros.control.linearisation.linear_loop`.
    z : array_like, shape (N,)
    """
    return np.sum(loop_parts(controller, plant, z), axis=1)


def loop_parts(controller: StateSpace, plant: StateSpace, z) -> np.ndarray:
    """Return the parts of L by what is fed back: the displacement, and behind a damping by force what acts.

    Parameters
    ----------
    controller, plant : StateSpace
    z : array_like, shape (N,)

    Returns
    -------
    ndarray of complex, shape (N, q)
    """
    return -controller.response(z)[:, 0, 1:] * plant.response(z)[:, :, 0]
