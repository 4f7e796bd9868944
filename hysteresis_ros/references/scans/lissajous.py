# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Lissajous: one sinusoid for each axis, with slightly different frequencies.

With N lines per frame and the phase θ = π s after s frames,

    u = width/2 cos(N θ),   v = depth/2 cos((N − 1) θ).

The frequencies are N/2 and (N − 1)/2 times the frame rate: in one frame, the path goes from one corner to another; in
the next frame, it goes back along the same line. Neighbouring lines are farthest apart in the middle, where they are
parallel. In the middle they have the slope ((N − 1) depth) / (N width) and are offset in v by 2π/N · depth/2, so their
distance is

    gap = π width depth / √((N width)² + ((N − 1) depth)²),

which is the diameter of the largest circle that the path leaves empty. For large N, this distance is π width depth / (N
√(width² + depth²)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hysteresis_ros.configuration import parameter
from hysteresis_ros.references.scan import Passes, Scan, ScanShape


@dataclass(frozen=True)
class Lissajous(Scan):
    """Two sinusoids over a rectangle.

    Parameters
    ----------
    width, depth : float
        Sides of the rectangle along u and v [m].
    lines : int
        Number N of half periods of u per frame.
    """

    width: float = parameter(description="side of the rectangle along u", unit="m", low=1e-12, high=1.0)
    depth: float = parameter(description="side of the rectangle along v", unit="m", low=1e-12, high=1.0)
    lines: int = parameter(128, description="half periods of u per frame", low=2, high=100_000)

    @property
    def frames_per_period(self) -> int:
        """Number of frames after which the path repeats."""
        return 2

    @property
    def size(self) -> float:
        """Length of the longer side [m]."""
        return max(self.width, self.depth)

    @property
    def frequencies(self) -> tuple[float, float]:
        """Frequencies of u and v [Hz]."""
        return 0.5 * self.lines * self.rate, 0.5 * (self.lines - 1) * self.rate

    @property
    def gap(self) -> float:
        """Largest distance between neighbouring lines [m]."""
        across = math.hypot(self.lines * self.width, (self.lines - 1) * self.depth)
        return math.pi * self.width * self.depth / across

    @property
    def _tones(self) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes [m] and angular frequencies [rad per frame]."""
        amplitudes = 0.5 * np.array([self.width, self.depth])
        return amplitudes, math.pi * np.array([self.lines, self.lines - 1.0])

    def plane(self, frames: np.ndarray, order: int = 0) -> np.ndarray:
        """Return u and v, or a derivative of them with respect to the number of frames, shape (2, N) [m].

        Parameters
        ----------
        frames : ndarray, shape (N,)
        order : int, optional
        """
        amplitudes, speeds = self._tones
        angles = speeds[:, None] * frames
        shape = (np.cos, lambda a: -np.sin(a), lambda a: -np.cos(a), np.sin)[order](angles)
        return (amplitudes * speeds**order)[:, None] * shape

    def plane_range(self, matrix: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of combinations of u and v, or of their derivatives, shapes (A,); exact for u or v alone.

        Parameters
        ----------
        matrix : ndarray, shape (A, 2)
        order : int
        """
        amplitudes, speeds = self._tones
        high = np.abs(matrix) @ (amplitudes * speeds**order)
        return -high, high

    @cached_property
    def passes(self) -> Passes:
        """The passes of a period: half periods of u; the second frame has the lines of the first in reverse."""
        number = np.arange(2 * self.lines)
        line = np.where(number < self.lines, number, 2 * self.lines - 1 - number)
        return Passes(number / self.lines, np.full(number.size, 1.0 / self.lines), line, np.where(number % 2, 1, -1))


SCAN = ScanShape("lissajous", Lissajous, "a sinusoid for each axis")
