# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""From the signals of an axis that was excited to its frequency response, with bands and levels of distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.distortion import Distortion, detected, harmonic_levels
from hysteresis_ros.identification.excitations import Plan
from hysteresis_ros.identification.frequency_response import (
    FrequencyResponse,
    averaged,
    experiments,
    multisine_response,
    welch_response,
)

#: Least ratio of response and deviation, at half of the lines [dB].
LEAST_RATIO = 6.0
#: Two pieces of a signal are the same period when they differ by less than this part of its RMS.
SAME = 0.03
#: Lines of a recorded excitation with less than this share of its strongest line are what came late or was rounded.
LINE = 0.03


@dataclass(frozen=True, eq=False)
class Analysis:
    """A frequency response, and what else its lines tell.

    Parameters
    ----------
    response : FrequencyResponse
        Of one input and one output.
    distortion : Distortion or None
        Noise does not tell it.
    kind : str
        Of the excitation.
    """

    response: FrequencyResponse
    distortion: Distortion | None
    kind: str

    @property
    def ratio(self) -> float:
        """Ratio of the response and the deviation of its noise [dB], median of the lines."""
        found = self.response
        variance = found.total_variance if found.noise_variance is None else found.noise_variance
        if variance is None:
            return float("inf")
        with np.errstate(divide="ignore"):
            return float(np.median(10.0 * np.log10(np.abs(found.single) ** 2 / np.maximum(variance[:, 0, 0], 1e-300))))

    def require_excited(self) -> None:
        """Refuse a response that drowns in noise.

        Raises
        ------
        IdentificationError
            The excitation was too weak; says by how much.
        """
        if self.ratio < LEAST_RATIO:
            raise IdentificationError(
                f"the excitation is too weak: signal-to-noise ratio of the response {self.ratio:.1f} dB at half of the "
                f"lines, at least {LEAST_RATIO:g} dB are needed; raise --amplitude by a factor of "
                f"{10.0 ** ((LEAST_RATIO - self.ratio) / 20.0):.2g}, or --periods"
            )


def analyse(plan: Plan, sample_time: float, u, y, excitation=None, input_unit: str = "V") -> Analysis:
    """Return the response from an input to an output.

    Parameters
    ----------
    plan : Plan
        Where they were excited, and how.
    sample_time : float
        [s]
    u, y : ndarray, shape (N,)
        Input and output [SI].
    excitation : ndarray, shape (N,), optional
        What excites from outside in a closed loop; the input itself by default.
    input_unit : str
        SI unit.

    Raises
    ------
    IdentificationError
        The recording ends before the excitation does.
    """
    signals = [u, y] if excitation is None else [u, y, excitation]
    if plan.first + plan.length > len(y):
        raise IdentificationError(
            f"the excitation of {plan.length} samples begins at sample {plan.first} and the recording has {len(y)}: "
            "it was cut off; record it again"
        )
    signals = [np.asarray(signal, dtype=float)[plan.first : plan.first + plan.length] for signal in signals]
    return ANALYSES[plan.kind](plan, sample_time, signals, input_unit)


def _multisine(plan: Plan, sample_time: float, signals, unit: str) -> Analysis:
    shape = plan.realisations, plan.settle + plan.periods, plan.samples[0]
    tables = [signal.reshape(shape)[:, plan.settle :, None, :] for signal in signals]
    N = plan.samples[0]
    excitation = tables[2] if len(tables) > 2 else None
    found = multisine_response(*tables[:2], sample_time, input_unit=unit, excitation=excitation)
    harmonics = np.rint(found.frequency * N * sample_time).astype(int)
    if plan.lines:
        # the loop's own quantisation may reach lines that were not excited
        planned = np.isin(harmonics, plan.lines)
        found = _at(found, planned)
        harmonics = harmonics[planned]
    if plan.periods < 2:
        return Analysis(found, None, plan.kind)
    U, Y = (np.fft.rfft(table[:, :, 0], axis=2)[..., : (N + 1) // 2] / N for table in tables[:2])
    levels = detected(U, Y, harmonics, found.single)
    if found.total_variance is None and np.isfinite(levels.odd).all():
        total = found.noise_variance + (levels.odd**2)[:, None, None] / plan.realisations
        found = replace(found, total_variance=total, warnings=())
    return Analysis(found, levels, plan.kind)


def _stepped(plan: Plan, sample_time: float, signals, unit: str) -> Analysis:
    frequency, spectra, levels = [], [], []
    begin = 0
    for samples, cycles in zip(plan.samples, plan.lines, strict=True):
        whole = (plan.settle + plan.periods) * samples
        blocks = [
            signal[begin + plan.settle * samples : begin + whole].reshape(plan.periods, samples) for signal in signals
        ]
        begin += whole
        transformed = [np.fft.rfft(block, axis=1)[:, : (samples + 1) // 2] / samples for block in blocks]
        frequency.append(cycles / (samples * sample_time))
        spectra.append([one[:, cycles] for one in transformed])
        U, Y = transformed[:2]
        levels.append(harmonic_levels(U, Y, cycles, Y[:, cycles].sum() / U[:, cycles].sum()))
    # (signals, 1, P, 1, F)
    table = np.array(spectra).transpose(1, 2, 0)[:, None, :, None, :]
    frequency = np.array(frequency)
    response, _, noise = averaged(frequency, table[0], table[1], table[-1] if len(table) > 2 else table[0])
    degrees = float(plan.periods - 1)
    found = FrequencyResponse(frequency, response, sample_time, None, noise, None, unit, degrees=degrees)
    return Analysis(found, Distortion(*np.array(levels).T), plan.kind)


def _noise(plan: Plan, sample_time: float, signals, unit: str) -> Analysis:
    segment = plan.samples[0]
    excitation = signals[2] if len(signals) > 2 else None
    found = welch_response(*signals[:2], sample_time, segment=segment, input_unit=unit, excitation=excitation)
    if plan.lines:
        low, high = (line / (segment * sample_time) for line in plan.lines)
        found = found.band(low * (1.0 - 1e-9), high * (1.0 + 1e-9))
    # Hann's window sees a third of a line's square to both sides: the error that the curvature of the response makes
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
    """Return the lines of a response that are kept."""
    names = ("frequency", "response", "total_variance", "noise_variance", "coherence")
    parts = {name: None if getattr(found, name) is None else getattr(found, name)[kept] for name in names}
    return replace(found, **parts)


def plan_of_recording(excitation, sample_time: float, period: float | None = None, kind: str | None = None) -> Plan:
    """Return a plan for a recording of which nobody says how it was excited.

    Parameters
    ----------
    excitation : ndarray, shape (N,)
        What excites.
    sample_time : float
        [s]
    period : float, optional
        Of a multisine, or of the segments of noise [s]; by default what repeats, and 17 segments.
    kind : str, optional
        ``multisine`` or ``noise``; by default a multisine where it repeats.

    Raises
    ------
    IdentificationError
        The recording does not hold two periods, or nothing repeats.
    """
    e = np.asarray(excitation, dtype=float)
    if kind not in (None, "multisine", "noise"):
        raise IdentificationError(
            f"--excitation {kind}: where its frequencies stand is known only of a recording that hysteresis frf made"
        )
    N = None if kind == "noise" else _repeats(e)
    if kind == "multisine" and (period or N is None):
        if period is None:
            raise IdentificationError("--excitation multisine: nothing repeats in what excites; give --period")
        N = round(period / sample_time)
    if N is None:
        length = round(period / sample_time) if period else max(2 * (e.size // 34), 32)
        return Plan("noise", 0, 0, 1, 1, (length, e.size))
    count = e.size // N if N else 0
    if N < 16 or count < 2:
        raise IdentificationError(
            f"--period {N * sample_time:g} s: the recording of {e.size * sample_time:.4g} s must hold two periods of "
            "16 samples at least"
        )
    # the first one settles, where there are enough
    settle = int(count > 2)
    spectrum = np.abs(np.fft.rfft(experiments("excitation", e[-(count - settle) * N :], N)[0, :, 0].mean(axis=0)))
    lines = np.flatnonzero(spectrum[1 : (N + 1) // 2] > LINE * spectrum[1:].max()) + 1
    return Plan("multisine", e.size - count * N, settle, count - settle, 1, (N,), tuple(int(line) for line in lines))


def _repeats(e) -> int | None:
    """Return after how many samples a signal repeats from its middle on; None when it does not."""
    tail = e[e.size // 4 :] - np.mean(e[e.size // 4 :])
    correlation = np.fft.irfft(np.abs(np.fft.rfft(tail, 2 * tail.size)) ** 2)[: tail.size // 2 + 1]
    correlation = correlation / (tail.size - np.arange(correlation.size))
    above = correlation > 0.9 * correlation[0]
    fallen = int(np.argmin(above))
    peaks = fallen + np.flatnonzero(above[fallen:])
    for lag in peaks if fallen else ():
        # the median: single samples that came late do not count
        if np.median(np.abs(tail[lag:] - tail[:-lag])) < SAME * np.std(tail):
            return int(lag)
    return None
