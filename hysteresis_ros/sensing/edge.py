# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The place of a straight edge in a frame, to a hundredth of a pixel: rows of partial areas and a line through them.

Of each row that crosses the edge, the sum of its normalised grey levels says how many pixels lie on one side of it,
whatever the blur, as long as it is symmetric. A line through all rows, without outliers, gives place, tilt and how
certain the place is. How blurred the edge is follows from all pixels over their distance from that line, as in the
slanted-edge method of ISO 12233.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

#: Rows that are taken together to look for the edge, and the distance of two columns that are compared there.
BLOCK, LAG = 16, 4
#: How far a block may be from the line through all of them [px].
STRAY = 6.0
#: Columns at each end of a window whose mean is the grey level of that side.
PLATEAU = 4
#: Least part of the rows that has to show the edge.
LEAST_ROWS = 0.5
#: Rows further from the line than so many standard deviations are outliers; how often that is looked at.
OUTLIER, LOOKS = 4.0, 3
#: Bins a pixel of the profile across the edge.
BINS = 4
#: Between 16 % and 84 % of a step blurred by a Gaussian lie two standard deviations.
LOW_PART, HIGH_PART = 0.158655, 0.841345


class Place(NamedTuple):
    """Where something is in a frame, or why it is nowhere."""

    #: Column, from the centre of the first one of the frame [px]; NaN with a reason.
    pixels: float
    #: Standard deviation of that from this frame alone [px].
    uncertainty: float
    #: Grey levels between both sides of the edge, of 255; of a pattern its correlation with the first frame, of 1.
    contrast: float
    #: Standard deviation of the blur [px]; NaN where it is not known.
    blur: float
    #: Why there is no place; empty: there is one.
    refusal: str = ""
    #: Of an edge: columns that it moves on from one row to the next.
    slope: float = math.nan


def nowhere(refusal: str, contrast: float = math.nan, blur: float = math.nan) -> Place:
    """Return that a frame shows no place.

    Parameters
    ----------
    refusal : str
        Why.
    contrast, blur : float
        What was found.
    """
    return Place(math.nan, math.nan, contrast, blur, refusal)


def find_edge(grey: np.ndarray, smallest_contrast: float, largest_blur: float) -> Place:
    """Return the place of the strongest edge across the rows of a frame, at the middle of its rows.

    Parameters
    ----------
    grey : ndarray, shape (rows, columns)
        Grey levels, 0 to 255.
    smallest_contrast : float
        Grey levels between both sides of the edge.
    largest_blur : float
        Standard deviation of the blur [px].
    """
    half = math.ceil(3.0 * largest_blur) + PLATEAU
    if grey.shape[1] < 2 * half + 2 or grey.shape[0] < 2 * BLOCK:
        return nowhere(f"{grey.shape[1]} x {grey.shape[0]} px are too few: {2 * half + 2} x {2 * BLOCK} are needed")
    rows, line = _coarse(grey, smallest_contrast)
    if line is None:
        return nowhere(f"no edge: less than half of the rows have {smallest_contrast:g} grey levels of contrast")
    place = _across(grey, rows, line, half, smallest_contrast)
    if isinstance(place, Place):
        return place
    if not place.blur <= largest_blur:
        text = f"blurred: a standard deviation of {place.blur:.3g} px, largest_blur is {largest_blur:g}"
        return nowhere(text, place.contrast, place.blur)
    # what does not belong to the edge only adds noise, and light that varies over the frame
    place = _across(grey, rows, place.line, min(math.ceil(3.5 * place.blur) + PLATEAU, half), smallest_contrast)
    if isinstance(place, Place):
        return place
    if place.rows < LEAST_ROWS * len(rows):
        text = f"only {place.rows / len(rows):.0%} of the rows show one straight edge"
        return nowhere(text, place.contrast, place.blur)
    uncertainty = place.scatter / math.sqrt(place.rows)
    return Place(place.line[0], uncertainty, place.contrast, place.blur, slope=place.line[1])


class _Found(NamedTuple):
    line: tuple[float, float]
    scatter: float
    rows: int
    contrast: float
    blur: float


def _across(grey: np.ndarray, rows: np.ndarray, line, half: int, smallest_contrast: float) -> _Found | Place:
    """Return what windows of ``2 half + 1`` columns around a line show of the edge, or why nothing."""
    first = np.rint(line[0] + line[1] * rows).astype(int) - half
    if first.min() < 0 or first.max() + 2 * half + 1 > grey.shape[1]:
        return nowhere("the edge is at the border of the frame or region")
    columns = first[:, np.newaxis] + np.arange(2 * half + 1)
    window = np.take_along_axis(grey, columns, axis=1).astype(np.float64)
    left, right = window[:, :PLATEAU].mean(axis=1), window[:, -PLATEAU:].mean(axis=1)
    step = right - left
    clear = np.abs(step) >= smallest_contrast
    contrast = float(np.median(np.abs(step)))
    if np.count_nonzero(clear) < LEAST_ROWS * len(rows):
        text = f"no edge: {np.mean(clear):.0%} of the rows have {smallest_contrast:g} grey levels of contrast"
        return nowhere(text, contrast)
    part = (right[clear, np.newaxis] - window[clear]) / step[clear, np.newaxis]
    level, slope, scatter, kept = _line(rows[clear], first[clear] - 0.5 + part.sum(axis=1))
    distance = columns[clear] - (level + slope * rows[clear])[:, np.newaxis]
    blur = _blur(distance[kept], part[kept]) if kept.any() else math.inf
    return _Found((level, slope), scatter, int(np.count_nonzero(kept)), contrast, blur)


def _coarse(grey: np.ndarray, smallest_contrast: float) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Return the rows from their middle, and the line where blocks of them change most: column there, and slope."""
    rows = np.arange(grey.shape[0]) - 0.5 * (grey.shape[0] - 1)
    blocks = grey.shape[0] // BLOCK
    means = grey[: blocks * BLOCK].reshape(blocks, BLOCK, -1).mean(axis=1, dtype=np.float32)
    change = np.abs(means[:, LAG:] - means[:, :-LAG])
    column = np.argmax(change, axis=1)
    # of a blurred edge only part of the step lies between two columns that are compared
    strong = change[np.arange(blocks), column] >= 0.25 * smallest_contrast
    if np.count_nonzero(strong) < max(LEAST_ROWS * blocks, 2):
        return rows, None
    middle = rows[: blocks * BLOCK].reshape(blocks, BLOCK).mean(axis=1)[strong]
    place = column[strong] + 0.5 * LAG
    slope = float(np.median(np.diff(place) / np.diff(middle)))
    level = float(np.median(place - slope * middle))
    near = np.abs(place - level - slope * middle) < STRAY
    if np.count_nonzero(near) < 2:
        return rows, None
    slope, level = np.polyfit(middle[near], place[near], 1)
    return rows, (float(level), float(slope))


def _line(rows: np.ndarray, places: np.ndarray) -> tuple[float, float, float, np.ndarray]:
    """Return a line through places over rows: at row 0, its slope, the scatter around it, and which rows it has."""
    kept = np.ones(len(rows), dtype=bool)
    slope = place = scatter = 0.0
    for _ in range(LOOKS):
        slope, place = np.polyfit(rows[kept], places[kept], 1)
        distance = places - place - slope * rows
        scatter = float(np.std(distance[kept]))
        robust = 1.4826 * float(np.median(np.abs(distance[kept])))
        kept = np.abs(distance) <= OUTLIER * robust + 1e-9
        if np.count_nonzero(kept) < 2:
            break
    return float(place), float(slope), scatter, kept


def _blur(distance: np.ndarray, part: np.ndarray) -> float:
    """Return the blur [px] from how much of each pixel lies on the left of the edge, over its distance from it."""
    bins = np.floor((distance - distance.min()) * BINS).astype(int).ravel()
    count = np.bincount(bins)
    mean = np.bincount(bins, weights=part.ravel()) / np.maximum(count, 1)
    centre = distance.min() + (np.arange(len(count)) + 0.5) / BINS
    mean, centre = mean[count > 0], centre[count > 0]
    falls = np.minimum.accumulate(mean)
    if falls[0] < HIGH_PART or falls[-1] > LOW_PART:
        return math.inf
    places = [float(np.interp(-level, -falls, centre)) for level in (HIGH_PART, LOW_PART)]
    return 0.5 * (places[1] - places[0])
