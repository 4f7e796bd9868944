# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Robust comparison: sliding mode designs for the corners of the mismatch, also with one more sample of delay."""

from __future__ import annotations

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.uncertainty import Uncertainty
from hysteresis_ros.designs.gains import robustness
from hysteresis_ros.laboratory.comparison.candidates import candidates
from hysteresis_ros.laboratory.comparison.compare import trial_around
from hysteresis_ros.laboratory.comparison.tasks import Conditions
from hysteresis_ros.loop.parameters import part

NAME = "offset-free + feedforward", "none"


def test_robust_candidates_keep_their_margins_on_the_corners_and_others_do_not():
    corners = Uncertainty(0.05, 0.05, 0.05, draws=0)
    for robust in (False, True):
        trial = trial_around(load_configuration("picma_stage"), Conditions(draws=1, others=0, robust=robust))
        (found,) = candidates(trial.given, trial.conditions, trial.tasks, {NAME})
        node = trial.given.designed(found).motion_controller
        worth = robustness(part(node, ControllerParameters), 1.0 / node.sample_rate, corners)
        assert not found.marked and (worth.misses() == ()) == robust
