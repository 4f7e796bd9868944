# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Declaration of a kind of damping, and discrete filters for kinds.

Filters are discretised by s = h (z − 1)/(z + 1). With h = ω / tan(ω T/2), the discrete filter has exactly the
continuous-time response at ω. With h = 2/T, its response approaches the continuous-time response at low frequencies. A
stable filter stays stable at any sample time.

References
----------
.. [1] Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed. 1998, section 6.1 (Tustin, prewarping).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.models.linear_algebra import product

#: Inputs of a filter: none, measured displacement, output of the law, and measured force in the stack.
NOTHING, MEASUREMENT, COMMAND, FORCE = range(4)
#: Maximum number of states of a filter.
MOST_STATES = 8


def shortened(value: float) -> float:
    """Return a number rounded to four significant digits, because the other digits may differ between processors."""
    return float(f"{value:.4g}")


@dataclass(frozen=True)
class Mode:
    """Resonance that a design damps.

    Parameters
    ----------
    frequency : float
        [Hz]
    damping : float
        Damping ratio.
    gain : float
        DC gain of the whole model: displacement divided by command.
    force : float
        Force divided by command far above the resonance [N/m]; 0: there is no force sensor.
    """

    frequency: float
    damping: float
    gain: float
    force: float = 0.0


@dataclass(frozen=True, eq=False)
class DampingKind:
    """A kind of damping: its parameters, its filter, and the ranges in which a design searches.

    Parameters
    ----------
    name : str
        ``damping.type`` of the motion controller.
    description : str
        Short description for the table of parameters.
    source : int
        Input of the filter: ``MEASUREMENT``, ``COMMAND`` or ``FORCE``.
    parameters : type
        Group ``damping.<name>``.
    filter : callable
        ``filter(parameters, sample_time)`` returns a :class:`StateSpace` with one input, one output and at most
        ``MOST_STATES`` states. It raises ParameterError, with names relative to the kind's group, if the filter cannot
        run at this sample time.
    ranges : callable
        ``ranges(mode)`` returns the boxes in which a design searches. A box has one (low, high, logarithmic) for each
        coordinate.
    chosen : callable
        ``chosen(point, mode)`` returns the parameters for a point of such a box.
    """

    name: str
    description: str
    source: int
    parameters: type[Parameters]
    filter: Callable[[Any, float], StateSpace]
    ranges: Callable[[Mode], tuple]
    chosen: Callable[[Any, Mode], Any]


def warped(frequency: float, sample_time: float) -> float:
    """Return h [1/s] of the prewarped bilinear transform s = h (z − 1)/(z + 1) for a frequency.

    A filter discretised with this h has the response of its continuous-time original at ``frequency``.

    Units: ``frequency`` [Hz], below half the sample rate; ``sample_time`` [s].
    """
    angle = math.pi * frequency * sample_time
    return 2.0 * math.pi * frequency * elementary.cos(angle) / elementary.sin(angle)


def first_order(gain: float, rate: float, sample_time: float) -> StateSpace:
    """Return the filter gain/(s + rate), with one input and one output.

    Parameters
    ----------
    gain : float
        [1/s]
    rate : float
        Above 0 [rad/s].
    sample_time : float
        [s]
    """
    h = 2.0 / sample_time
    pole, through = (h - rate) / (h + rate), gain / (h + rate)
    return StateSpace(np.array([[pole]]), np.ones((1, 1)), np.array([[through * (1.0 + pole)]]), np.array([[through]]))


def second_order(numerator, denominator, h: float) -> StateSpace:
    """Return the filter (b₂ s² + b₁ s + b₀)/(a₂ s² + a₁ s + a₀), with one input and one output.

    Parameters
    ----------
    numerator, denominator : tuple of float, shape (3,)
        (b₂, b₁, b₀) and (a₂, a₁, a₀).
    h : float
        h of the bilinear transform [1/s].
    """
    above, below = _discrete(numerator, h), _discrete(denominator, h)
    b0, b1, b2 = (value / below[0] for value in above)
    a1, a2 = below[1] / below[0], below[2] / below[0]
    A = np.array([[-a1, 1.0], [-a2, 0.0]])
    return StateSpace(A, np.array([[b1 - a1 * b0], [b2 - a2 * b0]]), np.array([[1.0, 0.0]]), np.array([[b0]]))


def _discrete(coefficients, h: float) -> tuple[float, float, float]:
    c2, c1, c0 = coefficients
    square = c2 * h * h
    return square + c1 * h + c0, 2.0 * (c0 - square), square - c1 * h + c0


def in_series(systems) -> StateSpace:
    """Return the series connection of systems with one input and one output; the first system receives the input."""
    found, *others = systems
    for after in others:
        corner = np.zeros((found.order, after.order))
        found = StateSpace(
            np.block([[found.A, corner], [product(after.B, found.C), after.A]]),
            np.vstack([found.B, product(after.B, found.D)]),
            np.hstack([product(after.D, found.C), after.C]),
            product(after.D, found.D),
        )
    return found


def in_parallel(systems) -> StateSpace:
    """Return the sum of the outputs of systems with one input and one output, all with the same input."""
    found, *others = systems
    for beside in others:
        corner = np.zeros((found.order, beside.order))
        found = StateSpace(
            np.block([[found.A, corner], [corner.T, beside.A]]),
            np.vstack([found.B, beside.B]),
            np.hstack([found.C, beside.C]),
            found.D + beside.D,
        )
    return found


def require_filters(parameters, most: int, beside: tuple[str, ...]):
    """Yield a Problem if there is no filter, if there are more than ``most``, or if arrays differ in length.

    ``beside`` contains the names of the arrays, in addition to ``frequencies``, that have one number per filter.
    """
    count = len(parameters.frequencies)
    if not 1 <= count <= most:
        yield Problem("frequencies", parameters.frequencies, f"must be 1 … {most} numbers")
        return
    for name in beside:
        values = getattr(parameters, name)
        if len(values) != count:
            yield Problem(name, values, f"must be {count} numbers, as many as frequencies")


def require_below_half_the_rate(frequencies: tuple[float, ...], sample_time: float) -> None:
    """Raise ParameterError about ``frequencies`` if a filter is at or above half the sample rate.

    Units: ``frequencies`` [Hz], ``sample_time`` [s].
    """
    highest = 0.5 / sample_time
    if not max(frequencies) < highest:
        remedy = f"each must be below half the sample rate, {highest:g} Hz"
        raise ParameterError([Problem("frequencies", frequencies, remedy)])
