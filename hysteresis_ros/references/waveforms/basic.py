# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The basic waveforms: hold, sine, triangle, square, staircase, and the decaying ones.

Each kernel computes one cycle from the position within the cycle; :func:`.cyclic` adds what all kernels share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
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
    TWO_PI,
    UNIPOLAR,
    Packed,
    WaveformShape,
    cyclic,
    first_value,
    head,
    triangle_shape,
    turns,
    whole_turns,
)

#: Parameters of single waveforms; they follow the polarity, if there is one.
DUTY = OWN + 1
LEVELS = OWN + 1  # levels per cycle
CYCLES = OWN + 1
DECAY = OWN  # 1/samples

#: Amplitude of the fundamental of a triangle, relative to half its height.
TRIANGLE_FUNDAMENTAL = 8.0 / math.pi**2


@kernel
def hold(p, x, u):
    """Constant offset."""
    x[COUNTER] += 1.0
    return p[OFFSET]


def _packed_hold(parameters, sample_time: float) -> Packed:
    return Packed(head(parameters), hold, parameters.offset, parameters.offset, 1)


HOLD = WaveformShape(
    name="hold",
    pack=_packed_hold,
    takes_frequency=False,
    takes_phase=False,
    extent="offset",
    duration=lambda p: 0,
)


@kernel
def sine(p, x, u):
    """Sine around the offset."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[AMPLITUDE] * elementary.sin(TWO_PI * turns(p, k))


SINE = WaveformShape(name="sine", pack=cyclic(sine), periodic=True, fundamental=lambda parameters: 1.0)


@kernel
def triangle(p, x, u):
    """Triangle of constant amplitude."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[AMPLITUDE] * triangle_shape(turns(p, k), p[UNIPOLAR])


TRIANGLE = WaveformShape(
    name="triangle",
    pack=cyclic(triangle, polarity=True),
    takes_polarity=True,
    periodic=True,
    fundamental=lambda parameters: TRIANGLE_FUNDAMENTAL,
)


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


def _last_level(parameters, p) -> float:
    """Return the level of a square at the end of a cycle [m]."""
    before = p.copy()
    before[PHASE] = (p[PHASE] - 1e-6) % 1.0
    return first_value(square, before)


SQUARE = WaveformShape(
    name="square",
    jumps=True,
    pack=cyclic(square, own=lambda parameters, sample_time: [parameters.square.duty], final=_last_level, polarity=True),
    parameters=SquareParameters,
    takes_polarity=True,
    periodic=True,
)


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


def _levels(parameters, sample_time: float) -> list[float]:
    """Return the number of levels per cycle of a staircase."""
    return [parameters.staircase.steps * (2.0 if parameters.polarity == "unipolar" else 4.0)]


STAIRCASE = WaveformShape(
    name="staircase",
    jumps=True,
    pack=cyclic(staircase, own=_levels, polarity=True),
    parameters=StaircaseParameters,
    takes_polarity=True,
    periodic=True,
    fundamental=lambda parameters: TRIANGLE_FUNDAMENTAL,
)


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


def _decayed(parameters, p) -> float:
    """Return the value of a decaying sine at the end of the last cycle [m]."""
    decay = elementary.exp(-parameters.cycles / (parameters.frequency * parameters.decaying_sine.decay_time))
    return parameters.offset + parameters.amplitude * decay * elementary.sin(TWO_PI * p[PHASE])


DECAYING_SINE = WaveformShape(
    name="decaying_sine",
    pack=cyclic(
        decaying_sine,
        own=lambda parameters, sample_time: [sample_time / parameters.decaying_sine.decay_time],
        final=_decayed,
        repeats=False,
    ),
    parameters=DecayingSineParameters,
    periodic=True,
    fundamental=lambda parameters: 1.0,
    example=DecayingSineParameters(decay_time=10.0),
)


@kernel
def decreasing_triangle(p, x, u):
    """Triangle for minor loops, with amplitude A (n − i)/n in cycle i = 0 … n − 1; then the offset."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if k >= p[END]:
        return p[FINAL]
    amplitude = p[AMPLITUDE] * ((p[CYCLES] - whole_turns(p, k)) / p[CYCLES])
    return p[OFFSET] + amplitude * triangle_shape(turns(p, k), p[UNIPOLAR])


def _number_of_cycles(parameters):
    """Yield a Problem if the number of cycles is missing."""
    if parameters.cycles < 1:
        yield Problem(
            "cycles", parameters.cycles, "must be ≥ 1 for decreasing_triangle, which decreases to zero over the cycles"
        )


DECREASING_TRIANGLE = WaveformShape(
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
    check=_number_of_cycles,
    periodic=True,
    fundamental=lambda parameters: TRIANGLE_FUNDAMENTAL,
)


WAVEFORM = (HOLD, SINE, TRIANGLE, SQUARE, STAIRCASE, DECAYING_SINE, DECREASING_TRIANGLE)
