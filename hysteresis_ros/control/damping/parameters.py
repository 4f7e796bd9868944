# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which damping there is, and its filter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from hysteresis_ros.control.damping.kind import MOST_STATES, NOTHING
from hysteresis_ros.control.damping.registry import KINDS, NONE
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.state_space import StateSpace
from hysteresis_ros.parameters import Parameters, parameter, variants


@dataclass(frozen=True)
@variants("type", {name: kind.parameters for name, kind in KINDS.items()})
class DampingParameters(Parameters):
    """Damping between the law and the compensator."""

    type: str = parameter(
        NONE,
        choices=(NONE, *KINDS),
        description="none; " + "; ".join(f"{name}: {kind.description}" for name, kind in KINDS.items()),
    )

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return the group of a kind."""

    @property
    def source(self) -> int:
        """What the filter works on, one of the numbers of :mod:`~hysteresis_ros.control.damping.kind`."""
        return NOTHING if self.type == NONE else KINDS[self.type].source

    def filter(self, sample_time: float) -> StateSpace:
        """Return the filter of the chosen kind, SI.

        Parameters
        ----------
        sample_time : float
            [s]

        Raises
        ------
        ParameterError
            It cannot run at this sample time; names begin with ``damping.``.
        """
        try:
            found = KINDS[self.type].filter(getattr(self, self.type), sample_time)
        except ParameterError as error:
            named = [replace(problem, name=f"damping.{self.type}.{problem.name}") for problem in error.problems]
            raise ParameterError(named) from None
        if found.order > MOST_STATES:
            allowed = f"has {found.order} states, at most {MOST_STATES} are allowed"
            raise ParameterError([Problem("damping.type", self.type, allowed)])
        return found
