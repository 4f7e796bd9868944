# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The hysteresis models: each is a file or folder in this folder and is found automatically.

:mod:`hysteresis_ros.models.declaration` describes the declaration of a model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from hysteresis_ros.configuration import Parameters, parameter, variants
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.declaration import HysteresisBlock, HysteresisModel, require_structure
from hysteresis_ros.registry import discover

#: The models, by name.
MODELS: dict[str, HysteresisModel] = discover(__name__, "MODEL", HysteresisModel, "hysteresis_ros.models")


@dataclass(frozen=True)
@variants("type", {name: model.parameters for name, model in MODELS.items()})
class HysteresisParameters(Parameters):
    """Type of the hysteresis model, and parameters of every model in a group with the name of the model."""

    type: str = parameter(description="hysteresis model", choices=tuple(MODELS), read_only=True)

    if TYPE_CHECKING:

        def __init__(self, type: str = ..., **models: Parameters): ...

        def __getattr__(self, name: str) -> Any: ...

    @property
    def model(self) -> HysteresisModel:
        """Declaration of the chosen model."""
        return MODELS[self.type]

    @property
    def chosen(self) -> Parameters:
        """Parameters of the chosen model."""
        return getattr(self, self.type)

    def changed(self, chosen: Parameters) -> HysteresisParameters:
        """Return a copy with other parameters of the chosen model.

        Parameters
        ----------
        chosen : Parameters
        """
        values: dict[str, Any] = {self.type: chosen}
        return replace(self, **values)

    def scaled(self, factor: float) -> HysteresisParameters:
        """Return the hysteresis with its displacement multiplied by ``factor``.

        Parameters
        ----------
        factor : float
            Above 0.
        """
        return self.changed(self.model.scaled(self.chosen, factor))

    def shifted(self, offset: float) -> HysteresisParameters:
        """Return the hysteresis with ``offset`` [m] added to its displacement; unchanged without a constant term.

        Parameters
        ----------
        offset : float
            [m]
        """
        shifted = self.model.shifted
        return self if shifted is None else self.changed(shifted(self.chosen, offset))

    def require_same(self, present: HysteresisParameters) -> None:
        """Raise ParameterError if type or sizes, which are fixed while running, differ from ``present``."""
        if self.type != present.type:
            raise ParameterError(
                [Problem("hysteresis.type", self.type, f"is fixed while running: keep {present.type}")]
            )
        require_structure(present.chosen, self.chosen)


def hysteresis_block(parameters: HysteresisParameters, sample_time: float) -> HysteresisBlock:
    """Return the block of the chosen model; raise ParameterError if type or parameters are wrong.

    In addition to the attributes of every block, the block has ``gain`` [m/V], ``inverse`` (closed-form inverse, or
    None), ``rate_independent``, ``invertible`` and ``rebase()``.
    """
    parameters = parameters.validated()
    return parameters.model.block(parameters.chosen, sample_time)
