# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sine around the offset."""

from __future__ import annotations

from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import kernel
from hysteresis_ros.references.declaration import (
    AMPLITUDE,
    COUNTER,
    END,
    FINAL,
    OFFSET,
    TWO_PI,
    WaveformShape,
    cyclic,
    turns,
)


@kernel
def sine(p, x, u):
    """Sine around the offset."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[AMPLITUDE] * elementary.sin(TWO_PI * turns(p, k))


WAVEFORM = WaveformShape(name="sine", pack=cyclic(sine), periodic=True, fundamental=lambda parameters: 1.0)
