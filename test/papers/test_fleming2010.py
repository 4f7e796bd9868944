# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The claims of the abstract of Fleming et al. 2010 give the stated results; rows that do not hold have a reason."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest
from claims_support import assert_shown

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.laboratory.papers import fleming2010
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.reach import single_axis

DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs" / "fleming2010.md"


@pytest.fixture(scope="module")
def found():
    return fleming2010.reproduce()


def test_exactly_the_known_row_does_not_hold_and_all_name_their_assumptions(found):
    failing = {claim.id: claim.reason for claim in found.claims if claim.holds is False}
    assert set(failing) == {"loop.lowered"} and all(failing.values())
    assert all(claim.assumptions for claim in found.claims)


def test_the_document_shows_the_table_as_it_is_printed(found):
    assert_shown(found, DOCUMENT)


def test_the_configuration_has_the_gains_that_the_reproduction_finds():
    node = single_axis(load_configuration("fleming2010")).motion_controller
    given, made = part(node, ControllerParameters), fleming2010.designed(load_configuration("fleming2010"))["tracking"]
    assert given.damping.irc == made.damping.irc
    for name in ("Kp", "Ki", "Kd", "derivative_filter"):
        assert getattr(given.pid, name) == pytest.approx(getattr(made.pid, name), rel=1e-4)


def test_law_and_damping_are_the_integrator_in_front_of_the_papers_second_order_controller():
    # gain/s · k/(s − k D_f) in the outer loop, at frequencies far below the sample rate
    model, k, gain = fleming2010.scanner(934.0, 1e-5), 3000.0, 700.0
    from hysteresis_ros.control.linearisation import linear_loop

    controller, _ = linear_loop(fleming2010.tracking(gain, k, model), 1e-5)
    hertz = np.array([3.0, 50.0, 400.0, 2000.0])
    s = 2j * np.pi * hertz
    outer = -controller.response(np.exp(s * 1e-5))[:, 0, 1] * (1.0 + 1.0 / fleming2010.FEEDTHROUGH)
    assert outer == pytest.approx(gain / s * k / (s - k * fleming2010.FEEDTHROUGH), rel=0.07)
    assert outer[:3] == pytest.approx((gain / s * k / (s - k * fleming2010.FEEDTHROUGH))[:3], rel=0.02)
