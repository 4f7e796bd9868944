# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Hand-over: the output continues from its last value and fades to the new input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.control import controller as module
from hysteresis_ros.control.controller import Handover, HandoverParameters, arm

finite = st.floats(-1e-3, 1e-3)


@pytest.mark.slow
def test_without_arming_it_is_a_wire():
    block = Handover(HandoverParameters(), 1e-3)
    u = np.linspace(-1e-5, 1e-5, 50)
    assert (block.simulate(u) == u).all()


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(finite, finite)
def test_armed_output_equals_the_last_one_exactly_and_fades_exponentially(before, after):
    block = Handover(HandoverParameters(time=0.01), 1e-3)
    block.step(before)
    arm(block)
    y = block.simulate(np.full(400, after))
    assert y[0] == before
    expected = after + (before - after) * np.exp(-0.1 * np.arange(400))
    assert y == pytest.approx(expected, rel=1e-9, abs=1e-17)


def test_bias_ends_at_zero():
    block = Handover(HandoverParameters(time=0.01), 1e-3)
    block.step(1e-5)
    arm(block)
    block.simulate(np.full(2000, 2e-5))
    assert block.x[module.BIAS] == 0.0
    arm(block)
    block.simulate(np.zeros(10000))
    assert block.x[module.BIAS] == 0.0


def test_arming_while_fading_and_from_another_value():
    block = Handover(HandoverParameters(time=0.01), 1e-3)
    block.step(1e-5)
    arm(block)
    last = block.simulate(np.full(5, 0.0))[-1]
    arm(block)
    assert block.step(5e-5) == last
    arm(block, 3e-5)
    assert block.step(-1e-5) == 3e-5


def test_no_time_means_at_once():
    block = Handover(HandoverParameters(time=0.0), 1e-3)
    block.step(1e-5)
    arm(block)
    assert block.step(2e-5) == 2e-5


def test_decay_follows_the_time_constant():
    assert Handover(HandoverParameters(time=0.2), 0.01).p[module.DECAY] == math.exp(-0.05)
