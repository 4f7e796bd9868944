# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Triangle whose peaks shrink in equal steps to zero: minor loops."""

from __future__ import annotations

import math

from hysteresis_ros.errors import Problem
from hysteresis_ros.models.block import kernel
from hysteresis_ros.references.declaration import (
    AMPLITUDE,
    COUNTER,
    END,
    FINAL,
    OFFSET,
    OWN,
    UNIPOLAR,
    WaveformShape,
    cyclic,
    triangle_shape,
    turns,
    whole_turns,
)

CYCLES = OWN + 1


@kernel
def decreasing_triangle(p, x, u):
    """Triangle with amplitude A (n − i)/n in cycle i = 0 … n − 1, then the offset."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if k >= p[END]:
        return p[FINAL]
    amplitude = p[AMPLITUDE] * ((p[CYCLES] - whole_turns(p, k)) / p[CYCLES])
    return p[OFFSET] + amplitude * triangle_shape(turns(p, k), p[UNIPOLAR])


def check(parameters):
    """Yield a Problem when the number of cycles is missing."""
    if parameters.cycles < 1:
        yield Problem("cycles", parameters.cycles, "must be ≥ 1 for decreasing_triangle: the last cycle ends at zero")


WAVEFORM = WaveformShape(
    name="decreasing_triangle",
    pack=cyclic(
        decreasing_triangle,
        own=lambda parameters, sample_time: [float(parameters.cycles)],
        final=lambda parameters, p: parameters.offset,
        polarity=True,
        repeats=False,
    ),
    takes_phase=False,
    takes_polarity=True,
    check=check,
    periodic=True,
    fundamental=lambda parameters: 8.0 / math.pi**2,
)
