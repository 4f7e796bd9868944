# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Declaration of a waveform, and the computation of its position within the cycle.

The state ``x`` is the sample counter k (exact up to 2⁵³). The position within the cycle is not accumulated from sample
to sample. Instead, ``frequency · sample_time`` is expressed once as a fraction a/b with b ≤ 2²⁶, plus a residual d, and
the position is

    frac( ((k mod b) · a mod b) / b + k · d + phase / 2π ).

The products of the first term stay below 2⁵², so this term is exact for every k. The residual is zero if the product of
frequency and sample time equals a fraction within the rounding of these numbers (2⁻⁵¹ relative). The waveform then
repeats bit for bit every b samples; a period of N whole samples gives b = N. With a residual, |d| ≤ 2⁻²⁶/b keeps the
rounding error of ``k · d`` below 1e-15 of a cycle after 10⁹ samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, NoReturn

import numpy as np

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import kernel

#: State.
COUNTER = 0

#: Parameters common to all waveforms: END is the sample from which on FINAL is held (0: there is no end).
OFFSET, AMPLITUDE, NUMERATOR, DENOMINATOR, RESIDUAL, PHASE, END, FINAL = range(8)
#: Index of the first parameter that only one waveform uses.
OWN = 8
#: Index of the polarity in waveforms that have one; 1: they rise from the offset; 0: they are symmetric about it.
UNIPOLAR = OWN

TWO_PI = 2.0 * math.pi
#: Tolerance [cycles] within which an edge of square or staircase counts as being at a sample, because of rounding.
EDGE = 1e-9
LARGEST_DENOMINATOR = 2**26


def cycles_per_sample(frequency: float | Fraction, sample_time: float) -> tuple[int, int, float]:
    """Return (a, b, d) with ``frequency · sample_time`` = a/b + d, as described at the top of this module."""
    exact = Fraction(frequency) * Fraction(sample_time)
    fraction = exact.limit_denominator(LARGEST_DENOMINATOR)
    residual = exact - fraction
    if abs(residual) <= exact / 2**51:
        residual = Fraction(0)
    return fraction.numerator, fraction.denominator, float(residual)


@kernel
def turns(p, k):
    """Return the position within the cycle at sample ``k``, in [0, 1)."""
    b = p[DENOMINATOR]
    position = ((k % b) * p[NUMERATOR]) % b / b + k * p[RESIDUAL] + p[PHASE]
    position -= math.floor(position)
    return position if position < 1.0 else 0.0


@kernel
def whole_turns(p, k):
    """Return the number of whole cycles before sample ``k`` (for phase 0)."""
    b = p[DENOMINATOR]
    rest = k % b
    product = rest * p[NUMERATOR]
    part = product % b
    return (k - rest) / b * p[NUMERATOR] + (product - part) / b + math.floor(part / b + k * p[RESIDUAL])


@kernel
def triangle_shape(position, unipolar):
    """Return a triangle of height 1 at ``position`` in [0, 1): 0 → 1 → 0 (unipolar) or 0 → 1 → −1 → 0 (symmetric)."""
    if unipolar > 0.0:
        return 2.0 * position if position < 0.5 else 2.0 - 2.0 * position
    if position < 0.25:
        return 4.0 * position
    return 2.0 - 4.0 * position if position < 0.75 else 4.0 * position - 4.0


#: Prefix of the parameters' names in errors.
PREFIX = "waveform."


@dataclass(frozen=True, eq=False)
class Packed:
    """A waveform, prepared for one set of parameters.

    Parameters
    ----------
    p : ndarray
        Parameters of the kernel, in the layout of :mod:`hysteresis_ros.references.declaration`.
    kernel : callable
        ``y = kernel(p, x, u)``; the state is the sample counter.
    lowest, highest : float
        Range [m], including the offset.
    period : int or None
        Number of samples after which the output repeats bit for bit; None if there is no such number.
    crest_factor : float or None
        Peak divided by root mean square, without the offset; None if unknown.
    edges : ndarray, optional
        Scan edges of each sample as bits (:meth:`.ScanClock.edges`); a single 0: no scan.
    """

    p: np.ndarray
    kernel: Callable
    lowest: float
    highest: float
    period: int | None
    crest_factor: float | None = None
    edges: np.ndarray = field(default_factory=lambda: np.zeros(1))


def _nothing_wrong(parameters) -> Iterable[Problem]:
    return ()


def _end(p) -> int:
    return int(p[END])


@dataclass(frozen=True, eq=False)
class WaveformShape:
    """A waveform: its type, its parameters, and the properties that other parts of the package use.

    Parameters
    ----------
    name : str
        ``type`` of the waveform.
    pack : callable
        ``pack(parameters, sample_time)`` returns a :class:`Packed` for WaveformParameters; :func:`cyclic` makes such a
        function from a kernel.
    parameters : type of Parameters, optional
        Parameters of this waveform only, in a group with the waveform's name.
    takes_frequency, takes_phase, takes_polarity : bool, optional
        Whether the waveform uses these shared parameters.
    begins_at_frequency : bool, optional
        Whether ``frequency`` is only the frequency at the beginning, which may be 0 Hz.
    check : callable, optional
        ``check(parameters)`` yields a Problem for each inconsistency; names are relative to WaveformParameters.
    extent : str, optional
        Name of the parameter that determines the amplitude.
    periodic : bool, optional
        Whether the waveform has a single frequency, which is compared with the bandwidth of the axis; False for
        experiments (chirp, multisine).
    fundamental : callable, optional
        ``fundamental(parameters)`` returns the amplitude of the fundamental divided by half the height of the waveform;
        None for waveforms with jumps, which are treated as steps.
    jumps : bool, optional
        Whether the waveform jumps from one level to another; with ``approach.steps``, jumps keep the limits of the
        approach.
    duration : callable, optional
        ``duration(p)`` returns the length of the waveform in samples, 0 if it has no end.
    example : Parameters, optional
        Parameters of this waveform for an example; needed if they have no defaults.
    """

    name: str
    pack: Callable[[Any, float], Packed]
    parameters: type[Parameters] | None = None
    takes_frequency: bool = True
    takes_phase: bool = True
    takes_polarity: bool = False
    begins_at_frequency: bool = False
    check: Callable[[Any], Iterable[Problem]] = _nothing_wrong
    extent: str = "amplitude"
    periodic: bool = False
    fundamental: Callable[[Any], float] | None = None
    jumps: bool = False
    duration: Callable[[np.ndarray], int] = _end
    example: Parameters | None = None


def refuse(name: str, value, remedy: str) -> NoReturn:
    """Raise a ParameterError about a parameter of a waveform.

    Raises
    ------
    ParameterError
        Always; the message contains the name of the parameter, its value and what is allowed.
    """
    raise ParameterError([Problem(PREFIX + name, value, remedy)])


def head(parameters) -> np.ndarray:
    """Return the parameters common to all kernels, shape (8,), with offset and amplitude."""
    p = np.zeros(OWN)
    p[[OFFSET, AMPLITUDE, DENOMINATOR]] = parameters.offset, parameters.amplitude, 1.0
    return p


def time_cycles(p, parameters, sample_time: float, rate: Fraction, fastest: tuple[str, float]) -> int | None:
    """Write the end and the numbers for the position within the cycle into ``p``; return the period [samples] or None.

    Parameters
    ----------
    p : ndarray
        Parameter array of :func:`head`.
    parameters : WaveformParameters
    sample_time : float
        [s]
    rate : Fraction
        Cycles per second.
    fastest : (str, float)
        Name and value of the waveform's highest frequency [Hz].

    Raises
    ------
    ParameterError
        The highest frequency is above half the sample rate.
    """
    name, frequency = fastest
    if frequency * sample_time > 0.5 or rate * Fraction(sample_time) > Fraction(1, 2):
        refuse(name, frequency, f"must be ≤ {0.5 / sample_time:g} Hz, half the sample rate")
    a, b, d = cycles_per_sample(rate, sample_time)
    p[[NUMERATOR, DENOMINATOR, RESIDUAL]] = a, b, d
    if parameters.cycles:
        p[END] = math.ceil(parameters.cycles / (Fraction(a, b) + Fraction(d)))
    return b if d == 0.0 and not parameters.cycles else None


def turns_of(phase: float) -> float:
    """Return a phase, given in rad, as a fraction of a turn in [0, 1)."""
    turns = phase / TWO_PI
    return (turns - math.floor(turns)) % 1.0


def first_value(kernel, p) -> float:
    """Return the first sample of a waveform [m], as if it had no end."""
    endless = p.copy()
    endless[END] = 0.0
    return kernel(endless, np.zeros(1), 0.0)


def cyclic(kernel, own=None, final=None, polarity: bool = False, repeats: bool = True):
    """Return the ``pack`` of a waveform; its kernel computes offset ± amplitude from the position within the cycle.

    Parameters
    ----------
    kernel : callable
    own : callable, optional
        ``own(parameters, sample_time)`` returns the numbers in ``p`` that only this waveform has; they follow the
        polarity, if there is one.
    final : callable, optional
        ``final(parameters, p)`` returns the value that is held after the last cycle; by default the first value of the
        next cycle.
    polarity : bool
        Whether the waveform has the parameter ``polarity``.
    repeats : bool
        Whether all cycles are equal.
    """

    def pack(parameters, sample_time: float) -> Packed:
        p = head(parameters)
        frequency, amplitude, offset = parameters.frequency, parameters.amplitude, parameters.offset
        period = time_cycles(p, parameters, sample_time, Fraction(frequency), ("frequency", frequency))
        p[PHASE] = turns_of(parameters.phase)
        lowest, numbers = offset - amplitude, []
        if polarity:
            unipolar = parameters.polarity == "unipolar"
            numbers.append(1.0 if unipolar else 0.0)
            lowest = offset if unipolar else lowest
        if own is not None:
            numbers += own(parameters, sample_time)
        p = np.append(p, numbers)
        p[FINAL] = first_value(kernel, p) if final is None else final(parameters, p)
        return Packed(p, kernel, lowest, offset + amplitude, period if repeats else None)

    return pack
