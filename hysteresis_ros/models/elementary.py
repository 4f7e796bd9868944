# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Elementary functions whose results are identical on every processor and C library, compiled or not.

The C library has different versions of ``sin``, ``exp``, … for different processors (with or without fused
multiply-add), which round differently: about one value in a thousand differs in its last digit. Therefore values that a
running axis uses, in a kernel or for its parameters, are computed here only by additions, multiplications and divisions
of float64 in a fixed order, as in Java's ``StrictMath`` [1]_. Errors are below 1.5 units in the last place, unless
stated otherwise; ``math.sqrt``, ``floor``, ``ldexp`` and ``frexp`` are exact or correctly rounded everywhere.

For an argument that is not finite or is outside the domain, the result is NaN or the infinite limit, never an
exception.

References
----------
.. [1] Sun Microsystems, fdlibm 5.3, 1995 (reduction by two parts of the constant, corrections of the leading term).
.. [2] Tang, Table-driven implementation of the exponential function in IEEE floating-point arithmetic, ACM Trans. Math.
   Softw. 15 (1989) 144-157, doi:10.1145/63522.214389.
"""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import numpy as np

from hysteresis_ros.models.block import called

# π/2 in two parts; the first part has 33 bits, so that its multiples by k < 2²⁰ are exact.
_QUARTER_HIGH, _QUARTER_LOW = 1.57079632673412561417e00, 6.07710050650619224932e-11
_QUARTERS = 2.0 / math.pi  # quarter turns per radian
#: Largest angle [rad] for which sine and cosine are computed.
LARGEST_ANGLE = 1e6

# ln 2 and ln 2/32 in two parts each; the first part is short enough for exact multiples.
_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
_STEP_HIGH, _STEP_LOW = 0.021660849392446835, 5.145609244655338e-14
_STEPS = 46.16624130844683  # 32/ln 2
_HALF_ROOT = math.sqrt(0.5)


def _powers_of_two() -> tuple[np.ndarray, np.ndarray]:
    """Return 2^(j/32), j = 0 … 31, rounded, and the errors of the rounding, computed with 50 decimal digits [2]_."""
    with localcontext() as context:
        context.prec = 50
        exact = [Decimal(2) ** (Decimal(j) / 32) for j in range(32)]
        return np.array([float(x) for x in exact]), np.array([float(x - Decimal(float(x))) for x in exact])


_POWERS, _POWERS_REST = _powers_of_two()


@called
def _sine(r, rest):
    """Return the sine of r + rest for |r| ≤ π/4."""
    z = r * r
    zz = z * z
    high = (-1.0 / 39916800.0 + z * (1.0 / 6227020800.0)) + zz * (
        -1.0 / 1307674368000.0 + z * (1.0 / 355687428096000.0)
    )
    low = (1.0 / 120.0 + z * (-1.0 / 5040.0)) + zz * (1.0 / 362880.0 + z * high)
    return r + (r * z * (-1.0 / 6.0 + z * low) + rest * (1.0 - 0.5 * z))


@called
def _cosine(r, rest):
    """Return the cosine of r + rest for |r| ≤ π/4."""
    z = r * r
    zz = z * z
    high = (-1.0 / 3628800.0 + z * (1.0 / 479001600.0)) + zz * (-1.0 / 87178291200.0 + z * (1.0 / 20922789888000.0))
    low = (1.0 / 24.0 + z * (-1.0 / 720.0)) + zz * (1.0 / 40320.0 + z * high)
    half = 0.5 * z
    near = 1.0 - half
    return near + (((1.0 - near) - half) + (zz * low - r * rest))


@called
def _turned(x, quarters):
    """Return the sine of x plus ``quarters`` quarter turns."""
    if not abs(x) <= LARGEST_ANGLE:
        return math.nan
    count = math.floor(x * _QUARTERS + 0.5)
    start = x - count * _QUARTER_HIGH
    shift = count * _QUARTER_LOW
    r = start - shift
    rest = (start - r) - shift
    quadrant = (int(count) + quarters) & 3
    value = _sine(r, rest) if quadrant & 1 == 0 else _cosine(r, rest)
    return value if quadrant < 2 else -value


@called
def sin(x):
    """Return the sine of ``x`` [rad]; NaN beyond :data:`LARGEST_ANGLE`."""
    return _turned(x, 0)


@called
def cos(x):
    """Return the cosine of ``x`` [rad]; NaN beyond :data:`LARGEST_ANGLE`."""
    return _turned(x, 1)


@called
def exp(x):
    """Return e to the power ``x``."""
    if not abs(x) < 800.0:
        if x > 0.0:
            return math.inf
        return 0.0 if x < 0.0 else x  # NaN is returned unchanged
    count = math.floor(x * _STEPS + 0.5)
    j = int(count) & 31
    high = x - count * _STEP_HIGH
    low = count * _STEP_LOW
    r = high - low
    rest = (high - r) - low
    rr = r * r
    tail = (0.5 + r * (1.0 / 6.0)) + rr * ((1.0 / 24.0 + r * (1.0 / 120.0)) + rr * (1.0 / 720.0 + r * (1.0 / 5040.0)))
    part = r + (rr * tail + rest)
    power = float(_POWERS[j])
    return math.ldexp(power + (float(_POWERS_REST[j]) + power * part), (int(count) - j) >> 5)


@called
def expm1(x):
    """Return e to the power ``x``, minus 1; accurate also near zero; errors below 3 units in the last place."""
    if not abs(x) < 0.35:
        return exp(x) - 1.0
    xx = x * x
    high = (1.0 / 40320.0 + x * (1.0 / 362880.0)) + xx * (1.0 / 3628800.0 + x * (1.0 / 39916800.0))
    high += xx * xx * ((1.0 / 479001600.0 + x * (1.0 / 6227020800.0)) + xx * (1.0 / 87178291200.0))
    low = (1.0 / 24.0 + x * (1.0 / 120.0)) + xx * ((1.0 / 720.0 + x * (1.0 / 5040.0)) + xx * high)
    return x + xx * ((0.5 + x * (1.0 / 6.0)) + xx * low)


@called
def log(x):
    """Return the natural logarithm of ``x``."""
    if not 0.0 < x < math.inf:
        if x == 0.0:
            return -math.inf
        return x if x > 0.0 else math.nan
    mantissa, exponent = math.frexp(x)
    if mantissa < _HALF_ROOT:
        mantissa *= 2.0
        exponent -= 1
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    zz = z * z
    high = (2.0 / 15.0 + z * (2.0 / 17.0)) + zz * (
        (2.0 / 19.0 + z * (2.0 / 21.0)) + zz * (2.0 / 23.0 + z * (2.0 / 25.0))
    )
    low = (2.0 / 7.0 + z * (2.0 / 9.0)) + zz * ((2.0 / 11.0 + z * (2.0 / 13.0)) + zz * high)
    series = z * ((2.0 / 3.0 + z * (2.0 / 5.0)) + zz * low)
    half = 0.5 * f * f
    return exponent * _LN2_HIGH - ((half - (s * (half + series) + exponent * _LN2_LOW)) - f)


@called
def log1p(x):
    """Return the natural logarithm of 1 + ``x``; accurate also near zero; errors below 3 units in the last place."""
    whole = 1.0 + x
    if whole == 1.0 or not 0.0 < whole < math.inf:
        return x if whole == 1.0 else log(whole)
    return log(whole) + (x - (whole - 1.0)) / whole


@called
def pow(x, exponent):
    """Return ``x`` ≥ 0 to the power ``exponent``, with a relative error of 2e-16 (1 + |exponent log x|)."""
    if exponent == 0.0:
        return 1.0
    if exponent == 1.0:
        return x
    return exp(exponent * log(x))


@called
def tanh(x):
    """Return the hyperbolic tangent; errors below 3 units in the last place."""
    size = abs(x)
    if not size < 20.0:
        return math.copysign(1.0, x) if size >= 20.0 else x  # NaN is returned unchanged
    grown = expm1(2.0 * size)
    value = grown / (grown + 2.0) if size < 0.5 else 1.0 - 2.0 / (grown + 2.0)
    return value if x >= 0.0 else -value
