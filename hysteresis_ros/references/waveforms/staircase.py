# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Staircase: a triangle held on equidistant levels."""

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
    UNIPOLAR,
    WaveformShape,
    cyclic,
    triangle_shape,
    turns,
)

LEVELS = OWN + 1  # levels per cycle


@dataclass(frozen=True)
class StaircaseParameters(Parameters):
    """Equal steps up and down again."""

    steps: int = parameter(10, description="steps from the offset to the amplitude", low=1, high=100_000)


@kernel
def staircase(p, x, u):
    """Triangle held on equidistant levels."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    level = math.floor(turns(p, k) * p[LEVELS] + EDGE * p[LEVELS])
    if level >= p[LEVELS]:
        level = 0.0
    return p[OFFSET] + p[AMPLITUDE] * triangle_shape(level / p[LEVELS], p[UNIPOLAR])


def own(parameters, sample_time: float) -> list[float]:
    """Return the number of levels per cycle."""
    return [parameters.staircase.steps * (2.0 if parameters.polarity == "unipolar" else 4.0)]


WAVEFORM = WaveformShape(
    name="staircase",
    jumps=True,
    pack=cyclic(staircase, own=own, polarity=True),
    parameters=StaircaseParameters,
    takes_polarity=True,
    periodic=True,
    fundamental=lambda parameters: 8.0 / math.pi**2,
)
