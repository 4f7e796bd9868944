# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Frames from folders of pictures and from videos, and the size of a pixel [m]; needs OpenCV (an optional extra)."""

from __future__ import annotations

import contextlib
import math
import os
import pathlib
import re
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros.hardware.tracker import MOST_PIXELS, FrameError, Tracker, find_edge, nowhere
from hysteresis_ros.recordings.dataset import Recording

#: For a scale, the RMS motion must exceed this multiple of the standard error of the residual.
CLEAR = 20.0
#: Smallest number of frames with a position and a known displacement for a scale.
LEAST_PLACES = 3
#: Minimum distance between the two edges of a target [px].
APART = 12


class Scale(NamedTuple):
    """Displacement as a linear function of the position in a frame."""

    #: [m/px], always above 0.
    metres_per_pixel: float
    #: Standard deviation of the scale [m/px].
    uncertainty: float
    #: Direction: 1, or -1 if the position decreases with increasing displacement.
    sign: int = 1
    #: Displacement at position 0, if the scale comes from a motion [m].
    offset: float = math.nan
    #: RMS residual of the line, if the scale comes from a motion [m].
    residual: float = math.nan


def scale_of_motion(pixels, displacements) -> Scale:
    """Return the scale from positions and known displacements.

    Units: ``pixels`` [px], NaN for a refused frame; ``displacements`` [m]; both of shape (N,). FrameError: there are
    too few positions, or they do not follow the displacements.
    """
    pixels, displacements = np.asarray(pixels, dtype=float), np.asarray(displacements, dtype=float)
    if pixels.shape != displacements.shape:
        text = f"{displacements.size} known displacements for {pixels.size} frames"
        raise FrameError(f"{text}: give one row for each frame")
    there = np.isfinite(pixels) & np.isfinite(displacements)
    count = int(np.count_nonzero(there))
    if count < LEAST_PLACES:
        raise FrameError(f"only {count} frames have a position and a known displacement; {LEAST_PLACES} are needed")
    x, y = pixels[there], displacements[there]
    spread = x - x.mean()
    squares = float(np.sum(spread**2))
    slope = float(np.sum(spread * (y - y.mean()))) / squares if squares else 0.0
    offset = float(y.mean() - slope * x.mean())
    residual = math.sqrt(float(np.sum((y - offset - slope * x) ** 2)) / max(count - 2, 1))
    if not abs(slope) * math.sqrt(squares / count) > CLEAR * residual / math.sqrt(count) or slope == 0.0:
        text = f"positions that move by {np.ptp(x):.3g} px do not follow the known displacements"
        raise FrameError(
            f"{text} (RMS residual of a straight line {1e6 * residual:.3g} µm): check that the displacements belong to "
            "these frames, in the same order"
        )
    uncertainty = residual / math.sqrt(squares)
    return Scale(abs(slope), uncertainty, 1 if slope > 0.0 else -1, offset, residual)


def scale_of_target(grey: np.ndarray, size: float, smallest_contrast: float, largest_blur: float) -> Scale:
    """Return the scale from a frame that shows two parallel edges at a known distance ``size`` [m].

    The edges cross the rows of ``grey``, grey levels of 0 to 255. ``smallest_contrast`` and ``largest_blur`` are as in
    :func:`hysteresis_ros.hardware.tracker.find_edge`. FrameError: the frame does not show two edges.
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
        raise FrameError(f"no target: only one edge was found, in column {strongest.pixels:.1f}; two are needed")
    column, other = max(others, key=lambda item: item[1].contrast)
    apart = abs(column - strongest.pixels) * math.cos(math.atan(0.5 * (strongest.slope + other.slope)))
    scale = size / apart
    uncertainty = scale * math.hypot(strongest.uncertainty, other.uncertainty) / apart
    return Scale(scale, uncertainty)


#: Suffixes of pictures.
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm")
#: The numbers in the names are frame numbers if their span is below this multiple of the number of pictures.
GAPS = 10

_NUMBER = re.compile(r"(\d+)\D*$")


def opencv() -> Any:
    """Return OpenCV.

    Raises
    ------
    FrameError
        OpenCV is not installed.
    """
    # OpenCV's own limit is a gigapixel; OpenCV reads this variable only once, at its import
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
    try:
        import cv2
    except ImportError:
        text = (
            'pictures and videos are read by OpenCV, which is not installed: pip install "hysteresis_ros[camera]", or '
        )
        raise FrameError(f"{text}python3-opencv with apt") from None
    return cv2


class Footage:
    """Frames of a folder of pictures or of a video.

    Parameters
    ----------
    source : path-like
        Folder of pictures, or video. The order is that of the numbers in the names; a missing number is a lost frame.
        Unless all names have different numbers, the order is alphabetical.
    rate : float, optional
        Frame rate [Hz]; by default the frame rate of the video.

    Attributes
    ----------
    rate : float
        [Hz]
    count : int
        Number of frames, including lost ones.

    Raises
    ------
    FrameError
        OpenCV is missing, there are no frames, or the frame rate is unknown.
    """

    def __init__(self, source, rate: float | None = None):
        self._source, self._cv2 = pathlib.Path(source), opencv()
        if not self._source.exists():
            raise FrameError(f"{self._source}: no such file or folder; give a video or a folder of pictures")
        if self._source.is_dir():
            self._pictures = numbered(path for path in self._source.iterdir() if path.suffix.lower() in PICTURES)
            self.count = self._pictures[-1][0] + 1 if self._pictures else 0
            said = 0.0
        else:
            video = self._cv2.VideoCapture(str(self._source))
            self.count = max(int(video.get(self._cv2.CAP_PROP_FRAME_COUNT)), 0) if video.isOpened() else 0
            said = float(video.get(self._cv2.CAP_PROP_FPS)) if video.isOpened() else 0.0
            video.release()
        if not self.count:
            raise FrameError(f"{self._source}: contains no frames; give a video, or a folder of {', '.join(PICTURES)}")
        self.rate = rate or said
        if not 0.0 < self.rate < math.inf:
            raise FrameError(f"{self._source}: has no frame rate: give --rate HZ")

    def __iter__(self) -> Iterator[np.ndarray | None]:
        """Yield the grey levels of each frame, 0 to 255; None for a lost or unreadable frame."""
        return self._each_picture() if self._source.is_dir() else self._each_of_video()

    def _each_picture(self) -> Iterator[np.ndarray | None]:
        kind = self._cv2.IMREAD_GRAYSCALE | self._cv2.IMREAD_ANYDEPTH
        by_number = dict(self._pictures)
        for number in range(self.count):
            path = by_number.get(number)
            grey = None
            with contextlib.suppress(self._cv2.error):  # OpenCV raises this for an invalid header
                grey = None if path is None else self._cv2.imread(str(path), kind)
            yield grey if grey is None or grey.dtype == np.uint8 else grey * np.float32(255.0 / 65535.0)

    def _each_of_video(self) -> Iterator[np.ndarray | None]:
        video = self._cv2.VideoCapture(str(self._source))
        try:
            for _ in range(self.count):
                there, frame = video.read()
                yield self._cv2.cvtColor(frame, self._cv2.COLOR_BGR2GRAY) if there else None
        finally:
            video.release()


def numbered(paths) -> list[tuple[int, pathlib.Path]]:
    """Return pictures with their frame numbers, counted from 0.

    Parameters
    ----------
    paths : iterable of pathlib.Path
    """
    paths = list(paths)
    found = [_NUMBER.search(path.stem) for path in paths]
    numbers = [int(match[1]) for match in found if match]
    if len(numbers) < len(paths) or len(set(numbers)) < len(numbers):
        return list(enumerate(sorted(paths)))
    ordered = sorted(zip(numbers, paths, strict=True))
    first, last = ordered[0][0] if ordered else 0, ordered[-1][0] if ordered else 0
    if last - first >= GAPS * len(ordered):
        return [(number, path) for number, (_, path) in enumerate(ordered)]
    return [(number - first, path) for number, path in ordered]


def follow(frames: Footage, tracker: Tracker, on_frame: Callable[[int], object] = lambda number: None) -> Recording:
    """Return a recording of the displacements in frames, ``measured`` [m], and of the quality of each frame.

    Parameters
    ----------
    frames : Footage
    tracker : Tracker
    on_frame : callable, optional
        Called with the number of each frame.

    Raises
    ------
    FrameError
        No frame shows the tip; the message gives the reason for the first refused frame.
    """
    rows, reasons, first = [], Counter[str](), ""
    for number, grey in enumerate(frames):
        on_frame(number)
        seen, place = (math.nan, nowhere("lost or not readable")) if grey is None else tracker.see(grey)
        rows.append((seen, place.pixels, place.uncertainty, place.contrast, place.blur))
        if place.refusal:
            reasons[place.refusal.partition(":")[0]] += 1
            first = first or place.refusal
    if not np.isfinite([row[0] for row in rows]).any():
        raise FrameError(f"the tip was not found in any of {len(rows)} frames; reason for the first frame: {first}")
    names = ("measured", "pixels", "uncertainty", "contrast", "blur")
    units = {"pixels": "px", "uncertainty": "px", "contrast": "1", "blur": "px"}
    notes = [f"{count} of {len(rows)} frames give no displacement: {reason}" for reason, count in reasons.items()]
    columns = dict(zip(names, np.array(rows).T, strict=True))
    return Recording(np.arange(len(rows)) / frames.rate, columns, units, {"notes": notes, "source": "frames"})
