# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Hyperplane and linear gain of the sliding mode controllers: parameters and design."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.control import design
from hysteresis_ros.linear_algebra import product
from hysteresis_ros.models.state_space import StateSpace
from hysteresis_ros.parameters import Parameters, parameter


@dataclass(frozen=True)
class SlidingModeParameters(Parameters):
    """Hyperplane and laws of the three sliding mode controllers; gains are in the model's units."""

    tracking: str = parameter(
        "target",
        choices=("target", "integral"),
        read_only=True,
        description="Follow the reference by its rest point alone (target), or with an integral of the error as well",
    )
    hyperplane: str = parameter(
        "lq",
        choices=("given", "lq", "poles"),
        read_only=True,
        description="Whether S is given, follows from an LQ problem, or from the poles of the sliding motion",
    )
    S: tuple[float, ...] = parameter(
        (), description="Hyperplane when given: one entry a state, and one for the integral with integral tracking"
    )
    lq_state_weight: tuple[float, ...] = parameter(
        (),
        description="State weight of the LQ problem: diagonal or rows of a matrix (with the integral as last state); "
        "empty: output squared plus 0.0001 of the integral squared",
    )
    lq_input_weight: float = parameter(1.0, low=0.0, description="Input weight of the LQ problem, above 0")
    poles: tuple[float, ...] = parameter(
        (),
        low=-1.0,
        high=1.0,
        description="Real parts of the poles of the sliding motion: one fewer than states (the integral counts as one)",
    )
    poles_imaginary: tuple[float, ...] = parameter(
        (),
        low=-1.0,
        high=1.0,
        description="Imaginary parts of the poles, in conjugate pairs; empty: all poles are real",
    )
    phi: float = parameter(
        0.93, low=-1.0, high=1.0, description="Reaching law: s(k+1) = phi s(k) without the nonlinear part"
    )
    rejection_pole: float = parameter(
        0.5,
        low=-1.0,
        high=1.0,
        description="integral_sliding_mode: s(k+1) = rejection_pole s(k), how fast it rejects what the filter does not "
        "explain; 0 at once, nearer to 1 calmer",
    )
    eta: float = parameter(0.0, low=0.0, description="Slope of the nonlinear part over |s| / |S B|")
    beta: float = parameter(0.0, low=0.0, description="Constant level of the nonlinear part (input unit)")
    delta: float = parameter(0.0, low=0.0, description="Width of the boundary layer (unit of s)")
    anti_windup_threshold: float = parameter(
        0.02,
        low=0.0,
        description="The integral holds while command and applied differ by more than this fraction of the largest "
        "applied command so far and integrating would widen the difference",
    )


@dataclass(frozen=True, eq=False)
class SlidingModeDesign:
    """Gains that follow from the parameters, in the model's units.

    Attributes
    ----------
    S, K : ndarray, shape (n,) or (n + 1,) with integral tracking
        Hyperplane and linear gain.
    switching_gain : float
        Λ = S B.
    poles : ndarray, shape like S
        Poles of the controlled model.
    """

    S: np.ndarray
    K: np.ndarray
    switching_gain: float
    poles: np.ndarray


def design_sliding_mode(parameters: SlidingModeParameters, model: StateSpace) -> SlidingModeDesign:
    """Return hyperplane and linear gain for a model.

    Parameters
    ----------
    parameters : SlidingModeParameters
    model : StateSpace
        Of one input and one output, in its own units.

    Raises
    ------
    ParameterError
        Names the parameter of ``sliding_mode`` or ``model.dynamics`` from which no stable controller follows.
    """
    whole = model
    if parameters.tracking == "integral":
        design.steady_state(model)  # without DC gain the integral never settles
        whole = design.integral_system(model)
    n, order, A, B = model.order, whole.order, whole.A, whole.B
    if parameters.hyperplane == "given":
        if len(parameters.S) != order:
            design.refuse("sliding_mode.S", parameters.S, f"must have {order} entries with this model and tracking")
        S = np.array(parameters.S, dtype=float)
    elif parameters.hyperplane == "poles":
        S = design.hyperplane_from_poles(A, B, _poles(parameters, order))
    else:
        if not parameters.lq_input_weight > 0.0:
            design.refuse("sliding_mode.lq_input_weight", parameters.lq_input_weight, "must be above 0")
        if parameters.lq_state_weight:
            weight = design.square_weight(parameters.lq_state_weight, order, "sliding_mode.lq_state_weight")
        else:
            weight = np.zeros((order, order))
            weight[:n, :n] = product(model.C.T, model.C)
            weight[n:, n:] = 1e-4
        S = design.hyperplane_lq(A, B, weight, parameters.lq_input_weight)
    if not abs(parameters.phi) < 1.0:
        design.refuse(
            "sliding_mode.phi", parameters.phi, "must be inside -1 … 1, or the switching function never decays"
        )
    if not parameters.phi - parameters.eta > -1.0:
        design.refuse("sliding_mode.eta", parameters.eta, f"must be below 1 + phi = {1.0 + parameters.phi:g}")
    K, switching_gain = design.sliding_gain(A, B, S, parameters.phi)
    return SlidingModeDesign(S, K, switching_gain, np.linalg.eigvals(A - B @ K[np.newaxis]))


def _poles(parameters: SlidingModeParameters, order: int):
    if len(parameters.poles) != order - 1:
        design.refuse("sliding_mode.poles", parameters.poles, f"must have {order - 1} entries with this model")
    imaginary = parameters.poles_imaginary or (0.0,) * (order - 1)
    if len(imaginary) != order - 1:
        design.refuse("sliding_mode.poles_imaginary", imaginary, f"must be empty or have {order - 1} entries")
    poles = [complex(*parts) for parts in zip(parameters.poles, imaginary, strict=True)]
    if sorted(poles, key=_order) != sorted((pole.conjugate() for pole in poles), key=_order):
        design.refuse("sliding_mode.poles_imaginary", imaginary, "complex poles must come in conjugate pairs")
    if any(abs(pole) >= 1.0 for pole in poles):
        design.refuse("sliding_mode.poles", parameters.poles, "all poles must be inside the unit circle")
    return poles


def _order(pole: complex):
    return pole.real, pole.imag
