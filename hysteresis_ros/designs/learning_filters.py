# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Filters of the learned correction for a closed loop: three designs, and the contraction of the error.

T is the closed loop from reference to measured displacement with the model, T_p that with another possible plant. From
one period to the next the error is multiplied by Q − G T. Every design chooses the highest bandwidth at which |Q − G
T_p| + ε |G|, computed with the truncated filters, is at most 1 − :data:`MARGIN` at all frequencies and on all plants; ε
is :data:`UNSEEN`. If noise and repeating error are known, the design chooses the bandwidth with the least remaining
error, which may be lower.

- *inversion*: G = Q L, where L minimises the largest |1 − L T_p| over all plants at each frequency (Lawson's iteration
  [1]_); with the model alone it is 1/T.
- *norm_optimal*: m_(j+1) minimises the mean over the plants of |e_(j+1)|² + λ |m_(j+1)|² + μ |m_(j+1) − m_j|² [2]_:
  Q = (μ + E|T|²)/(λ + μ + E|T|²), G = E[T*]/(λ + μ + E|T|²). The weight λ on the correction rises with the frequency.
- *repetitive*: G = k z^n Q with phase lead n and gain k [3]_.

References
----------
.. [1] Ellacott & Williams, Linear Chebyshev approximation in the complex plane using Lawson's algorithm, Mathematics
   of Computation 30 (133), 1976.
.. [2] Amann, Owens & Rogers, Iterative learning control using optimal feedback and feedforward actions, International
   Journal of Control 65 (2), 1996; here frequency by frequency.
.. [3] Longman, Iterative learning control and repetitive control for engineering practice, International Journal of
   Control 73 (10), 2000.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.models.linear_algebra import rounded

#: The contraction factor must be at most 1 minus this margin.
MARGIN = 0.1
#: ε: assumed uncertainty of the closed loop, relative to its DC gain.
UNSEEN = 0.15
#: Number of taps of Q on each side of the middle tap, if the period is long enough.
HALF = 64
#: Highest tried bandwidth, as a fraction of the sample rate.
HIGHEST = 0.45
#: Lowest tried bandwidth, as a fraction of the sample rate, unless half of the frequency of the period is higher.
LOWEST = 1e-3
#: Number of tried bandwidths.
STEPS = 60
#: Half of the width of the roll-off of Q, as a fraction of the bandwidth.
FALL = 0.15
#: Minimum of half of the width of the roll-off of Q, as a fraction of the sample rate, but at most the bandwidth
#: itself.
LEAST_FALL = 0.02
#: In the notches of Q, the contraction factor of the untruncated filters is this far below 1; truncation uses up part
#: of it, so it is larger than MARGIN.
DIP = 0.15
#: Number of iterations of Lawson's algorithm.
ITERATIONS = 60
#: μ of the norm-optimal design.
CHANGE = 0.2
#: Exponent with which λ of the norm-optimal design rises with the frequency.
STEEPNESS = 16
#: Tried gains of the repetitive design.
GAINS = (0.9, 0.7, 0.5, 0.3)
#: Longest tried phase lead of the repetitive design [samples].
LONGEST_LEAD = 24
#: Number of frequencies for the choice of gain and phase lead.
COARSE = 400


class Response(NamedTuple):
    """Closed loop at equidistant angles from 0 to π."""

    model: np.ndarray  #: shape (m,); T on the model.
    possible: np.ndarray  #: shape (p, m); T_p on all possible plants, including the model.
    #: shape (m,); T on the identified model. It differs from ``model`` if ``model`` comes from a measured response,
    #: because the noise of such a response does not decay in time.
    identified: np.ndarray | None = None
    #: shape (m,); Closed-loop response from the plant's input to the displacement, on the identified model.
    pushed: np.ndarray | None = None
    #: shape (m,); Closed-loop response from the sensor's noise to the measured displacement, on the identified model.
    noise: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Filters:
    """Filters and their contraction."""

    kind: str  #: Name of the design.
    error: np.ndarray  #: Taps of G, the largest lead first.
    lead: int  #: Lead of the first tap [samples].
    robustness: np.ndarray  #: Taps of Q: the middle tap, then the taps on either side (symmetric).
    bandwidth: float  #: Frequency at which Q has fallen by 3 dB, as a fraction of the sample rate.
    contraction: float  #: Largest |Q − G T_p| + ε |G| over all frequencies and possible plants.
    nominal: float  #: The same quantity for the model alone.
    worst: float  #: Frequency of the largest contraction factor, as a fraction of the sample rate.
    #: Highest bandwidth with contraction, as a fraction of the sample rate, if ``bandwidth`` is lower because this
    #: leaves less error; else 0.
    highest: float = 0.0

    def responses(self, angles) -> tuple[np.ndarray, np.ndarray]:
        """Return Q and G at the given angles, shape (m,) each."""
        return filter_responses(self.error, self.lead, self.robustness, np.asarray(angles))


def filter_responses(error, lead: int, robustness, angles) -> tuple[np.ndarray, np.ndarray]:
    """Return Q and G at the given angles.

    Units: ``lead`` [samples].
    """
    sides = np.cos(np.outer(angles, np.arange(1, len(robustness))))
    low_pass = robustness[0] + 2.0 * sides @ np.asarray(robustness[1:], dtype=float)
    ahead = np.exp(1j * np.outer(angles, lead - np.arange(len(error))))
    return low_pass, ahead @ np.asarray(error, dtype=float)


def contraction(low_pass, learning, possible, gain: float = 1.0) -> np.ndarray:
    """Return |1 − γ + γ (Q − G T_p)| + γ ε |G| at each frequency, the largest over all plants, shape (m,)."""
    sizes = np.max(np.abs(1.0 - gain + gain * (low_pass - learning * possible)), axis=0)
    return sizes + gain * UNSEEN * np.abs(learning)


def design_filters(
    kind: str,
    response: Response,
    period: int,
    bandwidth: float | None = None,
    sample_rate: float = 1.0,
    error: Callable[[Filters], float] | None = None,
) -> Filters:
    """Return filters with contraction: for the requested bandwidth, the highest bandwidth, or the least ``error``.

    Units: ``period`` [samples], ``sample_rate`` [Hz].
    """
    wanted = np.geomspace(HIGHEST, max(LOWEST, 0.5 / period), STEPS) if bandwidth is None else np.array([bandwidth])
    design = KINDS[kind](response, period)
    for number, cutoff in enumerate(wanted):
        found = design(float(cutoff))
        if found.contraction <= 1.0 - MARGIN:
            return found if error is None else _least(found, design, wanted[number + 1 :], error)
    asked = "no bandwidth" if bandwidth is None else f"a bandwidth of {bandwidth * sample_rate:.4g} Hz does not"
    raise ConfigurationError(
        f"learning by {kind}: {asked} {'contracts' if bandwidth is None else 'contract'} on all possible "
        f"plants: |Q - G T| + {UNSEEN:g} |G| reaches {found.contraction:.3g} at {found.worst * sample_rate:.4g} Hz, "
        f"but at most {1.0 - MARGIN:g} is allowed; request a lower --bandwidth, narrow the ranges (--resonance-range, "
        "--gain-range), or use a controller that damps the resonance"
    )


def _least(highest: Filters, design: Callable[[float], Filters], lower, error: Callable[[Filters], float]) -> Filters:
    """Return the filters with contraction and the least error; search downwards until the error has doubled."""
    best, least = highest, error(highest)
    for cutoff in lower:
        found = design(float(cutoff))
        left = error(found)
        if left < least and found.contraction <= 1.0 - MARGIN:
            best, least = found, left
        elif left > 2.0 * least:
            break
    return best if best is highest else replace(best, highest=highest.bandwidth)


def _judged(kind: str, response: Response, taps, lead: int, robustness) -> Filters:
    angles = np.linspace(0.0, np.pi, len(response.model))
    low_pass, learning = filter_responses(taps, lead, robustness, angles)
    sizes = contraction(low_pass, learning, response.possible)
    place = int(np.argmax(sizes))
    nominal = contraction(low_pass, learning, response.model[np.newaxis])
    fallen = np.flatnonzero(np.abs(low_pass) < np.sqrt(0.5))
    bandwidth = 0.5 * fallen[0] / (len(angles) - 1) if len(fallen) else 0.5
    worst = 0.5 * place / (len(angles) - 1)
    return Filters(kind, taps, lead, robustness, bandwidth, float(sizes[place]), float(np.max(nominal)), worst)


def low_pass(cutoff: float, points: int) -> np.ndarray:
    """Return a zero-phase response that falls from 1 to 0 around the frequency ``cutoff``, shape (points,)."""
    places = np.linspace(0.0, 0.5, points)
    width = max(FALL * cutoff, min(LEAST_FALL, cutoff))
    return 0.5 + 0.5 * np.cos(np.pi * np.clip((places - cutoff + width) / (2.0 * width), 0.0, 1.0))


def symmetric_taps(response, half: int) -> np.ndarray:
    """Return the taps of a real response, scaled to a DC gain of 1: the middle tap, then those on either side."""
    taps = np.fft.irfft(response)[: half + 1]
    return rounded(taps / (taps[0] + 2.0 * np.sum(taps[1:])))


def taps_of(response, half: int) -> tuple[np.ndarray, int]:
    """Return the 2 ``half`` + 1 consecutive taps with most energy of a response, and the lead of the first one.

    Units: ``half`` [samples].
    """
    count, furthest = 2 * half + 1, half
    whole = np.fft.irfft(response)
    energy = np.cumsum(np.concatenate([[0.0], np.roll(whole, furthest)[: furthest + count] ** 2]))
    held = energy[count:] - energy[: len(energy) - count]
    lead = furthest - int(np.argmax(held))
    return rounded(np.roll(whole, lead)[:count]), lead


def _inversion(response: Response, period: int):
    possible = response.possible
    weights = np.ones(possible.shape)
    for _ in range(ITERATIONS):
        inverse = np.sum(weights * possible.conj(), axis=0) / np.sum(weights * np.abs(possible) ** 2, axis=0)
        weights = weights * np.abs(1.0 - inverse * possible)
        largest = np.max(weights, axis=0)
        # if the inverse is exact for all plants, all weights become 0; any weights are then correct
        weights = np.where(largest > 1e-300, weights / np.maximum(largest, 1e-300), 1.0)

    # where the plants differ much, Q gets a notch that is just deep enough for contraction
    allowed = np.minimum(1.0, (1.0 - DIP) / contraction(1.0, inverse, possible))

    half = min(HALF, period - 1)

    def design(cutoff: float) -> Filters:
        wanted = low_pass(cutoff, len(response.model)) * allowed
        robustness = symmetric_taps(wanted, half)
        return _judged("inversion", response, *taps_of(wanted * inverse, half), robustness)

    return design


def _norm_optimal(response: Response, period: int):
    mean = np.mean(response.possible, axis=0)
    square = np.mean(np.abs(response.possible) ** 2, axis=0) + UNSEEN**2
    places = np.linspace(0.0, 0.5, len(mean))
    half = min(HALF, period - 1)

    def design(cutoff: float) -> Filters:
        # λ = E|T|² + μ at the cutoff, where the correction is halved
        level = np.interp(cutoff, places, square) + CHANGE
        effort = level * (places / cutoff) ** STEEPNESS
        whole = effort + CHANGE + square
        robustness = symmetric_taps((CHANGE + square) / whole, half)
        return _judged("norm_optimal", response, *taps_of(mean.conj() / whole, half), robustness)

    return design


def _repetitive(response: Response, period: int):
    # phase lead and filter together must look less than one period ahead
    half = min(HALF, period // 2)
    leads = np.arange(min(LONGEST_LEAD, period - 1 - half) + 1)
    thin = slice(None, None, max(len(response.model) // COARSE, 1))
    angles, possible = np.linspace(0.0, np.pi, len(response.model))[thin], response.possible[:, thin]

    def design(cutoff: float) -> Filters:
        robustness = symmetric_taps(low_pass(cutoff, len(response.model)), half)
        around = filter_responses([0.0], 0, robustness, angles)[0]
        tried = [(lead, gain, gain * around * np.exp(1j * lead * angles)) for lead in leads for gain in GAINS]
        lead, gain, _ = min(tried, key=lambda one: np.max(contraction(around, one[2], possible)))
        taps = gain * np.concatenate([robustness[:0:-1], robustness])
        return _judged("repetitive", response, taps, int(lead) + half, robustness)

    return design


#: Designs by name: ``design(response, period)`` returns the filters as a function of the bandwidth.
KINDS: dict[str, Callable] = {"inversion": _inversion, "norm_optimal": _norm_optimal, "repetitive": _repetitive}
