# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The inverses by name: root search (exact), Picard steps (approximate), and the inverses that models declare.

The inverse ``general`` evaluates the model's kernel with a copy of the model's state. For any model, it finds the
voltage at which the model's output is the commanded displacement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter, variants
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import INVERSE, composite, nested
from hysteresis_ros.models.declaration import HysteresisBlock, OwnInverse, require_structure
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters
from hysteresis_ros.models.hysteresis.proportional import proportional_inverse

# Layout of p_i of ``general``; the first three entries are the parameters of the Picard steps.
GAIN = 2  # nominal gain [m/V]
LOWEST = 3  # first of the two voltages of the search range [V]
HIGHEST = 4

#: Residual at which the search ends, relative to the displacements: a few units in the last place.
TOLERANCE = 4.0e-16
MOST_TRIALS = 120


@nested
def _trial(hysteresis, x_i, p_h, x_h, voltage):
    states = x_h.shape[0]
    trial = x_i[:states]
    for i in range(states):
        trial[i] = x_h[i]
    return hysteresis(p_h, trial, voltage)


@composite(*INVERSE)
def general(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Return the voltage [V] at which the model's next output is ``displacement`` [m], exact to rounding.

    Trial voltages start at the last voltage and go in the direction of the change, until the model's output has passed
    the target. Then regula falsi with Anderson-Björck weights narrows the bracket; if three trials have not halved it,
    a bisection step follows. The number of trials is bounded. For a displacement beyond the model's range, the result
    is the lowest or the highest voltage; for NaN, it is the last voltage. ``x_h`` is not changed.

    Parameters
    ----------
    hysteresis : kernel
        Any model that stores the last voltage and the last output in ``x[0]`` and ``x[1]``, or that has no memory.
    p_i : ndarray, shape (5,)
        Nominal gain [m/V] at index 2, lowest and highest voltage [V] at indices 3 and 4.
    x_i : ndarray, shape (>= len(x_h),)
        Scratch.
    p_h, x_h : ndarray
        Parameters and state of the model.
    displacement : float
        Commanded output [m].
    """
    lowest, highest = p_i[LOWEST], p_i[HIGHEST]
    # a model with one state has no memory, so any start is valid
    near = max(lowest, min(highest, x_h[0])) if x_h.shape[0] > 1 else 0.0
    missing = displacement - _trial(hysteresis, x_i, p_h, x_h, near)
    if not abs(missing) > 0.0:
        return near
    direction = 1.0 if missing > 0.0 else -1.0
    limit = highest if missing > 0.0 else lowest
    near_error = -direction * missing  # the residual is below zero at the near end, above at the far end
    size = abs(displacement) + abs(missing)
    step = abs(missing) / p_i[GAIN]
    far, far_error = near, near_error
    trials = 0
    while trials < MOST_TRIALS:
        trials += 1
        far = near + direction * step
        if direction * (far - limit) >= 0.0:
            far = limit
        far_error = direction * (_trial(hysteresis, x_i, p_h, x_h, far) - displacement)
        if abs(far_error) <= TOLERANCE * size or (far_error < 0.0 and far == limit):
            return far
        if far_error > 0.0:
            break
        # extrapolate with the last slope and slightly further, by at least half of the present distance
        seen = far_error - near_error
        ahead = 1.1 * step * (-far_error / seen) if seen > 0.0 else 4.0 * step
        step = max(0.5 * step, min(ahead, 8.0 * step))
        near, near_error = far, far_error
    width = abs(far - near)
    near_weight, far_weight = near_error, far_error
    slow = 0
    while trials < MOST_TRIALS:
        trials += 1
        voltage = near + (far - near) * (near_weight / (near_weight - far_weight))
        if slow >= 3:
            voltage = near + 0.5 * (far - near)
            slow = 0
        if (voltage - near) * (voltage - far) >= 0.0:  # no float64 lies between them, or the secant left the bracket
            voltage = near + 0.5 * (far - near)
            if voltage in (near, far):
                break
        error = direction * (_trial(hysteresis, x_i, p_h, x_h, voltage) - displacement)
        if abs(error) <= TOLERANCE * size:
            return voltage
        if error < 0.0:
            weight = 1.0 - error / near_weight
            far_weight *= weight if weight > 0.0 else 0.5
            near, near_error, near_weight = voltage, error, error
            far_weight = max(far_weight, 1e-3 * far_error)
        else:
            weight = 1.0 - error / far_weight
            near_weight *= weight if weight > 0.0 else 0.5
            far, far_error, far_weight = voltage, error, error
            near_weight = min(near_weight, 1e-3 * near_error)
        slow += 1
        if abs(far - near) <= 0.5 * width:
            width = abs(far - near)
            slow = 0
    return near if -near_error <= far_error else far


# Layout of p_i of the Picard steps.
STEPS = 0
RATE = 1  # R [V/m]
PICARD_GAIN = 2  # nominal gain [m/V]


@composite(*INVERSE)
def picard(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Return the voltage for ``displacement`` [m]: V_0 = V_r = displacement/gain, V_{j+1} = V_j + (V_r - R H(V_j)).

    One step gives the compensator of the paper in its corrected form, 2 V_r - R X. Every trial H(V_j) starts from the
    state ``x_h``, which is not changed.

    Parameters
    ----------
    hysteresis : kernel
        Any model H.
    p_i : ndarray, shape (3,)
        Number of steps, R [V/m], nominal gain [m/V].
    x_i : ndarray, shape (>= len(x_h),)
        Scratch.
    p_h, x_h : ndarray
        Parameters and state of the model.
    displacement : float
        Commanded output [m].
    """
    wanted = displacement / p_i[PICARD_GAIN]
    states = x_h.shape[0]
    trial = x_i[:states]
    voltage = wanted
    for _ in range(int(p_i[STEPS])):
        for i in range(states):
            trial[i] = x_h[i]
        voltage += wanted - p_i[RATE] * hysteresis(p_h, trial, voltage)
    return voltage


#: Descriptions and kernels of the general inverses; ``exact`` is the closed form of the model's own block.
GENERAL_INVERSES = {
    "none": ("voltage = command / gain", proportional_inverse),
    "picard_steps": ("", picard),
    "exact": ("closed form of the model", None),
    "general": ("root search on any model", general),
}


@dataclass(frozen=True)
class BroughtInverse:
    """An inverse that a model declares.

    Parameters
    ----------
    model : str
        Name of the model.
    inverse : OwnInverse
        The declaration of the inverse.
    """

    model: str
    inverse: OwnInverse


def _brought() -> dict[str, BroughtInverse]:
    """Return the inverses that models declare."""
    found: dict[str, BroughtInverse] = {}
    for model, declared in MODELS.items():
        for name, inverse in declared.own_inverses.items():
            if name in GENERAL_INVERSES or name in found:
                raise TypeError(f"{model} declares an inverse {name!r}, but this name is taken: choose another")
            found[name] = BroughtInverse(model, inverse)
    return found


#: Inverses that models declare, by name.
BROUGHT = _brought()
#: Names of all inverses.
NAMES = (*GENERAL_INVERSES, *BROUGHT)


def _described() -> str:
    words = {name: text for name, (text, _) in GENERAL_INVERSES.items()}
    words |= {name: brought.inverse.description for name, brought in BROUGHT.items()}
    return ", ".join(f"{name} ({text})" if text else name for name, text in words.items())


@dataclass(frozen=True)
@variants("type", {name: item.inverse.parameters for name, item in BROUGHT.items() if item.inverse.parameters})
class InverseParameters(Parameters):
    """Choice of the inverse of the hysteresis model."""

    type: str = parameter("exact", description=f"inverse: {_described()}", choices=NAMES, read_only=True)
    picard_steps: int = parameter(3, description="number of Picard steps", low=1, high=1000)
    picard_rate: float = parameter(
        0.0, description="R of the Picard steps; 0: 1/gain of the model", unit="V/m", low=0.0
    )

    def fits(self, hysteresis: HysteresisParameters):
        """Yield a Problem if this inverse does not work with the hysteresis model."""
        kind, model, block = self.type, hysteresis.type, hysteresis.model.block
        brought = BROUGHT.get(kind)
        remedy = ""
        if kind == "exact" and block.inverse is None:
            remedy = f"{model} has no closed-form inverse; use general"
        if brought is not None and brought.inverse.follows_model and brought.model != model:
            remedy = f"is an inverse of {brought.model} only, and the model is {model}; use general"
        if kind != "none" and not block.invertible:
            remedy = f"{model} has internal dynamics, so no inverse works with it; use none, or another model"
        if remedy:
            yield Problem("inverse.type", kind, remedy)

    def require_same(self, present: InverseParameters) -> None:
        """Raise ParameterError if type or sizes, which are fixed while running, differ from ``present``."""
        if self.type != present.type:
            raise ParameterError([Problem("inverse.type", self.type, f"is fixed while running: keep {present.type}")])
        if self._own_block is not None:
            require_structure(getattr(present, self.type), getattr(self, self.type))

    def kernel(self, block: HysteresisBlock) -> Callable:
        """Return the kernel of the inverse for the model's ``block``."""
        if self.type in BROUGHT:
            return BROUGHT[self.type].inverse.kernel
        kernel: Any = GENERAL_INVERSES[self.type][1] or block.inverse
        return kernel

    @property
    def _own_block(self):
        brought = BROUGHT.get(self.type)
        return None if brought is None else brought.inverse.block

    def own_block(self, sample_time: float):
        """Return the block with the inverse's own equation; None if the inverse uses the model's state."""
        block = self._own_block
        return None if block is None else block(getattr(self, self.type), sample_time)

    def packed(self, gain: float, lowest: float, highest: float) -> np.ndarray:
        """Return the array p_i for the inverses that use a model's state, shape (5,).

        ``gain`` is the nominal gain of the model [m/V]; ``lowest`` and ``highest`` are the ends of the search range of
        ``general`` [V].
        """
        return np.array([self.picard_steps, self.picard_rate or 1.0 / gain, gain, lowest, highest])


def tries_model(inverse) -> bool:
    """Return whether an inverse evaluates the model's kernel; all other inverses are closed forms."""
    return inverse in (picard, general)
