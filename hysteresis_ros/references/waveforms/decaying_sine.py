# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sine whose amplitude decays."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import kernel
from hysteresis_ros.references.declaration import (
    AMPLITUDE,
    COUNTER,
    END,
    FINAL,
    OFFSET,
    OWN,
    PHASE,
    TWO_PI,
    WaveformShape,
    cyclic,
    turns,
)

DECAY = OWN  # 1/samples


@dataclass(frozen=True)
class DecayingSineParameters(Parameters):
    """Amplitude falls as exp(−t/decay_time)."""

    decay_time: float = parameter(description="time constant of the amplitude", unit="s", low=1e-9)


@kernel
def decaying_sine(p, x, u):
    """Sine around the offset whose amplitude decays as exp(−t/decay_time)."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[AMPLITUDE] * elementary.exp(-k * p[DECAY]) * elementary.sin(TWO_PI * turns(p, k))


def final(parameters, p) -> float:
    """Return the value at the end of the last cycle [m]."""
    decay = elementary.exp(-parameters.cycles / (parameters.frequency * parameters.decaying_sine.decay_time))
    return parameters.offset + parameters.amplitude * decay * elementary.sin(TWO_PI * p[PHASE])


WAVEFORM = WaveformShape(
    name="decaying_sine",
    pack=cyclic(
        decaying_sine,
        own=lambda parameters, sample_time: [sample_time / parameters.decaying_sine.decay_time],
        final=final,
        repeats=False,
    ),
    parameters=DecayingSineParameters,
    periodic=True,
    fundamental=lambda parameters: 1.0,
    example=DecayingSineParameters(decay_time=10.0),
)
