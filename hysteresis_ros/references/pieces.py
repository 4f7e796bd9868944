# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Motions composed of polynomials: straight lines, turns from a velocity to its opposite, and steps.

Let T be the duration of a piece, τ the time since it began, and s = τ/T. A *turn* from the velocity V to −V is

- of minimum jerk: p = V T (s − 2 s³ + s⁴). Its acceleration is 12 V/T · s (s − 1), with a magnitude of at most 3 V/T;
  its jerk is at most 12 V/T²; and it overshoots its ends by 5/16 V T;
- parabolic: p = V T (s − s²). Its acceleration has the constant magnitude 2 V/T and jumps at both ends; it overshoots
by V T/4.

A *step* by D is added to a motion at constant velocity. It is

- of minimum jerk (Flash and Hogan 1985, doi 10.1523/JNEUROSCI.05-07-01688.1985): p = D (10 s³ − 15 s⁴ + 6 s⁵), with a
  velocity up to 15/8 D/T, an acceleration up to 10/√3 D/T² and a jerk up to 60 D/T³;
- parabolic, with the acceleration 4 D/T² in the first half and −4 D/T² in the second half.
"""

from __future__ import annotations

import numpy as np

#: Motion profiles of turns and steps.
LAWS = ("minimum_jerk", "parabolic")
#: Instants that are closer than this fraction of the whole duration count as one.
TOGETHER = 1e-12
#: A term smaller than this fraction of the largest term is a rounding error, for example of the cosine of a right
#: angle.
NOTHING = 1e-14
#: Largest degree of a polynomial here.
DEGREE = 5


def shifted(coefficients: np.ndarray, delay: float) -> np.ndarray:
    """Return the coefficients of the same polynomial for a time whose zero is ``delay`` later.

    Parameters
    ----------
    coefficients : ndarray, shape (DEGREE + 1,)
        Coefficients of the ascending powers of the time.
    delay : float
        Value of the original time at which the new time is 0.
    """
    moved = np.zeros_like(coefficients)
    rest = coefficients.copy()
    factor = 1.0
    for power in range(len(coefficients)):
        moved[power] = np.polynomial.polynomial.polyval(delay, rest) / factor
        rest = np.polynomial.polynomial.polyder(rest)
        factor *= power + 1.0
    return moved


class Builder:
    """Collector of the pieces of one coordinate; each piece begins where the previous one ends.

    Parameters
    ----------
    position : float
        Position at which the motion begins.
    law : str
        Motion profile of turns and steps, one of :data:`LAWS`.
    """

    def __init__(self, position: float, law: str):
        self.position = position
        self._law = law
        self._knots, self._rows = [0.0], [np.zeros(0)]
        self._rows.clear()

    def _add(self, duration: float, *powers: float) -> None:
        self._rows.append(np.array([self.position, *powers] + [0.0] * (DEGREE - len(powers))))
        self._knots.append(self._knots[-1] + duration)

    def line(self, duration: float, velocity: float) -> None:
        """Move at a constant velocity.

        Parameters
        ----------
        duration, velocity : float
        """
        if duration > 0.0:
            self._add(duration, velocity)
            self.position += velocity * duration

    def turn(self, duration: float, velocity: float) -> None:
        """Turn from a velocity to its opposite; the turn ends at the position at which it began.

        Parameters
        ----------
        duration, velocity : float
        """
        if self._law == "parabolic":
            self._add(duration, velocity, -velocity / duration)
        else:
            self._add(duration, velocity, 0.0, -2.0 * velocity / duration**2, velocity / duration**3)

    def step(self, duration: float, size: float, velocity: float = 0.0) -> None:
        """Step by ``size``, in addition to a motion at a constant velocity.

        Parameters
        ----------
        duration, size : float
        velocity : float, optional
        """
        if self._law == "parabolic":
            half = 0.5 * duration
            rise = 0.5 * size / half**2
            self._add(half, velocity, rise)
            self.position += velocity * half + 0.5 * size
            self._add(half, velocity + 2.0 * rise * half, -rise)
            self.position += velocity * half + 0.5 * size
        else:
            cubic = size / duration**3
            self._add(duration, velocity, 0.0, 10.0 * cubic, -15.0 * cubic / duration, 6.0 * cubic / duration**2)
            self.position += velocity * duration + size

    def done(self) -> Pieces:
        """Return the motion."""
        return Pieces(np.array(self._knots), np.array(self._rows)[:, :, None])


class Pieces:
    """Polynomials one after the other, for one or several coordinates.

    Parameters
    ----------
    knots : ndarray, shape (P + 1,)
        Instants at which the pieces begin, and the instant at which the last one ends.
    coefficients : ndarray, shape (P, D, M)
        Coefficients of the ascending powers of the time since the beginning of the piece, for each of M coordinates.
    """

    def __init__(self, knots: np.ndarray, coefficients: np.ndarray):
        self.knots = knots
        self._orders = [coefficients]
        while len(self._orders) <= 3:
            last = self._orders[-1]
            self._orders.append(last[:, 1:] * np.arange(1.0, last.shape[1])[None, :, None])

    def __call__(self, time: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the motion or a derivative, shape (M, N), at instants within the knots, shape (N,)."""
        rows = self._orders[order]
        piece = np.clip(np.searchsorted(self.knots, time, "right") - 1, 0, len(rows) - 1)
        tau = time - self.knots[piece]
        value = np.zeros((rows.shape[2], time.size))
        for power in range(rows.shape[1] - 1, -1, -1):
            value = value * tau + rows[piece, power].T
        return value

    @staticmethod
    def together(motions: list[Pieces]) -> Pieces:
        """Return one motion of several coordinates from motions of the same duration, one for each coordinate.

        Parameters
        ----------
        motions : list of Pieces
            Motions of one coordinate each.
        """
        knots = np.sort(np.concatenate([motion.knots for motion in motions]))
        near = TOGETHER * (knots[-1] - knots[0])
        knots = knots[np.concatenate([[True], np.diff(knots) > near])]
        rows = np.zeros((len(knots) - 1, DEGREE + 1, len(motions)))
        for axis, motion in enumerate(motions):
            own = np.searchsorted(motion.knots, 0.5 * (knots[:-1] + knots[1:]), "right") - 1
            delays = knots[:-1] - motion.knots[own]
            rows[:, : motion._orders[0].shape[1], axis] = motion._orders[0][own, :, 0]
            for index in np.flatnonzero(np.abs(delays) > near):
                rows[index, :, axis] = shifted(rows[index, :, axis], delays[index])
        return Pieces(knots, rows)

    def range(self, matrix: np.ndarray, order: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest value of linear combinations of the coordinates, or of their derivatives.

        Parameters
        ----------
        matrix : ndarray, shape (A, M)
            Combinations.
        order : int, optional
            Order of the derivative.

        Returns
        -------
        low, high : ndarray, shape (A,)
        """
        durations = np.diff(self.knots)
        low, high = np.zeros(len(matrix)), np.zeros(len(matrix))
        for axis, row in enumerate(matrix):
            mixed = self._orders[order] @ row
            steep = self._orders[order + 1] @ row if order < 3 else mixed[:, 1:] * np.arange(1.0, mixed.shape[1])
            tau = _critical(steep, durations)
            value = np.zeros_like(tau)
            for power in range(mixed.shape[1] - 1, -1, -1):
                value = value * tau + mixed[:, power, None]
            low[axis], high[axis] = value.min(), value.max()
        return low, high


def _critical(steep: np.ndarray, durations: np.ndarray) -> np.ndarray:
    """Return the times at which polynomials may have extremes, shape (P, K): both ends, and zeros of the derivative."""
    count = len(steep)
    ends = np.stack([np.zeros(count), durations], axis=1)
    scaled = steep * durations[:, None] ** np.arange(steep.shape[1])
    scaled[np.abs(scaled) < NOTHING * np.max(np.abs(scaled), axis=1, initial=0.0, keepdims=True)] = 0.0
    high = np.flatnonzero(np.any(scaled[:, 3:] != 0.0, axis=1)) if steep.shape[1] > 3 else np.zeros(0, dtype=int)
    a, b, c = (scaled[:, power] if power < steep.shape[1] else np.zeros(count) for power in (2, 1, 0))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # the stable form of the two roots of a s² + b s + c
        middle = -0.5 * (b + np.where(b >= 0.0, 1.0, -1.0) * np.sqrt(b * b - 4.0 * a * c))
        roots = np.stack([middle / a, c / middle], axis=1)
    found = np.zeros((count, max(2, steep.shape[1] - 1)))
    found[:, :2] = np.where(np.isfinite(roots), roots, 0.0)
    if high.size:
        # the lines of a raster are equal, so the computation is done only once for each kind
        kinds, which = np.unique(scaled[high], axis=0, return_inverse=True)
        table = np.zeros((len(kinds), found.shape[1]))
        for row, kind in zip(table, kinds, strict=True):
            roots_of = np.polynomial.polynomial.polyroots(np.trim_zeros(kind, "b"))
            row[: roots_of.size] = roots_of.real
        found[high] = table[which.ravel()]
    return np.concatenate([ends, np.clip(found, 0.0, 1.0) * durations[:, None]], axis=1)
