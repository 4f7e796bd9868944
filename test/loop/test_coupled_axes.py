# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Two actuators that move each other, in one tick of the same kernels: compiled as one function, and stable."""

from __future__ import annotations

import numpy as np
import pytest
from coupled_support import SETPOINTS, coupled_run
from interpreted import interpreted
from loop_support import HOLD, axis

COUPLING = 0.15


@pytest.fixture(scope="module")
def run():
    """Measured displacements, voltages and modes of both axes."""
    return coupled_run(1500, COUPLING)


@pytest.mark.slow
def test_two_coupled_axes_are_one_function_with_the_bits_of_its_python_form(run, tmp_path):
    expected = interpreted("coupled_support", f"coupled_run(1500, {COUPLING})", tmp_path)
    np.testing.assert_array_equal(run.view(np.int64), expected.view(np.int64))


def test_both_reach_their_setpoints_though_each_moves_the_other(run):
    for measured, setpoint in zip(run[:2], SETPOINTS, strict=True):
        assert measured[-1] == pytest.approx(setpoint, abs=2e-8)
        assert np.max(np.abs(measured[-200:] - setpoint)) < 2e-8
    alone = coupled_run(1500, 0.0)
    # less voltage than for a single axis, because the other actuator contributes
    assert np.all(run[2:4, -1] < alone[2:4, -1] - 2.0)
    assert not run[4:].any()


def test_without_coupling_each_is_the_axis_it_is_alone():
    both = coupled_run(300, 0.0)
    controller = {"kalman__gain": "riccati", "kalman__L": [], "kalman__disturbance": "constant"}
    for number, setpoint in enumerate(SETPOINTS):
        alone = axis(**HOLD, motion_controller=controller).run(np.full(300, setpoint))
        np.testing.assert_array_equal(both[number].view(np.int64), alone["measured"].view(np.int64))
        np.testing.assert_array_equal(both[2 + number].view(np.int64), alone["voltage"].view(np.int64))


def test_a_fault_of_one_leaves_the_other_in_control(run):
    table = coupled_run(1500, COUPLING, faults=(("stale:0.2:0.1",), ()))
    np.testing.assert_array_equal(np.flatnonzero(table[4]), np.arange(600, 900))
    assert not table[5].any()
    np.testing.assert_array_equal(table[:, :600], run[:, :600])
    assert np.max(np.abs(table[1, 600:] - SETPOINTS[1])) < 1e-6
