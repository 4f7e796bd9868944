# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Positive position feedback: one or two resonant filters of the displacement, added to the command [1]_, [2]_.

u = γ w + Σ g_i ω_i² / (s² + 2 ζ_i ω_i s + ω_i²) y

The factor γ keeps the DC gain. A filter changes the stiffness below its frequency, and damps at its frequency. If the
delay of the loop is more than about a quarter of the resonance's period, damping needs the opposite sign of the gain, g
< 0.

References
----------
.. [1] Goh & Caughey, On the stability problem caused by finite actuator dynamics in the collocated control of large
   space structures, Int. J. Control 41 (1985) 787-802.
.. [2] Fanson & Caughey, Positive position feedback control for large space structures, AIAA J. 28 (1990) 717-724.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control.damping.kind import (
    MEASUREMENT,
    DampingKind,
    Mode,
    in_parallel,
    require_below_half_the_rate,
    require_filters,
    second_order,
    shortened,
    warped,
)
from hysteresis_ros.models.linear import StateSpace

#: Largest number of modes.
MOST = 2


@dataclass(frozen=True)
class PpfParameters(Parameters):
    """The filters of positive position feedback, one or two."""

    frequencies: tuple[float, ...] = parameter(
        (), unit="Hz", low=1e-6, description="frequencies of the filters, one or two"
    )
    damping: tuple[float, ...] = parameter((), low=1e-4, description="damping ratio of each filter")
    gains: tuple[float, ...] = parameter(
        (), description="DC gain of each filter; below 0 for a delay above about a quarter of the resonance's period"
    )

    def check(self):
        """Yield a Problem if there is no filter, if there are too many, or if the arrays differ in length."""
        yield from require_filters(self, MOST, ("damping", "gains"))


def ppf(parameters: PpfParameters, sample_time: float) -> StateSpace:
    """Return the sum of the filters, from the displacement to the command.

    Raises
    ------
    ParameterError
        ``frequencies``: a frequency is not below half the sample rate.
    """
    require_below_half_the_rate(parameters.frequencies, sample_time)
    found = []
    for frequency, damping, gain in zip(parameters.frequencies, parameters.damping, parameters.gains, strict=True):
        omega = 2.0 * math.pi * frequency
        square = omega * omega
        below = (1.0, 2.0 * damping * omega, square)
        found.append(second_order((0.0, 0.0, gain * square), below, warped(frequency, sample_time)))
    return in_parallel(found)


def ranges(mode: Mode) -> tuple:
    """Return the search ranges of (DC gain of the loop, frequency [Hz], damping) of one filter, for both signs."""
    frequency, damping = (0.3 * mode.frequency, 3.0 * mode.frequency, True), (0.05, 2.0, True)
    return ((0.02, 0.4, True), frequency, damping), ((-1.0, -0.02, True), frequency, damping)


def chosen(point, mode: Mode) -> PpfParameters:
    """Return the parameters of one filter."""
    gain, frequency, damping = shortened(point[0] / mode.gain), shortened(point[1]), shortened(point[2])
    return PpfParameters(frequencies=(frequency,), damping=(damping,), gains=(gain,))


DAMPING = DampingKind(
    name="ppf",
    description="positive position feedback of one or two modes (Fanson & Caughey 1990)",
    source=MEASUREMENT,
    parameters=PpfParameters,
    filter=ppf,
    ranges=ranges,
    chosen=chosen,
)
