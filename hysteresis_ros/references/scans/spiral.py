# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Spiral of Archimedes: outwards in one frame, inwards in the next, at constant angular or constant linear velocity.

A frame covers the angle Ψ. From the middle outwards, the radius is :math:`r = a\,\psi`. Around ψ = Ψ, within ``rim``
revolutions, the radius reverses by minimum jerk (:mod:`hysteresis_ros.references.pieces`, with ψ instead of the time),
and then decreases. The angle ψ always grows:

.. math::

    u + i v = r(\psi)\,e^{i\psi}, \qquad \Psi = 2\pi\,(\mathrm{turns} + 1/4).

Because of the quarter revolution, the inward spiral continues straight through the middle into the outward spiral.
Therefore the path is smooth in the middle, and repeats after two frames.

*Constant angular velocity* (cav): :math:`\psi = \Psi s` after s frames. *Constant linear velocity* (clv):
:math:`\mathrm{d}s/\mathrm{d}\psi \propto \sqrt{1 + \psi^2}`, whose integral is :math:`(\psi\sqrt{1 + \psi^2} +
\operatorname{arsinh}\psi)/2`: the arc length of the spiral. Near the middle this needs an angular velocity that grows
without limit with the number of revolutions. So within ``core`` revolutions, and in the reversal at the rim, the even
polynomial of fourth degree that continues value, slope and curvature replaces the square root. The timing then causes
no jumps of acceleration and jerk. Spirals of this kind: Mahmood and Moheimani 2009 (doi
10.1088/0957-4484/20/36/365503); with internal models and a smooth turn at the rim: Bazaei, Yong and Moheimani 2016 (doi
10.1109/TMECH.2016.2574892).
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

#: Number of points per part of a frame (core, spiral, rim) for the search of the derivatives' largest magnitudes.
LOOKS = 4000
#: Number of points in each of the three parts of the table for an initial estimate of the angle.
TABLE = 4000
#: Number of Newton steps after this estimate.
STEPS = 3


@dataclass(frozen=True)
class Spiral(Scan):
    """A spiral outwards and back inwards.

    Parameters
    ----------
    diameter : float
        Diameter of the disc in which neighbouring arms have a constant distance [m]; excludes the reversal at the rim.
    turns : int
        Number of revolutions per frame; a quarter revolution is added.
    law : str
        ``cav``: constant angular velocity, ``clv``: constant linear velocity.
    core : float
        With ``clv``: number of revolutions around the middle in which the velocity is lower.
    rim : float
        Number of revolutions in which the radius reverses at the rim.
    """

    diameter: float = parameter(description="diameter of the disc", unit="m", low=1e-12, high=1.0)
    turns: int = parameter(64, description="revolutions per frame; a quarter revolution is added", low=2, high=100_000)
    law: str = parameter("cav", description="constant angular or constant linear velocity", choices=("cav", "clv"))
    core: float = parameter(
        1.0, description="clv: revolutions around the middle at a lower velocity", low=0.05, high=1000.0
    )
    rim: float = parameter(0.5, description="revolutions in which the radius reverses at the rim", low=0.05, high=1e5)

    def check(self) -> Iterable[Problem]:
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        if self.rim > self.turns:
            yield Problem("rim", self.rim, f"must be ≤ the turns of a frame, {self.turns}")
            return
        most = self.turns + 0.25 - 0.5 * self.rim
        if self.law == "clv" and self.core >= most:
            text = f"must be less than {most:g}, because the reversal at the rim takes the other turns"
            yield Problem("core", self.core, text, "turns")

    @property
    def frames_per_period(self) -> int:
        """Number of frames after which the path repeats."""
        return 2

    @property
    def size(self) -> float:
        """Diameter [m]."""
        return self.diameter

    @property
    def gap(self) -> float:
        """Distance between two arms [m]."""
        return 2.0 * math.pi * self._slope

    @property
    def frequency(self) -> float:
        """Revolutions per second [Hz]; with ``clv``, the mean over a frame."""
        return (self.turns + 0.25) * self.rate

    @property
    def constant_share(self) -> float:
        """Fraction of a frame's time at constant linear velocity; 0 with ``cav``."""
        if self.law == "cav":
            return 0.0
        return float(self._elapsed(np.array([self._outer]))[0] - self._elapsed(np.array([self._inner]))[0])

    @property
    def _whole(self) -> float:
        """Angle of a frame, Ψ [rad]."""
        return 2.0 * math.pi * (self.turns + 0.25)

    @property
    def _inner(self) -> float:
        """Angle [rad] from the middle to the end of the core."""
        return 2.0 * math.pi * self.core

    @property
    def _outer(self) -> float:
        """Angle [rad] from the middle to the point at which the radius begins to reverse."""
        return self._whole - math.pi * self.rim

    @property
    def _slope(self) -> float:
        """Radius divided by the angle: a [m/rad]."""
        return 0.5 * self.diameter / self._outer

    def _radius(self, angle: np.ndarray) -> list[np.ndarray]:
        """Return r/a and its derivatives with respect to the angle, at angles from the middle in 0 … Ψ."""
        turn = 2.0 * math.pi * self.rim
        s = np.maximum(angle - self._outer, 0.0) / turn
        out = s == 0.0
        return [
            np.where(out, angle, self._outer + turn * (s - 2.0 * s**3 + s**4)),
            np.where(out, 1.0, 1.0 - 6.0 * s**2 + 4.0 * s**3),
            np.where(out, 0.0, 12.0 * (s**2 - s) / turn),
            np.where(out, 0.0, 12.0 * (2.0 * s - 1.0) / turn**2),
        ]

    @cached_property
    def _joined(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the even polynomials of core and rim, for powers 0, 2, 4 of the angle from each centre."""
        found = []
        for at, slope, end in ((self._inner, 1.0, self._inner), (self._outer, -1.0, self._whole - self._outer)):
            value = math.sqrt(1.0 + at * at)
            first, second = slope * at / value, 1.0 / value**3
            fourth = (second - first / end) / (8.0 * end**2)
            square = 0.5 * first / end - 2.0 * fourth * end**2
            found.append(np.array([value - square * end**2 - fourth * end**4, square, fourth]))
        return found[0], found[1]

    def _pace(self, angle: np.ndarray) -> list[np.ndarray]:
        """Return the unscaled ds/dψ and its derivatives, at angles from the middle in 0 … Ψ."""
        if self.law == "cav":
            return [np.ones_like(angle), np.zeros_like(angle), np.zeros_like(angle)]
        root = np.sqrt(1.0 + angle**2)
        found = [root, angle / root, root**-3.0]
        core, rim = self._joined
        for inside, d, (c0, c2, c4) in (
            (angle < self._inner, angle, core),
            (angle > self._outer, angle - self._whole, rim),
        ):
            even = [c0 + c2 * d**2 + c4 * d**4, 2.0 * c2 * d + 4.0 * c4 * d**3, 2.0 * c2 + 12.0 * c4 * d**2]
            found = [np.where(inside, new, old) for new, old in zip(even, found, strict=True)]
        return found

    def _passed(self, angle: np.ndarray) -> np.ndarray:
        """Return the integral of :meth:`_pace` from the middle to angles in 0 … Ψ."""
        if self.law == "cav":
            return angle

        def arc(at):
            return 0.5 * (at * np.sqrt(1.0 + at**2) + np.arcsinh(at))

        def even(coefficients, d):
            c0, c2, c4 = coefficients
            return c0 * d + c2 * d**3 / 3.0 + c4 * d**5 / 5.0

        core, rim = self._joined
        free = even(core, self._inner) + arc(np.clip(angle, self._inner, self._outer)) - arc(self._inner)
        beyond = even(rim, self._whole - self._outer) - even(rim, self._whole - np.maximum(angle, self._outer))
        return np.where(angle < self._inner, even(core, angle), free + beyond)

    @cached_property
    def _total(self) -> float:
        return float(self._passed(np.array([self._whole]))[0])

    def _elapsed(self, angle: np.ndarray) -> np.ndarray:
        """Return the fraction of a frame that has passed at given angles from the middle."""
        return self._passed(angle) / self._total

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        edges = [0.0, min(self._inner, self._outer), self._outer, self._whole]
        parts = [np.linspace(a, b, TABLE, endpoint=False) for a, b in zip(edges, edges[1:], strict=False)]
        angles = np.unique(np.concatenate([*parts, edges[-1:]]))
        return self._elapsed(angles), angles

    def _angle(self, elapsed: np.ndarray) -> np.ndarray:
        """Return the angle from the middle at which given fractions of a frame have passed."""
        if self.law == "cav":
            return elapsed * self._whole
        angle = np.interp(elapsed, *self._table)
        for _ in range(STEPS):
            angle = angle - (self._elapsed(angle) - elapsed) * self._total / self._pace(angle)[0]
            angle = np.clip(angle, 0.0, self._whole)
        return angle

    def _outward(self, angle: np.ndarray, order: int) -> np.ndarray:
        """Return a derivative (order 0 … 3) of the outward spiral with respect to the frames, divided by exp(i ψ)."""
        r, r1, r2, r3 = (self._slope * value for value in self._radius(angle))
        if order == 0:
            return r + 0j
        pace, pace1, pace2 = self._pace(angle)
        speed = self._total / pace
        first = r1 + 1j * r
        if order == 1:
            return first * speed
        speed1 = -pace1 * speed**2 / pace
        second = r2 + 2j * r1 - r
        if order == 2:
            return second * speed**2 + first * speed1
        speed2 = (3.0 * pace1**2 / pace - pace2) * speed**3 / pace
        third = r3 + 3j * r2 - 3.0 * r1 - 1j * r
        return third * speed**3 + 3.0 * second * speed * speed1 + first * speed2

    def plane(self, frames: np.ndarray, order: int = 0) -> np.ndarray:
        """Return u and v, or a derivative of them with respect to the number of frames, shape (2, N) [m].

        Parameters
        ----------
        frames : ndarray, shape (N,)
        order : int, optional
        """
        outward = frames < 1.0
        angle = self._angle(np.where(outward, frames, 2.0 - frames))
        path = self._outward(angle, order) * np.exp(1j * angle)
        # inwards, the path is the outward spiral, mirrored, reversed in time, and rotated
        back = np.exp(2j * self._whole) * np.conj(path) * (-1.0) ** order
        path = np.where(outward, path, back)
        return np.array([path.real, path.imag])

    @cached_property
    def _moduli(self) -> np.ndarray:
        """Bounds of the magnitudes of the derivatives with respect to the number of frames, shape (4,)."""
        edges = [0.0, self._outer, self._whole]
        if self.law == "clv":
            edges.insert(1, self._inner)
        found = np.zeros(4)
        for low, high in zip(edges, edges[1:], strict=False):
            inset = 1e-9 * (high - low)
            angles = np.linspace(low + inset, high - inset, LOOKS)
            for order in range(4):
                size = np.abs(self._outward(angles, order))
                # between two points, a parabola is at most an eighth of the second difference higher than the points
                rise = 0.25 * np.max(np.abs(np.diff(size, 2)))
                found[order] = max(found[order], size.max() + rise)
        return found

    def plane_range(self, matrix: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of combinations of u and v, or of their derivatives, shapes (A,), from magnitudes of vectors.

        Parameters
        ----------
        matrix : ndarray, shape (A, 2)
        order : int
        """
        high = np.hypot(*matrix.T) * self._moduli[order]
        return -high, high

    @cached_property
    def passes(self) -> Passes:
        """The passes of a period: whole revolutions around the middle; a trace outwards, and a retrace inwards."""
        ends = self._elapsed(2.0 * math.pi * np.arange(self.turns + 1.0))
        begin, duration, line = ends[:-1], np.diff(ends), np.arange(self.turns)
        return Passes(
            np.concatenate([begin, (2.0 - ends[1:])[::-1]]),
            np.concatenate([duration, duration[::-1]]),
            np.concatenate([line, line[::-1]]),
            np.repeat([1, -1], self.turns),
        )


SCAN = ScanShape("spiral", Spiral, "a spiral outwards and back inwards")
