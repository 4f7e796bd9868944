# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Frequency responses with their uncertainty: Welch's method for any input, averaging for periodic multisines.

Shapes: a response has shape (F, n_y, n_u); variances are E|G - Ĝ|² of each complex entry of the average.

In a closed loop the noise of the output is in the input too, and S_yu S_uu⁻¹ is drawn towards the inverse of the
controller. With the excitation e from outside, which the noise knows nothing of, S_ye S_ue⁻¹ is not (the indirect
method): all functions take it as ``excitation``, and what is left is judged by y - G u all the same.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, chapters 2.6 and 4.3.
.. [2] Bendat & Piersol, Random Data, 2010, chapter 9 (variance from the coherence).
.. [3] Welch, IEEE Trans. Audio Electroacoust. 15, 1967, eq. 16 (overlapping segments).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from hysteresis_ros.identification.data import DataError, finite_array, refuse_short
from hysteresis_ros.identification.data_checks import CONSTANT

#: Lines of an input with less than this share of its strongest line count as not excited.
EXCITED = 1e-3
#: Below this coherence a response is hardly better than noise.
POOR_COHERENCE = 0.5


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """A measured frequency response.

    Parameters
    ----------
    frequency : ndarray, shape (F,)
        [Hz]
    response : ndarray, shape (F, n_y, n_u)
        Complex, output unit per input unit.
    sample_time : float
        Of the data [s].
    total_variance : ndarray, shape (F, n_y, n_u), or None
        Noise and nonlinear distortion together, [(output unit/input unit)²]; None where it cannot be told.
    noise_variance : ndarray, shape (F, n_y, n_u), or None
        Noise alone, from the differences of the periods.
    coherence : ndarray, shape (F, n_y), or None
        Share of each output's power that the inputs explain linearly.
    input_unit, output_unit : str
        SI units.
    warnings : tuple of str
        Poor coherence, few averages …
    degrees : float or None
        How many independent complex values the variance is a mean of: of the total one, otherwise of the noise's.
    """

    frequency: np.ndarray
    response: np.ndarray
    sample_time: float
    total_variance: np.ndarray | None = None
    noise_variance: np.ndarray | None = None
    coherence: np.ndarray | None = None
    input_unit: str = "V"
    output_unit: str = "m"
    warnings: tuple[str, ...] = ()
    degrees: float | None = None

    def band(self, low: float, high: float) -> FrequencyResponse:
        """Return the lines from ``low`` to ``high`` [Hz], both included.

        Parameters
        ----------
        low, high : float

        Raises
        ------
        DataError
            No line is in the band.
        """
        keep = (self.frequency >= low) & (self.frequency <= high)
        if not keep.any():
            there = f"{self.frequency[0]:.6g} … {self.frequency[-1]:.6g} Hz"
            raise DataError("band", f"no line in {low:g} … {high:g} Hz; the response has {there}")
        names = ("frequency", "response", "total_variance", "noise_variance", "coherence")
        kept = {name: None if getattr(self, name) is None else getattr(self, name)[keep] for name in names}
        others = tuple(text for text in self.warnings if not text.startswith("coherence"))
        return replace(self, **kept, warnings=(*others, *_poor_coherence(kept["coherence"])))

    def radius(self, probability: float = 0.95) -> np.ndarray:
        """Return the radius of the circle around each entry that holds the true one, shape (F, n_y, n_u).

        |Ĝ - G|²/σ̂² is distributed as F(2, 2ν) for a variance of ν complex degrees of freedom [1]_.

        Parameters
        ----------
        probability : float
            That it does.

        Raises
        ------
        DataError
            The variance is not known.
        """
        variance = self.noise_variance if self.total_variance is None else self.total_variance
        if variance is None or self.degrees is None:
            raise DataError("short", "one period of one realisation has no variance; record more periods")
        return np.sqrt(variance * scipy.stats.f.ppf(probability, 2.0, 2.0 * self.degrees))

    @property
    def single(self) -> np.ndarray:
        """The response of the first output to the first input, shape (F,)."""
        return self.response[:, 0, 0]


def welch_response(
    u,
    y,
    sample_time: float,
    *,
    segment: int | None = None,
    window: str = "hann",
    input_unit="V",
    output_unit="m",
    excitation=None,
) -> FrequencyResponse:
    """Estimate the response ``S_yu S_uu⁻¹`` from averaged spectra of overlapping segments (half of each).

    Parameters
    ----------
    u : array_like, shape (N,) or (N, n_u)
        Inputs [SI].
    y : array_like, shape (N,) or (N, n_y)
        Outputs [SI].
    sample_time : float
        [s]
    segment : int, optional
        Samples a segment; by default such that there are about 8 n_u + 8 segments. Longer ones resolve sharper
        resonances, shorter ones average more.
    window : str
        Any window of SciPy.
    input_unit, output_unit : str
        SI units.
    excitation : array_like, shape (N,) or (N, n_u), optional
        What excites from outside in a closed loop; the inputs themselves by default.

    Raises
    ------
    DataError
        Too short for two segments an input, constant input, values that are not finite.
    """
    u, y = _columns("input", u), _columns("output", y)
    e = u if excitation is None else _columns("excitation", excitation)
    if not len(u) == len(y) == len(e):
        raise DataError("shape", f"the input has {len(u)} samples, the output {len(y)}, the excitation {len(e)}")
    N, inputs = u.shape
    refuse_short(N, 64, "a frequency response")
    _refuse_constant(e)
    segment = segment or max(32, min(N // 2, int(2 * N / (9 + 8 * inputs))))
    step = segment - segment // 2
    count = (N - segment) // step + 1
    if segment > N or count <= inputs:
        raise DataError("short", f"{N} samples give {max(count, 0)} segments of {segment}; {inputs + 1} are needed")
    both = np.concatenate([u, y, *([] if excitation is None else [e])], axis=1)
    frequency, S = _spectra(both, sample_time, segment, step, window)
    outputs = slice(inputs, inputs + y.shape[1])
    exciting = slice(0, inputs) if excitation is None else slice(outputs.stop, None)
    power = np.einsum("fii->fi", S[:, exciting, exciting]).real.sum(axis=1)
    excited = (np.abs(np.linalg.det(S[:, :inputs, exciting])) > 0.0) & (power > EXCITED**2 * np.max(power))
    frequency, S = frequency[excited], S[excited]
    inverse = np.linalg.inv(S[:, :inputs, exciting])
    response = S[:, outputs, exciting] @ inverse
    # what is left: y - G u
    seen = response @ S[:, :inputs, outputs]
    left = S[:, outputs, outputs] - seen - seen.conj().transpose(0, 2, 1)
    left = left + response @ S[:, :inputs, :inputs] @ response.conj().transpose(0, 2, 1)
    averages = _effective_averages(count, segment, step, window)
    rest = np.einsum("fii->fi", left).real.clip(0.0) * averages / max(averages - inputs, 0.5)
    spread = np.einsum("fji,fjk,fki->fi", inverse.conj(), S[:, exciting, exciting], inverse).real
    variance = rest[:, :, None] * spread[:, None, :] / averages
    coherence = _coherence(S, outputs, exciting)
    warnings = []
    poor = float(np.mean(coherence < POOR_COHERENCE))
    if poor > 0.1:
        warnings.append(
            f"coherence below {POOR_COHERENCE} at {100 * poor:.0f} % of the lines: noise or weak excitation"
        )
    if averages < inputs + 4:
        warnings.append(f"only {averages:.1f} independent averages: the variance is rough; record longer")
    units = input_unit, output_unit
    degrees = max(averages - inputs, 0.5)
    return FrequencyResponse(
        frequency, response, sample_time, variance, None, coherence, *units, tuple(warnings), degrees
    )


def _spectra(both, sample_time, segment, step, window):
    """Return frequencies and the spectra of all channels against each other, shape (F, channels, channels)."""
    options = dict(
        fs=1.0 / sample_time, window=window, nperseg=segment, noverlap=segment - step, detrend="constant", axis=0
    )
    pairs = [
        [scipy.signal.csd(both[:, i], both[:, j], **options) for j in range(both.shape[1])]
        for i in range(both.shape[1])
    ]
    # SciPy's csd(a, b) is conj(a) b: transposed, so that S[i, j] is the spectrum of i against j
    S = np.array([[spectrum for _, spectrum in row] for row in pairs]).transpose(2, 1, 0)
    # the line at half the sample rate is real for a real signal: no phase can be read there
    kept = slice(1, -1 if segment % 2 == 0 else None)
    return pairs[0][0][0][kept], S[kept]


def _coherence(S, outputs, exciting):
    """Return the share of each output's power that the excitation explains linearly, shape (F, n_y)."""
    across = S[:, outputs, exciting]
    explained = np.einsum(
        "fij,fji->fi", across @ np.linalg.inv(S[:, exciting, exciting]), across.conj().transpose(0, 2, 1)
    )
    power = np.einsum("fii->fi", S[:, outputs, outputs]).real
    return np.clip(explained.real / np.maximum(power, 1e-300), 0.0, 1.0)


def multisine_response(
    u, y, sample_time: float, period: int | None = None, input_unit="V", output_unit="m", excitation=None
) -> FrequencyResponse:
    """Average a periodic multisine over its periods and realisations (steady state, whole periods).

    Within each realisation the periods are averaged, and their differences give the noise; over the realisations the
    response is the least-squares solution of Y = G U at each line, and what it leaves is noise and nonlinear distortion
    together. With one realisation an input there is nothing left: the total variance is None then.

    Parameters
    ----------
    u : array_like, shape (N,), (P, N) or (R, P, n_u, N)
        Inputs [SI]: N samples a period, P periods, R realisations (or experiments) of n_u inputs. With ``period`` a
        plain sequence of whole periods, shape (P · period,), is cut up.
    y : array_like
        Outputs [SI], likewise with n_y outputs.
    sample_time : float
        [s]
    period : int, optional
        Samples a period.
    input_unit, output_unit : str
        SI units.
    excitation : array_like, optional
        What excites from outside in a closed loop, in the shape of ``u``; the inputs themselves by default.

    Raises
    ------
    DataError
        Shapes differ, fewer realisations than inputs, constant input, values that are not finite.
    """
    u, y = experiments("input", u, period), experiments("output", y, period)
    e = u if excitation is None else experiments("excitation", excitation, period)
    if u.shape[:2] != y.shape[:2] or u.shape[3] != y.shape[3] or u.shape != e.shape:
        raise DataError("shape", f"input {u.shape} and output {y.shape} differ in realisations, periods or samples")
    realisations, periods, inputs, N = u.shape
    refuse_short(N, 16, "a period of a multisine")
    _refuse_constant(e.reshape(-1, 1))
    if inputs > realisations:
        raise DataError("short", f"{realisations} experiments cannot separate {inputs} inputs; {inputs} are needed")
    U, Y, E = (np.fft.rfft(part, axis=3)[..., 1 : (N + 1) // 2] / N for part in (u, y, e))
    strength = np.abs(E.mean(axis=1)).max(axis=(0, 1))
    excited = strength > EXCITED * strength.max()
    frequency = (np.arange(1, (N + 1) // 2) / (N * sample_time))[excited]
    U, Y, E = (part[..., excited] for part in (U, Y, E))
    response, total, noise = averaged(frequency, U, Y, E)
    warnings = []
    if periods == 1:
        warnings.append("one period: noise cannot be told from nonlinear distortion, and a transient not be seen")
    if realisations == inputs:
        warnings.append("one realisation an input: nonlinear distortion cannot be told; repeat with other phases")
    degrees = _degrees(realisations, periods, inputs)
    units = input_unit, output_unit
    return FrequencyResponse(frequency, response, sample_time, total, noise, None, *units, tuple(warnings), degrees)


def averaged(frequency, U, Y, E):
    """Return response, total variance and variance of the noise from spectra of periods; None where not known.

    Parameters
    ----------
    frequency : ndarray, shape (F,)
        [Hz], for what is said of a line.
    U, Y, E : ndarray of complex, shape (R, P, channels, F)
        Inputs, outputs, excitation.

    Raises
    ------
    DataError
        The experiments do not separate the inputs.
    """
    realisations, periods, inputs, _ = U.shape
    # (F, channels, R): averaged over the periods
    Um, Ym, Em = (part.mean(axis=1).transpose(2, 1, 0) for part in (U, Y, E))
    Eh = Em.conj().transpose(0, 2, 1)
    gram = Um @ Eh
    weak = np.linalg.cond(gram) > 1e10
    if weak.any():
        raise DataError("rank", f"the experiments do not separate the inputs at {frequency[weak][0]:.6g} Hz and others")
    inverse = np.linalg.inv(gram)
    response = Ym @ Eh @ inverse
    spread = np.einsum("fji,fjk,fki->fi", inverse.conj(), Em @ Eh, inverse).real
    noise = total = None
    if periods > 1:
        # the part of the output's scatter that the input's own scatter explains is no noise of the output
        dU, dY = (part - part.mean(axis=1, keepdims=True) for part in (U, Y))
        rest = dY - np.einsum("fij,rpjf->rpif", response, dU)
        per_line = np.sum(np.abs(rest) ** 2, axis=(0, 1)).T / (realisations * (periods - 1) * periods)
        noise = per_line[:, :, None] * spread[:, None, :]
    if realisations > inputs:
        rest = Ym - response @ Um
        per_line = np.sum(np.abs(rest) ** 2, axis=2) / (realisations - inputs)
        total = per_line[:, :, None] * spread[:, None, :]
    return response, total, noise


def _degrees(realisations: int, periods: int, inputs: int) -> float | None:
    """Return the degrees of freedom of the variance that a band rests on."""
    if realisations > inputs:
        return float(realisations - inputs)
    return float(realisations * (periods - 1)) if periods > 1 else None


def _poor_coherence(coherence):
    poor = 0.0 if coherence is None else float(np.mean(coherence < POOR_COHERENCE))
    text = f"coherence below {POOR_COHERENCE} at {100 * poor:.0f} % of the lines: noise or weak excitation"
    return [text] if poor > 0.1 else []


def _effective_averages(count, segment, step, window):
    """Return the number of independent segments that ``count`` overlapping ones are worth (Welch, eq. 16)."""
    shape = scipy.signal.get_window(window, segment)
    correlation = (shape[step:] @ shape[: segment - step] / (shape @ shape)) ** 2
    return count / (1.0 + 2.0 * correlation * (count - 1) / count)


def _columns(name, values):
    array = finite_array(name, values)
    return array.reshape(len(array), -1)


def experiments(name: str, values, period: int | None = None) -> np.ndarray:
    """Return signals of whole periods, shape (R, P, channels, N).

    Parameters
    ----------
    name : str
        What they are, for what is said of them.
    values : array_like
        Of shape (N,), (P, N) or (R, P, channels, N); with ``period`` (P · period,).
    period : int, optional
        [samples]

    Raises
    ------
    DataError
        They have another shape, or are not finite.
    """
    array = finite_array(name, values)
    if period is not None:
        if array.ndim != 1 or array.size % period:
            text = f"{name} of shape {array.shape} is no whole number of periods of {period} samples"
            raise DataError("shape", f"{text}; leave the start out, not the end of a period")
        array = array.reshape(-1, period)
    if array.ndim not in (1, 2, 4):
        raise DataError("shape", f"{name} has shape {array.shape}; it must be (N,), (P, N) or (R, P, channels, N)")
    return array if array.ndim == 4 else np.atleast_2d(array)[None, :, None, :]


def _refuse_constant(u):
    for i in range(u.shape[1]):
        if np.ptp(u[:, i]) <= CONSTANT * np.max(np.abs(u[:, i])):
            raise DataError("constant", f"input {i} is constant; a frequency response needs an input that moves")
