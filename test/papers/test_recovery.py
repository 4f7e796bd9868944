# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The figures of the papers' linear parts, as printed by the module."""

import pytest

from hysteresis_ros.laboratory.papers.auwal2017.model import paper_b_reduction
from hysteresis_ros.laboratory.papers.kim2009.identification import paper_k_dynamics


def test_order_three_and_the_635_hz_pole_pair_come_back_from_a_noisy_recording():
    order, frequency, damping = paper_k_dynamics()
    assert order == 3
    assert frequency == pytest.approx(635.0, abs=0.5)
    assert damping == pytest.approx(0.0018, abs=3e-4)


def test_mass_damping_and_stiffness_are_the_papers_within_half_a_percent():
    assert all(abs(difference) < 0.005 for difference in paper_b_reduction().values())
