# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Multisine: many simultaneous frequencies of equal amplitude."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.linear_algebra import rounded
from hysteresis_ros.references.declaration import (
    AMPLITUDE,
    COUNTER,
    DENOMINATOR,
    END,
    FINAL,
    NUMERATOR,
    OFFSET,
    OWN,
    PHASE,
    RESIDUAL,
    TWO_PI,
    Packed,
    WaveformShape,
    first_value,
    head,
    refuse,
    time_cycles,
    turns,
    turns_of,
)

COMPONENTS = OWN  # number of components; then pairs (harmonic, phase in turns)
LONGEST_PERIOD = 10_000_000


@dataclass(frozen=True)
class MultisineParameters(Parameters):
    """Equal amplitudes on harmonics of ``frequency``; ``amplitude`` is the peak of their sum."""

    first_harmonic: int = parameter(1, description="lowest harmonic of frequency", low=1)
    last_harmonic: int = parameter(10, description="highest harmonic of frequency", low=1)
    harmonic_step: int = parameter(
        1, description="spacing of the harmonics; 2, with first_harmonic 1, excites only odd ones", low=1
    )
    phases: str = parameter("schroeder", description="choice of the phases", choices=("schroeder", "random"))
    seed: int = parameter(1, description="seed of the random phases", low=0)

    @property
    def harmonics(self) -> np.ndarray:
        """The excited harmonics, shape (M,)."""
        return np.arange(self.first_harmonic, self.last_harmonic + 1, self.harmonic_step)

    def check(self):
        """Yield a Problem if the band is empty."""
        if self.last_harmonic < self.first_harmonic:
            yield Problem("last_harmonic", self.last_harmonic, f"must be ≥ first_harmonic = {self.first_harmonic}")


@kernel
def multisine(p, x, u):
    """Sum of harmonics of equal amplitude; p[AMPLITUDE] is the amplitude of one harmonic."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    position = turns(p, k)
    total = 0.0
    for i in range(int(p[COMPONENTS])):
        angle = p[COMPONENTS + 1 + 2 * i] * position + p[COMPONENTS + 2 + 2 * i]
        total += elementary.sin(TWO_PI * (angle - math.floor(angle)))
    return p[OFFSET] + p[AMPLITUDE] * total


def _phases(own: MultisineParameters) -> np.ndarray:
    """Return the phases of the components in turns, shape (M,)."""
    count = own.harmonics.size
    if own.phases == "schroeder":
        index = np.arange(1, count + 1)
        # M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85, flat spectrum: Σ cos(… − π i(i−1)/M), here with sines
        return 0.25 - 0.5 * ((index * (index - 1)) % (2 * count)) / count
    # the raw numbers of a bit generator are the same in every NumPy (NEP 19); numbers from its distributions may differ
    return (np.random.PCG64(own.seed).random_raw(count) >> np.uint64(11)) * 2.0**-53


def pack(parameters, sample_time: float) -> Packed:
    """Return the multisine; its peak is the parameter ``amplitude``.

    Raises
    ------
    ParameterError
        The period is not a whole number of samples, or a harmonic reaches half the sample rate.
    """
    own, frequency, p = parameters.multisine, parameters.frequency, head(parameters)
    repeat = time_cycles(p, parameters, sample_time, Fraction(frequency), ("frequency", frequency))
    p[PHASE] = turns_of(parameters.phase)
    samples, harmonics = int(p[DENOMINATOR]), own.harmonics
    if p[NUMERATOR] != 1.0 or p[RESIDUAL] != 0.0 or samples > LONGEST_PERIOD:
        whole = min(max(round(1.0 / (frequency * sample_time)), 2), LONGEST_PERIOD)
        near = 1.0 / (whole * sample_time)
        remedy = f"the period of a multisine must be a whole number of samples ≤ {LONGEST_PERIOD}; nearest {near!r} Hz"
        refuse("frequency", frequency, remedy)
    if 2 * harmonics[-1] >= samples:
        remedy = f"must be ≤ {(samples - 1) // 2}, below half the sample rate"
        refuse("multisine.last_harmonic", own.last_harmonic, remedy)
    count, phases = harmonics.size, _phases(own)
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    # one period of the sum of sin(2π (h (k/N + phase) + φ_h))
    angles = (TWO_PI * (phases + harmonics * p[PHASE])).tolist()
    parts = [complex(elementary.sin(angle), -elementary.cos(angle)) for angle in angles]
    spectrum[harmonics] = 0.5 * samples * np.array(parts)
    period = np.fft.irfft(spectrum, samples)
    # smaller by 10⁻¹², so that rounding in the kernel cannot exceed the amplitude; rounded to 13 digits, because the
    # order of additions in NumPy's transform may differ between machines
    scale = float(rounded((1.0 - 1e-12) / np.max(np.abs(period))))
    lowest = parameters.offset + parameters.amplitude * scale * float(np.min(period))
    highest = parameters.offset + parameters.amplitude * scale * float(np.max(period))
    p[AMPLITUDE] = parameters.amplitude * scale
    p = np.concatenate([p, [count], np.column_stack([harmonics, phases % 1.0]).ravel()])
    p[FINAL] = first_value(multisine, p)
    return Packed(p, multisine, lowest, highest, repeat, float(np.max(np.abs(period)) / np.sqrt(0.5 * count)))


WAVEFORM = WaveformShape(name="multisine", pack=pack, parameters=MultisineParameters)
