# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Raster: straight lines at a constant velocity, with smooth turns between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hysteresis_ros.configuration import parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.references.pieces import LAWS, Builder, Pieces
from hysteresis_ros.references.scan import Passes, Scan, ScanShape

#: Patterns: each line forward and backward; alternate lines forward and backward; each line forward, with a smooth
#: return.
PATTERNS = ("trace_retrace", "bidirectional", "trace")


@dataclass(frozen=True)
class Raster(Scan):
    """Lines along u at a constant velocity over the whole ``width``; v moves from line to line.

    A line takes 1 / (lines + flyback) of a frame. Let T be the time of one pass over the plane. In the fraction 1 −
    ``turn`` of T, u covers the whole width at the constant velocity width / ((1 − turn) T). In the fraction ``turn`` of
    T, u turns and overshoots the width (:mod:`hysteresis_ros.references.pieces`). During the flyback, u continues in
    the same way, and v returns.

    Parameters
    ----------
    width, depth : float
        Length of the lines, and distance from the first to the last line [m].
    lines : int
        Number of lines per frame.
    pattern : str
        One of :data:`PATTERNS`.
    turn : float
        Fraction of a pass that the turn takes; with the pattern ``trace``, fraction that the return takes.
    turn_law : str
        Motion profile of turns, steps and flyback.
    slow : str
        ``stepped``: v moves only during turns; ``ramped``: v moves at a constant velocity, so that the lines are
        oblique.
    flyback : int
        Duration of the return of v, in durations of a line.
    line_rate : float
        Lines per second [Hz], if given instead of frames per second; with ``trace_retrace``, a line is a trace and its
        retrace. 0: ``frame_rate`` applies.
    """

    width: float = parameter(description="length of the lines", unit="m", low=1e-12, high=1.0)
    depth: float = parameter(description="distance between the first and the last line", unit="m", low=0.0, high=1.0)
    lines: int = parameter(128, description="lines per frame", low=2, high=100_000)
    pattern: str = parameter(
        "trace_retrace",
        description="each line forward and back; lines alternately forward and backward; or each line "
        "forward, with a smooth return",
        choices=PATTERNS,
    )
    turn: float = parameter(
        0.2,
        description="fraction of a pass that the turn takes (pattern trace: that the return takes)",
        low=0.001,
        high=0.95,
    )
    turn_law: str = parameter("minimum_jerk", description="motion profile of turns, steps and flyback", choices=LAWS)
    slow: str = parameter(
        "stepped", description="v moves only during turns, or at a constant velocity", choices=("stepped", "ramped")
    )
    flyback: int = parameter(8, description="duration of the return of v, in line durations", low=1, high=100_000)
    line_rate: float = parameter(
        0.0, description="lines per second, in place of frame_rate; 0: frame_rate", unit="Hz", low=0.0, high=1e6
    )

    def check(self) -> Iterable[Problem]:
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        if self.pattern == "bidirectional" and (self.lines + self.flyback) % 2:
            text = (
                f"lines + flyback = {self.lines + self.flyback} is odd, but the pattern bidirectional "
                "needs an even number"
            )
            yield Problem("flyback", self.flyback, f"{text}: use {self.flyback + 1}")

    @property
    def frames_per_period(self) -> int:
        """Number of frames after which the path repeats."""
        return 1

    @property
    def size(self) -> float:
        """Length of the longer side [m]."""
        return max(self.width, self.depth)

    @property
    def pitch(self) -> float:
        """Distance between two lines [m]."""
        return self.depth / (self.lines - 1 if self.slow == "stepped" else self.lines)

    @property
    def gap(self) -> float:
        """Largest distance between neighbouring lines [m]."""
        return self.pitch

    @property
    def rate(self) -> float:
        """Frames per second [Hz]."""
        return self.line_rate / (self.lines + self.flyback) if self.line_rate else self.frame_rate

    @property
    def lines_per_second(self) -> float:
        """Lines per second [Hz]; with ``trace_retrace`` a line is a trace and its retrace."""
        return self.rate * (self.lines + self.flyback)

    @property
    def line_velocity(self) -> float:
        """Velocity along the lines [m/s]."""
        return self.width / (self._pass * (1.0 - self.turn)) * self.rate

    @property
    def constant_share(self) -> float:
        """Fraction of a frame's duration in which data are taken at a constant velocity along the line."""
        return (1.0 - self.turn) * self.lines / (self.lines + self.flyback)

    @property
    def overshoot(self) -> float:
        """Overshoot of u beyond each end of the lines [m]."""
        low, high = self._fast.range(np.eye(1))
        return float(max(high[0], -low[0])) - 0.5 * self.width

    @property
    def slow_axis(self) -> bool:
        """Whether v is constant, or drifts slowly, while a line is scanned along u."""
        return True

    @property
    def _line(self) -> float:
        """Duration of a line [frames]."""
        return 1.0 / (self.lines + self.flyback)

    @property
    def _each(self) -> int:
        """Number of passes per line."""
        return 2 if self.pattern == "trace_retrace" else 1

    @property
    def _pass(self) -> float:
        """Duration of a pass with its turn [frames]."""
        return self._line / self._each

    @cached_property
    def _fast(self) -> Pieces:
        """The coordinate u over a frame."""
        constant, turning = (1.0 - self.turn) * self._pass, self.turn * self._pass
        velocity = self.width / constant
        made = Builder(-0.5 * self.width, self.turn_law)
        for number in range((self.lines + self.flyback) * self._each):
            sign = -1.0 if self.pattern != "trace" and number % 2 else 1.0
            made.position = -0.5 * sign * self.width
            made.line(constant, sign * velocity)
            made.position = 0.5 * sign * self.width
            if self.pattern == "trace":
                made.step(turning, -self.width - velocity * turning, velocity)
            else:
                made.turn(turning, sign * velocity)
        return made.done()

    @cached_property
    def _slow(self) -> Pieces:
        """The coordinate v over a frame."""
        made = Builder(-0.5 * self.depth, self.turn_law)
        back = self.flyback * self._line
        if self.slow == "ramped":
            velocity = self.pitch / self._line
            made.line(self.lines * self._line, velocity)
            made.step(back, -self.depth - velocity * back, velocity)
            return made.done()
        turning = self.turn * self._pass
        for number in range(self.lines):
            made.position = number * self.pitch - 0.5 * self.depth
            last = number == self.lines - 1
            made.line(self._line if last else self._line - turning, 0.0)
            if not last:
                made.step(turning, self.pitch)
        made.step(back, -self.depth)
        return made.done()

    @cached_property
    def _both(self) -> Pieces:
        return Pieces.together([self._fast, self._slow])

    def plane(self, frames: np.ndarray, order: int = 0) -> np.ndarray:
        """Return u and v, or a derivative of them with respect to the number of frames, shape (2, N) [m].

        Parameters
        ----------
        frames : ndarray, shape (N,)
        order : int, optional
        """
        return self._both(frames, order)

    def plane_range(self, matrix: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the extremes of combinations of u and v, or of their derivatives, shapes (A,).

        Parameters
        ----------
        matrix : ndarray, shape (A, 2)
        order : int
        """
        low, high = self._both.range(matrix, order)
        if order == 3 and self.turn_law == "parabolic":
            moves = np.any(matrix != 0.0, axis=1)
            return np.where(moves, -np.inf, low), np.where(moves, np.inf, high)
        return low, high

    @cached_property
    def passes(self) -> Passes:
        """The passes of a period."""
        number = np.arange(self.lines * self._each)
        back = (self.pattern != "trace") & (number % 2 == 1)
        return Passes(
            number * self._pass,
            np.full(number.size, (1.0 - self.turn) * self._pass),
            number // self._each,
            np.where(back, -1, 1),
        )


SCAN = ScanShape("raster", Raster, "lines at a constant velocity with smooth turns")
