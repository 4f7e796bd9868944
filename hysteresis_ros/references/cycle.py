# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Where a waveform is within its cycle, from the sample counter alone.

The state ``x`` is the sample counter k (exact up to 2⁵³). The position within the cycle is never accumulated:
``frequency · sample_time`` is written once as a fraction a/b with b ≤ 2²⁶ plus a residual d, and the position is

    frac( ((k mod b) · a mod b) / b + k · d + phase / 2π ).

The products of the first term stay below 2⁵², so it is exact for every k. The residual is zero whenever frequency
and sample time, as the floating-point numbers they are, agree with a fraction within their own rounding (2⁻⁵¹
relative): the waveform then repeats bit for bit every b samples, for a period of N whole samples every N = b. With
a residual, |d| ≤ 2⁻²⁶/b makes the rounding of ``k · d`` harmless: below 1e-15 of a cycle after 10⁹ samples.
"""

from __future__ import annotations

import math
from fractions import Fraction

from hysteresis_ros.block import kernel

#: State.
COUNTER = 0

#: Parameters common to all waveforms: END is the sample from which FINAL is held (0 = endless).
OFFSET, AMPLITUDE, NUMERATOR, DENOMINATOR, RESIDUAL, PHASE, END, FINAL = range(8)
#: First parameter of each waveform's own.
OWN = 8
#: Of waveforms with a polarity the first of their own: 1 from the offset upwards, 0 symmetric.
UNIPOLAR = OWN

TWO_PI = 2.0 * math.pi
#: Edges of square and staircase that fall on a sample belong to that sample in spite of rounding [cycles].
EDGE = 1e-9
LARGEST_DENOMINATOR = 2**26


def cycles_per_sample(frequency: float | Fraction, sample_time: float) -> tuple[int, int, float]:
    """Return (a, b, d) with ``frequency · sample_time`` = a/b + d, by the rule at the top of this module."""
    exact = Fraction(frequency) * Fraction(sample_time)
    fraction = exact.limit_denominator(LARGEST_DENOMINATOR)
    residual = exact - fraction
    if abs(residual) <= exact / 2**51:
        residual = Fraction(0)
    return fraction.numerator, fraction.denominator, float(residual)


@kernel
def turns(p, k):
    """Position within the cycle at sample ``k``, in [0, 1)."""
    b = p[DENOMINATOR]
    position = ((k % b) * p[NUMERATOR]) % b / b + k * p[RESIDUAL] + p[PHASE]
    position -= math.floor(position)
    return position if position < 1.0 else 0.0


@kernel
def whole_turns(p, k):
    """Whole cycles before sample ``k`` (for phase 0)."""
    b = p[DENOMINATOR]
    rest = k % b
    product = rest * p[NUMERATOR]
    part = product % b
    return (k - rest) / b * p[NUMERATOR] + (product - part) / b + math.floor(part / b + k * p[RESIDUAL])


@kernel
def triangle_shape(position, unipolar):
    """Triangle of height one: 0 → 1 → 0 (unipolar) or 0 → 1 → −1 → 0 (symmetric), ``position`` in [0, 1)."""
    if unipolar > 0.0:
        return 2.0 * position if position < 0.5 else 2.0 - 2.0 * position
    if position < 0.25:
        return 4.0 * position
    return 2.0 - 4.0 * position if position < 0.75 else 4.0 * position - 4.0
