# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameter tables: conversion, ranges, names in messages, and conversion back to YAML."""

from dataclasses import FrozenInstanceError, dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.configuration import Parameters, group, parameter, variants
from hysteresis_ros.errors import HysteresisError, ParameterError, Problem


@dataclass(frozen=True)
class Inner(Parameters):
    gain: float = parameter(unit="m/V", low=0.0, description="gain")
    points: tuple[float, ...] = parameter((), description="points")


@dataclass(frozen=True)
class Other(Parameters):
    count: int = parameter(3, low=1, high=9, description="count")


@dataclass(frozen=True)
class Outer(Parameters):
    type: str = parameter("inner", choices=("inner", "other"), read_only=True, description="which")
    inner: Inner = group(Inner, variant_of="type")
    other: Other = group(Other, variant_of="type")
    fast: bool = parameter(False, description="fast")
    low: float = parameter(0.0, unit="V", description="low")
    high: float = parameter(1.0, unit="V", description="high")

    def check(self):
        if not self.low < self.high:
            yield Problem("low", self.low, f"must be below high = {self.high:g} V")


def problems(mapping, prefix=""):
    with pytest.raises(ParameterError) as refusal:
        Outer.from_mapping(mapping, prefix)
    return {problem.name: str(problem) for problem in refusal.value.problems}


def test_the_table_has_dotted_names_types_and_ranges():
    rows = {row.name: row for row in Outer.table()}
    assert list(rows) == ["type", "inner.gain", "inner.points", "other.count", "fast", "low", "high"]
    assert rows["inner.gain"].required and rows["inner.gain"].allowed() == "double ≥ 0 m/V"
    assert rows["other.count"].allowed() == "integer in 1 … 9"
    assert rows["type"].read_only and rows["type"].allowed() == "string, one of inner, other"
    assert rows["inner.points"].type_name == "double array"


def test_values_arrive_typed_and_whole_numbers_serve_as_doubles():
    made = Outer.from_mapping({"inner.gain": 2, "inner.points": [1, 2.5], "fast": True})
    assert made.inner.gain == 2.0 and isinstance(made.inner.gain, float)
    assert made.inner.points == (1.0, 2.5)
    with pytest.raises(FrozenInstanceError):
        made.fast = False


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("inner.gain", "much", "wrong type, allowed: double"),
        ("inner.gain", True, "wrong type, allowed: double"),
        ("inner.gain", -1.0, "out of range, allowed: double ≥ 0 m/V"),
        ("inner.gain", float("nan"), "must be finite"),
        ("inner.points", 3.0, "wrong type, allowed: double array"),
        ("inner.points", "123", "wrong type, allowed: double array"),
        ("other.count", 2.5, "wrong type, allowed: integer"),
        ("other.count", 10, "1 … 9"),
        ("fast", 1, "wrong type, allowed: bool"),
        ("type", "third", "one of inner, other"),
        ("type", "iner", "one of inner, other; did you mean inner?"),
    ],
)
def test_each_wrong_value_is_named_with_what_is_allowed(name, value, said):
    found = problems({"inner.gain": 1.0, name: value}, "node: ")
    assert set(found) == {f"node: {name}"} and said in found[f"node: {name}"]


def test_unknown_and_missing_ones_are_named_with_what_to_do():
    assert "did you mean inner.gain?" in problems({"inner.gian": 1.0})["inner.gian"]
    assert problems({})["inner.gain"] == "inner.gain = None: missing; give a double ≥ 0 m/V"


def test_the_parameters_of_a_variant_that_is_not_chosen_may_be_incomplete():
    assert Outer.from_mapping({"type": "other"}).other.count == 3


def test_groups_may_come_from_a_registry():
    @dataclass(frozen=True)
    @variants("type", {"inner": Inner, "other": Other})
    class Chosen(Parameters):
        type: str = parameter("inner", choices=("inner", "other"), description="which")

    assert [row.name for row in Chosen.table()] == ["type", "inner.gain", "inner.points", "other.count"]
    assert Chosen.from_mapping({"type": "other", "other.count": 4}).other == Other(4)
    with pytest.raises(ParameterError, match=r"inner\.gain = None: missing"):
        Chosen.from_mapping({})


def test_inconsistent_parameters_are_refused_with_their_prefix():
    assert problems({"inner.gain": 1.0, "low": 2.0}, "p: ") == {"p: low": "p: low = 2.0: must be below high = 1 V"}


def test_parameters_built_in_python_are_checked_alike():
    with pytest.raises(ParameterError, match=r"x\.inner\.gain = -1\.0: out of range"):
        Outer(inner=Inner(gain=-1.0)).validated("x.")
    assert issubclass(ParameterError, HysteresisError) and issubclass(HysteresisError, ValueError)


@pytest.mark.slow
@given(
    st.floats(0.0, 1e9),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=5),
    st.integers(1, 9),
    st.booleans(),
)
def test_a_mapping_comes_back_as_the_same_parameters(gain, points, count, fast):
    made = Outer(inner=Inner(gain, tuple(points)), other=Other(count), fast=fast)
    assert Outer.from_mapping(made.to_mapping()) == made
