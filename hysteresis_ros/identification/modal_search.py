# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which dynamics stand behind a hysteresis: lag, delay and up to two resonances, found and told apart.

The displacement w that the hysteresis puts out and the measured one are compared by the spectra of segments. For given
poles and delay the response is linear in the numerators, which are solved for exactly (variable projection), so a
structure needs few numbers to be searched: τ, delay, and frequency and damping of each mode. Where a mode may stand is
tried on a grid. A structure with more numbers is taken when segments that it was not fitted to are predicted better, by
more than its numbers explain (Bayesian information criterion), in most of the folds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.identification.linear_part import LinearPart, Mode
from hysteresis_ros.identification.segment_spectra import SegmentSpectra

#: Most modes that are looked for.
MOST_MODES = 2
#: Ranges: damping; frequency [of the sample rate]; lag and delay in samples and as parts of a segment.
DAMPING = (5e-4, 0.9)
HIGHEST = 0.49
SHORTEST, LONGEST = 0.05, 0.25
MOST_EVALUATIONS = 60
#: A mode makes at least so many turns in a segment.
TURNS = 20.0
#: No model is truer than to this part of the movement at neighbouring frequencies; the window leaks as much.
SMALLEST_ERROR = 3e-3


@dataclass(frozen=True)
class Structure:
    """Which parts there are.

    Parameters
    ----------
    lag, delay : bool
    modes : int
    series : bool
        Lag and modes one behind the other, without zeros; otherwise beside each other, with free numerators.
    """

    lag: bool
    delay: bool
    modes: int = 0
    series: bool = False

    @property
    def numbers(self) -> int:
        """How many numbers are fitted."""
        return self.lag + self.delay + (2 if self.series else 4) * self.modes + 1


@dataclass(frozen=True, eq=False)
class Trial:
    """A structure with its best numbers.

    Parameters
    ----------
    structure : Structure
    part : LinearPart
        Of unit gain, without creep, for a held input.
    gain : float
    response : ndarray of complex, shape (n,)
        At the frequencies of the spectra, gain included.
    values : ndarray
        Of the search.
    """

    structure: Structure
    part: LinearPart
    gain: float
    response: np.ndarray
    values: np.ndarray


def held_pole(pole, frequencies, sample_time: float, delay: float) -> np.ndarray:
    """Return the response of 1/(s - p) from a held input, delayed, to the samples before it changes, shape (n,).

    Parameters
    ----------
    pole : complex
        p [rad/s].
    frequencies : ndarray, shape (n,)
        [Hz]
    sample_time, delay : float
        [s]
    """
    whole = int(np.floor(delay / sample_time + 1e-9))
    part = max(delay / sample_time - whole, 0.0)
    late = np.expm1(pole * (1.0 - part) * sample_time) / pole
    early = np.expm1(pole * sample_time) / pole - late
    z = np.exp(2j * np.pi * frequencies * sample_time)
    return z**-whole * (late + early / z) / (z - np.exp(pole * sample_time))


def mode_columns(frequency, damping, frequencies, sample_time: float, delay: float) -> np.ndarray:
    """Return the responses of ω²/(s² + 2 ζ ω s + ω²) and of ω s/(…) from a held input, shape (n, 2).

    Parameters
    ----------
    frequency, damping : float
        ω/2π [Hz] and ζ.
    frequencies : ndarray, shape (n,)
        [Hz]
    sample_time, delay : float
        [s]
    """
    omega = 2.0 * np.pi * frequency
    pole = omega * complex(-damping, np.sqrt(1.0 - damping**2))
    one, other = (held_pole(p, frequencies, sample_time, delay) for p in (pole, pole.conjugate()))
    spread = pole - pole.conjugate()
    return np.column_stack(
        [omega**2 / spread * (one - other), omega / spread * (pole * one - pole.conjugate() * other)]
    )


def _lag_column(lag, frequencies, sample_time, delay):
    if lag > 0.0:
        return held_pole(-1.0 / lag, frequencies, sample_time, delay) / lag
    whole = int(np.floor(delay / sample_time + 1e-9))
    part = max(delay / sample_time - whole, 0.0)
    z = np.exp(2j * np.pi * frequencies * sample_time)
    return z ** -(whole + 1) * ((1.0 - part) + part / z)


class ModalSearch:
    """Searches on one set of spectra.

    Parameters
    ----------
    spectra : SegmentSpectra
    """

    def __init__(self, spectra: SegmentSpectra):
        self.spectra = spectra
        self.f, self.T = spectra.frequencies, spectra.sample_time
        longest = LONGEST / spectra.resolution
        self.lag_range = (SHORTEST * self.T, max(longest, 4.0 * self.T))
        self.delay_range = (0.0, max(longest, 4.0 * self.T))
        self.mode_range = (TURNS * spectra.resolution, HIGHEST / self.T)
        whole = spectra.input.sum(axis=0)
        self.estimate = spectra.cross.sum(axis=0) / np.maximum(whole, np.finfo(float).tiny)
        self.power = whole
        self.weigh(np.abs(self.estimate))

    def weigh(self, response) -> None:
        """Take the noise that a response leaves as the weight of the frequencies from now on."""
        noise = self.spectra.noise(response)
        around = self.spectra.smooth(self.spectra.output.mean(axis=0), 0.0)
        self.variance = np.maximum(noise, SMALLEST_ERROR**2 * around)
        self.weight = np.sqrt(self.power / self.variance)

    def cost(self, response) -> float:
        """Return twice the negative logarithm of the likelihood, but for a constant."""
        return self.scale * float(np.sum(self.spectra.errors(response) / self.variance))

    @property
    def scale(self) -> float:
        """By which sums over folds and frequencies count as independent samples."""
        return self.spectra.samples / self.spectra.input.size

    def without(self, fold: int) -> ModalSearch:
        """Return the search on the other folds, with the weights of this one.

        Parameters
        ----------
        fold : int
        """
        spectra = self.spectra
        kept = np.arange(len(spectra.input)) != fold
        sums = {name: getattr(spectra, name)[kept] for name in ("input", "output", "cross")}
        other = ModalSearch(replace(spectra, **sums))
        other.variance, other.weight = self.variance, np.sqrt(other.power / self.variance)
        return other

    def unpack(self, structure: Structure, values):
        """Return lag, delay [s], and pairs (frequency [Hz], damping)."""
        values = list(values)
        lag = float(np.exp(values.pop(0))) if structure.lag else 0.0
        delay = float(self.T * values.pop(0)) if structure.delay else 0.0
        pairs = [(float(np.exp(values[2 * i])), float(np.exp(values[2 * i + 1]))) for i in range(structure.modes)]
        return lag, delay, pairs

    def bounds(self, structure: Structure):
        """Return the lowest and the highest values of the search, in the order of :meth:`unpack`."""
        rows = [np.log(self.lag_range)] * structure.lag + [np.array(self.delay_range) / self.T] * structure.delay
        rows += [np.log(self.mode_range), np.log(DAMPING)] * structure.modes
        return np.reshape(rows, (-1, 2)).T

    def part(self, structure: Structure, values, coefficients) -> tuple[LinearPart, float]:
        """Return the linear part of unit gain, and the gain."""
        lag, delay, pairs = self.unpack(structure, values)
        if structure.series:
            modes, gain = in_series(lag, pairs), float(coefficients[0])
        else:
            shares = np.reshape(coefficients[1:], (-1, 2))
            gain = float(coefficients[0] + shares[:, 0].sum())
            both = zip(pairs, shares / gain, strict=True)
            modes = tuple(Mode(*pair, float(share[0]), float(share[1])) for pair, share in both)
        return LinearPart(lag=lag, delay=delay, modes=modes, hold=self.T), gain

    def columns(self, structure: Structure, values) -> np.ndarray:
        """Return what the response is linear in, shape (n, k)."""
        lag, delay, pairs = self.unpack(structure, values)
        if structure.series:
            return part_response(LinearPart(lag=lag, delay=delay, modes=in_series(lag, pairs), hold=self.T), self.f)[
                :, None
            ]
        found = [_lag_column(lag, self.f, self.T, delay)[:, None]]
        found += [mode_columns(*pair, self.f, self.T, delay) for pair in pairs]
        return np.concatenate(found, axis=1)

    def solve(self, columns):
        """Return the coefficients of the columns and the weighted residual, real and imaginary parts."""
        table = self.weight[:, None] * columns
        table = np.concatenate([table.real, table.imag])
        target = self.weight * self.estimate
        target = np.concatenate([target.real, target.imag])
        size = np.linalg.norm(table, axis=0)
        size[size == 0.0] = 1.0
        table = table / size
        gram = table.T @ table + 1e-12 * np.eye(len(size))
        coefficients = np.linalg.solve(gram, table.T @ target)
        return coefficients / size, table @ coefficients - target

    def fit(self, structure: Structure, starts, evaluations: int = MOST_EVALUATIONS) -> Trial:
        """Return the best trial of a structure from several starts."""
        from scipy.optimize import least_squares  # imported here because only fits need it

        low, high = self.bounds(structure)
        best = (np.inf, np.zeros(0))
        for start in starts if len(low) else ():
            inside = np.clip(start, low + 1e-6, high - 1e-6)
            found = least_squares(
                lambda values: self.solve(self.columns(structure, values))[1],
                inside,
                bounds=(low, high),
                x_scale=np.maximum(0.1 * (np.abs(inside) > 0), 0.1),
                xtol=1e-6,
                ftol=1e-6,
                max_nfev=evaluations,
            )
            if found.cost < best[0]:
                best = (found.cost, found.x)
        return self.trial(structure, best[1])

    def trial(self, structure: Structure, values) -> Trial:
        """Return the trial with given poles."""
        columns = self.columns(structure, values)
        coefficients, _ = self.solve(columns)
        part, gain = self.part(structure, values, coefficients)
        return Trial(structure, part, gain, columns @ coefficients, values)


def part_response(part: LinearPart, frequencies) -> np.ndarray:
    """Return the response of lag, modes and delay, shape (n,), for a held input, at the samples before it changes.

    Parameters
    ----------
    part : LinearPart
        With ``hold``.
    frequencies : ndarray, shape (n,)
        [Hz]
    """
    direct = 1.0 - sum(mode.position for mode in part.modes)
    found = direct * _lag_column(part.lag, frequencies, part.hold, part.delay)
    for mode in part.modes:
        columns = mode_columns(mode.frequency, mode.damping, frequencies, part.hold, part.delay)
        found = found + columns @ np.array([mode.position, mode.velocity])
    return found


def in_series(lag: float, pairs) -> tuple[Mode, ...]:
    """Return lag and modes one behind the other as modes beside the lag: partial fractions.

    Parameters
    ----------
    lag : float
        [s]
    pairs : sequence of (float, float)
        Frequency [Hz] and damping of each mode.
    """
    modes = []
    for i, (frequency, damping) in enumerate(pairs):
        omega = 2.0 * np.pi * frequency
        pole = omega * complex(-damping, np.sqrt(1.0 - damping**2))
        residue = omega**2 / (pole - pole.conjugate()) / (1.0 + lag * pole)
        for j, (other, other_damping) in enumerate(pairs):
            if j != i:
                square = (2.0 * np.pi * other) ** 2
                residue *= square / (pole**2 + 2.0 * other_damping * np.sqrt(square) * pole + square)
        # r/(s - p) + r*/(s - p*) = (2 Re r s - 2 Re(r p*))/(…)
        position = -2.0 * (residue * pole.conjugate()).real / omega**2
        modes.append(Mode(frequency, damping, float(position), float(2.0 * residue.real / omega)))
    return tuple(modes)
