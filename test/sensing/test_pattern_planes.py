# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Patterns with slanted details: the position along the rows does not depend on a motion across them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy import fft

from hysteresis_ros.hardware.tracker import Pattern

SIZE = 128
REGION = (16, 16, 96, 96)


def slanted(slope: float) -> np.ndarray:
    """Return the spectrum of a periodic picture whose details are long along a slanted line."""
    random = np.random.default_rng(3)
    u, v = fft.fftfreq(SIZE), fft.fftfreq(SIZE)[:, np.newaxis]
    along, across = u + slope * v, v - slope * u
    weight = np.exp(-((along / 0.14) ** 2) - (across / 0.05) ** 2)
    return fft.fft2(random.standard_normal((SIZE, SIZE))) * weight


def picture(spectrum, column: float, row: float) -> np.ndarray:
    """Return the picture shifted by fractions of a pixel: exactly, by the phases of its spectral lines."""
    u, v = fft.fftfreq(SIZE), fft.fftfreq(SIZE)[:, np.newaxis]
    grey = fft.ifft2(spectrum * np.exp(-2j * np.pi * (u * column + v * row))).real
    return 128.0 + 30.0 * grey / np.std(grey)


@pytest.mark.parametrize("slope", [0.0, 0.7, -0.7])
def test_a_motion_across_the_rows_does_not_move_the_place_along_them(slope):
    spectrum = slanted(slope)
    pattern = Pattern(picture(spectrum, 0.0, 0.0), REGION, 0.5)
    for column, row in ((0.0, 0.4), (0.3, -0.4), (-0.2, 0.3), (0.45, 0.0)):
        found = pattern.find(picture(spectrum, column, row))
        assert not found.refusal and found.pixels == pytest.approx(column, abs=0.05), (column, row)
