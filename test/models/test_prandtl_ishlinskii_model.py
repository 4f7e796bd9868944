# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Prandtl-Ishlinskii: play operators in closed form, dead zones and their inverse, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import (
    PrandtlIshlinskiiHysteresis,
    PrandtlIshlinskiiParameters,
    dead_zones,
    dead_zones_inverse,
)


def block(**changes):
    given = dict(radii=(0.0, 10.0), weights=(80e-9, 20e-9), **changes)
    return PrandtlIshlinskiiHysteresis(PrandtlIshlinskiiParameters(**given), 1e-3)


def test_one_play_by_hand():
    """Up to 50 V the play follows 10 V behind; it does not move while the voltage falls by 20 V."""
    np.testing.assert_allclose(
        block(offset=1e-7).simulate([5.0, 50.0, 40.0, 30.0, 0.0]),
        1e-7 + 80e-9 * np.array([5.0, 50.0, 40.0, 30.0, 0.0]) + 20e-9 * np.array([0.0, 40.0, 40.0, 40.0, 10.0]),
        rtol=1e-14,
    )


def test_classical_loop_is_point_symmetric_and_its_width_is_known():
    drive = np.concatenate([np.linspace(-100.0, 100.0, 201), np.linspace(100.0, -100.0, 201)])
    pi = block()
    pi.simulate([100.0])
    y = pi.simulate(drive)
    np.testing.assert_allclose(y[:201], -y[201:], atol=1e-18)
    assert np.max(y[201:][::-1] - y[:201]) == pytest.approx(20e-9 * 20.0)


def test_dead_zones_bend_both_branches_alike():
    plain, bent = block(), block(thresholds=(4e-6,), zone_weights=(-0.5,))
    drive = 100.0 * np.sin(0.1 * np.arange(200))
    x = plain.simulate(drive)
    np.testing.assert_allclose(bent.simulate(drive), x - 0.5 * np.maximum(x - 4e-6, 0.0), atol=1e-18)


@given(
    x=st.floats(-2e-5, 2e-5),
    thresholds=st.lists(st.floats(-1e-5, 1e-5), max_size=6, unique=True),
    slope=st.floats(-0.15, 2.0),
)
def test_dead_zones_are_inverted(x, thresholds, slope):
    p = block(thresholds=tuple(thresholds), zone_weights=(slope,) * len(thresholds)).p
    assert dead_zones_inverse(p, dead_zones(p, x)) == pytest.approx(x, abs=1e-18)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(weights=(80e-9, -1e-9)), r"weights.*out of range.*≥ 0"),
        (dict(weights=(0.0, 1e-9)), r"weights.*above 0"),
        (dict(radii=(1.0, 10.0)), r"radii.*radius 0"),
        (dict(radii=(0.0, 0.0)), r"radii.*rise strictly"),
        (dict(weights=(1e-9,)), r"weights.*as many numbers as radii \(2\)"),
        (dict(thresholds=(1e-6,), zone_weights=(-1.0,)), r"zone_weights.*above zero the slope.*monotone"),
        (dict(thresholds=(-1e-6, -2e-6), zone_weights=(-0.5, -0.6)), r"zone_weights.*below zero.*-0.1"),
        (dict(thresholds=(1e-6,)), r"zone_weights.*as many numbers as thresholds"),
    ],
)
def test_what_is_not_monotone_is_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        PrandtlIshlinskiiHysteresis(
            PrandtlIshlinskiiParameters(**{"radii": (0.0, 10.0), "weights": (8e-8, 2e-8), **changes}), 1e-3
        )
