# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Super-twisting controller: a continuous command keeps the switching function at zero under drifting disturbances.

Let σ = Λ⁻¹ S x_e be the switching function in the unit of the command (:mod:`hysteresis_ros.control.sliding_surface`
defines u* and x_e):

.. math::

   u = u^* - \hat d - \Lambda^{-1} (S A - S) \, x_e + u_{st}

The first three terms are the equivalent control, so σ⁺ = σ + u_st + innovation. The explicit law is

.. math::

   u_{st} = -k_1 |\sigma|^{1/2} \mathrm{sign}\,\sigma + w, \qquad w^+ = w - k_2 T \, \mathrm{sign}\,\sigma

and the implicit law [2]_ [3]_ is

.. math::

   u_{st} = -k_1 |\tilde\sigma|^{1/2} \mathrm{sign}\,\sigma + w^+, \qquad
   w^+ = w - \min(\max(\sigma, -k_2 T), k_2 T), \qquad
   \tilde\sigma + k_1 |\tilde\sigma|^{1/2} \mathrm{sign}\,\tilde\sigma = \sigma

The explicit law is the sampled continuous law: σ oscillates around zero, and sign σ makes the command chatter by about
k2 T. The implicit law evaluates the square root part at the end of the sample (backward Euler) and the set-valued sign
by projection: while |σ| ≤ k2 T, the sign is replaced by σ/(k2 T). So under a constant disturbance σ stays at zero
without chattering, and w is the negative disturbance.

In continuous time, σ̇ = v + a with |ȧ| ≤ L_a reaches zero in finite time for k1 = 1.5 √L_a, k2 = 1.1 L_a [1]_. In
discrete time, the command of a sample is u = T v. If the rate of change of a disturbance of the command is bounded by L
per second, L_a is L/T, and the gains become k1 = 1.5 √(L T), k2 = 1.1 L (``gains: from_bound``).

References
----------
.. [1] Levant, Robust exact differentiation via sliding mode technique, Automatica 34(3), 1998.
.. [2] Acary & Brogliato, Implicit Euler numerical scheme and chattering-free implementation of sliding mode systems,
   Systems & Control Letters 59(5), 2010 (the projection).
.. [3] Brogliato, Polyakov & Efimov, The implicit discretization of the super-twisting sliding-mode control algorithm,
   IEEE TAC 65(8), 2020. Their law combines both parts in one inclusion, so that σ settles at the disturbance of one
   sample instead of zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.kalman import OFFSET, KalmanParameters
from hysteresis_ros.control.law import APPLIED, ControllerLaw, DesignTask, bounded
from hysteresis_ros.control.sliding_gains import (
    filter_row,
    integration_warning,
    sliding_gains,
    sliding_pole,
    surface_row,
)
from hysteresis_ros.control.sliding_surface import (
    GAINS,
    LAMBDA,
    LINEAR,
    MEMORY,
    OBSERVER,
    OWN,
    TARGET,
    SlidingController,
    SlidingModeParameters,
    check_with,
    design_sliding_mode,
    leave,
    pack_surface,
    require_target,
    switching_function,
    widens,
)
from hysteresis_ros.models.block import kernel

# Entries of the law in the parameter array p.
ROOT_GAIN = OWN  # k1
STEP = OWN + 1  # k2 T
IMPLICIT = OWN + 2
#: x[TWIST]: w.
TWIST = MEMORY


@kernel
def super_twisting(p, x, reference, measured):
    """Return the command [m] for ``reference`` [m, without preload offset] and ``measured`` [m]."""
    applied = bounded(x[APPLIED])
    s = switching_function(p, x, reference, measured)
    sigma = s / p[LAMBDA]
    size = abs(sigma)
    sign = 0.0
    if sigma > 0.0:
        sign = 1.0
    elif sigma < 0.0:
        sign = -1.0
    before = x[TWIST]
    if p[IMPLICIT] != 0.0:
        change = -sign * min(size, p[STEP])
        # q is the positive root of q² + k1 q = |σ|, computed without cancellation; k1 > 0
        root = 2.0 * size / (p[ROOT_GAIN] + math.sqrt(p[ROOT_GAIN] * p[ROOT_GAIN] + 4.0 * size))
    else:
        change = -sign * p[STEP]
        root = math.sqrt(size)
    if not widens(p, x, applied, change):
        x[TWIST] = bounded(before + change)
    held = before
    if p[IMPLICIT] != 0.0:
        held = x[TWIST]
    twisting = held - sign * p[ROOT_GAIN] * root
    return leave(p, x, s, x[TARGET] - x[OBSERVER + OFFSET] - x[LINEAR] + twisting)


@dataclass(frozen=True)
class SuperTwistingParameters(Parameters):
    """Gains of the super-twisting controller, in the units of the model; ``sliding_mode`` defines the hyperplane."""

    gains: str = parameter(
        "from_bound",
        choices=("given", "from_bound"),
        read_only=True,
        description="Whether k1 and k2 are given or follow from the bound of the disturbance's rate",
    )
    bound: float = parameter(
        1.0,
        unit="1/s",
        low=0.0,
        description="from_bound: largest rate of the disturbance (input unit per second), above 0; "
        "k1 = 1.5 sqrt(bound sample time), k2 = 1.1 bound",
    )
    k1: float = parameter(
        0.0, low=0.0, description="given: gain of the root of the switching function (root of input unit), above 0"
    )
    k2: float = parameter(
        0.0, unit="1/s", low=0.0, description="given: rate of the integral part (input unit per second), above 0"
    )
    discretisation: str = parameter(
        "implicit",
        choices=("explicit", "implicit"),
        description="Backward Euler with projection (implicit: no chattering) or the sampled law (explicit)",
    )


def twisting_gains(parameters: SuperTwistingParameters, sample_time: float) -> tuple[float, float]:
    """Return k1 and k2; ParameterError if ``super_twisting.bound``, ``k1`` or ``k2`` is zero."""
    for name in ("bound",) if parameters.gains == "from_bound" else ("k1", "k2"):
        if not getattr(parameters, name) > 0.0:
            state_feedback.refuse(f"super_twisting.{name}", getattr(parameters, name), "must be above 0")
    if parameters.gains == "given":
        return parameters.k1, parameters.k2
    return 1.5 * math.sqrt(parameters.bound * sample_time), 1.1 * parameters.bound


@lru_cache(maxsize=16)
def packed_super_twisting(parameters, sample_time: float | None = None) -> np.ndarray:
    """Return the parameter array for ControllerParameters (read-only); without a sample time it only serves as a check.

    ParameterError: the design fails; names are relative to the controller's parameters.
    """
    require_target(parameters)
    gains, packed = pack_surface(parameters, sample_time)
    seconds = sample_time or 1.0
    k1, k2 = twisting_gains(parameters.super_twisting, seconds)
    packed = packed.copy()
    n = parameters.model.dynamics.order
    # K of the reaching law is Λ⁻¹ (S A − Φ S); K of the equivalent control is the same with Φ = 1
    packed[GAINS : GAINS + n] = gains.K - (1.0 - parameters.sliding_mode.phi) * gains.S / gains.switching_gain
    packed[ROOT_GAIN] = k1
    packed[STEP] = k2 * seconds
    packed[IMPLICIT] = parameters.super_twisting.discretisation == "implicit"
    packed.flags.writeable = False
    return packed


class SuperTwisting(SlidingController):
    """Super-twisting controller with Kalman filter.

    Parameters
    ----------
    parameters : ControllerParameters
        With ``type`` super_twisting; gains in groups ``super_twisting`` and ``sliding_mode``.
    sample_time : float
        Sample time [s] of the discrete model.
    """

    kernel = staticmethod(super_twisting)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array: head, K, S, Kalman filter."""
        return packed_super_twisting(parameters, self.sample_time).copy()

    def forget(self) -> None:
        """Reset the integrated state: errors during another law's operation do not belong in this law's integral."""
        self.x[TWIST] = 0.0


def near_rest(parameters):
    """Return the parameters of the implicit law; the explicit law jumps at zero and cannot be linearised."""
    return replace(parameters, super_twisting=replace(parameters.super_twisting, discretisation="implicit"))


def designed(task: DesignTask):
    """Return the parameters in which the slowest pole of the sliding motion gives the requested bandwidth.

    Raises
    ------
    ParameterError
        A bandwidth is given for a model with one state, or the bandwidth cannot be reached.
    """
    if task.bandwidth is not None and task.parameters.model.dynamics.order == 1:
        remedy = (
            "super_twisting has no pole to place for a model with one state; give no bandwidth, or "
            "choose another controller"
        )
        state_feedback.refuse("bandwidth", task.bandwidth, remedy)
    place = sliding_pole if task.parameters.model.dynamics.order > 1 else None
    return sliding_gains(task, "super_twisting", place)


def rows(parameters, sample_time: float):
    """Return (name, text) of each row that a design prints."""
    found = design_sliding_mode(parameters.sliding_mode, parameters.model.dynamics.state_space)
    k1, k2 = twisting_gains(parameters.super_twisting, sample_time)
    return [surface_row(found), ("k1, k2", f"{k1:.6g}, {k2:.6g} 1/s"), filter_row(parameters)]


def doubts(parameters, sample_time: float, tuned: bool):
    """Return the warning about the range in which this law's margins are valid."""
    return ["the margins of super_twisting hold for small signals, where the switching function is below k2 T"]


CONTROLLER = ControllerLaw(
    name="super_twisting",
    block=SuperTwisting,
    description="super-twisting, with Kalman filter",
    groups={
        "sliding_mode": SlidingModeParameters,
        "super_twisting": SuperTwistingParameters,
        "kalman": KalmanParameters,
    },
    check=check_with(packed_super_twisting),
    warnings=integration_warning,
    near_rest=near_rest,
    designs={"super_twisting": designed},
    rows=rows,
    doubts=doubts,
)
