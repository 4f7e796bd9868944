"""The figures of the papers' linear parts, as the module prints them."""

import pytest

from hysteresis_ros.papers.auwal2017.recovery import paper_b_reduction
from hysteresis_ros.papers.kim2009.recovery import paper_k_dynamics


def test_order_three_and_the_635_hz_pole_pair_come_back_from_a_noisy_recording():
    order, frequency, damping = paper_k_dynamics()
    assert order == 3
    assert frequency == pytest.approx(635.0, abs=0.5)
    assert damping == pytest.approx(0.0018, abs=3e-4)


def test_mass_damping_and_stiffness_are_the_papers_within_half_a_percent():
    assert all(abs(difference) < 0.005 for difference in paper_b_reduction().values())
