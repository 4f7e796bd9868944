# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Images in the formats of cameras become grey levels, or are refused."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.hardware.tracker import ENCODINGS, FrameError, grey_image

LEVELS = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20


def packed(encoding: str, big_endian: bool = False, padding: int = 3):
    """Return the bytes of grey levels in an encoding, and their row length; all colours are equal."""
    size, channels, _ = ENCODINGS[encoding]
    kind = np.uint8 if size == 1 else np.dtype(">u2" if big_endian else "<u2")
    scaled = LEVELS.astype(float) * (1.0 if size == 1 else 200.0)
    pixels = np.repeat(scaled.astype(kind)[..., np.newaxis], channels, axis=2)
    rows = pixels.reshape(3, -1).view(np.uint8)
    return np.pad(rows, ((0, 0), (0, padding))).tobytes(), rows.shape[1] + padding


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("big_endian", [False, True])
def test_every_encoding_gives_the_same_grey_levels(encoding, big_endian):
    data, step = packed(encoding, big_endian)
    expected = LEVELS if ENCODINGS[encoding][0] == 1 else LEVELS * 200.0 / 257.0
    np.testing.assert_allclose(grey_image(data, encoding, (3, 4), step, big_endian), expected, rtol=1e-6)


def test_red_green_and_blue_are_weighed_in_their_places():
    pixel = bytes([10, 100, 200])
    assert grey_image(pixel, "rgb8", (1, 1), 3)[0, 0] == pytest.approx(0.299 * 10 + 0.587 * 100 + 0.114 * 200)
    assert grey_image(pixel, "bgr8", (1, 1), 3)[0, 0] == pytest.approx(0.299 * 200 + 0.587 * 100 + 0.114 * 10)


@pytest.mark.parametrize(
    ("encoding", "shape", "step", "words"),
    [
        ("yuv422", (3, 4), 8, "encoding 'yuv422' is not supported; configure the camera for one of mono8"),
        ("mono8", (3, 4), 3, "are not an image of 4 x 3 px"),
        ("mono8", (30, 4), 4, "12 bytes in rows of 4 are not an image of 4 x 30 px"),
        ("mono8", (0, 4), 4, "are not an image"),
    ],
)
def test_what_is_no_image_is_named(encoding, shape, step, words):
    with pytest.raises(FrameError, match=words):
        grey_image(bytes(12), encoding, shape, step)
