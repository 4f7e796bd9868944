# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Square: an upper and a lower level."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.models.block import kernel
from hysteresis_ros.references.declaration import (
    AMPLITUDE,
    COUNTER,
    EDGE,
    END,
    FINAL,
    OFFSET,
    OWN,
    PHASE,
    UNIPOLAR,
    WaveformShape,
    cyclic,
    first_value,
    turns,
)

DUTY = OWN + 1


@dataclass(frozen=True)
class SquareParameters(Parameters):
    """Upper level first, then lower level."""

    duty: float = parameter(0.5, description="fraction of the cycle on the upper level", low=0.0, high=1.0)


@kernel
def square(p, x, u):
    """Upper level for the first fraction ``duty`` of each cycle, then the lower level."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    position = turns(p, k) + EDGE
    position -= math.floor(position)
    if position < p[DUTY]:
        return p[OFFSET] + p[AMPLITUDE]
    return p[OFFSET] if p[UNIPOLAR] > 0.0 else p[OFFSET] - p[AMPLITUDE]


def final(parameters, p) -> float:
    """Return the level at the end of a cycle [m]."""
    before = p.copy()
    before[PHASE] = (p[PHASE] - 1e-6) % 1.0
    return first_value(square, before)


WAVEFORM = WaveformShape(
    name="square",
    jumps=True,
    pack=cyclic(square, own=lambda parameters, sample_time: [parameters.square.duty], final=final, polarity=True),
    parameters=SquareParameters,
    takes_polarity=True,
    periodic=True,
)
