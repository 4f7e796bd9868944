# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""How many metres a pixel is: from a known motion, or from a target of known size."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hysteresis_ros.sensing.edge import find_edge
from hysteresis_ros.sensing.images import FrameError

#: A motion has to be so many times as large as the uncertainty of a place, and go to so many places.
CLEAR, LEAST_PLACES = 20.0, 3
#: Columns between two edges of a target [px].
APART = 12


class Scale(NamedTuple):
    """Displacements as a line over places in frames."""

    #: [m/px], always above 0.
    metres_per_pixel: float
    #: Standard deviation of that [m/px].
    uncertainty: float
    #: Of a motion: 1, or -1 where the place falls with a growing displacement.
    sign: int = 1
    #: Of a motion: displacement at place 0 [m].
    offset: float = math.nan
    #: Of a motion: root mean square of what the line leaves [m].
    residual: float = math.nan


def scale_of_motion(pixels, displacements) -> Scale:
    """Return the scale of a known motion.

    Parameters
    ----------
    pixels : array_like, shape (N,)
        Places [px]; NaN where a frame was refused.
    displacements : array_like, shape (N,)
        [m]

    Raises
    ------
    FrameError
        There are too few places, or they hardly move.
    """
    pixels, displacements = np.asarray(pixels, dtype=float), np.asarray(displacements, dtype=float)
    if pixels.shape != displacements.shape:
        text = f"{displacements.size} known displacements for {pixels.size} frames"
        raise FrameError(f"{text}: give one row for each frame")
    there = np.isfinite(pixels) & np.isfinite(displacements)
    count = int(np.count_nonzero(there))
    if count < LEAST_PLACES:
        raise FrameError(f"{count} frames show a place whose displacement is known: {LEAST_PLACES} are needed")
    x, y = pixels[there], displacements[there]
    spread = x - x.mean()
    squares = float(np.sum(spread**2))
    slope = float(np.sum(spread * (y - y.mean()))) / squares if squares else 0.0
    offset = float(y.mean() - slope * x.mean())
    residual = math.sqrt(float(np.sum((y - offset - slope * x) ** 2)) / max(count - 2, 1))
    if not abs(slope) * math.sqrt(squares / count) > CLEAR * residual / math.sqrt(count) or slope == 0.0:
        text = f"places that move by {np.ptp(x):.3g} px do not follow the known displacements"
        raise FrameError(f"{text}, a line leaves {1e6 * residual:.3g} µm: is it their motion, in the same order?")
    uncertainty = residual / math.sqrt(squares)
    return Scale(abs(slope), uncertainty, 1 if slope > 0.0 else -1, offset, residual)


def scale_of_target(grey: np.ndarray, size: float, smallest_contrast: float, largest_blur: float) -> Scale:
    """Return the scale of a frame that shows two parallel edges of a known distance.

    Parameters
    ----------
    grey : ndarray, shape (rows, columns)
        Grey levels, 0 to 255; the edges stand across the rows.
    size : float
        Distance of the edges [m].
    smallest_contrast, largest_blur : float
        What an edge has to have, see :func:`hysteresis_ros.sensing.edge.find_edge`.

    Raises
    ------
    FrameError
        There are no two edges.
    """
    strongest = find_edge(grey, smallest_contrast, largest_blur)
    if strongest.refusal:
        raise FrameError(f"no target: {strongest.refusal}")
    place = round(strongest.pixels)
    lean = math.ceil(0.5 * abs(strongest.slope) * grey.shape[0]) + APART
    sides = [(0, grey[:, : max(place - lean, 0)]), (place + lean, grey[:, place + lean :])]
    found = [(first, find_edge(np.ascontiguousarray(part), smallest_contrast, largest_blur)) for first, part in sides]
    others = [(first + edge.pixels, edge) for first, edge in found if not edge.refusal]
    if not others:
        raise FrameError(f"no target: one edge in column {strongest.pixels:.1f}, and no other one beside it")
    column, other = max(others, key=lambda item: item[1].contrast)
    apart = abs(column - strongest.pixels) * math.cos(math.atan(0.5 * (strongest.slope + other.slope)))
    scale = size / apart
    uncertainty = scale * math.hypot(strongest.uncertainty, other.uncertainty) / apart
    return Scale(scale, uncertainty)
