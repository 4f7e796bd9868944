# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Chirp: a sine whose frequency changes over a sweep."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import kernel
from hysteresis_ros.references.declaration import (
    AMPLITUDE,
    COUNTER,
    END,
    FINAL,
    OFFSET,
    OWN,
    TWO_PI,
    Packed,
    WaveformShape,
    head,
    time_cycles,
    turns,
    turns_of,
)

CHIRP_PHASE, CHIRP_LINEAR, CHIRP_CURVE = OWN, OWN + 1, OWN + 2  # turns


@dataclass(frozen=True)
class ChirpParameters(Parameters):
    """A cycle is one sweep from ``frequency`` to ``final_frequency``."""

    final_frequency: float = parameter(description="frequency at the end of the sweep", unit="Hz", low=0.0)
    duration: float = parameter(description="time of one sweep", unit="s", low=1e-9)
    sweep: str = parameter(
        "linear", description="how the frequency changes over the sweep", choices=("linear", "logarithmic")
    )


@kernel
def chirp_linear(p, x, u):
    """Sine whose frequency changes linearly over the sweep: turns = f0 T s + (f1 − f0) T s²/2 at the position s."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    s = turns(p, k)
    angle = (p[CHIRP_LINEAR] + p[CHIRP_CURVE] * s) * s + p[CHIRP_PHASE]
    return p[OFFSET] + p[AMPLITUDE] * elementary.sin(TWO_PI * (angle - math.floor(angle)))


@kernel
def chirp_logarithmic(p, x, u):
    """Sine whose frequency changes exponentially: turns = f0 T (r^s − 1)/ln r at the position s, with r = f1/f0."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    angle = p[CHIRP_LINEAR] * elementary.expm1(p[CHIRP_CURVE] * turns(p, k)) + p[CHIRP_PHASE]
    return p[OFFSET] + p[AMPLITUDE] * elementary.sin(TWO_PI * (angle - math.floor(angle)))


def check(parameters):
    """Yield a Problem if the frequency cannot change exponentially from the first to the final one."""
    if parameters.chirp.sweep == "logarithmic":
        first, last = parameters.frequency, parameters.chirp.final_frequency
        if not (first > 0.0 and last > 0.0 and first != last):
            yield Problem(
                "chirp.final_frequency",
                last,
                f"a logarithmic sweep needs two different frequencies > 0 Hz; it begins at frequency = {first:g} Hz",
            )


def pack(parameters, sample_time: float) -> Packed:
    """Return the sweep.

    Raises
    ------
    ParameterError
        A frequency is above half the sample rate.
    """
    own, first, p = parameters.chirp, parameters.frequency, head(parameters)
    fastest = ("frequency", first)
    if own.final_frequency > first:
        fastest = ("chirp.final_frequency", own.final_frequency)
    repeat = time_cycles(p, parameters, sample_time, 1 / Fraction(own.duration), fastest)
    begin = turns_of(parameters.phase)
    if own.sweep == "linear":
        kernel, linear, curve = chirp_linear, first * own.duration, 0.5 * (own.final_frequency - first) * own.duration
        end = linear + curve
    else:
        curve = elementary.log(own.final_frequency / first)
        kernel, linear = chirp_logarithmic, first * own.duration / curve
        end = linear * elementary.expm1(curve)
    end += begin
    amplitude, offset = parameters.amplitude, parameters.offset
    p[FINAL] = offset + amplitude * elementary.sin(TWO_PI * (end - math.floor(end)))
    p = np.append(p, [begin, linear, curve])
    return Packed(p, kernel, offset - amplitude, offset + amplitude, repeat)


WAVEFORM = WaveformShape(
    name="chirp",
    pack=pack,
    parameters=ChirpParameters,
    takes_frequency=False,
    begins_at_frequency=True,
    check=check,
    example=ChirpParameters(final_frequency=100.0, duration=2.0),
)
