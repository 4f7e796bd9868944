# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Pixels of images as they come from cameras, as grey levels."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.errors import HysteresisError


class FrameError(HysteresisError):
    """An image cannot be read as a frame."""


#: Encodings of ``sensor_msgs/Image`` that are read: bytes a channel, channels, place of red, green and blue.
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

#: Most pixels of an image: those of the largest screens, 7680 x 4320, fit in.
MOST_PIXELS = 2**25

#: Parts of red, green and blue in the luminance of ITU-R BT.601.
LUMINANCE = (0.299, 0.587, 0.114)


def grey_image(data, encoding: str, shape: tuple[int, int], step: int, big_endian: bool = False) -> np.ndarray:
    """Return the grey levels of an image, 0 to 255.

    Parameters
    ----------
    data : bytes-like
        Rows one after the other.
    encoding : str
        One of :data:`ENCODINGS`.
    shape : tuple of int
        Rows and columns.
    step : int
        Bytes from one row to the next.
    big_endian : bool
        Of two bytes the more significant one comes first.

    Returns
    -------
    ndarray, shape (rows, columns)
        Of 8 bits where the image has one channel of 8 bits.

    Raises
    ------
    FrameError
        The encoding is unknown, the data are too few, or the image is too large.
    """
    rows, columns = shape
    if encoding not in ENCODINGS:
        raise FrameError(f"encoding '{encoding}' is not read; have the camera send one of {', '.join(ENCODINGS)}")
    size, channels, colours = ENCODINGS[encoding]
    if rows * columns > MOST_PIXELS:
        raise FrameError(f"{columns} x {rows} px are more than {MOST_PIXELS}: have the camera send a part of its image")
    used = columns * channels * size
    if rows < 1 or columns < 1 or step < used or len(data) < rows * step:
        text = f"{len(data)} bytes in rows of {step} are no image of {columns} x {rows} px in '{encoding}'"
        raise FrameError(f"{text}: the camera's driver is at fault")
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
