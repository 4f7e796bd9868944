"""Kernels of the reference waveforms: each depends on the sample counter alone.

The state ``x`` is the sample counter k (exact up to 2⁵³). The position within the cycle is never accumulated:
``frequency · sample_time`` is written once as a fraction a/b with b ≤ 2²⁶ plus a residual d, and the position is

    frac( ((k mod b) · a mod b) / b + k · d + phase / 2π ).

The products of the first term stay below 2⁵², so it is exact for every k. The residual is zero whenever frequency
and sample time, as the floating-point numbers they are, agree with a fraction within their own rounding (2⁻⁵¹
relative): the waveform then repeats bit for bit every b samples, for a period of N whole samples every N = b. With
a residual, |d| ≤ 2⁻²⁶/b makes the rounding of ``k · d`` harmless: below 1e-15 of a cycle after 10⁹ samples.
"""

from __future__ import annotations

import math
from fractions import Fraction

from hysteresis_ros.block import kernel

#: State.
COUNTER = 0

#: Parameters common to all waveforms: END is the sample from which FINAL is held (0 = endless).
OFFSET, AMPLITUDE, NUMERATOR, DENOMINATOR, RESIDUAL, PHASE, END, FINAL = range(8)
#: First parameter of each shape's own.
OWN = 8

UNIPOLAR = OWN  # square, triangle, decreasing_triangle, staircase: 1 from offset upwards, 0 symmetric
DUTY = OWN + 1  # square
CYCLES = OWN + 1  # decreasing_triangle
LEVELS = OWN + 1  # staircase: levels a cycle
DECAY = OWN  # decaying_sine: 1/samples
COMPONENTS = OWN  # multisine: number of components; then pairs (harmonic, phase in turns)
CHIRP_PHASE, CHIRP_LINEAR, CHIRP_CURVE = OWN, OWN + 1, OWN + 2  # chirp: turns
COUNT, REPEAT, TABLE = OWN, OWN + 1, OWN + 2  # steps, file: entries, samples after which it repeats (0 = never)

TWO_PI = 2.0 * math.pi
#: Edges of square and staircase that fall on a sample belong to that sample in spite of rounding [cycles].
EDGE = 1e-9
LARGEST_DENOMINATOR = 2**26


def cycles_per_sample(frequency: float, sample_time: float) -> tuple[int, int, float]:
    """Return (a, b, d) with ``frequency · sample_time`` = a/b + d, by the rule at the top of this module."""
    exact = Fraction(frequency) * Fraction(sample_time)
    fraction = exact.limit_denominator(LARGEST_DENOMINATOR)
    residual = exact - fraction
    if abs(residual) <= exact / 2**51:
        residual = Fraction(0)
    return fraction.numerator, fraction.denominator, float(residual)


@kernel
def turns(p, k):
    """Position within the cycle at sample ``k``, in [0, 1)."""
    b = p[DENOMINATOR]
    position = ((k % b) * p[NUMERATOR]) % b / b + k * p[RESIDUAL] + p[PHASE]
    position -= math.floor(position)
    return position if position < 1.0 else 0.0


@kernel
def whole_turns(p, k):
    """Whole cycles before sample ``k`` (for phase 0)."""
    b = p[DENOMINATOR]
    rest = k % b
    product = rest * p[NUMERATOR]
    part = product % b
    return (k - rest) / b * p[NUMERATOR] + (product - part) / b + math.floor(part / b + k * p[RESIDUAL])


@kernel
def triangle_shape(position, unipolar):
    """Triangle of height one: 0 → 1 → 0 (unipolar) or 0 → 1 → −1 → 0 (symmetric), ``position`` in [0, 1)."""
    if unipolar > 0.0:
        return 2.0 * position if position < 0.5 else 2.0 - 2.0 * position
    if position < 0.25:
        return 4.0 * position
    return 2.0 - 4.0 * position if position < 0.75 else 4.0 * position - 4.0


@kernel
def hold(p, x, u):
    """Constant offset."""
    x[COUNTER] += 1.0
    return p[OFFSET]


@kernel
def square(p, x, u):
    """Upper level for the first ``duty`` of each cycle, lower level for the rest."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    position = turns(p, k) + EDGE
    position -= math.floor(position)
    if position < p[DUTY]:
        return p[OFFSET] + p[AMPLITUDE]
    return p[OFFSET] if p[UNIPOLAR] > 0.0 else p[OFFSET] - p[AMPLITUDE]


@kernel
def triangle(p, x, u):
    """Triangle of constant amplitude."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[AMPLITUDE] * triangle_shape(turns(p, k), p[UNIPOLAR])


@kernel
def decreasing_triangle(p, x, u):
    """Triangle with amplitude A (n − i)/n in cycle i = 0 … n − 1, then the offset."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if k >= p[END]:
        return p[FINAL]
    amplitude = p[AMPLITUDE] * ((p[CYCLES] - whole_turns(p, k)) / p[CYCLES])
    return p[OFFSET] + amplitude * triangle_shape(turns(p, k), p[UNIPOLAR])


@kernel
def staircase(p, x, u):
    """Triangle held on equidistant levels."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    level = math.floor(turns(p, k) * p[LEVELS] + EDGE * p[LEVELS])
    if level >= p[LEVELS]:
        level = 0.0
    return p[OFFSET] + p[AMPLITUDE] * triangle_shape(level / p[LEVELS], p[UNIPOLAR])


@kernel
def sine(p, x, u):
    """Sine around the offset."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[AMPLITUDE] * math.sin(TWO_PI * turns(p, k))


@kernel
def decaying_sine(p, x, u):
    """Sine around the offset whose amplitude decays as exp(−t/decay_time)."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[AMPLITUDE] * math.exp(-k * p[DECAY]) * math.sin(TWO_PI * turns(p, k))


@kernel
def multisine(p, x, u):
    """Sum of harmonics of equal amplitude; p[AMPLITUDE] is that of one harmonic."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    position = turns(p, k)
    total = 0.0
    for i in range(int(p[COMPONENTS])):
        angle = p[COMPONENTS + 1 + 2 * i] * position + p[COMPONENTS + 2 + 2 * i]
        total += math.sin(TWO_PI * (angle - math.floor(angle)))
    return p[OFFSET] + p[AMPLITUDE] * total


@kernel
def chirp_linear(p, x, u):
    """Sine whose frequency grows linearly over the sweep: turns = f0 T s + (f1 − f0) T s²/2, s = position."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    s = turns(p, k)
    angle = (p[CHIRP_LINEAR] + p[CHIRP_CURVE] * s) * s + p[CHIRP_PHASE]
    return p[OFFSET] + p[AMPLITUDE] * math.sin(TWO_PI * (angle - math.floor(angle)))


@kernel
def chirp_logarithmic(p, x, u):
    """Sine whose frequency grows exponentially: turns = f0 T (r^s − 1)/ln r, r = f1/f0."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    angle = p[CHIRP_LINEAR] * math.expm1(p[CHIRP_CURVE] * turns(p, k)) + p[CHIRP_PHASE]
    return p[OFFSET] + p[AMPLITUDE] * math.sin(TWO_PI * (angle - math.floor(angle)))


@kernel
def steps(p, x, u):
    """Value i from its start sample on, zero before the first; binary search of the start samples."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    if p[REPEAT] > 0.0:
        k = k % p[REPEAT]
    count = int(p[COUNT])
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if p[TABLE + middle] <= k:
            low = middle + 1
        else:
            high = middle
    return p[OFFSET] if low == 0 else p[OFFSET] + p[TABLE + count + low - 1]


@kernel
def file(p, x, u):
    """Samples of a table, repeated."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[TABLE + int(k % p[REPEAT])]
