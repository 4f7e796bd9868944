# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Displacement from images: for each frame, position and uncertainty of the tip, or the reason for a refusal.

Pixels are converted to grey levels. The position of an edge, or the motion of a pattern, is found to about a hundredth
of a pixel.

For each row that crosses the edge, the sum of the row's normalised grey levels gives the number of pixels on one side
of the edge; a symmetric blur does not change this sum. A line through all rows except outliers gives position, tilt and
uncertainty. The blur is determined from the grey levels of all pixels as a function of their distance from this line,
as in the slanted-edge method of ISO 12233.

For a pattern, the phase of the cross-spectrum, after the shift by whole pixels, is a plane; the slopes of this plane
are the remaining displacement (H. S. Stone, M. T. Orchard, E.-C. Chang, S. A. Martucci, A fast direct Fourier-based
algorithm for subpixel registration of images, IEEE Trans. Geoscience and Remote Sensing 39(10), 2001). The plane is
fitted at the lower frequencies, which noise and aliasing hardly affect, with the magnitude of the cross-spectrum as
weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import fft

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import HysteresisError, Problem
from hysteresis_ros.models.calibration import SensorCalibration, SensorCalibrationParameters


class FrameError(HysteresisError):
    """An image cannot be read as a frame."""


#: Supported encodings of ``sensor_msgs/Image``: bytes per channel, number of channels, and places of red, green and
#: blue.
ENCODINGS: dict[str, tuple[int, int, tuple[int, ...]]] = {
    "mono8": (1, 1, ()),
    "8UC1": (1, 1, ()),
    "mono16": (2, 1, ()),
    "16UC1": (2, 1, ()),
    "rgb8": (1, 3, (0, 1, 2)),
    "bgr8": (1, 3, (2, 1, 0)),
    "rgba8": (1, 4, (0, 1, 2)),
    "bgra8": (1, 4, (2, 1, 0)),
}

#: Maximum number of pixels of an image; enough for 7680 x 4320.
MOST_PIXELS = 2**25

#: Weights of red, green and blue in the luminance of ITU-R BT.601.
LUMINANCE = (0.299, 0.587, 0.114)


def grey_image(data, encoding: str, shape: tuple[int, int], step: int, big_endian: bool = False) -> np.ndarray:
    """Return the grey levels of an image, 0 to 255.

    Parameters
    ----------
    data : bytes-like
        The rows, one after the other.
    encoding : str
        One of :data:`ENCODINGS`.
    shape : tuple of int
        Rows and columns.
    step : int
        Bytes from one row to the next.
    big_endian : bool
        Whether the more significant byte comes first.

    Returns
    -------
    ndarray, shape (rows, columns)
        Of type uint8 if the image has one channel of 8 bits.

    Raises
    ------
    FrameError
        The encoding is not supported, the data are too few, or the image is too large.
    """
    rows, columns = shape
    if encoding not in ENCODINGS:
        raise FrameError(
            f"encoding '{encoding}' is not supported; configure the camera for one of {', '.join(ENCODINGS)}"
        )
    size, channels, colours = ENCODINGS[encoding]
    if rows * columns > MOST_PIXELS:
        raise FrameError(
            f"{columns} x {rows} px are more than {MOST_PIXELS} pixels: configure the camera for a part of its image"
        )
    used = columns * channels * size
    if rows < 1 or columns < 1 or step < used or len(data) < rows * step:
        text = f"{len(data)} bytes in rows of {step} are not an image of {columns} x {rows} px in '{encoding}'"
        raise FrameError(f"{text}: check the driver of the camera")
    kind = np.dtype(np.uint8 if size == 1 else (">u2" if big_endian else "<u2"))
    lines = np.frombuffer(data, dtype=np.uint8, count=rows * step).reshape(rows, step)[:, :used]
    if size == 1 and channels == 1:
        return lines
    levels = np.ascontiguousarray(lines).view(kind)
    if channels == 1:
        return levels.astype(np.float32) * np.float32(255.0 / 65535.0)
    weights = np.zeros(channels, dtype=np.float32)
    weights[list(colours)] = LUMINANCE
    return levels.reshape(rows, columns, channels).astype(np.float32) @ weights


#: Number of rows per block in the search for the edge.
BLOCK = 16
#: Distance of the two columns that are compared in the search for the edge [px].
LAG = 4
#: Largest distance of a block from the line through all blocks [px].
STRAY = 6.0
#: Number of columns at each end of a window; their mean is the grey level of that side.
PLATEAU = 4
#: Fraction of the rows that must show the edge.
LEAST_ROWS = 0.5
#: Distance from the line beyond which a row is an outlier [standard deviations].
OUTLIER = 4.0
#: Largest number of iterations of the fit of the line.
EDGE_LOOKS = 3
#: Bins per pixel of the profile across the edge.
BINS = 4
#: In a step blurred by a Gaussian, the points at 16 % and 84 % of the height are two standard deviations apart.
LOW_PART, HIGH_PART = 0.158655, 0.841345


class Place(NamedTuple):
    """Position of the edge or pattern in a frame, or the reason why it was not found."""

    #: Column, measured from the centre of the first column of the frame [px]; NaN if it was not found.
    pixels: float
    #: Standard deviation of the column, estimated from this frame alone [px].
    uncertainty: float
    #: Contrast of an edge in grey levels (at most 255), or coherence of a pattern with the first frame (at most 1).
    contrast: float
    #: Standard deviation of the blur [px]; NaN if unknown.
    blur: float
    #: Why the position was not found; empty if it was found.
    refusal: str = ""
    #: Slope of an edge: columns per row.
    slope: float = math.nan


def nowhere(refusal: str, contrast: float = math.nan, blur: float = math.nan) -> Place:
    """Return the result for a frame without a position.

    Parameters
    ----------
    refusal : str
        Reason.
    contrast, blur : float
        Measured values.
    """
    return Place(math.nan, math.nan, contrast, blur, refusal)


def find_edge(grey: np.ndarray, smallest_contrast: float, largest_blur: float) -> Place:
    """Return the position of the strongest edge across the rows of a frame, at the middle row.

    ``grey`` has levels of 0 to 255, shape (rows, columns). ``smallest_contrast`` is the smallest allowed difference of
    grey levels between the sides of the edge, ``largest_blur`` the largest allowed standard deviation of the blur [px].
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
        text = f"blurred: standard deviation {place.blur:.3g} px, but largest_blur is {largest_blur:g}"
        return nowhere(text, place.contrast, place.blur)
    # a wider window would only add noise and varying light
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
    """Return the edge in windows of ``2 half + 1`` columns around a line, or the reason for its absence."""
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
    """Return the rows, counted from the middle, and column and slope of a line through the largest grey-level steps."""
    rows = np.arange(grey.shape[0]) - 0.5 * (grey.shape[0] - 1)
    blocks = grey.shape[0] // BLOCK
    means = grey[: blocks * BLOCK].reshape(blocks, BLOCK, -1).mean(axis=1, dtype=np.float32)
    change = np.abs(means[:, LAG:] - means[:, :-LAG])
    column = np.argmax(change, axis=1)
    # only a part of a blurred step lies between the two compared columns
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
    """Return a line through the positions of all rows but outliers: value at row 0, slope, scatter, used rows."""
    kept = np.ones(len(rows), dtype=bool)
    slope = place = scatter = 0.0
    for _ in range(EDGE_LOOKS):
        slope, place = np.polyfit(rows[kept], places[kept], 1)
        distance = places - place - slope * rows
        scatter = float(np.std(distance[kept]))
        robust = 1.4826 * float(np.median(np.abs(distance[kept])))
        kept = np.abs(distance) <= OUTLIER * robust + 1e-9
        if np.count_nonzero(kept) < 2:
            break
    return float(place), float(slope), scatter, kept


def _blur(distance: np.ndarray, part: np.ndarray) -> float:
    """Return the blur [px], from the bright fraction of the pixels versus their distance from the edge."""
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


#: Frequencies are fitted if they are below this value along both directions of the picture [1/px].
HIGHEST = 0.2
#: Frequency above which the content counts as fine details [1/px].
FINE = 0.08
#: Maximum number of searches for the shift by whole pixels.
PATTERN_LOOKS = 6
#: A frame with less than this fraction of the fine details of the first frame counts as blurred.
LEAST_DETAIL = 0.3

LOST = "the pattern of the first frame is not found again"


class Pattern:
    """Finds the pattern of a first frame in later frames.

    Parameters
    ----------
    first : ndarray, shape (rows, columns)
        Grey levels, 0 to 255.
    region : tuple of int
        First column and row, width and height of the pattern in the first frame [px].
    smallest_coherence : float
        Coherence below which a frame does not show the pattern.
    """

    def __init__(self, first: np.ndarray, region: tuple[int, int, int, int], smallest_coherence: float):
        self._column, self._row, self._width, self._height = region
        self._smallest = smallest_coherence
        window = np.hanning(self._height)[:, np.newaxis] * np.hanning(self._width)
        self._window = window.astype(np.float32)
        u, v = fft.rfftfreq(self._width), fft.fftfreq(self._height)[:, np.newaxis]
        self._low = (np.abs(u) < HIGHEST) & (np.abs(v) < HIGHEST)
        shape = self._low.shape
        self._u, self._v = (np.broadcast_to(given, shape)[self._low] for given in (u, v))
        self._fine = np.hypot(self._u, self._v) > FINE
        self._shift = 0
        self._spectrum = self._spectrum_of(first, 0)

    def _spectrum_of(self, grey: np.ndarray, shift: int) -> np.ndarray:
        left = self._column + shift
        part = grey[self._row : self._row + self._height, left : left + self._width].astype(np.float32)
        return fft.rfft2((part - part.mean()) * self._window)

    @property
    def has_details(self) -> bool:
        """Whether the first frame has a pattern to track."""
        return bool(np.sum(np.abs(self._spectrum[self._low][self._fine])) > 0.0)

    def find(self, grey: np.ndarray) -> Place:
        """Return the displacement of the pattern along the rows since the first frame.

        Parameters
        ----------
        grey : ndarray, shape (rows, columns)
            Grey levels, of the same shape as the first frame.
        """
        moved = self._moved(grey, self._shift)
        if moved is None and self._shift:
            moved = self._moved(grey, 0)
        if moved is None:
            return nowhere(f"{LOST}, or has left the frame")
        self._shift, cross, spectrum = moved
        weight, phase = np.abs(cross), np.angle(cross)
        if not weight.any():
            return nowhere(f"{LOST}: the frame has no content", 0.0)
        u, v = self._u, self._v
        uu, uv, vv = np.sum(weight * u * u), np.sum(weight * u * v), np.sum(weight * v * v)
        ru, rv = -np.sum(weight * u * phase) / (2.0 * np.pi), -np.sum(weight * v * phase) / (2.0 * np.pi)
        determinant = uu * vv - uv * uv
        column, row = (ru * vv - rv * uv) / determinant, (rv * uu - ru * uv) / determinant
        rest = np.angle(cross * np.exp(2j * np.pi * (u * column + v * row)))
        first = self._spectrum[self._low]
        coherence = float(np.sum(weight * np.cos(rest)) / np.linalg.norm(first) / np.linalg.norm(spectrum))
        detail = float(np.linalg.norm(spectrum[self._fine]) / np.linalg.norm(first[self._fine]))
        if coherence < self._smallest:
            text = f"{LOST}: coherence {coherence:.2f}, smallest_coherence is {self._smallest:g}"
            return nowhere(text, coherence)
        if detail < LEAST_DETAIL:
            return nowhere(f"blurred: {detail:.0%} of the first frame's fine details are left", coherence)
        scatter = np.sum((weight * u * rest) ** 2)
        uncertainty = math.sqrt(scatter) / (2.0 * np.pi * uu)
        return Place(self._shift + float(column), uncertainty, coherence, math.nan)

    def _moved(self, grey: np.ndarray, shift: int) -> tuple[int, np.ndarray, np.ndarray] | None:
        """Return the shift in whole pixels, and cross-spectrum and spectrum at lower frequencies; None: no shift."""
        for _ in range(PATTERN_LOOKS):
            if not 0 <= self._column + shift <= grey.shape[1] - self._width:
                return None
            spectrum = self._spectrum_of(grey, shift)
            cross = np.conj(self._spectrum) * spectrum
            peak = np.argmax(fft.irfft2(np.where(self._low, cross, 0.0), self._window.shape))
            step = int(peak % self._width)
            step -= self._width if step > self._width // 2 else 0
            if step == 0:
                return shift, cross[self._low], spectrum[self._low]
            shift += step
        return None


@dataclass(frozen=True)
class TrackingParameters(Parameters):
    """Parameters of the search for the tip in a frame."""

    method: str = parameter(
        "edge",
        choices=("edge", "pattern"),
        read_only=True,
        description="edge: a straight edge across the direction of motion; pattern: the content of the first frame",
    )
    along: str = parameter(
        "x", choices=("x", "y"), read_only=True, description="motion along the rows (x) or along the columns (y)"
    )
    region: tuple[float, ...] = parameter(
        (),
        unit="px",
        low=0.0,
        high=65535.0,
        read_only=True,
        description="part of the frame that is used: first column, first row, width, height; empty: the "
        "whole frame. It contains the pattern to be tracked, and must leave room in the frame "
        "for the motion",
    )
    smallest_contrast: float = parameter(
        20.0, low=0.5, high=255.0, description="edge: smallest difference of grey levels between its sides (0 to 255)"
    )
    largest_blur: float = parameter(
        4.0, unit="px", low=0.3, high=50.0, description="edge: largest standard deviation of the blur"
    )
    smallest_coherence: float = parameter(
        0.5, low=0.01, high=1.0, read_only=True, description="pattern: least coherence with the first frame"
    )
    largest_uncertainty: float = parameter(
        0.1, unit="px", low=1.0e-6, high=10.0, description="largest standard deviation of the position"
    )
    frozen_frames: int = parameter(
        5,
        low=0,
        high=10**9,
        description="number of exact repetitions of a frame after which the camera counts as frozen; 0: not checked",
    )

    def check(self):
        """Yield a Problem for each inconsistency."""
        if self.region and (len(self.region) != 4 or not all(number == int(number) for number in self.region)):
            yield Problem("region", self.region, "give four whole numbers: first column, first row, width, height")
        elif self.region and not (self.region[2] > 0.0 and self.region[3] > 0.0):
            yield Problem("region", self.region, "width and height must be above 0")


@dataclass(frozen=True)
class CameraCalibrationParameters(SensorCalibrationParameters):
    """Calibration from pixels to displacements."""

    unit: str = parameter("px", choices=("px",), read_only=True, description="unit of a camera's readings")
    homing_samples: int = parameter(
        5,
        low=1,
        high=10**6,
        read_only=True,
        description="relative: number of frames that are averaged for the home position",
    )


@dataclass(frozen=True)
class CameraParameters(Parameters):
    """Parameters of the conversion of frames to displacements."""

    tracking: TrackingParameters = group(TrackingParameters)
    calibration: CameraCalibrationParameters = group(CameraCalibrationParameters)


def fits(grey: np.ndarray, tracking: TrackingParameters) -> bool:
    """Return whether the region fits into a frame."""
    x, y, width, height = tracking.region or (0, 0, 0, 0)
    return x + width <= grey.shape[1] and y + height <= grey.shape[0]


def turned(grey: np.ndarray, tracking: TrackingParameters) -> tuple[np.ndarray, tuple[int, int, int, int]]:
    """Return a frame and its region, both transposed if necessary so that the motion is along the rows."""
    x, y, width, height = map(int, tracking.region or (0, 0, grey.shape[1], grey.shape[0]))
    return (grey.T, (y, x, height, width)) if tracking.along == "y" else (grey, (x, y, width, height))


def looked_at(grey: np.ndarray, tracking: TrackingParameters) -> np.ndarray:
    """Return the region of a frame, transposed if necessary so that the motion is along the rows."""
    frame, (x, y, width, height) = turned(grey, tracking)
    return frame[y : y + height, x : x + width]


class Tracker:
    """Converts frames to displacements.

    Parameters
    ----------
    parameters : CameraParameters

    Attributes
    ----------
    calibration : SensorCalibration
        Conversion from pixels to metres, including the home position.
    refused : int
        Number of frames since the start that gave no displacement.
    """

    def __init__(self, parameters: CameraParameters):
        self.parameters = parameters.validated()
        self.calibration = SensorCalibration(parameters.calibration, 1.0)
        self.reset()

    def reset(self) -> None:
        """Restart with the next frame."""
        self.calibration.reset()
        self._shape: tuple[int, int] | None = None
        self._last: np.ndarray | None = None
        self._same = 0
        self._pattern: Pattern | None = None
        self.refused = 0

    def rehearse(self) -> None:
        """Compile the functions in advance, so that no frame has to wait."""
        self.calibration.step(math.nan)

    def retune(self, parameters: CameraParameters) -> None:
        """Apply new limits for the rejection of frames."""
        self.parameters = parameters.validated()

    def see(self, grey: np.ndarray) -> tuple[float, Place]:
        """Return the displacement [m] (NaN: the frame is refused), and the position in the frame.

        Parameters
        ----------
        grey : ndarray, shape (rows, columns)
            Grey levels, 0 to 255, as uint8 or float.
        """
        place = self._place(grey)
        if not place.refusal and place.uncertainty > self.parameters.tracking.largest_uncertainty:
            text = f"uncertain to {place.uncertainty:.3g} px, largest_uncertainty is "
            place = nowhere(f"{text}{self.parameters.tracking.largest_uncertainty:g}", place.contrast, place.blur)
        displacement = self.calibration.step(place.pixels)
        if math.isnan(displacement) and not place.refusal:
            refusal = self.calibration.complaint.replace("the sensor reads", "the tip is at")
            place = place._replace(refusal=refusal or "homing")
        self.refused += math.isnan(displacement)
        return displacement, place

    def _place(self, grey: np.ndarray) -> Place:
        tracking = self.parameters.tracking
        if self._shape is None:
            self._shape = grey.shape
        elif grey.shape != self._shape:
            (rows, columns), (first_rows, first_columns) = grey.shape, self._shape
            return nowhere(f"the frame has {columns} x {rows} px, but the first one had {first_columns} x {first_rows}")
        self._same = self._same + 1 if self._last is not None and np.array_equal(grey, self._last) else 0
        self._last = grey
        if 0 < tracking.frozen_frames <= self._same:
            return nowhere(f"frozen: {self._same + 1} frames in a row are identical")
        if not fits(grey, tracking):
            return nowhere(f"region = {tracking.region} does not lie within {grey.shape[1]} x {grey.shape[0]} px")
        if tracking.method == "pattern":
            return self._seen_again(*turned(grey, tracking))
        place = find_edge(looked_at(grey, tracking), tracking.smallest_contrast, tracking.largest_blur)
        return place._replace(pixels=place.pixels + turned(grey, tracking)[1][0])

    def _seen_again(self, grey: np.ndarray, region: tuple[int, int, int, int]) -> Place:
        if self._pattern is None:
            pattern = Pattern(grey, region, self.parameters.tracking.smallest_coherence)
            if not pattern.has_details:
                return nowhere("the first frame shows no pattern that can be tracked")
            self._pattern = pattern
        return self._pattern.find(grey)
