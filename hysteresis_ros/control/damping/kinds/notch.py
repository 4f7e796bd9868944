# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One to four notch filters after the law: the law does not excite the resonances, but it does not damp them either.

N(s) = Π (s² + 2 ζ_i ω_i s + ω_i²) / (s² + 2 η_i ω_i s + ω_i²)

with unit gain at frequency zero and at high frequencies, and gain ζ_i/η_i at ω_i. Disturbances and noise still excite a
resonance, with the plant's own damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control.damping.kind import (
    COMMAND,
    DampingKind,
    Mode,
    in_series,
    require_below_half_the_rate,
    require_filters,
    second_order,
    shortened,
    warped,
)
from hysteresis_ros.models.linear import StateSpace

#: Largest number of filters.
MOST = 4


@dataclass(frozen=True)
class NotchParameters(Parameters):
    """The notch filters, one to four."""

    frequencies: tuple[float, ...] = parameter(
        (), unit="Hz", low=1e-6, description="frequencies of the notches, one to four"
    )
    damping: tuple[float, ...] = parameter(
        (), low=0.0, description="damping ratio of each numerator: that of the plant's resonance"
    )
    width: tuple[float, ...] = parameter((), low=1e-4, description="damping ratio of each denominator")

    def check(self):
        """Yield a Problem if there is no filter, if there are too many, or if the arrays differ in length."""
        yield from require_filters(self, MOST, ("damping", "width"))


def notch(parameters: NotchParameters, sample_time: float) -> StateSpace:
    """Return the series of the filters, from the law's output to the command.

    Raises
    ------
    ParameterError
        ``frequencies``: a frequency is not below half the sample rate.
    """
    require_below_half_the_rate(parameters.frequencies, sample_time)
    found = []
    for frequency, damping, width in zip(parameters.frequencies, parameters.damping, parameters.width, strict=True):
        omega = 2.0 * math.pi * frequency
        square = omega * omega
        above, below = (1.0, 2.0 * damping * omega, square), (1.0, 2.0 * width * omega, square)
        found.append(second_order(above, below, warped(frequency, sample_time)))
    return in_series(found)


def ranges(mode: Mode) -> tuple:
    """Return the search ranges of frequency [Hz], damping of the numerator, and width."""
    least = min(mode.damping, 0.5)
    frequency = (0.8 * mode.frequency, 1.25 * mode.frequency, True)
    return ((frequency, (least, 0.9, True), (0.1, 3.0, True)),)


def chosen(point, mode: Mode) -> NotchParameters:
    """Return the parameters of one notch."""
    frequency, damping, width = (shortened(value) for value in point)
    return NotchParameters(frequencies=(frequency,), damping=(damping,), width=(width,))


DAMPING = DampingKind(
    name="notch",
    description="one to four notch filters behind the law, so that it neither excites nor damps the resonances",
    source=COMMAND,
    parameters=NotchParameters,
    filter=notch,
    ranges=ranges,
    chosen=chosen,
)
