# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Sliding mode controller with boundary layer, for the state that a Kalman filter estimates.

Let x_e = x̂ − x* be the distance from the target (rest point or trajectory, see
:mod:`hysteresis_ros.control.sliding_surface`), s = S x_e the switching function and Λ = S B:

.. math::

   u &= u^* - \hat d + u_l + u_n \\
   u_l &= -\Lambda^{-1} (S A - \Phi S) \, x_e \\
   u_n &= -\left( \eta |\Lambda|^{-1} |s| + \beta \right) \mathrm{sign}(\Lambda) \, \frac{s}{|s| + \delta}

with the reaching law s⁺ = Φ s and a boundary layer of width δ [1]_, eqs 6-12. (Eq. 9 of [1]_ prints S B instead of S A.
The factor sign(Λ) is not printed, because Λ is positive there.) The printed law controls the state to zero; here the
rest point is the target, so that the law follows a reference. With ``tracking: integral`` the state x_e is extended by
z_k = z_(k-1) + r_k − y_k (in the model's output unit), and S and K have one more entry.

References
----------
.. [1] Kim, Kim & Park, Development of an inchworm, International Journal of Precision Engineering and Manufacturing,
   2009.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.control.kalman import OFFSET, KalmanParameters
from hysteresis_ros.control.law import ControllerLaw
from hysteresis_ros.control.sliding_gains import reaching_law, reaching_rows, sliding_gains
from hysteresis_ros.control.sliding_surface import (
    LINEAR,
    OBSERVER,
    TARGET,
    SlidingController,
    SlidingModeParameters,
    boundary_layer,
    check_with,
    leave,
    pack_surface,
    switching_function,
)
from hysteresis_ros.models.block import kernel


@kernel
def sliding_mode(p, x, reference, measured):
    """Return the command [m] for ``reference`` [m, without preload offset] and ``measured`` [m]."""
    s = switching_function(p, x, reference, measured)
    return leave(p, x, s, x[TARGET] - x[OBSERVER + OFFSET] - x[LINEAR] - boundary_layer(p, s))


def packed_sliding_mode(parameters, sample_time: float | None = None) -> np.ndarray:
    """Return the parameter array for ControllerParameters (read-only).

    ParameterError: the design fails; names are relative to the controller's parameters.
    """
    return pack_surface(parameters, sample_time)[1]


class SlidingMode(SlidingController):
    """Sliding mode controller with Kalman filter.

    Parameters
    ----------
    parameters : ControllerParameters
        With ``type`` sliding_mode.
    sample_time : float
        Sample time [s] of the discrete model.
    """

    kernel = staticmethod(sliding_mode)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array: head, K, S, Kalman filter."""
        return packed_sliding_mode(parameters, self.sample_time).copy()


def doubts(parameters, sample_time: float, tuned: bool):
    """Yield a warning that an offset remains if the disturbance is not estimated."""
    if parameters.kalman.disturbance == "none":
        yield "model errors cause an offset, because the disturbance is not estimated; offset_free estimates it"


CONTROLLER = ControllerLaw(
    name="sliding_mode",
    block=SlidingMode,
    description="sliding mode with boundary layer and Kalman filter",
    groups={"sliding_mode": SlidingModeParameters, "kalman": KalmanParameters},
    check=check_with(packed_sliding_mode),
    designs={
        # the published law estimates no disturbance; integral sliding mode needs the estimate to reject a disturbance
        "smc": lambda task: sliding_gains(task, "smc", reaching_law, disturbed=False),
        "offset_free": lambda task: sliding_gains(task, "offset_free", reaching_law),
    },
    rows=reaching_rows,
    doubts=doubts,
)
