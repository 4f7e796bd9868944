# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fraction of a period's error that is learned: the least gain, a restart, and the effect of missing errors."""

from __future__ import annotations

import numpy as np
import pytest
from learning_support import REFERENCE, N, followed, learning

from hysteresis_ros.control.learning import FROZEN, LEARNING


def gains(errors) -> np.ndarray:
    """Return the fraction of the error that each period has removed, in a loop with one sample of delay."""
    return 1.0 - errors[1:, 5] / errors[:-1, 5]


def test_the_gain_of_averaging_falls_to_the_least_gain_and_no_further():
    block = learning(error_filter=(1.0,), lead=1, gain=0.8, averaging=1.0, least_gain=0.2)
    _, e = followed(block, (0.0, 1.0), 14, REFERENCE + 5e-7)
    # 1/j of the periods 2 … 5, then a fifth
    found = gains(e)
    assert found[1:4] == pytest.approx([1 / 3, 1 / 4, 1 / 5], rel=1e-6)
    assert found[4:12] == pytest.approx(np.full(8, 0.2), rel=1e-6)


@pytest.mark.parametrize("how", ["frozen and learned again", "another reference"])
def test_learning_that_begins_anew_begins_with_the_whole_gain(how):
    block = learning(error_filter=(1.0,), lead=1, gain=0.8, averaging=2.0, least_gain=0.01)
    _, before = followed(block, (0.0, 1.0), 12, REFERENCE + 5e-7)
    assert gains(before)[-1] < 0.2
    other = np.tile(REFERENCE + 5e-7, 6)
    if how == "another reference":
        other = np.tile(-2.0 * REFERENCE + 9e-7, 6)
    else:
        block.set_mode(FROZEN)
        followed(block, (0.0, 1.0), 2, REFERENCE + 5e-7)
        block.set_mode(LEARNING)
    _, after = followed(block, (0.0, 0.6), 6, other)
    # of the remaining error 0.6 · 0.8, and more from a period that is not averaged yet
    taken = gains(after)
    assert taken[1:3].max() > 0.35, taken


def test_a_hole_in_the_errors_is_weighed_by_the_sizes_of_the_taps_that_meet_it():
    """Taps that cancel also count: a missing error matters little at a small tap; at a large one the sample is lost."""
    hole = 2 * N + 17
    m, _ = followed(learning(error_filter=(0.5, 0.04, -0.5), lead=1), (0.0, 0.9), 5, bad={hole})
    # the large taps belong to the samples before and after it
    np.testing.assert_array_equal(np.flatnonzero(m[3] == m[2]), [16, 18])
