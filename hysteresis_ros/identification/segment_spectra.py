# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Spectra of the segments of a recording, to which the dynamics between two signals are fitted and by which judged.

A recording of any length becomes sums of a few thousand frequencies, so that a trial of a model costs a millisecond,
and segments that were left out judge it. Differences are taken of both signals before, and Hann's window: a strong slow
movement then leaks little into the weak fast one, by which a resonance shows.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, sections 2.6 and 4.3 (noise of
   averaged spectra, weighted cost).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: The recording is cut into this many lengths of a segment; segments overlap by half.
LENGTHS = 8
#: Segments side by side that are left out together, so many times.
FOLDS = 4
#: Neighbouring frequencies are put together up to this part of the frequency.
RESOLUTION = 2e-3
#: The noise is taken as smooth over this part of an octave to both sides, and over so many frequencies.
NOISE_OCTAVE, NOISE_BINS = 0.25, 8


@dataclass(frozen=True, eq=False)
class SegmentSpectra:
    """Sums of the spectra of an input w and an output y over the segments of each fold.

    Parameters
    ----------
    frequencies : ndarray, shape (n,)
        [Hz], rising.
    input, output : ndarray, shape (F, n)
        Σ |W|² and Σ |Y|².
    cross : ndarray of complex, shape (F, n)
        Σ Y W*.
    samples : float
        Independent samples in all.
    segments : int
        How many were added up.
    sample_time : float
        [s]
    """

    frequencies: np.ndarray
    input: np.ndarray
    output: np.ndarray
    cross: np.ndarray
    samples: float
    segments: int
    sample_time: float

    @property
    def resolution(self) -> float:
        """Distance of the lowest frequencies [Hz]."""
        return float(self.frequencies[1] - self.frequencies[0])

    def errors(self, response) -> np.ndarray:
        """Return Σ |Y - G W|² of each fold and frequency, shape (F, n).

        Parameters
        ----------
        response : ndarray of complex, shape (n,)
            G.
        """
        size = np.abs(response) ** 2 * self.input - 2.0 * np.real(np.conj(response) * self.cross) + self.output
        return np.maximum(size, 0.0)

    def noise(self, response) -> np.ndarray:
        """Return the mean Σ |Y - G W|² of a fold, smooth over the frequency, shape (n,).

        Parameters
        ----------
        response : ndarray of complex, shape (n,)
            G.
        """
        return self.smooth(self.errors(response).mean(axis=0))

    def incoherent(self) -> np.ndarray:
        """Return the mean |Y|² of a segment that no linear response to w explains, smooth over the frequency, (n,)."""
        tiny = np.finfo(float).tiny
        explained = np.abs(self.cross.sum(axis=0)) ** 2 / np.maximum(self.input.sum(axis=0), tiny)
        left = np.maximum(self.output.sum(axis=0) - explained, 0.0)
        return self.smooth(left) / max(self.segments - 1, 1)

    def smooth(self, values, octave: float = NOISE_OCTAVE) -> np.ndarray:
        """Return values, shape (n,), averaged over part of an octave to both sides, shape (n,).

        Parameters
        ----------
        values : ndarray, shape (n,)
        octave : float
        """
        f, n = self.frequencies, len(self.frequencies)
        low = np.minimum(np.searchsorted(f, f * 2.0**-octave), np.maximum(np.arange(n) - NOISE_BINS, 0))
        high = np.maximum(np.searchsorted(f, f * 2.0**octave), np.minimum(np.arange(n) + NOISE_BINS, n))
        total = np.append(0.0, np.cumsum(values))
        return (total[high] - total[low]) / (high - low)


def segment_spectra(w, y, sample_time: float, first: int = 0, late: int = 0) -> SegmentSpectra:
    """Return the spectra of two signals of one rate.

    Parameters
    ----------
    w, y : ndarray, shape (N,)
    sample_time : float
        [s]
    first : int
        Samples left out at the start.
    late : int
        By how many samples y comes after w, about: its segments are cut so much later, which is put right in its phase.
    """
    w, y = (np.diff(np.asarray(signal, dtype=float)[first:]) for signal in (w, y))
    w, y = w[: w.size - late], y[late:]
    length = 2 * max(w.size // (2 * LENGTHS), 16)
    window = np.hanning(length)
    starts = range(0, w.size - length + 1, length // 2)
    place = np.arange(2, length // 2)
    turned = np.exp(-2j * np.pi * place * late / length)
    edges = [0]
    while edges[-1] < place.size:
        edges.append(edges[-1] + max(int(RESOLUTION * place[edges[-1]]), 1))
    edges = np.array(edges[:-1])
    sums = [np.zeros((FOLDS, edges.size)), np.zeros((FOLDS, edges.size)), np.zeros((FOLDS, edges.size), dtype=complex)]
    for number, start in enumerate(starts):
        W, Y = (np.fft.rfft(window * signal[start : start + length])[place] for signal in (w, y))
        for total, value in zip(sums, (np.abs(W) ** 2, np.abs(Y) ** 2, Y * turned * np.conj(W)), strict=True):
            total[number * FOLDS // len(starts)] += np.add.reduceat(value, edges)
    frequencies = np.add.reduceat(place.astype(float), edges) / np.diff(np.append(edges, place.size))
    return SegmentSpectra(frequencies / (length * sample_time), *sums, float(w.size), len(starts), sample_time)
