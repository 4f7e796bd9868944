# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Moves with a waiting caller: their end, and their result."""

from __future__ import annotations

import math

import pytest

from hysteresis_ros.references.moves import Ending, Move, Tolerances
from hysteresis_ros.references.trajectory import ENDED, HELD, OPEN, REPLACED, STOPPED

NEAR = Tolerances(goal=1e-8, dwell=0.02, goal_time=0.5, path=1e-6)


def looked(outcomes_and_errors, number=3, step=0.01):
    """Return the sample at which a move ended, and its result."""
    move = Move(3, NEAR)
    for k, (outcome, error) in enumerate(outcomes_and_errors):
        found = move.look(step * k, (number, outcome), error)
        if found:
            return k, found[0]
    return None


def test_a_move_has_arrived_when_it_stays_near_after_its_last_point():
    near, far = 5e-9, 5e-8
    assert looked([(OPEN, near)] * 50) is None
    assert looked([(OPEN, near)] * 5 + [(ENDED, far)] * 3 + [(ENDED, near)] * 9) == (10, Ending.ARRIVED)
    assert looked([(ENDED, near), (ENDED, far)] * 40) == (53, Ending.GOAL_MISSED)
    assert looked([(ENDED, math.nan)] * 80) == (53, Ending.GOAL_MISSED)


@pytest.mark.parametrize(
    ("outcome", "ending"),
    [(REPLACED, Ending.REPLACED), (HELD, Ending.CANCELLED), (STOPPED, Ending.STOPPED)],
)
def test_it_ends_as_its_trajectory_does(outcome, ending):
    assert looked([(OPEN, 0.0), (outcome, 0.0)]) == (1, ending)


def test_it_is_replaced_by_another_trajectory_and_must_not_leave_its_path():
    assert looked([(OPEN, 0.0)], number=4) == (0, Ending.REPLACED)
    assert looked([(OPEN, 9e-7), (OPEN, -1.1e-6)]) == (1, Ending.PATH_VIOLATED)
    assert looked([(ENDED, 1.1e-6)]) is None
