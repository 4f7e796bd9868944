# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Hysteresis loops: branches of an input and the loop width between them."""

from __future__ import annotations

import numpy as np

#: Smallest reversal of the input that counts, as a fraction of its range; smaller reversals are noise or quantisation.
REVERSAL = 0.01
#: Values for the smallest reversal, tried in order until branches are found.
REVERSALS = (REVERSAL, 0.03, 0.1)
#: Least number of different input values of a branch; a jump between two levels is not a branch.
BRANCH_LEVELS = 10


def turning_points(u, reversal: float = REVERSAL) -> np.ndarray:
    """Return the indices at which ``u``, shape (N,), reverses by more than ``reversal`` of its range, and the ends."""
    u = np.asarray(u, dtype=np.float64)
    if u.size < 2 or np.ptp(u) == 0.0:
        return np.arange(min(u.size, 1))
    threshold = reversal * np.ptp(u)
    change = np.diff(u)
    moving = np.flatnonzero(change)
    turns = moving[np.flatnonzero(np.diff(np.sign(change[moving]))) + 1] if moving.size > 1 else moving[:0]
    places = [0, *turns.tolist(), u.size - 1]
    values = u[places].tolist()  # Python compares its own numbers ten times as fast as numbers of an array
    points, direction, extreme = [0], 0, 0  # extreme, low and high are indices into places
    low = high = 0
    for k, value in enumerate(values[1:], start=1):
        if direction == 0:
            low = k if value < values[low] else low
            high = k if value > values[high] else high
            if values[high] - values[low] > threshold:
                direction = 1 if high > low else -1
                extreme = max(high, low)
                if places[min(high, low)] > 0:
                    points.append(places[min(high, low)])
        elif (value - values[extreme]) * direction > 0.0:
            extreme = k
        elif (values[extreme] - value) * direction > threshold:
            points.append(places[extreme])
            direction, extreme = -direction, k
    if extreme and places[extreme] != points[-1]:
        points.append(places[extreme])
    return np.array(points)


def loop_opening(u, y) -> float | None:
    """Return the largest vertical width of the loops in ``y`` versus ``u``, in the unit of ``y``.

    Two consecutive branches (one rising, one falling) enclose a loop; the width of the loop at an input is the
    difference between the outputs of the two branches. The result is the largest width over all common inputs and all
    pairs of branches. If there are more than two branches, the first is omitted, because it starts at rest (virgin
    curve) and closes no loop. The width includes everything that separates the branches: hysteresis, creep and the lag
    of the dynamics.
    """
    u, y = np.asarray(u, dtype=np.float64), np.asarray(y, dtype=np.float64)
    finite = np.isfinite(u) & np.isfinite(y)
    u, y = u[finite], y[finite]
    # if noise exceeds the smallest reversal, the branches are too short, and a larger reversal is tried
    return next((opening for part in REVERSALS if (opening := _opening(u, y, part)) is not None), None)


def _opening(u, y, reversal: float) -> float | None:
    """Return the largest loop width; only reversals above the fraction ``reversal`` of the range of ``u`` count."""
    points = turning_points(u, reversal)
    branches = [_branch(u[a : b + 1], y[a : b + 1]) for a, b in zip(points[:-1], points[1:], strict=True)]
    if len(branches) > 2:
        branches = branches[1:]
    openings = []
    for (u_a, y_a), (u_b, y_b) in zip(branches[:-1], branches[1:], strict=True):
        low, high = max(u_a[0], u_b[0]), min(u_a[-1], u_b[-1])
        levels = np.union1d(u_a, u_b)
        levels = levels[(levels >= low) & (levels <= high)]
        if min(u_a.size, u_b.size, levels.size) >= BRANCH_LEVELS:
            openings.append(float(np.max(np.abs(np.interp(levels, u_a, y_a) - np.interp(levels, u_b, y_b)))))
    return max(openings, default=None)


def _branch(u, y):
    """Sort a branch by its input, and average the outputs at equal inputs."""
    levels, place, counts = np.unique(u, return_inverse=True, return_counts=True)
    return levels, np.bincount(place, weights=y) / counts
