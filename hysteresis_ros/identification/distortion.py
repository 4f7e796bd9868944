# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Nonlinear distortion of a periodic response, apart from noise: odd and even, from lines that were not excited.

All levels are in the unit of the response, as large as an error of it would be that did the same to the output. What a
linear response to the input's own content at those lines explains, as in a closed loop, is taken off before.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, chapter 4 (odd multisines
   with detection lines).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Lines of detection over which a level is averaged.
NEAREST = 8
#: Highest harmonic of a sine that counts: each further one brings more noise than distortion.
HARMONICS = 9


@dataclass(frozen=True, eq=False)
class Distortion:
    """Levels at the excited lines, of one realisation averaged over its periods; RMS, each shape (F,).

    Parameters
    ----------
    noise : ndarray
    odd, even : ndarray
        With the noise taken off; 0 where nothing is left.
    """

    noise: np.ndarray
    odd: np.ndarray
    even: np.ndarray


def detected(U, Y, harmonics, response) -> Distortion:
    """Return the levels of a multisine with odd lines, some of which were left out; NaN where there are none.

    With even lines among the excited ones neither odd nor even distortion has lines of its own.

    Parameters
    ----------
    U, Y : ndarray of complex, shape (R, P, n)
        Spectra of the periods, of all lines from zero frequency on.
    harmonics : ndarray of int, shape (F,)
        The excited lines.
    response : ndarray of complex, shape (F,)
    """
    lines = np.arange(U.shape[2])
    left = np.setdiff1d(lines[harmonics[0] : harmonics[-1] + 1], harmonics)
    G = np.interp(lines, harmonics, response.real) + 1j * np.interp(lines, harmonics, response.imag)
    size = np.mean(np.abs(U[..., harmonics].mean(axis=1)) ** 2, axis=0)
    power, noise = _scatter(Y - G * U)
    per_input = 1.0 / np.interp(lines, harmonics, size)
    power, noise = power * per_input, noise * per_input
    levels = {}
    for name, parity in (("odd", 1), ("even", 0)):
        seen = left[left % 2 == parity] if np.all(harmonics % 2 == 1) else left[:0]
        clear = power[seen] - noise[seen] if seen.size else np.zeros(0)
        levels[name] = _near(harmonics, seen, clear)
    return Distortion(np.sqrt(noise[harmonics]), **levels)


def harmonic_levels(U, Y, cycles: int, response: complex) -> tuple[float, float, float]:
    """Return the levels (noise, odd, even) of a sine, from its harmonics.

    Parameters
    ----------
    U, Y : ndarray of complex, shape (P, n)
        Spectra of the blocks, of all lines from zero frequency on.
    cycles : int
        Line of the sine.
    response : complex
        At that line.
    """
    size = abs(U[:, cycles].mean()) ** 2
    places = cycles * np.arange(1, min((U.shape[1] - 1) // cycles, HARMONICS) + 1)
    # in a closed loop the input has harmonics too; nothing but the response at the sine itself is known
    power, noise = _scatter((Y - response * U)[None, :, places])
    clear = power - noise
    odd, even = max(clear[2::2].sum(), 0.0), max(clear[1::2].sum(), 0.0)
    return float(np.sqrt(noise[0] / size)), float(np.sqrt(odd / size)), float(np.sqrt(even / size))


def _scatter(rest) -> tuple[np.ndarray, np.ndarray]:
    """Return |mean over the periods|² of each line, averaged over the realisations, and how much of it is noise."""
    periods = rest.shape[1]
    power = np.mean(np.abs(rest.mean(axis=1)) ** 2, axis=0)
    noise = np.mean(np.var(rest, axis=1, ddof=1), axis=0) / periods
    return power, noise


def _near(harmonics, seen, clear) -> np.ndarray:
    """Return the RMS of what is clear over the nearest lines of detection of each excited one."""
    if not seen.size:
        return np.full(harmonics.size, np.nan)
    count = min(NEAREST, seen.size)
    first = np.clip(np.searchsorted(seen, harmonics) - count // 2, 0, seen.size - count)
    total = np.append(0.0, np.cumsum(clear))
    return np.sqrt(np.maximum((total[first + count] - total[first]) / count, 0.0))
