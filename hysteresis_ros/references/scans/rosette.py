# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Rosette: a sinusoid through the middle with a direction that turns; the path is the sum of two tones.

With N lines per frame and the phase θ = π s after s frames,

    u + i v = R cos(N θ) exp(i θ) = R/2 (exp(i (N + 1) θ) + exp(−i (N − 1) θ)).

N must be odd: the path then closes after one frame, and its N petals are evenly spaced. The tips of the petals, on the
rim, are 2 R sin(π/N) apart. Trajectories of this kind and their control: Nikooienejad, Maroufi and Moheimani 2019 (doi
10.1063/1.5098499).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hysteresis_ros.configuration import parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.references.scan import Passes, Scan, ScanShape


@dataclass(frozen=True)
class Rosette(Scan):
    """Diameters of a disc, each turned by π/N from the previous one.

    Parameters
    ----------
    diameter : float
        Diameter of the disc [m].
    lines : int
        Number N of diameters per frame, odd.
    """

    diameter: float = parameter(description="diameter of the disc", unit="m", low=1e-12, high=1.0)
    lines: int = parameter(127, description="number of diameters per frame; odd", low=3, high=99_999)

    def check(self) -> Iterable[Problem]:
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        if self.lines % 2 == 0:
            text = f"must be odd, so that the path closes after a frame; use {self.lines + 1}"
            yield Problem("lines", self.lines, text)

    @property
    def frames_per_period(self) -> int:
        """Number of frames after which the path repeats."""
        return 1

    @property
    def size(self) -> float:
        """Diameter [m]."""
        return self.diameter

    @property
    def gap(self) -> float:
        """Distance between neighbouring tips of petals [m]."""
        return self.diameter * math.sin(math.pi / self.lines)

    @property
    def frequencies(self) -> tuple[float, float]:
        """Frequencies of the two tones [Hz]."""
        return 0.5 * (self.lines + 1) * self.rate, 0.5 * (self.lines - 1) * self.rate

    @property
    def _speeds(self) -> np.ndarray:
        """Angular velocities of the two tones [rad per frame]."""
        return math.pi * np.array([self.lines + 1.0, 1.0 - self.lines])

    def plane(self, frames: np.ndarray, order: int = 0) -> np.ndarray:
        """Return u and v, or a derivative of them with respect to the number of frames, shape (2, N) [m].

        Parameters
        ----------
        frames : ndarray, shape (N,)
        order : int, optional
        """
        speeds = self._speeds
        path = 0.25 * self.diameter * ((1j * speeds) ** order @ np.exp(1j * speeds[:, None] * frames))
        return np.array([path.real, path.imag])

    def plane_range(self, matrix: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of combinations of u and v, or of their derivatives, shapes (A,).

        Parameters
        ----------
        matrix : ndarray, shape (A, 2)
        order : int
        """
        high = np.hypot(*matrix.T) * 0.25 * self.diameter * np.sum(np.abs(self._speeds) ** order)
        return -high, high

    @cached_property
    def passes(self) -> Passes:
        """The passes of a period: diameters from rim to rim."""
        line = np.arange(self.lines)
        each = np.full(self.lines, 1.0 / self.lines)
        return Passes(line / self.lines, each, line, np.ones(self.lines, dtype=np.int64))


SCAN = ScanShape("rosette", Rosette, "diameters of a disc whose direction turns")
