# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Excitations of a frequency-response analyser, and the periods of such excitations in a recording.

A multisine has random phases and excites the odd harmonics; in each group of them one is omitted at random. Such a
multisine shows the nonlinear response of an axis: even distortion appears at the even harmonics, odd distortion at the
omitted odd harmonics [1]_. With a stepped sine, distortion appears as harmonics; with noise as excitation, distortion
and noise cannot be separated.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, chapters 3
   to 5 (nonlinear distortion, design of excitations).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.files import read_json

#: One odd harmonic of each group of this size is omitted.
GROUP = 4
#: Default number of samples per period of a multisine, and per segment of noise.
PERIOD = 2000
#: Default number of samples of a block of a stepped sine; a block with whole cycles may be longer.
STEP = 200
#: Default of the highest frequency, as a fraction of the sample rate.
HIGHEST = 0.48
#: Least number of lines of a multisine.
LEAST_LINES = 8
#: A block of a stepped sine may be longer than the shortest allowed one by this number of cycles, or by 8 samples if
#: these are more.
LEAST_CYCLE = 2.0
#: Default length of noise, as a multiple of half a segment.
SEGMENTS = 32
#: Largest number of samples of a plausible recording.
MOST_SAMPLES = 10**12
#: Points at which each loop can be excited; the first is the default.
PLACES = {"open": ("voltage", "command"), "closed": ("reference", "command")}
#: Noise is limited to this number of standard deviations.
CUT_OFF = 3.0


@dataclass(frozen=True)
class Experiment:
    """Settings of a frequency-response analyser; None: chosen automatically.

    Parameters
    ----------
    kind : str
        ``multisine``, ``stepped`` or ``noise``.
    low, high : float, optional
        Band [Hz].
    period : float, optional
        Period of the multisine, shortest block of the stepped sine, or segment of the noise [s].
    duration : float, optional
        Length of the whole excitation [s], given instead of the period.
    periods : int
        Periods of each realisation, or blocks of each frequency, that are averaged.
    settle : int
        Number of periods, or blocks, discarded before the averaged ones.
    realisations : int
        Realisations of the random phases of a multisine.
    points : int
        Frequencies of a stepped sine.
    seed : int
        Seed of the random phases, omitted lines and noise.
    """

    kind: str = "multisine"
    low: float | None = None
    high: float | None = None
    period: float | None = None
    duration: float | None = None
    periods: int = 4
    settle: int = 1
    realisations: int = 4
    points: int = 40
    seed: int = 1


@dataclass(frozen=True)
class Plan:
    """Position and structure of an excitation in a recording."""

    kind: str
    first: int  #: First sample of the excitation.
    settle: int
    periods: int
    realisations: int
    #: Numbers of samples. Multisine: of a period; stepped sine: of each block; noise: of a segment and of the whole
    #: excitation.
    samples: tuple[int, ...]
    #: Multisine: excited harmonics; stepped sine: cycles per block of each frequency; noise: first and last line of the
    #: segments.
    lines: tuple[int, ...] = field(default=())
    #: loop, at: ``open`` or ``closed`` loop, and the excited point: ``voltage``, ``command`` or ``reference``.
    loop: str = "open"
    at: str = "voltage"

    @property
    def length(self) -> int:
        """Number of samples of the whole excitation."""
        if self.kind == "noise":
            return self.samples[1]
        return self.realisations * (self.settle + self.periods) * sum(self.samples)

    @property
    def text(self) -> str:
        """The plan as JSON text."""
        return json.dumps(asdict(self))

    @classmethod
    def from_text(cls, text: str) -> Plan:
        """Return the plan from a text of :attr:`text`."""
        found, names = read_json(text), {item.name for item in fields(cls)}
        if not isinstance(found, dict) or not names >= set(found) >= names - {"lines", "loop", "at"}:
            raise ValueError("not the plan of an excitation")
        values: dict[str, Any] = {n: tuple(value) if isinstance(value, list) else value for n, value in found.items()}
        plan = cls(**values)
        if not plan._sound():
            raise ValueError("the plan of an excitation has invalid numbers")
        return plan

    def _sound(self) -> bool:
        """Return whether the types and sizes of the fields are consistent."""
        samples, lines = self.samples, self.lines
        if not (isinstance(samples, tuple) and isinstance(lines, tuple)):
            return False
        counts = (self.first, self.settle, self.periods, self.realisations, *lines, *samples)
        if any(type(count) is not int or not 0 <= count <= MOST_SAMPLES for count in counts):
            return False
        forms = {"multisine": len(samples) == 1, "noise": (len(samples), len(lines)) in ((2, 0), (2, 2))}
        forms["stepped"] = len(samples) == len(lines) > 0
        least = min(self.periods, self.realisations, *samples)
        return least > 0 and forms.get(str(self.kind), False) and self.at in PLACES.get(str(self.loop), ())


#: ``shape(frequencies)`` returns the factor of the amplitude at each frequency [Hz].
Shape = Callable[[np.ndarray], np.ndarray]


def excitation(asked: Experiment, rate: float, shape: Shape | None = None) -> tuple[np.ndarray, Plan]:
    """Return an excitation and its plan, which begins at sample 0; without a shape, the peak is 1.

    Units: ``rate`` [Hz], ``shape`` [Hz].
    """
    _check(asked, rate)
    samples, plan = KINDS[asked.kind](asked, rate, shape or np.ones_like)
    return samples, plan


def uniform(seed: int, count: int) -> np.ndarray:
    """Return random numbers in 0 … 1 that are the same in every version of NumPy."""
    return (np.random.PCG64(seed).random_raw(count) >> np.uint64(11)) * 2.0**-53


def _check(asked: Experiment, rate: float) -> None:
    if asked.kind not in KINDS:
        raise ConfigurationError(f"excitation {asked.kind!r}: must be one of {', '.join(KINDS)}")
    for name, value in (("low", asked.low), ("high", asked.high)):
        if value is not None and not 0.0 < value < 0.5 * rate:
            raise ConfigurationError(
                f"--{name} {value:g} Hz: must be above 0 and below half the sample rate, {0.5 * rate:g} Hz"
            )
    if asked.low is not None and asked.high is not None and not asked.low < asked.high:
        raise ConfigurationError(f"--low {asked.low:g} Hz: must be below --high {asked.high:g} Hz")
    for name, value in (("period", asked.period), ("duration", asked.duration)):
        if value is not None and not 8.0 / rate <= value < float("inf"):
            raise ConfigurationError(f"--{name} {value:g} s: must be at least {8.0 / rate:g} s, 8 samples")
    if asked.period is not None and asked.duration is not None and asked.kind != "noise":
        raise ConfigurationError("--period and --duration exclude each other; give one of them")
    counts = {"periods": 2, "settle": 0, "realisations": 1, "points": 2, "seed": 0}
    for name, least in counts.items():
        if getattr(asked, name) < least:
            raise ConfigurationError(f"--{name} {getattr(asked, name)}: must be at least {least}")


def _too_slow(low: float, seconds: float, what: str) -> ConfigurationError:
    return ConfigurationError(
        f"--low {low:g} Hz: {what} of {seconds:.4g} s resolves nothing below {1.0 / seconds:.4g} Hz; raise "
        "--low, or give "
        "a longer --period or --duration"
    )


def _multisine(asked: Experiment, rate: float, shape: Shape) -> tuple[np.ndarray, Plan]:
    """Return consecutive realisations, each with the same number of whole periods."""
    whole = asked.realisations * (asked.settle + asked.periods)
    N = round(rate * (asked.period or (asked.duration / whole if asked.duration else PERIOD / rate)))
    low, high = asked.low or rate / N, asked.high or HIGHEST * rate
    if low < (1.0 - 1e-9) * rate / N:
        raise _too_slow(low, N / rate, "a period")
    first = int(np.ceil(low * N / rate - 1e-9))
    odd = np.arange(first + (first + 1) % 2, int(high * N / rate + 1e-9) + 1, 2)
    # one line of each complete group is omitted, but never the first and last line
    groups = odd[1 : 1 + GROUP * ((odd.size - 2) // GROUP)].reshape(-1, GROUP)
    chosen = (uniform(asked.seed, len(groups)) * GROUP).astype(int)
    harmonics = np.setdiff1d(odd, groups[np.arange(len(groups)), chosen])
    if harmonics.size < LEAST_LINES:
        raise ConfigurationError(
            f"{low:g} … {high:g} Hz contains {harmonics.size} lines of a multisine of {N / rate:.4g} s, but "
            f"{LEAST_LINES} are needed; widen the band, or give a longer --period or --duration"
        )
    factor = np.abs(shape(harmonics * rate / N))
    phases = 2.0 * np.pi * uniform(asked.seed + 1, asked.realisations * harmonics.size)
    spectra = np.zeros((asked.realisations, N // 2 + 1), dtype=complex)
    spectra[:, harmonics] = np.exp(1j * phases.reshape(asked.realisations, -1))
    largest = np.max(np.abs(np.fft.irfft(spectra, N)))
    spectra[:, harmonics] *= factor / largest
    table = np.repeat(np.fft.irfft(spectra, N)[:, None], asked.settle + asked.periods, axis=1)
    lines = tuple(int(harmonic) for harmonic in harmonics)
    return table.ravel(), Plan("multisine", 0, asked.settle, asked.periods, asked.realisations, (N,), lines)


def _stepped(asked: Experiment, rate: float, shape: Shape) -> tuple[np.ndarray, Plan]:
    """Return consecutive sines with a whole number of cycles in each block."""
    per_point = asked.points * (asked.settle + asked.periods)
    block = round(rate * (asked.period or (asked.duration / per_point if asked.duration else STEP / rate)))
    low, high = asked.low or rate / block, asked.high or HIGHEST * rate
    if asked.duration and low < (1.0 - 1e-9) * rate / block:
        raise _too_slow(low, block / rate, "a block")
    cycles, samples = [], []
    for frequency in np.geomspace(low, high, asked.points):
        # whole cycles per block: of the lengths from the requested one up, choose the one with the nearest frequency
        least = max(block, round(rate / frequency))
        lengths = np.arange(least, least + max(int(LEAST_CYCLE * rate / frequency), 8) + 1)
        turns = np.maximum(np.round(frequency * lengths / rate), 1)
        best = int(np.argmin(np.abs(turns * rate / lengths - frequency) + (2 * turns >= lengths) * rate))
        cycles.append(int(turns[best]))
        samples.append(int(lengths[best]))
    factor = np.abs(shape(np.array(cycles) * rate / np.array(samples)))
    repeats = asked.settle + asked.periods
    parts = [
        size * np.sin(2.0 * np.pi * ((turns * np.arange(repeats * length)) % length) / length)
        for size, turns, length in zip(factor, cycles, samples, strict=True)
    ]
    return np.concatenate(parts), Plan("stepped", 0, asked.settle, asked.periods, 1, tuple(samples), tuple(cycles))


def _noise(asked: Experiment, rate: float, shape: Shape) -> tuple[np.ndarray, Plan]:
    """Return Gaussian noise in a band, limited to :data:`CUT_OFF` standard deviations."""
    N = round(rate * (asked.duration or SEGMENTS * (asked.period or PERIOD / rate) / 2.0))
    segment = min(round(rate * (asked.period or 2.0 * N / rate / SEGMENTS)), N)
    low, high = asked.low or 2.0 * rate / segment, asked.high or HIGHEST * rate
    if low < (1.0 - 1e-9) * rate / segment:
        raise _too_slow(low, segment / rate, "a segment")
    # Box-Muller transform of random numbers that are the same on every machine
    draws = uniform(asked.seed, 2 * N)
    values = np.sqrt(-2.0 * np.log1p(-draws[:N])) * np.cos(2.0 * np.pi * draws[N:])
    frequencies = np.fft.rfftfreq(N, 1.0 / rate)
    # one more line on each side, because the window spreads a line to its neighbours
    inside = (frequencies >= low - 1.5 * rate / segment) & (frequencies <= high + 1.5 * rate / segment)
    inside[0] = False
    values = np.fft.irfft(np.fft.rfft(values) * inside, N)
    limit = CUT_OFF * np.std(values)
    values = np.clip(values, -limit, limit) / limit
    factor = np.zeros(frequencies.size)
    factor[1:] = np.abs(shape(frequencies[1:]))
    lines = int(np.ceil(low * segment / rate - 1e-9)), int(high * segment / rate + 1e-9)
    return np.fft.irfft(np.fft.rfft(values) * factor, N), Plan("noise", 0, 0, 1, 1, (segment, N), lines)


def orthogonal_multisines(inputs: int, period: int, lines, realisations: int, seed: int = 1) -> np.ndarray:
    """Return periods of simultaneous multisines for all inputs, shape (realisations, period, inputs), with peak 1.

    Each group of ``inputs`` realisations has new random phases for every input [1]_ (section 2.7.2); realisation r of
    the group adds 2π i r/inputs to the phases of input i. At each line the spectra of a group therefore form an
    orthogonal matrix.

    Units: ``period`` [samples], ``lines`` [harmonics of the period].
    """
    lines = np.asarray(lines, dtype=int)
    groups = -(-realisations // inputs)
    phases = uniform(seed, groups * inputs * lines.size).reshape(groups, 1, inputs, lines.size)
    number = np.arange(inputs)
    turned = np.outer(number, number)[None, :, :, None] / inputs
    spectra = np.zeros((groups * inputs, inputs, period // 2 + 1), dtype=complex)
    spectra[:, :, lines] = np.exp(2j * np.pi * (phases + turned)).reshape(groups * inputs, inputs, -1)
    samples = np.fft.irfft(spectra[:realisations], period, axis=2).transpose(0, 2, 1)
    return samples / np.max(np.abs(samples))


#: Kinds of excitation by name.
KINDS = {"multisine": _multisine, "stepped": _stepped, "noise": _noise}
