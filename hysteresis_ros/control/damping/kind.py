# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a kind of damping declares, so that parameters, loop and design know all of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hysteresis_ros.models.state_space import StateSpace
from hysteresis_ros.parameters import Parameters

#: What a filter works on: nothing, the measured displacement, the output of the law, the measured force in the stack.
NOTHING, MEASUREMENT, COMMAND, FORCE = range(4)
#: Most states of a filter.
MOST_STATES = 8


def shortened(value: float) -> float:
    """Return a number that a search found, in four significant digits: more would differ between processors."""
    return float(f"{value:.4g}")


@dataclass(frozen=True)
class Mode:
    """The resonance that a design damps.

    Parameters
    ----------
    frequency : float
        [Hz]
    damping : float
        Part of the critical one.
    gain : float
        Displacement per command at rest, of the whole model.
    force : float
        Force per command far above the resonance [N/m]; 0: none is measured.
    """

    frequency: float
    damping: float
    gain: float
    force: float = 0.0


@dataclass(frozen=True, eq=False)
class DampingKind:
    """A kind of damping: its parameters, its filter, and where a design looks for it.

    Parameters
    ----------
    name : str
        ``damping.type`` of the motion controller.
    description : str
        A few words for the table of parameters.
    source : int
        ``MEASUREMENT``, ``COMMAND`` or ``FORCE``: what the filter works on.
    parameters : type
        Group ``damping.<name>``.
    filter : callable
        ``filter(parameters, sample_time)`` returns a :class:`StateSpace` of one input and one output, of at most
        ``MOST_STATES`` states; it raises ParameterError, with names relative to its group, where it cannot run at this
        sample time.
    ranges : callable
        ``ranges(mode)`` returns boxes, each a tuple of (low, high, logarithmic), in which a design searches.
    chosen : callable
        ``chosen(point, mode)`` returns the parameters of a point of such a box.
    """

    name: str
    description: str
    source: int
    parameters: type[Parameters]
    filter: Callable[[Any, float], StateSpace]
    ranges: Callable[[Mode], tuple]
    chosen: Callable[[Any, Mode], Any]
