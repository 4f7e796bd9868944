# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Structured arguments of ``hr.simulate`` and ``hr.sweep`` mean what the words of the commands mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import hysteresis_ros as hr
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.loop.faults import DELAY, FAULTS, parse_fault


@given(
    name=st.sampled_from(sorted(FAULTS)),
    start=st.floats(0.0, 1e6),
    duration=st.floats(1e-9, 1e6),
    share=st.floats(0.0, 1.0),
)
def test_a_fault_is_the_words_that_it_writes(name, start, duration, share):
    kind = FAULTS[name]
    value = None
    if kind.value is not None:
        value = 1.0 + np.floor(100.0 * share) if kind.action == DELAY else share
    fault = hr.Fault(name, start, duration, value)
    assert parse_fault(str(fault)) == fault and (fault.value is None) == (kind.value is None)


@pytest.mark.parametrize("text", ["stale:0.1:0.3", "offset:0:1", "offset:1e-2:0.5:2e-7", "late:0:2:3", "drop:0.5:1:0.25"])
def test_words_are_the_fault(text):
    name, *numbers = text.split(":")
    assert parse_fault(text) == hr.Fault(name, *map(float, numbers)) == parse_fault(str(parse_fault(text)))


def test_a_default_value_is_that_of_the_words():
    assert hr.Fault("spike", 0.0, 1.0).value == FAULTS["spike"].value == parse_fault("spike:0:1").value


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("stail", 0.0, 1.0), "there is no fault 'stail'; did you mean stale"),
        (("stale", -1.0, 1.0), "START must be ≥ 0"),
        (("stale", 0.0, 0.0), "DURATION > 0"),
        (("stale", 0.0, 1.0, 2.0), "stale has no VALUE"),
        (("drop", 0.0, 1.0, 2.0), "VALUE must be within 0 … 1"),
        (("late", 0.0, 1.0, 1.5), "VALUE must be within 1"),
        (("stale", "0.1", 1.0), "start = '0.1': must be a number"),
        (("stale", float("nan"), 1.0), "write NAME:START:DURATION"),
    ],
)
def test_a_wrong_fault_is_refused_when_it_is_made(arguments, message):
    with pytest.raises(HysteresisError, match=message):
        hr.Fault(*arguments)


def test_a_run_with_a_fault_is_bit_for_bit_that_with_its_words():
    words = hr.simulate("kim2009", duration=0.03, faults=["offset:0.01:0.005:2e-7", "stale:0.02:0.005"])
    objects = [hr.Fault("offset", 0.01, 0.005, 2e-7), hr.Fault("stale", 0.02, 0.005)]
    run = hr.simulate("kim2009", duration=0.03, faults=objects)
    for name in words.signals:
        np.testing.assert_array_equal(run[name], words[name])
    # the fault is in the run and in its configuration: the same run comes from it again
    again = hr.simulate(run, duration=0.03)
    np.testing.assert_array_equal(again.measured, run.measured)
    assert not np.array_equal(run.measured, hr.simulate("kim2009", duration=0.03).measured, equal_nan=True)
