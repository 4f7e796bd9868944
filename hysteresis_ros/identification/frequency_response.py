# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Measured frequency responses: estimates, their uncertainty, levels of nonlinear distortion, and files.

Shapes: a response has shape (F, n_y, n_u); variances are E|G - Ĝ|² of each complex entry of the averaged response.
Welch's method accepts any input; periodic multisines are averaged over periods and realisations.

With several inputs and outputs (:func:`response_matrix`), m inputs need at least m independent experiments at each
line. These are either orthogonal multisines (realisations in groups of m, whose phases differ by an orthogonal matrix),
or R ≥ m realisations with random phases at each input. Differences between the periods of a realisation are noise;
differences between realisations are noise and nonlinear distortion. Both are stored as covariances of the outputs,
because a disturbance usually affects several sensors.

In a closed loop the noise of the output is fed back to the input, which biases S_yu S_uu⁻¹ towards the inverse of the
controller. S_ye S_ue⁻¹ has no such bias, because the external excitation e is uncorrelated with the noise (indirect
method), so all functions accept e as ``excitation``. In both cases the residual is y - G u.

Noise, odd distortion and even distortion are separated at lines that are not excited. In a closed loop the input also
has content at these lines; the linear response to this content is subtracted first. A distortion level has the unit of
the response: it is the error of the response that would have the same effect on the output.

Files: NPZ, which can be read back completely, and CSV and YAML for other programs.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, chapters 2.6, 2.7
   (several inputs), 4 and 4.3 (best linear approximation).
.. [2] Bendat & Piersol, Random Data, 2010, chapter 9 (variance from the coherence).
.. [3] Welch, IEEE Trans. Audio Electroacoust. 15, 1967, eq. 16 (overlapping segments).
"""

from __future__ import annotations

import contextlib
import pathlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from hysteresis_ros.errors import IdentificationError, RecordingError
from hysteresis_ros.files import ArchiveError, read_arrays, read_heads, replacing
from hysteresis_ros.identification.data import CONSTANT, DataError, finite_array, refuse_short
from hysteresis_ros.identification.excitations import KINDS, Plan
from hysteresis_ros.units import UNITS

#: A line of an input counts as excited if its amplitude is above this fraction of the input's strongest line.
EXCITED = 1e-3
#: Coherence below which a line counts as poorly estimated.
POOR_COHERENCE = 0.5


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """A measured frequency response."""

    frequency: np.ndarray  #: shape (F,) [Hz]
    response: np.ndarray  #: shape (F, n_y, n_u); Complex, output unit per input unit.
    sample_time: float  #: Sample time of the data [s].
    #: shape (F, n_y, n_u); Variance of the response due to noise and nonlinear distortion together, [(output unit/input
    #: unit)²]; None if it cannot be estimated.
    total_variance: np.ndarray | None = None
    noise_variance: np.ndarray | None = None  #: shape (F, n_y, n_u); Noise alone, from the differences of the periods.
    #: shape (F, n_y); Fraction of each output's power that the inputs explain linearly.
    coherence: np.ndarray | None = None
    input_unit: str = "V"  #: input_unit, output_unit: SI units.
    output_unit: str = "m"
    warnings: tuple[str, ...] = ()  #: Poor coherence, few averages and others.
    #: Complex degrees of freedom of the total variance, or else of the noise variance.
    degrees: float | None = None

    def band(self, low: float, high: float) -> FrequencyResponse:
        """Return the lines from ``low`` to ``high`` [Hz], both included."""
        keep = (self.frequency >= low) & (self.frequency <= high)
        if not keep.any():
            there = f"{self.frequency[0]:.6g} … {self.frequency[-1]:.6g} Hz"
            raise DataError("band", f"no line in {low:g} … {high:g} Hz; the response has {there}")
        names = ("frequency", "response", "total_variance", "noise_variance", "coherence")
        kept: dict[str, Any] = {
            name: None if getattr(self, name) is None else getattr(self, name)[keep] for name in names
        }
        others = tuple(text for text in self.warnings if not text.startswith("coherence"))
        return replace(self, **kept, warnings=(*others, *_poor_coherence(kept["coherence"])))

    def radius(self, probability: float = 0.95) -> np.ndarray:
        """Return the radius of the circle around each entry that contains the true value with this probability.

        |Ĝ - G|²/σ̂² is distributed as F(2, 2ν) for a variance with ν complex degrees of freedom [1]_.
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
    """Estimate the response ``S_yu S_uu⁻¹`` from averaged spectra of segments that overlap by half.

    Units: ``sample_time`` [s].
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
    # residual: y - G u
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
        warnings.append(f"only {averages:.1f} independent averages: the variance is inaccurate; record longer")
    units = input_unit, output_unit
    degrees = max(averages - inputs, 0.5)
    return FrequencyResponse(
        frequency, response, sample_time, variance, None, coherence, *units, tuple(warnings), degrees
    )


def _spectra(both, sample_time, segment, step, window):
    """Return frequencies and the cross-spectra of all channels, shape (F, channels, channels)."""
    options = dict(
        fs=1.0 / sample_time, window=window, nperseg=segment, noverlap=segment - step, detrend="constant", axis=0
    )
    pairs = [
        [scipy.signal.csd(both[:, i], both[:, j], **options) for j in range(both.shape[1])]
        for i in range(both.shape[1])
    ]
    # SciPy's csd(a, b) averages conj(a) b; after the transposition, S[i, j] is the average of i conj(j)
    S = np.array([[spectrum for _, spectrum in row] for row in pairs]).transpose(2, 1, 0)
    # omits the mean, and half the sample rate, where the spectrum of a real signal is real and has no phase
    kept = slice(1, -1 if segment % 2 == 0 else None)
    return pairs[0][0][0][kept], S[kept]


def _coherence(S, outputs, exciting):
    """Return the fraction of each output's power that the excitation explains linearly, shape (F, n_y)."""
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

    Within each realisation the periods are averaged, and their differences give the noise. At each line the response is
    the least-squares solution of Y = G U over the realisations; the residual of this solution is noise and nonlinear
    distortion together. With one realisation per input there is no residual, and the total variance is None.

    Units: ``sample_time`` [s].
    """
    u, y = experiments("input", u, period), experiments("output", y, period)
    e = u if excitation is None else experiments("excitation", excitation, period)
    if u.shape[:2] != y.shape[:2] or u.shape[3] != y.shape[3] or u.shape != e.shape:
        raise DataError("shape", f"input {u.shape} and output {y.shape} differ in realisations, periods or samples")
    realisations, periods, inputs, N = u.shape
    refuse_short(N, 16, "a period of a multisine")
    _refuse_constant(e.reshape(-1, 1))
    if inputs > realisations:
        text = f"{realisations} experiments cannot separate {inputs} inputs"
        raise DataError("short", f"{text}; at least {inputs} are needed")
    U, Y, E = (np.fft.rfft(part, axis=3)[..., 1 : (N + 1) // 2] / N for part in (u, y, e))
    strength = np.abs(E.mean(axis=1)).max(axis=(0, 1))
    excited = strength > EXCITED * strength.max()
    frequency = (np.arange(1, (N + 1) // 2) / (N * sample_time))[excited]
    U, Y, E = (part[..., excited] for part in (U, Y, E))
    response, total, noise = averaged(frequency, U, Y, E)
    warnings = []
    if periods == 1:
        warnings.append(
            "one period: noise cannot be separated from nonlinear distortion, and a transient remains undetected"
        )
    if realisations == inputs:
        warnings.append("one realisation per input: nonlinear distortion cannot be estimated; repeat with other phases")
    degrees = _degrees(realisations, periods, inputs)
    units = input_unit, output_unit
    return FrequencyResponse(frequency, response, sample_time, total, noise, None, *units, tuple(warnings), degrees)


def averaged(frequency, U, Y, E):
    """Return response, total variance and noise variance from spectra of periods; an unknown variance is None.

    Units: ``frequency`` [Hz].
    """
    realisations, periods, inputs, _ = U.shape
    # (F, channels, R): averaged over the periods
    Um, Ym, Em = (part.mean(axis=1).transpose(2, 1, 0) for part in (U, Y, E))
    Eh = Em.conj().transpose(0, 2, 1)
    gram = Um @ Eh
    weak = np.linalg.cond(gram) > 1e10
    if weak.any():
        text = f"the experiments do not separate the inputs, for example at {frequency[weak][0]:.6g} Hz"
        raise DataError("rank", f"{text}; excite the inputs with different phases")
    inverse = np.linalg.inv(gram)
    response = Ym @ Eh @ inverse
    spread = np.einsum("fji,fjk,fki->fi", inverse.conj(), Em @ Eh, inverse).real
    noise = total = None
    if periods > 1:
        # variations of the output that the input causes are not noise of the output
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
    """Return the complex degrees of freedom of the total variance, or, if this is not known, of the noise variance."""
    if realisations > inputs:
        return float(realisations - inputs)
    return float(realisations * (periods - 1)) if periods > 1 else None


def _poor_coherence(coherence):
    poor = 0.0 if coherence is None else float(np.mean(coherence < POOR_COHERENCE))
    text = f"coherence below {POOR_COHERENCE} at {100 * poor:.0f} % of the lines: noise or weak excitation"
    return [text] if poor > 0.1 else []


def _effective_averages(count, segment, step, window):
    """Return how many independent segments have the same variance as ``count`` overlapping ones (Welch, eq. 16)."""
    shape = scipy.signal.get_window(window, segment)
    correlation = (shape[step:] @ shape[: segment - step] / (shape @ shape)) ** 2
    return count / (1.0 + 2.0 * correlation * (count - 1) / count)


def _columns(name, values):
    array = finite_array(name, values)
    return array.reshape(len(array), -1)


def experiments(name: str, values, period: int | None = None) -> np.ndarray:
    """Return signals of whole periods, shape (R, P, channels, N).

    Units: ``period`` [samples].
    """
    array = finite_array(name, values)
    if period is not None:
        if array.ndim != 1 or array.size % period:
            text = f"{name} of shape {array.shape} is not a whole number of periods of {period} samples"
            raise DataError("shape", f"{text}; remove the surplus samples at the beginning")
        array = array.reshape(-1, period)
    if array.ndim not in (1, 2, 4):
        raise DataError("shape", f"{name} has shape {array.shape}; it must be (N,), (P, N) or (R, P, channels, N)")
    return array if array.ndim == 4 else np.atleast_2d(array)[None, :, None, :]


def _refuse_constant(u):
    for i in range(u.shape[1]):
        if np.ptp(u[:, i]) <= CONSTANT * np.max(np.abs(u[:, i])):
            raise DataError("constant", f"input {i} is constant; a frequency response needs a varying input")


#: Largest condition number of the inputs' spectra at a line; above it the inputs count as correlated. In the direction
#: that is excited least, the noise is amplified by the condition number.
MOST_CONDITION = 1e3


@dataclass(frozen=True, eq=False)
class ResponseMatrix:
    """The response from all inputs to all outputs at the excited lines, with covariances of noise and distortion."""

    response: FrequencyResponse  #: Response, shape (F, q, m), with the variances of its entries.
    #: shape (F, q, q), complex; covariance [m²] of the noise in the output spectrum of one realisation, which is
    #: averaged over its periods; None if there is only one period.
    noise: np.ndarray | None
    #: shape (F, q, q), complex; covariance [m²] of noise and nonlinear distortion together; None with m realisations.
    total: np.ndarray | None
    condition: np.ndarray  #: shape (F,); Condition number of the matrix of input spectra (inputs × realisations).

    def level(self, covariance) -> np.ndarray:
        """Return the RMS value [m] of each output, shape (q,), from its variance summed over all lines."""
        return np.sqrt(2.0 * np.einsum("fii->i", covariance).real)

    def at(self, kept) -> ResponseMatrix:
        """Return the response matrix at the lines that the mask ``kept`` selects; ``kept``: bool, shape (F,)."""
        noise, total = (None if one is None else one[kept] for one in (self.noise, self.total))
        return ResponseMatrix(_at(self.response, kept), noise, total, self.condition[kept])


#: Fewest samples of a period.
SHORTEST = 16


def experiments_of(name: str, values, period: int) -> np.ndarray:
    """Return signals of shape (R, P N, channels) as periods, shape (R, P, channels, N)."""
    array = finite_array(name, values)
    if array.ndim != 3:
        raise DataError("shape", f"{name} has shape {array.shape}; it must be (realisations, samples, channels)")
    if period < SHORTEST:
        raise DataError("shape", f"a period of {period} samples is too short: at least {SHORTEST} are needed")
    if not array.size:
        raise DataError("shape", f"{name} has no samples")
    if array.shape[1] % period:
        raise DataError(
            "shape",
            f"{name} has {array.shape[1]} samples, not a whole number of periods of {period} samples; remove the "
            "surplus samples at the beginning",
        )
    realisations, samples, channels = array.shape
    return array.reshape(realisations, samples // period, period, channels).transpose(0, 1, 3, 2)


def response_matrix(u, y, sample_time: float, period: int, input_unit: str = "V", output_unit: str = "m"):
    """Return the frequency response matrix (:class:`ResponseMatrix`) from experiments.

    Shapes: ``u`` (R, P N, m), ``y`` (R, P N, q) with N = ``period``. Units: ``sample_time`` [s].
    """
    inputs, outputs = experiments_of("input", u, period), experiments_of("output", y, period)
    if inputs.shape[:2] != outputs.shape[:2]:
        raise DataError("shape", f"input {np.shape(u)} and output {np.shape(y)} differ in realisations or samples")
    realisations, periods, m, N = inputs.shape
    if realisations < m:
        raise DataError("short", f"{realisations} experiments cannot separate {m} inputs; at least {m} are needed")
    _require_independent(inputs, sample_time)
    found = multisine_response(inputs, outputs, sample_time, input_unit=input_unit, output_unit=output_unit)
    lines = np.rint(found.frequency * N * sample_time).astype(int)
    U, Y = (np.fft.rfft(part, axis=3)[..., lines] / N for part in (inputs, outputs))
    mean_u, mean_y = (part.mean(axis=1).transpose(2, 1, 0) for part in (U, Y))
    noise = total = None
    if periods > 1:
        rest = (Y - Y.mean(axis=1, keepdims=True)) - np.einsum(
            "fij,rpjf->rpif", found.response, U - U.mean(axis=1, keepdims=True)
        )
        noise = np.einsum("rpif,rpjf->fij", rest, rest.conj()) / (realisations * (periods - 1) * periods)
    if realisations > m:
        rest = mean_y - found.response @ mean_u
        total = rest @ rest.conj().transpose(0, 2, 1) / (realisations - m)
    return ResponseMatrix(found, noise, total, np.linalg.cond(mean_u))


def _require_independent(inputs, sample_time: float) -> None:
    """Refuse inputs with nearly linearly dependent spectra at an excited line."""
    N = inputs.shape[3]
    U = np.fft.rfft(inputs.mean(axis=1), axis=2)[..., 1 : (N + 1) // 2].transpose(2, 1, 0) / N
    strength = np.abs(U).max(axis=(1, 2))
    if not strength.max() > 0.0:
        raise DataError("constant", "the inputs are constant; a frequency response needs varying inputs")
    # only the excited lines count, because the others contain only rounding errors
    excited = strength > 1e-3 * strength.max()
    condition = np.linalg.cond(U[excited])
    worst = int(np.argmax(condition))
    if not condition[worst] <= MOST_CONDITION:
        line = (np.flatnonzero(excited)[worst] + 1) / (N * sample_time)
        raise IdentificationError(
            f"the excitations are correlated: condition number {condition[worst]:.3g} of the inputs at {line:.5g} Hz, "
            f"at most {MOST_CONDITION:g} is allowed; excite with orthogonal multisines, or with other random phases "
            "at each input and in each realisation"
        )


#: Number of detection lines, the nearest ones, over which a distortion level is averaged.
NEAREST = 8
#: Highest harmonic of a sine that is evaluated; higher ones contain more noise than distortion.
HARMONICS = 9


@dataclass(frozen=True, eq=False)
class Distortion:
    """RMS levels at the excited lines, each of shape (F,), for one realisation averaged over its periods."""

    noise: np.ndarray
    odd: np.ndarray  #: odd, even: Levels without the noise, at least 0; NaN if they cannot be separated.
    even: np.ndarray


def detected(U, Y, harmonics, response) -> Distortion:
    """Return noise and distortion levels of a multisine on odd lines, some of which are omitted (detection lines).

    The level of odd distortion is NaN if no odd lines are omitted. Both levels are NaN if even lines are excited.
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
        levels[name] = near_level(harmonics, seen, clear)
    return Distortion(np.sqrt(noise[harmonics]), **levels)


def harmonic_levels(U, Y, cycles: int, response: complex) -> tuple[float, float, float]:
    """Return the levels of noise, odd and even distortion of a sine, from its harmonics."""
    size = abs(U[:, cycles].mean()) ** 2
    places = cycles * np.arange(1, min((U.shape[1] - 1) // cycles, HARMONICS) + 1)
    # in a closed loop the input also has harmonics, but the response is known only at the frequency of the sine
    power, noise = _scatter((Y - response * U)[None, :, places])
    clear = power - noise
    odd, even = max(clear[2::2].sum(), 0.0), max(clear[1::2].sum(), 0.0)
    return float(np.sqrt(noise[0] / size)), float(np.sqrt(odd / size)), float(np.sqrt(even / size))


def _scatter(rest) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each line, the power of the mean over the periods and its noise, averaged over realisations."""
    periods = rest.shape[1]
    power = np.mean(np.abs(rest.mean(axis=1)) ** 2, axis=0)
    noise = np.mean(np.var(rest, axis=1, ddof=1), axis=0) / periods
    return power, noise


def near_level(harmonics, seen, clear) -> np.ndarray:
    """Return, at each excited line, the RMS level at the nearest detection lines; ``clear`` is power without noise."""
    if not seen.size:
        return np.full(harmonics.size, np.nan)
    count = min(NEAREST, seen.size)
    first = np.clip(np.searchsorted(seen, harmonics) - count // 2, 0, seen.size - count)
    total = np.append(0.0, np.cumsum(clear))
    return np.sqrt(np.maximum((total[first + count] - total[first]) / count, 0.0))


#: Smallest accepted signal-to-noise ratio of the response, median over the lines [dB].
LEAST_RATIO = 6.0
#: Two sections of a signal count as periods if the median of their absolute difference is below this fraction of the
#: standard deviation of the signal.
SAME = 0.03
#: Lines of a recorded excitation below this fraction of its strongest line come from late samples or rounding.
LINE = 0.03


@dataclass(frozen=True, eq=False)
class Analysis:
    """A frequency response with distortion and signal-to-noise ratio."""

    response: FrequencyResponse  #: Response from one input to one output.
    distortion: Distortion | None  #: None for a noise excitation.
    kind: str  #: Kind of the excitation.

    @property
    def ratio(self) -> float:
        """Ratio of the response to the standard deviation of its noise [dB]: median over the lines."""
        found = self.response
        variance = found.total_variance if found.noise_variance is None else found.noise_variance
        if variance is None:
            return float("inf")
        with np.errstate(divide="ignore"):
            return float(np.median(10.0 * np.log10(np.abs(found.single) ** 2 / np.maximum(variance[:, 0, 0], 1e-300))))

    def require_excited(self) -> None:
        """Refuse a response whose signal-to-noise ratio is too low."""
        if self.ratio < LEAST_RATIO:
            raise IdentificationError(
                f"the excitation is too weak: the signal-to-noise ratio of the response is {self.ratio:.1f} dB at half "
                f"of the lines, but at least {LEAST_RATIO:g} dB are needed; raise --amplitude by a factor of "
                f"{10.0 ** ((LEAST_RATIO - self.ratio) / 20.0):.2g}, or --periods"
            )


def analyse(plan: Plan, sample_time: float, u, y, excitation=None, input_unit: str = "V") -> Analysis:
    """Return the response from an input to an output.

    Units: ``sample_time`` [s].
    """
    signals = [u, y] if excitation is None else [u, y, excitation]
    if plan.first + plan.length > len(y):
        raise IdentificationError(
            f"the excitation of {plan.length} samples begins at sample {plan.first}, but the recording has only "
            f"{len(y)} samples: the recording was cut off; record it again"
        )
    signals = [np.asarray(signal, dtype=float)[plan.first : plan.first + plan.length] for signal in signals]
    return ANALYSES[plan.kind](plan, sample_time, signals, input_unit)


def _multisine(plan: Plan, sample_time: float, signals, unit: str) -> Analysis:
    shape = plan.realisations, plan.settle + plan.periods, plan.samples[0]
    tables = [signal.reshape(shape)[:, plan.settle :, None, :] for signal in signals]
    N = plan.samples[0]
    excitation = tables[2] if len(tables) > 2 else None
    found = multisine_response(tables[0], tables[1], sample_time, input_unit=unit, excitation=excitation)
    harmonics = np.rint(found.frequency * N * sample_time).astype(int)
    if plan.lines:
        # quantisation in a closed loop may excite lines that the plan does not contain
        planned = np.isin(harmonics, plan.lines)
        found = _at(found, planned)
        harmonics = harmonics[planned]
    if plan.periods < 2:
        return Analysis(found, None, plan.kind)
    U, Y = (np.fft.rfft(table[:, :, 0], axis=2)[..., : (N + 1) // 2] / N for table in tables[:2])
    levels = detected(U, Y, harmonics, found.single)
    noise = found.noise_variance
    if found.total_variance is None and noise is not None and np.isfinite(levels.odd).all():
        total = noise + (levels.odd**2)[:, None, None] / plan.realisations
        found = replace(found, total_variance=total, warnings=())
    return Analysis(found, levels, plan.kind)


def _stepped(plan: Plan, sample_time: float, signals, unit: str) -> Analysis:
    lines, spectra, levels = [], [], []
    begin = 0
    for samples, cycles in zip(plan.samples, plan.lines, strict=True):
        whole = (plan.settle + plan.periods) * samples
        blocks = [
            signal[begin + plan.settle * samples : begin + whole].reshape(plan.periods, samples) for signal in signals
        ]
        begin += whole
        transformed = [np.fft.rfft(block, axis=1)[:, : (samples + 1) // 2] / samples for block in blocks]
        lines.append(cycles / (samples * sample_time))
        spectra.append([one[:, cycles] for one in transformed])
        U, Y = transformed[:2]
        levels.append(harmonic_levels(U, Y, cycles, Y[:, cycles].sum() / U[:, cycles].sum()))
    # (signals, 1, P, 1, F)
    table = np.array(spectra).transpose(1, 2, 0)[:, None, :, None, :]
    frequency = np.array(lines)
    response, _, noise = averaged(frequency, table[0], table[1], table[-1] if len(table) > 2 else table[0])
    degrees = float(plan.periods - 1)
    found = FrequencyResponse(frequency, response, sample_time, None, noise, None, unit, degrees=degrees)
    return Analysis(found, Distortion(*np.array(levels).T), plan.kind)


def _noise(plan: Plan, sample_time: float, signals, unit: str) -> Analysis:
    segment = plan.samples[0]
    excitation = signals[2] if len(signals) > 2 else None
    found = welch_response(signals[0], signals[1], sample_time, segment=segment, input_unit=unit, excitation=excitation)
    if plan.lines:
        low, high = (line / (segment * sample_time) for line in plan.lines)
        found = found.band(low * (1.0 - 1e-9), high * (1.0 + 1e-9))
    # error of the response due to the Hann window: curvature times half the variance of the window's spectrum (1/3
    # line²)
    bent = np.abs(np.diff(found.single, 2)) / 6.0
    blurred = bent > found.radius()[1:-1, 0, 0]
    if blurred.any():
        where = found.frequency[1 + int(np.argmax(bent))]
        text = f"segments of {segment * sample_time:.3g} s blur the response at {where:.4g} Hz; give a longer --period"
        found = replace(found, warnings=(*found.warnings, text))
    return Analysis(found, None, plan.kind)


#: How each kind of excitation is analysed.
ANALYSES = {"multisine": _multisine, "stepped": _stepped, "noise": _noise}


def _at(found: FrequencyResponse, kept) -> FrequencyResponse:
    """Return the response at the lines ``kept``."""
    names = ("frequency", "response", "total_variance", "noise_variance", "coherence")
    parts: dict[str, Any] = {
        name: None if getattr(found, name) is None else getattr(found, name)[kept] for name in names
    }
    return replace(found, **parts)


def plan_of_recording(excitation, sample_time: float, period: float | None = None, kind: str | None = None) -> Plan:
    """Return a plan for a recording without a description of its excitation.

    Units: ``sample_time`` [s], ``period`` [s].
    """
    e = np.asarray(excitation, dtype=float)
    if kind not in (None, "multisine", "noise"):
        raise IdentificationError(
            f"--excitation {kind}: its frequencies are known only for a recording made by hysteresis frf"
        )
    N = None if kind == "noise" else _repeats(e)
    if kind == "multisine" and (period or N is None):
        if period is None:
            raise IdentificationError("--excitation multisine: the excitation is not periodic; give --period")
        N = round(period / sample_time)
    if N is None:
        length = round(period / sample_time) if period else max(2 * (e.size // 34), 32)
        return Plan("noise", 0, 0, 1, 1, (length, e.size))
    count = e.size // N if N else 0
    if N < 16 or count < 2:
        raise IdentificationError(
            f"--period {N * sample_time:g} s: the recording of {e.size * sample_time:.4g} s must contain at least two "
            "periods of at least 16 samples"
        )
    # if there are more than two periods, the first is discarded, because the system settles during it
    settle = int(count > 2)
    spectrum = np.abs(np.fft.rfft(experiments("excitation", e[-(count - settle) * N :], N)[0, :, 0].mean(axis=0)))
    lines = np.flatnonzero(spectrum[1 : (N + 1) // 2] > LINE * spectrum[1:].max()) + 1
    return Plan("multisine", e.size - count * N, settle, count - settle, 1, (N,), tuple(int(line) for line in lines))


def _repeats(e) -> int | None:
    """Return the period [samples] of a signal, from its last three quarters; None if these do not repeat."""
    tail = e[e.size // 4 :] - np.mean(e[e.size // 4 :])
    correlation = np.fft.irfft(np.abs(np.fft.rfft(tail, 2 * tail.size)) ** 2)[: tail.size // 2 + 1]
    correlation = correlation / (tail.size - np.arange(correlation.size))
    above = correlation > 0.9 * correlation[0]
    fallen = int(np.argmin(above))
    peaks = fallen + np.flatnonzero(above[fallen:])
    for lag in peaks if fallen else ():
        # the median ignores single late samples
        if np.median(np.abs(tail[lag:] - tail[:-lag])) < SAME * np.std(tail):
            return int(lag)
    return None


#: Probability of the confidence circles in tables.
PROBABILITY = 0.95
#: Required entries of an NPZ file.
NEEDED = ("frequency", "response", "sample_time", "input_unit", "output_unit", "kind")
SPREADS = ("total_variance", "noise_variance", "coherence", "degrees")
LEVELS = ("noise", "odd", "even")


def require_response_file(path) -> None:
    """Refuse a response file that cannot be written; to be called before any movement."""
    path = pathlib.Path(path)
    if path.suffix.lower() not in WRITERS:
        raise RecordingError(f"{path}: unknown kind of file '{path.suffix}'; write .npz, .csv or .yaml")
    if not path.absolute().parent.is_dir():
        raise RecordingError(f"{path}: cannot be written: the folder does not exist; choose another one")


def save_response(path, found: Analysis, columns: dict[str, np.ndarray], figures: dict) -> None:
    """Write a response in the format given by the file's suffix."""
    table = response_columns(found)
    extra = {} if pathlib.Path(path).suffix.lower() == ".yaml" else columns
    write_response_file(path, _arrays(found, columns), table | extra, figures)


def write_response_file(path, arrays: dict[str, Any], table: dict[str, np.ndarray], figures: dict) -> None:
    """Write arrays into an NPZ file, or a table and figures into a CSV or YAML file, according to the suffix."""
    require_response_file(path)
    write = WRITERS[pathlib.Path(path).suffix.lower()]
    with replacing(path, RecordingError) as beside, beside.open("wb") as stream:
        write(stream, arrays, table, figures)


@contextlib.contextmanager
def reading_response(path, missing: str, origin: str) -> Iterator[None]:
    """Raise RecordingError for a file that does not exist or contains ``missing``; name the command that writes one."""
    try:
        yield
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file; give the NPZ file that hysteresis frf wrote") from None
    except (OSError, ValueError, KeyError):
        raise RecordingError(f"{path}: contains {missing}; give the NPZ file that {origin}") from None


def load_response(path) -> Analysis:
    """Return the response of an NPZ file written by :func:`save_response`."""
    with reading_response(path, "no frequency response", "hysteresis frf wrote"):
        held = read_arrays(path)
        if "axes" not in held:
            return _response_of(held)
    raise RecordingError(
        f"{path}: contains the response matrix of a stage, but the response of a single axis is needed; "
        "hysteresis design "
        "STAGE --response takes the matrix, and hysteresis identify takes the recording of the stage"
    )


def _response_of(held: dict[str, np.ndarray]) -> Analysis:
    """Return the response in ``arrays``; raise ValueError or KeyError if they do not contain a response."""
    frequency, sample_time = real_array(held, "frequency"), real_array(held, "sample_time")
    input_unit, output_unit, kind = (str(held[name]) for name in ("input_unit", "output_unit", "kind"))
    if not frequency.size or np.any(np.diff(frequency) <= 0.0) or not (sample_time.size == 1 and sample_time[0] > 0.0):
        raise ValueError("frequency must contain increasing values, and sample_time must be one number > 0")
    if not {input_unit, output_unit} <= {unit for unit, _ in UNITS.values()} or kind not in KINDS:
        raise ValueError("unknown units or kind")
    values = np.asarray(held["response"], dtype=complex).reshape(frequency.size, 1, 1)
    response = FrequencyResponse(
        frequency, values, float(sample_time[0]), input_unit=input_unit, output_unit=output_unit
    )
    shapes = {"total_variance": (-1, 1, 1), "noise_variance": (-1, 1, 1), "coherence": (-1, 1)}
    spreads: dict[str, Any] = {
        name: real_array(held, name, frequency.size).reshape(shape) for name, shape in shapes.items() if name in held
    }
    degrees = float(real_array(held, "degrees", 1)[0]) if "degrees" in held else None
    if degrees is not None and not (degrees > 0.0 and {"total_variance", "noise_variance"} & set(spreads)):
        raise ValueError("degrees must be > 0 and needs total_variance or noise_variance")
    levels = (
        [real_array(held, name, frequency.size) for name in LEVELS] if all(name in held for name in LEVELS) else None
    )
    return Analysis(replace(response, **spreads, degrees=degrees), Distortion(*levels) if levels else None, kind)


def real_array(held: dict[str, np.ndarray], name: str, size: int | None = None) -> np.ndarray:
    """Return an array of real numbers as a vector; raise ValueError if it has another type or size."""
    array = held[name]
    if (
        array.dtype.kind not in "iuf"
        or size not in (None, array.size)
        or (size is None and np.any(~np.isfinite(array)))
    ):
        raise ValueError(f"{name} has a wrong type or size")
    return np.asarray(array, dtype=float).ravel()


def holds_response(path) -> bool:
    """Return whether :func:`load_response` reads this kind of file."""
    if pathlib.Path(path).suffix.lower() != ".npz":
        return False
    try:
        return set(NEEDED) <= set(read_heads(path))
    except (OSError, ArchiveError):
        return False


def response_columns(found: Analysis) -> dict[str, np.ndarray]:
    """Return the columns of a table of a response, by names with units."""
    response = found.response
    unit = f"{response.output_unit}/{response.input_unit}"
    columns = {
        "frequency [Hz]": response.frequency,
        f"magnitude [{unit}]": np.abs(response.single),
        "phase [deg]": np.degrees(np.unwrap(np.angle(response.single))),
    }
    if response.degrees is not None:
        columns[f"radius_{100 * PROBABILITY:g}_percent [{unit}]"] = response.radius(PROBABILITY)[:, 0, 0]
    if found.distortion is not None:
        columns |= {f"{name} [{unit}]": getattr(found.distortion, name) for name in LEVELS}
    if response.coherence is not None:
        columns["coherence [1]"] = response.coherence[:, 0]
    return columns


def _arrays(found: Analysis, columns: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the arrays of an NPZ file from which :func:`load_response` restores the response."""
    response = found.response
    arrays: dict[str, Any] = {"kind": np.array(found.kind), "response": response.single}
    arrays |= {name: np.asarray(getattr(response, name)) for name in NEEDED if name not in arrays}
    for name in SPREADS:
        value = getattr(response, name)
        if value is not None:
            arrays[name] = np.squeeze(value) if name != "degrees" else np.array(value)
    if found.distortion is not None:
        arrays |= {name: getattr(found.distortion, name) for name in LEVELS}
    return arrays | {name.split(" ")[0]: values for name, values in columns.items()}


def _npz(stream, arrays, table, figures) -> None:
    np.savez(stream, **arrays)


def _csv(stream, arrays, table, figures) -> None:
    stream.write((",".join(table) + "\n").encode())
    np.savetxt(stream, np.column_stack(list(table.values())), delimiter=",", fmt="%.9g")


def _yaml(stream, arrays, table, figures) -> None:
    import yaml

    lines = {name: [float(f"{value:.6g}") for value in values] for name, values in table.items()}
    text = yaml.safe_dump({"figures": figures, "lines": lines}, sort_keys=False, allow_unicode=True, width=120)
    stream.write(text.encode())


#: Writer of each kind of file.
WRITERS = {".npz": _npz, ".csv": _csv, ".yaml": _yaml}
