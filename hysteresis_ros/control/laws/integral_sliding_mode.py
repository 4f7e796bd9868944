# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Integral sliding mode: a nominal controller, and a sliding mode that begins without a reaching phase.

The switching function is S times the distance of the state from that of the nominal dynamics. Both states start at the
same point (x̄_0 = x̂_0, so s_0 = 0):

.. math::

   s_k &= S (\hat x_k - \bar x_k) \\
   \bar x_{k+1} &= \bar x_k + A \hat x_k + B (u_{0,k} + \Delta_k) - \hat x_k \\
   u_k &= u_{0,k} + u_{1,k} \\
   u_0 &= u^* - \Lambda^{-1} (S A - \Phi S) \, x_e \\
   u_1 &= -\hat d - \Lambda^{-1} (1 - \rho) s
   - \left( \eta |\Lambda|^{-1} |s| + \beta \right) \mathrm{sign}(\Lambda) \frac{s}{|s| + \delta}

with the nominal state feedback u0 and the rejection u1. Only the innovation ε of the Kalman filter drives s [1]_ [2]_:
s_(k+1) = ρ s_k − Λ u_n + S L ε, with ρ = ``rejection_pole`` and the nonlinear part u_n of u1. A step of the reference
does not change s. With ρ = 0 an innovation is rejected in the next sample. Δ is the change of the last command by a
hand-over or by limits. This change is known and is included in the nominal dynamics, so there is no windup.

d̂ is the disturbance that the filter estimates (``kalman.disturbance``). Without this estimate, a matched disturbance
affects the law only through the innovation, and the law rejects only a part of the disturbance.

References
----------
.. [1] Utkin & Shi, Integral sliding mode in systems operating under uncertainty conditions, CDC 1996.
.. [2] Abidi, Xu & Yu, On the discrete-time integral sliding-mode control, IEEE TAC 52(4), 2007.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.kalman import ESTIMATE, OFFSET, KalmanParameters
from hysteresis_ros.control.law import APPLIED, STARTED, ControllerLaw, bounded
from hysteresis_ros.control.sliding_gains import (
    integration_warning,
    reaching_law,
    reaching_rows,
    sliding_gains,
)
from hysteresis_ros.control.sliding_surface import (
    BEGUN,
    GAINS,
    INPUT_SCALE,
    LAMBDA,
    LAST,
    LINEAR,
    MEMORY,
    OBSERVER,
    OWN,
    PHI,
    TARGET,
    N,
    SlidingController,
    SlidingModeParameters,
    boundary_layer,
    check_with,
    leave,
    pack_surface,
    require_target,
    switching_function,
)
from hysteresis_ros.models.block import kernel

#: p[REJECTION]: (1 − ρ) / Λ.
REJECTION = OWN
#: x[SLIDING]: s of the previous sample.
SLIDING = MEMORY
#: x[FORESEEN]: S (A x̂ + B u0) of the previous sample.
FORESEEN = MEMORY + 1


@kernel
def integral_sliding_mode(p, x, reference, measured):
    """Return the command [m] for ``reference`` [m, without preload offset] and ``measured`` [m]."""
    n = int(p[N])
    fresh = x[STARTED] == 0.0 or x[BEGUN] == 0.0
    changed = bounded(x[APPLIED]) / p[INPUT_SCALE] - x[LAST]
    switching_function(p, x, reference, measured)
    place = 0.0
    pull = 0.0
    for i in range(n):
        place += p[GAINS + n + i] * x[OBSERVER + ESTIMATE + i]
        pull += p[GAINS + i] * x[OBSERVER + ESTIMATE + i]
    s = 0.0
    if not fresh:
        s = bounded(x[SLIDING] + place - x[FORESEEN] - p[LAMBDA] * changed)
    nominal = x[TARGET] - x[LINEAR]
    x[SLIDING] = s
    # because S A = Λ K + Φ S
    x[FORESEEN] = bounded(p[LAMBDA] * (pull + nominal) + p[PHI] * place)
    return leave(p, x, s, nominal - x[OBSERVER + OFFSET] - p[REJECTION] * s - boundary_layer(p, s))


@lru_cache(maxsize=16)
def packed_integral_sliding_mode(parameters, sample_time: float | None = None) -> np.ndarray:
    """Return the parameter array for ControllerParameters (read-only).

    ParameterError: the design fails; names are relative to the controller's parameters.
    """
    require_target(parameters)
    gains, packed = pack_surface(parameters, sample_time)
    pole, eta = parameters.sliding_mode.rejection_pole, parameters.sliding_mode.eta
    if not abs(pole) < 1.0:
        state_feedback.refuse(
            "sliding_mode.rejection_pole", pole, "must be above -1 and below 1, or disturbances are not rejected"
        )
    if not pole - eta > -1.0:
        state_feedback.refuse("sliding_mode.eta", eta, f"must be below 1 + rejection_pole = {1.0 + pole:g}")
    packed = packed.copy()
    packed[REJECTION] = (1.0 - pole) / gains.switching_gain
    packed.flags.writeable = False
    return packed


class IntegralSlidingMode(SlidingController):
    """Integral sliding mode controller with Kalman filter.

    Parameters
    ----------
    parameters : ControllerParameters
        With ``type`` integral_sliding_mode; gains in group ``sliding_mode``.
    sample_time : float
        Sample time [s] of the discrete model.
    """

    kernel = staticmethod(integral_sliding_mode)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array: head, K, S, Kalman filter."""
        return packed_integral_sliding_mode(parameters, self.sample_time).copy()


CONTROLLER = ControllerLaw(
    name="integral_sliding_mode",
    block=IntegralSlidingMode,
    description="integral sliding mode around a nominal controller, with Kalman filter",
    groups={"sliding_mode": SlidingModeParameters, "kalman": KalmanParameters},
    check=check_with(packed_integral_sliding_mode),
    warnings=integration_warning,
    designs={"integral_smc": lambda task: sliding_gains(task, "integral_smc", reaching_law)},
    rows=reaching_rows,
)
