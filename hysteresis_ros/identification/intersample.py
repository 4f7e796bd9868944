# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""How an input runs between its samples: held, straight or band-limited.

A model with continuous dynamics is integrated with the input at more instants than were recorded. A converter holds
(``zoh``); a slowly sampled monitor signal is nearest to straight lines (``linear``); a multisine that was generated
below the Nyquist frequency, or a simulation that was decimated, is ``bandlimited``.
"""

from __future__ import annotations

import numpy as np
import scipy

from hysteresis_ros.errors import IdentificationError

METHODS = ("zoh", "linear", "bandlimited")
#: Samples beyond each end over which a band-limited input that is not periodic is mirrored.
MARGIN = 64


def upsample(u, factor: int, method: str = "bandlimited", periodic: bool = False) -> np.ndarray:
    """Return the input at ``factor`` times as many instants, shape (N factor,); every factor-th is a sample.

    Parameters
    ----------
    u : array_like, shape (N,)
        Input at uniform instants.
    factor : int
        At least 1.
    method : str
        ``zoh``, ``linear`` or ``bandlimited``.
    periodic : bool
        The input goes on with its first sample after the last one; the interpolation is then exact.

    Raises
    ------
    IdentificationError
        The method is unknown or the factor below 1.
    """
    u = np.ascontiguousarray(u, dtype=np.float64)
    if method not in METHODS or factor < 1:
        raise IdentificationError(
            f"intersample = {method!r}, factor = {factor}: must be one of {', '.join(METHODS)} and at least 1"
        )
    if factor == 1:
        return u.copy()
    if method == "zoh":
        return np.repeat(u, factor)
    if method == "linear":
        following = np.append(u[1:], u[0] if periodic else u[-1])
        return (u[:, None] + (following - u)[:, None] * (np.arange(factor) / factor)).ravel()
    if periodic:
        spectrum = np.fft.rfft(u)
        if u.size % 2 == 0:
            spectrum[-1] *= 0.5  # the Nyquist bin stands for two frequencies of the finer grid
        return np.fft.irfft(spectrum, u.size * factor) * factor
    margin = min(MARGIN, u.size - 1)
    # mirrored about the ends, so that level and slope go on
    head, tail = 2.0 * u[0] - u[margin:0:-1], 2.0 * u[-1] - u[-2 : -margin - 2 : -1]
    longer = scipy.signal.resample_poly(np.concatenate([head, u, tail]), factor, 1, window=("kaiser", 12.0))
    return longer[margin * factor : (margin + u.size) * factor]


def find_period(u, tolerance: float = 1e-6) -> int | None:
    """Return the number of samples after which the input repeats itself, None when it does not.

    At least two whole periods must be there.

    Parameters
    ----------
    u : array_like, shape (N,)
    tolerance : float
        Largest difference of two periods, as a part of the range.
    """
    u = np.asarray(u, dtype=float)
    centred = u - u.mean()
    scale = np.ptp(u)
    if scale == 0.0 or u.size < 8:
        return None
    n = u.size
    power = np.abs(np.fft.rfft(centred, 2 * n)) ** 2
    overlap = np.fft.irfft(power)[:n] / np.arange(n, 0, -1)
    candidates = np.flatnonzero(overlap[: n // 2 + 1] > 0.999 * overlap[0])
    for period in candidates[candidates > 1]:
        if np.max(np.abs(u[period:] - u[:-period])) <= tolerance * scale:
            return int(period)
    return None
