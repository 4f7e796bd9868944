# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""How far a pattern has moved since a first frame, to a hundredth of a pixel: phase correlation.

After the whole pixels, the phase of the cross-spectrum is a plane whose slopes are the displacement (H. S. Stone,
M. T. Orchard, E.-C. Chang, S. A. Martucci, A fast direct Fourier-based algorithm for subpixel registration of images,
IEEE Trans. Geoscience and Remote Sensing 39(10), 2001). It is fitted where there is light, at the lower frequencies,
which noise and aliasing spare.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import fft

from hysteresis_ros.sensing.edge import Place, nowhere

#: Frequencies that are fitted, and those whose light says how sharp a frame is [1/px].
HIGHEST, FINE = 0.2, 0.08
#: Largest rest after the whole pixels [px], and how often these are looked for.
REST, LOOKS = 0.6, 6
#: Least part of the fine details of the first frame; less is a blurred frame.
LEAST_DETAIL = 0.3

LOST = "the pattern of the first frame is not found again"


class Pattern:
    """Finds the pattern of a first frame again.

    Parameters
    ----------
    first : ndarray, shape (rows, columns)
        Grey levels, 0 to 255.
    region : tuple of int
        First column and row, width and height of the pattern in it [px].
    smallest_coherence : float
        Below this a frame does not show the pattern.
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
        """Whether the first frame has anything to find again."""
        return bool(np.sum(np.abs(self._spectrum[self._low][self._fine])) > 0.0)

    def find(self, grey: np.ndarray) -> Place:
        """Return how far along its rows a frame has moved since the first one.

        Parameters
        ----------
        grey : ndarray, shape (rows, columns)
            As large as the first one.
        """
        moved = self._moved(grey, self._shift)
        if moved is None and self._shift:
            moved = self._moved(grey, 0)
        if moved is None:
            return nowhere(f"{LOST}, or has left the frame")
        self._shift, cross, spectrum = moved
        weight, phase = np.abs(cross), np.angle(cross)
        if not weight.any():
            return nowhere(f"{LOST}: the frame shows nothing", 0.0)
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
        """Return the whole pixels, and both spectra at the lower frequencies; None when they are not found."""
        for _ in range(LOOKS):
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
