# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Two axes whose actuators move each other: one tick over the parts of both, with the kernels of one axis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from loop_support import HOLD, axis

from hysteresis_ros import signals as at
from hysteresis_ros.loop.compensator import compensate
from hysteresis_ros.loop.controller import carried_out, control
from hysteresis_ros.loop.plant import actuate, sense
from hysteresis_ros.loop.source import refer
from hysteresis_ros.loop.tick import Parts
from hysteresis_ros.models.block import specialised

#: First axis, second axis.
SETPOINTS = (4e-6, 7e-6)


class Pair(NamedTuple):
    """The parts of two axes."""

    first: Parts
    second: Parts


def coupled_ticks(laws, pair, coupling, rows, setpoints, found):
    """Run ``found.shape[1]`` samples of both axes; each moves the other axis by a fraction of its displacement.

    Parameters
    ----------
    laws : Laws
        Laws of both axes.
    pair : Pair
    coupling : ndarray, shape (1,)
        Fraction of one displacement that is added to the measurement of the other axis.
    rows : ndarray, shape (2, row length)
    setpoints : ndarray, shape (2, N)
        [m]
    found : ndarray, shape (6, N)
        Measured displacements, voltages and modes of the controllers.
    """
    for k in range(found.shape[1]):
        for i in range(2):
            rows[i, at.SETPOINT] = setpoints[i, k]
            sense(laws, pair[i].plant, rows[i])
        one, other = rows[0, at.MEASURED], rows[1, at.MEASURED]
        rows[0, at.MEASURED] = one + coupling[0] * other
        rows[1, at.MEASURED] = other + coupling[0] * one
        for i in range(2):
            row, parts = rows[i], pair[i]
            refer(laws, parts.source, row)
            control(laws, parts.controller, row)
            compensate(laws, parts.compensator, row)
            carried_out(parts.controller, row[at.APPLIED])
            actuate(laws, parts.plant, row)
            found[i, k] = row[at.MEASURED]
            found[2 + i, k] = row[at.VOLTAGE]
            found[4 + i, k] = row[at.CONTROLLER_MODE]


def coupled_run(samples, coupling, faults=((), ())):
    """Return measured displacements [m], voltages [V] and controllers' modes of two coupled axes, shape (6, samples).

    Parameters
    ----------
    samples : int
    coupling : float
    faults : tuple of tuple of str
        Faults of each axis.
    """
    # the controllers estimate a constant disturbance, because each axis is a disturbance of the other
    controller = {"kalman__gain": "riccati", "kalman__L": [], "kalman__disturbance": "constant"}
    axes = [axis(**HOLD, motion_controller=controller) for _ in range(2)]
    for one, texts in zip(axes, faults, strict=True):
        one.inject(texts)
    pair = Pair(axes[0].parts, axes[1].parts)
    rows, found = np.zeros((2, at.ACTUATOR_ROW)), np.zeros((6, samples))
    setpoints = np.repeat(np.array(SETPOINTS)[:, None], samples, axis=1)
    arguments = axes[0].laws, pair, np.array([coupling]), rows, setpoints, found
    specialised(coupled_ticks, *arguments)(*arguments)
    return found
