# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What rate-independent hysteresis models share: the last point in the state, live parameters without a jump.

A rate-independent model knows only the order of the voltages, not their speed. Its kernel takes the voltage at the end
of a step along which it moved monotonically and returns the displacement there.
"""

from __future__ import annotations

from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.declaration import DISPLACEMENT_PLACE, HysteresisBlock

# The first two places of x in every model with memory.
VOLTAGE = 0  # at the last step [V]
DISPLACEMENT = DISPLACEMENT_PLACE  # the last output [m]


def require_structure(present, wanted) -> None:
    """Raise ParameterError when parameters differ in structure (sizes of arrays) from those in use.

    Parameters
    ----------
    present, wanted : Parameters
        Of the same class. A class whose arrays may have any length has a ``structure``: a dict of name to size.
    """
    before, after = getattr(present, "structure", {}), getattr(wanted, "structure", {})
    problems = [
        Problem(name, after.get(name), f"is fixed while running: keep {size}; another size needs a new configuration")
        for name, size in before.items()
        if after.get(name) != size
    ]
    if problems:
        raise ParameterError(problems)


class InvertibleBlock(HysteresisBlock):
    """Base of the models with memory whose output at the end of a step rises with the voltage there.

    Their parameters change live without a jump, and inverses fit them.

    Parameters
    ----------
    parameters : Parameters
        Typed parameters, checked on construction.
    sample_time : float
        Sample time [s].
    """

    invertible = True

    def retune(self, parameters) -> None:
        """Take new parameters of the same structure while running; the output stays where it is.

        Raises
        ------
        ParameterError
            The parameters are wrong or of another structure; the block is unchanged then.
        """
        require_structure(self.parameters, parameters.validated())
        super().retune(parameters)
        self.rebase()


class RateIndependentBlock(InvertibleBlock):
    """Base of the rate-independent hysteresis models, voltage [V] to displacement [m].

    Parameters
    ----------
    parameters : Parameters
        Typed parameters, checked on construction.
    sample_time : float
        Sample time [s]; not used by the model itself.
    """

    rate_independent = True
