# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The inverses by name: those that serve any model, and those that models bring along."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.compensation.general import general
from hysteresis_ros.compensation.picard import picard
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.declaration import HysteresisBlock, OwnInverse
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters
from hysteresis_ros.models.hysteresis.proportional import proportional_inverse
from hysteresis_ros.models.rate_independent import require_structure
from hysteresis_ros.parameters import Parameters, parameter, variants

#: What the inverses are that every model may have; ``exact`` is the closed form of the model's own block.
GENERAL_INVERSES = {
    "none": ("voltage = command / gain", proportional_inverse),
    "picard_steps": ("", picard),
    "exact": ("closed form of the model", None),
    "general": ("root search on any model", general),
}


@dataclass(frozen=True)
class BroughtInverse:
    """An inverse that a model brings along.

    Parameters
    ----------
    model : str
        Name of the model.
    inverse : OwnInverse
        What it declares.
    """

    model: str
    inverse: OwnInverse


def _brought() -> dict[str, BroughtInverse]:
    """Return the inverses that models bring along.

    Raises
    ------
    TypeError
        Two models, or a model and :data:`GENERAL_INVERSES`, use one name.
    """
    found: dict[str, BroughtInverse] = {}
    for model, declared in MODELS.items():
        for name, inverse in declared.own_inverses.items():
            if name in GENERAL_INVERSES or name in found:
                raise TypeError(f"{model} brings along an inverse {name!r}: the name is taken")
            found[name] = BroughtInverse(model, inverse)
    return found


#: Inverses that models bring along, by name.
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
    """Which inverse of the hysteresis model is used."""

    type: str = parameter("exact", description=f"inverse: {_described()}", choices=NAMES, read_only=True)
    picard_steps: int = parameter(3, description="number of Picard steps", low=1, high=1000)
    picard_rate: float = parameter(
        0.0, description="R of the Picard steps; 0: 1/gain of the model", unit="V/m", low=0.0
    )

    def fits(self, hysteresis: HysteresisParameters):
        """Yield a Problem when this inverse does not fit the model.

        Parameters
        ----------
        hysteresis : HysteresisParameters
        """
        kind, model, block = self.type, hysteresis.type, hysteresis.model.block
        brought = BROUGHT.get(kind)
        allowed = ""
        if kind == "exact" and block.inverse is None:
            allowed = f"{model} has no closed-form inverse; use general"
        if brought is not None and brought.inverse.follows_model and brought.model != model:
            allowed = f"is the inverse of {brought.model} only, the model is {model}; use general"
        if kind != "none" and not block.invertible:
            allowed = f"{model} has dynamics inside, no inverse fits it; use none, or another model"
        if allowed:
            yield Problem("inverse.type", kind, allowed)

    def require_same(self, present: InverseParameters) -> None:
        """Raise ParameterError when type or sizes are not the ``present`` ones: they cannot change while running."""
        if self.type != present.type:
            raise ParameterError([Problem("inverse.type", self.type, f"is fixed while running: keep {present.type}")])
        if self._own_block is not None:
            require_structure(getattr(present, self.type), getattr(self, self.type))

    def kernel(self, block: HysteresisBlock) -> Callable:
        """Return the inverse, to be called with the state of the model's ``block``.

        Parameters
        ----------
        block : HysteresisBlock
        """
        if self.type in BROUGHT:
            return BROUGHT[self.type].inverse.kernel
        kernel: Any = GENERAL_INVERSES[self.type][1] or block.inverse
        return kernel

    @property
    def _own_block(self):
        brought = BROUGHT.get(self.type)
        return None if brought is None else brought.inverse.block

    def own_block(self, sample_time: float):
        """Return the block of the inverse's own equation, or None: it follows the model.

        Parameters
        ----------
        sample_time : float
            [s]
        """
        block = self._own_block
        return None if block is None else block(getattr(self, self.type), sample_time)

    def packed(self, gain: float, lowest: float, highest: float) -> np.ndarray:
        """Return the array p_i of the inverses that follow a model, shape (5,).

        Parameters
        ----------
        gain : float
            Nominal gain of the model [m/V].
        lowest, highest : float
            Voltages between which ``general`` searches [V].
        """
        return np.array([self.picard_steps, self.picard_rate or 1.0 / gain, gain, lowest, highest])


def tries_model(inverse) -> bool:
    """Tell whether an inverse tries the model's kernel; all others are closed forms, which do not use it.

    Parameters
    ----------
    inverse : callable
    """
    return inverse in (picard, general)
