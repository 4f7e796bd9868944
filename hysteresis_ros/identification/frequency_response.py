"""Frequency responses with their uncertainty: Welch's method for any input, averaging for periodic multisines.

Shapes: a response has shape (F, n_y, n_u); variances are E|G - Ĝ|² of each complex entry of the average.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, chapters 2.6 and 4.3.
.. [2] Bendat & Piersol, Random Data, 2010, chapter 9 (variance from the coherence).
.. [3] Welch, IEEE Trans. Audio Electroacoust. 15, 1967, eq. 16 (overlapping segments).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal

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
        parts = [None if part is None else part[keep] for part in (self.total_variance, self.noise_variance)]
        coherence = None if self.coherence is None else self.coherence[keep]
        others = tuple(text for text in self.warnings if not text.startswith("coherence"))
        return FrequencyResponse(
            self.frequency[keep],
            self.response[keep],
            self.sample_time,
            *parts,
            coherence,
            self.input_unit,
            self.output_unit,
            (*others, *_poor_coherence(coherence)),
        )

    @property
    def single(self) -> np.ndarray:
        """The response of the first output to the first input, shape (F,)."""
        return self.response[:, 0, 0]


def welch_response(
    u, y, sample_time: float, segment: int | None = None, window: str = "hann", input_unit="V", output_unit="m"
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

    Raises
    ------
    DataError
        Too short for two segments an input, constant input, values that are not finite.
    """
    u, y = _columns("input", u), _columns("output", y)
    if len(u) != len(y):
        raise DataError("shape", f"the input has {len(u)} samples and the output {len(y)}")
    N, inputs = u.shape
    refuse_short(N, 64, "a frequency response")
    _refuse_constant(u)
    segment = segment or max(32, min(N // 2, int(2 * N / (9 + 8 * inputs))))
    step = segment - segment // 2
    count = (N - segment) // step + 1
    if segment > N or count <= inputs:
        raise DataError("short", f"{N} samples give {max(count, 0)} segments of {segment}; {inputs + 1} are needed")
    both = np.concatenate([u, y], axis=1)
    options = dict(
        fs=1.0 / sample_time, window=window, nperseg=segment, noverlap=segment - step, detrend="constant", axis=0
    )
    pairs = [
        [scipy.signal.csd(both[:, i], both[:, j], **options) for j in range(both.shape[1])]
        for i in range(both.shape[1])
    ]
    frequency = pairs[0][0][0]
    # SciPy's csd(a, b) is conj(a) b: transposed, so that S[i, j] is the spectrum of i against j
    S = np.array([[spectrum for _, spectrum in row] for row in pairs]).transpose(2, 1, 0)[1:]
    frequency, Suu, Syu, Syy = frequency[1:], S[:, :inputs, :inputs], S[:, inputs:, :inputs], S[:, inputs:, inputs:]
    if segment % 2 == 0:  # the line at half the sample rate is real for a real signal: no phase can be read there
        frequency, Suu, Syu, Syy = (part[:-1] for part in (frequency, Suu, Syu, Syy))
    excited = np.abs(np.linalg.det(Suu)) > 0.0
    excited &= np.trace(Suu, axis1=1, axis2=2).real > EXCITED**2 * np.max(np.trace(Suu, axis1=1, axis2=2).real)
    frequency, Suu, Syu, Syy = (part[excited] for part in (frequency, Suu, Syu, Syy))
    inverse = np.linalg.inv(Suu)
    response = Syu @ inverse
    power = np.einsum("fii->fi", Syy).real
    explained = np.einsum("fij,fij->fi", response, Syu.conj()).real
    coherence = np.clip(explained / np.maximum(power, 1e-300), 0.0, 1.0)
    averages = _effective_averages(count, segment, step, window)
    rest = (power - explained).clip(0.0) * averages / max(averages - inputs, 0.5)
    variance = rest[:, :, None] * np.einsum("fii->fi", inverse).real[:, None, :] / averages
    warnings = []
    poor = float(np.mean(coherence < POOR_COHERENCE))
    if poor > 0.1:
        warnings.append(
            f"coherence below {POOR_COHERENCE} at {100 * poor:.0f} % of the lines: noise or weak excitation"
        )
    if averages < inputs + 4:
        warnings.append(f"only {averages:.1f} independent averages: the variance is rough; record longer")
    return FrequencyResponse(
        frequency, response, sample_time, variance, None, coherence, input_unit, output_unit, tuple(warnings)
    )


def multisine_response(
    u, y, sample_time: float, period: int | None = None, input_unit="V", output_unit="m"
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

    Raises
    ------
    DataError
        Shapes differ, fewer realisations than inputs, constant input, values that are not finite.
    """
    u, y = _experiments("input", u, period), _experiments("output", y, period)
    if u.shape[:2] != y.shape[:2] or u.shape[3] != y.shape[3]:
        raise DataError("shape", f"input {u.shape} and output {y.shape} differ in realisations, periods or samples")
    realisations, periods, inputs, N = u.shape
    refuse_short(N, 16, "a period of a multisine")
    _refuse_constant(u.reshape(-1, 1))
    if inputs > realisations:
        raise DataError("short", f"{realisations} experiments cannot separate {inputs} inputs; {inputs} are needed")
    U, Y = (np.fft.rfft(part, axis=3)[..., 1 : (N + 1) // 2] / N for part in (u, y))
    # (F, channels, R): averaged over the periods
    Um, Ym = (part.mean(axis=1).transpose(2, 1, 0) for part in (U, Y))
    strength = np.abs(Um).max(axis=(1, 2))
    excited = strength > EXCITED * strength.max()
    frequency = (np.arange(1, (N + 1) // 2) / (N * sample_time))[excited]
    Um, Ym, U, Y = Um[excited], Ym[excited], U[..., excited], Y[..., excited]
    Uh = Um.conj().transpose(0, 2, 1)
    gram = Um @ Uh
    weak = np.linalg.cond(gram) > 1e10
    if weak.any():
        raise DataError("rank", f"the experiments do not separate the inputs at {frequency[weak][0]:.6g} Hz and others")
    inverse = np.linalg.inv(gram)
    response = Ym @ Uh @ inverse
    spread = np.einsum("fii->fi", inverse).real
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
    warnings = []
    if periods == 1:
        warnings.append("one period: noise cannot be told from nonlinear distortion, and a transient not be seen")
    if realisations == inputs:
        warnings.append("one realisation an input: nonlinear distortion cannot be told; repeat with other phases")
    return FrequencyResponse(
        frequency, response, sample_time, total, noise, None, input_unit, output_unit, tuple(warnings)
    )


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


def _experiments(name, values, period):
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
