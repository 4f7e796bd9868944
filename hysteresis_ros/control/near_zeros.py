# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Zeros so near to the unit circle that an inverse would ring, or have to know the reference for hundreds of samples.

A pair of zeros outside the circle by half a per cent, high above what is to be followed, is what the samples of two
modes look like, or of a mode above half of the sample rate. Inverted exactly, it asks for a command that swells at its
frequency long before, and a little mismatch makes a movement of it. Inside the circle, and next to -1 where holding a
mode's input puts one, it asks for a command that alternates long after each corner: right at the samples, and between
them a movement that nobody asked for. Such zeros are left out of the inverse instead,
without phase error. With g(z⁻¹) their polynomial, g(1) = 1, the reference passes through

    f = g g* p,   p ≈ 1/(g g* + ε (1 - cos ω)/(1 - cos θ)),

an inverse in the sense of least squares [1]_, θ the lowest of their angles: f cancels the zeros, and elsewhere it is
one but for ε (1 - cos ω)/(1 - cos θ)/(…), which falls with the square of the frequency. p is real and even; ε is the
smallest one with which it dies out within :data:`REACH` samples: a longer reach makes f better and the preview longer.

References
----------
.. [1] Tomizuka, Zero phase error tracking algorithm for digital control, J. Dyn. Sys. Meas. Control 109 (1987) 65-68,
   doi:10.1115/1.3143822, has p = 1: the amplitude g g*.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.linear_algebra import polynomial, product

#: Zeros outside the circle, but nearer to the origin than this, ask for more than 64 samples to come down to 1e-4, and
#: those inside it that are as near ring as long.
FARTHEST = 1.155
#: They are left out at this angle and above (a fifth of the sample rate): below, what follows a reference needs them.
LOWEST_ANGLE = 0.4 * math.pi
#: Samples to either side within which p dies out to this part.
REACH, LEFT = 10, 1e-3
#: ε that are tried.
PENALTIES = tuple(0.01 * 2.0 ** (0.25 * step) for step in range(40))
#: Points of a half turn on which p is computed, and its smallest error that is told of.
POINTS = 128
TOLD = 0.01


class Notch(NamedTuple):
    """What takes the place of an inverse of zeros near the circle. Weights ascend in time, from the past to the future.

    Parameters
    ----------
    zeros : ndarray of complex, shape (m,)
    factor : ndarray, shape (m + 1,)
        g: weights of r(k-m) … r(k).
    inverse : ndarray, shape (2 REACH + m + 1,)
        g* p: weights of r(k-REACH) … r(k+REACH+m).
    known_to : float
        Up to this part of the sample rate f differs from one by less than :data:`TOLD`.
    """

    zeros: np.ndarray
    factor: np.ndarray
    inverse: np.ndarray
    known_to: float

    @property
    def whole(self) -> np.ndarray:
        """f: weights of r(k-REACH-m) … r(k+REACH+m)."""
        return convolved(self.inverse, self.factor)

    @property
    def reach(self) -> int:
        """How far f reaches to either side [samples]."""
        return REACH + len(self.zeros)


def convolved(weights: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """Return the convolution, added up in a fixed order, shape (n + m - 1,).

    Parameters
    ----------
    weights : ndarray, shape (n,)
    taps : ndarray, shape (m,)
    """
    found = np.zeros(len(weights) + len(taps) - 1)
    for i, tap in enumerate(taps):
        found[i : i + len(weights)] += tap * weights
    return found


def near_zeros(zeros: np.ndarray, margin: float, inside: bool = True) -> np.ndarray:
    """Return the zeros to leave out; those that are smaller than one of a low angle cannot be told from it and stay.

    Parameters
    ----------
    zeros : ndarray of complex, shape (n,)
    margin : float
        Zeros nearer to the circle than this are on it.
    inside : bool
        Whether those inside it count.
    """
    sizes, low = np.abs(zeros), np.abs(np.angle(zeros)) < LOWEST_ANGLE
    inner = np.max(sizes[low & (sizes < 1.0 - margin)], initial=1.0 / FARTHEST)
    near = (sizes > (inner * (1.0 + margin) if inside else 1.0 - margin)) & (sizes < FARTHEST)
    return zeros[near] if not np.any(near & low) else zeros[:0]


def notch(zeros: np.ndarray) -> Notch:
    """Return what takes the place of an inverse of zeros near the circle.

    Parameters
    ----------
    zeros : ndarray of complex, shape (m,)
        In conjugate pairs.
    """
    falling = polynomial(zeros)
    falling = falling / math.fsum(falling)  # g: weights of r(k), r(k-1) …
    order = len(falling) - 1
    cosines = np.array([elementary.cos(math.pi * k / POINTS) for k in range(2 * POINTS)])
    turns = np.arange(POINTS + 1)
    size = np.full(POINTS + 1, math.fsum(falling * falling))
    for shift in range(1, order + 1):
        together = math.fsum(falling[shift:] * falling[:-shift])
        size += 2.0 * together * cosines[shift * turns % (2 * POINTS)]
    lowest = max(zero.real / math.sqrt(zero.real * zero.real + zero.imag * zero.imag) for zero in zeros.tolist())
    penalty = (1.0 - cosines[turns]) / (1.0 - lowest)
    ends = np.full(POINTS + 1, 1.0 / POINTS)
    ends[[0, -1]] *= 0.5
    table = cosines[np.outer(np.arange(POINTS), turns) % (2 * POINTS)] * ends
    for weight in PENALTIES:
        half = product(table, 1.0 / (size + weight * penalty))
        if 2.0 * math.fsum(np.abs(half[REACH + 1 :])) < LEFT:
            break
    half = half[: REACH + 1] / (half[0] + 2.0 * math.fsum(half[1 : REACH + 1]))
    even = np.concatenate([half[:0:-1], half])
    response = half[0] + 2.0 * product(cosines[np.outer(turns, np.arange(1, REACH + 1)) % (2 * POINTS)], half[1:])
    wrong = np.flatnonzero(np.abs(1.0 - size * response) > TOLD)
    known_to = 0.5 * (int(wrong[0]) - 1 if wrong.size else POINTS) / POINTS
    return Notch(zeros, falling[::-1].copy(), convolved(even, falling), known_to)
