# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Linear dynamics after a hysteresis, from the output of the hysteresis and the measurement (:func:`fit_stage`).

The user may name the structure (one of :data:`STAGES`: a continuous model fitted by output error, ARX, or a matrix
fraction). Otherwise the functions here choose lag, delay and up to two resonances, and identify them alternately with
the hysteresis.

The output w of the hysteresis and the measured displacement are compared through the spectra of segments. This reduces
a recording of any length to sums at a few thousand frequencies, so that one evaluation of a model takes a millisecond.
Both signals are differenced and windowed (Hann) first, so that little of the strong slow movement leaks into the weak
fast movement of a resonance. For given poles and delay the response is linear in the numerator coefficients. These
coefficients are solved for exactly (variable projection), so the search has few unknowns: time constant of the lag,
delay, and frequency and damping of each mode. A structure with more parameters is chosen only if it predicts held-out
segments better: in at least three quarters of the folds, and in total by more than the Bayesian information criterion
requires. The parameters of a structure with modes are then refined in the time domain (:class:`TimeSearch`).

For slow recordings the hysteresis is first fitted together with lag, delay and creep on coarse data; then the dynamics
after it are chosen again at the full sample rate. For fast recordings the dynamics between voltage and displacement are
identified first, because a hysteresis cannot represent a resonance. In both cases hysteresis and dynamics are then
refined alternately. If the hysteresis is identified from a slow recording, the dynamics after it may be identified from
a second recording of small, fast movements.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, sections 2.6 and 4.3 (noise
   of averaged spectra, weighted cost).
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from hysteresis_ros.errors import IdentificationError, ParameterError
from hysteresis_ros.identification.arx import ArxOrders, fit_arx, suggest_arx_orders
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.frequency_response import welch_response
from hysteresis_ros.identification.hammerstein import HammersteinFit
from hysteresis_ros.identification.linear_systems import FitError, Known, LinearModel, LinearPart, Mode
from hysteresis_ros.identification.matrix_fraction import identify_matrix_fraction
from hysteresis_ros.identification.plant_model import PlantModel
from hysteresis_ros.identification.prediction import before_dynamics
from hysteresis_ros.identification.preprocessing import condense
from hysteresis_ros.identification.thresholds import FAST_DYNAMICS
from hysteresis_ros.identification.transfer_function import Structure, fit_transfer_function
from hysteresis_ros.identification.validation import parameter_covariance
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.recordings.loops import turning_points

#: Ratio of the recording's length to a segment's length; segments overlap by half.
LENGTHS = 8
#: Number of folds. Segments are assigned to the folds in turn, so that an event affects several folds.
FOLDS = 4
#: A sweep passes each frequency once, so one fold may contain more than this fraction of the input's power at a
#: frequency, and the other folds cannot predict the response there.
SWEPT = 0.8
#: At these frequencies the sums are shifted among the folds, by one fold from each block of this number of frequencies
#: to the next; blocks, because the window correlates lines up to two apart.
BLOCK = 4
#: Fraction of the total power that must be exceeded near a frequency, so that a fold or a segment has real content
#: there.
LEAST_POWER = 1e-3
#: Relative distance from a frequency within which power counts as near this frequency.
BAND = 0.1
#: Lines of the spectrum that are closer together than this fraction of their frequency are combined.
RESOLUTION = 2e-3
#: The noise is averaged over this fraction of an octave on both sides of a frequency.
NOISE_OCTAVE = 0.25
#: The noise is averaged over at least this number of frequencies below a frequency, and of those from it upwards.
NOISE_BINS = 8


@dataclass(frozen=True, eq=False)
class SegmentSpectra:
    """Sums of the spectra of an input w and an output y over the segments of each fold."""

    frequencies: np.ndarray  #: shape (n,) [Hz], rising.
    input: np.ndarray  #: input, output: shape (F, n); Σ |W|² and Σ |Y|².
    output: np.ndarray
    cross: np.ndarray  #: shape (F, n); Σ Y W*.
    samples: float  #: Number of independent samples.
    segments: int  #: Number of summed segments.
    sample_time: float  #: [s]

    @property
    def resolution(self) -> float:
        """Distance between the two lowest frequencies [Hz]."""
        return float(self.frequencies[1] - self.frequencies[0])

    def at(self, frequencies) -> SegmentSpectra:
        """Return the same sums, assigned to other frequencies [Hz], shape (n,)."""
        return replace(self, frequencies=np.maximum(frequencies, 0.0))

    def errors(self, response) -> np.ndarray:
        """Return Σ |Y - G W|² of each fold and frequency, shape (F, n)."""
        size = np.abs(response) ** 2 * self.input - 2.0 * np.real(np.conj(response) * self.cross) + self.output
        return np.maximum(size, 0.0)

    def noise(self, response) -> np.ndarray:
        """Return Σ |Y - G W|², averaged over the folds and smoothed over frequency, shape (n,)."""
        return self.smooth(self.errors(response).mean(axis=0))

    def incoherent(self) -> np.ndarray:
        """Return the mean power per segment that w does not explain linearly, smoothed over frequency, shape (n,)."""
        tiny = np.finfo(float).tiny
        explained = np.abs(self.cross.sum(axis=0)) ** 2 / np.maximum(self.input.sum(axis=0), tiny)
        left = np.maximum(self.output.sum(axis=0) - explained, 0.0)
        return self.smooth(left) / max(self.segments - 1, 1)

    def smooth(self, values, octave: float = NOISE_OCTAVE) -> np.ndarray:
        """Return ``values``, shape (n,), each averaged over part of an octave on both sides."""
        f, n = self.frequencies, len(self.frequencies)
        low = np.minimum(np.searchsorted(f, f * 2.0**-octave), np.maximum(np.arange(n) - NOISE_BINS, 0))
        high = np.maximum(np.searchsorted(f, f * 2.0**octave), np.minimum(np.arange(n) + NOISE_BINS, n))
        total = np.append(0.0, np.cumsum(values))
        return (total[high] - total[low]) / (high - low)


def segment_spectra(w, y, sample_time: float, first: int = 0, late: int = 0) -> SegmentSpectra:
    """Return the sums of the spectra of input ``w`` and output ``y``, which have the same sample rate.

    Units: ``sample_time`` [s].
    """
    w, y = (np.diff(np.asarray(signal, dtype=float)[first:]) for signal in (w, y))
    w, y = w[: w.size - late], y[late:]
    length = 2 * max(w.size // (2 * LENGTHS), 16)
    window = np.hanning(length)
    starts = range(0, w.size - length + 1, length // 2)
    place = np.arange(2, length // 2)
    turned = np.exp(-2j * np.pi * place * late / length)
    found = [0]
    while found[-1] < place.size:
        found.append(found[-1] + max(int(RESOLUTION * place[found[-1]]), 1))
    edges = np.array(found[:-1])
    shape = FOLDS, edges.size
    input_, output, cross = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=complex)
    for number, start in enumerate(starts):
        W, Y = (np.fft.rfft(window * signal[start : start + length])[place] for signal in (w, y))
        fold = number % FOLDS
        input_[fold] += np.add.reduceat(np.abs(W) ** 2, edges)
        output[fold] += np.add.reduceat(np.abs(Y) ** 2, edges)
        cross[fold] += np.add.reduceat(Y * turned * np.conj(W), edges)
    frequencies = np.add.reduceat(place.astype(float), edges) / np.diff(np.append(edges, place.size))
    lines = frequencies / (length * sample_time)
    turns = np.where(_swept(lines, input_), np.arange(lines.size) // BLOCK, 0)
    folds = (np.arange(FOLDS)[:, None] - turns) % FOLDS
    input_, output, cross = (np.take_along_axis(values, folds, axis=0) for values in (input_, output, cross))
    return SegmentSpectra(lines, input_, output, cross, float(w.size), len(starts), sample_time)


def _swept(frequencies, power) -> np.ndarray:
    """Return at which frequencies one fold has nearly all input power, and real content, shape (n,) of bool."""
    most = np.argmax(power, axis=0)
    total = np.pad(np.cumsum(power, axis=1), ((0, 0), (1, 0)))
    low, high = (np.searchsorted(frequencies, frequencies * (1.0 + side)) for side in (-BAND, BAND))
    near = total[most, high] - total[most, low]
    return (power.max(axis=0) > SWEPT * power.sum(axis=0)) & (near > LEAST_POWER * total[most, -1])


#: Largest number of modes of a structure.
MOST_MODES = 2
#: Range of the damping ratio of a mode.
DAMPING_RANGE = (5e-4, 0.9)
#: Highest frequency of a mode, as a fraction of the sample rate.
HIGHEST = 0.49
#: Shortest lag [samples].
SHORTEST = 0.05
#: Longest lag and longest delay, as a fraction of a segment, but at least four samples.
LONGEST = 0.25
#: Largest number of evaluations of a fit.
MOST_EVALUATIONS = 60
#: Standard deviation (width) of the Hann window's power spectrum, as a fraction of the distance between two lines.
WINDOW_WIDTH = 1.0 / math.sqrt(3.0)
#: Relative step of the derivatives: the square root of the machine precision.
SMALL_STEP = float(np.sqrt(np.finfo(float).eps))
#: Number of modes whose responses a search caches.
KEPT_COLUMNS = 16
#: Least number of cycles of a mode in a segment.
LEAST_CYCLES = 20.0
#: Smallest assumed error of a model, as a fraction of the output at neighbouring frequencies; it accounts for the
#: leakage of the window.
SMALLEST_ERROR = 3e-3


@dataclass(frozen=True)
class ModalStructure:
    """The parts of a dynamic model."""

    lag: bool
    delay: bool
    modes: int = 0
    #: True: lag and modes in series, without zeros; false: in parallel, with free numerators.
    series: bool = False

    @property
    def numbers(self) -> int:
        """Number of fitted parameters."""
        return self.lag + self.delay + (2 if self.series else 4) * self.modes + 1


@dataclass(frozen=True, eq=False)
class ModalTrial:
    """A structure with its best parameters."""

    structure: ModalStructure
    part: LinearPart  #: Linear part of unit gain, without creep, for a held input.
    gain: float
    response: np.ndarray  #: shape (n,); Response at the frequencies of the spectra, including the gain.
    values: np.ndarray  #: Parameters of the search.
    #: Standard deviations by name, for the chosen trial only: lag and delay [s], mode_1_hz, mode_1_damping …
    deviations: dict[str, float] = field(default_factory=dict)


@functools.lru_cache(maxsize=8)
def _backward(frequencies: bytes, sample_time: float) -> np.ndarray:
    """Return 1/z at frequencies [Hz], given as the bytes of their array; cached, because searches need it often."""
    return np.exp(-2j * np.pi * sample_time * np.frombuffer(frequencies))


def _shifted(frequencies, sample_time: float, delay: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return 1/z, z^-(k + 1) with the k whole samples of the delay, and the remaining fraction of a sample."""
    back = _backward(np.asarray(frequencies, dtype=float).tobytes(), sample_time)
    whole = int(np.floor(delay / sample_time + 1e-9))
    return back, back ** (whole + 1) if whole else back, max(delay / sample_time - whole, 0.0)


def _held_mode(frequency, damping, sample_time: float, part: float):
    """Return ω²/(s² + 2 ζ ω s + ω²) and ω s/(…) for a held input: both numerators in 1/z, and the denominator.

    ``part`` is the fraction of a sample by which the input is late. The three coefficients of a numerator omit its
    factor 1/z. Units: ``frequency`` [Hz], ``sample_time`` [s].
    """
    omega = 2.0 * np.pi * frequency
    pole = omega * (-damping + 1j * np.sqrt(1.0 - damping**2))
    late = np.expm1(pole * (1.0 - part) * sample_time) / pole
    early = np.expm1(pole * sample_time) / pole - late
    decay = np.exp(pole * sample_time)
    # 1/(s - p) becomes (late + early/z)/(z - decay); the difference from its conjugate has real coefficients
    numerator = late, early - late * decay.conjugate(), -early * decay.conjugate()
    both = [[(turn * one).imag for one in numerator] for turn in (omega**2 / pole.imag, omega * pole / pole.imag)]
    return both, (-2.0 * decay.real, abs(decay) ** 2)


def _held_lag(lag: float, sample_time: float, part: float) -> tuple[float, float, float]:
    """Return a lag for a held input: the two numerator coefficients, without the factor 1/z, and the pole.

    Units: ``lag``, ``sample_time`` [s]; ``part`` as in :func:`_held_mode`.
    """
    if not lag > 0.0:
        return 1.0 - part, part, 0.0
    late = -np.expm1(-(1.0 - part) * sample_time / lag)
    return late, -np.expm1(-sample_time / lag) - late, np.exp(-sample_time / lag)


def mode_columns(frequency, damping, frequencies, sample_time: float, delay: float) -> np.ndarray:
    """Return the responses of ω²/(s² + 2 ζ ω s + ω²) and of ω s/(…) to a held input, shape (n, 2).

    The responses are sampled just before the input changes. ``frequency`` [Hz] and ``damping`` may be arrays, shape (K,
    1); the result then has the shape (K, n, 2). Units: ``frequencies`` [Hz], ``sample_time`` [s], ``delay`` [s].
    """
    back, shift, part = _shifted(frequencies, sample_time, delay)
    both, (d1, d2) = _held_mode(frequency, damping, sample_time, part)
    shift = shift / (1.0 + back * (d1 + d2 * back))
    found = np.empty((2, *shift.shape), dtype=complex)
    for column, (n0, n1, n2) in enumerate(both):
        found[column] = shift * (n0 + back * (n1 + n2 * back))
    return found.transpose(*range(1, found.ndim), 0)


def _lag_column(lag, frequencies, sample_time, delay):
    """Return the response of a lag to a held input, shape (n,), sampled just before the input changes."""
    back, shift, part = _shifted(frequencies, sample_time, delay)
    late, early, pole = _held_lag(lag, sample_time, part)
    return shift * (late + early * back) / (1.0 - pole * back)


def _rows(table) -> np.ndarray:
    """Return complex columns, shape (n, k), as rows of their real and imaginary parts, shape (k, 2 n)."""
    return np.ascontiguousarray(table.T).view(float)


def _solved(rows, right) -> np.ndarray:
    """Return the least-squares coefficients of ``rows``, shape (k,) or (k, m); ``right`` is rows · target."""
    gram = rows @ rows.T
    size = np.sqrt(gram.diagonal())
    size[size == 0.0] = 1.0
    gram /= size[:, None] * size
    gram.flat[:: len(size) + 1] += 1e-12
    size = size if right.ndim == 1 else size[:, None]
    return scipy.linalg.lapack.dposv(gram, right / size)[1] / size


def _least_squares(table, target) -> np.ndarray:
    """Return the real coefficients of complex columns, shape (k,), or (k, m) for several targets."""
    rows = _rows(table)
    return _solved(rows, rows @ (target.view(float) if target.ndim == 1 else _rows(target).T))


class ModalSearch:
    """Search for the parameters of structures, on one set of spectra."""

    def __init__(self, spectra: SegmentSpectra, variance=None):
        self.spectra = spectra
        self.f, self.T = spectra.frequencies, spectra.sample_time
        longest = LONGEST / spectra.resolution
        self.lag_range = (SHORTEST * self.T, max(longest, 4.0 * self.T))
        self.delay_range = (0.0, max(longest, 4.0 * self.T))
        self.mode_range = (LEAST_CYCLES * spectra.resolution, HIGHEST / self.T)
        whole = spectra.input.sum(axis=0)
        self.estimate = spectra.cross.sum(axis=0) / np.maximum(whole, np.finfo(float).tiny)
        self.power = whole
        self.cached: dict[tuple[float, float, float], np.ndarray] = {}
        if variance is None:
            self.weigh(np.abs(self.estimate))
        else:
            self._set(variance)

    def weigh(self, response) -> None:
        """Weight the frequencies in all later fits by the noise, estimated from the residual of a response."""
        noise = self.spectra.noise(response)
        around = self.spectra.smooth(self.spectra.output.mean(axis=0), 0.0)
        self._set(np.maximum(noise, SMALLEST_ERROR**2 * around))

    def _set(self, variance) -> None:
        """Weight the frequencies in all later fits by a variance."""
        self.variance, self.weight = variance, np.sqrt(self.power / variance)
        self.target = self.weight * self.estimate
        self.without = functools.lru_cache(self._without)

    def cost(self, response) -> float:
        """Return twice the negative log-likelihood, up to a constant."""
        return self.scale * float(np.sum(self.spectra.errors(response) / self.variance))

    @property
    def scale(self) -> float:
        """Factor that scales sums over folds and frequencies to the number of independent samples."""
        return self.spectra.samples / self.spectra.input.size

    def _without(self, fold: int) -> ModalSearch:
        """Return a search on all folds except ``fold``, with the weights of this search."""
        spectra = self.spectra
        kept = np.arange(len(spectra.input)) != fold
        sums = {name: getattr(spectra, name)[kept] for name in ("input", "output", "cross")}
        return ModalSearch(replace(spectra, **sums), self.variance)

    def unpack(self, structure: ModalStructure, values):
        """Return lag [s], delay [s], and pairs (frequency [Hz], damping)."""
        values = list(values)
        lag = float(np.exp(values.pop(0))) if structure.lag else 0.0
        delay = float(self.T * values.pop(0)) if structure.delay else 0.0
        pairs = [(float(np.exp(values[2 * i])), float(np.exp(values[2 * i + 1]))) for i in range(structure.modes)]
        return lag, delay, pairs

    def bounds(self, structure: ModalStructure):
        """Return the lowest and the highest values of the search, in the order of :meth:`unpack`."""
        rows = [np.log(self.lag_range)] * structure.lag + [np.array(self.delay_range) / self.T] * structure.delay
        rows += [np.log(self.mode_range), np.log(DAMPING_RANGE)] * structure.modes
        return np.reshape(rows, (-1, 2)).T

    def part(self, structure: ModalStructure, values, coefficients) -> tuple[LinearPart, float]:
        """Return the linear part with unit gain, and the gain separately."""
        lag, delay, pairs = self.unpack(structure, values)
        if structure.series:
            modes, gain = in_series(lag, pairs), float(coefficients[0])
        else:
            shares = np.reshape(coefficients[1:], (-1, 2))
            gain = float(coefficients[0] + shares[:, 0].sum())
            both = zip(pairs, shares / gain, strict=True)
            modes = tuple(Mode(pair[0], pair[1], float(share[0]), float(share[1])) for pair, share in both)
        return LinearPart(lag=lag, delay=delay, modes=modes, hold=self.T), gain

    def columns(self, structure: ModalStructure, values) -> np.ndarray:
        """Return the columns whose linear combination is the response, shape (n, k)."""
        lag, delay, pairs = self.unpack(structure, values)
        late = self.column_of_lag(lag, delay)
        both = [self.columns_of_mode(frequency, damping, delay) for frequency, damping in pairs]
        if structure.series:
            modes = in_series(lag, pairs)
            found = (1.0 - sum(mode.position for mode in modes)) * late
            for mode, own in zip(modes, both, strict=True):
                found = found + (mode.position * own[:, 0] + mode.velocity * own[:, 1])
            return found[:, None]
        return np.concatenate([late[:, None], *both], axis=1)

    def column_of_lag(self, lag: float, delay: float) -> np.ndarray:
        """Return the response of a lag after a delay, shape (n,).

        Units: ``lag``, ``delay`` [s].
        """
        return _lag_column(lag, self.f, self.T, delay)

    def columns_of_mode(self, frequency: float, damping: float, delay: float) -> np.ndarray:
        """Return :func:`mode_columns`, shape (n, 2), from a cache, because derivatives change one mode at a time.

        Units: ``frequency`` [Hz], ``delay`` [s].
        """
        place = frequency, damping, delay
        if place not in self.cached:
            if len(self.cached) >= KEPT_COLUMNS:
                del self.cached[next(iter(self.cached))]
            self.cached[place] = self._new_columns_of_mode(*place)
        return self.cached[place]

    def _new_columns_of_mode(self, frequency: float, damping: float, delay: float) -> np.ndarray:
        return mode_columns(frequency, damping, self.f, self.T, delay)

    def solve(self, columns):
        """Return the coefficients of the columns and the weighted residual, real and imaginary parts."""
        rows, target = _rows(self.weight[:, None] * columns), self.target.view(float)
        coefficients = _solved(rows, rows @ target)
        return coefficients, coefficients @ rows - target

    def costs_with(self, columns, pairs) -> np.ndarray:
        """Return the squared residual, shape (K,), after adding each of the K pairs of columns, shape (K, n, 2)."""
        table = self.weight[:, None] * columns
        rest = self.target - table @ _least_squares(table, self.target)
        flat = self.weight[:, None] * np.moveaxis(pairs, 0, 1).reshape(len(self.f), -1)
        flat -= table @ _least_squares(table, flat)
        a, b = flat.T.reshape(-1, 2, len(self.f)).swapaxes(0, 1)
        # the normal equations of the two columns of each pair, solved in closed form
        aa, bb, ab = (np.einsum("kn,kn->k", p.conj(), q).real for p, q in ((a, a), (b, b), (a, b)))
        at, bt = (a.conj() @ rest).real, (b.conj() @ rest).real
        left = np.maximum(aa * bb - ab**2, 1e-12 * np.maximum(aa * bb, np.finfo(float).tiny))
        return np.sum(np.abs(rest) ** 2) - (bb * at**2 - 2.0 * ab * at * bt + aa * bt**2) / left

    def with_short_delays(self, trial: ModalTrial) -> np.ndarray:
        """Return the values of a trial with the lag set to two samples and the delay to one."""
        head = [np.log(2.0 * self.T)] * trial.structure.lag + [1.0] * trial.structure.delay
        return np.append(head, trial.values[len(head) :])

    def fit(self, structure: ModalStructure, starts, evaluations: int = MOST_EVALUATIONS) -> ModalTrial:
        """Return the best trial of a structure from several starts."""
        from scipy.optimize import least_squares  # imported here because only fits need it

        latest: tuple[Any, Any] = None, None

        def residual(values):
            return self.solve(self.columns(structure, values))[1]

        def noted(values):
            nonlocal latest
            latest = values.copy(), residual(values)
            return latest[1]

        def slopes(values):
            here = latest[1] if np.array_equal(values, latest[0]) else residual(values)
            return self.slopes(structure, values, here)

        low, high = self.bounds(structure)
        best = (np.inf, np.zeros(0))
        for start in starts if len(low) else ():
            inside = np.clip(start, low + 1e-6, high - 1e-6)
            found = least_squares(
                noted,
                inside,
                jac=slopes,
                bounds=(low, high),
                x_scale=np.maximum(0.1 * (np.abs(inside) > 0), 0.1),
                xtol=1e-6,
                ftol=1e-6,
                max_nfev=evaluations,
            )
            if found.cost < best[0]:
                best = (found.cost, found.x)
        return self.trial(structure, best[1])

    def slopes(self, structure: ModalStructure, values, here) -> np.ndarray:
        """Return the derivatives of the residual with respect to the values, shape (2 n, k); ``here`` is the residual.

        The coefficients depend on the values: with columns Φ, coefficients c and the residual r,
        ΦᵀΦ dc = -(dΦᵀ r + Φᵀ dΦ c) (variable projection, Golub and Pereyra 1973). Only dΦ is a finite difference, so
        the normal equations are solved only once.
        """
        low, high = self.bounds(structure)
        columns, weight = self.columns(structure, values), self.weight[:, None]
        rows = _rows(weight * columns)
        coefficients = _solved(rows, rows @ self.target.view(float))
        steps = np.where(values < 0.0, -SMALL_STEP, SMALL_STEP) * np.maximum(np.abs(values), 1.0)
        steps = np.where((values + steps < low) | (values + steps > high), -steps, steps)
        moved, right = np.empty((values.size, here.size)), np.empty((values.size, len(coefficients)))
        for k, step in enumerate(steps):
            other = values.copy()
            other[k] += step
            change = _rows(weight * (self.columns(structure, other) - columns)) / (other[k] - values[k])
            moved[k], right[k] = coefficients @ change, -(change @ here)
        return (moved + _solved(rows, (right - moved @ rows.T).T).T @ rows).T

    def deviations(self, trial: ModalTrial) -> dict[str, float]:
        """Return the standard deviations of lag [s], delay [s], and frequency [Hz] and damping of the modes.

        The window correlates neighbouring lines; :func:`parameter_covariance` includes this correlation. The window
        also averages the response over :data:`WINDOW_WIDTH` lines, which makes resonances wider. The resulting shift of
        the parameters is included in their deviations (root sum of squares). With two parallel modes and no lag, the
        deviation of the delay is not returned: the free numerators of the modes can represent half a sample of delay,
        so several delays are equally likely.
        """
        if not trial.values.size:
            return {}
        columns = self.columns(trial.structure, trial.values)
        coefficients, residual = self.solve(columns)
        slopes = self.slopes(trial.structure, trial.values, residual)
        # real parts of all lines, then imaginary parts: neighbours in the table are neighbours in frequency
        ordered, errors = (np.concatenate([table[::2], table[1::2]]) for table in (slopes, residual))
        covariance = parameter_covariance(ordered, errors, columns.shape[1], truncated=SMALL_STEP, correlated=True)
        width = WINDOW_WIDTH * self.spectra.resolution
        sides = [ModalSearch(self.spectra.at(self.f + side), self.variance) for side in (-width, width)]
        averaged = 0.5 * sum(side.columns(trial.structure, trial.values) for side in sides)
        change = self.weight[:, None] * ((averaged - columns) @ coefficients)[:, None]
        table = self.weight[:, None] * columns
        change -= table @ _least_squares(table, change)
        shift = np.linalg.lstsq(slopes, change[:, 0].view(float), rcond=SMALL_STEP)[0]
        return self.named(trial, np.hypot(np.sqrt(np.diag(covariance)), shift))

    def named(self, trial: ModalTrial, deviations) -> dict[str, float]:
        """Return deviations of the search's values by name: lag [s], delay [s], frequencies [Hz] and dampings."""
        sizes = iter(deviations)
        lag, _, pairs = self.unpack(trial.structure, trial.values)
        found = {"lag": lag * next(sizes)} if trial.structure.lag else {}
        late = self.T * next(sizes) if trial.structure.delay else 0.0
        told = len(pairs) < 2 or trial.structure.lag or trial.structure.series
        found |= {"delay": late} if trial.structure.delay and told else {}
        rows = sorted((frequency, frequency * next(sizes), damping * next(sizes)) for frequency, damping in pairs)
        for number, (_, *both_sizes) in enumerate(rows, start=1):
            found |= dict(zip((f"mode_{number}_hz", f"mode_{number}_damping"), both_sizes, strict=True))
        return {name: float(size) for name, size in found.items()}

    def trial(self, structure: ModalStructure, values) -> ModalTrial:
        """Return the trial of a structure with these values."""
        columns = self.columns(structure, values)
        coefficients, _ = self.solve(columns)
        part, gain = self.part(structure, values, coefficients)
        return ModalTrial(structure, part, gain, columns @ coefficients, values)


#: Assumed order of the autoregressive model that whitens the residual.
WHITENING = 40
#: Assumed number of times that the autoregressive model is fitted.
WHITENED = 2
#: Largest number of evaluations of a fit in the time domain.
REFINEMENTS = 12
#: A sample is an outlier if its whitened residual is more than this multiple of the median around it, and of the
#: overall median.
FAR = 10.0
#: Number of samples of the median around a sample.
AROUND = 101
#: Residual, relative to the output, up to which no refinement is needed.
EXACT = 1e-9
#: Smallest and largest number of samples for a refinement: fewer samples do not determine the whitening filter, and
#: with more samples the segments of the spectra are so long that the window has little effect.
REFINED = (20 * WHITENING, 60_000)


class TimeSearch(ModalSearch):
    """Search in the time domain: output error of whitened samples.

    The window of the spectra suppresses the first and last samples and makes resonances wider. Both effects are large
    if the recording excites a resonance only once, by a sweep or a step. The residual is whitened by an autoregressive
    model, so that the slow errors of a hysteresis have little weight. A column of samples is stored as complex numbers,
    each of which contains two neighbouring samples as its real and imaginary part.
    """

    def __init__(self, spectra: SegmentSpectra, w, y, first: int):
        super().__init__(spectra)
        w, y = (np.asarray(values, dtype=float) for values in (w, y))
        self._w, self._y, self._first = w - w[0], y, first
        self._beside = np.stack([np.ones(len(y)), np.linspace(-1.0, 1.0, len(y))], axis=1)
        self._filter_by(np.ones(1))

    def _filter_by(self, whitening, kept=None) -> None:
        """Use this filter, shape (order + 1,), and only the filtered samples that are ``kept``, shape (n,) of bool."""
        self._whitening, self._kept, self._basis = whitening, kept, None
        self.cached.clear()
        self._basis = np.linalg.qr(self._filtered(self._beside))[0]
        self.target = self._column(self._y)
        self.weight = np.ones(len(self.target))

    def _filtered(self, values) -> np.ndarray:
        start = self._first + len(self._whitening) - 1
        count = (len(values) - start) // 2 * 2
        found = scipy.signal.lfilter(self._whitening, [1.0], values, axis=0)[start : start + count]
        if self._kept is not None:
            found[~self._kept] = 0.0
        return found if self._basis is None else found - self._basis @ (self._basis.T @ found)

    def _column(self, values) -> np.ndarray:
        """Return samples, shape (N,), filtered, without constant and linear trend, as complex pairs, shape (n/2,)."""
        return np.ascontiguousarray(self._filtered(values)).view(complex)

    def _late(self, delay: float) -> tuple[np.ndarray, float]:
        """Return the input, delayed by one sample plus the whole samples of a delay [s], and the remaining fraction."""
        whole = int(np.floor(delay / self.T + 1e-9))
        count = min(whole + 1, len(self._w))
        return np.append(np.zeros(count), self._w[: len(self._w) - count]), max(delay / self.T - whole, 0.0)

    def column_of_lag(self, lag: float, delay: float) -> np.ndarray:
        """Return the whitened output of a lag after a delay, shape (n/2,).

        Units: ``lag``, ``delay`` [s].
        """
        late, part = self._late(delay)
        *numerator, pole = _held_lag(lag, self.T, part)
        return self._column(scipy.signal.lfilter(numerator, [1.0, -pole], late))

    def _new_columns_of_mode(self, frequency: float, damping: float, delay: float) -> np.ndarray:
        late, part = self._late(delay)
        both, denominator = _held_mode(frequency, damping, self.T, part)
        outputs = (scipy.signal.lfilter(numerator, [1.0, *denominator], late) for numerator in both)
        return np.stack([self._column(output) for output in outputs], axis=1)

    def whiten(self, structure: ModalStructure, values) -> None:
        """Whiten with the residual of a model, and omit the residual's outliers."""
        self._filter_by(np.ones(1))
        whitening = _whitening(self.residual(structure, values))
        self._filter_by(whitening)
        size = np.abs(self.residual(structure, values))
        # outliers are isolated; where the model is wrong, as at a resonance, neighbouring residuals are large too
        around = scipy.ndimage.median_filter(size, AROUND)
        self._filter_by(whitening, size <= FAR * np.maximum(around, np.median(size)))
        # the search ends when the gradient is small, so the residual is scaled to a standard deviation of 1
        scale = float(np.std(self.residual(structure, values)))
        self.weight, self.target = self.weight / scale, self.target / scale

    def residual(self, structure: ModalStructure, values) -> np.ndarray:
        """Return the residual with the best coefficients for these values, shape (n,)."""
        return self.solve(self.columns(structure, values))[1]

    def refined(self, trial: ModalTrial) -> ModalTrial:
        """Return a trial of the spectra, refined to the values that fit the samples best, with their deviations."""
        structure, values = trial.structure, trial.values
        if np.std(self.residual(structure, values)) <= EXACT * np.std(self._y):
            return trial
        for _ in range(WHITENED):
            self.whiten(structure, values)
            values = self.fit(structure, [values], REFINEMENTS).values
        coefficients, _ = self.solve(self.columns(structure, values))
        part, gain = self.part(structure, values, coefficients)
        response = ModalSearch(self.spectra).columns(structure, values) @ coefficients
        found = ModalTrial(structure, part, gain, response, values)
        return replace(found, deviations=self.deviations(found))

    def deviations(self, trial: ModalTrial) -> dict[str, float]:
        """Return standard deviations as :meth:`ModalSearch.deviations` does, but from the scatter of the samples."""
        columns = self.columns(trial.structure, trial.values)
        residual = self.solve(columns)[1]
        slopes = self.slopes(trial.structure, trial.values, residual)
        others = columns.shape[1] + self._beside.shape[1]
        covariance = parameter_covariance(slopes, residual, others, truncated=SMALL_STEP, correlated=True)
        return self.named(trial, np.sqrt(np.diag(covariance)))


def _whitening(residual) -> np.ndarray:
    """Return the filter that whitens a residual, shape (order + 1,), from its correlation (Yule and Walker)."""
    count = 2 * len(residual)
    power = np.abs(np.fft.rfft(residual - residual.mean(), count)) ** 2
    correlation = np.fft.irfft(power)[: WHITENING + 1]
    correlation[0] *= 1.0 + 1e-6  # so that the equations stay regular
    return np.append(1.0, -scipy.linalg.solve_toeplitz(correlation[:-1], correlation[1:]))


def part_response(part: LinearPart, frequencies) -> np.ndarray:
    """Return the response of lag, modes and delay to a held input, shape (n,), sampled just before the input changes.

    Units: ``frequencies`` [Hz].
    """
    direct = 1.0 - sum(mode.position for mode in part.modes)
    found = direct * _lag_column(part.lag, frequencies, part.hold, part.delay)
    for mode in part.modes:
        columns = mode_columns(mode.frequency, mode.damping, frequencies, part.hold, part.delay)
        found = found + columns @ np.array([mode.position, mode.velocity])
    return found


def in_series(lag: float, pairs) -> tuple[Mode, ...]:
    """Return the parallel modes that are equivalent to a lag and modes in series, by partial fractions.

    Units: ``lag`` [s].
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


#: Number of initial frequencies of a mode.
TRIED_FREQUENCIES = 100
#: Initial damping ratios of a mode.
TRIED_DAMPINGS = (0.01, 0.05, 0.25)
#: Number of the best starts that are refined.
FOLLOWED = 2
#: Number of initial frequencies whose columns are computed together.
TRIED_TOGETHER = 20
#: For each number of modes, largest number of structures that are compared on held-out segments.
JUDGED = 3
#: Number of evaluations before the first comparison of the structures.
SCREENED = 10
#: Number of the best structures whose fit continues after this comparison.
CONTINUED = 4
#: Fraction of the folds in which a larger structure must at least predict better.
MAJORITY = 0.75
#: Frequencies within this factor of the frequency of an added mode are near it; the prediction there must also improve.
NEARBY_FREQUENCY = 1.4
#: If modes were added, only those folds count that have at least this fraction of the input's power near these modes.
LEAST_SHARE = 0.05
#: Largest number of evaluations of a fit without one fold; such a fit starts near its minimum.
FEW_EVALUATIONS = 6


def choose_dynamics(
    spectra: SegmentSpectra,
    parts=("lag", "delay"),
    most_modes: int = MOST_MODES,
    zeros: bool = True,
    accepted: Callable[[float], bool] | None = None,
) -> ModalTrial:
    """Return the dynamics that predict held-out segments best; every additional parameter must improve the prediction.

    ``accepted`` returns whether a mode may have a given frequency [Hz].
    """
    search = ModalSearch(spectra)
    plain = [_without_modes(search, *both) for both in itertools.product(*(_choices(part, parts) for part in PAIR))]
    largest = [min(plain, key=lambda trial: search.cost(trial.response))]
    search.weigh(largest[0].response)
    low, high = search.mode_range
    # in a short recording the lowest allowed frequency of a mode may be near half the sample rate
    for _ in range(most_modes if 1.2 * low < high else 0):
        largest.append(_with_mode(search, largest[-1]))
    search.weigh(largest[-1].response)
    judged = [_left_out(search, search.fit(trial.structure, [trial.values])) for trial in plain]
    for trial in largest[1:]:
        variants = _best_variants(search, trial, parts, zeros)
        judged += [_left_out(search, found) for found in variants[:JUDGED]]
    if accepted is not None:
        judged = [pair for pair in judged if all(accepted(mode.frequency) for mode in pair[0].part.modes)]
    chosen = _chosen(judged, spectra)
    return replace(chosen, deviations=search.deviations(chosen))


PAIR = ("lag", "delay")


def _choices(part: str, parts) -> tuple[bool, ...]:
    return (False, True) if part in parts else (False,)


def _price(spectra: SegmentSpectra) -> float:
    """Return the increase of twice the log-likelihood that is required for each additional parameter."""
    return float(np.log(spectra.samples))


def _chosen(judged, spectra: SegmentSpectra) -> ModalTrial:
    """Add parameters as long as each addition improves the prediction, and return the last trial."""
    price = _price(spectra)
    order = sorted(judged, key=lambda pair: (pair[0].structure.numbers, pair[1].sum()))
    best, least = order[0]
    for trial, errors in order[1:]:
        gain = least - errors
        added = _added_modes(trial.part.modes, best.part.modes)
        near = [np.abs(np.log(spectra.frequencies / mode.frequency)) < np.log(NEARBY_FREQUENCY) for mode in added]
        more = trial.structure.numbers - best.structure.numbers
        if (
            gain.sum() > price * more
            and _majority(gain, spectra, near)
            and all(gain[:, place].sum() > 2.0 * price for place in near)
        ):
            best, least = trial, errors
    if best.structure.delay and not best.structure.lag:
        # positioners usually have a lag, so a lag replaces the delay if it predicts nearly as well
        for trial, errors in order:
            same = trial.structure == replace(best.structure, lag=True, delay=False)
            if same and errors.sum() - least.sum() < price:
                return trial
    return best


def _majority(gain, spectra: SegmentSpectra, near) -> bool:
    """Return whether enough folds (MAJORITY) improve; for added modes, only folds with content near them count."""
    telling = np.ones(len(gain), dtype=bool)
    if near:
        power = spectra.input[:, np.any(near, axis=0)].sum(axis=1)
        telling = power >= LEAST_SHARE * power.sum()
    better = gain.sum(axis=1) > 0.0
    return bool(np.count_nonzero(better & telling) >= MAJORITY * np.count_nonzero(telling))


def _added_modes(modes, present) -> list[Mode]:
    """Return ``modes`` without the mode nearest in frequency to each mode in ``present``."""
    left = list(modes)
    for mode in present if len(modes) > len(present) else ():
        left.remove(min(left, key=lambda other: abs(np.log(other.frequency / mode.frequency))))
    return left


def _without_modes(search: ModalSearch, lag: bool, delay: bool) -> ModalTrial:
    """Fit lag and delay, starting from a grid of both."""
    structure, T = ModalStructure(lag, delay), search.T
    lags = np.geomspace(0.2 * T, search.lag_range[1], 10)
    delays = np.append(0.3 * T, np.geomspace(0.7 * T, search.delay_range[1], 8))
    grid = itertools.product(np.log(lags) if lag else [None], delays / T if delay else [None])
    starts = [np.array([value for value in point if value is not None]) for point in grid]
    starts.sort(key=lambda start: search.cost(search.trial(structure, start).response))
    return search.fit(structure, starts[:FOLLOWED])


def _with_mode(search: ModalSearch, trial: ModalTrial) -> ModalTrial:
    """Add a mode at the frequency that lowers the cost most."""
    structure = replace(trial.structure, modes=trial.structure.modes + 1)
    _, delay, _ = search.unpack(trial.structure, trial.values)
    columns = search.columns(trial.structure, trial.values)
    low, high = search.mode_range
    found = []
    tried = np.geomspace(1.05 * low, 0.95 * high, TRIED_FREQUENCIES)
    for damping, some in itertools.product(TRIED_DAMPINGS, np.array_split(tried, TRIED_FREQUENCIES // TRIED_TOGETHER)):
        extra = mode_columns(some[:, None], np.full((some.size, 1), damping), search.f, search.T, delay)
        costs = search.costs_with(columns, extra)
        found += [(float(cost), (float(frequency), damping)) for cost, frequency in zip(costs, some, strict=True)]
    starts: list[np.ndarray] = []
    taken: list[float] = []
    # each frequency is also tried with a short lag and delay, because the lag and delay that compensated for the
    # missing mode lead to a local minimum
    heads = (trial.values, search.with_short_delays(trial))
    for _, (frequency, damping) in sorted(found):
        if len(taken) < FOLLOWED and all(abs(np.log(frequency / other)) > 0.2 for other in taken):
            taken.append(frequency)
            starts += [np.append(head, np.log([frequency, damping])) for head in heads]
    ahead = sorted(
        (search.fit(structure, [start], SCREENED) for start in starts), key=lambda one: search.cost(one.response)
    )
    return search.fit(structure, [found.values for found in ahead[:FOLLOWED]])


def _variants(search: ModalSearch, trial: ModalTrial, parts, zeros: bool):
    """Yield structures with the same modes, and initial values of their search."""
    lag, delay, pairs = search.unpack(trial.structure, trial.values)
    tail = np.log(pairs).ravel()
    places = (False, True) if zeros else (True,)
    for has_lag, has_delay, series in itertools.product(*(_choices(part, parts) for part in PAIR), places):
        head = [np.log(lag or 2.0 * search.T)] * has_lag + [delay / search.T or 0.3] * has_delay
        yield ModalStructure(has_lag, has_delay, trial.structure.modes, series), np.append(head, tail)


def _best_variants(search: ModalSearch, trial: ModalTrial, parts, zeros: bool) -> list[ModalTrial]:
    """Return the best-fitting structures with the same modes; poor ones are stopped after a few evaluations."""

    def worth(found: ModalTrial) -> float:
        return search.cost(found.response) + _price(search.spectra) * found.structure.numbers

    variants = [search.fit(*one, SCREENED) for one in ((a, [b]) for a, b in _variants(search, trial, parts, zeros))]
    ahead = sorted(variants, key=worth)[:CONTINUED]
    return sorted((search.fit(found.structure, [found.values]) for found in ahead), key=worth)


def _left_out(search: ModalSearch, trial: ModalTrial) -> tuple[ModalTrial, np.ndarray]:
    """Return the trial, and the errors of its structure at each fold and frequency after a fit to the other folds."""
    spectra, found = search.spectra, []
    for fold in range(len(spectra.input)):
        others = search.without(fold)
        response = others.fit(trial.structure, [trial.values], FEW_EVALUATIONS).response
        found.append(search.scale * spectra.errors(response)[fold] / search.variance)
    return trial, np.array(found)


#: Numbers of poles and zeros of the named continuous models.
CONTINUOUS = {"first_order": (1, 0), "second_order": (2, 0), "second_order_zero": (2, 1), "third_order": (3, 0)}
#: Linear stages (dynamics after the hysteresis) with a structure chosen by the user, and their descriptions.
STAGES = {
    "first_order": "continuous, 1 pole, by output error",
    "second_order": "continuous, 2 poles (mass, damper, spring), by output error",
    "second_order_zero": "continuous, 2 poles and 1 zero, by output error",
    "third_order": "continuous, 3 poles, by output error",
    "arx": "discrete, by least squares; orders chosen by an information criterion",
    "arx2": "discrete, a1, a2, b0 and b1, by least squares",
    "frequency_response": "discrete, by a matrix fraction of Welch's frequency response; order chosen automatically",
}
#: Linear stage with lag, delay and modes, whose structure is chosen by the prediction of held-out segments.
MODES = "modes"


@dataclass(frozen=True, eq=False)
class LinearStage:
    """Dynamics with unit DC gain, and the gain separately."""

    dynamics: LinearParameters
    gain: float  #: gain, offset: Output = gain · dynamics(w) + offset, in SI units; :data:`MODES` has no offset.
    offset: float
    fitted: int  #: Number of fitted parameters.
    numbers: dict[str, float]  #: Figures for the user, by names with units.
    part: LinearPart  #: Lag, delay and modes in continuous time; empty for :data:`STAGES`.
    transfer_function: tuple[tuple[float, ...], tuple[float, ...]] | None = None  #: Dynamics with unit DC gain.
    rmse: float = math.nan  #: RMS error of the simulated output [m], if the output was fitted.
    warnings: tuple[str, ...] = ()
    converged: bool = True
    deviations: dict[str, float] = field(default_factory=dict)  #: As in :class:`ModalTrial`.


def fit_stage(
    w,
    y,
    sample_time: float,
    kind: str,
    skip: int = 0,
    *,
    intersample: str = "zoh",
    initial: str = "zero",
    parts: Sequence[str] = PAIR,
    late: int = 0,
    zeros: bool = True,
    accepted: Callable[[float], bool] | None = None,
) -> LinearStage:
    """Fit the dynamics between the output of the hysteresis and the measurement: one of :data:`STAGES`, or MODES.

    ``intersample`` and ``initial`` apply to continuous stages only; ``parts``, ``late``, ``zeros`` and ``accepted`` (a
    function that returns whether a mode may have a given frequency [Hz]) apply to :data:`MODES` only.

    Units: ``w`` [m], ``y`` [m], ``sample_time`` [s], ``late`` [samples].
    """
    if kind == MODES:
        spectra = segment_spectra(w, y, sample_time, skip, late)
        return _modal_stage(spectra, (w, y, skip), parts, zeros, accepted)
    if kind in CONTINUOUS:
        return _continuous_stage(w, y, sample_time, kind, skip, intersample, initial)
    w, y = np.asarray(w, dtype=float)[skip:], np.asarray(y, dtype=float)[skip:]
    if kind in ("arx", "arx2"):
        orders = ArxOrders(2, 2, 1) if kind == "arx2" else suggest_arx_orders(w, y, sample_time, offset=True)
        found = fit_arx(w, y, sample_time, orders, offset=True)
        model, offset = found.model, found.offset / float(np.sum(found.denominator))
        numbers = {**dict(zip(("na", "nb", "delay_samples"), map(float, orders), strict=True)), "fpe_m2": found.fpe}
        return _unit_stage(model, offset, sum(orders[:2]) + 1, numbers, None, found.warnings)
    if kind == "frequency_response":
        fraction = identify_matrix_fraction(welch_response(w, y, sample_time))
        model = fraction.model
        offset = float(np.mean(y) - model.dc_gain * np.mean(w))
        numbers = {"order": float(model.order)}
        return _unit_stage(model, offset, 2 * model.order + 1, numbers, None, tuple(fraction.warnings))
    raise IdentificationError(f"linear = {kind!r}: must be one of {', '.join(STAGES)}")


def _modal_stage(spectra: SegmentSpectra, samples: tuple, parts, zeros: bool, accepted) -> LinearStage:
    """Choose lag, delay and accepted modes; if there are modes, refine the fit on the ``samples`` (w, y, first)."""
    pair = tuple(part for part in PAIR if part in parts)
    found = choose_dynamics(spectra, pair, zeros=zeros, accepted=accepted)
    if found.structure.modes and REFINED[0] <= spectra.samples <= REFINED[1]:
        refined = TimeSearch(spectra, *samples).refined(found)
        is_accepted = accepted is None or all(accepted(mode.frequency) for mode in refined.part.modes)
        found = refined if is_accepted and refined.gain > 0.0 else found
    part = found.part
    return LinearStage(
        part.dynamics(spectra.sample_time),
        found.gain,
        0.0,
        found.structure.numbers,
        part.described()[0],
        part,
        deviations=found.deviations,
    )


def _continuous_stage(w, y, sample_time: float, kind: str, skip: int, intersample: str, initial: str) -> LinearStage:
    poles, zeros = CONTINUOUS[kind]
    found = fit_transfer_function(
        w, y, sample_time, Structure(poles, zeros, intersample, initial, offset=True), skip=skip
    )
    numbers = {}
    for number, pole in enumerate(sorted(found.poles, key=abs)):
        if pole.imag >= 0.0:
            numbers[f"pole_{number + 1}_hz"] = float(abs(pole) / (2.0 * np.pi))
            numbers[f"pole_{number + 1}_damping"] = float(-pole.real / abs(pole))
    if not found.dc_gain > 0.0:
        raise FitError(f"the DC gain of the linear fit is {found.dc_gain:.3g}: the output moves against the input")
    function = (
        tuple((np.asarray(found.numerator) / found.dc_gain).tolist()),
        tuple(np.asarray(found.denominator).tolist()),
    )
    count = poles + zeros + 2
    stage = _unit_stage(found.discrete(), found.offset, count, numbers, function, found.warnings, found.converged)
    return replace(stage, rmse=float(np.sqrt(found.mse)))


def _unit_stage(model: LinearModel, offset, fitted, numbers, function, warnings, converged=True) -> LinearStage:
    gain = float(model.dc_gain)
    if not gain > 0.0:
        raise FitError(f"the DC gain of the linear fit is {gain:.3g}: the output moves against the input")
    dynamics = model.linear_parameters()
    return LinearStage(
        dynamics,
        gain,
        float(offset),
        fitted,
        numbers,
        LinearPart(),
        function,
        warnings=tuple(warnings),
        converged=converged,
    )


#: A recording that condensing does not reduce to this number of samples counts as fast.
FAST_SAMPLES = 12000
#: Number of samples of fast recordings that are used in the search for creep, or more until they cover the voltage
#: range.
SEARCHED = 8000
#: Number of samples of fast recordings that are used for the final weights, or more until they cover the voltage range.
SETTLED = 24000
TURNS = 2
#: The hysteresis loops themselves contain power up to this harmonic of the drive, so a resonance at these frequencies
#: counts only if in at least one segment more than the fraction LEAST_POWER of the voltage's power lies within the
#: relative distance BAND of the resonance frequency.
HARMONICS = 10
#: Least number of cycles of the drive in such a segment, unless the whole recording has fewer.
CYCLES = 4.0
#: A mode with a damping ratio below this value is a resonance, which a lag cannot represent.
SHARP = 0.3


def found_with(fit_function, voltage, displacement, sample_time: float, parts, skip: int | None = None):
    """Fit a hysteresis with the dynamics after it.

    Units: ``voltage`` [V], ``displacement`` [m], ``sample_time`` [s].
    """
    if "modes" in parts:
        return TurnSearch(fit_function, voltage, displacement, sample_time, parts, skip).run()
    return fit_function(voltage, displacement, sample_time, linear=parts)


class TurnSearch:
    """The search on one recording, see :func:`found_with`."""

    def __init__(self, fit_function, voltage, displacement, sample_time: float, parts, skip: int | None):
        self.fit_function, self.sample_time, self.parts = fit_function, sample_time, tuple(parts)
        self.voltage, self.displacement = (np.asarray(values, dtype=float) for values in (voltage, displacement))
        coarse = condense(self.voltage, self.displacement, sample_time, skip)
        self.first, self.samples = coarse.skipped, len(coarse.voltage)
        self.creeps = tuple(part for part in self.parts if part == "creep")

    def run(self) -> HammersteinFit:
        """Return the simplest fit, unless another fit has a clearly smaller residual."""
        found, kept = [], {}
        if self.samples <= FAST_SAMPLES:
            together = self.fit(linear=tuple(part for part in self.parts if part != "modes"))
            found.append(together)
            # this structure of the hysteresis suffices to choose the dynamics; settled() chooses it again with these
            # dynamics
            kept = {"like": together.structure} if together.structure is not None else {}
            # samples that do not resolve a lag or delay of one sample do not resolve faster dynamics either
            if not together.synchronous:
                found += self.settled(together, sharp=True)
        # small loops are less steep than large ones; without a hysteresis, a lag parallel to the modes would fit this
        # difference and later replace part of the loops
        start = self.choose(self.voltage, zeros=False).part
        with contextlib.suppress(ParameterError, IdentificationError):
            if start.modes:
                # the structure of the hysteresis that was chosen with other modes is also right with these modes
                like = found[-1].structure if len(found) > 1 else None
                found += self.settled(self.fit(SEARCHED, linear=Known(start, self.creeps), **kept), like=like)
            elif not found:
                # a lag fitted to the spectra alone would include the phase lag of the loops
                together = self.fit(SEARCHED, linear=tuple(part for part in self.parts if part != "modes"))
                kept = {"like": together.structure} if together.structure is not None else {}
                found.append(self.fit(SETTLED, linear=Known(together.linear_part), **kept))
                found += self.settled(together, sharp=True)
        if not found:
            raise IdentificationError(
                "no hysteresis model can be fitted together with the identified dynamics; try --linear lag,delay,creep"
            )
        best, *others = found
        for fit in others:  # the simplest structure is tried first
            best = fit if FAST_DYNAMICS.improves(fit.rmse, best.rmse) else best
        return best

    def fit(self, longest: int | None = None, **options) -> HammersteinFit:
        """Fit the hysteresis to the first ``longest`` samples, or to more until they cover the voltage range."""
        v, count = self.voltage, None
        if longest is not None:
            near = 0.02 * np.ptp(v)
            reached = max(np.flatnonzero(v >= v.max() - near)[0], np.flatnonzero(v <= v.min() + near)[0])
            count = max(longest, int(reached) + longest // 4, self.first + longest)
        return self.fit_function(v[:count], self.displacement[:count], self.sample_time, **options)

    def choose(self, moved, late: int = 0, zeros: bool = True) -> LinearStage:
        """Choose the dynamics between their input ``moved``, shape (N,), and the measured displacement."""
        how: dict[str, Any] = dict(parts=self.parts, late=late, zeros=zeros, accepted=self.excited)
        return fit_stage(moved, self.displacement, self.sample_time, MODES, self.first, **how)

    def excited(self, frequency: float) -> bool:
        """Return whether a resonance at a frequency can be distinguished from the shape of the loops.

        At low harmonics of the drive the hysteresis itself produces movement, so the voltage must have power there.
        """
        v = self.voltage[self.first :]
        cycles = 0.5 * max(len(turning_points(v)) - 1, 1)
        if frequency > HARMONICS * cycles / (len(v) * self.sample_time):
            return True
        # a window over the whole recording would suppress the samples at its ends
        length = int(len(v) / max(1.0, min(float(LENGTHS), cycles / CYCLES)))
        # at least four lines of the spectrum within the band
        length = min(max(length, math.ceil(2.0 / (BAND * frequency * self.sample_time))), len(v))
        window = np.hanning(length)
        near = np.abs(np.fft.rfftfreq(length, self.sample_time) / frequency - 1.0) < BAND
        for start in np.unique(np.linspace(0, len(v) - length, 2 * (len(v) // length) + 1).astype(int)):
            part = v[start : start + length]
            power = np.abs(np.fft.rfft((part - part.mean()) * window)) ** 2
            if float(power[near].sum()) > LEAST_POWER * float(power.sum()):
                return True
        return False

    def settled(self, fit: HammersteinFit, sharp: bool = False, like=None) -> list[HammersteinFit]:
        """Alternately choose the dynamics after the hysteresis and refit the hysteresis and its creep.

        With ``sharp``, do this only if there is a resonance, which the present fit cannot represent. The first
        iteration chooses the structure of the hysteresis again, unless ``like`` gives the structure of another fit.
        """
        found: list[HammersteinFit] = []
        stage = None
        for _ in range(TURNS):
            late = max(round(fit.linear_part.group_delay / self.sample_time), 0)
            moved = replace(fit, dynamics=LinearParameters(), synchronous=True).simulate(self.voltage)
            before_stage, stage = stage, self.choose(moved, late)
            part = stage.part
            if sharp and not any(mode.damping < SHARP for mode in part.modes):
                break
            before = fit.linear_part
            creep: dict[str, Any] = dict(
                creep_rate=before.creep_rate, longest_time=before.longest_time, settled=before.settled
            )
            like = fit.structure if found else like
            kept = {} if like is None else {"like": like}
            try:
                fit = self.fit(SETTLED, linear=Known(replace(part, **creep), self.creeps), **kept)
                fit = replace(fit, deviations={**fit.deviations, **_less_certain(stage, before_stage)})
            except (ParameterError, IdentificationError):  # with these dynamics, the hysteresis has no valid weights
                break
            if not found or fit.rmse < found[0].rmse:
                found = [fit]
        return found


def _less_certain(stage: LinearStage, before: LinearStage | None) -> dict[str, float]:
    """Return the deviations of a linear stage, enlarged by its differences from the previous iteration.

    Errors of the hysteresis model change the identified dynamics, but do not appear in the scatter of the response.
    """
    earlier = {} if before is None else before.numbers
    return {
        name: float(np.hypot(size, stage.numbers[key] - earlier.get(key, stage.numbers[key])))
        for name, size in stage.deviations.items()
        if (key := {"lag": "lag_s", "delay": "delay_s"}.get(name, name)) in stage.numbers
    }


#: A parameter counts as at a bound of its search if it differs from the bound by at most this fraction.
AT_BOUND = 0.01


def modes_at_bounds(part: LinearPart | None) -> tuple[str, ...]:
    """Return a sentence for each mode whose damping or frequency is at a bound of its search."""
    found = []
    for mode in part.modes if part is not None else ():
        ends = [("damping", mode.damping, end) for end in DAMPING_RANGE]
        ends += [("frequency times sample time", mode.frequency * part.hold, HIGHEST)] if part and part.hold else []
        for name, value, end in ends:
            if abs(value - end) <= AT_BOUND * end:
                found.append(
                    f"mode {mode.frequency:.4g} Hz: {name} = {value:.3g} is at a search bound, so the recording "
                    "does not determine this mode; record a multisine that excites it (hysteresis excite --recipe "
                    "multisine), or leave modes out (--linear lag,delay,creep)"
                )
    return tuple(found)


def with_fast_dynamics(chain: PlantModel, fast: IdentificationData, skip: int) -> tuple[PlantModel, float]:
    """Return ``chain`` with the dynamics and the sample rate of the fast recording, and the gain of small movements.

    Lag, delay and modes are in series, without zeros: small loops are less steep than large ones, and zeros would
    represent this difference.
    """
    if not chain.invertible:
        raise IdentificationError(
            f"model {chain.hysteresis.type}: its hysteresis contains dynamics, so none can be added after it; "
            "choose another model"
        )
    slow = chain.continuous
    moved = before_dynamics(chain, fast.input, fast.sample_time)
    # a measurement responds to earlier voltages only
    found = fit_stage(moved, fast.output, fast.sample_time, MODES, skip, late=1, zeros=False)
    part = replace(found.part, creep_rate=slow.creep_rate, longest_time=slow.longest_time)
    kept: dict[str, Any] = dict(transfer_function=None, sample_time=fast.sample_time)
    dynamics = part.dynamics(fast.sample_time)
    return replace(chain, dynamics=dynamics, linear_part=part, synchronous=False, **kept), found.gain
