# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Elementary functions: equal to the C library within a few units in the last place, the same bits compiled or not."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import interpreted

#: For each function the arguments, and the allowed difference from the C library [units in the last place].
CASES = {
    "sin": (st.floats(-10.0, 10.0), 2.0),
    "cos": (st.floats(-10.0, 10.0), 2.0),
    "exp": (st.floats(-700.0, 700.0), 2.0),
    "expm1": (st.floats(-40.0, 40.0), 4.0),
    "log": (st.floats(1e-307, 1e307), 2.0),
    "log1p": (st.floats(-0.999999, 1e6), 4.0),
    "tanh": (st.floats(-25.0, 25.0), 4.0),
}


def units_apart(found: float, expected: float, smallest: float = 0.0) -> float:
    return abs(found - expected) / max(math.ulp(expected), smallest)


@pytest.mark.parametrize("name", CASES)
@settings(deadline=None)  # the first call compiles
@given(data=st.data())
def test_values_are_those_of_the_c_library_but_for_the_last_digit(name, data):
    arguments, units = CASES[name]
    x = data.draw(arguments)
    # near a zero at a multiple of pi the argument itself has no more digits
    smallest = 1e-26 if name in ("sin", "cos") and abs(x) > 1.0 else 0.0
    assert units_apart(getattr(elementary, name)(x), getattr(math, name)(x), smallest) <= units


@settings(deadline=None)  # the first call compiles
@given(x=st.floats(1e-6, 1e6), exponent=st.floats(-5.0, 5.0))
def test_powers_are_those_of_the_c_library(x, exponent):
    bound = 4e-16 * (1.0 + abs(exponent * math.log(x)))
    assert elementary.pow(x, exponent) == pytest.approx(math.pow(x, exponent), rel=bound, abs=0.0)


@pytest.mark.parametrize("name", [*CASES, "pow"])
@settings(deadline=None)  # the first call compiles
@given(x=st.one_of(st.floats(-100.0, 100.0), st.floats()))
def test_compiled_and_interpreted_are_the_same_bits(name, x):
    arguments = (abs(x), 1.7) if name == "pow" else (x,)
    function = getattr(elementary, name)
    assert repr(float(function(*arguments))) == repr(float(interpreted(function)(*arguments)))


def test_exact_values():
    assert elementary.sin(0.0) == 0.0 and elementary.cos(0.0) == 1.0
    assert elementary.sin(0.5 * math.pi) == 1.0 and elementary.cos(math.pi) == -1.0
    assert elementary.exp(0.0) == 1.0 and elementary.exp(1.0) == math.e
    assert [elementary.log(2.0**k) for k in (0, 1, -1)] == [0.0, math.log(2.0), -math.log(2.0)]
    assert elementary.pow(0.3, 1.0) == 0.3 and elementary.pow(0.3, 0.0) == 1.0 and elementary.pow(0.0, 0.5) == 0.0
    assert elementary.expm1(1e-20) == 1e-20 and elementary.log1p(1e-20) == 1e-20 and elementary.tanh(1e-20) == 1e-20


def test_smallest_and_largest_values():
    assert elementary.exp(-745.0) == math.exp(-745.0) and elementary.exp(709.7) == pytest.approx(
        math.exp(709.7), rel=1e-15
    )
    assert elementary.log(5e-324) == math.log(5e-324)
    assert elementary.sin(5e-324) == 5e-324


def test_limits_and_what_has_no_value():
    assert elementary.exp(1e4) == math.inf and elementary.exp(710.0) == math.inf and elementary.exp(-1e4) == 0.0
    assert elementary.exp(math.inf) == math.inf and elementary.exp(-math.inf) == 0.0
    assert elementary.expm1(-math.inf) == -1.0 and elementary.expm1(math.inf) == math.inf
    assert elementary.log(0.0) == -math.inf and elementary.log(math.inf) == math.inf
    assert elementary.log1p(-1.0) == -math.inf
    assert elementary.tanh(math.inf) == 1.0 and elementary.tanh(-math.inf) == -1.0
    assert elementary.pow(0.0, -1.0) == math.inf and elementary.pow(math.inf, 0.5) == math.inf
    assert math.isnan(elementary.log(-1.0)) and math.isnan(elementary.sin(2.0 * elementary.LARGEST_ANGLE))
    for name in CASES:
        assert math.isnan(getattr(elementary, name)(math.nan))
