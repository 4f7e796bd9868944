# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Loop widths without inverse, after Picard steps and with the exact inverse, on the loop of K7a to 120 V (K8).

The digest's numbers are those of the static branches: Picard's iteration on x_r and on x_f of the 120 V loop, continued
below 0 V, for commands from 0 to S = g · 120 V; the width is the largest distance of the branches as a fraction of S.
The compensator runs the iteration on the model with its memory instead, where a trial voltage below the present one is
a reversal. This converges faster, so its loops are narrower.
"""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.models.block import interpreted
from hysteresis_ros.models.compensator import Compensator, CompensatorParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis, assumed_stack, falling_curve, rising_curve
from hysteresis_ros.models.inverses import InverseParameters, picard
from hysteresis_ros.models.limits import LimitsParameters

GAIN = 0.1025e-6
STROKE = 120.0 * GAIN
STACK = PolynomialHysteresis(assumed_stack(), 1.0)


def branch(curve):
    return lambda p, x, voltage: curve(p, 120.0, voltage)


def static_width(steps, rate_times_gain):
    """Largest distance between both branches after Picard steps, % of S."""
    p_i, scratch = np.array([steps, rate_times_gain / GAIN, GAIN]), np.zeros(13)
    reached = []
    for curve in (rising_curve, falling_curve):
        hysteresis = branch(curve)
        voltages = [
            interpreted(picard)(hysteresis, p_i, scratch, STACK.p, STACK.x, command)
            for command in np.linspace(0.0, STROKE, 1001)
        ]
        reached.append([hysteresis(STACK.p, STACK.x, voltage) for voltage in voltages])
    return 100.0 * np.abs(np.subtract(*reached)).max() / STROKE


@pytest.mark.parametrize(
    ("rate_times_gain", "steps", "published"),
    [(1.0, 0, 15.0), (1.0, 1, 8.2), (1.0, 3, 1.7), (1.0, 6, 0.26), (1.12, 1, 9.3), (1.12, 3, 1.8), (1.12, 6, 0.10)],
)
def test_static_branches_have_the_digest_s_widths(rate_times_gain, steps, published):
    assert static_width(steps, rate_times_gain) == pytest.approx(published, rel=0.05 if steps == 6 else 0.02)


def running_width(kind, steps=1, rate_times_gain=1.0, points=1000):
    """Largest loop width of displacement over command in the second cycle between 0 and S, % of S."""
    parameters = CompensatorParameters(
        inverse=InverseParameters(type=kind, picard_steps=steps, picard_rate=rate_times_gain / GAIN),
        hysteresis=HysteresisParameters(type="polynomial", polynomial=assumed_stack()),
        limits=LimitsParameters(minimum=-30.0, maximum=150.0),
    )
    block, plant = Compensator(parameters, 1e-3), PolynomialHysteresis(assumed_stack(), 1e-3)
    up = np.linspace(0.0, STROKE, points + 1)
    down = up[::-1]
    cycle = np.concatenate([up, down[1:], up[1:], down[1:]])
    reached = np.array([plant.step(block.step(command)) for command in cycle])
    rising, falling = reached[2 * points : 3 * points + 1], reached[3 * points :][::-1]
    return 100.0 * np.abs(rising - falling).max() / STROKE


def test_running_loop_without_inverse_is_as_wide():
    assert running_width("none") == pytest.approx(15.0, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("rate_times_gain", [1.0, 1.12])
@pytest.mark.parametrize("steps", [1, 3, 6])
def test_running_compensator_closes_the_loop_further(steps, rate_times_gain):
    assert running_width("picard_steps", steps, rate_times_gain) < 0.65 * static_width(steps, rate_times_gain)


def test_exact_inverse_closes_the_loop():
    assert running_width("exact") < 1e-7
