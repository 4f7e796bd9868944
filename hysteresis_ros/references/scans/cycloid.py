# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Cycloid: circles whose middle drifts along u, forward in one frame and back in the next one.

The middle of the circles moves at a constant velocity. Around the beginnings of frames, its motion reverses smoothly
(:mod:`hysteresis_ros.references.pieces`); the reversal overshoots the ends. The path is the sum of one tone and this
slow drift. Trajectories of this kind: Yong, Moheimani and Petersen 2010 (doi 10.1088/0957-4484/21/36/365503).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hysteresis_ros.configuration import parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.references.pieces import LAWS, NOTHING, Builder, Pieces
from hysteresis_ros.references.scan import Passes, Scan, ScanShape


@dataclass(frozen=True)
class Cycloid(Scan):
    """Overlapping circles over a rectangle.

    Parameters
    ----------
    width : float
        Width along u [m], including the circles, without the overshoot of the reversals.
    diameter : float
        Diameter of the circles, which is also the width along v [m].
    lines : int
        Number of circles per frame.
    turn : float
        Fraction of a frame in which the drift reverses.
    turn_law : str
        Motion profile of the reversal.
    """

    width: float = parameter(description="width along u, including the circles", unit="m", low=1e-12, high=1.0)
    diameter: float = parameter(description="diameter of the circles", unit="m", low=1e-12, high=1.0)
    lines: int = parameter(128, description="circles per frame", low=2, high=100_000)
    turn: float = parameter(0.05, description="fraction of a frame in which the drift reverses", low=0.001, high=0.95)
    turn_law: str = parameter("minimum_jerk", description="motion profile of the reversal", choices=LAWS)

    def check(self) -> Iterable[Problem]:
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        if self.width <= self.diameter:
            text = f"must be more than the diameter of the circles, {self.diameter:g} m"
            yield Problem("width", self.width, text, "m")

    @property
    def frames_per_period(self) -> int:
        """Number of frames after which the path repeats."""
        return 2

    @property
    def size(self) -> float:
        """Length of the longer side [m]."""
        return self.width

    @property
    def gap(self) -> float:
        """Distance of one circle from the next [m]."""
        return (self.width - self.diameter) / ((1.0 - self.turn) * self.lines)

    @property
    def frequency(self) -> float:
        """Circles per second [Hz]."""
        return self.lines * self.rate

    @cached_property
    def _drift(self) -> Pieces:
        """The middle of the circles over two frames, starting at the end of a reversal."""
        span = self.width - self.diameter
        velocity = span / (1.0 - self.turn)
        made = Builder(-0.5 * span, self.turn_law)
        made.line(1.0 - self.turn, velocity)
        made.position = 0.5 * span
        made.turn(self.turn, velocity)
        made.line(1.0 - self.turn, -velocity)
        made.position = -0.5 * span
        made.turn(self.turn, -velocity)
        return made.done()

    def plane(self, frames: np.ndarray, order: int = 0) -> np.ndarray:
        """Return u and v, or a derivative of them with respect to the number of frames, shape (2, N) [m].

        Parameters
        ----------
        frames : ndarray, shape (N,)
        order : int, optional
        """
        speed = 2.0 * math.pi * self.lines
        circle = 0.5 * self.diameter * (1j * speed) ** order * np.exp(1j * speed * frames)
        return np.array([circle.real + self._drift(np.mod(frames - 0.5 * self.turn, 2.0), order)[0], circle.imag])

    def plane_range(self, matrix: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of combinations of u and v, or of their derivatives, shapes (A,).

        Parameters
        ----------
        matrix : ndarray, shape (A, 2)
        order : int
        """
        circle = 0.5 * self.diameter * (2.0 * math.pi * self.lines) ** order * np.hypot(*matrix.T)
        low, high = self._drift.range(matrix[:, :1], order)
        if order == 3 and self.turn_law == "parabolic":
            jumps = np.where(np.abs(matrix[:, 0]) > NOTHING, np.inf, 0.0)
            return -circle - jumps, circle + jumps
        return low - circle, high + circle

    @cached_property
    def passes(self) -> Passes:
        """The passes of a period: circles; the second frame has the lines of the first one in reverse order."""
        number = np.arange(2 * self.lines)
        ahead = number < self.lines
        line = np.where(ahead, number, 2 * self.lines - 1 - number)
        each = np.full(number.size, 1.0 / self.lines)
        return Passes(number / self.lines, each, line, np.where(ahead, 1, -1))


SCAN = ScanShape("cycloid", Cycloid, "circles whose middle drifts")
