# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Hold: a constant."""

from __future__ import annotations

from hysteresis_ros.models.block import kernel
from hysteresis_ros.references.declaration import COUNTER, OFFSET, Packed, WaveformShape, head


@kernel
def hold(p, x, u):
    """Constant offset."""
    x[COUNTER] += 1.0
    return p[OFFSET]


def pack(parameters, sample_time: float) -> Packed:
    """Return the offset as a waveform."""
    return Packed(head(parameters), hold, parameters.offset, parameters.offset, 1)


WAVEFORM = WaveformShape(
    name="hold",
    pack=pack,
    takes_frequency=False,
    takes_phase=False,
    extent="offset",
    duration=lambda p: 0,
)
