"""Reference waveforms: hold, steps, square, triangles, sines, staircase, multisine, chirp and samples from a file.

A waveform is a block whose output depends on the sample counter only (:mod:`hysteresis_ros.references.shapes` states
how the counter becomes a position within the cycle). After the last of ``cycles`` cycles it holds its final value:
where it stands at the end of the cycle, which for square is the last level and for staircase the level reached by
the last step, on which a next cycle would begin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from hysteresis_ros.block import Block
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.parameters import Parameters, group, parameter
from hysteresis_ros.references import shapes
from hysteresis_ros.references.samples import read_samples

TYPES = (
    "hold",
    "steps",
    "square",
    "triangle",
    "decreasing_triangle",
    "sine",
    "decaying_sine",
    "staircase",
    "multisine",
    "chirp",
    "file",
)
#: Prefix of the parameters' names in errors.
PREFIX = "waveform."
LONGEST_PERIOD = 10_000_000


@dataclass(frozen=True)
class StepsParameters(Parameters):
    """Levels at given times; zero before the first, the last one holds."""

    values: tuple[float, ...] = parameter(description="levels, added to the offset", unit="m")
    times: tuple[float, ...] = parameter(description="growing start times of the levels", unit="s", low=0.0)
    period: float = parameter(
        0.0, description="time after which the levels repeat, to the nearest sample; 0 = never", unit="s", low=0.0
    )

    def check(self):
        """Values and times belong together, times grow, the period covers them."""
        if not self.values or len(self.values) != len(self.times):
            yield Problem("times", self.times, f"must have one time for each of the {len(self.values)} values, ≥ 1")
        elif any(later <= earlier for earlier, later in zip(self.times, self.times[1:], strict=False)):
            yield Problem("times", self.times, "must grow strictly")
        elif self.period and self.period <= self.times[-1]:
            yield Problem("period", self.period, f"must be 0 (never) or > {self.times[-1]:g} s, the last time")


@dataclass(frozen=True)
class SquareParameters(Parameters):
    """Upper level first, then lower level."""

    duty: float = parameter(0.5, description="part of the cycle on the upper level", low=0.0, high=1.0)


@dataclass(frozen=True)
class DecayingSineParameters(Parameters):
    """Amplitude falls as exp(−t/decay_time)."""

    decay_time: float = parameter(description="time constant of the amplitude", unit="s", low=1e-9)


@dataclass(frozen=True)
class StaircaseParameters(Parameters):
    """Equal steps up and down again."""

    steps: int = parameter(10, description="steps from the offset to the amplitude", low=1, high=100_000)


@dataclass(frozen=True)
class MultisineParameters(Parameters):
    """Equal amplitudes on harmonics of ``frequency``; ``amplitude`` is the peak of the whole."""

    first_harmonic: int = parameter(1, description="lowest harmonic of frequency", low=1)
    last_harmonic: int = parameter(10, description="highest harmonic of frequency", low=1)
    harmonic_step: int = parameter(1, description="distance of harmonics; 2 from 1 excites odd ones only", low=1)
    phases: str = parameter("schroeder", description="how phases are chosen", choices=("schroeder", "random"))
    seed: int = parameter(1, description="seed of the random phases", low=0)

    @property
    def harmonics(self) -> np.ndarray:
        """The excited harmonics, shape (M,)."""
        return np.arange(self.first_harmonic, self.last_harmonic + 1, self.harmonic_step)

    def check(self):
        """The band is not empty."""
        if self.last_harmonic < self.first_harmonic:
            yield Problem("last_harmonic", self.last_harmonic, f"must be ≥ first_harmonic = {self.first_harmonic}")


@dataclass(frozen=True)
class ChirpParameters(Parameters):
    """A cycle is one sweep from ``frequency`` to ``final_frequency``."""

    final_frequency: float = parameter(description="frequency at the end of the sweep", unit="Hz", low=0.0)
    duration: float = parameter(description="time of one sweep", unit="s", low=1e-9)
    sweep: str = parameter("linear", description="how the frequency grows", choices=("linear", "logarithmic"))


@dataclass(frozen=True)
class FileParameters(Parameters):
    """Samples from CSV, NPZ or NPY, repeated every cycle."""

    path: str = parameter(description="CSV (header names units), NPZ or NPY file")
    column: str = parameter("reference", description="column of the CSV (without unit) or array of the NPZ")
    sample_time: float = parameter(
        0.0,
        description="sample time of the file, interpolated linearly; 0 = must be the generator's",
        unit="s",
        low=0.0,
    )


@dataclass(frozen=True)
class WaveformParameters(Parameters):
    """The waveform that is added to the setpoint."""

    type: str = parameter("hold", description="shape of the waveform", choices=TYPES)
    amplitude: float = parameter(0.0, description="height above the offset (peak)", unit="m", low=0.0)
    frequency: float = parameter(1.0, description="cycles per second; chirp: initial frequency", unit="Hz", low=0.0)
    offset: float = parameter(0.0, description="added to the waveform; the value of hold", unit="m")
    phase: float = parameter(
        0.0, description="phase at the first sample; not for hold, steps, decreasing_triangle, file", unit="rad"
    )
    cycles: int = parameter(0, description="cycles after which the final value is held, 0 = endless", low=0)
    polarity: str = parameter(
        "unipolar",
        description="square, triangles, staircase: from offset to offset + amplitude, or offset ± amplitude",
        choices=("unipolar", "symmetric"),
    )
    steps: StepsParameters = group(StepsParameters, variant_of="type")
    square: SquareParameters = group(SquareParameters, variant_of="type")
    decaying_sine: DecayingSineParameters = group(DecayingSineParameters, variant_of="type")
    staircase: StaircaseParameters = group(StaircaseParameters, variant_of="type")
    multisine: MultisineParameters = group(MultisineParameters, variant_of="type")
    chirp: ChirpParameters = group(ChirpParameters, variant_of="type")
    file: FileParameters = group(FileParameters, variant_of="type")

    def check(self):
        """Entries that exclude each other."""
        if self.type not in ("hold", "steps", "file", "chirp") and not self.frequency > 0.0:
            yield Problem("frequency", self.frequency, f"must be > 0 Hz for {self.type}")
        if self.type in ("hold", "steps", "decreasing_triangle", "file") and self.phase != 0.0:
            yield Problem("phase", self.phase, f"must be 0 for {self.type}, which always starts at its beginning")
        if self.type == "decreasing_triangle" and self.cycles < 1:
            yield Problem("cycles", self.cycles, "must be ≥ 1 for decreasing_triangle: the last cycle ends at zero")
        if self.type == "chirp" and self.chirp.sweep == "logarithmic":
            first, last = self.frequency, self.chirp.final_frequency
            if not (first > 0.0 and last > 0.0 and first != last):
                yield Problem("chirp.final_frequency", last, f"logarithmic: > 0 Hz and not frequency = {first:g} Hz")


class Waveform(Block):
    """One waveform.

    Parameters
    ----------
    parameters : WaveformParameters
        What to play.
    sample_time : float
        Sample time [s].

    Attributes
    ----------
    lowest, highest : float
        Range of the waveform [m], offset included (of the continuous shape where it is a formula).
    crest_factor : float or None
        Peak over root mean square, without the offset, of a multisine.
    period : int or None
        Samples after which the output repeats bit for bit; None where it does not within 2²⁶ samples.

    Raises
    ------
    ParameterError
        Parameters are wrong, a frequency reaches half the sample rate, a multisine's period is not a whole number of
        samples, or a file is missing or does not fit.
    """

    def __init__(self, parameters, sample_time: float):
        self._sample_time = float(sample_time)
        self.kernel = _kernel(parameters.validated(PREFIX))
        self.crest_factor = None
        self.period = None
        super().__init__(parameters, sample_time)

    @property
    def duration_samples(self) -> int:
        """Samples until the waveform has been played; 0 when it has no end.

        The last of several steps counts as long as the one before it.
        """
        kind = self.parameters.type
        if kind == "steps" and self.p[shapes.REPEAT] == 0.0:
            starts = self.p[shapes.TABLE : shapes.TABLE + int(self.p[shapes.COUNT])]
            return int(2 * starts[-1] - starts[-2]) if starts.size > 1 else 0
        return 0 if kind == "hold" else int(self.p[shapes.END])

    def pack(self, parameters) -> np.ndarray:
        """Return the kernel's parameters; their layout is in :mod:`~hysteresis_ros.references.shapes`."""
        kind, amplitude, offset = parameters.type, parameters.amplitude, parameters.offset
        p = np.zeros(shapes.OWN)
        p[[shapes.OFFSET, shapes.AMPLITUDE, shapes.DENOMINATOR]] = offset, amplitude, 1.0
        if kind == "hold":
            self.period, self.lowest, self.highest = 1, offset, offset
            return p
        if kind in ("steps", "file"):
            return self._pack_table(parameters, p)
        duration = parameters.chirp.duration if kind == "chirp" else None
        self._pack_timing(parameters, p, duration)
        self.lowest, self.highest = offset - amplitude, offset + amplitude
        if kind == "multisine":
            return self._pack_multisine(parameters, p)
        p = np.append(p, self._own(parameters, p))
        if kind in ("square", "triangle", "decreasing_triangle", "staircase") and p[shapes.UNIPOLAR]:
            self.lowest = offset
        p[shapes.FINAL] = _final(parameters, p)
        return p

    def _pack_timing(self, parameters, p, duration: float | None = None) -> None:
        """Write the position rule, end and phase; for chirps a cycle takes ``duration``."""
        rate = Fraction(parameters.frequency) if duration is None else 1 / Fraction(duration)
        fastest = parameters.frequency
        name = "frequency"
        if duration is not None and parameters.chirp.final_frequency > fastest:
            fastest, name = parameters.chirp.final_frequency, "chirp.final_frequency"
        if fastest * self._sample_time > 0.5 or rate * Fraction(self._sample_time) > Fraction(1, 2):
            self._refuse(name, fastest, f"must be ≤ {0.5 / self._sample_time:g} Hz, half the sample rate")
        a, b, d = shapes.cycles_per_sample(rate, self._sample_time)
        p[[shapes.NUMERATOR, shapes.DENOMINATOR, shapes.RESIDUAL]] = a, b, d
        endless_repeats = d == 0.0 and parameters.type not in ("decreasing_triangle", "decaying_sine")
        self.period = b if endless_repeats and parameters.cycles == 0 else None
        if duration is None:
            p[shapes.PHASE] = _turns(parameters.phase)
        if parameters.cycles:
            p[shapes.END] = math.ceil(parameters.cycles / (Fraction(a, b) + Fraction(d)))

    def _own(self, parameters, p) -> list[float]:
        """Return the parameters of the shape's own."""
        unipolar = 1.0 if parameters.polarity == "unipolar" else 0.0
        kind = parameters.type
        if kind == "square":
            return [unipolar, parameters.square.duty]
        if kind == "triangle":
            return [unipolar]
        if kind == "decreasing_triangle":
            return [unipolar, float(parameters.cycles)]
        if kind == "staircase":
            return [unipolar, parameters.staircase.steps * (2.0 if unipolar else 4.0)]
        if kind == "decaying_sine":
            return [self._sample_time / parameters.decaying_sine.decay_time]
        if kind == "chirp":
            first, chirp = parameters.frequency, parameters.chirp
            if chirp.sweep == "linear":
                curve = 0.5 * (chirp.final_frequency - first) * chirp.duration
                return [_turns(parameters.phase), first * chirp.duration, curve]
            growth = math.log(chirp.final_frequency / first)
            return [_turns(parameters.phase), first * chirp.duration / growth, growth]
        return []

    def _pack_multisine(self, parameters, p) -> np.ndarray:
        own = parameters.multisine
        samples, harmonics = int(p[shapes.DENOMINATOR]), own.harmonics
        if p[shapes.NUMERATOR] != 1.0 or p[shapes.RESIDUAL] != 0.0 or samples > LONGEST_PERIOD:
            whole = min(max(round(1.0 / (parameters.frequency * self._sample_time)), 2), LONGEST_PERIOD)
            near = 1.0 / (whole * self._sample_time)
            self._refuse(
                "frequency",
                parameters.frequency,
                f"the period of a multisine must be a whole number of samples ≤ {LONGEST_PERIOD}; nearest {near!r} Hz",
            )
        if 2 * harmonics[-1] >= samples:
            largest = (samples - 1) // 2
            self._refuse(
                "multisine.last_harmonic", own.last_harmonic, f"must be ≤ {largest}, below half the sample rate"
            )
        count = harmonics.size
        index = np.arange(1, count + 1)
        if own.phases == "schroeder":
            # M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85, flat spectrum: Σ cos(… − π i(i−1)/M), as sines.
            phases = 0.25 - 0.5 * ((index * (index - 1)) % (2 * count)) / count
        else:
            # The raw stream of a bit generator is the same in every NumPy (NEP 19); that of distributions need not be.
            phases = (np.random.PCG64(own.seed).random_raw(count) >> np.uint64(11)) * 2.0**-53
        spectrum = np.zeros(samples // 2 + 1, dtype=complex)
        # One period of the sum of sin(2π (h (k/N + phase) + φ_h)).
        spectrum[harmonics] = -0.5j * samples * np.exp(2j * np.pi * (phases + harmonics * p[shapes.PHASE]))
        period = np.fft.irfft(spectrum, samples)
        # A part in 10¹² less, so that the kernel's own rounding cannot exceed the amplitude.
        scale = (1.0 - 1e-12) / np.max(np.abs(period))
        self.crest_factor = float(np.max(np.abs(period)) / np.sqrt(0.5 * count))
        self.lowest = parameters.offset + parameters.amplitude * scale * float(np.min(period))
        self.highest = parameters.offset + parameters.amplitude * scale * float(np.max(period))
        p[shapes.AMPLITUDE] = parameters.amplitude * scale
        p = np.concatenate([p, [count], np.column_stack([harmonics, phases % 1.0]).ravel()])
        p[shapes.FINAL] = _first(shapes.multisine, p)
        return p

    def _pack_table(self, parameters, p) -> np.ndarray:
        if parameters.type == "file":
            own = parameters.file
            table = values = read_samples(own.path, own.column, own.sample_time, self._sample_time, f"{PREFIX}file.")
            repeat = values.size
        else:
            own = parameters.steps
            # The first sample at or after each time; rounding of t/Ts must not delay it.
            starts = np.ceil(np.array(own.times) / self._sample_time - 1e-6)
            repeat = round(own.period / self._sample_time)
            if np.any(np.diff(starts) <= 0.0) or 0 < repeat <= starts[-1]:
                text = f"must be at least one sample ({self._sample_time:g} s) apart, also from the period"
                self._refuse("steps.times", own.times, text)
            values = np.array(own.values)
            table = np.concatenate([starts, values])
            if starts[0] > 0.0:
                values = np.append(values, 0.0)
        self.period = repeat if repeat and not parameters.cycles else None
        self.lowest = parameters.offset + float(np.min(values))
        self.highest = parameters.offset + float(np.max(values))
        p[shapes.END] = parameters.cycles * repeat
        p[shapes.FINAL] = parameters.offset + table[-1]
        count = table.size if parameters.type == "file" else len(parameters.steps.values)
        return np.concatenate([p, [count, repeat], table])

    def _refuse(self, name, value, allowed):
        raise ParameterError([Problem(PREFIX + name, value, allowed)])

    def retune(self, parameters) -> None:
        """Refuse: another waveform may have another size; build a new one.

        Raises
        ------
        ParameterError
            Unless the parameters are the present ones.
        """
        if parameters != self.parameters:
            text = "a waveform in use cannot change; stop the generator first"
            raise ParameterError([Problem(PREFIX + "type", parameters.type, text)])


def _kernel(parameters):
    if parameters.type == "chirp":
        linear = parameters.chirp.sweep == "linear"
        return shapes.chirp_linear if linear else shapes.chirp_logarithmic
    return getattr(shapes, parameters.type)


def _turns(phase: float) -> float:
    turns = phase / shapes.TWO_PI
    return (turns - math.floor(turns)) % 1.0


def _first(kernel, p) -> float:
    """Output of an endless waveform at its first sample."""
    endless = p.copy()
    endless[shapes.END] = 0.0
    return kernel(endless, np.zeros(1), 0.0)


def _final(parameters, p) -> float:
    """Value after the last cycle: where a next cycle would begin, except where that would be a jump."""
    kind = parameters.type
    if kind == "decreasing_triangle":
        return parameters.offset
    if kind == "square":
        before = p.copy()
        before[shapes.PHASE] = (p[shapes.PHASE] - 1e-6) % 1.0
        return _first(shapes.square, before)
    if kind == "decaying_sine":
        decay = math.exp(-parameters.cycles / (parameters.frequency * parameters.decaying_sine.decay_time))
        return parameters.offset + parameters.amplitude * decay * math.sin(shapes.TWO_PI * p[shapes.PHASE])
    if kind == "chirp":
        rise = p[shapes.CHIRP_CURVE]
        angle = p[shapes.CHIRP_LINEAR] * math.expm1(rise)
        if parameters.chirp.sweep == "linear":
            angle = p[shapes.CHIRP_LINEAR] + rise
        angle += p[shapes.CHIRP_PHASE]
        return parameters.offset + parameters.amplitude * math.sin(shapes.TWO_PI * (angle - math.floor(angle)))
    return _first(_kernel(parameters), p)
